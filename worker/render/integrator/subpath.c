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

/* The nearest surface from a point on the walk's way on. */
static bool look_on(const walk_t *walk, sample_t *sample, vec3_t from, surface_t *surface)
{
    flights_t *flights = walk->flights;
    int look = flights != NULL ? flights->looks++ : FLIGHT_LOOKS;
    if (look < FLIGHT_LOOKS && look < flights->kept) {
        if (flights->hits[look]) *surface = flights->surfaces[look];
        return flights->hits[look];
    }
    sample->result->counts.rays++;
    bool looks = walk->mode == TRANSPORT_RADIANCE && !walk->scattered;
    bool hit = (looks ? scene_look : scene_intersect)(sample->setup->scene, from, walk->direction,
                                                      sample->time, surface);
    if (look < FLIGHT_LOOKS) {
        flights->hits[look] = hit;
        if (hit) flights->surfaces[look] = *surface;
        flights->kept = look + 1;
    }
    return hit;
}

/* The numbers for distances from the vertex before, whose numbers begin at the walk's dimension. */
static media_numbers_t distance_numbers(const walk_t *walk, const sample_t *sample)
{
    uint32_t dimension = walk->dimension;
    bool light = walk->mode == TRANSPORT_IMPORTANCE;
    sampler_t side = sample_side_stream(sample, dimension);
    uint64_t key = side.sample_key + 0xD6E8FEB86659FD93u * (dimension + 1);
    float u = sample_2d(sample, dimension + (light ? DIMENSION_LIGHT_DISTANCE : DIMENSION_DISTANCE)).y;
    return (media_numbers_t){.first = walk->other ? wrap(u + 0.5f) : u,
                             .exact = !light && !walk->scattered,
                             .way = walk->flights != NULL ? &walk->flights->way : NULL,
                             .key = walk->other ? ~key : key,
                             .waves = sample->waves};
}

/* Follows the walk through a piece of a medium, `distance` long. True when it is scattered there: the vertex
 * is then in the medium. */
static bool meet_medium(walk_t *walk, sample_t *sample, vec3_t from, float distance, media_numbers_t *numbers,
                        vertex_t *vertex)
{
    const media_t *media = sample->setup->media;
    float at;
    if (walk->mode == TRANSPORT_RADIANCE && media_emits(media, walk->medium.number))
        walk->glow =
            v_add(walk->glow, v_mul(vertex->throughput, media_emission(media, walk->medium.number, from,
                                                                       walk->direction, distance, numbers)));
    if (!media_scatter(media, walk->medium.number, from, walk->direction, distance, numbers,
                       &vertex->throughput, &at))
        return false;
    vertex->kind = VERTEX_MEDIUM;
    vertex->surface.p = v_mad(from, at, walk->direction);
    return true;
}

/* Goes on through media and their borders until the walk meets something; `hit`: the first thing in its way
 * is a surface, which the vertex has. */
