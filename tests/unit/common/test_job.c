/* Tests of common/job.c: tiles cover the image exactly once, units are checked against the job, settings
 * against their limits. */
#include "common/film/film.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static job_settings_t settings_of(int width, int height, int tile)
{
    job_settings_t settings = job_settings_default();
    settings.width = width;
    settings.height = height;
    settings.tile_size = tile;
    return settings;
}

static void check_cover(const job_settings_t *settings)
{
    size_t pixels = (size_t)settings->width * (size_t)settings->height, sum = 0;
    uint8_t *hits = mem_zalloc(pixels, 1);
    for (uint32_t tile = 0; tile < job_tile_count(settings); tile++) {
        rect_t rect = job_tile_rect(settings, tile);
        assert_true(rect.x0 >= 0 && rect.x0 < rect.x1 && rect.x1 <= settings->width);
        assert_true(rect.y0 >= 0 && rect.y0 < rect.y1 && rect.y1 <= settings->height);
        assert_true(rect.x1 - rect.x0 <= settings->tile_size && rect.y1 - rect.y0 <= settings->tile_size);
        for (int y = rect.y0; y < rect.y1; y++)
            for (int x = rect.x0; x < rect.x1; x++) hits[(size_t)y * (size_t)settings->width + (size_t)x]++;
        sum += job_tile_pixels(settings, tile);
    }
    assert_int_equal(sum, pixels);
    for (size_t p = 0; p < pixels; p++) assert_int_equal(hits[p], 1);
    free(hits);
}

static void tiles_cover_the_image_once(void **state)
{
    (void)state;
    const int sizes[][3] = {{64, 64, 32}, {65, 63, 32}, {1, 1, 8},     {8, 8, 8},       {7, 200, 8},
                            {200, 7, 16}, {33, 34, 16}, {640, 1, 256}, {256, 257, 256}, {100, 100, 9}};
    for (size_t i = 0; i < ARRAY_LENGTH(sizes); i++) {
        job_settings_t settings = settings_of(sizes[i][0], sizes[i][1], sizes[i][2]);
        assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
        check_cover(&settings);
    }
}

static void tiles_run_row_by_row(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(70, 40, 32);
    assert_int_equal(job_tile_count(&settings), 6);
    rect_t rect = job_tile_rect(&settings, 5);
    assert_int_equal(rect.x0, 64);
    assert_int_equal(rect.y0, 32);
    assert_int_equal(rect.x1, 70);
    assert_int_equal(rect.y1, 40);
    assert_int_equal(job_tile_pixels(&settings, 5), 48);
    /* The largest image: nothing wraps. */
    settings = settings_of(JOB_MAX_RESOLUTION, JOB_MAX_PIXELS / JOB_MAX_RESOLUTION, JOB_MIN_TILE);
    assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
    assert_int_equal(job_tile_count(&settings), JOB_MAX_PIXELS / 64);
    assert_int_equal(job_tile_rect(&settings, job_tile_count(&settings) - 1).x1, JOB_MAX_RESOLUTION);
}

static void units_are_checked(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(70, 40, 32);
    settings.spp = 100;
    const struct {
        unit_t unit;
        bool valid;
    } cases[] = {{{0, 0, 1}, true},
                 {{5, 0, 100}, true},
                 {{5, 99, 1}, true},
                 {{6, 0, 1}, false},
                 {{UINT32_MAX, 0, 1}, false},
                 {{0, 0, 0}, false},
                 {{0, 0, 101}, false},
                 {{0, 99, 2}, false},
                 {{0, 100, 1}, false},
                 {{0, UINT32_MAX, 1}, false},
                 {{0, UINT32_MAX, 2}, false},
                 {{0, 1, UINT32_MAX}, false},
                 {{0, UINT32_MAX - 50, 52}, false}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++)
        assert_int_equal(job_unit_valid(&settings, &cases[i].unit), cases[i].valid);
}

static void tiles_of_adaptive_jobs_may_have_more(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(70, 40, 32);
    settings.spp = 100;
    assert_false(job_is_planned(&settings));
    assert_int_equal(job_sample_limit(&settings), 100);
    settings.error = 0.1;
    assert_true(job_is_planned(&settings));
    assert_int_equal(job_sample_limit(&settings), 100);
    settings.error = 0;
    settings.adaptive = true;
    assert_true(job_is_planned(&settings));
    assert_int_equal(job_sample_limit(&settings), 1600);
    assert_true(job_unit_valid(&settings, &(unit_t){0, 1599, 1}));
    assert_false(job_unit_valid(&settings, &(unit_t){0, 1599, 2}));
    settings.spp = JOB_MAX_SPP;
    assert_int_equal(job_sample_limit(&settings), JOB_MAX_SPP);
    settings.spp = JOB_MAX_ADAPTIVE_SPP;
    assert_int_equal(job_sample_limit(&settings), JOB_MAX_SPP);
}

