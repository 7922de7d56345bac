/* Tests of the chaos proxy: what nobody disturbs passes as it is, and each mischief does to real connections
 * exactly what its name says, as often as it was ordered. */
#include "tests/chaos/proxy.h"
#include "tests/chaos/zmtp.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>
#include <zmq.h>

#include <cmocka.h>

enum { PATIENCE_MS = 10000 };

typedef struct {
    proxy_t *proxy;
    proxy_link_t *link;
    int port;
    int listener;         /* the master's side */
    int caller, answerer; /* a connection through the proxy */
} line_t;

static struct sockaddr_in address_of(const char *host, int port)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    assert_int_equal(inet_pton(AF_INET, host, &address.sin_addr), 1);
    return address;
}

static int set_up(void **state)
{
    line_t *line = mem_zalloc(1, sizeof *line);
    struct sockaddr_in address = address_of("127.0.0.1", 0);
    socklen_t size = sizeof address;
    line->listener = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(bind(line->listener, (struct sockaddr *)&address, sizeof address), 0);
    assert_int_equal(listen(line->listener, 8), 0);
    getsockname(line->listener, (struct sockaddr *)&address, &size);
    line->port = ntohs(address.sin_port);
    result_t result = proxy_start((const char *[]){"127.0.0.2"}, 1, "127.0.0.1", line->port, 1, &line->proxy);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    line->link = proxy_link(line->proxy, 0);
    *state = line;
    return 0;
}

static int tear_down(void **state)
{
    line_t *line = *state;
    assert_true(proxy_alive(line->proxy));
    proxy_stop(&line->proxy);
    close(line->listener);
    if (line->caller > 0) close(line->caller);
    if (line->answerer > 0) close(line->answerer);
    free(line);
    return 0;
}

/* ---- plain TCP ---------------------------------------------------------------------------------------- */

static void connect_line(line_t *line)
{
    struct sockaddr_in address = address_of("127.0.0.2", line->port);
    line->caller = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(line->caller, (struct sockaddr *)&address, sizeof address), 0);
    line->answerer = accept(line->listener, NULL, NULL);
    assert_true(line->answerer >= 0);
}

/* Reads until so many bytes have come, or nothing comes for a while; returns how many came. */
static size_t read_some(int file, uint8_t *bytes, size_t size, int patience_ms)
{
    size_t have = 0;
    struct pollfd item = {.fd = file, .events = POLLIN};
    while (have < size && poll(&item, 1, patience_ms) > 0) {
        ssize_t n = recv(file, bytes + have, size - have, 0);
        if (n <= 0) break;
        have += (size_t)n;
    }
    return have;
}

static uint8_t *pattern(size_t size)
{
    uint8_t *bytes = mem_alloc(size);
    for (size_t i = 0; i < size; i++) bytes[i] = (uint8_t)(i * 2654435761u >> 13);
    return bytes;
}

/* Sends bytes and returns what arrives, at most twice as many. */
static size_t send_through(const line_t *line, const uint8_t *bytes, size_t size, uint8_t *arrived)
{
    assert_int_equal(send(line->caller, bytes, size, 0), (int)size);
    return read_some(line->answerer, arrived, 2 * size, 300);
}

static void what_is_not_disturbed_passes_both_ways(void **state)
{
    line_t *line = *state;
    connect_line(line);
    enum { SIZE = 3000000 };
    uint8_t *sent = pattern(SIZE), *arrived = mem_alloc(SIZE);
    for (int way = 0; way < 2; way++) {
        int from = way ? line->answerer : line->caller, to = way ? line->caller : line->answerer;
        size_t have = 0;
        for (size_t at = 0; at < SIZE;) {
            ssize_t n = send(from, sent + at, SIZE - at < 50000 ? SIZE - at : 50000, 0);
            assert_true(n > 0);
            at += (size_t)n;
            have += read_some(to, arrived + have, at - have, PATIENCE_MS);
        }
        assert_int_equal(have, SIZE);
        assert_memory_equal(sent, arrived, SIZE);
    }
    /* The end of one side is the end of the other. */
    shutdown(line->caller, SHUT_RDWR);
    assert_int_equal(recv(line->answerer, arrived, 1, 0), 0);
    free(sent);
    free(arrived);
}

static void bytes_are_flipped_lost_repeated_and_swapped(void **state)
{
    line_t *line = *state;
    enum { SIZE = 1000 };
    uint8_t *sent = pattern(SIZE), arrived[2 * SIZE];
    for (int mischief = PROXY_FLIP_BYTES; mischief <= PROXY_LOSE_BYTES; mischief++) {
        connect_line(line);
        atomic_store(&line->link->todo[mischief], 1);
        size_t have, rounds = 0;
        do have = send_through(line, sent, SIZE, arrived);
        while (have == SIZE && memcmp(sent, arrived, SIZE) == 0 && ++rounds <= 100);
        assert_int_equal(atomic_load(&line->link->todo[mischief]), 0);
        assert_int_equal(atomic_load(&line->link->done[mischief]), 1);
        if (mischief == PROXY_LOSE_BYTES) assert_true(have < SIZE);
        if (mischief == PROXY_REPEAT_BYTES) assert_true(have > SIZE);
        if (mischief == PROXY_FLIP_BYTES || mischief == PROXY_SWAP_BYTES) assert_int_equal(have, SIZE);
        if (mischief == PROXY_FLIP_BYTES) {
            int different = 0;
            for (int i = 0; i < SIZE; i++) different += sent[i] != arrived[i];
            assert_in_range(different, 1, 4);
        }
        /* It was done once, and what comes now is whole. */
        assert_int_equal(send_through(line, sent, SIZE, arrived), SIZE);
        assert_memory_equal(sent, arrived, SIZE);
        close(line->caller);
        close(line->answerer);
    }
    line->caller = line->answerer = 0;
    free(sent);
}

