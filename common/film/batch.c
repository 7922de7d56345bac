/* batch: see batch.h. */
#include "common/film/batch.h"

#include "common/vec.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- counts -------------------------------------------------------------------------------------------- */

void film_counts_add(film_counts_t *sum, const film_counts_t *more)
{
    for (int half = 0; half < 2; half++) sum->light_paths[half] += more->light_paths[half];
    sum->dropped += more->dropped;
    sum->overflows += more->overflows;
    sum->rays += more->rays;
    sum->cpu_us += more->cpu_us;
}

void film_counts_take_out(film_counts_t *sum, const film_counts_t *less)
{
    for (int half = 0; half < 2; half++) sum->light_paths[half] -= less->light_paths[half];
    sum->dropped -= less->dropped;
    sum->overflows -= less->overflows;
    sum->rays -= less->rays;
    sum->cpu_us -= less->cpu_us;
}

/* What is merely for people may not get so large that the sum is refused for it. */
static void limit_counts(film_counts_t *counts)
{
    uint64_t *const others[] = {&counts->dropped, &counts->overflows, &counts->rays, &counts->cpu_us};
    for (size_t i = 0; i < ARRAY_LENGTH(others); i++)
        if (*others[i] > BATCH_MAX_COUNT) *others[i] = BATCH_MAX_COUNT;
}

result_t batch_check_counts(const batch_t *batch)
{
    uint64_t samples[2] = {0, 0};
    for (size_t i = 0; i < batch->unit_count; i++)
        for (int half = 0; half < 2; half++)
            samples[half] += (uint64_t)unit_half_count(&batch->units[i], half) *
                             job_tile_pixels(&batch->settings, batch->units[i].tile);
    for (int half = 0; half < 2; half++) {
        uint64_t paths = job_has_splats(&batch->settings) ? samples[half] : 0;
        if (batch->counts.light_paths[half] != paths)
            return result_fail(RESULT_PROTOCOL, "%llu light paths, where its units trace %llu",
                               (unsigned long long)batch->counts.light_paths[half],
                               (unsigned long long)paths);
    }
    /* Of a sample: what its eye subpath brings, its features, and a splat of each light vertex. */
    uint64_t both = samples[0] + samples[1];
    if (batch->counts.dropped > both * ((uint64_t)batch->settings.max_depth + 4))
        return result_fail(RESULT_PROTOCOL, "%llu contributions dropped of %llu samples",
                           (unsigned long long)batch->counts.dropped, (unsigned long long)both);
    const uint64_t others[] = {batch->counts.overflows, batch->counts.rays, batch->counts.cpu_us};
    for (size_t i = 0; i < ARRAY_LENGTH(others); i++)
        if (others[i] > BATCH_MAX_COUNT)
            return result_fail(RESULT_PROTOCOL, "a count of %llu is out of all bounds",
                               (unsigned long long)others[i]);
    return result_ok();
}

/* ---- the result of a unit ------------------------------------------------------------------------------ */

static void forget_lessons(unit_result_t *result)
{
    for (size_t i = 0; i < LESSON_GROUPS; i++)
        if (result->taught[i])
            memset(result->lessons + i * LESSON_GROUP, 0, LESSON_GROUP * sizeof *result->lessons);
    memset(result->taught, 0, sizeof result->taught);
}

void unit_result_reset(unit_result_t *result, const job_settings_t *settings, const unit_t *unit)
{
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
        sum_array_t *sums = &result->sums[k];
        sums->count = sum_unit_values(settings, k, unit);
        sum_array_reserve(sums, sums->count);
        if (sums->count > 0) memset(sums->values, 0, sums->count * sizeof *sums->values);
    }
    result->unit = *unit;
    result->splat_count = 0;
    if (job_learns(settings) && result->lessons == NULL)
        result->lessons = mem_zalloc(LEARNING_PLACES, sizeof *result->lessons);
    forget_lessons(result);
    result->counts = (film_counts_t){0};
}

void unit_result_free(unit_result_t *result)
{
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) sum_array_free(&result->sums[k]);
    free(result->splats);
    free(result->lessons);
    *result = (unit_result_t){0};
}

/* The measured values of a hit, in the order of the sums from FEATURE_ALBEDO to FEATURE_DEPTH. */
enum { MEASURED = FEATURE_DEPTH + 1 };

static void measured_values(const first_hit_t *hit, float values[MEASURED])
{
    memcpy(values + FEATURE_ALBEDO, hit->albedo, sizeof hit->albedo);
    memcpy(values + FEATURE_NORMAL, hit->normal, sizeof hit->normal);
    memcpy(values + FEATURE_POSITION, hit->position, sizeof hit->position);
    values[FEATURE_DEPTH] = hit->depth;
}

