/* Tests of rounds, extensions, particular units and saved states of master/farm/schedule*.c; that the
 * bookkeeping is right in a long random run is in test_schedule.c. */
#include "master/schedule/schedule.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { TILES = 6 }; /* 32 x 32 pixels, but the last column is 6 wide and the last row 8 high */

static job_settings_t small_job(uint32_t spp)
{
    job_settings_t settings = job_settings_default();
    settings.learn = false;
    settings.width = 70;
    settings.height = 40;
    settings.spp = spp;
    return settings;
}

static job_settings_t planned_job(void)
{
    job_settings_t settings = small_job(100);
    settings.adaptive = true;
    return settings;
}

static const uint32_t ends_a[TILES] = {4, 4, 4, 4, 4, 4}, ones[TILES] = {1, 1, 1, 1, 1, 1};
static const uint32_t ends_b[TILES] = {20, 8, 5, 4, 6, 12}, weights_b[TILES] = {1, 4, 16, 8, 8, 2};

/* Both rounds open, the first one counted. */
static schedule_t *two_rounds(const job_settings_t *settings)
{
    schedule_t *schedule = schedule_new(settings);
    schedule_open_round(schedule, ends_a, ones);
    for (uint32_t t = 0; t < TILES; t++)
        assert_int_equal(schedule_accept(schedule, &(unit_t){t, 0, 4}, 1).code, RESULT_OK);
    assert_true(schedule_round_counted(schedule));
    schedule_open_round(schedule, ends_b, weights_b);
    return schedule;
}

static void a_planned_job_begins_without_a_round(void **state)
{
    (void)state;
    job_settings_t settings = planned_job();
    unit_t unit;
    schedule_t *schedule = schedule_new(&settings);
    assert_int_equal(schedule_round_count(schedule), 0);
    assert_null(schedule_round_ends(schedule));
    assert_null(schedule_round_weights(schedule));
    assert_true(schedule_round_counted(schedule));
    assert_false(schedule_available(schedule));
    assert_int_equal(schedule_take(schedule, &(schedule_wish_t){1, 1000, 100, 1, 1}, &unit, 1), 0);
    assert_false(schedule_issue(schedule, 1, &(unit_t){0, 0, 1}));
    assert_int_equal(schedule_accept(schedule, &(unit_t){0, 0, 1}, 1).code, RESULT_MISMATCH);
    schedule_destroy(&schedule);
    settings = small_job(10);
    settings.error = 0.01;
    schedule = schedule_new(&settings);
    assert_int_equal(schedule_round_count(schedule), 0);
    schedule_destroy(&schedule);
}

static void units_lie_within_rounds(void **state)
{
    (void)state;
    job_settings_t settings = planned_job();
    schedule_t *schedule = schedule_new(&settings);
    schedule_open_round(schedule, ends_a, ones);
    assert_int_equal(schedule_accept(schedule, &(unit_t){0, 4, 1}, 1).code, RESULT_MISMATCH);
    assert_int_equal(schedule_accept(schedule, &(unit_t){0, 0, 5}, 1).code, RESULT_MISMATCH);
    schedule_open_round(schedule, ends_b, weights_b);
    assert_int_equal(schedule_accept(schedule, &(unit_t){0, 0, 5}, 1).code, RESULT_MISMATCH);
    assert_false(schedule_issue(schedule, 1, &(unit_t){0, 3, 2}));
    assert_int_equal(schedule_accept(schedule, &(unit_t){3, 4, 1}, 1).code, RESULT_MISMATCH); /* got none */
    assert_int_equal(schedule_accept(schedule, &(unit_t){0, 0, UINT32_MAX}, 1).code, RESULT_MISMATCH);
    assert_int_equal(schedule_weight(schedule, &(unit_t){2, 3, 1}), 1);
    assert_int_equal(schedule_weight(schedule, &(unit_t){2, 4, 1}), 16);
    unit_t units[100];
    size_t n = schedule_take(schedule, &(schedule_wish_t){1, UINT64_MAX, UINT64_MAX, 1, 1}, units, 100);
    for (size_t i = 0; i < n; i++) assert_true(units[i].first >= 4 || units[i].first + units[i].count <= 4);
    schedule_destroy(&schedule);
}

