/* Jobs in an image viewer (render --display, show): what the viewer has put together is the image of the
 * file, bit by bit; it may come late, be killed and come again; and no viewer, however bad, keeps a render
 * up. */
#include "tests/rig.h"
#include "tests/scratch.h"
#include "tests/tev.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double PATIENCE = 120; /* seconds */
#define SCENE "scenes/cornell"

static void assert_told(rig_t *rig, pid_t process, const char *text)
{
    char *output = rig_output(rig, process);
    if (strstr(output, text) == NULL) fail_msg("no '%s' in: %s", text, output);
    free(output);
}

static void a_render_is_shown_as_it_converges(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    tev_t *tev = tev_start(rig->folder, 0, false);
    char *path = scratch_path(rig->folder, "image.exr");
    const char *const arguments[] = {"render", SCENE, "-o",        path,         "--resolution", "200x300",
                                     "--time", "2",   "--display", tev->address, "--quiet",      NULL};
    pid_t render = rig_start_command(rig, arguments);
    char *layout = tev_wait(tev, "create ", PATIENCE);
    assert_non_null(layout);
    assert_int_equal(strncmp(layout, "200x300 R,G,B,", 14), 0);
    assert_non_null(strstr(layout, ",albedo.R,"));
    assert_non_null(strstr(layout, path));
    free(layout);
    tev_shown_t first;
    assert_true(tev_wait_shown(tev, PATIENCE, &first));
    assert_true(first.updates > 0); /* a slow viewer may have a part of one picture then, or the last one */
    assert_int_equal(rig_wait_exit(rig, render, PATIENCE), 0);
    hash_t hash = rig_file_hash(path);
    tev_expect_hash_after(tev, &first, &hash);
    free(tev_wait(tev, "closed", PATIENCE));
    free(path);
    tev_kill(&tev);
    rig_destroy(&rig);
}

/* A worker that is stopped but for a moment has rendered some tiles only. */
static void only_tiles_with_new_samples_are_sent(void **state)
{
    (void)state;
    enum { SIDE = 768, TILES = 12 * 12 };
    rig_t *rig = rig_new();
    rig_start_master(rig, 0.1);
    job_settings_t settings = rig_settings();
    settings.width = settings.height = SIDE;
    settings.integrator = INTEGRATOR_PATH;
    settings.features = false;
    settings.spp = 4096;
    uint64_t job = rig_submit(rig, &settings);
    tev_t *tev = tev_start(rig->folder, 0, false);
    char *number = mem_printf("%llu", (unsigned long long)job);
    char *master = mem_printf("127.0.0.1:%d", rig->port);
    const char *const show[] = {"show", number, "--display", tev->address, "--master", master, NULL};
    rig_start_command(rig, show);
    pid_t worker = rig_start_worker(rig);
    tev_shown_t shown;
    assert_true(tev_wait_shown(tev, PATIENCE, &shown));
    assert_true(shown.updates >= TILES);
    kill(worker, SIGSTOP);
    rig_sleep(0.5); /* what is on the wire arrives */
    hash_t hash = rig_image_hash(rig, job);
    tev_expect_hash_after(tev, &shown, &hash);
    kill(worker, SIGCONT);
    rig_wait_samples(rig, job, rig_status(rig, job).samples_done + 1);
    kill(worker, SIGSTOP);
    assert_true(tev_wait_shown(tev, PATIENCE, &shown));
    assert_true(shown.updates > 0 && shown.updates < TILES);
    kill(worker, SIGKILL);
    tev_kill(&tev);
    free(number);
    free(master);
    rig_destroy(&rig);
}

/* The same picture and the exit code of success, and no waiting for ever: a slow machine may take its time.
 */
static void no_viewer_keeps_a_render_up(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    tev_t *deaf = tev_start(rig->folder, 0, true);
    char *alone = scratch_path(rig->folder, "alone.exr"), *absent = scratch_path(rig->folder, "absent.exr");
    char *unread = scratch_path(rig->folder, "unread.exr");
    char *nobody = mem_printf("127.0.0.1:%d", rig->port);
#define RENDER(path) "render", SCENE, "--resolution", "300x300", "--spp", "2", "-o", path
    const char *const first[] = {RENDER(alone), NULL};
    const char *const second[] = {RENDER(absent), "--display", nobody, NULL};
    const char *const third[] = {RENDER(unread), "--display", deaf->address, NULL};
    double begin = clock_now();
    assert_int_equal(rig_run(rig, first), 0);
    double took = clock_now() - begin;
    hash_t hash = rig_file_hash(alone), other;
    pid_t process = rig_start_command(rig, second);
    assert_int_equal(rig_wait_exit(rig, process, 4 * took + 60), 0);
    other = rig_file_hash(absent);
    assert_true(hash_equal(&hash, &other));
    assert_told(rig, process, "no image viewer answers");
    assert_told(rig, process, "start tev");
    process = rig_start_command(rig, third);
    assert_int_equal(rig_wait_exit(rig, process, 4 * took + 60), 0);
    other = rig_file_hash(unread);
    assert_true(hash_equal(&hash, &other));
    assert_told(rig, process, "has not taken the last image");
    free(tev_wait(deaf, "connected", PATIENCE));
    free(alone);
    free(absent);
    free(unread);
    free(nobody);
    tev_kill(&deaf);
    rig_destroy(&rig);
}

