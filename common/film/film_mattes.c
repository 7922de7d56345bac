/* film_mattes: the mattes of a film: which objects and materials cover a pixel, and how much of it (film.h).
 */
#include "common/film/film.h"

#include <stdlib.h>
#include <string.h>

/* An id, and how many samples show it. */
typedef struct {
    uint32_t id, samples;
} share_t;

/* What the samples of a pixel met, of those that there are; returns their number. */
static size_t read_codes(const int64_t *sum, uint32_t codes[MATTE_SAMPLES])
{
    size_t count = 0;
    for (size_t s = 0; s < MATTE_SAMPLES; s++) {
        uint64_t slots = (uint64_t)sum[s / MATTE_SLOTS];
        uint32_t code = (uint32_t)(slots >> (MATTE_BITS * (s % MATTE_SLOTS))) & MATTE_MAX_CODE;
        if (code != MATTE_NO_SAMPLE) codes[count++] = code;
    }
    return count;
}

/* 0 for what met nothing, and for what a peer made up. */
static uint32_t id_of(const mattes_t *mattes, matte_kind_t kind, uint32_t code)
{
    size_t shape = (size_t)code - MATTE_FIRST_SHAPE;
    return code >= MATTE_FIRST_SHAPE && shape < mattes->shape_count ? mattes->ids[kind][shape] : 0;
}

static int by_rank(const void *a, const void *b)
{
    const share_t *x = a, *y = b;
    if (x->samples != y->samples) return x->samples > y->samples ? -1 : 1;
    return x->id < y->id ? -1 : x->id > y->id;
}

/* Counts the samples of each id, the most frequent first; returns the number of ids. */
static size_t rank_ids(const mattes_t *mattes, matte_kind_t kind, const uint32_t *codes, size_t count,
                       share_t shares[MATTE_SAMPLES])
{
    size_t found = 0, k = 0;
    for (size_t i = 0; i < count; i++) {
        if (i == 0 || codes[i] != codes[i - 1]) { /* most samples meet what the one before has met */
            uint32_t id = id_of(mattes, kind, codes[i]);
            for (k = 0; k < found && shares[k].id != id;) k++;
            if (k == found) shares[found++] = (share_t){id, 0};
        }
        shares[k].samples++;
    }
    if (found > 1) qsort(shares, found, sizeof *shares, by_rank);
    return found;
}

static void resolve_pixel(const film_t *film, const mattes_t *mattes, size_t pixel, film_image_t *image)
{
    uint32_t codes[MATTE_SAMPLES];
    share_t shares[MATTE_SAMPLES];
    size_t count = read_codes(film->sums[SUM_MATTES] + MATTE_VALUES * pixel, codes);
    for (matte_kind_t k = 0; k < MATTE_KINDS; k++) {
        size_t found = rank_ids(mattes, k, codes, count, shares);
        for (size_t r = 0; r < found && r < MATTE_RANKS; r++) {
            float *pair = image->mattes[k][r / 2] + 4 * pixel + 2 * (r % 2);
            memcpy(&pair[0], &shares[r].id, sizeof pair[0]);
            pair[1] = (float)shares[r].samples / (float)count;
        }
    }
}

void film_resolve_mattes(const film_t *film, const mattes_t *mattes, film_image_t *image)
{
    size_t pixels = (size_t)film->settings.width * (size_t)film->settings.height;
    if (film->sums[SUM_MATTES] == NULL) return;
    for (int k = 0; k < MATTE_KINDS; k++)
        for (int l = 0; l < MATTE_LEVELS; l++)
            image->mattes[k][l] = mem_zalloc(4 * pixels, sizeof *image->mattes[k][l]);
    for (size_t p = 0; p < pixels; p++) resolve_pixel(film, mattes, p, image);
}
