/* film_sums: see film_sums.h. */
#include "common/film/film_sums.h"

#include "common/film/learning.h"

#include <stdlib.h>
#include <string.h>

static size_t feature_planes(const job_settings_t *settings)
{
    return job_has_features(settings) ? 1 : 0;
}

static size_t matte_planes(const job_settings_t *settings)
{
    return job_has_mattes(settings) ? 1 : 0;
}

static size_t group_planes(const job_settings_t *settings)
{
    return light_groups_count(settings->light_groups);
}

static size_t group_splat_planes(const job_settings_t *settings)
{
    return job_has_splats(settings) ? group_planes(settings) : 0;
}

static size_t lesson_planes(const job_settings_t *settings)
{
    return job_learns(settings) ? learning_taught(settings) : 0;
}

const sum_layout_t film_sums[FILM_SUMS] = {
    [SUM_EYE] = {.name = "eye",
                 .bytes = sizeof(int64_t),
                 .values = 3,
                 .group_count = 1,
                 .groups = {3},
                 .weighted = true},
    [SUM_SPLAT] = {.name = "splat",
                   .bytes = sizeof(int64_t),
                   .values = 3,
                   .group_count = 1,
                   .groups = {3},
                   .frame = true},
    [SUM_FEATURES] = {.name = "feature",
                      .bytes = sizeof(int64_t),
                      .values = FEATURE_VALUES,
                      .group_count = 6,
                      .groups = {3, 3, 3, 1, 2, 2}, /* albedo, normal, position, depth, counts, ids */
                      .differences = true,
                      .planes = feature_planes,
                      .samples = FEATURE_SAMPLES,
                      .sample_bits = 57},
    [SUM_MATTES] = {.name = "matte",
                    .bytes = sizeof(int64_t),
                    .values = MATTE_VALUES,
                    .group_count = 6,
                    .groups = {3, 3, 3, 3, 3, 1},
                    .differences = true,
                    .planes = matte_planes,
                    .samples = MATTE_SAMPLES,
                    .sample_bits = 57},
    [SUM_GROUP_EYE] = {.name = "light group eye",
                       .bytes = sizeof(int64_t),
                       .values = 3,
                       .group_count = 1,
                       .groups = {3},
                       .weighted = true,
                       .planes = group_planes},
    [SUM_GROUP_SPLAT] = {.name = "light group splat",
                         .bytes = sizeof(int64_t),
                         .values = 3,
                         .group_count = 1,
                         .groups = {3},
                         .frame = true,
                         .planes = group_splat_planes},
    [SUM_LESSONS] = {.name = "lesson",
                     .bytes = sizeof(int64_t),
                     .values = 1,
                     .group_count = 1,
                     .groups = {1},
                     .places = LEARNING_PLACES,
                     .frame = true,
                     .planes = lesson_planes},
    [SUM_SAMPLES] = {.name = "sample", .bytes = sizeof(uint32_t), .values = 1}};

const sum_kind_t film_page_order[FILM_SUMS] = {SUM_EYE,    SUM_SPLAT,     SUM_SAMPLES,     SUM_FEATURES,
                                               SUM_MATTES, SUM_GROUP_EYE, SUM_GROUP_SPLAT, SUM_LESSONS};

/* ---- how many values there are ------------------------------------------------------------------------- */

size_t sum_planes(const job_settings_t *settings, sum_kind_t kind)
{
    return film_sums[kind].planes == NULL ? 2 : film_sums[kind].planes(settings);
}

size_t sum_image_values(const job_settings_t *settings, sum_kind_t kind)
{
    const sum_layout_t *layout = &film_sums[kind];
    size_t pixels = (size_t)settings->width * (size_t)settings->height;
    return sum_planes(settings, kind) * layout->values * (layout->places > 0 ? layout->places : pixels);
}

size_t sum_unit_values(const job_settings_t *settings, sum_kind_t kind, const unit_t *unit)
{
    const sum_layout_t *layout = &film_sums[kind];
    bool contributes = layout->samples == 0 || unit->first < layout->samples;
    if (layout->frame || !contributes) return 0;
    return sum_planes(settings, kind) * layout->values * job_tile_pixels(settings, unit->tile);
}

size_t sum_unit_bytes(const job_settings_t *settings, const unit_t *unit)
{
    size_t values = 0;
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) values += sum_unit_values(settings, k, unit);
    return values * sizeof(int64_t);
}

size_t sum_frame_bytes(const job_settings_t *settings)
{
    size_t values = 0;
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (film_sums[k].frame) values += sum_image_values(settings, k);
    return values * sizeof(int64_t);
}

bool sum_possible(sum_kind_t kind, const unit_t *unit, const int64_t *values, size_t count)
{
    const sum_layout_t *layout = &film_sums[kind];
    if (layout->sample_bits == 0) return true;
    uint32_t left = layout->samples - unit->first, samples = unit->count < left ? unit->count : left;
    int64_t limit = (int64_t)samples << layout->sample_bits;
    bool good = true;
    for (size_t i = 0; i < count; i++) good &= values[i] < limit && values[i] > -limit;
    return good;
}

/* ---- arrays -------------------------------------------------------------------------------------------- */

static void *memory_of(int64_t *values)
{
    return values != NULL ? (char *)values - SUM_HEADROOM : NULL;
}

static int64_t *values_in(void *memory)
{
    return (int64_t *)((char *)memory + SUM_HEADROOM);
}

void sum_array_reserve(sum_array_t *array, size_t capacity)
{
    if (array->capacity >= capacity) return;
    array->values =
        values_in(mem_realloc(memory_of(array->values), SUM_HEADROOM + capacity * sizeof *array->values));
    array->capacity = capacity;
}

void sum_array_zeroes(sum_array_t *array, size_t count)
{
    sum_array_free(array);
    *array =
        (sum_array_t){values_in(mem_zalloc(SUM_HEADROOM + count * sizeof *array->values, 1)), count, count};
}

bool sum_array_try(sum_array_t *array, size_t capacity)
{
    sum_array_free(array);
    void *memory = malloc(SUM_HEADROOM + capacity * sizeof *array->values);
    if (memory != NULL) *array = (sum_array_t){values_in(memory), 0, capacity};
    return memory != NULL;
}

void sum_array_free(sum_array_t *array)
{
    sum_values_free(array->values);
    *array = (sum_array_t){0};
}

void sum_values_free(int64_t *values)
{
    free(memory_of(values));
}

/* ---- adding -------------------------------------------------------------------------------------------- */

/* Wrapping arithmetic, and no branch, so that the compiler makes vectors of it. What film_quantise saturates
 * to, and anything beyond, is no sum; a total of two values, one of which is a sum, that wraps ends up beyond
 * -largest. */
uint64_t film_add_sums(int64_t *restrict sum, const int64_t *restrict more, size_t count)
{
    const int64_t largest = (INT64_C(1) << 62) - 1;
    uint64_t overflows = 0;
    for (size_t i = 0; i < count; i++) {
        int64_t total = (int64_t)((uint64_t)sum[i] + (uint64_t)more[i]);
        bool bad = (more[i] > largest) | (more[i] < -largest) | (total > largest) | (total < -largest);
        sum[i] = bad ? sum[i] : total;
        overflows += bad;
    }
    return overflows;
}
