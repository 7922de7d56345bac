/* pool_workers: the pool's side of its workers: who they are, which units they get, what they deliver (see
 * pool.h). */
#include "relay/pool_state.h"

#include <math.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    STALL_BATCHES = 6, /* batch intervals without a batch, after which others may have a worker's units */
    MAX_DECLINES = 3   /* of a job that nobody has rendered any of */
};

/* ---- coming and going ---------------------------------------------------------------------------------- */

/* A worker, which is hereby heard of. */
static member_t *hear(pool_t *pool, double now, const identity_t *identity, uint64_t id)
{
    member_t *member = pool_find_member(pool, id);
    if (member == NULL) return NULL;
    member->last_seen = now;
    member->identity = *identity;
    return member;
}

static uint32_t limit_threads(uint32_t threads, bool relay)
{
    uint32_t most = relay ? SERVE_RELAY_THREADS : SERVE_WORKER_THREADS;
    return threads < 1 ? 1 : threads > most ? most : threads;
}

/* The first worker decides whose bits are made here, as long as it or a sum of such bits is here. */
static result_t check_group(pool_t *pool, const hash_t *fingerprint)
{
    if (hash_equal(&pool->group, fingerprint)) return result_ok();
    if (pool->member_count == 0 && pool_empty(pool)) {
        pool->group = *fingerprint;
        return result_ok();
    }
    char here[2 * HASH_BYTES + 1], there[2 * HASH_BYTES + 1];
    hash_to_hex(&pool->group, here);
    hash_to_hex(fingerprint, there);
    return result_fail(
        RESULT_MISMATCH,
        "the workers of this relay make the bits %.8s, this machine makes %.8s, and a sum must "
        "not mix them: let it dial the master, or a relay of its own kind",
        here, there);
}

static result_t hello_from(void *self, double now, const identity_t *identity, const worker_hello_t *hello,
                           uint64_t *worker)
{
    pool_t *pool = self;
    pool_lock(pool);
    result_t result = check_group(pool, &hello->fingerprint);
    if (result.code == RESULT_OK && pool->member_count == SERVE_MAX_WORKERS)
        result = result_fail(RESULT_LIMIT, "this relay has %d workers already", SERVE_MAX_WORKERS);
    if (result.code == RESULT_OK) {
        pool->members = mem_realloc(pool->members, (pool->member_count + 1) * sizeof *pool->members);
        member_t *member = &pool->members[pool->member_count++];
        *member = (member_t){.identity = *identity,
                             .threads = limit_threads(hello->threads, hello->relay),
                             .relay = hello->relay,
                             .last_seen = now,
                             .delivered = now};
        const char *address = hello->address != NULL ? hello->address : "";
        snprintf(member->party, sizeof member->party, "%s", hello->key[0] != '\0' ? hello->key : address);
        snprintf(member->name, sizeof member->name, "%s", hello->name[0] != '\0' ? hello->name : "(no name)");
        while (member->id == 0) randombytes_buf(&member->id, sizeof member->id);
        *worker = member->id;
        log_info("worker %s joins with %u threads", member->name, member->threads);
        wake_up(pool->options.control_wake);
    }
    pool_unlock(pool);
    return result;
}

/* A worker has nothing (more) to send of a job that is being flushed. */
static void flushed(pool_t *pool, relay_job_t *job, uint64_t worker)
{
    if (ledger_return(&job->ledger, worker) == 0) return;
    ledger_drop_free(&job->ledger);
    wake_up(pool->options.bulk_wake);
}

static void hear_trouble(member_t *member, const heartbeat_t *beat)
{
    if (beat->trouble[0] != '\0' && !member->troubled)
        log_warning("worker %s gets no work: %.300s", member->name, beat->trouble);
    member->troubled = member->troubled || beat->trouble[0] != '\0';
}

