/* distribution: see distribution.h.
 *
 * Cumulative sums are made in double precision and kept as floats: as fine as the 24 bits of the numbers that
 * they are compared with. The density is kept apart, since differences of the sums would be too coarse for
 * dark cells beside a bright one. A guide (Chen and Asau 1974) says where in a row to start the search.
 *
 * The table of a large image does not fit into a processor's caches, and at each draw one would wait for
 * memory several times. So cells make blocks, few enough for the cache, and what lies in a block has a table
 * of its own only where it is uneven: about edges and small bright things, of which the bright ones are drawn
 * often and so stay in the cache.
 */
#include "worker/render/sampling/distribution.h"

#include "common/base.h"

#include <math.h>
#include <stdlib.h>

/* So the table of blocks takes some 100 KB (measured: with more it is slower). */
enum { MOST_BLOCKS = 1 << 13, MOST_SIDE = 16 };

typedef struct {
    float cumulative; /* probability of this cell and those before it */
    union {
        float density;  /* per area of the square; of rows unused */
        uint32_t table; /* of an uneven block in place of that: its number, with the sign's bit set */
    };
} cell_t;
#define UNEVEN 0x80000000u

/* A run of cells, and for each of `buckets` equal parts of [0, 1) the cell that its first number draws. */
typedef struct {
    uint32_t count, buckets; /* buckets: a power of two, so that finding one is exact */
    const cell_t *cells;
    const uint16_t *guide;
} axis_t;

struct distribution {
    uint32_t width, height; /* in cells */
    uint32_t side, shift;   /* of a block: a power of two, and which */
    uint32_t across, down;  /* blocks */
    uint32_t column_buckets, row_buckets;
    double total;
    cell_t *columns; /* all blocks, cumulative within their rows */
    uint16_t *column_guides;
    cell_t *rows; /* of blocks */
    uint16_t *row_guide;
    cell_t *tables; /* of uneven blocks: side rows, then side x side cells */
};

static double usable(float weight)
{
    return weight > 0 && isfinite(weight) ? (double)weight : 0;
}

/* Cumulative sums of `count` weights, divided by their sum: exactly 1 from the last positive one on. All 0
 * when the sum is. */
static void accumulate(cell_t *cells, const double *weights, uint32_t count, double total)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; i++) {
        sum += weights[i];
        cells[i].cumulative = total > 0 ? (float)(sum / total) : 0;
    }
}

