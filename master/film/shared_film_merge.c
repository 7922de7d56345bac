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
 * looked at; and if all is well the batch is added for good, without the sums that overflow.
 *
 * With limits, a walk that meets a value beyond them is stopped and taken back in the same way. Limits are
 * powers of two: most pieces are known to be within them by the bytes that their values take, and of others
 * it is enough to look at the bits of all magnitudes together. */
#include "master/film/shared_film_pages.h"

#include <stdlib.h>
#include <string.h>

/* One walk over the payloads of a batch. */
typedef struct {
    adder_t adder;
    const job_settings_t *settings;
    const batch_t *batch;
    const uint32_t *weights;
    sum_limits_t *limits;  /* NULL: none */
    uint64_t mean_samples; /* of the batch, a pixel of the image, rounded up; with limits */
    lesson_limits_t lesson_limits;
    payload_reader_t *reader;
    sum_kind_t kind; /* of the payload at hand */
    size_t *starts;  /* of each unit in it, in pixels, and the end */
    size_t unit;     /* the one at hand */
    int64_t unfolded[PAYLOAD_PIECE_VALUES], weighed[PAYLOAD_PIECE_VALUES];
} walk_t;

static uint32_t weight_of(const walk_t *walk, size_t unit)
{
    return walk->weights == NULL ? 1 : walk->weights[unit];
}

/* These return RESULT_CANCELLED when the adder stopped, or a value is beyond the limits. */

static result_t stopped(void)
{
    return result_fail(RESULT_CANCELLED, "stopped");
}

/* ---- limits -------------------------------------------------------------------------------------------- */

/* All bits that are set in the magnitudes (less 1 of those below zero) of some values. */
static uint64_t magnitude_bits(const int64_t *values, size_t count)
{
    uint64_t bits = 0;
    for (size_t i = 0; i < count; i++) bits |= (uint64_t)(values[i] < 0 ? ~values[i] : values[i]);
    return bits;
}

/* True when values of the payload at hand, from -2^bits to before 2^bits and of so many samples, are within
 * the limits. They were looked at before when the batch is added in another mode than the first. */
static bool within_limits(walk_t *walk, uint64_t samples, int bits, const int64_t *values, size_t count)
{
    sum_limits_t *limits = walk->limits;
    if (limits == NULL || walk->adder.mode != ADD_STRICT || limits->once[walk->kind] == 0) return true;
    uint64_t most, largest = UINT64_C(1) << 62;
    if (__builtin_mul_overflow(limits->each[walk->kind], samples, &most) || most > largest) most = largest;
    int allowed = 64 - __builtin_clzll(most + limits->once[walk->kind]);
    if (bits <= allowed && !limits->measured) return true;
    uint64_t set = magnitude_bits(values, count);
    limits->top[walk->kind] |= set;
    return set >> allowed == 0;
}

/* ---- samples ------------------------------------------------------------------------------------------- */

static bool count_tile(walk_t *walk, const unit_t *unit, uint32_t weight)
{
    rect_t rect = job_tile_rect(walk->settings, unit->tile);
    size_t width = (size_t)walk->settings->width, height = (size_t)walk->settings->height;
    for (int half = 0; half < 2; half++)
        for (int y = rect.y0; y < rect.y1; y++)
            if (!adder_count(&walk->adder, ((size_t)half * height + (size_t)y) * width + (size_t)rect.x0,
                             weight * unit_half_count(unit, half), (size_t)(rect.x1 - rect.x0)))
                return false;
    return true;
}

/* They are in no payload: they follow from the units. */
static result_t walk_samples(walk_t *walk)
{
    bool good = true;
    for (size_t i = 0; i < walk->batch->unit_count && good; i++)
        good = count_tile(walk, &walk->batch->units[i], weight_of(walk, i));
    adder_rest(&walk->adder);
    return good ? result_ok() : stopped();
}

/* ---- tiles --------------------------------------------------------------------------------------------- */

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

/* Part of a row of a tile. */
typedef struct {
    size_t pixel; /* the first, numbered through the halves of the image */
    size_t count;
} run_t;