/* A tile with many light samples goes on as evenly as one with few heavy ones: what is counted at any moment
 * weighs about the same everywhere. */
static void tiles_advance_by_weight(void **state)
{
    (void)state;
    job_settings_t settings = planned_job();
    schedule_t *schedule = schedule_new(&settings);
    const uint32_t ends[TILES] = {64, 4, 16, 8, 32, 64}, weights[TILES] = {1, 16, 4, 8, 2, 1};
    uint32_t weight[TILES] = {0};
    schedule_open_round(schedule, ends, weights);
    for (unit_t unit; schedule_take(schedule, &(schedule_wish_t){1, 1, 1, 1, 1}, &unit, 1) == 1;) {
        uint32_t low = UINT32_MAX, high = 0;
        weight[unit.tile] += unit.count * schedule_weight(schedule, &unit);
        for (uint32_t t = 0; t < TILES; t++) {
            if (weight[t] < low) low = weight[t];
            if (weight[t] > high) high = weight[t];
        }
        assert_true(high - low <= 16);
    }
    for (uint32_t t = 0; t < TILES; t++) assert_int_equal(weight[t], 64);
    schedule_destroy(&schedule);
}

static void a_plain_job_is_extended(void **state)
{
    (void)state;
    job_settings_t settings = small_job(4);
    schedule_t *schedule = schedule_new(&settings);
    for (uint32_t t = 0; t < TILES; t++)
        assert_int_equal(schedule_accept(schedule, &(unit_t){t, 0, 4}, 1).code, RESULT_OK);
    assert_true(schedule_round_counted(schedule));
    settings.spp = 9;
    schedule_extend(schedule, &settings);
    assert_false(schedule_round_counted(schedule));
    assert_true(schedule_available(schedule));
    assert_int_equal(schedule_round_count(schedule), 1);
    assert_int_equal(schedule_round_ends(schedule)[0], 9);
    for (uint32_t t = 0; t < TILES; t++)
        assert_int_equal(schedule_accept(schedule, &(unit_t){t, 4, 5}, 1).code, RESULT_OK);
    assert_true(schedule_round_counted(schedule));
    settings.spp = 7; /* too late */
    schedule_extend(schedule, &settings);
    assert_int_equal(settings.spp, 9);
    assert_true(schedule_round_counted(schedule));
    /* Now to an error: what there is counts as a round. */
    settings.error = 0.1;
    schedule_extend(schedule, &settings);
    assert_true(schedule_round_counted(schedule));
    assert_int_equal(schedule_round_ends(schedule)[0], 9);
    const uint32_t ends[TILES] = {12, 12, 12, 12, 12, 12};
    schedule_open_round(schedule, ends, ones);
    assert_true(schedule_issue(schedule, 1, &(unit_t){0, 9, 1}));
    /* And to samples again: the round that was open ends where they do. */
    settings.error = 0;
    settings.spp = 10;
    schedule_extend(schedule, &settings);
    assert_int_equal(schedule_round_count(schedule), 2);
    assert_int_equal(schedule_round_ends(schedule)[5], 10);
    assert_false(schedule_round_counted(schedule));
    for (uint32_t t = 0; t < TILES; t++)
        assert_int_equal(schedule_accept(schedule, &(unit_t){t, 9, 1}, 1).code, RESULT_OK);
    assert_true(schedule_round_counted(schedule));
    schedule_destroy(&schedule);
}

static void a_job_that_time_ended_goes_on_to_an_error(void **state)
{
    (void)state;
    job_settings_t settings = small_job(JOB_MAX_SPP);
    settings.time_limit = 5;
    schedule_t *schedule = schedule_new(&settings);
    assert_int_equal(schedule_accept(schedule, &(unit_t){0, 0, 6}, 1).code, RESULT_OK);
    assert_int_equal(schedule_accept(schedule, &(unit_t){1, 2, 3}, 1).code, RESULT_OK);
    settings.time_limit = 0;
    settings.error = 0.1;
    schedule_extend(schedule, &settings);
    const uint32_t reached[TILES] = {6, 5};
    assert_memory_equal(schedule_round_ends(schedule), reached, sizeof reached);
    assert_false(schedule_round_counted(schedule)); /* a gap */
    assert_int_equal(schedule_accept(schedule, &(unit_t){1, 0, 2}, 1).code, RESULT_OK);
    assert_true(schedule_round_counted(schedule));
    schedule_destroy(&schedule);
}

