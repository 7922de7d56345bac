/* integrator: what all integrators share (see integrator.h). */
#include "worker/render/integrator/integrator.h"

/* Numbers for the point of the lens; a pinhole needs none. */
static vec2_t sample_lens(const sample_t *sample, uint32_t dimension)
{
    return camera_has_lens(sample->setup->camera) ? sample_2d(sample, dimension) : (vec2_t){0, 0};
}

void sample_eye_ray(sample_t *sample, camera_ray_t *ray)
{
    const setup_t *setup = sample->setup;
    vec2_t u = sample_2d(sample, DIMENSION_EYE + DIMENSION_FILTER);
    vec2_t lens = sample_lens(sample, DIMENSION_EYE + DIMENSION_LENS);
    float weight_x, weight_y;
    vec2_t raster = {(float)sample->pixel_x + 0.5f + filter_sample(&setup->filter.x, u.x, &weight_x),
                     (float)sample->pixel_y + 0.5f + filter_sample(&setup->filter.y, u.y, &weight_y)};
    sample->eye_weight = weight_x * weight_y;
    camera_ray(setup->camera, raster, lens, sample->time, ray);
    sample->eye_weight *= ray->weight;
}

float sample_time(const sample_t *sample)
{
    return sample->setup->moves ? sample_2d(sample, DIMENSION_EYE + DIMENSION_TIME).x : 0;
}

void sample_waves(sample_t *sample, waves_t *waves)
{
    const waves_tables_t *tables = sample->setup->waves;
    if (tables == NULL) return;
    *waves = waves_draw(tables, sample_2d(sample, DIMENSION_EYE + DIMENSION_WAVES).x);
    sample->waves = waves;
}

rgb_t sample_light_waves(const sample_t *sample, uint32_t light, rgb_t radiance)
{
    const scene_blob_t *blob = scene_blob(sample->setup->scene);
    const blob_value_t *value = &blob->lights[light].radiance;
    if (value->spectrum == 0 || value->texture != 0) return waves_light(sample->waves, radiance);
    return v_scale(waves_spectrum(sample->waves, &blob->spectra[value->spectrum - 1]), v_max(radiance));
}

bool sample_join_camera(const sample_t *sample, vec3_t p, uint32_t dimension, camera_view_t *view)
{
    const setup_t *setup = sample->setup;
    vec2_t lens = sample_lens(sample, dimension + DIMENSION_JOIN_LENS);
    return camera_project(setup->camera, p, lens, sample->time, filter_reach(&setup->filter), view);
}

/* Scales a value down to the luminance that the scene allows. */
static rgb_t clamp_luminance(const setup_t *setup, rgb_t value)
{
    float luminance = rgb_luminance(value);
    return luminance > setup->max_luminance ? v_scale(value, setup->max_luminance / luminance) : value;
}

/* What a splat says beside its pixel (splat_t): its half, and its light group. */
static uint32_t splat_marks(const sample_t *sample, uint32_t light)
{
    const uint8_t *groups = sample->setup->light_groups;
    uint32_t half = sample->sample & 1 ? SPLAT_HALF_BIT : 0;
    return groups != NULL ? half | (uint32_t)groups[light] << SPLAT_GROUP_SHIFT : half;
}

/* A splat at one film position. */
static void splat_at(sample_t *sample, vec2_t raster, rgb_t value, uint32_t light, vec2_t u)
{
    const setup_t *setup = sample->setup;
    unit_result_t *result = sample->result;
    float weight_x, weight_y;
    int x = filter_choose_pixel(&setup->filter.x, raster.x, u.x, &weight_x);
    int y = filter_choose_pixel(&setup->filter.y, raster.y, u.y, &weight_y);
    int width = setup->settings.width, height = setup->settings.height;
    if (x < 0 || x >= width || y < 0 || y >= height) return;
    value = v_scale(clamp_luminance(setup, value), weight_x * weight_y);
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
        (splat_t){pixel | splat_marks(sample, light), {value.x, value.y, value.z}};
}

void sample_splat(sample_t *sample, vec2_t raster, rgb_t value, uint32_t light, uint32_t dimension)
{
    value = sample_colour(sample, value);
    const filter_t *filter = &sample->setup->filter;
    if (filter->x.is_pixel && filter->y.is_pixel) {
        splat_at(sample, raster, value, light, (vec2_t){0, 0});
        return;
    }
    vec2_t images[CAMERA_IMAGES], u = sample_2d(sample, dimension + DIMENSION_JOIN_PIXEL);
    int count = camera_images(sample->setup->camera, raster, filter_reach(filter), images);
    for (int i = 0; i < count; i++) splat_at(sample, images[i], value, light, u);
}
