/* The commands as people use them: exit codes, messages, interrupts, outputs. */
#include "tests/rig.h"
#include "tests/scratch.h"

#include "common/image/image.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

#define SCENE "scenes/seed-hidden"

/* Runs a command; it must end with this code and say this (NULL: anything). */
static void expect(rig_t *rig, int code, const char *said, const char *const *arguments)
{
    pid_t process = rig_start_command(rig, arguments);
    int got = rig_wait_exit(rig, process, 60);
    char *output = rig_output(rig, process);
    if (got != code) fail_msg("exit code %d instead of %d: %s", got, code, output);
    if (said && !strstr(output, said)) fail_msg("'%s' is not in: %s", said, output);
    free(output);
}

/* A blob that was written renders to the same pixels as its scene. */
static void an_imported_scene_is_the_scene(void **state)
{
    rig_t *rig = *state;
    char *blob = scratch_path(rig->folder, "scene.blob"), *a = scratch_path(rig->folder, "a.exr");
    char *b = scratch_path(rig->folder, "b.exr");
    expect(rig, 0, "wrote", ARGUMENTS("import", "scenes/textures", "-o", blob));
    expect(rig, 0, NULL, ARGUMENTS("render", blob, "--spp", "2", "--quiet", "-o", a));
    expect(rig, 0, NULL, ARGUMENTS("render", "scenes/textures", "--spp", "2", "--quiet", "-o", b));
    hash_t hash_a = rig_file_hash(a), hash_b = rig_file_hash(b);
    assert_true(hash_equal(&hash_a, &hash_b));
    expect(rig, RESULT_IO, "cannot", ARGUMENTS("import", "scenes/textures", "-o", "/nowhere/scene.blob"));
    expect(rig, RESULT_USAGE, "expects SCENE", ARGUMENTS("import"));
    free(blob);
    free(a);
    free(b);
}

static void wrong_usage_is_told(void **state)
{
    rig_t *rig = *state;
    expect(rig, RESULT_USAGE, "no command", ARGUMENTS("--"));
    expect(rig, RESULT_USAGE, "no command", ARGUMENTS("rendr"));
    expect(rig, RESULT_USAGE, "--spp takes", ARGUMENTS("render", SCENE, "--spp", "0"));
    expect(rig, RESULT_USAGE, "--resolution", ARGUMENTS("render", SCENE, "--resolution", "64"));
    expect(rig, RESULT_USAGE, "--integrator", ARGUMENTS("render", SCENE, "--integrator", "magic"));
    expect(rig, RESULT_USAGE, "must end in", ARGUMENTS("render", SCENE, "-o", "image.jpg"));
    expect(rig, RESULT_USAGE, "expects SCENE", ARGUMENTS("render"));
    expect(rig, RESULT_USAGE, "address", ARGUMENTS("status", "--master", "host:port"));
    expect(rig, RESULT_USAGE, "--verify takes a share", ARGUMENTS("submit", SCENE, "--verify", "101%"));
    expect(rig, RESULT_USAGE, "--priority takes", ARGUMENTS("submit", SCENE, "--priority", "1001"));
    expect(rig, RESULT_USAGE, "between 0 and 1", ARGUMENTS("extend", "1", "--error", "0"));
    expect(rig, RESULT_USAGE, "between 0 and 1", ARGUMENTS("submit", SCENE, "--error", "200%"));
    expect(rig, RESULT_USAGE, "need --wait", ARGUMENTS("submit", SCENE, "--png", "never.png"));
    expect(rig, RESULT_USAGE, "belong together",
           ARGUMENTS("extend", "1", "--spp", "9", "--png", "never.png"));
    expect(rig, RESULT_USAGE, "--spp takes", ARGUMENTS("extend", "1", "--spp", "many"));
    expect(rig, RESULT_USAGE, "expects JOB N", ARGUMENTS("priority", "1"));
    expect(rig, RESULT_USAGE, "no job number", ARGUMENTS("pause", "1", "two"));
    expect(rig, RESULT_USAGE, "expects JOB...", ARGUMENTS("delete"));
    expect(rig, RESULT_USAGE, "too many: '2'", ARGUMENTS("status", "1", "2"));
    expect(rig, 0, "JOB...", ARGUMENTS("retain", "--help"));
    expect(rig, 0, "--master-key", ARGUMENTS("status", "--help"));
    expect(rig, 0, "--error E", ARGUMENTS("extend", "--help"));
    expect(rig, 0, "Exit codes", ARGUMENTS("--help"));
    expect(rig, 0, LIGHTMILL_VERSION, ARGUMENTS("--version"));
    expect(rig, 0, "--workers", ARGUMENTS("render", "--help"));
}

