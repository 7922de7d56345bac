/* renderer: units over integrators (see renderer.h). */
#include "worker/render/renderer.h"

#include "worker/render/integrator/lessons.h"
#include "worker/render/integrator/light_pool.h"
#include "worker/render/integrator/photons.h"
#include "worker/render/plan/plan.h"

#include <pmmintrin.h>
#include <stdlib.h>
#include <time.h>

struct renderer {
    setup_t setup;
    scene_t *scene;
    lights_t *lights;
    caustics_t *caustics; /* of a job that learns; may be NULL */
    camera_t *camera;
    media_t *media;        /* NULL: the scene has none */
    waves_tables_t *waves; /* of a spectral job; else NULL */
    uint8_t *light_groups; /* of each light; NULL: none */
    const integrator_ops_t *integrator;
    photons_t *photons; /* NULL: the integrator does not merge */
    /* Of a job that learns. */
    float inverse_brightness[BRIGHTNESS_SIDE * BRIGHTNESS_SIDE];
    plan_t *_Atomic plans[LEARNING_PASSES]; /* NULL: none yet, or the pass has none */
};

static const integrator_ops_t *const integrators[] = {
    [INTEGRATOR_BDPT] = &integrator_bdpt,   [INTEGRATOR_PATH] = &integrator_path,
    [INTEGRATOR_LIGHT] = &integrator_light, [INTEGRATOR_AO] = &integrator_ao,
    [INTEGRATOR_VCM] = &integrator_vcm,
};

/* Embree's and our own results depend on it: denormals are flushed on every thread that renders. */
static void flush_denormals(void)
{
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
}

/* The group of each light, in fresh memory; NULL when the job has no groups. */
static result_t sort_lights(const scene_blob_t *blob, const job_settings_t *settings, uint8_t **groups)
{
    if (settings->light_groups[0] == '\0') return result_ok();
    size_t count = blob->counts[BLOB_SECTION_LIGHTS];
    grouped_light_t *lights = blob_grouped_lights(blob);
    *groups = mem_alloc(count + 1);
    result_t result = light_groups_assign(settings->light_groups, lights, count, *groups);
    free(lights);
    return result;
}

result_t renderer_new(const scene_blob_t *blob, const job_settings_t *settings, renderer_t **result)
{
    *result = NULL;
    flush_denormals();
    TRY(blob_check_settings(blob, settings));
    renderer_t *renderer = mem_zalloc(1, sizeof *renderer);
    result_t made = scene_new(blob, &renderer->scene);
    if (made.code != RESULT_OK) {
        free(renderer);
        return made;
    }
    made = sort_lights(blob, settings, &renderer->light_groups);
    if (made.code != RESULT_OK) {
        renderer_destroy(&renderer);
        return made;
    }
    renderer->lights = lights_new(renderer->scene);
    renderer->camera = camera_new(blob, settings->width, settings->height);
    renderer->integrator = integrators[settings->integrator];
    setup_t *setup = &renderer->setup;
    setup->scene = renderer->scene;
    setup->lights = renderer->lights;
    setup->light_groups = renderer->light_groups;
    setup->settings = *settings;
    setup->camera = renderer->camera;
    setup->media = renderer->media = media_new(blob, settings->integrator == INTEGRATOR_AO);
    setup->medium = blob->scene->medium;
    setup->moves = scene_moves(renderer->scene) || camera_moves(renderer->camera);
    setup->regularizes = blob->scene->regularize != 0;
    setup->max_luminance = blob->scene->max_luminance;
    filter_init(&setup->filter, &blob->scene->filter);
    setup->light_share = 1;
    setup->teaching_mask = LESSON_NOBODY;
    if (settings->spectral) setup->waves = renderer->waves = waves_tables_new();
    if (job_learns(settings))
        renderer->caustics =
            plan_prepare(setup, renderer->lights, renderer->integrator, renderer->inverse_brightness);
    if (renderer->integrator->merges) renderer->photons = photons_new(setup);
    *result = renderer;
    return result_ok();
}

