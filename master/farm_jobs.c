/* farm_jobs: the queue of jobs and the life of each (see farm.h and the note in farm.c). */
#include "master/farm_state.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* What the film of a job takes, and resolving it. */
static uint64_t film_bytes(const job_settings_t *settings)
{
    uint64_t pixels = (uint64_t)settings->width * (uint64_t)settings->height;
    uint64_t features = job_has_features(settings) ? FEATURE_VALUES * (sizeof(int64_t) + sizeof(float)) : 0;
    return pixels * (2 * 2 * 3 * sizeof(int64_t) + 2 * sizeof(uint32_t) + 13 * sizeof(float) + features);
}

void farm_job_free_film(farm_t *farm, job_t *job)
{
    if (job->canvas == NULL) return;
    job->canvas_condemned = job->canvas_users > 0;
    if (job->canvas_condemned) return;
    farm->film_bytes -= film_bytes(&job->settings);
    canvas_destroy(&job->canvas);
}

void farm_job_free(farm_t *farm, job_t *job)
{
    farm_job_free_film(farm, job);
    schedule_destroy(&job->schedule);
    free(job->seen);
    free(job);
}

bool farm_job_has_work(const job_t *job)
{
    return job->state == JOB_QUEUED || (job->state == JOB_RUNNING && schedule_available(job->schedule));
}

/* ---- the life of a job; all under the lock ------------------------------------------------------------- */

/* The last batch is in: nothing more is taken, the image writer has the next word. */
void farm_job_close(farm_t *farm, double now, job_t *job, job_state_t outcome)
{
    job->taking = false;
    job->flush_until = 0;
    job->ended = now;
    job->outcome = outcome;
    job->state = outcome == JOB_FAILED ? JOB_FAILED : JOB_FINISHING;
    job->image_due = true;
    farm_notify_over(farm, job, false);
    schedule_destroy(&job->schedule);
    farm_wake(farm->options.image_wake);
    farm_notify_idle(farm);
}

/* A job ends before all is counted: what workers have finished is asked for. */
void farm_job_cut_short(farm_t *farm, double now, job_t *job, job_state_t outcome)
{
    if (schedule_holders(job->schedule) == 0) {
        farm_job_close(farm, now, job, outcome);
        return;
    }
    job->state = JOB_FINISHING;
    job->outcome = outcome;
    job->flush_until = now + fmax(farm->options.lease, farm->options.batch_interval);
    farm_notify_over(farm, job, true);
    farm_notify_idle(farm); /* later jobs may start */
}

/* A worker has nothing (more) to send for a job that is being flushed. */
void farm_job_flushed(farm_t *farm, double now, job_t *job, uint64_t worker)
{
    schedule_release(job->schedule, worker);
    if (schedule_holders(job->schedule) == 0) farm_job_close(farm, now, job, job->outcome);
}

/* Makes film and schedule; false when it has to wait for memory. A job that can never start fails. */
bool farm_job_start(farm_t *farm, double now, job_t *job)
{
    uint64_t bytes = film_bytes(&job->settings);
    if (farm->film_bytes + bytes > farm->options.film_limit) return false;
    film_t *film;
    result_t result = film_new(&job->settings, &film);
    if (result.code != RESULT_OK) {
        snprintf(job->message, sizeof job->message, "%s", result.message);
        log_error("job %llu: %s", (unsigned long long)job->id, result.message);
        farm_job_close(farm, now, job, JOB_FAILED);
        return false;
    }
    farm->film_bytes += bytes;
    job->canvas = canvas_new(film);
    job->schedule = schedule_new(&job->settings);
    job->state = JOB_RUNNING;
    job->taking = true;
    job->started = job->rate_time[0] = job->rate_time[1] = now;
    log_info("job %llu starts: %s, %d x %d, %s", (unsigned long long)job->id, job->terms.name,
             job->settings.width, job->settings.height, integrator_name(job->settings.integrator));
    return true;
}

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* Makes room in the list of jobs; false when none can be forgotten. */
static bool forget_oldest(farm_t *farm)
{
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (!job_state_final(job->state) || job->image_due || job->pins > 0) continue;
        farm_job_free(farm, job);
        memmove(farm->jobs + i, farm->jobs + i + 1, (--farm->job_count - i) * sizeof *farm->jobs);
        return true;
    }
    return false;
}

