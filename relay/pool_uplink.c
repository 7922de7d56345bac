/* pool_uplink: the pool's side of its master: the calls of proto/uplink/uplink_handler.h (see the note in
 * pool.c). */
#include "relay/pool_state.h"

#include "common/memory_limit.h"

#include <stdlib.h>
#include <string.h>

enum {
    HOLD_UNITS = 5,  /* good units for each thread that are to be here, free; ours make them of 0.4 s */
    UNIT_FACTOR = 3, /* so many times larger ones are asked for than a worker would */
    MIN_UNIT_SAMPLES = 256
};
static const double FLUSH_SHARE = 0.4; /* of the batch interval is waited for the workers' last batches, */
static const double MIN_FLUSH = 0.5, MAX_FLUSH = 4; /* within these seconds */

/* ---- news from the master ----------------------------------------------------------------------------- */

/* Makes room for one more job; false when all are in use. */
static bool make_room(pool_t *pool)
{
    pool_sweep(pool);
    for (size_t i = 0; pool->job_count == POOL_MAX_JOBS && i < pool->job_count; i++) {
        if (!pool_job_empty(pool->jobs[i])) continue;
        pool_drop_job(pool, pool->jobs[i]);
        pool_sweep(pool);
    }
    return pool->job_count < POOL_MAX_JOBS;
}

/* The job of an assignment; a number alone does not make it the same (job_content_hash, and the plans that it
 * goes by). NULL when there is no room: the master gives the units to others in time. */
static relay_job_t *job_of(pool_t *pool, const assignment_t *assignment)
{
    relay_job_t *job = pool_find_job(pool, assignment->job);
    if (job != NULL && hash_equal(&job->content, &assignment->content) &&
        assignment_plans_agree(job->plans, assignment->plans))
        return job;
    if (job != NULL) pool_drop_job(pool, job);
    if (!make_room(pool)) return NULL;
    job = mem_zalloc(1, sizeof *job);
    job->id = assignment->job;
    job->content = assignment->content;
    job->settings = assignment->settings;
    job->blob_hash = assignment->blob;
    job->blob_size = assignment->blob_size;
    job->last_used = clock_now();
    pthread_rwlockattr_t attributes; /* who closes a parcel must not wait for ever for those who add */
    pthread_rwlockattr_init(&attributes);
    pthread_rwlockattr_setkind_np(&attributes, PTHREAD_RWLOCK_PREFER_WRITER_NONRECURSIVE_NP);
    pthread_rwlock_init(&job->adding, &attributes);
    pthread_rwlockattr_destroy(&attributes);
    ledger_init(&job->ledger, &assignment->settings);
    pool->jobs[pool->job_count++] = job;
    return job;
}

static void add_check(relay_job_t *job, const assignment_t *assignment)
{
    relay_check_t *check = mem_zalloc(1, sizeof *check);
    check->number = assignment->check;
    check->units = mem_alloc((assignment->unit_count + 1) * sizeof *check->units);
    check->count = assignment->unit_count;
    memcpy(check->units, assignment->units, check->count * sizeof *check->units);
    issued_add(&check->issued, assignment->units, assignment->macs, check->count);
    job->checks = mem_realloc(job->checks, (job->check_count + 1) * sizeof(relay_check_t *));
    job->checks[job->check_count++] = check;
}

static void assign(void *self, const assignment_t *assignment)
{
    pool_t *pool = self;
    pool_lock(pool);
    pool->no_more = false;
    relay_job_t *job = pool->draining || assignment->unit_count == 0 ? NULL : job_of(pool, assignment);
    if (job != NULL) {
        job->settings = assignment->settings;      /* the number of samples may have been extended */
        if (job->flush) pool_end_flush(pool, job); /* its workers were told to drop the rest */
        job->over = job->flush = false;
        for (uint32_t pass = 0; pass < LEARNING_PASSES; pass++)
            if (!hash_is_zero(&assignment->plans[pass])) job->plans[pass] = assignment->plans[pass];
        if (assignment->check != 0) {
            add_check(job, assignment);
        } else {
            ledger_put(&job->ledger, assignment->units, assignment->unit_count);
            issued_add(&job->issued, assignment->units, assignment->macs, assignment->unit_count);
        }
        pool_notify_idle(pool);
        wake_up(pool->options.bulk_wake);
    }
    pool_unlock(pool);
    free(assignment->units);
}

static void no_more(void *self)
{
    pool_t *pool = self;
    pool_lock(pool);
    pool->no_more = true;
    pool_unlock(pool);
    wake_up(pool->options.bulk_wake);
}

