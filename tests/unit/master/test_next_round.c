/* Tests of master/schedule/next_round.c: when jobs end, how far rounds go, where their samples go, and that
 * every pixel has the same weight in every round. The films are made up; tests/statistics/test_convergence.c
 * renders. */
#include "master/schedule/next_round.h"
#include "master/schedule/schedule.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { MAX_TILES = 64 };

static job_settings_t job_of(int width, int height, uint32_t spp)
{
    job_settings_t settings = job_settings_default();
    settings.width = width;
    settings.height = height;
    settings.tile_size = 8;
    settings.features = false;
    settings.spp = spp;
    return settings;
}

typedef struct {
    job_settings_t settings;
    film_t *film;
    uint32_t tiles, rounds;
    uint32_t ends[MAX_TILES], weights[MAX_TILES], next_ends[MAX_TILES], next_weights[MAX_TILES];
    double error;
} run_t;

static run_t run_begin(const job_settings_t *settings)
{
    run_t run = {.settings = *settings, .tiles = job_tile_count(settings)};
    assert_int_equal(job_settings_check(settings).code, RESULT_OK);
    assert_true(run.tiles <= MAX_TILES);
    assert_int_equal(film_new(settings, &run.film).code, RESULT_OK);
    return run;
}

static round_verdict_t run_next(run_t *run)
{
    round_t last = {run->ends, run->weights}, next = {run->next_ends, run->next_weights};
    return next_round(&run->settings, run->rounds, run->rounds > 0 ? &last : NULL, run->film, &next,
                      &run->error);
}

/* The standard error of the image when each sample has this much noise, and half the sign in either half:
 * what the halves show is exactly that. */
static void set_pixel(run_t *run, uint32_t tile, size_t pixel, double weight, double value, double noise)
{
    size_t pixels = (size_t)run->settings.width * (size_t)run->settings.height;
    double samples = run->ends[tile], error = samples > 0 ? noise / sqrt(samples) : 0;
    for (size_t h = 0; h < 2; h++) {
        run->film->samples[h * pixels + pixel] = (uint32_t)(weight / 2);
        for (size_t c = 0; c < 3; c++)
            run->film->sums[SUM_EYE][3 * (h * pixels + pixel) + c] =
                llrint((value + (h == 0 ? error : -error)) * weight / 2 * 0x1p32);
    }
}

/* Counts the planned round: pixels of value 1, with noise[tile] a sample. */
static void run_count(run_t *run, const double *noise)
{
    for (uint32_t t = 0; t < run->tiles; t++) {
        rect_t rect = job_tile_rect(&run->settings, t);
        size_t width = (size_t)run->settings.width, first = (size_t)rect.y0 * width + (size_t)rect.x0;
        size_t pixels = width * (size_t)run->settings.height;
        double weight = run->film->samples[first] + run->film->samples[pixels + first];
        assert_true(run->next_ends[t] >= run->ends[t]);
        weight += (double)(run->next_ends[t] - run->ends[t]) * run->next_weights[t];
        run->ends[t] = run->next_ends[t];
        run->weights[t] = run->next_weights[t];
        for (int y = rect.y0; y < rect.y1; y++)
            for (int x = rect.x0; x < rect.x1; x++)
                set_pixel(run, t, (size_t)y * width + (size_t)x, weight, 1, noise[t]);
    }
    run->rounds++;
}

static void run_end(run_t *run)
{
    film_destroy(&run->film);
}

static void fill(double *noise, double value)
{
    for (int t = 0; t < MAX_TILES; t++) noise[t] = value;
}

/* The error of film_noise for pixels of value 1 and mean 1. */
static double image_error(double noise, double samples)
{
    return noise / sqrt(samples) / sqrt(1 + FILM_ERROR_FLOOR * FILM_ERROR_FLOOR);
}

