/* bdpt: bidirectional path tracing with all strategies of t >= 2 eye and s >= 0 light vertices and of t = 1
 * and s >= 2, combined by the power heuristic (Veach 1997, chapter 10).
 *
 * Path weights in constant time, after van Antwerpen (2011, "Recursive MIS Computation for Streaming BDPT on
 * the GPU") and Georgiev (2012, "Implementing Vertex Connection and Merging"), here with squares for the
 * power heuristic. Number a subpath's vertices i = 0 (on the light, or the camera), 1, 2, ... and let
 *
 *   p_i       density per area of vertex i as its own subpath makes it,
 *   r_i       density per area of vertex i as the opposite subpath would make it,
 *   c_i       1 when the strategy that joins vertices i - 1 and i exists: neither is specular, and for i = 0
 *             the end can be run into (a light can, a pinhole cannot); else 0.
 *
 * Moving the junction towards this end multiplies a path's density by r_i / p_i a vertex, so that its share
 * of the weight is
 *
 *   share_i = (r_i / p_i)^2 (c_i + (r_{i-1} / p_{i-1})^2 (c_{i-1} + ...))
 *
 * r_i depends on what vertex i is joined to, r_{i-1} on the direction in which the path leaves vertex i, and
 * all the rest is known on arrival. With r_{i-1} = q g, q the density per solid angle at vertex i and g the
 * factor from solid angle at i to area at i - 1,
 *
 *   share_i = r_i^2 (direct_i + q^2 inner_i),    direct_i = c_i / p_i^2,
 *   inner_i = g^2 / p_i^2 (direct_{i-1} + q_{i-1}^2 inner_{i-1}).
 *
 * The weight of a connected path is 1 / (1 + share of the light side + share of the eye side). A Dirac lobe
 * has the same probability both ways, so its density cancels in r / p: discrete probabilities stand in for
 * densities.
 *
 * Light vertices are stored first; each eye vertex then gathers its connections, evaluates each before it
 * pays for the shadow ray, and traces the rays of those that carry anything as one packet. (Leaving faint
 * ones to Russian roulette was tried: it saves as much time as it adds noise.)
 */
#include "worker/render/integrator.h"

enum { MAX_VERTICES = JOB_MAX_DEPTH + 2 };

/* Vertex i >= 1 of a subpath. */
typedef struct {
    surface_t surface;
    bsdf_t bsdf;
    vec3_t wo;        /* to vertex i - 1 */
    rgb_t throughput; /* up to here, scattering at this vertex excluded */
    float inv_p2;     /* 1 / p_i^2 */
    float direct;     /* c_i / p_i^2, were vertex i not specular */
    float inner;
} vertex_t;

/* A subpath on its way from vertex i - 1 to vertex i. */
typedef struct {
    transport_t mode;
    vec3_t origin, direction; /* of the ray */
    vec3_t point;             /* vertex i - 1 */
    float cosine;             /* |direction . geometric normal| there */
    rgb_t throughput;
    float pdf;       /* of direction, per steradian */
    float chain;     /* direct_{i-1} + q^2 inner_{i-1} */
    bool joinable;   /* vertex i - 1 is not specular */
    float reference; /* brightness that Russian roulette compares the throughput with */
} walk_t;

/* The candidate connections of one vertex. */
typedef struct {
    segments_t segments;
    rgb_t values[SCENE_PACKET];
    vec2_t rasters[SCENE_PACKET];      /* where t = 1 connections fall */
    uint32_t dimensions[SCENE_PACKET]; /* of the numbers that choose the pixel there */
} bundle_t;

/* One bidirectional sample. */
typedef struct {
    sample_t *sample;
    const stage_t *stage;
    rgb_t radiance;  /* of the eye subpath, so far */
    int light_count; /* stored light vertices: y_1 ... y_count */
    vertex_t light[MAX_VERTICES];
} bidirectional_t;

static inline float square(float x)
{
    return x * x;
}

/* share_i of the head comment for the vertex at the junction; r and q as there. */
static inline float mis_share(const vertex_t *v, float r, float q)
{
    return square(r) * (v->direct + square(q) * v->inner);
}

/* ---- subpaths ------------------------------------------------------------------------------------------ */

