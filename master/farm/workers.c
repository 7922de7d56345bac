/* workers: who works for the farm (see farm.h). What they are given is in take.c; what becomes of
 * those who fail, and of the units that they had, in trust/standing.c and trust/suspects.c. */
#include "master/farm/parts.h"

#include <math.h>
#include <sodium.h>
#include <stdio.h>
#include <string.h>

enum {
    UNTOLD_SECONDS = 60,
    FORGET_SECONDS = 3600,     /* that a worker which is gone stays on the list, */
    FORGET_IDLE_SECONDS = 300, /* and one which never delivered anything */
    REMARK_SECONDS = 1,        /* between two looks at what is to be said of jobs */
    TROUBLE_SECONDS = 30       /* between two lines in the log on what hinders one worker */
};

void farm_count_reissued(job_t *job, worker_t *worker, size_t units)
{
    job->kept.units_reissued += units;
    if (worker != NULL) worker->units_reissued += units;
}

/* ---- what a worker holds ------------------------------------------------------------------------------- */

size_t farm_worker_take_back(farm_t *farm, double now, worker_t *worker)
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
        trust_released(farm, now, job, worker->id);
        total += units;
    }
    worker->held = 0;
    worker->quarantine = 0;
    return total;
}

/* True when a line about a worker that comes or goes may be written: a process that does nothing else must
 * not fill the log. */
static bool may_tell(farm_t *farm, double now, const worker_t *worker)
{
    rate_verdict_t verdict = rate_limit_take(farm->comings, now, &worker->party, sizeof worker->party, 1);
    if (verdict == RATE_TELL)
        log_warning("workers of %s come and go all the time: not every line about it is written",
                    worker->party_text);
    farm->untold += verdict != RATE_PASS;
    return verdict == RATE_PASS;
}

/* Says how many lines were left out, once a minute. */
static void tell_untold(farm_t *farm, double now)
{
    if (farm->untold == 0) farm->untold_since = now;
    if (now - farm->untold_since < UNTOLD_SECONDS) return;
    log_info("workers have come and gone %llu times more than was written", (unsigned long long)farm->untold);
    farm->untold = 0;
}

static void disconnect(farm_t *farm, double now, worker_t *worker, const char *why)
{
    size_t units = farm_worker_take_back(farm, now, worker);
    trust_left(farm, worker);
    worker->connected = false;
    if (may_tell(farm, now, worker))
        log_info("worker %s %s; %zu units go back; it sent %llu batches (%llu refused), %.1f MB",
                 worker->name, why, units, (unsigned long long)worker->batches,
                 (unsigned long long)worker->batches_refused, 1e-6 * (double)worker->bytes);
    farm_notify_idle(farm);
}

void farm_cast_out(farm_t *farm, double now)
{
    for (size_t i = 0; farm->cast_out && i < farm->worker_count; i++)
        if (farm->workers[i].outcast && farm->workers[i].connected)
            disconnect(farm, now, &farm->workers[i], "is put aside");
    farm->cast_out = false;
}

/* True when two are one process: a machine that starts a new one under the same name (a container does) has
 * lost the one before. */
static bool is_same_process(const worker_t *a, const worker_t *b)
{
    return a->source == b->source && a->process == b->process;
}

/* True when the process is connected under another number: it lost its connection, not its life. */
static bool is_back(const farm_t *farm, const worker_t *worker)
{
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *other = &farm->workers[i];
        if (other != worker && other->connected && is_same_process(other, worker) &&
            other->joined > worker->last_seen)
            return true;
    }
    return false;
}

void farm_worker_fall(farm_t *farm, double now, worker_t *worker)
{
    char why[FARM_MAX_NAME];
    bool back = is_back(farm, worker);
    snprintf(why, sizeof why, "was silent for %.1f s and is given up", now - worker->last_seen);
    trust_died(farm, now, worker, back);
    disconnect(farm, now, worker, why);
    worker->fell = !back;
    farm_cast_out(farm, now);
}

/* ---- coming and going ---------------------------------------------------------------------------------- */

