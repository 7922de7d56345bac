/* window: how much a worker may hold, by what it and its party delivered of late.
 *
 * DESIGN. A worker says itself how much it wants, and whether it lives. So what it may hold goes by what it
 * delivered, as TCP's window goes by what was acknowledged:
 *
 *   - a worker that has delivered nothing yet is given FIRST_LEASES leases of work, by its own measure or
 * that of others at the job. Since it runs out of work, it delivers at once, and not after a batch interval;
 *   - one that delivers may hold IN_HAND times what it delivers from one batch to the next, and GROWTH times
 *     what it delivered in the last minute. So the window opens with two or three batches;
 *   - units that lapse, since their worker fell silent or nothing of them came while another had nothing to
 * do (of one that has delivered nothing, also when it is overtaken: batches may come so often that this is
 * long before a lease), halve the windows of its party. A delivery of the party doubles them. Until they are
 * what they were, its workers that have delivered nothing are given units one at a time, a lease after the
 * last lapse, two, four, and so on. So new names do not make the window larger. Where there is no other party
 * nothing is held against it.
 *
 * When somebody is idle, what others hold and do not deliver goes to it. Who has delivered nothing yet is
 * left its units for a lease, or not at all when units of its party have lapsed before; who has, for two
 * batches and a lease. The first result wins, so a slow start costs nobody anything: it is not held against a
 * worker that its first batch takes a minute. Only a party that takes units and delivers none for
 * FRUITLESS_LEASES is put aside, with the next lapses (standing.c).
 *
 * Workers of the master's own process have no window. */
#include "master/trust/trust_state.h"

#include <math.h>

enum { MOST_LAPSES = 4, FRUITLESS_LEASES = 60, IN_HAND = 3, GROWTH = 4 };
static const double FIRST_LEASES = 0.5;

/* Lapses of the worker's party that deliveries have not made up for. */
static uint32_t lapses_of(const farm_t *farm, const worker_t *worker)
{
    const standing_t *standing = standing_find(farm, worker->party);
    return standing == NULL || standing_alone(farm, worker->party) ? 0 : standing->lapses;
}

static double in_hand(const farm_t *farm, const worker_t *worker)
{
    return farm_worker_units(farm, worker) > 0 ? worker->held : 0;
}

/* What the workers of the party hold that have delivered nothing. */
static double held_by_new(const farm_t *farm, uint64_t party)
{
    double held = 0;
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        if (worker->connected && worker->party == party && worker->batches == 0)
            held += in_hand(farm, worker);
    }
    return held;
}

/* True when a worker that has delivered nothing may be given units though those of its party lapsed. */
static bool may_try(const farm_t *farm, double now, const worker_t *worker, uint32_t lapses)
{
    double pause = farm->options.lease * exp2(lapses);
    return now - standing_find(farm, worker->party)->lapsed >= pause && held_by_new(farm, worker->party) <= 0;
}

double trust_room(const farm_t *farm, double now, const job_t *job, const worker_t *worker, double speed)
{
    if (worker->key[0] == '\0' && worker->address[0] == '\0') return INFINITY;
    uint32_t lapses = lapses_of(farm, worker);
    double share = exp2(-(double)lapses), first = FIRST_LEASES * farm->options.lease * speed * share;
    double held = in_hand(farm, worker), allowed = first;
    if (worker->batches == 0) {
        if (lapses > 0 && !may_try(farm, now, worker, lapses)) return 0;
    } else {
        allowed = IN_HAND * fmax(farm->options.batch_interval, worker->gap) * speed * share;
        if (worker->speed_job == job->kept.job)
            allowed = fmin(allowed, GROWTH * worker->rated_samples * share);
    }
    return held > 0 ? fmax(allowed, first) - held : fmax(allowed, fmax(first, 1));
}

double trust_patience(const farm_t *farm, const worker_t *worker, const worker_t *idle)
{
    double interval = farm->options.batch_interval, lease = farm->options.lease;
    if (worker->batches > 0) return 2 * fmax(interval, worker->gap) + lease;
    if (worker->relay || worker->quarantine != 0) return 2 * interval + lease; /* they need longer */
    bool better = idle->batches > 0 || lapses_of(farm, idle) == 0;
    return better && lapses_of(farm, worker) > 0 ? 0 : lease;
}

bool window_lapsed(farm_t *farm, double now, worker_t *worker)
{
    standing_t *standing = standing_of(farm, now, worker->party);
    if (worker->quarantine != 0) return false; /* it was given what others died of */
    worker->lapsed = true;
    if (standing->fruitless == 0) standing->fruitless = now;
    if (standing->lapses > 0 && now - standing->lapsed < farm->options.lease)
        return false; /* a broken link */
    standing->lapsed = now;
    if (standing->lapses < MOST_LAPSES) standing->lapses++;
    return now - standing->fruitless > FRUITLESS_LEASES * farm->options.lease;
}

void window_delivered(farm_t *farm, worker_t *worker)
{
    worker->lapsed = false;
    if (standing_find(farm, worker->party) == NULL) return;
    standing_t *standing = standing_of(farm, worker->delivered, worker->party);
    standing->fruitless = 0;
    if (standing->lapses > 0) standing->lapses--;
}
