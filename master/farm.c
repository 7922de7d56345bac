/* farm: see farm.h.
 *
 * DESIGN. The life of a job:
 *
 *     queued --first assignment--> running --all counted--------------------> finishing --image written-->
 * done |                            |---cancel, time is up: flush--> finishing --> ...          cancelled or
 * done
 *        '--cancel--> cancelled       '---overflow--> failed
 *
 * The film is made at the first assignment, not at submission, so that a long queue costs nothing, and freed
 * when the image is written. While a job that was cut short is finishing, its workers are asked for what they
 * have (JobOver with flush), and batches are still taken until each has answered or a grace period is over.
 *
 * Jobs are handed out in the order of submission; a later one starts when the earlier has no free samples.
 * When samples come back (a worker was lost), they go out before those of later jobs.
 *
 * A lost worker's record is kept for a while: a batch from it whose units nobody else has delivered meanwhile
 * is still welcome. Worker numbers are random, so a batch of an earlier life of this master matches none.
 *
 * Jobs live in an array of pointers in the order of submission; a job that a server or the image writer works
 * on is pinned and cannot be forgotten meanwhile. */
#include "master/farm.h"

#include "master/schedule.h"

#include <math.h>
#include <pthread.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum {
    RATE_WINDOW = 60,  /* seconds over which the speed for `remaining` is measured */
    CLOCK_GAP = 2,     /* seconds between ticks after which we, not the workers, were asleep */
    MAX_THREADS = 4096 /* of one worker, for sharing out */
};
#define COUNT_LIMIT ((uint64_t)1 << 60) /* of any one count in a batch */

typedef struct {
    uint64_t id;
    char name[FARM_MAX_NAME + 1];
    identity_t identity;
    uint32_t threads;
    bool connected;
    bool idle;        /* was told that there is no work */
    double last_seen; /* seconds */
    uint64_t job;     /* that it has loaded or was assigned last */
    uint64_t batches, batches_refused, units_reissued, bytes;
} worker_t;

struct job {
    uint64_t id;
    char name[FARM_MAX_NAME + 1];
    job_settings_t settings;
    hash_t blob;
    uint64_t blob_size;
    job_state_t state;
    job_state_t outcome;   /* the state after finishing */
    bool taking;           /* batches are taken */
    bool image_due;        /* the image writer has to see to it */
    double started, ended; /* seconds; 0: not yet */
    double flush_until;    /* seconds, while a flush goes on */
    schedule_t *schedule;  /* NULL before the first assignment and when the job is over */
    pthread_mutex_t film_lock;
    film_t *film;
    film_counts_t counts; /* of the film, readable under the farm's lock */
    uint64_t samples_done;
    uint64_t *seen; /* workers that contributed */
    size_t seen_count;
    uint64_t bytes, batches, batches_refused, units_reissued;
    double rate_time[2]; /* two earlier points of the progress, for the speed */
    uint64_t rate_samples[2];
    char message[500];
    int pins;
};

/* A notice by worker number. */
typedef struct {
    uint64_t worker, job;
    bool flush;
} pending_t;

struct farm {
    farm_options_t options;
    pthread_mutex_t lock;
    job_t **jobs;
    size_t job_count;
    uint64_t next_job;
    uint64_t film_bytes; /* of all films */
    worker_t *workers;
    size_t worker_count;
    pending_t *notices;
    size_t notice_count, notice_capacity;
    double last_tick;
};

static void wake(int descriptor)
{
    uint64_t one = 1;
    if (descriptor >= 0 && write(descriptor, &one, sizeof one) < 0) return; /* full: it is awake already */
}

static void lock(farm_t *farm)
{
    pthread_mutex_lock(&farm->lock);
}

static void unlock(farm_t *farm)
{
    pthread_mutex_unlock(&farm->lock);
}

farm_t *farm_new(const farm_options_t *options)
{
    farm_t *farm = mem_zalloc(1, sizeof *farm);
    farm->options = *options;
    farm->next_job = options->first_job;
    pthread_mutex_init(&farm->lock, NULL);
    return farm;
}

