/* distribution: see distribution.h.
 *
 * Cumulative sums are made in double precision and kept as floats: as fine as the 24 bits of the numbers that
 * they are compared with. The density is kept apart, since differences of the sums would be too coarse for
 * dark cells beside a bright one.
 */
#include "worker/render/distribution.h"

#include "common/base.h"

#include <math.h>
#include <stdlib.h>

struct distribution {
    uint32_t width, height;
    double total;
    float *density; /* of each cell, per area of the square */
    float *columns; /* of each cell: probability, within its row, of it and those before it */
    float *rows;    /* of each row: probability of it and those before it */
};

static double usable(float weight)
{
    return weight > 0 && isfinite(weight) ? (double)weight : 0;
}

/* Cumulative sums of `count` weights, divided by their sum: exactly 1 from the last positive one on. All 0
 * when the sum is. */
static void accumulate(float *cumulative, const double *weights, uint32_t count, double total)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; i++) {
        sum += weights[i];
        cumulative[i] = total > 0 ? (float)(sum / total) : 0;
    }
}

static double sum_of(const double *weights, uint32_t count)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; i++) sum += weights[i];
    return sum;
}

distribution_t *distribution_new(const float *weights, uint32_t width, uint32_t height)
{
    size_t cells = (size_t)width * height;
    distribution_t *d = mem_zalloc(1, sizeof *d);
    *d = (distribution_t){.width = width,
                          .height = height,
                          .density = mem_alloc(cells * sizeof(float)),
                          .columns = mem_alloc(cells * sizeof(float)),
                          .rows = mem_alloc(height * sizeof(float))};
    double *row = mem_alloc(width * sizeof *row), *row_sums = mem_alloc(height * sizeof *row_sums);
    for (uint32_t y = 0; y < height; y++) {
        size_t start = (size_t)y * width;
        for (uint32_t x = 0; x < width; x++) row[x] = usable(weights[start + x]);
        row_sums[y] = sum_of(row, width);
        accumulate(d->columns + start, row, width, row_sums[y]);
    }
    d->total = sum_of(row_sums, height);
    accumulate(d->rows, row_sums, height, d->total);
    double scale = d->total > 0 ? (double)cells / d->total : 0;
    for (size_t i = 0; i < cells; i++) d->density[i] = (float)(usable(weights[i]) * scale);
    free(row);
    free(row_sums);
    return d;
}

void distribution_destroy(distribution_t **distribution)
{
    distribution_t *d = *distribution;
    if (d == NULL) return;
    free(d->density);
    free(d->columns);
    free(d->rows);
    free(d);
    *distribution = NULL;
}

double distribution_total(const distribution_t *distribution)
{
    return distribution->total;
}

/* The cell along one axis, `count` of them, that a coordinate lies in. */
static uint32_t cell_of(float at, uint32_t count)
{
    float cell = float_min(float_max(at, 0) * (float)count, (float)(count - 1));
    return (uint32_t)cell;
}

/* Draws a cell: the first whose cumulative probability is above u. Its own probability is thus not 0. Returns
 * a coordinate inside it, in the sense of cell_of, whatever the rounding. */
static float invert(const float *cumulative, uint32_t count, float u, uint32_t *cell)
{
    u = float_clamp(u, 0, 0x1.fffffep-1f);
    uint32_t low = 0, high = count - 1; /* the last is at 1 */
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (cumulative[middle] > u)
            high = middle;
        else
            low = middle + 1;
    }
    *cell = low;
    float before = low > 0 ? cumulative[low - 1] : 0;
    float at = ((float)low + (u - before) / (cumulative[low] - before)) / (float)count;
    at = float_min(at, 0x1.fffffep-1f);
    while (cell_of(at, count) > low) at = nextafterf(at, 0);
    while (cell_of(at, count) < low) at = nextafterf(at, 1);
    return at;
}

vec2_t distribution_sample(const distribution_t *d, vec2_t u, float *pdf)
{
    *pdf = 0;
    if (!(d->total > 0)) return u;
    uint32_t x, y;
    vec2_t at = {.y = invert(d->rows, d->height, u.y, &y)};
    size_t start = (size_t)y * d->width;
    at.x = invert(d->columns + start, d->width, u.x, &x);
    *pdf = d->density[start + x];
    return at;
}

float distribution_pdf(const distribution_t *d, vec2_t at)
{
    return d->density[(size_t)cell_of(at.y, d->height) * d->width + cell_of(at.x, d->width)];
}
