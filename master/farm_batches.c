/* farm_batches: what workers deliver, and the images made of it (see farm.h). */
#include "master/farm_state.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    RATE_WINDOW = 60, /* seconds over which the speed for `remaining` is measured */
    IMAGE_RETRY = 10  /* seconds between attempts to write an image */
};
#define COUNT_LIMIT ((uint64_t)1 << 60) /* of any one count in a batch */

/* ---- batches ------------------------------------------------------------------------------------------- */

job_settings_t farm_job_settings(farm_t *farm, const job_t *job)
{
    farm_lock(farm);
    job_settings_t settings = job->settings;
    farm_unlock(farm);
    return settings;
}

uint64_t farm_job_id(const job_t *job)
{
    return job->id;
}

void farm_unpin(farm_t *farm, job_t *job)
{
    farm_lock(farm);
    farm_job_unpin(farm, job);
    farm_unlock(farm);
}

canvas_t *farm_canvas_hold(farm_t *farm, job_t *job)
{
    farm_lock(farm);
    canvas_t *canvas = job->canvas_condemned ? NULL : job->canvas;
    job->canvas_users += canvas != NULL;
    farm_unlock(farm);
    return canvas;
}

void farm_canvas_let_go(farm_t *farm, job_t *job)
{
    farm_lock(farm);
    job->canvas_users--;
    if (job->canvas_condemned) farm_job_free_film(farm, job);
    farm_unlock(farm);
}

static result_t batch_open(worker_t *worker, job_t *job, uint64_t id, uint64_t bytes)
{
    if (worker == NULL) return result_fail(RESULT_UNREACHABLE, "this master does not know the worker");
    worker->bytes += bytes;
    if (job == NULL) return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)id);
    job->bytes += bytes;
    if (!job->taking) {
        job->batches_refused++;
        worker->batches_refused++;
        return result_fail(RESULT_CANCELLED, "job %llu is %s", (unsigned long long)id,
                           job->state == JOB_QUEUED ? "not started" : "over");
    }
    return result_ok();
}

result_t farm_batch_wanted(farm_t *farm, uint64_t worker_id, uint64_t id)
{
    farm_lock(farm);
    job_t *job = farm_find_job(farm, id);
    result_t result = result_ok();
    if (farm_find_worker(farm, worker_id) == NULL)
        result = result_fail(RESULT_UNREACHABLE, "this master does not know the worker: say hello again");
    else if (job == NULL)
        result = result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)id);
    else if (!job->taking)
        result = result_fail(RESULT_CANCELLED, "job %llu is %s", (unsigned long long)id,
                             job->state == JOB_QUEUED ? "not started" : "over");
    farm_unlock(farm);
    return result;
}

result_t farm_batch_open(farm_t *farm, double now, uint64_t worker_id, uint64_t id, uint64_t bytes,
                         job_t **pinned)
{
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, worker_id);
    job_t *job = farm_find_job(farm, id);
    result_t result = batch_open(worker, job, id, bytes);
    if (result.code == RESULT_OK) {
        job->pins++;
        *pinned = job;
        worker->last_seen = fmax(worker->last_seen, now);
    }
    farm_unlock(farm);
    return result;
}

/* No sender may claim more than its units can hold. */
static result_t check_counts(const batch_t *batch)
{
    uint64_t samples[2] = {0, 0};
    for (size_t i = 0; i < batch->unit_count; i++)
        for (int half = 0; half < 2; half++)
            samples[half] += (uint64_t)unit_half_count(&batch->units[i], half) *
                             job_tile_pixels(&batch->settings, batch->units[i].tile);
    for (int half = 0; half < 2; half++)
        if (batch->counts.light_paths[half] > samples[half])
            return result_fail(RESULT_PROTOCOL, "%llu light paths for %llu samples",
                               (unsigned long long)batch->counts.light_paths[half],
                               (unsigned long long)samples[half]);
    const uint64_t others[] = {batch->counts.dropped, batch->counts.overflows, batch->counts.rays,
                               batch->counts.cpu_us};
    for (size_t i = 0; i < ARRAY_LENGTH(others); i++)
        if (others[i] > COUNT_LIMIT)
            return result_fail(RESULT_PROTOCOL, "a count of %llu is out of all bounds",
                               (unsigned long long)others[i]);
    return result_ok();
}

static void job_see(job_t *job, uint64_t worker)
{
    for (size_t i = 0; i < job->seen_count; i++)
        if (job->seen[i] == worker) return;
    job->seen = mem_realloc(job->seen, (job->seen_count + 1) * sizeof *job->seen);
    job->seen[job->seen_count++] = worker;
}

/* Moves the points that the speed is measured from. */
static void note_progress(job_t *job, double now)
{
    if (now - job->rate_time[1] < RATE_WINDOW) return;
    job->rate_time[0] = job->rate_time[1];
    job->rate_samples[0] = job->rate_samples[1];
    job->rate_time[1] = now;
    job->rate_samples[1] = job->samples_done;
}

