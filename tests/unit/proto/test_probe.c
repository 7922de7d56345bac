/* Tests of what probes tell of a link: that it is there, and how fast it is. */
#include "proto/uplink/probe.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static void reach(probe_t *probe, double now)
{
    probe_sent(probe, now, 1);
    probe_answered(probe, now + 0.2, true);
}

static void each_conversation_is_probed_anew(void **state)
{
    (void)state;
    probe_t probe = {0};
    probe_follow(&probe, 1, 7);
    assert_false(probe_done(&probe, 1, 7));
    reach(&probe, 0);
    assert_int_equal(probe.stage, PROBE_MEASURING);
    reach(&probe, 1);
    assert_true(probe_done(&probe, 1, 7));
    assert_false(probe_done(&probe, 2, 7));
    probe_follow(&probe, 1, 8); /* another number: the master does not know this one yet */
    assert_int_equal(probe.stage, PROBE_REACHING);
    assert_false(probe_done(&probe, 1, 7));
}

static void silence_lasts_over_conversations(void **state)
{
    (void)state;
    probe_t probe = {0};
    probe_follow(&probe, 1, 7);
    probe_sent(&probe, 10, 1);
    probe_follow(&probe, 2, 7);
    probe_sent(&probe, 14, 2);
    assert_false(probe_is_silent(&probe, 14.9, 5));
    assert_true(probe_is_silent(&probe, 15, 5));
    probe_answered(&probe, 15, true);
    assert_false(probe_is_silent(&probe, 100, 5));
}

/* 64 KiB at 1 Mbit/s take half a second. */
static void a_slow_link_is_measured(void **state)
{
    (void)state;
    probe_t probe = {0};
    probe_follow(&probe, 1, 7);
    reach(&probe, 0);
    probe_sent(&probe, 1, 2);
    probe_answered(&probe, 1 + PROBE_BYTES / 125e3, true);
    assert_true(probe.rate > 120e3 && probe.rate < 150e3);
    for (int i = 0; i < 8; i++) probe_learn(&probe, 1e6, 1e6 / 500e3); /* it has become faster */
    assert_true(probe.rate > 450e3 && probe.rate < 550e3);
}

static void a_busy_machine_does_not_make_a_link_slow(void **state)
{
    (void)state;
    probe_t probe = {0};
    probe_learn(&probe, PROBE_BYTES, 0.05);
    assert_true(probe.rate > 1e9);
    probe_learn(&probe, 1000, 0.05); /* a small batch says nothing of a fast link, */
    assert_true(probe.rate > 1e9);
    for (int i = 0; i < 5; i++) probe_learn(&probe, 300e3, 2.4); /* a large one finds out that it is slow */
    assert_true(probe.rate < 300e3);
}

static void no_answer_is_a_measurement_too(void **state)
{
    (void)state;
    probe_t probe = {0};
    probe_follow(&probe, 1, 7);
    reach(&probe, 0);
    probe_sent(&probe, 1, 2);
    probe_give_up_measuring(&probe, 6);
    assert_true(probe_done(&probe, 1, 7));
    assert_true(probe.rate < PROBE_BYTES / 4.9);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(each_conversation_is_probed_anew),
        cmocka_unit_test(silence_lasts_over_conversations),
        cmocka_unit_test(a_slow_link_is_measured),
        cmocka_unit_test(a_busy_machine_does_not_make_a_link_slow),
        cmocka_unit_test(no_answer_is_a_measurement_too),
    };
    return cmocka_run_group_tests_name("probe", tests, NULL, NULL);
}
