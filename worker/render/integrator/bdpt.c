/* bdpt: bidirectional path tracing, and vcm: the same with vertex merging.
 *
 * bdpt has all strategies of t >= 2 eye and s >= 0 light vertices and of t = 1
 * and s >= 2, combined by the power heuristic (Veach 1997, chapter 10), with the weights of subpath.h.
 *
 * The light subpaths of a block of pixels are traced first, and joined to the camera. Their vertices make a
 * pool. Each eye vertex is joined to fresh places on lights (s = 1), and to a few vertices that it chooses
 * from the pool (light_pool.h). It evaluates each before it pays for the shadow ray, and traces the rays of
 * those that carry anything as one packet.
 *
 * Where nothing can be joined to the camera (camera.h) there is no t = 1, and an eye subpath that is lost in
 * the lens ends at once.
 *
 * What is seen and lit through glass or mirrors no connection finds. In jobs that learn eye vertices send
 * rays there (caustics.h), which make s = 0 a strategy of two ways.
 *
 * A job may ask for one strategy alone, with its weight or without (job_settings_t): Veach's pyramid.
 *
 * vcm adds what no connection finds: light that comes through glass and is seen through glass, too. Each eye
 * vertex that scatters widely takes the photons about it (photons.h) for light that arrives where it is
 * itself (Georgiev, Krivanek, Davidovic and Slusallek 2012, "Light Transport Simulation with Vertex
 * Connection and Merging"). This is one strategy more for every vertex of a path, and all are weighed
 * together (subpath.h). It blurs light over the distance of merging, which shrinks from sample to sample: vcm
 * is consistent, not unbiased. Connections and splats stay those of the light subpaths of the block, so that
 * each unit's splats are its own; photons are there for merging alone.
 */
#include "worker/render/integrator/lessons.h"
#include "worker/render/integrator/light_pool.h"
#include "worker/render/integrator/photons.h"

/* Sooner adds more noise than it saves time. */
static const roulette_t roulette = {.from = 3, .most = 1};
static const roulette_t no_roulette = {.from = JOB_MAX_DEPTH + 2, .most = 1};

/* Connections that bring less than this part of a sample's noise are left to Russian roulette. */
static const float FAINT = 0.2f;
/* The same of those that have become so on their way through a grid, which takes more time than a shadow ray.
 */
static const float FAINT_IN_MEDIA = 0.4f;
/* A vertex in a grid is joined to the pool as often as that: few of its connections are not faint. */
static const float POOLED_IN_GRIDS = 0.5f;

/* What is noted of choices must fit beside what else a sample notes (lessons.h). */
static_assert((JOB_MAX_DEPTH + 1) * LIGHT_CHOICES_MOST < LESSON_PARTS_MOST, "lessons overflow");

/* One of the two halves of a sample: its eye or its light subpath. */
typedef struct {
    sample_t *sample;
    const setup_t *setup;
    rgb_t radiance;         /* of the eye subpath, so far */
    rgb_t own;              /* what of it is not a light seen directly, for lessons */
    float brought;          /* by the light subpath to the film: squares of what counts for lessons */
    light_path_t path;      /* the light subpath, */
    const light_ray_t *ray; /* and the ray that it started with */
    float eta;              /* of merging (subpath.h); 0: there is none */
    float brightness;       /* 1 / that of the picture at the pixel; 0: not known */
    bool teaches;
    int hits, met;                     /* lights that were run into, and caustics, which taught */
    connections_t connections;         /* candidates of one vertex, or of the camera */
    vec2_t rasters[SCENE_PACKET];      /* where those to the camera fall */
    uint32_t dimensions[SCENE_PACKET]; /* of the vertices they come from */
    uint32_t lights[SCENE_PACKET];     /* where the light of all of them comes from */
    /* That those to the pool come from, NULL being a fresh place on a light; and the factors of these
     * choices. */
    const light_path_t *paths[SCENE_PACKET];
    float factors[SCENE_PACKET];
} half_t;

/* True when the job wants the strategy of s light and t eye vertices. */
static inline bool is_wanted(const half_t *b, int s, int t)
{
    const job_settings_t *settings = &b->setup->settings;
    return settings->strategy_t == 0 || (settings->strategy_t == t && settings->strategy_s == s);
}

