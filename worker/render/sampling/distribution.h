/* distribution: points of the unit square, drawn with a density that is constant in each cell of a grid; for
 * sampling images such as environment maps by their brightness.
 *
 * A row is drawn from the marginal distribution and a cell of it from the conditional one, each by inverting
 * a cumulative distribution, so that well stratified numbers give well stratified points. At most 10 bytes
 * a cell, and next to none where those of a large grid are made even.
 */
#ifndef LIGHTMILL_DISTRIBUTION_H
#define LIGHTMILL_DISTRIBUTION_H

#include "common/vec.h"

#include <stdint.h>

typedef struct distribution distribution_t;

/* From width x height weights, rows from y = 0, which are not kept; both sides from 1 to 65536. A negative or
 * non-finite weight counts as 0. In a large grid a block of cells becomes even when the variance of
 * their weights is at most `tolerance` times the square of their mean; at 0 every cell keeps its weight. */
distribution_t *distribution_new(const float *weights, uint32_t width, uint32_t height, float tolerance);
/* Frees the distribution and sets *distribution to NULL. */
void distribution_destroy(distribution_t **distribution);

/* A point of [0, 1)^2 for two uniform numbers in [0, 1), and its density per area of the square: the weight
 * of its cell over the mean weight. Cells of weight 0 are never drawn, but in even blocks; inside a cell
 * points are uniform. *pdf is 0, and the point means nothing, when all weights are 0. */
vec2_t distribution_sample(const distribution_t *distribution, vec2_t u, float *pdf);

/* The density of distribution_sample at a point of [0, 1]^2; points outside belong to the nearest cell. */
float distribution_pdf(const distribution_t *distribution, vec2_t at);

/* The numbers that distribution_sample takes to a point, but for rounding. */
vec2_t distribution_numbers(const distribution_t *distribution, vec2_t at);

#endif
