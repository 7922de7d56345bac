/* photon_grid: points of space, to be found within a distance of a place.
 *
 * Cells are as wide as twice the distance and hashed to buckets, so that whatever lies near enough to a place
 * is in the buckets of eight cells. A bucket may be that of several of them, or hold points of cells far off:
 * callers are told each bucket once and look at the distances themselves. Points keep their order within a
 * bucket, so sums over them have the same bits whoever made the grid.
 */
#ifndef LIGHTMILL_PHOTON_GRID_H
#define LIGHTMILL_PHOTON_GRID_H

#include "common/vec.h"

#include <stdint.h>

typedef struct {
    float per_cell;   /* 1 / the width of a cell */
    uint32_t mask;    /* buckets - 1 */
    uint32_t *starts; /* [buckets + 1]: where each begins in the new order of the points */
} photon_grid_t;

/* Sorts so many points into buckets; order[i] receives the new place of point i. */
void photon_grid_build(photon_grid_t *grid, const vec3_t *points, uint32_t count, float radius,
                       uint32_t *order);
void photon_grid_free(photon_grid_t *grid);

/* Points of a bucket: from `first` to before `end`. */
typedef struct {
    uint32_t first, end;
} photon_range_t;

enum { PHOTON_CELLS = 8 };
/* The buckets that have all within the radius of p, each once; returns how many are not empty. */
int photon_grid_near(const photon_grid_t *grid, vec3_t p, photon_range_t ranges[PHOTON_CELLS]);

#endif