static inline float weight_of(const half_t *b, float shares)
{
    return b->setup->settings.unweighted ? 1 : 1 / (1 + shares);
}

/* ---- strategies ---------------------------------------------------------------------------------------- */

/* Adds what the eye subpath brings from a light. */
static inline void add_radiance(half_t *b, rgb_t value, uint32_t light)
{
    b->radiance = v_add(b->radiance, value);
    sample_lit(b->sample, light, value);
}

/* Notes for the light groups what arrived of so many connections. */
static void light_connections(half_t *b, int count, uint32_t lost)
{
    for (int i = 0; i < count; i++)
        if (!(lost >> i & 1)) sample_lit(b->sample, b->lights[i], b->connections.values[i]);
}

/* What counts of a value for lessons, at a place of the film. Bounded, so that its square is. */
static inline float lesson_of(const half_t *b, float x, float y, rgb_t value)
{
    return float_min(v_max(value) * setup_brightness(b->setup, x, y), LESSON_MOST);
}

/* Traces the connections to the camera and takes what arrives as splats. */
static void take_splats(half_t *b)
{
    int count = b->connections.segments.count;
    uint32_t lost = connections_transmit(b->sample, &b->connections, true);
    for (int i = 0; i < count; i++) {
        if (lost >> i & 1) continue;
        rgb_t value = b->connections.values[i];
        sample_splat(b->sample, b->rasters[i], value, b->lights[i], b->dimensions[i]);
        if (b->teaches) b->brought += square(lesson_of(b, b->rasters[i].x, b->rasters[i].y, value));
    }
}

/* The k-th of the uniform numbers that share one; they lie apart. */
static inline float spread(float u, uint32_t k)
{
    const float golden = 0.618034f;
    float shifted = u + golden * (float)k;
    return shifted - floorf(shifted);
}

/* Notes what a light subpath brought to a pixel through a connection. A subpath that brings C to each pixel
 * of its block by itself brings each C / n, n pixels, so that its part of the noise of a pixel is C^2 / n;
 * that is what the choices for all pixels add up to, on average. */
static void note_choice(const half_t *b, int i, rgb_t value)
{
    const light_path_t *path = b->paths[i];
    float x = (float)b->sample->pixel_x, y = (float)b->sample->pixel_y, factor = b->factors[i];
    float alone = lesson_of(b, x, y, v_scale(value, 1 / factor));
    float brought = square(alone) * factor / (float)light_pool_pixels(b->sample->pool);
    float u = spread(sample_2d(b->sample, b->dimensions[i]).y, (uint32_t)i);
    lesson_note_part(b->sample, LESSON_LIGHTS + path->lessons[0], brought * path->density, GUIDE_SQUARE_BITS,
                     u);
}

/* Traces the connections of an eye vertex and takes what arrives. */
static void take_connections(half_t *b)
{
    int count = b->connections.segments.count;
    uint32_t lost = connections_transmit(b->sample, &b->connections, false);
    for (int i = 0; i < count; i++) {
        if (lost >> i & 1) continue;
        rgb_t value = b->connections.values[i];
        b->radiance = v_add(b->radiance, value);
        b->own = v_add(b->own, value);
        if (b->paths[i] != NULL && b->paths[i]->teaches) note_choice(b, i, value);
    }
    if (b->setup->light_groups != NULL) light_connections(b, count, lost);
}

/* False when a faint connection is left out; else raises its value to what it then stands for. `brightness`
 * is that of the picture where it goes; `k` counts connections that share the random number. */
static bool survives(const half_t *b, float brightness, uint32_t dimension, uint32_t k, rgb_t *value)
{
    float chance = v_max(*value) * brightness / (FAINT * b->setup->noise);
    if (!(chance < 1) || !(brightness > 0)) return true;
    if (!(spread(sample_2d(b->sample, dimension).x, k) < chance)) return false;
    *value = v_scale(*value, 1 / chance);
    return true;
}

/* Adds a connection of value > 0, and returns its place. `brightness` is as in `survives`: on its way through
 * a medium the connection becomes faint, too. */
