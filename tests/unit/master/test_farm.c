/* Tests of master/farm and master/trust without sockets, in a time of their own: what would take minutes on a
 * real farm. */
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const identity_t nobody = {{0}, 0};

static int set_up(void **state)
{
    *state = toy_farm(false);
    return 0;
}

static int tear_down(void **state)
{
    farm_destroy((farm_t **)state);
    return 0;
}

static uint64_t submit(farm_t *farm)
{
    job_settings_t settings = toy_settings();
    return toy_submit(farm, 0, &settings, 0);
}

static uint64_t hello(farm_t *farm, double now)
{
    return toy_hello(farm, now, 1);
}

/* Takes one unit of a whole tile; false when there is none. */
static bool take(farm_t *farm, double now, uint64_t worker, unit_t *unit)
{
    toy_work_t work = toy_take(farm, now, worker, 1, 1 << 20);
    if (work.job == 0) return false;
    assert_int_equal(work.count, 1);
    *unit = work.units[0];
    return true;
}

static result_t deliver(farm_t *farm, double now, uint64_t worker, uint64_t job, const unit_t *unit)
{
    return toy_deliver(farm, now, worker, job, unit, 1);
}

static job_report_t report(farm_t *farm, double now, uint64_t job)
{
    return toy_report(farm, now, job);
}

static void a_worker_that_lives_but_delivers_nothing_holds_nobody_up(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), hanging = hello(farm, 0), good = hello(farm, 0);
    unit_t unit, lost;
    int taken = 0;
    while (take(farm, 0, hanging, &lost)) taken++; /* it took it all */
    assert_true(taken >= 4);
    for (double now = 1; now <= 5; now++) { /* a lease */
        farm_tick(farm, now);
        assert_true(farm_heartbeat(farm, now, &nobody, hanging, job, 4));
        assert_false(take(farm, now, good, &unit));
    }
    assert_true(take(farm, 6, good, &unit));
    assert_int_equal(report(farm, 6, job).record.units_reissued, taken);
    assert_true(farm_heartbeat(farm, 6, &nobody, hanging, job, 4)); /* it is not thrown out */
    assert_int_equal(deliver(farm, 7, good, job, &unit).code, RESULT_OK);
    assert_int_equal(deliver(farm, 8, hanging, job, &unit).code, RESULT_MISMATCH);
    assert_int_equal(deliver(farm, 9, hanging, job, &lost).code, RESULT_OK);
}

static void a_worker_that_delivers_slowly_keeps_its_units(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), slow = hello(farm, 0), other = hello(farm, 0);
    unit_t units[16], unit;
    size_t count = 0;
    while (take(farm, 0, slow, &units[count])) count++;
    assert_int_equal(deliver(farm, 100, slow, job, &units[0]).code, RESULT_OK);
    for (size_t i = 1; i + 1 < count; i++) {
        double now = 100 + 100 * (double)i;
        assert_true(farm_heartbeat(farm, now, &nobody, slow, job, 4));
        assert_false(take(farm, now, other, &unit));
        assert_int_equal(deliver(farm, now, slow, job, &units[i]).code, RESULT_OK);
    }
    job_report_t status = report(farm, 100 * (double)count, job);
    assert_int_equal(status.record.units_reissued, 0);
    assert_true(status.remaining > 0);
}

/* The only worker never got what it was assigned. */
static void units_that_did_not_arrive_go_back(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), worker = hello(farm, 0);
    unit_t unit;
    size_t taken = 0, again = 0;
    while (take(farm, 1, worker, &unit)) taken++;
    for (double now = 2; now < 7; now++) {
        assert_true(farm_heartbeat(farm, now, &nobody, worker, job, 0));
        assert_false(take(farm, now, worker, &unit));
    }
    assert_true(farm_heartbeat(farm, 7, &nobody, worker, job, 1)); /* some of it did */
    for (double now = 8; now <= 14; now++) assert_true(farm_heartbeat(farm, now, &nobody, worker, job, 0));
    while (take(farm, 14, worker, &unit)) {
        assert_int_equal(deliver(farm, 14, worker, job, &unit).code, RESULT_OK);
        again++;
    }
    assert_int_equal(again, taken);
    assert_int_equal(report(farm, 14, job).record.units_reissued, taken);
    assert_int_equal(report(farm, 14, job).record.state, JOB_FINISHING);
}

