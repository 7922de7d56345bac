/* shared_film_merge: how a batch gets into the pages of a shared film (see shared_film.h).
 *
 * DESIGN. Payloads are read in pieces that stay in the cache (payload_read.c) and added from there: a frame
 * is never unfolded in memory, and a splat frame costs what its pixels that were hit cost. So a payload turns
 * out to be damaged when part of it is in the film. That part is then taken out again by walking over the
 * same pieces with the other sign, up to the step (shared_film_pages.h) where it ended: integers forget
 * nothing.
 *
 * An overflow, which fails the job, must not be counted before the whole batch is known to be good, since
 * what does not count must leave no trace. So the first walk stops at one and is taken back too; the rest is
 * looked at; and if all is well the batch is added for good, without the sums that overflow. */
#include "master/film/shared_film_pages.h"

#include <stdlib.h>
#include <string.h>

/* ---- rows and counts ----------------------------------------------------------------------------------- */

static uint32_t weight_of(const uint32_t *weights, size_t unit)
{
    return weights == NULL ? 1 : weights[unit];
}

/* A row of a tile's eye sums, and its samples. */
static bool add_eye_row(adder_t *adder, size_t pixel, size_t pixels, const int64_t *values, uint32_t samples,
                        uint32_t weight)
{
    int64_t weighted[3 * JOB_MAX_TILE];
    for (size_t i = 0; weight != 1 && i < 3 * pixels; i++)
        if (__builtin_mul_overflow(values[i], (int64_t)weight, &weighted[i])) weighted[i] = INT64_MAX;
    return adder_add(adder, ARRAY_EYE, 3 * pixel, weight != 1 ? weighted : values, 3 * pixels, true) &&
           adder_count(adder, pixel, weight * samples, pixels);
}

static void add_counts(shared_film_t *shared_film, const film_counts_t *counts, uint64_t overflows, int sign)
{
    pthread_mutex_lock(&shared_film->counting);
    if (sign < 0)
        film_counts_take_out(&shared_film->film->counts, counts);
    else
        film_counts_add(&shared_film->film->counts, counts);
    shared_film->film->counts.overflows += overflows;
    pthread_mutex_unlock(&shared_film->counting);
}

/* ---- walking over the payloads ------------------------------------------------------------------------- */

/* One walk over the payloads of a batch. */
typedef struct {
    adder_t adder;
    const job_settings_t *settings;
    const batch_t *batch;
    const uint32_t *weights;
    payload_reader_t *reader;
    size_t *starts; /* of each unit in the frame at hand, in pixels, and the end */
    size_t unit;    /* the one at hand */
    int64_t row[3 * PAYLOAD_PIECE];
} walk_t;

/* Goes to the unit that a pixel of the frame belongs to. */
static void find_unit(walk_t *walk, size_t pixel)
{
    size_t low = 0, high = walk->batch->unit_count;
    if (walk->starts[walk->unit] <= pixel && pixel < walk->starts[walk->unit + 1]) return;
    while (high - low > 1) {
        size_t middle = low + (high - low) / 2;
        if (walk->starts[middle] <= pixel)
            low = middle;
        else
            high = middle;
    }
    walk->unit = low;
}

/* Part of a row of a tile: where it lies in the image, and in which half. */
typedef struct {
    size_t pixel; /* in the image */
    size_t count;
    int half;
} run_t;

/* The pixels from `pixel` of the frame on that lie in one row of one tile, at most `left`. */
static run_t find_run(walk_t *walk, size_t pixel, size_t left)
{
    find_unit(walk, pixel);
    rect_t rect = job_tile_rect(walk->settings, walk->batch->units[walk->unit].tile);
    size_t width = (size_t)(rect.x1 - rect.x0), area = width * (size_t)(rect.y1 - rect.y0);
    size_t local = pixel - walk->starts[walk->unit], inside = local % area, x = inside % width;
    size_t row = (size_t)rect.y0 + inside / width;
    return (run_t){.pixel = row * (size_t)walk->settings->width + (size_t)rect.x0 + x,
                   .count = width - x < left ? width - x : left,
                   .half = (int)(local / area)};
}

/* All values of a piece of three values a pixel, zeroes too. */
static const int64_t *unfold_piece(walk_t *walk, const payload_piece_t *piece)
{
    const int64_t *value = piece->values;
    bool whole = true;
    for (size_t i = 0; i < piece->pixels && whole; i += 64) {
        size_t left = piece->pixels - i;
        uint64_t all = left < 64 ? (UINT64_C(1) << left) - 1 : UINT64_MAX;
        whole = (piece->mask[i / 64] & all) == all;
    }
    if (whole) return value;
    for (size_t i = 0; i < piece->pixels; i++) {
        bool marked = piece->mask[i / 64] >> (i % 64) & 1;
        for (size_t c = 0; c < 3; c++) walk->row[3 * i + c] = marked ? *value++ : 0;
    }
    return walk->row;
}

/* These return RESULT_CANCELLED when the adder stopped. */

static result_t stopped(void)
{
    return result_fail(RESULT_CANCELLED, "stopped");
}

