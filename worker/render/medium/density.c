/* density: see density.h. */
#include "worker/render/medium/density.h"

#include "common/base.h"

#include <stdlib.h>

enum { MOST_BLOCKS_ALONG = 64, LEAST_BLOCK = 4, SMALL = 64 };

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

/* ---- integrals ----------------------------------------------------------------------------------------- */

bool density_is_small(const density_t *d)
{
    return int_max(d->count[0], int_max(d->count[1], d->count[2])) <= SMALL;
}

/* The ray in one cube between the middles of cells, where the density is a polynomial of the third degree. */
typedef struct {
    const march_t *march;
    int first[3];
    float corners[8];
} cube_t;

static float density_in(const cube_t *cube, float t)
{
    float at[3];
    place_along(cube->march, t, at);
    for (int i = 0; i < 3; i++) at[i] = float_clamp(at[i] - (float)cube->first[i], 0, 1);
    return between(cube->corners, at);
}

/* The integral over a part of the ray in it, by Simpson's rule, which is exact here. */
static float integrate(const cube_t *cube, float begin, float end)
{
    float middle = density_in(cube, 0.5f * (begin + end));
    return (density_in(cube, begin) + 4 * middle + density_in(cube, end)) * ((end - begin) / 6);
}

/* Where in a part of it the integral is `wanted`, by bisection. */
static float find_in_cube(const cube_t *cube, float begin, float end, float wanted)
{
    float low = begin, high = end;
    for (int i = 0; i < 12; i++) {
        float middle = 0.5f * (low + high);
        if (integrate(cube, begin, middle) < wanted)
            low = middle;
        else
            high = middle;
    }
    return 0.5f * (low + high);
}

/* Goes through a piece of the ray, cube by cube, until the integral is `wanted`; *sum grows until then. */
static bool find_in_piece(const march_t *march, float begin, float end, float wanted, float *sum, float *at)
{
    float side = (float)march->density->side, place[3], next[3], step[3];
    const float direction[3] = {march->direction.x * side, march->direction.y * side,
                                march->direction.z * side};
    cube_t cube = {.march = march};
    place_along(march, begin, place);
    for (int i = 0; i < 3; i++) {
        cube.first[i] = (int)floorf(place[i]);
        float rest =
            direction[i] > 0 ? (float)(cube.first[i] + 1) - place[i] : place[i] - (float)cube.first[i];
        step[i] = direction[i] != 0 ? fabsf(1 / direction[i]) : INFINITY;
        next[i] = direction[i] != 0 ? begin + rest * step[i] : INFINITY;
    }
    while (begin < end) {
        int axis = next[0] <= next[1] ? (next[0] <= next[2] ? 0 : 2) : (next[1] <= next[2] ? 1 : 2);
        float leave = float_min(next[axis], end);
        if (leave > begin) {
            corners_at(march->density, cube.first, cube.corners);
            float more = integrate(&cube, begin, leave);
            if (*sum + more > wanted) {
                *at = find_in_cube(&cube, begin, leave, wanted - *sum);
                return true;
            }
            *sum += more;
        }
        begin = leave;
        next[axis] += step[axis];
        cube.first[axis] += direction[axis] > 0 ? 1 : -1;
    }
    return false;
}

bool density_find(const density_t *density, vec3_t from, vec3_t direction, float distance, float wanted,
                  float *sum, float *at)
{
    march_t march;
    float begin, end, most;
    *sum = 0;
    march_begin(&march, density, from, direction, distance);
    while (march_next(&march, &begin, &end, &most))
        if (most > 0 && find_in_piece(&march, begin, end, wanted, sum, at)) return true;
    return false;
}