/* What the film of a job takes, and resolving it. */
static uint64_t film_bytes(const job_settings_t *settings)
{
    uint64_t pixels = (uint64_t)settings->width * (uint64_t)settings->height;
    return pixels * (2 * 2 * 3 * sizeof(int64_t) + 2 * sizeof(uint32_t) + 13 * sizeof(float));
}

static void job_free_film(farm_t *farm, job_t *job)
{
    if (job->film != NULL) farm->film_bytes -= film_bytes(&job->settings);
    film_destroy(&job->film);
}

static void job_free(farm_t *farm, job_t *job)
{
    job_free_film(farm, job);
    schedule_destroy(&job->schedule);
    pthread_mutex_destroy(&job->film_lock);
    free(job->seen);
    free(job);
}

void farm_destroy(farm_t **farm)
{
    if (*farm == NULL) return;
    for (size_t i = 0; i < (*farm)->job_count; i++) job_free(*farm, (*farm)->jobs[i]);
    pthread_mutex_destroy(&(*farm)->lock);
    free((*farm)->jobs);
    free((*farm)->workers);
    free((*farm)->notices);
    free(*farm);
    *farm = NULL;
}

/* ---- finding things; all under the lock ---------------------------------------------------------------- */

static job_t *find_job(const farm_t *farm, uint64_t id)
{
    for (size_t i = 0; i < farm->job_count; i++)
        if (farm->jobs[i]->id == id) return farm->jobs[i];
    return NULL;
}

static worker_t *find_worker(const farm_t *farm, uint64_t id)
{
    for (size_t i = 0; i < farm->worker_count; i++)
        if (farm->workers[i].id == id) return &farm->workers[i];
    return NULL;
}

/* A connected worker, which is hereby heard of. */
static worker_t *hear_worker(farm_t *farm, double now, const identity_t *identity, uint64_t id)
{
    worker_t *worker = find_worker(farm, id);
    if (worker == NULL || !worker->connected) return NULL;
    worker->last_seen = now;
    worker->identity = *identity;
    return worker;
}

static bool has_work(const job_t *job)
{
    return job->state == JOB_QUEUED || (job->state == JOB_RUNNING && schedule_available(job->schedule));
}

/* ---- notices ------------------------------------------------------------------------------------------- */

static void notify(farm_t *farm, uint64_t worker, uint64_t job, bool flush)
{
    if (farm->notice_count == farm->notice_capacity) {
        farm->notice_capacity = 2 * farm->notice_capacity + 16;
        farm->notices = mem_realloc(farm->notices, farm->notice_capacity * sizeof *farm->notices);
    }
    farm->notices[farm->notice_count++] = (pending_t){worker, job, flush};
    wake(farm->options.control_wake);
}

/* Calls the idle workers when there is something to do. */
static void notify_idle(farm_t *farm)
{
    bool work = false;
    for (size_t i = 0; i < farm->job_count && !work; i++) work = has_work(farm->jobs[i]);
    for (size_t i = 0; work && i < farm->worker_count; i++) {
        worker_t *worker = &farm->workers[i];
        if (!worker->connected || !worker->idle) continue;
        worker->idle = false;
        notify(farm, worker->id, 0, false);
    }
}

/* Tells the workers that have a job that it is over. */
static void notify_over(farm_t *farm, const job_t *job, bool flush)
{
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        if (!worker->connected) continue;
        if (worker->job == job->id || (job->schedule != NULL && schedule_held(job->schedule, worker->id) > 0))
            notify(farm, worker->id, job->id, flush);
    }
}

bool farm_next_notice(farm_t *farm, notice_t *notice)
{
    bool found = false;
    lock(farm);
    while (!found && farm->notice_count > 0) {
        pending_t pending = farm->notices[0];
        memmove(farm->notices, farm->notices + 1, --farm->notice_count * sizeof *farm->notices);
        const worker_t *worker = find_worker(farm, pending.worker);
        found = worker != NULL && worker->connected;
        if (found) *notice = (notice_t){worker->identity, pending.job, pending.flush};
    }
    unlock(farm);
    return found;
}

