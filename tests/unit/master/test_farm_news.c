/* Tests of what the operator of a master is told of jobs (master/farm/news.c), in a time of their own. */
#include "tests/toy_farm.h"

#include "master/store/record.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static int set_up(void **state)
{
    *state = toy_telling_farm();
    return 0;
}

static int tear_down(void **state)
{
    farm_destroy((farm_t **)state);
    return 0;
}

static void assert_no_news(farm_t *farm, double now)
{
    farm_news_t news;
    double wait;
    if (farm_next_news(farm, now, &news, &wait))
        fail_msg("job %llu is %s", (unsigned long long)news.report.record.job,
                 job_state_name((uint32_t)news.report.record.state));
}

static farm_news_t next_news(farm_t *farm, double now, uint64_t job, job_state_t job_state)
{
    farm_news_t news;
    double wait;
    if (!farm_next_news(farm, now, &news, &wait)) fail_msg("there are no news");
    assert_int_equal(news.report.record.job, job);
    assert_int_equal(news.report.record.state, job_state);
    return news;
}

static void assert_told(farm_t *farm, double now, uint64_t job, job_state_t job_state)
{
    farm_news_t news = next_news(farm, now, job, job_state);
    farm_news_told(farm, &news);
    assert_no_news(farm, now);
}

static uint64_t submit(farm_t *farm, double now)
{
    job_settings_t settings = toy_settings();
    return toy_submit(farm, now, &settings, 0);
}

/* All of it is counted: the job is finishing. */
static void work_off(farm_t *farm, double now, uint64_t job)
{
    toy_work_off(farm, now, toy_hello(farm, now, 1), job);
    assert_int_equal(toy_state(farm, now, job), JOB_FINISHING);
}

/* And now it is done. */
static void put_away(farm_t *farm, double now)
{
    toy_film_t film;
    assert_int_equal(toy_write_images(farm, now, result_ok()), 1);
    while (toy_checkpoint(farm, now, result_ok(), &film)) toy_film_free(&film);
}

static void a_job_that_is_done_is_told_of_once(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 0);
    work_off(farm, 0, job);
    assert_no_news(farm, 0);
    put_away(farm, 1);
    farm_news_t news = next_news(farm, 1, job, JOB_DONE);
    assert_int_equal(news.report.record.samples_done, 32 * 32 * 4);
    assert_told(farm, 1, job, JOB_DONE);
    assert_no_news(farm, 1e6);
}

static void cancelled_and_failed_jobs_are_told_of(void **state)
{
    farm_t *farm = *state;
    uint64_t cancelled = submit(farm, 0);
    assert_int_equal(toy_order(farm, 0, cancelled, ORDER_CANCEL).code, RESULT_OK);
    assert_told(farm, 0, cancelled, JOB_CANCELLED);
    uint64_t failed = submit(farm, 1);
    double now = 1;
    for (; toy_state(farm, now, failed) != JOB_FAILED; now += 150) {
        uint64_t worker = toy_hello(farm, now, 1);
        assert_int_equal(toy_take(farm, now, worker, 1, 1 << 20).job, failed);
        farm_goodbye(farm, now, worker, failed, "no such texture");
    }
    farm_news_t news = next_news(farm, now, failed, JOB_FAILED);
    assert_non_null(strstr(news.report.record.message, "no such texture"));
}

static void who_orders_a_pause_is_not_told_of_it(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 0);
    assert_int_equal(toy_order(farm, 0, job, ORDER_PAUSE).code, RESULT_OK);
    assert_no_news(farm, 0);
}

static void a_lost_scene_is_told_of_until_the_job_is_resumed(void **state)
{
    farm_t *farm = *state;
    hash_t blob = {{0}};
    uint64_t job = submit(farm, 0);
    farm_scene_lost(farm, 0, &blob);
    farm_news_t news = next_news(farm, 0, job, JOB_PAUSED);
    assert_string_equal(news.report.record.message, FARM_NO_SCENE);
    assert_int_equal(toy_order(farm, 1, job, ORDER_RESUME).code, RESULT_OK);
    assert_no_news(farm, 1);
    assert_int_equal(toy_order(farm, 2, job, ORDER_PAUSE).code, RESULT_OK);
    assert_no_news(farm, 2); /* this one was ordered */
}

static void a_full_disk_is_told_of_once_and_then_the_end(void **state)
{
    farm_t *farm = *state;
    result_t full = result_fail(RESULT_IO, "no space left");
    uint64_t job = submit(farm, 0);
    toy_film_t film;
    work_off(farm, 0, job);
    assert_int_equal(toy_write_images(farm, 0, full), 1);
    farm_news_t news = next_news(farm, 0, job, JOB_FINISHING);
    assert_non_null(strstr(news.report.record.message, "no space left"));
    assert_told(farm, 0, job, JOB_FINISHING);
    farm_tick(farm, 100);
    assert_int_equal(toy_write_images(farm, 100, full), 1);
    assert_true(toy_checkpoint(farm, 100, full, &film));
    assert_no_news(farm, 100);
    farm_tick(farm, 200);
    put_away(farm, 200);
    assert_told(farm, 200, job, JOB_DONE);
}

static void a_checkpoint_that_fails_at_the_end_is_told_of(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 0);
    toy_film_t film;
    work_off(farm, 0, job);
    assert_true(toy_checkpoint(farm, 0, result_fail(RESULT_IO, "no space left"), &film));
    assert_told(farm, 0, job, JOB_FINISHING);
}

