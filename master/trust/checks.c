/* checks: the units of a job that are rendered twice and compared (terms.verify), and what follows from
 * it.
 *
 * DESIGN. A share of the batches that were merged is chosen at random, when they are there: who rendered them
 * could not know. The same units are given to another worker, with a number, to be delivered as a batch of
 * their own, which is compared (batch_digest) and not merged. Another worker is one with the same bits, on
 * of another party if there is one. If the sums are equal, the first worker is vouched for: what it had
 * delivered until then needs no further proof. If not, more workers render the same until two agree; whoever
 * differs from them is put aside (standing.c), and everything that it delivered since it was last
 * vouched for is taken out of the film again and re-rendered (evidence.c). The second worker knows that
 * it is watched, so its rendering does not vouch for itself, but it does for the first.
 *
 * A worker is chosen for certain when it has delivered MUST_CHECK / verify batches since it was vouched for,
 * so that what has to be kept stays bounded.
 *
 * A relay's batch is too large to be rendered by one worker, so of a relay's units one is chosen when they
 * are handed out, and asked for with a number from the first. That is weaker: whoever is behind the relay can
 * tell.
 *
 * With nobody else to render, no comparison can be made. That holds no job up, and does not fill the disk:
 * when all is counted, or too much is kept, those that nobody can make are dropped, and the message says so.
 * When two workers disagree, though, and there is no third, the job waits for one.
 *
 * All this finds machines that make mistakes, and liars with a probability of 1 - (1 - verify)^n after n
 * batches with wrong sums. It cannot find liars who outnumber the honest. */
#include "master/trust/trust_state.h"

#include <math.h>
#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAX_TRIES = 3,     /* of a comparison that were in vain */
    SLACK = 4,         /* times the time that it should take, until it is given to somebody else, */
    STALL_BATCHES = 12 /* but batch intervals at least */
};
static const double FIT_SECONDS =
    60; /* that a comparison should take at most, if somebody can do it so soon */

/* ---- the state ----------------------------------------------------------------------------------------- */

job_checks_t *checks_of(job_t *job)
{
    if (job->checks == NULL) job->checks = mem_zalloc(1, sizeof *job->checks);
    return job->checks;
}

static void check_free(check_t *check)
{
    free(check->units);
}

void checks_free(job_checks_t **pointer)
{
    job_checks_t *checks = *pointer;
    if (checks == NULL) return;
    for (size_t i = 0; i < checks->check_count; i++) check_free(&checks->checks[i]);
    free(checks->checks);
    free(checks->sources);
    id_table_free(&checks->by_id);
    free(checks->evidence);
    free(checks);
    *pointer = NULL;
}

size_t checks_source(job_checks_t *checks, uint64_t id, uint64_t party, const char *name, const char *text)
{
    size_t known = id_table_find(&checks->by_id, id);
    if (known != SIZE_MAX) return known;
    checks->sources = mem_realloc(checks->sources, (checks->source_count + 1) * sizeof *checks->sources);
    source_t *source = &checks->sources[checks->source_count];
    *source = (source_t){.id = id, .party = party, .condemned = -1};
    snprintf(source->name, sizeof source->name, "%s", name);
    snprintf(source->party_text, sizeof source->party_text, "%s", text);
    id_table_put(&checks->by_id, id, checks->source_count);
    return checks->source_count++;
}

