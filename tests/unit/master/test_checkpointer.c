/* The checkpointer's thread: how often it writes on a slow disk. The farm is real, a test plays the worker;
 * the disk takes a while for each flush, so that 2 % of the time would be one checkpoint in 15 seconds. */
#include "common/wake.h"
#include "master/threads/checkpointer.h"
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

/* The disk: a checkpoint flushes its file and its folder. */
int fsync(int file)
{
    usleep(150000);
    return (int)syscall(SYS_fsync, file);
}

static void must(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

typedef struct {
    char *folder;
    farm_t *farm;
    film_store_t *films;
    journal_t *journal;
    checkpointer_t *checkpointer;
    int wake;
    uint64_t job, worker;
} test_t;

static int set_up(void **state)
{
    test_t *t = mem_zalloc(1, sizeof *t);
    t->folder = scratch_new();
    must(wake_new(&t->wake));
    farm_options_t options = {.lease = 100,
                              .batch_interval = 0.05,
                              .film_limit = (uint64_t)1 << 32,
                              .first_job = 1,
                              .control_wake = -1,
                              .image_wake = -1,
                              .journal_writer_wake = -1,
                              .news_wake = -1,
                              .checkpoint_wake = t->wake,
                              .grant_wake = -1};
    log_init("test", LOG_ERROR);
    t->farm = farm_new(&options);
    char *path = scratch_path(t->folder, "lightmill.db");
    must(journal_open(path, true, &t->journal));
    free(path);
    must(film_store_open(t->folder, &t->films));
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    test_t *t = *state;
    farm_shut_down(t->farm);
    checkpointer_stop(&t->checkpointer);
    farm_destroy(&t->farm);
    film_store_close(&t->films);
    journal_close(&t->journal);
    wake_close(t->wake);
    scratch_destroy(&t->folder);
    free(t);
    return 0;
}

/* Begins a job and the thread that keeps it. */
static void start(test_t *t, double interval, double most)
{
    job_settings_t settings = toy_settings();
    settings.spp = 1 << 20;
    t->job = toy_submit(t->farm, clock_now(), &settings, 0);
    t->worker = toy_hello(t->farm, clock_now(), 1);
    checkpointer_options_t options = {.farm = t->farm,
                                      .films = t->films,
                                      .journal = t->journal,
                                      .interval = interval,
                                      .most = most,
                                      .keep_bytes = 1,
                                      .checkpoint_wake = t->wake};
    must(checkpointer_start(&options, &t->checkpointer));
}

static void deliver(test_t *t)
{
    toy_work_t work = toy_take(t->farm, clock_now(), t->worker, 1, 1);
    assert_int_equal(work.job, t->job);
    must(toy_deliver_work(t->farm, clock_now(), t->worker, &work, 0));
}

/* The number of the last checkpoint; 0: there is none. */
static uint64_t generation(test_t *t)
{
    size_t count;
    film_file_t *files = film_store_list(t->films, t->job, &count);
    uint64_t last = count > 0 ? files[0].generation : 0;
    free(files);
    return last;
}

/* Works until there are so many checkpoints: how long that took, seconds. */
static double work_until(test_t *t, uint64_t checkpoints)
{
    double begin = clock_now();
    while (generation(t) < checkpoints) {
        deliver(t);
        usleep(20000);
        if (clock_now() - begin > 60) fail_msg("no checkpoint %d in a minute", (int)checkpoints);
    }
    return clock_now() - begin;
}

/* With 2 % of the time alone these four would take a minute. */
static void a_slow_disk_is_written_within_the_bound(void **state)
{
    test_t *t = *state;
    start(t, 0.1, 1);
    work_until(t, 1);
    assert_true(work_until(t, 5) < 10);
}

/* The bound is for what would take longer; what takes little goes on as before. */
static void the_bound_makes_none_more_often(void **state)
{
    test_t *t = *state;
    start(t, 0.1, 100);
    work_until(t, 1);
    double begin = clock_now();
    while (clock_now() - begin < 2) {
        deliver(t);
        usleep(20000);
    }
    assert_int_equal(generation(t), 1);
}

/* Nothing was counted for longer than the bound: what comes then is as young as any other. */
static void work_that_comes_after_a_pause_is_not_old(void **state)
{
    test_t *t = *state;
    start(t, 0.1, 1);
    work_until(t, 1);
    for (uint64_t before = 0; before != generation(t);) { /* all is saved */
        before = generation(t);
        usleep(1500000);
    }
    double age;
    bool last;
    assert_null(farm_next_checkpoint(t->farm, clock_now(), &age, &last));
    usleep(500000);
    deliver(t);
    job_t *job = farm_next_checkpoint(t->farm, clock_now(), &age, &last);
    assert_non_null(job);
    farm_unpin(t->farm, job);
    assert_true(age < 0.5);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_slow_disk_is_written_within_the_bound, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_bound_makes_none_more_often, set_up, tear_down),
        cmocka_unit_test_setup_teardown(work_that_comes_after_a_pause_is_not_old, set_up, tear_down),
    };
    return cmocka_run_group_tests_name("checkpointer", tests, NULL, NULL);
}