static void an_error_is_reached_in_few_rounds(void **state)
{
    (void)state;
    const double errors[] = {0.5, 0.1, 0.03, 0.01, 0.001};
    double noise[MAX_TILES];
    fill(noise, 0.7);
    for (size_t i = 0; i < ARRAY_LENGTH(errors); i++) {
        job_settings_t settings = job_of(40, 24, JOB_MAX_SPP);
        settings.error = errors[i];
        run_t run = run_begin(&settings);
        while (run_next(&run) == ROUND_NEXT) {
            assert_true(run.rounds == 0 || run.error > settings.error);
            assert_true(run.next_ends[0] >= 1.25 * run.ends[0]);
            assert_true(run.rounds == 0 ? run.next_ends[0] == 16 : run.next_ends[0] <= 2 * run.ends[0]);
            for (uint32_t t = 0; t < run.tiles; t++) {
                assert_int_equal(run.next_ends[t], run.next_ends[0]);
                assert_int_equal(run.next_weights[t], 1);
            }
            run_count(&run, noise);
            assert_true(run.rounds < 25);
        }
        assert_true(fabs(run.error / image_error(0.7, run.ends[0]) - 1) < 1e-6);
        assert_true(run.error <= settings.error);
        if (run.rounds > 1) assert_true(run.error > 0.85 * settings.error);
        run_end(&run);
    }
}

static void spp_is_the_cap(void **state)
{
    (void)state;
    double noise[MAX_TILES];
    fill(noise, 1);
    const uint32_t caps[] = {1, 2, 15, 16, 17, 40, 999};
    for (size_t i = 0; i < ARRAY_LENGTH(caps); i++) {
        job_settings_t settings = job_of(40, 24, caps[i]);
        settings.error = 0.0001;
        run_t run = run_begin(&settings);
        while (run_next(&run) == ROUND_NEXT) run_count(&run, noise);
        for (uint32_t t = 0; t < run.tiles; t++) assert_int_equal(run.ends[t], caps[i]);
        run_end(&run);
    }
}

/* The ends of the rounds of a job, up to 10. */
static uint32_t ends_of(const job_settings_t *settings, uint32_t ends[10])
{
    double noise[MAX_TILES];
    fill(noise, 1);
    run_t run = run_begin(settings);
    while (run.rounds < 10 && run_next(&run) == ROUND_NEXT) {
        for (uint32_t t = 0; t < run.tiles; t++) {
            assert_int_equal(run.next_ends[t], run.next_ends[0]);
            assert_int_equal(run.next_weights[t], 1);
        }
        ends[run.rounds] = run.next_ends[0];
        run_count(&run, noise);
    }
    run_end(&run);
    return run.rounds;
}

static void rounds_end_at_milestones(void **state)
{
    (void)state;
    uint32_t ends[10];
    job_settings_t settings = job_of(40, 24, 100);
    settings.save_at = (save_at_t){3, {7, 16, 300}};
    assert_int_equal(ends_of(&settings, ends), 3);
    assert_memory_equal(ends, ((uint32_t[]){7, 16, 100}), 3 * sizeof *ends);
    settings.spp = 300;
    assert_int_equal(ends_of(&settings, ends), 3);
    assert_memory_equal(ends, ((uint32_t[]){7, 16, 300}), 3 * sizeof *ends);
    settings.spp = JOB_MAX_SPP; /* time ends it */
    assert_int_equal(ends_of(&settings, ends), 4);
    assert_memory_equal(ends, ((uint32_t[]){7, 16, 300, JOB_MAX_SPP}), 4 * sizeof *ends);
    settings.error = 0.001;
    settings.spp = 64;
    settings.save_at = (save_at_t){2, {20, 33}};
    assert_int_equal(ends_of(&settings, ends), 4);
    assert_memory_equal(ends, ((uint32_t[]){16, 20, 33, 64}), 4 * sizeof *ends);
}