/* Takes a comparison off the list and hands it over. */
static check_t remove_check(job_checks_t *checks, size_t at)
{
    check_t check = checks->checks[at];
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
    check_free(&check);
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

void checks_want(farm_t *farm, job_t *job, const evidence_t *evidence, const unit_t *units, size_t count,
                 const hash_t *fingerprint, const hash_t *digest)
{
    job_checks_t *checks = checks_of(job);
    if (checks->check_count == MAX_CHECKS) {
        checks->unmade++;
        return;
    }
    check_t *check = add_check(job, units, count, fingerprint);
    check->evidence = evidence->serial;
    check->clock = evidence->clock;
    add_rendering(check, evidence->source, digest);
    farm_notify_idle(farm);
}

check_t *checks_begun(job_checks_t *checks, size_t source, const unit_t *units, size_t count)
{
    for (size_t i = 0; i < checks->check_count; i++) {
        check_t *check = &checks->checks[i];
        if (check->evidence == 0 && check->doubt == DOUBT_NONE && check->rendering_count > 0 &&
            check->renderings[0].source == source && units_same(check->units, check->count, units, count))
            return check;
    }
    return NULL;
}

bool checks_open(const job_checks_t *checks, size_t source)
{
    for (size_t i = 0; i < checks->check_count; i++)
        if (checks->checks[i].rendering_count > 0 && checks->checks[i].renderings[0].source == source)
            return true;
    return false;
}

/* ---- who renders it ------------------------------------------------------------------------------------ */

static bool rendered_by(const job_checks_t *checks, const check_t *check, const worker_t *worker)
{
    for (size_t i = 0; i < check->rendering_count; i++)
        if (checks->sources[check->renderings[i].source].id == worker->source) return true;
    return false;
}

static bool rendered_on(const job_checks_t *checks, const check_t *check, uint64_t party)
{
    for (size_t i = 0; i < check->rendering_count; i++)
        if (checks->sources[check->renderings[i].source].party == party) return true;
    return false;
}

static bool may_compare(const job_checks_t *checks, const check_t *check, const worker_t *worker)
{
    return worker->connected && hash_equal(&worker->fingerprint, &check->fingerprint) &&
           !rendered_by(checks, check, worker);
}

/* True when somebody may render it who does not hang. */
static bool can_be_had(const farm_t *farm, double now, const job_checks_t *checks, const check_t *check)
{
    for (size_t i = 0; i < farm->worker_count; i++)
        if (may_compare(checks, check, &farm->workers[i]) &&
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
           !can_be_had(farm, now, checks, check);
}

/* True when nobody is better placed: of a party that has not rendered it, or fast enough. */
static bool suits(const farm_t *farm, double now, const job_checks_t *checks, const check_t *check,
                  const worker_t *worker)
{
    bool fresh = !rendered_on(checks, check, worker->party);
    bool quick = check->samples <= worker->speed * FIT_SECONDS;
    for (size_t i = 0; i < farm->worker_count && !(fresh && quick); i++) {
        const worker_t *other = &farm->workers[i];
        if (other == worker || !may_compare(checks, check, other) ||
            !farm_worker_asks(farm, now, other, FARM_ASK_BATCHES))
            continue;
        bool other_fresh = !rendered_on(checks, check, other->party);
        if (other_fresh && !fresh) return false;
        if (other_fresh == fresh && !quick && other->speed > worker->speed) return false;
    }
    return true;
}

bool checks_waiting(const job_t *job)
{
    for (size_t i = 0; job->checks != NULL && i < job->checks->check_count; i++)
        if (job->checks->checks[i].with == 0) return true;
    return false;
}

static double deadline(const farm_t *farm, double now, const check_t *check, const worker_t *worker)
{
    double interval = farm->options.batch_interval;
    double seconds = worker->speed > 0 ? (worker->held + check->samples) / worker->speed : 0;
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

/* True with a probability. */
static bool happens(double probability)
{
    return (double)randombytes_random() < probability * 0x1p32;
}

bool checks_marks(const farm_t *farm, const job_t *job, const worker_t *worker, double units)
{
    if (!worker->relay || job->kept.terms.verify <= 0 || farm->options.spool_dir == NULL) return false;
    if (job->checks != NULL && (job->checks->given_up || job->checks->check_count == MAX_CHECKS))
        return false;
    double share = job->kept.terms.verify * fmax(units, 1); /* one unit of so many that it would be given */
    return happens(share / (1 - job->kept.terms.verify + share));
}

void trust_mark(farm_t *farm, double now, job_t *job, const worker_t *worker, work_t *work)
{
    (void)checks_of(job);
    check_t *check = add_check(job, work->units, work->unit_count, &worker->fingerprint);
    check->with = worker->id;
    check->deadline = deadline(farm, now, check, worker);
    work->check = check->number;
}

/* The worker does not render it any more. */
static void lose(job_t *job, size_t at)
{
    check_t *check = &job->checks->checks[at];
    check->with = 0;
    check->tries++;
    if (check->rendering_count == 0) drop_check(job, at);
}

void trust_left(farm_t *farm, const worker_t *worker)
{
    for (size_t j = 0; j < farm->job_count; j++) {
        job_checks_t *checks = farm->jobs[j]->checks;
        for (size_t i = checks != NULL ? checks->check_count : 0; i-- > 0;)
            if (checks->checks[i].with == worker->id) lose(farm->jobs[j], i);
    }
}

/* ---- what comes of it ---------------------------------------------------------------------------------- */

/* Two renderings that agree; false when there are none. */
static bool agreement(const check_t *check, hash_t *digest)
{
    for (size_t i = 0; i < check->rendering_count; i++)
        for (size_t j = 0; j < i; j++)
            if (hash_equal(&check->renderings[i].digest, &check->renderings[j].digest)) {
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

/* A comparison is over: those who were right are trusted, those who were wrong are not. */
static void conclude(farm_t *farm, double now, job_t *job, const check_t *check, const hash_t *digest)
{
    bool passed = true;
    if (check->doubt == DOUBT_NONE && hash_equal(&check->renderings[0].digest, digest))
        evidence_vouch(farm, job, check->renderings[0].source, check->clock);
    for (size_t i = 0; i < check->rendering_count; i++) {
        if (hash_equal(&check->renderings[i].digest, digest)) continue;
        source_t source = job->checks->sources[check->renderings[i].source];
        char why[FARM_MAX_NAME];
        passed = false;
        bool doubted = i == 0 && check->doubt != DOUBT_NONE;
        snprintf(why, sizeof why, "sent %s for %zu units of job %llu; it is %s",
                 doubted ? "sums that are too large, and that others do not make,"
                         : "other sums than two others",
                 check->count, (unsigned long long)job->kept.job, source.party_text);
        evidence_condemn(farm, now, source.id);
        standing_lied(farm, now, source.id, source.name, why);
    }
    job->kept.checks_passed += passed && check->doubt == DOUBT_NONE;
    job->kept.checks_failed += !passed;
    farm_record_changed(farm, job);
}

static void decide(farm_t *farm, double now, job_t *job, size_t at)
{
    const check_t *check = &job->checks->checks[at];
    hash_t digest;
    job->progress_due = true;
    if (agreement(check, &digest)) {
        check_t over = remove_check(job->checks, at);
        conclude(farm, now, job, &over, &digest);
        check_free(&over);
    } else if (check->rendering_count == CHECK_RENDERINGS) {
        give_up(farm, job);
    } else if (check->rendering_count > 1) {
        say_disputed(job, check);
        farm_notify_idle(farm);
    } else {
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
    if (checks->checks[*at].doubt != DOUBT_OPEN && rendered_by(checks, &checks->checks[*at], worker))
        return result_fail(RESULT_MISMATCH, "the worker has rendered these units before");
    return result_ok();
}

result_t trust_asked(const farm_t *farm, const job_t *job, uint64_t id, uint64_t number, unit_t **units,
                     size_t *count)
{
    size_t at;
    TRY(find_asked(job->checks, farm_find_worker(farm, id), number, &at));
    const check_t *check = &job->checks->checks[at];
    *units = mem_alloc(check->count * sizeof **units);
    *count = check->count;
    memcpy(*units, check->units, check->count * sizeof **units);
    return result_ok();
}

result_t trust_compare(farm_t *farm, double now, job_t *job, uint64_t id, uint64_t number,
                       const unit_t *units, size_t count, const hash_t *digest, bool *merge, bool *confirmed)
{
    *merge = *confirmed = false;
    const worker_t *worker = farm_find_worker(farm, id);
    size_t at;
    TRY(find_asked(job->checks, worker, number, &at));
    check_t *check = &job->checks->checks[at];
    if (!units_same(check->units, check->count, units, count))
        return result_fail(RESULT_MISMATCH, "these are not the units that were to be compared");
    if (check->with == id) check->with = 0;
    *merge = check->rendering_count == 0 || check->doubt == DOUBT_OPEN;
    add_rendering(check,
                  checks_source(job->checks, worker->source, worker->party, worker->name, worker->party_text),
                  digest);
    if (check->doubt == DOUBT_OPEN) {
        hash_t agreed;
        *confirmed = agreement(check, &agreed) && hash_equal(&agreed, digest);
        schedule_release_units(job->schedule, 0, check->units, check->count);
        check->doubt = DOUBT_TRIED;
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
    if (!again)
        add_rendering(check,
                      checks_source(checks, worker->source, worker->party, worker->name, worker->party_text),
                      digest);
    farm_notify_idle(farm);
}

void trust_answered(job_t *job, uint64_t number)
{
    size_t at = find_check(job->checks, number);
    if (at != SIZE_MAX && job->checks->checks[at].doubt == DOUBT_TRIED)
        job->checks->checks[at].doubt = DOUBT_ANSWERED;
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
        if (check->rendering_count > 0 && check->renderings[0].source == source) {
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

/* Notes since when a comparison is not worth waiting for: nobody can make it, or nobody did. */
static void note_hopeless(const farm_t *farm, double now, const job_checks_t *checks, check_t *check)
{
    bool open = check->with != 0 ||
                (check->doubt == DOUBT_NONE ? check->rendering_count > 1 : check->doubt != DOUBT_ANSWERED);
    bool hopeless = !open && (check->tries >= MAX_TRIES || !can_be_had(farm, now, checks, check));
    if (!hopeless)
        check->hopeless = 0;
    else if (check->hopeless <= 0)
        check->hopeless = now;
}

/* True when those who could make it have had the time to come back. */
static bool is_long_hopeless(const farm_t *farm, double now, const check_t *check)
{
    return check->hopeless > 0 && now - check->hopeless > farm_patience(farm, FARM_ASK_BATCHES);
}

/* True when a worker has lost what it was to compare. The first rendering of a unit may come as long as the
 * worker holds it. */
static bool is_late(const job_t *job, const check_t *check, double now)
{
    if (check->with == 0 || now <= check->deadline) return false;
    return check->rendering_count > 0 || job->schedule == NULL ||
           schedule_held(job->schedule, check->with) == 0;
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
    check_free(&check);
    job->progress_due = true;
}

static void tick_job(farm_t *farm, double now, job_t *job)
{
    job_checks_t *checks = job->checks;
    uint64_t unmade = checks->unmade;
    for (size_t i = checks->check_count; i-- > 0;)
        if (is_late(job, &checks->checks[i], now)) lose(job, i);
    bool counted = job->schedule != NULL && schedule_round_counted(job->schedule);
    for (size_t i = 0; i < checks->check_count;) { /* the oldest first */
        check_t *check = &checks->checks[i];
        size_t source = check->renderings[0].source;
        uint64_t clock = check->clock;
        note_hopeless(farm, now, checks, check);
        if (check->hopeless > 0 && check->doubt == DOUBT_ANSWERED) {
            decide_alone(farm, now, job, i);
            i = 0; /* others may have gone with it */
            continue;
        }
        bool piles_up = is_long_hopeless(farm, now, check) && evidence_piles_up(farm, job, source);
        if (check->hopeless <= 0 || (!counted && !piles_up)) {
            i++;
            continue;
        }
        checks->unmade += check->doubt == DOUBT_NONE;
        drop_check(job, i);
        if (piles_up) evidence_vouch(farm, job, source, clock);
    }
    if (checks->unmade == unmade) return;
    if (strstr(job->kept.message, "could not be compared") == NULL)
        farm_job_tell(farm, job,
                      "batches could not be compared: there was no other worker that makes the same "
                      "bits");
    log_warning("job %llu: %llu batches could not be compared, since nobody else rendered them",
                (unsigned long long)job->kept.job, (unsigned long long)checks->unmade);
}

void checks_tick(farm_t *farm, double now)
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
        if (check->with != 0 || check->doubt != DOUBT_NONE || can_be_had(farm, now, checks, check)) continue;
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