static bool heartbeat(void *self, double now, const identity_t *identity, const heartbeat_t *beat)
{
    pool_t *pool = self;
    pool_lock(pool);
    member_t *member = hear(pool, now, identity, beat->worker);
    if (member != NULL) {
        member->job = beat->job;
        hear_trouble(member, beat);
        if (beat->threads > 0) member->threads = limit_threads(beat->threads, member->relay);
        for (size_t i = 0; beat->units_held == 0 && i < pool->job_count; i++)
            if (pool->jobs[i]->flush) flushed(pool, pool->jobs[i], beat->worker);
    }
    pool_unlock(pool);
    return member != NULL;
}

/* A worker cannot render a job. Another may, but if nobody here can, the master has to know. */
static void decline(pool_t *pool, relay_job_t *job, const char *worker, const char *reason)
{
    job->declines++;
    bool all = job->declines >= MAX_DECLINES || job->declines > pool->member_count;
    if (job->delivered || job->ledger.out_count > 0 || !all) return;
    pool->failure = result_fail(
        RESULT_INPUT, "none of the relay's workers can render it; %.100s says: %.300s", worker, reason);
    pool->failed = job->id;
    pool_drop_job(pool, job);
    wake_up(pool->options.control_wake);
}

static void goodbye(void *self, double now, uint64_t worker, uint64_t id, const char *reason)
{
    pool_t *pool = self;
    pool_lock(pool);
    member_t *member = pool_find_member(pool, worker);
    if (member != NULL) {
        char name[SERVE_MAX_NAME + 1];
        snprintf(name, sizeof name, "%s", member->name);
        size_t units = pool_remove_member(pool, now, member);
        log_info("worker %s leaves%s%s; %zu units go to others", name, reason[0] != '\0' ? ": " : "", reason,
                 units);
        relay_job_t *job = pool_find_job(pool, id);
        if (job != NULL) decline(pool, job, name, reason);
    }
    pool_unlock(pool);
}

/* ---- what was issued ----------------------------------------------------------------------------------- */

/* For units of a job that a worker is issued, or delivers. */
static unit_mac_t mac_for(const pool_t *pool, const member_t *member, const relay_job_t *job, uint64_t check)
{
    return unit_mac(&pool->options.secret, member->party, job->id, &job->content, check);
}

/* ---- giving -------------------------------------------------------------------------------------------- */

static bool is_of(const relay_job_t *job, const claim_t *claim)
{
    return job != NULL && !job->over && claim->content != NULL && hash_equal(&job->content, claim->content);
}

static bool may_claim(const pool_t *pool, const relay_job_t *job, const member_t *member,
                      const claim_t *claim)
{
    unit_mac_t mac = mac_for(pool, member, job, 0);
    return job_check_units(&job->settings, claim->units, claim->unit_count).code == RESULT_OK &&
           unit_mac_check(&mac, claim->units, claim->issues, claim->unit_count).code == RESULT_OK;
}

static void claim_units(void *self, double now, const claim_t *claim)
{
    pool_t *pool = self;
    (void)now;
    pool_lock(pool);
    relay_job_t *job = pool_find_job(pool, claim->job);
    const member_t *member = pool_find_member(pool, claim->worker);
    if (is_of(job, claim) && member != NULL && may_claim(pool, job, member, claim))
        for (size_t i = 0; i < claim->unit_count; i++)
            ledger_lend_unit(&job->ledger, claim->worker, &claim->units[i]);
    pool_unlock(pool);
}

static void describe(const relay_job_t *job, work_t *work)
{
    work->job = job->id;
    work->settings = job->settings;
    work->blob = job->blob_hash;
    work->blob_size = job->blob_size;
}

/* Names the plans that units of a job go by. */
static void name_plans(const relay_job_t *job, work_t *work)
{
    memset(work->plans, 0, sizeof work->plans);
    for (size_t i = 0; i < work->unit_count && job_learns(&job->settings); i++) {
        uint32_t pass = learning_pass(&job->settings, work->units[i].first);
        work->plans[pass] = job->plans[pass];
    }
}

/* Whether the plans are here that a check goes by. */
static bool is_ready(const relay_job_t *job, const relay_check_t *check)
{
    bool ready = true;
    for (size_t i = 0; i < check->count; i++)
        ready &= learning_ready(&job->settings, check->units[i].first, job->ledger.plans);
    return ready;
}

