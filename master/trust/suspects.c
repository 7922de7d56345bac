/* suspects: units that were in the hands of workers who died, and what becomes of them.
 *
 * DESIGN. A unit may end whoever renders it: a scene that takes all memory from one point of view, a bug in a
 * library. Left alone it would go from worker to worker until none is left. So:
 *
 *   - the units that a worker held when it fell silent are remembered. When somebody delivers one, it is
 *     above suspicion and forgotten; when the worker is heard of after all, its death is taken back;
 *   - units that were in the hands of two dead workers are kept from the others (the farm itself holds
 *     them, as worker 0), and handed out apart: first up to GROUP of them together, after a further death
 *     one by one. A worker that is given them holds nothing else. One that asks for work while it holds
 *     other units is told that there is none, until it has delivered them; QUARANTINE_SHARE of the workers
 *     at a time, so that the job goes on meanwhile;
 *   - a unit is left out when FARM_UNIT_DEATHS workers or more died while they were alone with it, and chance
 *     can be ruled out. They must have been of two machines or more, if there is another one that may have
 *     it, and asks for work now and then (one that hangs would be waited for in vain).
 *
 * Chance: where workers are killed at random, any unit may be in the wrong hands several times. Let r be the
 * rate at which workers die of nothing in particular, per worker and second, and T the time that workers were
 * alone with the unit. By chance, then, n or more deaths have the probability P(N >= n) of a Poisson
 * distribution of mean r T, and the unit is left out only when that is below CHANCE. The rate is a mean of
 * the last minutes (farm->trust->deaths), which begins at one death in an hour; deaths with this unit do not
 * count, those with other suspects only when these have been delivered. With a death an hour and five seconds
 * for each of five deaths P is 1e-13. Where each worker lives for 12 s only, five deaths in 25 s have a
 * probability of 6 %, and it takes some fifty in a row without a single delivery. Of ten thousand units that
 * are ever alone with a worker when it dies, chance thus makes one be left out in a thousand jobs at most.
 *
 * Where one unit of a tile kills, others do: in such a tile KNOWN_DEATHS suffice, and KNOWN_CHANCE.
 *
 * Suspects are forgotten when the master ends; what was left out stays so (schedule_skip). Units may be cut
 * anew between two deaths, so suspicion lies on ranges of samples: a sorted list without overlap. */
#include "master/trust/trust_state.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAX_SUSPECTS = 4096,  /* more are not remembered */
    MAX_DEATHS = 128,     /* of a unit, the latest ones */
    KEPT_DEATHS = 2,      /* from which on a unit is kept from others */
    GROUP = 8,            /* units handed out together, as long as they have no more than KEPT_DEATHS */
    QUARANTINE_SHARE = 4, /* one worker in so many may have suspects */
    MAX_TOLD = 3,         /* units that the message of the job names */
    KNOWN_DEATHS = 2,     /* where a unit of the same tile was left out */
    BASE_SECONDS = 360    /* what the rate of deaths begins with: a tenth of a death in so many */
};
static const double BASE_DEATHS = 0.1;
static const double CHANCE = 1e-7, KNOWN_CHANCE = 1e-3;

/* A worker that died with the unit. */
typedef struct {
    uint64_t worker, party;
    bool apart;     /* it had nothing but suspects */
    double seconds; /* that it was alone with it; 0: it was not */
} death_t;

typedef struct {
    unit_t unit;
    death_t *deaths;
    uint32_t death_count;
    bool kept;       /* the farm holds it */
    uint64_t holder; /* the worker that it was handed out to apart; 0: none */
    double issued;   /* seconds, when */
} suspect_t;

struct job_suspects {
    suspect_t *list; /* sorted by tile and sample */
    size_t count, capacity;
    size_t kept; /* of them by the farm */
    size_t out;  /* of them handed out apart */
    unit_t *left_out;
    size_t left_out_count;
};

/* ---- the list ------------------------------------------------------------------------------------------ */

static uint32_t unit_end(const unit_t *unit)
{
    return unit->first + unit->count;
}

