/* lightmill-relay: the command line around relay.h. */
#include "common/address.h"
#include "common/memory_limit.h"
#include "proto/wire/wire.h"
#include "relay/relay.h"

#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { DEFAULT_PORT = 7430 };

/* Written by the signal handler; the one variable of this kind that a handler needs. */
static atomic_int stop_requested;

static const char usage[] =
    "lightmill-relay: between a master and many workers: adds up what they render and forwards one batch\n"
    "\n"
    "usage: lightmill-relay [MASTER[:PORT]] [options]\n"
    "\n"
    "MASTER (default 127.0.0.1:7420) is a master or another relay. Workers dial the relay as they would the\n"
    "master: lightmill-worker RELAY:7430. It may be started before both.\n"
    "\n"
    "  --listen HOST[:PORT]   where workers dial (127.0.0.1:7430); the port after it is used too;\n"
    "                         port 0 chooses free ones\n"
    "  --data DIR             where scenes, keys and the list of workers are kept (lightmill-relay-data)\n"
    "  --scene-limit GB       how much scenes may take; the least recently used go first (20)\n"
    "  --name NAME            what to be called (host name and process number)\n"
    "  --heartbeat SECONDS    how often workers say that they live (1)\n"
    "  --lease SECONDS        the silence after which a worker's share is given to others (5)\n"
    "  --batch-interval SECONDS  how often workers send what they have (10)\n"
    "  --grace SECONDS        how long leaving may take (25)\n"
    "  --quiet                warnings and errors only\n"
    "  --verbose              every batch and assignment\n"
    "  --help, --version\n";
static const char usage_end[] =
    "\n"
    "Keys (docs/relay.md): the relay's own key, for the master and for its workers, and who may dial it\n"
    "\n"
    "  --key FILE             the relay's .secret file\n"
    "  --master-key KEY       the master's public key, or a file that holds it\n"
    "  --allow FILE           the list of workers' keys (DATA/keys/allow)\n"
    "  --insecure             no keys, in either direction\n"
    "\n"
    "SIGTERM or SIGINT: calls in what the workers have finished, delivers it and leaves; twice: at once.\n"
    "Exit codes: 0 left as asked and all was delivered, 1 wrong command line, 2 a bad key file, 3 the "
    "operating\n"
    "system refused, 5 out of memory, 6 not all could be delivered within the grace period, 7 told twice to\n"
    "leave, 9 no key.\n";

static void on_signal(int number)
{
    (void)number;
    if (atomic_fetch_add(&stop_requested, 1) > 0) _exit(RESULT_CANCELLED);
}

static void catch_signals(void)
{
    struct sigaction action = {.sa_handler = on_signal};
    sigemptyset(&action.sa_mask);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
    signal(SIGHUP,
           SIG_IGN); /* a master reads its list of keys anew; a relay sees by itself that it changed */
}

typedef struct {
    relay_options_t relay;
    dial_options_t dial;
    health_options_t health;
    pulse_t pulse;
    char *master, *control, *bulk; /* endpoints, owned */
    log_level_t level;
    bool done; /* help or version was printed */
} command_t;

static result_t parse_number(const char *option, const char *text, double least, double most, double *value)
{
    char *end;
    errno = 0;
    *value = strtod(text, &end);
    if (end == text || *end != '\0' || errno != 0 || !(*value >= least && *value <= most))
        return result_fail(RESULT_USAGE, "--%s takes a number from %g to %g, not '%.100s'", option, least,
                           most, text);
    return result_ok();
}

static void set_listen(command_t *command, char *control, char *bulk)
{
    free(command->control);
    free(command->bulk);
    command->control = control;
    command->bulk = bulk;
}

/* "HOST:0" asks for free ports, which an address cannot say. */
static result_t parse_listen(const char *text, command_t *command)
{
    address_t address;
    size_t length = strlen(text);
    if (length > 2 && strcmp(text + length - 2, ":0") == 0) {
        char *host = mem_strdup(text);
        host[length - 2] = '\0';
        result_t result = address_parse(host, DEFAULT_PORT, &address);
        free(host);
        TRY(result);
        set_listen(command, mem_printf("tcp://%s:*", address.host), mem_printf("tcp://%s:*", address.host));
        return result_ok();
    }
    TRY(address_parse(text, DEFAULT_PORT, &address));
    if (address.port == 65535) return result_fail(RESULT_USAGE, "port 65535 leaves none for the bulk socket");
    set_listen(command, address_endpoint(&address, address.port),
               address_endpoint(&address, address.port + 1));
    return result_ok();
}

