/* vertex: a place on a path, and what it does with light.
 *
 * A vertex lies on a surface or in a medium, or it is a direction of the sky, where a path ends. Integrators
 * ask the functions below and do not look at the surface. A point in a medium has a phase function for a
 * BSDF, 1 for both cosines and for the adjoint, nothing to be moved off, and the medium itself for what rays
 * enter.
 *
 * What connections ask is inlined, here and in transmittance.h; the two long steps of a walk, which would
 * fill the instruction cache once for each of their callers, are not (subpath.c).
 */
#ifndef LIGHTMILL_VERTEX_H
#define LIGHTMILL_VERTEX_H

#include "worker/render/integrator/transmittance.h"
#include "worker/render/material/material.h"

typedef enum { VERTEX_SKY, VERTEX_SURFACE, VERTEX_MEDIUM } vertex_kind_t;

/* Vertex i >= 1 of a subpath (subpath.h). */
typedef struct {
    surface_t surface; /* of VERTEX_SURFACE; of others its point alone */
    vertex_kind_t kind;
    transport_t mode;    /* of its subpath */
    int depth;           /* i */
    int length, within;  /* as in walk_t */
    float worth;         /* of the strategy that joins it to the one before it, if both are inner ones */
    bool bounds;         /* it lies in a body, or on what parts one from other media */
    bool first;          /* nothing but mirrors and clear glass lies between it and the subpath's start */
    bool twice, other;   /* it lies at the end of one of two flights; of the other one (flights_t) */
    uint32_t dimension;  /* where its random numbers begin */
    blob_ref_t media[2]; /* on the side away from the geometric normal, and on that of it */
    vec3_t wo;           /* unit direction to vertex i - 1 */
    rgb_t throughput;    /* up to here, scattering at this vertex excluded */
    float inv_p2;        /* 1 / p_i^2; this and the next two only for weights (walk_weigh) */
    float direct;        /* c_i / p_i^2, were the vertex not specular */
    float inner;
    float merging; /* m_i eta^2 */
    bsdf_t bsdf;   /* made by vertex_shade; at the end, so that lobes which it does not have need no memory
                      (light_pool.c) */
} vertex_t;

/* Makes the BSDF. `scattered`: the path was scattered before by something that is not specular. */
static inline void vertex_shade(vertex_t *vertex, const sample_t *sample, bool scattered)
{
    const setup_t *setup = sample->setup;
    if (vertex->kind == VERTEX_MEDIUM) {
        media_bsdf(setup->media, vertex->media[0], vertex->wo, &vertex->bsdf);
        return;
    }
    material_bsdf_of(setup->scene, &vertex->surface, sample->waves, &vertex->bsdf);
    if (setup->regularizes && scattered) bsdf_regularize(&vertex->bsdf);
    bsdf_carry(&vertex->bsdf, vertex->throughput);
}

/* Where it is; the sky is nowhere: the vertex before. */
static inline vec3_t vertex_point(const vertex_t *vertex)
{
    return vertex->surface.p;
}

/* False when the vertex cannot be joined to another, but only be passed through. */
static inline bool vertex_is_joinable(const vertex_t *vertex)
{
    return !vertex->bsdf.specular;
}

/* True where only eye subpaths come, and light subpaths end: on the hair of a fibre. Its band faces the ray
 * that meets it, and its BSDF knows at which offset from the middle the eye's ray does. */
static inline bool vertex_is_for_eyes(const vertex_t *vertex)
{
    return vertex->kind == VERTEX_SURFACE && vertex->surface.fibre;
}

/* False when light that arrives nearby says nothing about it; or on the surface of a body, which paths meet
 * so often from within that there would be no bound on the number of photons. */
static inline bool vertex_is_mergeable(const vertex_t *vertex)
{
    return vertex->kind == VERTEX_SURFACE && !vertex->bounds && !vertex_is_for_eyes(vertex) &&
           bsdf_is_broad(&vertex->bsdf) && surface_is_whole(&vertex->surface);
}

/* Light that is scattered between wo and w: as bsdf_eval. */
static inline bool vertex_eval(const vertex_t *vertex, vec3_t w, bsdf_value_t *value)
{
    return bsdf_eval(&vertex->bsdf, vertex->wo, w, vertex->mode, value);
}

/* Draws where light goes on: as bsdf_sample. */
static inline bool vertex_sample(const vertex_t *vertex, vec2_t u, float choice, bsdf_sample_t *next)
{
    return bsdf_sample(&vertex->bsdf, vertex->wo, u, choice, vertex->mode, next);
}

/* The cosine that belongs to the value. */
static inline float vertex_cosine(const vertex_t *vertex, vec3_t w)
{
    return vertex->kind == VERTEX_MEDIUM ? 1 : fabsf(v_dot(w, vertex->bsdf.ns));
}

/* The cosine that belongs to densities: takes those per area across w to those per area of the vertex. */
static inline float vertex_area_cosine(const vertex_t *vertex, vec3_t w)
{
    return vertex->kind == VERTEX_MEDIUM ? 1 : fabsf(v_dot(w, vertex->surface.ng));
}

/* The factor that makes scattering with shading normals the adjoint of itself: on light subpaths values are
 * multiplied by |wo ns| |wi ng| / (|wo ng| |wi ns|) (Veach 1997, section 5.3.2). */