static int add_connection(half_t *b, float brightness, vec3_t from, vec3_t to, medium_t medium, float length,
                          rgb_t value)
{
    float faint = 0;
    if (b->setup->media != NULL && brightness > 0)
        faint = FAINT_IN_MEDIA * b->setup->noise / (v_max(value) * brightness);
    return connections_add(&b->connections, b->setup, from, to, medium, length, faint, value);
}

/* t = 1: joins a light vertex to the camera. */
static void join_camera(half_t *b, const vertex_t *y)
{
    camera_view_t view;
    bsdf_value_t fy;
    if (!sample_join_camera(b->sample, vertex_point(y), y->dimension, &view) || !vertex_eval(y, view.w, &fy))
        return;
    medium_t medium = vertex_medium(y, view.w);
    if (!join_is_near(b->setup, y, medium.number, 0, 0, b->setup->medium)) return;
    float length = v_length(v_sub(view.position, vertex_point(y)));
    float r = view.density * vertex_area_cosine(y, view.w);
    if (!view.parallel) r *= medium_fade(b->setup, medium.number, length);
    float direct = b->path.last / later_light_worth *
                   first_light_count(b->setup, b->path.source, y->kind == VERTEX_MEDIUM);
    float count = strategy_count(y, direct);
    float weight = weight_of(b, mis_share_counted(y, r, fy.pdf_rev, count) / square(splat_worth));
    float factor = vertex_cosine(y, view.w) * vertex_adjoint(y, view.w) * view.density;
    rgb_t value = v_scale(v_mul(y->throughput, fy.f), factor * weight);
    if (v_is_zero(value)) return;
    float brightness = setup_brightness(b->setup, view.raster.x, view.raster.y);
    if (!survives(b, brightness, y->dimension + DIMENSION_LIGHT_SURVIVE, 0, &value)) return;
    medium.number = b->setup->medium; /* where the connection begins */
    int n = add_connection(b, brightness, view.position, vertex_exit(y, view.w), medium, length, value);
    b->lights[n] = b->path.source;
    b->rasters[n] = view.raster;
    b->dimensions[n] = y->dimension;
}

/* Notes what was left to an eye subpath that ran into a light (light_guide.h). `value` is what it brought. */
static void teach_hit(half_t *b, const vertex_t *z, const light_hit_t *hit, rgb_t value)
{
    const float most = 64;         /* that it counts as */
    const float least = 1.0f / 64; /* below which light subpaths never make up for it */
    float ratio = hit->pdf_place * hit->pdf_ray * sqrtf(z->inner);
    float excess = square(float_min(v_max(value) * b->brightness, most)) - square(LESSON_MOST);
    if (!(ratio > least) || !(excess > 0) || b->hits++ >= LESSON_HITS_MOST) return;
    lesson_note_hit(b->sample, LESSON_EXCESS, excess, LESSON_EXCESS_BITS);
    lesson_note_hit(b->sample, LESSON_LIGHTS + hit->lesson, excess * hit->start.density / ratio,
                    GUIDE_LEFT_BITS);
}

/* Notes what came from a light that was met by way of specular vertices, from a region of caustics. */
static void teach_caustic(half_t *b, uint32_t region, rgb_t value)
{
    if (b->met++ < LESSON_HITS_MOST)
        lesson_note_hit(b->sample, caustics_hit_place(b->setup->caustics, region),
                        v_max(value) * b->brightness, CAUSTICS_HIT_BITS);
}

/* s = 0: the eye subpath ran into a light, or into the sky. What is seen directly has no other strategy here:
 * t = 1 starts at s = 2. */
static void hit_lights(half_t *b, const walk_t *walk, const vertex_t *z)
{
    if (!is_wanted(b, 0, z->depth + 1)) return;
    bool caustic = walk->seeks != CAUSTICS_NOWHERE && !walk->joinable;
    for (uint32_t k = 0; k < vertex_light_count(z, b->setup->lights); k++) {
        light_hit_t hit;
        if (!vertex_light_hit(z, b->sample, k, walk->point, &hit)) continue;
        float count =
            walk->first ? first_light_count(b->setup, hit.light, walk->in_medium) : later_light_worth;
        float share =
            z->depth == 1 ? 0 : mis_share_counted(z, hit.pdf_place, hit.pdf_ray, count * hit.view_ratio);
        float weight = weight_of(b, share);
        if (caustic) weight *= walk->left;
        rgb_t value = v_scale(v_mul(z->throughput, hit.radiance), weight);
        add_radiance(b, value, hit.light);
        if (z->depth == 1) continue;
        b->own = v_add(b->own, value);
        if (b->teaches && caustic) teach_caustic(b, walk->seeks, value);
        if (b->teaches && hit.start.density > 0) teach_hit(b, z, &hit, value);
    }
}