/* The first suspect that is not before a sample of a tile. */
static size_t suspect_at(const job_suspects_t *s, uint32_t tile, uint32_t sample)
{
    size_t low = 0, high = s->count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        const unit_t *unit = &s->list[middle].unit;
        if (unit->tile > tile || (unit->tile == tile && unit_end(unit) > sample))
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

static bool overlaps(const job_suspects_t *s, size_t at, uint32_t tile, uint32_t end)
{
    return at < s->count && s->list[at].unit.tile == tile && s->list[at].unit.first < end;
}

static void insert_at(job_suspects_t *s, size_t at, suspect_t suspect)
{
    if (s->count == s->capacity) {
        s->capacity = 2 * s->capacity + 16;
        s->list = mem_realloc(s->list, s->capacity * sizeof *s->list);
    }
    memmove(s->list + at + 1, s->list + at, (s->count - at) * sizeof *s->list);
    s->list[at] = suspect;
    s->count++;
    s->kept += suspect.kept;
    s->out += suspect.holder != 0;
}

static void remove_at(job_suspects_t *s, size_t at)
{
    s->kept -= s->list[at].kept;
    s->out -= s->list[at].holder != 0;
    free(s->list[at].deaths);
    memmove(s->list + at, s->list + at + 1, (--s->count - at) * sizeof *s->list);
}

/* The part [first, end) of a suspect, with memory of its own. */
static suspect_t part_of(const suspect_t *suspect, uint32_t first, uint32_t end)
{
    suspect_t part = *suspect;
    part.unit = (unit_t){suspect->unit.tile, first, end - first};
    part.deaths = mem_alloc((suspect->death_count + 1) * sizeof *part.deaths);
    memcpy(part.deaths, suspect->deaths, suspect->death_count * sizeof *part.deaths);
    return part;
}

/* Splits a suspect so that what it has in [first, end), which is something, is one by itself; returns its
 * index. */
static size_t cut(job_suspects_t *s, size_t at, uint32_t first, uint32_t end)
{
    unit_t unit = s->list[at].unit;
    if (end < unit_end(&unit)) {
        insert_at(s, at + 1, part_of(&s->list[at], end, unit_end(&unit)));
        s->list[at].unit.count = end - unit.first;
    }
    if (first > unit.first) {
        insert_at(s, at, part_of(&s->list[at], unit.first, first));
        at++;
        s->list[at].unit.count -= first - unit.first;
        s->list[at].unit.first = first;
    }
    return at;
}

static void add_death(suspect_t *suspect, death_t death)
{
    if (suspect->death_count == MAX_DEATHS)
        memmove(suspect->deaths, suspect->deaths + 1, --suspect->death_count * sizeof death);
    suspect->deaths = mem_realloc(suspect->deaths, (suspect->death_count + 1) * sizeof death);
    suspect->deaths[suspect->death_count++] = death;
}

/* A worker died with this unit. */
static void note(job_suspects_t *s, const unit_t *unit, death_t death)
{
    uint32_t end = unit_end(unit);
    for (uint32_t from = unit->first; from < end;) {
        size_t at = suspect_at(s, unit->tile, from);
        bool known = overlaps(s, at, unit->tile, end);
        if (known && s->list[at].unit.first <= from) {
            at = cut(s, at, from, end);
            add_death(&s->list[at], death);
            from = unit_end(&s->list[at].unit);
        } else {
            uint32_t to = known ? s->list[at].unit.first : end;
            if (s->count >= MAX_SUSPECTS) return;
            insert_at(s, at, (suspect_t){.unit = {unit->tile, from, to - from}});
            add_death(&s->list[at], death);
            from = to;
        }
    }
}

/* Those who died alone with a unit that was delivered now did not die of it. */
static void note_innocent(farm_t *farm, const suspect_t *suspect)
{
    for (uint32_t i = 0; i < suspect->death_count; i++) {
        farm->trust->deaths += suspect->deaths[i].seconds > 0;
        farm->trust->worker_seconds += suspect->deaths[i].seconds;
    }
}

void suspects_delivered(farm_t *farm, job_t *job, const unit_t *units, size_t count)
{
    job_suspects_t *s = job->suspects;
    for (size_t i = 0; s != NULL && s->count > 0 && i < count; i++) {
        uint32_t end = unit_end(&units[i]);
        size_t at = suspect_at(s, units[i].tile, units[i].first);
        while (overlaps(s, at, units[i].tile, end)) {
            at = cut(s, at, units[i].first, end); /* what is left of it lies before */
            note_innocent(farm, &s->list[at]);
            remove_at(s, at);
        }
    }
}

void suspects_free(job_suspects_t **suspects)
{
    job_suspects_t *s = *suspects;
    if (s == NULL) return;
    for (size_t i = 0; i < s->count; i++) free(s->list[i].deaths);
    free(s->list);
    free(s->left_out);
    free(s);
    *suspects = NULL;
}

bool suspects_waiting(const job_t *job)
{
    return job->suspects != NULL && job->suspects->kept > 0;
}

size_t suspects_count(const job_t *job)
{
    return job->suspects != NULL ? job->suspects->kept + job->suspects->out : 0;
}

/* ---- keeping apart ------------------------------------------------------------------------------------- */

static void keep(job_t *job, suspect_t *suspect)
{
    if (suspect->kept || suspect->holder != 0 || suspect->death_count < KEPT_DEATHS) return;
    suspect->kept = schedule_issue(job->schedule, 0, &suspect->unit);
    job->suspects->kept += suspect->kept;
}

static void set_holder(job_t *job, suspect_t *suspect, uint64_t holder)
{
    job->suspects->out -= suspect->holder != 0;
    job->suspects->out += holder != 0;
    suspect->holder = holder;
}

static void let_go(job_t *job, suspect_t *suspect)
{
    if (!suspect->kept) return;
    schedule_release_units(job->schedule, 0, &suspect->unit, 1);
    suspect->kept = false;
    job->suspects->kept--;
}

/* ---- leaving out --------------------------------------------------------------------------------------- */

/* Workers that died while they were alone with a suspect, and for how long they were, seconds. */
static uint32_t lonely_deaths(const suspect_t *suspect, double *seconds)
{
    uint32_t count = 0;
    *seconds = 0;
    for (uint32_t i = 0; i < suspect->death_count; i++) {
        count += suspect->deaths[i].seconds > 0;
        *seconds += suspect->deaths[i].seconds;
    }
    return count;
}

/* How bad it was for a machine: its worst experience with a suspect. */
typedef enum { RECORD_CLEAN, RECORD_DIED, RECORD_DIED_ALONE } record_t;

static record_t machine_record(const suspect_t *suspect, uint64_t machine)
{
    record_t record = RECORD_CLEAN;
    for (uint32_t i = 0; i < suspect->death_count; i++) {
        if (suspect->deaths[i].party != machine) continue;
        if (suspect->deaths[i].seconds > 0) return RECORD_DIED_ALONE;
        record = RECORD_DIED;
    }
    return record;
}

static bool killed_several_machines(const suspect_t *suspect)
{
    uint64_t first = 0;
    for (uint32_t i = 0; i < suspect->death_count; i++) {
        const death_t *death = &suspect->deaths[i];
        if (death->seconds <= 0) continue;
        if (first != 0 && death->party != first) return true;
        first = death->party;
    }
    return false;
}

/* True when there is a machine that may have the suspect and has a better record than that, and that has
 * asked for work in so many batch intervals. */
static bool better_machine(const farm_t *farm, double now, const job_t *job, const suspect_t *suspect,
                           record_t record, int batches)
{
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        if (farm_worker_asks(farm, now, worker, batches) && farm_bits_fit(job, &worker->fingerprint) &&
            machine_record(suspect, worker->party) < record)
            return true;
    }
    return false;
}

