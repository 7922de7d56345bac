/* lightmill-master: the command line around master.h. */
#include "common/address.h"
#include "common/memory_limit.h"
#include "master/farm/farm.h"
#include "master/master.h"
#include "proto/wire/wire.h"

#include <getopt.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const char HELP[] =
    "lightmill-master: takes jobs, shares them out to workers and puts the image together\n"
    "\n"
    "usage: lightmill-master [options]\n"
    "\n"
    "  --listen HOST[:PORT]   where to listen (127.0.0.1:7420); the port after it is used too;\n"
    "                         port 0 chooses free ones\n"
    "  --data DIR             where jobs, films, scenes and images are kept; a master that is started with "
    "it\n"
    "                         again goes on where the last one ended (lightmill-data)\n"
    "  --heartbeat SECONDS    how often workers say that they live (1)\n"
    "  --lease SECONDS        the silence after which a worker's share is given to others (5)\n"
    "  --batch-interval SECONDS  how often workers send what they have (10)\n"
    "  --checkpoint SECONDS   the least time between two checkpoints of a job (10); it becomes longer where "
    "they\n"
    "                         would take more than 2% of the time. What a crash can cost is the work since "
    "the last\n"
    "  --keep GB              what the films of jobs that are over may take, so that these can be extended "
    "(20);\n"
    "                         those of retained jobs stay in any case\n"
    "  --blob-limit GB        what scenes may take (100); the ones that no job needs go first\n"
    "  --batch-memory GB      for batches that are under way or wait to be merged; workers wait to send more "
    "(an\n"
    "                         eighth of the memory, at least 1, or a quarter where that is less)\n"
    "  --merge-threads N      that merge batches (one for each core)\n"
    "  --film-memory GB       what the films of jobs at work may take in memory (three quarters of it); "
    "others\n"
    "                         wait, and a job whose film is larger is refused\n"
    "  --max-jobs N           jobs known at a time (1000); for a new one the oldest that is over and not\n"
    "                         retained goes, with its film and image\n"
    "  --quiet                log warnings and errors only\n"
    "  --verbose              log every batch\n"
    "  --help, --version\n";
static const char HELP_END[] =
    "\n"
    "SIGTERM or SIGINT ends it: last checkpoints are written first, no job is cancelled. A second one ends "
    "it at "
    "once.\n"
    "Exit codes: 0 success, 1 usage, 2 bad file, 3 input or output failed, 5 limit exceeded.\n";

/* How many signals asked us to end, and whether one asked us to read our files again. The variables that are
 * not constant: a signal handler has no argument. */
static volatile sig_atomic_t signals, hang_up;

static void on_signal(int number)
{
    if (++signals > 1) _exit(128 + number);
}

static void on_hang_up(int number)
{
    (void)number;
    hang_up = 1;
}

enum { MAX_THREADS = 64 }; /* that merge */

typedef struct {
    master_options_t master;
    health_options_t health;
    pulse_t pulse;
    address_t address;
    bool any_port;
    log_level_t log;
} command_t;

static result_t parse_seconds(const char *name, const char *text, double *value)
{
    char *end;
    *value = strtod(text, &end);
    if (end != text && *end == '\0') return result_ok();
    return result_fail(RESULT_USAGE, "--%s takes a number of seconds, not \"%s\"", name, text);
}

static result_t parse_gigabytes(const char *name, const char *text, uint64_t *bytes)
{
    char *end;
    double value = strtod(text, &end);
    if (end == text || *end != '\0' || !(value >= 0 && value <= 1e6))
        return result_fail(RESULT_USAGE, "--%s takes a number of gigabytes from 0 to 1e6, not \"%s\"", name,
                           text);
    *bytes = (uint64_t)(1e9 * value);
    return result_ok();
}

static result_t parse_count(const char *name, const char *text, long most, long *value)
{
    char *end;
    *value = strtol(text, &end, 10);
    if (end != text && *end == '\0' && *value >= 1 && *value <= most) return result_ok();
    return result_fail(RESULT_USAGE, "--%s takes a whole number from 1 to %ld, not \"%s\"", name, most, text);
}

/* "HOST:0" asks for free ports, which an address cannot say. */
static result_t parse_listen(const char *text, command_t *command)
{
    size_t length = strlen(text);
    command->any_port = length > 2 && strcmp(text + length - 2, ":0") == 0;
    if (!command->any_port) {
        TRY(address_parse(text, WIRE_DEFAULT_PORT, &command->address));
        if (command->address.port < 65535) return result_ok();
        return result_fail(RESULT_USAGE, "port 65535 leaves none for the bulk socket");
    }
    char *host = mem_strdup(text);
    host[length - 2] = '\0';
    result_t result = address_parse(host, WIRE_DEFAULT_PORT, &command->address);
    free(host);
    return result;
}

