/* integrator: what an integrator gets and gives. It estimates one sample of one pixel: it returns the
 * radiance of its eye subpath and hands its splats over one by one. bdpt, path and light stand on the same
 * scene, BSDFs, lights and camera, and so validate one another.
 *
 * A new integrator is one file and one entry in the table in renderer.c.
 */
#ifndef LIGHTMILL_INTEGRATOR_H
#define LIGHTMILL_INTEGRATOR_H

#include "common/film/batch.h"
#include "common/sampler.h"
#include "worker/render/bsdf/bsdf.h"
#include "worker/render/camera/camera.h"
#include "worker/render/camera/filter.h"
#include "worker/render/light/light.h"

/* Everything that stays the same during a job. */
typedef struct {
    const scene_t *scene;
    const lights_t *lights;
    const camera_t *camera;
    filter_t filter;
    bool moves;          /* the camera or something in the scene: samples have a time */
    bool regularizes;    /* blob_scene_t */
    float max_luminance; /* blob_scene_t */
    job_settings_t settings;
} stage_t;

/* One sample in the making. */
typedef struct {
    const stage_t *stage;
    uint32_t pixel_x, pixel_y, sample;
    sampler_t numbers;     /* at dimension 0 */
    float time;            /* of the whole path, 0 to 1 */
    float eye_weight;      /* factor on the eye subpath's radiance; set by sample_eye_ray */
    first_hit_t first_hit; /* filled by integrators that trace eye subpaths */
    unit_result_t *result; /* receives splats and counts */
} sample_t;

typedef struct {
    /* Radiance along the eye subpath of this sample. */
    rgb_t (*sample)(sample_t *sample);
    bool traces_light; /* every sample traces one light subpath */
} integrator_ops_t;

extern const integrator_ops_t integrator_bdpt, integrator_path, integrator_light;

/* Where the streams of random numbers of the two subpaths begin, and how many numbers (pairs) lie between one
 * vertex and the next. They alternate: dimensions never collide however long the paths, and those of the
 * first vertices of both, where stratification counts, come first. */
enum { DIMENSION_EYE = 0, DIMENSION_LIGHT = 6, DIMENSION_STRIDE = 12 };
/* Of vertex 0 of the eye subpath. */
enum { DIMENSION_FILTER = 0, DIMENSION_LENS = 1, DIMENSION_TIME = 2 };
/* Of vertex i >= 1 of the eye subpath: a light's choice and place, and the scattering. */
enum { DIMENSION_ILLUMINATE = 0, DIMENSION_SCATTER = 2 };
/* Of the light subpath: of vertex 0 choice, place and ray; of vertex i >= 1 the scattering; of either the
 * pixel and the point of the lens that it is joined to. */
enum { DIMENSION_EMIT = 0, DIMENSION_LIGHT_SCATTER = 0, DIMENSION_JOIN_PIXEL = 4, DIMENSION_JOIN_LENS = 5 };

/* True where pbrt-v3 shows light of a light that the two normals of what the camera sees disagree about. */
static inline bool splits_direct_light(const surface_t *surface)
{
    return (surface->shape->flags & SHAPE_NORMALS_V3) != 0;
}

/* The share of such light that pbrt-v3's bdpt shows: all of a light that cannot be run into. Else it counts
 * the scattering that cannot happen as a strategy with the density 1 of the place on the light (of
 * `pdf_place` when drawn as such), and nothing makes up for its part; `ratio`: of the densities of what the
 * camera sees, as made by the light over as made by the camera. */
static inline float split_light_share(bool delta, float pdf_place, float ratio)
{
    return delta ? 1 : (1 + ratio) / (1 + ratio + 1 / pdf_place);
}

static inline sampler_t sample_stream(const sample_t *sample, uint32_t dimension)
{
    sampler_t sampler = sample->numbers;
    sampler.dimension = dimension;
    return sampler;
}

/* A pair of numbers of the sample. */
static inline vec2_t sample_2d(const sample_t *sample, uint32_t dimension)
{
    sampler_t sampler = sample_stream(sample, dimension);
    return sampler_2d(&sampler);
}

/* The eye ray of the sample, its place on the film drawn from the pixel filter. Also settles the sample's
 * weight. */
void sample_eye_ray(sample_t *sample, camera_ray_t *ray);
/* The time of the sample: 0 where nothing moves. */
float sample_time(const sample_t *sample);
/* Joins a point to the camera; `dimension` is that of the point's vertex. */
bool sample_join_camera(const sample_t *sample, vec3_t p, uint32_t dimension, camera_view_t *view);
/* Adds a splat at a film position; `dimension` is that of the point's vertex. */
void sample_splat(sample_t *sample, vec2_t raster, rgb_t value, uint32_t dimension);
/* Notes what the eye ray met first, for the samples whose features count. */
void sample_first_hit(sample_t *sample, const surface_t *surface, const bsdf_t *bsdf, vec3_t origin);

/* Segments that a full path may have: pbrt's maxdepth counts scattering events. */
static inline int stage_max_segments(const stage_t *stage)
{
    return stage->settings.max_depth + 1;
}

/* The factor that makes scattering with shading normals the adjoint of itself: on light subpaths throughput
 * is multiplied by |wo ns| |wi ng| / (|wo ng| |wi ns|) (Veach 1997, section 5.3.2). */
static inline float shading_adjoint(const bsdf_t *bsdf, vec3_t wo, vec3_t wi)
{
    float num = v_dot(wo, bsdf->ns) * v_dot(wi, bsdf->ng), den = v_dot(wo, bsdf->ng) * v_dot(wi, bsdf->ns);
    return den != 0 ? fabsf(num / den) : 0;
}

#endif
