/* What can happen to a farm: workers that are killed, stopped, late or sent away, a master that comes back,
 * jobs in a row and jobs cancelled. Real processes; wherever the job completes, its pixels have the same bits
 * as those of an undisturbed render on one machine. */
#include "tests/rig.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double BATCH_INTERVAL = 0.2; /* seconds */
enum { BEGUN = 4 * RIG_PIXELS };          /* samples */

static uint64_t submit_short(rig_t *rig, uint32_t spp)
{
    job_settings_t settings = rig_settings();
    settings.spp = spp;
    return rig_submit(rig, &settings);
}

/* Starts a job without an end on a farm of `workers` and waits until something of it is counted. */
static uint64_t begin_job(rig_t *rig, int workers, pid_t *pids)
{
    rig_start_master(rig, BATCH_INTERVAL);
    for (int i = 0; i < workers; i++) pids[i] = rig_start_worker(rig);
    rig_wait_workers(rig, (uint32_t)workers);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_samples(rig, job, BEGUN);
    return job;
}

static void a_killed_worker_is_replaced(void **state)
{
    rig_t *rig = *state;
    pid_t workers[2];
    uint64_t job = begin_job(rig, 2, workers);
    kill(workers[0], SIGKILL);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
}

static void a_stopped_worker_is_replaced_and_comes_back(void **state)
{
    rig_t *rig = *state;
    pid_t workers[2];
    uint64_t job = begin_job(rig, 2, workers);
    kill(workers[0], SIGSTOP);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
    rig_wait_workers(rig, 1);
    kill(workers[0], SIGCONT);
    rig_wait_workers(rig, 2);
    job = rig_submit_endless(rig);
    rig_wait_workers_seen(rig, job, 2);
    rig_end_job(rig, job);
    assert_int_equal(rig_assert_reference(rig, job).workers_seen, 2);
}

/* Stopped for longer than its lease, but back before the job ends: its units were given to the other. */
static void a_straggler_counts_nothing_twice(void **state)
{
    rig_t *rig = *state;
    pid_t workers[2];
    uint64_t job = begin_job(rig, 2, workers);
    kill(workers[0], SIGSTOP);
    rig_wait_workers(rig, 1);
    kill(workers[0], SIGCONT);
    rig_wait_workers(rig, 2);
    rig_wait_samples(rig, job, rig_status(rig, job).samples_done + BEGUN);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
}

static void the_last_worker_dies_and_a_new_one_finishes(void **state)
{
    rig_t *rig = *state;
    pid_t worker;
    uint64_t job = begin_job(rig, 1, &worker);
    kill(worker, SIGKILL);
    rig_wait_workers(rig, 0);
    assert_int_equal(rig_status(rig, job).state, JOB_RUNNING);
    rig_end_job(rig, job);
    rig_start_worker(rig);
    rig_assert_reference(rig, job);
}

static void a_late_worker_joins(void **state)
{
    rig_t *rig = *state;
    pid_t worker;
    uint64_t job = begin_job(rig, 1, &worker);
    rig_start_worker(rig);
    rig_wait_workers_seen(rig, job, 2);
    rig_end_job(rig, job);
    assert_int_equal(rig_assert_reference(rig, job).workers_seen, 2);
}

/* After a first small one no batch is due for a long time: what is counted then came with the farewell. */
static void a_worker_sent_away_leaves_its_work(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, 1000);
    pid_t worker = rig_start_worker(rig);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_output(rig, worker, "counted after");
    rig_sleep(0.5);
    uint64_t before = rig_status(rig, job).samples_done;
    kill(worker, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, worker, 30), 0);
    assert_true(rig_status(rig, job).samples_done > before);
    rig_wait_workers(rig, 0);
    rig_end_job(rig, job);
    rig_start_worker(rig);
    rig_assert_reference(rig, job);
}

static void a_worker_waits_for_its_master(void **state)
{
    rig_t *rig = *state;
    rig_start_worker(rig);
    rig_sleep(1.5);
    rig_start_master(rig, BATCH_INTERVAL);
    rig_assert_reference(rig, submit_short(rig, 32));
}