/* A check that nobody has; false when there is none. */
static bool take_check(relay_job_t *job, uint64_t worker, work_t *work)
{
    for (size_t i = 0; i < job->check_count; i++) {
        relay_check_t *check = job->checks[i];
        if (check->worker != 0 || check->done || !is_ready(job, check)) continue;
        check->worker = worker;
        memcpy(work->units, check->units, check->count * sizeof *work->units);
        work->unit_count = check->count;
        work->check = check->number;
        return true;
    }
    return false;
}

static void take_from_job(relay_job_t *job, uint64_t worker, uint64_t samples, work_t *work)
{
    if (!job->loaded || job->over || job->gone) return;
    describe(job, work);
    if (!take_check(job, worker, work))
        work->unit_count = ledger_lend(&job->ledger, worker, samples, work->units, WIRE_MAX_UNITS);
    name_plans(job, work);
}

/* The job that the worker has loaded goes first, so that scenes are not changed more often than need be. */
static void take_from_jobs(pool_t *pool, uint64_t worker, uint64_t loaded, uint64_t samples, work_t *work)
{
    relay_job_t *job = pool_find_job(pool, loaded);
    work->unit_count = 0;
    work->check = 0;
    if (job != NULL) take_from_job(job, worker, samples, work);
    for (size_t i = 0; i < pool->job_count && work->unit_count == 0; i++)
        take_from_job(pool->jobs[i], worker, samples, work);
}

/* Shows the worker's units to be from here. */
static void issue(pool_t *pool, const member_t *member, work_t *work)
{
    if (work->unit_count == 0 || work->issues == NULL) return;
    unit_mac_t mac = mac_for(pool, member, pool_find_job(pool, work->job), work->check);
    unit_mac_issue(&mac, work->units, work->unit_count, work->issues);
}

static size_t units_of(const pool_t *pool, uint64_t worker)
{
    size_t units = 0;
    for (size_t i = 0; i < pool->job_count; i++) {
        const relay_job_t *job = pool->jobs[i];
        units += ledger_held(&job->ledger, worker);
        for (size_t e = 0; e < job->check_count; e++)
            if (job->checks[e]->worker == worker && !job->checks[e]->done) units += job->checks[e]->count;
    }
    return units;
}

/* Somebody is idle: workers that live but have not delivered anything for long lose their units. True when
 * any did. They may still deliver first. The idle one may be among them: then what it was given did not reach
 * it. */
static bool recall_stalled(pool_t *pool, double now)
{
    size_t recalled = 0;
    for (size_t i = 0; i < pool->member_count; i++) {
        const member_t *member = &pool->members[i];
        double silent = now - member->delivered;
        if (silent <= STALL_BATCHES * pool->options.batch_interval) continue;
        size_t units = 0;
        for (size_t j = 0; j < pool->job_count; j++) units += pool_take_back(pool->jobs[j], member->id);
        if (units > 0)
            log_warning("worker %s has sent nothing for %.0f s: %zu units go to others", member->name, silent,
                        units);
        recalled += units;
    }
    return recalled > 0;
}

static result_t unknown_worker(void)
{
    return result_fail(RESULT_UNREACHABLE, "this relay does not know the worker: say hello again");
}

static result_t take(void *self, double now, const identity_t *identity, const work_request_t *request,
                     work_t *work)
{
    pool_t *pool = self;
    uint64_t worker = request->worker;
    pool_lock(pool);
    member_t *member = hear(pool, now, identity, worker);
    if (member == NULL) {
        pool_unlock(pool);
        return unknown_worker();
    }
    work->unit_count = 0;
    member->unit_samples = request->unit_samples;
    if (units_of(pool, worker) == 0) {
        member->delivered = now;
        member->granted = 0;
    }
    if (!pool->draining && member->reached && request->samples > 0) {
        take_from_jobs(pool, worker, request->job, request->samples, work);
        if (work->unit_count == 0 && recall_stalled(pool, now))
            take_from_jobs(pool, worker, request->job, request->samples, work);
    }
    issue(pool, member, work);
    if (work->unit_count == 0) work->job = 0;
    member->idle = work->unit_count == 0;
    member->job = work->unit_count > 0 ? work->job : request->job;
    wake_up(pool->options.control_wake); /* more may be wanted from above */
    pool_unlock(pool);
    return result_ok();
}

