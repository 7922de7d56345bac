/* Tests of proto/serve/connections.h, through the gate and libzmq: connections that say nothing, and messages
 * that never end, by a peer that writes ZMTP itself. */
#include "proto/serve/gate.h"

#include <arpa/inet.h>
#include <poll.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { MB = 1 << 20 };

typedef struct {
    void *context, *router;
    gate_t *gate;
    int port;
} hall_t;

/* A gate without keys, and one socket that it watches. */
static void open_hall(hall_t *hall, connection_limits_t limits)
{
    char endpoint[100];
    size_t size = sizeof endpoint;
    gate_options_t options = {.insecure = true};
    hall->context = zmq_ctx_new();
    assert_int_equal(wire_socket(hall->context, ZMQ_ROUTER, &hall->router).code, RESULT_OK);
    assert_int_equal(gate_new(&options, "/nowhere", hall->context, true, &hall->gate).code, RESULT_OK);
    assert_int_equal(gate_guard(hall->gate, hall->router, "test", &limits).code, RESULT_OK);
    assert_int_equal(zmq_bind(hall->router, "tcp://127.0.0.1:*"), 0);
    assert_int_equal(zmq_getsockopt(hall->router, ZMQ_LAST_ENDPOINT, endpoint, &size), 0);
    hall->port = atoi(strrchr(endpoint, ':') + 1);
    assert_int_equal(gate_start(hall->gate, "127.0.0.1", hall->port).code, RESULT_OK);
}

static void close_hall(hall_t *hall)
{
    zmq_close(hall->router);
    gate_stop(&hall->gate);
    zmq_ctx_term(hall->context);
}

/* Takes the messages that have come, as a server does; returns how many. */
static int take_messages(hall_t *hall)
{
    int count = 0;
    for (;;) {
        wire_message_t message;
        bool received;
        result_t result = wire_receive_frames(hall->router, true, &message, &received);
        if (!received && result.code != RESULT_PROTOCOL) return count;
        gate_heard(hall->gate, message.connection);
        assert_true(message.connection >= 0);
        if (received) wire_free(&message);
        count++;
    }
}

static int dial(const hall_t *hall)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)hall->port)};
    int peer = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    struct timeval patience = {.tv_sec = 1}; /* the other side may have closed its window for good */
    assert_int_equal(setsockopt(peer, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience), 0);
    inet_pton(AF_INET, "127.0.0.1", &address.sin_addr);
    assert_int_equal(connect(peer, (struct sockaddr *)&address, sizeof address), 0);
    return peer;
}

/* The greeting of ZMTP 3.0 without keys, and the command READY of a DEALER; waits for those of the other
 * side. */
static int dial_zmtp(const hall_t *hall)
{
    uint8_t greeting[64] = {0xFF, [9] = 0x7F, 3, 0, 'N', 'U', 'L', 'L'};
    static const uint8_t ready[] = "\x04\x1c\x05READY\x0bSocket-Type\0\0\0\x06"
                                   "DEALER";
    int peer = dial(hall);
    assert_int_equal(write(peer, greeting, sizeof greeting), sizeof greeting);
    assert_int_equal(write(peer, ready, sizeof ready - 1), sizeof ready - 1);
    assert_int_equal(recv(peer, greeting, sizeof greeting, MSG_WAITALL), sizeof greeting);
    uint8_t answer[2 + 255];
    assert_int_equal(recv(peer, answer, 2, MSG_WAITALL), 2);
    assert_int_equal(recv(peer, answer + 2, answer[1], MSG_WAITALL), answer[1]);
    return peer;
}

/* True when the other side has ended the connection, or does within `seconds`. */
static bool has_ended(int peer, double seconds)
{
    double deadline = clock_now() + seconds;
    do {
        char bytes[256];
        struct pollfd wait = {.fd = peer, .events = POLLIN};
        if (poll(&wait, 1, 20) > 0 && recv(peer, bytes, sizeof bytes, MSG_DONTWAIT) <= 0) return true;
    } while (clock_now() < deadline);
    return false;
}

static void connections_that_say_nothing_are_closed(void **state)
{
    (void)state;
    enum { SILENT = 40 };
    hall_t hall;
    int silent[SILENT];
    open_hall(&hall, (connection_limits_t){.silence = 0.5, .unfinished = MB, .all = MB});
    int speaks = dial_zmtp(&hall);
    for (int i = 0; i < SILENT; i++) silent[i] = i % 2 ? dial_zmtp(&hall) : dial(&hall);
    double deadline = clock_now() + 5;
    assert_int_equal(write(speaks, "\0\x02hi", 4), 4);
    while (take_messages(&hall) == 0 && clock_now() < deadline) usleep(1000);
    for (int i = 0; i < SILENT; i++) {
        assert_true(has_ended(silent[i], 5));
        close(silent[i]);
    }
    assert_false(has_ended(speaks, 1)); /* it has spoken once, and may be silent now */
    close(speaks);
    close_hall(&hall);
}

