/* light_guide: where light subpaths of one light are worth starting, as earlier passes showed (learning.h).
 *
 * The starts of a light are cut into cells. Let q be the density of starts: how many light subpaths a sample
 * of the picture has, measured such that all starts of a light measure 1; v what a subpath brings to the
 * picture, in terms of how bright that is there; and c what it costs. A cell has the sums of v^2 q and of
 * c / q over the subpaths that began in it (GUIDE_SQUARES, GUIDE_COSTS). Whatever q was, these are estimates
 * of the integrals over the cell, times the samples, of g^2, g = v q being what a start is worth, and of c.
 * With b the noise and c_b the cost of all that needs no light subpath, a sample has the noise b + sum g^2 /
 * q at the cost c_b + sum q c. The product is least for q = reach sqrt(g^2 / c), reach = sqrt(c_b / b) (as in
 * Rath et al. 2022, "EARS: Efficiency-Aware Russian Roulette and Splitting", for whole paths).
 *
 * Lights that have a place in the world are cut by the directions of their rays, over the square of the plain
 * octahedral map. Those at infinity are cut by the numbers that draw their direction, and for each part by
 * where the ray crosses a square about the scene.
 *
 * That alone would keep what it once was: where few light subpaths start, eye subpaths that run into the
 * light have nearly all the weight, so that what light subpaths bring there looks small, however noisy it is
 * what eye subpaths bring. So these teach, too (GUIDE_LEFT). One that ran into the light and brought w could
 * have been made by a light subpath, too, from a start of the density q, whose strategies together make it r
 * times as densely (r^2 is their share in its weight). Left to them alone the noise would be w^2 / r; so w^2
 * q / r is an estimate of g^2.
 *
 * All densities are mixed with what would be drawn without a guide, so that what was never seen is found,
 * too, and nothing weighs more than a bound.
 */
#ifndef LIGHTMILL_LIGHT_GUIDE_H
#define LIGHTMILL_LIGHT_GUIDE_H

#include "common/vec.h"

#include <stdint.h>

typedef struct light_guide light_guide_t;

/* What of a light is cut; of parallel rays where they go, of a sky the directions, too. */
typedef enum { GUIDE_NOTHING, GUIDE_DIRECTIONS, GUIDE_PARALLEL, GUIDE_SKY } guide_kind_t;

/* The lessons of a cell, which are in units of 2^-bits. */
enum { GUIDE_SQUARES, GUIDE_COSTS, GUIDE_LEFT, GUIDE_LESSONS };
enum { GUIDE_SQUARE_BITS = 14, GUIDE_COST_BITS = 4, GUIDE_LEFT_BITS = 4 };

/* Cells a side of its grids, where there is room for that: of a fineness from 0 to LIGHT_GUIDE_FINEST. */
enum { LIGHT_GUIDE_FINEST = 2 };
uint32_t light_guide_side(guide_kind_t kind, uint32_t fineness);
/* Cells of a light of this kind, cut into so many a side. */
uint32_t light_guide_cells(guide_kind_t kind, uint32_t side);
/* A guide from its lessons, [GUIDE_LESSONS][cells], of so many samples; `left`: how much GUIDE_LEFT counts.
 * *worth: the integral of sqrt(g^2 / c) over all starts. NULL where the kind has none, or nothing was
 * learned. */
light_guide_t *light_guide_new(guide_kind_t kind, uint32_t side, const double *lessons, double samples,
                               double left, double *worth);
/* Frees the guide and sets *guide to NULL. */
void light_guide_destroy(light_guide_t **guide);

/* Where a light subpath started. */
typedef struct {
    uint32_t cell;
    float density; /* q; 0: it teaches nothing */
} light_start_t;

/* ---- rays of lights in the world; `guide` may be NULL -------------------------------------------------- */

/* Draws a direction by the guide; false when it is to be drawn as without one, by *u, which was stretched. */
bool light_guide_direction(const light_guide_t *guide, vec2_t *u, vec3_t *w);
/* The density of direction w, per steradian; `plain`: without the guide. */
float light_guide_direction_pdf(const light_guide_t *guide, float plain, vec3_t w);
/* The start that this direction is, `pdf` its density. */
light_start_t light_guide_direction_start(uint32_t side, vec3_t w, float pdf);

/* ---- of lights at infinity ----------------------------------------------------------------------------- */

/* Draws numbers that draw a direction, from such. *density: of these numbers. */
vec2_t light_guide_place(const light_guide_t *guide, vec2_t u, float *density);
/* The density of such numbers. */
float light_guide_place_pdf(const light_guide_t *guide, vec2_t u);
/* Draws a point of the unit square, where `place` are the numbers of the direction; false when it is to be
 * drawn as without a guide, by *u, which was stretched. */
bool light_guide_square(const light_guide_t *guide, vec2_t place, vec2_t *u, vec2_t *at);
/* The density at a point of the square, or outside; `plain`: without the guide. */
float light_guide_square_pdf(const light_guide_t *guide, vec2_t place, float plain, vec2_t at);
/* The start that these numbers and this point are, with the density of both. */
light_start_t light_guide_square_start(guide_kind_t kind, uint32_t side, vec2_t place, vec2_t at,
                                       float density);

#endif
