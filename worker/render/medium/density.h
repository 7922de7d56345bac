/* density: how dense a medium is from place to place (field.h), and bounds on it along rays, for tracking.
 *
 * Cells make up blocks, whose largest densities are kept: a ray is a run of pieces, each with a bound that
 * holds on it (Fong, Wrenninge, Kulla and Habel 2017, "Production Volume Rendering"). Trilinear interpolation
 * reaches one cell beyond a block, so that cell counts in its bound. A cloud has bounds by height.
 */
#ifndef LIGHTMILL_DENSITY_H
#define LIGHTMILL_DENSITY_H

#include "worker/render/medium/field.h"

typedef struct density density_t;

/* Of a field of numbers of the blob, which must outlive it. */
density_t *density_new(const scene_blob_t *blob, blob_ref_t field);
/* Of other numbers in the cells of a field of FIELD_CELLS, one for each, which are not kept: it is good for
 * bounds and places alone. */
density_t *density_of_cells(const scene_blob_t *blob, blob_ref_t field, const float *cells);
/* Frees it and sets *density to NULL. */
void density_destroy(density_t **density);
/* True when integrals along rays cost little. */
bool density_is_small(const density_t *density);

/* A ray on its way through the blocks. */
typedef struct {
    const density_t *density;
    float origin[3], direction[3]; /* in blocks; `direction` per unit length in the world */
    float inverse[3];              /* 1 / direction */
    float at, end;                 /* distances along the ray */
    float next[3];                 /* where it leaves the block across each axis */
    int block[3], step[3];         /* to the next one along each axis: 1 or -1 */
    const float *most;             /* of the block, */
    ptrdiff_t stride[3];           /* and from it to that of the next one */
} march_t;

/* Starts at `from` in the unit direction, for a distance that may be INFINITY. From 2^24 blocks away on there
 * is nothing. */
void march_begin(march_t *march, const density_t *density, vec3_t from, vec3_t direction, float distance);
/* Goes on to the next piece: it lies between the distances *begin and *end, and has at most the density
 * *most, which may be 0. False when there is none. */
bool march_next(march_t *march, float *begin, float *end, float *most);
/* The place in the field at a distance that lies on one of its pieces; from millions of blocks away only as
 * near it as floats tell. */
void density_place(const march_t *march, float distance, float place[3]);
/* The density there. */
float density_along(const march_t *march, float distance);

/* Cubes that a way keeps; more make it begin anew when it is asked again. */
enum { WAY_CUBES = 128 };
/* A part of a ray between the middles of eight cells, of which `first` is the lowest along each axis. */
typedef struct {
    int first[3];
    float begin, end;
    float sum; /* of the integral up to `end` */
} way_cube_t;
/* The integral of the density along a ray, as far as somebody has asked. What it costs to go on is paid once,
 * however often it is asked. */
typedef struct {
    vec3_t from, direction;
    float distance;
    march_t march;
    float begin, end;       /* of the piece at hand, from the cube at hand on */
    float next[3], step[3]; /* where the ray leaves the cube across each axis, and how far it is then */
    int first[3], ahead[3]; /* the cube at hand, and to the next one along each axis: 1 or -1 */
    int left;               /* cubes that the piece may have */
    int count;              /* cubes behind it; only WAY_CUBES are kept */
    way_cube_t cubes[WAY_CUBES];
} way_t;
/* Starts at `from` in the unit direction, for a distance that may be INFINITY. */
void way_begin(way_t *way, const density_t *density, vec3_t from, vec3_t direction, float distance);
/* Makes it a way that began nowhere. */
static inline void way_forget(way_t *way)
{
    way->march.density = NULL;
}
/* True for a way that began like that. */
bool way_is(const way_t *way, const density_t *density, vec3_t from, vec3_t direction, float distance);
/* Where the integral becomes `wanted`: exact but for rounding. False when it does not; *sum is then what it
 * becomes. */
bool way_find(way_t *way, float wanted, float *sum, float *at);

#endif
