/* What people do with the jobs of a farm: pause, extend, delete, ask in JSON, wait over a restart. With the
 * programs as they are. */
#include "tests/rig.h"
#include "tests/scratch.h"

#include <jansson.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

#define SCENE "scenes/seed-hidden"

static const double INTERVAL = 0.2; /* seconds between batches */

static int set_up(void **state)
{
    rig_t *rig = *state = rig_new();
    char *address = mem_printf("127.0.0.1:%d", rig->port);
    setenv("LIGHTMILL_MASTER", address, 1);
    free(address);
    return 0;
}

/* Runs a command that must end with this code; returns what it said. */
static char *run(rig_t *rig, int code, const char *const *arguments)
{
    pid_t process = rig_start_command(rig, arguments);
    int got = rig_wait_exit(rig, process, 60);
    char *output = rig_output(rig, process);
    if (got != code) fail_msg("exit code %d instead of %d: %s", got, code, output);
    return output;
}

/* The same; it must say this (NULL: anything). */
static void expect(rig_t *rig, int code, const char *said, const char *const *arguments)
{
    char *output = run(rig, code, arguments);
    if (said && !strstr(output, said)) fail_msg("'%s' is not in: %s", said, output);
    free(output);
}

/* The status as a program sees it. */
static json_t *status_json(rig_t *rig, const char *option)
{
    json_error_t error;
    char *text = run(rig, 0, ARGUMENTS("status", "--json", option));
    json_t *root = json_loads(text, 0, &error);
    if (root == NULL) fail_msg("%s in: %s", error.text, text);
    free(text);
    return root;
}

static double number(const json_t *object, const char *key)
{
    const json_t *value = json_object_get(object, key);
    if (!json_is_number(value)) fail_msg("\"%s\" is no number", key);
    return json_number_value(value);
}

static void assert_text(const json_t *object, const char *key, const char *expected)
{
    const json_t *value = json_object_get(object, key);
    if (!json_is_string(value)) fail_msg("\"%s\" is no string", key);
    assert_string_equal(json_string_value(value), expected);
}

/* A submission without end; its number. */
static uint64_t submit_endless(rig_t *rig, const char *name, const char *priority)
{
    char *output = run(rig, 0,
                       ARGUMENTS("submit", SCENE, "--spp", "1000000000", "--resolution", "64x64", "--name",
                                 name, "--priority", priority, "--no-learn"));
    uint64_t job = strtoull(output, NULL, 10);
    assert_true(job > 0);
    free(output);
    return job;
}

static void wait_state(rig_t *rig, uint64_t job, job_state_t state)
{
    double start = clock_now();
    while (rig_status(rig, job).state != (uint32_t)state) {
        if (clock_now() - start > 60)
            fail_msg("job %d does not become %s", (int)job, job_state_name((uint32_t)state));
        rig_sleep(0.05);
    }
}

static void json_says_all_of_a_job(rig_t *rig, const char *name)
{
    json_t *root = status_json(rig, "--workers");
    assert_int_equal(number(root, "workers"), 1);
    json_t *jobs = json_object_get(root, "jobs"), *job = json_array_get(jobs, 0);
    assert_int_equal(json_array_size(jobs), 1);
    assert_int_equal(number(job, "job"), 1);
    assert_text(job, "name", name);
    assert_text(job, "state", "running");
    assert_text(job, "integrator", "bdpt");
    assert_text(job, "message", "");
    assert_int_equal(number(job, "priority"), -3);
    assert_true(json_is_false(json_object_get(job, "retained")));
    assert_true(number(job, "samples_issued") == number(job, "samples_counted") +
                                                     number(job, "samples_returned") +
                                                     number(job, "samples_out"));
    assert_true(number(job, "samples_done") == number(job, "samples_counted"));
    assert_true(number(job, "elapsed") > 0);
    assert_true(number(job, "submitted") > 1.6e9);
    static const char *const others[] = {"samples_total",  "samples_skipped",
                                         "batches",        "batches_refused",
                                         "units_reissued", "error",
                                         "error_target",   "remaining",
                                         "checkpoint_age", "checks_passed",
                                         "checks_failed",  "verify",
                                         "light_paths",    "rays",
                                         "ended"};
    for (size_t i = 0; i < ARRAY_LENGTH(others); i++) number(job, others[i]);
    assert_true(json_is_array(json_object_get(root, "worker_list")));
    json_decref(root);
}

