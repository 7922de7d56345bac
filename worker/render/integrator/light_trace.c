/* light_trace: paths from the lights, every vertex of which is connected to the camera (Dutre, Lafortune and
 * Willems 1993); an eye ray of one segment adds the lights that are seen directly. It sees all but what is
 * seen through mirrors and lenses, and checks the light half of bdpt.
 */
#include "worker/render/integrator/integrator.h"

/* Joins a vertex to the camera. `first`: the ray that came straight from the light, or NULL. */
static void splat_vertex(sample_t *sample, const surface_t *surface, const bsdf_t *bsdf, vec3_t wo,
                         rgb_t throughput, const light_ray_t *first, uint32_t dimension)
{
    camera_view_t view;
    bsdf_value_t scattered;
    float share = 1;
    if (!sample_join_camera(sample, surface->p, dimension, &view)) return;
    if (!bsdf_eval(bsdf, wo, view.w, TRANSPORT_IMPORTANCE, &scattered)) {
        if (!first || !splits_direct_light(surface) ||
            !bsdf_eval_split(bsdf, wo, view.w, TRANSPORT_IMPORTANCE, &scattered))
            return;
        float distance2 = first->at_infinity ? 1 : v_length2(v_sub(surface->p, first->point));
        float arrives = first->pdf_ray * fabsf(v_dot(wo, surface->ng)) / distance2;
        float seen = view.density * fabsf(v_dot(view.w, surface->ng));
        share = split_light_share(first->delta, first->pdf_place, arrives / seen);
    }
    float factor = share * fabsf(v_dot(view.w, bsdf->ns)) * shading_adjoint(bsdf, wo, view.w) * view.density;
    rgb_t value = v_scale(v_mul(throughput, scattered.f), factor);
    if (bsdf->absorbs)
        value = v_mul(value,
                      rgb_fade(bsdf_attenuation(bsdf, view.w), v_length(v_sub(view.position, surface->p))));
    if (v_is_zero(value)) return;
    sample->result->counts.rays++;
    if (scene_occluded(sample->stage->scene, scene_offset(surface, view.w), view.position, sample->time))
        return;
    sample_splat(sample, view.raster, value, dimension);
}

static void trace_light_path(sample_t *sample)
{
    const stage_t *stage = sample->stage;
    light_ray_t ray;
    sampler_t sampler = sample_stream(sample, DIMENSION_LIGHT + DIMENSION_EMIT);
    float choice = sampler_1d(&sampler);
    vec2_t place = sampler_2d(&sampler);
    if (lights_empty(stage->lights) || !lights_emit(stage->lights, choice, place, sampler_2d(&sampler), &ray))
        return;
    rgb_t throughput = ray.throughput, attenuation = vec3(0, 0, 0);
    float brightest = v_max(throughput);
    bool scattered = false;
    vec3_t origin = ray.origin, direction = ray.direction, before = ray.origin;
    /* The last segment is the one to the camera. */
    for (int segment = 1; segment < stage_max_segments(stage); segment++) {
        surface_t surface;
        bsdf_t bsdf;
        bsdf_sample_t next;
        uint32_t dimension = DIMENSION_LIGHT + (uint32_t)segment * DIMENSION_STRIDE;
        sample->result->counts.rays++;
        if (!scene_intersect(stage->scene, origin, direction, sample->time, &surface)) return;
        if (!v_is_zero(attenuation))
            throughput = v_mul(throughput, rgb_fade(attenuation, v_length(v_sub(surface.p, before))));
        bsdf_init(&bsdf, stage->scene, &surface);
        if (stage->regularizes && scattered) bsdf_regularize(&bsdf);
        vec3_t wo = v_neg(direction);
        sampler = sample_stream(sample, dimension + DIMENSION_LIGHT_SCATTER);
        vec2_t u = sampler_2d(&sampler), choices = sampler_2d(&sampler);
        if (!bsdf.specular)
            splat_vertex(sample, &surface, &bsdf, wo, throughput, segment == 1 ? &ray : NULL, dimension);
        if (!bsdf_sample(&bsdf, wo, u, choices.x, TRANSPORT_IMPORTANCE, &next)) return;
        throughput = v_scale(v_mul(throughput, next.weight), shading_adjoint(&bsdf, wo, next.wi));
        float survive = float_min(1, v_max(throughput) / brightest);
        if (!(choices.y < survive)) return;
        throughput = v_scale(throughput, 1 / survive);
        scattered = scattered || !next.specular;
        direction = next.wi;
        before = surface.p;
        origin = scene_offset(&surface, direction);
        attenuation = bsdf_attenuation(&bsdf, direction);
    }
}

/* What the eye ray sees shining by itself. */
static rgb_t seen_light(sample_t *sample)
{
    const stage_t *stage = sample->stage;
    camera_ray_t eye;
    surface_t surface;
    light_hit_t hit;
    rgb_t sum = vec3(0, 0, 0);
    sample_eye_ray(sample, &eye);
    sample->result->counts.rays++;
    if (!scene_intersect(stage->scene, eye.origin, eye.direction, sample->time, &surface)) {
        for (uint32_t k = 0; k < lights_sky_count(stage->lights); k++)
            if (lights_escape(stage->lights, k, eye.direction, &hit)) sum = v_add(sum, hit.radiance);
        return sum;
    }
    bsdf_t bsdf;
    bsdf_init(&bsdf, stage->scene, &surface);
    sample_first_hit(sample, &surface, &bsdf, eye.origin);
    if (surface.light == BLOB_NONE || !lights_hit(stage->lights, &surface, v_neg(eye.direction), &hit))
        return sum;
    return hit.radiance;
}

static rgb_t light_sample(sample_t *sample)
{
    trace_light_path(sample);
    return seen_light(sample);
}

const integrator_ops_t integrator_light = {.sample = light_sample, .traces_light = true};
