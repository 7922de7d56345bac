/* The estimated error of jobs and its history: points are thinned; every job gets them, at times that do not
 * disturb it; what was lost is not told of; a deleted job loses its history. Without sockets, in a time of
 * its own (tests/toy_farm.h), but for the thread that makes them. */
#include "common/wake.h"
#include "master/threads/image_writer.h"
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const result_t ok = {0};

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

/* ---- points -------------------------------------------------------------------------------------------- */

static void assert_rising(const error_point_t *points, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        assert_true(error_point_valid(&points[i]));
        if (i == 0) continue;
        assert_true(points[i].samples > points[i - 1].samples);
        assert_true(points[i].elapsed >= points[i - 1].elapsed);
    }
}

static void add(error_history_t *history, double elapsed, uint64_t samples, double error)
{
    error_history_add(history, &(error_point_t){elapsed, samples, error});
}

static void a_full_history_is_thinned_evenly(void **state)
{
    (void)state;
    error_history_t history = {0};
    const uint64_t first = 1000, last = 100000000;
    for (uint64_t n = first; n < last; n += n / 200) /* far more than there is room for */
        add(&history, (double)n, n, 1 / sqrt((double)n));
    add(&history, (double)last, last, 1 / sqrt((double)last));
    assert_int_equal(history.count, ERROR_HISTORY_POINTS);
    assert_rising(history.points, history.count);
    assert_int_equal(history.points[0].samples, first);
    assert_int_equal(error_history_last(&history)->samples, last);
    /* No gap is several times the mean one of the scale. */
    double mean = log((double)last / (double)first) / ERROR_HISTORY_POINTS;
    for (size_t i = 1; i < history.count; i++) {
        double gap = log((double)history.points[i].samples / (double)history.points[i - 1].samples);
        if (gap > 4 * mean) fail_msg("a gap of %g at %zu, the mean is %g", gap, i, mean);
    }
}

static void a_point_is_wanted_when_the_samples_have_grown(void **state)
{
    (void)state;
    error_history_t history = {0};
    assert_false(error_history_wants(&history, 0));
    assert_true(error_history_wants(&history, 1));
    add(&history, 1, 1000, 0.5);
    assert_false(error_history_wants(&history, 1000));
    assert_false(error_history_wants(&history, 1049));
    assert_true(error_history_wants(&history, 1050));
    assert_true(error_history_wants(&history, 900)); /* some were taken out */
}

static void points_of_samples_that_were_lost_go(void **state)
{
    (void)state;
    error_history_t history = {0};
    add(&history, 1, 100, 0.4);
    add(&history, 2, 200, 0.3);
    add(&history, 3, 400, 0.2);
    assert_false(error_history_cut(&history, 400));
    add(&history, 4, 300, 0.25);
    assert_int_equal(history.count, 3);
    assert_true(error_history_last(&history)->samples == 300 && error_history_last(&history)->elapsed == 4);
    add(&history, 9, 300, 0.24); /* a better estimate of the same samples is no later one */
    assert_int_equal(history.count, 3);
    assert_true(error_history_last(&history)->error == 0.24 && error_history_last(&history)->elapsed == 4);
    add(&history, 3, 350, 0.2); /* a clock that was ahead in an earlier process */
    assert_rising(history.points, history.count);
    assert_true(error_history_cut(&history, 0));
    assert_null(error_history_last(&history));
}

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* The image writer: makes the estimates that are due; returns how many. */
static int estimate(farm_t *farm, double now)
{
    int count = 0;
    for (job_t *job; (job = farm_next_estimate(farm, now)) != NULL; count++) {
        assert_true(count < 100);
        farm_estimate(farm, now, job);
        farm_unpin(farm, job);
    }
    return count;
}

static size_t points(farm_t *farm, uint64_t job, error_point_t *last)
{
    size_t count;
    error_point_t *copy = farm_job_history(farm, job, &count);
    assert_true((copy == NULL) == (count == 0));
    assert_rising(copy, count);
    if (count > 0) *last = copy[count - 1];
    free(copy);
    return count;
}

static uint64_t submit(farm_t *farm, uint32_t spp)
{
    job_settings_t settings = toy_settings();
    settings.spp = spp;
    return toy_submit(farm, 0, &settings, 0);
}

static void work(farm_t *farm, double now, uint64_t worker, uint64_t samples)
{
    toy_work_t taken = toy_take(farm, now, worker, samples, 256);
    assert_int_equal(toy_deliver(farm, now, worker, taken.job, taken.units, taken.count).code, RESULT_OK);
}

