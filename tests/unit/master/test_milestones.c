/* Tests of master/farm/milestones.c: nothing beyond a milestone is given out before its image is written,
 * whatever happens meanwhile. tests/farm/test_save_at.c does it with real processes and real images. */
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static int set_up(void **state)
{
    *state = toy_farm(true);
    return 0;
}

static int tear_down(void **state)
{
    farm_destroy((farm_t **)state);
    return 0;
}

/* Images at 3 and 5 of 8 samples a pixel. */
static job_settings_t settings_of(void)
{
    job_settings_t settings = toy_settings();
    settings.spp = 8;
    settings.save_at = (save_at_t){2, {3, 5}};
    return settings;
}

static uint64_t samples_at(uint32_t spp)
{
    return 32 * 32 * (uint64_t)spp;
}

/* The sums of a job that has so many samples a pixel and no milestones. */
static hash_t plain_sums(uint32_t spp)
{
    farm_t *farm = toy_farm(false);
    job_settings_t settings = toy_settings();
    settings.spp = spp + 1; /* so that its film stays open */
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    for (uint32_t t = 0; t < 4; t++) {
        toy_work_t work = toy_take(farm, 0, worker, 1, 1);
        assert_int_equal(work.job, job);
        assert_int_equal(toy_deliver(farm, 0, worker, job, &(unit_t){t, 0, spp}, 1).code, RESULT_OK);
    }
    assert_int_equal(toy_report(farm, 0, job).record.samples_done, samples_at(spp));
    hash_t sums = toy_sums(farm, job);
    farm_destroy(&farm);
    return sums;
}

/* Plays the image writer: tells how the image of the milestone went that is due; which one, 0: none is. */
static uint32_t write_milestone(farm_t *farm, double now, result_t result)
{
    uint32_t spp = 0;
    job_t *job = farm_next_milestone(farm, &spp);
    if (job == NULL) return 0;
    uint32_t other;
    assert_null(farm_next_milestone(farm, &other)); /* it is given out once */
    farm_milestone_written(farm, now, job, result, "a file");
    farm_unpin(farm, job);
    return spp;
}

static void the_image_comes_before_the_next_sample(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = settings_of();
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    const uint32_t stops[] = {3, 5};
    for (int i = 0; i < 2; i++) {
        toy_work_off(farm, 1, worker, job);
        assert_int_equal(toy_report(farm, 1, job).record.samples_done, samples_at(stops[i]));
        hash_t sums = toy_sums(farm, job), plain = plain_sums(stops[i]);
        assert_true(hash_equal(&sums, &plain));
        /* What was never given out is refused too. */
        assert_int_equal(toy_deliver(farm, 1, worker, job, &(unit_t){0, stops[i], 1}, 1).code,
                         RESULT_MISMATCH);
        assert_int_equal(toy_write_images(farm, 1, result_ok()), 0);
        assert_int_equal(write_milestone(farm, 1, result_ok()), stops[i]);
        assert_int_equal(toy_report(farm, 1, job).record.saved, stops[i]);
    }
    toy_work_off(farm, 2, worker, job);
    assert_int_equal(toy_report(farm, 2, job).record.samples_done, samples_at(8));
    assert_int_equal(write_milestone(farm, 2, result_ok()), 0);
    assert_int_equal(toy_write_images(farm, 2, result_ok()), 1);
}

static void a_milestone_at_the_end_comes_before_the_end(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = toy_settings();
    settings.save_at = (save_at_t){1, {settings.spp}};
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    toy_work_off(farm, 1, worker, job);
    assert_int_equal(toy_state(farm, 1, job), JOB_RUNNING);
    assert_int_equal(write_milestone(farm, 1, result_ok()), settings.spp);
    assert_int_equal(toy_state(farm, 1, job), JOB_FINISHING);
    assert_int_equal(toy_write_images(farm, 1, result_ok()), 1);
}

/* A full disk: the job waits, says so, and goes on when there is room. */
static void a_failure_is_tried_again(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = settings_of();
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    toy_work_off(farm, 1, worker, job);
    for (int i = 0; i < 3; i++) {
        double now = 1 + 10 * i;
        assert_int_equal(write_milestone(farm, now, result_fail(RESULT_IO, "no room")), 3);
        assert_int_equal(write_milestone(farm, now, result_ok()), 0);
        assert_int_equal(toy_state(farm, now, job), JOB_RUNNING);
        assert_non_null(strstr(toy_report(farm, now, job).record.message, "no room"));
        assert_true(toy_beat(farm, now + 1, worker));
        farm_tick(farm, now + 1);
        assert_non_null(strstr(toy_report(farm, now, job).record.message, "no room"));
        assert_int_equal(toy_take(farm, now + 1, worker, 1024, 512).job, 0);
        for (int s = 1; s < 8; s++) {
            assert_true(toy_beat(farm, now + s, worker));
            farm_tick(farm, now + s);
        }
    }
    assert_int_equal(write_milestone(farm, 31, result_ok()), 3);
    assert_string_equal(toy_report(farm, 31, job).record.message, "");
    toy_work_off(farm, 32, worker, job);
    assert_int_equal(write_milestone(farm, 32, result_ok()), 5);
}

