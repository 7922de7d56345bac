/* checks: units of verified jobs (terms.verify) that are rendered twice and compared, and what follows from
 * it.
 *
 * DESIGN. What is compared is a share of the samples of every batch, chosen at random when the batch is
 * there: who rendered it could not know. With probability verify / 2 it is the whole batch, with its splats.
 * Else it is units that have verify / 2 of the batch's samples, one at least, whose tiles are compared: their
 * splats lie in one frame with those of all others. So a batch that is wrong everywhere is always found, and
 * one that is wrong somewhere with the probability that it was just there. Who has not earned trust, by
 * EARNED batches that passed, is looked at more closely: NEW_SHARE of the samples of each batch. That is so
 * for relays too.
 *
 * The units go to another worker, with a number, as a batch of their own, which is compared and not merged.
 * It has the same bits, and is of another party when there is one. If both agree, that is all. If not, more
 * workers render the same until two agree; who differs from them is put aside (standing.c), and all that it
 * delivered to the job is taken out of the film again and rendered anew (evidence.c).
 *
 * Who is who: a party (standing.c) has one voice, however many processes it has. So two that agree are of
 * different parties, unless nobody else has rendered the units at all. Who differs is condemned as a party;
 * but as a process alone where other processes of the same party were right. A process is known by its name,
 * which only its own party can be fooled with.
 *
 * With nobody else to render, no comparison can be made. That holds no job up, and what could not be compared
 * is said. When two parties disagree, though, and there is no third, the job waits for one.
 *
 * All this finds machines that make mistakes, and liars. It cannot find liars who outnumber the honest. */
#include "master/trust/trust_state.h"

#include <math.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAX_TRIES = 3,      /* of a comparison that were in vain */
    SLACK = 4,          /* times the time that it should take, until it is given to somebody else, */
    STALL_BATCHES = 12, /* but batch intervals at least */
    EARNED = 8          /* batches of a party that passed until it is trusted as others are */
};
static const double NEW_SHARE = 0.25; /* of the samples of a new party's batches that are compared */
/* Seconds that a comparison should take at most, if somebody can do it so soon. */
static const double FIT_SECONDS = 60;

/* ---- the state ----------------------------------------------------------------------------------------- */

job_checks_t *checks_of(job_t *job)
{
    if (job->checks == NULL) job->checks = mem_zalloc(1, sizeof *job->checks);
    return job->checks;
}

void checks_free(job_checks_t **pointer)
{
    job_checks_t *checks = *pointer;
    if (checks == NULL) return;
    for (size_t i = 0; i < checks->check_count; i++) free(checks->checks[i].units);
    free(checks->checks);
    free(checks->sources);
    id_table_free(&checks->by_id);
    free(checks->evidence);
    free(checks);
    *pointer = NULL;
}

size_t checks_source(job_checks_t *checks, const worker_t *worker)
{
    size_t known = id_table_find(&checks->by_id, worker->source);
    if (known != SIZE_MAX) return known;
    checks->sources = mem_realloc(checks->sources, (checks->source_count + 1) * sizeof *checks->sources);
    source_t *source = &checks->sources[checks->source_count];
    *source = (source_t){.id = worker->source, .party = worker->party};
    memcpy(source->name, worker->name, sizeof source->name);
    memcpy(source->party_text, worker->party_text, sizeof source->party_text);
    id_table_put(&checks->by_id, source->id, checks->source_count);
    return checks->source_count++;
}

/* Takes a comparison off the list and hands it over. */
static check_t remove_check(job_checks_t *checks, size_t at)
{
    check_t check = checks->checks[at];
    evidence_t *evidence = evidence_find(checks, check.evidence);
    if (evidence != NULL && evidence->kind == SPOOL_CHECK) evidence->kind = SPOOL_KEPT;
    memmove(checks->checks + at, checks->checks + at + 1,
            (--checks->check_count - at) * sizeof *checks->checks);
    return check;
}

/* It is not made. The job may have waited for nothing else. */
static void drop_check(job_t *job, size_t at)
{
    check_t check = remove_check(job->checks, at);
    if (check.doubt == DOUBT_OPEN && job->schedule != NULL)
        schedule_release_units(job->schedule, 0, check.units, check.count);
    free(check.units);
    job->progress_due = true;
}