/* s = 1: joins the eye vertex to the k-th fresh place on a light. */
static void join_light(half_t *b, const vertex_t *z, uint32_t k)
{
    light_view_t light;
    bsdf_value_t fz;
    float weight;
    if (!vertex_view_light(z, b->sample, k, &light)) return;
    float r_eye = light.arrival * vertex_area_cosine(z, light.w);
    medium_t medium = vertex_medium_to(z, &light);
    if (!join_is_near(b->setup, z, medium.number, 0, 0, light.medium)) return;
    float length = v_length(v_sub(light.target, vertex_point(z))), fade = 1;
    if (!light.at_infinity) {
        r_eye *= medium_fade(b->setup, medium.number, length);
        fade = medium_fade(b->setup, light.medium, length);
    }
    if (vertex_eval(z, light.w, &fz)) {
        float counted =
            light.density * (z->first ? first_worth(z->kind == VERTEX_MEDIUM) : later_light_worth);
        float light_share = light.delta ? 0 : square(fz.pdf * fade * light.geometry / counted);
        float eye_share = mis_share_counted(z, r_eye, fz.pdf_rev, strategy_count(z, splat_worth)) *
                          square(light.pdf_place / counted);
        weight = weight_of(b, light_share + eye_share);
    } else if (z->depth > 1 || !vertex_split_light(z, &light, 1 / sqrtf(z->inv_p2), &fz, &weight)) {
        return;
    }
    float factor = vertex_cosine(z, light.w) * light.geometry / light.density * weight;
    rgb_t value = v_mul(v_scale(v_mul(z->throughput, fz.f), factor), light.radiance);
    if (v_is_zero(value)) return;
    if (!survives(b, b->brightness, z->dimension + DIMENSION_SURVIVE, k, &value)) return;
    int n = add_connection(b, b->brightness, vertex_exit(z, light.w), light.target, medium, length, value);
    b->lights[n] = light.light;
    b->paths[n] = NULL;
}

/* s >= 2, t >= 2: joins an eye vertex to a light vertex that it chose, the k-th. */
static void join_vertices(half_t *b, const vertex_t *z, const light_choice_t *choice, uint32_t k)
{
    const vertex_t *y = choice->vertex;
    vec3_t d;
    if (!vertex_way_to(z, vertex_point(y), &d)) return;
    float distance2 = v_length2(d);
    if (!(distance2 > 0)) return;
    float distance = sqrtf(distance2);
    vec3_t w = v_scale(d, 1 / distance), back = v_neg(w);
    bsdf_value_t fz, fy;
    if (!vertex_eval(z, w, &fz) || !vertex_eval(y, back, &fy)) return;
    medium_t medium = vertex_medium(z, w), behind = vertex_medium(y, back);
    if (v_is_zero(medium.attenuation)) medium.attenuation = behind.attenuation; /* as walk_shade */
    blob_ref_t arrival = behind.number;
    if (!join_is_near(b->setup, z, medium.number, y->length, y->within, arrival)) return;
    float r_light = fz.pdf * vertex_area_cosine(y, w) / distance2;
    float r_eye = fy.pdf * vertex_area_cosine(z, w) / distance2;
    r_light *= medium_fade(b->setup, arrival, distance);
    r_eye *= medium_fade(b->setup, medium.number, distance);
    float light_share = mis_share_counted(y, r_light, fy.pdf_rev, strategy_count(y, choice->path->last));
    float eye_share = mis_share_counted(z, r_eye, fz.pdf_rev, strategy_count(z, splat_worth));
    float worth = segment_worth(b->setup, medium.number, arrival);
    float weight = weight_of(b, (light_share + eye_share) / square(worth)) * choice->factor;
    float factor = vertex_cosine(z, w) * vertex_cosine(y, w) * vertex_adjoint(y, back) / distance2 * weight;
    rgb_t value = v_mul(v_scale(v_mul(z->throughput, fz.f), factor), v_mul(y->throughput, fy.f));
    if (v_is_zero(value)) return;
    if (!survives(b, b->brightness, z->dimension + DIMENSION_SURVIVE, LIGHTS_FIRST_MOST + k, &value)) return;
    int n =
        add_connection(b, b->brightness, vertex_exit(z, w), vertex_exit(y, back), medium, distance, value);
    b->lights[n] = choice->path->source;
    b->paths[n] = choice->path;
    b->dimensions[n] = z->dimension + DIMENSION_SURVIVE;
    b->factors[n] = choice->factor;
}