static void a_job_is_shown_to_viewers_that_come_and_go(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    rig_start_master(rig, 0.2);
    job_settings_t settings = rig_settings();
    uint64_t job = rig_submit(rig, &settings);
    tev_t *tev = tev_start(rig->folder, 0, false);
    int port = tev->port;
    char *number = mem_printf("%llu", (unsigned long long)job);
    char *master = mem_printf("127.0.0.1:%d", rig->port), *viewer = mem_printf("127.0.0.1:%d", port);
    const char *const show[] = {"show", number, "--display", viewer, "--master", master, NULL};
    pid_t process = rig_start_command(rig, show);
    pid_t worker = rig_start_worker(rig);
    char *layout = tev_wait(tev, "create ", PATIENCE);
    assert_non_null(layout);
    assert_non_null(strstr(layout, ", job "));
    free(layout);
    tev_shown_t shown;
    assert_true(tev_wait_shown(tev, PATIENCE, &shown));
    unsigned tiles = shown.updates;
    tev_kill(&tev);
    tev = tev_start(rig->folder, port, false);
    assert_true(tev_wait_shown(tev, PATIENCE, &shown));
    assert_int_equal(shown.updates, tiles);
    assert_int_equal(rig_wait_job(rig, job).state, JOB_DONE);
    hash_t hash = rig_image_hash(rig, job);
    assert_int_equal(rig_wait_exit(rig, process, PATIENCE), 0);
    tev_expect_hash_after(tev, &shown, &hash);
    assert_told(rig, process, "is gone");
    assert_told(rig, process, "is there");
    /* A job that is over is shown as it is; without a viewer that fails after a while. */
    assert_int_equal(rig_run(rig, show), 0);
    tev_expect_hash(tev, &hash);
    tev_kill(&tev);
    process = rig_start_command(rig, show);
    assert_int_equal(rig_wait_exit(rig, process, PATIENCE), RESULT_UNREACHABLE);
    assert_told(rig, process, "start tev");
    kill(worker, SIGTERM);
    free(number);
    free(master);
    free(viewer);
    rig_destroy(&rig);
}

static void ctrl_c_ends_the_showing_and_not_the_job(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    rig_start_master(rig, 0.2);
    job_settings_t settings = rig_settings();
    uint64_t job = rig_submit(rig, &settings);
    tev_t *deaf = tev_start(rig->folder, 0, true);
    char *number = mem_printf("%llu", (unsigned long long)job);
    char *master = mem_printf("127.0.0.1:%d", rig->port);
    const char *const show[] = {"show", number, "--display", deaf->address, "--master", master, NULL};
    const char *const unknown[] = {"show", "99", "--display", deaf->address, "--master", master, NULL};
    pid_t process = rig_start_command(rig, show);
    free(tev_wait(deaf, "connected", PATIENCE));
    kill(process, SIGINT);
    assert_int_equal(rig_wait_exit(rig, process, 60), RESULT_CANCELLED);
    assert_told(rig, process, "the job goes on");
    assert_false(job_state_final(rig_status(rig, job).state));
    assert_int_equal(rig_run(rig, unknown), RESULT_INPUT);
    tev_kill(&deaf);
    free(number);
    free(master);
    rig_destroy(&rig);
}

static void what_cannot_be_shown_is_an_error_before_the_render(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    const char *const address[] = {"render", SCENE, "--display", "here:there", NULL};
    const char *const strategies[] = {"render", SCENE, "--strategies", "--display", "127.0.0.1", NULL};
    assert_int_equal(rig_run(rig, strategies), RESULT_USAGE);
    assert_int_equal(rig_run(rig, address), RESULT_USAGE);
    rig_destroy(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_render_is_shown_as_it_converges),
                                       cmocka_unit_test(only_tiles_with_new_samples_are_sent),
                                       cmocka_unit_test(no_viewer_keeps_a_render_up),
                                       cmocka_unit_test(a_job_is_shown_to_viewers_that_come_and_go),
                                       cmocka_unit_test(ctrl_c_ends_the_showing_and_not_the_job),
                                       cmocka_unit_test(what_cannot_be_shown_is_an_error_before_the_render)};
    return cmocka_run_group_tests_name("display", tests, NULL, NULL);
}
