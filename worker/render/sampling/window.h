/* window: points of a rectangle of the unit square, drawn with a density that is constant in each cell of a
 * grid over the square; for sampling the part of an image that is seen through an opening, which is another
 * one from each point.
 *
 * Sums over all rectangles at the origin (a summed-area table: Crow 1984) give the sum over any other in
 * four look-ups, and so the cumulative distributions that are searched (Bitterli, Novak and Jarosz 2015,
 * "Portal-Masked Environment Map Sampling", section 4). 12 bytes a cell.
 */
#ifndef LIGHTMILL_WINDOW_H
#define LIGHTMILL_WINDOW_H

#include "common/vec.h"

#include <stdint.h>

/* A rectangle of the unit square, its edges included; low <= high in both. */
typedef struct {
    vec2_t low, high;
} window_t;

typedef struct window_table window_table_t;

/* From width x height weights, rows from y = 0; both sides from 1 to 65536. A negative or non-finite weight
 * counts as 0. */
window_table_t *window_table_new(const float *weights, uint32_t width, uint32_t height);
/* Frees the table and sets *table to NULL. */
void window_table_destroy(window_table_t **table);

/* The integral over a window of the weights, which are constant in each cell. */
double window_integral(const window_table_t *table, const window_t *window);
/* The weight at a point of [0, 1]^2. Over the integral it is the density of window_sample, per area of the
 * square, at a point of its window. */
float window_weight(const window_table_t *table, vec2_t at);
/* A point of the window for two uniform numbers in [0, 1), drawn in proportion to the weights; the integral
 * over the window must not be 0. */
vec2_t window_sample(const window_table_t *table, const window_t *window, vec2_t u);

#endif
