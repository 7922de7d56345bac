/* bdpt: bidirectional path tracing, and vcm: the same with vertex merging.
 *
 * bdpt has all strategies of t >= 2 eye and s >= 0 light vertices and of t = 1
 * and s >= 2, combined by the power heuristic (Veach 1997, chapter 10), with the weights of subpath.h.
 *
 * Light vertices are stored first; each eye vertex then gathers its connections, evaluates each before it
 * pays for the shadow ray, and traces the rays of those that carry anything as one packet. (Leaving faint
 * ones to Russian roulette was tried: it saves as much time as it adds noise.)
 *
 * Where nothing can be joined to the camera (camera.h) there is no t = 1, and a sample whose eye ray is lost
 * in the lens ends at once.
 *
 * A job may ask for one strategy alone, with its weight or without (job_settings_t): Veach's pyramid.
 *
 * vcm adds what no connection finds: light that comes through glass and is seen through glass, too. Each eye
 * vertex that scatters widely takes the photons about it (photons.h) for light that arrives where it is
 * itself (Georgiev, Krivanek, Davidovic and Slusallek 2012, "Light Transport Simulation with Vertex
 * Connection and Merging"). This is one strategy more for every vertex of a path, and all are weighed
 * together (subpath.h). It blurs light over the distance of merging, which shrinks from sample to sample: vcm
 * is consistent, not unbiased. Connections and splats stay those of the light subpath of the sample, so that
 * each unit's splats are its own; photons are there for merging alone.
 */
#include "worker/render/integrator/lessons.h"
#include "worker/render/integrator/photons.h"

#include <string.h>

enum { MAX_VERTICES = JOB_MAX_DEPTH + 2 };
/* Sooner adds more noise than it saves time. */
static const roulette_t roulette = {.from = 3, .most = 1};

/* One bidirectional sample. */
typedef struct {
    sample_t *sample;
    const setup_t *setup;
    rgb_t radiance;   /* of the eye subpath, so far */
    uint32_t source;  /* the light that the light subpath starts from, */
    float view_ratio; /* of its place there (light_ray_t), */
    /* For lessons: */
    bool teaches;
    float density;       /* of the start of the light subpath; 0: none */
    uint32_t lessons[2]; /* of that start */
    float brought;       /* by the light subpath: squares, in terms of how bright the picture is there */
    rgb_t own;           /* of `radiance` what needs no light subpath, and is not a light seen directly */
    uint64_t light_rays; /* that the light subpath took, with all that is joined to it */
    int light_count;     /* stored light vertices, in the order of the subpath */
    vertex_t light[MAX_VERTICES];
    connections_t connections;         /* candidates of one vertex, or of the camera */
    vec2_t rasters[SCENE_PACKET];      /* where those to the camera fall */
    uint32_t dimensions[SCENE_PACKET]; /* of the vertices they come from */
    uint32_t lights[SCENE_PACKET];     /* where the light of all of them comes from */
    uint32_t fresh; /* bit i is set where it is a fresh place on a light, and not the light subpath */
    float eta;      /* of merging (subpath.h); 0: there is none */
} bidirectional_t;

/* True when the job wants the strategy of s light and t eye vertices. */
static inline bool is_wanted(const bidirectional_t *b, int s, int t)
{
    const job_settings_t *settings = &b->setup->settings;
    return settings->strategy_t == 0 || (settings->strategy_t == t && settings->strategy_s == s);
}

static inline float weight_of(const bidirectional_t *b, float shares)
{
    return b->setup->settings.unweighted ? 1 : 1 / (1 + shares);
}

/* Stores the light vertices that an eye vertex or the camera can be joined to; specular ones are passed
 * through. */
static void trace_light_subpath(bidirectional_t *b)
{
    walk_t walk;
    light_ray_t ray;
    b->light_count = 0;
    b->density = 0;
    float share = b->setup->light_share;
    if (share < 1 && sample_2d(b->sample, DIMENSION_EYE + DIMENSION_LIGHT_SHARE).x >= share) return;
    if (!walk_from_light(b->sample, roulette, &walk, &ray)) return;
    b->source = ray.light;
    b->view_ratio = ray.view_ratio;
    b->density = ray.start.density;
    memcpy(b->lessons, ray.lessons, sizeof b->lessons);
    for (int i = 1; i < setup_max_segments(b->setup); i++) {
        vertex_t *y = &b->light[b->light_count];
        walk_arrive(&walk, b->sample, y);
        if (y->kind == VERTEX_SKY || !walk_weigh(&walk, y)) return;
        vertex_shade(y, b->setup, walk.scattered);
        if (b->eta > 0) walk_weigh_merging(&walk, y, b->eta);
        if (vertex_is_joinable(y)) b->light_count++;
        if (!walk_scatter(&walk, b->sample, y)) return;
    }
}