/* s >= 2, t >= 2: joins an eye vertex to the pool. A job of one strategy with its weight chooses as one of
 * all does, so that the images of all strategies add up; without the weight it chooses among its own. */
static void join_pool(half_t *b, const vertex_t *z)
{
    const job_settings_t *settings = &b->setup->settings;
    light_choice_t choices[LIGHT_CHOICES_MOST];
    bool in_grid = z->kind == VERTEX_MEDIUM && media_is_grid(b->setup->media, z->media[0]);
    light_wish_t wish = {.most = setup_max_segments(b->setup) - z->length - !z->bounds,
                         .weighted = !settings->unweighted,
                         .often = in_grid ? POOLED_IN_GRIDS : 1,
                         .u = sample_2d(b->sample, z->dimension + DIMENSION_CHOOSE).x};
    int t = z->depth + 1;
    bool bodies = media_has_bodies(b->setup->media); /* where lengths are not depths */
    if (settings->unweighted && settings->strategy_t != t) return;
    if (settings->unweighted && !bodies) {
        if (settings->strategy_s - 1 > wish.most) return;
        wish.least = wish.most = settings->strategy_s - 1;
    }
    if (wish.most < !bodies) return;
    if (b->brightness > 0)
        wish.worth = v_max(v_mul(z->throughput, bsdf_albedo(&z->bsdf))) * b->brightness / b->setup->noise;
    int count = light_pool_choose(b->sample->pool, z, &wish, choices);
    for (int k = 0; k < count; k++) {
        if (b->connections.segments.count == SCENE_PACKET) take_connections(b);
        if (is_wanted(b, choices[k].vertex->depth + 1, t)) join_vertices(b, z, &choices[k], (uint32_t)k);
    }
}

/* Everything that joins an eye vertex to the lights. At the end of either of two flights (flights_t) places
 * on lights count half; light vertices are left to the one that goes on. */
static void join_eye_vertex(half_t *b, vertex_t *z)
{
    rgb_t throughput = z->throughput;
    if (!vertex_joins(z, b->sample, &z->throughput)) return;
    rgb_t whole = z->throughput;
    if (z->twice) z->throughput = v_scale(whole, 0.5f);
    if (is_wanted(b, 1, z->depth + 1))
        for (uint32_t k = 0; k < vertex_view_count(z, b->setup->lights); k++) join_light(b, z, k);
    z->throughput = whole;
    if (!z->other) join_pool(b, z);
    if (b->connections.segments.count > 0) take_connections(b);
    z->throughput = throughput;
}

/* Weight of the photon merged with the eye vertex, at which the path scatters as `fz` says. The strategies
 * that join the vertex to one of its neighbours have the densities of merging over eta p_i, p_i of either
 * subpath; the two chains begin there. */
static float merging_weight(const half_t *b, const vertex_t *z, const photon_t *y, const bsdf_value_t *fz)
{
    bool first = y->depth == 1 && z->first;
    float count =
        first ? first_light_count(b->setup, y->light, z->kind == VERTEX_MEDIUM) / later_light_worth : 1;
    float light = square(count) * y->direct + square(fz->pdf) * y->inner;
    float eye = square(strategy_count(z, splat_worth)) * z->direct + square(fz->pdf_rev) * z->inner;
    return 1 / (1 + (light + eye) / z->merging);
}

/* Takes a photon near the eye vertex for light that arrives there; returns what goes on towards the eye.
 * Photons count per area: where the shading normal makes another angle than the surface, as at light vertices
 * that are connected (vertex_adjoint). */
