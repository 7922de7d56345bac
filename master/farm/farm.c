/* farm: see farm.h.
 *
 * DESIGN. A lost worker's record is kept for a while: a batch from it whose units nobody else has delivered
 * meanwhile is still welcome. Worker numbers are random, so a batch of an earlier life of this master matches
 * none.
 *
 * This file has the farm itself, its notices and its clock; workers.c the workers and take.c what they are
 * given, shares.c whose turn it is, jobs.c the life of a job, milestones.c images that are kept on the way,
 * orders.c what clients want done, report.c what they are told, news.c what the operator is, errors.c how
 * good the images are, keep.c what outlives the process, batches.c what is delivered and the images made of
 * it. They share parts.h and state.h.
 *
 * Jobs live in an array of pointers in the order of submission; a job that a server or the image writer works
 * on is pinned and cannot be forgotten meanwhile. */
#include "master/farm/parts.h"

#include <math.h>
#include <stdlib.h>

enum { CLOCK_GAP = 2 }; /* seconds between ticks after which we, not the workers, were asleep */

farm_t *farm_new(const farm_options_t *options)
{
    static const double LINES_A_SECOND = 1, LINES_AT_ONCE = 256; /* of one party, on coming and going */
    farm_t *farm = mem_zalloc(1, sizeof *farm);
    farm->comings = rate_limit_new(LINES_A_SECOND, LINES_AT_ONCE, FARM_MAX_WORKERS);
    farm->options = *options;
    farm->next_job = options->first_job;
    if (farm->options.job_limit == 0 || farm->options.job_limit > FARM_MAX_JOBS)
        farm->options.job_limit = FARM_MAX_JOBS;
    farm->trust = trust_new();
    pthread_mutex_init(&farm->lock, NULL);
    return farm;
}

void farm_destroy(farm_t **farm)
{
    if (*farm == NULL) return;
    for (size_t i = 0; i < (*farm)->job_count; i++) farm_job_free(*farm, (*farm)->jobs[i]);
    free((*farm)->removed);
    free((*farm)->ranked);
    pthread_mutex_destroy(&(*farm)->lock);
    free((*farm)->jobs);
    free((*farm)->workers);
    id_table_free(&(*farm)->by_id);
    rate_limit_destroy(&(*farm)->comings);
    trust_destroy(&(*farm)->trust);
    free((*farm)->notices);
    free(*farm);
    *farm = NULL;
}

/* ---- notices ------------------------------------------------------------------------------------------- */

/* Calls the idle workers if there is something to do. */
static void call_idle(farm_t *farm)
{
    bool work = false;
    for (size_t i = 0; i < farm->job_count && !work; i++) work = farm_job_has_work(farm->jobs[i]);
    for (size_t i = 0; work && i < farm->worker_count; i++) {
        worker_t *worker = &farm->workers[i];
        if (!worker->connected || !worker->idle) continue;
        worker->idle = false;
        farm_notify(farm, worker->id, 0, false);
    }
    farm->work_due = false;
}

bool farm_next_notice(farm_t *farm, notice_t *notice)
{
    bool found = false;
    farm_lock(farm);
    if (farm->work_due) call_idle(farm);
    while (!found && farm->notice_first < farm->notice_count) {
        pending_t pending = farm->notices[farm->notice_first++];
        const worker_t *worker = farm_find_worker(farm, pending.worker);
        found = worker != NULL && worker->connected;
        if (found) *notice = (notice_t){worker->identity, pending.job, pending.flush, pending.leave};
    }
    if (!found) farm->notice_first = farm->notice_count = 0;
    farm_unlock(farm);
    return found;
}

/* ---- time, and the end --------------------------------------------------------------------------------- */

static bool time_is_up(const job_t *job, double now)
{
    return job->kept.state == JOB_RUNNING && job->kept.settings.time_limit > 0 &&
           farm_job_elapsed(job, now) >= job->kept.settings.time_limit;
}

void farm_tick(farm_t *farm, double now)
{
    farm_lock(farm);
    /* If this process was stopped, or the machine asleep, the silence was ours. */
    double gap = farm->last_tick > 0 ? now - farm->last_tick : 0;
    farm->last_tick = now;
    farm_shares_tick(farm, fmin(gap, CLOCK_GAP));
    for (size_t i = 0; i < farm->worker_count; i++) {
        worker_t *worker = &farm->workers[i];
        if (!worker->connected) continue;
        if (gap > CLOCK_GAP) worker->last_seen = fmin(now, worker->last_seen + gap);
        if (now - worker->last_seen <= farm->options.lease) continue;
        farm_worker_fall(farm, now, worker);
    }
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (time_is_up(job, now)) farm_job_cut_short(farm, now, job, JOB_DONE);
        if (job->flush_until > 0 && now >= job->flush_until) farm_job_flush_end(farm, now, job);
        farm_milestone_tick(farm, now, job);
        if (job->image == IMAGE_FAILED && now >= job->image_retry) {
            job->image = IMAGE_DUE;
            wake_up(farm->options.image_wake);
        }
    }
    farm_workers_tick(farm, now);
    farm_unlock(farm);
}

void farm_shut_down(farm_t *farm)
{
    farm_lock(farm);
    farm->shut = true;
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (!job_state_final(job->kept.state)) farm_record_changed(farm, job);
    }
    wake_up(farm->options.checkpoint_wake);
    farm_unlock(farm);
}
