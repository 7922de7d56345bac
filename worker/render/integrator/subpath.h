/* subpath: walks from the camera and from the lights, vertex by vertex, and the weights of multiple
 * importance sampling that they carry along. All integrators stand on these walks.
 *
 * Path weights in constant time, after van Antwerpen (2011, "Recursive MIS Computation for Streaming BDPT on
 * the GPU") and Georgiev (2012, "Implementing Vertex Connection and Merging"), here with squares for the
 * power heuristic. Number a subpath's vertices i = 0 (on the light, or the camera), 1, 2, ... and let
 *
 *   p_i       density per area of vertex i as its own subpath makes it,
 *   r_i       density per area of vertex i as the opposite subpath would make it,
 *   c_i       1 when the strategy that joins vertices i - 1 and i exists: neither is specular, and for i = 0
 *             the end can be run into (a light can, a pinhole cannot); else 0. Of the eye subpath c_1 is 0,
 *             too, where points cannot be joined to the camera (camera.h).
 *
 * Moving the junction towards this end multiplies a path's density by r_i / p_i a vertex, so that its share
 * of the weight is
 *
 *   share_i = (r_i / p_i)^2 (c_i + (r_{i-1} / p_{i-1})^2 (c_{i-1} + ...))
 *
 * r_i depends on what vertex i is joined to, r_{i-1} on the direction in which the path leaves vertex i, and
 * all the rest is known on arrival. With r_{i-1} = q g, q the density per solid angle at vertex i and g the
 * factor from solid angle at i to area at i - 1 (a ray that comes from infinity, or from an orthographic
 * camera, has a density per area across it instead, and no distance in g),
 *
 *   share_i = r_i^2 (direct_i + q^2 inner_i),    direct_i = c_i / p_i^2,
 *   inner_i = g^2 / p_i^2 (direct_{i-1} + q_{i-1}^2 inner_{i-1}).
 *
 * Vertex merging (bdpt.c: vcm) adds strategies in the same terms. Joining a light vertex to an eye vertex
 * that lies within the distance r makes a path whose vertex i both subpaths have made; M light subpaths are
 * tried. Its density is that of the strategy which joins vertices i - 1 and i, times p_i (the other subpath
 * made vertex i already) times eta = M pi r^2 (Georgiev et al. 2012, "Light Transport Simulation with Vertex
 * Connection and Merging", equation 7). With m_i 1 where vertex i can be merged, else 0,
 *
 *   share_i = (r_i / p_i)^2 (c_i + m_i eta^2 p_i^2 + (r_{i-1} / p_{i-1})^2 (c_{i-1} + m_{i-1} eta^2 p_{i-1}^2
 * + ...)),
 *
 * so that all there is to do is to put direct_i + m_i eta^2 in the place of direct_i. Without merging eta is
 * 0.
 *
 * Pictures (LIGHT_PICTURE) are met only by eye subpaths that nothing but mirrors and clear glass has turned,
 * and by the segments that join light vertices to the camera. No light subpath starts or ends on one and no
 * vertex is joined to one, so what an eye subpath sees of it has weight 1. All other segments lie beyond a
 * vertex that scatters, as seen from the camera, whichever strategy makes them: all let them through alike.
 *
 * No light subpath makes a vertex on a fibre (vertex_is_for_eyes): r_i is 0 there, which cuts the chain of an
 * eye subpath.
 *
 * The weight of a connected path is 1 / (1 + share of the light side + share of the eye side). A Dirac lobe
 * has the same probability both ways, so its density cancels in r / p: discrete probabilities stand in for
 * densities.
 */
#ifndef LIGHTMILL_SUBPATH_H
#define LIGHTMILL_SUBPATH_H

#include "worker/render/integrator/caustics.h"
#include "worker/render/integrator/vertex.h"

static inline float square(float x)
{
    return x * x;
}

/* Russian roulette: from which scattering on, and the largest chance to survive one. A subpath's throughput
 * is compared with what it started from, as that would be where it is: radiance gets denser in glass or
 * water, and thinner again before the subpath meets a light. */
typedef struct {
    int from;
    float most;
} roulette_t;