/* The probability of n or more events of a Poisson distribution. */
static double poisson_tail(double mean, uint32_t n)
{
    double term = exp(-mean), sum = 0;
    for (uint32_t k = 1; k <= n; k++) term *= mean / k;
    for (uint32_t k = n + 1; k < n + 200; k++) {
        sum += term;
        term *= mean / k;
    }
    return sum;
}

/* True when a unit of the tile was left out. */
static bool tile_kills(const job_suspects_t *s, uint32_t tile)
{
    for (size_t i = 0; i < s->left_out_count; i++)
        if (s->left_out[i].tile == tile) return true;
    return false;
}

static bool is_killer(const farm_t *farm, double now, const job_t *job, const suspect_t *suspect)
{
    double seconds;
    uint32_t deaths = lonely_deaths(suspect, &seconds);
    bool known = tile_kills(job->suspects, suspect->unit.tile);
    if (deaths < (known ? KNOWN_DEATHS : FARM_UNIT_DEATHS)) return false;
    if (!killed_several_machines(suspect) &&
        better_machine(farm, now, job, suspect, RECORD_DIED_ALONE, FARM_LOAD_BATCHES))
        return false;
    double others = farm->trust->deaths;
    for (uint32_t i = 0; i < suspect->death_count; i++) others -= !suspect->deaths[i].apart;
    double rate = (fmax(others, 0) + BASE_DEATHS) / (farm->trust->worker_seconds + BASE_SECONDS);
    return poisson_tail(rate * seconds, deaths) < (known ? KNOWN_CHANCE : CHANCE);
}