static result_t reached(void *self, double now, uint64_t worker)
{
    pool_t *pool = self;
    pool_lock(pool);
    member_t *member = pool_find_member(pool, worker);
    if (member != NULL) {
        member->reached = true;
        member->last_seen = now;
    }
    pool_unlock(pool);
    return member != NULL ? result_ok() : unknown_worker();
}

static bool next_notice(void *self, notice_t *notice)
{
    pool_t *pool = self;
    bool found = false;
    pool_lock(pool);
    while (!found && pool->notice_count > 0) {
        pool_notice_t pending = pool->notices[0];
        memmove(pool->notices, pool->notices + 1, --pool->notice_count * sizeof *pool->notices);
        const member_t *member = pool_find_member(pool, pending.worker);
        found = member != NULL;
        if (found)
            *notice = (notice_t){.identity = member->identity, .job = pending.job, .flush = pending.flush};
    }
    pool_unlock(pool);
    return found;
}

/* ---- batches ------------------------------------------------------------------------------------------- */

/* Whether a batch of this job is wanted at all; `content` NULL: it is not said, or was looked at before. */
static result_t check_wanted(pool_t *pool, uint64_t id, const hash_t *content)
{
    const relay_job_t *job = pool_find_job(pool, id);
    if (job == NULL)
        return result_fail(RESULT_INPUT, "this relay has no job %llu now", (unsigned long long)id);
    if (content != NULL && !hash_equal(content, &job->content))
        return result_fail(RESULT_INPUT, "job %llu is another one than the batch was rendered for",
                           (unsigned long long)id);
    if (job->over && !job->flush)
        return result_fail(RESULT_CANCELLED, "job %llu is over", (unsigned long long)id);
    return result_ok();
}

static result_t wanted(void *self, double now, const batch_offer_t *offer)
{
    pool_t *pool = self;
    pool_lock(pool);
    result_t result = unknown_worker();
    member_t *member = pool_find_member(pool, offer->worker);
    if (member != NULL) {
        result = check_wanted(pool, offer->job, offer->named ? &offer->content : NULL);
        bool waits = result.code == RESULT_OK && member->granted <= 0 && units_of(pool, member->id) > 0;
        if (waits) member->delivered = now; /* as good as: it is we who make it wait */
    }
    if (result.code == RESULT_OK && pool_bytes(pool) >= pool_bytes_limit(pool))
        result = result_fail(RESULT_LIMIT, "the relay waits for its master");
    pool_unlock(pool);
    return result;
}

static result_t offered(void *self, double now, const batch_offer_t *offer)
{
    result_t result = wanted(self, now, offer);
    return result.code == RESULT_LIMIT ? result_ok() : result; /* it can wait */
}

static void granted(void *self, double now, uint64_t worker)
{
    pool_t *pool = self;
    pool_lock(pool);
    member_t *member = pool_find_member(pool, worker);
    if (member != NULL && member->granted <= 0) member->granted = now;
    pool_unlock(pool);
}

/* The parcel that a batch is to be added to: the open one, or a new one when that would get too many units.
 */
static parcel_t *parcel_for(pool_t *pool, double now, relay_job_t *job, size_t units)
{
    pool_lock(pool);
    parcel_t **last = &job->parcels;
    while (*last != NULL && (*last)->next != NULL) last = &(*last)->next;
    if (*last != NULL && (*last)->units + units > PARCEL_MAX_UNITS) last = &(*last)->next;
    if (*last == NULL) {
        *last = mem_zalloc(1, sizeof **last);
        (*last)->sum = sum_new(&job->settings);
        (*last)->since = now;
    }
    parcel_t *parcel = *last;
    parcel->units += units;
    pool_unlock(pool);
    return parcel;
}