static result_t set_option(command_t *command, const char *name, const char *value)
{
    if (gate_option(&command->master.gate, name, value)) return result_ok();
    if (health_option(&command->health, name, value)) return result_ok();
    if (strcmp(name, "listen") == 0) return parse_listen(value, command);
    if (strcmp(name, "heartbeat") == 0) return parse_seconds(name, value, &command->master.heartbeat);
    if (strcmp(name, "lease") == 0) return parse_seconds(name, value, &command->master.lease);
    if (strcmp(name, "batch-interval") == 0)
        return parse_seconds(name, value, &command->master.batch_interval);
    if (strcmp(name, "checkpoint") == 0) return parse_seconds(name, value, &command->master.checkpoint);
    if (strcmp(name, "keep") == 0) return parse_gigabytes(name, value, &command->master.keep_bytes);
    if (strcmp(name, "blob-limit") == 0) return parse_gigabytes(name, value, &command->master.blob_limit);
    if (strcmp(name, "batch-memory") == 0) return parse_gigabytes(name, value, &command->master.batch_memory);
    if (strcmp(name, "film-memory") == 0) return parse_gigabytes(name, value, &command->master.film_memory);
    long count;
    if (strcmp(name, "max-jobs") == 0) {
        TRY(parse_count(name, value, FARM_MAX_JOBS, &count));
        command->master.job_limit = (size_t)count;
    }
    if (strcmp(name, "merge-threads") == 0) {
        TRY(parse_count(name, value, MAX_THREADS, &count));
        command->master.merge_threads = (int)count;
    }
    if (strcmp(name, "data") == 0) command->master.data_dir = value;
    if (strcmp(name, "quiet") == 0) command->log = LOG_WARNING;
    if (strcmp(name, "verbose") == 0) command->log = LOG_DEBUG;
    return result_ok();
}

/* *done is set when there is nothing more to do (--help, --version). */
static result_t parse_command(int argc, char **argv, command_t *command, bool *done)
{
    static const struct option options[] = {{"listen", required_argument, NULL, 0},
                                            {"data", required_argument, NULL, 0},
                                            {"heartbeat", required_argument, NULL, 0},
                                            {"lease", required_argument, NULL, 0},
                                            {"batch-interval", required_argument, NULL, 0},
                                            {"checkpoint", required_argument, NULL, 0},
                                            {"keep", required_argument, NULL, 0},
                                            {"batch-memory", required_argument, NULL, 0},
                                            {"film-memory", required_argument, NULL, 0},
                                            {"max-jobs", required_argument, NULL, 0},
                                            {"merge-threads", required_argument, NULL, 0},
                                            {"blob-limit", required_argument, NULL, 0},
                                            GATE_OPTIONS,
                                            HEALTH_OPTIONS,
                                            {"quiet", no_argument, NULL, 0},
                                            {"verbose", no_argument, NULL, 0},
                                            {"help", no_argument, NULL, 'h'},
                                            {"version", no_argument, NULL, 'v'},
                                            {NULL, 0, NULL, 0}};
    int index, choice;
    while ((choice = getopt_long(argc, argv, "h", options, &index)) != -1) {
        if (choice == '?') return result_fail(RESULT_USAGE, "see lightmill-master --help");
        *done = choice == 'h' || choice == 'v';
        if (choice == 'h') printf("%s%s%s%s", HELP, health_usage, gate_usage, HELP_END);
        if (choice == 'v') puts("lightmill-master " LIGHTMILL_VERSION);
        if (*done) return result_ok();
        TRY(set_option(command, options[index].name, optarg));
    }
    if (optind < argc)
        return result_fail(RESULT_USAGE, "\"%s\" is not an option; see lightmill-master --help",
                           argv[optind]);
    return result_ok();
}

/* Starts the master with the signals blocked, so that its threads never get them, and waits for one. */
static result_t serve(command_t *command)
{
    sigset_t ending, before;
    sigemptyset(&ending);
    sigaddset(&ending, SIGINT);
    sigaddset(&ending, SIGTERM);
    sigaddset(&ending, SIGHUP);
    pthread_sigmask(SIG_BLOCK, &ending, &before);
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    action.sa_handler = on_hang_up;
    sigaction(SIGHUP, &action, NULL);
    signal(SIGPIPE, SIG_IGN);

    command->master.pulse = &command->pulse;
    health_t *health;
    master_t *master;
    TRY(health_start(command->health.path, pulse_report, &command->pulse, &health));
    result_t result = master_start(&command->master, &master);
    if (result.code != RESULT_OK) {
        health_stop(&health);
        return result;
    }
    while (signals == 0) {
        sigsuspend(&before);
        if (!hang_up) continue;
        hang_up = 0;
        master_reload(master);
    }
    log_info("ending; once more to end at once");
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    result = master_stop(&master);
    health_stop(&health);
    return result;
}

static result_t run(int argc, char **argv)
{
    command_t command = {
        .master = master_options_default(), .health = health_options_default(), .log = LOG_INFO};
    bool done = false;
    TRY(address_parse("127.0.0.1", WIRE_DEFAULT_PORT, &command.address));
    TRY(parse_command(argc, argv, &command, &done));
    if (done) return result_ok();
    if (command.health.ask) return health_print(&command.health);
    log_init("master", command.log);
    char *control, *bulk;
    if (command.any_port) {
        control = mem_printf("tcp://%s:*", command.address.host);
        bulk = mem_strdup(control);
    } else {
        control = address_endpoint(&command.address, command.address.port);
        bulk = address_endpoint(&command.address, command.address.port + 1);
    }
    command.master.control_endpoint = control;
    command.master.bulk_endpoint = bulk;
    file_limit_raise();
    result_t result = serve(&command);
    free(control);
    free(bulk);
    return result;
}

int main(int argc, char **argv)
{
    result_t result = run(argc, argv);
    if (result.code != RESULT_OK) fprintf(stderr, "lightmill-master: %s\n", result.message);
    return result_exit_code(result);
}
