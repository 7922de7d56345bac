/* take: what workers are given, and what is given to others instead (see farm.h).
 *
 * DESIGN. How long a worker will take for what it holds is told from what it has delivered of the same job in
 * the last minute: pixel samples a second.
 *
 * A worker is given no more than its window lets it hold (trust/window.c). As long as there are free units,
 * nobody is hurried, and only a worker whose batches are long on their way gets none of the last ones, when
 * others would have rendered all before it had delivered. But when somebody has nothing to do, others lose
 * units to it in two cases. A worker that has delivered nothing for longer than trust_patience loses what it
 * holds (it hangs, or never meant to deliver). And at the end of a job, or of a round that others wait for, a
 * worker loses what it holds when the idle one is expected to be done with all of it in less than half of the
 * time that the holder is expected to take from now. (One that is late by so many seconds is expected to take
 * as many again.) The first result wins; the factor of two keeps units from going to and fro between equals.
 * Who is overtaken before it has delivered anything may never mean to: it counts as late (trust_lapsed).
 *
 * At the end of a pass (common/film/learning.h) nobody is overtaken who is expected to deliver soon. It comes
 * when workers hold a second of work each, and most of what is missing is on its way: hundreds of idle
 * workers would render it again, and each that comes second loses a batch.
 *
 * A batch counts whole or not at all, so whoever comes second loses what else is in its batch. That is why
 * not some of a straggler's units are taken, but all.
 *
 * The bits: a job belongs to the machines that make the same bits as its first counted batch. Before there is
 * one, the kind that has most threads is given units, of those workers that deliver what they are given. If
 * kinds overtake each other, several have units of it; the first batch decides, and the others lose theirs.
 * When nothing of it is counted any more, it is bound to nobody. A mixed job takes everybody, and says so
 * when the bits that were counted do differ. */
#include "master/farm/parts.h"

#include <math.h>
#include <string.h>

enum {
    OFFER_SECONDS = 30, /* for which a worker that has offered a batch is left alone: we make it wait, */
    GRANT_SECONDS = 60, /* until so long after it was first let send it, however often it offers it again, */
    HURRY_GRANT = 2,    /* or only so long when somebody is idle who would be sooner: its link is thin */
    SOON_BATCHES = 2,   /* batch intervals in which others have to deliver at the end of a pass */
    GAP_BATCHES = 12,   /* batch intervals that may lie between two batches, as far as patience goes */
    MAX_KINDS = 32      /* kinds of bits that are told apart */
};
static const double UNIT_SECONDS = 0.4;  /* of one thread, in what a worker calls a good unit */
static const double GAP_DECAY = 0.7;     /* a batch, of the longest time between two, and on the way */
static const double SILENT_LEASES = 0.4; /* after which a worker may be dead, and is left to its lease */
static const double SPEED_SECONDS = 60;  /* over which the speed is measured, roughly */
static const double HURRY = 2;           /* by what factor an idle worker has to be sooner, */
static const double HURRY_SECONDS = 1;   /* and by what time beside */
static const double THIN_SECONDS = 1;    /* for a batch to come, from which on a link is thin */

/* ---- the bits of a job --------------------------------------------------------------------------------- */

/* A kind of connected workers. */
typedef struct {
    const worker_t *one;
    uint64_t threads;
} kind_t;

/* The kinds of workers that ask for work, without those who were given units and did not deliver; returns how
 * many. (Who asks for none, or has not asked for long, keeps no job from others.) */
static size_t list_kinds(const farm_t *farm, double now, kind_t kinds[MAX_KINDS])
{
    size_t count = 0;
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        size_t k = 0;
        bool wants = worker->wanted >= now - farm_patience(farm, FARM_ASK_BATCHES);
        if (worker->lapsed || !worker->connected || !worker->reached || !wants) continue;
        while (k < count && !hash_equal(&kinds[k].one->fingerprint, &worker->fingerprint)) k++;
        if (k == MAX_KINDS) continue;
        if (k == count) kinds[count++] = (kind_t){.one = worker};
        kinds[k].threads += worker->threads;
    }
    return count;
}