static check_t *add_check(const job_t *job, const unit_t *units, size_t count, const hash_t *fingerprint)
{
    job_checks_t *checks = job->checks;
    checks->checks = mem_realloc(checks->checks, (checks->check_count + 1) * sizeof *checks->checks);
    check_t *check = &checks->checks[checks->check_count++];
    *check = (check_t){.units = units_sorted(units, count),
                       .count = count,
                       .samples = farm_unit_samples(job, units, count),
                       .fingerprint = *fingerprint};
    while (check->number == 0) randombytes_buf(&check->number, sizeof check->number);
    return check;
}

static void add_rendering(check_t *check, size_t source, const hash_t *digest)
{
    check->renderings[check->rendering_count].source = source;
    check->renderings[check->rendering_count++].digest = *digest;
}

void checks_want(farm_t *farm, job_t *job, sample_t *sample, uint64_t evidence, size_t source,
                 const hash_t *fingerprint)
{
    job_checks_t *checks = checks_of(job);
    if (checks->check_count == MAX_CHECKS) {
        checks->unmade++;
        return;
    }
    check_t *check = add_check(job, sample->units, sample->count, fingerprint);
    check->whole = sample->whole;
    check->evidence = evidence;
    add_rendering(check, source, &sample->digest);
    farm_notify_idle(farm);
}

/* ---- what is compared ---------------------------------------------------------------------------------- */

/* True with a probability. */
static bool happens(double probability)
{
    return (double)randombytes_random() < probability * 0x1p32;
}

/* True when somebody of another party can render so many samples soon, as far as is known. */
static bool is_soon_rendered(const farm_t *farm, uint64_t party, double samples)
{
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *other = &farm->workers[i];
        if (other->connected && other->party != party &&
            (other->speed <= 0 || samples <= other->speed * FIT_SECONDS))
            return true;
    }
    return false;
}

sample_t checks_sample(const farm_t *farm, const job_t *job, uint64_t party, const unit_t *units,
                       size_t count)
{
    double verify = job->kept.terms.verify, samples = farm_unit_samples(job, units, count), chosen = 0;
    const standing_t *standing = standing_find(farm, party);
    bool earned = standing != NULL && standing->passed >= EARNED;
    double share = earned ? verify / 2 : fmax(verify / 2, NEW_SHARE);
    bool fits = is_soon_rendered(farm, party, samples);
    sample_t sample = {.whole = verify >= 1 || (fits && happens(verify / 2)),
                       .units = mem_alloc(count * sizeof *units)};
    memcpy(sample.units, units, count * sizeof *units);
    if (sample.whole) sample.count = count;
    while (!sample.whole && sample.count < count && chosen < fmax(share * samples, 1)) {
        size_t at = sample.count + randombytes_uniform((uint32_t)(count - sample.count));
        unit_t unit = sample.units[at];
        sample.units[at] = sample.units[sample.count];
        sample.units[sample.count++] = unit;
        chosen += farm_unit_samples(job, &unit, 1);
    }
    return sample;
}

result_t checks_digest(const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch, sample_t *sample)
{
    static const char overflow[] = "overflow";
    if (!sample->whole)
        return payload_digest_units(payload, batch, sample->units, sample->count, &sample->digest);
    TRY(payload_digest(payload, batch, &sample->digest));
    /* Sums that overflowed at the worker depend on the order in which it made them. */
    if (batch->counts.overflows > 0) sample->digest = hash_bytes(overflow, sizeof overflow);
    return result_ok();
}

/* ---- who renders it ------------------------------------------------------------------------------------ */

static uint64_t party_of(const job_checks_t *checks, const check_t *check, size_t rendering)
{
    return checks->sources[check->renderings[rendering].source].party;
}

/* True when a party or a process has rendered it. */
static bool has_rendered(const job_checks_t *checks, const check_t *check, uint64_t who)
{
    for (size_t i = 0; i < check->rendering_count; i++)
        if (party_of(checks, check, i) == who || checks->sources[check->renderings[i].source].id == who)
            return true;
    return false;
}

/* True when all that rendered it are of one party. */
static bool is_of_one_party(const job_checks_t *checks, const check_t *check)
{
    for (size_t i = 1; i < check->rendering_count; i++)
        if (party_of(checks, check, i) != party_of(checks, check, 0)) return false;
    return true;
}

/* True when a worker is one whose rendering can be compared. */
static bool may_compare(const job_checks_t *checks, const check_t *check, const worker_t *worker)
{
    return worker->connected && hash_equal(&worker->fingerprint, &check->fingerprint) &&
           !has_rendered(checks, check, worker->source) &&
           (is_of_one_party(checks, check) || !has_rendered(checks, check, worker->party));
}