/* ---- strategies ---------------------------------------------------------------------------------------- */

/* Adds what the eye subpath brings from a light. */
static inline void add_radiance(bidirectional_t *b, rgb_t value, uint32_t light)
{
    b->radiance = v_add(b->radiance, value);
    sample_lit(b->sample, light, value);
}

/* Notes for the light groups what arrived of so many connections. */
static void light_connections(bidirectional_t *b, int count, uint32_t lost)
{
    for (int i = 0; i < count; i++)
        if (!(lost >> i & 1)) sample_lit(b->sample, b->lights[i], b->connections.values[i]);
}

/* Notes what the light subpath brought to a place of the film. */
static inline void note_brought(bidirectional_t *b, float x, float y, rgb_t value)
{
    b->brought += square(float_min(v_max(value) * setup_brightness(b->setup, x, y), 4));
}

/* Traces the connections and takes what arrives, of those to the camera as splats. */
static void take_connections(bidirectional_t *b, bool splats)
{
    int count = b->connections.segments.count;
    b->light_rays += (uint64_t)(count - __builtin_popcount(b->fresh));
    uint32_t lost = connections_transmit(b->sample, &b->connections, splats);
    for (int i = 0; i < count; i++) {
        if (lost >> i & 1) continue;
        rgb_t value = b->connections.values[i];
        if (splats) {
            sample_splat(b->sample, b->rasters[i], value, b->lights[i], b->dimensions[i]);
            if (b->teaches) note_brought(b, b->rasters[i].x, b->rasters[i].y, value);
        } else {
            b->radiance = v_add(b->radiance, value);
            if (!b->teaches) continue;
            if (b->fresh >> i & 1)
                b->own = v_add(b->own, value);
            else
                note_brought(b, (float)b->sample->pixel_x, (float)b->sample->pixel_y, value);
        }
    }
    b->fresh = 0;
    if (!splats && b->setup->light_groups != NULL) light_connections(b, count, lost);
}

/* t = 1: joins a light vertex to the camera. */
static void join_camera(bidirectional_t *b, const vertex_t *y)
{
    camera_view_t view;
    bsdf_value_t fy;
    if (!sample_join_camera(b->sample, vertex_point(y), y->dimension, &view) || !vertex_eval(y, view.w, &fy))
        return;
    float r = view.density * vertex_area_cosine(y, view.w);
    float count = y->depth == 1 ? b->view_ratio * light_count(b->setup, b->source, true) : 1;
    float weight = weight_of(b, mis_share_counted(y, r, fy.pdf_rev, count));
    float factor = vertex_cosine(y, view.w) * vertex_adjoint(y, view.w) * view.density;
    rgb_t value = v_scale(v_mul(y->throughput, fy.f), factor * weight);
    if (v_is_zero(value)) return;
    int n = connections_add(&b->connections, view.position, vertex_exit(y, view.w), vertex_medium(y, view.w),
                            v_length(v_sub(view.position, vertex_point(y))), value);
    b->lights[n] = b->source;
    b->rasters[n] = view.raster;
    b->dimensions[n] = y->dimension;
}

/* s = 0: the eye subpath ran into a light, or into the sky. What is seen directly has no other strategy here:
 * t = 1 starts at s = 2. */
static void hit_lights(bidirectional_t *b, const walk_t *walk, const vertex_t *z)
{
    if (!is_wanted(b, 0, z->depth + 1)) return;
    for (uint32_t k = 0; k < vertex_light_count(z, b->setup->lights); k++) {
        light_hit_t hit;
        if (!vertex_light_hit(z, b->setup->lights, k, &hit)) continue;
        float count = hit.view_ratio * light_count(b->setup, hit.light, walk->first);
        float share = z->depth == 1 ? 0 : mis_share_counted(z, hit.pdf_place, hit.pdf_ray, count);
        float weight = weight_of(b, share);
        rgb_t value = v_scale(v_mul(z->throughput, hit.radiance), weight);
        add_radiance(b, value, hit.light);
        if (z->depth > 1) b->own = v_add(b->own, value);
    }
}

