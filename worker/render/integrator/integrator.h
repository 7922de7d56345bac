/* integrator: what an integrator gets and gives. It estimates one sample of one pixel: it returns the
 * radiance of its eye subpath and hands its splats over one by one. bdpt, path and light stand on the same
 * scene, BSDFs, lights, camera and walks (subpath.h), and so validate one another.
 *
 * A new integrator is one file, its declaration below, one entry in the table in renderer.c, and its name in
 * common/job.h and job.c.
 */
#ifndef LIGHTMILL_INTEGRATOR_H
#define LIGHTMILL_INTEGRATOR_H

#include "common/film/batch.h"
#include "common/sampler.h"
#include "worker/render/camera/camera.h"
#include "worker/render/camera/filter.h"
#include "worker/render/light/light.h"
#include "worker/render/medium/medium.h"

/* Everything that stays the same during a job. */
typedef struct {
    const scene_t *scene;
    const lights_t *lights;
    const camera_t *camera;
    const media_t *media; /* NULL: there are none */
    blob_ref_t medium;    /* that the camera stands in */
    filter_t filter;
    bool moves;                  /* the camera or something in the scene: samples have a time */
    bool regularizes;            /* blob_scene_t */
    float max_luminance;         /* blob_scene_t */
    const uint8_t *light_groups; /* of each light; NULL in a job without groups */
    float light_share;           /* how many light subpaths a sample has, on average */
    /* Of a job that learns (lessons.h): which pixels teach, and 1 / about how bright the picture is, of
     * BRIGHTNESS_SIDE x BRIGHTNESS_SIDE parts of the film. */
    uint32_t teaching_mask;
    const float *inverse_brightness;
    const struct caustics *caustics; /* caustics.h; NULL: there are none */
    float noise; /* in those terms, about the standard deviation of what the eye half of a sample brings */
    const waves_tables_t *waves; /* of a spectral job; else NULL */
    job_settings_t settings;
} setup_t;

enum { BRIGHTNESS_SIDE = 8 };
/* The one of a place of the film, which may lie outside; 0: not known. */
static inline float setup_brightness(const setup_t *setup, float x, float y)
{
    if (setup->inverse_brightness == NULL) return 0;
    int u = (int)(x * BRIGHTNESS_SIDE / (float)setup->settings.width);
    int v = (int)(y * BRIGHTNESS_SIDE / (float)setup->settings.height);
    u = int_min(int_max(u, 0), BRIGHTNESS_SIDE - 1);
    v = int_min(int_max(v, 0), BRIGHTNESS_SIDE - 1);
    return setup->inverse_brightness[BRIGHTNESS_SIDE * v + u];
}

struct photon_set;     /* photons.h */
struct caustics_scout; /* caustics.h */
struct light_pool;     /* light_pool.h */

/* One sample in the making. */
typedef struct {
    const setup_t *setup;
    uint32_t pixel_x, pixel_y, sample;
    sampler_t numbers;              /* at dimension 0 */
    float time;                     /* of the whole path, 0 to 1 */
    const waves_t *waves;           /* likewise; NULL: it has red, green and blue */
    float eye_weight;               /* factor on the eye subpath's radiance; set by sample_eye_ray */
    first_hit_t first_hit;          /* filled by integrators that trace eye subpaths */
    rgb_t groups[LIGHT_GROUPS_MAX]; /* what of the radiance of the eye subpath comes from each light group */
    struct light_pool *pool;        /* of its block */
    const struct photon_set *photons; /* that it merges with; NULL: none */
    struct caustics_scout *scout;     /* NULL, or: it is a first look */
    unit_result_t *result;            /* receives splats and counts */
} sample_t;

typedef struct {
    /* Radiance along the eye subpath of this sample. */
    rgb_t (*sample)(sample_t *sample);
    /* NULL, or: samples of one index go in blocks of pixels (light_pool.h). Of a block, `light` is called for
     * each light subpath, with the pixel that it belongs to, and then `sample` for the pixels that are to be
     * rendered. `splats`: the pixel is one of these; else only light vertices are wanted. All samples of a
     * block have one time and one set of wavelengths. */
    void (*light)(sample_t *sample, bool splats);
    bool traces_light; /* its splats are over the number of samples */
    bool merges;       /* samples get photons */
} integrator_ops_t;

extern const integrator_ops_t integrator_bdpt, integrator_path, integrator_light, integrator_ao,
    integrator_vcm;

