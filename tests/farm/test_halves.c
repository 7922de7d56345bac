/* The two halves of a picture (--halves), with real processes: their mean is the picture, they can be fetched
 * while the job works, and afterwards as long as its film is kept or if it was submitted so. */
#include "common/image/image.h"
#include "tests/rig.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static int set_up(void **state)
{
    rig_t *rig = rig_new();
    rig_start_master(rig, 0.1);
    rig_start_worker(rig);
    *state = rig;
    return 0;
}

/* Finds a channel of the image; NULL when it has none. */
static const image_channel_t *find(const image_t *image, const char *layer, char colour)
{
    char name[20];
    snprintf(name, sizeof name, "%s%c", layer, colour);
    for (size_t i = 0; i < image->channel_count; i++)
        if (strcmp(image->channels[i].name, name) == 0) return &image->channels[i];
    return NULL;
}

static float value(const image_channel_t *channel, size_t pixel)
{
    assert_non_null(channel);
    return channel->data[pixel * channel->stride];
}

/* `share`: of the samples of the whole that half 0 has. */
static void assert_mean(const char *path, double share, double tolerance)
{
    image_t image;
    size_t different = 0;
    assert_int_equal(image_read_exr(path, &image).code, RESULT_OK);
    for (const char *c = "RGB"; *c != '\0'; c++)
        for (size_t p = 0; p < (size_t)image.width * (size_t)image.height; p++) {
            double half[2] = {(double)value(find(&image, "half0.", *c), p),
                              (double)value(find(&image, "half1.", *c), p)};
            double whole = (double)value(find(&image, "", *c), p);
            double mean = share * half[0] + (1 - share) * half[1];
            if (fabs(mean - whole) > tolerance * (1e-3 + whole))
                fail_msg("%s, pixel %zu: the halves mean %g, the picture is %g", path, p, mean, whole);
            different += fabs(half[0] - half[1]) > 1e-3 * whole;
        }
    assert_true(different > 1000); /* they are estimates of their own */
    image_free(&image);
}

static bool has_halves(const char *path)
{
    image_t image;
    assert_int_equal(image_read_exr(path, &image).code, RESULT_OK);
    bool has = find(&image, "half0.", 'R') != NULL;
    image_free(&image);
    return has;
}

static void the_mean_of_the_halves_is_the_picture(void **state)
{
    rig_t *rig = *state;
    char *path = scratch_path(rig->folder, "out.exr");
    const char *const render[] = {"render",   "scenes/cornell", "--resolution", "64x64", "--spp", "5",
                                  "--halves", "--quiet",        "-o",           path,    NULL};
    assert_int_equal(rig_run(rig, render), 0);
    assert_mean(path, 3.0 / 5, 1e-5);
    free(path);
}

/* Runs `fetch` with one more argument or none (NULL), and gives its exit code and what it said. */
static int fetch(rig_t *rig, const char *job, const char *path, const char *option, char **said)
{
    char *master = mem_printf("127.0.0.1:%d", rig->port);
    const char *const arguments[] = {"fetch", job, "--halves", "-o", path, "--master", master, option, NULL};
    pid_t process = rig_start_command(rig, arguments);
    int code = rig_wait_exit(rig, process, 60);
    *said = rig_output(rig, process);
    free(master);
    return code;
}

static void assert_says(char *said, const char *text)
{
    if (strstr(said, text) == NULL) fail_msg("this does not say \"%s\": %s", text, said);
    free(said);
}

static void a_job_that_works_can_be_asked_for_them(void **state)
{
    rig_t *rig = *state;
    job_settings_t settings = rig_settings();
    settings.spp = 1 << 20;
    uint64_t job = rig_submit(rig, &settings);
    char *path = scratch_path(rig->folder, "half.exr"), *said;
    rig_wait_samples(rig, job, 1);
    if (fetch(rig, "1", path, "--half", &said) != 0) fail_msg("%s", said);
    free(said);
    assert_true(has_halves(path));
    free(path);
}

/* Deletes the films of the master, as if others had needed their place, by a master that keeps none. */
static void forget_films(rig_t *rig)
{
    char *data = mem_strdup(rig->data);
    rig_kill_master(rig);
    rig_start_master_on(rig, data, 0.1, (const char *[]){"--keep", "0", NULL});
    free(data);
}

static void a_job_that_is_over_too_as_long_as_its_film_is_kept(void **state)
{
    rig_t *rig = *state;
    job_settings_t settings = rig_settings();
    settings.spp = 6;
    settings.save_at = (save_at_t){1, {4}};
    char *path = scratch_path(rig->folder, "half.exr"), *said;
    hash_t plain;
    uint64_t job = rig_submit(rig, &settings);
    assert_int_equal(rig_wait_job(rig, job).state, JOB_DONE);
    plain = rig_image_hash(rig, job);
    if (fetch(rig, "1", path, "--wait", &said) != 0) fail_msg("%s", said);
    free(said);
    assert_mean(path, 0.5, 1e-5);
    hash_t after = rig_image_hash(rig, job); /* the image that is kept is as it was */
    assert_true(hash_equal(&plain, &after));
    /* There is no film of what it was on the way. */
    assert_int_not_equal(fetch(rig, "1", path, "--at=4", &said), 0);
    assert_says(said, "submitted without --halves");
    forget_films(rig);
    assert_int_not_equal(fetch(rig, "1", path, NULL, &said), 0);
    assert_says(said, "submit it again with --halves");
    free(path);
}

static void images_of_a_job_that_keeps_them_have_them(void **state)
{
    rig_t *rig = *state;
    job_settings_t settings = rig_settings();
    settings.spp = 8;
    settings.save_at = (save_at_t){1, {4}};
    uint64_t job = rig_submit_on(rig, &settings, &(job_terms_t){.name = "kept", .halves = true});
    char *path = scratch_path(rig->folder, "out.exr"), *said;
    assert_int_equal(rig_wait_job(rig, job).state, JOB_DONE);
    if (fetch(rig, "1", path, NULL, &said) != 0) fail_msg("%s", said);
    free(said);
    assert_mean(path, 0.5, 1e-5);
    if (fetch(rig, "1", path, "--at=4", &said) != 0) fail_msg("%s", said);
    free(said);
    assert_mean(path, 0.5, 1e-5);
    if (fetch(rig, "1", path, "--half", &said) != 0) fail_msg("%s", said);
    free(said);
    assert_mean(path, 0.5, 2e-3);
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(the_mean_of_the_halves_is_the_picture, set_up, rig_tear_down),
        cmocka_unit_test_setup_teardown(a_job_that_works_can_be_asked_for_them, set_up, rig_tear_down),
        cmocka_unit_test_setup_teardown(a_job_that_is_over_too_as_long_as_its_film_is_kept, set_up,
                                        rig_tear_down),
        cmocka_unit_test_setup_teardown(images_of_a_job_that_keeps_them_have_them, set_up, rig_tear_down),
    };
    return cmocka_run_group_tests_name("halves", tests, NULL, NULL);
}