static void every_job_has_its_error_estimated(void **state)
{
    farm_t *farm = *state;
    error_point_t last = {0};
    uint64_t job = submit(farm, 1024), worker = toy_hello(farm, 0, 1);
    assert_int_equal(points(farm, job, &last), 0);
    assert_int_equal(estimate(farm, 0), 0);
    for (int i = 1; i <= 64; i++) {
        work(farm, 10 * i, worker, 4096);
        estimate(farm, 10 * i);
    }
    size_t count = points(farm, job, &last);
    assert_in_range(count, 30, 64); /* the later ones are less than five percent apart */
    job_report_t report = toy_report(farm, 640, job);
    assert_true(report.error == last.error && report.error > 0 && report.error < 0.1);
    assert_true((double)last.samples * 1.05 >= (double)report.record.samples_done);
    assert_true(last.elapsed > 500 && last.elapsed <= report.record.elapsed);
    assert_int_equal(estimate(farm, 1000), 0); /* nothing new */
}

static void estimates_are_some_seconds_apart(void **state)
{
    farm_t *farm = *state;
    uint64_t worker = toy_hello(farm, 0, 1);
    submit(farm, 1024);
    work(farm, 1, worker, 1024);
    assert_int_equal(estimate(farm, 1), 1);
    work(farm, 1.5, worker, 4096);
    assert_int_equal(estimate(farm, 2), 0);
    assert_int_equal(estimate(farm, 60), 1);
}

/* Renders to an error; returns the sums, and how many samples it took. */
static hash_t render(bool estimates, uint64_t *samples)
{
    farm_t *farm = toy_farm(true);
    job_settings_t settings = toy_settings();
    settings.spp = JOB_MAX_SPP;
    settings.error = 0.02;
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    double now = 1;
    int made = 0;
    for (toy_work_t taken; (taken = toy_take(farm, now, worker, 1024, 256)).job != 0; now += 3) {
        assert_int_equal(toy_deliver(farm, now, worker, job, taken.units, taken.count).code, RESULT_OK);
        if (estimates) made += estimate(farm, now);
    }
    if (estimates) assert_true(made > 20);
    assert_int_equal(toy_state(farm, now, job), JOB_FINISHING);
    *samples = toy_report(farm, now, job).record.samples_done;
    hash_t sums = toy_sums(farm, job);
    farm_destroy(&farm);
    return sums;
}

static void an_estimate_changes_neither_rounds_nor_sums(void **state)
{
    (void)state;
    uint64_t plain_samples, watched_samples;
    hash_t plain = render(false, &plain_samples), watched = render(true, &watched_samples);
    assert_true(hash_equal(&plain, &watched));
    assert_int_equal(plain_samples, watched_samples);
}

static void the_last_point_is_that_of_the_last_image(void **state)
{
    farm_t *farm = *state;
    error_point_t last = {0};
    film_image_t image;
    job_report_t report;
    uint64_t job = submit(farm, 16);
    toy_work_off(farm, 1, toy_hello(farm, 0, 1), job);
    job_t *pinned = farm_next_finished(farm);
    assert_non_null(pinned);
    assert_int_equal(farm_resolve(farm, 2, pinned, NULL, &image, &report).code, RESULT_OK);
    farm_finished(farm, 2, pinned, ok, NULL);
    farm_unpin(farm, pinned);
    assert_int_equal(points(farm, job, &last), 1);
    assert_true(last.error == image.error);
    assert_int_equal(last.samples, 16 * 32 * 32);
    film_image_free(&image);
    toy_film_t film;
    assert_true(toy_checkpoint(farm, 2, ok, &film));
    assert_int_equal(toy_state(farm, 2, job), JOB_DONE);
    assert_int_equal(points(farm, job, &last), 1);
    toy_film_free(&film);
    assert_int_equal(toy_order(farm, 3, job, ORDER_DELETE).code, RESULT_OK);
    assert_int_equal(points(farm, job, &last), 0);
}

/* ---- the thread that makes them ------------------------------------------------------------------------ */

/* People who ask for images without end, each before the last one is answered. */
typedef struct {
    image_writer_t *image_writer;
    atomic_bool enough;
} crowd_t;

static void ask_again(void *context, const result_t *result, const image_file_t *file)
{
    (void)result, (void)file;
    crowd_t *crowd = context;
    image_request_t request = {.done = ask_again, .context = crowd, .job = 99}; /* that there is not */
    if (!atomic_load(&crowd->enough)) image_writer_ask(crowd->image_writer, &request);
}