static void pass_media(walk_t *walk, sample_t *sample, bool hit, vertex_t *vertex)
{
    enum { MOST_BORDERS = 1000 }; /* that lie on one another may be without end */
    const media_t *media = sample->setup->media;
    media_numbers_t numbers = distance_numbers(walk, sample);
    vec3_t from = walk->origin;
    blob_ref_t start = walk->medium.number;
    walk->fade = walk->fade_back = 1;
    walk->flew = false;
    bool met = false; /* a medium: the first decides about flights, before chance has a part in it */
    for (int i = 0;; i++) {
        float distance = hit ? v_length(v_sub(vertex_point(vertex), from)) : INFINITY;
        if (!met && walk->medium.number != 0) {
            walk->flew = !media_is_body(media, walk->medium.number);
            met = true;
        }
        if (walk->medium.number != 0 && meet_medium(walk, sample, from, distance, &numbers, vertex)) break;
        vertex->kind = hit && i < MOST_BORDERS ? VERTEX_SURFACE : VERTEX_SKY;
        if (vertex->kind == VERTEX_SKY || !surface_is_interface(&vertex->surface)) break;
        walk->medium.number = medium_behind(&vertex->surface, walk->direction);
        from = scene_offset(&vertex->surface, walk->direction);
        hit = look_on(walk, sample, from, &vertex->surface);
    }
    walk->flew = walk->flew && vertex->first && walk->mode == TRANSPORT_RADIANCE;
    vertex->twice = walk->flew && vertex->kind == VERTEX_MEDIUM;
    vertex->media[0] = vertex->media[1] = walk->medium.number;
    vertex->worth = segment_worth(sample->setup, start, walk->medium.number);
    if (is_inner(sample->setup, start, walk->medium.number)) {
        walk->length--;
        walk->within++;
    }
    if (vertex->kind == VERTEX_SKY) return;
    if (!walk->parallel && (walk->medium.number != 0 || start != 0)) {
        float length = v_length(v_sub(vertex_point(vertex), walk->point));
        walk->fade = media_fade(media, walk->medium.number, length);
        walk->fade_back = media_fade(media, start, length);
    }
    if (vertex->kind == VERTEX_SURFACE && vertex->surface.shape->flags & SHAPE_INTERFACE)
        for (int i = 0; i < 2; i++) vertex->media[i] = vertex->surface.shape->media[i];
    for (int i = 0; i < 2; i++) vertex->bounds = vertex->bounds || media_is_body(media, vertex->media[i]);
}

void walk_arrive(walk_t *walk, sample_t *sample, vertex_t *vertex)
{
    bool hit = look_on(walk, sample, walk->origin, &vertex->surface);
    rgb_t glow = walk->glow;
    vertex->kind = hit ? VERTEX_SURFACE : VERTEX_SKY;
    vertex->mode = walk->mode;
    vertex->depth = ++walk->depth;
    vertex->bounds = vertex->twice = false;
    vertex->worth = inner_worth;
    vertex->other = walk->other;
    walk->length++;
    vertex->first = !walk->scattered;
    vertex->media[0] = vertex->media[1] = 0;
    vertex->wo = v_neg(walk->direction);
    vertex->throughput = walk->throughput;
    if (sample->setup->media != NULL) pass_media(walk, sample, hit, vertex);
    vertex->length = walk->length;
    vertex->within = walk->within;
    if (!vertex_is_near(vertex, sample->setup)) walk->glow = glow; /* of a segment that does not count */
    vertex->dimension = walk->dimension += DIMENSION_STRIDE;
    if (vertex->kind == VERTEX_SKY) {
        vertex->surface.p = walk->point;
        return;
    }
    if (walk->depth == 1 && walk->mode == TRANSPORT_IMPORTANCE)
        walk->last *= lights_nearness(sample->setup->lights, walk->light, vertex_point(vertex));
    if (walk->gated) enter_portal(walk, sample, vertex);
    if (!v_is_zero(walk->medium.attenuation))
        vertex->throughput =
            v_mul(vertex->throughput,
                  medium_transmittance(&walk->medium, v_length(v_sub(vertex_point(vertex), walk->point))));
}

bool walk_other_flight(flights_t *flights, sample_t *sample, walk_t *walk, vertex_t *vertex)
{
    *walk = flights->before;
    walk->other = true;
    walk->flights = flights;
    flights->looks = 0;
    walk_arrive(walk, sample, vertex);
    walk->flights = NULL;
    return vertex->twice && vertex_is_near(vertex, sample->setup) &&
           vertex_has_room(vertex, setup_max_segments(sample->setup)) && walk_weigh(walk, vertex);
}

/* Leaves the vertex in direction w; how it was drawn is noted. */
static void go_on(walk_t *walk, const vertex_t *vertex, vec3_t w)
{
    walk->first = !walk->scattered;
    walk->in_medium = vertex->kind == VERTEX_MEDIUM;
    walk->scattered = walk->scattered || walk->joinable;
    walk->parallel = false;
    walk->direction = w;
    walk->point = vertex_source(vertex, w);
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
        float most = vertex->bounds ? 1 : walk->roulette.most; /* long ways there are the rule */
        float survive = float_min(most, v_max(walk->throughput) / walk->reference);
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