/* Moves on to vertex i. False when the ray leaves the scene or its density degenerates. */
static bool walk_arrive(walk_t *walk, const scene_t *scene, film_counts_t *counts, vertex_t *vertex)
{
    counts->rays++;
    if (!scene_intersect(scene, walk->origin, walk->direction, &vertex->surface)) return false;
    float distance2 = v_length2(v_sub(vertex->surface.p, walk->point));
    float cosine = fabsf(v_dot(vertex->surface.ng, walk->direction));
    float p = walk->pdf * cosine / distance2;
    if (!(p > 0x1p-60f) || !(p < 0x1p60f)) return false;
    vertex->wo = v_neg(walk->direction);
    vertex->throughput = walk->throughput;
    vertex->inv_p2 = 1 / square(p);
    vertex->direct = walk->joinable ? vertex->inv_p2 : 0;
    vertex->inner = square(walk->cosine / distance2) * vertex->inv_p2 * walk->chain;
    return true;
}

/* Scatters at the vertex. False when the subpath ends here. */
static bool walk_scatter(walk_t *walk, const vertex_t *vertex, sampler_t *sampler)
{
    bsdf_sample_t next;
    vec2_t u = sampler_2d(sampler), choices = sampler_2d(sampler);
    if (!bsdf_sample(&vertex->bsdf, vertex->wo, u, choices.x, walk->mode, &next)) return false;
    rgb_t throughput = v_mul(vertex->throughput, next.weight);
    if (walk->mode == TRANSPORT_IMPORTANCE)
        throughput = v_scale(throughput, shading_adjoint(&vertex->bsdf, vertex->wo, next.wi));
    float survive = float_min(1, v_max(throughput) / walk->reference);
    if (!(choices.y < survive)) return false;
    walk->throughput = v_scale(throughput, 1 / survive);
    walk->pdf = next.pdf;
    walk->chain = (next.specular ? 0 : vertex->direct) + square(next.pdf_rev) * vertex->inner;
    walk->joinable = !next.specular;
    walk->direction = next.wi;
    walk->point = vertex->surface.p;
    walk->origin = scene_offset(&vertex->surface, next.wi);
    walk->cosine = fabsf(v_dot(vertex->surface.ng, next.wi));
    return true;
}

static walk_t walk_from_camera(const bidirectional_t *b, sampler_t *sampler)
{
    walk_t walk = {.mode = TRANSPORT_RADIANCE, .throughput = vec3(1, 1, 1), .joinable = true, .reference = 1};
    walk.origin = walk.point = b->stage->camera.position;
    walk.direction = sample_eye_ray(b->sample, sampler_2d(sampler), &walk.pdf);
    return walk; /* chain 0: nothing runs into a pinhole */
}

static bool walk_from_light(const bidirectional_t *b, sampler_t *sampler, walk_t *walk)
{
    light_point_t light;
    float choice = sampler_1d(sampler);
    lights_sample(b->stage->lights, choice, sampler_2d(sampler), &light);
    vec3_t direction = light_sample_direction(&light, sampler_2d(sampler));
    float pdf = light_direction_pdf(&light, direction), cosine = fabsf(v_dot(light.n, direction));
    if (!(pdf > 0)) return false;
    *walk = (walk_t){.mode = TRANSPORT_IMPORTANCE,
                     .origin = light_offset(&light, direction),
                     .direction = direction,
                     .point = light.p,
                     .cosine = cosine,
                     .throughput = v_scale(light.radiance, cosine / (pdf * light.pdf_area)),
                     .pdf = pdf,
                     .chain = 1 / square(light.pdf_area),
                     .joinable = true};
    walk->reference = v_max(walk->throughput);
    return true;
}

/* Stores the light vertices that an eye vertex or the camera can be joined to; specular ones are passed
 * through. */
static void trace_light_subpath(bidirectional_t *b, sampler_t *sampler, int *depths)
{
    walk_t walk;
    b->light_count = 0;
    if (lights_empty(b->stage->lights) || !walk_from_light(b, sampler, &walk)) return;
    for (int i = 1; i < stage_max_segments(b->stage); i++) {
        vertex_t *vertex = &b->light[b->light_count];
        sampler->dimension = DIMENSION_LIGHT + (uint32_t)i * DIMENSION_STRIDE;
        if (!walk_arrive(&walk, b->stage->scene, &b->sample->result->counts, vertex)) return;
        bsdf_init(&vertex->bsdf, &vertex->surface);
        depths[b->light_count] = i;
        if (!vertex->bsdf.specular) b->light_count++;
        if (!walk_scatter(&walk, vertex, sampler)) return;
    }
}

