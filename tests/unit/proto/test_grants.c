/* Tests of proto/serve/grants.c: what is promised and what is here never exceeds the credit, nobody is
 * overtaken, and what vanishes gives back what it was promised. */
#include "proto/serve/grants.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { MB = 1 << 20 };

static batch_offer_t offer_of(uint8_t peer, uint64_t megabytes)
{
    return (batch_offer_t){
        .identity = {{peer}, 1}, .request = 100 + peer, .worker = peer, .job = 1, .bytes = megabytes * MB};
}

static void offer(grants_t *grants, double now, uint8_t peer, uint64_t megabytes)
{
    batch_offer_t offered = offer_of(peer, megabytes);
    assert_int_equal(grants_offer(grants, now, &offered).code, RESULT_OK);
}

/* Peer 13's batches are refused; those of peer 40 have to wait. */
static result_t wanted(void *context, const batch_offer_t *offered)
{
    (void)context;
    if (offered->worker == 13) return result_fail(RESULT_CANCELLED, "no");
    if (offered->worker == 40) return result_fail(RESULT_LIMIT, "not yet");
    return result_ok();
}

/* The peer that is answered next, as a negative number when it is refused; 0: nobody. */
static int next(grants_t *grants, double now)
{
    batch_offer_t answered;
    result_t verdict;
    if (!grants_next(grants, now, wanted, NULL, &answered, &verdict)) return 0;
    assert_int_equal(answered.request, 100 + answered.worker);
    return verdict.code == RESULT_OK ? (int)answered.worker : -(int)answered.worker;
}

static bool admit(grants_t *grants, uint8_t peer, uint64_t megabytes)
{
    return grants_admit(grants, &(identity_t){{peer}, 1}, megabytes * MB);
}

static void memory_is_bounded_and_the_order_kept(void **state)
{
    (void)state;
    grants_t *grants = grants_new(100 * MB);
    for (uint8_t peer = 1; peer <= 5; peer++) offer(grants, 0, peer, 40);
    offer(grants, 0, 6, 1);
    assert_int_equal(next(grants, 0), 1);
    assert_int_equal(next(grants, 0), 2);
    assert_int_equal(next(grants, 0), 0); /* there would be room for the small one, but it is not its turn */
    assert_int_equal(grants_state(grants).waiting, 4);
    assert_int_equal(grants_state(grants).used, 80 * MB);
    assert_true(admit(grants, 1, 30)); /* smaller than it said */
    assert_int_equal(grants_state(grants).used, 70 * MB);
    assert_int_equal(next(grants, 0), 0);
    grants_release(grants, 30 * MB);
    assert_int_equal(next(grants, 0), 3);
    assert_int_equal(next(grants, 0), 0);
    assert_true(admit(grants, 2, 60)); /* larger, but not by much */
    assert_int_equal(grants_state(grants).used, 100 * MB);
    grants_release(grants, 60 * MB);
    assert_int_equal(next(grants, 0), 4);
    assert_int_equal(grants_state(grants).most, 100 * MB);
    grants_destroy(&grants);
    assert_null(grants);
}

/* Grants all that may be granted at this moment; returns how many that were. */
static int grant_all(grants_t *grants, double now)
{
    int count = 0;
    while (next(grants, now) != 0) count++;
    return count;
}

static void a_master_that_is_behind_grants_less(void **state)
{
    (void)state;
    grants_t *grants = grants_new(100 * MB);
    for (uint8_t peer = 100; peer < 200; peer++) offer(grants, 0, peer, 1);
    grants_tick(grants, 0);
    assert_int_equal(grant_all(grants, 0), 25);
    for (uint8_t peer = 100; peer < 125; peer++) assert_true(admit(grants, peer, 1));
    for (double now = 0; now < 4; now += 0.1) grants_tick(grants, now); /* nothing is merged */
    assert_true(grants_state(grants).window < 4 * MB);
    grants_release(grants, 23 * MB);
    assert_int_equal(grant_all(grants, 4), 2); /* no more than keeps the threads busy */
    grants_release(grants, 2 * MB);
    for (double now = 4; now < 40; now += 0.1) {
        for (uint8_t peer = 125; peer < 200; peer++)
            if ((int)(10 * now) % 100 == peer % 100) offer(grants, now, peer, 1);
        grants_tick(grants, now); /* what comes is merged at once */
        grant_all(grants, now);
    }
    assert_int_equal(grants_state(grants).window, 100 * MB);
    assert_true(grants_state(grants).most <= 100 * MB);
    grants_destroy(&grants);
}