result_t farm_submit(farm_t *farm, double now, const job_terms_t *terms, const job_settings_t *settings,
                     const hash_t *blob, uint64_t blob_size, uint64_t *id)
{
    (void)now;
    if (film_bytes(settings) > farm->options.film_limit)
        return result_fail(RESULT_LIMIT,
                           "a film of %d x %d pixels takes %.1f GB, this master has room for %.1f GB",
                           settings->width, settings->height, 1e-9 * (double)film_bytes(settings),
                           1e-9 * (double)farm->options.film_limit);
    farm_lock(farm);
    if (farm->job_count == FARM_MAX_JOBS && !forget_oldest(farm)) {
        farm_unlock(farm);
        return result_fail(RESULT_LIMIT, "the queue is full: %d jobs wait", FARM_MAX_JOBS);
    }
    job_t *job = mem_zalloc(1, sizeof *job);
    job->id = farm->next_job++;
    job->settings = *settings;
    job->blob = *blob;
    job->blob_size = blob_size;
    job->state = JOB_QUEUED;
    job->terms = *terms;
    farm->jobs = mem_realloc(farm->jobs, (farm->job_count + 1) * sizeof(job_t *));
    farm->jobs[farm->job_count++] = job;
    *id = job->id;
    log_info("job %llu is submitted: %s", (unsigned long long)job->id, job->terms.name);
    farm_notify_idle(farm);
    farm_unlock(farm);
    return result_ok();
}

static result_t cancel(farm_t *farm, double now, job_t *job, uint64_t id)
{
    if (job == NULL) return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)id);
    if (job_state_final(job->state))
        return result_fail(RESULT_INPUT, "job %llu is already %s", (unsigned long long)id,
                           job_state_name((uint32_t)job->state));
    log_info("job %llu is cancelled", (unsigned long long)id);
    if (job->state == JOB_QUEUED)
        job->state = JOB_CANCELLED;
    else if (job->state == JOB_RUNNING)
        farm_job_cut_short(farm, now, job, JOB_CANCELLED);
    return result_ok(); /* one that is finishing is left to finish */
}

result_t farm_order(farm_t *farm, double now, const job_order_t *order)
{
    farm_lock(farm);
    result_t result = cancel(farm, now, farm_find_job(farm, order->job), order->job);
    farm_unlock(farm);
    return result;
}

/* Seconds until the job is done at the speed of the last minute or two; < 0 when not known. */
static double remaining_time(const job_t *job, double now)
{
    if (job->state == JOB_FINISHING || job_state_final(job->state)) return 0;
    if (job->state != JOB_RUNNING) return -1;
    double remaining = -1;
    if (job->settings.time_limit > 0) remaining = fmax(0, job->started + job->settings.time_limit - now);
    double seconds = now - job->rate_time[0];
    double samples = (double)(job->samples_done - job->rate_samples[0]);
    if (job->settings.spp >= JOB_MAX_SPP || samples <= 0 || seconds <= 0) return remaining;
    double left = (double)(schedule_total(job->schedule) - job->samples_done) / (samples / seconds);
    return remaining < 0 ? left : fmin(left, remaining);
}

job_report_t farm_report_job(const job_t *job, double now)
{
    uint64_t pixels = (uint64_t)job->settings.width * (uint64_t)job->settings.height;
    job_report_t report = {.job = job->id,
                           .state = job->state,
                           .settings = job->settings,
                           .blob = job->blob,
                           .samples_done = job->samples_done,
                           .samples_total = job->settings.spp < JOB_MAX_SPP ? pixels * job->settings.spp : 0,
                           .elapsed =
                               job->started > 0 ? (job->ended > 0 ? job->ended : now) - job->started : 0,
                           .remaining = remaining_time(job, now),
                           .workers = job->schedule != NULL ? (uint32_t)schedule_holders(job->schedule) : 0,
                           .workers_seen = (uint32_t)job->seen_count,
                           .bytes_received = job->bytes,
                           .batches = job->batches,
                           .batches_refused = job->batches_refused,
                           .units_reissued = job->units_reissued,
                           .counts = job->counts};
    report.terms = job->terms;
    memcpy(report.message, job->message, sizeof report.message);
    return report;
}

job_report_t *farm_report(farm_t *farm, double now, uint64_t id, size_t *count, uint32_t *workers)
{
    farm_lock(farm);
    job_report_t *reports = farm->job_count > 0 ? mem_alloc(farm->job_count * sizeof *reports) : NULL;
    *count = 0;
    for (size_t i = 0; i < farm->job_count; i++)
        if (id == 0 || farm->jobs[i]->id == id) reports[(*count)++] = farm_report_job(farm->jobs[i], now);
    *workers = 0;
    for (size_t i = 0; i < farm->worker_count; i++) *workers += farm->workers[i].connected;
    farm_unlock(farm);
    if (*count > 0) return reports;
    free(reports);
    return NULL;
}