static void delay_rate_and_stall_take_their_time(void **state)
{
    line_t *line = *state;
    connect_line(line);
    uint8_t *sent = pattern(40000), *arrived = mem_alloc(40000);
    atomic_store(&line->link->delay_ms, 200);
    double start = clock_now();
    send(line->caller, sent, 10, 0);
    assert_int_equal(read_some(line->answerer, arrived, 10, PATIENCE_MS), 10);
    assert_true(clock_now() - start > 0.19);
    proxy_heal(line->link);
    atomic_store(&line->link->bytes_per_second, 60000);
    start = clock_now();
    assert_int_equal(send(line->caller, sent, 40000, 0), 40000);
    assert_int_equal(read_some(line->answerer, arrived, 40000, PATIENCE_MS), 40000);
    assert_true(clock_now() - start > 0.5);
    atomic_store(&line->link->stalled, true);
    usleep(50000);
    send(line->caller, sent, 10, 0);
    assert_int_equal(read_some(line->answerer, arrived, 10, 300), 0);
    proxy_heal(line->link);
    assert_int_equal(read_some(line->answerer, arrived, 10, PATIENCE_MS), 10);
    free(sent);
    free(arrived);
}

static void connections_are_reset_and_refused(void **state)
{
    line_t *line = *state;
    connect_line(line);
    uint8_t byte = 1;
    assert_int_equal(send_through(line, &byte, 1, (uint8_t[2]){0}), 1);
    atomic_fetch_add(&line->link->cuts, 1);
    assert_int_equal(recv(line->caller, &byte, 1, 0), -1);
    assert_int_equal(errno, ECONNRESET);
    assert_int_equal(recv(line->answerer, &byte, 1, 0), -1);
    close(line->caller);
    close(line->answerer);
    atomic_store(&line->link->refusing, true);
    struct sockaddr_in address = address_of("127.0.0.2", line->port);
    line->caller = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    line->answerer = 0;
    assert_int_equal(connect(line->caller, (struct sockaddr *)&address, sizeof address), 0);
    assert_true(recv(line->caller, &byte, 1, 0) <= 0);
}

/* ---- messages ----------------------------------------------------------------------------------------- */

typedef struct {
    void *context, *in, *out;
} pipe_t;

/* Messages go from a PUSH socket through the proxy to a PULL socket. */
static pipe_t pipe_open(line_t *line)
{
    pipe_t pipe = {.context = zmq_ctx_new()};
    char endpoint[100];
    close(line->listener);
    pipe.out = zmq_socket(pipe.context, ZMQ_PULL);
    pipe.in = zmq_socket(pipe.context, ZMQ_PUSH);
    int patience = PATIENCE_MS, linger = 0;
    zmq_setsockopt(pipe.out, ZMQ_RCVTIMEO, &patience, sizeof patience);
    zmq_setsockopt(pipe.in, ZMQ_LINGER, &linger, sizeof linger);
    sprintf(endpoint, "tcp://127.0.0.1:%d", line->port);
    assert_int_equal(zmq_bind(pipe.out, endpoint), 0);
    sprintf(endpoint, "tcp://127.0.0.2:%d", line->port);
    assert_int_equal(zmq_connect(pipe.in, endpoint), 0);
    line->listener = -1;
    return pipe;
}

static void pipe_close(pipe_t *pipe)
{
    zmq_close(pipe->in);
    zmq_close(pipe->out);
    zmq_ctx_term(pipe->context);
}

enum { MESSAGES = 60, SECOND_FRAME = 40000 };

/* What became of 60 messages of two frames, "NUMBER" and a large one, of which each copy is the same. */
typedef struct {
    int came, changed, missing, repeated, late;
} outcome_t;