static void a_black_image_goes_on(void **state)
{
    (void)state;
    job_settings_t settings = job_of(16, 8, JOB_MAX_SPP);
    settings.error = 0.5;
    run_t run = run_begin(&settings);
    assert_int_equal(run_next(&run), ROUND_NEXT);
    run_count(&run, (double[]){0, 0});
    memset(run.film->sums[SUM_EYE], 0, sum_image_values(&settings, SUM_SPLAT) * sizeof(int64_t));
    assert_int_equal(run_next(&run), ROUND_NEXT);
    assert_true(run.error == 0); /* not known */
    assert_int_equal(run.next_ends[1], 32);
    run_end(&run);
}

/* A job that time has ended has tiles with different numbers of samples. */
static void tiles_that_lag_catch_up(void **state)
{
    (void)state;
    job_settings_t settings = job_of(16, 16, JOB_MAX_SPP);
    settings.error = 0.01;
    double noise[MAX_TILES];
    fill(noise, 0.5);
    run_t run = run_begin(&settings);
    const uint32_t ends[] = {20, 90, 20, 21};
    memcpy(run.next_ends, ends, sizeof ends);
    for (int t = 0; t < 4; t++) run.next_weights[t] = 1;
    run_count(&run, noise);
    assert_int_equal(run_next(&run), ROUND_NEXT);
    const uint32_t expected[] = {40, 90, 40, 40};
    assert_memory_equal(run.next_ends, expected, sizeof expected);
    run_end(&run);
    /* Nothing at all in some of them. */
    run = run_begin(&settings);
    memcpy(run.next_ends, (uint32_t[]){0, 90, 3, 21}, sizeof ends);
    for (int t = 0; t < 4; t++) run.next_weights[t] = 1;
    run_count(&run, noise);
    assert_int_equal(run_next(&run), ROUND_NEXT);
    assert_memory_equal(run.next_ends, ((uint32_t[]){16, 90, 16, 21}), sizeof expected);
    run_end(&run);
}

/* ---- adaptive ------------------------------------------------------------------------------------------ */

/* A different noise for every tile, over three orders of magnitude; some have none. */
static void uneven_noise(double *noise, uint64_t seed)
{
    for (uint32_t t = 0; t < MAX_TILES; t++) {
        seed = seed * 6364136223846793005u + 1442695040888963407u;
        noise[t] = (seed >> 60) == 0 ? 0 : exp(7.0 * (double)(seed >> 40) * 0x1p-24 - 4);
    }
}

/* Pixel samples that the planned round adds. */
static uint64_t round_cost(const run_t *run)
{
    uint64_t cost = 0;
    for (uint32_t t = 0; t < run->tiles; t++)
        cost += (uint64_t)(run->next_ends[t] - run->ends[t]) * job_tile_pixels(&run->settings, t);
    return cost;
}

/* The round adds the same weight to all tiles, by multiples that are powers of two; returns that weight. */
static uint32_t check_weights(const run_t *run)
{
    uint32_t weight = 0;
    for (uint32_t t = 0; t < run->tiles; t++) {
        uint32_t added = (run->next_ends[t] - run->ends[t]) * run->next_weights[t];
        assert_true(run->next_weights[t] >= 1 && run->next_weights[t] <= JOB_MAX_BOOST);
        assert_int_equal(run->next_weights[t] & (run->next_weights[t] - 1), 0);
        if (t == 0) weight = added;
        assert_int_equal(added, weight);
    }
    return weight;
}

