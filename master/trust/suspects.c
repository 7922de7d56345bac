/* suspects: units that were in the hands of workers who died, and what becomes of them.
 *
 * DESIGN. A unit may end whoever renders it: a scene that takes all memory from one point of view, a bug in a
 * library. Left alone it would go from worker to worker until none is left. So the units that a worker held
 * when it fell silent are remembered. When anything of one is delivered, it is above suspicion and forgotten;
 * when the worker is heard of after all, its death is taken back.
 *
 * What a worker loses to an idle one while it lives is remembered too, for the case that it dies of it: it is
 * held against the first of those who still live.
 *
 * Units that two workers died with are kept from the others (the farm itself holds them, as worker 0) and
 * handed out apart: first up to GROUP together, after a further death one by one, to a worker that holds
 * nothing else. One that asks for work while it holds other units is told that there is none until it has
 * delivered them, one worker in QUARANTINE_SHARE at a time, so that the job goes on meanwhile. After
 * FARM_UNIT_DEATHS more, in a row, of workers that were alone with it, a unit is left out; they must be of
 * two parties, if another one could have it. In a tile that has lost a unit KNOWN_DEATHS are enough.
 *
 * Chance: a unit alone takes a second or two. Workers that are killed at random, and live for 12 s, die in
 * that time with a probability of 15 %, twelve in a row with 1e-10.
 *
 * Suspects are forgotten when the master ends; what was left out stays so (schedule_skip). */
#include "master/trust/trust_state.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAX_SUSPECTS = 4096,  /* more are not remembered */
    KEPT_DEATHS = 2,      /* from which on a unit is kept from others, */
    ALONE_DEATHS = 3,     /* and handed out alone; before that */
    GROUP = 8,            /* so many together */
    QUARANTINE_SHARE = 4, /* one worker in so many may have suspects */
    KNOWN_DEATHS = 3,     /* instead of FARM_UNIT_DEATHS where a unit of the same tile was left out */
    MAX_TOLD = 3          /* units that the message of the job names */
};
#define SEVERAL UINT64_MAX /* in the place of a party */

typedef struct {
    unit_t unit;
    uint32_t deaths; /* of workers with it; beyond ALONE_DEATHS, in a row while they were alone with it */
    uint64_t party;  /* of these: up to ALONE_DEATHS, or beyond; 0: none yet */
    uint64_t last;   /* who died with it last, or lives and lost it first */
    bool kept;       /* the farm holds it */
    bool over;       /* it is to be forgotten */
    uint64_t holder; /* the worker that it was handed out to apart; 0: none */
} suspect_t;

struct job_suspects {
    suspect_t *list; /* sorted by tile and sample, without overlap */
    size_t count;
    size_t kept;      /* of them by the farm */
    uint32_t *deadly; /* tiles that have lost a unit */
    size_t deadly_count;
};

/* ---- the list ------------------------------------------------------------------------------------------ */

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
    free((*suspects)->deadly);
    free(*suspects);
    *suspects = NULL;
}

bool suspects_waiting(const job_t *job)
{
    return job->suspects != NULL && job->suspects->kept > 0;
}

void suspects_remark(const job_t *job, char *text, size_t size)
{
    size_t apart = 0;
    for (size_t i = 0; job->suspects != NULL && i < job->suspects->count; i++)
        apart += job->suspects->list[i].kept || job->suspects->list[i].holder != 0;
    text[0] = '\0';
    if (apart > 0) snprintf(text, size, "%zu units that workers died with are rendered apart", apart);
}

/* ---- deaths -------------------------------------------------------------------------------------------- */

/* Remembers that a worker had this unit, which takes the place of the suspects that it has samples of: of the
 * first `count`. */
static void note(job_suspects_t *s, size_t count, uint64_t worker, const unit_t *unit)
{
    suspect_t fresh = {.deaths = 0};
    for (size_t at = suspect_at(s, count, unit->tile, unit->first);
         at < count && overlaps(&s->list[at], unit); at++) {
        if (s->list[at].deaths > fresh.deaths) fresh = s->list[at];
        s->list[at].over = true;
    }
    fresh.unit = *unit;
    fresh.last = worker;
    fresh.kept = fresh.over = false;
    if (s->count < MAX_SUSPECTS) s->list[s->count++] = fresh;
}