static void the_life_of_a_job_in_orders(void **state)
{
    rig_t *rig = *state;
    char *image = scratch_path(rig->folder, "image.exr");
    rig_start_master(rig, INTERVAL);
    rig_start_worker(rig);
    uint64_t job = submit_endless(rig, "\"quoted\"\tJob \xC3\xA9", "-3");
    assert_int_equal(job, 1);
    rig_wait_samples(rig, job, 1);
    json_says_all_of_a_job(rig, "\"quoted\"?Job \xC3\xA9");
    expect(rig, RESULT_INPUT, "cancel it first", ARGUMENTS("delete", "1"));

    expect(rig, 0, NULL, ARGUMENTS("pause", "1"));
    expect(rig, 0, "paused", ARGUMENTS("status"));
    expect(rig, RESULT_INPUT, "nothing to pause", ARGUMENTS("pause", "1"));
    rig_sleep(1.5); /* the workers send what they have */
    json_t *root = status_json(rig, "1"), *paused = json_array_get(json_object_get(root, "jobs"), 0);
    double done = number(paused, "samples_done"), elapsed = number(paused, "elapsed");
    assert_int_equal(number(paused, "samples_out"), 0);
    json_decref(root);
    rig_sleep(1);
    root = status_json(rig, "1");
    paused = json_array_get(json_object_get(root, "jobs"), 0);
    assert_true(number(paused, "samples_done") == done);
    assert_true(number(paused, "elapsed") == elapsed);
    json_decref(root);
    expect(rig, 0, "wrote", ARGUMENTS("fetch", "1", "-o", image)); /* its film is there */

    expect(rig, 0, NULL, ARGUMENTS("resume", "1"));
    rig_wait_samples(rig, job, (uint64_t)done + 1);
    expect(rig, 0, NULL, ARGUMENTS("priority", "1", "-7"));
    expect(rig, 0, "  -7 ", ARGUMENTS("status"));
    expect(rig, 0, NULL, ARGUMENTS("priority", "1", "--", "-8"));
    expect(rig, 0, "  -8 ", ARGUMENTS("status"));
    expect(rig, 0, NULL, ARGUMENTS("priority", "1", "7"));
    expect(rig, 0, "   7 ", ARGUMENTS("status"));
    expect(rig, RESULT_USAGE, "from -1000 to 1000", ARGUMENTS("priority", "1", "1001"));
    expect(rig, 0, NULL, ARGUMENTS("retain", "1"));
    expect(rig, 0, "retained", ARGUMENTS("status"));
    expect(rig, 0, NULL, ARGUMENTS("cancel", "1"));
    assert_int_equal(rig_wait_job(rig, job).state, JOB_CANCELLED);
    expect(rig, RESULT_INPUT, "already", ARGUMENTS("cancel", "1"));
    expect(rig, RESULT_INPUT, "already", ARGUMENTS("extend", "1", "--spp", "1"));
    expect(rig, 0, "wrote", ARGUMENTS("fetch", "1", "-o", image));
    expect(rig, 0, "issued", ARGUMENTS("status", "1"));
    expect(rig, 0, NULL, ARGUMENTS("release", "1"));
    expect(rig, RESULT_INPUT, "no job 2", ARGUMENTS("delete", "1", "2"));
    expect(rig, RESULT_INPUT, "no job 1", ARGUMENTS("status", "1"));
    char *kept = mem_printf("%s/job-1.exr", rig->data);
    assert_int_not_equal(access(kept, F_OK), 0);
    free(kept);
    free(image);
}

/* What `lightmill render` makes of so many samples. */
static hash_t rendered(rig_t *rig, const char *spp)
{
    char *path = scratch_path(rig->folder, "rendered.exr");
    assert_int_equal(rig_run(rig, ARGUMENTS("render", SCENE, "--resolution", "64x64", "--spp", spp, "--quiet",
                                            "-o", path)),
                     0);
    hash_t hash = rig_file_hash(path);
    free(path);
    return hash;
}

