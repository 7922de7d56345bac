/* photons: see photons.h.
 *
 * DESIGN. The light subpaths of a set are cut into chunks. Threads that need the set take one chunk after the
 * other; who finishes the last sorts all photons into the grid, chunk by chunk, so that their order, and with
 * it every sum over them, is the same however many threads there were. A chunk that was begun is always
 * finished (it takes milliseconds), so whoever waits for the others waits for threads that work, and a set
 * that was given up half-way can be gone on with.
 *
 * How many light subpaths a set has: one a pixel, at most MOST_SUBPATHS, and no more than may leave
 * MOST_PHOTONS if every vertex becomes a photon. So a set has a bound that does not depend on the scene, and
 * a small image is not made to wait for photons that none of its pixels sees.
 */
#include "worker/render/integrator/photons.h"

#include "common/base.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>

enum {
    MOST_SUBPATHS = 1 << 18,
    MOST_PHOTONS = 1 << 21,
    CHUNK = 512,              /* subpaths */
    KEPT = 2 * JOB_PHOTON_RUN /* sets: those of one run, and of the next, which some threads have begun */
};
/* The first radius, in pixels. */
static const float FIRST_RADIUS = 2;

/* All photons that a vertex is merged with share one eye subpath, and neighbouring pixels share photons,
 * which the power heuristic does not know: it takes them for M samples (Jendersie and Grosch 2018, "An
 * Improved Multiple Importance Sampling Heuristic for Density Estimates in Light Transport Simulations"). In
 * weights, and only there, they count as so much less. What nothing but merging finds is not changed by it.
 * (Measured: docs/renderer.md.) */
static const float merging_worth = 0.1f;

/* Scatters light as bdpt does: sooner adds more noise than it saves time. */
static const roulette_t roulette = {.from = 3, .most = 1};

/* Photons in the making. */
typedef struct {
    vec3_t *points;
    photon_t *photons;
    uint32_t count, capacity;
} chunk_t;

typedef struct {
    photon_set_t set; /* first: callers hold pointers to it */
    int holders;
    uint64_t used;            /* the turn of its latest holder */
    chunk_t *chunks;          /* NULL when the set is complete */
    uint32_t begun, finished; /* chunks */
} slot_t;

struct photons {
    const setup_t *setup;
    uint32_t subpaths, chunk_count;
    float first_radius;
    pthread_mutex_t lock;
    pthread_cond_t complete; /* a set is */
    slot_t **slots;
    size_t count;
    uint64_t turn;
};

/* ---- the size of things -------------------------------------------------------------------------------- */

static uint32_t subpath_count(const job_settings_t *settings)
{
    uint32_t pixels = (uint32_t)(settings->width * settings->height);
    uint32_t most = MOST_PHOTONS / (uint32_t)int_max(settings->max_depth, 1);
    most = most < MOST_SUBPATHS ? most : MOST_SUBPATHS;
    return pixels < most ? pixels : most;
}

uint64_t photons_memory(const job_settings_t *settings)
{
    if (settings->integrator != INTEGRATOR_VCM) return 0;
    uint64_t photons = (uint64_t)subpath_count(settings) * (uint64_t)int_max(settings->max_depth, 1);
    return KEPT * photons * (sizeof(vec3_t) + sizeof(photon_t) + 2 * sizeof(uint32_t));
}

static int float_order(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return x < y ? -1 : x > y;
}

/* How wide a pixel is on what the eye ray of a sample hits first: its eye rays have a density per area of the
 * film as a whole. 0 when it hits nothing. */