static void who_asks_for_images_holds_up_no_estimate(void **state)
{
    farm_t *farm = *state;
    error_point_t last = {0};
    crowd_t crowd = {.enough = false};
    char *folder = scratch_new();
    image_writer_options_t options = {.farm = farm, .data_dir = folder, .answer_wake = -1};
    assert_int_equal(wake_new(&options.image_wake).code, RESULT_OK);
    assert_int_equal(image_writer_start(&options, &crowd.image_writer).code, RESULT_OK);
    ask_again(&crowd, NULL, NULL);
    usleep(20000); /* from now on somebody waits at every moment */
    uint64_t job = submit(farm, 1024);
    work(farm, 1, toy_hello(farm, 0, 1), 1024);
    for (int i = 0; i < 500 && points(farm, job, &last) == 0; i++) usleep(10000);
    atomic_store(&crowd.enough, true);
    assert_int_equal(points(farm, job, &last), 1);
    image_writer_stop(&crowd.image_writer);
    wake_close(options.image_wake);
    scratch_destroy(&folder);
}

/* ---- what survives the process ------------------------------------------------------------------------- */

/* The record and the history as the journal has them. */
typedef struct {
    job_record_t record;
    error_history_t history;
} kept_t;

static kept_t keep(farm_t *farm, double now, uint64_t job)
{
    kept_t kept = {0};
    uint64_t of;
    while (farm_next_record(farm, now, &kept.record)) {
    }
    assert_true(farm_next_history(farm, &of, &kept.history));
    assert_int_equal(of, job);
    assert_false(farm_next_history(farm, &of, &kept.history));
    farm_history_unsaved(farm, job);
    assert_true(farm_next_history(farm, &of, &kept.history));
    return kept;
}

static void a_history_goes_on_after_a_restart(void **state)
{
    farm_t *farm = *state;
    error_point_t last = {0};
    toy_film_t film;
    uint64_t job = submit(farm, 1024), worker = toy_hello(farm, 0, 1);
    for (int i = 1; i <= 8; i++) {
        work(farm, 10 * i, worker, 2048);
        assert_int_equal(estimate(farm, 10 * i), 1);
        if (i == 4) assert_true(toy_checkpoint(farm, 10 * i, ok, &film));
    }
    assert_int_equal(points(farm, job, &last), 8);
    kept_t kept = keep(farm, 80, job);
    farm_destroy(&farm);
    farm = *state = toy_farm(true);
    farm_restore(farm, 100, &kept.record);
    farm_restore_history(farm, job, &kept.history);
    assert_int_equal(points(farm, job, &last), 8);
    assert_true(toy_load(farm, 100, &film)); /* which has half of the samples */
    assert_int_equal(points(farm, job, &last), 4);
    assert_int_equal(last.samples, toy_report(farm, 100, job).record.samples_done);
    worker = toy_hello(farm, 100, 1);
    work(farm, 110, worker, 4096);
    assert_int_equal(estimate(farm, 110), 1);
    assert_int_equal(points(farm, job, &last), 5);
}

static void a_job_that_begins_anew_has_no_history(void **state)
{
    farm_t *farm = *state;
    error_point_t last = {0};
    uint64_t job = submit(farm, 1024);
    work(farm, 10, toy_hello(farm, 0, 1), 2048);
    assert_int_equal(estimate(farm, 10), 1);
    kept_t kept = keep(farm, 11, job);
    farm_destroy(&farm);
    farm = *state = toy_farm(true);
    farm_restore(farm, 20, &kept.record);
    farm_restore_history(farm, job, &kept.history);
    assert_true(toy_load(farm, 20, NULL)); /* there is no checkpoint */
    assert_int_equal(points(farm, job, &last), 0);
    kept = keep(farm, 21, job); /* the journal is told */
    assert_int_equal(kept.history.count, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define WITH_FARM(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
        cmocka_unit_test(a_full_history_is_thinned_evenly),
        cmocka_unit_test(a_point_is_wanted_when_the_samples_have_grown),
        cmocka_unit_test(points_of_samples_that_were_lost_go),
        WITH_FARM(every_job_has_its_error_estimated),
        WITH_FARM(estimates_are_some_seconds_apart),
        cmocka_unit_test(an_estimate_changes_neither_rounds_nor_sums),
        WITH_FARM(the_last_point_is_that_of_the_last_image),
        WITH_FARM(who_asks_for_images_holds_up_no_estimate),
        WITH_FARM(a_history_goes_on_after_a_restart),
        WITH_FARM(a_job_that_begins_anew_has_no_history),
    };
    return cmocka_run_group_tests_name("farm_errors", tests, NULL, NULL);
}
