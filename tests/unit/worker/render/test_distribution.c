/* Tests of worker/render/sampling/distribution.c and octahedral.h: points are drawn from the density that is
 * claimed, nothing is drawn where there is none, and the octahedral map goes both ways and keeps areas. */
#include "worker/render/sampling/distribution.h"

#include "common/base.h"
#include "common/sampler.h"
#include "tests/chi_square.h"
#include "worker/render/sampling/octahedral.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

/* A number in [0, 1) that depends on its argument alone. */
static float uniform(uint64_t i)
{
    return sampler_float((uint32_t)(sampler_mix(i * 0x9E3779B97F4A7C15u + 12345) >> 32));
}

static vec2_t uniform_pair(uint64_t i)
{
    return (vec2_t){uniform(2 * i), uniform(2 * i + 1)};
}

/* ---- distribution ---- */

enum { WIDTH = 13, HEIGHT = 7, CELLS = WIDTH * HEIGHT, DRAWS = 400000, PARTS = 2 };

/* Bright and dark cells, empty ones, empty rows first, last and in between. */
static void uneven_weights(float weights[CELLS])
{
    for (size_t i = 0; i < CELLS; i++) {
        float u = uniform(1000 + i);
        size_t row = i / WIDTH;
        weights[i] = row == 0 || row == 3 || row == HEIGHT - 1 || u < 0.3f ? 0 : u * u * u;
    }
    weights[2 * WIDTH + 5] = 20;
}

static uint32_t cell(vec2_t at)
{
    uint32_t x = (uint32_t)(at.x * WIDTH), y = (uint32_t)(at.y * HEIGHT);
    assert_true(at.x >= 0 && at.x < 1 && at.y >= 0 && at.y < 1);
    return (y < HEIGHT ? y : HEIGHT - 1) * WIDTH + (x < WIDTH ? x : WIDTH - 1);
}

/* Over a grid with PARTS x PARTS bins in each cell: cells right, and uniform inside them. */
static void samples_follow_the_density(void **state)
{
    (void)state;
    enum { BINS = CELLS * PARTS * PARTS };
    float weights[CELLS];
    uneven_weights(weights);
    distribution_t *d = distribution_new(weights, WIDTH, HEIGHT, 0);
    double *observed = mem_zalloc(BINS, sizeof *observed), *expected = mem_zalloc(BINS, sizeof *expected);
    for (uint64_t i = 0; i < DRAWS; i++) {
        float pdf;
        vec2_t at = distribution_sample(d, uniform_pair(i), &pdf);
        assert_true(pdf > 0 && pdf == distribution_pdf(d, at));
        size_t x = (size_t)(at.x * WIDTH * PARTS), y = (size_t)(at.y * HEIGHT * PARTS);
        observed[y * WIDTH * PARTS + x]++;
    }
    for (size_t i = 0; i < BINS; i++) {
        vec2_t middle = {((float)(i % (WIDTH * PARTS)) + 0.5f) / (WIDTH * PARTS),
                         ((float)(i / (WIDTH * PARTS)) + 0.5f) / (HEIGHT * PARTS)};
        expected[i] = (double)distribution_pdf(d, middle) * DRAWS / BINS;
    }
    double p = chi_square_p(observed, expected, BINS, DRAWS);
    if (!(p > 1e-3)) fail_msg("p = %g", p);
    free(observed);
    free(expected);
    distribution_destroy(&d);
    assert_null(d);
}

static void density_is_weight_over_mean(void **state)
{
    (void)state;
    float weights[CELLS];
    uneven_weights(weights);
    distribution_t *d = distribution_new(weights, WIDTH, HEIGHT, 0);
    double sum = 0, integral = 0;
    for (size_t i = 0; i < CELLS; i++) sum += (double)weights[i];
    for (uint32_t i = 0; i < CELLS; i++) {
        vec2_t at = {((float)(i % WIDTH) + 0.5f) / WIDTH, ((float)(i / WIDTH) + 0.5f) / HEIGHT};
        double pdf = (double)distribution_pdf(d, at), expected = (double)weights[i] * CELLS / sum;
        assert_true(fabs(pdf - expected) <= 1e-6 * expected);
        integral += pdf / CELLS;
    }
    assert_true(fabs(integral - 1) < 1e-6);
    distribution_destroy(&d);
}

/* ---- a grid so large that its cells make blocks ---- */