/* ---- the life of a job; all under the lock ------------------------------------------------------------- */

/* The last batch is in: nothing more is taken, the image writer has the next word. */
static void job_close(farm_t *farm, double now, job_t *job, job_state_t outcome)
{
    job->taking = false;
    job->flush_until = 0;
    job->ended = now;
    job->outcome = outcome;
    job->state = outcome == JOB_FAILED ? JOB_FAILED : JOB_FINISHING;
    job->image_due = true;
    notify_over(farm, job, false);
    schedule_destroy(&job->schedule);
    wake(farm->options.image_wake);
    notify_idle(farm);
}

/* A job ends before all is counted: what workers have finished is asked for. */
static void job_cut_short(farm_t *farm, double now, job_t *job, job_state_t outcome)
{
    if (schedule_holders(job->schedule) == 0) {
        job_close(farm, now, job, outcome);
        return;
    }
    job->state = JOB_FINISHING;
    job->outcome = outcome;
    job->flush_until = now + fmax(farm->options.lease, farm->options.batch_interval);
    notify_over(farm, job, true);
    notify_idle(farm); /* later jobs may start */
}

/* A worker has nothing (more) to send for a job that is being flushed. */
static void job_flushed(farm_t *farm, double now, job_t *job, uint64_t worker)
{
    schedule_release(job->schedule, worker);
    if (schedule_holders(job->schedule) == 0) job_close(farm, now, job, job->outcome);
}

/* Makes film and schedule; false when it has to wait for memory. A job that can never start fails. */
static bool job_start(farm_t *farm, double now, job_t *job)
{
    uint64_t bytes = film_bytes(&job->settings);
    if (farm->film_bytes + bytes > farm->options.film_limit) return false;
    result_t result = film_new(&job->settings, &job->film);
    if (result.code != RESULT_OK) {
        snprintf(job->message, sizeof job->message, "%s", result.message);
        log_error("job %llu: %s", (unsigned long long)job->id, result.message);
        job_close(farm, now, job, JOB_FAILED);
        return false;
    }
    farm->film_bytes += bytes;
    job->schedule = schedule_new(&job->settings);
    job->state = JOB_RUNNING;
    job->taking = true;
    job->started = job->rate_time[0] = job->rate_time[1] = now;
    log_info("job %llu starts: %s, %d x %d, %s", (unsigned long long)job->id, job->name, job->settings.width,
             job->settings.height, integrator_name(job->settings.integrator));
    return true;
}

static void count_reissued(job_t *job, worker_t *worker, size_t units)
{
    job->units_reissued += units;
    if (worker != NULL) worker->units_reissued += units;
}

/* Takes back what a worker holds, of all jobs; returns the number of units. */
static size_t take_back(farm_t *farm, double now, worker_t *worker)
{
    size_t total = 0;
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (job->schedule == NULL || schedule_held(job->schedule, worker->id) == 0) continue;
        if (job->flush_until > 0) {
            job_flushed(farm, now, job, worker->id);
            continue;
        }
        size_t units = schedule_release(job->schedule, worker->id);
        count_reissued(job, worker, units);
        total += units;
    }
    return total;
}

static void worker_disconnect(farm_t *farm, double now, worker_t *worker, const char *why)
{
    size_t units = take_back(farm, now, worker);
    worker->connected = false;
    worker->last_seen = now;
    log_info("worker %s %s; %zu units go back; it sent %llu batches (%llu refused), %.1f MB", worker->name,
             why, units, (unsigned long long)worker->batches, (unsigned long long)worker->batches_refused,
             1e-6 * (double)worker->bytes);
    notify_idle(farm);
}

/* ---- workers ------------------------------------------------------------------------------------------- */

/* Room for one more worker: the lost one that was heard of longest ago is forgotten. NULL when too many are
 * connected. */