/* s = 1: joins the eye vertex to the k-th fresh place on a light. */
static void join_light(bidirectional_t *b, const vertex_t *z, uint32_t k)
{
    light_view_t light;
    bsdf_value_t fz;
    float weight;
    if (!vertex_view_light(z, b->sample, k, &light)) return;
    float r_eye = light.arrival * vertex_area_cosine(z, light.w);
    if (vertex_eval(z, light.w, &fz)) {
        float counted = z->first ? first_light_worth * light.density : light.density;
        float light_share = light.delta ? 0 : square(fz.pdf * light.geometry / counted);
        float eye_share = mis_share(z, r_eye, fz.pdf_rev) * square(light.pdf_place / counted);
        weight = weight_of(b, light_share + eye_share);
    } else if (z->depth > 1 || !vertex_split_light(z, &light, 1 / sqrtf(z->inv_p2), &fz, &weight)) {
        return;
    }
    float factor = vertex_cosine(z, light.w) * light.geometry / light.density * weight;
    rgb_t value = v_mul(v_scale(v_mul(z->throughput, fz.f), factor), light.radiance);
    if (v_is_zero(value)) return;
    int n = connections_add(&b->connections, vertex_exit(z, light.w), light.target, vertex_medium(z, light.w),
                            v_length(v_sub(light.target, vertex_point(z))), value);
    b->lights[n] = light.light;
    b->fresh |= 1u << n;
}

/* s >= 2, t >= 2: joins an eye vertex to a light vertex. */
static void join_vertices(bidirectional_t *b, const vertex_t *z, const vertex_t *y)
{
    vec3_t d = v_sub(vertex_point(y), vertex_point(z));
    float distance2 = v_length2(d);
    if (!(distance2 > 0)) return;
    float distance = sqrtf(distance2);
    vec3_t w = v_scale(d, 1 / distance), back = v_neg(w);
    bsdf_value_t fz, fy;
    if (!vertex_eval(z, w, &fz) || !vertex_eval(y, back, &fy)) return;
    float r_light = fz.pdf * vertex_area_cosine(y, w) / distance2;
    float r_eye = fy.pdf * vertex_area_cosine(z, w) / distance2;
    float count = y->depth == 1 ? b->view_ratio : 1;
    float weight =
        weight_of(b, mis_share_counted(y, r_light, fy.pdf_rev, count) + mis_share(z, r_eye, fz.pdf_rev));
    float factor = vertex_cosine(z, w) * vertex_cosine(y, w) * vertex_adjoint(y, back) / distance2 * weight;
    rgb_t value = v_mul(v_scale(v_mul(z->throughput, fz.f), factor), v_mul(y->throughput, fy.f));
    if (v_is_zero(value)) return;
    int n = connections_add(&b->connections, vertex_exit(z, w), vertex_exit(y, back), vertex_medium(z, w),
                            distance, value);
    b->lights[n] = b->source;
}

/* Everything that joins an eye vertex to the lights. */
static void join_eye_vertex(bidirectional_t *b, const vertex_t *z)
{
    int segments = setup_max_segments(b->setup);
    if (is_wanted(b, 1, z->depth + 1))
        for (uint32_t k = 0; k < vertex_view_count(z, b->setup->lights); k++) join_light(b, z, k);
    if (b->connections.segments.count == SCENE_PACKET) take_connections(b, false);
    for (int k = 0; k < b->light_count && z->depth + b->light[k].depth < segments; k++) {
        if (is_wanted(b, b->light[k].depth + 1, z->depth + 1)) join_vertices(b, z, &b->light[k]);
        if (b->connections.segments.count == SCENE_PACKET) take_connections(b, false);
    }
    if (b->connections.segments.count > 0) take_connections(b, false);
}

/* Weight of the photon merged with the eye vertex, at which the path scatters as `fz` says. The strategies
 * that join the vertex to one of its neighbours have the densities of merging over eta p_i, p_i of either
 * subpath; the two chains begin there. */
static float merging_weight(const bidirectional_t *b, const vertex_t *z, const photon_t *y,
                            const bsdf_value_t *fz)
{
    float count = y->depth == 1 ? light_count(b->setup, y->light, z->first) : 1;
    float light = square(count) * y->direct + square(fz->pdf) * y->inner;
    float eye = z->direct + square(fz->pdf_rev) * z->inner;
    return 1 / (1 + (light + eye) / z->merging);
}

/* Takes a photon near the eye vertex for light that arrives there; returns what goes on towards the eye.
 * Photons count per area: where the shading normal makes another angle than the surface, as at light vertices
 * that are connected (vertex_adjoint). */
static rgb_t merge_photon(bidirectional_t *b, const vertex_t *z, const photon_t *y)
{
    bsdf_value_t fz;
    float arrives = vertex_area_cosine(z, y->wo);
    if (!(arrives > 0) || !vertex_eval(z, y->wo, &fz)) return vec3(0, 0, 0);
    float factor = vertex_cosine(z, y->wo) / arrives * merging_weight(b, z, y, &fz);
    return v_mul(v_scale(v_mul(z->throughput, fz.f), factor / b->sample->photons->area), y->throughput);
}