worker_t *farm_worker_hear(farm_t *farm, double now, const identity_t *identity, uint64_t id)
{
    worker_t *worker = farm_find_worker(farm, id);
    if (worker != NULL && worker->fell) {
        trust_lives(farm, worker);
        worker->fell = false;
    }
    if (worker == NULL || !worker->connected) return NULL;
    worker->last_seen = now;
    worker->identity = *identity;
    return worker;
}

/* The place of one more worker: the lost one that was heard of longest ago is forgotten. SIZE_MAX when too
 * many are connected. */
static size_t worker_place(const farm_t *farm)
{
    size_t connected = 0, oldest = SIZE_MAX;
    if (farm->worker_count < FARM_MAX_WORKERS) return farm->worker_count;
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        connected += worker->connected;
        if (worker->connected) continue;
        if (oldest == SIZE_MAX || worker->last_seen < farm->workers[oldest].last_seen) oldest = i;
    }
    if (connected >= FARM_MAX_WORKERS) return SIZE_MAX;
    return farm->worker_count - connected < FARM_MAX_WORKERS ? farm->worker_count : oldest;
}

static worker_t *worker_add(farm_t *farm, const worker_t *joins)
{
    size_t at = worker_place(farm);
    if (at == SIZE_MAX) return NULL;
    if (at == farm->worker_count)
        farm->workers = mem_realloc(farm->workers, ++farm->worker_count * sizeof *farm->workers);
    else
        id_table_remove(&farm->by_id, farm->workers[at].id);
    worker_t *worker = &farm->workers[at];
    *worker = *joins;
    while (worker->id == 0) randombytes_buf(&worker->id, sizeof worker->id);
    id_table_put(&farm->by_id, worker->id, at);
    return worker;
}

static void forget(farm_t *farm, size_t at)
{
    size_t last = --farm->worker_count;
    id_table_remove(&farm->by_id, farm->workers[at].id);
    if (at == last) return;
    farm->workers[at] = farm->workers[last];
    id_table_put(&farm->by_id, farm->workers[at].id, at);
}

/* Forgets the workers that are gone, after a while; those that are put aside stay on the list until they no
 * longer are. Returns how many. */
static size_t forget_gone(farm_t *farm, double now, double after, double after_idle)
{
    size_t count = 0;
    for (size_t i = farm->worker_count; i-- > 0;) {
        const worker_t *worker = &farm->workers[i];
        double patience = worker->batches > 0 ? after : after_idle;
        if (worker->connected || now - worker->last_seen < patience) continue;
        if (trust_reason(farm, now, worker) != NULL) continue;
        forget(farm, i);
        count++;
    }
    return count;
}

size_t farm_purge(farm_t *farm, double now)
{
    farm_lock(farm);
    size_t count = forget_gone(farm, now, 0, 0);
    farm_unlock(farm);
    return count;
}

/* ---- draining ------------------------------------------------------------------------------------------ */

static void drain(farm_t *farm, worker_t *worker)
{
    worker->drained = true;
    farm_notify_leave(farm, worker->id);
}

size_t farm_drain(farm_t *farm, const char *wanted)
{
    size_t count = 0;
    farm_lock(farm);
    for (size_t i = 0; i < farm->worker_count; i++) {
        worker_t *worker = &farm->workers[i];
        if (!worker->connected || !wire_worker_is(worker->name, wanted)) continue;
        log_info("worker %s is drained: it delivers what it has, and leaves", worker->name);
        drain(farm, worker);
        count++;
    }
    farm_unlock(farm);
    return count;
}

/* The process lost its connection, or missed the notice: it is to leave all the same. */
static bool was_drained(const farm_t *farm, const worker_t *joins)
{
    for (size_t i = 0; i < farm->worker_count; i++)
        if (farm->workers[i].drained && is_same_process(&farm->workers[i], joins) &&
            farm->workers[i].id != joins->id)
            return true;
    return false;
}

/* ---- coming -------------------------------------------------------------------------------------------- */

static uint32_t most_threads(const worker_t *worker)
{
    return worker->relay ? FARM_RELAY_THREADS : FARM_WORKER_THREADS;
}

