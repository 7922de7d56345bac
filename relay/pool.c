/* pool: see pool.h.
 *
 * DESIGN. The samples of a job that are here are in its ledger: free, out with a worker, or summed. A batch
 * of a worker is read, accepted into the ledger whole or refused whole, and added to the open parcel. At the
 * interval that the master wishes, the parcel is offered upward, closed when that is granted (until then it
 * grows), and leaves memory and ledger when the master has answered. So a unit is forwarded once; if the
 * master gives it out again, because it refused the sum or lost its data, it is a new unit here.
 *
 * One lock guards all of it and is held for moments. Adding a frame takes many milliseconds, and several
 * threads may be at it at once; a lock of the job's (adding) keeps its parcel from being closed meanwhile.
 *
 * Back-pressure: parcels have a limit. When it is reached, because the master does not grant, batches of the
 * workers are not granted either, and these let theirs grow.
 *
 * Units pass through as they are. So that a sum has few of them, larger ones are asked for than the workers
 * would: UNIT_FACTOR.
 *
 * This file has the pool itself and its clock; pool_workers.c the workers and their batches,
 * pool_uplink.c what the master says and gets. */
#include "relay/pool_state.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { CLOCK_GAP = 2, KEEP_SCENE = 60 }; /* seconds */
#define SUMS_LIMIT ((uint64_t)1 << 30)   /* bytes, or a quarter of the memory */

void pool_lock(pool_t *pool)
{
    pthread_mutex_lock(&pool->lock);
}

void pool_unlock(pool_t *pool)
{
    pthread_mutex_unlock(&pool->lock);
}

pool_t *pool_new(const pool_options_t *options)
{
    pool_t *pool = mem_zalloc(1, sizeof *pool);
    pool->options = *options;
    pool->uplink_interval = options->batch_interval;
    pthread_mutex_init(&pool->lock, NULL);
    return pool;
}

void pool_parcel_free(parcel_t *parcel)
{
    if (parcel == NULL) return;
    sum_free(&parcel->sum);
    free(parcel);
}

static void free_job(relay_job_t *job)
{
    while (job->check_count > 0) pool_check_remove(job, 0);
    free(job->checks);
    for (parcel_t *parcel = job->parcels; parcel != NULL;) {
        parcel_t *next = parcel->next;
        pool_parcel_free(parcel);
        parcel = next;
    }
    pool_parcel_free(job->under_way);
    ledger_free(&job->ledger);
    issued_free(&job->issued);
    for (uint32_t pass = 0; pass < LEARNING_PASSES; pass++) free(job->plan_bytes[pass]);
    blob_close(&job->blob);
    pthread_rwlock_destroy(&job->adding);
    free(job);
}

void pool_destroy(pool_t **pool_pointer)
{
    pool_t *pool = *pool_pointer;
    if (pool == NULL) return;
    for (size_t i = 0; i < pool->job_count; i++) free_job(pool->jobs[i]);
    pthread_mutex_destroy(&pool->lock);
    free(pool->members);
    free(pool->notices);
    free(pool);
    *pool_pointer = NULL;
}

/* ---- finding things ------------------------------------------------------------------------------------ */

relay_job_t *pool_find_job(pool_t *pool, uint64_t id)
{
    for (size_t i = 0; i < pool->job_count; i++)
        if (pool->jobs[i]->id == id && !pool->jobs[i]->gone) return pool->jobs[i];
    return NULL;
}

member_t *pool_find_member(pool_t *pool, uint64_t id)
{
    for (size_t i = 0; i < pool->member_count; i++)
        if (pool->members[i].id == id) return &pool->members[i];
    return NULL;
}

/* ---- notices ------------------------------------------------------------------------------------------- */

static void notify(pool_t *pool, uint64_t worker, uint64_t job, bool flush)
{
    if (pool->notice_count == pool->notice_capacity) {
        pool->notice_capacity = 2 * pool->notice_capacity + 16;
        pool->notices = mem_realloc(pool->notices, pool->notice_capacity * sizeof *pool->notices);
    }
    pool->notices[pool->notice_count++] = (pool_notice_t){worker, job, flush};
    wake_up(pool->options.notice_wake);
}

static bool has_work(const relay_job_t *job)
{
    if (!job->loaded || job->over || job->gone) return false;
    for (size_t i = 0; i < job->check_count; i++)
        if (job->checks[i]->worker == 0 && !job->checks[i]->done) return true;
    return unit_queue_length(&job->ledger.free) > 0;
}

void pool_notify_idle(pool_t *pool)
{
    bool work = false;
    for (size_t i = 0; i < pool->job_count && !work; i++) work = has_work(pool->jobs[i]);
    for (size_t i = 0; work && i < pool->member_count; i++) {
        if (!pool->members[i].idle) continue;
        pool->members[i].idle = false;
        notify(pool, pool->members[i].id, 0, false);
    }
}

static bool has_check(const relay_job_t *job, uint64_t worker)
{
    for (size_t i = 0; i < job->check_count; i++)
        if (job->checks[i]->worker == worker) return true;
    return false;
}

void pool_notify_over(pool_t *pool, const relay_job_t *job, bool flush)
{
    for (size_t i = 0; i < pool->member_count; i++) {
        const member_t *member = &pool->members[i];
        if (member->job == job->id || ledger_held(&job->ledger, member->id) > 0 || has_check(job, member->id))
            notify(pool, member->id, job->id, flush);
    }
}