static void make_guide(uint16_t *guide, uint32_t buckets, const cell_t *cells, uint32_t count)
{
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

/* The smallest side of blocks that divides both sides and makes few blocks, or the largest. */
static uint32_t side_of_blocks(uint32_t width, uint32_t height)
{
    uint32_t side = 1;
    while (side < MOST_SIDE && (uint64_t)(width / side) * (height / side) > MOST_BLOCKS &&
           width % (2 * side) == 0 && height % (2 * side) == 0)
        side *= 2;
    return side;
}

static distribution_t *allocate(uint32_t width, uint32_t height)
{
    distribution_t *d = mem_zalloc(1, sizeof *d);
    uint32_t side = side_of_blocks(width, height), across = width / side, down = height / side;
    *d = (distribution_t){.width = width,
                          .height = height,
                          .side = side,
                          .shift = 31 - (uint32_t)__builtin_clz(side),
                          .across = across,
                          .down = down,
                          .column_buckets = power_below(across),
                          .row_buckets = power_below(down)};
    d->columns = mem_alloc((size_t)across * down * sizeof *d->columns);
    d->column_guides = mem_alloc((size_t)d->column_buckets * down * sizeof *d->column_guides);
    d->rows = mem_zalloc(down, sizeof *d->rows);
    d->row_guide = mem_alloc(d->row_buckets * sizeof *d->row_guide);
    return d;
}

/* The weights of a block, row by row. */
static void read_block(const distribution_t *d, const float *weights, size_t block, double *inside)
{
    size_t row = block / d->across * d->side, column = block % d->across * d->side;
    for (size_t i = 0; i < (size_t)d->side * d->side; i++)
        inside[i] = usable(weights[(row + i / d->side) * d->width + column + i % d->side]);
}

/* True when the variance of the weights is no more than so many times the square of their mean. */
static bool is_even(const double *weights, uint32_t count, double sum, double tolerance)
{
    double mean = sum / count, variance = 0;
    for (uint32_t i = 0; i < count; i++) variance += (weights[i] - mean) * (weights[i] - mean) / count;
    return variance <= tolerance * mean * mean;
}

static uint32_t table_size(const distribution_t *d)
{
    return d->side + d->side * d->side;
}

/* The table of an uneven block; NULL for others. */
static cell_t *table_of(const distribution_t *d, const cell_t *block)
{
    return block->table & UNEVEN ? d->tables + (size_t)(block->table & ~UNEVEN) * table_size(d) : NULL;
}

/* Of a block that is drawn with this probability. */
static void fill_table(const distribution_t *d, cell_t *table, const double *inside, double scale)
{
    uint32_t side = d->side;
    double row_sums[MOST_SIDE];
    for (uint32_t y = 0; y < side; y++) {
        cell_t *cells = table + side + (size_t)y * side;
        row_sums[y] = sum_of(inside + (size_t)y * side, side);
        accumulate(cells, inside + (size_t)y * side, side, row_sums[y]);
        for (uint32_t x = 0; x < side; x++) cells[x].density = (float)(inside[(size_t)y * side + x] * scale);
    }
    accumulate(table, row_sums, side, sum_of(row_sums, side));
}

/* Notes the sums of blocks, and gives uneven ones a table, even ones a density of 0. */
static uint32_t sum_blocks(const distribution_t *d, const float *weights, double tolerance, double *sums)
{
    double inside[MOST_SIDE * MOST_SIDE];
    uint32_t cells = d->side * d->side, uneven = 0;
    for (size_t i = 0; i < (size_t)d->across * d->down; i++) {
        read_block(d, weights, i, inside);
        sums[i] = sum_of(inside, cells);
        d->columns[i].table = is_even(inside, cells, sums[i], tolerance) ? 0 : UNEVEN | uneven++;
    }
    return uneven;
}

distribution_t *distribution_new(const float *weights, uint32_t width, uint32_t height, float tolerance)
{
    distribution_t *d = allocate(width, height);
    size_t blocks = (size_t)d->across * d->down;
    double *sums = mem_alloc(blocks * sizeof *sums), *row_sums = mem_alloc(d->down * sizeof *row_sums);
    double inside[MOST_SIDE * MOST_SIDE];
    uint32_t uneven = sum_blocks(d, weights, (double)tolerance, sums);
    d->tables = mem_zalloc((size_t)uneven * table_size(d) + 1, sizeof *d->tables);
    for (uint32_t y = 0; y < d->down; y++) {
        size_t start = (size_t)y * d->across;
        row_sums[y] = sum_of(sums + start, d->across);
        accumulate(d->columns + start, sums + start, d->across, row_sums[y]);
        make_guide(d->column_guides + (size_t)y * d->column_buckets, d->column_buckets, d->columns + start,
                   d->across);
    }
    d->total = sum_of(row_sums, d->down);
    accumulate(d->rows, row_sums, d->down, d->total);
    make_guide(d->row_guide, d->row_buckets, d->rows, d->down);
    double scale = d->total > 0 ? (double)width * height / d->total : 0;
    for (size_t i = 0; i < blocks; i++) {
        cell_t *table = table_of(d, &d->columns[i]);
        if (table != NULL) {
            read_block(d, weights, i, inside);
            fill_table(d, table, inside, scale);
        } else {
            d->columns[i].density = (float)(sums[i] / (d->side * d->side) * scale);
        }
    }
    free(sums);
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
    free(d->tables);
    free(d);
    *distribution = NULL;
}

/* The cell along one axis, `count` of them, that a coordinate lies in. */
static uint32_t cell_of(float at, uint32_t count)
{
    float cell = float_min(float_max(at, 0) * (float)count, (float)(count - 1));
    return (uint32_t)cell;
}

/* Where a number lies between the ends of the cell that it draws. */
static float part_of(const cell_t *cells, uint32_t cell, float u)
{
    float before = cell > 0 ? cells[cell - 1].cumulative : 0;
    return (u - before) / (cells[cell].cumulative - before);
}

/* Draws a cell: the first whose cumulative probability is above u. Its own probability is thus not 0. Where
 * u lies between its ends is *part. */
static uint32_t invert(const axis_t *axis, float u, float *part)
{
    u = float_min(float_max(u, 0), 0x1.fffffep-1f);
    uint32_t low = 0, high = axis->count - 1;
    uint32_t bucket = (uint32_t)(u * (float)axis->buckets);
    low = axis->guide[bucket];
    if (bucket + 1 < axis->buckets) high = axis->guide[bucket + 1];
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (axis->cells[middle].cumulative > u)
            high = middle;
        else
            low = middle + 1;
    }
    *part = part_of(axis->cells, low, u);
    return low;
}

