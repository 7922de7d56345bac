/* tessellate: triangle meshes for pbrt's shapes that the renderer does not intersect itself.
 *
 * Each function takes the numbers of one shape, as the scene file gives them, and fills an empty mesh_t in
 * the shape's own space: no transform and no ReverseOrientation is applied. The caller frees the mesh, also
 * after an error. The parametrisation, and so uv and the side that is out, is pbrt's: where a mesh has vertex
 * normals they are dp/du x dp/dv, and (p1 - p0) x (p2 - p0) of its triangles agrees with them; of loopsubdiv
 * alone see below. Vertices are computed in double precision and rounded once. Arrays are only read.
 *
 * Errors are RESULT_INPUT and name `at`, the shape in the scene file. Whatever the numbers are, a mesh stays
 * below TESSELLATE_MAX_TRIANGLES. Vertices that overflow to infinity are left to mesh_add, which refuses
 * them.
 */
#ifndef LIGHTMILL_TESSELLATE_H
#define LIGHTMILL_TESSELLATE_H

#include "client/import/scene/mesh.h"

#define TESSELLATE_MAX_TRIANGLES ((uint32_t)1 << 26)

/* ---- surfaces of revolution about z (pbrt-v3); phi_max in degrees, over 0, clamped to 360 ------------- */

enum { TESSELLATE_COLUMNS = 256, TESSELLATE_ROWS = 64 };

/* From the circle of `radius` about the origin in z = 0 to the apex at z = height; uv = (phi / phi_max,
 * z / height); normals point outward. Defaults of pbrt: 1, 1, 360. */
typedef struct {
    double radius, height, phi_max;
} cone_t;

/* z = z_max (x^2 + y^2) / radius^2 between z_min and z_max, in either order; uv = (phi / phi_max, (z - z_min)
 * / (z_max - z_min)); normals point away from the axis. Defaults of pbrt: 1, 0, 1, 360. */
typedef struct {
    double radius, z_min, z_max, phi_max;
} paraboloid_t;

/* The segment from p1 to p2 swept about z; uv = (phi / phi_max, position on the segment). As in pbrt, the
 * ends change places when p2 lies in z = 0. Defaults of pbrt: (0 0 0), (1 1 1), 360. */
typedef struct {
    double p1[3], p2[3];
    double phi_max;
} hyperboloid_t;

result_t tessellate_cone(const cone_t *cone, position_t at, mesh_t *mesh);
result_t tessellate_paraboloid(const paraboloid_t *paraboloid, position_t at, mesh_t *mesh);
result_t tessellate_hyperboloid(const hyperboloid_t *hyperboloid, position_t at, mesh_t *mesh);

/* ---- subdivision surfaces ----------------------------------------------------------------------------- */

enum { LOOP_MAX_LEVELS = 10, LOOP_FREE_LEVELS = 3 };
/* Beyond LOOP_FREE_LEVELS; so that a few numbers cannot ask for gigabytes. */
#define LOOP_MAX_TRIANGLES ((uint32_t)1 << 24)

/* The limit surface of Loop subdivision, sampled at the vertices of the mesh after `levels` refinements:
 * 4^levels triangles for each of the control mesh, without uv. The control mesh must be a manifold whose
 * triangles all turn the same way; it may have boundaries. Vertices that no triangle uses are left out.
 *
 * The normals point to the side from which the control triangles are seen clockwise, AGAINST (p1 - p0) x
 * (p2 - p0): pbrt-v3 and v4 go about a vertex clockwise, so their limit normals do. Default of pbrt: 3 levels
 * ("nlevels" in v3, "levels" in v4). */
typedef struct {
    const double *positions; /* 3 numbers a vertex */
    size_t vertex_count;
    const double *indices; /* integers, three a triangle */
    size_t index_count;
    double levels; /* an integer from 0 to LOOP_MAX_LEVELS */
} loop_t;

result_t tessellate_loop(const loop_t *loop, position_t at, mesh_t *mesh);

/* ---- grids -------------------------------------------------------------------------------------------- */

/* Heights over [0, 1]^2: nu x nv of them, u (x) running fastest; uv = (x, y); no normals. */
typedef struct {
    double nu, nv;         /* integers of at least 2 */
    const double *heights; /* Pz */
    size_t height_count;
} heightfield_t;

result_t tessellate_heightfield(const heightfield_t *field, position_t at, mesh_t *mesh);

/* Bilinear patches (pbrt-v4): p(u, v) through p00, p10, p01, p11, the four vertices of each, in this order. A
 * parallelogram becomes two triangles, any other patch a grid whose triangles stay within 1/4096 of its
 * longest edge of the surface. uv is (u, v) where none is given. Where no normals are given they are the
 * surface's, or none when all patches are parallelograms. */
typedef struct {
    const double *positions; /* 3 numbers a vertex */
    size_t vertex_count;
    const double *normals; /* 3 numbers a vertex, or NULL */
    size_t normal_count;
    const double *uvs; /* 2 numbers a vertex, or NULL */
    size_t uv_count;
    const double *indices; /* integers, four a patch; NULL for one patch of four vertices */
    size_t index_count;
} bilinear_t;

result_t tessellate_bilinear(const bilinear_t *bilinear, position_t at, mesh_t *mesh);

/* ---- NURBS -------------------------------------------------------------------------------------------- */

enum { NURBS_DICE = 30, NURBS_MAX_ORDER = 64 };

/* A rational B-spline surface (pbrt-v3), evaluated at NURBS_DICE x NURBS_DICE evenly spaced parameters; uv =
 * (u, v) themselves, not scaled to [0, 1]. */
typedef struct {
    double order;        /* degree + 1: an integer from 2 to NURBS_MAX_ORDER */
    double count;        /* control points along this parameter; an integer of at least `order` */
    const double *knots; /* not decreasing */
    size_t knot_count;   /* count + order */
    bool has_range;      /* false: all that the knots allow, from knots[order - 1] to knots[count] */
    double range[2];     /* u0 and u1; may run backward */
} nurbs_axis_t;

typedef struct {
    nurbs_axis_t u, v;
    const double *points; /* u runs fastest */
    size_t number_count;  /* numbers in points: u.count * v.count * (3 or 4) */
    bool rational;        /* points are "Pw": (w x, w y, w z, w); else "P": (x, y, z) */
} nurbs_t;

result_t tessellate_nurbs(const nurbs_t *nurbs, position_t at, mesh_t *mesh);

#endif
