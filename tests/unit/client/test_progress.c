/* Tests of what people are told of the progress of jobs (client/text/progress.h). */
#include "client/text/progress.h"

#include "proto/wire/wire.h"

#include <setjmp.h>
#include <stdarg.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static int percent(uint32_t state, uint64_t done, uint64_t total)
{
    Lm__JobStatus status = LM__JOB_STATUS__INIT;
    status.state = state;
    status.samples_done = done;
    status.samples_total = total;
    return (int)(100 * job_fraction(&status));
}

/* An adaptive job that was done with all but a few of the samples that it could take said "99%" for ever. */
static void a_job_is_at_100_percent_when_it_is_done_and_not_before(void **state)
{
    (void)state;
    assert_int_equal(percent(JOB_RUNNING, 0, 1000), 0);
    assert_int_equal(percent(JOB_RUNNING, 500, 1000), 50);
    assert_int_equal(percent(JOB_RUNNING, 1000, 1000), 99);
    assert_int_equal(percent(JOB_FINISHING, 1000, 1000), 99);
    assert_int_equal(percent(JOB_DONE, 997, 1000), 100);
    assert_int_equal(percent(JOB_DONE, 1000, 1000), 100);
    assert_int_equal(percent(JOB_DONE, 10, 0), 100); /* only time ended it */
    assert_int_equal(percent(JOB_CANCELLED, 250, 1000), 25);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_job_is_at_100_percent_when_it_is_done_and_not_before)};
    return cmocka_run_group_tests_name("progress", tests, NULL, NULL);
}
