/* Tests of master/schedule/schedule_passes.c: units lie within passes, a pass opens when what its plan needs
 * is counted, and stays open, whatever happens next. */
#include "common/film/learning.h"
#include "master/schedule/schedule.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

enum { TILES = 4, PIXELS = 16 * 16, ROOM = 1000 };

static job_settings_t job_of(uint32_t spp)
{
    job_settings_t settings = job_settings_default();
    settings.width = settings.height = 32;
    settings.tile_size = 16;
    settings.spp = spp;
    return settings;
}

static size_t take_all(schedule_t *schedule, const job_settings_t *settings, unit_t *units)
{
    schedule_wish_t wish = {1, UINT64_MAX, UINT64_MAX, 1, 1};
    size_t count = 0;
    for (size_t n = 1; n > 0; count += n) n = schedule_take(schedule, &wish, units + count, ROOM - count);
    for (size_t i = 0; i < count && job_learns(settings); i++)
        assert_int_equal(learning_pass(settings, units[i].first),
                         learning_pass(settings, unit_end(&units[i]) - 1));
    return count;
}

/* The highest sample among units, and after it. */
static uint32_t end_of(const unit_t *units, size_t count)
{
    uint32_t end = 0;
    for (size_t i = 0; i < count; i++)
        if (unit_end(&units[i]) > end) end = unit_end(&units[i]);
    return end;
}

static void open_next(schedule_t *schedule, uint32_t pass)
{
    assert_int_equal(schedule_next_pass(schedule), pass);
    schedule_teach(schedule);
    assert_int_equal(schedule_next_pass(schedule), pass);
    schedule_open_pass(schedule);
    assert_int_equal(schedule_open_passes(schedule), pass + 1);
}

static void passes_open_as_they_are_counted(void **state)
{
    (void)state;
    job_settings_t settings = job_of(24);
    schedule_t *schedule = schedule_new(&settings);
    unit_t units[ROOM];
    size_t count = take_all(schedule, &settings, units), kept = 0;
    assert_int_equal(end_of(units, count), 4); /* passes 0 and 1 */
    assert_false(schedule_available(schedule));
    assert_int_equal(schedule_free(schedule), 0);
    assert_int_equal(schedule_next_pass(schedule), 0);
    for (size_t i = 0; i < count; i++) { /* pass 1 is still out */
        if (units[i].first >= 2)
            units[kept++] = units[i];
        else
            assert_int_equal(schedule_accept(schedule, &units[i], 1).code, RESULT_OK);
    }
    open_next(schedule, 2);
    assert_int_equal(schedule_next_pass(schedule), 0);
    assert_true(schedule_available(schedule));
    assert_int_equal(schedule_free(schedule), 4 * TILES * PIXELS);
    unit_t more[ROOM];
    count = take_all(schedule, &settings, more);
    assert_int_equal(end_of(more, count), 8);
    assert_int_equal(schedule_accept(schedule, more, count).code, RESULT_OK);
    assert_int_equal(schedule_next_pass(schedule), 0); /* for pass 1 */
    assert_int_equal(schedule_accept(schedule, units, kept).code, RESULT_OK);
    open_next(schedule, 3);
    open_next(schedule, 4);
    count = take_all(schedule, &settings, more);
    assert_int_equal(end_of(more, count), 24);
    assert_int_equal(schedule_accept(schedule, more, count).code, RESULT_OK);
    assert_int_equal(schedule_next_pass(schedule), 0); /* there is none any more, */
    assert_true(schedule_round_counted(schedule));
    settings.spp = 40;
    schedule_extend(schedule, &settings);
    open_next(schedule, 5); /* until the job is extended */
    assert_int_equal(end_of(more, take_all(schedule, &settings, more)), 40);
    schedule_destroy(&schedule);
}

static void a_job_that_does_not_learn_has_no_passes(void **state)
{
    (void)state;
    job_settings_t settings = job_of(24);
    settings.learn = false;
    schedule_t *schedule = schedule_new(&settings);
    unit_t units[ROOM];
    assert_int_equal(end_of(units, take_all(schedule, &settings, units)), 24);
    assert_int_equal(schedule_next_pass(schedule), 0);
    schedule_destroy(&schedule);
}