const worker_t *farm_largest_kind(const farm_t *farm, double now)
{
    kind_t kinds[MAX_KINDS];
    size_t count = list_kinds(farm, now, kinds), largest = 0;
    for (size_t k = 1; k < count; k++)
        if (kinds[k].threads > kinds[largest].threads) largest = k;
    return count > 0 ? kinds[largest].one : NULL;
}

/* True when no other kind of workers has more threads. */
static bool in_largest_kind(const farm_t *farm, double now, const worker_t *worker)
{
    kind_t kinds[MAX_KINDS];
    size_t count = list_kinds(farm, now, kinds);
    uint64_t most = 0, own = 0;
    for (size_t k = 0; k < count; k++) {
        if (kinds[k].threads > most) most = kinds[k].threads;
        if (hash_equal(&kinds[k].one->fingerprint, &worker->fingerprint)) own = kinds[k].threads;
    }
    return own >= most;
}

/* Whether a worker may have units of a job at all. */
static bool may_work(const worker_t *worker, const job_t *job)
{
    if (worker->quarantine != 0 && worker->quarantine != job->kept.job)
        return false; /* it waits for units of another one */
    if (farm_has_declined(job, worker, worker->asked)) return false;
    if (!farm_bits_fit(job, &worker->fingerprint)) return false;
    bool begins = !job->kept.terms.mixed && hash_is_zero(&job->kept.fingerprint);
    return !begins || worker->begins;
}

/* Who holds units of the job and makes other bits loses them, and is told so. */
static void dismiss_others(farm_t *farm, double now, job_t *job)
{
    for (size_t i = 0; i < farm->worker_count && job->schedule != NULL; i++) {
        worker_t *worker = &farm->workers[i];
        if (schedule_held(job->schedule, worker->id) == 0 || farm_bits_fit(job, &worker->fingerprint))
            continue;
        farm_count_reissued(job, worker, schedule_release(job->schedule, worker->id));
        trust_released(farm, now, job, worker->id);
        farm_notify(farm, worker->id, job->kept.job, false);
    }
}

void farm_bind(farm_t *farm, double now, job_t *job, const hash_t *fingerprint)
{
    char bits[2 * HASH_BYTES + 1];
    hash_to_hex(fingerprint, bits);
    log_info("job %llu is made of the bits %.8s", (unsigned long long)job->kept.job, bits);
    job->kept.fingerprint = *fingerprint;
    dismiss_others(farm, now, job);
    farm_record_changed(farm, job);
    farm_notify_idle(farm);
}

void farm_unbind(farm_t *farm, job_t *job)
{
    if (job->film != FILM_OPEN || job->merging > 0 || schedule_done(job->schedule) > 0 ||
        hash_is_zero(&job->kept.fingerprint))
        return;
    job->kept.fingerprint = (hash_t){{0}};
    job->several_bits = false;
    farm_record_changed(farm, job);
    farm_notify_idle(farm);
}

void farm_note_bits(farm_t *farm, double now, job_t *job, const worker_t *worker)
{
    if (hash_equal(&job->kept.fingerprint, &worker->fingerprint)) return;
    if (hash_is_zero(&job->kept.fingerprint)) {
        farm_bind(farm, now, job, &worker->fingerprint);
    } else if (!job->several_bits) {
        job->several_bits = true;
        static const char note[] = "its last bits depend on which machine rendered what, since they differ";
        if (strstr(job->kept.message, note) == NULL) farm_job_tell(farm, job, "%s", note);
        log_warning("job %llu: %s", (unsigned long long)job->kept.job, note);
    }
}

/* ---- speed ------------------------------------------------------------------------------- */

void farm_worker_relieved(farm_t *farm, worker_t *worker)
{
    bool waits = worker->quarantine != 0 && farm_worker_units(farm, worker) == 0;
    if (!waits && !worker->limited) return;
    worker->limited = false;
    worker->idle = true;
    farm_notify_idle(farm);
}