static void leave_out(farm_t *farm, job_t *job, size_t at)
{
    suspect_t *suspect = &job->suspects->list[at];
    unit_t unit = suspect->unit;
    double seconds;
    uint32_t deaths = lonely_deaths(suspect, &seconds);
    let_go(job, suspect);
    schedule_skip(job->schedule, &unit);
    log_error("job %llu: tile %u, samples %u to %u are left out: %u workers died while they had nothing else "
              "to render",
              (unsigned long long)job->kept.job, unit.tile, unit.first, unit_end(&unit) - 1, deaths);
    job_suspects_t *s = job->suspects;
    s->left_out = mem_realloc(s->left_out, (s->left_out_count + 1) * sizeof unit);
    s->left_out[s->left_out_count++] = unit;
    if (s->left_out_count <= MAX_TOLD)
        farm_job_tell(farm, job, "tile %u, samples %u to %u are left out: they ended %u workers", unit.tile,
                      unit.first, unit_end(&unit) - 1, deaths);
    else if (strstr(job->kept.message, "more are left out") == NULL)
        farm_job_tell(farm, job, "more are left out: see the log");
    remove_at(s, at);
    job->progress_due = true;
}

/* ---- deaths -------------------------------------------------------------------------------------------- */

/* True when a worker of another machine died with a part of the unit. */
static bool killed_elsewhere(const job_suspects_t *s, const unit_t *unit, uint64_t machine)
{
    for (size_t at = suspect_at(s, unit->tile, unit->first); overlaps(s, at, unit->tile, unit_end(unit));
         at++)
        for (uint32_t i = 0; i < s->list[at].death_count; i++)
            if (s->list[at].deaths[i].party != machine) return true;
    return false;
}

bool suspects_died(farm_t *farm, double now, job_t *job, const worker_t *worker, bool *apart)
{
    *apart = false;
    if (job->schedule == NULL || job->flush_until > 0) return false;
    size_t count, given = 0; /* suspects that it was given apart */
    unit_t *units = schedule_units_of(job->schedule, worker->id, &count);
    if (count > 0 && job->suspects == NULL) job->suspects = mem_zalloc(1, sizeof *job->suspects);
    job_suspects_t *s = job->suspects;
    double issued = now;
    for (size_t i = 0; s != NULL && i < s->count; i++) {
        if (s->list[i].holder != worker->id) continue;
        given++;
        issued = s->list[i].issued;
    }
    death_t death = {.worker = worker->id, .party = worker->party, .apart = given > 0};
    /* It died some time between its last sign of life and now. */
    if (given == 1) death.seconds = fmax(worker->last_seen + 0.5 * farm->options.lease - issued, 1e-3);
    bool excused = given > 0;
    for (size_t i = 0; i < count; i++) {
        excused = excused || killed_elsewhere(s, &units[i], worker->party);
        note(s, &units[i], death);
    }
    free(units);
    *apart = given > 0;
    return excused;
}

void trust_released(farm_t *farm, double now, job_t *job, uint64_t worker)
{
    job_suspects_t *s = job->suspects;
    for (size_t i = 0; s != NULL && i < s->count; i++) {
        if (s->list[i].holder == worker) set_holder(job, &s->list[i], 0);
        keep(job, &s->list[i]);
        if (s->list[i].kept && is_killer(farm, now, job, &s->list[i])) leave_out(farm, job, i--);
    }
}