static void a_pause_of_the_master_costs_no_worker_its_lease(void **state)
{
    farm_t *farm = *state;
    uint64_t worker = hello(farm, 0);
    farm_tick(farm, 0.1);
    farm_tick(farm, 1000); /* the machine slept */
    assert_true(farm_heartbeat(farm, 1000.1, &nobody, worker, 0, 0));
    for (double now = 1000.2; now < 1006; now += 0.1) farm_tick(farm, now);
    assert_false(farm_heartbeat(farm, 1006, &nobody, worker, 0, 0));
}

static void jobs_wait_for_memory(void **state)
{
    farm_t *farm = *state; /* its memory holds six films of 160 kB */
    uint64_t worker = hello(farm, 0), jobs[8];
    unit_t unit;
    for (int j = 0; j < 8; j++) jobs[j] = submit(farm);
    while (take(farm, 0, worker, &unit)) {
    }
    for (int j = 0; j < 8; j++)
        assert_int_equal(report(farm, 1, jobs[j]).record.state, j < 6 ? JOB_RUNNING : JOB_QUEUED);
    assert_int_equal(farm_order(farm, 1, &(job_order_t){.job = jobs[0], .kind = ORDER_CANCEL}).code,
                     RESULT_OK);
    farm_tick(farm, 1.1);
    farm_tick(farm, 12); /* nobody answers the flush */
    job_t *job = farm_next_finished(farm);
    assert_non_null(job);
    assert_int_equal(farm_job_id(job), jobs[0]);
    farm_finished(farm, 12, job, result_ok(), NULL);
    farm_unpin(farm, job);
    assert_int_equal(report(farm, 12, jobs[0]).record.state, JOB_CANCELLED);
    worker = hello(farm, 12);
    assert_true(take(farm, 12, worker, &unit));
}

/* A worker comes, takes what there is of a job and says that it cannot render it. */
static void come_and_decline(farm_t *farm, double now, uint64_t job)
{
    char name[20];
    snprintf(name, sizeof name, "poor-%g", now);
    uint64_t worker = toy_join(farm, now, name, 1, 0);
    unit_t unit;
    assert_true(take(farm, now, worker, &unit));
    farm_goodbye(farm, now, worker, job, "no memory");
}

static void a_job_that_nobody_can_render_fails(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), other = submit(farm), worker = hello(farm, 0);
    unit_t unit;
    job_order_t later = {.job = other, .kind = ORDER_PRIORITY, .priority = -1};
    assert_int_equal(farm_order(farm, 0, &later).code, RESULT_OK);
    farm_goodbye(farm, 0, worker, job, "had none of it"); /* does not count */
    for (int i = 1; i < FARM_MAX_DECLINES; i++) come_and_decline(farm, i, job);
    assert_int_equal(report(farm, 5, job).record.state, JOB_RUNNING);
    worker = hello(farm, 5);
    assert_true(take(farm, 5, worker, &unit)); /* somebody still tries */
    come_and_decline(farm, 6, job);
    assert_int_equal(report(farm, 6, job).record.state, JOB_RUNNING);
    farm_goodbye(farm, 7, worker, job, "the scene is too large");
    assert_int_equal(report(farm, 7, job).record.state, JOB_FAILED);
    assert_non_null(strstr(report(farm, 7, job).record.message, "the scene is too large"));
    assert_int_equal(report(farm, 7, other).record.state, JOB_QUEUED);
}

/* A machine with a full disk, say, is the only one: the job waits, says what the worker says, and fails only
 * after the operator has had the time to mend it. */