static void add_matte(unit_result_t *result, size_t pixel, uint32_t sample, const first_hit_t *hit)
{
    if (result->sums[SUM_MATTES].count == 0 || sample >= MATTE_SAMPLES) return;
    uint64_t code = hit->hit ? (uint64_t)hit->object - 1 + MATTE_FIRST_SHAPE : MATTE_NOTHING;
    if (code > MATTE_MAX_CODE) code = MATTE_NOTHING;
    result->sums[SUM_MATTES].values[MATTE_VALUES * pixel + sample / MATTE_SLOTS] +=
        (int64_t)(code << (MATTE_BITS * (sample % MATTE_SLOTS)));
}

void unit_result_feature(unit_result_t *result, size_t pixel, uint32_t sample, const first_hit_t *hit)
{
    const float limit = 0x1.fffffep24f; /* FEATURE_SAMPLES of it are below 2^62 units: nothing saturates */
    const double scale = (double)(UINT64_C(1) << FEATURE_SCALE);
    add_matte(result, pixel, sample, hit);
    if (result->sums[SUM_FEATURES].count == 0 || sample >= FEATURE_SAMPLES) return;
    int64_t *sum = result->sums[SUM_FEATURES].values + FEATURE_VALUES * pixel;
    if (!hit->hit) {
        sum[FEATURE_COUNT]++;
        return;
    }
    float values[MEASURED];
    bool finite = true;
    measured_values(hit, values);
    for (int v = 0; v < MEASURED; v++) finite = finite && isfinite(values[v]);
    if (!finite) {
        result->counts.dropped++;
        return;
    }
    sum[FEATURE_COUNT]++;
    sum[FEATURE_HITS]++;
    for (int v = 0; v < MEASURED; v++)
        sum[v] += llrint((double)float_clamp(values[v], -limit, limit) * scale);
    if (sample > 0) return;
    sum[FEATURE_OBJECT] = hit->object;
    sum[FEATURE_MATERIAL] = hit->material;
}

/* ---- the batch ----------------------------------------------------------------------------------------- */

void batch_init(batch_t *batch, const job_settings_t *settings)
{
    *batch = (batch_t){.settings = *settings};
}

void batch_clear(batch_t *batch)
{
    batch->unit_count = 0;
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (!film_sums[k].frame)
            batch->sums[k].count = 0;
        else if (batch->sums[k].count > 0)
            memset(batch->sums[k].values, 0, batch->sums[k].count * sizeof(int64_t));
    batch->counts = (film_counts_t){0};
}

void batch_free(batch_t *batch)
{
    free(batch->units);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) sum_array_free(&batch->sums[k]);
    *batch = (batch_t){0};
}

int64_t *batch_frame(batch_t *batch, sum_kind_t kind)
{
    sum_array_t *frame = &batch->sums[kind];
    if (frame->count > 0) return frame->values;
    sum_array_zeroes(frame, sum_image_values(&batch->settings, kind));
    return frame->values;
}

static void add_splats(batch_t *batch, const unit_result_t *result)
{
    if (result->splat_count == 0) return;
    bool grouped = sum_planes(&batch->settings, SUM_GROUP_SPLAT) > 0;
    int64_t *frame = batch_frame(batch, SUM_SPLAT);
    int64_t *groups = grouped ? batch_frame(batch, SUM_GROUP_SPLAT) : NULL;
    size_t plane = batch->sums[SUM_SPLAT].count / 2;
    for (size_t i = 0; i < result->splat_count; i++) {
        const splat_t *splat = &result->splats[i];
        size_t place = (size_t)3 * (splat->pixel & SPLAT_PIXEL_MASK);
        int64_t *sum = frame + place + (splat->pixel & SPLAT_HALF_BIT ? plane : 0);
        batch->counts.overflows += film_add(sum, splat->rgb, batch->settings.film_scale);
        if (grouped)
            batch->counts.overflows +=
                film_add(groups + place + splat_group(splat) * plane, splat->rgb, batch->settings.film_scale);
    }
}

/* Lessons that go into no plan are not kept. */
static void add_lessons(batch_t *batch, const unit_result_t *result)
{
    uint32_t pass = learning_pass(&batch->settings, result->unit.first);
    if (pass >= sum_planes(&batch->settings, SUM_LESSONS)) return;
    int64_t *plane = batch_frame(batch, SUM_LESSONS) + (size_t)pass * LEARNING_PLACES;
    for (size_t i = 0; i < LEARNING_PLACES; i += LESSON_GROUP) {
        if (!result->taught[i / LESSON_GROUP]) continue;
        for (size_t k = i; k < i + LESSON_GROUP; k++) plane[k] += (int64_t)result->lessons[k];
    }
}

