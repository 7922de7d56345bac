/* batches: what workers deliver, and the images made of it (see farm.h). */
#include "master/farm/parts.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    RATE_WINDOW = 60, /* seconds over which the speed for `remaining` is measured */
    IMAGE_RETRY = 10  /* seconds between attempts to write an image */
};
static const uint64_t COMPARED_BYTES = (uint64_t)1 << 30;

/* ---- batches ------------------------------------------------------------------------------------------- */

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

static result_t job_over(const job_t *job)
{
    return result_fail(RESULT_CANCELLED, "job %llu is %s", (unsigned long long)job->id,
                       job->state == JOB_QUEUED ? "not started" : "over");
}

static result_t unknown_worker(void)
{
    return result_fail(RESULT_UNREACHABLE, "this master does not know the worker");
}

static result_t unknown_job(uint64_t id)
{
    return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)id);
}

/* Nobody is given units of a job of other bits; but a job may have been begun anew by another kind of
 * machines after this process or its data were lost. */
static result_t other_bits(const job_t *job)
{
    return result_fail(RESULT_MISMATCH, "job %llu is made by machines that make other bits",
                       (unsigned long long)job->id);
}

result_t farm_content_check(farm_t *farm, uint64_t id, const hash_t *content)
{
    if (content == NULL) return result_ok();
    farm_lock(farm);
    const job_t *job = farm_find_job(farm, id);
    bool same = true;
    if (job != NULL) {
        hash_t own = job_content_hash(&job->settings, &job->blob);
        same = hash_equal(content, &own);
    }
    farm_unlock(farm);
    if (same) return result_ok();
    return result_fail(RESULT_INPUT, "job %llu is another one than the batch was rendered for",
                       (unsigned long long)id);
}

/* A worker has a batch of a job that is not begun: it was, before this process, and what is rendered of it is
 * as good as ever. */
static void prepare_for_batch(farm_t *farm, double now, job_t *job, bool named)
{
    if (job->state == JOB_QUEUED && !job->film_due && named) farm_job_start(farm, now, job);
    if (!job->film_due || job->film_wanted) return;
    job->film_wanted = true;
    farm_wake(farm->options.checkpoint_wake);
}

result_t farm_batch_wanted(farm_t *farm, double now, uint64_t worker, uint64_t id, bool named)
{
    farm_lock(farm);
    job_t *job = farm_find_job(farm, id);
    result_t result = result_ok();
    worker_t *sender = farm_find_worker(farm, worker);
    if (sender == NULL || sender->outcast) {
        result = unknown_worker();
    } else if (job == NULL) {
        result = unknown_job(id);
    } else {
        prepare_for_batch(farm, now, job, named);
        if (job->film_due)
            result =
                result_fail(RESULT_LIMIT, "the film of job %llu is being loaded", (unsigned long long)id);
        else if (!job->taking)
            result = job_over(job);
        else if (!farm_bits_fit(job, &sender->fingerprint))
            result = other_bits(job);
        sender->offered = now;
    }
    farm_unlock(farm);
    return result;
}

void farm_batch_granted(farm_t *farm, double now, uint64_t id)
{
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, id);
    if (worker != NULL && worker->granted <= 0) worker->granted = now;
    farm_unlock(farm);
}

