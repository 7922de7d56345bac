/* lightmill-relay: the command line around relay.h. */
#include "common/address.h"
#include "common/interrupt.h"
#include "common/memory_limit.h"
#include "common/options/service_options.h"
#include "relay/relay.h"

#include <signal.h>
#include <stdlib.h>
#include <sys/stat.h>

enum { DEFAULT_PORT = 7430 };

/* The relay has one key, for the master and for its workers. */
typedef struct {
    relay_options_t relay;
    dial_options_t dial;
    service_options_t service;
    pulse_t pulse;
    const char *listen;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, listen, "listen", "HOST[:PORT]",
           "where workers dial (default: 127.0.0.1:7430); the port after it is used too; port 0 chooses free "
           "ones"),
    OPTION(values_t, relay.data_dir, "data", "DIR",
           "where scenes, keys and the list of workers are kept (default: lightmill-relay-data)"),
    OPTION_BY(option_gigabytes, values_t, relay.cache_limit, "scene-limit", "GB",
              "how much scenes may take; the least recently used go first (default: 20)",
              OPTION_RANGE(0, 1e6)),
    OPTION(values_t, relay.name, "name", "NAME", "what to be called (default: host name and process number)"),
    OPTION(values_t, relay.heartbeat, "heartbeat", "SECONDS",
           "how often workers say that they live (default: 1)", OPTION_RANGE(0, 1e6)),
    OPTION(values_t, relay.lease, "lease", "SECONDS",
           "the silence after which a worker's share is given to others (default: 5)", OPTION_RANGE(0, 1e6)),
    OPTION(values_t, relay.batch_interval, "batch-interval", "SECONDS",
           "how often workers send what they have (default: 10)", OPTION_RANGE(0, 1e6)),
    OPTION(values_t, relay.grace, "grace", "SECONDS", "how long leaving may take (default: 25)",
           OPTION_RANGE(0, 86400)),
};
static const option_group_t relay_group = OPTION_GROUP(NULL, rows);

static result_t take_key(const option_t *option, const char *text, void *field)
{
    (void)option;
    values_t *values = field;
    values->dial.key = values->relay.gate.key = text;
    return result_ok();
}

static result_t take_insecure(const option_t *option, const char *text, void *field)
{
    (void)option, (void)text;
    values_t *values = field;
    values->dial.insecure = values->relay.gate.insecure = true;
    return result_ok();
}

static const option_t key_rows[] = {
    {.name = "key", .argument = "FILE", .help = "the relay's .secret file", .parse = take_key},
    OPTION(values_t, dial.master_key, "master-key", "KEY",
           "the master's public key, or a file that holds it"),
    OPTION(values_t, relay.gate.allow, "allow", "FILE",
           "the list of workers' keys (default: DATA/keys/allow)"),
    {.name = "insecure", .help = "no keys, in either direction", .parse = take_insecure},
};
static const option_group_t key_group = OPTION_GROUP(
    "Keys (docs/relay.md): the relay's own, for the master and for its workers, and who may dial it",
    key_rows);

static void begin(void *data)
{
    *(values_t *)data =
        (values_t){.relay = relay_options_default(), .dial.role = "relay", .listen = "127.0.0.1"};
}

static result_t serve(values_t *values)
{
    log_init("relay", service_log_level(&values->service));
    signal(SIGPIPE, SIG_IGN);
    /* A master reads its list of keys anew; a relay sees by itself that it changed. */
    signal(SIGHUP, SIG_IGN);
    const atomic_int *stop = interrupt_catch();
    file_limit_raise();
    health_t *health;
    values->relay.pulse = &values->pulse;
    TRY(health_start(values->service.health, pulse_report, &values->pulse, &health));
    result_t result = relay_run(&values->relay, stop, NULL);
    health_stop(&health);
    return result;
}

static result_t run(const call_t *call)
{
    values_t *values = call->values;
    if (values->service.ask_health) return service_ask_health(&values->service);
    char *control, *bulk, *master = NULL;
    TRY(address_listen(values->listen, DEFAULT_PORT, &control, &bulk));
    result_t result = dial_find(&values->dial, call->arguments[0], &values->relay.keys, &master);
    values->relay.control_endpoint = control;
    values->relay.bulk_endpoint = bulk;
    values->relay.master_endpoint = master;
    if (result.code == RESULT_OK) result = serve(values);
    dial_keys_free(&values->relay.keys);
    free(master);
    free(control);
    free(bulk);
    return result;
}

static const command_t command = {
    .name = "lightmill-relay",
    .arguments = "[MASTER[:PORT]]",
    .summary = "stand between a master and many workers: add up what they render, forward one batch",
    .about = "Stands between a master and many workers: adds up what they render and forwards one batch.\n\n"
             "MASTER (default 127.0.0.1:7420) is a master or another relay. Workers dial the relay as they "
             "would the master: lightmill-worker RELAY:7430. It may be started before both.",
    .groups = {{&relay_group, 0}, {&service_options, offsetof(values_t, service)}, {&key_group, 0}},
    .after =
        "SIGTERM or SIGINT: calls in what the workers have finished, delivers it and leaves; twice: at "
        "once.\n\n"
        "Exit codes: 0 left as asked and all was delivered, 1 wrong command line, 2 a bad key file, 3 the "
        "operating system refused, 5 out of memory, 6 not all could be delivered within the grace "
        "period, 7 told twice to leave, 9 no key.",
    .size = sizeof(values_t),
    .begin = begin,
    .run = run};

int main(int argc, char **argv)
{
    umask(077); /* what it writes is for its own user alone: scenes, images, keys */
    return command_main(&command, argc, argv);
}
