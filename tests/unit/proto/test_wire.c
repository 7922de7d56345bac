/* Tests of proto/wire/wire.c over real sockets: messages come as they were sent, limits hold, and whatever
 * bytes a peer sends, the receiver gets an error value and goes on. */
#include "proto/wire/checksum.h"
#include "proto/wire/wire.h"
#include "tests/peer.h"

#include <errno.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* A ROUTER as the master has it, a DEALER as a peer has it, and a DEALER without our limits for sending bad
 * bytes. */
typedef struct {
    void *context, *router, *dealer, *raw;
} sockets_t;

static int open_sockets(void **state)
{
    sockets_t *s = mem_zalloc(1, sizeof *s);
    char endpoint[100];
    size_t size = sizeof endpoint;
    s->context = zmq_ctx_new();
    if (wire_socket(s->context, ZMQ_ROUTER, &s->router).code != RESULT_OK) return -1;
    if (wire_socket(s->context, ZMQ_DEALER, &s->dealer).code != RESULT_OK) return -1;
    s->raw = zmq_socket(s->context, ZMQ_DEALER);
    int linger = 0;
    zmq_setsockopt(s->raw, ZMQ_LINGER, &linger, sizeof linger);
    if (zmq_bind(s->router, "tcp://127.0.0.1:*") != 0) return -1;
    if (zmq_getsockopt(s->router, ZMQ_LAST_ENDPOINT, endpoint, &size) != 0) return -1;
    if (zmq_connect(s->dealer, endpoint) != 0 || zmq_connect(s->raw, endpoint) != 0) return -1;
    *state = s;
    return 0;
}

static int close_sockets(void **state)
{
    sockets_t *s = *state;
    zmq_close(s->raw);
    zmq_close(s->dealer);
    zmq_close(s->router);
    zmq_ctx_term(s->context);
    free(s);
    return 0;
}

/* Waits up to two seconds for a message. */
static result_t receive(void *socket, bool router, wire_message_t *message, bool *received)
{
    zmq_pollitem_t item = {.socket = socket, .events = ZMQ_POLLIN};
    zmq_poll(&item, 1, 2000);
    return wire_receive(socket, router, message, received);
}

static void send_raw(void *socket, const void *bytes, size_t size, bool more)
{
    assert_int_equal(zmq_send(socket, bytes, size, more ? ZMQ_SNDMORE : 0), (int)size);
}

/* The raw socket sends frames; the router must find them wrong, and know who sent them. */
static void expect_malformed(sockets_t *s)
{
    wire_message_t message;
    bool received;
    assert_int_equal(receive(s->router, true, &message, &received).code, RESULT_PROTOCOL);
    assert_false(received);
    assert_true(message.identity_size > 0);
}

static Lm__Envelope heartbeat_envelope(Lm__Heartbeat *beat)
{
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    lm__heartbeat__init(beat);
    beat->worker = 0xFEDCBA9876543210u;
    beat->units_held = 7;
    envelope.request = 99;
    envelope.body_case = LM__ENVELOPE__BODY_HEARTBEAT;
    envelope.heartbeat = beat;
    return envelope;
}

