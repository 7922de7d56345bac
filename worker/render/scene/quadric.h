/* quadric: spheres, disks and cylinders, whole or in part, under any affine transform.
 *
 * Solved in double precision in their own space, so that light refracted through one meets it exactly. Points
 * and directions are in the space of the shape's object; (u, v) are pbrt's.
 */
#ifndef LIGHTMILL_QUADRIC_H
#define LIGHTMILL_QUADRIC_H

#include "common/scene/scene_blob.h"

typedef struct {
    const blob_quadric_t *record;
    xform_t quadric_from_object;
    double area; /* exact for a rigid transform, of the right size for any other */
    float reach; /* xform_reach of its points */
} quadric_t;

/* A point of it. */
typedef struct {
    vec3_t p;
    vec3_t n; /* away from the axis or centre, of a disk along +z; unit length */
} quadric_point_t;

/* What only textures and turned frames ask for: it takes inverse trigonometry. */
typedef struct {
    vec2_t uv;
    vec3_t dpdu, dpdv;
    vec3_t dndu, dndv;
} quadric_details_t;

void quadric_init(quadric_t *quadric, const blob_quadric_t *record);
/* A box about it. */
void quadric_bounds(const quadric_t *quadric, float low[3], float high[3]);
/* Distances along a ray at which it crosses the quadric, ascending; returns how many there are, up to 2. */
int quadric_crossings(const quadric_t *quadric, vec3_t origin, vec3_t direction, float distances[2]);
/* The point of it nearest to p, which is on it but for rounding. */
void quadric_at(const quadric_t *quadric, vec3_t p, quadric_point_t *point);
void quadric_details(const quadric_t *quadric, vec3_t p, quadric_details_t *details);

/* A point, uniform over the area in the quadric's own space. */
void quadric_sample(const quadric_t *quadric, vec2_t u, quadric_point_t *point);
/* The density per area at that point. */
float quadric_pdf(const quadric_t *quadric, const quadric_point_t *point);

#endif
