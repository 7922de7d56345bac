/* bsdf: how a surface scatters light. One interface for eye and light subpaths.
 *
 * wo points to where the path comes from, wi to where it goes; both leave the surface, of unit length, in
 * world space. What differs between the subpaths is only the transport mode, which matters where a BSDF is
 * not symmetric (refraction scales radiance by the squared ratio of indices, Veach 1997, section 5.2), and
 * the shading-normal correction, which the integrators apply (Veach 1997, section 5.3).
 *
 * Densities are per solid angle, except those of specular (Dirac) lobes, which are discrete probabilities.
 * Cosines are those to the shading normal; which side of the surface a direction is on is told by the
 * geometric normal, so that light does not leak through.
 *
 * A new material is one file and one entry in the table in bsdf.c.
 */
#ifndef LIGHTMILL_RENDER_BSDF_H
#define LIGHTMILL_RENDER_BSDF_H

#include "worker/render/scene.h"

/* What is carried: an eye subpath carries importance and meets RADIANCE; a light subpath the reverse. */
typedef enum { TRANSPORT_RADIANCE, TRANSPORT_IMPORTANCE } transport_t;

/* A BSDF at a point: the material with the frame in which it is evaluated. */
typedef struct {
    const blob_material_t *material;
    vec3_t ng, ns, s, t; /* geometric normal; shading frame (s, t, ns) */
    bool specular;       /* only Dirac lobes: cannot be connected to */
} bsdf_t;

typedef struct {
    rgb_t f;       /* value, without cosine, per steradian */
    float pdf;     /* of choosing wi given wo, per steradian */
    float pdf_rev; /* of choosing wo given wi */
} bsdf_value_t;

typedef struct {
    vec3_t wi;
    rgb_t weight;  /* f |cos| / pdf, Dirac lobes likewise */
    float pdf;     /* of wi given wo: per steradian, or a probability when specular */
    float pdf_rev; /* of wo given wi */
    bool specular;
} bsdf_sample_t;

/* Sets up the frame at a surface point. */
void bsdf_init(bsdf_t *bsdf, const surface_t *surface);
/* Evaluates the lobes that are not specular. False when the value is zero; *value is then undefined. */
bool bsdf_eval(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, transport_t mode, bsdf_value_t *value);
/* Draws wi in proportion to the density that bsdf_eval returns, or a specular direction. `u` are two uniform
 * numbers for the direction, `choice` one for the lobe. False when there is nothing to follow. */
bool bsdf_sample(const bsdf_t *bsdf, vec3_t wo, vec2_t u, float choice, transport_t mode,
                 bsdf_sample_t *sample);

/* A world direction in shading coordinates (s, t, ns), and back. */
static inline vec3_t bsdf_to_local(const bsdf_t *bsdf, vec3_t v)
{
    return vec3(v_dot(v, bsdf->s), v_dot(v, bsdf->t), v_dot(v, bsdf->ns));
}
static inline vec3_t bsdf_to_world(const bsdf_t *bsdf, vec3_t v)
{
    return v_add(v_add(v_scale(bsdf->s, v.x), v_scale(bsdf->t, v.y)), v_scale(bsdf->ns, v.z));
}

/* One kind of material. eval is as bsdf_eval; `reflect` tells that wo and wi are on the same side of the
 * geometric surface; NULL for kinds that are purely specular. sample is as bsdf_sample in shading
 * coordinates, wo.z not 0. */
typedef struct {
    bool (*eval)(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value);
    bool (*sample)(const blob_material_t *material, vec3_t wo, vec2_t u, float choice, transport_t mode,
                   bsdf_sample_t *sample);
} bsdf_kind_t;

extern const bsdf_kind_t bsdf_diffuse, bsdf_mirror, bsdf_dielectric, bsdf_conductor;

#endif