/* True when a party has neither rendered it nor lost it. */
static bool is_fresh(const job_checks_t *checks, const check_t *check, uint64_t party)
{
    for (size_t i = 0; i < CHECK_LOSERS; i++)
        if (check->lost[i] == party) return false;
    return !has_rendered(checks, check, party);
}

/* True when somebody may render it who does not hang; of a fresh party, if need be. */
static bool can_be_had(const farm_t *farm, double now, const job_checks_t *checks, const check_t *check,
                       bool fresh)
{
    for (size_t i = 0; i < farm->worker_count; i++)
        if (may_compare(checks, check, &farm->workers[i]) &&
            (!fresh || is_fresh(checks, check, farm->workers[i].party)) &&
            farm_worker_asks(farm, now, &farm->workers[i], FARM_LOAD_BATCHES))
            return true;
    return false;
}

/* Whoever is there may render what is doubted and not in the film yet, if nobody is there who has not. */
static bool may_render(const farm_t *farm, double now, const job_checks_t *checks, const check_t *check,
                       const worker_t *worker)
{
    if (may_compare(checks, check, worker)) return true;
    return check->doubt == DOUBT_OPEN && hash_equal(&worker->fingerprint, &check->fingerprint) &&
           !can_be_had(farm, now, checks, check, false);
}

/* How well placed a worker is: it is of a fresh party, or fast enough. */
static double fitness(const job_checks_t *checks, const check_t *check, const worker_t *worker)
{
    return 2 * is_fresh(checks, check, worker->party) + fmin(worker->speed * FIT_SECONDS / check->samples, 1);
}

/* True when nobody else is better placed. */
static bool suits(const farm_t *farm, double now, const job_checks_t *checks, const check_t *check,
                  const worker_t *worker)
{
    double own = fitness(checks, check, worker);
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *other = &farm->workers[i];
        if (other != worker && fitness(checks, check, other) > own && may_compare(checks, check, other) &&
            farm_worker_asks(farm, now, other, FARM_ASK_BATCHES))
            return false;
    }
    return true;
}

bool checks_waiting(const job_t *job)
{
    for (size_t i = 0; job->checks != NULL && i < job->checks->check_count; i++)
        if (job->checks->checks[i].with == 0) return true;
    return false;
}

/* The speed and what it holds are in a worker's hands: it has no longer than the fastest one would need, or
 * FIT_SECONDS. */
static double deadline(const farm_t *farm, double now, const check_t *check, const worker_t *worker)
{
    double interval = farm->options.batch_interval, fastest = 0;
    double seconds = worker->speed > 0 ? (worker->held + check->samples) / worker->speed : 0;
    for (size_t i = 0; i < farm->worker_count; i++)
        if (farm->workers[i].connected) fastest = fmax(fastest, farm->workers[i].speed);
    if (fastest > 0) seconds = fmin(seconds, fmax(check->samples / fastest, FIT_SECONDS));
    return now + fmax(SLACK * (seconds + interval), STALL_BATCHES * interval);
}

bool checks_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work)
{
    job_checks_t *checks = job->checks;
    for (size_t i = 0; checks != NULL && i < checks->check_count; i++) {
        check_t *check = &checks->checks[i];
        if (check->with != 0 || !may_render(farm, now, checks, check, worker) ||
            !suits(farm, now, checks, check, worker))
            continue;
        check->with = worker->id;
        check->deadline = deadline(farm, now, check, worker);
        memcpy(work->units, check->units, check->count * sizeof *check->units);
        work->unit_count = check->count;
        work->check = check->number;
        return true;
    }
    return false;
}

bool checks_held(const farm_t *farm, const worker_t *worker)
{
    for (size_t j = 0; j < farm->job_count; j++) {
        const job_checks_t *checks = farm->jobs[j]->checks;
        for (size_t i = 0; checks != NULL && i < checks->check_count; i++)
            if (checks->checks[i].with == worker->id) return true;
    }
    return false;
}

/* The worker does not render it any more. */
static void lose(const farm_t *farm, check_t *check)
{
    const worker_t *worker = farm_find_worker(farm, check->with);
    check->with = 0;
    check->lost[check->tries++ % CHECK_LOSERS] = worker != NULL ? worker->party : 0;
}