void renderer_plan(renderer_t *renderer, const learning_plan_t *plan)
{
    if (atomic_load(&renderer->plans[plan->pass]) != NULL) return;
    flush_denormals();
    atomic_store(&renderer->plans[plan->pass], plan_new(&renderer->setup, plan));
}

/* The setup that a unit is rendered with. */
static const setup_t *setup_of(const renderer_t *renderer, const unit_t *unit)
{
    const job_settings_t *settings = &renderer->setup.settings;
    if (!job_learns(settings)) return &renderer->setup;
    const plan_t *plan = atomic_load(&renderer->plans[learning_pass(settings, unit->first)]);
    return plan != NULL ? plan_setup(plan) : &renderer->setup;
}

uint64_t renderer_memory(const scene_blob_t *blob, const job_settings_t *settings)
{
    /* Of Embree's trees, by primitive; and of tables for images and lights, which are smaller than these. */
    const uint64_t primitive = 100;
    return blob->size + photons_memory(settings) +
           primitive * (blob->counts[BLOB_SECTION_TRIANGLES] + blob->counts[BLOB_SECTION_CURVE_POINTS]);
}

void renderer_destroy(renderer_t **renderer)
{
    renderer_t *self = *renderer;
    if (self == NULL) return;
    for (int i = 0; i < LEARNING_PASSES; i++) {
        plan_t *plan = atomic_load(&self->plans[i]);
        plan_destroy(&plan);
    }
    photons_destroy(&self->photons);
    lights_destroy(&self->lights);
    caustics_destroy(&self->caustics);
    free(self->camera);
    media_destroy(&self->media);
    waves_tables_destroy(&self->waves);
    free(self->light_groups);
    scene_destroy(&self->scene);
    free(self);
    *renderer = NULL;
}

/* CPU microseconds of the calling thread. */
static uint64_t thread_cpu_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
}

/* Adds to one of the sums of the unit's tile. */
static void add_rgb(const setup_t *setup, unit_result_t *result, sum_kind_t kind, size_t pixel, rgb_t value)
{
    result->counts.overflows += film_add(result->sums[kind].values + 3 * pixel,
                                         (float[3]){value.x, value.y, value.z}, setup->settings.film_scale);
}

/* Likewise for what of the sample comes from each light group, scaled as the sample is. */
static void add_groups(const setup_t *setup, const sample_t *sample, size_t pixel, size_t pixels, float scale)
{
    size_t count = sum_planes(&setup->settings, SUM_GROUP_EYE);
    for (size_t g = 0; g < count; g++) {
        rgb_t value = v_scale(sample_colour(sample, sample->groups[g]), scale);
        if (v_is_finite(value)) add_rgb(setup, sample->result, SUM_GROUP_EYE, pixel + g * pixels, value);
    }
}

/* Adds what the eye subpath of a sample brought to a pixel of the unit's tile, which has so many. */
static void add_eye_sample(const setup_t *setup, const sample_t *sample, size_t pixel, size_t pixels,
                           rgb_t value)
{
    unit_result_t *result = sample->result;
    value = sample_colour(sample, value);
    float luminance = rgb_luminance(value), clamp = 1;
    if (luminance > setup->max_luminance) {
        clamp = setup->max_luminance / luminance;
        value = v_scale(value, clamp);
    }
    value = v_scale(value, sample->eye_weight);
    if (!v_is_finite(value)) {
        result->counts.dropped++;
        return;
    }
    add_rgb(setup, result, SUM_EYE, pixel + (sample->sample & 1) * pixels, value);
    if (setup->light_groups != NULL) add_groups(setup, sample, pixel, pixels, clamp * sample->eye_weight);
}

/* A block of pixels (light_pool.h), from (x, y) on, which ends where the film does. */
typedef struct {
    int x, y;
    int columns, rows;
} block_t;

