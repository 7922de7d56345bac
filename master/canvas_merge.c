/* canvas_merge: how a batch gets into the pages of a canvas (see canvas.h). */
#include "master/canvas_pages.h"

#include <stdlib.h>
#include <string.h>

enum { ROW_VALUES = 3 * JOB_MAX_TILE };

static uint32_t weight_of(const uint32_t *weights, size_t unit)
{
    return weights == NULL ? 1 : weights[unit];
}

/* A row of a tile's eye sums, and its samples. */
static bool add_eye_row(adder_t *adder, size_t pixel, const int64_t *values, size_t pixels, uint32_t samples,
                        uint32_t weight)
{
    int64_t weighted[ROW_VALUES];
    bool large = weight != 1;
    for (size_t i = 0; weight != 1 && i < 3 * pixels; i++)
        if (__builtin_mul_overflow(values[i], (int64_t)weight, &weighted[i])) weighted[i] = INT64_MAX;
    return adder_add(adder, ARRAY_EYE, 3 * pixel, large ? weighted : values, 3 * pixels, true) &&
           adder_count(adder, pixel, weight * samples, pixels);
}

static bool add_tile(adder_t *adder, const job_settings_t *settings, const unit_t *unit, const int64_t *tile,
                     uint32_t weight)
{
    rect_t rect = job_tile_rect(settings, unit->tile);
    size_t width = (size_t)settings->width, row = (size_t)(rect.x1 - rect.x0);
    for (int half = 0; half < 2; half++)
        for (int y = rect.y0; y < rect.y1; y++) {
            size_t pixel = ((size_t)half * (size_t)settings->height + (size_t)y) * width + (size_t)rect.x0;
            if (!add_eye_row(adder, pixel, tile, row, unit_half_count(unit, half), weight)) return false;
            tile += 3 * row;
        }
    return true;
}

static bool add_features(adder_t *adder, const job_settings_t *settings, const unit_t *unit,
                         const int64_t *features)
{
    rect_t rect = job_tile_rect(settings, unit->tile);
    size_t row = FEATURE_VALUES * (size_t)(rect.x1 - rect.x0);
    for (int y = rect.y0; y < rect.y1; y++) {
        size_t pixel = (size_t)y * (size_t)settings->width + (size_t)rect.x0;
        if (!adder_add(adder, ARRAY_FEATURES, FEATURE_VALUES * pixel, features, row, true)) return false;
        features += row;
    }
    return true;
}

static bool add_batch(adder_t *adder, const batch_t *batch, const uint32_t *weights)
{
    const job_settings_t *settings = &adder->canvas->film->settings;
    const int64_t *tile = batch->eye, *features = batch->features;
    for (size_t i = 0; i < batch->unit_count; i++) {
        if (!add_tile(adder, settings, &batch->units[i], tile, weight_of(weights, i))) return false;
        tile += batch_tile_values(settings, batch->units[i].tile);
        size_t values = batch->feature_count > 0 ? batch_feature_values(settings, &batch->units[i]) : 0;
        if (values > 0 && !add_features(adder, settings, &batch->units[i], features)) return false;
        features += values;
    }
    return batch->splat == NULL ||
           adder_add(adder, ARRAY_SPLAT, 0, batch->splat, batch_splat_values(settings), true);
}

static void add_counts(canvas_t *canvas, const film_counts_t *counts, uint64_t overflows, int sign)
{
    film_counts_t *sum = &canvas->film->counts;
    uint64_t one = sign < 0 ? UINT64_MAX : 1;
    pthread_mutex_lock(&canvas->counting);
    for (int half = 0; half < 2; half++) sum->light_paths[half] += one * counts->light_paths[half];
    sum->dropped += one * counts->dropped;
    sum->overflows += one * counts->overflows + overflows;
    sum->rays += one * counts->rays;
    sum->cpu_us += one * counts->cpu_us;
    pthread_mutex_unlock(&canvas->counting);
}

void canvas_merge(canvas_t *canvas, const batch_t *batch, const uint32_t *weights, int sign)
{
    adder_t adder = adder_new(canvas, sign < 0 ? ADD_EXACT : ADD_TOLERANT, sign < 0, UINT64_MAX);
    add_batch(&adder, batch, weights);
    adder_rest(&adder);
    add_counts(canvas, &batch->counts, adder.overflows, sign);
}

result_t canvas_merge_payload(canvas_t *canvas, const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch,
                              const uint32_t *weights, int sign)
{
    batch_t decoded = *batch;
    decoded.eye = decoded.splat = decoded.features = NULL;
    decoded.eye_capacity = decoded.feature_capacity = decoded.eye_count = decoded.feature_count = 0;
    result_t result = payload_decode(payload, &decoded);
    if (result.code == RESULT_OK) canvas_merge(canvas, &decoded, weights, sign);
    free(decoded.eye);
    free(decoded.splat);
    free(decoded.features);
    return result;
}