void trust_left(farm_t *farm, const worker_t *worker)
{
    for (size_t j = 0; j < farm->job_count; j++) {
        job_checks_t *checks = farm->jobs[j]->checks;
        for (size_t i = 0; checks != NULL && i < checks->check_count; i++)
            if (checks->checks[i].with == worker->id) lose(farm, &checks->checks[i]);
    }
}

/* ---- what comes of it ---------------------------------------------------------------------------------- */

/* Two renderings that agree, of different parties if there are several; false when there are none. */
static bool agreement(const job_checks_t *checks, const check_t *check, hash_t *digest)
{
    bool alone = is_of_one_party(checks, check);
    for (size_t i = 0; i < check->rendering_count; i++)
        for (size_t j = 0; j < i; j++)
            if (hash_equal(&check->renderings[i].digest, &check->renderings[j].digest) &&
                (alone || party_of(checks, check, i) != party_of(checks, check, j))) {
                *digest = check->renderings[i].digest;
                return true;
            }
    return false;
}

/* Renderings differ, and there are not yet two that agree. */
static void say_disputed(const job_t *job, const check_t *check)
{
    const source_t *sources = job->checks->sources;
    log_error(
        "job %llu: %s and %s have rendered %zu units (the first: tile %u, samples %u + %u) and disagree; "
        "another worker is to decide",
        (unsigned long long)job->kept.job, sources[check->renderings[0].source].name,
        sources[check->renderings[check->rendering_count - 1].source].name, check->count,
        check->units[0].tile, check->units[0].first, check->units[0].count);
}

/* Everybody has other sums: the job is to blame, not the workers. */
static void give_up(farm_t *farm, job_t *job)
{
    job_checks_t *checks = job->checks;
    checks->given_up = true;
    while (checks->check_count > 0) drop_check(job, 0);
    log_error("job %llu cannot be verified: %d workers have rendered the same units, and no two agree",
              (unsigned long long)job->kept.job, CHECK_RENDERINGS);
    farm_job_tell(farm, job, "it could not be verified: no two of %d workers make the same bits of it",
                  CHECK_RENDERINGS);
}

/* True when a process of this party made the sums that are right. */
static bool was_right(const job_checks_t *checks, const check_t *check, uint64_t party, const hash_t *digest)
{
    for (size_t i = 0; i < check->rendering_count; i++)
        if (party_of(checks, check, i) == party && hash_equal(&check->renderings[i].digest, digest))
            return true;
    return false;
}

/* A comparison is over: those who were right are trusted, those who were wrong are not. */
static void conclude(farm_t *farm, double now, job_t *job, const check_t *check, const hash_t *digest)
{
    bool passed = true;
    for (size_t i = 0; i < check->rendering_count; i++) {
        if (hash_equal(&check->renderings[i].digest, digest)) continue;
        source_t source = job->checks->sources[check->renderings[i].source];
        bool process = was_right(job->checks, check, source.party, digest);
        char why[FARM_MAX_NAME];
        passed = false;
        bool doubted = i == 0 && check->doubt != DOUBT_NONE;
        snprintf(why, sizeof why, "sent %s for %zu units of job %llu; it is %s",
                 doubted ? "sums that are too large, and that others do not make,"
                         : "other sums than two others",
                 check->count, (unsigned long long)job->kept.job, source.party_text);
        evidence_condemn(farm, process ? source.id : source.party);
        standing_lied(farm, now, process ? source.id : source.party, source.name, why);
    }
    if (passed && !is_of_one_party(job->checks, check))
        standing_of(farm, now, party_of(job->checks, check, 0))->passed++;
    job->kept.checks_passed += passed && check->doubt == DOUBT_NONE;
    job->kept.checks_failed += !passed;
    farm_record_changed(farm, job);
}

static void decide(farm_t *farm, double now, job_t *job, size_t at)
{
    const check_t *check = &job->checks->checks[at];
    hash_t digest;
    job->progress_due = true;
    if (agreement(job->checks, check, &digest)) {
        check_t over = remove_check(job->checks, at);
        conclude(farm, now, job, &over, &digest);
        free(over.units);
    } else if (check->rendering_count == CHECK_RENDERINGS) {
        give_up(farm, job);
    } else {
        if (check->rendering_count > 1) say_disputed(job, check);
        farm_notify_idle(farm);
    }
}

static size_t find_check(const job_checks_t *checks, uint64_t number)
{
    size_t i = 0;
    while (checks != NULL && i < checks->check_count && checks->checks[i].number != number) i++;
    return checks != NULL && i < checks->check_count ? i : SIZE_MAX;
}

