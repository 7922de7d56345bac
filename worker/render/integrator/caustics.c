/* caustics: see caustics.h. */
#include "worker/render/integrator/caustics.h"

#include "common/base.h"
#include "common/film/learning.h"
#include "worker/render/sampling/distribution.h"
#include "worker/render/sampling/octahedral.h"
#include "worker/render/sampling/smoothed.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    DEPTH = 6, /* of the tree */
    REGIONS = 1 << DEPTH,
    LEAST = 2, /* places that a region is cut by */
    SIDE = 32, /* cells a side of the directions */
    CELLS = SIDE * SIDE,
    VISITS = CELLS,
    HITS,
    LESSONS
};
/* Of a region's radius: the smallest sphere, and the largest. */
static const float least_sphere = 2, most_sphere = 1000;
/* Rays that a vertex sends at the most; and at the least where light comes, however little was found. */
static const float most_rays = 2, least_rays = 1.0f / 16;
/* So many visits that bring as much as the whole picture does are supposed where little is known. */
static const double few = 32;

typedef struct {
    vec3_t centre;
    float radius;          /* of the sphere */
    distribution_t *guide; /* NULL: no light came */
    float rays;            /* to send for a throughput of 1 */
} region_t;

struct caustics {
    int axes[REGIONS]; /* of the tree: node 1 is the root, those below node i are 2 i and 2 i + 1 */
    float cuts[REGIONS];
    uint32_t leaves[2 * REGIONS]; /* region of a node; CAUSTICS_NOWHERE: the node is cut */
    uint32_t count;
    region_t regions[REGIONS];
};

/* ---- first looks --------------------------------------------------------------------------------------- */

void caustics_scout_sight(caustics_scout_t *scout, vec3_t point)
{
    scout->seen = mem_realloc(scout->seen, (scout->sights + 1) * sizeof *scout->seen);
    scout->seen[scout->sights++] = point;
}

void caustics_scout_meeting(caustics_scout_t *scout, const caustics_meeting_t *meeting)
{
    scout->met = mem_realloc(scout->met, (scout->meetings + 1) * sizeof *scout->met);
    scout->met[scout->meetings++] = *meeting;
}

void caustics_scout_free(caustics_scout_t *scout)
{
    free(scout->seen);
    free(scout->met);
    *scout = (caustics_scout_t){0};
}

/* ---- regions ------------------------------------------------------------------------------------------- */

/* By one coordinate; then by the others, so that the order is the same everywhere. */
static int axis_order(const void *a, const void *b, void *axis)
{
    for (int k = 0; k < 3; k++) {
        int at = (*(int *)axis + k) % 3;
        float u = v_at(*(const vec3_t *)a, at), v = v_at(*(const vec3_t *)b, at);
        if (u != v) return u < v ? -1 : 1;
    }
    return 0;
}

/* Makes a node of the points, which it sorts. */
static void cut(caustics_t *self, uint32_t node, vec3_t *points, size_t count)
{
    vec3_t low = points[0], high = points[0];
    for (size_t i = 1; i < count; i++) {
        low = v_low(low, points[i]);
        high = v_high(high, points[i]);
    }
    vec3_t sides = v_sub(high, low);
    int axis = v_longest(sides);
    if (node >= REGIONS || count < 2 * LEAST || !(v_at(sides, axis) > 0)) {
        self->leaves[node] = self->count;
        self->regions[self->count++] =
            (region_t){.centre = v_scale(v_add(low, high), 0.5f), .radius = 0.5f * v_length(sides)};
        return;
    }
    qsort_r(points, count, sizeof *points, axis_order, &axis);
    size_t half = count / 2;
    self->leaves[node] = CAUSTICS_NOWHERE;
    self->axes[node] = axis;
    self->cuts[node] = 0.5f * (v_at(points[half - 1], axis) + v_at(points[half], axis));
    cut(self, 2 * node, points, half);
    cut(self, 2 * node + 1, points + half, count - half);
}

static uint32_t find(const caustics_t *self, vec3_t point)
{
    uint32_t node = 1;
    while (self->leaves[node] == CAUSTICS_NOWHERE)
        node = 2 * node + (v_at(point, self->axes[node]) >= self->cuts[node]);
    return self->leaves[node];
}

/* The spheres: as far as lights are, in the harmonic mean; where no light came, of all. */
static void size_spheres(caustics_t *self, const caustics_scout_t *scout)
{
    float sums[REGIONS] = {0}, counts[REGIONS] = {0}, sum = 0;
    for (size_t i = 0; i < scout->meetings; i++) {
        uint32_t region = find(self, scout->met[i].point);
        sums[region] += scout->met[i].nearness;
        counts[region]++;
        sum += scout->met[i].nearness;
    }
    float mean = sum / (float)scout->meetings;
    for (uint32_t i = 0; i < self->count; i++) {
        float near = counts[i] > 0 ? sums[i] / counts[i] : mean,
              radius = fmaxf(self->regions[i].radius, 1e-6f);
        float far = near > 0 ? 1 / near : INFINITY;
        self->regions[i].radius = float_clamp(far, least_sphere * radius, most_sphere * radius);
    }
}

void caustics_destroy(caustics_t **caustics)
{
    if (*caustics == NULL) return;
    for (uint32_t i = 0; i < (*caustics)->count; i++) distribution_destroy(&(*caustics)->regions[i].guide);
    free(*caustics);
    *caustics = NULL;
}