static void wrong_files_are_told(void **state)
{
    rig_t *rig = *state;
    char *bad = scratch_path(rig->folder, "bad.pbrt"), *cut = scratch_path(rig->folder, "cut.blob");
    char *good = scratch_path(rig->folder, "good.exr");
    scratch_write(bad, "WorldBegin\nShape \"trianglemesh\" \"integer indices\" [0 1", 55);
    scratch_write(cut, "not a scene", 11);
    expect(rig, RESULT_INPUT, "missing.pbrt", ARGUMENTS("render", "missing.pbrt"));
    expect(rig, RESULT_INPUT, "bad.pbrt", ARGUMENTS("render", bad));
    expect(rig, RESULT_INPUT, "cut.blob", ARGUMENTS("render", cut));
    expect(rig, RESULT_IO, "cannot be written", ARGUMENTS("render", SCENE, "-o", "/nonexistent/a.exr"));
    expect(rig, RESULT_IO, "cannot be written",
           ARGUMENTS("render", SCENE, "-o", good, "--png", "/proc/a.png"));
    free(bad);
    free(cut);
    free(good);
}

static void an_unreachable_master_is_told(void **state)
{
    rig_t *rig = *state;
    char *address = mem_printf("127.0.0.1:%d", rig->port);
    double start = clock_now();
    expect(rig, RESULT_UNREACHABLE, address, ARGUMENTS("status", "--master", address, "--timeout", "0.3"));
    expect(rig, RESULT_UNREACHABLE, "lightmill-master",
           ARGUMENTS("submit", SCENE, "--master", address, "--timeout", "0.3"));
    expect(rig, RESULT_UNREACHABLE, address,
           ARGUMENTS("fetch", "1", "-o", "/tmp/never.exr", "--master", address, "--timeout", "0.3"));
    expect(rig, RESULT_UNREACHABLE, address,
           ARGUMENTS("cancel", "1", "--master", address, "--timeout", "0.3"));
    assert_true(clock_now() - start < 30);
    free(address);
}

static void assert_image(const char *path, int width, int height)
{
    image_t image;
    result_t result = image_read_exr(path, &image);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    assert_int_equal(image.width, width);
    assert_int_equal(image.height, height);
    image_free(&image);
}

/* Renders without end, sends a signal, and looks for the image: there is none when it has not even begun,
 * which takes a busy machine longer. */
static void interrupt_render(rig_t *rig, int number, const char *option, const char *value)
{
    char *path = scratch_path(rig->folder, "interrupted.exr"),
         *png = scratch_path(rig->folder, "interrupted.png");
    for (double seconds = 2; seconds < 50 && access(path, F_OK) != 0; seconds *= 3) {
        pid_t process =
            rig_start_command(rig, ARGUMENTS("render", SCENE, "--resolution", "40x30", "--spp", "1000000000",
                                             "-o", path, "--png", png, option, value));
        rig_sleep(seconds);
        kill(process, number);
        assert_int_equal(rig_wait_exit(rig, process, 60), RESULT_CANCELLED);
    }
    assert_image(path, 40, 30);
    assert_int_equal(access(png, R_OK), 0);
    unlink(path);
    unlink(png);
    free(path);
    free(png);
}

static void an_interrupted_render_writes_what_it_has(void **state)
{
    interrupt_render(*state, SIGINT, "--threads", "2");
    interrupt_render(*state, SIGHUP, "--workers", "2"); /* the terminal was closed */
}

static void time_limits_a_render(void **state)
{
    rig_t *rig = *state;
    char *png = scratch_path(rig->folder, "timed.png");
    double start = clock_now();
    expect(rig, 0, "wrote", ARGUMENTS("render", SCENE, "--time", "1", "-o", png));
    assert_true(clock_now() - start < 30);
    assert_int_equal(access(png, R_OK), 0);
    free(png);
}

