/* density: see density.h. */
#include "worker/render/medium/density.h"

#include "common/base.h"

#include <stdlib.h>

enum { MOST_BLOCKS_ALONG = 64, LEAST_BLOCK = 2, SMALL = 64, CLOUD_LAYERS = 32 };
/* Cubes of a small grid that a straight line meets; from so far away that it does not move it meets no more.
 */
enum { MOST_CUBES = 3 * (SMALL + 2) };

struct density {
    field_t field;
    bool small;
    float side[3]; /* of a block, in cells */
    int blocks[3]; /* along each axis */
    float *most;   /* of each block */
};

static size_t block_index(const int count[3], const int block[3])
{
    return ((size_t)block[2] * (size_t)count[1] + (size_t)block[1]) * (size_t)count[0] + (size_t)block[0];
}

/* Cuts the box into blocks. A cloud's bounds differ by height alone. */
static void lay_out_blocks(density_t *d)
{
    const float *span = d->field.record->span;
    if (d->field.record->kind == FIELD_CLOUD) {
        for (int i = 0; i < 3; i++) {
            d->blocks[i] = i == 1 ? CLOUD_LAYERS : 1;
            d->side[i] = span[i] / (float)d->blocks[i];
        }
        return;
    }
    int largest = (int)ceilf(float_max(span[0], float_max(span[1], span[2])));
    int side = int_max((largest + MOST_BLOCKS_ALONG - 1) / MOST_BLOCKS_ALONG, LEAST_BLOCK);
    for (int i = 0; i < 3; i++) {
        d->side[i] = (float)side;
        d->blocks[i] = ((int)ceilf(span[i]) + side - 1) / side;
    }
}

/* The largest density of the cells that each block's own places are interpolated from. */
static void bound_blocks(density_t *d, const field_t *field)
{
    const float *origin = field->record->origin;
    d->most = mem_alloc((size_t)d->blocks[0] * (size_t)d->blocks[1] * (size_t)d->blocks[2] * sizeof *d->most);
    int b[3];
    float low[3], high[3];
    for (b[2] = 0; b[2] < d->blocks[2]; b[2]++)
        for (b[1] = 0; b[1] < d->blocks[1]; b[1]++)
            for (b[0] = 0; b[0] < d->blocks[0]; b[0]++) {
                for (int i = 0; i < 3; i++) {
                    low[i] = (float)b[i] * d->side[i] + origin[i];
                    high[i] = (float)(b[i] + 1) * d->side[i] + origin[i];
                }
                d->most[block_index(d->blocks, b)] = field_most(field, low, high);
            }
}

density_t *density_new(const scene_blob_t *blob, blob_ref_t ref)
{
    density_t *d = mem_zalloc(1, sizeof *d);
    d->field = field_open(blob, ref);
    const int *n = d->field.cells;
    d->small = n[0] > 0 && int_max(n[0], int_max(n[1], n[2])) <= SMALL;
    lay_out_blocks(d);
    bound_blocks(d, &d->field);
    return d;
}

