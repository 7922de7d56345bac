/* Telling that jobs are over, with real masters, workers, commands and a real HTTP server: also when it
 * fails, hangs or is killed in between. */
#include "tests/hook.h"
#include "tests/rig.h"
#include "tests/scratch.h"

#include <jansson.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

static const double INTERVAL = 0.2; /* seconds between batches */
static const double PATIENCE = 60;  /* seconds for anything */

static int set_up(void **state)
{
    rig_t *rig = rig_new();
    setenv("FOLDER", rig->folder, 1);
    rig->data = scratch_path(rig->folder, "data");
    *state = rig;
    return 0;
}

static void start_master(rig_t *rig, const char *target)
{
    rig_start_master_on(rig, rig->data, INTERVAL, (const char *[]){"--notify", target, NULL});
}

/* A job of a moment. */
static uint64_t submit(rig_t *rig)
{
    job_settings_t settings = rig_settings();
    settings.width = settings.height = 16;
    settings.spp = 2;
    return rig_submit(rig, &settings);
}

static void cancel(rig_t *rig, uint64_t job)
{
    assert_int_equal(remote_cancel(rig->remote, job).code, RESULT_OK);
}

/* A command that is wrong: it ends with exit code 1, and says this. */
static void assert_refused(rig_t *rig, const char *const *arguments, const char *why)
{
    pid_t process = rig_start_command(rig, arguments);
    assert_int_equal(rig_wait_exit(rig, process, PATIENCE), 1);
    char *text = rig_output(rig, process);
    if (strstr(text, why) == NULL) fail_msg("not \"%s\" but: %s", why, text);
    free(text);
}

/* The JSON at the end of a text. */
static json_t *json_of(const char *text)
{
    json_error_t error;
    const char *begin = strchr(text, '{');
    json_t *object = json_loads(begin != NULL ? begin : text, 0, &error);
    if (object == NULL) fail_msg("%s: %s", error.text, text);
    return object;
}

static const char *string_of(const json_t *object, const char *key)
{
    return json_string_value(json_object_get(object, key));
}

/* What the hook got as its request `index`: it tells of this job in this state. */
static json_t *told(hook_t *hook, size_t index, uint64_t job, const char *job_state)
{
    char *request = hook_wait(hook, index, PATIENCE);
    json_t *object = json_of(request);
    assert_int_equal(json_integer_value(json_object_get(object, "job")), job);
    assert_string_equal(string_of(object, "state"), job_state);
    free(request);
    return object;
}

static void assert_told(hook_t *hook, size_t index, uint64_t job, const char *job_state)
{
    json_decref(told(hook, index, job, job_state));
}

/* Waits until the file has something in it: its text, fresh memory. */
static char *wait_file(rig_t *rig, const char *name)
{
    char *path = scratch_path(rig->folder, name);
    double deadline = clock_now() + PATIENCE;
    while (access(path, R_OK) != 0) {
        if (clock_now() > deadline) fail_msg("there is no %s", path);
        rig_sleep(0.01);
    }
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    char *text = mem_zalloc(1, size + 1);
    memcpy(text, bytes, size);
    free(bytes);
    free(path);
    return text;
}

/* ---- the master ---------------------------------------------------------------------------------------- */

static void a_hook_that_fails_twice_is_told_that_a_job_is_done(void **state)
{
    rig_t *rig = *state;
    hook_t *hook = hook_start(0, (int[]){503, 500, 204}, 3);
    start_master(rig, hook_url(hook));
    rig_start_worker(rig);
    uint64_t job = submit(rig);
    for (size_t i = 0; i < 2; i++) assert_told(hook, i, job, "done");
    json_t *object = told(hook, 2, job, "done");
    assert_int_equal(json_integer_value(json_object_get(object, "samples")), 16 * 16 * 2);
    assert_string_equal(string_of(object, "name"), "test");
    assert_int_equal(access(string_of(object, "image"), R_OK), 0); /* absolute, whatever --data is */
    assert_int_equal(string_of(object, "image")[0], '/');
    json_decref(object);
    rig_wait_output(rig, rig->master, "was told that it is done");
    assert_int_equal(hook_count(hook), 3);
    char *log = rig_output(rig, rig->master);
    assert_non_null(strstr(log, "status 503"));
    assert_null(strstr(log, "/secret")); /* a URL may be one */
    free(log);
    hook_stop(&hook);
}

