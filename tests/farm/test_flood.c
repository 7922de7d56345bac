/* Floods on loopback: peers send nonsense, valid messages and connection attempts to both sockets as fast as
 * they can, from several threads, while a well-behaved worker measures how long its heartbeats take. It must
 * never come near to losing its lease. The figures are printed. */
#include "proto/wire/checksum.h"
#include "tests/rig.h"
#include "tests/scratch.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { HEADER_BYTES = 9, FLOODERS = 4, SOCKETS = 4, MAX_BEATS = 2000 };
static const double LEASE = 5;    /* seconds: the default */
static const double PHASE = 1.5;  /* seconds of each flood */
static const double PAUSE = 0.01; /* seconds between heartbeats */

/* ---- flooding -------------------------------------------------------------------------------------------
 */

typedef enum {
    FLOOD_GARBAGE,     /* frames of random bytes */
    FLOOD_HEARTBEATS,  /* valid, of nobody */
    FLOOD_LARGE,       /* valid, and as much work to decode as the socket lets in */
    FLOOD_UPLOADS,     /* parts of blobs, 4 MiB each, in the wrong order */
    FLOOD_TCP,         /* connections that send random bytes and go */
    FLOOD_CONNECTIONS, /* connections with the flooder's keys, one after another */
} flood_kind_t;

typedef struct {
    flood_kind_t kind;
    int port;
    dial_keys_t keys;
    atomic_bool *stop;
    pthread_t thread;
    unsigned seed;
    _Atomic uint64_t sent;
} flooder_t;

static void fill_random(unsigned *seed, uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) bytes[i] = (uint8_t)(rand_r(seed) >> 7);
}

/* A header frame for the envelope and, if there is one, its payload. */
static void put_envelope(Lm__Envelope *envelope, const zmq_msg_t *payload, zmq_msg_t *frame)
{
    zmq_msg_init_size(frame, HEADER_BYTES + lm__envelope__get_packed_size(envelope));
    uint8_t *bytes = zmq_msg_data(frame);
    memcpy(bytes, "LMIL", 4);
    bytes[4] = WIRE_VERSION;
    lm__envelope__pack(envelope, bytes + HEADER_BYTES);
    uint32_t sum = checksum_add(0, bytes + HEADER_BYTES, zmq_msg_size(frame) - HEADER_BYTES);
    if (payload != NULL) {
        uint64_t size = zmq_msg_size(payload);
        sum = checksum_add(sum, &size, sizeof size);
        sum = checksum_add(sum, zmq_msg_data((zmq_msg_t *)payload), size);
    }
    memcpy(bytes + 5, &sum, sizeof sum);
}

/* One message of the flood as frames; returns how many. */
static int make_message(flooder_t *flooder, zmq_msg_t frames[2])
{
    static const unit_t units[7000];
    static uint8_t hash[HASH_BYTES];
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    Lm__Heartbeat beat = LM__HEARTBEAT__INIT;
    Lm__BatchResult batch = LM__BATCH_RESULT__INIT;
    Lm__BlobPut put = LM__BLOB_PUT__INIT;
    switch (flooder->kind) {
    case FLOOD_HEARTBEATS:
        beat.worker = rand_r(&flooder->seed);
        envelope.body_case = LM__ENVELOPE__BODY_HEARTBEAT;
        envelope.heartbeat = &beat;
        put_envelope(&envelope, NULL, &frames[0]);
        return 1;
    case FLOOD_LARGE:
        batch.n_units = ARRAY_LENGTH(units);
        batch.units = wire_units_new(units, NULL, ARRAY_LENGTH(units));
        envelope.body_case = LM__ENVELOPE__BODY_BATCH_RESULT;
        envelope.batch_result = &batch;
        put_envelope(&envelope, NULL, &frames[0]);
        free(batch.units);
        return 1;
    case FLOOD_UPLOADS:
        put.blob = (ProtobufCBinaryData){sizeof hash, hash};
        put.offset = 1;
        put.size = 1 << 30;
        envelope.body_case = LM__ENVELOPE__BODY_BLOB_PUT;
        envelope.blob_put = &put;
        zmq_msg_init_size(&frames[1], WIRE_MAX_CHUNK);
        memset(zmq_msg_data(&frames[1]), 1, WIRE_MAX_CHUNK);
        put_envelope(&envelope, &frames[1], &frames[0]);
        return 2;
    default:
        zmq_msg_init_size(&frames[0], 1 + rand_r(&flooder->seed) % 300);
        fill_random(&flooder->seed, zmq_msg_data(&frames[0]), zmq_msg_size(&frames[0]));
        if (rand_r(&flooder->seed) % 2 && zmq_msg_size(&frames[0]) > HEADER_BYTES) {
            memcpy(zmq_msg_data(&frames[0]), "LMIL", 4);
            ((uint8_t *)zmq_msg_data(&frames[0]))[4] = WIRE_VERSION;
        }
        return 1;
    }
}