/* A subpath on its way from vertex i - 1 to vertex i. */
typedef struct {
    transport_t mode;
    roulette_t roulette;
    float reference;          /* brightness that Russian roulette compares the throughput with */
    int depth;                /* i - 1 */
    int length;               /* segments up to vertex i - 1 that count, */
    int within;               /* and those within bodies, which do not */
    uint32_t dimension;       /* where the random numbers of vertex i - 1 begin */
    vec3_t origin, direction; /* of the ray */
    vec3_t point;             /* vertex i - 1: its vertex_source */
    float cosine;             /* |direction . geometric normal| there; 1 where there is none */
    rgb_t throughput;
    medium_t medium; /* along the ray; once it has arrived, where it did */
    /* medium_fade of the last segment, with the medium at its end and at its start; 1 from or to infinity. */
    float fade, fade_back;
    rgb_t glow;          /* of an eye subpath: what the media on its way have emitted so far */
    float pdf;           /* of the ray: per steradian, of parallel rays per area across */
    float pdf_rev;       /* of the way back at vertex i - 1: q_{i-1} */
    float direct, inner; /* of vertex i - 1, were it not specular */
    uint32_t light;      /* that a light subpath starts from */
    float last;     /* of strategy_count; of s = 1 with view_ratio (light_ray_t) in it, as the first vertex
                       sees it, on arrival there */
    bool gated;     /* vertex i - 1 is at infinity, beyond the portal of its light */
    bool joinable;  /* vertex i - 1 is not specular */
    bool parallel;  /* vertex i - 1 is at infinity, or the camera orthographic */
    bool scattered; /* by something that is not specular */
    bool first;     /* as of vertex i - 1 */
    bool in_medium; /* vertex i - 1 is */
    bool other;     /* the flight to vertex i is the other one (flights_t) */
    bool flew;      /* on arrival: there are two flights to vertex i */
    struct flights *flights; /* while it flies; else NULL */
    /* Of an eye subpath: where it last scattered by something that is not specular, if rays to caustics
     * (caustics.h) may be sent from there; and the part of what it runs into from there by way of specular
     * vertices that is left to it, since such rays find it, too. */
    uint32_t seeks; /* the region, or CAUSTICS_NOWHERE */
    float left;
} walk_t;

/* In weights a strategy counts as so many samples, since the power heuristic does not know how evenly samples
 * are spread, or how much alike they are (all measured: docs/performance.md). Strata do most for the places
 * that the first vertex draws on lights, less further down, and least for where splats fall. */
static const float first_light_worth = 1.5f;
static const float first_light_worth_in_media = 0.7f; /* at the ends of flights */
static const float later_light_worth = 0.5f;
static const float splat_worth = 0.7f;

static inline float first_worth(bool in_medium)
{
    return in_medium ? first_light_worth_in_media : first_light_worth;
}

/* How many places s = 1 counts as drawing at the first vertex for one of lights_illuminate on this light. */
static inline float first_light_count(const setup_t *setup, uint32_t light, bool in_medium)
{
    return first_worth(in_medium) * lights_first_times(setup->lights, light);
}

/* Eye vertices choose whom of a whole block's light vertices they are joined to (light_pool.h), which makes s
 * >= 2, t >= 2 far better than one random light vertex would be. */
static const float inner_worth = 16;
/* Those within a body are not: many vertices lie side by side, and few of them are joined (vertex_joins). */
static const float body_worth = 0.25f;
/* Those that begin or end in a grid are, as far as light gets through it, which neither the choice nor
 * weights know. */
static const float grid_worth = 1;

/* How many the strategy that joins the vertex to the one before it counts as: `last` where that is vertex 0,
 * which makes it t = 1 of an eye subpath, s = 1 of a light subpath. */
static inline float strategy_count(const vertex_t *vertex, float last)
{
    return vertex->depth == 1 ? last : vertex->worth;
}

/* The eye subpath of the sample. Settles the sample's weight: where that is 0 nothing is to be seen. */
static inline walk_t walk_from_camera(sample_t *sample, roulette_t roulette)
{
    camera_ray_t ray;
    sample_eye_ray(sample, &ray);
    return (walk_t){.mode = TRANSPORT_RADIANCE,
                    .roulette = roulette,
                    .reference = 1,
                    .dimension = DIMENSION_EYE,
                    .origin = ray.origin,
                    .direction = ray.direction,
                    .point = ray.origin,
                    .cosine = 1,
                    .throughput = vec3(1, 1, 1),
                    .medium = {.number = sample->setup->medium},
                    .fade = 1,
                    .fade_back = 1,
                    .pdf = ray.pdf,
                    .last = splat_worth,
                    .seeks = CAUSTICS_NOWHERE,
                    .joinable = ray.joinable,
                    .parallel = ray.parallel}; /* direct 0: nothing runs into a camera */
}