enum {
    LARGE_X = 512,
    LARGE_Y = 256,
    LARGE = LARGE_X * LARGE_Y,
    SUN_X = 301,
    SUN_Y = 77,
    SUN = 3,
    COARSE = 8
};

static bool is_sun(uint32_t i)
{
    uint32_t x = i % LARGE_X, y = i / LARGE_X;
    return x >= SUN_X && x < SUN_X + SUN && y >= SUN_Y && y < SUN_Y + SUN;
}

static bool is_night(uint32_t i)
{
    return i / LARGE_X >= LARGE_Y / 2 + 1; /* the rim lies inside of blocks */
}

/* A sky that brightens slowly, with a small sun, over a black ground. */
static distribution_t *sky(float tolerance, float weights[LARGE])
{
    for (uint32_t i = 0; i < LARGE; i++)
        weights[i] = is_sun(i) ? 3e4f : is_night(i) ? 0 : 1 + (float)(i % LARGE_X) / LARGE_X;
    return distribution_new(weights, LARGE_X, LARGE_Y, tolerance);
}

static vec2_t middle_of(uint32_t i)
{
    return (vec2_t){((float)(i % LARGE_X) + 0.5f) / LARGE_X, ((float)(i / LARGE_X) + 0.5f) / LARGE_Y};
}

/* With the tolerance the slow change is lost; edges and small bright things are not. */
static void large_grids_keep_what_is_uneven(void **state)
{
    (void)state;
    float *weights = mem_alloc(LARGE * sizeof *weights);
    for (int rough = 0; rough < 2; rough++) {
        distribution_t *d = sky(rough ? 0.02f : 0, weights);
        double sum = 0, integral = 0;
        for (uint32_t i = 0; i < LARGE; i++) sum += (double)weights[i];
        for (uint32_t i = 0; i < LARGE; i++) {
            double pdf = (double)distribution_pdf(d, middle_of(i)),
                   expected = (double)weights[i] * LARGE / sum;
            double slack = rough && !is_sun(i) ? 0.02 : 1e-6;
            if (!(fabs(pdf - expected) <= slack * expected))
                fail_msg("cell %u: %g, not %g", i, pdf, expected);
            integral += pdf / LARGE;
        }
        assert_true(fabs(integral - 1) < 1e-5);
        distribution_destroy(&d);
    }
    free(weights);
}

static void samples_follow_the_density_of_large_grids(void **state)
{
    (void)state;
    enum { ACROSS = LARGE_X / COARSE, BINS = ACROSS * (LARGE_Y / COARSE) + SUN * SUN };
    float *weights = mem_alloc(LARGE * sizeof *weights);
    distribution_t *d = sky(0.02f, weights);
    double *observed = mem_zalloc(BINS, sizeof *observed), *expected = mem_zalloc(BINS, sizeof *expected);
    size_t bins[LARGE];
    for (uint32_t i = 0, sun = BINS - SUN * SUN; i < LARGE; i++) {
        bins[i] = is_sun(i) ? sun++ : (size_t)(i / LARGE_X / COARSE) * ACROSS + i % LARGE_X / COARSE;
        expected[bins[i]] += (double)distribution_pdf(d, middle_of(i)) * DRAWS / LARGE;
    }
    for (uint64_t k = 0; k < DRAWS; k++) {
        float pdf;
        vec2_t at = distribution_sample(d, uniform_pair(k), &pdf);
        uint32_t i = (uint32_t)(at.y * LARGE_Y) * LARGE_X + (uint32_t)(at.x * LARGE_X);
        assert_true(pdf > 0 && pdf == distribution_pdf(d, at) && weights[i] > 0);
        observed[bins[i]]++;
    }
    double p = chi_square_p(observed, expected, BINS, DRAWS);
    if (!(p > 1e-3)) fail_msg("p = %g", p);
    free(observed);
    free(expected);
    free(weights);
    distribution_destroy(&d);
}

/* The numbers at which rounding could lead into an empty cell. */
static void empty_cells_are_never_drawn(void **state)
{
    (void)state;
    float weights[CELLS];
    uneven_weights(weights);
    distribution_t *d = distribution_new(weights, WIDTH, HEIGHT, 0);
    float edges[2 + 2 * (CELLS + 1)];
    size_t count = 0;
    for (int i = 0; i <= CELLS; i++) {
        edges[count++] = (float)i / CELLS;
        edges[count++] = nextafterf((float)i / CELLS, 0);
    }
    edges[count++] = 0x1.fffffep-1f;
    edges[count++] = NAN;
    for (size_t i = 0; i < count * count; i++) {
        float pdf;
        vec2_t at = distribution_sample(d, (vec2_t){edges[i % count], edges[i / count]}, &pdf);
        assert_true(weights[cell(at)] > 0 && pdf > 0 && pdf == distribution_pdf(d, at));
    }
    distribution_destroy(&d);
}