/* ---- strategies ---------------------------------------------------------------------------------------- */

/* Adds a candidate, for which there must be room, and returns its place. */
static int bundle_add(bundle_t *bundle, vec3_t from, vec3_t to, rgb_t value)
{
    int n = bundle->segments.count++;
    bundle->segments.from[n] = from;
    bundle->segments.to[n] = to;
    bundle->values[n] = value;
    return n;
}

/* t = 1: joins a light vertex to the camera. */
static void join_camera(const bidirectional_t *b, const vertex_t *y, uint32_t dimension, bundle_t *bundle)
{
    const stage_t *stage = b->stage;
    camera_view_t view;
    bsdf_value_t fy;
    if (!camera_project(&stage->camera, y->surface.p, filter_reach(&stage->filter), &view) ||
        !bsdf_eval(&y->bsdf, y->wo, view.w, TRANSPORT_IMPORTANCE, &fy))
        return;
    float distance2 = square(view.distance);
    float geometry =
        fabsf(v_dot(view.w, y->bsdf.ns)) * shading_adjoint(&y->bsdf, y->wo, view.w) * view.we_cos;
    float r = view.pdf * fabsf(v_dot(view.w, y->surface.ng)) / distance2;
    float weight = 1 / (1 + mis_share(y, r, fy.pdf_rev));
    rgb_t value = v_scale(v_mul(y->throughput, fy.f), geometry / distance2 * weight);
    if (v_is_zero(value)) return;
    int n = bundle_add(bundle, stage->camera.position, scene_offset(&y->surface, view.w), value);
    bundle->rasters[n] = view.raster;
    bundle->dimensions[n] = dimension;
}

static void splat_bundle(bidirectional_t *b, bundle_t *bundle)
{
    int count = bundle->segments.count;
    if (count == 0) return;
    b->sample->result->counts.rays += (uint64_t)count;
    uint32_t occluded = scene_occluded_packet(b->stage->scene, &bundle->segments);
    for (int i = 0; i < count; i++)
        if (!(occluded >> i & 1))
            sample_splat(b->sample, bundle->rasters[i], bundle->values[i], bundle->dimensions[i]);
    bundle->segments.count = 0;
}

/* s = 0: the eye subpath ran into a light. */
static void hit_light(bidirectional_t *b, const vertex_t *z, int segments)
{
    light_point_t light;
    lights_at(b->stage->lights, &z->surface, &light);
    rgb_t radiance = light_radiance(&light, z->wo);
    if (v_is_zero(radiance)) return;
    /* A light seen directly has no other strategy here: t = 1 starts at s = 2. */
    float share = segments == 1 ? 0 : mis_share(z, light.pdf_area, light_direction_pdf(&light, z->wo));
    b->radiance = v_add(b->radiance, v_scale(v_mul(z->throughput, radiance), 1 / (1 + share)));
}

/* s = 1: joins the eye vertex to a fresh point on a light. */
static void join_light(const bidirectional_t *b, const vertex_t *z, sampler_t *sampler, bundle_t *bundle)
{
    light_point_t light;
    float choice = sampler_1d(sampler);
    lights_sample(b->stage->lights, choice, sampler_2d(sampler), &light);
    vec3_t d = v_sub(light.p, z->surface.p);
    float distance2 = v_length2(d);
    if (!(distance2 > 0)) return;
    vec3_t w = v_scale(d, 1 / sqrtf(distance2));
    rgb_t radiance = light_radiance(&light, v_neg(w));
    bsdf_value_t fz;
    if (v_is_zero(radiance) || !bsdf_eval(&z->bsdf, z->wo, w, TRANSPORT_RADIANCE, &fz)) return;
    float cos_light = fabsf(v_dot(light.n, w));
    float r_light = fz.pdf * cos_light / distance2;
    float r_eye = light_direction_pdf(&light, v_neg(w)) * fabsf(v_dot(w, z->surface.ng)) / distance2;
    float weight = 1 / (1 + square(r_light / light.pdf_area) + mis_share(z, r_eye, fz.pdf_rev));
    float factor = fabsf(v_dot(w, z->bsdf.ns)) * cos_light / (distance2 * light.pdf_area) * weight;
    rgb_t value = v_mul(v_scale(v_mul(z->throughput, fz.f), factor), radiance);
    if (v_is_zero(value)) return;
    bundle_add(bundle, scene_offset(&z->surface, w), light_offset(&light, v_neg(w)), value);
}