void farm_worker_delivered(farm_t *farm, double now, worker_t *worker, job_t *job, const unit_t *units,
                           size_t count)
{
    double samples = farm_unit_samples(job, units, count), seconds = now - worker->delivered;
    if (worker->speed_job != job->kept.job) worker->rated_samples = worker->rated_seconds = 0;
    double decay = exp(-fmax(seconds, 0) / SPEED_SECONDS);
    worker->rated_samples = worker->rated_samples * decay + samples;
    worker->rated_seconds = worker->rated_seconds * decay + fmax(seconds, 0);
    worker->speed = worker->rated_seconds > 0 ? worker->rated_samples / worker->rated_seconds : 0;
    worker->speed_job = job->kept.job;
    worker->gap = fmin(fmax(seconds, GAP_DECAY * worker->gap), GAP_BATCHES * farm->options.batch_interval);
    double transfer = worker->granted > 0 ? now - worker->granted : 0;
    worker->transfer = fmax(transfer, GAP_DECAY * worker->transfer);
    worker->delivered = now;
    worker->offered = worker->granted = 0;
    worker->held = farm_worker_units(farm, worker) > 0 ? fmax(worker->held - samples, 0) : 0;
    trust_delivered(farm, now, worker, job, units, count);
    farm_worker_relieved(farm, worker);
}

/* Seconds from now until a worker is expected to have delivered what it holds. (When there is no more work,
 * it does not wait for its batch interval.) */
static double expected(const farm_t *farm, double now, const worker_t *worker)
{
    double elapsed = now - worker->delivered;
    return worker->speed > 0 ? fabs(elapsed - worker->held / worker->speed)
                             : fmax(elapsed - farm->options.batch_interval, 0);
}

/* Pixel samples a second of a worker at a job; if it was not measured, as others a thread; 0: not known. */
static double speed_at(const farm_t *farm, const worker_t *worker, uint64_t job)
{
    if (worker->speed > 0 && worker->speed_job == job) return worker->speed;
    double speed = 0, threads = 0;
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *other = &farm->workers[i];
        if (other->speed <= 0 || other->speed_job != job) continue;
        speed += other->speed;
        threads += other->threads;
    }
    return threads > 0 ? speed / threads * worker->threads : 0;
}

/* True when the idle worker, with this speed at their job, would be done with what another holds long before
 * that one is: after what it holds itself. If the other delivered first, all that was in one batch with these
 * units would be lost. */
static bool is_sooner(const farm_t *farm, double now, const worker_t *idle, double speed,
                      const worker_t *holder)
{
    if (speed <= 0 || holder->held <= 0) return false;
    double own = farm_worker_units(farm, idle) > 0 ? idle->held : 0;
    return expected(farm, now, holder) > HURRY * (own + holder->held) / speed + HURRY_SECONDS;
}

/* True when the idle worker is to have what another holds, though that one is not late. At the end of a pass
 * the holder may be the only one that was measured: nothing is told from its speed of the idle one's then. */
static bool overtakes(const farm_t *farm, double now, const job_t *job, const worker_t *idle,
                      const worker_t *holder)
{
    bool pass_ends = schedule_goes_on(job->schedule);
    bool measured = idle->speed > 0 && idle->speed_job == job->kept.job;
    if (pass_ends && expected(farm, now, holder) < SOON_BATCHES * farm->options.batch_interval) return false;
    return (pass_ends && !measured) ||
           is_sooner(farm, now, idle, speed_at(farm, idle, job->kept.job), holder);
}

/* True when a worker has a batch that it is not let send yet, or for less than `seconds`. */
static bool made_to_wait(double now, const worker_t *worker, double seconds)
{
    bool offers = worker->offered > 0 && now - worker->offered < OFFER_SECONDS;
    return offers && (worker->granted <= 0 || now - worker->granted < seconds);
}