/* Under the lock, in the canvas: refuses the batch, or counts its units. */
static result_t count_batch(double now, job_t *job, worker_t *worker, const batch_t *batch)
{
    result_t result = check_counts(batch);
    if (result.code == RESULT_OK && !job->taking) result = result_fail(RESULT_CANCELLED, "the job is over");
    if (result.code == RESULT_OK) result = schedule_accept(job->schedule, batch->units, batch->unit_count);
    if (result.code != RESULT_OK) return result;
    job->batches++;
    if (worker != NULL) {
        worker->batches++;
        worker->delivered = now;
    }
    job_see(job, worker != NULL ? worker->id : 0);
    job->samples_done = schedule_done(job->schedule);
    note_progress(job, now);
    return result;
}

/* Under the lock: what the merged film means for the job. */
static void after_merge(farm_t *farm, double now, job_t *job, uint64_t worker)
{
    film_counts_t counts = canvas_counts(job->canvas);
    if (job->counts.dropped == 0 && counts.dropped > 0)
        log_warning("job %llu: contributions that are NaN or infinite are dropped",
                    (unsigned long long)job->id);
    job->counts = counts;
    job->unsaved = true;
    if (!job->taking) return; /* closed meanwhile: a grace period ended. The merge still counts. */
    if (job->counts.overflows > 0) {
        farm_job_fail_overflow(farm, now, job);
    } else if (schedule_complete(job->schedule)) {
        farm_job_progress(farm, now, job);
    } else if (job->flush_until > 0) {
        farm_job_flushed(farm, now, job, worker);
    }
}

void farm_batch_refuse(farm_t *farm, job_t *job, uint64_t id, const unit_t *units, size_t count)
{
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, id);
    job->batches_refused++;
    if (worker != NULL) worker->batches_refused++;
    if (job->schedule != NULL)
        farm_count_reissued(job, worker, schedule_release_units(job->schedule, id, units, count));
    farm_notify_idle(farm);
    farm_unlock(farm);
}

result_t farm_batch_merge(farm_t *farm, double now, job_t *job, uint64_t id, uint64_t check,
                          const batch_t *batch, const zmq_msg_t payload[BATCH_PAYLOADS])
{
    (void)check;
    canvas_t *canvas = farm_canvas_hold(farm, job);
    if (canvas == NULL) return result_fail(RESULT_CANCELLED, "the job is over");
    canvas_enter(canvas);
    farm_lock(farm);
    result_t result = count_batch(now, job, farm_find_worker(farm, id), batch);
    farm_unlock(farm);
    if (result.code == RESULT_OK) result = canvas_merge_payload(canvas, payload, batch, NULL, 1);
    canvas_leave(canvas);
    if (result.code == RESULT_OK) {
        farm_lock(farm);
        after_merge(farm, now, job, id);
        farm_unlock(farm);
    } else {
        farm_batch_refuse(farm, job, id, batch->units, batch->unit_count);
    }
    farm_canvas_let_go(farm, job);
    return result;
}

/* ---- images -------------------------------------------------------------------------------------------- */

job_t *farm_pin(farm_t *farm, uint64_t id)
{
    farm_lock(farm);
    job_t *job = farm_find_job(farm, id);
    if (job != NULL) job->pins++;
    farm_unlock(farm);
    return job;
}

job_t *farm_next_finished(farm_t *farm)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count && found == NULL; i++)
        if (farm->jobs[i]->image_due) found = farm->jobs[i];
    if (found != NULL) {
        found->image_due = false;
        found->pins++;
    }
    farm_unlock(farm);
    return found;
}

result_t farm_resolve(farm_t *farm, double now, job_t *job, film_image_t *image, job_report_t *report)
{
    farm_lock(farm);
    *report = farm_report_job(job, now);
    bool empty = job->batches == 0, due = job->film_due;
    if (due && !job->film_wanted) {
        job->film_wanted = true; /* somebody wants to see it */
        farm_wake(farm->options.checkpoint_wake);
    }
    farm_unlock(farm);
    canvas_t *canvas = empty ? NULL : farm_canvas_hold(farm, job);
    if (canvas != NULL) {
        film_resolve(canvas_lock(canvas), image);
        canvas_unlock(canvas);
        farm_canvas_let_go(farm, job);
        return result_ok();
    }
    if (due)
        return result_fail(RESULT_INPUT, "the film of job %llu is not loaded yet: try again in a moment",
                           (unsigned long long)report->job);
    return result_fail(RESULT_INPUT, "job %llu has no samples yet", (unsigned long long)report->job);
}

uint64_t farm_image_version(farm_t *farm, job_t *job, bool *over)
{
    farm_lock(farm);
    uint64_t version = job->batches;
    *over = job_state_final(job->state);
    farm_unlock(farm);
    return version;
}

void farm_finished(farm_t *farm, double now, job_t *job, result_t written, const char *path)
{
    farm_lock(farm);
    if (written.code == RESULT_OK) {
        job->image_written = true;
        if (job->image_retry > 0) job->message[0] = '\0'; /* it is not true any more */
        if (path != NULL) log_info("job %llu: the image is in %s", (unsigned long long)job->id, path);
    } else {
        job->image_retry = now + IMAGE_RETRY;
        snprintf(job->message, sizeof job->message, "the image cannot be written, and is tried again: %.400s",
                 written.message);
        log_error("job %llu: %s", (unsigned long long)job->id, job->message);
    }
    farm_job_settle(farm, now, job);
    farm_unlock(farm);
}
