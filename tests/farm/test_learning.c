/* Jobs that learn, with real processes: plans change the picture, and what happens on the farm does not.
 * Workers and the master are killed in many passes, also right at the end of one, before the plan that
 * follows is made. */
#include "tests/rig.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double INTERVAL = 0.2; /* seconds between batches */
enum { PIXELS = 64 * 64 };

static hash_t render(const char *option)
{
    rig_t *rig = rig_new();
    char *path = scratch_path(rig->folder, "plain.exr");
    assert_int_equal(
        rig_run(rig, (const char *[]){"render", "scenes/seed-hidden", "--resolution", "64x64", "--spp", "64",
                                      "--seed", "7", "--quiet", "-o", path, option, NULL}),
        0);
    hash_t hash = rig_file_hash(path);
    free(path);
    rig_destroy(&rig);
    return hash;
}

static void plans_change_the_picture(void **state)
{
    (void)state;
    hash_t learned = rig_reference_at(64), plain = render("--no-learn");
    assert_false(hash_equal(&learned, &plain));
}

static void start_master(rig_t *rig, const char *data)
{
    rig_start_master_on(rig, data, INTERVAL, (const char *[]){"--checkpoint", "0.1", NULL});
}

static void kills_in_any_pass_make_no_difference(void **state)
{
    rig_t *rig = *state;
    char *data = scratch_new();
    /* Samples a pixel that are counted when something is killed: some are the end of a pass. */
    static const uint32_t at[] = {1, 2, 4, 7, 8, 16, 25, 32};
    start_master(rig, data);
    pid_t worker = rig_start_worker(rig);
    rig_start_worker(rig);
    uint64_t job = rig_submit_endless(rig);
    for (size_t i = 0; i < ARRAY_LENGTH(at); i++) {
        rig_wait_samples(rig, job, (uint64_t)at[i] * PIXELS);
        rig_kill_master(rig);
        if (i % 2 == 0) {
            kill(worker, SIGKILL);
            worker = rig_start_worker(rig);
        }
        start_master(rig, data);
    }
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
    scratch_destroy(&data);
}

/* It has seen nothing of the passes before, and needs the plans of those that come. */
static void late_workers_go_by_the_same_plans(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, INTERVAL);
    pid_t first = rig_start_worker(rig);
    uint64_t job = rig_submit_endless(rig);
    rig_wait_samples(rig, job, PIXELS * 20);
    rig_start_worker(rig);
    rig_wait_workers(rig, 2);
    kill(first, SIGKILL);
    rig_end_job(rig, job);
    rig_assert_reference(rig, job);
}

/* Checks are of any pass, and compare lessons too. */
static void checks_agree(void **state)
{
    rig_t *rig = *state;
    rig_start_master(rig, INTERVAL);
    for (int i = 0; i < 2; i++) rig_start_worker(rig);
    rig_wait_workers(rig, 2);
    job_settings_t settings = rig_settings();
    settings.spp /= 2;
    uint64_t job = rig_submit_on(rig, &settings, &(job_terms_t){.name = "test", .verify = 0.5});
    rig_assert_reference(rig, job);
    wire_message_t message;
    assert_int_equal(remote_status(rig->remote, job, &message).code, RESULT_OK);
    const Lm__JobStatus *status = message.envelope->job_status_reply->jobs[0];
    assert_true(status->checks_passed > 0);
    assert_int_equal(status->checks_failed, 0);
    wire_free(&message);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(plans_change_the_picture),
        cmocka_unit_test_setup_teardown(kills_in_any_pass_make_no_difference, rig_set_up, rig_tear_down),
        cmocka_unit_test_setup_teardown(late_workers_go_by_the_same_plans, rig_set_up, rig_tear_down),
        cmocka_unit_test_setup_teardown(checks_agree, rig_set_up, rig_tear_down),
    };
    return cmocka_run_group_tests_name("learning", tests, NULL, NULL);
}