static void every_round_weighs_the_same_everywhere(void **state)
{
    (void)state;
    const int sizes[][2] = {{64, 64}, {8, 8}, {61, 37}, {9, 64}, {3, 5}};
    const uint32_t caps[] = {1, 5, 16, 20, 23, 24, 64, 100, 203, 1000};
    double noise[MAX_TILES];
    for (size_t i = 0; i < ARRAY_LENGTH(sizes); i++)
        for (size_t k = 0; k < ARRAY_LENGTH(caps); k++) {
            job_settings_t settings = job_of(sizes[i][0], sizes[i][1], caps[k]);
            settings.adaptive = true;
            uneven_noise(noise, 17 * i + k);
            uint64_t pixels = (uint64_t)settings.width * (uint64_t)settings.height, cost = 0;
            bool even = settings.width % 8 == 0 && settings.height % 8 == 0;
            uint32_t total = 0;
            run_t run = run_begin(&settings);
            while (run_next(&run) == ROUND_NEXT) {
                uint32_t added = check_weights(&run) / JOB_MEAN_BOOST;
                uint64_t round = round_cost(&run);
                assert_true(added > 0 && round <= added * pixels);
                if (even) assert_int_equal(round, added * pixels);
                total += added;
                cost += round;
                run_count(&run, noise);
                assert_true(run.rounds < 12);
            }
            assert_int_equal(total, caps[k]);
            assert_true(cost > 0.97 * (double)pixels * caps[k]);
            /* The next time there is more to be had. */
            run.settings.spp = caps[k] + 51;
            while (run_next(&run) == ROUND_NEXT) {
                total += check_weights(&run) / JOB_MEAN_BOOST;
                run_count(&run, noise);
                assert_true(run.rounds < 24);
            }
            assert_int_equal(total, caps[k] + 51);
            run_end(&run);
        }
}

static double squared_error(const run_t *run, const double *noise)
{
    double sum = 0;
    for (uint32_t t = 0; t < run->tiles; t++) sum += noise[t] * noise[t] * run->next_weights[t];
    return sum;
}

/* Hardly any other multiples of the same cost have less noise: all of them are tried. */
static void the_spread_is_about_the_best(void **state)
{
    (void)state;
    enum { TILES = 6 };
    double noise[MAX_TILES], worst = 0;
    uint32_t near = 0;
    for (uint64_t seed = 0; seed < 200; seed++) {
        job_settings_t settings = job_of(8 * TILES, 8, 64);
        settings.adaptive = true;
        uneven_noise(noise, seed);
        run_t run = run_begin(&settings);
        assert_int_equal(run_next(&run), ROUND_NEXT);
        run_count(&run, noise);
        assert_int_equal(run_next(&run), ROUND_NEXT);
        double best = INFINITY, ours = squared_error(&run, noise);
        for (uint32_t code = 0; code < 15625; code++) { /* 5^6 */
            uint32_t cost = 0, digits = code;
            double error = 0;
            for (int t = 0; t < TILES; t++, digits /= 5) {
                cost += 1u << digits % 5;
                error += noise[t] * noise[t] * (JOB_MAX_BOOST >> digits % 5);
            }
            if (cost <= TILES * JOB_MEAN_BOOST) best = fmin(best, error);
        }
        worst = fmax(worst, ours / fmax(best, 1e-12));
        near += ours < 1.01 * best + 1e-12;
        run_end(&run);
    }
    /* With so few tiles a doubling that does not fit costs something now and then. */
    assert_true(near > 150);
    assert_true(worst < 1.5);
}

/* Once the noise is known, the rounds go on alike, although the tiles have different numbers of samples. */
static void the_noise_of_a_sample_is_what_counts(void **state)
{
    (void)state;
    job_settings_t settings = job_of(64, 64, 256);
    settings.adaptive = true;
    double noise[MAX_TILES];
    uneven_noise(noise, 5);
    run_t run = run_begin(&settings);
    for (int i = 0; i < 2; i++) {
        assert_int_equal(run_next(&run), ROUND_NEXT);
        run_count(&run, noise);
    }
    uint32_t weights[MAX_TILES];
    memcpy(weights, run.weights, sizeof weights);
    assert_int_equal(run_next(&run), ROUND_NEXT);
    assert_memory_equal(run.next_weights, weights, sizeof weights);
    run_end(&run);
}

static void without_noise_the_budget_is_spent_evenly(void **state)
{
    (void)state;
    job_settings_t settings = job_of(64, 64, 64);
    settings.adaptive = true;
    double noise[MAX_TILES];
    fill(noise, 0);
    run_t run = run_begin(&settings);
    while (run_next(&run) == ROUND_NEXT) {
        for (uint32_t t = 0; t < run.tiles; t++) assert_int_equal(run.next_weights[t], 4);
        run_count(&run, noise);
    }
    assert_int_equal(run.ends[0], 64);
    run_end(&run);
}