/* Drops the checks that the bulk thread does not have. */
static void drop_checks(relay_job_t *job)
{
    for (size_t i = job->check_count; i-- > 0;)
        if (!job->checks[i]->under_way) pool_check_remove(job, i);
}

/* Calls in what the workers have rendered of a job, for `seconds`. */
static void begin_flush(pool_t *pool, relay_job_t *job, double seconds)
{
    pool_notify_over(pool, job, true);
    job->over = job->flush = true;
    job->flush_until = clock_now() + seconds;
    ledger_drop_free(&job->ledger);
    drop_checks(job);
}

static double clamp(double value, double least, double most)
{
    return value < least ? least : value > most ? most : value;
}

static void job_over(void *self, uint64_t id, bool flush)
{
    pool_t *pool = self;
    pool_lock(pool);
    relay_job_t *job = pool_find_job(pool, id);
    if (job != NULL && flush)
        begin_flush(pool, job, clamp(FLUSH_SHARE * pool->uplink_interval, MIN_FLUSH, MAX_FLUSH));
    else if (job != NULL)
        pool_drop_job(pool, job);
    pool_unlock(pool);
    wake_up(pool->options.bulk_wake);
}

static void forget(void *self)
{
    pool_t *pool = self;
    pool_lock(pool);
    for (size_t i = 0; i < pool->job_count; i++) {
        relay_job_t *job = pool->jobs[i];
        ledger_drop_free(&job->ledger);
        drop_checks(job);
        job->hurry = true;
    }
    pool_unlock(pool);
    wake_up(pool->options.bulk_wake);
}

static size_t kept(void *self, uint64_t id, unit_t *units, issue_t *issues, size_t capacity)
{
    pool_t *pool = self;
    pool_lock(pool);
    relay_job_t *job = pool_find_job(pool, id);
    size_t count = job != NULL ? ledger_list(&job->ledger, units, capacity) : 0;
    if (count > 0) issued_find(&job->issued, units, count, issues);
    pool_unlock(pool);
    return count;
}

/* The workers cannot deliver to anybody when the relay is gone: what they have finished is called in now. */
static void drain(void *self)
{
    const double as_long_as_it_takes = 1e9;
    pool_t *pool = self;
    pool_lock(pool);
    pool->draining = true;
    for (size_t i = 0; i < pool->job_count; i++) begin_flush(pool, pool->jobs[i], as_long_as_it_takes);
    pool_unlock(pool);
    wake_up(pool->options.bulk_wake);
}

static void give_up(void *self)
{
    pool_t *pool = self;
    pool_lock(pool);
    for (size_t i = 0; i < pool->job_count; i++) pool->jobs[i]->flush_until = clock_now();
    pool_unlock(pool);
}

static void clear_failure(void *self)
{
    pool_t *pool = self;
    pool_lock(pool);
    pool->failure = result_ok();
    pool_unlock(pool);
}

/* ---- state -------------------------------------------------------------------------------------------- */

/* Pixel samples to ask for, and of a good unit. */
static void add_wishes(const pool_t *pool, uplink_state_t *state)
{
    double units = 0, threads = 0, free_samples = 0;
    size_t held = 0;
    for (size_t i = 0; i < pool->member_count; i++) {
        const member_t *member = &pool->members[i];
        threads += member->threads;
        units += (double)member->threads *
                 clamp((double)member->unit_samples, MIN_UNIT_SAMPLES, (double)JOB_MAX_PIXELS);
    }
    for (size_t i = 0; i < pool->job_count; i++) {
        const relay_job_t *job = pool->jobs[i];
        if (job->gone) continue;
        held += ledger_units(&job->ledger);
        free_samples += (double)job->ledger.free.samples;
        for (size_t e = 0; e < job->check_count; e++) {
            const relay_check_t *check = job->checks[e];
            held += check->count;
            for (size_t u = 0; u < check->count && check->worker == 0; u++)
                free_samples += (double)unit_samples(&job->settings, &check->units[u]);
        }
    }
    if (threads == 0) return;
    double hold = HOLD_UNITS * units;
    state->unit_samples = (uint64_t)(UNIT_FACTOR * units / threads);
    if (pool->draining || pool->failure.code != RESULT_OK || held >= POOL_MAX_UNITS) return;
    if (free_samples < 0.5 * hold) state->samples = (uint64_t)(hold - free_samples);
}