/* Takes back from the slow ones what they hold of one job, and all else; returns how many units. */
static size_t recall_from(farm_t *farm, double now, const worker_t *idle, const job_t *job)
{
    size_t units = 0;
    for (size_t i = 0; i < farm->worker_count; i++) {
        worker_t *worker = &farm->workers[i];
        if (worker == idle || !worker->connected) continue;
        if (schedule_held(job->schedule, worker->id) == 0) continue;
        if (now - worker->last_seen > SILENT_LEASES * farm->options.lease) continue; /* it may have died */
        bool late = now - worker->delivered > trust_patience(farm, worker, idle);
        bool fresh = worker->batches == 0;
        if (made_to_wait(now, worker, late && !fresh ? GRANT_SECONDS : HURRY_GRANT)) continue;
        if (!late && !overtakes(farm, now, job, idle, worker)) continue;
        double silent = now - worker->delivered;
        if (late || fresh) trust_lapsed(farm, now, worker);
        size_t recalled = farm_worker_take_back(farm, now, worker);
        log_warning("worker %s has sent nothing for %.0f s%s: %zu units go to others", worker->name, silent,
                    late ? "" : " and holds others up", recalled);
        units += recalled;
    }
    return units;
}

/* Somebody is idle: workers that do not deliver, or that it would overtake, lose their units. True when any
 * did. They may still deliver first. */
static bool recall_slow(farm_t *farm, double now, const worker_t *idle)
{
    size_t units = 0;
    for (size_t i = 0; i < farm->job_count; i++) {
        const job_t *job = farm->jobs[i];
        if (job->schedule != NULL && job->kept.state == JOB_RUNNING && farm_bits_fit(job, &idle->fingerprint))
            units += recall_from(farm, now, idle, job);
    }
    return units > 0;
}

/* ---- giving -------------------------------------------------------------------------------------------- */

/* Threads of workers that share the job, of those that deliver what they are given. */
static uint32_t working_threads(const farm_t *farm, const job_t *job)
{
    uint32_t threads = farm_fitting_threads(farm, job);
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        if (worker->connected && worker->lapsed && farm_bits_fit(job, &worker->fingerprint))
            threads -= worker->threads;
    }
    return threads;
}

/* Pixel samples a second that a worker may do at a job: as it did before, or else by its own measure, but no
 * more than others. */
static double likely_speed(const farm_t *farm, const worker_t *worker, const job_t *job,
                           const schedule_wish_t *wish)
{
    double measured = speed_at(farm, worker, job->kept.job);
    if (worker->speed > 0 && worker->speed_job == job->kept.job) return worker->speed;
    double claimed = (double)wish->unit_samples / UNIT_SECONDS * worker->threads;
    return measured > 0 ? fmin(measured, claimed) : claimed;
}

/* Lets a worker wish for no more than its window has room for; false when that is nothing. One whose batch we
 * make wait goes on meanwhile. */
static bool limit_wish(const farm_t *farm, double now, const job_t *job, worker_t *worker,
                       schedule_wish_t *wish)
{
    if (worker->batches > 0 && made_to_wait(now, worker, GRANT_SECONDS)) return true;
    double room = trust_room(farm, now, job, worker, likely_speed(farm, worker, job, wish));
    worker->limited = room <= 0;
    if (room < (double)wish->samples) wish->samples = room > 1 ? (uint64_t)room : 1;
    return !worker->limited;
}

/* True when a worker has delivered, or been given its first units, not long ago. */
static bool delivers(const farm_t *farm, double now, const worker_t *worker)
{
    bool present = worker->connected && !worker->lapsed && !worker->drained;
    return present && now - worker->delivered < 2 * fmax(farm->options.batch_interval, worker->gap);
}

/* True when a worker has so thin a link that the others, whose links are twice as good, would have rendered
 * all that is free before a batch of it was here, after the one that it may be sending now. */
static bool comes_too_late(const farm_t *farm, double now, const job_t *job, const worker_t *worker)
{
    double others = 0;
    if (worker->transfer < THIN_SECONDS) return false;
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *other = &farm->workers[i];
        if (other->speed_job == job->kept.job && 2 * other->transfer < worker->transfer &&
            delivers(farm, now, other))
            others += other->speed;
    }
    return (double)schedule_free(job->schedule) < 2 * worker->transfer * others;
}