/* Writes frames of `size` bytes that all say that more come, so many bytes in all or until the end of the
 * connection; returns how many bytes went. */
static size_t write_frames(int peer, size_t size, size_t most)
{
    size_t sent = 0;
    uint8_t *frame = mem_zalloc(1, size + 9);
    frame[0] = 3; /* more follow; a long frame */
    for (int i = 0; i < 8; i++) frame[1 + i] = (uint8_t)((uint64_t)size >> (56 - 8 * i));
    for (size_t at = 0; sent < most; sent += size + 9, at = 0)
        while (at < size + 9) {
            ssize_t n = send(peer, frame + at, size + 9 - at, MSG_NOSIGNAL);
            if (n <= 0) {
                free(frame);
                return sent + at;
            }
            at += (size_t)n;
        }
    free(frame);
    return sent;
}

static size_t memory_used(void)
{
    size_t all = 0, resident = 0;
    FILE *file = fopen("/proc/self/statm", "re");
    assert_non_null(file);
    assert_int_equal(fscanf(file, "%zu %zu", &all, &resident), 2);
    fclose(file);
    return resident * (size_t)sysconf(_SC_PAGESIZE);
}

/* libzmq keeps the frames of a message until the last one has come. */
static void a_message_without_end_ends_the_connection(void **state)
{
    (void)state;
    static const size_t sizes[] = {300, 16000, 900000};
    hall_t hall;
    open_hall(&hall, (connection_limits_t){.silence = 60, .unfinished = 4 * MB, .all = 64 * MB});
    for (size_t i = 0; i < ARRAY_LENGTH(sizes); i++) {
        int peer = dial_zmtp(&hall);
        size_t before = memory_used(), sent = write_frames(peer, sizes[i], (size_t)20000 * MB);
        assert_true(sent < (size_t)20000 * MB);
        assert_true(has_ended(peer, 5));
        /* What comes between two looks is beyond the limit; it depends on the machine. */
        assert_true(memory_used() < before + (size_t)1500 * MB);
        close(peer);
    }
    close_hall(&hall);
}

static void a_message_that_is_expected_may_be_longer(void **state)
{
    (void)state;
    hall_t hall;
    open_hall(&hall, (connection_limits_t){.silence = 60, .unfinished = MB, .all = 64 * MB});
    int large = dial_zmtp(&hall), other = dial_zmtp(&hall);
    double deadline = clock_now() + 5;
    for (int taken = 0; taken < 2 && clock_now() < deadline; usleep(1000)) {
        if (taken == 0) {
            assert_int_equal(write(large, "\0\x02hi", 4), 4);
            assert_int_equal(write(other, "\0\x02hi", 4), 4);
        }
        wire_message_t message;
        bool received;
        wire_receive_frames(hall.router, true, &message, &received);
        if (!received) continue;
        gate_heard(hall.gate, message.connection);
        if (taken++ == 0) gate_expect(hall.gate, message.connection, 32 * MB);
        wire_free(&message);
    }
    usleep(500000); /* the gate has seen that they spoke */
    write_frames(large, 60000, 8 * MB);
    write_frames(other, 60000, 8 * MB);
    bool a = has_ended(large, 2), b = has_ended(other, 2);
    assert_true(a != b); /* whichever message was taken first had leave */
    close(large);
    close(other);
    close_hall(&hall);
}

/* Many that keep within their own limit. */
static void all_together_have_a_limit(void **state)
{
    (void)state;
    enum { PEERS = 8 };
    hall_t hall;
    int peers[PEERS], ended = 0;
    open_hall(&hall, (connection_limits_t){.silence = 60, .unfinished = 4 * MB, .all = 8 * MB});
    for (int i = 0; i < PEERS; i++) peers[i] = dial_zmtp(&hall);
    for (int i = 0; i < PEERS; i++) write_frames(peers[i], 60000, 2 * MB + (size_t)i * 100000);
    for (int i = PEERS - 1; i >= 0; i--) {
        ended += has_ended(peers[i], 0.6);
        close(peers[i]);
    }
    assert_in_range(ended, 4, 6); /* 8 MB have room for three or four */
    close_hall(&hall);
}

int main(void)
{
    log_init("test", LOG_WARNING);
    signal(SIGPIPE, SIG_IGN);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(connections_that_say_nothing_are_closed),
        cmocka_unit_test(a_message_without_end_ends_the_connection),
        cmocka_unit_test(a_message_that_is_expected_may_be_longer),
        cmocka_unit_test(all_together_have_a_limit),
    };
    return cmocka_run_group_tests_name("connections", tests, NULL, NULL);
}