static void the_samples_of_a_job_are_known_unless_time_ends_it(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(70, 40, 32);
    settings.spp = 100;
    assert_int_equal(unit_samples(&settings, &(unit_t){2, 7, 5}), 5 * (70 - 64) * 32);
    assert_int_equal(job_total_samples(&settings), 70 * 40 * 100);
    settings.spp = JOB_MAX_SPP - 1;
    assert_int_equal(job_total_samples(&settings), (uint64_t)70 * 40 * (JOB_MAX_SPP - 1));
    settings.spp = JOB_MAX_SPP;
    assert_int_equal(job_total_samples(&settings), 0);
}

static void halves_count_even_and_odd_samples(void **state)
{
    (void)state;
    for (uint32_t first = 0; first < 5; first++)
        for (uint32_t count = 1; count < 9; count++) {
            uint32_t expected[2] = {0, 0};
            for (uint32_t i = first; i < first + count; i++) expected[i % 2]++;
            unit_t unit = {0, first, count};
            assert_int_equal(unit_half_count(&unit, 0), expected[0]);
            assert_int_equal(unit_half_count(&unit, 1), expected[1]);
        }
    unit_t whole = {0, 1, JOB_MAX_SPP};
    assert_int_equal(unit_half_count(&whole, 0), JOB_MAX_SPP / 2);
}

static void assert_refused(job_settings_t settings, const char *field)
{
    result_t result = job_settings_check(&settings);
    if (result.code == RESULT_OK || strstr(result.message, field) == NULL)
        fail_msg("expected an error about %s, got: %s", field, result.message);
}

static void settings_are_checked(void **state)
{
    (void)state;
    const job_settings_t good = job_settings_default();
    job_settings_t bad = good;
    assert_int_equal(job_settings_check(&good).code, RESULT_OK);
    const int widths[] = {0, -1, JOB_MAX_RESOLUTION + 1, INT32_MAX, INT32_MIN};
    for (size_t i = 0; i < ARRAY_LENGTH(widths); i++) {
        bad.width = widths[i];
        assert_refused(bad, "width");
        bad.width = good.width;
        bad.height = widths[i];
        assert_refused(bad, "height");
        bad.height = good.height;
    }
    bad.width = bad.height = JOB_MAX_RESOLUTION;
    assert_refused(bad, "pixels");
    bad = good;
    bad.tile_size = JOB_MIN_TILE - 1;
    assert_refused(bad, "tile size");
    bad.tile_size = JOB_MAX_TILE + 1;
    assert_refused(bad, "tile size");
    bad = good;
    bad.integrator = (integrator_t)0;
    assert_refused(bad, "integrator");
    bad.integrator = (integrator_t)(INTEGRATOR_VCM + 1);
    assert_refused(bad, "integrator");
    bad = good;
    bad.merge_radius = 0.1;
    assert_refused(bad, "merge radius");
    bad.integrator = INTEGRATOR_VCM;
    assert_int_equal(job_settings_check(&bad).code, RESULT_OK);
    assert_true(job_has_splats(&bad));
    bad.merge_radius = 2 * JOB_MAX_MERGE_RADIUS;
    assert_refused(bad, "merge radius");
    bad.merge_radius = -1;
    assert_refused(bad, "merge radius");
    bad = good;
    bad.integrator = INTEGRATOR_AO;
    assert_int_equal(job_settings_check(&bad).code, RESULT_OK);
    assert_false(job_has_splats(&bad));
    snprintf(bad.light_groups, sizeof bad.light_groups, "all=1");
    assert_refused(bad, "looks at none");
    bad = good;
    bad.sampler = (sampler_kind_t)3;
    assert_refused(bad, "sampler");
    bad = good;
    bad.max_depth = JOB_MAX_DEPTH + 1;
    assert_refused(bad, "depth");
    bad = good;
    bad.spp = 0;
    assert_refused(bad, "samples");
    bad.spp = UINT32_MAX;
    assert_refused(bad, "samples");
    bad = good;
    bad.film_scale = FILM_MAX_SCALE + 1;
    assert_refused(bad, "film scale");
    bad = good;
    bad.time_limit = NAN;
    assert_refused(bad, "time limit");
    bad.time_limit = -1;
    assert_refused(bad, "time limit");
    bad = good;
    const double errors[] = {-0.1, 1, NAN, INFINITY};
    for (size_t i = 0; i < ARRAY_LENGTH(errors); i++) {
        bad.error = errors[i];
        assert_refused(bad, "error");
    }
    bad = good;
    bad.adaptive = true;
    bad.spp = JOB_MAX_ADAPTIVE_SPP + 1;
    assert_refused(bad, "adaptive");
    bad.spp = JOB_MAX_SPP; /* time or the error ends it */
    assert_int_equal(job_settings_check(&bad).code, RESULT_OK);
}

static job_settings_t strategy_of(int s, int t, int max_depth)
{
    job_settings_t settings = job_settings_default();
    settings.strategy_s = s;
    settings.strategy_t = t;
    settings.max_depth = max_depth;
    settings.unweighted = true;
    return settings;
}

