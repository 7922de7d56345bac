/* Light groups on real farms: the picture keeps its bits, the groups add up to it, and they are the same in
 * one process, and on a farm with a relay, verification and a master that is killed. */
#include "common/image/image.h"
#include "tests/rig.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

#ifdef __SANITIZE_THREAD__
enum { SPP = 1 };
#else
enum { SPP = 8 };
#endif

static image_t read_image(const char *path)
{
    image_t image;
    assert_string_equal(image_read_exr(path, &image).message, "");
    return image;
}

/* Renders the scene of everything, with one or two options more. */
static image_t render(const rig_t *rig, const char *option, const char *value, const char *more,
                      const char *number)
{
    char *path = scratch_path(rig->folder, "image.exr"), *spp = mem_printf("%d", SPP);
    assert_int_equal(
        rig_run((rig_t *)rig, (const char *[]){"render", "tests/farm/everything.pbrt", "--spp", spp,
                                               "--quiet", "-o", path, option, value, more, number, NULL}),
        0);
    image_t image = read_image(path);
    free(path);
    free(spp);
    return image;
}

/* The values of channel "eye.R" or "light.B" of all groups together are those of the image. */
static void expect_sum(const image_t *image, const char *part)
{
    const image_channel_t *whole = image_find(image, part);
    size_t pixels = (size_t)image->width * (size_t)image->height, groups = 0;
    double *sum = mem_zalloc(pixels, sizeof *sum);
    for (size_t i = 0; i < image->channel_count; i++) {
        const image_channel_t *channel = &image->channels[i];
        size_t length = strlen(channel->name), end = strlen(part);
        if (strncmp(channel->name, "group.", 6) != 0 || length < end ||
            strcmp(channel->name + length - end, part) != 0)
            continue;
        groups++;
        for (size_t p = 0; p < pixels; p++) sum[p] += (double)channel->data[p * channel->stride];
    }
    assert_int_equal(groups, 4); /* infinite, distant, area and the rest: projection and spot */
    for (size_t p = 0; p < pixels; p++)
        if (!(fabs(sum[p] - (double)whole->data[p]) <= 2e-6 * (fabs(sum[p]) + 1e-3)))
            fail_msg("%s of pixel %zu is %g, the groups have %g", part, p, (double)whole->data[p], sum[p]);
    free(sum);
}

static void groups_add_up_and_leave_the_picture_alone(void **state)
{
    rig_t *rig = *state;
    static const char groups[] = "sky=infinite,sun=distant,lamp=everything.pbrt:73";
    image_t plain = render(rig, "--threads", "2", NULL, NULL);
    image_t one = render(rig, "--threads", "1", "--light-groups", groups);
    image_t two = render(rig, "--workers", "2", "--light-groups", groups);
    hash_t hash = image_hash(&one), other = image_hash(&two);
    assert_true(hash_equal(&hash, &other));
    assert_int_equal(one.channel_count, plain.channel_count + 4 * 6);
    assert_string_equal(image_attribute(&one, "lightmill.lightGroups")->text,
                        "sky=infinite,sun=distant,lamp=2,rest");
    for (size_t i = 0; i < plain.channel_count; i++) {
        const image_channel_t *channel = &plain.channels[i], *same = image_find(&one, channel->name);
        for (size_t p = 0; p < (size_t)plain.width * (size_t)plain.height; p++)
            assert_memory_equal(&channel->data[p * channel->stride], &same->data[p * same->stride],
                                sizeof(float));
    }
    static const char *const parts[] = {"eye.R", "eye.G", "eye.B", "light.R", "light.G", "light.B"};
    for (size_t i = 0; i < ARRAY_LENGTH(parts); i++) expect_sum(&one, parts[i]);
    image_free(&plain);
    image_free(&one);
    image_free(&two);
}

/* The mix of all groups is the picture; without a group it is the picture less that group. */
static void mixes_are_made_of_what_was_rendered(void **state)
{
    rig_t *rig = *state;
    image_t image = render(rig, "--threads", "2", "--light-groups", "kinds");
    char *from = scratch_path(rig->folder, "image.exr"), *to = scratch_path(rig->folder, "mix.exr");
    for (int out = 0; out < 2; out++) {
        assert_int_equal(rig_run(rig, (const char *[]){"mix", from, "-o", to, out ? "spot=0" : NULL, NULL}),
                         0);
        image_t mixed = read_image(to);
        for (int c = 0; c < 3; c++) {
            const char colour[] = {"RGB"[c], 0};
            char *eye = mem_printf("group.spot.eye.%s", colour),
                 *light = mem_printf("group.spot.light.%s", colour);
            const image_channel_t *was = image_find(&image, colour), *is = image_find(&mixed, colour);
            const image_channel_t *parts[] = {image_find(&image, eye), image_find(&image, light)};
            double most = 0;
            for (size_t p = 0; p < (size_t)image.width * (size_t)image.height; p++) {
                double less = out ? (double)parts[0]->data[p] + (double)parts[1]->data[p] : 0;
                most = fmax(most, less);
                if (!(fabs((double)was->data[p] - less - (double)is->data[p]) <= 1e-5 * (double)was->data[p]))
                    fail_msg("pixel %zu is %g, was %g, less %g", p, (double)is->data[p], (double)was->data[p],
                             less);
            }
            assert_true(!out || most > 0);
            free(eye);
            free(light);
        }
        image_free(&mixed);
    }
    image_free(&image);
    free(from);
    free(to);
}

