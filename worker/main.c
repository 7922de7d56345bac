/* lightmill-worker: renders for a master until it is told to leave.
 *
 * DESIGN. Only the command line and the signals live here. The first SIGTERM or SIGINT asks the worker to
 * finish what it has begun and to send it; the second ends the process at once.
 */
#include "common/address.h"
#include "proto/wire/wire.h"
#include "worker/worker.h"

#include <errno.h>
#include <getopt.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MAX_THREADS = 4096, MAX_GRACE = 86400 };

/* Written by the signal handler; the one variable of this kind that a handler needs. */
static atomic_int stop_requested;

static const char usage[] =
    "usage: lightmill-worker [HOST[:PORT]] [options]\n"
    "\n"
    "Renders for the master at HOST:PORT (default 127.0.0.1:7420). It may be started before the master, and "
    "finds\n"
    "it again when it comes back. SIGTERM or Ctrl-C: finish and send what is in hand, then leave; twice: at "
    "once.\n"
    "\n"
    "  --grace SECONDS    how long leaving may take: units that are not finished in time are given up "
    "(default: "
    "25)\n"
    "  --threads N        render threads (default: one a core)\n"
    "  --name NAME        what to be called (default: host name and process number)\n"
    "  --cache DIR        where scenes are kept, shared by the workers of a machine\n"
    "                     (default: $XDG_CACHE_HOME/lightmill or ~/.cache/lightmill)\n"
    "  --cache-limit GB   how much they may take; the least recently used go first (default: 20)\n"
    "  --quiet            warnings and errors only\n"
    "  --verbose          every batch and assignment\n"
    "  --help, --version\n";
static const char usage_keys[] = "\n"
                                 "Keys, to join a master on another machine (docs/security.md):\n"
                                 "\n";
static const char usage_end[] =
    "\n"
    "Exit codes: 0 left as asked and all was delivered, 1 wrong command line, 2 a bad key file, 3 the "
    "operating\n"
    "system refused, 5 out of memory, 6 the last batch could not be delivered within the grace period,\n"
    "7 told twice to leave, 9 no key.\n";

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
}

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

typedef struct {
    worker_options_t options;
    dial_options_t dial;
    health_options_t health;
    pulse_t pulse;
    char *endpoint; /* owned */
    log_level_t level;
    bool done; /* help or version was printed */
} command_t;

static result_t parse_option(command_t *command, const char *option, const char *value)
{
    double number;
    if (dial_option(&command->dial, option, value)) return result_ok();
    if (health_option(&command->health, option, value)) return result_ok();
    if (strcmp(option, "threads") == 0) {
        TRY(parse_number(option, value, 1, MAX_THREADS, &number));
        command->options.threads = (int)number;
    } else if (strcmp(option, "cache-limit") == 0) {
        TRY(parse_number(option, value, 0, 1e9, &number));
        command->options.cache_limit = (uint64_t)(number * 1e9);
    } else if (strcmp(option, "grace") == 0) {
        TRY(parse_number(option, value, 0, MAX_GRACE, &command->options.grace));
    } else if (strcmp(option, "cache") == 0) {
        command->options.cache_dir = value;
    } else if (strcmp(option, "name") == 0) {
        command->options.name = value;
    } else if (strcmp(option, "quiet") == 0) {
        command->level = LOG_WARNING;
    } else if (strcmp(option, "verbose") == 0) {
        command->level = LOG_DEBUG;
    } else {
        if (strcmp(option, "help") == 0)
            printf("%s%s%s%s%s", usage, health_usage, usage_keys, dial_usage, usage_end);
        else
            puts("lightmill-worker " LIGHTMILL_VERSION);
        command->done = true;
    }
    return result_ok();
}

static result_t parse_arguments(int argc, char **argv, command_t *command)
{
    static const struct option options[] = {DIAL_OPTIONS,
                                            {"threads", required_argument, NULL, 0},
                                            {"name", required_argument, NULL, 0},
                                            {"grace", required_argument, NULL, 0},
                                            {"cache", required_argument, NULL, 0},
                                            {"cache-limit", required_argument, NULL, 0},
                                            HEALTH_OPTIONS,
                                            {"quiet", no_argument, NULL, 0},
                                            {"verbose", no_argument, NULL, 0},
                                            {"help", no_argument, NULL, 0},
                                            {"version", no_argument, NULL, 0},
                                            {NULL, 0, NULL, 0}};
    *command = (command_t){.options = worker_options_default(),
                           .dial.role = "worker",
                           .health = health_options_default(),
                           .level = LOG_INFO};
    int index, found;
    while ((found = getopt_long(argc, argv, "", options, &index)) != -1) {
        if (found == '?') return result_fail(RESULT_USAGE, "see lightmill-worker --help");
        TRY(parse_option(command, options[index].name, optarg));
        if (command->done) return result_ok();
    }
    if (command->health.ask) return result_ok();
    if (argc - optind > 1)
        return result_fail(RESULT_USAGE, "more than one master: '%.100s'", argv[optind + 1]);
    address_t address;
    TRY(address_parse(optind < argc ? argv[optind] : "127.0.0.1", WIRE_DEFAULT_PORT, &address));
    command->endpoint = address_endpoint(&address, address.port);
    command->options.control_endpoint = command->endpoint;
    return dial_keys_find(&command->dial, address.host, &command->options.keys);
}

static result_t run(command_t *command)
{
    const char *called = command->options.name;
    char *name = called ? mem_printf("worker %s", called) : mem_printf("worker %d", (int)getpid());
    log_init(name, command->level);
    free(name);
    catch_signals();
    command->options.pulse = &command->pulse;
    health_t *health;
    TRY(health_start(command->health.path, pulse_report, &command->pulse, &health));
    result_t result = worker_run(&command->options, &stop_requested);
    health_stop(&health);
    return result;
}

int main(int argc, char **argv)
{
    command_t command;
    result_t result = parse_arguments(argc, argv, &command);
    if (result.code == RESULT_OK && !command.done)
        result = command.health.ask ? health_print(&command.health) : run(&command);
    if (result.code != RESULT_OK) fprintf(stderr, "lightmill-worker: %s\n", result.message);
    dial_keys_free(&command.options.keys);
    free(command.endpoint);
    return result_exit_code(result);
}