/* On a large farm few workers render what a pass needs; at the end of a job all do. */
static void a_pass_is_not_shared_by_all(void **state)
{
    (void)state;
    job_settings_t settings = job_of(24);
    schedule_wish_t wish = {1, 2 * PIXELS, PIXELS, 1, 1000};
    unit_t units[ROOM];
    schedule_t *schedule = schedule_new(&settings);
    uint64_t taken = 0;
    size_t count = schedule_take(schedule, &wish, units, ROOM);
    for (size_t i = 0; i < count; i++) taken += unit_samples(&settings, &units[i]);
    assert_int_equal(taken, wish.samples);
    schedule_destroy(&schedule);
    settings.learn = false;
    schedule = schedule_new(&settings);
    assert_int_equal(schedule_take(schedule, &wish, units, ROOM), 1);
    assert_int_equal(units[0].count, 1);
    schedule_destroy(&schedule);
}

/* Passes 0 to `passes` - 1 are counted, and the one after the next is open. */
static schedule_t *schedule_at(const job_settings_t *settings, uint32_t passes)
{
    schedule_t *schedule = schedule_new(settings);
    for (uint32_t pass = 0; pass < passes; pass++) {
        uint32_t begin = learning_pass_begin(settings, pass), end = learning_pass_begin(settings, pass + 1);
        for (uint32_t t = 0; t < TILES; t++)
            assert_int_equal(schedule_accept(schedule, &(unit_t){t, begin, end - begin}, 1).code, RESULT_OK);
        open_next(schedule, pass + 2);
    }
    return schedule;
}

static void units_of_other_passes_are_not_taken(void **state)
{
    (void)state;
    job_settings_t settings = job_of(64);
    schedule_t *schedule = schedule_at(&settings, 1);
    const unit_t crosses = {0, 3, 2}, closed = {0, 8, 1}, good = {0, 4, 4};
    assert_int_equal(schedule_accept(schedule, &crosses, 1).code, RESULT_MISMATCH);
    assert_int_equal(schedule_accept(schedule, &closed, 1).code, RESULT_MISMATCH);
    assert_false(schedule_issue(schedule, 1, &crosses));
    assert_false(schedule_issue(schedule, 1, &closed));
    assert_true(schedule_issue(schedule, 1, &good));
    assert_int_equal(schedule_accept(schedule, &good, 1).code, RESULT_OK);
    schedule_destroy(&schedule);
}

/* Samples that are taken out, or given up, close nothing; those given back open nothing. */
static void what_was_opened_stays_open(void **state)
{
    (void)state;
    job_settings_t settings = job_of(64);
    schedule_t *schedule = schedule_at(&settings, 2);
    const unit_t taken_out = {1, 0, 2};
    schedule_uncount(schedule, &taken_out, 1);
    assert_int_equal(schedule_open_passes(schedule), 4);
    for (uint32_t t = 0; t < TILES; t++)
        assert_int_equal(schedule_accept(schedule, &(unit_t){t, 4, 4}, 1).code, RESULT_OK);
    assert_int_equal(schedule_next_pass(schedule), 0); /* for what was taken out */
    unit_t units[ROOM];
    schedule_wish_t wish = {1, 1, 1, 1, 1};
    assert_int_equal(schedule_take(schedule, &wish, units, ROOM), 1);
    assert_true(units[0].tile == 1 && units[0].first == 0); /* it goes out first */
    assert_int_equal(schedule_release(schedule, 1), 1);
    assert_int_equal(schedule_next_pass(schedule), 0);
    schedule_skip(schedule, &(unit_t){1, 0, 1});
    assert_int_equal(schedule_next_pass(schedule), 0);
    schedule_skip(schedule, &(unit_t){1, 1, 1});
    open_next(schedule, 4);
    schedule_destroy(&schedule);
}

