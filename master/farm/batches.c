/* batches: what workers deliver, and the images made of it (see farm.h).
 *
 * DESIGN. A batch takes the farm's lock four times on its way from the socket into the film:
 *
 *     farm_batch_begin    what its units were issued with is found
 *     farm_batch_begin    its job and its sender are found, its units were issued to it, the film is held
 *     count_units         in the film: it is refused, or its units are counted
 *     farm_batch_commit   in the film: what is merged is noted, what could not be is uncounted; film and job
 *                         are let go. (Or farm_batch_abort, instead of the third and the fourth.)
 *
 * Between them, without the lock, its MACs are checked, and its sums are decoded, added, and written to the
 * disk. */
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
    return job->kept.job;
}

void farm_unpin(farm_t *farm, job_t *job)
{
    farm_lock(farm);
    farm_job_unpin(farm, job);
    farm_unlock(farm);
}

static result_t job_over(const job_t *job)
{
    return result_fail(RESULT_CANCELLED, "job %llu is %s", (unsigned long long)job->kept.job,
                       job->kept.state == JOB_QUEUED ? "not started" : "over");
}

static result_t unknown_worker(void)
{
    return result_fail(RESULT_UNREACHABLE, "this master does not know the worker");
}

static result_t unknown_job(uint64_t id)
{
    return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)id);
}

static result_t other_content(uint64_t id)
{
    return result_fail(RESULT_INPUT, "job %llu is another one than the batch was rendered for",
                       (unsigned long long)id);
}

/* Nobody is given units of a job of other bits; but a job may have been begun anew by another kind of
 * machines after this process or its data were lost. */
static result_t other_bits(const job_t *job)
{
    return result_fail(RESULT_MISMATCH, "job %llu is made by machines that make other bits",
                       (unsigned long long)job->kept.job);
}

result_t farm_content_check(farm_t *farm, uint64_t id, const hash_t *content)
{
    farm_lock(farm);
    const job_t *job = farm_find_job(farm, id);
    bool same = job == NULL || farm_content_fits(job, content);
    farm_unlock(farm);
    return same ? result_ok() : other_content(id);
}

static result_t film_waits(const job_t *job)
{
    return result_fail(RESULT_LIMIT, "the film of job %llu is being loaded",
                       (unsigned long long)job->kept.job);
}

/* A job that has not begun in this process. If a batch of it was issued, it had begun before, and what is
 * rendered of it is as good as ever: the job begins again. The batch shows that, not the offer. */
static bool may_begin(const farm_t *farm, const job_t *job)
{
    bool waits = job->film == FILM_NONE && job->kept.state == JOB_QUEUED;
    return job->film == FILM_STORED || (waits && farm_job_has_room(farm, job));
}

/* May a batch of the job be sent? */
static result_t check_offer(const farm_t *farm, const job_t *job, const worker_t *sender)
{
    if (may_begin(farm, job)) return result_ok();
    if (job_awaits_film(job)) return film_waits(job);
    if (job->film != FILM_OPEN) return job_over(job);
    return farm_bits_fit(job, &sender->fingerprint) ? result_ok() : other_bits(job);
}