static uplink_state_t state(void *self)
{
    pool_t *pool = self;
    uplink_state_t s = {0};
    pool_lock(pool);
    s.ready = pool->member_count > 0 || !pool_empty(pool);
    s.fingerprint = pool->group;
    for (size_t i = 0; i < pool->member_count; i++) s.threads += pool->members[i].threads;
    if (s.threads > SERVE_RELAY_THREADS) s.threads = SERVE_RELAY_THREADS;
    for (size_t i = 0; i < pool->job_count; i++) {
        const relay_job_t *job = pool->jobs[i];
        if (job->gone) continue;
        s.job = job->id;
        s.content = job->content;
        s.units_held += (uint32_t)ledger_units(&job->ledger);
        s.rendering += (uint32_t)job->ledger.out_count;
        for (size_t e = 0; e < job->check_count; e++) s.units_held += (uint32_t)job->checks[e]->count;
    }
    s.idle = pool_empty(pool);
    s.failure = pool->failure;
    s.failed = pool->failed;
    add_wishes(pool, &s);
    pool_unlock(pool);
    return s;
}

/* ---- duties of the bulk thread ------------------------------------------------------------------------ */

/* Two frames of sums must fit into memory with something to spare. */
static result_t check_memory(const pool_t *pool, const relay_job_t *job)
{
    double need = 2.0 * (double)sum_frame_bytes(&job->settings);
    double have = (double)pool->options.memory;
    if (need < 0.5 * have && memory_is_there((uint64_t)need)) return result_ok();
    return result_fail(RESULT_LIMIT, "an image of %d x %d takes %.1f GB of sums; the relay has %.1f GB",
                       job->settings.width, job->settings.height, 1e-9 * need, 1e-9 * have);
}

/* Nothing will be added to the sums of a job for now. */
static bool nothing_coming(const pool_t *pool, const relay_job_t *job)
{
    return (pool->no_more || job->over || pool->member_count == 0) &&
           unit_queue_length(&job->ledger.free) == 0 && job->ledger.out_count == 0 && job->merging == 0;
}

static void set_offer(const relay_job_t *job, uint64_t check, size_t bytes, duty_t *duty)
{
    duty->kind = DUTY_OFFER;
    duty->offer = (offer_t){.job = job->id, .check = check, .content = job->content, .bytes = bytes};
}

/* Finds what is to be sent of a job. */
static void find_offer(const pool_t *pool, const relay_job_t *job, duty_t *duty)
{
    if (job->gone || (job->over && !job->flush)) return;
    for (size_t i = 0; i < job->check_count; i++)
        if (job->checks[i]->done)
            set_offer(job, job->checks[i]->number, batch_bytes(&job->checks[i]->batch), duty);
    const parcel_t *parcel = job->parcels;
    if (duty->kind != DUTY_NONE || parcel == NULL) return;
    double wait = parcel->since + pool->uplink_interval - clock_now();
    bool full = parcel->next != NULL || parcel->units >= PARCEL_READY_UNITS ||
                pool_bytes(pool) >= pool_bytes_limit(pool);
    if (wait <= 0 || full || job->hurry || nothing_coming(pool, job))
        set_offer(job, 0, parcel->bytes, duty);
    else if (wait < duty->wait)
        duty->wait = wait;
}

static void find_any_offer(const pool_t *pool, duty_t *duty)
{
    for (size_t i = 0; i < pool->job_count && duty->kind == DUTY_NONE; i++)
        find_offer(pool, pool->jobs[i], duty);
}

/* Finds a scene that is to be fetched; declines jobs that are too large. */
static void find_load(pool_t *pool, duty_t *duty)
{
    for (size_t i = 0; i < pool->job_count; i++) {
        relay_job_t *job = pool->jobs[i];
        if (job->loaded || job->over) continue;
        result_t memory = check_memory(pool, job);
        if (memory.code == RESULT_OK) {
            duty->kind = DUTY_LOAD;
            duty->assignment = (assignment_t){.job = job->id,
                                              .settings = job->settings,
                                              .blob = job->blob_hash,
                                              .blob_size = job->blob_size,
                                              .content = job->content};
            return;
        }
        pool->failure = memory;
        pool->failed = job->id;
        pool_drop_job(pool, job);
        wake_up(pool->options.control_wake);
    }
}

