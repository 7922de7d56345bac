/* integrator: what an integrator gets and gives. It estimates one sample of one pixel: it returns the
 * radiance of its eye subpath and hands its splats over one by one. bdpt, path and light stand on the same
 * scene, BSDFs, lights and camera, and so validate one another.
 *
 * A new integrator is one file and one entry in the table in renderer.c.
 */
#ifndef LIGHTMILL_RENDER_INTEGRATOR_H
#define LIGHTMILL_RENDER_INTEGRATOR_H

#include "common/film.h"
#include "common/sampler.h"
#include "worker/render/bsdf.h"
#include "worker/render/camera.h"
#include "worker/render/filter.h"
#include "worker/render/light.h"

/* Everything that stays the same during a job. */
typedef struct {
    const scene_t *scene;
    const lights_t *lights;
    camera_t camera;
    filter_t filter;
    job_settings_t settings;
} stage_t;

/* One sample in the making. */
typedef struct {
    const stage_t *stage;
    uint32_t pixel_x, pixel_y, sample;
    unit_result_t *result; /* receives splats and counts */
    first_hit_t first_hit; /* zeroed; the integrator says what the eye ray met */
} sample_t;

typedef struct {
    /* Radiance along the eye subpath of this sample. */
    rgb_t (*sample)(sample_t *sample);
    bool traces_light; /* every sample traces one light subpath */
} integrator_ops_t;

extern const integrator_ops_t integrator_bdpt, integrator_path, integrator_light;

/* Where the streams of random numbers of the two subpaths begin: dimensions never collide. */
enum { DIMENSION_EYE = 0, DIMENSION_LIGHT = 96, DIMENSION_STRIDE = 6 };

static inline sampler_t sample_stream(const sample_t *sample, uint32_t dimension)
{
    const job_settings_t *settings = &sample->stage->settings;
    uint32_t pixel = sample->pixel_y * (uint32_t)settings->width + sample->pixel_x;
    sampler_t sampler = sampler_new(settings->sampler, settings->seed, pixel, sample->sample);
    sampler.dimension = dimension;
    return sampler;
}

/* The eye ray of the sample, its place on the film drawn from the pixel filter with `u`. */
vec3_t sample_eye_ray(const sample_t *sample, vec2_t u, float *pdf);
/* Adds a splat at a film position; the numbers of `dimension` choose the pixel under the filter. */
void sample_splat(sample_t *sample, vec2_t raster, rgb_t value, uint32_t dimension);

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