static worker_t *worker_add(farm_t *farm)
{
    size_t connected = 0, oldest = SIZE_MAX;
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        connected += worker->connected;
        if (worker->connected) continue;
        if (oldest == SIZE_MAX || worker->last_seen < farm->workers[oldest].last_seen) oldest = i;
    }
    if (connected >= FARM_MAX_WORKERS) return NULL;
    if (farm->worker_count - connected >= FARM_MAX_WORKERS) return &farm->workers[oldest];
    farm->workers = mem_realloc(farm->workers, (farm->worker_count + 1) * sizeof *farm->workers);
    return &farm->workers[farm->worker_count++];
}

result_t farm_hello(farm_t *farm, double now, const identity_t *identity, const char *name, uint32_t threads,
                    uint64_t *id)
{
    lock(farm);
    worker_t *worker = worker_add(farm);
    if (worker == NULL) {
        unlock(farm);
        return result_fail(RESULT_LIMIT, "this master has %d workers already", FARM_MAX_WORKERS);
    }
    *worker = (worker_t){.identity = *identity,
                         .threads = threads < 1             ? 1
                                    : threads > MAX_THREADS ? MAX_THREADS
                                                            : threads,
                         .connected = true,
                         .last_seen = now};
    snprintf(worker->name, sizeof worker->name, "%s", name[0] != '\0' ? name : "(no name)");
    while (worker->id == 0) randombytes_buf(&worker->id, sizeof worker->id);
    *id = worker->id;
    log_info("worker %s joins with %u threads", worker->name, worker->threads);
    unlock(farm);
    return result_ok();
}

bool farm_heartbeat(farm_t *farm, double now, const identity_t *identity, uint64_t id, uint64_t job,
                    uint32_t units_held)
{
    lock(farm);
    worker_t *worker = hear_worker(farm, now, identity, id);
    if (worker != NULL) {
        worker->job = job;
        for (size_t i = 0; units_held == 0 && i < farm->job_count; i++)
            if (farm->jobs[i]->flush_until > 0) job_flushed(farm, now, farm->jobs[i], id);
    }
    unlock(farm);
    return worker != NULL;
}

void farm_goodbye(farm_t *farm, uint64_t id, const char *reason)
{
    lock(farm);
    worker_t *worker = find_worker(farm, id);
    char why[FARM_MAX_NAME];
    snprintf(why, sizeof why, "leaves%s%s", reason[0] != '\0' ? ": " : "", reason);
    if (worker != NULL && worker->connected) worker_disconnect(farm, worker->last_seen, worker, why);
    unlock(farm);
}

/* The threads of all connected workers. */
static uint32_t farm_threads(const farm_t *farm)
{
    uint32_t threads = 0;
    for (size_t i = 0; i < farm->worker_count; i++)
        if (farm->workers[i].connected) threads += farm->workers[i].threads;
    return threads;
}

/* Issues units of one job, if it has any for this worker. */
static size_t take_from_job(farm_t *farm, double now, job_t *job, const schedule_wish_t *wish,
                            farm_work_t *work)
{
    if (!has_work(job)) return 0;
    if (job->state == JOB_QUEUED && !job_start(farm, now, job)) return 0;
    work->unit_count = schedule_take(job->schedule, wish, work->units, WIRE_MAX_UNITS);
    work->job = job->id;
    work->settings = job->settings;
    work->blob = job->blob;
    work->blob_size = job->blob_size;
    return work->unit_count;
}

result_t farm_take(farm_t *farm, double now, const identity_t *identity, uint64_t id, uint64_t loaded_job,
                   uint64_t samples, uint64_t unit_samples, farm_work_t *work)
{
    lock(farm);
    worker_t *worker = hear_worker(farm, now, identity, id);
    if (worker == NULL) {
        unlock(farm);
        return result_fail(RESULT_UNREACHABLE, "this master does not know the worker: say hello again");
    }
    schedule_wish_t wish = {.worker = id,
                            .samples = samples,
                            .unit_samples = unit_samples,
                            .threads = worker->threads,
                            .farm_threads = farm_threads(farm)};
    work->unit_count = 0;
    for (size_t i = 0; i < farm->job_count && work->unit_count == 0; i++)
        take_from_job(farm, now, farm->jobs[i], &wish, work);
    if (work->unit_count == 0) work->job = 0;
    worker->idle = work->unit_count == 0;
    worker->job = work->unit_count > 0 ? work->job : loaded_job;
    unlock(farm);
    return result_ok();
}