/* True when the history of job 1 has a point of so many samples a pixel; it must be rising. */
static bool has_point(rig_t *rig, int spp)
{
    bool found = false;
    double before = 0;
    json_t *root = status_json(rig, "1");
    json_t *list = json_object_get(json_array_get(json_object_get(root, "jobs"), 0), "history");
    assert_true(json_is_array(list));
    for (size_t i = 0; i < json_array_size(list); i++) {
        const json_t *point = json_array_get(list, i);
        assert_true(number(point, "samples") > before);
        assert_true(number(point, "error") > 0 && number(point, "elapsed") > 0);
        before = number(point, "samples");
        found = found || before == 64 * 64 * spp;
    }
    json_decref(root);
    return found;
}

static void an_extended_job_has_the_bits_of_a_longer_one(void **state)
{
    rig_t *rig = *state;
    char *path = scratch_path(rig->folder, "extended.exr");
    rig_start_master(rig, INTERVAL);
    rig_start_worker(rig);
    rig_start_worker(rig);
    expect(rig, 0, "wrote",
           ARGUMENTS("submit", SCENE, "--resolution", "64x64", "--spp", "6", "--wait", "-o", path));
    expect(rig, RESULT_INPUT, "how far", ARGUMENTS("extend", "1"));
    expect(rig, RESULT_INPUT, "already", ARGUMENTS("extend", "1", "--spp", "6"));
    expect(rig, RESULT_USAGE, "belong together", ARGUMENTS("extend", "1", "--spp", "9", "--wait"));
    expect(rig, 0, "wrote", ARGUMENTS("extend", "1", "--spp", "21", "--wait", "-o", path));
    hash_t expected = rendered(rig, "21"), got = rig_file_hash(path);
    assert_true(hash_equal(&expected, &got));

    rig_kill_master(rig);
    rig_restart_master(rig, INTERVAL);
    assert_int_equal(rig_status(rig, 1).state, JOB_DONE);
    got = rig_image_hash(rig, 1); /* it is still there, */
    assert_true(hash_equal(&expected, &got));
    assert_true(has_point(rig, 6) && has_point(rig, 21)); /* and so is the history of its error */
    expect(rig, 0, "wrote", ARGUMENTS("extend", "1", "--spp", "40", "--wait", "-o", path));
    expected = rendered(rig, "40");
    got = rig_file_hash(path);
    assert_true(hash_equal(&expected, &got));
    rig_status_t status = rig_status(rig, 1);
    assert_int_equal(status.samples_done, 40 * 64 * 64);
    assert_int_equal(status.samples_total, 40 * 64 * 64);
    assert_true(has_point(rig, 6) && has_point(rig, 21) && has_point(rig, 40));
    expect(rig, 0, "error against samples a pixel", ARGUMENTS("status", "1"));
    free(path);
}

static void wait_first_job(rig_t *rig)
{
    double start = clock_now();
    for (size_t jobs = 0; jobs == 0; rig_sleep(0.05)) {
        wire_message_t message;
        assert_int_equal(remote_status(rig->remote, 0, &message).code, RESULT_OK);
        jobs = message.envelope->job_status_reply->n_jobs;
        wire_free(&message);
        if (clock_now() - start > 60) fail_msg("no job is submitted");
    }
}

static void a_waiting_client_outlives_its_master(void **state)
{
    rig_t *rig = *state;
    char *path = scratch_path(rig->folder, "patient.exr");
    rig_start_master(rig, INTERVAL);
    rig_start_worker(rig);
    pid_t client = rig_start_command(rig, ARGUMENTS("submit", SCENE, "--resolution", "64x64", "--spp",
                                                    "1073741824", "--wait", "-o", path, "--timeout", "0.5"));
    wait_first_job(rig);
    rig_wait_samples(rig, 1, 1);
    rig_kill_master(rig);
    rig_sleep(1.5);
    rig_restart_master(rig, INTERVAL);
    rig_wait_output(rig, client, "the master is back");
    rig_end_job(rig, 1);
    int code = rig_wait_exit(rig, client, 200);
    char *output = rig_output(rig, client);
    if (code != 0) fail_msg("exit code %d: %s", code, output);
    assert_non_null(strstr(output, "asking on"));
    char *spp = mem_printf("%d", (int)(rig_status(rig, 1).samples_total / RIG_PIXELS));
    hash_t expected = rendered(rig, spp), got = rig_file_hash(path);
    assert_true(hash_equal(&expected, &got));
    free(spp);
    free(output);
    free(path);
}

