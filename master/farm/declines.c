/* declines: jobs that workers say they cannot render: they have no memory for the scene, cannot write it to a
 * full disk, cannot get it.
 *
 * DESIGN. One machine never fails a job that others can render. Who declines is not given units of the job
 * for a while, each time for twice as long, and does other jobs meanwhile. The job fails only when nothing of
 * it was counted, nobody holds units of it, everybody who is connected and could have has declined, and
 *
 *   - these are two parties or more, with FARM_MAX_DECLINES declines in all; or
 *   - it is one, which has tried FARM_LONE_DECLINES times, for LONE_SECONDS: its operator has had the time to
 *     mend it, or to connect another; or
 *   - nobody else can ever come, since the master serves one command (it keeps no films).
 *
 * Until then the job's message says who cannot render it, and why. To decline is no failure of the worker's:
 * the others go on, and it costs them nothing. */
#include "master/farm/parts.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const double LONE_SECONDS = 600;
static const double FIRST_PAUSE = 10, LONGEST_PAUSE = 120; /* seconds */

static decline_t *find(job_t *job, uint64_t source)
{
    for (uint32_t i = 0; i < job->decline_count; i++)
        if (job->declined[i].source == source) return &job->declined[i];
    return NULL;
}

bool farm_has_declined(const job_t *job, const worker_t *worker, double now)
{
    const decline_t *decline = find((job_t *)job, worker->source);
    return decline != NULL && now < decline->until;
}

/* The entry of a process; the one that may try again first makes room. */
static decline_t *find_or_make(job_t *job, const worker_t *worker)
{
    decline_t *decline = find(job, worker->source);
    if (decline != NULL) return decline;
    if (job->decline_count < FARM_DECLINERS) {
        decline = &job->declined[job->decline_count++];
    } else {
        decline = &job->declined[0];
        for (uint32_t i = 1; i < FARM_DECLINERS; i++)
            if (job->declined[i].until < decline->until) decline = &job->declined[i];
    }
    *decline = (decline_t){.source = worker->source, .party = worker->party};
    return decline;
}

static void note(const farm_t *farm, double now, job_t *job, const worker_t *worker, const char *reason)
{
    decline_t *decline = find_or_make(job, worker);
    double pause = fmin(FIRST_PAUSE * exp2(decline->count), LONGEST_PAUSE);
    decline->count++;
    decline->until = farm->options.checkpoint_wake < 0 ? now : now + pause;
    if (job->declines++ == 0) job->first_decline = now;
    snprintf(job->decline_reason, sizeof job->decline_reason, "%.80s says: %.160s", worker->name, reason);
}

/* True when a worker that has not declined the job may have units of it, now or when it is done with others.
 */
static bool somebody_could(const farm_t *farm, double now, job_t *job)
{
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        if (farm_worker_asks(farm, now, worker, FARM_LOAD_BATCHES) &&
            farm_bits_fit(job, &worker->fingerprint) && find(job, worker->source) == NULL)
            return true;
    }
    return false;
}

static bool one_party(const job_t *job)
{
    for (uint32_t i = 1; i < job->decline_count; i++)
        if (job->declined[i].party != job->declined[0].party) return false;
    return true;
}

static bool is_hopeless(const farm_t *farm, double now, job_t *job)
{
    if (job->kept.batches > 0 || job->kept.state != JOB_RUNNING || job->declines < FARM_MAX_DECLINES)
        return false;
    if (schedule_holders(job->schedule) > 0 || somebody_could(farm, now, job)) return false;
    if (!one_party(job) || farm->options.checkpoint_wake < 0) return true;
    return job->declines >= FARM_LONE_DECLINES && now - job->first_decline >= LONE_SECONDS;
}

void farm_declined(farm_t *farm, double now, job_t *job, const worker_t *worker, const char *reason)
{
    note(farm, now, job, worker, reason);
    job->scene_due = true;
    wake_up(farm->options.checkpoint_wake);
    if (!is_hopeless(farm, now, job)) return;
    snprintf(job->kept.message, sizeof job->kept.message, "no worker can render it; %s", job->decline_reason);
    log_error("job %llu failed: %s", (unsigned long long)job->kept.job, job->kept.message);
    farm_job_close(farm, now, job, JOB_FAILED);
}

void farm_decline_remark(const job_t *job, char *text, size_t size)
{
    text[0] = '\0';
    if (job->kept.batches > 0 || job->decline_count == 0) return;
    snprintf(text, size,
             "those who tried (%u) cannot render it, and try again now and then: mend them or connect "
             "another; %s",
             job->decline_count, job->decline_reason);
}
