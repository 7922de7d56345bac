/* suspects: units that were in the hands of workers who died, and what becomes of them.
 *
 * DESIGN. A unit may end whoever renders it: a scene that takes all memory from one point of view, a bug in a
 * library. Left alone it would go from worker to worker until none is left. So the units that a worker held
 * when it fell silent are remembered. When anything of one is delivered, it is above suspicion and forgotten;
 * when the worker is heard of after all, its death is taken back.
 *
 * What a worker lost to an idle one a moment before it died counts as well.
 *
 * Units that two workers died with are kept from the others (the farm itself holds them, as worker 0) and
 * handed out apart: first up to GROUP together, after a further death one by one, to a worker that holds
 * nothing else. One that asks for work while it holds other units is told that there is none until it has
 * delivered them, one worker in QUARANTINE_SHARE at a time, so that the job goes on meanwhile. After
 * FARM_UNIT_DEATHS workers in a row that died while they were alone with it, a unit is left out; they must be
 * of two parties, if another one could have it. In a tile that has lost a unit KNOWN_DEATHS are enough.
 *
 * Chance: a unit alone takes a second or two. Workers that are killed at random, and live for 12 s, die in
 * that time with a probability of 15 %, twelve in a row with 1e-10.
 *
 * Suspects are forgotten when the master ends; what was left out stays so (schedule_skip). */
#include "master/trust/trust_state.h"

#include <stdlib.h>
#include <string.h>

enum {
    MAX_SUSPECTS = 4096,  /* more are not remembered */
    KEPT_DEATHS = 2,      /* from which on a unit is kept from others */
    GROUP = 8,            /* units handed out together, as long as they have no more than KEPT_DEATHS */
    QUARANTINE_SHARE = 4, /* one worker in so many may have suspects */
    KNOWN_DEATHS = 3,     /* instead of FARM_UNIT_DEATHS where a unit of the same tile was left out */
    RECALLED_LEASES = 3,  /* for which a unit that was recalled is remembered */
    MAX_TOLD = 3          /* units that the message of the job names */
};
#define SEVERAL UINT64_MAX /* in the place of a party */

typedef struct {
    unit_t unit;
    uint32_t deaths, lonely;      /* workers that died with it, and in a row while they were alone with it */
    uint64_t party, lonely_party; /* of these; 0: none yet */
    uint64_t last;                /* who died last, */
    bool last_alone;              /* and whether alone with it */
    bool kept;                    /* the farm holds it */
    bool over;                    /* it is to be forgotten */
    uint64_t holder;              /* the worker that it was handed out to apart; 0: none */
} suspect_t;

/* A unit that a worker lost while it lived, to one that was idle: it may be about to die of it. */
typedef struct {
    unit_t unit;
    uint64_t worker;
    double when; /* seconds */
} recalled_t;

struct job_suspects {
    recalled_t *recalled;
    size_t recalled_count;
    suspect_t *list; /* sorted by tile and sample, without overlap */
    size_t count;
    size_t kept;      /* of them by the farm */
    uint32_t *deadly; /* tiles that have lost a unit */
    size_t deadly_count;
};

/* ---- the list ------------------------------------------------------------------------------------------ */

static uint32_t unit_end(const unit_t *unit)
{
    return unit->first + unit->count;
}