static void *dial(flooder_t *flooder, void *context)
{
    void *socket = zmq_socket(context, ZMQ_DEALER);
    int linger = 0, timeout = 50, queued = flooder->kind == FLOOD_UPLOADS ? 2 : 200;
    char endpoint[64];
    snprintf(endpoint, sizeof endpoint, "tcp://127.0.0.1:%d", flooder->port);
    zmq_setsockopt(socket, ZMQ_LINGER, &linger, sizeof linger);
    zmq_setsockopt(socket, ZMQ_SNDTIMEO, &timeout, sizeof timeout);
    zmq_setsockopt(socket, ZMQ_SNDHWM, &queued, sizeof queued);
    dial_keys_apply(&flooder->keys, socket);
    zmq_connect(socket, endpoint);
    return socket;
}

static bool send_message(flooder_t *flooder, void *socket)
{
    zmq_msg_t frames[2];
    int count = make_message(flooder, frames);
    bool sent = true;
    for (int i = 0; i < count; i++) {
        sent = sent && zmq_msg_send(&frames[i], socket, i + 1 < count ? ZMQ_SNDMORE : 0) >= 0;
        if (!sent) zmq_msg_close(&frames[i]);
    }
    flooder->sent += sent;
    return sent;
}

static void drain(void *socket)
{
    zmq_msg_t frame;
    zmq_msg_init(&frame);
    while (zmq_msg_recv(&frame, socket, ZMQ_DONTWAIT) >= 0) {
    }
    zmq_msg_close(&frame);
}

static void flood_messages(flooder_t *flooder, void *context)
{
    void *sockets[SOCKETS];
    for (int i = 0; i < SOCKETS; i++) sockets[i] = dial(flooder, context);
    while (!atomic_load(flooder->stop))
        for (int i = 0; i < SOCKETS; i++) {
            send_message(flooder, sockets[i]);
            drain(sockets[i]);
        }
    for (int i = 0; i < SOCKETS; i++) zmq_close(sockets[i]);
}

static void flood_connections(flooder_t *flooder, void *context)
{
    while (!atomic_load(flooder->stop)) {
        void *sockets[SOCKETS];
        for (int i = 0; i < SOCKETS; i++) sockets[i] = dial(flooder, context);
        for (int i = 0; i < SOCKETS; i++) send_message(flooder, sockets[i]);
        rig_sleep(0.002);
        for (int i = 0; i < SOCKETS; i++) zmq_close(sockets[i]);
    }
}

static void flood_tcp(flooder_t *flooder)
{
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)flooder->port)};
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    while (!atomic_load(flooder->stop)) {
        uint8_t bytes[512];
        int file = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        struct linger reset = {.l_onoff = 1}; /* so that no ports are used up */
        setsockopt(file, SOL_SOCKET, SO_LINGER, &reset, sizeof reset);
        fill_random(&flooder->seed, bytes, sizeof bytes);
        if (flooder->sent % 2) memcpy(bytes, "\xff\0\0\0\0\0\0\0\1\x7f\3", 11);
        if (connect(file, (struct sockaddr *)&address, sizeof address) == 0 &&
            send(file, bytes, sizeof bytes, MSG_NOSIGNAL) > 0)
            flooder->sent++;
        close(file);
    }
}

static void *flood(void *argument)
{
    flooder_t *flooder = argument;
    /* In earnest the flood comes from other machines; here it should not take all processors from the master.
     */
    setpriority(PRIO_PROCESS, (id_t)gettid(), 5);
    void *context = zmq_ctx_new();
    if (flooder->kind == FLOOD_TCP)
        flood_tcp(flooder);
    else if (flooder->kind == FLOOD_CONNECTIONS)
        flood_connections(flooder, context);
    else
        flood_messages(flooder, context);
    zmq_ctx_term(context);
    return NULL;
}

/* ---- the well-behaved worker ----------------------------------------------------------------------------
 */

typedef struct {
    rig_t *rig;
    void *context, *socket;
    uint64_t request, worker;
    double beats[MAX_BEATS]; /* seconds each took */
    int beat_count;
    double most; /* p99, of all phases */
} good_t;

