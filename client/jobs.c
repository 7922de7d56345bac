/* jobs: the commands on jobs that a master already has: their image (fetch), and what is to be done with them
 * (cancel, pause, resume, retain, release, delete, priority, extend). */
#include "client/commands.h"
#include "client/master_option.h"
#include "client/options.h"
#include "client/output.h"
#include "client/progress.h"
#include "client/watch.h"

#include <ctype.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    master_option_t master;
    output_t output;
    job_order_t order; /* of extend */
    bool wait, quiet, help;
} command_t;

#define HELP_OPTION                                                                                          \
    {                                                                                                        \
        "help", no_argument, NULL, 0                                                                         \
    }
#define LAST_OPTION                                                                                          \
    {                                                                                                        \
        NULL, 0, NULL, 0                                                                                     \
    }
#define WAIT_OPTIONS                                                                                         \
    OUTPUT_OPTIONS, {"wait", no_argument, NULL, 0},                                                          \
    {                                                                                                        \
        "quiet", no_argument, NULL, 0                                                                        \
    }

static const struct option order_options[] = {MASTER_OPTIONS, HELP_OPTION, LAST_OPTION};
static const struct option fetch_options[] = {MASTER_OPTIONS, WAIT_OPTIONS, HELP_OPTION, LAST_OPTION};
static const struct option extend_options[] = {MASTER_OPTIONS,
                                               WAIT_OPTIONS,
                                               {"spp", required_argument, NULL, 0},
                                               {"error", required_argument, NULL, 0},
                                               {"time", required_argument, NULL, 0},
                                               HELP_OPTION,
                                               LAST_OPTION};

static result_t parse_goal(command_t *command, const char *option, const char *value, bool *taken)
{
    long long number;
    *taken = true;
    if (strcmp(option, "spp") == 0) {
        TRY(option_integer(option, value, 1, JOB_MAX_SPP, &number));
        command->order.spp = (uint32_t)number;
    } else if (strcmp(option, "error") == 0) {
        return option_error(value, &command->order.error);
    } else if (strcmp(option, "time") == 0) {
        return option_real(option, value, 0.1, 1e9, &command->order.time_limit);
    } else {
        *taken = false;
    }
    return result_ok();
}

static result_t parse_option(command_t *command, const char *option, const char *value)
{
    bool taken;
    TRY(master_option(&command->master, option, value, &taken));
    if (!taken) TRY(output_option(&command->output, option, value, &taken));
    if (!taken) TRY(parse_goal(command, option, value, &taken));
    command->wait |= strcmp(option, "wait") == 0;
    command->quiet |= strcmp(option, "quiet") == 0;
    command->help |= strcmp(option, "help") == 0;
    return result_ok();
}

/* The arguments that are no options are left from argv[optind] on. */
static result_t parse_options(int argc, char **argv, const struct option *options, command_t *command)
{
    *command = (command_t){.master = master_option_default()};
    int index = 0, found;
    while ((found = getopt_long(argc, argv, "o:", options, &index)) != -1) {
        if (found == '?') return result_fail(RESULT_USAGE, "see lightmill %s --help", argv[0]);
        TRY(parse_option(command, found == 'o' ? "output" : options[index].name, optarg));
        if (command->help) return result_ok();
    }
    log_init("lightmill", LOG_WARNING);
    return result_ok();
}

static result_t one_job(int argc, char **argv, uint64_t *job)
{
    if (argc - optind != 1)
        return result_fail(RESULT_USAGE, "%s takes one job's number; see lightmill status", argv[0]);
    return option_job(argv[optind], job);
}

/* ---- fetch -------------------------------------------------------------------------------------------- */

/* The image of a job as it is or, with --wait, as it is at the end. */
static result_t fetch(const command_t *command, remote_t *remote, uint64_t job)
{
    progress_t progress = progress_start(command->quiet || !command->wait);
    watch_t watch = {.remote = remote, .job = job, .progress = &progress, .patient = command->wait};
    if (!command->wait) {
        TRY(watch_poll(&watch));
        return watch_deliver(&watch, &command->output, command->quiet);
    }
    result_t result = watch_wait(&watch);
    progress_end(&progress);
    TRY(result);
    TRY(watch_deliver(&watch, &command->output, command->quiet));
    return watch_outcome(&watch);
}

result_t cmd_fetch(int argc, char **argv)
{
    command_t command;
    uint64_t job;
    TRY(parse_options(argc, argv, fetch_options, &command));
    if (command.help) {
        printf("usage: lightmill fetch JOB -o FILE [options]\n\nThe image of a job so far.\n\n"
               "  --wait             wait for the end of the job, and show its progress\n"
               "  --quiet            no progress\n%s%s%s",
               output_usage, master_usage, dial_usage);
        return result_ok();
    }
    TRY(one_job(argc, argv, &job));
    if (command.output.path == NULL) return result_fail(RESULT_USAGE, "fetch needs -o FILE");
    TRY(output_check(&command.output));
    remote_t *remote;
    TRY(master_connect(&command.master, &remote));
    result_t result = fetch(&command, remote, job);
    remote_close(&remote);
    return result;
}

/* ---- orders ------------------------------------------------------------------------------------------- */

typedef struct {
    const char *name;
    order_kind_t kind;
    const char *help;
} verb_t;

