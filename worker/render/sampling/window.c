/* window: see window.h.
 *
 * The table has the sums of whole cells, one row and one column of zeroes in front. Between its entries it is
 * interpolated bilinearly, which is exact for weights that are constant in each cell.
 */
#include "worker/render/sampling/window.h"

#include "common/base.h"

#include <math.h>
#include <stdlib.h>

struct window_table {
    uint32_t width, height;
    float *weights; /* [height][width] */
    double *sums;   /* [height + 1][width + 1] */
};

window_table_t *window_table_new(const float *weights, uint32_t width, uint32_t height)
{
    window_table_t *table = mem_zalloc(1, sizeof *table);
    size_t stride = (size_t)width + 1;
    *table = (window_table_t){.width = width, .height = height};
    table->weights = mem_alloc((size_t)width * height * sizeof *table->weights);
    table->sums = mem_zalloc(stride * ((size_t)height + 1), sizeof *table->sums);
    for (uint32_t y = 0; y < height; y++) {
        double row = 0;
        for (uint32_t x = 0; x < width; x++) {
            size_t at = (size_t)y * width + x;
            bool usable = weights[at] > 0 && isfinite(weights[at]);
            table->weights[at] = usable ? weights[at] : 0;
            row += (double)table->weights[at];
            table->sums[(y + 1) * stride + x + 1] = table->sums[y * stride + x + 1] + row;
        }
    }
    return table;
}

void window_table_destroy(window_table_t **table)
{
    if (*table == NULL) return;
    free((*table)->weights);
    free((*table)->sums);
    free(*table);
    *table = NULL;
}

/* ---- sums ---------------------------------------------------------------------------------------------- */

/* Where a coordinate lies among `count` cells: in which one, and how far in it. */
typedef struct {
    uint32_t cell;
    double part; /* 0 to 1 */
} place_t;

static place_t place_of(float at, uint32_t count)
{
    double x = (double)float_clamp(at, 0, 1) * count;
    uint32_t cell = x < count ? (uint32_t)x : count - 1;
    return (place_t){cell, x - cell};
}

/* The sum of the first `column` whole columns, down to a place among the rows. */
static double sum_above(const window_table_t *table, uint32_t column, place_t row)
{
    const double *sums = table->sums + (size_t)row.cell * (table->width + 1) + column;
    return sums[0] + row.part * (sums[table->width + 1] - sums[0]);
}

/* The sum of the first `column` whole columns between two places among the rows. */
static double sum_between(const window_table_t *table, uint32_t column, const place_t rows[2])
{
    return sum_above(table, column, rows[1]) - sum_above(table, column, rows[0]);
}

static double sum_to(const window_table_t *table, place_t column, const place_t rows[2])
{
    double before = sum_between(table, column.cell, rows);
    return before + column.part * (sum_between(table, column.cell + 1, rows) - before);
}

double window_integral(const window_table_t *table, const window_t *window)
{
    const place_t rows[2] = {place_of(window->low.y, table->height), place_of(window->high.y, table->height)};
    double sum = sum_to(table, place_of(window->high.x, table->width), rows) -
                 sum_to(table, place_of(window->low.x, table->width), rows);
    return fmax(sum, 0) / ((double)table->width * table->height);
}

float window_weight(const window_table_t *table, vec2_t at)
{
    uint32_t x = place_of(at.x, table->width).cell, y = place_of(at.y, table->height).cell;
    return table->weights[(size_t)y * table->width + x];
}

/* ---- drawing ------------------------------------------------------------------------------------------- */

/* The sum of one column's cells above a whole row. */
static double column_sum(const window_table_t *table, uint32_t column, uint32_t row)
{
    const double *sums = table->sums + (size_t)row * (table->width + 1) + column;
    return sums[1] - sums[0];
}

/* A coordinate inside a cell, whatever the rounding: the share `part` of it, cut off at the window, which
 * reaches into the cell. */
static float coordinate(uint32_t cell, double part, uint32_t count, float low, float high)
{
    float at = float_clamp((float)((cell + fmin(fmax(part, 0), 1)) / count), low, high);
    while (at > low && place_of(at, count).cell > cell) at = nextafterf(at, 0);
    while (at < high && place_of(at, count).cell < cell) at = nextafterf(at, 1);
    return at;
}

/* The first column whose cells, with those before it, hold more than `sum`; and where in it. */
static float draw_column(const window_table_t *table, const window_t *window, const place_t rows[2], float u,
                         uint32_t *column)
{
    place_t first = place_of(window->low.x, table->width), last = place_of(window->high.x, table->width);
    double start = sum_to(table, first, rows);
    double sum = start + (double)u * (sum_to(table, last, rows) - start);
    uint32_t low = first.cell, high = last.cell;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (sum_between(table, middle + 1, rows) > sum)
            high = middle;
        else
            low = middle + 1;
    }
    *column = low;
    double before = sum_between(table, low, rows), all = sum_between(table, low + 1, rows) - before;
    return coordinate(low, all > 0 ? (sum - before) / all : 0.5, table->width, window->low.x, window->high.x);
}

static double column_sum_to(const window_table_t *table, uint32_t column, place_t row)
{
    double before = column_sum(table, column, row.cell);
    return before + row.part * (column_sum(table, column, row.cell + 1) - before);
}

static float draw_row(const window_table_t *table, const window_t *window, uint32_t column,
                      const place_t rows[2], float u)
{
    double start = column_sum_to(table, column, rows[0]);
    double sum = start + (double)u * (column_sum_to(table, column, rows[1]) - start);
    uint32_t low = rows[0].cell, high = rows[1].cell;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (column_sum(table, column, middle + 1) > sum)
            high = middle;
        else
            low = middle + 1;
    }
    double before = column_sum(table, column, low), all = column_sum(table, column, low + 1) - before;
    return coordinate(low, all > 0 ? (sum - before) / all : 0.5, table->height, window->low.y,
                      window->high.y);
}

vec2_t window_sample(const window_table_t *table, const window_t *window, vec2_t u)
{
    const place_t rows[2] = {place_of(window->low.y, table->height), place_of(window->high.y, table->height)};
    uint32_t column;
    float x = draw_column(table, window, rows, u.x, &column);
    return (vec2_t){x, draw_row(table, window, column, rows, u.y)};
}
