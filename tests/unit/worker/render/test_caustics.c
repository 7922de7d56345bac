/* Where eye subpaths look for caustics: directions are drawn from the density that is claimed; what was
 * learned at one point of a region says where the light is from others; and points that nothing is known of
 * are left alone. */
#include "worker/render/integrator/caustics.h"

#include "common/base.h"
#include "common/film/learning.h"
#include "common/sampler.h"
#include "tests/chi_square.h"
#include "worker/render/sampling/octahedral.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

static const vec3_t lamp = {0.4f, 2.5f, -0.3f};

static vec3_t to_lamp(vec3_t p)
{
    return v_normalize(v_sub(lamp, p));
}

/* A point of the floor of a basin of 2 x 2. */
static vec3_t point_of_floor(sampler_t *numbers)
{
    vec2_t u = sampler_2d(numbers);
    return vec3(2 * u.x - 1, 0, 2 * u.y - 1);
}

/* Regions about so many points of the floor, to most of which light came straight from the lamp. */
static caustics_t *caustics_of_floor(int points)
{
    sampler_t numbers = sampler_new(SAMPLER_INDEPENDENT, 1, 2, 3);
    caustics_scout_t scout = {0};
    for (int i = 0; i < points; i++) {
        vec3_t p = point_of_floor(&numbers);
        caustics_scout_sight(&scout, p);
        caustics_meeting_t met = {p, to_lamp(p), 1 / v_length(v_sub(lamp, p)), 1};
        if (i % 4 != 0) caustics_scout_meeting(&scout, &met);
    }
    caustics_t *caustics = caustics_new(&scout);
    assert_non_null(caustics);
    caustics_scout_free(&scout);
    return caustics;
}

/* Draws by the region of a point and compares with the density over the whole sphere. */
static void check_density(const caustics_t *caustics, vec3_t p)
{
    enum { SIDE = 12, CELLS = SIDE * SIDE, FINE = 128, DRAWS = 1 << 14 };
    double observed[CELLS] = {0}, expected[CELLS] = {0}, all = 0;
    sampler_t numbers = sampler_new(SAMPLER_SOBOL, 4, 5, 6);
    uint32_t region = caustics_region(caustics, p);
    assert_int_not_equal(region, CAUSTICS_NOWHERE);
    for (int i = 0; i < DRAWS; i++) {
        vec3_t w;
        float pdf;
        numbers = sampler_new(SAMPLER_INDEPENDENT, 4, 5, (uint32_t)i);
        if (!caustics_sample(caustics, region, p, sampler_2d(&numbers), &w, &pdf)) continue;
        assert_true(pdf > 0 && pdf == caustics_pdf(caustics, region, p, w));
        vec2_t at = octahedral_to_square(w);
        observed[int_min((int)(at.y * SIDE), SIDE - 1) * SIDE + int_min((int)(at.x * SIDE), SIDE - 1)]++;
    }
    for (int i = 0; i < CELLS * FINE * FINE; i++) {
        vec2_t at = {((float)(i % (SIDE * FINE)) + 0.5f) / (SIDE * FINE),
                     ((float)(i / (SIDE * FINE)) + 0.5f) / (SIDE * FINE)};
        double part = (double)caustics_pdf(caustics, region, p, octahedral_to_sphere(at)) * 4 * M_PI /
                      (CELLS * FINE * FINE);
        all += part;
        expected[(int)(at.y * SIDE) * SIDE + (int)(at.x * SIDE)] += part * DRAWS;
    }
    assert_true(fabs(all - 1) < 0.005);
    assert_true(chi_square_p(observed, expected, CELLS, DRAWS) > 1e-4);
}

static void directions_have_the_density_that_is_claimed(void **state)
{
    (void)state;
    caustics_t *caustics = caustics_of_floor(100);
    check_density(caustics, vec3(0.1f, 0, 0.2f));
    check_density(caustics, vec3(-0.9f, 0, 0.7f));
    check_density(caustics, vec3(0.5f, 0.05f, -0.6f));
    caustics_destroy(&caustics);
    assert_null(caustics);
}

/* The part of the rays from a point that go within a few degrees of the lamp. */
static double aim(const caustics_t *caustics, vec3_t p)
{
    enum { DRAWS = 4096 };
    int near = 0;
    uint32_t region = caustics_region(caustics, p);
    for (uint32_t i = 0; i < DRAWS; i++) {
        vec3_t w;
        float pdf;
        sampler_t numbers = sampler_new(SAMPLER_SOBOL, 7, 8, i);
        near += caustics_sample(caustics, region, p, sampler_2d(&numbers), &w, &pdf) &&
                v_dot(w, to_lamp(p)) > 0.95f;
    }
    return (double)near / DRAWS;
}