/* A claim of very many would decide alone which bits jobs are made of, and how they share the farm. */
static result_t check_threads(const worker_t *worker)
{
    if (worker->threads <= most_threads(worker)) return result_ok();
    return result_fail(RESULT_LIMIT, "%s %.80s says that it has %u threads, and this master takes %u at most",
                       worker->relay ? "relay" : "worker", worker->name, worker->threads,
                       most_threads(worker));
}

static worker_t make_worker(double now, const identity_t *identity, const worker_hello_t *hello)
{
    worker_t worker = {.identity = *identity,
                       .threads = hello->threads > 0 ? hello->threads : 1,
                       .fingerprint = hello->fingerprint,
                       .process = hello->process,
                       .relay = hello->relay,
                       .connected = true,
                       .joined = now,
                       .last_seen = now,
                       .asked = now,
                       .wanted = now};
    /* Those who do not say make a group of their own. */
    if (hash_is_zero(&worker.fingerprint)) memset(&worker.fingerprint, 0xFF, sizeof worker.fingerprint);
    snprintf(worker.name, sizeof worker.name, "%s", hello->name[0] != '\0' ? hello->name : "(no name)");
    snprintf(worker.key, sizeof worker.key, "%s", hello->key);
    snprintf(worker.address, sizeof worker.address, "%s", hello->address != NULL ? hello->address : "");
    return worker;
}

/* A connection that says hello again has one number, the new one, unless work is bound to the old one. Else
 * one that does nothing else would fill the list. */
static void supersede(farm_t *farm, double now, const identity_t *identity)
{
    for (size_t i = 0; identity->size > 0 && i < farm->worker_count; i++) {
        worker_t *worker = &farm->workers[i];
        bool same = worker->identity.size == identity->size &&
                    memcmp(worker->identity.bytes, identity->bytes, identity->size) == 0;
        if (same && worker->connected && worker->batches == 0 && farm_worker_units(farm, worker) == 0)
            disconnect(farm, now, worker, "says hello again");
    }
}

result_t farm_hello(farm_t *farm, double now, const identity_t *identity, const worker_hello_t *hello,
                    uint64_t *id)
{
    worker_t joins = make_worker(now, identity, hello);
    farm_lock(farm);
    result_t result = check_threads(&joins);
    if (result.code == RESULT_OK) result = trust_admit(farm, now, &joins);
    if (result.code == RESULT_OK) supersede(farm, now, identity);
    worker_t *worker = result.code == RESULT_OK ? worker_add(farm, &joins) : NULL;
    if (result.code == RESULT_OK && worker == NULL)
        result = result_fail(RESULT_LIMIT, "this master has %d workers already", FARM_MAX_WORKERS);
    if (result.code == RESULT_OK) {
        *id = worker->id;
        if (was_drained(farm, worker)) drain(farm, worker);
        char bits[2 * HASH_BYTES + 1];
        hash_to_hex(&worker->fingerprint, bits);
        if (may_tell(farm, now, worker))
            log_info("%s %s joins with %u threads, bits %.8s, %s", worker->relay ? "relay" : "worker",
                     worker->name, worker->threads, bits, worker->party_text);
    }
    farm_unlock(farm);
    return result;
}

/* An assignment may be lost on its way (what is damaged is dropped), though the line does not break. Where
 * there is no other worker that would be given the units one day, nothing else brings them back. */
static void look_for_lost_units(farm_t *farm, double now, worker_t *worker, uint32_t units_held)
{
    if (units_held > 0 || farm_worker_units(farm, worker) == 0) {
        worker->empty = 0;
    } else if (worker->empty == 0) {
        worker->empty = now;
    } else if (now - worker->empty > farm->options.lease) {
        size_t units = farm_worker_take_back(farm, now, worker);
        log_warning("worker %s holds nothing of %zu units that it was given: they go back", worker->name,
                    units);
        worker->empty = 0;
        farm_notify_idle(farm);
    }
}

bool farm_heartbeat(farm_t *farm, double now, const identity_t *identity, uint64_t id, uint64_t job,
                    uint32_t units_held)
{
    farm_lock(farm);
    worker_t *worker = farm_worker_hear(farm, now, identity, id);
    if (worker != NULL) {
        worker->job = job;
        for (size_t i = 0; units_held == 0 && i < farm->job_count; i++)
            if (farm->jobs[i]->flush_until > 0) farm_job_flushed(farm, now, farm->jobs[i], id);
        look_for_lost_units(farm, now, worker, units_held);
    }
    farm_unlock(farm);
    return worker != NULL;
}