/* The block whose first pixel that is. */
static block_t block_at(const job_settings_t *settings, int x, int y)
{
    int columns = (settings->width - x + POOL_STRIDE - 1) / POOL_STRIDE;
    int rows = (settings->height - y + POOL_STRIDE - 1) / POOL_STRIDE;
    return (block_t){x, y, int_min(columns, POOL_SIDE), int_min(rows, POOL_SIDE)};
}

/* Where along an axis the next block begins: at the first pixels of each region. */
static int next_block(int at)
{
    return (at + 1) % POOL_REGION < POOL_STRIDE ? at + 1 : at + 1 + POOL_REGION - POOL_STRIDE;
}

static int block_pixels(const block_t *block)
{
    return block->columns * block->rows;
}

/* The sample of the i-th pixel of a block, made of what it shares with others; it has no numbers yet. */
static sample_t sample_of(const sample_t *shared, const block_t *block, int i)
{
    sample_t sample = *shared;
    sample.pixel_x = (uint32_t)(block->x + i % block->columns * POOL_STRIDE);
    sample.pixel_y = (uint32_t)(block->y + i / block->columns * POOL_STRIDE);
    return sample;
}

/* The number of the sample's pixel, which is also that of the block that begins there. */
static uint32_t number_of(const sample_t *sample)
{
    return sample->pixel_y * (uint32_t)sample->setup->settings.width + sample->pixel_x;
}

/* The numbers of the sample's pixel. */
static sampler_t numbers_of(const sample_t *sample)
{
    const job_settings_t *settings = &sample->setup->settings;
    return sampler_new(settings->sampler, settings->seed, number_of(sample), sample->sample);
}

/* The light subpaths that the block of a first sample has: as many as the share says, on average. Subpath i
 * brings its splats with pixel (i + turn) % pixels of the block, and so with the tile of that pixel. The turn
 * gives each pixel the same chance to have one: a film that is divided by the samples of all tiles, of which
 * some have more, needs that of tiles which cut a block. */
typedef struct {
    int count, turn;
} light_subpaths_t;

static light_subpaths_t light_subpaths_of(const sample_t *first, int pixels)
{
    float share = first->setup->light_share;
    if (!(share < 1)) return (light_subpaths_t){.count = pixels};
    vec2_t u = sample_2d(first, DIMENSION_EYE + DIMENSION_LIGHT_COUNT);
    return (light_subpaths_t){.count = int_min((int)(share * (float)pixels + u.x), pixels),
                              .turn = int_min((int)(u.y * (float)pixels), pixels - 1)};
}

/* The light half of the samples of a block, whose first one it is. */
static void trace_light(const integrator_ops_t *integrator, const block_t *block, const rect_t *tile,
                        const sample_t *first)
{
    const job_settings_t *settings = &first->setup->settings;
    int pixels = block_pixels(block);
    light_subpaths_t subpaths = light_subpaths_of(first, pixels);
    light_pool_reset(first->pool, pixels);
    for (int i = 0; i < subpaths.count; i++) {
        sample_t sample = sample_of(first, block, i),
                 bringer = sample_of(first, block, (i + subpaths.turn) % pixels);
        sample.numbers = sampler_new_member(settings->sampler, settings->seed, number_of(first),
                                            sample.sample, (uint32_t)i);
        integrator->light(&sample, rect_has(tile, (int)bringer.pixel_x, (int)bringer.pixel_y));
    }
}

/* The eye half of a sample of a pixel of the tile. */
static void trace_eye(const integrator_ops_t *integrator, const rect_t *tile, sample_t *sample)
{
    size_t row = (size_t)(tile->x1 - tile->x0), pixels = row * (size_t)(tile->y1 - tile->y0);
    size_t pixel = (sample->pixel_y - (size_t)tile->y0) * row + sample->pixel_x - (size_t)tile->x0;
    rgb_t value = integrator->sample(sample);
    add_eye_sample(sample->setup, sample, pixel, pixels, value);
    unit_result_feature(sample->result, pixel, sample->sample, &sample->first_hit);
}