static outcome_t outcome_of(pipe_t *pipe)
{
    uint8_t *large = pattern(SECOND_FRAME);
    char number[16], arrived[16];
    zmq_msg_t frame;
    for (int i = 0; i < MESSAGES; i++) {
        sprintf(number, "%010d", i);
        assert_int_equal(zmq_send(pipe->in, number, 10, ZMQ_SNDMORE), 10);
        assert_int_equal(zmq_send(pipe->in, large, SECOND_FRAME, 0), SECOND_FRAME);
    }
    assert_int_equal(zmq_send(pipe->in, "the end", 7, 0), 7);
    outcome_t outcome = {0};
    int seen[MESSAGES] = {0}, last = -1;
    for (;;) {
        int n = zmq_recv(pipe->out, arrived, sizeof arrived, 0);
        assert_true(n >= 0);
        if (n == 7 && memcmp(arrived, "the end", 7) == 0) break;
        assert_int_equal(n, 10);
        arrived[10] = '\0';
        zmq_msg_init(&frame);
        assert_int_equal(zmq_msg_recv(&frame, pipe->out, 0), SECOND_FRAME);
        outcome.came++;
        char *end;
        int which = (int)strtol(arrived, &end, 10);
        bool known = *end == '\0' && which < MESSAGES;
        bool whole = known && memcmp(zmq_msg_data(&frame), large, SECOND_FRAME) == 0;
        outcome.changed += !whole;
        if (known) outcome.repeated += seen[which]++ > 0;
        if (known && which < last) outcome.late++;
        if (known) last = which;
        zmq_msg_close(&frame);
    }
    for (int i = 0; i < MESSAGES; i++) outcome.missing += seen[i] == 0;
    free(large);
    return outcome;
}

static void messages_are_lost_repeated_swapped_and_changed(void **state)
{
    line_t *line = *state;
    pipe_t pipe = pipe_open(line);
    outcome_t outcome = outcome_of(&pipe);
    assert_int_equal(outcome.came, MESSAGES);
    assert_int_equal(outcome.changed + outcome.missing + outcome.repeated + outcome.late, 0);
    enum { TIMES = 5 };
    atomic_store(&line->link->todo[PROXY_FLIP_MESSAGE], TIMES);
    outcome = outcome_of(&pipe);
    assert_int_equal(outcome.came, MESSAGES);
    assert_int_equal(outcome.changed, TIMES);
    atomic_store(&line->link->todo[PROXY_LOSE_MESSAGE], TIMES);
    outcome = outcome_of(&pipe);
    assert_int_equal(outcome.missing, TIMES);
    assert_int_equal(outcome.came, MESSAGES - TIMES);
    assert_int_equal(outcome.changed + outcome.repeated + outcome.late, 0);
    atomic_store(&line->link->todo[PROXY_REPEAT_MESSAGE], TIMES);
    outcome = outcome_of(&pipe);
    assert_int_equal(outcome.repeated, TIMES);
    assert_int_equal(outcome.came, MESSAGES + TIMES);
    assert_int_equal(outcome.changed + outcome.missing, 0);
    atomic_store(&line->link->todo[PROXY_SWAP_MESSAGES], TIMES);
    outcome = outcome_of(&pipe);
    assert_int_equal(outcome.late, TIMES);
    assert_int_equal(outcome.came, MESSAGES);
    assert_int_equal(outcome.changed + outcome.missing + outcome.repeated, 0);
    for (int i = PROXY_FLIP_MESSAGE; i < PROXY_MISCHIEFS; i++)
        assert_int_equal(atomic_load(&line->link->done[i]), TIMES);
    assert_int_equal(atomic_load(&line->link->connections), 1);
    pipe_close(&pipe);
}

static void frames_are_found(void **state)
{
    (void)state;
    static const uint8_t command[] = {4, 2, 'H', 'I'}, two[] = {1, 3, 'a', 'b', 'c', 0, 1, 'd'};
    static const uint8_t large[] = {2, 0, 0, 0, 0, 0, 0, 0, 1, 'x'}, hostile[] = {2, 1, 0, 0, 0, 0, 0, 0, 0};
    bool is_command;
    assert_int_equal(zmtp_message(command, sizeof command, &is_command), sizeof command);
    assert_true(is_command);
    for (size_t size = 0; size < sizeof two; size++)
        assert_int_equal(zmtp_message(two, size, &is_command), 0);
    assert_int_equal(zmtp_message(two, sizeof two, &is_command), sizeof two);
    assert_false(is_command);
    assert_int_equal(zmtp_body_size(two, sizeof two), 4);
    static const size_t places[] = {2, 3, 4, 7};
    for (size_t i = 0; i < 4; i++) assert_int_equal(zmtp_body_at(two, sizeof two, i), places[i]);
    assert_int_equal(zmtp_message(large, sizeof large, &is_command), sizeof large);
    assert_true(zmtp_message(hostile, sizeof hostile, &is_command) == SIZE_MAX);
    assert_true(zmtp_message((const uint8_t *)"HTTP", 4, &is_command) == SIZE_MAX);
}

int main(void)
{
#define ON_A_LINE(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        ON_A_LINE(what_is_not_disturbed_passes_both_ways),
        ON_A_LINE(bytes_are_flipped_lost_repeated_and_swapped),
        ON_A_LINE(delay_rate_and_stall_take_their_time),
        ON_A_LINE(connections_are_reset_and_refused),
        ON_A_LINE(messages_are_lost_repeated_swapped_and_changed),
        cmocka_unit_test(frames_are_found),
    };
    return cmocka_run_group_tests_name("proxy", tests, NULL, NULL);
}