result_t farm_worker_reached(farm_t *farm, double now, uint64_t id)
{
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, id);
    bool known = worker != NULL && worker->connected;
    if (known) {
        worker->reached = true;
        worker->last_seen = now;
    }
    farm_unlock(farm);
    if (known) return result_ok();
    return result_fail(RESULT_UNREACHABLE, "this master does not know the worker: say hello again");
}

/* The words are the worker's own, which may change them at will: that must not fill the log. */
static void hear_trouble(double now, worker_t *worker, const char *trouble)
{
    bool news = strncmp(worker->trouble, trouble, FARM_MAX_TROUBLE) != 0;
    if (news) snprintf(worker->trouble, sizeof worker->trouble, "%s", trouble);
    worker->told = worker->told && !news;
    bool due = worker->troubled <= 0 || now - worker->troubled > TROUBLE_SECONDS;
    if (worker->told || worker->trouble[0] == '\0' || !due) return;
    log_warning("worker %s at %s gets no work: %s", worker->name,
                worker->address[0] != '\0' ? worker->address : "this machine", worker->trouble);
    worker->told = true;
    worker->troubled = now;
}

void farm_worker_trouble(farm_t *farm, double now, uint64_t id, const char *trouble)
{
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, id);
    if (worker != NULL && worker->connected) hear_trouble(now, worker, trouble);
    farm_unlock(farm);
}

void farm_worker_threads(farm_t *farm, uint64_t id, uint32_t threads)
{
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, id);
    if (worker != NULL && threads > 0)
        worker->threads = threads < most_threads(worker) ? threads : most_threads(worker);
    farm_unlock(farm);
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
        disconnect(farm, now, worker, why);
        if (held) farm_declined(farm, now, job, worker, reason);
    }
    farm_unlock(farm);
}

/* Under the lock. */
static void reclaim(farm_t *farm, double now, worker_t *worker, job_t *job, const unit_t *units, size_t count)
{
    if (farm_worker_units(farm, worker) == 0) worker->delivered = now;
    worker->empty = 0;
    for (size_t i = 0; i < count; i++)
        if (schedule_issue(job->schedule, worker->id, &units[i]))
            worker->held += farm_unit_samples(job, &units[i], 1);
}

/* True when the claim is of units that were issued to who makes it. */
static bool was_issued(farm_t *farm, const claim_t *claim)
{
    unit_mac_t mac;
    farm_lock(farm);
    const worker_t *worker = farm_find_worker(farm, claim->worker);
    const job_t *job = farm_find_job(farm, claim->job);
    bool known = worker != NULL && worker->connected && job != NULL &&
                 farm_content_fits(job, claim->content) &&
                 job_check_units(&job->kept.settings, claim->units, claim->unit_count).code == RESULT_OK;
    if (known) mac = farm_unit_mac(farm, worker, job, 0);
    farm_unlock(farm);
    return known && unit_mac_check(&mac, claim->units, claim->issues, claim->unit_count).code == RESULT_OK;
}

void farm_reclaim(farm_t *farm, double now, const claim_t *claim)
{
    if (claim->unit_count == 0 || !was_issued(farm, claim)) return;
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, claim->worker);
    job_t *job = farm_find_job(farm, claim->job);
    if (worker != NULL && worker->connected && job != NULL && farm_bits_fit(job, &worker->fingerprint)) {
        if (job->kept.state == JOB_QUEUED) farm_job_start(farm, now, job); /* it had begun before */
        if (job->film == FILM_OPEN) reclaim(farm, now, worker, job, claim->units, claim->unit_count);
    }
    farm_unlock(farm);
}

/* ---- what is known of them ----------------------------------------------------------------------------- */

