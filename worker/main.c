/* lightmill-worker: renders for a master until it is told to leave. Only the command line lives here. */
#include "common/interrupt.h"
#include "common/options/service_options.h"
#include "worker/worker.h"

#include <signal.h>
#include <stdlib.h>
#include <unistd.h>

typedef struct {
    worker_options_t worker;
    dial_options_t dial;
    service_options_t service;
    pulse_t pulse;
} values_t;

static const option_t rows[] = {
    OPTION(worker_options_t, grace, "grace", "SECONDS",
           "how long leaving may take: units that are not finished in time are given up (default: 25)",
           OPTION_RANGE(0, 86400)),
    OPTION(worker_options_t, threads, "threads", "N", "render threads (default: one a core)",
           OPTION_RANGE(1, 4096)),
    OPTION(worker_options_t, name, "name", "NAME",
           "what to be called (default: host name and process number)"),
    OPTION(worker_options_t, cache_dir, "cache", "DIR",
           "where scenes are kept, shared by the workers of a machine (default: $XDG_CACHE_HOME/lightmill or "
           "~/.cache/lightmill)"),
    OPTION_BY(option_gigabytes, worker_options_t, cache_limit, "cache-limit", "GB",
              "how much they may take; the least recently used go first (default: 20)", OPTION_RANGE(0, 1e6)),
};
static const option_group_t worker_group = OPTION_GROUP(NULL, rows);

static void begin(void *data)
{
    *(values_t *)data = (values_t){.worker = worker_options_default(), .dial.role = "worker"};
}

static result_t serve(values_t *values)
{
    const char *called = values->worker.name;
    char *name = called ? mem_printf("worker %s", called) : mem_printf("worker %d", (int)getpid());
    log_init(name, service_log_level(&values->service));
    free(name);
    signal(SIGPIPE, SIG_IGN);
    signal(SIGHUP, SIG_IGN); /* keys are read again for every connection anyway */
    const atomic_int *stop = interrupt_catch();
    health_t *health;
    values->worker.pulse = &values->pulse;
    TRY(health_start(values->service.health, pulse_report, &values->pulse, &health));
    result_t result = worker_run(&values->worker, stop);
    health_stop(&health);
    return result;
}

static result_t run(const call_t *call)
{
    values_t *values = call->values;
    if (values->service.ask_health) return service_ask_health(&values->service);
    char *endpoint;
    TRY(dial_find(&values->dial, call->arguments[0], &values->worker.keys, &endpoint));
    values->worker.control_endpoint = endpoint;
    result_t result = serve(values);
    dial_keys_free(&values->worker.keys);
    free(endpoint);
    return result;
}

static const command_t command = {
    .name = "lightmill-worker",
    .arguments = "[HOST[:PORT]]",
    .summary = "render for a master",
    .about = "Renders for the master at HOST:PORT (default 127.0.0.1:7420). It may be started before the "
             "master, and finds it again when it comes back.",
    .groups = {{&worker_group, offsetof(values_t, worker)},
               {&service_options, offsetof(values_t, service)},
               {&dial_options, offsetof(values_t, dial)}},
    .after =
        "SIGTERM or Ctrl-C: finish and send what is in hand, then leave; twice: at once. SIGHUP is "
        "ignored.\n\n"
        "Exit codes: 0 left as asked and all was delivered, 1 wrong command line, 2 a bad key file, 3 the "
        "operating system refused, 5 out of memory, 6 the last batch could not be delivered within the grace "
        "period, 7 told twice to leave, 9 no key.",
    .size = sizeof(values_t),
    .begin = begin,
    .run = run};

int main(int argc, char **argv)
{
    return command_main(&command, argc, argv);
}
