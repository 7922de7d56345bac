/* density: see density.h. */
#include "worker/render/medium/density.h"

#include "common/base.h"

#include <stdlib.h>

enum { MOST_BLOCKS_ALONG = 64, LEAST_BLOCK = 4 };

struct density {
    const float *cells;
    int count[3];  /* cells along each axis */
    int side;      /* of a block, in cells */
    int blocks[3]; /* along each axis */
    float *most;   /* of each block */
    xform_t from_world;
};

static size_t cell_index(const int count[3], int x, int y, int z)
{
    return ((size_t)z * (size_t)count[1] + (size_t)y) * (size_t)count[0] + (size_t)x;
}

/* The largest density of the cells that a block's own places are interpolated from. */
static float most_of_block(const density_t *d, const int block[3])
{
    int low[3], high[3];
    float most = 0;
    for (int i = 0; i < 3; i++) {
        low[i] = int_max(block[i] * d->side - 1, 0);
        high[i] = int_min((block[i] + 1) * d->side, d->count[i] - 1);
    }
    for (int z = low[2]; z <= high[2]; z++)
        for (int y = low[1]; y <= high[1]; y++)
            for (int x = low[0]; x <= high[0]; x++)
                most = float_max(most, d->cells[cell_index(d->count, x, y, z)]);
    return most;
}

density_t *density_new(const scene_blob_t *blob, const blob_medium_t *medium)
{
    density_t *d = mem_zalloc(1, sizeof *d);
    d->cells = blob->numbers + medium->first_density;
    xform_invert(&medium->world_from_grid, &d->from_world);
    int largest = 1;
    for (int i = 0; i < 3; i++) {
        d->count[i] = (int)medium->cells[i];
        largest = int_max(largest, d->count[i]);
    }
    d->side = int_max((largest + MOST_BLOCKS_ALONG - 1) / MOST_BLOCKS_ALONG, LEAST_BLOCK);
    for (int i = 0; i < 3; i++) d->blocks[i] = (d->count[i] + d->side - 1) / d->side;
    d->most = mem_alloc((size_t)d->blocks[0] * (size_t)d->blocks[1] * (size_t)d->blocks[2] * sizeof *d->most);
    int b[3];
    for (b[2] = 0; b[2] < d->blocks[2]; b[2]++)
        for (b[1] = 0; b[1] < d->blocks[1]; b[1]++)
            for (b[0] = 0; b[0] < d->blocks[0]; b[0]++)
                d->most[cell_index(d->blocks, b[0], b[1], b[2])] = most_of_block(d, b);
    return d;
}

void density_destroy(density_t **density)
{
    density_t *self = *density;
    if (self == NULL) return;
    free(self->most);
    free(self);
    *density = NULL;
}

static float cell_at(const density_t *d, int x, int y, int z)
{
    if (x < 0 || x >= d->count[0] || y < 0 || y >= d->count[1] || z < 0 || z >= d->count[2]) return 0;
    return d->cells[cell_index(d->count, x, y, z)];
}

/* The densities at the corners of a cube between the middles of eight cells, the first of which is that. */
static void corners_at(const density_t *d, const int first[3], float corners[8])
{
    for (int k = 0; k < 8; k++)
        corners[k] = cell_at(d, first[0] + (k & 1), first[1] + (k >> 1 & 1), first[2] + (k >> 2));
}

/* What is interpolated between them. */
static float between(const float corners[8], const float part[3])
{
    float lines[4], faces[2];
    for (int k = 0; k < 4; k++) lines[k] = corners[2 * k] + part[0] * (corners[2 * k + 1] - corners[2 * k]);
    for (int k = 0; k < 2; k++) faces[k] = lines[2 * k] + part[1] * (lines[2 * k + 1] - lines[2 * k]);
    return faces[0] + part[2] * (faces[1] - faces[0]);
}

/* ---- along a ray --------------------------------------------------------------------------------------- */

/* Narrows the ray to where one of its coordinates lies between 0 and `size`. */
static void clip(march_t *march, float origin, float direction, float size)
{
    if (direction == 0) {
        if (!(origin >= 0 && origin <= size)) march->end = -1;
        return;
    }
    float a = -origin / direction, b = (size - origin) / direction;
    march->at = float_max(march->at, float_min(a, b));
    march->end = float_min(march->end, float_max(a, b));
}

void march_begin(march_t *march, const density_t *d, vec3_t from, vec3_t direction, float distance)
{
    vec3_t o = xform_point(&d->from_world, from), w = xform_vector(&d->from_world, direction);
    vec3_t scale = vec3((float)d->count[0] / (float)d->side, (float)d->count[1] / (float)d->side,
                        (float)d->count[2] / (float)d->side);
    *march =
        (march_t){.density = d, .origin = v_mul(o, scale), .direction = v_mul(w, scale), .end = distance};
    clip(march, march->origin.x, march->direction.x, scale.x);
    clip(march, march->origin.y, march->direction.y, scale.y);
    clip(march, march->origin.z, march->direction.z, scale.z);
    if (!(march->at < march->end)) return;
    const float at[3] = {march->origin.x + march->at * march->direction.x,
                         march->origin.y + march->at * march->direction.y,
                         march->origin.z + march->at * march->direction.z};
    for (int i = 0; i < 3; i++) march->block[i] = (int)float_clamp(at[i], 0, (float)(d->blocks[i] - 1));
}

/* A place of the ray among the middles of cells. */
static void place_along(const march_t *march, float t, float at[3])
{
    float side = (float)march->density->side;
    at[0] = (march->origin.x + t * march->direction.x) * side - 0.5f;
    at[1] = (march->origin.y + t * march->direction.y) * side - 0.5f;
    at[2] = (march->origin.z + t * march->direction.z) * side - 0.5f;
}

float density_along(const march_t *march, float t)
{
    float at[3], corners[8];
    int first[3];
    place_along(march, t, at);
    for (int i = 0; i < 3; i++) {
        float below = floorf(at[i]);
        first[i] = (int)below;
        at[i] -= below;
    }
    corners_at(march->density, first, corners);
    return between(corners, at);
}

/* How far along the ray it leaves the block across an axis. */
static float leaves(float origin, float direction, int block)
{
    if (direction == 0) return INFINITY;
    return ((float)(direction > 0 ? block + 1 : block) - origin) / direction;
}

bool march_next(march_t *march, float *begin, float *end, float *most)
{
    const density_t *d = march->density;
    if (!(march->at < march->end)) return false;
    float at[3] = {leaves(march->origin.x, march->direction.x, march->block[0]),
                   leaves(march->origin.y, march->direction.y, march->block[1]),
                   leaves(march->origin.z, march->direction.z, march->block[2])};
    int axis = at[0] <= at[1] ? (at[0] <= at[2] ? 0 : 2) : (at[1] <= at[2] ? 1 : 2);
    *begin = march->at;
    *end = float_min(float_max(at[axis], march->at), march->end);
    *most = d->most[cell_index(d->blocks, march->block[0], march->block[1], march->block[2])];
    const float directions[3] = {march->direction.x, march->direction.y, march->direction.z};
    march->block[axis] += directions[axis] > 0 ? 1 : -1;
    bool left = march->block[axis] < 0 || march->block[axis] >= d->blocks[axis] || !(at[axis] < march->end);
    march->at = left ? march->end : *end;
    return true;
}
