/* film: exact fixed-point sums (see film.h). */
#include "common/film.h"

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

int64_t film_quantise(float value, int scale)
{
    const double limit = 0x1p62;
    double units = (double)value * (double)(UINT64_C(1) << scale);
    return units >= limit ? INT64_C(1) << 62 : units <= -limit ? -(INT64_C(1) << 62) : llrint(units);
}

/* True for what film_quantise saturates to, and beyond. */
static bool too_large(int64_t value)
{
    return value >= INT64_C(1) << 62 || value <= -(INT64_C(1) << 62);
}

/* Adds in place; a saturated value, or a sum that would get as large, is left out. Returns how many were. */
static uint64_t add_sums(int64_t *sum, const int64_t *more, size_t count)
{
    uint64_t overflows = 0;
    for (size_t i = 0; i < count; i++) {
        int64_t total;
        bool wraps = __builtin_add_overflow(sum[i], more[i], &total);
        wraps |= too_large(total) || too_large(more[i]);
        sum[i] = wraps ? sum[i] : total;
        overflows += wraps;
    }
    return overflows;
}

uint64_t film_add(int64_t sum[3], const float rgb[3], int scale)
{
    int64_t more[3];
    for (int c = 0; c < 3; c++) more[c] = film_quantise(rgb[c], scale);
    return add_sums(sum, more, 3);
}

size_t batch_tile_values(const job_settings_t *settings, uint32_t tile)
{
    return (size_t)2 * 3 * job_tile_pixels(settings, tile);
}

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

/* Adds the eye tile of one unit (see unit_result_t for the layout of `tile`). */
static void merge_tile(film_t *film, const unit_t *unit, const int64_t *tile)
{
    rect_t rect = job_tile_rect(&film->settings, unit->tile);
    size_t width = (size_t)film->settings.width, row = (size_t)(rect.x1 - rect.x0);
    for (int half = 0; half < 2; half++) {
        uint32_t samples = unit_half_count(unit, half);
        for (int y = rect.y0; y < rect.y1; y++) {
            size_t pixel =
                ((size_t)half * (size_t)film->settings.height + (size_t)y) * width + (size_t)rect.x0;
            film->counts.overflows += add_sums(film->eye + 3 * pixel, tile, 3 * row);
            for (size_t x = 0; x < row; x++) film->samples[pixel + x] += samples;
            tile += 3 * row;
        }
    }
}

/* Adds the features of one unit. What overflows does not come from a renderer, and the picture is none the
 * worse for it: it is left out. */
static void merge_features(film_t *film, const unit_t *unit, const int64_t *features)
{
    rect_t rect = job_tile_rect(&film->settings, unit->tile);
    size_t row = FEATURE_VALUES * (size_t)(rect.x1 - rect.x0);
    for (int y = rect.y0; y < rect.y1; y++) {
        size_t pixel = (size_t)y * (size_t)film->settings.width + (size_t)rect.x0;
        add_sums(film->features + FEATURE_VALUES * pixel, features, row);
        features += row;
    }
}

void film_merge(film_t *film, const batch_t *batch)
{
    const int64_t *tile = batch->eye, *features = batch->features;
    for (size_t i = 0; i < batch->unit_count; i++) {
        merge_tile(film, &batch->units[i], tile);
        tile += batch_tile_values(&film->settings, batch->units[i].tile);
        size_t values =
            batch->feature_count > 0 ? batch_feature_values(&film->settings, &batch->units[i]) : 0;
        if (values > 0) merge_features(film, &batch->units[i], features);
        features += values;
    }
    if (batch->splat != NULL)
        film->counts.overflows += add_sums(film->splat, batch->splat, batch_splat_values(&film->settings));
    film_counts_add(&film->counts, &batch->counts);
}

/* The estimates of one pixel and channel. */
typedef struct {
    double eye, light, noise;
} estimate_t;

/* `eye` and `splat` are the sums of both halves, `samples` and `light_factor` (pixels / light paths)
 * likewise. */
static estimate_t resolve_value(const double eye[2], const double splat[2], const uint32_t samples[2],
                                const double light_factor[3])
{
    double count = (double)samples[0] + samples[1], half[2] = {0, 0};
    estimate_t estimate = {.eye = (eye[0] + eye[1]) / count,
                           .light = (splat[0] + splat[1]) * light_factor[2]};
    for (int h = 0; h < 2; h++)
        half[h] = (samples[h] > 0 ? eye[h] / samples[h] : 0) + splat[h] * light_factor[h];
    /* Var(sum) of two independent means whose weights are their shares of the samples. With one half empty
     * nothing is known of the noise: all of the value is taken to be noise. */
    estimate.noise = samples[0] > 0 && samples[1] > 0
                         ? sqrt((double)samples[0] * samples[1]) / count * fabs(half[0] - half[1])
                         : fabs(estimate.eye + estimate.light);
    return estimate;
}