static result_t batch_open(worker_t *worker, job_t *job, uint64_t id, uint64_t bytes)
{
    if (worker == NULL || worker->outcast) return unknown_worker();
    worker->bytes += bytes;
    if (job == NULL) return unknown_job(id);
    job->bytes += bytes;
    if (job->taking) return result_ok();
    job->batches_refused++;
    worker->batches_refused++;
    return job_over(job);
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

/* A batch that is being merged. */
typedef struct {
    job_t *job;
    uint64_t worker;
    const batch_t *batch;
    const zmq_msg_t *payload;
    uint32_t *weights; /* of its units; NULL: all 1 */
} merge_t;

/* The weights of the units where some are not 1, in fresh memory. */
static uint32_t *unit_weights(const job_t *job, const batch_t *batch)
{
    if (!job_is_planned(&job->settings)) return NULL;
    uint32_t *weights = mem_alloc(batch->unit_count * sizeof *weights);
    for (size_t i = 0; i < batch->unit_count; i++)
        weights[i] = schedule_weight(job->schedule, &batch->units[i]);
    return weights;
}

/* Bytes that the tiles of a batch that may be compared take at most, unfolded: more than what workers close a
 * batch at, and what their threads have begun then. */
static uint64_t most_compared(const job_t *job, const worker_t *worker)
{
    const unit_t largest = {.tile = 0, .first = 0, .count = 1};
    uint64_t unit = sizeof(int64_t) * (batch_tile_values(&job->settings, largest.tile) +
                                       batch_feature_values(&job->settings, &largest));
    return COMPARED_BYTES + worker->threads * unit;
}

/* Under the lock, in the shared film: refuses the batch, or counts its units. They are in the film before the
 * shared film is left, so that nobody sees one without the other. */
static result_t count_units(farm_t *farm, merge_t *merge)
{
    job_t *job = merge->job;
    const batch_t *batch = merge->batch;
    const worker_t *worker = farm_find_worker(farm, merge->worker);
    if (!job->taking) return job_over(job);
    if (worker != NULL && !farm_bits_fit(job, &worker->fingerprint)) return other_bits(job);
    if (job->terms.verify > 0 && worker != NULL && !worker->relay)
        TRY(batch_check_size(batch, most_compared(job, worker)));
    TRY(schedule_accept(job->schedule, batch->units, batch->unit_count));
    if (worker != NULL) farm_note_bits(farm, job, worker);
    merge->weights = unit_weights(job, batch);
    job->merging++;
    return result_ok();
}

/* In the shared film. */
static result_t add_batch(farm_t *farm, shared_film_t *shared_film, merge_t *merge)
{
    farm_lock(farm);
    result_t result = count_units(farm, merge);
    farm_unlock(farm);
    if (result.code != RESULT_OK) return result;
    result = shared_film_merge_payload(shared_film, merge->payload, merge->batch, merge->weights, 1);
    if (result.code == RESULT_OK) {
        if (merge->job->terms.verify > 0)
            trust_keep(farm, merge->job, merge->worker, merge->batch, merge->payload);
        return result;
    }
    farm_lock(farm);
    schedule_uncount(merge->job->schedule, merge->batch->units, merge->batch->unit_count);
    merge->job->merging--;
    farm_unlock(farm);
    return result;
}

/* Under the lock: a batch is in the film. */
static void note_batch(farm_t *farm, double now, const merge_t *merge)
{
    job_t *job = merge->job;
    worker_t *worker = farm_find_worker(farm, merge->worker);
    film_counts_t counts = shared_film_counts(job->shared_film);
    if (job->counts.dropped == 0 && counts.dropped > 0)
        log_warning("job %llu: contributions that are NaN or infinite are dropped",
                    (unsigned long long)job->id);
    job->counts = counts;
    job->unsaved = true;
    job->batches++;
    if (worker != NULL) {
        worker->batches++;
        farm_worker_delivered(farm, now, worker, job, merge->batch->units, merge->batch->unit_count);
    }
    job_see(job, worker != NULL ? worker->id : 0);
    job->samples_done = schedule_done(job->schedule);
    note_progress(job, now);
}

/* Under the lock: what that means for the job. It may have been closed meanwhile, when a grace period ended:
 * the batch still counts. */
static void after_merge(farm_t *farm, double now, const merge_t *merge)
{
    job_t *job = merge->job;
    job->merging--;
    if (job->taking && job->counts.overflows > 0)
        farm_job_fail_overflow(farm, now, job);
    else if (job->taking && job->flush_until > 0)
        farm_job_flushed(farm, now, job, merge->worker);
}

void farm_batch_refuse(farm_t *farm, job_t *job, uint64_t id, const unit_t *units, size_t count)
{
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, id);
    job->batches_refused++;
    if (worker != NULL) {
        worker->batches_refused++;
        worker->offered = worker->granted = 0;
    }
    if (job->schedule != NULL)
        farm_count_reissued(job, worker, schedule_release_units(job->schedule, id, units, count));
    farm_notify_idle(farm);
    farm_unlock(farm);
}

/* Merges a batch that goes into the film. */
static result_t merge_batch(farm_t *farm, double now, merge_t *merge)
{
    shared_film_t *shared_film = job_film_hold(farm, merge->job);
    if (shared_film == NULL) return result_fail(RESULT_CANCELLED, "the job is over");
    shared_film_enter(shared_film);
    result_t result = add_batch(farm, shared_film, merge);
    shared_film_leave(shared_film);
    if (result.code == RESULT_OK) {
        farm_lock(farm);
        note_batch(farm, now, merge);
        after_merge(farm, now, merge);
        farm_unlock(farm);
    }
    free(merge->weights);
    job_film_let_go(farm, merge->job);
    return result;
}