static bool time_is_up(const job_t *job, double now)
{
    return job->state == JOB_RUNNING && job->settings.time_limit > 0 &&
           now - job->started >= job->settings.time_limit;
}

void farm_tick(farm_t *farm, double now)
{
    lock(farm);
    /* If this process was stopped, or the machine asleep, the silence was ours. */
    double gap = farm->last_tick > 0 ? now - farm->last_tick : 0;
    farm->last_tick = now;
    for (size_t i = 0; i < farm->worker_count; i++) {
        worker_t *worker = &farm->workers[i];
        if (!worker->connected) continue;
        if (gap > CLOCK_GAP) worker->last_seen = fmin(now, worker->last_seen + gap);
        if (now - worker->last_seen <= farm->options.lease) continue;
        char why[FARM_MAX_NAME];
        snprintf(why, sizeof why, "was silent for %.1f s and is given up", now - worker->last_seen);
        worker_disconnect(farm, now, worker, why);
    }
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (time_is_up(job, now)) job_cut_short(farm, now, job, JOB_DONE);
        if (job->flush_until > 0 && now >= job->flush_until) job_close(farm, now, job, job->outcome);
    }
    unlock(farm);
}

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* Makes room in the list of jobs; false when none can be forgotten. */
static bool forget_oldest(farm_t *farm)
{
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (!job_state_final(job->state) || job->image_due || job->pins > 0) continue;
        job_free(farm, job);
        memmove(farm->jobs + i, farm->jobs + i + 1, (--farm->job_count - i) * sizeof *farm->jobs);
        return true;
    }
    return false;
}

result_t farm_submit(farm_t *farm, double now, const char *name, const job_settings_t *settings,
                     const hash_t *blob, uint64_t blob_size, uint64_t *id)
{
    (void)now;
    if (film_bytes(settings) > farm->options.film_limit)
        return result_fail(RESULT_LIMIT,
                           "a film of %d x %d pixels takes %.1f GB, this master has room for %.1f GB",
                           settings->width, settings->height, 1e-9 * (double)film_bytes(settings),
                           1e-9 * (double)farm->options.film_limit);
    lock(farm);
    if (farm->job_count == FARM_MAX_JOBS && !forget_oldest(farm)) {
        unlock(farm);
        return result_fail(RESULT_LIMIT, "the queue is full: %d jobs wait", FARM_MAX_JOBS);
    }
    job_t *job = mem_zalloc(1, sizeof *job);
    job->id = farm->next_job++;
    job->settings = *settings;
    job->blob = *blob;
    job->blob_size = blob_size;
    job->state = JOB_QUEUED;
    snprintf(job->name, sizeof job->name, "%s", name);
    pthread_mutex_init(&job->film_lock, NULL);
    farm->jobs = mem_realloc(farm->jobs, (farm->job_count + 1) * sizeof(job_t *));
    farm->jobs[farm->job_count++] = job;
    *id = job->id;
    log_info("job %llu is submitted: %s", (unsigned long long)job->id, job->name);
    notify_idle(farm);
    unlock(farm);
    return result_ok();
}

static result_t cancel(farm_t *farm, double now, job_t *job, uint64_t id)
{
    if (job == NULL) return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)id);
    if (job_state_final(job->state))
        return result_fail(RESULT_INPUT, "job %llu is already %s", (unsigned long long)id,
                           job_state_name((uint32_t)job->state));
    log_info("job %llu is cancelled", (unsigned long long)id);
    if (job->state == JOB_QUEUED)
        job->state = JOB_CANCELLED;
    else if (job->state == JOB_RUNNING)
        job_cut_short(farm, now, job, JOB_CANCELLED);
    return result_ok(); /* one that is finishing is left to finish */
}

result_t farm_cancel(farm_t *farm, double now, uint64_t id)
{
    lock(farm);
    result_t result = cancel(farm, now, find_job(farm, id), id);
    unlock(farm);
    return result;
}