static void add_to_parcel(pool_t *pool, double now, relay_job_t *job, const addend_t *addend)
{
    pthread_rwlock_rdlock(&job->adding);
    parcel_t *parcel = parcel_for(pool, now, job, addend->batch.unit_count);
    size_t bytes = sum_add(parcel->sum, addend);
    pool_lock(pool);
    if (bytes > parcel->bytes) parcel->bytes = bytes;
    pool_unlock(pool);
    pthread_rwlock_unlock(&job->adding);
}

/* A batch that bears a number is kept as it is. It must have exactly the units of the check. Lock held; the
 * batch is taken over. */
static result_t keep_check(relay_job_t *job, uint64_t number, batch_t *batch)
{
    for (size_t i = 0; i < job->check_count; i++) {
        relay_check_t *check = job->checks[i];
        if (check->number != number || check->done) continue;
        if (!units_same(check->units, check->count, batch->units, batch->unit_count))
            return result_fail(RESULT_MISMATCH, "a check has other units than its assignment");
        check->batch = *batch;
        *batch = (batch_t){0};
        check->done = true;
        return result_ok();
    }
    return result_fail(RESULT_MISMATCH, "nobody asked for this check");
}

/* Decides over a batch that was read: with *add it is to be added. A worker that is not (or no more) of this
 * relay may make other bits than those that are. Lock held. */
static result_t accept(pool_t *pool, relay_job_t *job, const incoming_batch_t *incoming, batch_t *batch,
                       bool *add)
{
    *add = false;
    if (pool_find_member(pool, incoming->worker) == NULL) return unknown_worker();
    if (job->gone || (job->over && !job->flush)) return result_fail(RESULT_CANCELLED, "the job is over");
    if (incoming->check != 0) return keep_check(job, incoming->check, batch);
    TRY(ledger_accept(&job->ledger, batch->units, batch->unit_count));
    *add = true;
    return result_ok();
}

static void after_batch(pool_t *pool, double now, relay_job_t *job, uint64_t worker)
{
    member_t *member = pool_find_member(pool, worker);
    if (member != NULL) {
        member->delivered = now;
        member->last_seen = fmax(member->last_seen, now);
    }
    job->delivered = true;
    if (job->flush) flushed(pool, job, worker);
    wake_up(pool->options.bulk_wake);
}

/* The job that a batch is for, which is used from here on; NULL when it is not wanted, for the reason in
 * *why. */
static relay_job_t *hold_job(pool_t *pool, const incoming_batch_t *incoming, job_settings_t *settings,
                             unit_mac_t *mac, result_t *why)
{
    pool_lock(pool);
    *why = unknown_worker();
    const member_t *member = pool_find_member(pool, incoming->worker);
    if (member != NULL) *why = check_wanted(pool, incoming->job, incoming->content);
    relay_job_t *job = why->code == RESULT_OK ? pool_find_job(pool, incoming->job) : NULL;
    if (job != NULL) {
        *settings = job->settings;
        *mac = mac_for(pool, member, job, incoming->check);
        job->users++;
    }
    pool_unlock(pool);
    return job;
}

/* Takes over a batch and reads it, if all of it was issued to who sends it. */
static result_t read_batch(const pool_t *pool, const incoming_batch_t *incoming,
                           const job_settings_t *settings, const unit_mac_t *mac, addend_t *addend)
{
    batch_t *batch = incoming->batch;
    result_t result = unit_mac_check(mac, batch->units, incoming->issues, batch->unit_count);
    if (result.code == RESULT_OK)
        return sum_read(batch, incoming->payload, settings, pool_bytes_limit(pool), addend);
    *addend = (addend_t){.batch = *batch};
    *batch = (batch_t){0};
    if (job_check_units(settings, addend->batch.units, addend->batch.unit_count).code != RESULT_OK)
        addend->batch.unit_count = 0; /* nobody holds what is not of the job */
    return result;
}

