/* integrator: what all integrators share (see integrator.h). */
#include "worker/render/integrator.h"

vec3_t sample_eye_ray(const sample_t *sample, vec2_t u, float *pdf)
{
    const stage_t *stage = sample->stage;
    vec2_t raster = {(float)sample->pixel_x + 0.5f + filter_sample(&stage->filter.x, u.x),
                     (float)sample->pixel_y + 0.5f + filter_sample(&stage->filter.y, u.y)};
    return camera_ray(&stage->camera, raster, pdf);
}

void sample_splat(sample_t *sample, vec2_t raster, rgb_t value, uint32_t dimension)
{
    const stage_t *stage = sample->stage;
    unit_result_t *result = sample->result;
    float weight_x, weight_y;
    vec2_t u = {0, 0};
    if (!stage->filter.x.is_pixel || !stage->filter.y.is_pixel) {
        sampler_t sampler = sample_stream(sample, dimension);
        u = sampler_2d(&sampler);
    }
    int x = filter_choose_pixel(&stage->filter.x, raster.x, u.x, &weight_x);
    int y = filter_choose_pixel(&stage->filter.y, raster.y, u.y, &weight_y);
    int width = stage->settings.width, height = stage->settings.height;
    if (x < 0 || x >= width || y < 0 || y >= height) return;
    value = v_scale(value, weight_x * weight_y);
    if (!v_is_finite(value)) {
        result->counts.dropped++;
        return;
    }
    if (result->splat_count == result->splat_capacity) {
        result->splat_capacity = 2 * result->splat_capacity + 1024;
        result->splats = mem_realloc(result->splats, result->splat_capacity * sizeof *result->splats);
    }
    uint32_t pixel = (uint32_t)y * (uint32_t)width + (uint32_t)x;
    result->splats[result->splat_count++] =
        (splat_t){pixel | (sample->sample & 1 ? SPLAT_HALF_BIT : 0), {value.x, value.y, value.z}};
}