result_t farm_batch_wanted(farm_t *farm, double now, uint64_t worker, uint64_t id)
{
    farm_lock(farm);
    job_t *job = farm_find_job(farm, id);
    result_t result;
    worker_t *sender = farm_find_worker(farm, worker);
    if (sender == NULL || sender->outcast) {
        result = unknown_worker();
    } else if (job == NULL) {
        result = unknown_job(id);
    } else {
        result = check_offer(farm, job, sender);
        bool holds = job->schedule != NULL && schedule_held(job->schedule, worker) > 0;
        if (holds && (result.code == RESULT_OK || result.code == RESULT_LIMIT)) sender->offered = now;
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

/* What the sender holds of a batch that is no good goes back. */
static void refuse(farm_t *farm, job_t *job, worker_t *worker, const unit_t *units, size_t count)
{
    job->kept.batches_refused++;
    if (worker != NULL) {
        worker->batches_refused++;
        worker->offered = 0;
        if (job->schedule != NULL)
            farm_count_reissued(job, worker, schedule_release_units(job->schedule, worker->id, units, count));
    }
    farm_notify_idle(farm);
}

/* Whether all units of a batch were issued to who sends it. Without the lock, as long as it takes. Nothing
 * was issued of a job that there is only a moment later. */
static result_t check_issued(farm_t *farm, const batch_head_t *head)
{
    unit_mac_t mac;
    farm_lock(farm);
    const worker_t *worker = farm_find_worker(farm, head->worker);
    const job_t *job = farm_find_job(farm, head->job);
    bool known = worker != NULL && job != NULL;
    if (known) mac = farm_unit_mac(farm, worker, job, head->check);
    farm_unlock(farm);
    if (!known) return result_fail(RESULT_DENIED, "nothing of this job was issued to who delivers it");
    return unit_mac_check(&mac, head->units, head->issues, head->unit_count);
}

/* The batch is of units that the sender was not given, or of the job as another one. */
static void refuse_unissued(farm_t *farm, double now, job_t *job, worker_t *worker, const batch_head_t *head)
{
    bool valid = job_check_units(&job->kept.settings, head->units, head->unit_count).code == RESULT_OK;
    refuse(farm, job, worker, head->units, valid ? head->unit_count : 0);
    trust_failed(farm, now, worker, "delivers units that it was not given");
    farm_cast_out(farm, now);
}

static result_t check_head(farm_t *farm, double now, worker_t *worker, job_t *job, const batch_head_t *head,
                           const result_t *issued)
{
    if (job != NULL && !farm_content_fits(job, head->content)) return other_content(head->job);
    if (worker == NULL || worker->outcast) return unknown_worker();
    worker->bytes += head->bytes;
    if (job == NULL) return unknown_job(head->job);
    job->kept.bytes += head->bytes;
    if (issued->code != RESULT_OK) {
        refuse_unissued(farm, now, job, worker, head);
        return *issued;
    }
    if (may_begin(farm, job)) farm_job_start(farm, now, job);
    if (job->film == FILM_OPEN) return result_ok();
    if (job_awaits_film(job)) return film_waits(job);
    job->kept.batches_refused++;
    worker->batches_refused++;
    return job_over(job);
}

result_t farm_batch_begin(farm_t *farm, double now, const batch_head_t *head, farm_batch_t *open)
{
    result_t issued = check_issued(farm, head);
    farm_lock(farm);
    worker_t *worker = farm_find_worker(farm, head->worker);
    job_t *job = farm_find_job(farm, head->job);
    result_t result = check_head(farm, now, worker, job, head, &issued);
    if (result.code == RESULT_OK) {
        *open = (farm_batch_t){.settings = job->kept.settings,
                               .job = job,
                               .worker = head->worker,
                               .blob = job->kept.blob,
                               .dark = job->brightest <= 0,
                               .check = head->check,
                               .shared_film = farm_job_film_hold(job)};
        job->pins++;
        worker->last_seen = fmax(worker->last_seen, now);
        if (head->check != 0) open->asked = trust_asked(farm, job, head->worker, head->check, &open->sample);
    }
    farm_unlock(farm);
    return result;
}

void farm_batch_lights(farm_t *farm, farm_batch_t *open, const scene_blob_t *blob)
{
    double brightest = plausible_brightest(blob);
    farm_lock(farm);
    open->job->brightest = brightest;
    farm_unlock(farm);
}

/* Moves the points that the speed is measured from. */
static void note_progress(job_t *job, double now)
{
    if (now - job->rate_time[1] < RATE_WINDOW) return;
    job->rate_time[0] = job->rate_time[1];
    job->rate_samples[0] = job->rate_samples[1];
    job->rate_time[1] = now;
    job->rate_samples[1] = job->kept.samples_done;
}

/* A batch whose job is known. */
typedef struct {
    farm_batch_t *open;
    const batch_t *batch;
    const zmq_msg_t *payload;
    hash_t digest;   /* of its sums, when it is doubted */
    bool counted;    /* its units are, and it goes into the film */
    bool believed;   /* whatever its sums are: it is of this process, or another one is the same */
    bool doubted;    /* it is not merged, since it has sums that are too large */
    bool comparable; /* then: its digest is known */
    sum_limits_t limits;
    uint32_t *weights;  /* of its units; NULL: all 1 */
    trust_keep_t *keep; /* NULL: it is not kept */
} delivery_t;

/* The weights of the units where some are not 1, in fresh memory. */
static uint32_t *unit_weights(const job_t *job, const batch_t *batch)
{
    if (!job_is_planned(&job->kept.settings)) return NULL;
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
    return COMPARED_BYTES + worker->threads * sum_unit_bytes(&job->kept.settings, &largest);
}

/* A batch that bears a number is a rendering of units that two workers are asked for: it is compared with the
 * other by its digest. No memory is taken for what nobody asked for. */
static result_t digest_rendering(delivery_t *delivery)
{
    farm_batch_t *open = delivery->open;
    if (open->asked.code != RESULT_OK) return open->asked;
    return trust_digest(delivery->payload, delivery->batch, &open->sample);
}

/* Compares a rendering with others; *wanted is false when it does not go into the film. */
static result_t compare(farm_t *farm, double now, delivery_t *delivery, bool *wanted)
{
    const farm_batch_t *open = delivery->open;
    TRY(trust_compare(farm, now, open->job, open->worker, open->check, &open->sample.digest, wanted,
                      &delivery->believed));
    worker_t *worker = farm_find_worker(farm, open->worker);
    worker->delivered = now;
    worker->offered = worker->granted = 0;
    farm_worker_relieved(farm, worker);
    farm_cast_out(farm, now);
    return result_ok();
}

static bool is_of_this_process(const worker_t *worker)
{
    return worker != NULL && worker->key[0] == '\0' && worker->address[0] == '\0';
}

/* Under the lock, in the shared film: refuses the batch, or counts its units. They are in the film before the
 * shared film is left, so that nobody sees one without the other. */
static result_t count_units(farm_t *farm, double now, delivery_t *delivery)
{
    job_t *job = delivery->open->job;
    const batch_t *batch = delivery->batch;
    bool wanted = true;
    if (delivery->open->check != 0) TRY(compare(farm, now, delivery, &wanted));
    if (!wanted) return result_ok();
    const worker_t *worker = farm_find_worker(farm, delivery->open->worker);
    if (job->film != FILM_OPEN) return job_over(job);
    if (worker != NULL && !farm_bits_fit(job, &worker->fingerprint)) return other_bits(job);
    if (job->kept.terms.verify > 0 && worker != NULL && !worker->relay)
        TRY(batch_check_size(batch, most_compared(job, worker)));
    TRY(schedule_accept(job->schedule, batch->units, batch->unit_count));
    if (worker != NULL) farm_note_bits(farm, now, job, worker);
    delivery->weights = unit_weights(job, batch);
    delivery->keep = trust_keep_begin(farm, job, worker, batch);
    delivery->counted = true;
    delivery->comparable =
        worker != NULL && batch_check_size(batch, most_compared(job, worker)).code == RESULT_OK;
    if (trust_believes_all(job) || is_of_this_process(worker)) delivery->believed = true;
    delivery->limits = delivery->believed ? plausible_anything() : plausible_limits(job);
    job->merging++;
    return result_ok();
}

/* Merges a batch, or doubts it. */
static result_t merge(delivery_t *delivery)
{
    shared_film_t *shared_film = delivery->open->shared_film;
    const batch_t *batch = delivery->batch;
    bool claims = batch->counts.overflows > 0;
    result_t result = result_fail(RESULT_CANCELLED, "sums that are said to be too large");
    bool bounded = !delivery->believed || delivery->open->check != 0; /* or it is to be seen what they are */
    if (bounded && (!claims || delivery->believed))
        result = shared_film_merge_within(shared_film, delivery->payload, batch, delivery->weights,
                                          &delivery->limits);
    if (result.code != RESULT_CANCELLED) return result;
    if (delivery->believed)
        return shared_film_merge_payload(shared_film, delivery->payload, batch, delivery->weights, 1);
    delivery->doubted = true;
    if (!delivery->comparable)
        return result_fail(RESULT_PROTOCOL, "it has sums that are too large, and too many to be compared");
    sample_t whole = {.units = batch->units, .count = batch->unit_count, .whole = true};
    TRY(trust_digest(delivery->payload, batch, &whole));
    delivery->digest = whole.digest;
    return result_fail(RESULT_MISMATCH,
                       "it has sums that are too large to be believed: its units are rendered once more");
}

/* In the shared film. */
static result_t add_batch(farm_t *farm, double now, delivery_t *delivery)
{
    const farm_batch_t *open = delivery->open;
    farm_lock(farm);
    result_t result = count_units(farm, now, delivery);
    farm_unlock(farm);
    if (result.code != RESULT_OK || !delivery->counted) return result;
    TRY(merge(delivery));
    if (delivery->keep != NULL)
        trust_keep_write(farm, open->job, delivery->keep, delivery->batch, delivery->payload);
    return result_ok();
}

/* The last time under the lock, for what follows. A batch is in the film: what that means for the
 * job. It may have been closed meanwhile, when a grace period ended: the batch still counts. */
static void note_batch(farm_t *farm, double now, const delivery_t *delivery)
{
    job_t *job = delivery->open->job;
    const batch_t *batch = delivery->batch;
    worker_t *worker = farm_find_worker(farm, delivery->open->worker);
    film_counts_t counts = shared_film_counts(job->shared_film);
    if (job->kept.counts.dropped == 0 && counts.dropped > 0)
        log_warning("job %llu: contributions that are NaN or infinite are dropped",
                    (unsigned long long)job->kept.job);
    job->kept.counts = counts;
    if (job->save == SAVE_DONE) job->unsaved_since = now;
    job_unsaved(job);
    job->kept.batches++;
    if (worker != NULL) {
        worker->batches++;
        farm_worker_delivered(farm, now, worker, job, batch->units, batch->unit_count);
    }
    id_table_put(&job->seen, worker != NULL ? worker->id : 0, 0);
    job->kept.samples_done = schedule_done(job->schedule);
    note_progress(job, now);
    job->merging--;
    if (job->film != FILM_OPEN) return;
    if (job->kept.counts.overflows > 0)
        farm_job_fail_overflow(farm, now, job);
    else if (job->flush_until > 0)
        farm_job_flushed(farm, now, job, delivery->open->worker);
}

/* A batch was counted, and is not in the film after all. */
static void uncount(const delivery_t *delivery)
{
    job_t *job = delivery->open->job;
    schedule_uncount(job->schedule, delivery->batch->units, delivery->batch->unit_count);
    job->merging--;
}

static void conclude(farm_t *farm, double now, delivery_t *delivery, const result_t *result)
{
    farm_batch_t *open = delivery->open;
    bool good = result->code == RESULT_OK;
    worker_t *worker = farm_find_worker(farm, open->worker);
    if (delivery->keep != NULL) trust_keep_end(farm, open->job, &delivery->keep, good);
    if (good && delivery->counted) note_batch(farm, now, delivery);
    if (!good && delivery->counted) uncount(delivery);
    if (good && delivery->believed) plausible_confirm(open->job, &delivery->limits);
    if (delivery->doubted && result->code == RESULT_MISMATCH && worker != NULL &&
        open->job->film == FILM_OPEN)
        trust_doubt(farm, open->job, worker, open->check, delivery->batch->units, delivery->batch->unit_count,
                    &delivery->digest);
    if (!good) refuse(farm, open->job, worker, delivery->batch->units, delivery->batch->unit_count);
    if (result->code == RESULT_PROTOCOL && worker != NULL)
        trust_failed(farm, now, worker, "sends batches that are malformed");
    farm_cast_out(farm, now);
}

/* Lets go of what farm_batch_begin took, and of the lock. */
static void end_batch(farm_t *farm, farm_batch_t *open)
{
    farm_job_film_let_go(farm, open->job);
    farm_job_unpin(farm, open->job);
    farm_unlock(farm);
    free(open->sample.units);
}

result_t farm_batch_commit(farm_t *farm, double now, farm_batch_t *open, const batch_t *batch,
                           const zmq_msg_t payload[BATCH_PAYLOADS])
{
    delivery_t delivery = {.open = open, .batch = batch, .payload = payload};
    result_t result = batch_check_counts(batch);
    if (result.code == RESULT_OK && open->check != 0) result = digest_rendering(&delivery);
    bool entered = result.code == RESULT_OK;
    if (entered) {
        shared_film_enter(open->shared_film);
        result = add_batch(farm, now, &delivery);
    }
    farm_lock(farm); /* in the shared film: what is uncounted was never seen as counted */
    conclude(farm, now, &delivery, &result);
    if (entered) shared_film_leave(open->shared_film);
    farm_job_progress(farm, now, open->job);
    end_batch(farm, open);
    free(delivery.weights);
    return result;
}

void farm_batch_abort(farm_t *farm, farm_batch_t *open, const unit_t *units, size_t count)
{
    farm_lock(farm);
    refuse(farm, open->job, farm_find_worker(farm, open->worker), units, count);
    end_batch(farm, open);
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
    return job->merging == 0 && (job->kept.state != JOB_FINISHING || !trust_wrong(job));
}

job_t *farm_next_finished(farm_t *farm)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count && found == NULL; i++)
        if (farm->jobs[i]->image == IMAGE_DUE && farm->jobs[i]->milestone == IMAGE_NONE &&
            is_settled(farm->jobs[i]))
            found = farm->jobs[i];
    if (found != NULL) {
        found->image = IMAGE_WRITING;
        found->pins++;
    }
    farm_unlock(farm);
    return found;
}

