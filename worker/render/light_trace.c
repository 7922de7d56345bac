/* light_trace: paths from the lights alone; every vertex is connected to the camera (Dutre, Lafortune and
 * Willems 1993). It sees all but what is seen through mirrors and lenses, and checks the light half of bdpt.
 */
#include "worker/render/integrator.h"

/* Splats `value` (throughput times scattering towards the camera) from a point that the camera can see. */
static void splat_if_visible(sample_t *sample, vec3_t from, const camera_view_t *view, rgb_t value,
                             uint32_t dimension)
{
    const stage_t *stage = sample->stage;
    if (v_is_zero(value)) return;
    sample->result->counts.rays++;
    if (scene_occluded(stage->scene, from, stage->camera.position)) return;
    sample_splat(sample, view->raster, value, dimension);
}

static void splat_light(sample_t *sample, const light_point_t *light, uint32_t dimension)
{
    camera_view_t view;
    if (!camera_project(&sample->stage->camera, light->p, filter_reach(&sample->stage->filter), &view))
        return;
    float cos = fabsf(v_dot(light->n, view.w));
    rgb_t value = v_scale(light_radiance(light, view.w),
                          view.we_cos * cos / (view.distance * view.distance * light->pdf_area));
    splat_if_visible(sample, light_offset(light, view.w), &view, value, dimension);
}

static void splat_vertex(sample_t *sample, const surface_t *surface, const bsdf_t *bsdf, vec3_t wo,
                         rgb_t throughput, uint32_t dimension)
{
    camera_view_t view;
    bsdf_value_t scattered;
    if (!camera_project(&sample->stage->camera, surface->p, filter_reach(&sample->stage->filter), &view) ||
        !bsdf_eval(bsdf, wo, view.w, TRANSPORT_IMPORTANCE, &scattered))
        return;
    float factor = fabsf(v_dot(view.w, bsdf->ns)) * shading_adjoint(bsdf, wo, view.w) * view.we_cos /
                   (view.distance * view.distance);
    rgb_t value = v_scale(v_mul(throughput, scattered.f), factor);
    splat_if_visible(sample, scene_offset(surface, view.w), &view, value, dimension);
}

static rgb_t light_sample(sample_t *sample)
{
    const stage_t *stage = sample->stage;
    const rgb_t black = vec3(0, 0, 0);
    if (lights_empty(stage->lights)) return black;
    sampler_t sampler = sample_stream(sample, DIMENSION_LIGHT);
    light_point_t light;
    float choice = sampler_1d(&sampler);
    lights_sample(stage->lights, choice, sampler_2d(&sampler), &light);
    vec3_t direction = light_sample_direction(&light, sampler_2d(&sampler));
    splat_light(sample, &light, sampler.dimension);

    float cos = fabsf(v_dot(light.n, direction)),
          pdf = light.pdf_area * light_direction_pdf(&light, direction);
    if (!(pdf > 0)) return black;
    rgb_t throughput = v_scale(light.radiance, cos / pdf);
    float brightest = v_max(throughput);
    vec3_t origin = light_offset(&light, direction);
    /* The last segment is the one to the camera. */
    for (int segment = 1; segment < stage_max_segments(stage); segment++) {
        surface_t surface;
        bsdf_t bsdf;
        sampler.dimension = DIMENSION_LIGHT + (uint32_t)segment * DIMENSION_STRIDE;
        sample->result->counts.rays++;
        if (!scene_intersect(stage->scene, origin, direction, &surface)) break;
        bsdf_init(&bsdf, &surface);
        vec3_t wo = v_neg(direction);
        vec2_t u = sampler_2d(&sampler), choices = sampler_2d(&sampler);
        if (!bsdf.specular) splat_vertex(sample, &surface, &bsdf, wo, throughput, sampler.dimension);
        bsdf_sample_t next;
        if (!bsdf_sample(&bsdf, wo, u, choices.x, TRANSPORT_IMPORTANCE, &next)) break;
        throughput = v_scale(v_mul(throughput, next.weight), shading_adjoint(&bsdf, wo, next.wi));
        float survive = float_min(1, v_max(throughput) / brightest);
        if (!(choices.y < survive)) break;
        throughput = v_scale(throughput, 1 / survive);
        direction = next.wi;
        origin = scene_offset(&surface, direction);
    }
    return black;
}

const integrator_ops_t integrator_light = {.sample = light_sample, .traces_light = true};
