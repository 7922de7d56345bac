/* shares: which job a worker gets units of.
 *
 * DESIGN. Priorities are strict: as long as a job of a higher one has units for a worker, the worker gets
 * those. Jobs of one priority share the farm evenly, by thread-seconds. That is start-time fair queueing
 * (Goyal, Vin and Cheng 1996) with a view to what a switch costs: a worker that changes its job has to load
 * another scene.
 *
 * Each job counts the thread-seconds that it was given (service). A job that joins starts at the least count
 * of those that are at work, so it is owed nothing for the time before. A worker goes to the job that will
 * have had least one quantum from now, if all others stay where they are:
 *
 *     claim(job) = service + quantum * threads at the job without this worker
 *
 * but it stays with the job that it has loaded unless another's claim is smaller by more than the quantum
 * times its own threads. So workers settle down: four workers and two jobs make two pairs that never switch,
 * three workers make two pairs of which one switches every two quanta, and a single worker goes back and
 * forth.
 *
 * Of one priority and above only MAX_ACTIVE jobs are begun as long as they have units to give, since every
 * job that has begun takes memory for its film. A job that waits for its round to be complete does not count.
 */
#include "master/farm/parts.h"

#include <stdlib.h>

enum {
    MAX_ACTIVE = 4,
    MAX_WAITING = 16, /* jobs that a worker may begin are looked at, in case that some do not fit in memory */
    QUANTUM = 3       /* batch intervals */
};

void farm_job_joins(farm_t *farm, job_t *job)
{
    double least = -1;
    for (size_t i = 0; i < farm->job_count; i++) {
        const job_t *other = farm->jobs[i];
        if (other == job || other->kept.state != JOB_RUNNING ||
            other->kept.terms.priority != job->kept.terms.priority)
            continue;
        if (least < 0 || other->service < least) least = other->service;
    }
    if (job->service < least) job->service = least;
}

/* Counts the threads at each job; a worker that was told that there is no work is at none. */
static void count_threads(farm_t *farm)
{
    for (size_t i = 0; i < farm->job_count; i++) farm->jobs[i]->threads = 0;
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        if (!worker->connected || worker->idle || worker->job == 0) continue;
        job_t *job = farm_find_job(farm, worker->job);
        if (job != NULL) job->threads += worker->threads;
    }
}

void farm_shares_tick(farm_t *farm, double seconds)
{
    count_threads(farm);
    for (size_t i = 0; i < farm->job_count; i++)
        farm->jobs[i]->service += seconds * (double)farm->jobs[i]->threads;
}

static double claim(const farm_t *farm, const worker_t *worker, const job_t *job)
{
    bool loaded = worker->job == job->kept.job;
    double quantum = QUANTUM * farm->options.batch_interval;
    double others = (double)job->threads - (loaded && !worker->idle ? (double)worker->threads : 0);
    return job->service + quantum * (others + (loaded ? 0 : (double)worker->threads));
}

static int rank_order(const void *a, const void *b)
{
    const job_t *p = *(job_t *const *)a, *q = *(job_t *const *)b;
    if (p->kept.terms.priority != q->kept.terms.priority)
        return p->kept.terms.priority > q->kept.terms.priority ? -1 : 1;
    if (p->held_back != q->held_back) return p->held_back ? 1 : -1;
    if (p->claim < q->claim || p->claim > q->claim) return p->claim < q->claim ? -1 : 1;
    return p->kept.job < q->kept.job ? -1 : 1;
}

/* Of the jobs that have not begun only the first few are of interest, by priority and then by number: puts
 * `job`, whose number is higher than all before, in its place among the `count` that are in `list`. */
static size_t keep_first(job_t **list, size_t count, job_t *job)
{
    size_t at = count < MAX_WAITING ? count : MAX_WAITING;
    for (; at > 0 && list[at - 1]->kept.terms.priority < job->kept.terms.priority; at--)
        if (at < MAX_WAITING) list[at] = list[at - 1];
    if (at < MAX_WAITING) list[at] = job;
    return count < MAX_WAITING ? count + 1 : count;
}

/* Jobs that have not begun are held back if enough of their priority and above have work to give. The list is
 * in the order of priorities. */
static void hold_back(job_t *const *list, size_t count)
{
    size_t active = 0;
    for (size_t first = 0, end; first < count; first = end) {
        int32_t priority = list[first]->kept.terms.priority;
        for (end = first; end < count && list[end]->kept.terms.priority == priority; end++)
            active += list[end]->kept.state == JOB_RUNNING;
        for (size_t i = first; i < end; i++)
            list[i]->held_back = list[i]->kept.state == JOB_QUEUED && active >= MAX_ACTIVE;
    }
}

bool farm_job_has_work(const job_t *job)
{
    if (job->kept.state == JOB_QUEUED) return job->film == FILM_NONE || job->film == FILM_STORED;
    return job->kept.state == JOB_RUNNING && (schedule_available(job->schedule) || trust_waiting(job));
}

job_t *const *farm_rank_jobs(farm_t *farm, const worker_t *worker,
                             bool (*fits)(const worker_t *worker, const job_t *job), size_t *count)
{
    job_t *waiting[MAX_WAITING];
    size_t waiting_count = 0;
    farm->ranked = mem_realloc(farm->ranked, (farm->job_count + 1) * sizeof(job_t *));
    *count = 0;
    for (size_t i = 0; i < farm->job_count && !farm->shut; i++) {
        job_t *job = farm->jobs[i];
        if (!farm_job_has_work(job) || !fits(worker, job)) continue;
        if (job->kept.state == JOB_QUEUED)
            waiting_count = keep_first(waiting, waiting_count, job);
        else
            farm->ranked[(*count)++] = job;
    }
    for (size_t i = 0; i < waiting_count; i++) farm->ranked[(*count)++] = waiting[i];
    if (*count < 2) return farm->ranked;
    count_threads(farm);
    for (size_t i = 0; i < *count; i++) {
        farm->ranked[i]->claim = claim(farm, worker, farm->ranked[i]);
        farm->ranked[i]->held_back = false;
    }
    qsort(farm->ranked, *count, sizeof(job_t *), rank_order);
    hold_back(farm->ranked, *count);
    qsort(farm->ranked, *count, sizeof(job_t *), rank_order);
    return farm->ranked;
}