/* The first of `count` suspects that is not before a sample of a tile. */
static size_t suspect_at(const job_suspects_t *s, size_t count, uint32_t tile, uint32_t sample)
{
    size_t low = 0, high = count;
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

static bool overlaps(const suspect_t *suspect, const unit_t *unit)
{
    return suspect->unit.tile == unit->tile && suspect->unit.first < unit_end(unit);
}

static void let_go(job_t *job, suspect_t *suspect)
{
    if (!suspect->kept) return;
    schedule_release_units(job->schedule, 0, &suspect->unit, 1);
    suspect->kept = false;
    job->suspects->kept--;
}

static void keep(job_t *job, suspect_t *suspect)
{
    if (suspect->kept || suspect->holder != 0 || suspect->deaths < KEPT_DEATHS) return;
    suspect->kept = schedule_issue(job->schedule, 0, &suspect->unit);
    job->suspects->kept += suspect->kept;
}

static int suspect_order(const void *a, const void *b)
{
    const unit_t *p = &((const suspect_t *)a)->unit, *q = &((const suspect_t *)b)->unit;
    if (p->tile != q->tile) return p->tile < q->tile ? -1 : 1;
    return p->first < q->first ? -1 : p->first > q->first;
}

/* Forgets those that are over, and puts the others in order. */
static void tidy(job_t *job)
{
    job_suspects_t *s = job->suspects;
    size_t count = 0;
    for (size_t i = 0; i < s->count; i++) {
        if (s->list[i].over)
            let_go(job, &s->list[i]);
        else
            s->list[count++] = s->list[i];
    }
    s->count = count;
    qsort(s->list, count, sizeof *s->list, suspect_order);
}

void suspects_delivered(job_t *job, const unit_t *units, size_t count)
{
    job_suspects_t *s = job->suspects;
    bool any = false;
    for (size_t i = 0; s != NULL && s->count > 0 && i < count; i++)
        for (size_t at = suspect_at(s, s->count, units[i].tile, units[i].first);
             at < s->count && overlaps(&s->list[at], &units[i]); at++)
            any = s->list[at].over = true;
    if (any) tidy(job);
}

void suspects_free(job_suspects_t **suspects)
{
    if (*suspects == NULL) return;
    free((*suspects)->list);
    free((*suspects)->recalled);
    free((*suspects)->deadly);
    free(*suspects);
    *suspects = NULL;
}

bool suspects_waiting(const job_t *job)
{
    return job->suspects != NULL && job->suspects->kept > 0;
}

size_t suspects_count(const job_t *job)
{
    size_t apart = 0;
    for (size_t i = 0; job->suspects != NULL && i < job->suspects->count; i++)
        apart += job->suspects->list[i].kept || job->suspects->list[i].holder != 0;
    return apart;
}

/* ---- deaths -------------------------------------------------------------------------------------------- */

/* A worker died with this unit, which takes the place of the suspects that it has samples of: of the first
 * `count`. True when the worker was given it apart, or others of another party died with it. */
static bool note(job_suspects_t *s, size_t count, const worker_t *worker, const unit_t *unit, bool alone)
{
    suspect_t fresh = {
        .unit = *unit, .party = worker->party, .last = worker->id, .last_alone = alone, .lonely = alone};
    bool apart = false;
    for (size_t at = suspect_at(s, count, unit->tile, unit->first);
         at < count && overlaps(&s->list[at], unit); at++) {
        suspect_t *known = &s->list[at];
        apart = apart || known->holder == worker->id;
        if (known->party != fresh.party) fresh.party = SEVERAL;
        if (known->lonely + alone > fresh.lonely) fresh.lonely = known->lonely + alone;
        if (known->deaths > fresh.deaths) fresh.deaths = known->deaths;
        if (known->lonely_party != 0) fresh.lonely_party = known->lonely_party;
        known->over = true;
    }
    fresh.deaths++;
    if (alone && fresh.lonely_party != worker->party)
        fresh.lonely_party = fresh.lonely_party == 0 ? worker->party : SEVERAL;
    if (s->count < MAX_SUSPECTS) s->list[s->count++] = fresh;
    return apart || fresh.party == SEVERAL;
}

static job_suspects_t *suspects_of(job_t *job)
{
    if (job->suspects == NULL) {
        job->suspects = mem_zalloc(1, sizeof *job->suspects);
        job->suspects->list = mem_alloc(MAX_SUSPECTS * sizeof *job->suspects->list);
        job->suspects->recalled = mem_alloc(MAX_SUSPECTS * sizeof *job->suspects->recalled);
    }
    return job->suspects;
}

void suspects_recalled(farm_t *farm, double now, job_t *job, uint64_t worker)
{
    size_t count, kept = 0;
    if (job->schedule == NULL) return;
    unit_t *units = schedule_units_of(job->schedule, worker, &count);
    job_suspects_t *s = count > 0 ? suspects_of(job) : NULL;
    for (size_t i = 0; s != NULL && i < s->recalled_count; i++)
        if (now - s->recalled[i].when < RECALLED_LEASES * farm->options.lease)
            s->recalled[kept++] = s->recalled[i];
    for (size_t i = 0; i < count && kept < MAX_SUSPECTS; i++)
        s->recalled[kept++] = (recalled_t){units[i], worker, now};
    if (s != NULL) s->recalled_count = kept;
    free(units);
}

/* What a worker holds, or lost a moment ago, in fresh memory. */
static unit_t *last_units(const farm_t *farm, double now, const job_t *job, uint64_t worker, size_t *count)
{
    const job_suspects_t *s = job->suspects;
    unit_t *units = schedule_units_of(job->schedule, worker, count);
    for (size_t i = 0; s != NULL && i < s->recalled_count; i++) {
        const recalled_t *recalled = &s->recalled[i];
        if (recalled->worker != worker || now - recalled->when >= RECALLED_LEASES * farm->options.lease)
            continue;
        units = mem_realloc(units, (*count + 1) * sizeof *units);
        units[(*count)++] = recalled->unit;
    }
    return units;
}

bool suspects_died(farm_t *farm, double now, job_t *job, const worker_t *worker)
{
    if (job->schedule == NULL || job->flush_until > 0) return false;
    size_t count;
    unit_t *units = last_units(farm, now, job, worker->id, &count);
    bool excused = false, alone = count == 1 && worker->quarantine == job->kept.job;
    size_t known = count > 0 ? suspects_of(job)->count : 0;
    for (size_t i = 0; i < count; i++) excused |= note(job->suspects, known, worker, &units[i], alone);
    if (count > 0) tidy(job);
    free(units);
    return excused;
}

void suspects_lives(farm_t *farm, uint64_t worker)
{
    for (size_t j = 0; j < farm->job_count; j++) {
        job_t *job = farm->jobs[j];
        job_suspects_t *s = job->schedule != NULL ? job->suspects : NULL;
        for (size_t i = 0; s != NULL && i < s->count; i++) {
            suspect_t *suspect = &s->list[i];
            if (suspect->last != worker) continue;
            suspect->last = 0;
            suspect->lonely -= suspect->last_alone;
            if (--suspect->deaths < KEPT_DEATHS) let_go(job, suspect);
            suspect->over = suspect->deaths == 0;
        }
        if (s != NULL) tidy(job);
    }
}

/* ---- leaving out --------------------------------------------------------------------------------------- */

/* True when somebody of another party may have the job's units, and has asked for work in so many batch
 * intervals. */
static bool other_could(const farm_t *farm, double now, const job_t *job, uint64_t party, int batches)
{
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        if (worker->party != party && !worker->lapsed && farm_worker_asks(farm, now, worker, batches) &&
            farm_bits_fit(job, &worker->fingerprint))
            return true;
    }
    return false;
}