static result_t add(void *self, double now, const incoming_batch_t *incoming)
{
    pool_t *pool = self;
    job_settings_t settings;
    unit_mac_t mac;
    addend_t addend;
    bool adds = false;
    result_t result;
    relay_job_t *job = hold_job(pool, incoming, &settings, &mac, &result);
    if (job == NULL) return result;
    result = read_batch(pool, incoming, &settings, &mac, &addend);
    if (result.code == RESULT_OK && incoming->check != 0)
        result = payload_decode(incoming->payload, &addend.batch);
    pool_lock(pool);
    if (result.code == RESULT_OK) result = accept(pool, job, incoming, &addend.batch, &adds);
    job->merging += adds;
    pool_unlock(pool);
    if (adds) add_to_parcel(pool, now, job, &addend);
    pool_lock(pool);
    job->merging -= adds;
    member_t *member = pool_find_member(pool, incoming->worker);
    if (member != NULL) member->granted = 0;
    if (result.code == RESULT_OK)
        after_batch(pool, now, job, incoming->worker);
    else
        ledger_return_units(&job->ledger, incoming->worker, addend.batch.units, addend.batch.unit_count);
    job->users--;
    pool_notify_idle(pool);
    pool_unlock(pool);
    batch_free(&addend.batch);
    if (result.code == RESULT_LIMIT) result.code = RESULT_MISMATCH; /* that is decided */
    return result;
}

/* ---- scenes -------------------------------------------------------------------------------------------- */

static relay_job_t *job_with_blob(pool_t *pool, const hash_t *hash)
{
    for (size_t i = 0; i < pool->job_count; i++)
        if (pool->jobs[i]->loaded && hash_equal(&pool->jobs[i]->blob_hash, hash)) return pool->jobs[i];
    return NULL;
}

/* Likewise, a plan; *size is its bytes. */
static relay_job_t *job_with_plan(const pool_t *pool, const hash_t *hash, const uint8_t **bytes, size_t *size)
{
    for (size_t i = 0; i < pool->job_count; i++)
        for (uint32_t pass = 0; pass < LEARNING_PASSES; pass++) {
            relay_job_t *job = pool->jobs[i];
            if (job->gone || job->plan_bytes[pass] == NULL || !hash_equal(&job->plans[pass], hash)) continue;
            *bytes = job->plan_bytes[pass];
            *size = learning_plan_bytes();
            return job;
        }
    return NULL;
}

/* The job that has some blob, scene or plan, and its bytes. */
static relay_job_t *find_blob(pool_t *pool, const hash_t *hash, const uint8_t **bytes, size_t *size)
{
    relay_job_t *job = job_with_blob(pool, hash);
    if (job == NULL) return job_with_plan(pool, hash, bytes, size);
    *bytes = job->blob.bytes;
    *size = job->blob.size;
    return job;
}

static result_t blob_size(void *self, const hash_t *hash, uint64_t *size)
{
    pool_t *pool = self;
    const uint8_t *bytes;
    size_t length = 0;
    pool_lock(pool);
    const relay_job_t *job = find_blob(pool, hash, &bytes, &length);
    *size = length;
    pool_unlock(pool);
    return job != NULL ? result_ok() : result_fail(RESULT_INPUT, "this relay does not have the blob now");
}

static result_t blob_read(void *self, const hash_t *hash, uint64_t offset, void *bytes, size_t length)
{
    pool_t *pool = self;
    pool_lock(pool);
    const uint8_t *from;
    size_t size;
    relay_job_t *job = find_blob(pool, hash, &from, &size);
    if (job != NULL) job->users++;
    pool_unlock(pool);
    if (job == NULL) return result_fail(RESULT_INPUT, "this relay does not have the blob now");
    memcpy(bytes, from + offset, length);
    pool_lock(pool);
    job->users--;
    pool_unlock(pool);
    return result_ok();
}

serve_handler_t pool_serve(pool_t *pool)
{
    static const serve_calls_t calls = {.hello = hello_from,
                                        .heartbeat = heartbeat,
                                        .goodbye = goodbye,
                                        .claim = claim_units,
                                        .take = take,
                                        .next_notice = next_notice,
                                        .tick = pool_tick,
                                        .reached = reached,
                                        .offered = offered,
                                        .wanted = wanted,
                                        .granted = granted,
                                        .add = add,
                                        .blob_size = blob_size,
                                        .blob_read = blob_read};
    return (serve_handler_t){&calls, pool};
}