/* The film of an adaptive job knows the weights of its samples, the schedule their number. Called with the
 * shared film locked, so that both are of the same moment. `image` has the rows from y0 to before y1. */
static void show_samples(farm_t *farm, const job_t *job, const job_settings_t *settings, int y0, int y1,
                         film_image_t *image)
{
    uint32_t *samples = mem_alloc(job_tile_count(settings) * sizeof *samples);
    farm_lock(farm);
    bool known = job->schedule != NULL;
    if (known) schedule_tile_samples(job->schedule, samples);
    farm_unlock(farm);
    if (known) schedule_show_samples(settings, samples, y0, y1, image->samples);
    free(samples);
}

bool farm_job_halves(farm_t *farm, const job_t *job)
{
    farm_lock(farm);
    bool halves = job->kept.terms.halves;
    farm_unlock(farm);
    return halves;
}

/* The film of a job, to be let go, or why there is none. */
static result_t hold_film(farm_t *farm, job_t *job, shared_film_t **shared_film)
{
    farm_lock(farm);
    unsigned long long number = job->kept.job;
    bool empty = job->kept.batches == 0, due = job_awaits_film(job);
    if (job->film == FILM_STORED) farm_want_film(farm, job); /* somebody wants to see it */
    farm_unlock(farm);
    *shared_film = empty ? NULL : job_film_hold(farm, job);
    if (*shared_film != NULL) return result_ok();
    if (due)
        return result_fail(RESULT_INPUT, "the film of job %llu is not loaded yet: try again in a moment",
                           number);
    return result_fail(RESULT_INPUT, "job %llu has no samples yet", number);
}

