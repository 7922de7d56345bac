/* distribution: see distribution.h.
 *
 * Cumulative sums are made in double precision and kept as floats: as fine as the 24 bits of the numbers that
 * they are compared with. The density is kept apart, since differences of the sums would be too coarse for
 * dark cells beside a bright one. A guide (Chen and Asau 1974) says where in a row to start the search, which
 * in a large image would otherwise miss the cache at most of its steps.
 */
#include "worker/render/sampling/distribution.h"

#include "common/base.h"

#include <math.h>
#include <stdlib.h>

typedef struct {
    float cumulative; /* probability of this cell and those before it */
    float density;    /* per area of the square; of rows unused */
} cell_t;

/* A run of cells, and for each of `buckets` equal parts of [0, 1) the cell that its first number draws. */
typedef struct {
    uint32_t count, buckets; /* buckets: a power of two, so that finding one is exact */
    const cell_t *cells;
    const uint16_t *guide;
} axis_t;

struct distribution {
    uint32_t width, height;
    uint32_t column_buckets, row_buckets;
    double total;
    cell_t *columns; /* all cells, cumulative within their rows */
    uint16_t *column_guides;
    cell_t *rows;
    uint16_t *row_guide;
};

static double usable(float weight)
{
    return weight > 0 && isfinite(weight) ? (double)weight : 0;
}

/* Cumulative sums of `count` weights, divided by their sum: exactly 1 from the last positive one on. All 0
 * when the sum is. Then the guide to them. */
static void accumulate(cell_t *cells, uint16_t *guide, uint32_t buckets, const double *weights,
                       uint32_t count, double total)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; i++) {
        sum += weights[i];
        cells[i].cumulative = total > 0 ? (float)(sum / total) : 0;
    }
    uint32_t cell = 0;
    for (uint32_t bucket = 0; bucket < buckets; bucket++) {
        while (cell < count - 1 && cells[cell].cumulative <= (float)bucket / (float)buckets) cell++;
        guide[bucket] = (uint16_t)cell;
    }
}

static double sum_of(const double *weights, uint32_t count)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; i++) sum += weights[i];
    return sum;
}

/* The largest power of two that is not above n > 0. */
static uint32_t power_below(uint32_t n)
{
    return 1u << (31 - __builtin_clz(n));
}

static distribution_t *allocate(uint32_t width, uint32_t height)
{
    distribution_t *d = mem_zalloc(1, sizeof *d);
    *d = (distribution_t){.width = width,
                          .height = height,
                          .column_buckets = power_below(width),
                          .row_buckets = power_below(height)};
    d->columns = mem_alloc((size_t)width * height * sizeof *d->columns);
    d->column_guides = mem_alloc((size_t)d->column_buckets * height * sizeof *d->column_guides);
    d->rows = mem_zalloc(height, sizeof *d->rows);
    d->row_guide = mem_alloc(d->row_buckets * sizeof *d->row_guide);
    return d;
}

distribution_t *distribution_new(const float *weights, uint32_t width, uint32_t height)
{
    distribution_t *d = allocate(width, height);
    size_t cells = (size_t)width * height;
    double *row = mem_alloc(width * sizeof *row), *row_sums = mem_alloc(height * sizeof *row_sums);
    for (uint32_t y = 0; y < height; y++) {
        size_t start = (size_t)y * width;
        for (uint32_t x = 0; x < width; x++) row[x] = usable(weights[start + x]);
        row_sums[y] = sum_of(row, width);
        accumulate(d->columns + start, d->column_guides + (size_t)y * d->column_buckets, d->column_buckets,
                   row, width, row_sums[y]);
    }
    d->total = sum_of(row_sums, height);
    accumulate(d->rows, d->row_guide, d->row_buckets, row_sums, height, d->total);
    double scale = d->total > 0 ? (double)cells / d->total : 0;
    for (size_t i = 0; i < cells; i++) d->columns[i].density = (float)(usable(weights[i]) * scale);
    free(row);
    free(row_sums);
    return d;
}

void distribution_destroy(distribution_t **distribution)
{
    distribution_t *d = *distribution;
    if (d == NULL) return;
    free(d->columns);
    free(d->column_guides);
    free(d->rows);
    free(d->row_guide);
    free(d);
    *distribution = NULL;
}

/* The cell along one axis, `count` of them, that a coordinate lies in. */
static uint32_t cell_of(float at, uint32_t count)
{
    float cell = float_min(float_max(at, 0) * (float)count, (float)(count - 1));
    return (uint32_t)cell;
}

/* Draws a cell: the first whose cumulative probability is above u. Its own probability is thus not 0. Returns
 * a coordinate inside it, in the sense of cell_of, whatever the rounding. */
static float invert(const axis_t *axis, float u, uint32_t *cell)
{
    u = float_min(float_max(u, 0), 0x1.fffffep-1f);
    uint32_t bucket = (uint32_t)(u * (float)axis->buckets);
    uint32_t low = axis->guide[bucket];
    uint32_t high = bucket + 1 < axis->buckets ? axis->guide[bucket + 1] : axis->count - 1;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (axis->cells[middle].cumulative > u)
            high = middle;
        else
            low = middle + 1;
    }
    *cell = low;
    float before = low > 0 ? axis->cells[low - 1].cumulative : 0;
    float part = (u - before) / (axis->cells[low].cumulative - before);
    float at = float_min(((float)low + part) / (float)axis->count, 0x1.fffffep-1f);
    while (cell_of(at, axis->count) > low) at = nextafterf(at, 0);
    while (cell_of(at, axis->count) < low) at = nextafterf(at, 1);
    return at;
}

vec2_t distribution_sample(const distribution_t *d, vec2_t u, float *pdf)
{
    *pdf = 0;
    if (!(d->total > 0)) return u;
    uint32_t x, y;
    axis_t rows = {d->height, d->row_buckets, d->rows, d->row_guide};
    float at_y = invert(&rows, u.y, &y);
    axis_t columns = {d->width, d->column_buckets, d->columns + (size_t)y * d->width,
                      d->column_guides + (size_t)y * d->column_buckets};
    float at_x = invert(&columns, u.x, &x);
    *pdf = columns.cells[x].density;
    return (vec2_t){at_x, at_y};
}

float distribution_pdf(const distribution_t *d, vec2_t at)
{
    return d->columns[(size_t)cell_of(at.y, d->height) * d->width + cell_of(at.x, d->width)].density;
}
