/* Images at sample counts (--save-at), with real processes: each has the pixels of a render with so many
 * samples, on this machine and on a farm, also when the master is killed on the way. */
#include "tests/rig.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double INTERVAL = 0.2; /* seconds between batches */
static const uint32_t AT[] = {5, 24, 64};
enum { IMAGES = 3, SPP = 96 };

typedef struct {
    rig_t *rig;
    char *data;
} test_t;

static int set_up(void **state)
{
    test_t *t = mem_zalloc(1, sizeof *t);
    t->data = scratch_new();
    t->rig = rig_new();
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    test_t *t = *state;
    rig_destroy(&t->rig);
    scratch_destroy(&t->data);
    free(t);
    return 0;
}

static void assert_plain(const char *path, uint32_t spp)
{
    hash_t hash = rig_file_hash(path), plain = rig_reference_at(spp);
    if (!hash_equal(&hash, &plain)) fail_msg("%s is not the image at %u samples a pixel", path, spp);
}

static void assert_file_at(const test_t *t, uint64_t job, uint32_t spp)
{
    char *path = mem_printf("%s/job-%llu-at-%u.exr", t->data, (unsigned long long)job, spp);
    assert_plain(path, spp);
    free(path);
}

static void start_master(test_t *t)
{
    rig_start_master_on(t->rig, t->data, INTERVAL, (const char *[]){"--checkpoint", "0.1", NULL});
}

static uint64_t submit(test_t *t)
{
    job_settings_t settings = rig_settings();
    settings.spp = SPP;
    settings.save_at = (save_at_t){.count = IMAGES};
    memcpy(settings.save_at.spp, AT, sizeof AT);
    return rig_submit(t->rig, &settings);
}

static uint32_t saved(test_t *t, uint64_t job)
{
    wire_message_t message;
    assert_int_equal(remote_status(t->rig->remote, job, &message).code, RESULT_OK);
    uint32_t count = message.envelope->job_status_reply->jobs[0]->saved;
    wire_free(&message);
    return count;
}

static char *address(const test_t *t)
{
    return mem_printf("127.0.0.1:%d", t->rig->port);
}

static void a_render_writes_the_images_on_the_way(void **state)
{
    test_t *t = *state;
    char *path = scratch_path(t->rig->folder, "out.exr");
    assert_int_equal(
        rig_run(t->rig, (const char *[]){"render", "scenes/seed-hidden", "--resolution", "64x64", "--spp",
                                         "96", "--seed", "7", "--save-at", "5,24,64", "-o", path, NULL}),
        0);
    assert_plain(path, SPP);
    for (int i = 0; i < IMAGES; i++) {
        char *name = mem_printf("%s/out-%04u.exr", t->rig->folder, AT[i]);
        assert_plain(name, AT[i]);
        free(name);
    }
    free(path);
}

/* Killed in the first round, right after an image, and so on. */
static void a_killed_master_keeps_them_exact(void **state)
{
    test_t *t = *state;
    start_master(t);
    rig_start_worker(t->rig);
    rig_start_worker(t->rig);
    uint64_t job = submit(t);
    for (uint32_t i = 0; i < IMAGES; i++) {
        rig_wait_samples(t->rig, job, 64 * 64 * (i == 0 ? 1 : (uint64_t)AT[i - 1] + 1));
        rig_kill_master(t->rig);
        start_master(t);
        while (saved(t, job) < AT[i]) rig_sleep(0.01);
        rig_kill_master(t->rig);
        assert_file_at(t, job, AT[i]); /* it is on the disk as soon as the master says so */
        start_master(t);
    }
    assert_int_equal(rig_wait_job(t->rig, job).state, JOB_DONE);
    for (int i = 0; i < IMAGES; i++) assert_file_at(t, job, AT[i]);
    hash_t hash = rig_image_hash(t->rig, job), plain = rig_reference_at(SPP);
    assert_true(hash_equal(&hash, &plain));
}

static void they_are_fetched_and_deleted(void **state)
{
    test_t *t = *state;
    start_master(t);
    rig_start_worker(t->rig);
    uint64_t job = submit(t);
    char *path = scratch_path(t->rig->folder, "at.exr"), *master = address(t);
    const char *const fetch[] = {"fetch", "1", "--at", "24", "--wait", "-o", path, "--master", master, NULL};
    assert_int_equal(job, 1);
    assert_int_equal(rig_run(t->rig, fetch), 0);
    assert_plain(path, 24);
    const char *const other[] = {"fetch", "1", "--at", "25", "-o", path, "--master", master, NULL};
    pid_t failing = rig_start_command(t->rig, other);
    assert_int_not_equal(rig_wait_exit(t->rig, failing, 60), 0);
    rig_wait_output(t->rig, failing, "submit it with --save-at 25");
    assert_int_equal(rig_wait_job(t->rig, job).state, JOB_DONE);
    const char *const json[] = {"status", "1", "--json", "--master", master, NULL};
    rig_wait_output(t->rig, rig_start_command(t->rig, json), "\"saved\": 64");
    const char *const text[] = {"status", "1", "--master", master, NULL};
    rig_wait_output(t->rig, rig_start_command(t->rig, text), "kept at 5, 24, 64 samples a pixel");
    assert_int_equal(rig_run(t->rig, (const char *[]){"delete", "1", "--master", master, NULL}), 0);
    char *kept = mem_printf("%s/job-1-at-24.exr", t->data);
    for (int i = 0; i < 1000 && access(kept, F_OK) == 0; i++) rig_sleep(0.01);
    for (int i = 0; i < IMAGES; i++) {
        char *name = mem_printf("%s/job-1-at-%u.exr", t->data, AT[i]);
        assert_int_not_equal(access(name, F_OK), 0);
        free(name);
    }
    free(kept);
    free(master);
    free(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_render_writes_the_images_on_the_way, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_killed_master_keeps_them_exact, set_up, tear_down),
        cmocka_unit_test_setup_teardown(they_are_fetched_and_deleted, set_up, tear_down),
    };
    return cmocka_run_group_tests_name("save_at", tests, NULL, NULL);
}