static void a_failed_attempt_is_repeated_when_it_is_time(void **state)
{
    farm_t *farm = *state;
    double wait;
    farm_news_t news;
    uint64_t first = submit(farm, 0), second = submit(farm, 0);
    assert_int_equal(toy_order(farm, 0, first, ORDER_CANCEL).code, RESULT_OK);
    news = next_news(farm, 10, first, JOB_CANCELLED);
    assert_int_equal(news.failures, 0);
    farm_news_failed(farm, &news, 15);
    assert_false(farm_next_news(farm, 12, &news, &wait));
    assert_true(wait == 3);
    assert_int_equal(toy_order(farm, 13, second, ORDER_CANCEL).code, RESULT_OK);
    assert_int_equal(next_news(farm, 20, second, JOB_CANCELLED).failures, 0); /* the new one goes first */
    assert_told(farm, 14, second, JOB_CANCELLED);
    news = next_news(farm, 15, first, JOB_CANCELLED);
    assert_int_equal(news.failures, 1);
    assert_true(news.since == 10);
    farm_news_told(farm, &news);
    assert_false(farm_next_news(farm, 15, &news, &wait));
    assert_true(isinf(wait));
}

/* While the first end is being told, the job goes on and ends again. */
static void an_answer_to_old_news_does_not_stand_for_new_ones(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 0);
    assert_int_equal(toy_order(farm, 0, job, ORDER_CANCEL).code, RESULT_OK);
    farm_news_t news = next_news(farm, 0, job, JOB_CANCELLED);
    assert_int_equal(toy_order(farm, 0, job, ORDER_EXTEND).code, RESULT_OK);
    assert_no_news(farm, 0);
    assert_int_equal(toy_order(farm, 0, job, ORDER_CANCEL).code, RESULT_OK);
    farm_news_told(farm, &news);
    assert_told(farm, 0, job, JOB_CANCELLED);
}

static void of_a_deleted_job_nothing_is_told(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 0);
    assert_int_equal(toy_order(farm, 0, job, ORDER_CANCEL).code, RESULT_OK);
    farm_news_t news = next_news(farm, 0, job, JOB_CANCELLED);
    assert_int_equal(toy_order(farm, 0, job, ORDER_DELETE).code, RESULT_OK);
    assert_no_news(farm, 0);
    farm_news_failed(farm, &news, 1);
    farm_news_told(farm, &news);
}

/* The record as the journal has it in the end. */
static job_record_t last_record(farm_t *farm)
{
    job_record_t record = {0}, next;
    while (farm_next_record(farm, 0, &next)) record = next;
    size_t size;
    uint8_t *bytes = record_pack(&record, &size);
    assert_int_equal(record_unpack(bytes, size, &next).code, RESULT_OK);
    free(bytes);
    return next;
}

/* Kills the process, starts another one on its journal. */
static void restart(farm_t **farm, bool tells)
{
    job_record_t record = last_record(*farm);
    farm_destroy(farm);
    *farm = tells ? toy_telling_farm() : toy_farm(true);
    farm_restore(*farm, 0, &record);
}

static void what_a_killed_master_did_not_tell_the_next_one_does(void **state)
{
    farm_t **farm = (farm_t **)state;
    uint64_t job = submit(*farm, 0);
    assert_int_equal(toy_order(*farm, 0, job, ORDER_CANCEL).code, RESULT_OK);
    restart(farm, true);
    assert_told(*farm, 0, job, JOB_CANCELLED);
    restart(farm, true);
    assert_no_news(*farm, 0);
}

static void a_master_that_tells_nobody_forgets_the_news(void **state)
{
    farm_t **farm = (farm_t **)state;
    uint64_t job = submit(*farm, 0);
    assert_int_equal(toy_order(*farm, 0, job, ORDER_CANCEL).code, RESULT_OK);
    restart(farm, false);
    assert_no_news(*farm, 0);
    restart(farm, true);
    assert_no_news(*farm, 0);
    assert_int_equal(toy_order(*farm, 0, job, ORDER_EXTEND).code, RESULT_OK);
    assert_int_equal(toy_order(*farm, 0, job, ORDER_CANCEL).code, RESULT_OK);
    assert_told(*farm, 0, job, JOB_CANCELLED);
}

static void a_record_that_tells_of_no_state_is_refused(void **state)
{
    farm_t *farm = *state;
    submit(farm, 0);
    job_record_t record = last_record(farm);
    record.news = (job_state_t)(JOB_PAUSED + 1);
    size_t size;
    uint8_t *bytes = record_pack(&record, &size);
    assert_int_equal(record_unpack(bytes, size, &record).code, RESULT_INPUT);
    free(bytes);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(a_job_that_is_done_is_told_of_once),
        TEST(cancelled_and_failed_jobs_are_told_of),
        TEST(who_orders_a_pause_is_not_told_of_it),
        TEST(a_lost_scene_is_told_of_until_the_job_is_resumed),
        TEST(a_full_disk_is_told_of_once_and_then_the_end),
        TEST(a_checkpoint_that_fails_at_the_end_is_told_of),
        TEST(a_failed_attempt_is_repeated_when_it_is_time),
        TEST(an_answer_to_old_news_does_not_stand_for_new_ones),
        TEST(of_a_deleted_job_nothing_is_told),
        TEST(what_a_killed_master_did_not_tell_the_next_one_does),
        TEST(a_master_that_tells_nobody_forgets_the_news),
        TEST(a_record_that_tells_of_no_state_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