/* The pass of a unit of a job that waits for its plan; LEARNING_PASSES: none does. */
static uint32_t lacking_pass(const relay_job_t *job)
{
    for (size_t i = 0; i < job->check_count; i++)
        for (size_t u = 0; u < job->checks[i]->count; u++) {
            uint32_t first = job->checks[i]->units[u].first;
            if (!learning_ready(&job->settings, first, job->ledger.plans))
                return learning_pass(&job->settings, first);
        }
    return unit_queue_lacks(&job->ledger.free, &job->settings, job->ledger.plans);
}

/* Finds a plan that is to be fetched. */
static void find_plan(const pool_t *pool, duty_t *duty)
{
    for (size_t i = 0; i < pool->job_count && duty->kind == DUTY_NONE; i++) {
        const relay_job_t *job = pool->jobs[i];
        duty->pass = lacking_pass(job);
        if (duty->pass == LEARNING_PASSES || job->over || job->gone) continue;
        duty->kind = DUTY_PLAN;
        duty->assignment = (assignment_t){.job = job->id, .settings = job->settings, .content = job->content};
        memcpy(duty->assignment.plans, job->plans, sizeof job->plans);
    }
}

/* Sums and scenes take turns: a scene gives way to a sum (pressing), but sums that are always ready do not
 * keep it away. Plans are small, and units wait for them; but one that does not come keeps no sum. */
static duty_t find_duty(void *self, double batch_interval, double rate)
{
    pool_t *pool = self;
    duty_t duty = {.kind = DUTY_NONE, .wait = 1};
    pool_lock(pool);
    (void)rate;
    pool->uplink_interval = batch_interval;
    pool_sweep(pool);
    if (!pool->fetched) find_plan(pool, &duty);
    if (duty.kind == DUTY_NONE) find_any_offer(pool, &duty);
    if (duty.kind == DUTY_NONE || (duty.kind == DUTY_OFFER && pool->offered)) find_load(pool, &duty);
    if (duty.kind == DUTY_NONE) find_plan(pool, &duty);
    pool->fetched = duty.kind == DUTY_PLAN;
    pool->offered = duty.kind == DUTY_OFFER || (pool->offered && pool->fetched);
    pool_unlock(pool);
    return duty;
}

static bool pressing(void *self)
{
    pool_t *pool = self;
    duty_t duty = {.kind = DUTY_NONE};
    pool_lock(pool);
    find_any_offer(pool, &duty);
    pool_unlock(pool);
    return duty.kind == DUTY_OFFER;
}

static bool unwanted(void *self, uint64_t id)
{
    pool_t *pool = self;
    pool_lock(pool);
    const relay_job_t *job = pool_find_job(pool, id);
    bool wanted = job != NULL && !(job->over && (!job->flush || !job->loaded));
    pool_unlock(pool);
    return !wanted;
}

static result_t loaded(void *self, uint64_t id, scene_blob_t *blob)
{
    pool_t *pool = self;
    pool_lock(pool);
    relay_job_t *job = pool_find_job(pool, id);
    /* There may be another job of this number by now (job_of). */
    if (job == NULL || job->loaded || !hash_equal(&job->blob_hash, &blob->hash)) {
        pool_unlock(pool);
        blob_close(blob);
        return result_fail(RESULT_CANCELLED, "the job is over");
    }
    job->blob = *blob;
    job->loaded = true;
    pool_notify_idle(pool);
    pool_unlock(pool);
    return result_ok();
}

static result_t planned(void *self, const assignment_t *assignment, uint32_t pass, const uint8_t *bytes,
                        size_t size)
{
    pool_t *pool = self;
    learning_plan_t plan;
    TRY(learning_plan_read(bytes, size, &assignment->content, &plan));
    if (plan.pass != pass)
        return result_fail(RESULT_MISMATCH, "a plan of pass %u where that of pass %u is due", plan.pass,
                           pass);
    pool_lock(pool);
    relay_job_t *job = pool_find_job(pool, assignment->job);
    /* There may be another job of this number by now, or another plan (job_of). */
    if (job != NULL && hash_equal(&job->plans[pass], &assignment->plans[pass]) &&
        job->plan_bytes[pass] == NULL) {
        job->plan_bytes[pass] = mem_alloc(size);
        memcpy(job->plan_bytes[pass], bytes, size);
        job->ledger.plans |= UINT32_C(1) << pass;
        pool_notify_idle(pool);
    }
    pool_unlock(pool);
    return result_ok();
}

static void refuse(void *self, uint64_t id, result_t why)
{
    pool_t *pool = self;
    pool_lock(pool);
    relay_job_t *job = pool_find_job(pool, id);
    if (job != NULL) pool_drop_job(pool, job);
    pool->failure = why;
    pool->failed = id;
    pool_unlock(pool);
    wake_up(pool->options.control_wake);
}