result_t farm_resolve(farm_t *farm, double now, job_t *job, const film_extras_t *extras, film_image_t *image,
                      job_report_t *report)
{
    shared_film_t *shared_film;
    farm_lock(farm);
    *report = farm_report_job(job, now);
    farm_unlock(farm);
    TRY(hold_film(farm, job, &shared_film));
    const job_settings_t *settings = &report->record.settings;
    const film_t *film = shared_film_lock(shared_film);
    film_resolve(film, image);
    if (extras != NULL) film_resolve_extras(film, extras, image);
    if (settings->adaptive) show_samples(farm, job, settings, 0, settings->height, image);
    farm_note_image_error(farm, now, job, image->error);
    shared_film_unlock(shared_film);
    job_film_let_go(farm, job);
    return result_ok();
}

result_t farm_resolve_rows(farm_t *farm, job_t *job, const film_rows_t *rows, film_image_t *image)
{
    shared_film_t *shared_film;
    job_settings_t settings = farm_job_settings(farm, job);
    TRY(hold_film(farm, job, &shared_film));
    film_resolve_rows(shared_film_lock(shared_film), rows, image);
    if (settings.adaptive) show_samples(farm, job, &settings, rows->y0, rows->y1, image);
    shared_film_unlock(shared_film);
    job_film_let_go(farm, job);
    return result_ok();
}