/* Seconds until the job is done at the speed of the last minute or two; < 0 when not known. */
static double remaining_time(const job_t *job, double now)
{
    if (job->state == JOB_FINISHING || job_state_final(job->state)) return 0;
    if (job->state != JOB_RUNNING) return -1;
    double remaining = -1;
    if (job->settings.time_limit > 0) remaining = fmax(0, job->started + job->settings.time_limit - now);
    double seconds = now - job->rate_time[0];
    double samples = (double)(job->samples_done - job->rate_samples[0]);
    if (job->settings.spp >= JOB_MAX_SPP || samples <= 0 || seconds <= 0) return remaining;
    double left = (double)(schedule_total(job->schedule) - job->samples_done) / (samples / seconds);
    return remaining < 0 ? left : fmin(left, remaining);
}

static job_report_t report_job(const job_t *job, double now)
{
    uint64_t pixels = (uint64_t)job->settings.width * (uint64_t)job->settings.height;
    job_report_t report = {.job = job->id,
                           .state = job->state,
                           .settings = job->settings,
                           .blob = job->blob,
                           .samples_done = job->samples_done,
                           .samples_total = job->settings.spp < JOB_MAX_SPP ? pixels * job->settings.spp : 0,
                           .elapsed =
                               job->started > 0 ? (job->ended > 0 ? job->ended : now) - job->started : 0,
                           .remaining = remaining_time(job, now),
                           .workers = job->schedule != NULL ? (uint32_t)schedule_holders(job->schedule) : 0,
                           .workers_seen = (uint32_t)job->seen_count,
                           .bytes_received = job->bytes,
                           .batches = job->batches,
                           .batches_refused = job->batches_refused,
                           .units_reissued = job->units_reissued,
                           .counts = job->counts};
    memcpy(report.name, job->name, sizeof report.name);
    memcpy(report.message, job->message, sizeof report.message);
    return report;
}

job_report_t *farm_report(farm_t *farm, double now, uint64_t id, size_t *count, uint32_t *workers)
{
    lock(farm);
    job_report_t *reports = farm->job_count > 0 ? mem_alloc(farm->job_count * sizeof *reports) : NULL;
    *count = 0;
    for (size_t i = 0; i < farm->job_count; i++)
        if (id == 0 || farm->jobs[i]->id == id) reports[(*count)++] = report_job(farm->jobs[i], now);
    *workers = 0;
    for (size_t i = 0; i < farm->worker_count; i++) *workers += farm->workers[i].connected;
    unlock(farm);
    if (*count > 0) return reports;
    free(reports);
    return NULL;
}

/* ---- batches ------------------------------------------------------------------------------------------- */

const job_settings_t *farm_job_settings(const job_t *job)
{
    return &job->settings;
}

uint64_t farm_job_id(const job_t *job)
{
    return job->id;
}

void farm_unpin(farm_t *farm, job_t *job)
{
    lock(farm);
    job->pins--;
    unlock(farm);
}

static result_t batch_open(worker_t *worker, job_t *job, uint64_t id, uint64_t bytes)
{
    if (worker == NULL) return result_fail(RESULT_UNREACHABLE, "this master does not know the worker");
    worker->bytes += bytes;
    if (job == NULL) return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)id);
    job->bytes += bytes;
    if (!job->taking) {
        job->batches_refused++;
        worker->batches_refused++;
        return result_fail(RESULT_CANCELLED, "job %llu is %s", (unsigned long long)id,
                           job->state == JOB_QUEUED ? "not started" : "over");
    }
    return result_ok();
}

result_t farm_batch_open(farm_t *farm, double now, uint64_t worker_id, uint64_t id, uint64_t bytes,
                         job_t **pinned)
{
    lock(farm);
    worker_t *worker = find_worker(farm, worker_id);
    job_t *job = find_job(farm, id);
    result_t result = batch_open(worker, job, id, bytes);
    if (result.code == RESULT_OK) {
        job->pins++;
        *pinned = job;
        worker->last_seen = fmax(worker->last_seen, now);
    }
    unlock(farm);
    return result;
}