/* A batch that bears a number is a rendering of units that two workers are asked for: it is compared with the
 * other, and only one of them goes into the film. */
static result_t check_batch(farm_t *farm, double now, const merge_t *merge, uint64_t check, bool *wanted)
{
    batch_t decoded = *merge->batch;
    hash_t digest;
    decoded.eye = decoded.splat = decoded.features = NULL;
    decoded.eye_capacity = decoded.feature_capacity = 0;
    farm_lock(farm); /* before memory is taken for what nobody asked for */
    result_t result = trust_asked(farm, merge->job, merge->worker, check, decoded.units, decoded.unit_count);
    farm_unlock(farm);
    TRY(result);
    result = payload_decode(merge->payload, &decoded);
    if (result.code == RESULT_OK) batch_digest(&decoded, &digest);
    free(decoded.eye);
    free(decoded.splat);
    free(decoded.features);
    if (result.code != RESULT_OK) return result;
    farm_lock(farm);
    result = trust_compare(farm, now, merge->job, merge->worker, check, decoded.units, decoded.unit_count,
                           &digest, wanted);
    worker_t *worker = farm_find_worker(farm, merge->worker);
    if (result.code == RESULT_OK && worker != NULL) {
        worker->delivered = now;
        worker->offered = worker->granted = 0;
        farm_worker_relieved(farm, worker);
    }
    farm_cast_out(farm, now);
    farm_unlock(farm);
    return result;
}

result_t farm_batch_merge(farm_t *farm, double now, job_t *job, uint64_t worker, uint64_t check,
                          const batch_t *batch, const zmq_msg_t payload[BATCH_PAYLOADS])
{
    merge_t merge = {.job = job, .worker = worker, .batch = batch, .payload = payload};
    bool wanted = true;
    result_t result = batch_check_counts(batch);
    if (result.code == RESULT_OK && check != 0) result = check_batch(farm, now, &merge, check, &wanted);
    if (result.code == RESULT_OK && wanted) result = merge_batch(farm, now, &merge);
    if (result.code != RESULT_OK) farm_batch_refuse(farm, job, worker, batch->units, batch->unit_count);
    farm_lock(farm);
    worker_t *sender = farm_find_worker(farm, worker);
    if (result.code == RESULT_PROTOCOL && sender != NULL)
        trust_failed(farm, now, sender, "sends batches that are malformed");
    farm_cast_out(farm, now);
    farm_job_progress(farm, now, job);
    farm_unlock(farm);
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

/* True when the film is what it will be: what was counted is in it, what is known to be wrong is out. */
static bool is_settled(const job_t *job)
{
    return job->merging == 0 && (job->state != JOB_FINISHING || !trust_wrong(job));
}

job_t *farm_next_finished(farm_t *farm)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count && found == NULL; i++)
        if (farm->jobs[i]->image_due && is_settled(farm->jobs[i])) found = farm->jobs[i];
    if (found != NULL) {
        found->image_due = false;
        found->pins++;
    }
    farm_unlock(farm);
    return found;
}

/* The film of an adaptive job knows the weights of its samples, the schedule their number. Called with the
 * shared film locked, so that both are of the same moment. */
static void show_samples(farm_t *farm, const job_t *job, const job_settings_t *settings, film_image_t *image)
{
    uint32_t *samples = mem_alloc(job_tile_count(settings) * sizeof *samples);
    farm_lock(farm);
    bool known = job->schedule != NULL;
    if (known) schedule_tile_samples(job->schedule, samples);
    farm_unlock(farm);
    if (known) schedule_show_samples(settings, samples, image->samples);
    free(samples);
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
    shared_film_t *shared_film = empty ? NULL : job_film_hold(farm, job);
    if (shared_film != NULL) {
        film_resolve(shared_film_lock(shared_film), image);
        if (report->settings.adaptive) show_samples(farm, job, &report->settings, image);
        shared_film_unlock(shared_film);
        job_film_let_go(farm, job);
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
        if (job->image_retry > 0) job->remark[0] = '\0'; /* it is not true any more */
        job->image_retry = 0;
        if (path != NULL) log_info("job %llu: the image is in %s", (unsigned long long)job->id, path);
    } else {
        job->image_retry = now + IMAGE_RETRY;
        snprintf(job->remark, sizeof job->remark, "the image cannot be written, and is tried again: %.200s",
                 written.message);
        log_error("job %llu: %s", (unsigned long long)job->id, job->remark);
    }
    farm_job_settle(farm, job);
    farm_unlock(farm);
}