static char *at_port(int port)
{
    return mem_printf("127.0.0.1:%d", port);
}

/* A relay below the rig's master, with a worker; both write to the rig's folder. */
static void start_relay_and_worker(rig_t *rig)
{
    int port;
    do port = rig_free_ports();
    while (port == rig->port);
    char *master = at_port(rig->port), *listen = at_port(port);
    char *data = scratch_path(rig->folder, "relay"), *cache = scratch_path(rig->folder, "cache-below");
    pid_t relay =
        rig_start_program(rig, "lightmill-relay",
                          (const char *[]){master, "--listen", listen, "--data", data, "--heartbeat", "0.2",
                                           "--lease", "1", "--batch-interval", "0.2", "--verbose", NULL});
    rig_wait_output(rig, relay, "listening on");
    rig_start_program(rig, "lightmill-worker",
                      (const char *[]){listen, "--threads", "1", "--cache", cache, NULL});
    free(master);
    free(listen);
    free(data);
    free(cache);
}

static hash_t local_hash(rig_t *rig, const job_settings_t *settings)
{
    char *path = scratch_path(rig->folder, "local.exr"), *spp = mem_printf("%u", settings->spp);
    assert_int_equal(
        rig_run(rig, (const char *[]){"render", "scenes/seed-hidden", "--spp", spp, "--seed", "7",
                                      "--resolution", "64x64", "--threads", "2", "--quiet", "-o", path,
                                      "--light-groups", settings->light_groups, NULL}),
        0);
    hash_t hash = rig_file_hash(path);
    free(path);
    free(spp);
    return hash;
}

static void any_farm_makes_the_same_groups(void **state)
{
    rig_t *rig = *state;
    job_settings_t settings = rig_settings();
    settings.spp /= 4;
    strcpy(settings.light_groups, "front=1,rest");
    hash_t expected = local_hash(rig, &settings);
    rig_start_master(rig, 0.2);
    start_relay_and_worker(rig);
    rig_start_worker(rig);
    rig_wait_workers(rig, 2);
    uint64_t job = rig_submit_on(rig, &settings, &(job_terms_t){.name = "groups", .verify = 0.2});
    rig_wait_samples(rig, job, 64 * 64 * settings.spp / 3);
    rig_kill_master(rig);
    rig_restart_master(rig, 0.2);
    rig_status_t status = rig_wait_job(rig, job);
    assert_int_equal(status.state, JOB_DONE);
    assert_true(status.samples_done == status.samples_total);
    hash_t hash = rig_image_hash(rig, job);
    assert_true(hash_equal(&hash, &expected));
}

/* Whoever submits past the command cannot make workers read beyond the lights of the scene. */
static void groups_of_another_scene_are_declined(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, 0.2);
    rig_start_worker(rig);
    rig_wait_workers(rig, 1);
    job_settings_t settings = rig_settings();
    strcpy(settings.light_groups, "a=0,b=7,rest");
    uint64_t job = rig_submit(rig, &settings);
    const char *why = "the scene has no light '7'";
    rig_status_t status = rig_status(rig, job);
    for (double deadline = clock_now() + 20; strstr(status.message, why) == NULL && clock_now() < deadline;) {
        rig_sleep(0.1);
        status = rig_status(rig, job);
    }
    assert_non_null(strstr(status.message, why));
    assert_int_equal(status.samples_done, 0);
}

static void mistakes_are_said_before_anything_is_done(void **state)
{
    rig_t *rig = *state;
    pid_t command = rig_start_command(
        rig, (const char *[]){"render", "scenes/seed-hidden", "--light-groups", "key=2", NULL});
    assert_int_equal(rig_wait_exit(rig, command, 30), 1);
    char *output = rig_output(rig, command);
    assert_non_null(strstr(output, "light group 'key': the scene has no light '2'; it has area (0-1)"));
    free(output);
}

#define TEST(function) cmocka_unit_test_setup_teardown(function, rig_set_up, rig_tear_down)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(groups_add_up_and_leave_the_picture_alone), TEST(mixes_are_made_of_what_was_rendered),
        TEST(any_farm_makes_the_same_groups), TEST(groups_of_another_scene_are_declined),
        TEST(mistakes_are_said_before_anything_is_done)};
    return cmocka_run_group_tests_name("light groups on a farm", tests, NULL, NULL);
}