static float footprint(const setup_t *setup, uint32_t k)
{
    const job_settings_t *settings = &setup->settings;
    unit_result_t nothing = {0};
    sample_t sample = {.setup = setup, .sample = 0, .result = &nothing};
    sample.numbers = sampler_new(SAMPLER_INDEPENDENT, settings->seed, UINT32_MAX, k);
    vec2_t place = sample_2d(&sample, DIMENSION_LIGHT);
    sample.pixel_x = (uint32_t)(place.x * (float)settings->width);
    sample.pixel_y = (uint32_t)(place.y * (float)settings->height);
    sample.time = sample_time(&sample);
    walk_t walk = walk_from_camera(&sample, roulette);
    if (sample.eye_weight == 0) return 0;
    vertex_t vertex;
    walk_arrive(&walk, &sample, &vertex);
    if (vertex.kind == VERTEX_SKY) return 0;
    float distance2 = walk.parallel ? 1 : v_length2(v_sub(vertex_point(&vertex), walk.point));
    float density = (float)settings->width * (float)settings->height * walk.pdf;
    float width = sqrtf(distance2 / density);
    return width > 0 && width < INFINITY ? width : 0;
}

/* The radius of set 0: a few pixels of what is seen, in the middle of all; a part of the scene where nothing
 * is seen. */
static float first_radius(const setup_t *setup)
{
    enum { LOOKS = 1024 };
    if (setup->settings.merge_radius > 0) return (float)setup->settings.merge_radius;
    float widths[LOOKS];
    size_t count = 0;
    for (uint32_t k = 0; k < LOOKS; k++) {
        widths[count] = footprint(setup, k);
        count += widths[count] > 0;
    }
    vec3_t centre;
    float radius;
    scene_bounds(setup->scene, &centre, &radius);
    if (count == 0) return float_clamp(0.003f * radius, 1e-6f, JOB_MAX_MERGE_RADIUS);
    qsort(widths, count, sizeof *widths, float_order);
    return float_min(FIRST_RADIUS * widths[count / 2], JOB_MAX_MERGE_RADIUS);
}

/* (i + 1)^(-1/8): see the head of photons.h. Square roots, unlike powers, are the same on every machine. */
static float shrinkage(uint32_t index)
{
    return 1 / sqrtf(sqrtf(sqrtf((float)index + 1)));
}

/* ---- tracing ------------------------------------------------------------------------------------------- */

static void chunk_add(chunk_t *chunk, const vertex_t *y, const walk_t *walk)
{
    if (chunk->count == chunk->capacity) {
        chunk->capacity = 2 * chunk->capacity + CHUNK;
        chunk->points = mem_realloc(chunk->points, chunk->capacity * sizeof *chunk->points);
        chunk->photons = mem_realloc(chunk->photons, chunk->capacity * sizeof *chunk->photons);
    }
    float count = strategy_count(y, walk->last); /* as in bdpt.c */
    chunk->points[chunk->count] = vertex_point(y);
    chunk->photons[chunk->count++] = (photon_t){.wo = y->wo,
                                                .throughput = y->throughput,
                                                .direct = square(count) * y->direct,
                                                .inner = y->inner,
                                                .light = walk->light,
                                                .depth = y->depth,
                                                .length = y->length,
                                                .within = y->within};
}

/* Subpath k of the set. Its random numbers are those of sample 2 k of a pixel that no image has: so the
 * subpaths of one set are stratified among themselves. */
static void trace_subpath(const setup_t *setup, const photon_set_t *set, uint32_t k, chunk_t *chunk)
{
    const job_settings_t *settings = &setup->settings;
    unit_result_t nothing = {0}; /* rays are not counted: units must not depend on who made the photons */
    sample_t sample = {.setup = setup,
                       .sample = set->index,
                       .numbers =
                           sampler_new(settings->sampler, settings->seed, JOB_MAX_PIXELS + set->index, 2 * k),
                       .time = set->time,
                       .result = &nothing};
    walk_t walk;
    light_ray_t ray;
    if (!walk_from_light(&sample, roulette, &walk, &ray)) return;
    int segments = light_segments(setup);
    vertex_t y;
    y.length = 0;
    y.bounds = false;
    do {
        if (!vertex_has_room(&y, segments)) return;
        walk_arrive(&walk, &sample, &y);
        if (y.kind == VERTEX_SKY || vertex_is_for_eyes(&y) || !walk_weigh(&walk, &y)) return;
        if (y.length > segments || y.within > WITHIN_MOST) return;
        walk_shade(&walk, &sample, &y);
        walk_weigh_merging(&walk, &y, set->eta);
        if (y.merging > 0 && v_is_finite(y.throughput)) chunk_add(chunk, &y, &walk);
    } while (walk_scatter(&walk, &sample, &y));
}