uint32_t caustics_region(const caustics_t *caustics, vec3_t point)
{
    uint32_t number = find(caustics, point);
    const region_t *region = &caustics->regions[number];
    float inside = 0.9f * region->radius;
    return v_length2(v_sub(point, region->centre)) < inside * inside ? number : CAUSTICS_NOWHERE;
}

/* ---- directions ---------------------------------------------------------------------------------------- */

/* Where a direction from a point leaves the sphere, as seen from its centre. *density receives the factor
 * from densities over the sphere, per steradian at its centre, to those per steradian at the point. */
static vec3_t leave(const region_t *region, vec3_t point, vec3_t w, float *density)
{
    vec3_t o = v_scale(v_sub(point, region->centre), 1 / region->radius);
    float along = v_dot(o, w), t = sqrtf(float_max(along * along + 1 - v_length2(o), 0)) - along;
    vec3_t n = v_add(o, v_scale(w, t));
    *density = t * t / float_max(v_dot(n, w), 1e-6f);
    return v_normalize(n);
}

uint32_t caustics_places(const caustics_t *caustics)
{
    return caustics == NULL ? 0 : caustics->count * LESSONS;
}

/* The place of a region's first lesson. */
static uint32_t first_place(const caustics_t *caustics, uint32_t region)
{
    return LEARNING_PLACES - caustics_places(caustics) + region * LESSONS;
}

uint32_t caustics_light_place(const caustics_t *caustics, uint32_t region, vec3_t point, vec3_t w)
{
    float density;
    vec2_t at = octahedral_to_square(leave(&caustics->regions[region], point, w, &density));
    int x = int_min((int)(at.x * SIDE), SIDE - 1), y = int_min((int)(at.y * SIDE), SIDE - 1);
    return first_place(caustics, region) + (uint32_t)(y * SIDE + x);
}

uint32_t caustics_visit_place(const caustics_t *caustics, uint32_t region)
{
    return first_place(caustics, region) + VISITS;
}

uint32_t caustics_hit_place(const caustics_t *caustics, uint32_t region)
{
    return first_place(caustics, region) + HITS;
}

float caustics_rays(const caustics_t *caustics, uint32_t region, float throughput)
{
    return float_min(caustics->regions[region].rays * throughput, most_rays);
}

bool caustics_sample(const caustics_t *caustics, uint32_t region, vec3_t point, vec2_t u, vec3_t *w,
                     float *pdf)
{
    const region_t *self = &caustics->regions[region];
    float of_square;
    vec3_t n = octahedral_to_sphere(distribution_sample(self->guide, u, &of_square));
    *w = v_normalize(v_sub(v_add(self->centre, v_scale(n, self->radius)), point));
    *pdf = caustics_pdf(caustics, region, point, *w);
    return *pdf > 0;
}

float caustics_pdf(const caustics_t *caustics, uint32_t region, vec3_t point, vec3_t w)
{
    const region_t *self = &caustics->regions[region];
    if (self->guide == NULL) return 0;
    float density;
    vec2_t at = octahedral_to_square(leave(self, point, w, &density));
    return distribution_pdf(self->guide, at) * density * (0.25f * INV_PI_F);
}

/* ---- learning ------------------------------------------------------------------------------------------ */

static distribution_t *learn_guide(const double *lessons)
{
    float weights[CELLS];
    for (int i = 0; i < CELLS; i++) weights[i] = (float)smoothed(lessons, SIDE, i % SIDE, i / SIDE);
    return distribution_new(weights, SIDE, SIDE, 0);
}

/* The guide of a region, and how many rays go by it. */
static void learn_region(region_t *region, const double *lessons, double reach)
{
    double light = 0, visits = lessons[VISITS] / (1 << CAUSTICS_VISIT_BITS),
           hits = lessons[HITS] / (1 << CAUSTICS_HIT_BITS);
    for (int i = 0; i < CELLS; i++) light += lessons[i];
    region->guide = light > 0 ? learn_guide(lessons) : NULL;
    region->rays = light > 0 ? float_max((float)(reach * (hits + few) / (visits + few)), least_rays) : 0;
}

static void learn_all(caustics_t *self, const double *lessons, double reach)
{
    for (uint32_t i = 0; i < self->count; i++)
        learn_region(&self->regions[i], lessons + first_place(self, i), reach);
}

/* Guides by what first looks met. */
static void learn_from_scout(caustics_t *self, const caustics_scout_t *scout)
{
    const double reach = 4; /* until more is known */
    double *lessons = mem_zalloc(LEARNING_PLACES, sizeof *lessons);
    for (size_t i = 0; i < scout->meetings; i++) {
        const caustics_meeting_t *met = &scout->met[i];
        uint32_t region = caustics_region(self, met->point);
        if (region != CAUSTICS_NOWHERE)
            lessons[caustics_light_place(self, region, met->point, met->w)] += (double)met->power;
    }
    learn_all(self, lessons, reach);
    free(lessons);
}

caustics_t *caustics_new(const caustics_scout_t *scout)
{
    if (scout->sights == 0 || scout->meetings == 0) return NULL;
    caustics_t *self = mem_zalloc(1, sizeof *self);
    vec3_t *points = mem_alloc(scout->sights * sizeof *points);
    memcpy(points, scout->seen, scout->sights * sizeof *points);
    cut(self, 1, points, scout->sights);
    free(points);
    size_spheres(self, scout);
    learn_from_scout(self, scout);
    return self;
}

caustics_t *caustics_guided(const caustics_t *base, const double *lessons, double reach)
{
    if (base == NULL) return NULL;
    caustics_t *self = mem_alloc(sizeof *self);
    *self = *base;
    learn_all(self, lessons, reach);
    return self;
}
