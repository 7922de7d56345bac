/* farm_workers: who works for the farm, and what they are given (see farm.h). */
#include "master/farm_state.h"

#include <sodium.h>
#include <stdio.h>
#include <string.h>

enum {
    MAX_THREADS = 4096, /* of one worker, for sharing out */
    STALL_BATCHES = 12  /* batch intervals without a batch, after which others may have a worker's units */
};

void farm_count_reissued(job_t *job, worker_t *worker, size_t units)
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
            farm_job_flushed(farm, now, job, worker->id);
            continue;
        }
        size_t units = schedule_release(job->schedule, worker->id);
        farm_count_reissued(job, worker, units);
        total += units;
    }
    return total;
}

void farm_worker_disconnect(farm_t *farm, double now, worker_t *worker, const char *why)
{
    size_t units = take_back(farm, now, worker);
    worker->connected = false;
    worker->last_seen = now;
    log_info("worker %s %s; %zu units go back; it sent %llu batches (%llu refused), %.1f MB", worker->name,
             why, units, (unsigned long long)worker->batches, (unsigned long long)worker->batches_refused,
             1e-6 * (double)worker->bytes);
    farm_notify_idle(farm);
}

/* A connected worker, which is hereby heard of. */
static worker_t *hear_worker(farm_t *farm, double now, const identity_t *identity, uint64_t id)
{
    worker_t *worker = farm_find_worker(farm, id);
    if (worker == NULL || !worker->connected) return NULL;
    worker->last_seen = now;
    worker->identity = *identity;
    return worker;
}

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

result_t farm_hello(farm_t *farm, double now, const identity_t *identity, const farm_hello_t *hello,
                    uint64_t *id)
{
    farm_lock(farm);
    worker_t *worker = worker_add(farm);
    if (worker == NULL) {
        farm_unlock(farm);
        return result_fail(RESULT_LIMIT, "this master has %d workers already", FARM_MAX_WORKERS);
    }
    *worker = (worker_t){.identity = *identity,
                         .threads = hello->threads < 1             ? 1
                                    : hello->threads > MAX_THREADS ? MAX_THREADS
                                                                   : hello->threads,
                         .fingerprint = hello->fingerprint,
                         .relay = hello->relay,
                         .connected = true,
                         .last_seen = now};
    snprintf(worker->name, sizeof worker->name, "%s", hello->name[0] != '\0' ? hello->name : "(no name)");
    snprintf(worker->key, sizeof worker->key, "%s", hello->key);
    while (worker->id == 0) randombytes_buf(&worker->id, sizeof worker->id);
    *id = worker->id;
    log_info("worker %s joins with %u threads", worker->name, worker->threads);
    farm_unlock(farm);
    return result_ok();
}

bool farm_heartbeat(farm_t *farm, double now, const identity_t *identity, uint64_t id, uint64_t job,
                    uint32_t units_held)
{
    farm_lock(farm);
    worker_t *worker = hear_worker(farm, now, identity, id);
    if (worker != NULL) {
        worker->job = job;
        for (size_t i = 0; units_held == 0 && i < farm->job_count; i++)
            if (farm->jobs[i]->flush_until > 0) farm_job_flushed(farm, now, farm->jobs[i], id);
    }
    farm_unlock(farm);
    return worker != NULL;
}

/* A worker cannot render a job. Another may, but if nobody ever could, the fault is the job's. */
static void decline(farm_t *farm, double now, job_t *job, const char *worker, const char *reason)
{
    job->declines++;
    if (job->state != JOB_RUNNING || job->batches > 0 || job->declines < FARM_MAX_DECLINES) return;
    if (schedule_holders(job->schedule) > 0) return;
    snprintf(job->message, sizeof job->message, "no worker can render it; %.100s says: %.350s", worker,
             reason);
    log_error("job %llu failed: %s", (unsigned long long)job->id, job->message);
    farm_job_close(farm, now, job, JOB_FAILED);
}

void farm_goodbye(farm_t *farm, double now, uint64_t id, uint64_t job_id, const char *reason)
{
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, id);
    if (worker != NULL && worker->connected) {
        char why[FARM_MAX_NAME];
        snprintf(why, sizeof why, "leaves%s%s", reason[0] != '\0' ? ": " : "", reason);
        job_t *job = farm_find_job(farm, job_id);
        bool held = job != NULL && job->schedule != NULL && schedule_held(job->schedule, id) > 0;
        farm_worker_disconnect(farm, now, worker, why);
        if (held) decline(farm, now, job, worker->name, reason);
    }
    farm_unlock(farm);
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
    if (!farm_job_has_work(job)) return 0;
    if (job->state == JOB_QUEUED && !farm_job_start(farm, now, job)) return 0;
    work->unit_count = schedule_take(job->schedule, wish, work->units, WIRE_MAX_UNITS);
    work->job = job->id;
    work->settings = job->settings;
    work->blob = job->blob;
    work->blob_size = job->blob_size;
    return work->unit_count;
}

static void take_from_jobs(farm_t *farm, double now, const worker_t *worker, const schedule_wish_t *wish,
                           farm_work_t *work)
{
    size_t count;
    job_t *const *jobs = farm_rank_jobs(farm, worker, NULL, &count);
    work->unit_count = 0;
    for (size_t i = 0; i < count && work->unit_count == 0; i++) take_from_job(farm, now, jobs[i], wish, work);
}

static bool holds_units(const farm_t *farm, uint64_t worker)
{
    for (size_t i = 0; i < farm->job_count; i++)
        if (farm->jobs[i]->schedule != NULL && schedule_held(farm->jobs[i]->schedule, worker) > 0)
            return true;
    return false;
}

/* Somebody is idle: workers that live but have not delivered anything for long (they hang, or fetch a scene
 * over a slow link) lose their units. True when any did. They may still deliver first. */
static bool recall_stalled(farm_t *farm, double now, const worker_t *idle)
{
    size_t units = 0;
    for (size_t i = 0; i < farm->worker_count; i++) {
        worker_t *worker = &farm->workers[i];
        bool stalled = now - worker->delivered > STALL_BATCHES * farm->options.batch_interval;
        if (worker == idle || !worker->connected || !stalled) continue;
        size_t recalled = take_back(farm, now, worker);
        if (recalled > 0)
            log_warning("worker %s has sent nothing for %.0f s: %zu units go to others", worker->name,
                        now - worker->delivered, recalled);
        units += recalled;
    }
    return units > 0;
}

result_t farm_take(farm_t *farm, double now, const identity_t *identity, uint64_t id, uint64_t loaded_job,
                   uint64_t samples, uint64_t unit_samples, farm_work_t *work)
{
    farm_lock(farm);
    worker_t *worker = hear_worker(farm, now, identity, id);
    if (worker == NULL) {
        farm_unlock(farm);
        return result_fail(RESULT_UNREACHABLE, "this master does not know the worker: say hello again");
    }
    schedule_wish_t wish = {.worker = id,
                            .samples = samples,
                            .unit_samples = unit_samples,
                            .threads = worker->threads,
                            .farm_threads = farm_threads(farm)};
    if (!holds_units(farm, id)) worker->delivered = now;
    take_from_jobs(farm, now, worker, &wish, work);
    if (work->unit_count == 0 && recall_stalled(farm, now, worker))
        take_from_jobs(farm, now, worker, &wish, work);
    if (work->unit_count == 0) work->job = 0;
    worker->idle = work->unit_count == 0;
    worker->job = work->unit_count > 0 ? work->job : loaded_job;
    farm_unlock(farm);
    return result_ok();
}