static void trace_chunk(const photons_t *photons, slot_t *slot, uint32_t number)
{
    uint32_t end = (number + 1) * CHUNK;
    if (end > photons->subpaths) end = photons->subpaths;
    for (uint32_t k = number * CHUNK; k < end; k++)
        trace_subpath(photons->setup, &slot->set, k, &slot->chunks[number]);
}

/* ---- putting together ---------------------------------------------------------------------------------- */

static void free_chunks(slot_t *slot, uint32_t count)
{
    for (uint32_t c = 0; slot->chunks != NULL && c < count; c++) {
        free(slot->chunks[c].points);
        free(slot->chunks[c].photons);
    }
    free(slot->chunks);
    slot->chunks = NULL;
}

/* Joins the points of all chunks, in fresh memory. */
static vec3_t *join_points(const slot_t *slot, uint32_t chunks, uint32_t count)
{
    vec3_t *points = mem_alloc(((size_t)count + 1) * sizeof *points);
    size_t at = 0;
    for (uint32_t c = 0; c < chunks; c++)
        for (uint32_t i = 0; i < slot->chunks[c].count; i++) points[at++] = slot->chunks[c].points[i];
    return points;
}

static void sort_photons(slot_t *slot, uint32_t chunks)
{
    photon_set_t *set = &slot->set;
    uint32_t count = 0;
    for (uint32_t c = 0; c < chunks; c++) count += slot->chunks[c].count;
    uint32_t *order = mem_alloc(((size_t)count + 1) * sizeof *order);
    vec3_t *points = join_points(slot, chunks, count);
    photon_grid_build(&set->grid, points, count, set->radius, order);
    set->points = mem_alloc(((size_t)count + 1) * sizeof *set->points);
    set->photons = mem_alloc(((size_t)count + 1) * sizeof *set->photons);
    size_t at = 0;
    for (uint32_t c = 0; c < chunks; c++)
        for (uint32_t i = 0; i < slot->chunks[c].count; i++, at++) {
            set->points[order[at]] = points[at];
            set->photons[order[at]] = slot->chunks[c].photons[i];
        }
    free(points);
    free(order);
}

/* ---- the sets that are kept; all under the lock but where it says otherwise -----------------------------
 */

static void slot_free(photons_t *photons, size_t place)
{
    slot_t *slot = photons->slots[place];
    free_chunks(slot, photons->chunk_count);
    photon_grid_free(&slot->set.grid);
    free(slot->set.points);
    free(slot->set.photons);
    free(slot);
    photons->slots[place] = photons->slots[--photons->count];
}

/* Makes room for one more set by dropping the one that was not asked for for the longest time. */
static void drop_oldest(photons_t *photons)
{
    while (photons->count >= KEPT) {
        size_t oldest = SIZE_MAX;
        for (size_t i = 0; i < photons->count; i++) {
            const slot_t *slot = photons->slots[i];
            if (slot->holders == 0 && (oldest == SIZE_MAX || slot->used < photons->slots[oldest]->used))
                oldest = i;
        }
        if (oldest == SIZE_MAX) return; /* all are held: more threads than sets, each at another sample */
        slot_free(photons, oldest);
    }
}

