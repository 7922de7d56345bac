/* renderer: units over integrators (see renderer.h). */
#include "worker/render/renderer.h"

#include "worker/render/integrator/integrator.h"

#include <pmmintrin.h>
#include <stdlib.h>
#include <time.h>

struct renderer {
    setup_t setup;
    scene_t *scene;
    lights_t *lights;
    camera_t *camera;
    const integrator_ops_t *integrator;
};

static const integrator_ops_t *const integrators[] = {
    [INTEGRATOR_BDPT] = &integrator_bdpt,
    [INTEGRATOR_PATH] = &integrator_path,
    [INTEGRATOR_LIGHT] = &integrator_light,
};

/* Embree's and our own results depend on it: denormals are flushed on every thread that renders. */
static void flush_denormals(void)
{
    _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
    _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
}

result_t renderer_new(const scene_blob_t *blob, const job_settings_t *settings, renderer_t **result)
{
    *result = NULL;
    flush_denormals();
    renderer_t *renderer = mem_zalloc(1, sizeof *renderer);
    result_t made = scene_new(blob, &renderer->scene);
    if (made.code != RESULT_OK) {
        free(renderer);
        return made;
    }
    renderer->lights = lights_new(renderer->scene);
    renderer->camera = camera_new(blob->scene, settings->width, settings->height);
    renderer->integrator = integrators[settings->integrator];
    setup_t *setup = &renderer->setup;
    setup->scene = renderer->scene;
    setup->lights = renderer->lights;
    setup->settings = *settings;
    setup->camera = renderer->camera;
    setup->moves = scene_moves(renderer->scene) || camera_moves(renderer->camera);
    setup->regularizes = blob->scene->regularize != 0;
    setup->max_luminance = blob->scene->max_luminance;
    filter_init(&setup->filter, &blob->scene->filter);
    *result = renderer;
    return result_ok();
}

void renderer_destroy(renderer_t **renderer)
{
    renderer_t *self = *renderer;
    if (self == NULL) return;
    lights_destroy(&self->lights);
    free(self->camera);
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

/* Adds what the eye subpath of a sample brought to its pixel of the unit's tile. */
static void add_eye_sample(const setup_t *setup, const sample_t *sample, size_t pixel, rgb_t value)
{
    unit_result_t *result = sample->result;
    float luminance = rgb_luminance(value);
    if (luminance > setup->max_luminance) value = v_scale(value, setup->max_luminance / luminance);
    value = v_scale(value, sample->eye_weight);
    if (!v_is_finite(value)) {
        result->counts.dropped++;
        return;
    }
    result->counts.overflows += film_add(result->sums[SUM_EYE].values + 3 * pixel,
                                         (float[3]){value.x, value.y, value.z}, setup->settings.film_scale);
}

bool renderer_unit(const renderer_t *renderer, const unit_t *unit, unit_result_t *result,
                   const atomic_bool *cancel)
{
    const job_settings_t *settings = &renderer->setup.settings;
    flush_denormals();
    uint64_t begin = thread_cpu_us();
    unit_result_reset(result, settings, unit);
    rect_t rect = job_tile_rect(settings, unit->tile);
    size_t row = (size_t)(rect.x1 - rect.x0), half_pixels = row * (size_t)(rect.y1 - rect.y0);
    for (int y = rect.y0; y < rect.y1; y++)
        for (int x = rect.x0; x < rect.x1; x++) {
            if (atomic_load_explicit(cancel, memory_order_relaxed)) return false;
            size_t pixel = (size_t)(y - rect.y0) * row + (size_t)(x - rect.x0);
            for (uint32_t i = unit->first; i < unit->first + unit->count; i++) {
                sample_t sample = {.setup = &renderer->setup,
                                   .pixel_x = (uint32_t)x,
                                   .pixel_y = (uint32_t)y,
                                   .sample = i,
                                   .numbers = sampler_new(settings->sampler, settings->seed,
                                                          (uint32_t)(y * settings->width + x), i),
                                   .result = result};
                sample.time = sample_time(&sample);
                rgb_t value = renderer->integrator->sample(&sample);
                add_eye_sample(&renderer->setup, &sample, pixel + (i & 1) * half_pixels, value);
                unit_result_feature(result, pixel, i, &sample.first_hit);
            }
        }
    if (renderer->integrator->traces_light)
        for (int half = 0; half < 2; half++)
            result->counts.light_paths[half] = (uint64_t)half_pixels * unit_half_count(unit, half);
    result->counts.cpu_us = thread_cpu_us() - begin;
    return true;
}