static bool any_features(const film_t *film, size_t pixels)
{
    for (size_t p = 0; film->features != NULL && p < pixels; p++)
        if (film->features[FEATURE_VALUES * p + FEATURE_COUNT] > 0) return true;
    return false;
}

static void resolve_feature(const int64_t *sum, film_image_t *image, size_t p)
{
    /* A peer may have sent any number; only what is above zero divides. */
    double count = (double)sum[FEATURE_COUNT], hits = (double)sum[FEATURE_HITS];
    double per_sample = count > 0 ? ldexp(1.0, -FEATURE_SCALE) / count : 0;
    double per_hit = hits > 0 ? ldexp(1.0, -FEATURE_SCALE) / hits : 0;
    for (size_t c = 0; c < 3; c++) {
        image->albedo[3 * p + c] = (float)((double)sum[FEATURE_ALBEDO + c] * per_sample);
        image->normal[3 * p + c] = (float)((double)sum[FEATURE_NORMAL + c] * per_sample);
        image->position[3 * p + c] = (float)((double)sum[FEATURE_POSITION + c] * per_hit);
    }
    image->depth[p] = (float)((double)sum[FEATURE_DEPTH] * per_hit);
    image->object[p] = (float)sum[FEATURE_OBJECT];
    image->material[p] = (float)sum[FEATURE_MATERIAL];
    image->coverage[p] = count > 0 ? (float)(hits / count) : 0;
}

static void resolve_features(const film_t *film, film_image_t *image, size_t pixels)
{
    float **vectors[] = {&image->albedo, &image->normal, &image->position};
    float **scalars[] = {&image->depth, &image->object, &image->material, &image->coverage};
    for (size_t i = 0; i < ARRAY_LENGTH(vectors); i++) *vectors[i] = mem_zalloc(3 * pixels, sizeof(float));
    for (size_t i = 0; i < ARRAY_LENGTH(scalars); i++) *scalars[i] = mem_zalloc(pixels, sizeof(float));
    for (size_t p = 0; p < pixels; p++) resolve_feature(film->features + FEATURE_VALUES * p, image, p);
}

void film_resolve(const film_t *film, film_image_t *image)
{
    int width = film->settings.width, height = film->settings.height;
    size_t pixels = (size_t)width * (size_t)height;
    *image = (film_image_t){.width = width, .height = height};
    float **planes[] = {&image->sum, &image->eye, &image->light, &image->noise};
    for (size_t i = 0; i < ARRAY_LENGTH(planes); i++) *planes[i] = mem_zalloc(3 * pixels, sizeof(float));
    image->samples = mem_zalloc(pixels, sizeof(float));
    if (any_features(film, pixels)) resolve_features(film, image, pixels);

    double unit = ldexp(1.0, -film->settings.film_scale), light_factor[3] = {0};
    double paths[3] = {(double)film->counts.light_paths[0], (double)film->counts.light_paths[1], 0};
    paths[2] = paths[0] + paths[1];
    for (int i = 0; i < 3; i++) light_factor[i] = paths[i] > 0 ? (double)pixels / paths[i] : 0;

    for (size_t p = 0; p < pixels; p++) {
        uint32_t samples[2] = {film->samples[p], film->samples[pixels + p]};
        if (samples[0] == 0 && samples[1] == 0) continue;
        image->samples[p] = (float)samples[0] + (float)samples[1];
        for (size_t v = 3 * p; v < 3 * p + 3; v++) {
            double eye[2], splat[2];
            for (size_t h = 0; h < 2; h++) {
                eye[h] = (double)film->eye[h * 3 * pixels + v] * unit;
                splat[h] = (double)film->splat[h * 3 * pixels + v] * unit;
            }
            estimate_t e = resolve_value(eye, splat, samples, light_factor);
            image->eye[v] = (float)e.eye;
            image->light[v] = (float)e.light;
            image->sum[v] = (float)(e.eye + e.light);
            image->noise[v] = (float)e.noise;
        }
    }
}

void film_image_free(film_image_t *image)
{
    free(image->sum);
    free(image->eye);
    free(image->light);
    free(image->noise);
    free(image->samples);
    float *features[] = {image->albedo, image->normal,   image->position, image->depth,
                         image->object, image->material, image->coverage};
    for (size_t i = 0; i < ARRAY_LENGTH(features); i++) free(features[i]);
    *image = (film_image_t){0};
}
