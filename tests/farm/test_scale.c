/* Tests of a farm with many workers (tests/sim): a real master that is sent real batches by workers that do
 * not render. What is measured here at length is in docs/scale.md. */
#include "tests/sim/sim.h"

#include <setjmp.h>
#include <stdarg.h>

#include <cmocka.h>

enum { MB = 1 << 20 };

/* Under a sanitizer everything is slow and large: only the accounts are looked at. */
#if defined __SANITIZE_THREAD__ || defined __SANITIZE_ADDRESS__
static const bool sanitized = true;
#else
static const bool sanitized = false;
#endif

static sim_report_t run(const sim_options_t *options)
{
    sim_report_t report;
    result_t result = sim_run(options, &report);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    return report;
}

/* Every sample that the workers know to be counted is, and nothing that they sent was refused. */
static void assert_all_counted(const sim_report_t *report)
{
    assert_int_equal(report->samples, report->samples_counted);
    assert_true(report->samples > 0);
    assert_int_equal(report->all.refused, 0);
    assert_int_equal(report->all.failed, 0);
    assert_int_equal(report->all.lost, 0);
}

static sim_options_t small_farm(void)
{
    sim_options_t options = sim_options_default();
    options.workers = sanitized ? 8 : 50;
    options.width = 640;
    options.height = 360;
    options.seconds = 9;
    options.interval = 1.5;
    options.power = 0.1;
    options.row = 1;
    options.master = "--lease 60 --heartbeat 0.5"; /* however busy this machine is */
    return options;
}

static void many_workers_deliver_to_one_master(void **state)
{
    (void)state;
    sim_options_t options = small_farm();
    sim_report_t report = run(&options);
    assert_all_counted(&report);
    assert_int_equal(report.all.joined, options.workers);
    if (sanitized) return;
    assert_true(report.batches > 0.25 * options.workers / options.interval);
    assert_true(report.memory_late < 1.25 * report.memory_early + 20 * MB);
    assert_true(report.beat_99 < 2);
}

/* The master stands still a quarter of the time, while everybody has something to send, and may use little
 * memory: batches wait where they are made, and get larger and rarer. */
static void a_master_that_falls_behind_is_not_flooded(void **state)
{
    (void)state;
    const double credit = 4, film = 640 * 360 * 104.0 / MB, rest = 30; /* MB */
    const double plans = 12;                                           /* on their way to workers */
    sim_options_t options = small_farm();
    options.batch_megabytes = (int)credit;
    options.pause_merging = true;
    sim_report_t report = run(&options);
    assert_all_counted(&report);
    assert_true(report.all.batches > 0);
    if (sanitized) return;
    double flood = options.workers * (report.wire / report.batches) / MB; /* if all were sent at once */
    assert_true(flood > 3 * credit);
    assert_true(report.memory_most < (film + credit + plans + rest) * MB);
}

/* A tree of two levels counts what one master counts. */
static void relays_in_between_lose_nothing(void **state)
{
    (void)state;
    sim_options_t options = small_farm();
    options.workers = 8;
    options.relays = 2;
    options.seconds = 4;
    options.interval = 1;
    sim_report_t report = run(&options);
    assert_all_counted(&report);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(many_workers_deliver_to_one_master),
        cmocka_unit_test(a_master_that_falls_behind_is_not_flooded),
        cmocka_unit_test(relays_in_between_lose_nothing),
    };
    log_init("test", LOG_WARNING);
    return cmocka_run_group_tests_name("scale", tests, NULL, NULL);
}