/* ---- jobs ---------------------------------------------------------------------------------------------- */

bool pool_job_empty(const relay_job_t *job)
{
    return ledger_units(&job->ledger) == 0 && job->check_count == 0 && job->parcels == NULL &&
           job->under_way == NULL && job->merging == 0;
}

bool pool_empty(const pool_t *pool)
{
    for (size_t i = 0; i < pool->job_count; i++)
        if (!pool->jobs[i]->gone && !pool_job_empty(pool->jobs[i])) return false;
    return true;
}

size_t pool_bytes(const pool_t *pool)
{
    size_t bytes = 0;
    for (size_t i = 0; i < pool->job_count; i++)
        for (const parcel_t *parcel = pool->jobs[i]->parcels; parcel != NULL; parcel = parcel->next)
            bytes += parcel->bytes;
    return bytes;
}

uint64_t pool_bytes_limit(const pool_t *pool)
{
    uint64_t share = pool->options.memory / 4;
    return share < SUMS_LIMIT ? share : SUMS_LIMIT;
}

size_t pool_take_back(relay_job_t *job, uint64_t worker)
{
    size_t units = ledger_return(&job->ledger, worker);
    for (size_t i = 0; i < job->check_count; i++) {
        relay_check_t *check = job->checks[i];
        if (check->worker != worker || check->done) continue;
        check->worker = 0;
        units += check->count;
    }
    if (job->over) ledger_drop_free(&job->ledger);
    return units;
}

void pool_check_remove(relay_job_t *job, size_t index)
{
    relay_check_t *check = job->checks[index];
    free(check->units);
    issued_free(&check->issued);
    batch_free(&check->batch);
    free(check);
    memmove(job->checks + index, job->checks + index + 1,
            (--job->check_count - index) * sizeof(relay_check_t *));
}

void pool_drop_job(pool_t *pool, relay_job_t *job)
{
    pool_notify_over(pool, job, false);
    job->over = job->gone = true;
    job->flush = false;
    wake_up(pool->options.bulk_wake);
}

void pool_sweep(pool_t *pool)
{
    size_t kept = 0;
    for (size_t i = 0; i < pool->job_count; i++) {
        relay_job_t *job = pool->jobs[i];
        bool busy = job->users > 0 || job->under_way != NULL;
        for (size_t e = 0; e < job->check_count; e++) busy = busy || job->checks[e]->under_way;
        if (job->gone && !busy)
            free_job(job);
        else
            pool->jobs[kept++] = job;
    }
    pool->job_count = kept;
}

/* ---- time ---------------------------------------------------------------------------------------------- */

void pool_end_flush(pool_t *pool, relay_job_t *job)
{
    for (size_t i = 0; i < pool->member_count; i++) ledger_return(&job->ledger, pool->members[i].id);
    ledger_drop_free(&job->ledger);
    job->flush_until = 0;
    wake_up(pool->options.bulk_wake);
}

size_t pool_remove_member(pool_t *pool, double now, member_t *member)
{
    uint64_t id = member->id;
    size_t units = 0;
    *member = pool->members[--pool->member_count];
    if (pool->member_count == 0) pool->deserted = now;
    for (size_t i = 0; i < pool->job_count; i++) units += pool_take_back(pool->jobs[i], id);
    pool_notify_idle(pool);
    wake_up(pool->options.control_wake);
    wake_up(pool->options.bulk_wake);
    return units;
}

/* No worker came for so long that the units are better off with the master. */
static void give_units_up(pool_t *pool)
{
    for (size_t i = 0; i < pool->job_count; i++) {
        relay_job_t *job = pool->jobs[i];
        ledger_drop_free(&job->ledger);
        for (size_t e = job->check_count; e-- > 0;)
            if (!job->checks[e]->done) pool_check_remove(job, e);
    }
    wake_up(pool->options.control_wake);
}

static void give_up_silent(pool_t *pool, double now)
{
    for (size_t i = 0; i < pool->member_count;) {
        member_t *member = &pool->members[i];
        double silent = now - member->last_seen;
        if (silent <= pool->options.lease) {
            i++;
            continue;
        }
        char name[SERVE_MAX_NAME + 1];
        snprintf(name, sizeof name, "%s", member->name);
        size_t units = pool_remove_member(pool, now, member);
        log_info("worker %s was silent for %.1f s and is given up; %zu units go to others", name, silent,
                 units);
    }
}

void pool_tick(void *self, double now)
{
    pool_t *pool = self;
    pool_lock(pool);
    /* If this process was stopped, or the machine asleep, the silence was ours. */
    double gap = pool->last_tick > 0 ? now - pool->last_tick : 0;
    pool->last_tick = now;
    for (size_t i = 0; gap > CLOCK_GAP && i < pool->member_count; i++) pool->members[i].last_seen += gap;
    give_up_silent(pool, now);
    if (pool->member_count == 0 && now - pool->deserted > pool->options.lease) give_units_up(pool);
    for (size_t i = 0; i < pool->job_count; i++) {
        relay_job_t *job = pool->jobs[i];
        if (job->flush && job->flush_until > 0 && now >= job->flush_until) pool_end_flush(pool, job);
        if (!pool_job_empty(job)) job->last_used = now;
        bool newest = i + 1 == pool->job_count;
        if (!newest && !job->gone && now - job->last_used > KEEP_SCENE) pool_drop_job(pool, job);
    }
    pool_sweep(pool);
    pool_unlock(pool);
}
