/* grid: what the tessellations share: three-vectors in double precision, and quads of a parameter grid. */
#ifndef LIGHTMILL_GRID_H
#define LIGHTMILL_GRID_H

#include "client/import/scene/mesh.h"

typedef struct {
    double x, y, z;
} dvec3_t;

static inline dvec3_t d_vec3(const double *numbers)
{
    return (dvec3_t){numbers[0], numbers[1], numbers[2]};
}
static inline dvec3_t d_add(dvec3_t a, dvec3_t b)
{
    return (dvec3_t){a.x + b.x, a.y + b.y, a.z + b.z};
}
static inline dvec3_t d_sub(dvec3_t a, dvec3_t b)
{
    return (dvec3_t){a.x - b.x, a.y - b.y, a.z - b.z};
}
static inline dvec3_t d_scale(dvec3_t a, double s)
{
    return (dvec3_t){a.x * s, a.y * s, a.z * s};
}
/* a + s b */
static inline dvec3_t d_mad(dvec3_t a, double s, dvec3_t b)
{
    return (dvec3_t){a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}
static inline dvec3_t d_lerp(double t, dvec3_t a, dvec3_t b)
{
    return d_mad(d_scale(a, 1 - t), t, b);
}
static inline dvec3_t d_cross(dvec3_t a, dvec3_t b)
{
    return (dvec3_t){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline double d_length(dvec3_t a)
{
    return sqrt(a.x * a.x + a.y * a.y + a.z * a.z);
}
static inline vec3_t d_to_float(dvec3_t a)
{
    return vec3((float)a.x, (float)a.y, (float)a.z);
}
/* The unit vector along a, or (0, 0, 0) where there is none. */
static inline vec3_t d_direction(dvec3_t a)
{
    double length = d_length(a);
    return length > 0 && isfinite(length) ? d_to_float(d_scale(a, 1 / length)) : vec3(0, 0, 0);
}

/* Room for the mesh's arrays; counts start at 0. */
void mesh_reserve(mesh_t *mesh, size_t vertices, size_t triangles, bool normals, bool uvs);

/* Appends the triangle; its room was reserved. One with two corners at the same place is passed over: such
 * are the poles of a parametrisation, which are no flaw worth a warning. */
void mesh_triangle(mesh_t *mesh, uint32_t a, uint32_t b, uint32_t c);

/* Appends the triangles of a grid of columns x rows vertices that begins at vertex `first`, u running
 * fastest: of each quad (u v), (u+1 v), (u+1 v+1) and (u v), (u+1 v+1), (u v+1). Twice (columns - 1) (rows -
 * 1) fit. */
void mesh_grid(mesh_t *mesh, uint32_t first, uint32_t columns, uint32_t rows);

/* An index of a scene file as an integer below `limit`, or an error that names it as number `place`. */
result_t take_index(double index, size_t limit, size_t place, position_t at, uint32_t *out);

#endif