static void one_machine_alone_does_not_fail_a_job_at_once(void **state)
{
    farm_destroy((farm_t **)state);
    farm_t *farm = *state = toy_farm(true);
    uint64_t job = submit(farm), next, last = 0;
    double now = 0;
    unit_t unit;
    while (report(farm, now, job).record.state != JOB_FAILED) {
        assert_true(now < 3600);
        uint64_t worker = toy_join(farm, now, "poor:1", 1, 0);
        if (take(farm, now, worker, &unit)) {
            farm_goodbye(farm, now, worker, job, "the disk is full");
            last++;
            farm_tick(farm, now + 2);
            if (report(farm, now, job).record.state != JOB_FAILED)
                assert_non_null(strstr(report(farm, now + 2, job).record.message, "the disk is full"));
            if (last == 1) { /* it may do others meanwhile */
                next = submit(farm);
                worker = toy_join(farm, now + 2, "poor:1", 1, 0);
                assert_true(take(farm, now + 2, worker, &unit));
                assert_int_equal(deliver(farm, now + 3, worker, next, &unit).code, RESULT_OK);
                assert_int_equal(farm_order(farm, now, &(job_order_t){.job = next, .kind = ORDER_PAUSE}).code,
                                 RESULT_OK);
                farm_goodbye(farm, now + 3, worker, 0, "");
            }
        } else {
            farm_goodbye(farm, now, worker, 0, "");
        }
        now += 5;
    }
    assert_true(now > 600 && last >= FARM_LONE_DECLINES && last < 20);
    assert_non_null(strstr(report(farm, now, job).record.message, "the disk is full"));
}

/* However often one declines: somebody else is connected who could, though busy for the moment. */
static void a_job_waits_for_those_who_have_not_declined_it(void **state)
{
    farm_destroy((farm_t **)state);
    farm_t *farm = *state = toy_farm(true);
    uint64_t job = submit(farm);
    unit_t unit;
    uint64_t busy = toy_join(farm, 0, "good:1", 1, 0);
    for (double now = 0; now < 2000; now += 150) {
        toy_beat(farm, now, busy);
        farm_take(farm, now, &(identity_t){{0}, 1}, busy, 0, 0, 1, &(work_t){.units = &unit}); /* enough */
        come_and_decline(farm, now, job);
        assert_int_equal(report(farm, now, job).record.state, JOB_RUNNING);
    }
    farm_goodbye(farm, 2000, busy, 0, "");
    come_and_decline(farm, 2150, job);
    assert_int_equal(report(farm, 2150, job).record.state, JOB_FAILED);
}

/* Who cannot render what others can does no harm. */
static void a_job_that_somebody_can_render_goes_on(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), worker = hello(farm, 0);
    unit_t unit;
    assert_true(take(farm, 0, worker, &unit));
    assert_int_equal(deliver(farm, 1, worker, job, &unit).code, RESULT_OK);
    farm_goodbye(farm, 1, worker, 0, "");
    for (int i = 0; i < 3 * FARM_MAX_DECLINES; i++) come_and_decline(farm, 2 + i, job);
    assert_int_equal(report(farm, 20, job).record.state, JOB_RUNNING);
    worker = hello(farm, 20);
    assert_true(take(farm, 20, worker, &unit));
    assert_int_equal(deliver(farm, 21, worker, job, &unit).code, RESULT_OK);
}

static void a_film_that_never_fits_is_refused(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = job_settings_default();
    hash_t blob = {{0}};
    uint64_t job;
    assert_int_equal(farm_submit(farm, 0, &(job_terms_t){.name = "x"}, &settings, &blob, 1, &job).code,
                     RESULT_LIMIT);
}

static void the_queue_has_an_end_and_forgets_the_finished(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = toy_settings();
    hash_t blob = {{0}};
    uint64_t first = submit(farm), job;
    for (int i = 1; i < FARM_MAX_JOBS; i++) submit(farm);
    assert_int_equal(farm_submit(farm, 0, &(job_terms_t){.name = "x"}, &settings, &blob, 1, &job).code,
                     RESULT_LIMIT);
    assert_int_equal(farm_order(farm, 0, &(job_order_t){.job = first, .kind = ORDER_CANCEL}).code, RESULT_OK);
    assert_int_equal(farm_submit(farm, 0, &(job_terms_t){.name = "x"}, &settings, &blob, 1, &job).code,
                     RESULT_OK);
    assert_int_equal(farm_order(farm, 0, &(job_order_t){.job = first, .kind = ORDER_CANCEL}).code,
                     RESULT_INPUT);
}