static bool is_killer(const farm_t *farm, double now, const job_t *job, const suspect_t *suspect)
{
    const job_suspects_t *s = job->suspects;
    bool known = false;
    for (size_t i = 0; i < s->deadly_count; i++) known = known || s->deadly[i] == suspect->unit.tile;
    if (suspect->lonely < (known ? KNOWN_DEATHS : FARM_UNIT_DEATHS)) return false;
    return suspect->lonely_party == SEVERAL ||
           !other_could(farm, now, job, suspect->lonely_party, FARM_LOAD_BATCHES);
}

static void leave_out(farm_t *farm, job_t *job, suspect_t *suspect)
{
    job_suspects_t *s = job->suspects;
    const unit_t *unit = &suspect->unit;
    let_go(job, suspect);
    schedule_skip(job->schedule, unit);
    suspect->over = true;
    log_error("job %llu: tile %u, samples %u to %u are left out: %u workers died while they had nothing else "
              "to render",
              (unsigned long long)job->kept.job, unit->tile, unit->first, unit_end(unit) - 1,
              suspect->lonely);
    s->deadly = mem_realloc(s->deadly, (s->deadly_count + 1) * sizeof *s->deadly);
    s->deadly[s->deadly_count++] = unit->tile;
    if (s->deadly_count <= MAX_TOLD)
        farm_job_tell(farm, job, "tile %u, samples %u to %u are left out: they ended %u workers", unit->tile,
                      unit->first, unit_end(unit) - 1, suspect->lonely);
    else if (strstr(job->kept.message, "more are left out") == NULL)
        farm_job_tell(farm, job, "more are left out: see the log");
    job->progress_due = true;
}