/* How the units of a batch were issued, in fresh memory. */
static issue_t *issues_of(issued_t *issued, const batch_t *batch)
{
    issue_t *issues = mem_alloc((batch->unit_count + 1) * sizeof *issues);
    issued_find(issued, batch->units, batch->unit_count, issues);
    return issues;
}

/* Takes the first parcel, and how its units were issued; NULL when there is none. No lock held. */
static batch_t *close_parcel(pool_t *pool, relay_job_t *job, issue_t **issues)
{
    batch_t *batch = NULL;
    pthread_rwlock_wrlock(&job->adding); /* waits until what is being added is in */
    pool_lock(pool);
    if (job->parcels != NULL && (!job->over || job->flush)) {
        job->under_way = job->parcels;
        job->parcels = job->parcels->next;
        job->under_way->next = NULL;
        if (job->parcels == NULL) job->hurry = false;
        batch = sum_batch(job->under_way->sum);
        *issues = issues_of(&job->issued, batch);
    }
    pool_unlock(pool);
    pthread_rwlock_unlock(&job->adding);
    return batch;
}

/* The batch of a check that is done; *issues are of its units. */
static batch_t *close_check(relay_job_t *job, uint64_t number, issue_t **issues)
{
    for (size_t i = 0; i < job->check_count; i++) {
        if (job->checks[i]->number != number || !job->checks[i]->done) continue;
        job->checks[i]->under_way = true;
        *issues = issues_of(&job->checks[i]->issued, &job->checks[i]->batch);
        return &job->checks[i]->batch;
    }
    return NULL;
}

static closed_batch_t close_batch(void *self, const offer_t *offer)
{
    pool_t *pool = self;
    closed_batch_t closed = {.offer = *offer};
    pool_lock(pool);
    relay_job_t *job = pool_find_job(pool, offer->job);
    if (job != NULL) job->users++;
    if (job != NULL && offer->check != 0) closed.batch = close_check(job, offer->check, &closed.issues);
    closed.sequence = ++pool->sequence;
    pool_unlock(pool);
    if (job == NULL) return closed;
    if (offer->check == 0) closed.batch = close_parcel(pool, job, &closed.issues);
    pool_lock(pool);
    job->users--;
    pool_unlock(pool);
    return closed;
}

/* What has left the ledger need not be known any more. */
static void forget_issued(relay_job_t *job)
{
    size_t count;
    unit_t *units = ledger_all(&job->ledger, &count);
    issued_keep(&job->issued, units, count);
    free(units);
}

/* Lets go of what was sent of a job, if it was of this one. Lock held; the parcel is the caller's to free. */
static parcel_t *settle(relay_job_t *job, const closed_batch_t *closed)
{
    for (size_t i = 0; i < job->check_count; i++)
        if (&job->checks[i]->batch == closed->batch) {
            pool_check_remove(job, i);
            return NULL;
        }
    parcel_t *parcel = job->under_way;
    if (parcel == NULL || sum_batch(parcel->sum) != closed->batch) return NULL;
    ledger_settle(&job->ledger, closed->batch->units, closed->batch->unit_count);
    forget_issued(job);
    job->under_way = NULL;
    return parcel;
}

static void sent(void *self, const closed_batch_t *closed, bool counted)
{
    pool_t *pool = self;
    parcel_t *parcel = NULL;
    (void)counted; /* what was refused, the master gives out again */
    pool_lock(pool);
    for (size_t i = 0; i < pool->job_count && parcel == NULL; i++) parcel = settle(pool->jobs[i], closed);
    pool_sweep(pool);
    pool_unlock(pool);
    pool_parcel_free(parcel);
    wake_up(pool->options.control_wake);
    wake_up(pool->options.grant_wake);
}

uplink_handler_t pool_uplink(pool_t *pool)
{
    static const uplink_calls_t calls = {.assign = assign,
                                         .no_more = no_more,
                                         .job_over = job_over,
                                         .forget = forget,
                                         .kept = kept,
                                         .drain = drain,
                                         .give_up = give_up,
                                         .clear_failure = clear_failure,
                                         .state = state,
                                         .duty = find_duty,
                                         .unwanted = unwanted,
                                         .pressing = pressing,
                                         .loaded = loaded,
                                         .planned = planned,
                                         .refuse = refuse,
                                         .close = close_batch,
                                         .sent = sent};
    return (uplink_handler_t){&calls, pool};
}