static void the_farm_keeps_and_leaves_out_units(void **state)
{
    (void)state;
    job_settings_t settings = small_job(4);
    schedule_t *schedule = schedule_new(&settings);
    const unit_t suspect = {2, 0, 3}, overlap = {2, 2, 2};
    assert_true(schedule_issue(schedule, 0, &suspect));
    assert_false(schedule_issue(schedule, 0, &overlap));
    assert_int_equal(schedule_holders(schedule), 0); /* no worker */
    assert_int_equal(schedule_held(schedule, 0), 1);
    unit_t unit;
    while (schedule_take(schedule, &(schedule_wish_t){1, 1, 1, 1, 1}, &unit, 1) == 1) {
        assert_true(unit.tile != 2 || unit.first >= 3);
        assert_int_equal(schedule_accept(schedule, &unit, 1).code, RESULT_OK);
    }
    schedule_skip(schedule, &suspect); /* nothing of it is free */
    assert_int_equal(schedule_account(schedule).skipped, 0);
    assert_int_equal(schedule_release(schedule, 0), 1);
    assert_false(schedule_round_counted(schedule));
    schedule_skip(schedule, &(unit_t){2, 1, 3}); /* sample 3 is counted */
    schedule_skip(schedule, &suspect);
    assert_int_equal(schedule_account(schedule).skipped, 3 * job_tile_pixels(&settings, 2));
    assert_true(schedule_round_counted(schedule));
    assert_int_equal(schedule_accept(schedule, &suspect, 1).code, RESULT_MISMATCH);
    float *samples = mem_zalloc((size_t)70 * 40, sizeof *samples);
    uint32_t tile_samples[64];
    assert_true(job_tile_count(&settings) <= 64);
    schedule_tile_samples(schedule, tile_samples);
    schedule_show_samples(&settings, tile_samples, 0, settings.height, samples);
    assert_true(samples[0] == 4 && samples[63] == 4 && samples[64] == 1 && samples[69] == 1);
    assert_true(samples[70 * 40 - 1] == 4);
    free(samples);
    schedule_destroy(&schedule);
}

/* ---- states -------------------------------------------------------------------------------------------- */

static void assert_refused(job_settings_t settings, const schedule_state_t *state, const char *why)
{
    schedule_t *schedule = NULL;
    result_t result = schedule_restore(&settings, state, &schedule);
    if (result.code != RESULT_INPUT || strstr(result.message, why) == NULL)
        fail_msg("expected '%s', got: %s", why, result.message);
    assert_null(schedule);
}