static void passes_outlive_the_process(void **state)
{
    (void)state;
    job_settings_t settings = job_of(64);
    for (uint32_t passes = 0; passes < 4; passes++) {
        schedule_t *schedule = schedule_at(&settings, passes), *again;
        const unit_t taken_out = {1, 0, 2};
        schedule_uncount(schedule, &taken_out, 1);
        schedule_state_t saved;
        schedule_save(schedule, &saved);
        assert_int_equal(saved.settled, passes);
        assert_int_equal(schedule_restore(&settings, &saved, &again).code, RESULT_OK);
        assert_int_equal(schedule_open_passes(again), passes + 2);
        assert_int_equal(schedule_next_pass(again), 0);
        assert_int_equal(schedule_free(again), schedule_free(schedule));
        schedule_destroy(&again);
        saved.settled = LEARNING_PASSES;
        assert_int_equal(schedule_restore(&settings, &saved, &again).code, RESULT_INPUT);
        job_settings_t unlearned = settings;
        unlearned.learn = false;
        saved.settled = 1;
        assert_int_equal(schedule_restore(&unlearned, &saved, &again).code, RESULT_INPUT);
        schedule_state_free(&saved);
        schedule_destroy(&schedule);
    }
}

/* Settled, and the process ends before the pass is open. */
static void a_pass_that_was_about_to_open_is_open_afterwards(void **state)
{
    (void)state;
    job_settings_t settings = job_of(64);
    schedule_t *schedule = schedule_at(&settings, 1), *again;
    for (uint32_t t = 0; t < TILES; t++)
        assert_int_equal(schedule_accept(schedule, &(unit_t){t, 2, 2}, 1).code, RESULT_OK);
    schedule_teach(schedule);
    schedule_state_t saved;
    schedule_save(schedule, &saved);
    assert_int_equal(schedule_restore(&settings, &saved, &again).code, RESULT_OK);
    assert_int_equal(schedule_open_passes(again), schedule_open_passes(schedule) + 1);
    schedule_state_free(&saved);
    schedule_destroy(&schedule);
    schedule_destroy(&again);
}

/* Rounds that end anywhere: a pass opens only once a round allows samples of it. */
static void rounds_and_passes_need_not_agree(void **state)
{
    (void)state;
    job_settings_t settings = job_of(64);
    settings.error = 0.5;
    schedule_t *schedule = schedule_new(&settings);
    static const uint32_t all_ends[] = {3, 6, 20, 64};
    uint32_t weights[TILES] = {1, 1, 1, 1}, opened = 2;
    for (size_t r = 0; r < ARRAY_LENGTH(all_ends); r++) {
        uint32_t ends[TILES];
        unit_t units[ROOM];
        for (int t = 0; t < TILES; t++) ends[t] = all_ends[r];
        schedule_open_round(schedule, ends, weights);
        while (!schedule_round_counted(schedule)) {
            while (schedule_next_pass(schedule) > 0) open_next(schedule, opened++);
            size_t count = take_all(schedule, &settings, units);
            assert_true(count > 0);
            assert_int_equal(schedule_accept(schedule, units, count).code, RESULT_OK);
        }
        assert_int_equal(opened, 1 + (learning_pass(&settings, all_ends[r] - 1) < 1
                                          ? 1
                                          : learning_pass(&settings, all_ends[r] - 1)));
    }
    schedule_destroy(&schedule);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(passes_open_as_they_are_counted),
                                       cmocka_unit_test(a_job_that_does_not_learn_has_no_passes),
                                       cmocka_unit_test(a_pass_is_not_shared_by_all),
                                       cmocka_unit_test(units_of_other_passes_are_not_taken),
                                       cmocka_unit_test(what_was_opened_stays_open),
                                       cmocka_unit_test(passes_outlive_the_process),
                                       cmocka_unit_test(a_pass_that_was_about_to_open_is_open_afterwards),
                                       cmocka_unit_test(rounds_and_passes_need_not_agree)};
    return cmocka_run_group_tests_name("passes", tests, NULL, NULL);
}