static void batches_that_were_not_granted_need_room(void **state)
{
    (void)state;
    grants_t *grants = grants_new(100 * MB);
    offer(grants, 0, 4, 1);
    assert_int_equal(next(grants, 0), 4);
    assert_true(admit(grants, 1, 50));
    assert_true(admit(grants, 2, 30));
    assert_false(admit(grants, 3, 30));
    assert_true(admit(grants, 3, 19));
    grants_release(grants, 30 * MB);
    assert_false(admit(grants, 4, 40)); /* much more than it was granted */
    assert_int_equal(grants_state(grants).granted, 0);
    assert_int_equal(grants_state(grants).used, 69 * MB);
    grants_destroy(&grants);
}

/* Whatever the credit, the largest batch gets through, and another while it is merged. */
static void two_of_the_largest_always_fit(void **state)
{
    (void)state;
    grants_t *grants = grants_new(1);
    for (uint8_t peer = 1; peer <= 3; peer++) offer(grants, 0, peer, 500);
    assert_int_equal(next(grants, 0), 1);
    assert_int_equal(next(grants, 0), 2);
    assert_int_equal(next(grants, 0), 0);
    assert_true(admit(grants, 1, 500));
    grants_release(grants, 500 * MB);
    assert_int_equal(next(grants, 0), 3);
    grants_destroy(&grants);
}

static void who_is_not_wanted_holds_nobody_up(void **state)
{
    (void)state;
    grants_t *grants = grants_new(100 * MB);
    offer(grants, 0, 40, 10);
    offer(grants, 0, 13, 10);
    offer(grants, 0, 2, 10);
    assert_int_equal(next(grants, 0), -13);
    assert_int_equal(next(grants, 0), 2);
    assert_int_equal(next(grants, 0), 0);
    assert_int_equal(grants_state(grants).waiting, 1); /* 40 */
    grants_destroy(&grants);
}

static void who_vanishes_is_forgotten(void **state)
{
    (void)state;
    grants_t *grants = grants_new(100 * MB);
    for (uint8_t peer = 1; peer <= 4; peer++) offer(grants, 0, peer, 50);
    assert_int_equal(next(grants, 0), 1);
    assert_int_equal(next(grants, 0), 2);
    grants_tick(grants, 19);
    assert_int_equal(next(grants, 19), 0);
    offer(grants, 50, 4, 40); /* repeated: it lives, and keeps its place */
    offer(grants, 50, 5, 40);
    grants_tick(grants, 61); /* 3 has not repeated its offer */
    assert_int_equal(grants_state(grants).waiting, 2);
    assert_int_equal(next(grants, 61), 0);
    offer(grants, 105, 4, 40);
    grants_tick(grants, 121); /* 50 MB may take a while; now it is over */
    assert_int_equal(grants_state(grants).used, 0);
    assert_int_equal(next(grants, 121), 4);
    assert_int_equal(next(grants, 121), 0);
    grants_forget(grants, &(identity_t){{4}, 1}); /* it could not be told */
    assert_int_equal(grants_state(grants).used, 0);
    grants_destroy(&grants);
}

static void a_new_offer_takes_an_old_promise_back(void **state)
{
    (void)state;
    grants_t *grants = grants_new(100 * MB);
    offer(grants, 0, 1, 60);
    assert_int_equal(next(grants, 0), 1);
    offer(grants, 5, 1, 70); /* what it was granted did not come */
    assert_int_equal(grants_state(grants).used, 0);
    assert_int_equal(next(grants, 5), 1);
    assert_int_equal(grants_state(grants).used, 70 * MB);
    grants_destroy(&grants);
}

static void the_number_of_offers_is_bounded(void **state)
{
    (void)state;
    grants_t *grants = grants_new(1);
    batch_offer_t offered = offer_of(40, 1);
    size_t taken = 0;
    for (uint32_t i = 0; i < 10000; i++) {
        memcpy(offered.identity.bytes, &i, sizeof i);
        offered.identity.size = sizeof i;
        taken += grants_offer(grants, 0, &offered).code == RESULT_OK;
    }
    assert_int_equal(taken, 2 * SERVE_MAX_WORKERS);
    uint32_t first = 0;
    memcpy(offered.identity.bytes, &first, sizeof first);
    assert_int_equal(grants_offer(grants, 0, &offered).code,
                     RESULT_OK); /* one that waits may repeat itself */
    grants_destroy(&grants);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(memory_is_bounded_and_the_order_kept),
        cmocka_unit_test(a_master_that_is_behind_grants_less),
        cmocka_unit_test(batches_that_were_not_granted_need_room),
        cmocka_unit_test(two_of_the_largest_always_fit),
        cmocka_unit_test(who_is_not_wanted_holds_nobody_up),
        cmocka_unit_test(who_vanishes_is_forgotten),
        cmocka_unit_test(a_new_offer_takes_an_old_promise_back),
        cmocka_unit_test(the_number_of_offers_is_bounded),
    };
    return cmocka_run_group_tests_name("grants", tests, NULL, NULL);
}