/* Where the streams of random numbers of the two subpaths begin, and how many numbers (pairs) lie between one
 * vertex and the next. They alternate: dimensions never collide however long the paths, and those of the
 * first vertices of both, where stratification counts, come first. Before them come the places on lights that
 * the first vertex to scatter is joined to. */
enum {
    DIMENSION_FIRST_LIGHTS = 0,
    DIMENSION_EYE = LIGHTS_FIRST_MOST,
    DIMENSION_LIGHT = DIMENSION_EYE + 6,
    DIMENSION_STRIDE = 12
};
/* Of vertex 0 of the eye subpath; the last but one is the block's, for how many light subpaths it has. */
enum {
    DIMENSION_FILTER = 0,
    DIMENSION_LENS = 1,
    DIMENSION_TIME = 2,
    DIMENSION_LIGHT_COUNT = 3,
    DIMENSION_WAVES = 5
};
/* Of vertex i >= 1 of the eye subpath: a light's choice and place, the scattering, the choice of light
 * vertices, and which connections survive. */
enum { DIMENSION_ILLUMINATE = 0, DIMENSION_SCATTER = 2, DIMENSION_CHOOSE = 4, DIMENSION_SURVIVE = 5 };
/* Of the vertex before, how far it is to the next one in a medium: of eye subpaths the second of the pair. */
enum { DIMENSION_DISTANCE = 4, DIMENSION_LIGHT_DISTANCE = 3 };
/* Of the light subpath: of vertex 0 choice, place and ray; of vertex i >= 1 the scattering and whether its
 * connection survives; of either the pixel and the point of the lens that it is joined to. */
enum {
    DIMENSION_EMIT = 0,
    DIMENSION_LIGHT_SCATTER = 0,
    DIMENSION_LIGHT_SURVIVE = 2,
    DIMENSION_JOIN_PIXEL = 4,
    DIMENSION_JOIN_LENS = 5
};

/* Of the side stream of a vertex, behind what caustics take: whether it is joined to others. */
enum { DIMENSION_JOINING = 7 };

static inline sampler_t sample_stream(const sample_t *sample, uint32_t dimension)
{
    sampler_t sampler = sample->numbers;
    sampler.dimension = dimension;
    return sampler;
}

/* Numbers of the sample that no dimension of sample_stream has. */
static inline sampler_t sample_side_stream(const sample_t *sample, uint32_t dimension)
{
    sampler_t sampler = sample_stream(sample, dimension);
    sampler.sequence_key ^= 0x8F1BBCDCu;
    sampler.sample_key ^= 0xCA62C1D6F3A0B5E7u;
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
/* Draws the wavelengths of the sample, if its job is spectral, to be kept in *waves. */
void sample_waves(sample_t *sample, waves_t *waves);
/* What the channels have of light from a light, of the given linear sRGB. */
rgb_t sample_light_waves(const sample_t *sample, uint32_t light, rgb_t radiance);
static inline rgb_t sample_light(const sample_t *sample, uint32_t light, rgb_t radiance)
{
    return sample->waves == NULL ? radiance : sample_light_waves(sample, light, radiance);
}
/* What the film shows of light in the channels. */
static inline rgb_t sample_colour(const sample_t *sample, rgb_t light)
{
    return sample->waves == NULL ? light : waves_colour(sample->waves, light);
}
/* Joins a point to the camera; `dimension` is that of the point's vertex. */
bool sample_join_camera(const sample_t *sample, vec3_t p, uint32_t dimension, camera_view_t *view);
/* Adds a splat at a film position, of light from this light; `dimension` is that of the point's vertex. */
void sample_splat(sample_t *sample, vec2_t raster, rgb_t value, uint32_t light, uint32_t dimension);
/* Notes for the light groups, if the job has some, that so much of the eye subpath's radiance comes from this
 * light. Integrators call it with all that they return. */
static inline void sample_lit(sample_t *sample, uint32_t light, rgb_t value)
{
    const uint8_t *groups = sample->setup->light_groups;
    if (groups == NULL) return;
    rgb_t *sum = &sample->groups[groups[light]];
    *sum = v_add(*sum, value);
}

/* Segments that a full path may have: pbrt's maxdepth counts scattering events. */
static inline int setup_max_segments(const setup_t *setup)
{
    return setup->settings.max_depth + 1;
}

#endif