/* Numbers that are the very first of a cell: the point must not round into the cell before, which is black.
 */
static void the_first_number_of_a_cell_falls_into_it(void **state)
{
    (void)state;
    enum { WIDEST = 300 };
    float weights[WIDEST];
    for (uint32_t width = 2; width <= WIDEST; width++) {
        for (uint32_t i = 0; i < width; i++) weights[i] = i % 2 == 0 ? 0 : 1;
        distribution_t *d = distribution_new(weights, width, 1, 0);
        for (uint32_t k = 0; k < width / 2; k++) {
            float pdf;
            vec2_t at = distribution_sample(d, (vec2_t){(float)((double)k / (width / 2)), 0.5f}, &pdf);
            assert_true((uint32_t)(at.x * (float)width) == 2 * k + 1);
            assert_true(pdf > 0 && pdf == distribution_pdf(d, at));
        }
        distribution_destroy(&d);
    }
}

/* One bright cell in a large dark image: every point is in it. */
static void one_bright_cell_gets_every_point(void **state)
{
    (void)state;
    enum { SIDE = 1021 };
    float *weights = mem_zalloc(SIDE * SIDE, sizeof *weights);
    for (uint64_t k = 0; k < 40; k++) {
        uint32_t x = (uint32_t)(uniform(2 * k) * SIDE), y = (uint32_t)(uniform(2 * k + 1) * SIDE);
        weights[y * SIDE + x] = 1e-30f;
        distribution_t *d = distribution_new(weights, SIDE, SIDE, 0);
        for (uint64_t i = 0; i < 200; i++) {
            float pdf;
            vec2_t u = i == 0   ? (vec2_t){0, 0}
                       : i == 1 ? (vec2_t){0x1.fffffep-1f, 0x1.fffffep-1f}
                                : uniform_pair(i);
            vec2_t at = distribution_sample(d, u, &pdf);
            assert_true((uint32_t)(at.x * SIDE) == x && (uint32_t)(at.y * SIDE) == y);
            assert_true(fabsf(pdf / (SIDE * SIDE) - 1) < 1e-6f);
        }
        distribution_destroy(&d);
        weights[y * SIDE + x] = 0;
    }
    free(weights);
}

static void where_all_is_dark_nothing_is_drawn(void **state)
{
    (void)state;
    const float weights[4] = {0, -1, NAN, INFINITY};
    distribution_t *d = distribution_new(weights, 2, 2, 0);
    float pdf = 1;
    distribution_sample(d, (vec2_t){0.5f, 0.5f}, &pdf);
    assert_true(pdf == 0);
    assert_true(distribution_pdf(d, (vec2_t){0.5f, 0.5f}) == 0);
    distribution_destroy(&d);
}

/* The nearest cell answers for what lies outside. */
static void outside_the_density_is_of_the_nearest_cell(void **state)
{
    (void)state;
    const float weights[4] = {1, 2, 3, 4};
    distribution_t *d = distribution_new(weights, 2, 2, 0);
    assert_true(distribution_pdf(d, (vec2_t){1, 1}) == 1.6f);
    assert_true(distribution_pdf(d, (vec2_t){-1, 1e30f}) == 1.2f);
    assert_true(distribution_pdf(d, (vec2_t){NAN, NAN}) == 0.4f);
    distribution_destroy(&d);
}

/* ---- octahedral map ---- */

static void the_octahedral_map_goes_both_ways(void **state)
{
    (void)state;
    for (uint64_t i = 0; i < 100000; i++) {
        vec2_t p = uniform_pair(i);
        vec3_t d = octahedral_to_sphere(p);
        vec2_t q = octahedral_to_square(d);
        assert_true(fabsf(v_length(d) - 1) < 1e-6f);
        if (!(fabsf(p.x - q.x) < 2e-6f && fabsf(p.y - q.y) < 2e-6f))
            fail_msg("(%.8g, %.8g) came back as (%.8g, %.8g)", (double)p.x, (double)p.y, (double)q.x,
                     (double)q.y);
    }
}