static void a_cancelled_job_keeps_the_image_that_was_due(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = settings_of();
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    toy_work_off(farm, 1, worker, job);
    assert_int_equal(toy_order(farm, 1, job, ORDER_CANCEL).code, RESULT_OK);
    assert_int_equal(toy_state(farm, 1, job), JOB_FINISHING);
    assert_int_equal(toy_write_images(farm, 1, result_ok()), 0);
    assert_int_equal(write_milestone(farm, 1, result_ok()), 3);
    assert_int_equal(toy_write_images(farm, 1, result_ok()), 1);
    assert_int_equal(toy_report(farm, 1, job).record.saved, 3);
    assert_int_equal(write_milestone(farm, 1, result_ok()), 0);
}

/* The end does not wait for ever: the image is tried once, and its failure is told. */
static void a_cancelled_job_does_not_wait_for_room(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = settings_of();
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    toy_work_off(farm, 1, worker, job);
    assert_int_equal(write_milestone(farm, 1, result_fail(RESULT_IO, "no room")), 3);
    assert_int_equal(toy_order(farm, 1, job, ORDER_CANCEL).code, RESULT_OK);
    assert_int_equal(write_milestone(farm, 1, result_fail(RESULT_IO, "no room")), 3);
    assert_int_equal(toy_write_images(farm, 1, result_ok()), 1);
    job_report_t report = toy_report(farm, 1, job);
    assert_int_equal(report.record.saved, 0);
    assert_non_null(strstr(report.record.message, "no room"));
}

/* The process ends where it likes; `forget`: the journal has not heard of the image. */
static farm_t *restart(farm_t *farm, uint64_t job, bool forget)
{
    toy_film_t film;
    job_record_t record = toy_report(farm, 2, job).record;
    if (forget) record.saved = 0;
    assert_true(toy_checkpoint(farm, 2, result_ok(), &film));
    farm_destroy(&farm);
    farm = toy_farm(true);
    farm_restore(farm, 3, &record);
    assert_true(toy_load(farm, 3, &film));
    assert_int_equal(toy_state(farm, 3, job), JOB_RUNNING);
    return farm;
}

static void a_restart_loses_no_image(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = settings_of();
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    toy_work_t work = toy_take(farm, 1, worker, 1024, 512);
    assert_int_equal(toy_deliver(farm, 1, worker, job, work.units, work.count).code, RESULT_OK);
    *state = farm = restart(farm, job, false); /* in the middle of a round */
    worker = toy_hello(farm, 3, 1);
    assert_int_equal(write_milestone(farm, 3, result_ok()), 0);
    toy_work_off(farm, 3, worker, job);
    assert_int_equal(toy_report(farm, 3, job).record.samples_done, samples_at(3));
    *state = farm = restart(farm, job, false); /* the image was being written */
    worker = toy_hello(farm, 3, 1);
    assert_int_equal(toy_take(farm, 3, worker, 1024, 512).job, 0);
    assert_int_equal(write_milestone(farm, 3, result_ok()), 3);
    work = toy_take(farm, 3, worker, 1024, 512);
    assert_int_equal(toy_deliver(farm, 3, worker, job, work.units, work.count).code, RESULT_OK);
    *state = farm = restart(farm, job, true); /* beyond it */
    assert_int_equal(toy_report(farm, 3, job).record.saved, 3);
    assert_int_equal(write_milestone(farm, 3, result_ok()), 0);
    toy_work_off(farm, 3, toy_hello(farm, 3, 1), job);
    hash_t sums = toy_sums(farm, job), plain = plain_sums(5);
    assert_true(hash_equal(&sums, &plain));
    assert_int_equal(write_milestone(farm, 3, result_ok()), 5);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(the_image_comes_before_the_next_sample, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_milestone_at_the_end_comes_before_the_end, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_failure_is_tried_again, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_cancelled_job_keeps_the_image_that_was_due, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_cancelled_job_does_not_wait_for_room, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_restart_loses_no_image, set_up, tear_down),
    };
    return cmocka_run_group_tests_name("milestones", tests, NULL, NULL);
}