static const verb_t verbs[] = {
    {"cancel", ORDER_CANCEL,
     "Ends jobs. What their workers have finished is still counted, and the image so far is written.\n"
     "lightmill extend goes on with a job that was cancelled.\n"},
    {"pause", ORDER_PAUSE,
     "Hands out no more of the jobs until they are resumed. What their workers have finished is counted;\n"
     "time that they are paused does not count for --time.\n"},
    {"resume", ORDER_RESUME, "Goes on with jobs that were paused.\n"},
    {"retain", ORDER_RETAIN,
     "Keeps jobs until they are deleted: when the master needs room for new ones, it forgets the oldest of\n"
     "those that are over and not retained, with their films and images.\n"},
    {"release", ORDER_RELEASE, "Takes back lightmill retain.\n"},
    {"delete", ORDER_DELETE,
     "Removes jobs that are over (cancel them first), with their films and images on the master.\n"},
};

static const verb_t *find_verb(const char *name)
{
    size_t i = 0;
    while (strcmp(verbs[i].name, name) != 0) i++; /* main.c has found it */
    return &verbs[i];
}

result_t cmd_order(int argc, char **argv)
{
    command_t command;
    const verb_t *verb = find_verb(argv[0]);
    TRY(parse_options(argc, argv, order_options, &command));
    if (command.help) {
        printf("usage: lightmill %s JOB... [options]\n\n%s\n%s%s", verb->name, verb->help, master_usage,
               dial_usage);
        return result_ok();
    }
    job_order_t order = {.kind = verb->kind};
    if (argc == optind)
        return result_fail(RESULT_USAGE, "%s takes the numbers of jobs; see lightmill status", argv[0]);
    for (int i = optind; i < argc; i++) TRY(option_job(argv[i], &order.job));
    remote_t *remote;
    TRY(master_connect(&command.master, &remote));
    result_t first = result_ok();
    for (int i = optind; i < argc && first.code != RESULT_UNREACHABLE; i++) {
        option_job(argv[i], &order.job);
        result_t result = remote_order(remote, &order);
        if (result.code == RESULT_OK) continue;
        if (first.code == RESULT_OK)
            first = result;
        else
            log_error("%s", result.message);
    }
    remote_close(&remote);
    return first;
}

/* ---- priority ----------------------------------------------------------------------------------------- */

/* Takes the first word that is a negative number out of the arguments, where it would be an option; NULL when
 * there is none. */
static const char *take_negative(int *argc, char **argv)
{
    const char *number = NULL;
    for (int i = 1; i < *argc && number == NULL; i++) {
        if (argv[i][0] != '-' || !isdigit((unsigned char)argv[i][1])) continue;
        number = argv[i];
        memmove(&argv[i], &argv[i + 1], (size_t)(*argc - i) * sizeof *argv); /* with the NULL at the end */
        --*argc;
    }
    return number;
}

result_t cmd_priority(int argc, char **argv)
{
    command_t command;
    job_order_t order = {.kind = ORDER_PRIORITY};
    long long priority;
    const char *number = take_negative(&argc, argv);
    TRY(parse_options(argc, argv, order_options, &command));
    if (command.help) {
        printf("usage: lightmill priority JOB N [options]\n\n"
               "Jobs of a higher priority go first, jobs of the same one share the workers. New jobs have 0; "
               "N is\n"
               "from -%d to %d.\n\n%s%s",
               JOB_MAX_PRIORITY, JOB_MAX_PRIORITY, master_usage, dial_usage);
        return result_ok();
    }
    if (number == NULL && argc - optind == 2) number = argv[--argc];
    if (number == NULL || argc - optind != 1)
        return result_fail(RESULT_USAGE, "priority takes a job's number and its new priority");
    TRY(option_job(argv[optind], &order.job));
    TRY(option_integer("priority", number, -JOB_MAX_PRIORITY, JOB_MAX_PRIORITY, &priority));
    order.priority = (int32_t)priority;
    remote_t *remote;
    TRY(master_connect(&command.master, &remote));
    result_t result = remote_order(remote, &order);
    remote_close(&remote);
    return result;
}

/* ---- extend ------------------------------------------------------------------------------------------- */

static const char extend_usage[] =
    "usage: lightmill extend JOB [--spp N] [--error E] [--time SECONDS] [options]\n"
    "\n"
    "Goes on with a job: one that is over with the samples that it has, one that runs with other goals. A "
    "goal\n"
    "that was reached and is not set anew no longer ends the job; a job that was cancelled or has failed "
    "goes on\n"
    "to its old goals if none is given. The image is the one that a job with these goals from the start "
    "would\n"
    "have made, bit by bit, if it goes by --spp.\n"
    "\n"
    "  --spp N            samples a pixel in all\n"
    "  --error E          until the estimated relative error is at most E (0.01 or 1%)\n"
    "  --time SECONDS     for so long from now\n"
    "  --wait             wait for the end of the job, and fetch its image (needs -o)\n"
    "  --quiet            no progress\n";

result_t cmd_extend(int argc, char **argv)
{
    command_t command;
    TRY(parse_options(argc, argv, extend_options, &command));
    if (command.help) {
        printf("%s%s%s%s", extend_usage, output_usage, master_usage, dial_usage);
        return result_ok();
    }
    command.order.kind = ORDER_EXTEND;
    TRY(one_job(argc, argv, &command.order.job));
    if (command.wait != (command.output.path != NULL) || (command.output.png && !command.wait))
        return result_fail(RESULT_USAGE, "--wait and -o FILE belong together; fetch gets an image later");
    if (command.wait) TRY(output_check(&command.output));
    remote_t *remote;
    TRY(master_connect(&command.master, &remote));
    result_t result = remote_order(remote, &command.order);
    if (result.code == RESULT_OK && command.wait) result = fetch(&command, remote, command.order.job);
    remote_close(&remote);
    return result;
}
