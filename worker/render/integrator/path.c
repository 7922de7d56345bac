/* path: unidirectional path tracing with next-event estimation, combined with running into lights by the
 * power heuristic (Kajiya 1986; Veach 1997, section 10.3), and Russian roulette. */
#include "worker/render/integrator/subpath.h"

static const roulette_t roulette = {.from = 3, .most = 0.95f};

/* Power heuristic of two strategies, beta = 2 (Veach 1997, equation 9.13). */
static float power_heuristic(float pdf, float other)
{
    float ratio = other / pdf;
    return 1 / (1 + ratio * ratio);
}

/* Radiance that the k-th sampled place on a light sends over the vertex. */
static rgb_t direct_light(sample_t *sample, const walk_t *walk, const vertex_t *z, uint32_t k)
{
    light_view_t light;
    bsdf_value_t value;
    float weight = 1;
    if (!vertex_view_light(z, sample, k, &light)) return vec3(0, 0, 0);
    medium_t medium = vertex_medium_to(z, &light);
    if (!join_is_near(sample->setup, z, medium.number, 0, 0, light.medium)) return vec3(0, 0, 0);
    float density = light.density / light.geometry; /* per steradian */
    if (vertex_eval(z, light.w, &value)) {
        float counted = z->first ? first_worth(z->kind == VERTEX_MEDIUM) * density : density;
        if (!light.delta) weight = power_heuristic(counted, value.pdf);
    } else {
        float distance2, seen = z->depth == 1 ? walk_density(walk, z, &distance2) : 0;
        if (!(seen > 0) || !vertex_split_light(z, &light, seen, &value, &weight)) return vec3(0, 0, 0);
    }
    rgb_t result = v_scale(v_mul(value.f, light.radiance), vertex_cosine(z, light.w) / density * weight);
    if (v_is_zero(result)) return result;
    result = transmit(sample, vertex_exit(z, light.w), light.target, medium,
                      v_length(v_sub(light.target, vertex_point(z))), false, result);
    sample_lit(sample, light.light, v_mul(z->throughput, result));
    return result;
}

/* Radiance of the lights that the walk ran into, weighted against next-event estimation from the vertex
 * before, where it could have found them. */
static rgb_t emitted(sample_t *sample, const walk_t *walk, const vertex_t *z)
{
    const setup_t *setup = sample->setup;
    rgb_t sum = vec3(0, 0, 0);
    for (uint32_t k = 0; k < vertex_light_count(z, setup->lights); k++) {
        light_hit_t hit;
        if (!vertex_light_hit(z, sample, k, walk->point, &hit)) continue;
        /* makes the place's density one per steradian at the vertex before */
        float measure = z->kind == VERTEX_SKY
                            ? 1
                            : v_length2(v_sub(vertex_point(z), walk->point)) / vertex_area_cosine(z, z->wo);
        bool found = z->depth > 1 && walk->joinable;
        float count =
            hit.view_ratio * (walk->first ? first_light_count(setup, hit.light, walk->in_medium) : 1);
        float weight = found ? power_heuristic(walk->pdf, count * hit.pdf_place * measure) : 1;
        rgb_t radiance = v_scale(hit.radiance, weight);
        sum = v_add(sum, radiance);
        sample_lit(sample, hit.light, v_mul(z->throughput, radiance));
    }
    return sum;
}

/* Adds what the lights that the vertex is joined to bring. */
static void add_next_event(sample_t *sample, const walk_t *walk, vertex_t *z, rgb_t *radiance)
{
    rgb_t throughput = z->throughput;
    if (!vertex_joins(z, sample, &z->throughput)) return;
    if (z->twice) z->throughput = v_scale(z->throughput, 0.5f);
    for (uint32_t k = 0; k < vertex_view_count(z, sample->setup->lights); k++)
        *radiance = v_add(*radiance, v_mul(z->throughput, direct_light(sample, walk, z, k)));
    z->throughput = throughput;
}

/* The same at the end of the other flight of a walk. */
static void add_flight(sample_t *sample, flights_t *flights, rgb_t *radiance)
{
    walk_t walk;
    vertex_t z;
    if (!walk_other_flight(flights, sample, &walk, &z)) return;
    walk_shade(&walk, sample, &z);
    add_next_event(sample, &walk, &z, radiance);
}

/* What the walk from the camera brings from the lights. */
static rgb_t gather(sample_t *sample, walk_t *walk)
{
    const setup_t *setup = sample->setup;
    int segments = setup_max_segments(setup);
    rgb_t radiance = vec3(0, 0, 0);
    vec3_t eye = walk->origin;
    flights_t flights;
    for (;;) {
        vertex_t z;
        if (walk_fly(walk, sample, &z, &flights)) add_flight(sample, &flights, &radiance);
        if (!vertex_is_near(&z, setup)) return radiance;
        if (vertex_light_count(&z, setup->lights) > 0)
            radiance = v_add(radiance, v_mul(z.throughput, emitted(sample, walk, &z)));
        bool ends = !vertex_has_room(&z, segments);
        if (z.kind == VERTEX_SKY || (ends && z.depth > 1)) return radiance;
        walk_shade(walk, sample, &z);
        if (z.depth == 1) vertex_first_hit(&z, sample, eye);
        if (ends) return radiance;
        if (vertex_is_joinable(&z) && !lights_empty(setup->lights))
            add_next_event(sample, walk, &z, &radiance);
        if (!walk_scatter(walk, sample, &z)) return radiance;
    }
}

static rgb_t path_sample(sample_t *sample)
{
    walk_t walk = walk_from_camera(sample, roulette);
    if (sample->eye_weight == 0) return vec3(0, 0, 0);
    rgb_t radiance = gather(sample, &walk);
    return v_add(radiance, walk.glow);
}

const integrator_ops_t integrator_path = {.sample = path_sample, .traces_light = false};
