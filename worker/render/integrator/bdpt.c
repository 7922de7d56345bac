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
 * factor from solid angle at i to area at i - 1 (a ray that comes from infinity, or from an orthographic
 * camera, has a density per area across it instead, and no distance in g),
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
 *
 * A job may ask for one strategy alone, with its weight or without (job_settings_t): Veach's pyramid.
 */
#include "worker/render/integrator/integrator.h"

enum { MAX_VERTICES = JOB_MAX_DEPTH + 2 };
/* The scattering from which on Russian roulette ends subpaths: sooner adds more noise than it saves time. */
enum { ROULETTE_FROM = 3 };

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
    float cosine;             /* |direction . geometric normal| there; 1 where there is none */
    rgb_t throughput;
    float pdf;         /* of the ray: per steradian, of parallel rays per area across */
    float chain;       /* direct_{i-1} + q^2 inner_{i-1} */
    bool joinable;     /* vertex i - 1 is not specular */
    bool parallel;     /* vertex i - 1 is at infinity, or the camera orthographic */
    bool scattered;    /* by something that is not specular */
    rgb_t attenuation; /* per unit length along the ray */
    int scatterings;   /* so far */
    float reference;   /* brightness that Russian roulette compares the throughput with */
} walk_t;

/* The candidate connections of one vertex. */
typedef struct {
    segments_t segments;
    rgb_t values[SCENE_PACKET];
    vec2_t rasters[SCENE_PACKET];      /* where t = 1 connections fall */
    uint32_t dimensions[SCENE_PACKET]; /* of the vertices they come from */
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

/* share_i of the head comment, all as there. */
static inline float share_of(float direct, float inner, float r, float q)
{
    return square(r) * (direct + square(q) * inner);
}

/* That of the vertex at the junction. */
static inline float mis_share(const vertex_t *v, float r, float q)
{
    return share_of(v->direct, v->inner, r, q);
}

/* True when the job wants the strategy of s light and t eye vertices. */
static inline bool is_wanted(const bidirectional_t *b, int s, int t)
{
    const job_settings_t *settings = &b->stage->settings;
    return settings->strategy_t == 0 || (settings->strategy_t == t && settings->strategy_s == s);
}

static inline float weight_of(const bidirectional_t *b, float shares)
{
    return b->stage->settings.unweighted ? 1 : 1 / (1 + shares);
}

/* ---- subpaths ------------------------------------------------------------------------------------------ */

/* Moves on to vertex i. False when the ray leaves the scene (*escaped) or its density degenerates. */
static bool walk_arrive(walk_t *walk, sample_t *sample, vertex_t *vertex, bool *escaped)
{
    const scene_t *scene = sample->stage->scene;
    sample->result->counts.rays++;
    *escaped = !scene_intersect(scene, walk->origin, walk->direction, sample->time, &vertex->surface);
    if (*escaped) return false;
    float distance2 = walk->parallel ? 1 : v_length2(v_sub(vertex->surface.p, walk->point));
    float cosine = fabsf(v_dot(vertex->surface.ng, walk->direction));
    float p = walk->pdf * cosine / distance2;
    if (!(p > 0x1p-60f) || !(p < 0x1p60f)) return false;
    vertex->wo = v_neg(walk->direction);
    vertex->throughput = walk->throughput;
    if (!v_is_zero(walk->attenuation))
        vertex->throughput = v_mul(vertex->throughput, rgb_fade(walk->attenuation, sqrtf(distance2)));
    vertex->inv_p2 = 1 / square(p);
    vertex->direct = walk->joinable ? vertex->inv_p2 : 0;
    vertex->inner = square(walk->cosine / distance2) * vertex->inv_p2 * walk->chain;
    return true;
}

static void make_bsdf(const walk_t *walk, const stage_t *stage, vertex_t *vertex)
{
    bsdf_init(&vertex->bsdf, stage->scene, &vertex->surface);
    if (stage->regularizes && walk->scattered) bsdf_regularize(&vertex->bsdf);
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
    walk->scatterings++;
    float survive = walk->scatterings < ROULETTE_FROM ? 1 : float_min(1, v_max(throughput) / walk->reference);
    if (!(choices.y < survive)) return false;
    walk->throughput = v_scale(throughput, 1 / survive);
    walk->pdf = next.pdf;
    walk->chain = (next.specular ? 0 : vertex->direct) + square(next.pdf_rev) * vertex->inner;
    walk->joinable = !next.specular;
    walk->parallel = false;
    walk->scattered = walk->scattered || !next.specular;
    walk->direction = next.wi;
    walk->point = vertex->surface.p;
    walk->origin = scene_offset(&vertex->surface, next.wi);
    walk->cosine = fabsf(v_dot(vertex->surface.ng, next.wi));
    walk->attenuation = bsdf_attenuation(&vertex->bsdf, next.wi);
    return true;
}

static walk_t walk_from_camera(const bidirectional_t *b)
{
    camera_ray_t ray;
    sample_eye_ray(b->sample, &ray);
    return (walk_t){.mode = TRANSPORT_RADIANCE,
                    .origin = ray.origin,
                    .direction = ray.direction,
                    .point = ray.origin,
                    .cosine = 1,
                    .throughput = vec3(1, 1, 1),
                    .pdf = ray.pdf,
                    .joinable = true,
                    .parallel = ray.parallel,
                    .reference = 1}; /* chain 0: nothing runs into a camera */
}

static bool walk_from_light(const bidirectional_t *b, walk_t *walk)
{
    light_ray_t ray;
    sampler_t sampler = sample_stream(b->sample, DIMENSION_LIGHT + DIMENSION_EMIT);
    float choice = sampler_1d(&sampler);
    vec2_t place = sampler_2d(&sampler);
    if (!lights_emit(b->stage->lights, choice, place, sampler_2d(&sampler), &ray)) return false;
    *walk = (walk_t){.mode = TRANSPORT_IMPORTANCE,
                     .origin = ray.origin,
                     .direction = ray.direction,
                     .point = ray.point,
                     .cosine = ray.cosine,
                     .throughput = ray.throughput,
                     .pdf = ray.pdf_ray,
                     .chain = ray.delta ? 0 : 1 / square(ray.pdf_place),
                     .joinable = true,
                     .parallel = ray.at_infinity,
                     .reference = v_max(ray.throughput)};
    return true;
}

/* Where the numbers of vertex i of the light subpath begin. */
static uint32_t light_dimension(int i)
{
    return DIMENSION_LIGHT + (uint32_t)i * DIMENSION_STRIDE;
}

/* Stores the light vertices that an eye vertex or the camera can be joined to; specular ones are passed
 * through. */
static void trace_light_subpath(bidirectional_t *b, int *depths)
{
    walk_t walk;
    b->light_count = 0;
    if (lights_empty(b->stage->lights) || !walk_from_light(b, &walk)) return;
    for (int i = 1; i < stage_max_segments(b->stage); i++) {
        bool escaped;
        vertex_t *vertex = &b->light[b->light_count];
        if (!walk_arrive(&walk, b->sample, vertex, &escaped)) return;
        make_bsdf(&walk, b->stage, vertex);
        depths[b->light_count] = i;
        if (!vertex->bsdf.specular) b->light_count++;
        sampler_t sampler = sample_stream(b->sample, light_dimension(i) + DIMENSION_LIGHT_SCATTER);
        if (!walk_scatter(&walk, vertex, &sampler)) return;
    }
}

/* ---- strategies ---------------------------------------------------------------------------------------- */

/* Adds a candidate, for which there must be room, and returns its place. */
static int bundle_add(bundle_t *bundle, vec3_t from, vec3_t to, rgb_t value)
{
    int n = bundle->segments.count++;
    segments_set(&bundle->segments, n, from, to);
    bundle->values[n] = value;
    return n;
}

/* t = 1: joins a light vertex to the camera. */
static void join_camera(const bidirectional_t *b, const vertex_t *y, uint32_t dimension, bundle_t *bundle)
{
    camera_view_t view;
    bsdf_value_t fy;
    if (!sample_join_camera(b->sample, y->surface.p, dimension, &view) ||
        !bsdf_eval(&y->bsdf, y->wo, view.w, TRANSPORT_IMPORTANCE, &fy))
        return;
    float r = view.density * fabsf(v_dot(view.w, y->surface.ng));
    float weight = weight_of(b, mis_share(y, r, fy.pdf_rev));
    float factor = fabsf(v_dot(view.w, y->bsdf.ns)) * shading_adjoint(&y->bsdf, y->wo, view.w) * view.density;
    rgb_t value = v_scale(v_mul(y->throughput, fy.f), factor * weight);
    if (y->bsdf.absorbs)
        value = v_mul(value, rgb_fade(bsdf_attenuation(&y->bsdf, view.w),
                                      v_length(v_sub(view.position, y->surface.p))));
    if (v_is_zero(value)) return;
    int n = bundle_add(bundle, view.position, scene_offset(&y->surface, view.w), value);
    bundle->rasters[n] = view.raster;
    bundle->dimensions[n] = dimension;
}

static uint32_t trace_bundle(bidirectional_t *b, bundle_t *bundle)
{
    bundle->segments.time = b->sample->time;
    b->sample->result->counts.rays += (uint64_t)bundle->segments.count;
    return scene_occluded_packet(b->stage->scene, &bundle->segments);
}

static void splat_bundle(bidirectional_t *b, bundle_t *bundle)
{
    int count = bundle->segments.count;
    if (count == 0) return;
    uint32_t occluded = trace_bundle(b, bundle);
    for (int i = 0; i < count; i++)
        if (!(occluded >> i & 1))
            sample_splat(b->sample, bundle->rasters[i], bundle->values[i], bundle->dimensions[i]);
    bundle->segments.count = 0;
}

static void gather_bundle(bidirectional_t *b, bundle_t *bundle)
{
    int count = bundle->segments.count;
    if (count == 0) return;
    uint32_t occluded = trace_bundle(b, bundle);
    for (int i = 0; i < count; i++)
        if (!(occluded >> i & 1)) b->radiance = v_add(b->radiance, bundle->values[i]);
    bundle->segments.count = 0;
}

/* s = 0: the eye subpath, of so many segments, ran into a light. What is seen directly has no other strategy
 * here: t = 1 starts at s = 2. */
static void add_light_hit(bidirectional_t *b, rgb_t throughput, rgb_t radiance, float share, int segments)
{
    float weight = weight_of(b, segments == 1 ? 0 : share);
    b->radiance = v_add(b->radiance, v_scale(v_mul(throughput, radiance), weight));
}

static void hit_light(bidirectional_t *b, const vertex_t *z, int segments)
{
    light_hit_t hit;
    if (!lights_hit(b->stage->lights, &z->surface, z->wo, &hit)) return;
    add_light_hit(b, z->throughput, hit.radiance, mis_share(z, hit.pdf_place, hit.pdf_ray), segments);
}

/* The same where the eye subpath left the scene: its last vertex is a direction of the sky. */
static void hit_sky(bidirectional_t *b, const walk_t *walk, int segments)
{
    float inv_p2 = 1 / square(walk->pdf);
    float direct = walk->joinable ? inv_p2 : 0, inner = square(walk->cosine) * inv_p2 * walk->chain;
    for (uint32_t k = 0; k < lights_sky_count(b->stage->lights); k++) {
        light_hit_t hit;
        if (!lights_escape(b->stage->lights, k, walk->direction, &hit)) continue;
        float share = share_of(direct, inner, hit.pdf_place, hit.pdf_ray);
        add_light_hit(b, walk->throughput, hit.radiance, share, segments);
    }
}

/* s = 1: joins the eye vertex to a fresh place on a light. */
static void join_light(const bidirectional_t *b, const vertex_t *z, int i, sampler_t *sampler,
                       bundle_t *bundle)
{
    light_view_t light;
    bsdf_value_t fz;
    float choice = sampler_1d(sampler), weight;
    if (!lights_illuminate(b->stage->lights, z->surface.p, choice, sampler_2d(sampler), &light)) return;
    float r_eye = light.arrival * fabsf(v_dot(light.w, z->surface.ng));
    if (bsdf_eval(&z->bsdf, z->wo, light.w, TRANSPORT_RADIANCE, &fz)) {
        float light_share = light.delta ? 0 : square(fz.pdf * light.geometry / light.pdf_place);
        weight = weight_of(b, light_share + mis_share(z, r_eye, fz.pdf_rev));
    } else if (i == 1 && splits_direct_light(&z->surface) &&
               bsdf_eval_split(&z->bsdf, z->wo, light.w, TRANSPORT_RADIANCE, &fz)) {
        weight = split_light_share(light.delta, light.pdf_place, r_eye * sqrtf(z->inv_p2));
    } else {
        return;
    }
    float factor = fabsf(v_dot(light.w, z->bsdf.ns)) * light.geometry / light.pdf_place * weight;
    rgb_t value = v_mul(v_scale(v_mul(z->throughput, fz.f), factor), light.radiance);
    if (z->bsdf.absorbs)
        value = v_mul(value, rgb_fade(bsdf_attenuation(&z->bsdf, light.w),
                                      v_length(v_sub(light.target, z->surface.p))));
    if (v_is_zero(value)) return;
    bundle_add(bundle, scene_offset(&z->surface, light.w), light.target, value);
}

/* s >= 2, t >= 2: joins an eye vertex to a light vertex. */
static void join_vertices(const bidirectional_t *b, const vertex_t *z, const vertex_t *y, bundle_t *bundle)
{
    vec3_t d = v_sub(y->surface.p, z->surface.p);
    float distance2 = v_length2(d);
    if (!(distance2 > 0)) return;
    float distance = sqrtf(distance2);
    vec3_t w = v_scale(d, 1 / distance);
    bsdf_value_t fz, fy;
    if (!bsdf_eval(&z->bsdf, z->wo, w, TRANSPORT_RADIANCE, &fz) ||
        !bsdf_eval(&y->bsdf, y->wo, v_neg(w), TRANSPORT_IMPORTANCE, &fy))
        return;
    float r_light = fz.pdf * fabsf(v_dot(w, y->surface.ng)) / distance2;
    float r_eye = fy.pdf * fabsf(v_dot(w, z->surface.ng)) / distance2;
    float weight = weight_of(b, mis_share(y, r_light, fy.pdf_rev) + mis_share(z, r_eye, fz.pdf_rev));
    float factor = fabsf(v_dot(w, z->bsdf.ns) * v_dot(w, y->bsdf.ns)) *
                   shading_adjoint(&y->bsdf, y->wo, v_neg(w)) / distance2 * weight;
    rgb_t value = v_mul(v_scale(v_mul(z->throughput, fz.f), factor), v_mul(y->throughput, fy.f));
    if (z->bsdf.absorbs) value = v_mul(value, rgb_fade(bsdf_attenuation(&z->bsdf, w), distance));
    if (v_is_zero(value)) return;
    bundle_add(bundle, scene_offset(&z->surface, w), scene_offset(&y->surface, v_neg(w)), value);
}

/* Everything that joins eye vertex i to the lights. */
static void join_eye_vertex(bidirectional_t *b, const vertex_t *z, int i, const int *depths, bundle_t *bundle)
{
    int segments = stage_max_segments(b->stage);
    sampler_t sampler =
        sample_stream(b->sample, DIMENSION_EYE + (uint32_t)i * DIMENSION_STRIDE + DIMENSION_ILLUMINATE);
    if (is_wanted(b, 1, i + 1)) join_light(b, z, i, &sampler, bundle);
    for (int k = 0; k < b->light_count && i + depths[k] < segments; k++) {
        if (is_wanted(b, depths[k] + 1, i + 1)) join_vertices(b, z, &b->light[k], bundle);
        if (bundle->segments.count == SCENE_PACKET) gather_bundle(b, bundle);
    }
    gather_bundle(b, bundle);
}

static rgb_t bdpt_sample(sample_t *sample)
{
    bidirectional_t b;
    bundle_t bundle;
    int depths[MAX_VERTICES];
    b.sample = sample;
    b.stage = sample->stage;
    b.radiance = vec3(0, 0, 0);
    bundle.segments = (segments_t){0};
    int segments = stage_max_segments(b.stage);

    trace_light_subpath(&b, depths);
    for (int i = 0; i < b.light_count && depths[i] < segments; i++) {
        if (is_wanted(&b, depths[i] + 1, 1))
            join_camera(&b, &b.light[i], light_dimension(depths[i]), &bundle);
        if (bundle.segments.count == SCENE_PACKET) splat_bundle(&b, &bundle);
    }
    splat_bundle(&b, &bundle);

    walk_t walk = walk_from_camera(&b);
    vec3_t eye = walk.origin;
    for (int i = 1; i <= segments; i++) {
        vertex_t z;
        bool escaped;
        if (!walk_arrive(&walk, sample, &z, &escaped)) {
            if (escaped && is_wanted(&b, 0, i + 1)) hit_sky(&b, &walk, i);
            break;
        }
        if (z.surface.light != BLOB_NONE && is_wanted(&b, 0, i + 1)) hit_light(&b, &z, i);
        if (i == segments && i > 1) break;
        make_bsdf(&walk, b.stage, &z);
        if (i == 1) sample_first_hit(sample, &z.surface, &z.bsdf, eye);
        if (i == segments) break;
        if (!z.bsdf.specular && !lights_empty(b.stage->lights)) join_eye_vertex(&b, &z, i, depths, &bundle);
        sampler_t sampler =
            sample_stream(sample, DIMENSION_EYE + (uint32_t)i * DIMENSION_STRIDE + DIMENSION_SCATTER);
        if (!walk_scatter(&walk, &z, &sampler)) break;
    }
    return b.radiance;
}

const integrator_ops_t integrator_bdpt = {.sample = bdpt_sample, .traces_light = true};