/* No sender may claim more than its units can hold. */
static result_t check_counts(const batch_t *batch)
{
    uint64_t samples[2] = {0, 0};
    for (size_t i = 0; i < batch->unit_count; i++)
        for (int half = 0; half < 2; half++)
            samples[half] += (uint64_t)unit_half_count(&batch->units[i], half) *
                             job_tile_pixels(&batch->settings, batch->units[i].tile);
    for (int half = 0; half < 2; half++)
        if (batch->counts.light_paths[half] > samples[half])
            return result_fail(RESULT_PROTOCOL, "%llu light paths for %llu samples",
                               (unsigned long long)batch->counts.light_paths[half],
                               (unsigned long long)samples[half]);
    const uint64_t others[] = {batch->counts.dropped, batch->counts.overflows, batch->counts.rays,
                               batch->counts.cpu_us};
    for (size_t i = 0; i < ARRAY_LENGTH(others); i++)
        if (others[i] > COUNT_LIMIT)
            return result_fail(RESULT_PROTOCOL, "a count of %llu is out of all bounds",
                               (unsigned long long)others[i]);
    return result_ok();
}

static void job_see(job_t *job, uint64_t worker)
{
    for (size_t i = 0; i < job->seen_count; i++)
        if (job->seen[i] == worker) return;
    job->seen = mem_realloc(job->seen, (job->seen_count + 1) * sizeof *job->seen);
    job->seen[job->seen_count++] = worker;
}

/* Moves the points that the speed is measured from. */
static void note_progress(job_t *job, double now)
{
    if (now - job->rate_time[1] < RATE_WINDOW) return;
    job->rate_time[0] = job->rate_time[1];
    job->rate_samples[0] = job->rate_samples[1];
    job->rate_time[1] = now;
    job->rate_samples[1] = job->samples_done;
}

/* Under the lock and the film's lock: refuses the batch, or counts its units. */
static result_t count_batch(double now, job_t *job, worker_t *worker, const batch_t *batch)
{
    result_t result = check_counts(batch);
    if (result.code == RESULT_OK && !job->taking) result = result_fail(RESULT_CANCELLED, "the job is over");
    if (result.code == RESULT_OK) result = schedule_accept(job->schedule, batch->units, batch->unit_count);
    if (result.code != RESULT_OK) return result;
    job->batches++;
    if (worker != NULL) worker->batches++;
    job_see(job, worker != NULL ? worker->id : 0);
    job->samples_done = schedule_done(job->schedule);
    note_progress(job, now);
    return result;
}

/* Under the lock: what the merged film means for the job. */
static void after_merge(farm_t *farm, double now, job_t *job, uint64_t worker)
{
    if (job->counts.dropped == 0 && job->film->counts.dropped > 0)
        log_warning("job %llu: contributions that are NaN or infinite are dropped",
                    (unsigned long long)job->id);
    job->counts = job->film->counts;
    if (job->counts.overflows > 0) {
        snprintf(
            job->message, sizeof job->message,
            "%llu sums were too large for the film at scale %d: submit the job with a smaller film scale",
            (unsigned long long)job->counts.overflows, job->settings.film_scale);
        log_error("job %llu failed: %s", (unsigned long long)job->id, job->message);
        job_close(farm, now, job, JOB_FAILED);
    } else if (schedule_complete(job->schedule)) {
        job_close(farm, now, job, JOB_DONE);
    } else if (job->flush_until > 0) {
        job_flushed(farm, now, job, worker);
    }
}

void farm_batch_refuse(farm_t *farm, job_t *job, uint64_t id, const unit_t *units, size_t count)
{
    lock(farm);
    worker_t *worker = find_worker(farm, id);
    job->batches_refused++;
    if (worker != NULL) worker->batches_refused++;
    if (job->schedule != NULL)
        count_reissued(job, worker, schedule_release_units(job->schedule, id, units, count));
    notify_idle(farm);
    unlock(farm);
}