/* The master is killed while nobody can be told. */
static void what_was_not_told_is_told_after_a_restart_and_once(void **state)
{
    rig_t *rig = *state;
    int port = rig_free_ports();
    char *url = mem_printf("http://127.0.0.1:%d/secret", port);
    start_master(rig, url);
    uint64_t job = submit(rig);
    cancel(rig, job);
    rig_wait_output(rig, rig->master, "nobody is told yet");
    rig_kill_master(rig);
    hook_t *hook = hook_start(port, (int[]){200}, 1);
    start_master(rig, url);
    assert_told(hook, 0, job, "cancelled");
    rig_wait_output(rig, rig->master, "was told that it is cancelled");
    rig_sleep(2); /* the journal has it */
    rig_kill_master(rig);
    start_master(rig, url);
    uint64_t next = submit(rig);
    cancel(rig, next);
    assert_told(hook, 1, next, "cancelled"); /* not the first one again */
    hook_stop(&hook);
    free(url);
}

/* A process group, whose orphans become our children, was ended by a signal. */
static void assert_ended(pid_t group)
{
    double deadline = clock_now() + PATIENCE;
    int status;
    while (waitpid(group, &status, WNOHANG) == 0) {
        if (clock_now() > deadline) fail_msg("process group %d lives", -(int)group);
        rig_sleep(0.01);
    }
    assert_true(WIFSIGNALED(status));
}

static void a_command_that_hangs_holds_nothing_up(void **state)
{
    rig_t *rig = *state;
    prctl(PR_SET_CHILD_SUBREAPER, 1);
    start_master(rig, "echo $$ >$FOLDER/new; mv $FOLDER/new $FOLDER/hangs; sleep 1000");
    rig_start_worker(rig);
    cancel(rig, submit(rig));
    char *process = wait_file(rig, "hangs");
    for (int i = 0; i < 3; i++) assert_int_equal(rig_wait_job(rig, submit(rig)).state, JOB_DONE);
    kill(rig->master, SIGTERM); /* nor the end of the master */
    assert_int_equal(rig_wait_exit(rig, rig->master, 20), 0);
    rig->master = 0;
    assert_ended(-(pid_t)strtol(process, NULL, 10)); /* and nothing is left of it */
    free(process);
}

/* The scene of a job that waits is deleted while no master looks. */
static void a_lost_scene_is_told_of_once(void **state)
{
    rig_t *rig = *state;
    hook_t *hook = hook_start(0, (int[]){200}, 1);
    start_master(rig, hook_url(hook));
    uint64_t job = submit(rig);
    rig_kill_master(rig);
    char *blobs = scratch_path(rig->data, "blobs");
    scratch_destroy(&blobs);
    start_master(rig, hook_url(hook));
    json_t *object = told(hook, 0, job, "paused");
    assert_non_null(strstr(string_of(object, "message"), "its scene is not in the data directory"));
    json_decref(object);
    rig_wait_output(rig, rig->master, "was told that it is paused");
    rig_sleep(2); /* the journal has it */
    rig_kill_master(rig);
    start_master(rig, hook_url(hook));
    cancel(rig, job);
    assert_told(hook, 1, job, "cancelled");
    hook_stop(&hook);
}

static void the_environment_names_the_target_too(void **state)
{
    rig_t *rig = *state;
    setenv("LIGHTMILL_NOTIFY", "env >$FOLDER/new; mv $FOLDER/new $FOLDER/told", 1);
    rig_start_master_on(rig, rig->data, INTERVAL, NULL);
    unsetenv("LIGHTMILL_NOTIFY");
    cancel(rig, submit(rig));
    char *environment = wait_file(rig, "told");
    assert_non_null(strstr(environment, "LIGHTMILL_TEXT=job 1 (test) is cancelled\n"));
    assert_null(strstr(environment, "LIGHTMILL_NOTIFY"));
    free(environment);
}

/* ---- the client ---------------------------------------------------------------------------------------- */

#define SCENE "scenes/seed-hidden", "--resolution", "16x16", "--spp", "2", "--quiet"

static void render_tells_where_its_image_is(void **state)
{
    rig_t *rig = *state;
    char *image = scratch_path(rig->folder, "a.exr");
    const char *const arguments[] = {
        "render", SCENE, "-o", image, "--notify", "test -s \"$LIGHTMILL_IMAGE\" && cat >$FOLDER/told", NULL};
    assert_int_equal(rig_run(rig, arguments), 0);
    char *text = wait_file(rig, "told");
    json_t *object = json_of(text);
    assert_string_equal(string_of(object, "state"), "done");
    assert_string_equal(string_of(object, "name"), "seed-hidden");
    char *path = realpath(image, NULL);
    assert_string_equal(string_of(object, "image"), path);
    free(path);
    json_decref(object);
    free(text);
    free(image);
}

