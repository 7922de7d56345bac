/* films: see films.h. */
#include "tests/films.h"

#include "master/film/shared_film.h"

#include <string.h>

result_t encode_either(const batch_t *batch, bool compress, zmq_msg_t payload[BATCH_PAYLOADS])
{
    if (compress) return payload_encode(batch, payload);
    batch_t copy;
    batch_init(&copy, &batch->settings);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
        const sum_array_t *sums = &batch->sums[k];
        if (sums->count == 0) continue;
        sum_array_zeroes(&copy.sums[k], sums->count);
        memcpy(copy.sums[k].values, sums->values, sums->count * sizeof *sums->values);
    }
    result_t result = payload_wrap(&copy, payload);
    batch_free(&copy);
    return result;
}

result_t merge_as_master(film_t *film, const batch_t *batch, const uint32_t *weights, int sign)
{
    zmq_msg_t payload[BATCH_PAYLOADS];
    TRY(payload_encode(batch, payload));
    film_t *lent = mem_alloc(sizeof *lent);
    *lent = *film; /* its sums alone: they are taken back below */
    shared_film_t *shared_film = shared_film_new(lent);
    shared_film_enter(shared_film);
    result_t result = shared_film_merge_payload(shared_film, payload, batch, weights, sign);
    shared_film_leave(shared_film);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    *film = *lent;
    *lent = (film_t){0};
    shared_film_destroy(&shared_film);
    return result;
}

static void add_value(film_t *film, int64_t *sum, int64_t more)
{
    const int64_t largest = (INT64_C(1) << 62) - 1;
    int64_t total;
    if (more > largest || more < -largest || __builtin_add_overflow(*sum, more, &total) || total > largest ||
        total < -largest)
        film->counts.overflows++;
    else
        *sum = total;
}

/* One tile; returns how many values it has. */
static size_t add_tile(film_t *film, const unit_t *unit, sum_kind_t kind, const int64_t *values)
{
    size_t width = (size_t)film->settings.width, height = (size_t)film->settings.height, next = 0;
    rect_t rect = job_tile_rect(&film->settings, unit->tile);
    for (size_t half = 0; half < sum_planes(&film->settings, kind); half++)
        for (int y = rect.y0; y < rect.y1; y++)
            for (int x = rect.x0; x < rect.x1; x++) {
                size_t pixel = (half * height + (size_t)y) * width + (size_t)x;
                for (size_t v = 0; v < film_sums[kind].values; v++)
                    add_value(film, &film->sums[kind][film_sums[kind].values * pixel + v], values[next++]);
                if (kind == SUM_EYE) film->samples[pixel] += unit_half_count(unit, (int)half);
            }
    return next;
}

void merge_plainly(film_t *film, const batch_t *batch)
{
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
        const int64_t *values = batch->sums[k].values;
        for (size_t i = 0; i < batch->unit_count && !film_sums[k].frame; i++)
            if (sum_unit_values(&film->settings, k, &batch->units[i]) > 0)
                values += add_tile(film, &batch->units[i], k, values);
        for (size_t i = 0; i < batch->sums[k].count && film_sums[k].frame; i++)
            add_value(film, &film->sums[k][i], values[i]);
    }
    film_counts_add(&film->counts, &batch->counts);
}

bool same_film(const film_t *a, const film_t *b)
{
    bool same = true;
    for (sum_kind_t k = 0; k < FILM_SUMS; k++) {
        size_t bytes = sum_image_values(&a->settings, k) * film_sums[k].bytes;
        same = same && bytes == sum_image_values(&b->settings, k) * film_sums[k].bytes &&
               (bytes == 0 || memcmp(film_values(a, k), film_values(b, k), bytes) == 0);
    }
    return same;
}

bool same_sums(const batch_t *a, const batch_t *b)
{
    bool same = true;
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
        const sum_array_t *left = &a->sums[k], *right = &b->sums[k];
        same = same && left->count == right->count &&
               (left->count == 0 || memcmp(left->values, right->values, left->count * sizeof(int64_t)) == 0);
    }
    return same;
}