/* s >= 2, t >= 2: joins an eye vertex to a light vertex. */
static void join_vertices(const vertex_t *z, const vertex_t *y, bundle_t *bundle)
{
    vec3_t d = v_sub(y->surface.p, z->surface.p);
    float distance2 = v_length2(d);
    if (!(distance2 > 0)) return;
    vec3_t w = v_scale(d, 1 / sqrtf(distance2));
    bsdf_value_t fz, fy;
    if (!bsdf_eval(&z->bsdf, z->wo, w, TRANSPORT_RADIANCE, &fz) ||
        !bsdf_eval(&y->bsdf, y->wo, v_neg(w), TRANSPORT_IMPORTANCE, &fy))
        return;
    float r_light = fz.pdf * fabsf(v_dot(w, y->surface.ng)) / distance2;
    float r_eye = fy.pdf * fabsf(v_dot(w, z->surface.ng)) / distance2;
    float weight = 1 / (1 + mis_share(y, r_light, fy.pdf_rev) + mis_share(z, r_eye, fz.pdf_rev));
    float factor = fabsf(v_dot(w, z->bsdf.ns) * v_dot(w, y->bsdf.ns)) *
                   shading_adjoint(&y->bsdf, y->wo, v_neg(w)) / distance2 * weight;
    rgb_t value = v_mul(v_scale(v_mul(z->throughput, fz.f), factor), v_mul(y->throughput, fy.f));
    if (v_is_zero(value)) return;
    bundle_add(bundle, scene_offset(&z->surface, w), scene_offset(&y->surface, v_neg(w)), value);
}

static void gather_bundle(bidirectional_t *b, bundle_t *bundle)
{
    int count = bundle->segments.count;
    if (count == 0) return;
    b->sample->result->counts.rays += (uint64_t)count;
    uint32_t occluded = scene_occluded_packet(b->stage->scene, &bundle->segments);
    for (int i = 0; i < count; i++)
        if (!(occluded >> i & 1)) b->radiance = v_add(b->radiance, bundle->values[i]);
    bundle->segments.count = 0;
}

static rgb_t bdpt_sample(sample_t *sample)
{
    bidirectional_t b;
    bundle_t bundle;
    int depths[MAX_VERTICES];
    b.sample = sample;
    b.stage = sample->stage;
    b.radiance = vec3(0, 0, 0);
    bundle.segments.count = 0;
    int segments = stage_max_segments(b.stage);
    sampler_t lamp = sample_stream(sample, DIMENSION_LIGHT), eye = sample_stream(sample, DIMENSION_EYE);

    trace_light_subpath(&b, &lamp, depths);
    for (int i = 0; i < b.light_count && depths[i] < segments; i++) {
        uint32_t dimension = DIMENSION_LIGHT + (uint32_t)depths[i] * DIMENSION_STRIDE + 2;
        join_camera(&b, &b.light[i], dimension, &bundle);
        if (bundle.segments.count == SCENE_PACKET) splat_bundle(&b, &bundle);
    }
    splat_bundle(&b, &bundle);

    walk_t walk = walk_from_camera(&b, &eye);
    for (int i = 1; i <= segments; i++) {
        vertex_t z;
        eye.dimension = DIMENSION_EYE + (uint32_t)i * DIMENSION_STRIDE;
        if (!walk_arrive(&walk, b.stage->scene, &sample->result->counts, &z)) break;
        if (z.surface.light != BLOB_NONE) hit_light(&b, &z, i);
        if (i == segments) break;
        bsdf_init(&z.bsdf, &z.surface);
        if (!z.bsdf.specular && !lights_empty(b.stage->lights)) {
            join_light(&b, &z, &eye, &bundle);
            for (int k = 0; k < b.light_count && i + depths[k] < segments; k++) {
                join_vertices(&z, &b.light[k], &bundle);
                if (bundle.segments.count == SCENE_PACKET) gather_bundle(&b, &bundle);
            }
            gather_bundle(&b, &bundle);
        }
        eye.dimension = DIMENSION_EYE + (uint32_t)i * DIMENSION_STRIDE + 2;
        if (!walk_scatter(&walk, &z, &eye)) break;
    }
    return b.radiance;
}

const integrator_ops_t integrator_bdpt = {.sample = bdpt_sample, .traces_light = true};