static rgb_t merge_photon(half_t *b, const vertex_t *z, const photon_t *y)
{
    bsdf_value_t fz;
    float arrives = vertex_area_cosine(z, y->wo);
    if (!(arrives > 0) || !vertex_eval(z, y->wo, &fz)) return vec3(0, 0, 0);
    float factor = vertex_cosine(z, y->wo) / arrives * merging_weight(b, z, y, &fz);
    return v_mul(v_scale(v_mul(z->throughput, fz.f), factor / b->sample->photons->area), y->throughput);
}

/* Merges an eye vertex with all photons near it. */
static void merge_photons(half_t *b, const vertex_t *z)
{
    const photon_set_t *set = b->sample->photons;
    int most_length = setup_max_segments(b->setup) - z->length;
    photon_range_t ranges[PHOTON_CELLS];
    int count = photon_grid_near(&set->grid, vertex_point(z), ranges);
    for (int k = 0; k < count; k++)
        for (uint32_t i = ranges[k].first; i < ranges[k].end; i++) {
            if (!(v_length2(v_sub(set->points[i], vertex_point(z))) < square(set->radius))) continue;
            const photon_t *y = &set->photons[i];
            if (y->length <= most_length && y->within + z->within <= WITHIN_MOST)
                add_radiance(b, merge_photon(b, z, y), y->light);
        }
}

/* ---- the two halves ------------------------------------------------------------------------------------ */

static void begin(half_t *b, sample_t *sample)
{
    b->sample = sample;
    b->setup = sample->setup;
    b->radiance = b->own = vec3(0, 0, 0);
    b->brought = 0;
    b->hits = b->met = 0;
    b->connections.segments = (segments_t){0};
    b->connections.absorbing = 0;
    b->teaches = lesson_due(sample);
    b->brightness = setup_brightness(sample->setup, (float)sample->pixel_x, (float)sample->pixel_y);
    b->eta = sample->photons != NULL ? sample->photons->eta : 0;
}

/* Tells that light came to a vertex by way of specular ones alone. */
static void meet_caustic(half_t *b, const vertex_t *y)
{
    const light_ray_t *ray = b->ray;
    const caustics_t *caustics = b->setup->caustics;
    caustics_scout_t *scout = b->sample->scout;
    if (ray->delta || (scout == NULL && !b->teaches)) return;
    caustics_meeting_t met = {
        .point = vertex_point(y), .w = y->wo, .power = v_max(y->throughput) / lights_flux(b->setup->lights)};
    if (scout != NULL) {
        if (!ray->at_infinity) met.nearness = 1 / v_length(v_sub(ray->point, met.point));
        caustics_scout_meeting(scout, &met);
    } else if (caustics != NULL && b->met++ < LESSON_HITS_MOST) {
        uint32_t region = caustics_region(caustics, met.point);
        if (region != CAUSTICS_NOWHERE)
            lesson_note_hit(b->sample, caustics_light_place(caustics, region, met.point, met.w), met.power,
                            CAUSTICS_LIGHT_BITS);
    }
}

/* Enters the light subpath into the pool, now that its first vertex says how often s = 1 would draw it. */
static void begin_path(half_t *b, const walk_t *walk)
{
    b->path.last = walk->last;
    light_pool_add_path(b->sample->pool, &b->path);
}

/* Puts a light vertex into the pool, and joins it to the camera. */
static void join_light_vertex(half_t *b, vertex_t *y, bool splats)
{
    rgb_t throughput = y->throughput;
    if (!vertex_joins(y, b->sample, &y->throughput)) return;
    light_pool_add(b->sample->pool, y);
    if (y->first && y->depth > 1 && splats) meet_caustic(b, y);
    if (splats && is_wanted(b, y->depth + 1, 1)) join_camera(b, y);
    if (b->connections.segments.count == SCENE_PACKET) take_splats(b);
    y->throughput = throughput;
}

