/* Leaving: what a worker process does when it is told to go, as Docker, Kubernetes, a batch system or a spot
 * market does it: SIGTERM, some seconds of grace, then a kill. */
#include "tests/rig.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double NO_BATCHES = 1000; /* seconds: what is counted came with a farewell */

static pid_t start_worker(rig_t *rig, const char *grace)
{
    char *address = mem_printf("127.0.0.1:%d", rig->port);
    char *cache = mem_printf("%s/cache-%d", rig->folder, rig->started_count);
    pid_t worker = rig_start_program(
        rig, "lightmill-worker",
        (const char *[]){address, "--threads", "2", "--cache", cache, "--grace", grace, "--verbose", NULL});
    free(address);
    free(cache);
    return worker;
}

static uint64_t submit(rig_t *rig)
{
    job_settings_t settings = rig_settings();
    return rig_submit(rig, &settings);
}

/* Waits until the worker's log has a text. */
static void await_log(rig_t *rig, pid_t worker, const char *text)
{
    for (double start = clock_now();; rig_sleep(0.02)) {
        char *log = rig_output(rig, worker);
        bool found = strstr(log, text) != NULL;
        free(log);
        if (found) return;
        if (clock_now() - start > 60) fail_msg("the worker never says \"%s\"", text);
    }
}

/* Waits until the worker is busy with the job, which it is for a second and more. */
static void await_work(rig_t *rig, uint64_t job)
{
    for (double start = clock_now(); rig_status(rig, job).issued == 0; rig_sleep(0.02))
        if (clock_now() - start > 60) fail_msg("the worker gets no work");
    rig_sleep(0.5);
}

static void what_was_begun_is_delivered(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, NO_BATCHES);
    pid_t worker = start_worker(rig, "30");
    uint64_t job = submit(rig);
    await_work(rig, job);
    kill(worker, SIGTERM);
    double start = clock_now();
    assert_int_equal(rig_wait_exit(rig, worker, 60), 0);
    assert_true(clock_now() - start < 20);
    rig_status_t status = rig_status(rig, job);
    assert_true(status.samples_done > 0);
    assert_int_equal(status.batches_refused, 0);
    rig_wait_workers(rig, 0);
    /* Another one goes on from there. */
    start_worker(rig, "30");
    assert_int_equal(rig_wait_job(rig, job).state, JOB_DONE);
    hash_t hash = rig_image_hash(rig, job), reference = rig_reference();
    assert_true(hash_equal(&hash, &reference));
}

static void an_idle_worker_survives_sighup_and_leaves_at_once(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, NO_BATCHES);
    pid_t worker = start_worker(rig, "30");
    rig_wait_workers(rig, 1);
    kill(worker, SIGHUP); /* does nothing */
    rig_sleep(0.5);
    rig_wait_workers(rig, 1);
    kill(worker, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, worker, 10), 0);
    rig_wait_workers(rig, 0);
}

static void a_worker_without_a_master_leaves_at_once(void **state)
{
    rig_t *rig = *state;
    pid_t worker = start_worker(rig, "30");
    rig_sleep(0.5);
    kill(worker, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, worker, 10), 0);
}

/* The master hangs: the grace period is all that the worker waits, and its exit code tells. */
static void the_grace_period_is_kept(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, NO_BATCHES);
    pid_t worker = start_worker(rig, "2");
    await_work(rig, submit(rig));
    kill(rig->master, SIGSTOP);
    kill(worker, SIGTERM);
    double start = clock_now();
    assert_int_equal(rig_wait_exit(rig, worker, 30), RESULT_UNREACHABLE);
    double took = clock_now() - start;
    assert_true(took > 1.5 && took < 8);
    kill(rig->master, SIGCONT);
    char *log = rig_output(rig, worker);
    assert_non_null(strstr(log, "not acknowledged within 2 s"));
    free(log);
}

static void twice_means_now(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, NO_BATCHES);
    pid_t worker = start_worker(rig, "60");
    await_work(rig, submit(rig));
    kill(rig->master, SIGSTOP);
    kill(worker, SIGTERM);
    await_log(rig, worker, "leaving");
    double start = clock_now();
    kill(worker, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, worker, 10), RESULT_CANCELLED);
    assert_true(clock_now() - start < 5);
    kill(rig->master, SIGCONT);
}

static void a_wrong_grace_is_refused(void **state)
{
    rig_t *rig = *state;
    const char *const wrong[] = {"-1", "soon", "1e9"};
    for (size_t i = 0; i < ARRAY_LENGTH(wrong); i++) {
        pid_t worker = start_worker(rig, wrong[i]);
        assert_int_equal(rig_wait_exit(rig, worker, 10), RESULT_USAGE);
        char *log = rig_output(rig, worker);
        assert_non_null(strstr(log, "--grace"));
        free(log);
    }
}

int main(void)
{
#define DRAIN(test) cmocka_unit_test_setup_teardown(test, rig_set_up_with_reference, rig_tear_down)
    const struct CMUnitTest tests[] = {
        DRAIN(what_was_begun_is_delivered),
        DRAIN(an_idle_worker_survives_sighup_and_leaves_at_once),
        DRAIN(a_worker_without_a_master_leaves_at_once),
        DRAIN(the_grace_period_is_kept),
        DRAIN(twice_means_now),
        DRAIN(a_wrong_grace_is_refused),
    };
    return cmocka_run_group_tests_name("drain", tests, NULL, NULL);
}