/* The comparison that this worker was asked for by its number. */
static result_t find_asked(const job_checks_t *checks, const worker_t *worker, uint64_t number, size_t *at)
{
    *at = find_check(checks, number);
    if (worker == NULL || worker->outcast)
        return result_fail(RESULT_UNREACHABLE, "this master does not know the worker");
    if (*at == SIZE_MAX)
        return result_fail(RESULT_MISMATCH, "these units are not (any more) to be compared with others");
    if (checks->checks[*at].doubt != DOUBT_OPEN && has_rendered(checks, &checks->checks[*at], worker->source))
        return result_fail(RESULT_MISMATCH, "the worker has rendered these units before");
    return result_ok();
}

result_t trust_asked(const farm_t *farm, const job_t *job, uint64_t id, uint64_t number, sample_t *sample)
{
    size_t at;
    TRY(find_asked(job->checks, farm_find_worker(farm, id), number, &at));
    const check_t *check = &job->checks->checks[at];
    *sample = (sample_t){
        .units = mem_alloc(check->count * sizeof(unit_t)), .count = check->count, .whole = check->whole};
    memcpy(sample->units, check->units, check->count * sizeof(unit_t));
    return result_ok();
}

result_t trust_digest(const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch, sample_t *sample)
{
    if (!units_same(sample->units, sample->count, batch->units, batch->unit_count))
        return result_fail(RESULT_MISMATCH, "these are not the units that were to be compared");
    return checks_digest(payload, batch, sample);
}

result_t trust_compare(farm_t *farm, double now, job_t *job, uint64_t id, uint64_t number,
                       const hash_t *digest, bool *merge, bool *confirmed)
{
    *merge = *confirmed = false;
    const worker_t *worker = farm_find_worker(farm, id);
    size_t at;
    TRY(find_asked(job->checks, worker, number, &at));
    check_t *check = &job->checks->checks[at];
    if (check->with == id) check->with = 0;
    *merge = check->doubt == DOUBT_OPEN;
    add_rendering(check, checks_source(job->checks, worker), digest);
    if (check->doubt == DOUBT_OPEN) {
        hash_t agreed;
        *confirmed = agreement(job->checks, check, &agreed) && hash_equal(&agreed, digest);
        schedule_release_units(job->schedule, 0, check->units, check->count);
        check->doubt = DOUBT_ANSWERED; /* or trust_doubt says otherwise */
    }
    decide(farm, now, job, at);
    return result_ok();
}

/* ---- doubts -------------------------------------------------------------------------------------------- */

/* Keeps the units of a doubted batch from others; false when they are not all free. */
static bool set_apart(job_t *job, const unit_t *units, size_t count)
{
    size_t i = 0;
    while (i < count && schedule_issue(job->schedule, 0, &units[i])) i++;
    if (i < count) schedule_release_units(job->schedule, 0, units, i);
    return i == count;
}

void trust_doubt(farm_t *farm, job_t *job, const worker_t *worker, uint64_t number, const unit_t *units,
                 size_t count, const hash_t *digest)
{
    job_checks_t *checks = checks_of(job);
    size_t at = find_check(checks, number);
    bool again = at != SIZE_MAX;
    log_warning("job %llu: %s sent sums that are too large to be believed; %zu units are rendered once more",
                (unsigned long long)job->kept.job, worker->name, count);
    if ((number != 0 && !again) || (!again && checks->check_count == MAX_CHECKS)) return;
    if (!set_apart(job, units, count)) return;
    check_t *check = again ? &checks->checks[at] : add_check(job, units, count, &worker->fingerprint);
    check->doubt = DOUBT_OPEN;
    check->whole = true;
    if (!again) add_rendering(check, checks_source(checks, worker), digest);
    farm_notify_idle(farm);
}

bool trust_believes_all(const job_t *job)
{
    return job->checks != NULL && job->checks->given_up;
}

void checks_forget(job_t *job, size_t source)
{
    job_checks_t *checks = job->checks;
    for (size_t i = checks->check_count; i-- > 0;) {
        check_t *check = &checks->checks[i];
        if (check->renderings[0].source == source) {
            drop_check(job, i);
            continue;
        }
        for (size_t r = check->rendering_count; r-- > 1;)
            if (check->renderings[r].source == source)
                memmove(check->renderings + r, check->renderings + r + 1,
                        (--check->rendering_count - r) * sizeof *check->renderings);
    }
}

/* ---- time, and what is to be said ---------------------------------------------------------------------- */