static result_t parse_option(command_t *command, const char *option, const char *value)
{
    relay_options_t *relay = &command->relay;
    double number;
    bool dial = dial_option(&command->dial, option, value);
    if (gate_option(&relay->gate, option, value) || dial) return result_ok();
    if (health_option(&command->health, option, value)) return result_ok();
    if (strcmp(option, "listen") == 0) return parse_listen(value, command);
    if (strcmp(option, "heartbeat") == 0) return parse_number(option, value, 0, 1e6, &relay->heartbeat);
    if (strcmp(option, "lease") == 0) return parse_number(option, value, 0, 1e6, &relay->lease);
    if (strcmp(option, "batch-interval") == 0)
        return parse_number(option, value, 0, 1e6, &relay->batch_interval);
    if (strcmp(option, "grace") == 0) return parse_number(option, value, 0, 86400, &relay->grace);
    if (strcmp(option, "scene-limit") == 0) {
        TRY(parse_number(option, value, 0, 1e9, &number));
        relay->cache_limit = (uint64_t)(number * 1e9);
    } else if (strcmp(option, "data") == 0) {
        relay->data_dir = value;
    } else if (strcmp(option, "name") == 0) {
        relay->name = value;
    } else if (strcmp(option, "quiet") == 0) {
        command->level = LOG_WARNING;
    } else if (strcmp(option, "verbose") == 0) {
        command->level = LOG_DEBUG;
    } else {
        if (strcmp(option, "help") == 0)
            printf("%s%s%s", usage, health_usage, usage_end);
        else
            puts("lightmill-relay " LIGHTMILL_VERSION);
        command->done = true;
    }
    return result_ok();
}

static result_t parse_arguments(int argc, char **argv, command_t *command)
{
    static const struct option options[] = {{"listen", required_argument, NULL, 0},
                                            {"data", required_argument, NULL, 0},
                                            {"scene-limit", required_argument, NULL, 0},
                                            {"name", required_argument, NULL, 0},
                                            {"heartbeat", required_argument, NULL, 0},
                                            {"lease", required_argument, NULL, 0},
                                            {"batch-interval", required_argument, NULL, 0},
                                            {"grace", required_argument, NULL, 0},
                                            {"key", required_argument, NULL, 0},
                                            {"master-key", required_argument, NULL, 0},
                                            {"allow", required_argument, NULL, 0},
                                            {"insecure", no_argument, NULL, 0},
                                            HEALTH_OPTIONS,
                                            {"quiet", no_argument, NULL, 0},
                                            {"verbose", no_argument, NULL, 0},
                                            {"help", no_argument, NULL, 0},
                                            {"version", no_argument, NULL, 0},
                                            {NULL, 0, NULL, 0}};
    int index, found;
    while ((found = getopt_long(argc, argv, "", options, &index)) != -1) {
        if (found == '?') return result_fail(RESULT_USAGE, "see lightmill-relay --help");
        TRY(parse_option(command, options[index].name, optarg));
        if (command->done) return result_ok();
    }
    if (command->health.ask) return result_ok();
    if (argc - optind > 1)
        return result_fail(RESULT_USAGE, "more than one master: '%.100s'", argv[optind + 1]);
    address_t address;
    TRY(address_parse(optind < argc ? argv[optind] : "127.0.0.1", WIRE_DEFAULT_PORT, &address));
    command->master = address_endpoint(&address, address.port);
    return dial_keys_find(&command->dial, address.host, &command->relay.keys);
}

static result_t run(command_t *command)
{
    relay_options_t *relay = &command->relay;
    relay->master_endpoint = command->master;
    if (command->control != NULL) {
        relay->control_endpoint = command->control;
        relay->bulk_endpoint = command->bulk;
    }
    log_init("relay", command->level);
    catch_signals();
    file_limit_raise();
    relay->pulse = &command->pulse;
    health_t *health;
    TRY(health_start(command->health.path, pulse_report, &command->pulse, &health));
    result_t result = relay_run(relay, &stop_requested, NULL);
    health_stop(&health);
    return result;
}

int main(int argc, char **argv)
{
    command_t command = {.relay = relay_options_default(),
                         .dial.role = "relay",
                         .health = health_options_default(),
                         .level = LOG_INFO};
    result_t result = parse_arguments(argc, argv, &command);
    if (result.code == RESULT_OK && !command.done)
        result = command.health.ask ? health_print(&command.health) : run(&command);
    if (result.code != RESULT_OK) fprintf(stderr, "lightmill-relay: %s\n", result.message);
    dial_keys_free(&command.relay.keys);
    free(command.master);
    free(command.control);
    free(command.bulk);
    return result_exit_code(result);
}
