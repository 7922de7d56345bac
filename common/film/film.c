/* film: exact fixed-point sums (see film.h). */
#include "common/film/film.h"

#include "common/vec.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

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

int64_t film_quantise(float value, int scale)
{
    const double limit = 0x1p62;
    double units = (double)value * (double)(UINT64_C(1) << scale);
    return units >= limit ? INT64_C(1) << 62 : units <= -limit ? -(INT64_C(1) << 62) : llrint(units);
}

/* What film_quantise saturates to, and anything beyond, is no sum. */
static const int64_t largest_sum = (INT64_C(1) << 62) - 1;

/* Wrapping arithmetic, and no branch, so that the compiler makes vectors of it: this loop is the master's
 * work. A product that wraps is of a value beyond `largest`; a total of two values, one within largest_sum,
 * that wraps ends up beyond -largest_sum. */
static inline uint64_t add_multiples(int64_t *restrict sum, const int64_t *restrict more, size_t count,
                                     int64_t factor)
{
    const int64_t largest = largest_sum / (factor < 0 ? -factor : factor);
    uint64_t overflows = 0;
    for (size_t i = 0; i < count; i++) {
        int64_t total = (int64_t)((uint64_t)sum[i] + (uint64_t)more[i] * (uint64_t)factor);
        bool bad =
            (more[i] > largest) | (more[i] < -largest) | (total > largest_sum) | (total < -largest_sum);
        sum[i] = bad ? sum[i] : total;
        overflows += bad;
    }
    return overflows;
}

uint64_t film_add_sums(int64_t *sum, const int64_t *more, size_t count, int factor)
{
    return factor == 1 ? add_multiples(sum, more, count, 1) : add_multiples(sum, more, count, factor);
}

uint64_t film_add(int64_t sum[3], const float rgb[3], int scale)
{
    int64_t more[3];
    for (int c = 0; c < 3; c++) more[c] = film_quantise(rgb[c], scale);
    return film_add_sums(sum, more, 3, 1);
}

size_t batch_tile_values(const job_settings_t *settings, uint32_t tile)
{
    return (size_t)2 * 3 * job_tile_pixels(settings, tile);
}

enum { FEATURE_LIMIT_BITS = 57 };

/* True when some samples of the unit contribute to features. */
static bool unit_has_features(const job_settings_t *settings, const unit_t *unit)
{
    return job_has_features(settings) && unit->first < FEATURE_SAMPLES;
}

size_t batch_feature_values(const job_settings_t *settings, const unit_t *unit)
{
    if (!unit_has_features(settings, unit)) return 0;
    return (size_t)FEATURE_VALUES * job_tile_pixels(settings, unit->tile);
}

result_t batch_check_size(const batch_t *batch, uint64_t limit)
{
    uint64_t bytes = 0;
    for (size_t i = 0; i < batch->unit_count; i++)
        bytes += sizeof(int64_t) * (batch_tile_values(&batch->settings, batch->units[i].tile) +
                                    batch_feature_values(&batch->settings, &batch->units[i]));
    if (bytes <= limit) return result_ok();
    return result_fail(RESULT_LIMIT, "a batch with tiles of %.0f MB is over the limit of %.0f MB",
                       1e-6 * (double)bytes, 1e-6 * (double)limit);
}

bool unit_features_possible(const unit_t *unit, const int64_t *values, size_t count)
{
    uint32_t left = FEATURE_SAMPLES - unit->first, samples = unit->count < left ? unit->count : left;
    int64_t limit = (int64_t)samples << FEATURE_LIMIT_BITS;
    bool good = true;
    for (size_t i = 0; i < count; i++) good &= values[i] < limit && values[i] > -limit;
    return good;
}

size_t batch_splat_values(const job_settings_t *settings)
{
    return (size_t)2 * 3 * (size_t)settings->width * (size_t)settings->height;
}

size_t batch_bytes(const batch_t *batch)
{
    size_t splats = batch->splat != NULL ? batch_splat_values(&batch->settings) : 0;
    return sizeof(int64_t) * (batch->eye_count + batch->feature_count + splats);
}

/* Grows an array of sums to at least `count`. What is in it stays. */
static void reserve_sums(int64_t **sums, size_t *capacity, size_t count)
{
    if (*capacity >= count) return;
    *sums = mem_realloc(*sums, count * sizeof **sums);
    *capacity = count;
}