static slot_t *slot_new(photons_t *photons, uint32_t index)
{
    drop_oldest(photons);
    slot_t *slot = mem_zalloc(1, sizeof *slot);
    sample_t sample = {.setup = photons->setup, .sample = index};
    const job_settings_t *settings = &photons->setup->settings;
    sample.numbers = sampler_new(settings->sampler, settings->seed, UINT32_MAX, index);
    slot->set.index = index;
    slot->set.time = sample_time(&sample);
    slot->set.radius = photons->first_radius * shrinkage(index);
    slot->set.area = (float)photons->subpaths * PI_F * square(slot->set.radius);
    slot->set.eta = merging_worth * slot->set.area;
    slot->chunks = mem_zalloc(photons->chunk_count, sizeof *slot->chunks);
    photons->slots = mem_realloc(photons->slots, (photons->count + 1) * sizeof(slot_t *));
    photons->slots[photons->count++] = slot;
    return slot;
}

static slot_t *slot_of(photons_t *photons, uint32_t index)
{
    for (size_t i = 0; i < photons->count; i++)
        if (photons->slots[i]->set.index == index) return photons->slots[i];
    return slot_new(photons, index);
}

/* Takes part in making the set until nothing of it is left to begin; the lock is free meanwhile. */
static void help(photons_t *photons, slot_t *slot, const atomic_bool *cancel)
{
    uint32_t chunks = photons->chunk_count;
    while (slot->begun < chunks && !atomic_load_explicit(cancel, memory_order_relaxed)) {
        uint32_t number = slot->begun++;
        pthread_mutex_unlock(&photons->lock);
        trace_chunk(photons, slot, number);
        pthread_mutex_lock(&photons->lock);
        if (++slot->finished < chunks) continue;
        pthread_mutex_unlock(&photons->lock);
        sort_photons(slot, chunks);
        pthread_mutex_lock(&photons->lock);
        free_chunks(slot, chunks);
        pthread_cond_broadcast(&photons->complete);
    }
}

const photon_set_t *photons_hold(photons_t *photons, uint32_t index, const atomic_bool *cancel)
{
    pthread_mutex_lock(&photons->lock);
    slot_t *slot = slot_of(photons, index);
    slot->holders++;
    slot->used = ++photons->turn;
    help(photons, slot, cancel);
    /* What was begun is finished soon, cancelled or not. */
    while (slot->chunks != NULL && slot->begun == photons->chunk_count)
        pthread_cond_wait(&photons->complete, &photons->lock);
    bool complete = slot->chunks == NULL;
    if (!complete) slot->holders--;
    pthread_mutex_unlock(&photons->lock);
    return complete ? &slot->set : NULL;
}

void photons_release(photons_t *photons, const photon_set_t *set)
{
    pthread_mutex_lock(&photons->lock);
    for (size_t i = 0; i < photons->count; i++)
        if (&photons->slots[i]->set == set) photons->slots[i]->holders--;
    pthread_mutex_unlock(&photons->lock);
}

/* ---- life ---------------------------------------------------------------------------------------------- */

photons_t *photons_new(const setup_t *setup)
{
    photons_t *photons = mem_zalloc(1, sizeof *photons);
    photons->setup = setup;
    photons->subpaths = subpath_count(&setup->settings);
    photons->chunk_count = (photons->subpaths + CHUNK - 1) / CHUNK;
    photons->first_radius = first_radius(setup);
    log_debug("sets of photons have %u light subpaths, and are merged within %g at first", photons->subpaths,
              (double)photons->first_radius);
    pthread_mutex_init(&photons->lock, NULL);
    pthread_cond_init(&photons->complete, NULL);
    return photons;
}

void photons_destroy(photons_t **pointer)
{
    photons_t *photons = *pointer;
    if (photons == NULL) return;
    while (photons->count > 0) slot_free(photons, photons->count - 1);
    free(photons->slots);
    pthread_cond_destroy(&photons->complete);
    pthread_mutex_destroy(&photons->lock);
    free(photons);
    *pointer = NULL;
}