static worker_report_t report_worker(const farm_t *farm, double now, const worker_t *worker)
{
    worker_report_t report = {.number = worker->id,
                              .threads = worker->threads,
                              .fingerprint = worker->fingerprint,
                              .relay = worker->relay,
                              .connected = worker->connected,
                              .job = worker->connected ? worker->job : 0,
                              .units_held = worker->connected ? (uint32_t)farm_worker_units(farm, worker) : 0,
                              .speed = worker->speed,
                              .batches = worker->batches,
                              .batches_refused = worker->batches_refused,
                              .units_reissued = worker->units_reissued,
                              .bytes = worker->bytes,
                              .last_seen = fmax(now - worker->last_seen, 0)};
    const char *aside = trust_reason(farm, now, worker);
    if (aside == NULL && worker->connected && worker->drained)
        aside = "drained: it delivers what it has, and leaves";
    snprintf(report.name, sizeof report.name, "%s", worker->name);
    snprintf(report.key, sizeof report.key, "%s", worker->key);
    snprintf(report.address, sizeof report.address, "%s", worker->address);
    snprintf(report.aside, sizeof report.aside, "%.*s", FARM_MAX_NAME,
             aside != NULL ? aside : worker->trouble);
    return report;
}

worker_report_t *farm_worker_report(farm_t *farm, double now, size_t *count)
{
    farm_lock(farm);
    worker_report_t *reports =
        farm->worker_count > 0 ? mem_alloc(farm->worker_count * sizeof *reports) : NULL;
    *count = 0;
    for (int connected = 1; connected >= 0; connected--)
        for (size_t i = 0; i < farm->worker_count; i++)
            if (farm->workers[i].connected == connected)
                reports[(*count)++] = report_worker(farm, now, &farm->workers[i]);
    farm_unlock(farm);
    return reports;
}

/* ---- time ---------------------------------------------------------------------------------------------- */

uint32_t farm_fitting_threads(const farm_t *farm, const job_t *job)
{
    uint32_t threads = 0;
    for (size_t i = 0; i < farm->worker_count; i++)
        if (farm->workers[i].connected && farm_bits_fit(job, &farm->workers[i].fingerprint))
            threads += farm->workers[i].threads;
    return threads;
}

/* What is to be known of a job that goes on. */
static void remark_job(farm_t *farm, double now, job_t *job)
{
    if (job->film != FILM_OPEN || job->milestone == IMAGE_FAILED) return;
    job->remark[0] = '\0';
    if (job->kept.state == JOB_PAUSED) return;
    farm_unbind(farm, job);
    if (!hash_is_zero(&job->kept.fingerprint) && farm_fitting_threads(farm, job) == 0) {
        char bits[2 * HASH_BYTES + 1];
        hash_to_hex(&job->kept.fingerprint, bits);
        uint32_t connected = 0;
        for (size_t i = 0; i < farm->worker_count; i++) connected += farm->workers[i].connected;
        snprintf(job->remark, sizeof job->remark,
                 "waits for a machine that makes the same bits (%.8s); %u workers that make others are "
                 "connected",
                 bits, connected);
    }
    char more[sizeof job->remark];
    for (int part = 0; part < 3; part++) {
        if (part == 0) farm_decline_remark(job, more, sizeof more);
        if (part == 1) suspects_remark(job, more, sizeof more);
        if (part == 2) checks_remark(farm, now, job, more, sizeof more);
        farm_add_remark(job->remark, sizeof job->remark, more);
    }
}

/* Jobs that may be complete now, though nothing was delivered. Lets the lock go meanwhile. */
static void progress(farm_t *farm, double now)
{
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (!job->progress_due || job->merging > 0) continue;
        job->progress_due = false;
        farm_job_progress(farm, now, job);
        i = SIZE_MAX; /* jobs may have come and gone */
    }
}

void farm_workers_tick(farm_t *farm, double now)
{
    trust_tick(farm, now);
    farm_cast_out(farm, now);
    tell_untold(farm, now);
    if (now - farm->remarked >= REMARK_SECONDS || now < farm->remarked) {
        for (size_t i = 0; i < farm->job_count; i++) remark_job(farm, now, farm->jobs[i]);
        farm->remarked = now;
        forget_gone(farm, now, FORGET_SECONDS, FORGET_IDLE_SECONDS);
    }
    progress(farm, now);
}