static job_suspects_t *suspects_of(job_t *job)
{
    if (job->suspects == NULL) {
        job->suspects = mem_zalloc(1, sizeof *job->suspects);
        job->suspects->list = mem_alloc(MAX_SUSPECTS * sizeof *job->suspects->list);
    }
    return job->suspects;
}

/* True when a worker that lives lost the unit before. */
static bool is_remembered(const farm_t *farm, const job_suspects_t *s, size_t count, const unit_t *unit)
{
    size_t at = suspect_at(s, count, unit->tile, unit->first);
    const worker_t *last =
        at < count && overlaps(&s->list[at], unit) ? farm_find_worker(farm, s->list[at].last) : NULL;
    return last != NULL && last->connected;
}

/* Remembers what a worker holds, that died or is about to lose it. */
static void note_all(const farm_t *farm, job_t *job, uint64_t worker, bool died)
{
    size_t count;
    unit_t *units = schedule_units_of(job->schedule, worker, &count);
    size_t known = count > 0 ? suspects_of(job)->count : 0;
    for (size_t i = 0; i < count; i++)
        if (died || !is_remembered(farm, job->suspects, known, &units[i]))
            note(job->suspects, known, worker, &units[i]);
    if (count > 0) tidy(job);
    free(units);
}

void suspects_recalled(const farm_t *farm, job_t *job, uint64_t worker)
{
    if (job->schedule != NULL) note_all(farm, job, worker, false);
}

/* A worker died with this unit, and perhaps with nothing else. True when that may be the unit's fault: it was
 * handed out to the worker apart, or others of another party died with it. */
static bool blame(suspect_t *suspect, const worker_t *worker, bool only)
{
    bool apart = suspect->holder == worker->id;
    if (suspect->deaths >= ALONE_DEATHS && !(apart && only)) return apart || suspect->party != worker->party;
    if (suspect->deaths == ALONE_DEATHS) suspect->party = 0;
    suspect->deaths++;
    suspect->party = suspect->party == 0 || suspect->party == worker->party ? worker->party : SEVERAL;
    return apart || suspect->party == SEVERAL;
}

bool suspects_died(farm_t *farm, job_t *job, const worker_t *worker)
{
    if (job->schedule == NULL || job->flush_until > 0) return false;
    note_all(farm, job, worker->id, true);
    job_suspects_t *s = job->suspects;
    size_t count = 0;
    bool excused = false;
    for (size_t i = 0; s != NULL && i < s->count; i++) count += s->list[i].last == worker->id;
    for (size_t i = 0; count > 0 && i < s->count; i++)
        if (s->list[i].last == worker->id) excused |= blame(&s->list[i], worker, count == 1);
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
            if (suspect->deaths > 0) suspect->deaths--;
            if (suspect->deaths < KEPT_DEATHS) let_go(job, suspect);
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
    if (suspect->deaths < ALONE_DEATHS + (known ? KNOWN_DEATHS : FARM_UNIT_DEATHS)) return false;
    return suspect->party == SEVERAL || !other_could(farm, now, job, suspect->party, FARM_LOAD_BATCHES);
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
              suspect->deaths - ALONE_DEATHS);
    s->deadly = mem_realloc(s->deadly, (s->deadly_count + 1) * sizeof *s->deadly);
    s->deadly[s->deadly_count++] = unit->tile;
    if (s->deadly_count <= MAX_TOLD)
        farm_job_tell(farm, job, "tile %u, samples %u to %u are left out: they ended %u workers", unit->tile,
                      unit->first, unit_end(unit) - 1, suspect->deaths - ALONE_DEATHS);
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
    return suspect->party != worker->party || !other_could(farm, now, job, worker->party, FARM_ASK_BATCHES);
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
    for (size_t most = best->deaths < ALONE_DEATHS ? GROUP : 1;
         best != NULL && best->kept && work->unit_count < most; best = choose(farm, now, job, worker))
        hand_out(job, best, worker, work);
    if (work->unit_count > 0) return TRUST_GIVEN;
    worker->quarantine = 0;
    return TRUST_ANY;
}