static void damaged_states_are_refused(void **state)
{
    (void)state;
    job_settings_t settings = planned_job(), other = settings;
    schedule_t *schedule = two_rounds(&settings);
    schedule_state_t s;
    assert_int_equal(schedule_accept(schedule, &(unit_t){0, 10, 4}, 1).code, RESULT_OK);
    schedule_skip(schedule, &(unit_t){0, 16, 2});
    schedule_save(schedule, &s);
    schedule_destroy(&schedule);
    assert_int_equal(s.counted_count, 7);
    assert_int_equal(s.skipped_count, 1);

    other.width = 64;
    assert_refused(other, &s, "tiles");
    other = settings;
    other.adaptive = false;
    other.error = 0.1;
    assert_refused(other, &s, "weight");
    s.round_count = SCHEDULE_MAX_ROUNDS + 1;
    assert_refused(settings, &s, "rounds");
    s.round_count = 0;
    assert_refused(settings, &s, "no round allows");
    s.round_count = 2;

#define DAMAGED(field, value, why)                                                                           \
    do {                                                                                                     \
        __typeof__(field) kept = field;                                                                      \
        field = value;                                                                                       \
        assert_refused(settings, &s, why);                                                                   \
        field = kept;                                                                                        \
    } while (0)
    DAMAGED(s.ends[TILES + 1], 3, "round 1 of tile 1 ends");
    DAMAGED(s.ends[TILES + 1], JOB_MAX_SPP + 1, "round 1 of tile 1 ends");
    DAMAGED(s.ends[TILES + 1], JOB_MAX_SPP, "weigh");
    DAMAGED(s.weights[2], 0, "weight 0");
    DAMAGED(s.weights[2], JOB_MAX_BOOST + 1, "weight 17");
    DAMAGED(s.counted[1].first, 17, "no round allows");
    DAMAGED(s.counted[1].first, UINT32_MAX, "no round allows");
    DAMAGED(s.counted[1].count, UINT32_MAX, "no round allows");
    DAMAGED(s.counted[1].count, 0, "no round allows");
    DAMAGED(s.counted[6].tile, TILES, "no round allows");
    DAMAGED(s.counted[6].tile, 4, "counted twice or out of order");
    DAMAGED(s.counted[1].first, 3, "counted twice or out of order");
    DAMAGED(s.skipped[0].first, 13, "counted and skipped");
    DAMAGED(s.issued, s.issued - 1, "were issued");
    DAMAGED(s.returned, 1, "were issued");
    DAMAGED(s.returned, UINT64_MAX, "were issued");

    result_t result = schedule_restore(&settings, &s, &schedule);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    schedule_state_free(&s);
    schedule_destroy(&schedule);
}

/* Any state is refused or makes a schedule that works. */
static void random_damage_is_refused_or_harmless(void **state)
{
    (void)state;
    job_settings_t settings = planned_job();
    schedule_t *schedule = two_rounds(&settings);
    schedule_state_t s;
    uint64_t random = 1;
    int restored = 0;
    schedule_skip(schedule, &(unit_t){0, 16, 2});
    schedule_save(schedule, &s);
    schedule_destroy(&schedule);
    for (int i = 0; i < 20000; i++) {
        uint32_t *fields[] = {s.ends, s.weights, (uint32_t *)s.counted, (uint32_t *)s.skipped,
                              (uint32_t *)&s.issued};
        const size_t sizes[] = {2 * TILES, 2 * TILES, 3 * s.counted_count, 3 * s.skipped_count, 2};
        random = random * 6364136223846793005u + 1442695040888963407u;
        size_t which = (random >> 40) % 5, at = (random >> 20) % sizes[which];
        uint32_t kept = fields[which][at], bit = 1u << (random >> 58 & 31);
        fields[which][at] = (random >> 33 & 1) != 0 ? kept ^ bit : kept + (uint32_t)(random >> 60) - 8;
        job_settings_t now = settings;
        if (schedule_restore(&now, &s, &schedule).code == RESULT_OK) {
            unit_t units[40];
            size_t n = schedule_take(schedule, &(schedule_wish_t){1, 20000, 700, 1, 1}, units, 40);
            assert_int_equal(schedule_accept(schedule, units, n).code, RESULT_OK);
            schedule_account_t account = schedule_account(schedule);
            assert_int_equal(account.issued, account.counted + account.returned + account.out);
            schedule_destroy(&schedule);
            restored++;
        }
        fields[which][at] = kept;
    }
    assert_true(restored > 1000);
    schedule_state_free(&s);
}

static void what_was_out_is_returned(void **state)
{
    (void)state;
    job_settings_t settings = planned_job();
    schedule_t *schedule = two_rounds(&settings), *again;
    schedule_state_t s;
    assert_true(schedule_issue(schedule, 3, &(unit_t){0, 5, 10}));
    schedule_account_t before = schedule_account(schedule);
    schedule_save(schedule, &s);
    assert_int_equal(schedule_restore(&settings, &s, &again).code, RESULT_OK);
    schedule_account_t after = schedule_account(again);
    assert_int_equal(after.issued, before.issued);
    assert_int_equal(after.counted, before.counted);
    assert_int_equal(after.returned, before.returned + before.out);
    assert_int_equal(after.out, 0);
    assert_int_equal(settings.spp, 100);
    unit_t unit; /* lowest by weight: 5 x 16 wait in tile 2, the others are at 4 */
    assert_int_equal(schedule_take(again, &(schedule_wish_t){1, 1, 1, 1, 1}, &unit, 1), 1);
    assert_int_equal(unit.first, 4);
    schedule_state_free(&s);
    schedule_destroy(&schedule);
    schedule_destroy(&again);
}

