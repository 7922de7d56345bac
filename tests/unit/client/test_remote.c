/* Tests of the client's questions to a master that is not there. */
#include "client/farm/remote.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { QUESTIONS = 80 };                          /* more than a socket queues */
static const double TIMEOUT = 0.02, MOMENT = 0.5; /* seconds */

enum { ENDPOINT_ROOM = 64 };

/* Where a master would listen; `endpoint` becomes its address. */
static void *open_router(void *context, char endpoint[ENDPOINT_ROOM])
{
    void *router;
    size_t size = ENDPOINT_ROOM;
    assert_int_equal(wire_socket(context, ZMQ_ROUTER, &router).code, RESULT_OK);
    assert_int_equal(zmq_bind(router, "tcp://127.0.0.1:*"), 0);
    assert_int_equal(zmq_getsockopt(router, ZMQ_LAST_ENDPOINT, endpoint, &size), 0);
    return router;
}

/* Messages that come within a moment. */
static int count_messages(void *router)
{
    int count = 0;
    for (double end = clock_now() + MOMENT; clock_now() < end;) {
        zmq_pollitem_t item = {.socket = router, .events = ZMQ_POLLIN};
        wire_message_t message;
        bool received;
        zmq_poll(&item, 1, 10);
        assert_int_equal(wire_receive(router, true, &message, &received).code, RESULT_OK);
        if (!received) continue;
        count++;
        wire_free(&message);
    }
    return count;
}

/* However often it is asked, and none of it reaches the next one. */
static void a_master_that_is_away_can_be_asked_for_ever(void **state)
{
    (void)state;
    void *context = zmq_ctx_new();
    char endpoint[ENDPOINT_ROOM];
    void *router = open_router(context, endpoint);
    assert_int_equal(zmq_unbind(router, endpoint), 0);
    remote_t *remote;
    wire_message_t message;
    assert_int_equal(remote_open(NULL, endpoint, endpoint, TIMEOUT, &remote).code, RESULT_OK);
    for (int i = 0; i < QUESTIONS; i++)
        assert_int_equal(remote_status(remote, 1, &message).code, RESULT_UNREACHABLE);
    assert_int_equal(zmq_bind(router, endpoint), 0);
    assert_int_equal(count_messages(router), 0);
    assert_int_equal(remote_status(remote, 1, &message).code, RESULT_UNREACHABLE);
    assert_true(count_messages(router) <= 1);
    remote_close(&remote);
    zmq_close(router);
    zmq_ctx_term(context);
}

/* An order may have been done, though nobody said so: who gave it is told, and does not give it again
 * blindly. */
static void an_order_without_an_answer_may_have_been_done(void **state)
{
    (void)state;
    void *context = zmq_ctx_new();
    char endpoint[ENDPOINT_ROOM];
    void *router = open_router(context, endpoint);
    remote_t *remote;
    uint64_t job;
    assert_int_equal(remote_open(NULL, endpoint, endpoint, MOMENT, &remote).code, RESULT_OK);
    result_t result = remote_submit(remote, "a", &(job_settings_t){0}, &(hash_t){0}, &job);
    assert_int_equal(result.code, RESULT_UNREACHABLE);
    assert_non_null(strstr(result.message, "lightmill status tells"));
    assert_int_equal(count_messages(router), 1);
    remote_close(&remote);
    zmq_close(router);
    zmq_ctx_term(context);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_master_that_is_away_can_be_asked_for_ever),
        cmocka_unit_test(an_order_without_an_answer_may_have_been_done),
    };
    return cmocka_run_group_tests_name("remote", tests, NULL, NULL);
}