void unit_result_reset(unit_result_t *result, const job_settings_t *settings, const unit_t *unit)
{
    size_t values = batch_tile_values(settings, unit->tile);
    size_t features = batch_feature_values(settings, unit);
    reserve_sums(&result->eye, &result->eye_capacity, values);
    reserve_sums(&result->features, &result->feature_capacity, features);
    memset(result->eye, 0, values * sizeof *result->eye);
    if (features > 0) memset(result->features, 0, features * sizeof *result->features);
    result->has_features = features > 0;
    result->unit = *unit;
    result->splat_count = 0;
    result->counts = (film_counts_t){0};
}

void unit_result_free(unit_result_t *result)
{
    free(result->eye);
    free(result->features);
    free(result->splats);
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

void unit_result_feature(unit_result_t *result, size_t pixel, uint32_t sample, const first_hit_t *hit)
{
    const float limit = 0x1.fffffep24f; /* FEATURE_SAMPLES of it are below 2^62 units */
    if (!result->has_features || sample >= FEATURE_SAMPLES) return;
    int64_t *sum = result->features + FEATURE_VALUES * pixel;
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
        sum[v] += film_quantise(float_clamp(values[v], -limit, limit), FEATURE_SCALE);
    if (sample > 0) return;
    sum[FEATURE_OBJECT] = hit->object;
    sum[FEATURE_MATERIAL] = hit->material;
}

void batch_init(batch_t *batch, const job_settings_t *settings)
{
    *batch = (batch_t){.settings = *settings};
}

void batch_clear(batch_t *batch)
{
    batch->unit_count = 0;
    batch->eye_count = 0;
    batch->feature_count = 0;
    if (batch->splat != NULL)
        memset(batch->splat, 0, batch_splat_values(&batch->settings) * sizeof *batch->splat);
    batch->counts = (film_counts_t){0};
}

void batch_free(batch_t *batch)
{
    free(batch->units);
    free(batch->eye);
    free(batch->features);
    free(batch->splat);
    *batch = (batch_t){0};
}

static void batch_add_splats(batch_t *batch, const unit_result_t *result)
{
    if (result->splat_count == 0) return;
    if (batch->splat == NULL)
        batch->splat = mem_zalloc(batch_splat_values(&batch->settings), sizeof *batch->splat);
    size_t half_values = batch_splat_values(&batch->settings) / 2;
    for (size_t i = 0; i < result->splat_count; i++) {
        const splat_t *splat = &result->splats[i];
        size_t half = splat->pixel & SPLAT_HALF_BIT ? half_values : 0;
        int64_t *sum = batch->splat + half + (size_t)3 * (splat->pixel & ~SPLAT_HALF_BIT);
        batch->counts.overflows += film_add(sum, splat->rgb, batch->settings.film_scale);
    }
}

/* Appends sums to a growing array. */
static void append_sums(int64_t **sums, size_t *count, size_t *capacity, const int64_t *more, size_t values)
{
    if (values == 0) return;
    if (*count + values > *capacity) reserve_sums(sums, capacity, 2 * *capacity + values);
    memcpy(*sums + *count, more, values * sizeof **sums);
    *count += values;
}

void batch_add(batch_t *batch, const unit_result_t *result)
{
    if (batch->unit_count == batch->unit_capacity) {
        batch->unit_capacity = 2 * batch->unit_capacity + 16;
        batch->units = mem_realloc(batch->units, batch->unit_capacity * sizeof *batch->units);
    }
    batch->units[batch->unit_count++] = result->unit;
    append_sums(&batch->eye, &batch->eye_count, &batch->eye_capacity, result->eye,
                batch_tile_values(&batch->settings, result->unit.tile));
    append_sums(&batch->features, &batch->feature_count, &batch->feature_capacity, result->features,
                batch_feature_values(&batch->settings, &result->unit));
    batch_add_splats(batch, result);
    film_counts_add(&batch->counts, &result->counts);
}

/* What is merely for people may not get so large that the sum is refused for it. */
static void limit_counts(film_counts_t *counts)
{
    uint64_t *const others[] = {&counts->dropped, &counts->overflows, &counts->rays, &counts->cpu_us};
    for (size_t i = 0; i < ARRAY_LENGTH(others); i++)
        if (*others[i] > BATCH_MAX_COUNT) *others[i] = BATCH_MAX_COUNT;
}

void batch_merge(batch_t *sum, const batch_t *more)
{
    size_t count = sum->unit_count + more->unit_count;
    if (count > sum->unit_capacity) {
        sum->unit_capacity = 2 * count;
        sum->units = mem_realloc(sum->units, sum->unit_capacity * sizeof *sum->units);
    }
    memcpy(sum->units + sum->unit_count, more->units, more->unit_count * sizeof *sum->units);
    sum->unit_count = count;
    append_sums(&sum->eye, &sum->eye_count, &sum->eye_capacity, more->eye, more->eye_count);
    append_sums(&sum->features, &sum->feature_count, &sum->feature_capacity, more->features,
                more->feature_count);
    film_counts_add(&sum->counts, &more->counts);
    if (more->splat != NULL) {
        size_t values = batch_splat_values(&sum->settings);
        if (sum->splat == NULL) sum->splat = mem_zalloc(values, sizeof *sum->splat);
        sum->counts.overflows += film_add_sums(sum->splat, more->splat, values, 1);
    }
    limit_counts(&sum->counts);
}

result_t batch_check_counts(const batch_t *batch)
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
        if (others[i] > BATCH_MAX_COUNT)
            return result_fail(RESULT_PROTOCOL, "a count of %llu is out of all bounds",
                               (unsigned long long)others[i]);
    return result_ok();
}