/* Merges an eye vertex with all photons near it. */
static void merge_photons(bidirectional_t *b, const vertex_t *z)
{
    const photon_set_t *set = b->sample->photons;
    int most_depth = setup_max_segments(b->setup) - z->depth;
    photon_range_t ranges[PHOTON_CELLS];
    int count = photon_grid_near(&set->grid, vertex_point(z), ranges);
    for (int k = 0; k < count; k++)
        for (uint32_t i = ranges[k].first; i < ranges[k].end; i++) {
            if (!(v_length2(v_sub(set->points[i], vertex_point(z))) < square(set->radius))) continue;
            const photon_t *y = &set->photons[i];
            if (y->depth <= most_depth) add_radiance(b, merge_photon(b, z, y), y->light);
        }
}

/* Joins the light subpath to the camera. */
static void splat_light_subpath(bidirectional_t *b)
{
    for (int k = 0; k < b->light_count; k++) {
        if (is_wanted(b, b->light[k].depth + 1, 1)) join_camera(b, &b->light[k]);
        if (b->connections.segments.count == SCENE_PACKET) take_connections(b, true);
    }
    if (b->connections.segments.count > 0) take_connections(b, true);
}

/* What the sample teaches, which took so many rays. */
static void teach(const bidirectional_t *b, uint64_t rays)
{
    const sample_t *sample = b->sample;
    uint32_t x = sample->pixel_x, y = sample->pixel_y;
    /* Bounded, so that its square is. */
    float own = float_min(v_max(b->own) * setup_brightness(b->setup, (float)x, (float)y), 4);
    if (!(own >= 0) || !(b->brought < INFINITY)) return;
    lesson_note(sample, LESSON_OWN + lesson_block(&b->setup->settings, x, y), own, LESSON_BITS);
    lesson_note(sample, LESSON_OWN_SQUARES, square(own), LESSON_BITS);
    lesson_note(sample, LESSON_OWN_RAYS, (float)(rays - b->light_rays), LESSON_RAY_BITS);
    if (!(b->density > 0)) return;
    lesson_note(sample, LESSON_LIGHTS + b->lessons[0], b->brought * b->density, GUIDE_SQUARE_BITS);
    lesson_note(sample, LESSON_LIGHTS + b->lessons[1], (float)b->light_rays / b->density, GUIDE_COST_BITS);
}

static rgb_t bdpt_sample(sample_t *sample)
{
    bidirectional_t b;
    b.sample = sample;
    b.setup = sample->setup;
    b.radiance = vec3(0, 0, 0);
    b.connections.segments = (segments_t){0};
    b.connections.absorbing = 0;
    b.fresh = 0;
    b.brought = 0;
    b.teaches = lesson_due(sample);
    b.eta = sample->photons != NULL ? sample->photons->eta : 0;
    b.own = vec3(0, 0, 0);
    uint64_t rays = sample->result->counts.rays;
    int segments = setup_max_segments(b.setup);

    walk_t walk = walk_from_camera(sample, roulette);
    if (sample->eye_weight == 0 && !walk.joinable) return b.radiance;
    trace_light_subpath(&b);
    b.light_rays = sample->result->counts.rays - rays;
    if (walk.joinable) splat_light_subpath(&b);
    vec3_t eye = walk.origin;
    for (int i = 1; i <= segments; i++) {
        vertex_t z;
        walk_arrive(&walk, sample, &z);
        if (!walk_weigh(&walk, &z)) break;
        hit_lights(&b, &walk, &z);
        if (z.kind == VERTEX_SKY || (i == segments && i > 1)) break;
        vertex_shade(&z, b.setup, walk.scattered);
        if (i == 1) vertex_first_hit(&z, sample, eye);
        if (i == segments) break;
        if (b.eta > 0) walk_weigh_merging(&walk, &z, b.eta);
        if (vertex_is_joinable(&z) && !lights_empty(b.setup->lights)) join_eye_vertex(&b, &z);
        if (z.merging > 0) merge_photons(&b, &z);
        if (!walk_scatter(&walk, sample, &z)) break;
    }
    if (b.teaches) teach(&b, sample->result->counts.rays - rays);
    return b.radiance;
}

const integrator_ops_t integrator_bdpt = {.sample = bdpt_sample, .traces_light = true};
const integrator_ops_t integrator_vcm = {.sample = bdpt_sample, .traces_light = true, .merges = true};
