/* photon_grid: see photon_grid.h. */
#include "worker/render/integrator/photon_grid.h"

#include "common/base.h"

#include <math.h>
#include <stdlib.h>

/* A coordinate in cells. Beyond the bounds all cells are one: slow, but not wrong. */
static int32_t cell_of(float coordinate, float per_cell)
{
    return (int32_t)float_clamp(floorf(coordinate * per_cell), -0x1p29f, 0x1p29f);
}

static uint32_t bucket_of(const photon_grid_t *grid, int32_t x, int32_t y, int32_t z)
{
    /* Teschner et al. 2003, "Optimized Spatial Hashing for Collision Detection of Deformable Objects", with
     * the upper bits mixed in. */
    uint32_t hash = (uint32_t)x * 73856093u ^ (uint32_t)y * 19349663u ^ (uint32_t)z * 83492791u;
    hash ^= hash >> 15;
    hash *= 0x2C1B3C6Du;
    return (hash ^ hash >> 13) & grid->mask;
}

static uint32_t bucket_at(const photon_grid_t *grid, vec3_t p)
{
    return bucket_of(grid, cell_of(p.x, grid->per_cell), cell_of(p.y, grid->per_cell),
                     cell_of(p.z, grid->per_cell));
}

void photon_grid_build(photon_grid_t *grid, const vec3_t *points, uint32_t count, float radius,
                       uint32_t *order)
{
    uint32_t buckets = 16;
    while (buckets < count) buckets *= 2;
    grid->per_cell = 0.5f / radius;
    grid->mask = buckets - 1;
    grid->starts = mem_zalloc((size_t)buckets + 2, sizeof *grid->starts);
    uint32_t *next = grid->starts + 1; /* where the next point of each bucket goes */
    for (uint32_t i = 0; i < count; i++) {
        order[i] = bucket_at(grid, points[i]);
        next[order[i] + 1]++;
    }
    for (uint32_t b = 1; b <= buckets; b++) next[b] += next[b - 1];
    for (uint32_t i = 0; i < count; i++) order[i] = next[order[i]]++;
}

void photon_grid_free(photon_grid_t *grid)
{
    free(grid->starts);
    grid->starts = NULL;
}

int photon_grid_near(const photon_grid_t *grid, vec3_t p, photon_range_t ranges[PHOTON_CELLS])
{
    float half = 0.5f / grid->per_cell; /* of a cell: the radius */
    int32_t x = cell_of(p.x - half, grid->per_cell), y = cell_of(p.y - half, grid->per_cell),
            z = cell_of(p.z - half, grid->per_cell);
    int count = 0;
    for (int k = 0; k < PHOTON_CELLS; k++) {
        uint32_t bucket = bucket_of(grid, x + (k & 1), y + (k >> 1 & 1), z + (k >> 2));
        photon_range_t range = {grid->starts[bucket], grid->starts[bucket + 1]};
        bool seen = range.first == range.end;
        for (int i = 0; i < count; i++) seen = seen || ranges[i].first == range.first;
        if (!seen) ranges[count++] = range;
    }
    return count;
}
