/* Tests of how a slow link bounds what a worker has in hand. */
#include "proto/uplink/pace.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static const double MEGABIT = 125e3; /* bytes a second */
enum { TILE = 32 * 32 };

static job_settings_t full_hd(void)
{
    job_settings_t settings = job_settings_default();
    settings.width = 1920;
    settings.height = 1080;
    return settings;
}

static pace_t on_link(double rate)
{
    pace_t pace = {.interval = 10, .rate = rate};
    job_settings_t settings = full_hd();
    pace_begin(&pace, &settings, 100);
    return pace;
}

/* What a real batch of 8 samples a pixel of a tile takes at this size: 45 kB of tiles, 60 kB of splats. */
static void learn_unit(pace_t *pace)
{
    const load_t load = {8 * TILE, TILE};
    const uint64_t bytes[BATCH_SUMS] = {[SUM_EYE] = 25000, [SUM_FEATURES] = 20000, [SUM_SPLAT] = 60000};
    pace_learn(pace, &load, bytes);
}

static double seconds_of(const pace_t *pace, double samples)
{
    const load_t load = {samples, samples / 8};
    return pace_bytes(pace, &load) / pace->rate;
}

static void a_fast_link_bounds_nothing(void **state)
{
    (void)state;
    pace_t none = on_link(0), quick = on_link(1e3 * MEGABIT), slow = on_link(MEGABIT);
    assert_false(pace_is_slow(&none, 1e6, 8192));
    assert_false(pace_is_slow(&quick, 1e6, 8192));
    assert_true(pace_is_slow(&slow, 20e3, 8192));
    assert_false(pace_is_slow(&slow, 500, 8192)); /* nor does a slow machine */
}

static void what_is_in_hand_is_sent_in_a_few_seconds(void **state)
{
    (void)state;
    pace_t pace = on_link(MEGABIT);
    const load_t nothing = {0};
    double first = pace_wanted(&pace, 100, &nothing, pace_unit_samples(&pace, 100, 20e3));
    learn_unit(&pace);
    assert_true(seconds_of(&pace, first) < 0.25 * pace.interval); /* the guess was cautious */
    double wanted = pace_wanted(&pace, 110, &nothing, 8192);
    assert_true(wanted > first);
    assert_true(seconds_of(&pace, wanted) < 0.3 * pace.interval);
    load_t enough = {wanted, wanted / 8};
    assert_true(pace_wanted(&pace, 110, &enough, 8192) <= TILE);
    enough.samples *= 1.2;
    enough.pixels *= 1.2;
    assert_true(pace_wanted(&pace, 110, &enough, 8192) == 0);
    assert_true(pace_bytes(&pace, &enough) >= pace_batch_bytes(&pace, 110)); /* it is time to send it */
}

/* At 1 Mbit/s some thousand samples a second count in any case. */
static void a_slow_link_is_used(void **state)
{
    (void)state;
    pace_t pace = on_link(MEGABIT);
    learn_unit(&pace);
    double samples =
        60 * MEGABIT / pace_batch_bytes(&pace, 110) * pace_wanted(&pace, 110, &(load_t){0}, 8192);
    assert_true(samples > 60 * 3000);
}

static void batches_grow_to_full_frames_in_long_jobs(void **state)
{
    (void)state;
    pace_t fair = on_link(16 * MEGABIT), slow = on_link(MEGABIT);
    double small = 0.25 * fair.interval * fair.rate, full = fair.frame_bytes;
    assert_true(full / fair.rate > fair.interval && full / fair.rate < 2 * fair.interval);
    assert_true(fabs(pace_batch_bytes(&fair, 110) - small) < 1);
    assert_true(pace_batch_bytes(&fair, 100 + 2.1 * full / fair.rate) > full);
    const load_t much = {1e8, 0};
    assert_true(pace_bytes(&fair, &much) <= full);
    assert_true(pace_batch_bytes(&slow, 1e5) <
                0.3 * slow.interval * slow.rate); /* that takes too long ever */
}

/* Without splats a unit takes the same bytes whatever its samples: so it has many. */
static void units_without_splats_are_large(void **state)
{
    (void)state;
    pace_t pace = {.interval = 10, .rate = MEGABIT};
    job_settings_t settings = full_hd();
    settings.integrator = INTEGRATOR_PATH;
    pace_begin(&pace, &settings, 0);
    assert_true(pace_unit_samples(&pace, 0, 20e3) == 0.25 * 10 * 20e3);
    pace_t splats = on_link(MEGABIT);
    learn_unit(&splats);
    assert_true(pace_unit_samples(&splats, 110, 20e3) < 0.25 * 10 * 20e3);
    assert_true(pace_unit_samples(&splats, 110, 1) == TILE);
}

static void a_hopeless_link_is_known_from_batches_alone(void **state)
{
    (void)state;
    pace_t pace = on_link(1000);
    assert_true(pace_hopeless(&pace) == 0); /* what is known are guesses */
    learn_unit(&pace);
    double seconds = pace_hopeless(&pace);
    assert_true(seconds > 30 && seconds < 100);
    pace.rate = 3000;
    assert_true(pace_hopeless(&pace) == 0);
}

/* Frames fill up: then the bytes say nothing of the samples any more. */
static void full_frames_do_not_make_samples_look_cheap(void **state)
{
    (void)state;
    pace_t pace = on_link(16 * MEGABIT);
    learn_unit(&pace);
    double before = pace.sample_bytes;
    const load_t load = {1e8, 1e7};
    const uint64_t bytes[BATCH_SUMS] = {[SUM_EYE] = 1000000, [SUM_SPLAT] = 40000000};
    pace_learn(&pace, &load, bytes);
    assert_true(pace.sample_bytes == before);
    assert_true(pace.frame_bytes == 40000000);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_fast_link_bounds_nothing),
        cmocka_unit_test(what_is_in_hand_is_sent_in_a_few_seconds),
        cmocka_unit_test(a_slow_link_is_used),
        cmocka_unit_test(batches_grow_to_full_frames_in_long_jobs),
        cmocka_unit_test(units_without_splats_are_large),
        cmocka_unit_test(a_hopeless_link_is_known_from_batches_alone),
        cmocka_unit_test(full_frames_do_not_make_samples_look_cheap),
    };
    return cmocka_run_group_tests_name("pace", tests, NULL, NULL);
}