/* Traces the light subpath into the pool; specular vertices are passed through. */
static void trace_light_subpath(half_t *b, walk_t *walk, bool splats)
{
    int segments = light_segments(b->setup);
    vertex_t y;
    y.length = 0;
    y.bounds = false;
    do {
        if (!vertex_has_room(&y, segments)) return;
        walk_arrive(walk, b->sample, &y);
        if (y.depth == 1) begin_path(b, walk);
        if (y.kind == VERTEX_SKY || vertex_is_for_eyes(&y) || !walk_weigh(walk, &y)) return;
        if (y.length > segments || y.within > WITHIN_MOST) return;
        walk_shade(walk, b->sample, &y);
        if (b->eta > 0) walk_weigh_merging(walk, &y, b->eta);
        if (vertex_is_joinable(&y)) join_light_vertex(b, &y, splats);
    } while (walk_scatter(walk, b->sample, &y));
}

/* What a light subpath teaches, beside what its connections bring (note_choice). */
static void teach_light(const half_t *b, uint64_t rays)
{
    float density = b->path.density;
    if (!(b->brought < INFINITY)) return;
    lesson_note(b->sample, LESSON_LIGHTS + b->path.lessons[0], b->brought * density, GUIDE_SQUARE_BITS);
    lesson_note(b->sample, LESSON_LIGHTS + b->path.lessons[1], (float)rays / density, GUIDE_COST_BITS);
}

static void bdpt_light(sample_t *sample, bool splats)
{
    half_t b;
    walk_t walk;
    light_ray_t ray;
    begin(&b, sample);
    uint64_t rays = sample->result->counts.rays;
    if (!walk_from_light(sample, roulette, &walk, &ray)) return;
    b.path = (light_path_t){.source = ray.light,
                            .teaches = b.teaches && ray.start.density > 0,
                            .density = ray.start.density,
                            .lessons = {ray.lessons[0], ray.lessons[1]}};
    b.ray = &ray;
    trace_light_subpath(&b, &walk, splats);
    if (b.connections.segments.count > 0) take_splats(&b);
    if (b.path.teaches && splats) teach_light(&b, sample->result->counts.rays - rays);
}

/* What an eye subpath teaches, which took so many rays. */
static void teach_eye(const half_t *b, uint64_t rays)
{
    uint32_t x = b->sample->pixel_x, y = b->sample->pixel_y;
    float own = lesson_of(b, (float)x, (float)y, b->own);
    if (!(own >= 0)) return;
    lesson_note(b->sample, LESSON_OWN + lesson_block(&b->setup->settings, x, y), own, LESSON_BITS);
    lesson_note(b->sample, LESSON_OWN_SQUARES, square(own), LESSON_BITS);
    lesson_note(b->sample, LESSON_OWN_RAYS, (float)rays, LESSON_RAY_BITS);
}

/* ---- caustics ------------------------------------------------------------------------------------------ */

/* Where an eye vertex is that may seek caustics (caustics.h), and how many rays it sends, on average. */
typedef struct {
    uint32_t region;
    float rays;
} seeker_t;

/* Follows a ray through specular vertices into a light. */
static void follow(half_t *b, walk_t *walk)
{
    for (;;) {
        vertex_t y;
        walk_arrive(walk, b->sample, &y);
        if (!vertex_is_near(&y, b->setup) || !walk_weigh(walk, &y)) return;
        if (!walk->joinable) hit_lights(b, walk, &y);
        if (y.kind == VERTEX_SKY || !vertex_has_room(&y, setup_max_segments(b->setup))) return;
        walk_shade(walk, b->sample, &y);
        if (!walk_scatter(walk, b->sample, &y) || walk->joinable) return;
    }
}

/* Sends the rays of a vertex where `walk` arrived. */
static void send_rays(half_t *b, const walk_t *walk, const vertex_t *z, const seeker_t *seeker)
{
    sampler_t numbers = sample_side_stream(b->sample, z->dimension);
    int count = (int)(seeker->rays + sampler_1d(&numbers));
    for (int k = 0; k < count; k++) {
        vec3_t w;
        float pdf;
        bsdf_value_t fz;
        vec2_t u = sampler_2d(&numbers);
        if (!caustics_sample(b->setup->caustics, seeker->region, vertex_point(z), u, &w, &pdf) ||
            !vertex_eval(z, w, &fz))
            continue;
        walk_t ray = *walk;
        walk_turn(&ray, z, w, &fz, 1 / (fz.pdf + seeker->rays * pdf));
        ray.roulette = no_roulette;
        ray.dimension = (uint32_t)(k + 1) << 24 | z->dimension; /* which no subpath gets to */
        ray.seeks = seeker->region;
        ray.left = 1;
        follow(b, &ray);
    }
}