density_t *density_of_cells(const scene_blob_t *blob, blob_ref_t ref, const float *cells)
{
    density_t *d = mem_zalloc(1, sizeof *d);
    d->field = field_open(blob, ref);
    field_t own = d->field;
    own.numbers = cells;
    lay_out_blocks(d);
    bound_blocks(d, &own);
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

/* ---- along a ray --------------------------------------------------------------------------------------- */

/* Narrows the ray to where one of its coordinates lies between 0 and `size`; to nothing where floats do not
 * tell blocks apart. */
static void clip(march_t *march, float origin, float direction, float size)
{
    const float farthest = 0x1p24f;
    if (!(fabsf(origin) < farthest && fabsf(direction) < INFINITY)) {
        march->end = -1;
        return;
    }
    if (direction == 0) {
        if (!(origin >= 0 && origin <= size)) march->end = -1;
        return;
    }
    float a = -origin / direction, b = (size - origin) / direction;
    march->at = float_max(march->at, float_min(a, b));
    march->end = float_min(march->end, float_max(a, b));
}

/* How far along the ray it leaves the block across an axis. */
static float leaves(const march_t *march, int axis)
{
    int border = march->block[axis] + (march->step[axis] > 0);
    return ((float)border - march->origin[axis]) * march->inverse[axis];
}

void march_begin(march_t *march, const density_t *d, vec3_t from, vec3_t direction, float distance)
{
    const float *span = d->field.record->span;
    const float scale[3] = {span[0] / d->side[0], span[1] / d->side[1], span[2] / d->side[2]};
    vec3_t o = xform_point(&d->field.from_world, from), w = xform_vector(&d->field.from_world, direction);
    *march = (march_t){.density = d,
                       .origin = {o.x * scale[0], o.y * scale[1], o.z * scale[2]},
                       .direction = {w.x * scale[0], w.y * scale[1], w.z * scale[2]},
                       .end = distance};
    for (int i = 0; i < 3; i++) clip(march, march->origin[i], march->direction[i], scale[i]);
    if (!(march->at < march->end)) return;
    ptrdiff_t stride = 1;
    for (int i = 0; i < 3; i++) {
        float along = march->direction[i];
        march->block[i] =
            (int)float_clamp(march->origin[i] + march->at * along, 0, (float)(d->blocks[i] - 1));
        march->inverse[i] = 1 / along;
        march->step[i] = along > 0 ? 1 : -1;
        march->stride[i] = along > 0 ? stride : -stride;
        march->next[i] = along != 0 ? leaves(march, i) : INFINITY;
        stride *= d->blocks[i];
    }
    march->most = d->most + block_index(d->blocks, march->block);
}

void density_place(const march_t *march, float t, float place[3])
{
    const float *side = march->density->side, *origin = march->density->field.record->origin;
    for (int i = 0; i < 3; i++) place[i] = (march->origin[i] + t * march->direction[i]) * side[i] + origin[i];
}

float density_along(const march_t *march, float t)
{
    float place[3];
    density_place(march, t, place);
    return field_number(&march->density->field, place);
}

bool march_next(march_t *march, float *begin, float *end, float *most)
{
    const density_t *d = march->density;
    if (!(march->at < march->end)) return false;
    const float *next = march->next;
    int axis = next[0] <= next[1] ? (next[0] <= next[2] ? 0 : 2) : (next[1] <= next[2] ? 1 : 2);
    *begin = march->at;
    *end = float_min(float_max(next[axis], march->at), march->end);
    *most = *march->most;
    march->block[axis] += march->step[axis];
    march->at = *end;
    if (march->block[axis] < 0 || march->block[axis] >= d->blocks[axis]) {
        march->at = march->end;
        return true;
    }
    march->most += march->stride[axis];
    march->next[axis] = leaves(march, axis);
    return true;
}

/* ---- integrals ----------------------------------------------------------------------------------------- */

bool density_is_small(const density_t *d)
{
    return d->small;
}

/* The density in one cube between the middles of cells, where it is a polynomial of the third degree along a
 * ray. */
typedef struct {
    const march_t *march;
    const int *first;
    float corners[8];
} cube_t;

static cube_t cube_of(const march_t *march, const way_cube_t *part)
{
    cube_t cube = {.march = march, .first = part->first};
    field_corners(&march->density->field, part->first, cube.corners);
    return cube;
}

static float density_in(const cube_t *cube, float t)
{
    float at[3];
    density_place(cube->march, t, at);
    for (int i = 0; i < 3; i++) at[i] = float_clamp(at[i] - (float)cube->first[i], 0, 1);
    return field_between(cube->corners, at);
}

/* The integral over the part of the ray in it, by Gauss's rule of two points, which is exact here. */
static float integrate(const march_t *march, const way_cube_t *part)
{
    const float node = 0.57735027f; /* 1 / sqrt(3) */
    cube_t cube = cube_of(march, part);
    float middle = 0.5f * (part->begin + part->end), half = 0.5f * (part->end - part->begin);
    return (density_in(&cube, middle - node * half) + density_in(&cube, middle + node * half)) * half;
}

/* Where in it the integral is `wanted`, by bisection. The polynomial is that through four places, where a
 * number x is 0, 1, 2 and 3 (Newton's differences); its integral is one of the fourth degree. */
static float find_in_cube(const march_t *march, const way_cube_t *part, float wanted)
{
    cube_t cube = cube_of(march, part);
    float third = (part->end - part->begin) / 3, f[4];
    for (int i = 0; i < 4; i++) f[i] = density_in(&cube, part->begin + (float)i * third);
    float once = f[1] - f[0], twice = f[2] - f[1] - once, thrice = f[3] - f[2] - (f[2] - f[1]) - twice;
    float linear = once - twice / 2 + thrice / 3, square = (twice - thrice) / 2, cubic = thrice / 6;
    float low = 0, high = 3;
    for (int i = 0; i < 12; i++) {
        float x = 0.5f * (low + high);
        if (x * (f[0] + x * (linear / 2 + x * (square / 3 + x * cubic / 4))) * third < wanted)
            low = x;
        else
            high = x;
    }
    return part->begin + 0.5f * (low + high) * third;
}

/* Enters a piece of the ray. */
static void enter_piece(way_t *way)
{
    const march_t *march = &way->march;
    const float *side = march->density->side;
    float place[3];
    density_place(march, way->begin, place);
    for (int i = 0; i < 3; i++) {
        float along = march->direction[i] * side[i];
        way->first[i] = (int)floorf(place[i]);
        float rest = along > 0 ? (float)(way->first[i] + 1) - place[i] : place[i] - (float)way->first[i];
        way->step[i] = along != 0 ? fabsf(1 / along) : INFINITY;
        way->next[i] = along != 0 ? way->begin + rest * way->step[i] : INFINITY;
        way->ahead[i] = along > 0 ? 1 : -1;
    }
    way->left = MOST_CUBES;
}

/* Goes on to the next cube; false when there is none. */
static bool next_cube(way_t *way, way_cube_t *cube)
{
    float most;
    for (;;) {
        while (!(way->begin < way->end) || way->left == 0) {
            if (!march_next(&way->march, &way->begin, &way->end, &most)) return false;
            if (most > 0)
                enter_piece(way);
            else
                way->begin = way->end;
        }
        const float *next = way->next;
        int axis = next[0] <= next[1] ? (next[0] <= next[2] ? 0 : 2) : (next[1] <= next[2] ? 1 : 2);
        *cube = (way_cube_t){.first = {way->first[0], way->first[1], way->first[2]},
                             .begin = way->begin,
                             .end = float_min(next[axis], way->end)};
        way->begin = cube->end;
        way->next[axis] += way->step[axis];
        way->first[axis] += way->ahead[axis];
        way->left--;
        if (cube->end > cube->begin) return true;
    }
}

void way_begin(way_t *way, const density_t *density, vec3_t from, vec3_t direction, float distance)
{
    way->from = from;
    way->direction = direction;
    way->distance = distance;
    way->begin = way->end = 0;
    way->left = way->count = 0;
    march_begin(&way->march, density, from, direction, distance);
}

bool way_is(const way_t *way, const density_t *density, vec3_t from, vec3_t direction, float distance)
{
    return way->march.density == density && way->distance == distance && v_is_zero(v_sub(way->from, from)) &&
           v_is_zero(v_sub(way->direction, direction));
}

/* The i-th cube, of those that are kept or the next one; false when there is none. `sum` is up to it. */
static bool way_cube(way_t *way, int i, float sum, way_cube_t *cube)
{
    if (i < way->count) {
        *cube = way->cubes[i];
        return true;
    }
    if (!next_cube(way, cube)) return false;
    cube->sum = sum + integrate(&way->march, cube);
    if (way->count < WAY_CUBES) way->cubes[way->count] = *cube;
    way->count++;
    return true;
}

bool way_find(way_t *way, float wanted, float *sum, float *at)
{
    if (way->count > WAY_CUBES) way_begin(way, way->march.density, way->from, way->direction, way->distance);
    way_cube_t cube;
    *sum = 0;
    for (int i = 0; way_cube(way, i, *sum, &cube); i++) {
        if (cube.sum > wanted) {
            *at = find_in_cube(&way->march, &cube, wanted - *sum);
            return true;
        }
        *sum = cube.sum;
    }
    return false;
}
