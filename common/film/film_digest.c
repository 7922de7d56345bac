/* film_digest: a hash of what a batch holds, to compare two renderings of the same units (see film.h). */
#include "common/film/film.h"

#include <sodium.h>
#include <stdlib.h>

/* A unit and where its sums begin in the arrays of the batch. */
typedef struct {
    unit_t unit;
    size_t eye, features;
} place_t;

static int place_order(const void *a, const void *b)
{
    const unit_t *u = &((const place_t *)a)->unit, *v = &((const place_t *)b)->unit;
    if (u->tile != v->tile) return u->tile < v->tile ? -1 : 1;
    return u->first < v->first ? -1 : u->first > v->first;
}

/* The units by tile and sample: threads finish them in any order. */
static place_t *sorted_units(const batch_t *batch)
{
    place_t *places = mem_alloc((batch->unit_count + 1) * sizeof *places);
    size_t eye = 0, features = 0;
    for (size_t i = 0; i < batch->unit_count; i++) {
        places[i] = (place_t){batch->units[i], eye, features};
        eye += batch_tile_values(&batch->settings, batch->units[i].tile);
        features += batch_feature_values(&batch->settings, &batch->units[i]);
    }
    qsort(places, batch->unit_count, sizeof *places, place_order);
    return places;
}

static bool all_zero(const int64_t *values, size_t count)
{
    int64_t any = 0;
    for (size_t i = 0; i < count; i++) any |= values[i];
    return any == 0;
}

/* Nothing, or the values when one of them is not zero. A flag says which. */
static void hash_values(crypto_generichash_state *state, const int64_t *values, size_t count)
{
    uint8_t present = values != NULL && !all_zero(values, count);
    crypto_generichash_update(state, &present, sizeof present);
    if (present) crypto_generichash_update(state, (const uint8_t *)values, count * sizeof *values);
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
        const int64_t *features = batch->feature_count > 0 ? batch->features + places[i].features : NULL;
        const uint32_t name[] = {unit->tile, unit->first, unit->count};
        crypto_generichash_update(&state, (const uint8_t *)name, sizeof name);
        hash_values(&state, batch->eye + places[i].eye, batch_tile_values(&batch->settings, unit->tile));
        hash_values(&state, features, batch_feature_values(&batch->settings, unit));
    }
    hash_values(&state, batch->splat, batch_splat_values(&batch->settings));
    crypto_generichash_final(&state, hash->bytes, HASH_BYTES);
    free(places);
}