/* Its light subpath, and the ray that it starts with; false when there is none. */
static inline bool walk_from_light(const sample_t *sample, roulette_t roulette, walk_t *walk,
                                   light_ray_t *ray)
{
    const lights_t *lights = sample->setup->lights;
    sampler_t sampler = sample_stream(sample, DIMENSION_LIGHT + DIMENSION_EMIT);
    float choice = sampler_1d(&sampler);
    vec2_t place = sampler_2d(&sampler);
    if (lights_empty(lights) || !lights_emit(lights, choice, place, sampler_2d(&sampler), ray)) return false;
    ray->throughput = sample_light(sample, ray->light, ray->throughput);
    *walk = (walk_t){.mode = TRANSPORT_IMPORTANCE,
                     .roulette = roulette,
                     .reference = v_max(ray->throughput),
                     .dimension = DIMENSION_LIGHT,
                     .origin = ray->origin,
                     .direction = ray->direction,
                     .point = ray->point,
                     .cosine = ray->cosine,
                     .throughput = ray->throughput,
                     .medium = {.number = ray->medium},
                     .fade = 1,
                     .fade_back = 1,
                     .pdf = ray->pdf_ray,
                     .direct = ray->delta ? 0 : 1 / square(ray->pdf_place),
                     .light = ray->light,
                     .last = later_light_worth * ray->view_ratio,
                     .gated = ray->gate > 0,
                     .joinable = true,
                     .parallel = ray->at_infinity};
    return true;
}

/* Moves on to the next vertex, which has no BSDF yet (walk_shade). It is of the sky when the ray leaves the
 * scene, and in a medium when this scatters. */
void walk_arrive(walk_t *walk, sample_t *sample, vertex_t *vertex);

/* Makes the BSDF of a vertex where the walk arrived. A segment is dimmed where one of its ends is the inside
 * of absorbing glass, whichever of them a walk leaves, so that all strategies agree: walk_arrive has dimmed
 * it for the end that was left, and this does for the other. A light at infinity shines on no inside. */
static inline void walk_shade(const walk_t *walk, const sample_t *sample, vertex_t *vertex)
{
    vertex_shade(vertex, sample, walk->scattered);
    if (!vertex->bsdf.absorbs || !v_is_zero(walk->medium.attenuation)) return;
    if (walk->parallel && walk->mode == TRANSPORT_IMPORTANCE) return;
    medium_t inside = vertex_medium(vertex, vertex->wo);
    float distance = v_length(v_sub(vertex_point(vertex), walk->point));
    vertex->throughput = v_mul(vertex->throughput, medium_transmittance(&inside, distance));
}

/* FLIGHTS. Where an eye subpath that nothing has scattered yet comes through a medium, it is chance alone how
 * far it gets, and all light that the camera sees there varies with it. So there are two flights, with
 * numbers half a period apart: two vertices are joined to lights, for half of what one would count, and one
 * goes on. */
enum { FLIGHT_LOOKS = 4 };
typedef struct flights {
    walk_t before; /* either of them */
    /* What both meet, of which the first to get there keeps a part: the surfaces on their way, borders of
     * media for the most part, and the integral over a grid. */
    int looks, kept;
    bool hits[FLIGHT_LOOKS];
    surface_t surfaces[FLIGHT_LOOKS];
    way_t way;
} flights_t;
/* As walk_arrive, by the first flight; true when there may be another. */
static inline bool walk_fly(walk_t *walk, sample_t *sample, vertex_t *vertex, flights_t *flights)
{
    const setup_t *setup = sample->setup;
    bool may = setup->media != NULL && !walk->scattered && !lights_empty(setup->lights);
    if (may) {
        flights->before = *walk;
        flights->looks = flights->kept = 0;
        way_forget(&flights->way);
        walk->flights = flights;
    }
    walk_arrive(walk, sample, vertex);
    walk->flights = NULL;
    return may && walk->flew;
}
/* The other flight. True when it ends at a vertex in a medium, which has no BSDF yet. */
bool walk_other_flight(flights_t *flights, sample_t *sample, walk_t *walk, vertex_t *vertex);

/* p_i of the vertex: per area, of the sky per steradian. *distance2 receives what is squared in g. */
static inline float walk_density(const walk_t *walk, const vertex_t *vertex, float *distance2)
{
    *distance2 = 1;
    if (vertex->kind == VERTEX_SKY) return walk->pdf;
    if (!walk->parallel) *distance2 = v_length2(v_sub(vertex_point(vertex), walk->point));
    if (walk->medium.number != 0) /* where light goes less far than floats can tell, and yet goes on */
        *distance2 = float_max(*distance2, float_max(0x1p-54f, 0x1p-48f * v_length2(walk->point)));
    return walk->pdf * walk->fade * vertex_area_cosine(vertex, walk->direction) / *distance2;
}

/* Notes at the vertex what weights of its paths need. To be called at each vertex on arrival, or at none.
 * False when its density is too far from one to be squared. */
static inline bool walk_weigh(walk_t *walk, vertex_t *vertex)
{
    float chain = (walk->joinable ? walk->direct : 0) + square(walk->pdf_rev) * walk->inner;
    float distance2, p = walk_density(walk, vertex, &distance2);
    vertex->inv_p2 = 1 / square(p);
    vertex->direct = walk->joinable ? vertex->inv_p2 : 0;
    vertex->merging = 0;
    vertex->inner = square(walk->fade_back * walk->cosine / distance2) * vertex->inv_p2 * chain;
    if (vertex_is_for_eyes(vertex)) vertex->direct = vertex->inner = 0;
    walk->direct = square(strategy_count(vertex, walk->last)) * vertex->direct;
    walk->inner = vertex->inner;
    return vertex->kind == VERTEX_SKY || (p > 0x1p-60f && p < 0x1p60f);
}

