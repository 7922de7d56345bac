/* path: unidirectional path tracing with next-event estimation, combined with running into lights by the
 * power heuristic (Kajiya 1986; Veach 1997, section 10.3), and Russian roulette. */
#include "worker/render/integrator.h"

/* Power heuristic of two strategies, beta = 2 (Veach 1997, equation 9.13). */
static float power_heuristic(float pdf, float other)
{
    float ratio = other / pdf;
    return 1 / (1 + ratio * ratio);
}

/* Radiance that a sampled light point sends over the path's end. */
static rgb_t direct_light(sample_t *sample, const surface_t *surface, const bsdf_t *bsdf, vec3_t wo,
                          sampler_t *sampler)
{
    const stage_t *stage = sample->stage;
    light_point_t light;
    float choice = sampler_1d(sampler);
    lights_sample(stage->lights, choice, sampler_2d(sampler), &light);
    vec3_t d = v_sub(light.p, surface->p);
    float distance2 = v_length2(d);
    if (!(distance2 > 0)) return vec3(0, 0, 0);
    vec3_t wi = v_scale(d, 1 / sqrtf(distance2));
    rgb_t radiance = light_radiance(&light, v_neg(wi));
    bsdf_value_t value;
    if (v_is_zero(radiance) || !bsdf_eval(bsdf, wo, wi, TRANSPORT_RADIANCE, &value)) return vec3(0, 0, 0);
    /* From area to solid angle. */
    float cos_light = fabsf(v_dot(light.n, wi)), pdf = light.pdf_area * distance2 / cos_light;
    float factor = fabsf(v_dot(wi, bsdf->ns)) / pdf * power_heuristic(pdf, value.pdf);
    rgb_t result = v_scale(v_mul(value.f, radiance), factor);
    if (!(cos_light > 0) || v_is_zero(result)) return vec3(0, 0, 0);
    sample->result->counts.rays++;
    return scene_occluded(stage->scene, scene_offset(surface, wi), light_offset(&light, v_neg(wi)))
               ? vec3(0, 0, 0)
               : result;
}

/* Radiance of a light that the path ran into, weighted against next-event estimation from the vertex before.
 */
static rgb_t emitted_light(const stage_t *stage, const surface_t *surface, vec3_t wo, float distance2,
                           float bsdf_pdf, bool only_way)
{
    light_point_t light;
    lights_at(stage->lights, surface, &light);
    rgb_t radiance = light_radiance(&light, wo);
    if (only_way || v_is_zero(radiance)) return radiance;
    float pdf = light.pdf_area * distance2 / fabsf(v_dot(light.n, wo));
    return v_scale(radiance, power_heuristic(bsdf_pdf, pdf));
}

static rgb_t path_sample(sample_t *sample)
{
    const stage_t *stage = sample->stage;
    sampler_t sampler = sample_stream(sample, DIMENSION_EYE);
    rgb_t radiance = vec3(0, 0, 0), throughput = vec3(1, 1, 1);
    float pdf;
    vec3_t origin = stage->camera.position, direction = sample_eye_ray(sample, sampler_2d(&sampler), &pdf);
    vec3_t before = origin;
    bool specular = true; /* no next-event estimation could have found what the ray meets */
    int segments = stage_max_segments(stage);
    for (int segment = 1;; segment++) {
        surface_t surface;
        sampler.dimension = DIMENSION_EYE + (uint32_t)segment * DIMENSION_STRIDE;
        sample->result->counts.rays++;
        if (!scene_intersect(stage->scene, origin, direction, &surface)) break;
        vec3_t wo = v_neg(direction);
        if (surface.light != BLOB_NONE) {
            float distance2 = v_length2(v_sub(surface.p, before));
            rgb_t emitted = emitted_light(stage, &surface, wo, distance2, pdf, specular);
            radiance = v_add(radiance, v_mul(throughput, emitted));
        }
        if (segment >= segments) break;
        bsdf_t bsdf;
        bsdf_init(&bsdf, &surface);
        if (!bsdf.specular && !lights_empty(stage->lights))
            radiance =
                v_add(radiance, v_mul(throughput, direct_light(sample, &surface, &bsdf, wo, &sampler)));
        sampler.dimension = DIMENSION_EYE + (uint32_t)segment * DIMENSION_STRIDE + 2;
        bsdf_sample_t next;
        vec2_t u = sampler_2d(&sampler), choice = sampler_2d(&sampler);
        if (!bsdf_sample(&bsdf, wo, u, choice.x, TRANSPORT_RADIANCE, &next)) break;
        throughput = v_mul(throughput, next.weight);
        if (segment > 2) {
            float survive = float_min(0.95f, v_max(throughput));
            if (!(choice.y < survive)) break;
            throughput = v_scale(throughput, 1 / survive);
        }
        pdf = next.pdf;
        specular = next.specular;
        direction = next.wi;
        before = surface.p;
        origin = scene_offset(&surface, direction);
    }
    return radiance;
}

const integrator_ops_t integrator_path = {.sample = path_sample, .traces_light = false};
