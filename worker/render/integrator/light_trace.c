/* light_trace: paths from the lights, every vertex of which is connected to the camera (Dutre, Lafortune and
 * Willems 1993); an eye ray of one segment adds the lights that are seen directly. It sees all but what is
 * seen through mirrors and lenses, and checks the light half of bdpt. Through a camera's lens of elements it
 * would see nothing: such a job is refused (renderer.c).
 */
#include "worker/render/integrator/subpath.h"

static const roulette_t roulette = {.from = 1, .most = 1};

/* Joins a vertex of the walk that began with the ray to the camera. */
static void splat_vertex(sample_t *sample, const vertex_t *y, const walk_t *walk, const light_ray_t *ray)
{
    camera_view_t view;
    bsdf_value_t value;
    float share = 1;
    if (!sample_join_camera(sample, vertex_point(y), y->dimension, &view)) return;
    const setup_t *setup = sample->setup;
    if (!join_is_near(setup, y, vertex_medium(y, view.w).number, 0, 0, setup->medium)) return;
    if (!vertex_eval(y, view.w, &value)) {
        float distance2, arrives = y->depth == 1 ? walk_density(walk, y, &distance2) : 0;
        float seen = view.density * vertex_area_cosine(y, view.w);
        if (y->depth > 1 ||
            !vertex_eval_split(y, view.w, ray->delta, ray->pdf_place, arrives / seen, &value, &share))
            return;
    }
    float factor = share * vertex_cosine(y, view.w) * vertex_adjoint(y, view.w) * view.density;
    rgb_t result = v_scale(v_mul(y->throughput, value.f), factor);
    if (v_is_zero(result)) return;
    result = transmit(sample, vertex_exit(y, view.w), view.position, vertex_medium(y, view.w),
                      v_length(v_sub(view.position, vertex_point(y))), true, result);
    if (!v_is_zero(result)) sample_splat(sample, view.raster, result, ray->light, y->dimension);
}

static void trace_light_path(sample_t *sample)
{
    const setup_t *setup = sample->setup;
    walk_t walk;
    light_ray_t ray;
    if (!walk_from_light(sample, roulette, &walk, &ray)) return;
    /* The last segment is the one to the camera. */
    int segments = light_segments(setup);
    vertex_t y;
    y.length = 0;
    y.bounds = false;
    do {
        if (!vertex_has_room(&y, segments)) return;
        walk_arrive(&walk, sample, &y);
        if (y.kind == VERTEX_SKY || vertex_is_for_eyes(&y)) return;
        if (y.length > segments || y.within > WITHIN_MOST) return;
        walk_shade(&walk, sample, &y);
        rgb_t throughput = y.throughput;
        if (vertex_is_joinable(&y) && vertex_joins(&y, sample, &y.throughput))
            splat_vertex(sample, &y, &walk, &ray);
        y.throughput = throughput;
    } while (walk_scatter(&walk, sample, &y));
}

/* What the eye ray sees shining by itself. */
static rgb_t seen_light(sample_t *sample)
{
    const setup_t *setup = sample->setup;
    vertex_t z;
    light_hit_t hit;
    rgb_t sum = vec3(0, 0, 0);
    walk_t walk = walk_from_camera(sample, roulette);
    walk_arrive(&walk, sample, &z);
    for (uint32_t k = 0; k < vertex_light_count(&z, setup->lights); k++)
        if (vertex_light_hit(&z, sample, k, walk.point, &hit)) {
            rgb_t arrives = v_mul(z.throughput, hit.radiance);
            sum = v_add(sum, arrives);
            sample_lit(sample, hit.light, arrives);
        }
    sum = v_add(sum, walk.glow);
    if (z.kind == VERTEX_SKY) return sum;
    vertex_shade(&z, sample, false);
    vertex_first_hit(&z, sample, walk.origin);
    return sum;
}

static rgb_t light_sample(sample_t *sample)
{
    trace_light_path(sample);
    return seen_light(sample);
}

const integrator_ops_t integrator_light = {.sample = light_sample, .traces_light = true};