uint64_t farm_image_version(farm_t *farm, job_t *job, bool *over)
{
    farm_lock(farm);
    uint64_t version = job->kept.batches;
    *over = job_state_final(job->kept.state);
    farm_unlock(farm);
    return version;
}

void farm_finished(farm_t *farm, double now, job_t *job, result_t written, const char *path)
{
    farm_lock(farm);
    if (job->image != IMAGE_WRITING) {
        log_debug("job %llu: its image was given up meanwhile", (unsigned long long)job->kept.job);
    } else if (written.code == RESULT_OK) {
        job->image = IMAGE_WRITTEN;
        if (job->image_failures > 0) job->remark[0] = '\0'; /* it is not true any more */
        job->image_failures = 0;
        if (path != NULL) log_info("job %llu: the image is in %s", (unsigned long long)job->kept.job, path);
    } else {
        job->image = IMAGE_FAILED;
        job->image_failures++;
        job->image_retry = now + IMAGE_RETRY;
        snprintf(job->remark, sizeof job->remark, "the image cannot be written, and is tried again: %.200s",
                 written.message);
        log_error("job %llu: %s", (unsigned long long)job->kept.job, job->remark);
        farm_job_stuck(farm, job);
    }
    farm_job_settle(farm, job);
    farm_unlock(farm);
}