/* The corners, the middle and the middles of the sides, and both signs of zero. */
static void the_octahedral_map_has_its_known_corners(void **state)
{
    (void)state;
    static const struct {
        vec2_t p;
        vec3_t d;
    } cases[] = {{{0.5f, 0.5f}, {0, 0, 1}}, {{1, 0.5f}, {1, 0, 0}},
                 {{0, 0.5f}, {-1, 0, 0}},   {{0.5f, 1}, {0, 1, 0}},
                 {{0.5f, 0}, {0, -1, 0}},   {{0, 0}, {0, 0, -1}},
                 {{1, 0}, {0, 0, -1}},      {{0, 1}, {0, 0, -1}},
                 {{1, 1}, {0, 0, -1}},      {{0.75f, 0.75f}, {0.70710678f, 0.70710678f, 0}}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        vec3_t d = octahedral_to_sphere(cases[i].p), e = cases[i].d;
        assert_true(v_length(v_sub(d, e)) < 1e-6f);
        vec2_t q = octahedral_to_square(e);
        assert_true(q.x >= 0 && q.x <= 1 && q.y >= 0 && q.y <= 1);
        assert_true(v_length(v_sub(octahedral_to_sphere(q), e)) < 1e-6f);
    }
    vec2_t q = octahedral_to_square(vec3(-0.0f, -0.0f, -1));
    assert_true(q.x == 0 && q.y == 0);
}

/* The area element by central differences: 4 pi everywhere. */
static void the_octahedral_map_keeps_areas(void **state)
{
    (void)state;
    const float h = 1e-3f;
    int checked = 0;
    for (uint64_t i = 0; i < 20000; i++) {
        vec2_t p = uniform_pair(i);
        float u = fabsf(2 * p.x - 1), v = fabsf(2 * p.y - 1), margin = 0.02f;
        bool smooth =
            u > margin && v > margin && fabsf(1 - u - v) > margin && u < 1 - margin && v < 1 - margin;
        if (!smooth) continue;
        vec3_t du =
            v_sub(octahedral_to_sphere((vec2_t){p.x + h, p.y}), octahedral_to_sphere((vec2_t){p.x - h, p.y}));
        vec3_t dv =
            v_sub(octahedral_to_sphere((vec2_t){p.x, p.y + h}), octahedral_to_sphere((vec2_t){p.x, p.y - h}));
        float area = v_length(v_cross(du, dv)) / (4 * h * h);
        if (!(fabsf(area / (4 * PI_F) - 1) < 5e-3f))
            fail_msg("area element %g at (%g, %g)", (double)area, (double)p.x, (double)p.y);
        checked++;
    }
    assert_true(checked > 10000);
}

/* Uniform points of the square are uniform directions: bins in z and azimuth. */
static void uniform_points_are_uniform_directions(void **state)
{
    (void)state;
    enum { BANDS = 16, SECTORS = 24, BINS = BANDS * SECTORS, POINTS = 200000 };
    double observed[BINS] = {0}, expected[BINS];
    for (uint64_t i = 0; i < POINTS; i++) {
        vec3_t d = octahedral_to_sphere(uniform_pair(i + 7777777));
        int band = (int)((d.z + 1) / 2 * BANDS),
            sector = (int)((atan2f(d.y, d.x) / TWO_PI_F + 0.5f) * SECTORS);
        observed[int_min(band, BANDS - 1) * SECTORS + int_min(sector, SECTORS - 1)]++;
    }
    for (int i = 0; i < BINS; i++) expected[i] = (double)POINTS / BINS;
    double p = chi_square_p(observed, expected, BINS, POINTS);
    if (!(p > 1e-3)) fail_msg("p = %g", p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(samples_follow_the_density),
        cmocka_unit_test(density_is_weight_over_mean),
        cmocka_unit_test(large_grids_keep_what_is_uneven),
        cmocka_unit_test(samples_follow_the_density_of_large_grids),
        cmocka_unit_test(empty_cells_are_never_drawn),
        cmocka_unit_test(the_first_number_of_a_cell_falls_into_it),
        cmocka_unit_test(one_bright_cell_gets_every_point),
        cmocka_unit_test(where_all_is_dark_nothing_is_drawn),
        cmocka_unit_test(outside_the_density_is_of_the_nearest_cell),
        cmocka_unit_test(the_octahedral_map_goes_both_ways),
        cmocka_unit_test(the_octahedral_map_has_its_known_corners),
        cmocka_unit_test(the_octahedral_map_keeps_areas),
        cmocka_unit_test(uniform_points_are_uniform_directions),
    };
    return cmocka_run_group_tests_name("distribution", tests, NULL, NULL);
}