void trust_released(farm_t *farm, double now, job_t *job, uint64_t worker)
{
    job_suspects_t *s = job->suspects;
    for (size_t i = 0; s != NULL && i < s->count; i++) {
        if (s->list[i].holder == worker) s->list[i].holder = 0;
        keep(job, &s->list[i]);
        if (s->list[i].kept && is_killer(farm, now, job, &s->list[i])) leave_out(farm, job, &s->list[i]);
    }
    if (s != NULL) tidy(job);
}

/* ---- handing out --------------------------------------------------------------------------------------- */

/* True when one more worker may wait until it can have suspects. */
static bool may_wait(const farm_t *farm)
{
    size_t count = 0, connected = 0;
    for (size_t i = 0; i < farm->worker_count; i++) {
        connected += farm->workers[i].connected;
        count += farm->workers[i].connected && farm->workers[i].quarantine != 0;
    }
    return count * QUARANTINE_SHARE < connected || connected == 1;
}

/* True when the worker may be given the suspect: it goes to other parties than the one that died with it. */
static bool suits(const farm_t *farm, double now, const job_t *job, const suspect_t *suspect,
                  const worker_t *worker)
{
    if (!suspect->kept) return false;
    return (suspect->party != worker->party && suspect->lonely_party != worker->party) ||
           !other_could(farm, now, job, worker->party, FARM_ASK_BATCHES);
}

/* The suspect that most died with; NULL when there is none for this worker. */
static suspect_t *choose(const farm_t *farm, double now, const job_t *job, const worker_t *worker)
{
    const job_suspects_t *s = job->suspects;
    suspect_t *best = NULL;
    for (size_t i = 0; i < s->count; i++)
        if ((best == NULL || s->list[i].deaths > best->deaths) && suits(farm, now, job, &s->list[i], worker))
            best = &s->list[i];
    return best;
}

static void hand_out(job_t *job, suspect_t *suspect, const worker_t *worker, work_t *work)
{
    let_go(job, suspect);
    if (!schedule_issue(job->schedule, worker->id, &suspect->unit)) return;
    suspect->holder = worker->id;
    work->units[work->unit_count++] = suspect->unit;
}

trust_answer_t suspects_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work)
{
    job_suspects_t *s = job->suspects;
    bool empty = farm_worker_units(farm, worker) == 0 && !checks_held(farm, worker);
    if (!empty && worker->quarantine == job->kept.job) return TRUST_WAIT;
    if (s == NULL || s->count == 0) return TRUST_ANY;
    for (size_t i = 0; i < s->count; i++) { /* a flush or a refused batch may have freed them */
        if (s->list[i].holder != 0 && schedule_held(job->schedule, s->list[i].holder) == 0)
            s->list[i].holder = 0;
        keep(job, &s->list[i]);
    }
    suspect_t *best = s->kept > 0 ? choose(farm, now, job, worker) : NULL;
    if (best == NULL || (!empty && !may_wait(farm))) return TRUST_ANY;
    worker->quarantine = job->kept.job;
    if (!empty) return TRUST_WAIT;
    work->unit_count = 0;
    bool group = best->deaths == KEPT_DEATHS;
    hand_out(job, best, worker, work);
    for (size_t i = 0; group && i < s->count && work->unit_count < GROUP; i++)
        if (s->list[i].deaths == KEPT_DEATHS && suits(farm, now, job, &s->list[i], worker))
            hand_out(job, &s->list[i], worker, work);
    if (work->unit_count > 0) return TRUST_GIVEN;
    worker->quarantine = 0;
    return TRUST_ANY;
}