static dial_keys_t keys_of(rig_t *rig, const char *name)
{
    dial_keys_t keys = {0};
    if (rig->keys == NULL) return keys;
    char *secret = mem_printf("%s/%s.secret", rig->keys, name), *open = scratch_path(rig->keys, "master.key");
    dial_options_t options = {.role = name, .key = secret, .master_key = open};
    assert_int_equal(dial_keys_find(&options, "127.0.0.1", &keys).code, RESULT_OK);
    free(secret);
    free(open);
    return keys;
}

static wire_message_t ask(good_t *good, Lm__Envelope *envelope)
{
    wire_message_t answer;
    bool received = false;
    double deadline = clock_now() + 4 * LEASE;
    envelope->request = ++good->request;
    assert_int_equal(wire_send(good->socket, NULL, 0, envelope, NULL, 0).code, RESULT_OK);
    for (;;) {
        assert_int_equal(wire_receive(good->socket, false, &answer, &received).code, RESULT_OK);
        if (received && answer.envelope->request == good->request) return answer;
        if (received) wire_free(&answer);
        if (clock_now() > deadline) fail_msg("no answer");
        zmq_pollitem_t item = {.socket = good->socket, .events = ZMQ_POLLIN};
        zmq_poll(&item, 1, 100);
    }
}

static void say_hello(good_t *good, rig_t *rig)
{
    *good = (good_t){.rig = rig, .context = zmq_ctx_new()};
    char *endpoint = mem_printf("tcp://127.0.0.1:%d", rig->port);
    dial_keys_t keys = keys_of(rig, "worker");
    Lm__Hello hello = LM__HELLO__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    assert_int_equal(wire_socket(good->context, ZMQ_DEALER, &good->socket).code, RESULT_OK);
    assert_int_equal(dial_keys_apply(&keys, good->socket).code, RESULT_OK);
    assert_int_equal(zmq_connect(good->socket, endpoint), 0);
    dial_keys_free(&keys);
    free(endpoint);
    hello.protocol_version = WIRE_VERSION;
    hello.name = "good";
    hello.threads = 1;
    envelope.body_case = LM__ENVELOPE__BODY_HELLO;
    envelope.hello = &hello;
    wire_message_t answer = ask(good, &envelope);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_WELCOME);
    good->worker = answer.envelope->welcome->worker;
    wire_free(&answer);
}

static void beat(good_t *good)
{
    Lm__Heartbeat body = LM__HEARTBEAT__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    body.worker = good->worker;
    envelope.body_case = LM__ENVELOPE__BODY_HEARTBEAT;
    envelope.heartbeat = &body;
    double start = clock_now();
    wire_message_t answer = ask(good, &envelope);
    if (good->beat_count < MAX_BEATS) good->beats[good->beat_count++] = clock_now() - start;
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_HEARTBEAT_REPLY);
    assert_true(answer.envelope->heartbeat_reply->known); /* it has not lost its lease */
    wire_free(&answer);
}

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Beats for a phase, prints the figures, and holds them to the lease. */
static void measure(good_t *good, const char *what, uint64_t (*sent)(void *), void *context)
{
    double end = clock_now() + PHASE;
    uint64_t before = sent != NULL ? sent(context) : 0;
    good->beat_count = 0;
    for (; clock_now() < end; rig_sleep(PAUSE)) beat(good);
    int count = good->beat_count;
    assert_true(count > 0);
    qsort(good->beats, (size_t)count, sizeof good->beats[0], compare);
    double p50 = good->beats[count / 2], p99 = good->beats[count * 99 / 100], most = good->beats[count - 1];
    double rate = sent != NULL ? (double)(sent(context) - before) / PHASE : 0;
    printf("%-44s %8.0f a second; %4d heartbeats: p50 %6.2f, p99 %6.2f, max %6.2f ms\n", what, rate, count,
           1e3 * p50, 1e3 * p99, 1e3 * most);
    fflush(stdout);
    assert_true(count > 2);
#if !defined __SANITIZE_THREAD__ && !defined __SANITIZE_ADDRESS__
    assert_true(p99 < LEASE / 5);
#endif
    assert_true(most < LEASE / 2);
}

/* ---- floods against it ----------------------------------------------------------------------------------
 */

typedef struct {
    flooder_t flooders[FLOODERS];
    atomic_bool stop;
} flood_t;

static uint64_t count_sent(void *context)
{
    uint64_t sent = 0;
    for (int i = 0; i < FLOODERS; i++) sent += ((flood_t *)context)->flooders[i].sent;
    return sent;
}

