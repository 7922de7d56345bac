/* subpath: see subpath.h. */
#include "worker/render/integrator/subpath.h"

/* Light that was sent through a portal lights nothing before it, which ends the subpath as the sky does; and
 * behind it the densities become those that belong to the point. */
static void enter_portal(walk_t *walk, const sample_t *sample, vertex_t *vertex)
{
    float enter = lights_enter(sample->setup->lights, walk->light, vertex_point(vertex));
    if (!(enter > 0)) vertex->kind = VERTEX_SKY;
    walk->pdf *= enter;
    walk->direct *= square(enter);
    walk->gated = false;
}

void walk_arrive(walk_t *walk, sample_t *sample, vertex_t *vertex)
{
    sample->result->counts.rays++;
    bool looks = walk->mode == TRANSPORT_RADIANCE && !walk->scattered;
    bool hit = (looks ? scene_look : scene_intersect)(sample->setup->scene, walk->origin, walk->direction,
                                                      sample->time, &vertex->surface);
    vertex->kind = hit ? VERTEX_SURFACE : VERTEX_SKY;
    vertex->mode = walk->mode;
    vertex->depth = ++walk->depth;
    vertex->first = !walk->scattered;
    vertex->dimension = walk->dimension += DIMENSION_STRIDE;
    vertex->wo = v_neg(walk->direction);
    vertex->throughput = walk->throughput;
    if (!hit) {
        vertex->surface.p = walk->point;
        return;
    }
    if (walk->depth == 1 && walk->mode == TRANSPORT_IMPORTANCE)
        walk->last *= lights_nearness(sample->setup->lights, walk->light, vertex_point(vertex));
    if (walk->gated) enter_portal(walk, sample, vertex);
    if (medium_absorbs(&walk->medium))
        vertex->throughput =
            v_mul(vertex->throughput,
                  medium_transmittance(&walk->medium, v_length(v_sub(vertex_point(vertex), walk->point))));
}

/* Leaves the vertex in direction w; how it was drawn is noted. */
static void go_on(walk_t *walk, const vertex_t *vertex, vec3_t w)
{
    walk->first = !walk->scattered;
    walk->scattered = walk->scattered || walk->joinable;
    walk->parallel = false;
    walk->direction = w;
    walk->point = vertex_point(vertex);
    walk->origin = vertex_exit(vertex, w);
    walk->cosine = vertex_area_cosine(vertex, w);
    walk->medium = vertex_medium(vertex, w);
}

bool walk_scatter(walk_t *walk, const sample_t *sample, const vertex_t *vertex)
{
    bsdf_sample_t next;
    uint32_t offset = walk->mode == TRANSPORT_RADIANCE ? DIMENSION_SCATTER : DIMENSION_LIGHT_SCATTER;
    sampler_t sampler = sample_stream(sample, vertex->dimension + offset);
    vec2_t u = sampler_2d(&sampler), choices = sampler_2d(&sampler);
    if (!vertex_sample(vertex, u, choices.x, &next)) return false;
    walk->throughput = v_mul(vertex->throughput, next.weight);
    if (walk->mode == TRANSPORT_IMPORTANCE)
        walk->throughput = v_scale(walk->throughput, vertex_adjoint(vertex, next.wi));
    walk->reference *= next.squeeze;
    if (walk->depth >= walk->roulette.from) {
        float survive = float_min(walk->roulette.most, v_max(walk->throughput) / walk->reference);
        if (!(choices.y < survive)) return false;
        walk->throughput = v_scale(walk->throughput, 1 / survive);
    }
    walk->pdf = next.pdf;
    walk->pdf_rev = next.pdf_rev;
    walk->joinable = !next.specular;
    go_on(walk, vertex, next.wi);
    return true;
}

void walk_turn(walk_t *walk, const vertex_t *vertex, vec3_t w, const bsdf_value_t *value, float factor)
{
    walk->throughput = v_scale(v_mul(vertex->throughput, value->f), vertex_cosine(vertex, w) * factor);
    walk->pdf = value->pdf;
    walk->pdf_rev = value->pdf_rev;
    walk->joinable = true;
    go_on(walk, vertex, w);
}