/* The pixels from `pixel` of the frame on that lie in one row of one tile, at most `left`. */
static run_t find_run(walk_t *walk, size_t pixel, size_t left)
{
    find_unit(walk, pixel);
    rect_t rect = job_tile_rect(walk->settings, walk->batch->units[walk->unit].tile);
    size_t width = (size_t)(rect.x1 - rect.x0), area = width * (size_t)(rect.y1 - rect.y0);
    size_t local = pixel - walk->starts[walk->unit], inside = local % area, x = inside % width;
    size_t row = local / area * (size_t)walk->settings->height + (size_t)rect.y0 + inside / width;
    return (run_t){.pixel = row * (size_t)walk->settings->width + (size_t)rect.x0 + x,
                   .count = width - x < left ? width - x : left};
}

/* All values of a piece, zeroes too. */
static const int64_t *unfold_piece(walk_t *walk, const payload_piece_t *piece)
{
    const int64_t *value = piece->values;
    bool whole = true;
    for (size_t i = 0; i < piece->pixels && whole; i += 64) {
        size_t left = piece->pixels - i;
        whole = (size_t)__builtin_popcountll(payload_marked(piece, i)) == (left < 64 ? left : 64);
    }
    if (whole) return value;
    for (size_t i = 0; i < piece->pixels; i++) {
        bool marked = piece->mask[i / 64] >> (i % 64) & 1;
        for (size_t l = 0; l < piece->lanes; l++)
            walk->unfolded[piece->lanes * i + l] = marked ? *value++ : 0;
    }
    return walk->unfolded;
}

/* Values as often as they count. What then is no number any more overflows when it is added. */
static const int64_t *weigh(walk_t *walk, const int64_t *values, size_t count)
{
    int64_t weight = weight_of(walk, walk->unit);
    if (weight == 1 || !film_sums[walk->kind].weighted) return values;
    for (size_t i = 0; i < count; i++)
        if (__builtin_mul_overflow(values[i], weight, &walk->weighed[i])) walk->weighed[i] = INT64_MAX;
    return walk->weighed;
}

static result_t impossible(const walk_t *walk)
{
    return result_fail(RESULT_PROTOCOL, "%s sums that no sample can have", film_sums[walk->kind].name);
}

static result_t walk_tile_piece(walk_t *walk, const payload_piece_t *piece)
{
    const sum_layout_t *layout = &film_sums[walk->kind];
    const int64_t *values = unfold_piece(walk, piece);
    for (size_t i = 0; i < piece->pixels;) {
        run_t run = find_run(walk, piece->first + i, piece->pixels - i);
        size_t count = piece->lanes * run.count;
        if (!sum_possible(walk->kind, &walk->batch->units[walk->unit], values, count))
            return impossible(walk);
        if (!within_limits(walk, walk->batch->units[walk->unit].count, piece->bits, values, count))
            return stopped();
        if (!adder_add_strided(&walk->adder, walk->kind, layout->values * run.pixel + piece->offset,
                               layout->values, piece->lanes, weigh(walk, values, count), run.count))
            return stopped();
        values += count;
        i += run.count;
    }
    return result_ok();
}

/* Where the units lie in the payload at hand. */
static void index_units(walk_t *walk)
{
    size_t start = 0;
    for (size_t i = 0; i < walk->batch->unit_count; i++) {
        walk->starts[i] = start;
        start += sum_unit_values(walk->settings, walk->kind, &walk->batch->units[i]) /
                 film_sums[walk->kind].values;
    }
    walk->starts[walk->batch->unit_count] = start;
    walk->unit = 0;
}

/* ---- frames -------------------------------------------------------------------------------------------- */

static size_t marked_pixels(const payload_piece_t *piece)
{
    size_t marked = 0;
    for (size_t i = 0; i < piece->pixels; i += 64)
        marked += (size_t)__builtin_popcountll(payload_marked(piece, i));
    return marked;
}