/* `keys` are given to the flooders, who free nothing. */
static void endure(good_t *good, const char *what, flood_kind_t kind, bool bulk, const dial_keys_t *keys)
{
    flood_t *flooding = mem_zalloc(1, sizeof *flooding); /* its threads outlive a test that fails */
    for (int i = 0; i < FLOODERS; i++) {
        flooder_t *flooder = &flooding->flooders[i];
        *flooder = (flooder_t){.kind = kind, .port = good->rig->port + bulk, .stop = &flooding->stop};
        flooder->seed = (unsigned)(100 * (int)kind + i + 1);
        if (keys != NULL) flooder->keys = *keys;
        assert_int_equal(pthread_create(&flooder->thread, NULL, flood, flooder), 0);
    }
    rig_sleep(0.3);
    measure(good, what, count_sent, flooding);
    atomic_store(&flooding->stop, true);
    for (int i = 0; i < FLOODERS; i++) pthread_join(flooding->flooders[i].thread, NULL);
    assert_true(count_sent(flooding) > 10);
    free(flooding);
}

/* A master with its default times, and without a line for every message. */
static void start_master(rig_t *rig)
{
    char *listen = mem_printf("127.0.0.1:%d", rig->port), *data = scratch_path(rig->folder, "data");
    char *key = rig->keys ? scratch_path(rig->keys, "master.secret") : NULL;
    char *allow = rig->keys ? scratch_path(rig->keys, "allow") : NULL;
    rig->master = rig_start_program(rig, "lightmill-master",
                                    (const char *[]){"--listen", listen, "--data", data, key ? "--key" : NULL,
                                                     key, "--allow", allow, NULL});
    free(listen);
    free(data);
    free(key);
    free(allow);
}

static void finish(good_t *good, const char *expected)
{
    rig_t *rig = good->rig;
    zmq_close(good->socket);
    zmq_ctx_term(good->context);
    kill(rig->master, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, rig->master, 30), 0);
    char *output = rig_output(rig, rig->master);
#ifndef __SANITIZE_THREAD__ /* too slow to be over a limit */
    assert_non_null(strstr(output, expected));
#else
    (void)expected;
#endif
    assert_true(strlen(output) < 100000); /* a flood does not fill the disk with complaints */
    free(output);
    rig_destroy(&rig);
}

static void without_keys(void **state)
{
    (void)state;
    good_t good;
    rig_t *rig = rig_new();
    start_master(rig);
    say_hello(&good, rig);
    measure(&good, "no flood", NULL, NULL);
    endure(&good, "garbage to the control socket", FLOOD_GARBAGE, false, NULL);
    endure(&good, "heartbeats to the control socket", FLOOD_HEARTBEATS, false, NULL);
    endure(&good, "large messages to the control socket", FLOOD_LARGE, false, NULL);
    endure(&good, "connections to the control socket", FLOOD_CONNECTIONS, false, NULL);
    endure(&good, "bytes over TCP to the control socket", FLOOD_TCP, false, NULL);
    endure(&good, "garbage to the bulk socket", FLOOD_GARBAGE, true, NULL);
    endure(&good, "uploads of 4 MiB to the bulk socket", FLOOD_UPLOADS, true, NULL);
    finish(&good, "are dropped: more than");
}

static void with_keys(void **state)
{
    (void)state;
    good_t good;
    rig_t *rig = rig_new();
    rig_use_keys(rig);
    key_pair_t stranger;
    assert_int_equal(key_files_make(rig->keys, "stranger", &stranger).code, RESULT_OK);
    start_master(rig);
    say_hello(&good, rig);
    dial_keys_t unknown = keys_of(rig, "stranger"), client = keys_of(rig, "client");
    dial_keys_t misled = client;
    memcpy(misled.master, stranger.open, sizeof misled.master);
    measure(&good, "no flood, with keys", NULL, NULL);
    endure(&good, "connections with an unknown key", FLOOD_CONNECTIONS, false, &unknown);
    endure(&good, "connections for another master's key", FLOOD_CONNECTIONS, false, &misled);
    endure(&good, "connections without keys", FLOOD_CONNECTIONS, false, NULL);
    endure(&good, "bytes over TCP to the control socket", FLOOD_TCP, false, NULL);
    endure(&good, "heartbeats with a client's key", FLOOD_HEARTBEATS, false, &client);
    endure(&good, "uploads of 4 MiB to the bulk socket", FLOOD_UPLOADS, true, &client);
    dial_keys_free(&unknown);
    dial_keys_free(&client);
    finish(&good, "refused a connection from 127.0.0.1: the key");
}

int main(void)
{
    /* Of what is started here: libzmq 4.3.4 forgets a pipe now and then when it ends while connections break
     * off. */
    setenv("ASAN_OPTIONS", "detect_leaks=0", 1);
    const struct CMUnitTest tests[] = {cmocka_unit_test(without_keys), cmocka_unit_test(with_keys)};
    return cmocka_run_group_tests_name("floods", tests, NULL, NULL);
}
