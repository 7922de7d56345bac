/* batch_digest: a hash of what a batch holds, to compare two renderings of the same units (see batch.h). */
#include "common/film/batch.h"

#include <sodium.h>
#include <stdlib.h>

/* A unit and where its sums begin in the arrays of the batch. */
typedef struct {
    unit_t unit;
    size_t first[BATCH_SUMS];
} place_t;

/* The units by tile and sample: threads finish them in any order. */
static place_t *sorted_units(const batch_t *batch)
{
    place_t *places = mem_alloc((batch->unit_count + 1) * sizeof *places);
    place_t next = {0};
    for (size_t i = 0; i < batch->unit_count; i++) {
        next.unit = batch->units[i];
        places[i] = next;
        for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
            next.first[k] += sum_unit_values(&batch->settings, k, &next.unit);
    }
    qsort(places, batch->unit_count, sizeof *places, unit_order);
    return places;
}

static bool all_zero(const int64_t *values, size_t count)
{
    int64_t any = 0;
    for (size_t i = 0; i < count; i++) any |= values[i];
    return any == 0;
}

/* `count` values from one on, or nothing when they are not there or all zero. A flag says which. */
static void hash_values(crypto_generichash_state *state, const sum_array_t *sums, size_t first, size_t count)
{
    uint8_t present = sums->count > 0 && !all_zero(sums->values + first, count);
    crypto_generichash_update(state, &present, sizeof present);
    if (present)
        crypto_generichash_update(state, (const uint8_t *)(sums->values + first), count * sizeof(int64_t));
}

/* Sums that only some jobs have leave no trace in the others' digests, but for features, which always did. */
static bool is_hashed(const batch_t *batch, sum_kind_t kind, bool frame)
{
    bool in_job = kind == SUM_FEATURES || sum_planes(&batch->settings, kind) > 0;
    return film_sums[kind].frame == frame && in_job;
}

void batch_digest(const batch_t *batch, hash_t *hash)
{
    crypto_generichash_state state;
    place_t *places = sorted_units(batch);
    crypto_generichash_init(&state, NULL, 0, HASH_BYTES);
    crypto_generichash_update(&state, (const uint8_t *)batch->counts.light_paths,
                              sizeof batch->counts.light_paths);
    for (size_t i = 0; i < batch->unit_count; i++) {
        const unit_t *unit = &places[i].unit;
        const uint32_t name[] = {unit->tile, unit->first, unit->count};
        crypto_generichash_update(&state, (const uint8_t *)name, sizeof name);
        for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
            if (is_hashed(batch, k, false))
                hash_values(&state, &batch->sums[k], places[i].first[k],
                            sum_unit_values(&batch->settings, k, unit));
    }
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (is_hashed(batch, k, true))
            hash_values(&state, &batch->sums[k], 0, sum_image_values(&batch->settings, k));
    crypto_generichash_final(&state, hash->bytes, HASH_BYTES);
    free(places);
}
