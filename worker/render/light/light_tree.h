/* light_tree: chooses among many lights by what they may bring to a point: their power over the square of how
 * far away they are (Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree
 * Splitting", without their bounds on directions).
 *
 * The leaves are the lights, and a node has the box about all that is below it. A choice goes down from the
 * root, to either side in proportion to power / max(d^2, r^2), with d the distance to the middle of the box
 * and r half of its diagonal. So every light has a chance at every point.
 */
#ifndef LIGHTMILL_LIGHT_TREE_H
#define LIGHTMILL_LIGHT_TREE_H

#include "common/vec.h"

#include <stdint.h>

typedef struct light_tree light_tree_t;

/* A light and the box about it. */
typedef struct {
    vec3_t low, high;
    double power; /* above 0 */
    uint32_t light;
} light_box_t;

/* A tree over the boxes, at least one, which it sorts and does not keep. Lights have numbers below `lights`.
 */
light_tree_t *light_tree_new(light_box_t *boxes, uint32_t count, uint32_t lights);
/* Frees the tree and sets *tree to NULL. */
void light_tree_destroy(light_tree_t **tree);
/* The light that a uniform number chooses at a point, and its chance. The number is stretched to [0, 1)
 * again.
 */
uint32_t light_tree_choose(const light_tree_t *tree, vec3_t point, float *u, float *chance);
/* The chance of a light of the tree there. */
float light_tree_chance(const light_tree_t *tree, uint32_t light, vec3_t point);

#endif