static result_t walk_eye_piece(walk_t *walk, const payload_piece_t *piece)
{
    const int64_t *values = unfold_piece(walk, piece);
    size_t image = (size_t)walk->settings->width * (size_t)walk->settings->height;
    for (size_t i = 0; i < piece->pixels;) {
        run_t run = find_run(walk, piece->first + i, piece->pixels - i);
        uint32_t samples = unit_half_count(&walk->batch->units[walk->unit], run.half);
        if (!add_eye_row(&walk->adder, (size_t)run.half * image + run.pixel, run.count, values + 3 * i,
                         samples, weight_of(walk->weights, walk->unit)))
            return stopped();
        i += run.count;
    }
    return result_ok();
}

static result_t walk_splat_piece(walk_t *walk, const payload_piece_t *piece)
{
    const int64_t *values = piece->values;
    for (size_t i = 0; i < piece->pixels; i += 64) {
        size_t left = piece->pixels - i;
        uint64_t mask = piece->mask[i / 64] & (left < 64 ? (UINT64_C(1) << left) - 1 : UINT64_MAX);
        if (!adder_add_marked(&walk->adder, ARRAY_SPLAT, 3 * (piece->first + i), mask, values, piece->large))
            return stopped();
        values += 3 * (size_t)__builtin_popcountll(mask);
    }
    return result_ok();
}

static result_t walk_feature_piece(walk_t *walk, const payload_piece_t *piece)
{
    for (size_t i = 0; i < piece->pixels;) {
        const int64_t *values = piece->values + piece->lanes * i;
        run_t run = find_run(walk, piece->first + i, piece->pixels - i);
        if (!unit_features_possible(&walk->batch->units[walk->unit], values, piece->lanes * run.count))
            return result_fail(RESULT_PROTOCOL, "features that no sample can have");
        if (!adder_add_strided(&walk->adder, ARRAY_FEATURES, FEATURE_VALUES * run.pixel + piece->offset,
                               FEATURE_VALUES, piece->lanes, values, run.count))
            return stopped();
        i += run.count;
    }
    return result_ok();
}

/* Where the units lie in a frame that has `count` values of each, `stride` a pixel. */
static size_t index_units(walk_t *walk, bool features)
{
    size_t values = 0, stride = features ? FEATURE_VALUES : 3;
    for (size_t i = 0; i < walk->batch->unit_count; i++) {
        const unit_t *unit = &walk->batch->units[i];
        walk->starts[i] = values / stride;
        values += features ? batch_feature_values(walk->settings, unit)
                           : batch_tile_values(walk->settings, unit->tile);
    }
    walk->starts[walk->batch->unit_count] = values / stride;
    walk->unit = 0;
    return values;
}

static result_t walk_frame(walk_t *walk, const zmq_msg_t *frame, int which, size_t values,
                           result_t (*take)(walk_t *, const payload_piece_t *))
{
    result_t result = payload_open(walk->reader, frame, which, values);
    for (payload_piece_t piece; result.code == RESULT_OK && payload_read(walk->reader, &piece);) {
        result = take(walk, &piece);
        adder_rest(&walk->adder);
    }
    return result.code == RESULT_OK ? payload_end(walk->reader) : result;
}

static result_t walk_batch(walk_t *walk, const zmq_msg_t payload[BATCH_PAYLOADS])
{
    TRY(walk_frame(walk, &payload[0], 0, index_units(walk, false), walk_eye_piece));
    if (zmq_msg_size(&payload[1]) > 0)
        TRY(walk_frame(walk, &payload[1], 1, batch_splat_values(walk->settings), walk_splat_piece));
    size_t features = index_units(walk, true);
    if (features == 0) return payload_no_features(&payload[2]);
    return walk_frame(walk, &payload[2], 2, features, walk_feature_piece);
}

static result_t walk_again(walk_t *walk, const zmq_msg_t payload[BATCH_PAYLOADS], add_mode_t mode,
                           bool negative, uint64_t limit)
{
    walk->adder = adder_new(walk->adder.shared_film, mode, negative, limit);
    return walk_batch(walk, payload);
}

/* See the note at the top of the file. */
static result_t merge(walk_t *walk, const zmq_msg_t payload[BATCH_PAYLOADS], bool negative)
{
    result_t result = walk_again(walk, payload, negative ? ADD_EXACT : ADD_STRICT, negative, UINT64_MAX);
    if (result.code == RESULT_OK) return result;
    walk_again(walk, payload, ADD_EXACT, !negative, walk->adder.steps);
    if (result.code != RESULT_CANCELLED) return result;
    TRY(walk_again(walk, payload, ADD_NOTHING, false, UINT64_MAX));
    return walk_again(walk, payload, ADD_TOLERANT, false, UINT64_MAX);
}

result_t shared_film_merge_payload(shared_film_t *shared_film, const zmq_msg_t payload[BATCH_PAYLOADS],
                                   const batch_t *batch, const uint32_t *weights, int sign)
{
    walk_t *walk = mem_alloc(sizeof *walk);
    *walk = (walk_t){.adder.shared_film = shared_film,
                     .settings = &shared_film->film->settings,
                     .batch = batch,
                     .weights = weights,
                     .reader = payload_reader_new(),
                     .starts = mem_alloc((batch->unit_count + 1) * sizeof *walk->starts)};
    result_t result = walk->reader == NULL ? result_fail(RESULT_LIMIT, "no memory for a decoder")
                                           : merge(walk, payload, sign < 0);
    if (result.code == RESULT_OK) add_counts(shared_film, &batch->counts, walk->adder.overflows, sign);
    payload_reader_free(&walk->reader);
    free(walk->starts);
    free(walk);
    return result;
}
