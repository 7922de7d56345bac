/* Links that are closed or thin: what a worker behind one says, asks for and delivers. The lines are those of
 * the chaos proxy, so that no rights are needed. */
#include "tests/chaos/proxy.h"
#include "tests/rig.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

#define FAR "127.0.0.3" /* where the worker dials */

typedef struct {
    rig_t *rig;
    proxy_t *proxy;
    proxy_link_t *link;
} line_t;

static int set_up(void **state)
{
    line_t *line = mem_zalloc(1, sizeof *line);
    line->rig = rig_new();
    result_t result = proxy_start((const char *[]){FAR}, 1, "127.0.0.1", line->rig->port, 1, &line->proxy);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    line->link = proxy_link(line->proxy, 0);
    *state = line;
    return 0;
}

static int tear_down(void **state)
{
    line_t *line = *state;
    rig_destroy(&line->rig);
    proxy_stop(&line->proxy);
    free(line);
    return 0;
}

static pid_t start_far_worker(line_t *line)
{
    char *address = mem_printf(FAR ":%d", line->rig->port), *cache = mem_printf("%s/far", line->rig->folder);
    pid_t worker = rig_start_program(
        line->rig, "lightmill-worker",
        (const char *[]){address, "--threads", "1", "--cache", cache, "--name", "far", "--verbose", NULL});
    free(address);
    free(cache);
    return worker;
}

/* It joins, and both logs say within ten seconds what is wrong; it takes no units, and works when the port is
 * open. */
static void a_closed_bulk_port_is_told_by_both(void **state)
{
    line_t *line = *state;
    rig_t *rig = line->rig;
    job_settings_t settings = rig_settings();
    settings.spp = 8;
    atomic_store(&line->link->bulk_closed, true);
    rig_start_master(rig, 0.5);
    uint64_t job = rig_submit(rig, &settings);
    double start = clock_now();
    pid_t worker = start_far_worker(line);
    char *at_worker =
        mem_printf("port %d of " FAR " does not answer: open it in the firewall", rig->port + 1);
    char *at_master = mem_printf("worker far at 127.0.0.1 gets no work: %s", at_worker);
    rig_wait_output(rig, worker, at_worker);
    rig_wait_output(rig, rig->master, at_master);
    assert_true(clock_now() - start < 10);
    rig_sleep(1.5);
    char *log = rig_output(rig, rig->master);
    const char *rest = strstr(log, at_master) + strlen(at_master);
    assert_null(strstr(rest, "gets no work")); /* once, and not with every try */
    assert_null(strstr(log, "silent"));
    rig_status_t status = rig_status(rig, job);
    assert_true(status.issued == 0 && status.out == 0);
    atomic_store(&line->link->bulk_closed, false);
    assert_int_equal(rig_wait_job(rig, job).state, JOB_DONE);
    free(log);
    free(at_worker);
    free(at_master);
}

/* At 1 Mbit/s and 1920 x 1080 samples count, and what is in hand is little. */
static void a_thin_link_delivers_and_hoards_nothing(void **state)
{
    line_t *line = *state;
    rig_t *rig = line->rig;
    job_settings_t settings = rig_settings();
    double most = 0;
    settings.width = 1920;
    settings.height = 1080;
    settings.spp = 1 << 20;
    settings.time_limit = 12;
    atomic_store(&line->link->bytes_per_second, 125000);
    rig_start_master(rig, 4);
    uint64_t job = rig_submit(rig, &settings);
    start_far_worker(line);
    rig_status_t status;
    for (status = rig_status(rig, job); !job_state_final(status.state); rig_sleep(0.1)) {
        most = fmax(most, (double)status.out);
        status = rig_status(rig, job);
    }
    print_message("%llu samples of %llu counted, %.0f in hand at most\n", (unsigned long long)status.counted,
                  (unsigned long long)status.issued, most);
    assert_int_equal(status.state, JOB_DONE);
    assert_true(status.counted >= 6000);
    assert_true(most <= 50000);
    assert_int_equal(status.batches_refused, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_closed_bulk_port_is_told_by_both, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_thin_link_delivers_and_hoards_nothing, set_up, tear_down),
    };
    return cmocka_run_group_tests_name("links", tests, NULL, NULL);
}