static void too_many_workers_are_refused_and_lost_ones_forgotten(void **state)
{
    farm_t *farm = *state;
    uint64_t worker, first = hello(farm, 0);
    for (int i = 1; i < FARM_MAX_WORKERS; i++) hello(farm, 0);
    assert_int_equal(
        farm_hello(farm, 0, &nobody, &(worker_hello_t){.name = "x", .key = "", .threads = 1}, &worker).code,
        RESULT_LIMIT);
    farm_goodbye(farm, 0, first, 0, "");
    assert_int_equal(
        farm_hello(farm, 0, &nobody, &(worker_hello_t){.name = "x", .key = "", .threads = 1}, &worker).code,
        RESULT_OK);
    for (int i = 0; i < 2 * FARM_MAX_WORKERS; i++) { /* come and go: memory stays bounded */
        farm_goodbye(farm, 0, worker, 0, "");
        assert_int_equal(
            farm_hello(farm, i, &nobody, &(worker_hello_t){.name = "x", .key = "", .threads = 1}, &worker)
                .code,
            RESULT_OK);
    }
    uint64_t job = submit(farm), lost = worker;
    assert_true(farm_heartbeat(farm, 9000, &nobody, worker, 0, 0));
    farm_goodbye(farm, 9000, worker, 0, "");
    unit_t unit = {0};
    assert_true(take(farm, 9000, hello(farm, 9000), &unit));
    assert_int_equal(deliver(farm, 9000, lost, job, &unit).code, RESULT_OK); /* the last one is remembered */
    unit.tile++;
    assert_int_equal(deliver(farm, 9000, first, job, &unit).code, RESULT_UNREACHABLE);
}

/* A unit whose holder died was handed out again; half of it comes from somebody who had the rest already. */
static void half_of_a_dead_workers_unit_may_be_delivered(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), dead = hello(farm, 0);
    unit_t unit = {0};
    assert_true(take(farm, 0, dead, &unit));
    assert_int_equal(unit.count, 4);
    farm_tick(farm, 1);
    farm_tick(farm, 2);
    for (double now = 3; now < 12; now++) farm_tick(farm, now);
    uint64_t other = hello(farm, 12);
    const unit_t half = {unit.tile, unit.first + 2, 2};
    assert_int_equal(deliver(farm, 12, other, job, &half).code, RESULT_OK);
    assert_true(report(farm, 12, job).record.samples_done == 2 * 16 * 16);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define WITH_FARM(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
        WITH_FARM(half_of_a_dead_workers_unit_may_be_delivered),
        WITH_FARM(a_worker_that_lives_but_delivers_nothing_holds_nobody_up),
        WITH_FARM(a_worker_that_delivers_slowly_keeps_its_units),
        WITH_FARM(units_that_did_not_arrive_go_back),
        WITH_FARM(a_pause_of_the_master_costs_no_worker_its_lease),
        WITH_FARM(jobs_wait_for_memory),
        WITH_FARM(a_job_that_nobody_can_render_fails),
        WITH_FARM(one_machine_alone_does_not_fail_a_job_at_once),
        WITH_FARM(a_job_waits_for_those_who_have_not_declined_it),
        WITH_FARM(a_job_that_somebody_can_render_goes_on),
        WITH_FARM(a_film_that_never_fits_is_refused),
        WITH_FARM(the_queue_has_an_end_and_forgets_the_finished),
        WITH_FARM(too_many_workers_are_refused_and_lost_ones_forgotten),
    };
    return cmocka_run_group_tests_name("farm", tests, NULL, NULL);
}