static void error_and_adaptive_go_together(void **state)
{
    (void)state;
    job_settings_t settings = job_of(64, 64, JOB_MAX_SPP);
    settings.adaptive = true;
    settings.error = 0.01;
    double noise[MAX_TILES];
    uneven_noise(noise, 3);
    run_t run = run_begin(&settings);
    while (run_next(&run) == ROUND_NEXT) {
        check_weights(&run);
        run_count(&run, noise);
        assert_true(run.rounds < 40);
    }
    assert_true(run.error <= 0.01 && run.error > 0.008);
    run_end(&run);
}

/* The largest job: nothing wraps. */
static void a_job_without_end_stays_in_range(void **state)
{
    (void)state;
    job_settings_t settings = job_of(16, 8, JOB_MAX_SPP);
    settings.adaptive = true;
    settings.film_scale = 0;
    settings.time_limit = 1e9;
    run_t run = run_begin(&settings);
    while (run_next(&run) == ROUND_NEXT) {
        run_count(&run, (double[]){1, 1e-6});
        assert_true(run.rounds < 40);
        assert_true(run.ends[0] <= JOB_MAX_SPP);
    }
    assert_int_equal((run.film->samples[0] + run.film->samples[16 * 8]) / JOB_MEAN_BOOST,
                     JOB_MAX_ADAPTIVE_SPP);
    run_end(&run);
}

/* Rounds, as the schedule hands them out: what is issued is what was planned. */
static void the_schedule_follows_the_rounds(void **state)
{
    (void)state;
    job_settings_t settings = job_of(61, 37, 100);
    settings.adaptive = true;
    double noise[MAX_TILES];
    uneven_noise(noise, 9);
    run_t run = run_begin(&settings);
    schedule_t *schedule = schedule_new(&settings);
    uint32_t weight[MAX_TILES] = {0};
    while (schedule_round_counted(schedule) && run_next(&run) == ROUND_NEXT) {
        schedule_open_round(schedule, run.next_ends, run.next_weights);
        run_count(&run, noise);
        for (unit_t unit; schedule_take(schedule, &(schedule_wish_t){1, 500, 500, 1, 1}, &unit, 1) == 1;) {
            weight[unit.tile] += unit.count * schedule_weight(schedule, &unit);
            assert_true(job_unit_valid(&settings, &unit));
            assert_int_equal(schedule_accept(schedule, &unit, 1).code, RESULT_OK);
            if (schedule_next_pass(schedule) == 0) continue;
            schedule_teach(schedule);
            schedule_open_pass(schedule);
        }
    }
    assert_true(schedule_done(schedule) <= job_total_samples(&settings));
    assert_true((double)schedule_done(schedule) > 0.97 * (double)job_total_samples(&settings));
    for (uint32_t t = 0; t < run.tiles; t++) assert_int_equal(weight[t], 100 * JOB_MEAN_BOOST);
    schedule_destroy(&schedule);
    run_end(&run);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(an_error_is_reached_in_few_rounds),
                                       cmocka_unit_test(spp_is_the_cap),
                                       cmocka_unit_test(rounds_end_at_milestones),
                                       cmocka_unit_test(a_black_image_goes_on),
                                       cmocka_unit_test(tiles_that_lag_catch_up),
                                       cmocka_unit_test(every_round_weighs_the_same_everywhere),
                                       cmocka_unit_test(the_spread_is_about_the_best),
                                       cmocka_unit_test(the_noise_of_a_sample_is_what_counts),
                                       cmocka_unit_test(without_noise_the_budget_is_spent_evenly),
                                       cmocka_unit_test(error_and_adaptive_go_together),
                                       cmocka_unit_test(a_job_without_end_stays_in_range),
                                       cmocka_unit_test(the_schedule_follows_the_rounds)};
    return cmocka_run_group_tests_name("next_round", tests, NULL, NULL);
}
