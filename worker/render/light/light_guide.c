/* light_guide: see light_guide.h. */
#include "worker/render/light/light_guide.h"

#include "common/base.h"
#include "worker/render/sampling/distribution.h"
#include "worker/render/sampling/smoothed.h"

#include <math.h>
#include <stdlib.h>

/* Parts a side that a sky's directions are cut into, by the numbers that draw them. */
enum { PLACES = 8 };
/* The part of starts that is drawn as without a guide: of rays, and of a sky's directions. */
static const float plain_rays = 0.25f, plain_places = 0.25f;

struct light_guide {
    distribution_t *places;                /* NULL where there is one part only */
    distribution_t *rays[PLACES * PLACES]; /* of directions, or of parallel rays by parts */
};

/* ---- making one ---------------------------------------------------------------------------------------- */

static uint32_t parts_of(guide_kind_t kind)
{
    return kind == GUIDE_SKY ? PLACES * PLACES : 1;
}

uint32_t light_guide_side(guide_kind_t kind, uint32_t fineness)
{
    return (kind == GUIDE_SKY ? 6u : 16u) << fineness;
}

uint32_t light_guide_cells(guide_kind_t kind, uint32_t side)
{
    return kind == GUIDE_NOTHING ? 1 : parts_of(kind) * side * side;
}

/* The factors that take lessons to what they are for each measure and sample. */
typedef struct {
    double of[GUIDE_LESSONS];
} scale_t;

/* sqrt(g^2 / c) of a cell with these lessons. */
static double worth_of(const double lessons[GUIDE_LESSONS], const scale_t *scale)
{
    double squares =
        scale->of[GUIDE_SQUARES] * lessons[GUIDE_SQUARES] + scale->of[GUIDE_LEFT] * lessons[GUIDE_LEFT];
    double cost = scale->of[GUIDE_COSTS] * lessons[GUIDE_COSTS];
    return sqrt(squares / fmax(cost, 1)); /* there is a ray at least */
}

/* The distribution over one grid, and the mean of its weights. `lessons` are those of its first cell, `cells`
 * the step from one kind to the next. */
static distribution_t *learn_grid(const double *lessons, uint32_t cells, uint32_t side, const scale_t *scale,
                                  double *mean)
{
    float *weights = mem_alloc((size_t)side * side * sizeof *weights);
    *mean = 0;
    for (uint32_t i = 0; i < side * side; i++) {
        int x = (int)(i % side), y = (int)(i / side);
        double of_cell[GUIDE_LESSONS];
        for (uint32_t k = 0; k < GUIDE_LESSONS; k++)
            of_cell[k] = smoothed(lessons + (size_t)k * cells, (int)side, x, y);
        double worth = worth_of(of_cell, scale);
        weights[i] = (float)worth;
        *mean += worth / (side * side);
    }
    distribution_t *grid = *mean > 0 ? distribution_new(weights, side, side, 0) : NULL;
    free(weights);
    return grid;
}

/* Numbers that draw a direction, by what the parts are worth. */
static distribution_t *learn_places(const double *worths, double mean)
{
    float weights[PLACES * PLACES];
    for (int i = 0; i < PLACES * PLACES; i++)
        weights[i] = (float)((double)plain_places * mean + (1 - (double)plain_places) * worths[i]);
    return distribution_new(weights, PLACES, PLACES, 0);
}

light_guide_t *light_guide_new(guide_kind_t kind, uint32_t side, const double *lessons, double samples,
                               double left, double *worth)
{
    uint32_t cells = light_guide_cells(kind, side), parts = parts_of(kind);
    double worths[PLACES * PLACES], per_sample = cells / samples, mean = 0;
    scale_t scale = {{[GUIDE_SQUARES] = per_sample / (1 << GUIDE_SQUARE_BITS),
                      [GUIDE_COSTS] = per_sample / (1 << GUIDE_COST_BITS),
                      [GUIDE_LEFT] = left * per_sample / (1 << GUIDE_LEFT_BITS)}};
    if (kind == GUIDE_NOTHING) {
        *worth = worth_of(lessons, &scale);
        return NULL;
    }
    light_guide_t *guide = mem_zalloc(1, sizeof *guide);
    for (uint32_t part = 0; part < parts; part++) {
        const double *first = lessons + (size_t)part * side * side;
        guide->rays[part] = learn_grid(first, cells, side, &scale, &worths[part]);
        mean += worths[part] / parts;
    }
    *worth = mean;
    if (!(mean > 0))
        light_guide_destroy(&guide);
    else if (kind == GUIDE_SKY)
        guide->places = learn_places(worths, mean);
    return guide;
}

void light_guide_destroy(light_guide_t **guide)
{
    light_guide_t *self = *guide;
    if (self == NULL) return;
    distribution_destroy(&self->places);
    for (int i = 0; i < PLACES * PLACES; i++) distribution_destroy(&self->rays[i]);
    free(self);
    *guide = NULL;
}

