/* lightmill-master: the command line around master.h. */
#include "common/address.h"
#include "common/memory_limit.h"
#include "common/notify/notify.h"
#include "common/options/service_options.h"
#include "master/farm/farm.h"
#include "master/master.h"
#include "proto/wire/wire.h"

#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

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

typedef struct {
    master_options_t master;
    service_options_t service;
    pulse_t pulse;
    const char *listen;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, listen, "listen", "HOST[:PORT]",
           "where to listen (default: 127.0.0.1:7420); the port after it is used too; port 0 chooses free "
           "ones"),
    OPTION(values_t, master.data_dir, "data", "DIR",
           "where jobs, films, scenes and images are kept; a master that is started with it again goes on "
           "where the last one ended (default: lightmill-data)"),
    OPTION(values_t, master.heartbeat, "heartbeat", "SECONDS",
           "how often workers say that they live (default: 1)", OPTION_RANGE(0, 1e6)),
    OPTION(values_t, master.lease, "lease", "SECONDS",
           "the silence after which a worker's share is given to others (default: 5)", OPTION_RANGE(0, 1e6)),
    OPTION(values_t, master.batch_interval, "batch-interval", "SECONDS",
           "how often workers send what they have (default: 10)", OPTION_RANGE(0, 1e6)),
    OPTION(values_t, master.checkpoint, "checkpoint", "SECONDS",
           "the least time between two checkpoints of a job (default: 10); it becomes longer where they "
           "would take more than 2% of the time. What a crash can cost is the work since the last",
           OPTION_RANGE(0, 1e6)),
    OPTION(values_t, master.checkpoint_max, "checkpoint-max", "SECONDS",
           "how much longer: the next checkpoint is on the disk before so much of a job's work is in none "
           "(default: 120, or --checkpoint where that is more), even if they then take more than 2% of the "
           "time, up to half of it",
           OPTION_RANGE(0, 1e6)),
    OPTION_BY(option_gigabytes, values_t, master.keep_bytes, "keep", "GB",
              "what the films of jobs that are over may take, so that these can be extended (default: 20); "
              "those of retained jobs stay in any case",
              OPTION_RANGE(0, 1e6)),
    OPTION_BY(
        option_gigabytes, values_t, master.evidence_bytes, "evidence", "GB",
        "what is kept of verified jobs, so that it can be taken out of them again, may take on the disk "
        "(default: 20); what does not fit stays in the image, and the job's message says so",
        OPTION_RANGE(0, 1e6)),
    OPTION_BY(option_gigabytes, values_t, master.blob_limit, "blob-limit", "GB",
              "what scenes may take (default: 100); the ones that no job needs go first",
              OPTION_RANGE(0, 1e6)),
    OPTION_BY(option_gigabytes, values_t, master.snapshot_limit, "snapshot-limit", "GB",
              "what the files of images may take while they are fetched (default: 20), without those that "
              "are kept; when they take all of it, further ones are refused",
              OPTION_RANGE(0.001, 1e6)),
    OPTION_BY(option_gigabytes, values_t, master.batch_memory, "batch-memory", "GB",
              "for batches that are under way or wait to be merged; workers wait to send more (default: an "
              "eighth of the memory, at least 1, or a quarter where that is less)",
              OPTION_RANGE(0, 1e6)),
    OPTION(values_t, master.merge_threads, "merge-threads", "N",
           "threads that merge batches (default: one for each core)", OPTION_RANGE(1, 64)),
    OPTION_BY(option_gigabytes, values_t, master.film_memory, "film-memory", "GB",
              "what the films of jobs at work may take in memory (default: three quarters of it); others "
              "wait, and a job whose film is larger is refused",
              OPTION_RANGE(0, 1e6)),
    OPTION(values_t, master.job_limit, "max-jobs", "N",
           "jobs known at a time (default: 1000); for a new one the oldest that is over and not retained "
           "goes, with its film and image",
           OPTION_RANGE(1, FARM_MAX_JOBS)),
    OPTION_BY(option_notify, values_t, master.notify, "notify", "URL|COMMAND",
              "tell of every job that is done, failed or cancelled, or waits for you: post JSON to a URL, or "
              "run a command with it as input and in LIGHTMILL_... variables; tried again for 10 minutes "
              "(default: $LIGHTMILL_NOTIFY; docs/notify.md)",
              .environment = "LIGHTMILL_NOTIFY"),
};
static const option_group_t master_group = OPTION_GROUP(NULL, rows);

static void begin(void *data)
{
    *(values_t *)data = (values_t){.master = master_options_default(), .listen = "127.0.0.1"};
}

/* Starts the master with the signals blocked, so that its threads never get them, and waits for one. */
static result_t serve(values_t *values)
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

    values->master.pulse = &values->pulse;
    health_t *health;
    master_t *master;
    TRY(health_start(values->service.health, pulse_report, &values->pulse, &health));
    result_t result = master_start(&values->master, &master);
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
    master_stop(&master);
    health_stop(&health);
    return result;
}

static result_t run(const call_t *call)
{
    values_t *values = call->values;
    if (values->service.ask_health) return service_ask_health(&values->service);
    char *control, *bulk;
    TRY(address_listen(values->listen, WIRE_DEFAULT_PORT, &control, &bulk));
    log_init("master", service_log_level(&values->service));
    values->master.control_endpoint = control;
    values->master.bulk_endpoint = bulk;
    file_limit_raise();
    result_t result = serve(values);
    free(control);
    free(bulk);
    return result;
}

static const command_t command = {
    .name = "lightmill-master",
    .summary = "take jobs, share them out to workers, put the images together",
    .about = "Takes jobs, shares them out to workers and puts the images together.",
    .groups = {{&master_group, 0},
               {&service_options, offsetof(values_t, service)},
               {&gate_options, offsetof(values_t, master.gate)},
               {&http_options, offsetof(values_t, master.http)}},
    .after = "SIGTERM or SIGINT ends it: last checkpoints are written first, no job is cancelled. A second "
             "one ends it at once.\n\n"
             "Exit codes: 0 success, 1 usage, 2 bad file, 3 input or output failed, 5 limit exceeded.",
    .size = sizeof(values_t),
    .begin = begin,
    .run = run};

int main(int argc, char **argv)
{
    umask(077); /* what it writes is for its own user alone: scenes, images, keys */
    return command_main(&command, argc, argv);
}