/* The same of a few cells that have no guide, without a branch that a processor would have to guess. */
static uint32_t invert_few(const cell_t *cells, uint32_t count, float u, float *part)
{
    u = float_min(float_max(u, 0), 0x1.fffffep-1f);
    uint32_t cell = 0;
    for (uint32_t i = 0; i < count - 1; i++) cell += cells[i].cumulative <= u;
    *part = part_of(cells, cell, u);
    return cell;
}

/* A coordinate inside a cell, in the sense of cell_of, whatever the rounding. */
static float place(uint32_t cell, float part, uint32_t count)
{
    float at = float_min(((float)cell + part) / (float)count, 0x1.fffffep-1f);
    while (cell_of(at, count) > cell) at = nextafterf(at, 0);
    while (cell_of(at, count) < cell) at = nextafterf(at, 1);
    return at;
}

vec2_t distribution_sample(const distribution_t *d, vec2_t u, float *pdf)
{
    *pdf = 0;
    if (!(d->total > 0)) return u;
    axis_t rows = {d->down, d->row_buckets, d->rows, d->row_guide};
    uint32_t y = invert(&rows, u.y, &u.y);
    axis_t columns = {d->across, d->column_buckets, d->columns + (size_t)y * d->across,
                      d->column_guides + (size_t)y * d->column_buckets};
    uint32_t x = invert(&columns, u.x, &u.x);
    const cell_t *table = table_of(d, &columns.cells[x]);
    *pdf = columns.cells[x].density;
    if (table == NULL) return (vec2_t){place(x, u.x, d->across), place(y, u.y, d->down)};
    uint32_t inner_y = invert_few(table, d->side, u.y, &u.y);
    const cell_t *inside = table + d->side + (size_t)inner_y * d->side;
    uint32_t inner_x = invert_few(inside, d->side, u.x, &u.x);
    *pdf = inside[inner_x].density;
    return (vec2_t){place(x * d->side + inner_x, u.x, d->width),
                    place(y * d->side + inner_y, u.y, d->height)};
}

float distribution_pdf(const distribution_t *d, vec2_t at)
{
    uint32_t x = cell_of(at.x, d->width), y = cell_of(at.y, d->height), rest = d->side - 1;
    const cell_t *block = &d->columns[(size_t)(y >> d->shift) * d->across + (x >> d->shift)];
    const cell_t *table = table_of(d, block);
    return table != NULL ? table[d->side + ((size_t)(y & rest) << d->shift) + (x & rest)].density
                         : block->density;
}

/* The number that invert takes to a part of a cell. */
static float revert(const cell_t *cells, uint32_t cell, float part)
{
    float before = cell > 0 ? cells[cell - 1].cumulative : 0;
    return float_min(before + part * (cells[cell].cumulative - before), 0x1.fffffep-1f);
}

/* The part of cell `cell` of `count` that a coordinate lies at. */
static float part_at(float at, uint32_t cell, uint32_t count)
{
    return float_clamp(at * (float)count - (float)cell, 0, 1);
}

vec2_t distribution_numbers(const distribution_t *d, vec2_t at)
{
    uint32_t x = cell_of(at.x, d->width), y = cell_of(at.y, d->height), rest = d->side - 1;
    uint32_t outer_x = x >> d->shift, outer_y = y >> d->shift;
    size_t start = (size_t)outer_y * d->across;
    const cell_t *table = table_of(d, &d->columns[start + outer_x]);
    vec2_t part = {part_at(at.x, outer_x, d->across), part_at(at.y, outer_y, d->down)};
    if (table != NULL) {
        const cell_t *row = table + d->side + ((size_t)(y & rest) << d->shift);
        part.x = revert(row, x & rest, part_at(at.x, x, d->width));
        part.y = revert(table, y & rest, part_at(at.y, y, d->height));
    }
    return (vec2_t){revert(d->columns + start, outer_x, part.x), revert(d->rows, outer_y, part.y)};
}