/* Notes that the vertex, which was weighed and shaded, takes part in merging; `eta` as above. */
static inline void walk_weigh_merging(walk_t *walk, vertex_t *vertex, float eta)
{
    vertex->merging = vertex_is_mergeable(vertex) ? square(eta) : 0;
    walk->direct += vertex->merging;
}

/* Scatters at the vertex. False when the subpath ends here. */
bool walk_scatter(walk_t *walk, const sample_t *sample, const vertex_t *vertex);
/* Goes on in a given direction, in which the vertex scatters as `value` says; the density is 1 / `factor`. */
void walk_turn(walk_t *walk, const vertex_t *vertex, vec3_t w, const bsdf_value_t *value, float factor);

/* ---- how long paths may be -----------------------------------------------------------------------------
 *
 * Segments within a body (blob_material_t) do not count against the depth of a job: light is scattered there
 * hundreds of times before it comes out. They have a bound of their own. Both are functions of the path
 * alone, and the same whichever strategy makes it. */

/* Reached where a body neither absorbs nor ends alone, of which it keeps back 1 / sqrt(pi WITHIN_MOST). */
enum { WITHIN_MOST = 1 << 14 };

/* Whether a segment lies within bodies, from the media at its ends. */
static inline bool is_inner(const setup_t *setup, blob_ref_t a, blob_ref_t b)
{
    return media_is_body(setup->media, a) && media_is_body(setup->media, b);
}

/* How many the strategy that joins two inner vertices by a segment counts as, from the media at its ends. */
static inline float segment_worth(const setup_t *setup, blob_ref_t a, blob_ref_t b)
{
    if (is_inner(setup, a, b)) return body_worth;
    return media_is_grid(setup->media, a) || media_is_grid(setup->media, b) ? grid_worth : inner_worth;
}

/* False when the subpath has become longer than a path may be. */
static inline bool vertex_is_near(const vertex_t *vertex, const setup_t *setup)
{
    return vertex->length <= setup_max_segments(setup) && vertex->within <= WITHIN_MOST;
}

/* Whether a subpath may go on that has room for so many segments that count. */
static inline bool vertex_has_room(const vertex_t *vertex, int segments)
{
    return vertex->length < segments || vertex->bounds;
}

/* Whether the vertex of one subpath may be joined to where another one is, whose length is given, by a
 * segment between these media. */
static inline bool join_is_near(const setup_t *setup, const vertex_t *vertex, blob_ref_t medium, int length,
                                int within, blob_ref_t other)
{
    if (!media_has_bodies(setup->media)) return true; /* as subpaths see to */
    bool inner = is_inner(setup, medium, other);
    return vertex->length + length + !inner <= setup_max_segments(setup) &&
           vertex->within + within + inner <= WITHIN_MOST;
}

/* The segments that may count of a light subpath: one is left to what joins it to the camera. */
static inline int light_segments(const setup_t *setup)
{
    return setup_max_segments(setup) - !media_is_body(setup->media, setup->medium);
}

/* How often a vertex is joined to others, which counts the more then: a subpath has many in a body, which
 * bring little each, but for those on its surface. So there are about 8 log(within) of them. A function of
 * the vertex; the chances of strategies, as weights know them, are those without it. */
static inline float joining_chance(const vertex_t *vertex)
{
    const float surely = vertex->kind == VERTEX_MEDIUM ? 8 : 64;
    return vertex->bounds && (float)vertex->within > surely ? surely / (float)vertex->within : 1;
}

/* Whether it is, by the numbers of the sample; *throughput, the vertex's, is then raised to what it counts
 * for this. */
static inline bool vertex_joins(const vertex_t *vertex, const sample_t *sample, rgb_t *throughput)
{
    float chance = joining_chance(vertex);
    if (chance == 1) return true;
    sampler_t numbers = sample_side_stream(sample, vertex->dimension + DIMENSION_JOINING);
    if (!(sampler_1d(&numbers) < chance)) return false;
    *throughput = v_scale(vertex->throughput, 1 / chance);
    return true;
}

/* share_i of the vertex at the junction, all as above; `count`: how often the strategy next to this one draws
 * for once of the others. */
static inline float mis_share_counted(const vertex_t *vertex, float r, float q, float count)
{
    return square(r) * (square(count) * vertex->direct + vertex->merging + square(q) * vertex->inner);
}

static inline float mis_share(const vertex_t *vertex, float r, float q)
{
    return mis_share_counted(vertex, r, q, 1);
}

#endif