/* Waits until a process has said something so many times. */
static void wait_said(rig_t *rig, pid_t process, const char *what, int times)
{
    double start = clock_now();
    for (int count = 0; count < times; rig_sleep(0.05)) {
        char *output = rig_output(rig, process);
        count = 0;
        for (const char *at = output; (at = strstr(at, what)) != NULL; at++) count++;
        free(output);
        if (clock_now() - start > 60) fail_msg("'%s' is said %d times", what, count);
    }
}

static void a_status_is_watched_until_ctrl_c(void **state)
{
    rig_t *rig = *state;
    expect(rig, RESULT_USAGE, "--watch takes", ARGUMENTS("status", "--watch=0"));
    rig_start_master(rig, INTERVAL);
    pid_t lines = rig_start_command(rig, ARGUMENTS("status", "--watch=0.1", "--timeout", "0.5"));
    pid_t objects = rig_start_command(rig, ARGUMENTS("status", "--watch=0.1", "--json"));
    wait_said(rig, lines, "0 workers connected", 3);
    wait_said(rig, objects, "{\"workers\": 0, \"jobs\": []}\n", 3);
    kill(objects, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, objects, 20), 0);
    rig_kill_master(rig);
    rig_wait_output(rig, lines, "asking on");
    rig_restart_master(rig, INTERVAL);
    rig_wait_output(rig, lines, "the master is back");
    kill(lines, SIGINT);
    assert_int_equal(rig_wait_exit(rig, lines, 20), 0);
}

static void jobs_share_and_priorities_rule(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, INTERVAL);
    rig_start_worker(rig);
    rig_start_worker(rig);
    rig_wait_workers(rig, 2);
    uint64_t a = submit_endless(rig, "a", "0"), b = submit_endless(rig, "b", "0");
    rig_wait_samples(rig, a, 1);
    rig_wait_samples(rig, b, 1);
    double done[2] = {(double)rig_status(rig, a).samples_done, (double)rig_status(rig, b).samples_done};
    double gain[2] = {0, 0}, start = clock_now();
    bool even = false; /* what is shared is time: a busy machine may slow one of the workers for a while */
    while (!(even && gain[0] + gain[1] > 4e5) && clock_now() - start < 100) {
        rig_sleep(3);
        gain[0] = (double)rig_status(rig, a).samples_done - done[0];
        gain[1] = (double)rig_status(rig, b).samples_done - done[1];
        even = gain[0] > 0.5 * gain[1] && gain[1] > 0.5 * gain[0];
    }
    if (!even) fail_msg("%g and %g samples of two jobs alike", gain[0], gain[1]);
    uint64_t urgent = submit_endless(rig, "urgent", "10");
    rig_wait_samples(rig, urgent, 1);
    rig_sleep(3); /* what was out is in */
    uint64_t before = rig_status(rig, a).samples_done + rig_status(rig, b).samples_done;
    rig_sleep(1);
    assert_int_equal(rig_status(rig, a).samples_done + rig_status(rig, b).samples_done, before);
    wait_state(rig, a, JOB_RUNNING);
    expect(rig, 0, NULL, ARGUMENTS("cancel", "3"));
    rig_wait_samples(rig, a, (uint64_t)done[0] + (uint64_t)gain[0] + 1);
}

int main(void)
{
#define JOBS(test) cmocka_unit_test_setup_teardown(test, set_up, rig_tear_down)
    const struct CMUnitTest tests[] = {
        JOBS(the_life_of_a_job_in_orders),      JOBS(an_extended_job_has_the_bits_of_a_longer_one),
        JOBS(a_status_is_watched_until_ctrl_c), JOBS(a_waiting_client_outlives_its_master),
        JOBS(jobs_share_and_priorities_rule),
    };
    return cmocka_run_group_tests_name("jobs", tests, NULL, NULL);
}