/* The samples of one index of what of a block is in the tile. */
static void render_block(const integrator_ops_t *integrator, const block_t *block, const rect_t *tile,
                         const sample_t *shared)
{
    sample_t first = sample_of(shared, block, 0);
    first.numbers = numbers_of(&first);
    first.time = shared->photons != NULL ? shared->photons->time : sample_time(&first);
    waves_t waves;
    sample_waves(&first, &waves);
    if (integrator->light != NULL) trace_light(integrator, block, tile, &first);
    for (int i = 0; i < block_pixels(block); i++) {
        sample_t sample = sample_of(&first, block, i);
        if (!rect_has(tile, (int)sample.pixel_x, (int)sample.pixel_y)) continue;
        sample.numbers = numbers_of(&sample);
        if (integrator->light == NULL) {
            sample.time = sample_time(&sample);
            sample_waves(&sample, &waves);
        }
        trace_eye(integrator, tile, &sample);
    }
}

/* The samples from `first` to before `end` of all pixels of the unit's tile; false when cancelled. */
static bool render_run(const renderer_t *renderer, const unit_t *unit, uint32_t first, uint32_t end,
                       const photon_set_t *photons, light_pool_t *pool, unit_result_t *result,
                       const atomic_bool *cancel)
{
    const setup_t *setup = setup_of(renderer, unit);
    rect_t tile = job_tile_rect(&setup->settings, unit->tile);
    int x0 = tile.x0 / POOL_REGION * POOL_REGION, y0 = tile.y0 / POOL_REGION * POOL_REGION;
    for (int y = y0; y < tile.y1; y = next_block(y))
        for (int x = x0; x < tile.x1; x = next_block(x)) {
            block_t block = block_at(&setup->settings, x, y);
            for (uint32_t i = first; i < end; i++) {
                if (atomic_load_explicit(cancel, memory_order_relaxed)) return false;
                sample_t shared = {
                    .setup = setup, .sample = i, .photons = photons, .pool = pool, .result = result};
                render_block(renderer->integrator, &block, &tile, &shared);
            }
        }
    return true;
}

/* The same of a job that merges: sample by sample, since each index has its own photons. */
static bool render_merging(const renderer_t *renderer, const unit_t *unit, light_pool_t *pool,
                           unit_result_t *result, const atomic_bool *cancel)
{
    bool complete = true;
    for (uint32_t i = unit->first; complete && i < unit_end(unit); i++) {
        const photon_set_t *photons = photons_hold(renderer->photons, i, cancel);
        complete = photons != NULL && render_run(renderer, unit, i, i + 1, photons, pool, result, cancel);
        if (photons != NULL) photons_release(renderer->photons, photons);
    }
    return complete;
}

bool renderer_unit(const renderer_t *renderer, const unit_t *unit, unit_result_t *result,
                   const atomic_bool *cancel)
{
    flush_denormals();
    uint64_t begin = thread_cpu_us();
    unit_result_reset(result, &renderer->setup.settings, unit);
    light_pool_t *pool = light_pool_new();
    bool complete = renderer->photons != NULL
                        ? render_merging(renderer, unit, pool, result, cancel)
                        : render_run(renderer, unit, unit->first, unit_end(unit), NULL, pool, result, cancel);
    light_pool_destroy(&pool);
    if (!complete) return false;
    uint64_t pixels = job_tile_pixels(&renderer->setup.settings, unit->tile);
    if (renderer->integrator->traces_light)
        for (int half = 0; half < 2; half++)
            result->counts.light_paths[half] = pixels * unit_half_count(unit, half);
    result->counts.cpu_us = thread_cpu_us() - begin;
    return true;
}