result_t film_new(const job_settings_t *settings, film_t **film)
{
    size_t values = batch_splat_values(settings);
    film_t *made = mem_zalloc(1, sizeof *made);
    made->settings = *settings;
    made->eye = calloc(values, sizeof *made->eye);
    made->splat = calloc(values, sizeof *made->splat);
    made->samples = calloc(values / 3, sizeof *made->samples);
    bool features = job_has_features(settings);
    if (features) made->features = calloc(values / 6 * FEATURE_VALUES, sizeof *made->features);
    *film = made;
    if (made->eye != NULL && made->splat != NULL && made->samples != NULL &&
        (made->features != NULL || !features))
        return result_ok();
    film_destroy(film);
    return result_fail(RESULT_LIMIT, "no memory for a film of %d x %d pixels", settings->width,
                       settings->height);
}

void film_destroy(film_t **film)
{
    if (*film == NULL) return;
    free((*film)->eye);
    free((*film)->splat);
    free((*film)->samples);
    free((*film)->features);
    free(*film);
    *film = NULL;
}

/* Adds the eye tile of one unit (see unit_result_t for the layout of `tile`), `factor` times. */
static void merge_tile(film_t *film, const unit_t *unit, const int64_t *tile, int factor)
{
    rect_t rect = job_tile_rect(&film->settings, unit->tile);
    size_t width = (size_t)film->settings.width, row = (size_t)(rect.x1 - rect.x0);
    for (int half = 0; half < 2; half++) {
        uint32_t samples = unit_half_count(unit, half) * (uint32_t)factor;
        for (int y = rect.y0; y < rect.y1; y++) {
            size_t pixel =
                ((size_t)half * (size_t)film->settings.height + (size_t)y) * width + (size_t)rect.x0;
            film->counts.overflows += film_add_sums(film->eye + 3 * pixel, tile, 3 * row, factor);
            for (size_t x = 0; x < row; x++) film->samples[pixel + x] += samples;
            tile += 3 * row;
        }
    }
}

/* Adds the features of one unit. What overflows does not come from a renderer, and the picture is none the
 * worse for it: it is left out. */
static void merge_features(film_t *film, const unit_t *unit, const int64_t *features, int sign)
{
    rect_t rect = job_tile_rect(&film->settings, unit->tile);
    size_t row = FEATURE_VALUES * (size_t)(rect.x1 - rect.x0);
    for (int y = rect.y0; y < rect.y1; y++) {
        size_t pixel = (size_t)y * (size_t)film->settings.width + (size_t)rect.x0;
        film_add_sums(film->features + FEATURE_VALUES * pixel, features, row, sign);
        features += row;
    }
}

void film_merge_weighted(film_t *film, const batch_t *batch, const uint32_t *weights, int sign)
{
    const int64_t *tile = batch->eye, *features = batch->features;
    for (size_t i = 0; i < batch->unit_count; i++) {
        merge_tile(film, &batch->units[i], tile, sign * (weights == NULL ? 1 : (int)weights[i]));
        tile += batch_tile_values(&film->settings, batch->units[i].tile);
        size_t values =
            batch->feature_count > 0 ? batch_feature_values(&film->settings, &batch->units[i]) : 0;
        if (values == 0) continue;
        merge_features(film, &batch->units[i], features, sign);
        features += values;
    }
    if (batch->splat != NULL)
        film->counts.overflows +=
            film_add_sums(film->splat, batch->splat, batch_splat_values(&film->settings), sign);
    if (sign > 0)
        film_counts_add(&film->counts, &batch->counts);
    else
        film_counts_take_out(&film->counts, &batch->counts);
}

void film_merge(film_t *film, const batch_t *batch)
{
    film_merge_weighted(film, batch, NULL, 1);
}