static void submit_status_fetch_cancel(void **state)
{
    rig_t *rig = *state;
    char *address = mem_printf("127.0.0.1:%d", rig->port), *path = scratch_path(rig->folder, "submitted.exr");
    rig_start_master(rig, 0.2);
    rig_start_worker(rig);
    expect(rig, 0, "wrote",
           ARGUMENTS("submit", SCENE, "--master", address, "--wait", "-o", path, "--spp", "4", "--name",
                     "quick"));
    assert_image(path, 128, 128);
    expect(rig, 0, "quick", ARGUMENTS("status", "--master", address));
    expect(rig, 0, "\"state\": \"done\"", ARGUMENTS("status", "1", "--json", "--master", address));
    expect(rig, 0, "2", ARGUMENTS("submit", SCENE, "--master", address, "--spp", "1000000000"));
    rig_wait_samples(rig, 2, 1);
    expect(rig, 0, "wrote", ARGUMENTS("fetch", "2", "--half", "-o", path, "--master", address));
    expect(rig, 0, NULL, ARGUMENTS("cancel", "2", "--master", address));
    assert_int_equal(rig_wait_job(rig, 2).state, JOB_CANCELLED);
    pid_t process = rig_start_command(rig, ARGUMENTS("cancel", "77", "--master", address));
    assert_int_not_equal(rig_wait_exit(rig, process, 60), 0);
    free(address);
    free(path);
}

/* Ctrl-C ends the waiting and not the job; a second one does not wait for a master that is silent. */
static void an_interrupt_ends_the_waiting(void **state)
{
    rig_t *rig = *state;
    char *address = mem_printf("127.0.0.1:%d", rig->port), *path = scratch_path(rig->folder, "waited.exr");
    rig_start_master(rig, 0.2);
    pid_t process = rig_start_command(
        rig, ARGUMENTS("submit", SCENE, "--spp", "4", "--master", address, "--wait", "-o", path));
    rig_wait_output(rig, process, "1\n");
    rig_sleep(0.5);
    kill(process, SIGINT);
    assert_int_equal(rig_wait_exit(rig, process, 10), RESULT_CANCELLED);
    rig_wait_output(rig, process, "the job goes on");
    expect(rig, RESULT_INPUT, "no samples yet", ARGUMENTS("fetch", "1", "-o", path, "--master", address));
    process = rig_start_command(
        rig, ARGUMENTS("fetch", "1", "--wait", "-o", path, "--master", address, "--timeout", "60"));
    rig_sleep(1);
    kill(rig->master, SIGSTOP);
    rig_sleep(0.5);
    kill(process, SIGINT);
    rig_sleep(0.5);
    kill(process, SIGINT);
    assert_int_equal(rig_wait_exit(rig, process, 5), RESULT_CANCELLED);
    kill(rig->master, SIGCONT);
    free(address);
    free(path);
}

static void kill_children(pid_t parent)
{
    char *path = mem_printf("/proc/%d/task/%d/children", (int)parent, (int)parent);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    int child, killed = 0;
    for (; fscanf(file, "%d", &child) == 1; killed++) kill(child, SIGKILL);
    assert_true(killed > 0);
    fclose(file);
    free(path);
}

/* All worker processes of a local farm die: an error, and what was counted is written. */
static void a_render_without_workers_ends(void **state)
{
    rig_t *rig = *state;
    char *path = scratch_path(rig->folder, "orphan.exr");
    pid_t process = rig_start_command(rig, ARGUMENTS("render", SCENE, "--resolution", "40x30", "--spp",
                                                     "1000000000", "--workers", "1", "-o", path));
    rig_sleep(2);
    kill_children(process);
    assert_int_equal(rig_wait_exit(rig, process, 60), RESULT_IO);
    assert_image(path, 40, 30);
    free(path);
}

int main(void)
{
#define COMMAND(test) cmocka_unit_test_setup_teardown(test, rig_set_up, rig_tear_down)
    const struct CMUnitTest tests[] = {
        COMMAND(an_imported_scene_is_the_scene),
        COMMAND(wrong_usage_is_told),
        COMMAND(wrong_files_are_told),
        COMMAND(an_unreachable_master_is_told),
        COMMAND(an_interrupted_render_writes_what_it_has),
        COMMAND(time_limits_a_render),
        COMMAND(submit_status_fetch_cancel),
        COMMAND(an_interrupt_ends_the_waiting),
        COMMAND(a_render_without_workers_ends),
    };
    return cmocka_run_group_tests_name("commands", tests, NULL, NULL);
}