/* Takes a death back; true when the unit is not suspect any more. */
static bool forgive(job_t *job, suspect_t *suspect, uint64_t worker)
{
    for (uint32_t i = 0; i < suspect->death_count; i++) {
        if (suspect->deaths[i].worker != worker) continue;
        memmove(suspect->deaths + i, suspect->deaths + i + 1,
                (--suspect->death_count - i) * sizeof *suspect->deaths);
        break;
    }
    if (suspect->death_count < KEPT_DEATHS) let_go(job, suspect);
    return suspect->death_count == 0 && suspect->holder == 0;
}

void suspects_lives(farm_t *farm, uint64_t worker)
{
    for (size_t j = 0; j < farm->job_count; j++) {
        job_t *job = farm->jobs[j];
        job_suspects_t *s = job->schedule != NULL ? job->suspects : NULL;
        for (size_t i = 0; s != NULL && i < s->count; i++)
            if (forgive(job, &s->list[i], worker)) remove_at(s, i--);
    }
}

/* ---- handing out --------------------------------------------------------------------------------------- */

/* Workers that have suspects, or wait for some. */
static size_t quarantined(const farm_t *farm, size_t *connected)
{
    size_t count = 0;
    *connected = 0;
    for (size_t i = 0; i < farm->worker_count; i++) {
        *connected += farm->workers[i].connected;
        count += farm->workers[i].connected && farm->workers[i].quarantine != 0;
    }
    return count;
}

/* True when the worker may be given the suspect: it goes to those machines whose record with it is best. */
static bool suits(const farm_t *farm, double now, const job_t *job, const suspect_t *suspect,
                  const worker_t *worker)
{
    return suspect->kept &&
           !better_machine(farm, now, job, suspect, machine_record(suspect, worker->party), FARM_ASK_BATCHES);
}

/* The suspect that most died with; s->count when there is none for this worker. */
static size_t choose(const farm_t *farm, double now, const job_t *job, const worker_t *worker)
{
    const job_suspects_t *s = job->suspects;
    size_t best = s->count;
    for (size_t i = 0; i < s->count; i++)
        if (suits(farm, now, job, &s->list[i], worker) &&
            (best == s->count || s->list[i].death_count > s->list[best].death_count))
            best = i;
    return best;
}

static void hand_out(double now, job_t *job, suspect_t *suspect, const worker_t *worker, work_t *work)
{
    let_go(job, suspect);
    if (!schedule_issue(job->schedule, worker->id, &suspect->unit)) return;
    set_holder(job, suspect, worker->id);
    suspect->issued = now;
    work->units[work->unit_count++] = suspect->unit;
}

/* The job's units may have been taken from everybody, the farm as well, when it was paused. */
static void refresh(job_t *job)
{
    job_suspects_t *s = job->suspects;
    bool lost = s->kept > 0 && schedule_held(job->schedule, 0) == 0;
    for (size_t i = 0; i < s->count && (lost || s->out > 0); i++) {
        suspect_t *suspect = &s->list[i];
        if (suspect->holder != 0 && schedule_held(job->schedule, suspect->holder) == 0)
            set_holder(job, suspect, 0);
        if (lost) suspect->kept = false;
    }
    if (lost) s->kept = 0;
    for (size_t i = 0; i < s->count && lost; i++) keep(job, &s->list[i]);
}

trust_answer_t suspects_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work)
{
    job_suspects_t *s = job->suspects;
    bool empty = farm_worker_units(farm, worker) == 0 && !checks_held(farm, worker);
    if (!empty && worker->quarantine == job->kept.job) return TRUST_WAIT;
    if (s == NULL || s->count == 0) return TRUST_ANY;
    refresh(job);
    size_t best = s->kept > 0 ? choose(farm, now, job, worker) : s->count, connected;
    if (best == s->count) return TRUST_ANY;
    if (!empty) {
        if (quarantined(farm, &connected) * QUARANTINE_SHARE >= connected && connected > 1) return TRUST_ANY;
        worker->quarantine = job->kept.job;
        return TRUST_WAIT;
    }
    work->unit_count = 0;
    hand_out(now, job, &s->list[best], worker, work);
    bool group = s->list[best].death_count <= KEPT_DEATHS;
    for (size_t i = 0; group && i < s->count && work->unit_count < GROUP; i++)
        if (i != best && suits(farm, now, job, &s->list[i], worker))
            hand_out(now, job, &s->list[i], worker, work);
    if (work->unit_count == 0) return TRUST_ANY;
    worker->quarantine = job->kept.job;
    return TRUST_GIVEN;
}