static void a_worker_outlives_its_master(void **state)
{
    rig_t *rig = *state;
    pid_t worker;
    begin_job(rig, 1, &worker);
    rig_kill_master(rig);
    rig_sleep(0.5);
    rig_start_master(rig, BATCH_INTERVAL);
    rig_wait_workers(rig, 1);
    rig_assert_reference(rig, submit_short(rig, 32));
    kill(worker, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, worker, 30), 0);
}

/* A stopped master is silent for longer than any time-out, then goes on. */
static void a_stopped_master_goes_on(void **state)
{
    rig_t *rig = *state;
    pid_t workers[2];
    uint64_t job = begin_job(rig, 2, workers);
    kill(rig->master, SIGSTOP);
    rig_sleep(2.5);
    kill(rig->master, SIGCONT);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
}

static void two_jobs_in_a_row(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, BATCH_INTERVAL);
    rig_start_worker(rig);
    rig_start_worker(rig);
    job_settings_t other = rig_settings();
    other.seed++;
    other.width = 48;
    other.spp = 50;
    uint64_t first = rig_submit(rig, &other), second = submit_short(rig, other.spp);
    rig_assert_reference(rig, second);
    assert_int_equal(rig_wait_job(rig, first).state, JOB_DONE);
    hash_t hash = rig_image_hash(rig, first), reference = rig_reference_at(other.spp);
    assert_false(hash_equal(&hash, &reference));
}

static void a_cancelled_job_keeps_its_image(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, BATCH_INTERVAL);
    rig_start_worker(rig);
    uint64_t job = submit_short(rig, JOB_MAX_SPP);
    rig_wait_samples(rig, job, 1);
    uint64_t next = submit_short(rig, 32);
    assert_int_equal(remote_cancel(rig->remote, job).code, RESULT_OK);
    assert_int_equal(rig_wait_job(rig, job).state, JOB_CANCELLED);
    rig_image_hash(rig, job);
    rig_assert_reference(rig, next);
}

static void time_ends_a_job(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, BATCH_INTERVAL);
    rig_start_worker(rig);
    job_settings_t settings = rig_settings();
    settings.spp = JOB_MAX_SPP;
    settings.time_limit = 1.5;
    uint64_t job = rig_submit(rig, &settings);
    double start = clock_now();
    rig_status_t status = rig_wait_job(rig, job);
    assert_int_equal(status.state, JOB_DONE);
    assert_true(status.samples_done > 0);
    assert_true(clock_now() - start < 20);
    rig_image_hash(rig, job);
}

/* It would wait for as long as its time-out says, two minutes for an image, if it did not see the connection
 * break. */
static void a_client_sees_the_end_of_its_master(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, BATCH_INTERVAL); /* with a client whose time-out is a minute */
    kill(rig->master, SIGSTOP);
    assert_int_equal(waitpid(rig->master, NULL, WUNTRACED), rig->master); /* not a thread of it answers */
    pid_t killer = fork();
    if (killer == 0) {
        rig_sleep(1);
        kill(rig->master, SIGKILL);
        _exit(0);
    }
    wire_message_t message;
    double start = clock_now();
    result_t result = remote_status(rig->remote, 0, &message);
    if (result.code != RESULT_UNREACHABLE || !strstr(result.message, "broke") || clock_now() - start > 15)
        fail_msg("after %.1f s: %d, %s", clock_now() - start, (int)result.code, result.message);
    waitpid(killer, NULL, 0);
}

int main(void)
{
#define FAULT(test) cmocka_unit_test_setup_teardown(test, rig_set_up, rig_tear_down)
    const struct CMUnitTest tests[] = {
        FAULT(a_killed_worker_is_replaced),
        FAULT(a_stopped_worker_is_replaced_and_comes_back),
        FAULT(a_straggler_counts_nothing_twice),
        FAULT(the_last_worker_dies_and_a_new_one_finishes),
        FAULT(a_late_worker_joins),
        FAULT(a_worker_sent_away_leaves_its_work),
        FAULT(a_worker_waits_for_its_master),
        FAULT(a_worker_outlives_its_master),
        FAULT(a_stopped_master_goes_on),
        FAULT(a_client_sees_the_end_of_its_master),
        FAULT(two_jobs_in_a_row),
        FAULT(a_cancelled_job_keeps_its_image),
        FAULT(time_ends_a_job),
    };
    return cmocka_run_group_tests_name("faults", tests, NULL, NULL);
}