result_t farm_batch_merge(farm_t *farm, double now, job_t *job, uint64_t id, const batch_t *batch)
{
    pthread_mutex_lock(&job->film_lock);
    lock(farm);
    result_t result = count_batch(now, job, find_worker(farm, id), batch);
    unlock(farm);
    if (result.code == RESULT_OK) {
        film_merge(job->film, batch);
        lock(farm);
        /* The job may have been closed meanwhile: a grace period ended. The merge still counts. */
        if (job->taking)
            after_merge(farm, now, job, id);
        else
            job->counts = job->film->counts;
        unlock(farm);
    }
    pthread_mutex_unlock(&job->film_lock);
    if (result.code != RESULT_OK) farm_batch_refuse(farm, job, id, batch->units, batch->unit_count);
    return result;
}

/* ---- images -------------------------------------------------------------------------------------------- */

job_t *farm_pin(farm_t *farm, uint64_t id)
{
    lock(farm);
    job_t *job = find_job(farm, id);
    if (job != NULL) job->pins++;
    unlock(farm);
    return job;
}

job_t *farm_next_finished(farm_t *farm)
{
    job_t *found = NULL;
    lock(farm);
    for (size_t i = 0; i < farm->job_count && found == NULL; i++)
        if (farm->jobs[i]->image_due) found = farm->jobs[i];
    if (found != NULL) {
        found->image_due = false;
        found->pins++;
    }
    unlock(farm);
    return found;
}

result_t farm_resolve(farm_t *farm, double now, job_t *job, film_image_t *image, job_report_t *report)
{
    pthread_mutex_lock(&job->film_lock);
    lock(farm);
    *report = report_job(job, now);
    bool empty = job->film == NULL || job->batches == 0;
    unlock(farm);
    if (!empty) film_resolve(job->film, image);
    pthread_mutex_unlock(&job->film_lock);
    if (!empty) return result_ok();
    return result_fail(RESULT_INPUT, "job %llu has no samples yet", (unsigned long long)report->job);
}

uint64_t farm_image_version(farm_t *farm, job_t *job, bool *over)
{
    lock(farm);
    uint64_t version = job->batches;
    *over = job_state_final(job->state);
    unlock(farm);
    return version;
}

static void log_end(const job_t *job, const char *path)
{
    log_info("job %llu is %s after %.1f s: %llu batches (%llu refused), %llu units re-issued, %zu workers, "
             "%.1f MB "
             "(%llu bytes) received, %.1f CPU s%s%s",
             (unsigned long long)job->id, job_state_name((uint32_t)job->state), job->ended - job->started,
             (unsigned long long)job->batches, (unsigned long long)job->batches_refused,
             (unsigned long long)job->units_reissued, job->seen_count, 1e-6 * (double)job->bytes,
             (unsigned long long)job->bytes, 1e-6 * (double)job->counts.cpu_us,
             path != NULL ? "; image in " : "", path != NULL ? path : "");
    if (job->counts.dropped > 0)
        log_warning("job %llu: %llu contributions were NaN or infinite, and left out",
                    (unsigned long long)job->id, (unsigned long long)job->counts.dropped);
}

void farm_finished(farm_t *farm, double now, job_t *job, result_t written, const char *path)
{
    (void)now;
    pthread_mutex_lock(&job->film_lock);
    lock(farm);
    if (written.code != RESULT_OK && job->outcome != JOB_FAILED) {
        job->outcome = JOB_FAILED;
        snprintf(job->message, sizeof job->message, "the image could not be written: %.400s",
                 written.message);
        log_error("job %llu: %s", (unsigned long long)job->id, job->message);
    }
    job->state = job->outcome;
    log_end(job, job->state == JOB_FAILED ? NULL : path);
    job_free_film(farm, job);
    notify_idle(farm); /* a job may have waited for memory */
    unlock(farm);
    pthread_mutex_unlock(&job->film_lock);
}

void farm_shut_down(farm_t *farm, double now)
{
    lock(farm);
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (job->state == JOB_QUEUED) job->state = JOB_CANCELLED;
        if (!job->taking) continue;
        snprintf(job->message, sizeof job->message, "the master was shut down");
        job_close(farm, now, job, JOB_CANCELLED);
    }
    unlock(farm);
}