static void messages_go_both_ways(void **state)
{
    sockets_t *s = *state;
    Lm__Heartbeat beat;
    Lm__Envelope envelope = heartbeat_envelope(&beat);
    wire_message_t message;
    bool received;
    assert_int_equal(wire_receive(s->router, true, &message, &received).code, RESULT_OK);
    assert_false(received);
    assert_int_equal(wire_send(s->dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    assert_int_equal(receive(s->router, true, &message, &received).code, RESULT_OK);
    assert_true(received);
    assert_int_equal(message.envelope->request, 99);
    assert_int_equal(message.envelope->body_case, LM__ENVELOPE__BODY_HEARTBEAT);
    assert_true(message.envelope->heartbeat->worker == beat.worker);
    assert_int_equal(message.envelope->heartbeat->units_held, 7);
    assert_int_equal(message.payload_count, 0);

    zmq_msg_t payload[2];
    zmq_msg_init_size(&payload[0], 100000);
    memset(zmq_msg_data(&payload[0]), 'x', 100000);
    zmq_msg_init(&payload[1]);
    assert_int_equal(
        wire_send(s->router, message.identity, message.identity_size, &envelope, payload, 2).code, RESULT_OK);
    wire_free(&message);
    assert_int_equal(receive(s->dealer, false, &message, &received).code, RESULT_OK);
    assert_true(received);
    assert_int_equal(message.identity_size, 0);
    assert_int_equal(message.payload_count, 2);
    assert_int_equal(zmq_msg_size(&message.payload[0]), 100000);
    assert_int_equal(zmq_msg_size(&message.payload[1]), 0);
    assert_true(message.bytes > 100000 && message.bytes < 100100);
    wire_free(&message);
}

static void a_peer_that_is_gone_is_an_error(void **state)
{
    sockets_t *s = *state;
    Lm__Heartbeat beat;
    Lm__Envelope envelope = heartbeat_envelope(&beat);
    zmq_msg_t payload;
    zmq_msg_init_size(&payload, 1000);
    result_t result = wire_send(s->router, (const uint8_t *)"nobody", 6, &envelope, &payload, 1);
    assert_int_equal(result.code, RESULT_UNREACHABLE);
}

static void a_full_queue_is_an_error(void **state)
{
    sockets_t *s = *state;
    Lm__Heartbeat beat;
    Lm__Envelope envelope = heartbeat_envelope(&beat);
    result_t result = result_ok();
    for (int i = 0; i < 1000 && result.code == RESULT_OK; i++) {
        zmq_msg_t payload;
        zmq_msg_init_size(&payload, 1 << 20);
        result = wire_send(s->dealer, NULL, 0, &envelope, &payload, 1);
    }
    assert_int_equal(result.code, RESULT_LIMIT);
    /* What did go out arrives whole. */
    wire_message_t message;
    bool received;
    for (int i = 0; i < 50; i++) {
        assert_int_equal(receive(s->router, true, &message, &received).code, RESULT_OK);
        assert_true(received);
        assert_int_equal(message.payload_count, 1);
        assert_int_equal(zmq_msg_size(&message.payload[0]), 1 << 20);
        wire_free(&message);
    }
}

/* libzmq looks but once a millisecond whether a peer has read what it was sent. */
static void a_queue_that_was_emptied_is_not_full(void **state)
{
    enum { MESSAGES = 200 };
    (void)state;
    void *context = zmq_ctx_new(), *router, *dealer;
    char endpoint[100];
    size_t size = sizeof endpoint;
    Lm__Heartbeat beat;
    Lm__Envelope envelope = heartbeat_envelope(&beat);
    assert_int_equal(wire_socket(context, ZMQ_ROUTER, &router).code, RESULT_OK);
    assert_int_equal(wire_socket(context, ZMQ_DEALER, &dealer).code, RESULT_OK);
    assert_int_equal(wire_socket_queue(router, MESSAGES, 1).code, RESULT_OK);
    assert_int_equal(wire_socket_queue(dealer, MESSAGES, MESSAGES).code, RESULT_OK);
    assert_int_equal(zmq_bind(router, "tcp://127.0.0.1:*"), 0);
    assert_int_equal(zmq_getsockopt(router, ZMQ_LAST_ENDPOINT, endpoint, &size), 0);
    assert_int_equal(zmq_connect(dealer, endpoint), 0);
    for (int i = 0; i < MESSAGES; i++)
        assert_int_equal(wire_send(dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    for (int i = 0; i < MESSAGES; i++) { /* what was answered has been read before the next answer */
        wire_message_t message;
        bool received;
        assert_int_equal(wire_receive(router, true, &message, &received).code, RESULT_OK);
        if (!received) /* waiting makes libzmq look: only when it is needed */
            assert_int_equal(receive(router, true, &message, &received).code, RESULT_OK);
        assert_true(received);
        assert_int_equal(wire_send(router, message.identity, message.identity_size, &envelope, NULL, 0).code,
                         RESULT_OK);
        wire_free(&message);
        assert_int_equal(receive(dealer, false, &message, &received).code, RESULT_OK);
        assert_true(received);
        wire_free(&message);
    }
    zmq_close(dealer);
    zmq_close(router);
    zmq_ctx_term(context);
}

/* Packs an envelope as it goes over the wire in front of no payload. */
static uint8_t *packed(const Lm__Envelope *envelope, size_t *size)
{
    *size = PEER_ENVELOPE_AT + lm__envelope__get_packed_size(envelope);
    uint8_t *bytes = mem_alloc(*size);
    memcpy(bytes, (uint8_t[]){'L', 'M', 'I', 'L', WIRE_VERSION}, 5);
    lm__envelope__pack(envelope, bytes + PEER_ENVELOPE_AT);
    peer_seal(bytes, *size, NULL, NULL, 0);
    return bytes;
}

/* The check value that every list of CRCs gives, in one piece and in two. */
static void the_checksum_is_crc_32c(void **state)
{
    (void)state;
    const char digits[] = "123456789 and more, over several words of eight bytes";
    assert_true(checksum_add(0, digits, 9) == 0xe3069283u);
    for (size_t cut = 0; cut < sizeof digits; cut++)
        assert_true(checksum_add(checksum_add(0, digits, cut), digits + cut, sizeof digits - cut) ==
                    checksum_add(0, digits, sizeof digits));
}

/* Whichever byte of a message is damaged, of the header or a payload, the receiver finds out; so it does when
 * payloads change places or lengths. */
static void a_damaged_message_is_an_error(void **state)
{
    sockets_t *s = *state;
    Lm__Heartbeat beat;
    Lm__Envelope envelope = heartbeat_envelope(&beat);
    uint8_t frames[3][64] = {{0}, "payload one", "payload 2 .."};
    size_t sizes[3] = {0, 11, 12};
    uint8_t *bytes = packed(&envelope, &sizes[0]);
    assert_true(sizes[0] <= sizeof frames[0]);
    memcpy(frames[0], bytes, sizes[0]);
    free(bytes);
    peer_seal(frames[0], sizes[0], (const void *[]){frames[1], frames[2]}, sizes + 1, 2);
    wire_message_t message;
    bool received;
    for (size_t f = 0; f < 3; f++)
        for (size_t at = 0; at < sizes[f]; at++) {
            frames[f][at] ^= (uint8_t)(1 << at % 8);
            for (int i = 0; i < 3; i++) send_raw(s->raw, frames[i], sizes[i], i < 2);
            expect_malformed(s);
            frames[f][at] ^= (uint8_t)(1 << at % 8);
        }
    const size_t others[][4] = {{0, 2, 1, 3}, {0, 1, 3, 3}, {0, 2, 3, 3}, {0, 3, 3, 3}};
    for (size_t i = 0; i < ARRAY_LENGTH(others); i++) {
        size_t count = 1;
        while (count < 3 && others[i][count] < 3) count++;
        for (size_t k = 0; k < count; k++)
            send_raw(s->raw, frames[others[i][k]], sizes[others[i][k]], k + 1 < count);
        expect_malformed(s);
    }
    for (int i = 0; i < 3; i++) send_raw(s->raw, frames[i], sizes[i] - (i == 1), i < 2);
    expect_malformed(s);
    for (int i = 0; i < 3; i++) send_raw(s->raw, frames[i], sizes[i], i < 2);
    assert_int_equal(receive(s->router, true, &message, &received).code, RESULT_OK);
    assert_int_equal(message.payload_count, 2);
    wire_free(&message);
}

static void bad_headers_are_errors(void **state)
{
    sockets_t *s = *state;
    const struct {
        const char *bytes;
        size_t size;
    } bad[] = {{"", 0},
               {"LMIL", 4},
               {"LMIL\7", 5},
               {"LMIX\1\10\1", 7},
               {"LMIL\7\10\1", 7},
               {"LMIL\7\0\0\0\0", 9},
               {"LMIL\7\0\0\0\0\10\1", 11},
               {"LMIL\2\377\377\377", 8},
               {"GET / HTTP/1.1\r\n\r\n", 18}};
    for (size_t i = 0; i < ARRAY_LENGTH(bad); i++) {
        send_raw(s->raw, bad[i].bytes, bad[i].size, false);
        expect_malformed(s);
        send_raw(s->raw, bad[i].bytes, bad[i].size, true);
        send_raw(s->raw, "payload", 7, false);
        expect_malformed(s);
    }
    char *huge = mem_zalloc(1, WIRE_MAX_HEADER + 1);
    memcpy(huge, "LMIL\7", 5);
    send_raw(s->raw, huge, WIRE_MAX_HEADER + 1, false);
    expect_malformed(s);
    free(huge);
}

static void another_version_is_named(void **state)
{
    sockets_t *s = *state;
    wire_message_t message;
    bool received;
    send_raw(s->raw, "LMIL\11\10\1", 7, false);
    result_t result = receive(s->router, true, &message, &received);
    assert_int_equal(result.code, RESULT_PROTOCOL);
    assert_non_null(strstr(result.message, "protocol 9"));
}

static void too_many_payloads_are_errors(void **state)
{
    sockets_t *s = *state;
    Lm__Heartbeat beat;
    Lm__Envelope envelope = heartbeat_envelope(&beat);
    size_t size;
    uint8_t *bytes = packed(&envelope, &size);
    for (int extra = WIRE_MAX_PAYLOADS + 1; extra < 20; extra++) {
        send_raw(s->raw, bytes, size, true);
        for (int i = 1; i < extra; i++) send_raw(s->raw, "p", 1, true);
        send_raw(s->raw, "p", 1, false);
        expect_malformed(s);
    }
    send_raw(s->raw, bytes, size, false); /* the socket is still good */
    wire_message_t message;
    bool received;
    assert_int_equal(receive(s->router, true, &message, &received).code, RESULT_OK);
    assert_true(received);
    wire_free(&message);
    free(bytes);
}

static void long_strings_are_errors_and_harmful_characters_go(void **state)
{
    sockets_t *s = *state;
    Lm__Hello hello = LM__HELLO__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    char *name = mem_zalloc(1, WIRE_MAX_STRING + 2);
    memset(name, 'a', WIRE_MAX_STRING);
    name[0] = '\033';
    name[1] = '\n';
    hello.name = name;
    envelope.body_case = LM__ENVELOPE__BODY_HELLO;
    envelope.hello = &hello;
    wire_message_t message;
    bool received;
    assert_int_equal(wire_send(s->dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    assert_int_equal(receive(s->router, true, &message, &received).code, RESULT_OK);
    assert_int_equal(strlen(message.envelope->hello->name), WIRE_MAX_STRING);
    assert_int_equal(strncmp(message.envelope->hello->name, "??aaa", 5), 0);
    wire_free(&message);
    /* C1, overrides, isolates, marks, a separator, bytes that are not UTF-8; and what is harmless. */
    hello.name = "a\xc2\x9b"
                 "b\u202e"
                 "c\u2066"
                 "d\u200f"
                 "e\u061c"
                 "f\u2028"
                 "g\xff"
                 "h\xe2\x80 Größe \u2067λ 縫";
    assert_int_equal(wire_send(s->dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    assert_int_equal(receive(s->router, true, &message, &received).code, RESULT_OK);
    assert_string_equal(message.envelope->hello->name, "a?b?c?d?e?f?g?h?? Größe ?λ 縫");
    wire_free(&message);
    hello.name = name;
    name[WIRE_MAX_STRING] = 'a';
    assert_int_equal(wire_send(s->dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    expect_malformed(s);
    char *capabilities[] = {"ok", name};
    hello.name = "";
    hello.capabilities = capabilities;
    hello.n_capabilities = 2;
    assert_int_equal(wire_send(s->dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    expect_malformed(s);
    free(name);
}

static void too_many_units_are_errors(void **state)
{
    sockets_t *s = *state;
    size_t count = WIRE_MAX_UNITS + 1;
    unit_t *units = mem_zalloc(count, sizeof *units);
    Lm__BatchResult batch = LM__BATCH_RESULT__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_RESULT;
    envelope.batch_result = &batch;
    batch.units = wire_units_new(units, NULL, count);
    wire_message_t message;
    bool received;
    batch.n_units = count - 1;
    assert_int_equal(wire_send(s->dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    assert_int_equal(receive(s->router, true, &message, &received).code, RESULT_OK);
    assert_int_equal(message.envelope->batch_result->n_units, count - 1);
    assert_true(message.memory > message.bytes + (count - 1) * sizeof(Lm__Unit)); /* what it takes is known */
    wire_free(&message);
    batch.n_units = count;
    assert_int_equal(wire_send(s->dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    expect_malformed(s);
    free(batch.units);
    /* A megabyte of empty units would take forty: the decoder stops at its budget. */
    size_t size = WIRE_MAX_HEADER - 16;
    uint8_t *bytes = mem_alloc(size), *field = bytes + PEER_ENVELOPE_AT;
    memcpy(bytes, (uint8_t[]){'L', 'M', 'I', 'L', WIRE_VERSION}, 5);
    field[0] = 0x9A; /* field 19, batch_result */
    field[1] = 0x01;
    size_t inner = size - PEER_ENVELOPE_AT - 5;
    for (int i = 0; i < 3; i++) field[2 + i] = (uint8_t)((inner >> (7 * i) & 0x7F) | (i < 2 ? 0x80 : 0));
    for (size_t i = 5; i + 1 < inner + 5; i += 2) {
        field[i] = 0x22; /* field 4, units */
        field[i + 1] = 0;
    }
    peer_seal(bytes, size, NULL, NULL, 0);
    send_raw(s->raw, bytes, size, false);
    expect_malformed(s);
    free(bytes);
    free(units);
}

static void random_and_truncated_headers_do_no_harm(void **state)
{
    sockets_t *s = *state;
    Lm__Unit unit = LM__UNIT__INIT, *units[] = {&unit, &unit};
    Lm__Settings settings = LM__SETTINGS__INIT;
    Lm__Assignment assignment = LM__ASSIGNMENT__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    job_settings_t defaults = job_settings_default();
    hash_t hash = hash_bytes("x", 1);
    wire_settings_put(&defaults, &settings);
    unit.tile = 300;
    unit.count = 77;
    assignment.units = units;
    assignment.n_units = 2;
    assignment.settings = &settings;
    assignment.blob = wire_hash_put(&hash);
    envelope.body_case = LM__ENVELOPE__BODY_ASSIGNMENT;
    envelope.assignment = &assignment;
    size_t size;
    uint8_t *bytes = packed(&envelope, &size), *copy = mem_alloc(size);
    uint64_t random = 7;
    for (int i = 0; i < 3000; i++) {
        memcpy(copy, bytes, size);
        size_t length = i < (int)size ? (size_t)i : size;
        for (int c = 0; length == size && c < 3; c++) {
            random = random * 6364136223846793005u + 1442695040888963407u;
            copy[5 + (random >> 33) % (size - 5)] = (uint8_t)(random >> 20);
        }
        if (i % 16 > 0) peer_seal(copy, length, NULL, NULL, 0);
        send_raw(s->raw, copy, length, false);
        wire_message_t message;
        bool received;
        result_t result = receive(s->router, true, &message, &received);
        assert_true(result.code == RESULT_PROTOCOL || (result.code == RESULT_OK && received));
        wire_free(&message);
    }
    free(copy);
    free(bytes);
}

static void a_frame_over_the_limit_drops_the_connection(void **state)
{
    sockets_t *s = *state;
    void *router, *dealer;
    char endpoint[100];
    size_t size = sizeof endpoint;
    assert_int_equal(wire_socket(s->context, ZMQ_ROUTER, &router).code, RESULT_OK);
    assert_int_equal(wire_socket_limit(router, WIRE_MAX_CONTROL_FRAME).code, RESULT_OK);
    assert_int_equal(zmq_bind(router, "tcp://127.0.0.1:*"), 0);
    assert_int_equal(zmq_getsockopt(router, ZMQ_LAST_ENDPOINT, endpoint, &size), 0);
    assert_int_equal(wire_socket(s->context, ZMQ_DEALER, &dealer).code, RESULT_OK);
    assert_int_equal(zmq_connect(dealer, endpoint), 0);
    char *huge = mem_zalloc(2, WIRE_MAX_CONTROL_FRAME);
    send_raw(dealer, huge, 2 * WIRE_MAX_CONTROL_FRAME, false);
    free(huge);
    Lm__Heartbeat beat;
    Lm__Envelope envelope = heartbeat_envelope(&beat);
    wire_message_t message;
    bool received = false;
    for (int i = 0; i < 50 && !received; i++) { /* it reconnects by itself */
        assert_int_equal(wire_send(dealer, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
        zmq_pollitem_t item = {.socket = router, .events = ZMQ_POLLIN};
        zmq_poll(&item, 1, 100);
        assert_int_equal(wire_receive(router, true, &message, &received).code, RESULT_OK);
        if (received) wire_free(&message);
    }
    assert_true(received);
    zmq_close(dealer);
    zmq_close(router);
}

static void settings_units_and_counts_are_checked(void **state)
{
    (void)state;
    job_settings_t settings = job_settings_default(), got;
    Lm__Settings message = LM__SETTINGS__INIT;
    settings.seed = UINT64_MAX;
    settings.time_limit = 12.5;
    for (int on = 0; on < 2; on++) {
        settings.features = on;
        settings.strategy_s = 3 * on;
        settings.strategy_t = 2 * on;
        settings.unweighted = on;
        settings.error = 0.25 * on;
        settings.adaptive = on;
        settings.save_at = (save_at_t){.count = 0};
        if (!on) settings.save_at = (save_at_t){2, {16, JOB_MAX_SPP}};
        Lm__Settings there = LM__SETTINGS__INIT, back = LM__SETTINGS__INIT;
        wire_settings_put(&settings, &there);
        assert_int_equal(wire_settings_get(&there, &got).code, RESULT_OK);
        assert_int_equal(got.features, on);
        assert_int_equal(got.strategy_s, 3 * on);
        assert_int_equal(got.strategy_t, 2 * on);
        assert_int_equal(got.unweighted, on);
        assert_true(got.error == 0.25 * on && got.adaptive == (on == 1));
        assert_memory_equal(&got.save_at, &settings.save_at, sizeof got.save_at);
        wire_settings_put(&got, &back);
        uint8_t bytes[2][256]; /* the structures have padding, the messages have none */
        assert_true(lm__settings__get_packed_size(&there) <= sizeof bytes[0]);
        size_t size = lm__settings__pack(&there, bytes[0]);
        assert_int_equal(lm__settings__pack(&back, bytes[1]), size);
        assert_memory_equal(bytes[0], bytes[1], size);
    }
    wire_settings_put(&settings, &message);
    message.strategy_s = UINT32_MAX;
    assert_int_equal(wire_settings_get(&message, &got).code, RESULT_PROTOCOL);
    message.strategy_s = message.strategy_t = 1;
    assert_int_not_equal(wire_settings_get(&message, &got).code, RESULT_OK);
    wire_settings_put(&settings, &message);
    message.error = 1;
    assert_int_not_equal(wire_settings_get(&message, &got).code, RESULT_OK);
    message.error = 0.25;
    message.spp = JOB_MAX_ADAPTIVE_SPP + 1;
    assert_int_not_equal(wire_settings_get(&message, &got).code, RESULT_OK);
    message.spp = settings.spp;
    message.width = UINT32_MAX;
    assert_int_equal(wire_settings_get(&message, &got).code, RESULT_PROTOCOL);
    message.width = 0;
    assert_int_not_equal(wire_settings_get(&message, &got).code, RESULT_OK);
    message.width = message.height = JOB_MAX_RESOLUTION;
    assert_int_not_equal(wire_settings_get(&message, &got).code, RESULT_OK);
    assert_int_not_equal(wire_settings_get(NULL, &got).code, RESULT_OK);

    settings.adaptive = false;
    uint32_t save_at[JOB_MAX_SAVES + 1];
    for (uint32_t i = 0; i <= JOB_MAX_SAVES; i++) save_at[i] = i + 1;
    wire_settings_put(&settings, &message);
    message.save_at = save_at;
    message.n_save_at = JOB_MAX_SAVES;
    assert_int_equal(wire_settings_get(&message, &got).code, RESULT_OK);
    message.n_save_at++;
    assert_int_equal(wire_settings_get(&message, &got).code, RESULT_PROTOCOL);
    message.n_save_at = 2;
    save_at[1] = UINT32_MAX;
    assert_int_not_equal(wire_settings_get(&message, &got).code, RESULT_OK);

    const unit_t good[] = {{0, 0, 64}, {5, 63, 1}},
                 bad[] = {{0, 0, 0}, {1 << 30, 0, 1}, {0, 1, 64}, {0, UINT32_MAX, 2}};
    const issue_t issues[] = {{UINT64_MAX, 0, 0}, {1, 7, UINT32_MAX}};
    unit_t out[2];
    issue_t how[2];
    Lm__Unit **units = wire_units_new(good, issues, 2);
    assert_int_equal(wire_units_get(units, 2, &settings, out, how).code, RESULT_OK);
    assert_memory_equal(good, out, sizeof good);
    assert_memory_equal(issues, how, sizeof how);
    free(units);
    units = wire_units_new(good, NULL, 2);
    assert_int_equal(wire_units_get(units, 2, &settings, out, how).code, RESULT_OK);
    assert_memory_equal(how, (issue_t[2]){{0}}, sizeof how);
    free(units);
    for (size_t i = 0; i < ARRAY_LENGTH(bad); i++) {
        units = wire_units_new(&bad[i], NULL, 1);
        assert_int_equal(wire_units_get(units, 1, &settings, out, NULL).code, RESULT_PROTOCOL);
        free(units);
    }
    assert_null(wire_units_new(NULL, NULL, 0));

    film_counts_t counts = {{1, 2}, 3, 4, 5, 6}, back;
    Lm__Counts counts_message = LM__COUNTS__INIT;
    wire_counts_put(&counts, &counts_message);
    wire_counts_get(&counts_message, &back);
    assert_memory_equal(&counts, &back, sizeof back);
    wire_counts_get(NULL, &back);
    assert_int_equal(back.rays, 0);
}

static void set_key(void *socket, int option, const char *key)
{
    assert_int_equal(zmq_setsockopt(socket, option, key, strlen(key) + 1), 0);
}

/* A frame of exactly the limit comes through also where encryption makes it longer. */
static void the_largest_frame_fits_encrypted(void **state)
{
    (void)state;
    enum { LIMIT = 1 << 16 };
    void *context = zmq_ctx_new(), *router, *dealer;
    char server[2][41], client[2][41], endpoint[100];
    size_t size = sizeof endpoint;
    int yes = 1;
    assert_int_equal(zmq_curve_keypair(server[0], server[1]), 0);
    assert_int_equal(zmq_curve_keypair(client[0], client[1]), 0);
    assert_int_equal(wire_socket(context, ZMQ_ROUTER, &router).code, RESULT_OK);
    assert_int_equal(wire_socket(context, ZMQ_DEALER, &dealer).code, RESULT_OK);
    assert_int_equal(wire_socket_limit(router, LIMIT).code, RESULT_OK);
    assert_int_equal(zmq_setsockopt(router, ZMQ_CURVE_SERVER, &yes, sizeof yes), 0);
    set_key(router, ZMQ_CURVE_SECRETKEY, server[1]);
    set_key(dealer, ZMQ_CURVE_SERVERKEY, server[0]);
    set_key(dealer, ZMQ_CURVE_PUBLICKEY, client[0]);
    set_key(dealer, ZMQ_CURVE_SECRETKEY, client[1]);
    assert_int_equal(zmq_bind(router, "tcp://127.0.0.1:*"), 0);
    assert_int_equal(zmq_getsockopt(router, ZMQ_LAST_ENDPOINT, endpoint, &size), 0);
    assert_int_equal(zmq_connect(dealer, endpoint), 0);
    Lm__Heartbeat beat;
    Lm__Envelope envelope = heartbeat_envelope(&beat);
    zmq_msg_t payload;
    assert_int_equal(zmq_msg_init_size(&payload, LIMIT), 0);
    memset(zmq_msg_data(&payload), 7, LIMIT);
    assert_int_equal(wire_send(dealer, NULL, 0, &envelope, &payload, 1).code, RESULT_OK);
    wire_message_t message;
    bool received;
    assert_int_equal(receive(router, true, &message, &received).code, RESULT_OK);
    assert_true(received);
    assert_int_equal(zmq_msg_size(&message.payload[0]), LIMIT);
    wire_free(&message);
    zmq_close(dealer);
    zmq_close(router);
    zmq_ctx_term(context);
}

/* ---- plans --------------------------------------------------------------------------------------------- */

static void plans_come_back_by_pass(void **state)
{
    (void)state;
    job_settings_t settings = job_settings_default();
    const unit_t units[] = {{0, 0, 2}, {1, 4, 4}, {2, 8, 3}};
    hash_t plans[LEARNING_PASSES] = {[2] = hash_bytes("two", 3), [3] = hash_bytes("three", 5)};
    hash_t got[LEARNING_PASSES];
    size_t count;
    Lm__Plan **messages = wire_plans_new(plans, &count);
    assert_int_equal(count, 2);
    assert_int_equal(wire_plans_get(messages, count, &settings, units, 3, got).code, RESULT_OK);
    assert_memory_equal(got, plans, sizeof plans);
    assert_int_equal(wire_plans_get(messages, 1, &settings, units, 3, got).code, RESULT_PROTOCOL);
    assert_int_equal(wire_plans_get(messages, 1, &settings, units, 2, got).code, RESULT_OK);
    const unit_t crosses = {0, 7, 2};
    assert_int_equal(wire_plans_get(messages, count, &settings, &crosses, 1, got).code, RESULT_PROTOCOL);
    messages[1]->pass = 1; /* which has none */
    assert_int_equal(wire_plans_get(messages, count, &settings, units, 2, got).code, RESULT_PROTOCOL);
    messages[1]->pass = LEARNING_PASSES;
    assert_int_equal(wire_plans_get(messages, count, &settings, units, 2, got).code, RESULT_PROTOCOL);
    messages[1]->pass = 3;
    messages[1]->blob.len--;
    assert_int_equal(wire_plans_get(messages, count, &settings, units, 2, got).code, RESULT_PROTOCOL);
    settings.learn = false; /* then units are of any samples */
    assert_int_equal(wire_plans_get(NULL, 0, &settings, &crosses, 1, got).code, RESULT_OK);
    free(messages);
}

/* An older client or master knows nothing of it. */
static void a_message_without_it_does_not_learn(void **state)
{
    (void)state;
    job_settings_t settings = job_settings_default(), got;
    Lm__Settings message = LM__SETTINGS__INIT;
    wire_settings_put(&settings, &message);
    assert_int_equal(wire_settings_get(&message, &got).code, RESULT_OK);
    assert_true(got.learn);
    message.learn = ((Lm__Settings)LM__SETTINGS__INIT).learn;
    assert_int_equal(wire_settings_get(&message, &got).code, RESULT_OK);
    assert_false(got.learn);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define WITH_SOCKETS(test) cmocka_unit_test_setup_teardown(test, open_sockets, close_sockets)
        WITH_SOCKETS(messages_go_both_ways),
        WITH_SOCKETS(a_peer_that_is_gone_is_an_error),
        WITH_SOCKETS(a_full_queue_is_an_error),
        cmocka_unit_test(a_queue_that_was_emptied_is_not_full),
        WITH_SOCKETS(bad_headers_are_errors),
        WITH_SOCKETS(a_damaged_message_is_an_error),
        WITH_SOCKETS(another_version_is_named),
        WITH_SOCKETS(too_many_payloads_are_errors),
        WITH_SOCKETS(long_strings_are_errors_and_harmful_characters_go),
        WITH_SOCKETS(too_many_units_are_errors),
        WITH_SOCKETS(random_and_truncated_headers_do_no_harm),
        WITH_SOCKETS(a_frame_over_the_limit_drops_the_connection),
        cmocka_unit_test(the_largest_frame_fits_encrypted),
        cmocka_unit_test(the_checksum_is_crc_32c),
        cmocka_unit_test(settings_units_and_counts_are_checked),
        cmocka_unit_test(plans_come_back_by_pass),
        cmocka_unit_test(a_message_without_it_does_not_learn),
    };
    return cmocka_run_group_tests_name("wire", tests, NULL, NULL);
}