/* A checkpoint of before an extension, and settings of after it. */
static void an_older_state_is_extended(void **state)
{
    (void)state;
    job_settings_t settings = small_job(JOB_MAX_SPP);
    settings.time_limit = 5;
    schedule_t *schedule = schedule_new(&settings);
    schedule_state_t s;
    assert_int_equal(schedule_accept(schedule, &(unit_t){0, 0, 60}, 1).code, RESULT_OK);
    schedule_save(schedule, &s);
    schedule_destroy(&schedule);
    settings = small_job(50);
    assert_int_equal(schedule_restore(&settings, &s, &schedule).code, RESULT_OK);
    assert_int_equal(settings.spp, 60);
    assert_int_equal(schedule_round_ends(schedule)[0], 60);
    assert_int_equal(schedule_round_ends(schedule)[1], 60);
    schedule_destroy(&schedule);
    settings = small_job(200);
    assert_int_equal(schedule_restore(&settings, &s, &schedule).code, RESULT_OK);
    assert_int_equal(settings.spp, 200);
    assert_int_equal(schedule_round_ends(schedule)[0], 200);
    schedule_destroy(&schedule);
    schedule_state_free(&s);
}

/* Whatever comes between, a round ends at the next milestone, and at the new goal when that is nearer. */
static void milestones_outlive_extensions_and_restarts(void **state)
{
    (void)state;
    job_settings_t settings = small_job(100);
    settings.save_at = (save_at_t){2, {4, 50}};
    schedule_t *schedule = schedule_new(&settings), *again;
    assert_int_equal(schedule_round_count(schedule), 0);
    schedule_open_round(schedule, ends_a, ones);
    assert_int_equal(schedule_even_end(schedule), 4);
    assert_int_equal(schedule_round_start(schedule), 0);
    settings.spp = 200;
    schedule_extend(schedule, &settings);
    assert_int_equal(schedule_even_end(schedule), 4);
    for (uint32_t t = 0; t < TILES; t++)
        assert_int_equal(schedule_accept(schedule, &(unit_t){t, 0, 4}, 1).code, RESULT_OK);
    const uint32_t ends[TILES] = {50, 50, 50, 50, 50, 50};
    schedule_open_round(schedule, ends, ones);
    assert_int_equal(schedule_round_start(schedule), 4);
    assert_int_equal(schedule_accept(schedule, &(unit_t){1, 4, 6}, 1).code, RESULT_OK);
    schedule_state_t s;
    schedule_save(schedule, &s);
    schedule_destroy(&schedule);
    assert_int_equal(schedule_restore(&settings, &s, &again).code, RESULT_OK);
    assert_int_equal(schedule_even_end(again), 50);
    schedule_destroy(&again);
    settings.spp = 20; /* a job that was cancelled is to end sooner */
    assert_int_equal(schedule_restore(&settings, &s, &again).code, RESULT_OK);
    assert_int_equal(settings.spp, 20);
    assert_int_equal(schedule_even_end(again), 20);
    settings.spp = 60;
    schedule_extend(again, &settings);
    assert_int_equal(schedule_even_end(again), 50);
    schedule_destroy(&again);
    schedule_state_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_planned_job_begins_without_a_round),
        cmocka_unit_test(units_lie_within_rounds),
        cmocka_unit_test(tiles_advance_by_weight),
        cmocka_unit_test(a_plain_job_is_extended),
        cmocka_unit_test(a_job_that_time_ended_goes_on_to_an_error),
        cmocka_unit_test(the_farm_keeps_and_leaves_out_units),
        cmocka_unit_test(damaged_states_are_refused),
        cmocka_unit_test(random_damage_is_refused_or_harmless),
        cmocka_unit_test(what_was_out_is_returned),
        cmocka_unit_test(an_older_state_is_extended),
        cmocka_unit_test(milestones_outlive_extensions_and_restarts),
    };
    return cmocka_run_group_tests_name("rounds", tests, NULL, NULL);
}