/* The cell of a point of the unit square. */
static uint32_t cell_of(vec2_t at, uint32_t side)
{
    uint32_t x = (uint32_t)float_max(at.x * (float)side, 0), y = (uint32_t)float_max(at.y * (float)side, 0);
    return (y < side ? y : side - 1) * side + (x < side ? x : side - 1);
}

/* Decides by one of the numbers, which it stretches, whether to draw by a grid. */
static bool by_grid(const distribution_t *grid, float *u)
{
    if (grid == NULL) return false;
    bool plain = *u < plain_rays;
    *u = plain ? *u / plain_rays : (*u - plain_rays) / (1 - plain_rays);
    *u = float_min(*u, 0x1.fffffep-1f);
    return !plain;
}

/* ---- directions: the plain octahedral map -------------------------------------------------------------- */

/* The density per steradian of what has density 1 on the unit square. With l = |x| + |y| + |z| of the unit
 * vector, the octahedron |x| + |y| + |z| = 1 is 1 / l away, and an area dA of its shadow on the (x, y) plane
 * is l^3 dA steradians. */
static float square_density(vec3_t w)
{
    float l = fabsf(w.x) + fabsf(w.y) + fabsf(w.z);
    return 0.25f / (l * l * l);
}

static vec2_t square_of(vec3_t w)
{
    float scale = 1 / (fabsf(w.x) + fabsf(w.y) + fabsf(w.z)), x = w.x * scale, y = w.y * scale;
    if (w.z < 0) {
        float folded = (1 - fabsf(y)) * copysignf(1, x);
        y = (1 - fabsf(x)) * copysignf(1, y);
        x = folded;
    }
    return (vec2_t){float_clamp(0.5f + 0.5f * x, 0, 1), float_clamp(0.5f + 0.5f * y, 0, 1)};
}

static vec3_t direction_of(vec2_t at)
{
    float x = 2 * at.x - 1, y = 2 * at.y - 1, z = 1 - fabsf(x) - fabsf(y);
    if (z < 0) {
        float folded = (1 - fabsf(y)) * copysignf(1, x);
        y = (1 - fabsf(x)) * copysignf(1, y);
        x = folded;
    }
    return v_normalize(vec3(x, y, z));
}

bool light_guide_direction(const light_guide_t *guide, vec2_t *u, vec3_t *w)
{
    if (guide == NULL || !by_grid(guide->rays[0], &u->x)) return false;
    float pdf;
    *w = direction_of(distribution_sample(guide->rays[0], *u, &pdf));
    return true;
}

float light_guide_direction_pdf(const light_guide_t *guide, float plain, vec3_t w)
{
    if (guide == NULL) return plain;
    return plain_rays * plain +
           (1 - plain_rays) * distribution_pdf(guide->rays[0], square_of(w)) * square_density(w);
}

light_start_t light_guide_direction_start(uint32_t side, vec3_t w, float pdf)
{
    return (light_start_t){cell_of(square_of(w), side), pdf / square_density(w)};
}

/* ---- the sky ------------------------------------------------------------------------------------------- */

vec2_t light_guide_place(const light_guide_t *guide, vec2_t u, float *density)
{
    *density = 1;
    if (guide == NULL || guide->places == NULL) return u;
    return distribution_sample(guide->places, u, density);
}

float light_guide_place_pdf(const light_guide_t *guide, vec2_t u)
{
    return guide == NULL || guide->places == NULL ? 1 : distribution_pdf(guide->places, u);
}

/* The grid of where rays go for a direction; NULL where nothing is known. */
static const distribution_t *grid_at(const light_guide_t *guide, vec2_t place)
{
    if (guide == NULL) return NULL;
    return guide->rays[guide->places == NULL ? 0 : cell_of(place, PLACES)];
}

bool light_guide_square(const light_guide_t *guide, vec2_t place, vec2_t *u, vec2_t *at)
{
    const distribution_t *grid = grid_at(guide, place);
    if (!by_grid(grid, &u->x)) return false;
    float pdf;
    *at = distribution_sample(grid, *u, &pdf);
    return true;
}

float light_guide_square_pdf(const light_guide_t *guide, vec2_t place, float plain, vec2_t at)
{
    const distribution_t *grid = grid_at(guide, place);
    if (grid == NULL) return plain;
    bool inside = at.x >= 0 && at.x <= 1 && at.y >= 0 && at.y <= 1;
    return plain_rays * plain + (inside ? (1 - plain_rays) * distribution_pdf(grid, at) : 0);
}

light_start_t light_guide_square_start(guide_kind_t kind, uint32_t side, vec2_t place, vec2_t at,
                                       float density)
{
    uint32_t part = kind == GUIDE_SKY ? cell_of(place, PLACES) : 0;
    return (light_start_t){part * side * side + cell_of(at, side), density};
}