static void append_units(batch_t *batch, const unit_t *units, size_t count)
{
    if (batch->unit_count + count > batch->unit_capacity) {
        batch->unit_capacity = 2 * (batch->unit_count + count) + 16;
        batch->units = mem_realloc(batch->units, batch->unit_capacity * sizeof *batch->units);
    }
    memcpy(batch->units + batch->unit_count, units, count * sizeof *units);
    batch->unit_count += count;
}

static void append_sums(sum_array_t *sums, const sum_array_t *more)
{
    if (more->count == 0) return;
    size_t count = sums->count + more->count;
    if (count > sums->capacity) sum_array_reserve(sums, 2 * sums->capacity + more->count);
    memcpy(sums->values + sums->count, more->values, more->count * sizeof *sums->values);
    sums->count = count;
}

void batch_take_beside(batch_t *batch, unit_result_t *result)
{
    add_splats(batch, result);
    add_lessons(batch, result);
    memset(result->taught, 0, sizeof result->taught);
    free(result->splats);
    free(result->lessons);
    result->splats = NULL;
    result->lessons = NULL;
    result->splat_count = result->splat_capacity = 0;
}

void batch_add(batch_t *batch, const unit_result_t *result)
{
    append_units(batch, &result->unit, 1);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) append_sums(&batch->sums[k], &result->sums[k]);
    add_splats(batch, result);
    add_lessons(batch, result);
    film_counts_add(&batch->counts, &result->counts);
}

void batch_merge(batch_t *sum, const batch_t *more)
{
    append_units(sum, more->units, more->unit_count);
    film_counts_add(&sum->counts, &more->counts);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (!film_sums[k].frame)
            append_sums(&sum->sums[k], &more->sums[k]);
        else if (more->sums[k].count > 0)
            sum->counts.overflows +=
                film_add_sums(batch_frame(sum, k), more->sums[k].values, more->sums[k].count);
    limit_counts(&sum->counts);
}

/* ---- how large it is, and whether it can be ------------------------------------------------------------ */

size_t batch_expected_values(const batch_t *batch, sum_kind_t kind)
{
    if (film_sums[kind].frame) return sum_image_values(&batch->settings, kind);
    size_t values = 0;
    for (size_t i = 0; i < batch->unit_count; i++)
        values += sum_unit_values(&batch->settings, kind, &batch->units[i]);
    return values;
}

size_t batch_tile_values(const batch_t *batch)
{
    size_t values = 0;
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (!film_sums[k].frame) values += batch->sums[k].count;
    return values;
}

size_t batch_bytes(const batch_t *batch)
{
    size_t values = 0;
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) values += batch->sums[k].count;
    return values * sizeof(int64_t);
}

result_t batch_check_size(const batch_t *batch, uint64_t limit)
{
    uint64_t bytes = 0;
    for (size_t i = 0; i < batch->unit_count; i++)
        bytes += sum_unit_bytes(&batch->settings, &batch->units[i]);
    if (bytes <= limit) return result_ok();
    return result_fail(RESULT_LIMIT, "a batch with tiles of %.0f MB is over the limit of %.0f MB",
                       1e-6 * (double)bytes, 1e-6 * (double)limit);
}

#define LESSONS_MAX ((uint64_t)1 << 62)

static result_t impossible(sum_kind_t kind)
{
    return result_fail(RESULT_PROTOCOL, "%s sums that no sample can have", film_sums[kind].name);
}

lesson_limits_t batch_lesson_limits(const batch_t *batch)
{
    lesson_limits_t limits = {{0}};
    for (size_t i = 0; i < batch->unit_count; i++) {
        uint32_t pass = learning_pass(&batch->settings, batch->units[i].first);
        if (pass >= learning_taught(&batch->settings)) continue;
        uint64_t samples = unit_samples(&batch->settings, &batch->units[i]),
                 most = LESSONS_MAX >> LEARNING_BITS;
        uint64_t limit = limits.limit[pass] + ((samples < most ? samples : most) << LEARNING_BITS);
        limits.limit[pass] = limit < LESSONS_MAX ? limit : LESSONS_MAX; /* whatever the units claim */
    }
    return limits;
}

result_t batch_check_sums(const batch_t *batch)
{
    const sum_array_t *lessons = &batch->sums[SUM_LESSONS];
    lesson_limits_t limits = batch_lesson_limits(batch);
    for (size_t i = 0; i < lessons->count; i++)
        if (!lesson_possible(&limits, i, lessons->values[i])) return impossible(SUM_LESSONS);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
        const int64_t *values = batch->sums[k].values;
        for (size_t i = 0; i < batch->unit_count && batch->sums[k].count > 0; i++) {
            size_t count = sum_unit_values(&batch->settings, k, &batch->units[i]);
            if (count > 0 && !sum_possible(k, &batch->units[i], values, count)) return impossible(k);
            values += count;
        }
    }
    return result_ok();
}
