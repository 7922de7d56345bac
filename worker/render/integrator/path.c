/* path: unidirectional path tracing with next-event estimation, combined with running into lights by the
 * power heuristic (Kajiya 1986; Veach 1997, section 10.3), and Russian roulette. */
#include "worker/render/integrator/integrator.h"

/* Power heuristic of two strategies, beta = 2 (Veach 1997, equation 9.13). */
static float power_heuristic(float pdf, float other)
{
    float ratio = other / pdf;
    return 1 / (1 + ratio * ratio);
}

/* A path on its way. */
typedef struct {
    vec3_t origin, direction;
    vec3_t before; /* the vertex that the ray leaves */
    float pdf;     /* of the direction, per steradian */
    bool specular; /* no next-event estimation could have found what the ray meets */
    bool scattered;
    rgb_t throughput, attenuation;
} ray_t;

/* Radiance that a sampled place on a light sends over the path's end. `seen`: the density per area of a first
 * hit, 0 of others. */
static rgb_t direct_light(sample_t *sample, const surface_t *surface, const bsdf_t *bsdf, vec3_t wo,
                          float seen, sampler_t *sampler)
{
    const stage_t *stage = sample->stage;
    light_view_t light;
    bsdf_value_t value;
    float choice = sampler_1d(sampler);
    if (!lights_illuminate(stage->lights, surface->p, choice, sampler_2d(sampler), &light))
        return vec3(0, 0, 0);
    float pdf = light.pdf_place / light.geometry; /* per steradian */
    float factor = fabsf(v_dot(light.w, bsdf->ns)) / pdf;
    if (bsdf_eval(bsdf, wo, light.w, TRANSPORT_RADIANCE, &value)) {
        if (!light.delta) factor *= power_heuristic(pdf, value.pdf);
    } else if (seen > 0 && splits_direct_light(surface) &&
               bsdf_eval_split(bsdf, wo, light.w, TRANSPORT_RADIANCE, &value)) {
        float arrives = light.arrival * fabsf(v_dot(light.w, surface->ng));
        factor *= split_light_share(light.delta, light.pdf_place, arrives / seen);
    } else {
        return vec3(0, 0, 0);
    }
    rgb_t result = v_scale(v_mul(value.f, light.radiance), factor);
    if (bsdf->absorbs)
        result = v_mul(result,
                       rgb_fade(bsdf_attenuation(bsdf, light.w), v_length(v_sub(light.target, surface->p))));
    if (v_is_zero(result)) return result;
    sample->result->counts.rays++;
    return scene_occluded(stage->scene, scene_offset(surface, light.w), light.target, sample->time)
               ? vec3(0, 0, 0)
               : result;
}

/* Radiance of a light that the ray ran into, weighted against next-event estimation from the vertex before;
 * `measure` makes its place's density one per steradian there. */
static rgb_t emitted(const ray_t *ray, const light_hit_t *hit, float measure)
{
    if (ray->specular) return hit->radiance;
    return v_scale(hit->radiance, power_heuristic(ray->pdf, hit->pdf_place * measure));
}

static rgb_t sky_light(const stage_t *stage, const ray_t *ray)
{
    rgb_t sum = vec3(0, 0, 0);
    light_hit_t hit;
    for (uint32_t k = 0; k < lights_sky_count(stage->lights); k++)
        if (lights_escape(stage->lights, k, ray->direction, &hit)) sum = v_add(sum, emitted(ray, &hit, 1));
    return v_mul(ray->throughput, sum);
}

static rgb_t surface_light(const stage_t *stage, const ray_t *ray, const surface_t *surface)
{
    light_hit_t hit;
    vec3_t wo = v_neg(ray->direction);
    if (surface->light == BLOB_NONE || !lights_hit(stage->lights, surface, wo, &hit)) return vec3(0, 0, 0);
    float measure = v_length2(v_sub(surface->p, ray->before)) / fabsf(v_dot(surface->ng, wo));
    return v_mul(ray->throughput, emitted(ray, &hit, measure));
}

/* Scatters. False when the path ends here. */
static bool scatter(ray_t *ray, const surface_t *surface, const bsdf_t *bsdf, sampler_t *sampler,
                    bool roulette)
{
    bsdf_sample_t next;
    vec2_t u = sampler_2d(sampler), choice = sampler_2d(sampler);
    if (!bsdf_sample(bsdf, v_neg(ray->direction), u, choice.x, TRANSPORT_RADIANCE, &next)) return false;
    ray->throughput = v_mul(ray->throughput, next.weight);
    if (roulette) {
        float survive = float_min(0.95f, v_max(ray->throughput));
        if (!(choice.y < survive)) return false;
        ray->throughput = v_scale(ray->throughput, 1 / survive);
    }
    ray->pdf = next.pdf;
    ray->specular = next.specular;
    ray->scattered = ray->scattered || !next.specular;
    ray->direction = next.wi;
    ray->before = surface->p;
    ray->origin = scene_offset(surface, next.wi);
    ray->attenuation = bsdf_attenuation(bsdf, next.wi);
    return true;
}

/* Density per area with which the camera finds its first hit. */
static float density_seen(const camera_ray_t *eye, const surface_t *surface)
{
    float distance2 = eye->parallel ? 1 : v_length2(v_sub(surface->p, eye->origin));
    return eye->pdf * fabsf(v_dot(surface->ng, eye->direction)) / distance2;
}

static rgb_t path_sample(sample_t *sample)
{
    const stage_t *stage = sample->stage;
    camera_ray_t eye;
    sample_eye_ray(sample, &eye);
    rgb_t radiance = vec3(0, 0, 0);
    ray_t ray = {.origin = eye.origin,
                 .direction = eye.direction,
                 .before = eye.origin,
                 .specular = true,
                 .throughput = vec3(1, 1, 1)};
    int segments = stage_max_segments(stage);
    for (int segment = 1;; segment++) {
        surface_t surface;
        bsdf_t bsdf;
        uint32_t dimension = DIMENSION_EYE + (uint32_t)segment * DIMENSION_STRIDE;
        sample->result->counts.rays++;
        if (!scene_intersect(stage->scene, ray.origin, ray.direction, sample->time, &surface))
            return v_add(radiance, sky_light(stage, &ray));
        if (!v_is_zero(ray.attenuation))
            ray.throughput =
                v_mul(ray.throughput, rgb_fade(ray.attenuation, v_length(v_sub(surface.p, ray.before))));
        radiance = v_add(radiance, surface_light(stage, &ray, &surface));
        if (segment >= segments && segment > 1) return radiance;
        bsdf_init(&bsdf, stage->scene, &surface);
        if (stage->regularizes && ray.scattered) bsdf_regularize(&bsdf);
        if (segment == 1) sample_first_hit(sample, &surface, &bsdf, eye.origin);
        if (segment >= segments) return radiance;
        if (!bsdf.specular && !lights_empty(stage->lights)) {
            sampler_t sampler = sample_stream(sample, dimension + DIMENSION_ILLUMINATE);
            rgb_t direct = direct_light(sample, &surface, &bsdf, v_neg(ray.direction),
                                        segment == 1 ? density_seen(&eye, &surface) : 0, &sampler);
            radiance = v_add(radiance, v_mul(ray.throughput, direct));
        }
        sampler_t sampler = sample_stream(sample, dimension + DIMENSION_SCATTER);
        if (!scatter(&ray, &surface, &bsdf, &sampler, segment > 2)) return radiance;
    }
}

const integrator_ops_t integrator_path = {.sample = path_sample, .traces_light = false};