/* One region alone spans the basin: by directions from its centre a corner would look past the lamp. */
static void a_region_agrees_where_the_light_is(void **state)
{
    (void)state;
    caustics_scout_t scout = {0};
    vec3_t corners[3] = {{-1, 0, -1}, {1, 0, 1}, {0.9f, 0, -0.8f}};
    for (int i = 0; i < 3; i++) caustics_scout_sight(&scout, corners[i]);
    caustics_meeting_t met = {corners[0], to_lamp(corners[0]), 1 / 2.8f, 1};
    caustics_scout_meeting(&scout, &met);
    caustics_t *caustics = caustics_new(&scout);
    assert_int_equal(caustics_region(caustics, corners[0]), caustics_region(caustics, corners[1]));
    for (int i = 0; i < 3; i++) assert_true(aim(caustics, corners[i]) > 0.6);
    caustics_destroy(&caustics);
    caustics_scout_free(&scout);
}

/* Lessons of a lamp elsewhere take the place of what first looks said; the rays follow what they brought. */
static void lessons_replace_first_looks(void **state)
{
    (void)state;
    caustics_t *caustics = caustics_of_floor(100);
    double *lessons = mem_zalloc(LEARNING_PLACES, sizeof *lessons);
    vec3_t p = vec3(0.3f, 0, 0.3f), w = v_normalize(vec3(-0.8f, 0.5f, 0.1f));
    uint32_t region = caustics_region(caustics, p), first = LEARNING_PLACES - caustics_places(caustics);
    uint32_t place = caustics_light_place(caustics, region, p, w);
    assert_in_range(place, first, LEARNING_PLACES - 1);
    lessons[place] = 100;
    caustics_t *dark = caustics_guided(caustics, lessons, 1);
    lessons[caustics_visit_place(caustics, region)] = 1000 * (1 << CAUSTICS_VISIT_BITS);
    caustics_t *idle = caustics_guided(caustics, lessons, 1);
    lessons[caustics_hit_place(caustics, region)] = 500 * (1 << CAUSTICS_HIT_BITS);
    caustics_t *busy = caustics_guided(caustics, lessons, 1);
    assert_true(caustics_pdf(busy, region, p, w) > 5);
    assert_true(caustics_pdf(busy, region, p, to_lamp(p)) == 0);
    float unknown = caustics_rays(dark, region, 0.5f), few = caustics_rays(idle, region, 0.5f),
          many = caustics_rays(busy, region, 0.5f);
    assert_true(fabsf(unknown - 0.5f) < 0.01f && few > 0 && few < 0.1f && fabsf(many - 0.26f) < 0.02f);
    assert_true(caustics_rays(busy, region, 1000) <= 4);
    uint32_t other = caustics_region(caustics, vec3(-0.8f, 0, -0.8f));
    assert_int_not_equal(other, region);
    assert_true(caustics_rays(busy, other, 1) == 0);
    assert_true(caustics_pdf(busy, other, vec3(-0.8f, 0, -0.8f), w) == 0);
    caustics_destroy(&busy);
    caustics_destroy(&idle);
    caustics_destroy(&dark);
    caustics_destroy(&caustics);
    free(lessons);
}

static void nothing_is_known_elsewhere(void **state)
{
    (void)state;
    caustics_t *caustics = caustics_of_floor(100), *none = NULL;
    assert_int_equal(caustics_region(caustics, vec3(100, 0, 0)), CAUSTICS_NOWHERE);
    assert_in_range(caustics_places(caustics), 1, LEARNING_PLACES * 3 / 4);
    caustics_destroy(&caustics);
    caustics_scout_t blind = {0};
    caustics_meeting_t met = {lamp, {0, 1, 0}, 1, 1};
    assert_null(caustics_new(&blind));
    caustics_scout_meeting(&blind, &met);
    assert_null(caustics_new(&blind));
    assert_null(caustics_guided(NULL, NULL, 1));
    assert_int_equal(caustics_places(NULL), 0);
    caustics_scout_free(&blind);
    caustics_destroy(&none);
}

/* Where all was seen at one place there is one region, without an extent; the sky is infinitely far. */
static void one_place_is_a_region(void **state)
{
    (void)state;
    caustics_scout_t scout = {0};
    vec3_t p = vec3(3, 4, 5), up = vec3(0, 1, 0);
    caustics_meeting_t met = {p, up, 0, 1};
    for (int i = 0; i < 50; i++) caustics_scout_sight(&scout, p);
    caustics_scout_meeting(&scout, &met);
    caustics_t *caustics = caustics_new(&scout);
    assert_int_equal(caustics_region(caustics, p), 0);
    assert_true(caustics_pdf(caustics, 0, p, up) > 1);
    caustics_destroy(&caustics);
    caustics_scout_free(&scout);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(directions_have_the_density_that_is_claimed),
        cmocka_unit_test(a_region_agrees_where_the_light_is),
        cmocka_unit_test(lessons_replace_first_looks),
        cmocka_unit_test(nothing_is_known_elsewhere),
        cmocka_unit_test(one_place_is_a_region),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