bool trust_pending(const job_t *job)
{
    return job->checks != NULL && (job->checks->check_count > 0 || trust_wrong(job));
}

/* True when a comparison is not worth waiting for: nobody can make it, or all that could have lost it. A few
 * that lose what they are given on purpose cannot keep others from making it. */
static bool is_hopeless(const farm_t *farm, double now, const job_checks_t *checks, const check_t *check)
{
    bool open = check->with != 0 || check->doubt == DOUBT_OPEN ||
                (check->doubt == DOUBT_NONE && check->rendering_count > 1);
    return !open && !can_be_had(farm, now, checks, check, check->tries >= MAX_TRIES);
}

/* Of two parties, one has made sums of the same units that can be believed, and nobody else is there to be
 * asked. The other is not believed. A machine that differs from itself makes mistakes. */
static void decide_alone(farm_t *farm, double now, job_t *job, size_t at)
{
    check_t check = remove_check(job->checks, at);
    size_t last = check.rendering_count - 1;
    const source_t *first = &job->checks->sources[check.renderings[0].source];
    if (first->party != job->checks->sources[check.renderings[last].source].party)
        conclude(farm, now, job, &check, &check.renderings[last].digest);
    else
        for (size_t i = 0; i < farm->worker_count; i++)
            if (farm->workers[i].connected && farm->workers[i].source == first->id)
                trust_failed(farm, now, &farm->workers[i], "makes other sums each time");
    free(check.units);
    job->progress_due = true;
}

/* Gives up comparisons that nobody can make, when all else is counted. */
static void drop_hopeless(const farm_t *farm, double now, job_t *job)
{
    job_checks_t *checks = job->checks;
    if (job->schedule == NULL || job->merging > 0 || !schedule_round_counted(job->schedule)) return;
    for (size_t i = checks->check_count; i-- > 0;) {
        if (!is_hopeless(farm, now, checks, &checks->checks[i])) continue;
        checks->unmade += checks->checks[i].doubt == DOUBT_NONE;
        drop_check(job, i);
    }
}

static void tick_job(farm_t *farm, double now, job_t *job)
{
    job_checks_t *checks = job->checks;
    uint64_t unmade = checks->unmade;
    for (size_t i = 0; i < checks->check_count;) {
        check_t *check = &checks->checks[i];
        if (check->with != 0 && now > check->deadline) lose(farm, check);
        bool alone =
            check->doubt == DOUBT_ANSWERED && job->merging == 0 && is_hopeless(farm, now, checks, check);
        if (alone) decide_alone(farm, now, job, i);
        i = alone ? 0 : i + 1; /* others may have gone with it */
    }
    drop_hopeless(farm, now, job);
    if (checks->unmade == unmade) return;
    if (strstr(job->kept.message, "could not be compared") == NULL)
        farm_job_tell(farm, job,
                      "batches could not be compared: there was no other worker that makes the same bits");
    log_warning("job %llu: %llu batches could not be compared, since nobody else rendered them",
                (unsigned long long)job->kept.job, (unsigned long long)checks->unmade);
}

void trust_tick(farm_t *farm, double now)
{
    for (size_t i = 0; i < farm->job_count; i++)
        if (farm->jobs[i]->checks != NULL) tick_job(farm, now, farm->jobs[i]);
}

void checks_remark(const farm_t *farm, double now, const job_t *job, char *text, size_t size)
{
    const job_checks_t *checks = job->checks;
    size_t stuck = 0;
    text[0] = '\0';
    if (job->kept.terms.verify > 0 && farm->options.spool_dir == NULL)
        snprintf(text, size, "it is not verified: this master keeps nothing on a disk");
    if (checks != NULL && checks->delayed)
        snprintf(text, size,
                 "wrong sums are still to be taken out of the film, for which there is no room now");
    for (size_t i = 0; checks != NULL && i < checks->check_count; i++) {
        const check_t *check = &checks->checks[i];
        if (check->with != 0 || check->doubt != DOUBT_NONE || can_be_had(farm, now, checks, check, false))
            continue;
        stuck++;
        if (check->rendering_count < 2) continue;
        snprintf(text, size, "%.60s and %.60s disagree, and a further worker is needed to decide",
                 checks->sources[check->renderings[0].source].name,
                 checks->sources[check->renderings[1].source].name);
        return;
    }
    if (stuck > 0)
        snprintf(text, size, "%zu batch%s cannot be compared with only one worker", stuck,
                 stuck == 1 ? "" : "es");
}
