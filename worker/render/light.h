/* light: the emitters of a scene, chosen in proportion to their power.
 *
 * The unit of choice is a primitive: one triangle of an emissive mesh, or a sphere; an alias table makes the
 * choice O(1) (Vose 1991). Since a triangle is chosen in proportion to area x luminance and then sampled
 * uniformly by area, the density per area at a point depends on its light alone: next-event estimation, light
 * subpaths and the weights of paths that run into a light all use that one number.
 */
#ifndef LIGHTMILL_RENDER_LIGHT_H
#define LIGHTMILL_RENDER_LIGHT_H

#include "worker/render/scene.h"

typedef struct lights lights_t;

/* A point on a light. */
typedef struct {
    vec3_t p;
    vec3_t n;     /* unit normal on the emitting side */
    float offset; /* as surface_t.offset */
    rgb_t radiance;
    float pdf_area; /* of having chosen this point, per area */
    bool two_sided;
} light_point_t;

/* Tables for the lights of a blob, which must outlive them. A scene without (bright) lights gives empty
 * tables. */
lights_t *lights_new(const scene_blob_t *blob);
/* Frees the tables and sets *lights to NULL. */
void lights_destroy(lights_t **lights);
/* True when there is nothing to sample. */
bool lights_empty(const lights_t *lights);

/* Draws a point by power and area: `choice` picks the primitive, `u` the point on it. */
void lights_sample(const lights_t *lights, float choice, vec2_t u, light_point_t *point);
/* The same data for a point that a path ran into; surface->light is a light. */
void lights_at(const lights_t *lights, const surface_t *surface, light_point_t *point);

/* Radiance that leaves the point in the unit direction w. */
static inline rgb_t light_radiance(const light_point_t *point, vec3_t w)
{
    return point->two_sided || v_dot(point->n, w) > 0 ? point->radiance : vec3(0, 0, 0);
}
/* Density, per steradian, with which light_sample_direction draws w. */
static inline float light_direction_pdf(const light_point_t *point, vec3_t w)
{
    float cos = v_dot(point->n, w);
    return point->two_sided ? fabsf(cos) * (0.5f * INV_PI_F) : float_max(0, cos) * INV_PI_F;
}
/* The point moved off its light, to the side to which `direction` points. */
static inline vec3_t light_offset(const light_point_t *point, vec3_t direction)
{
    float side = v_dot(point->n, direction) < 0 ? -point->offset : point->offset;
    return v_mad(point->p, side, point->n);
}
/* Draws a direction of emission from `u`, by cosine; for two-sided lights each side half of the time. */
vec3_t light_sample_direction(const light_point_t *point, vec2_t u);

#endif