static inline float vertex_adjoint(const vertex_t *vertex, vec3_t w)
{
    if (vertex->kind == VERTEX_MEDIUM) return 1;
    const bsdf_t *bsdf = &vertex->bsdf;
    float num = v_dot(vertex->wo, bsdf->ns) * v_dot(w, bsdf->ng);
    float den = v_dot(vertex->wo, bsdf->ng) * v_dot(w, bsdf->ns);
    return den != 0 ? fabsf(num / den) : 0;
}

/* The point that light in direction w, of any length, comes from: beside a fibre, which its rays start
 * beyond. */
static inline vec3_t vertex_source(const vertex_t *vertex, vec3_t w)
{
    return vertex_is_for_eyes(vertex) ? scene_beside(&vertex->surface, w) : vertex_point(vertex);
}

/* Sets *d to the way of light from there to a point; false when that is nearer, so that no light comes to it.
 */
static inline bool vertex_way_to(const vertex_t *vertex, vec3_t point, vec3_t *d)
{
    vec3_t straight = v_sub(point, vertex_point(vertex));
    *d = v_sub(point, vertex_source(vertex, straight));
    return !vertex_is_for_eyes(vertex) || fabsf(v_dot(straight, vertex->surface.ng)) > vertex->surface.offset;
}

/* Where a ray in direction w starts. */
static inline vec3_t vertex_exit(const vertex_t *vertex, vec3_t w)
{
    return vertex->kind == VERTEX_MEDIUM ? vertex->surface.p : scene_offset(&vertex->surface, w);
}

/* What such a ray enters. */
static inline medium_t vertex_medium(const vertex_t *vertex, vec3_t w)
{
    return (medium_t){bsdf_attenuation(&vertex->bsdf, w), vertex->media[v_dot(w, vertex->bsdf.ng) > 0]};
}

/* The same towards a place on a light. A body has an end, so that no light at infinity shines on its inside;
 * where it has none, it does not dim that. */
static inline medium_t vertex_medium_to(const vertex_t *vertex, const light_view_t *light)
{
    medium_t medium = vertex_medium(vertex, light->w);
    if (light->at_infinity) medium.attenuation = vec3(0, 0, 0);
    return medium;
}

/* What pbrt-v3 does where the geometric and the shading normal disagree about the side of a light, and
 * vertex_eval is black: in its scenes light straight from a light shows on what the camera sees. False when
 * it does not; else sets the value, and the share of it that is shown. That is all of a light that cannot be
 * run into (`delta`). Else pbrt-v3's bdpt counts the scattering that cannot happen as a strategy with the
 * density 1 of the place on the light (of `pdf_place` when drawn as such), and nothing makes up for its part;
 * `ratio`: of the densities of the vertex, as made by the light over as made by the camera. */
bool vertex_eval_split(const vertex_t *vertex, vec3_t w, bool delta, float pdf_place, float ratio,
                       bsdf_value_t *value, float *share);
/* The same where a place on a light is joined to the vertex, which the camera makes with the density `seen`.
 * The densities are those without guides, and by power: what is seen does not depend on what was learned, or
 * on what is near. */
static inline bool vertex_split_light(const vertex_t *vertex, const light_view_t *light, float seen,
                                      bsdf_value_t *value, float *share)
{
    float arrives = light->plain_arrival * vertex_area_cosine(vertex, light->w);
    return vertex_eval_split(vertex, light->w, light->delta,
                             light->pdf_place * light->view_ratio / light->nearness, arrives / seen, value,
                             share);
}

/* How many lights an eye subpath that ends here may have run into. */
static inline uint32_t vertex_light_count(const vertex_t *vertex, const lights_t *lights)
{
    if (vertex->kind == VERTEX_SKY) return lights_sky_count(lights);
    return vertex->kind == VERTEX_SURFACE && vertex->surface.light != BLOB_NONE;
}
/* The k-th of them as seen from the vertex before, which is at `from`; false when it is dark. */
bool vertex_light_hit(const vertex_t *vertex, const sample_t *sample, uint32_t k, vec3_t from,
                      light_hit_t *hit);

/* Places on lights that the vertex of an eye subpath is joined to. */
static inline uint32_t vertex_view_count(const vertex_t *vertex, const lights_t *lights)
{
    return vertex->first ? lights_first_count(lights) : 1;
}
/* A number below 2 within [0, 1). */
static inline float wrap(float u)
{
    return u < 1 ? u : u - 1;
}
/* Draws the k-th of them; false when it does not light the vertex. */
static inline bool vertex_view_light(const vertex_t *vertex, const sample_t *sample, uint32_t k,
                                     light_view_t *view)
{
    const lights_t *lights = sample->setup->lights;
    sampler_t sampler = sample_stream(sample, vertex->dimension + DIMENSION_ILLUMINATE);
    float choice = sampler_1d(&sampler);
    if (!vertex->first) {
        if (!lights_illuminate(lights, vertex_point(vertex), choice, sampler_2d(&sampler), view))
            return false;
    } else {
        vec2_t place = sample_2d(sample, DIMENSION_FIRST_LIGHTS + lights_first_pair(lights, k));
        if (vertex->other) place = (vec2_t){wrap(place.x + 0.618034f), wrap(place.y + 0.754878f)};
        if (!lights_illuminate_first(lights, k, vertex_point(vertex), choice, place, view)) return false;
    }
    view->radiance = sample_light(sample, view->light, view->radiance);
    return true;
}

/* Notes the vertex as what the eye ray from `origin` met first, for the samples whose features count. */
void vertex_first_hit(const vertex_t *vertex, sample_t *sample, vec3_t origin);

#endif