/* Issues units of one job, if it has any for this worker; false when the worker is to wait until it has
 * delivered. */
static bool take_from_job(farm_t *farm, double now, job_t *job, worker_t *worker, schedule_wish_t *wish,
                          work_t *work)
{
    if (job->kept.state == JOB_QUEUED && !farm_job_start(farm, now, job)) return true;
    work->job = job->kept.job;
    work->settings = job->kept.settings;
    work->blob = job->kept.blob;
    work->blob_size = job->kept.blob_size;
    size_t held = farm_worker_units(farm, worker);
    trust_answer_t answer = trust_take(farm, now, job, worker, work);
    if (answer == TRUST_COMPARES) return true;
    if (answer == TRUST_WAIT) return false;
    if (answer != TRUST_GIVEN) {
        if (comes_too_late(farm, now, job, worker)) return true;
        if (!limit_wish(farm, now, job, worker, wish)) return false;
        wish->farm_threads = working_threads(farm, job);
        work->unit_count = schedule_take(job->schedule, wish, work->units, WIRE_MAX_UNITS);
    }
    if (work->unit_count == 0) return true;
    if (held == 0) {
        worker->delivered = now;
        worker->held = worker->offered = worker->granted = 0;
    }
    if (worker->speed_job != job->kept.job) worker->speed = 0;
    worker->empty = 0;
    worker->held += farm_unit_samples(job, work->units, work->unit_count);
    return true;
}

/* True when the worker is to wait until it has delivered. */
static bool take_from_jobs(farm_t *farm, double now, worker_t *worker, schedule_wish_t *wish, work_t *work)
{
    bool waits = false;
    size_t count;
    job_t *const *jobs = farm_rank_jobs(farm, worker, may_work, &count);
    work->unit_count = 0;
    work->check = 0;
    for (size_t i = 0; i < count && work->unit_count == 0 && !waits && wish->samples > 0; i++)
        waits = !take_from_job(farm, now, jobs[i], worker, wish, work);
    return waits;
}

result_t farm_take(farm_t *farm, double now, const identity_t *identity, uint64_t id, uint64_t loaded_job,
                   uint64_t samples, uint64_t unit_samples, work_t *work)
{
    farm_lock(farm);
    worker_t *worker = farm_worker_hear(farm, now, identity, id);
    if (worker == NULL) {
        farm_unlock(farm);
        return result_fail(RESULT_UNREACHABLE, "this master does not know the worker: say hello again");
    }
    if (!worker->reached || worker->drained) { /* it could not deliver; it is to leave */
        work->job = 0;
        work->unit_count = 0;
        farm_unlock(farm);
        return result_ok();
    }
    schedule_wish_t wish = {
        .worker = id, .samples = samples, .unit_samples = unit_samples, .threads = worker->threads};
    worker->asked = now;
    if (samples > 0) worker->wanted = now;
    if (farm_worker_units(farm, worker) == 0) worker->quarantine = 0;
    worker->begins = in_largest_kind(farm, now, worker);
    bool waits = take_from_jobs(farm, now, worker, &wish, work);
    if (work->unit_count == 0 && !waits && samples > 0 && recall_slow(farm, now, worker))
        waits = take_from_jobs(farm, now, worker, &wish, work);
    if (work->unit_count == 0) work->job = 0;
    worker->idle = work->unit_count == 0 && !waits;
    worker->job = work->unit_count > 0 ? work->job : loaded_job;
    const job_t *job = farm_find_job(farm, work->job);
    unit_mac_t mac = {{0}};
    if (job != NULL) {
        mac = farm_unit_mac(farm, worker, job, work->check);
        farm_name_plans(job, work);
    }
    farm_unlock(farm);
    unit_mac_issue(&mac, work->units, work->unit_count, work->issues);
    return result_ok();
}