/* Jobs whose samples are not the same have other hashes: nobody takes one for the other. */
static void the_content_has_what_samples_depend_on(void **state)
{
    (void)state;
    const hash_t blob = {{1}};
    job_settings_t plain = job_settings_default();
    plain.learn = false;
    job_settings_t adaptive = plain, learning = plain, both = plain;
    adaptive.adaptive = both.adaptive = learning.learn = both.learn = true;
    hash_t hash = job_content_hash(&plain, &blob), learned = job_content_hash(&learning, &blob);
    hash_t passes = job_content_hash(&both, &blob), same = job_content_hash(&adaptive, &blob);
    assert_true(hash_equal(&hash, &same));
    assert_false(hash_equal(&hash, &learned));
    assert_false(hash_equal(&learned, &passes)); /* which are others */
}

static void strategies_are_checked(void **state)
{
    (void)state;
    const int good[][3] = {{0, 2, 0}, {0, 3, 1}, {1, 2, 1},     {2, 1, 1},
                           {5, 1, 4}, {3, 3, 4}, {101, 1, 100}, {0, 102, 100}};
    for (size_t i = 0; i < ARRAY_LENGTH(good); i++) {
        job_settings_t settings = strategy_of(good[i][0], good[i][1], good[i][2]);
        assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
        settings.unweighted = false;
        assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
        settings.integrator = INTEGRATOR_PATH;
        assert_refused(settings, "belongs to bdpt, not to path");
    }
    const int missing[][2] = {{0, 1}, {1, 1}, {1, 0}, {7, 0}};
    for (size_t i = 0; i < ARRAY_LENGTH(missing); i++)
        assert_refused(strategy_of(missing[i][0], missing[i][1], 8), "no strategy");
    assert_refused(strategy_of(1, 2, 0), "max depth 0");
    assert_refused(strategy_of(3, 3, 3), "5 segments");
    assert_refused(strategy_of(0, 3, 0), "max depth");
    assert_refused(strategy_of(-1, 4, 8), "(s)");
    assert_refused(strategy_of(4, -1, 8), "(t)");
    assert_refused(strategy_of(INT32_MAX, INT32_MAX, 8), "(s)");
    assert_refused(strategy_of(0, INT32_MAX, 8), "(t)");
    assert_refused(strategy_of(0, 0, 8), "unweighted");
}

static job_settings_t saved_at(uint32_t count, uint32_t a, uint32_t b)
{
    job_settings_t settings = settings_of(70, 40, 32);
    settings.save_at = (save_at_t){count, {a, b}};
    return settings;
}

static void milestones_are_checked(void **state)
{
    (void)state;
    job_settings_t settings = saved_at(2, 16, JOB_MAX_SPP);
    assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
    assert_true(job_is_planned(&settings) && !job_follows_noise(&settings));
    assert_int_equal(job_next_milestone(&settings, 0), 16);
    assert_int_equal(job_next_milestone(&settings, 15), 16);
    assert_int_equal(job_next_milestone(&settings, 16), JOB_MAX_SPP);
    assert_int_equal(job_next_milestone(&settings, JOB_MAX_SPP), JOB_MAX_SPP + 1);
    settings.error = 0.1;
    assert_int_equal(job_settings_check(&settings).code, RESULT_OK);
    settings.adaptive = true;
    assert_refused(settings, "without --adaptive");
    assert_refused(saved_at(2, 16, 16), "must rise");
    assert_refused(saved_at(2, 16, 3), "must rise");
    assert_refused(saved_at(2, 0, 3), "from 1 to");
    assert_refused(saved_at(2, 16, JOB_MAX_SPP + 1), "from 1 to");
    assert_refused(saved_at(JOB_MAX_SAVES + 1, 16, 32), "from 0 to 64");
    assert_refused(saved_at(UINT32_MAX, 16, 32), "from 0 to 64");
}

static void every_kind_has_its_name(void **state)
{
    (void)state;
    assert_string_equal(integrator_name(INTEGRATOR_BDPT), "bdpt");
    assert_string_equal(integrator_name(INTEGRATOR_PATH), "path");
    assert_string_equal(integrator_name(INTEGRATOR_LIGHT), "light");
    assert_string_equal(integrator_name(INTEGRATOR_AO), "ao");
    assert_string_equal(integrator_name(INTEGRATOR_VCM), "vcm");
    assert_null(integrator_names[INTEGRATOR_VCM]);
    assert_string_equal(sampler_name(SAMPLER_SOBOL), "sobol");
    assert_string_equal(sampler_name(SAMPLER_INDEPENDENT), "independent");
    assert_null(sampler_names[SAMPLER_INDEPENDENT]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(tiles_cover_the_image_once),
                                       cmocka_unit_test(tiles_run_row_by_row),
                                       cmocka_unit_test(units_are_checked),
                                       cmocka_unit_test(tiles_of_adaptive_jobs_may_have_more),
                                       cmocka_unit_test(the_samples_of_a_job_are_known_unless_time_ends_it),
                                       cmocka_unit_test(halves_count_even_and_odd_samples),
                                       cmocka_unit_test(settings_are_checked),
                                       cmocka_unit_test(the_content_has_what_samples_depend_on),
                                       cmocka_unit_test(strategies_are_checked),
                                       cmocka_unit_test(milestones_are_checked),
                                       cmocka_unit_test(every_kind_has_its_name)};
    return cmocka_run_group_tests_name("job", tests, NULL, NULL);
}