/* Seeks caustics from a vertex where `walk` arrived, if it came by way of a specular one: what else it is
 * joined to finds the others. */
static seeker_t seek(half_t *b, const walk_t *walk, const vertex_t *z)
{
    seeker_t seeker = {CAUSTICS_NOWHERE, 0};
    const caustics_t *caustics = b->setup->caustics;
    if (walk->joinable || !vertex_is_joinable(z)) return seeker;
    if (b->sample->scout != NULL) caustics_scout_sight(b->sample->scout, vertex_point(z));
    if (caustics != NULL) seeker.region = caustics_region(caustics, vertex_point(z));
    if (seeker.region == CAUSTICS_NOWHERE) return seeker;
    float throughput = v_max(v_mul(z->throughput, bsdf_albedo(&z->bsdf)));
    if (b->teaches)
        lesson_note_part(b->sample, caustics_visit_place(caustics, seeker.region), throughput,
                         CAUSTICS_VISIT_BITS, 0.5f);
    seeker.rays = caustics_rays(caustics, seeker.region, throughput);
    if (seeker.rays > 0) send_rays(b, walk, z, &seeker);
    return seeker;
}

/* Notes at a walk that has left such a vertex what is left to it. */
static void note_seeker(const half_t *b, walk_t *walk, const seeker_t *seeker)
{
    if (!walk->joinable) return;
    walk->seeks = seeker->region;
    walk->left = 1;
    if (seeker->rays > 0) {
        float pdf = caustics_pdf(b->setup->caustics, seeker->region, walk->point, walk->direction);
        walk->left = walk->pdf / (walk->pdf + seeker->rays * pdf);
    }
}

/* Joins what the other flight of a walk ends at. */
static void take_flight(half_t *b, flights_t *flights)
{
    walk_t walk;
    vertex_t z;
    if (!walk_other_flight(flights, b->sample, &walk, &z)) return;
    walk_shade(&walk, b->sample, &z);
    if (b->eta > 0) walk_weigh_merging(&walk, &z, b->eta);
    join_eye_vertex(b, &z);
}

static rgb_t bdpt_eye(sample_t *sample)
{
    half_t b;
    begin(&b, sample);
    uint64_t rays = sample->result->counts.rays;
    int segments = setup_max_segments(b.setup);
    walk_t walk = walk_from_camera(sample, roulette);
    flights_t flights;
    if (sample->eye_weight == 0 && !walk.joinable) return b.radiance;
    vec3_t eye = walk.origin;
    for (;;) {
        vertex_t z;
        if (walk_fly(&walk, sample, &z, &flights)) take_flight(&b, &flights);
        if (!vertex_is_near(&z, b.setup) || !walk_weigh(&walk, &z)) break;
        hit_lights(&b, &walk, &z);
        bool ends = !vertex_has_room(&z, segments);
        if (z.kind == VERTEX_SKY || (ends && z.depth > 1)) break;
        walk_shade(&walk, sample, &z);
        if (z.depth == 1) vertex_first_hit(&z, sample, eye);
        if (ends) break;
        if (b.eta > 0) walk_weigh_merging(&walk, &z, b.eta);
        if (vertex_is_joinable(&z) && !lights_empty(b.setup->lights)) join_eye_vertex(&b, &z);
        if (z.merging > 0) merge_photons(&b, &z);
        seeker_t seeker = seek(&b, &walk, &z);
        if (!walk_scatter(&walk, sample, &z)) break;
        note_seeker(&b, &walk, &seeker);
    }
    if (b.setup->settings.strategy_t == 0) b.radiance = v_add(b.radiance, walk.glow);
    if (b.teaches) teach_eye(&b, sample->result->counts.rays - rays);
    return b.radiance;
}

const integrator_ops_t integrator_bdpt = {.light = bdpt_light, .sample = bdpt_eye, .traces_light = true};
const integrator_ops_t integrator_vcm = {
    .light = bdpt_light, .sample = bdpt_eye, .traces_light = true, .merges = true};