static result_t walk_frame_piece(walk_t *walk, const payload_piece_t *piece)
{
    const int64_t *values = piece->values;
    if (!within_limits(walk, walk->mean_samples, piece->bits, values, 3 * marked_pixels(piece)))
        return stopped();
    for (size_t i = 0; i < piece->pixels; i += 64) {
        uint64_t mask = payload_marked(piece, i);
        if (!adder_add_marked(&walk->adder, walk->kind, 3 * (piece->first + i), mask, values, piece->large))
            return stopped();
        values += 3 * (size_t)__builtin_popcountll(mask);
    }
    return result_ok();
}

/* A piece lies within one pass. */
_Static_assert(LEARNING_PLACES % PAYLOAD_PIECE == 0, "pieces of lessons cross passes");
static result_t walk_lessons_piece(walk_t *walk, const payload_piece_t *piece)
{
    if (marked_pixels(piece) == 0) return result_ok();
    if (!payload_lessons_possible(piece, &walk->lesson_limits)) return impossible(walk);
    bool settled = piece->first / LEARNING_PLACES < walk->adder.shared_film->film->settled;
    if (settled) return result_ok();
    const int64_t *values = unfold_piece(walk, piece);
    if (!adder_add_strided(&walk->adder, walk->kind, piece->first, 1, 1, values, piece->pixels))
        return stopped();
    return result_ok();
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

static result_t walk_piece(walk_t *walk, const payload_piece_t *piece)
{
    if (walk->kind == SUM_LESSONS) return walk_lessons_piece(walk, piece);
    return film_sums[walk->kind].frame ? walk_frame_piece(walk, piece) : walk_tile_piece(walk, piece);
}

static result_t walk_payload(walk_t *walk, const zmq_msg_t *payload, sum_kind_t kind)
{
    walk->kind = kind;
    if (!film_sums[kind].frame) index_units(walk);
    result_t result = payload_open(walk->reader, payload, kind, batch_expected_values(walk->batch, kind));
    for (payload_piece_t piece; result.code == RESULT_OK && payload_read(walk->reader, &piece);) {
        result = walk_piece(walk, &piece);
        adder_rest(&walk->adder);
    }
    return result.code == RESULT_OK ? payload_end(walk->reader) : result;
}

static result_t walk_batch(walk_t *walk, const zmq_msg_t payload[BATCH_PAYLOADS])
{
    TRY(walk_samples(walk));
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) TRY(walk_payload(walk, &payload[k], k));
    return result_ok();
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
    if (walk->limits != NULL) return result_fail(RESULT_CANCELLED, "sums that are too large");
    return walk_again(walk, payload, ADD_TOLERANT, false, UINT64_MAX);
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

/* Samples of a batch for each pixel of the image, rounded up. */
static uint64_t mean_samples(const batch_t *batch)
{
    uint64_t samples = 0, pixels = (uint64_t)batch->settings.width * (uint64_t)batch->settings.height;
    for (size_t i = 0; i < batch->unit_count; i++)
        samples += batch->units[i].count * (uint64_t)job_tile_pixels(&batch->settings, batch->units[i].tile);
    return (samples + pixels - 1) / pixels;
}

static result_t merge_batch(shared_film_t *shared_film, const zmq_msg_t payload[BATCH_PAYLOADS],
                            const batch_t *batch, const uint32_t *weights, sum_limits_t *limits, int sign)
{
    walk_t *walk = mem_alloc(sizeof *walk);
    *walk = (walk_t){.adder.shared_film = shared_film,
                     .settings = &shared_film->film->settings,
                     .batch = batch,
                     .weights = weights,
                     .limits = limits,
                     .mean_samples = mean_samples(batch),
                     .lesson_limits = batch_lesson_limits(batch),
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

result_t shared_film_merge_payload(shared_film_t *shared_film, const zmq_msg_t payload[BATCH_PAYLOADS],
                                   const batch_t *batch, const uint32_t *weights, int sign)
{
    return merge_batch(shared_film, payload, batch, weights, NULL, sign);
}

result_t shared_film_merge_within(shared_film_t *shared_film, const zmq_msg_t payload[BATCH_PAYLOADS],
                                  const batch_t *batch, const uint32_t *weights, sum_limits_t *limits)
{
    memset(limits->top, 0, sizeof limits->top);
    return merge_batch(shared_film, payload, batch, weights, limits, 1);
}