/* Ctrl-C ends the render; its image so far is written, and told of. */
static void an_interrupted_render_tells_that_it_is_cancelled(void **state)
{
    rig_t *rig = *state;
    char *image = scratch_path(rig->folder, "a.exr");
    const char *const arguments[] = {"render",
                                     "scenes/seed-hidden",
                                     "--resolution",
                                     "16x16",
                                     "--time",
                                     "100",
                                     "--verbose",
                                     "-o",
                                     image,
                                     "--notify",
                                     "cat >$FOLDER/new; mv $FOLDER/new $FOLDER/told",
                                     NULL};
    pid_t process = rig_start_command(rig, arguments);
    rig_wait_output(rig, process, "merged in");
    kill(process, SIGINT);
    assert_int_not_equal(rig_wait_exit(rig, process, PATIENCE), 0);
    char *text = wait_file(rig, "told");
    json_t *object = json_of(text);
    assert_string_equal(string_of(object, "state"), "cancelled");
    assert_string_equal(string_of(object, "message"), "interrupted");
    assert_true(json_integer_value(json_object_get(object, "samples")) > 0);
    assert_int_equal(access(string_of(object, "image"), R_OK), 0);
    json_decref(object);
    free(text);
    free(image);
}

static void a_client_that_waits_tells_by_itself(void **state)
{
    rig_t *rig = *state;
    hook_t *hook = hook_start(0, (int[]){503, 200}, 2);
    rig_start_master_on(rig, rig->data, INTERVAL, NULL);
    rig_start_worker(rig);
    char *address = mem_printf("127.0.0.1:%d", rig->port), *image = scratch_path(rig->folder, "a.exr");
    const char *const submit_it[] = {"submit", SCENE,      "--wait", "-o",       image,          "--name",
                                     "it",     "--master", address,  "--notify", hook_url(hook), NULL};
    assert_int_equal(rig_run(rig, submit_it), 0);
    json_t *object = told(hook, 1, 1, "done");
    assert_string_equal(string_of(object, "name"), "it");
    json_decref(object);
    const char *const fetch_it[] = {"fetch",    "1",     "--wait",   "-o",           image,
                                    "--master", address, "--notify", hook_url(hook), NULL};
    assert_int_equal(rig_run(rig, fetch_it), 0);
    assert_told(hook, 2, 1, "done");
    const char *const extend_it[] = {"extend", "1",        "--spp", "4",        "--wait",       "-o",
                                     image,    "--master", address, "--notify", hook_url(hook), NULL};
    assert_int_equal(rig_run(rig, extend_it), 0);
    assert_told(hook, 3, 1, "done");
    assert_int_equal(hook_count(hook), 4);
    free(address);
    free(image);
    hook_stop(&hook);
}

static void telling_without_waiting_is_refused(void **state)
{
    rig_t *rig = *state;
    static const char *const lines[][6] = {{"submit", "scenes/cornell", "--notify", "true"},
                                           {"fetch", "1", "-o", "a.exr", "--notify", "true"},
                                           {"extend", "1", "--notify", "true"}};
    for (size_t i = 0; i < ARRAY_LENGTH(lines); i++) {
        const char *arguments[7] = {NULL};
        memcpy(arguments, lines[i], sizeof lines[i]);
        assert_refused(rig, arguments, "--notify needs --wait");
    }
}

static void what_cannot_be_told_is_refused(void **state)
{
    rig_t *rig = *state;
    const char *const strategies[] = {"render", SCENE, "--strategies", "--notify", "true", NULL};
    const char *const other_scheme[] = {"render", SCENE, "--notify", "ftp://example.org/x", NULL};
    assert_refused(rig, strategies, "--notify tells of one job");
    assert_refused(rig, other_scheme, "http:// and https:// only");
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, rig_tear_down)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(a_hook_that_fails_twice_is_told_that_a_job_is_done),
        TEST(what_was_not_told_is_told_after_a_restart_and_once),
        TEST(a_command_that_hangs_holds_nothing_up),
        TEST(a_lost_scene_is_told_of_once),
        TEST(the_environment_names_the_target_too),
        TEST(render_tells_where_its_image_is),
        TEST(an_interrupted_render_tells_that_it_is_cancelled),
        TEST(a_client_that_waits_tells_by_itself),
        TEST(telling_without_waiting_is_refused),
        TEST(what_cannot_be_told_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
