/* Hostile bytes on every socket: raw TCP, frames that are no messages, messages cut anywhere or with bits
 * turned over, a wrong version, batches of work that nobody gave. The render in progress goes on to the same
 * bits, and nothing crashes; the other way round, a worker survives a master that sends it the same. */
#include "tests/peer.h"
#include "tests/rig.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static void fill_random(unsigned *seed, uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) bytes[i] = (uint8_t)(rand_r(seed) >> 7);
}

/* Bytes straight into a TCP connection, some after a half ZMTP greeting. */
static void send_raw(int port, unsigned *seed)
{
    for (int round = 0; round < 6; round++) {
        int file = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
        address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        assert_int_equal(connect(file, (struct sockaddr *)&address, sizeof address), 0);
        uint8_t bytes[4096];
        fill_random(seed, bytes, sizeof bytes);
        if (round % 2) memcpy(bytes, "\xff\0\0\0\0\0\0\0\1\x7f\3", 11);
        if (send(file, bytes, sizeof bytes, MSG_NOSIGNAL) < 0) rig_sleep(0);
        close(file);
    }
}

static void *dial(void *context, int port)
{
    void *socket = zmq_socket(context, ZMQ_DEALER);
    int linger = 1000;
    zmq_setsockopt(socket, ZMQ_LINGER, &linger, sizeof linger);
    char *endpoint = mem_printf("tcp://127.0.0.1:%d", port);
    assert_int_equal(zmq_connect(socket, endpoint), 0);
    free(endpoint);
    return socket;
}

/* One well-formed message of each kind that a master takes in, packed as a header frame; fresh memory. */
static uint8_t *pack(Lm__Envelope *envelope, size_t *size)
{
    *size = PEER_ENVELOPE_AT + lm__envelope__get_packed_size(envelope);
    uint8_t *frame = mem_alloc(*size);
    memcpy(frame, "LMIL", 4);
    frame[4] = WIRE_VERSION;
    lm__envelope__pack(envelope, frame + PEER_ENVELOPE_AT);
    peer_seal(frame, *size, NULL, NULL, 0);
    return frame;
}

static uint8_t *sample_message(int kind, size_t *size)
{
    static uint8_t hash[HASH_BYTES];
    Lm__Unit unit = LM__UNIT__INIT;
    unit.tile = 1;
    unit.count = 4;
    Lm__Unit *units[] = {&unit, &unit};
    Lm__Counts counts = LM__COUNTS__INIT;
    Lm__Hello hello = LM__HELLO__INIT;
    hello.protocol_version = WIRE_VERSION + 41;
    hello.name = "hostile";
    Lm__WorkRequest work = LM__WORK_REQUEST__INIT;
    work.worker = 12345;
    work.samples = UINT64_MAX;
    Lm__BatchResult batch = LM__BATCH_RESULT__INIT;
    batch.worker = 12345;
    batch.job = 1;
    batch.n_units = 2;
    batch.units = units;
    batch.counts = &counts;
    Lm__BlobPut put = LM__BLOB_PUT__INIT;
    put.blob = (ProtobufCBinaryData){sizeof hash, hash};
    put.offset = UINT64_MAX - 3;
    put.size = UINT64_MAX;
    Lm__ImageGet image = LM__IMAGE_GET__INIT;
    image.job = 1;
    image.snapshot = 99;
    image.offset = UINT64_MAX;
    Lm__Settings settings = LM__SETTINGS__INIT;
    settings.width = settings.height = UINT32_MAX;
    Lm__JobSubmit submit = LM__JOB_SUBMIT__INIT;
    submit.settings = &settings;
    submit.blob = put.blob;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.request = 7;
    switch (kind) {
    case 0:
        envelope.body_case = LM__ENVELOPE__BODY_HELLO;
        envelope.hello = &hello;
        break;
    case 1:
        envelope.body_case = LM__ENVELOPE__BODY_WORK_REQUEST;
        envelope.work_request = &work;
        break;
    case 2:
        envelope.body_case = LM__ENVELOPE__BODY_BATCH_RESULT;
        envelope.batch_result = &batch;
        break;
    case 3:
        envelope.body_case = LM__ENVELOPE__BODY_BLOB_PUT;
        envelope.blob_put = &put;
        break;
    case 4:
        envelope.body_case = LM__ENVELOPE__BODY_IMAGE_GET;
        envelope.image_get = &image;
        break;
    default:
        envelope.body_case = LM__ENVELOPE__BODY_JOB_SUBMIT;
        envelope.job_submit = &submit;
        break;
    }
    return pack(&envelope, size);
}

/* Sends a header frame and up to three random payloads, after `identity` on a ROUTER; `seal` gives it the
 * right checksum, so that more of it is looked at. */
static void send_frames(void *socket, const zmq_msg_t *identity, uint8_t *frame, size_t size, bool seal,
                        unsigned *seed)
{
    uint8_t payload[64];
    fill_random(seed, payload, sizeof payload);
    int payloads = (int)(rand_r(seed) % 4);
    size_t sizes[3];
    for (int i = 0; i < payloads; i++) sizes[i] = rand_r(seed) % sizeof payload;
    if (seal) peer_seal(frame, size, (const void *[]){payload, payload, payload}, sizes, payloads);
    if (identity) {
        zmq_send(socket, zmq_msg_data((zmq_msg_t *)identity), zmq_msg_size(identity),
                 ZMQ_SNDMORE | ZMQ_DONTWAIT);
    }
    zmq_send(socket, frame, size, ZMQ_DONTWAIT | (payloads ? ZMQ_SNDMORE : 0));
    for (int i = 0; i < payloads; i++)
        zmq_send(socket, payload, sizes[i], ZMQ_DONTWAIT | (i + 1 < payloads ? ZMQ_SNDMORE : 0));
}

/* Good messages, prefixes of them, and copies with bits turned over; then plain noise. */
static void send_mutants(void *socket, const zmq_msg_t *identity, unsigned *seed, int rounds)
{
    for (int round = 0; round < rounds; round++) {
        size_t size;
        uint8_t *frame = sample_message(round % 6, &size);
        size_t length = size;
        if (round / 6 % 3 == 1) length = rand_r(seed) % size;
        for (int i = 0; round / 6 % 3 == 2 && i < 4; i++)
            frame[rand_r(seed) % size] ^= (uint8_t)(1u << (rand_r(seed) % 8));
        send_frames(socket, identity, frame, length, round % 5 > 0, seed);
        free(frame);
        uint8_t noise[200];
        fill_random(seed, noise, sizeof noise);
        send_frames(socket, identity, noise, rand_r(seed) % sizeof noise, round % 2, seed);
    }
}

static void a_master_survives(void **state)
{
    (void)state;
    hash_t reference = rig_reference();
    rig_t *rig = rig_new();
    rig_start_master(rig, 0.2);
    rig_start_worker(rig);
    job_settings_t settings = rig_settings();
    uint64_t job = rig_submit(rig, &settings);
    rig_wait_samples(rig, job, 1);
    unsigned seed = 1;
    void *context = zmq_ctx_new();
    for (int which = 0; which < 2; which++) {
        send_raw(rig->port + which, &seed);
        void *socket = dial(context, rig->port + which);
        send_mutants(socket, NULL, &seed, 300);
        rig_sleep(0.2);
        zmq_close(socket);
    }
    zmq_ctx_term(context);
    rig_status_t status = rig_wait_job(rig, job);
    assert_int_equal(status.state, JOB_DONE);
    hash_t hash = rig_image_hash(rig, job);
    assert_true(hash_equal(&hash, &reference));
    kill(rig->master, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, rig->master, 30), 0);
    rig_destroy(&rig);
}

static void a_wrong_version_is_refused(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    rig_start_master(rig, 0.2);
    void *context = zmq_ctx_new(), *socket = dial(context, rig->port);
    size_t size;
    uint8_t *frame = sample_message(0, &size);
    zmq_send(socket, frame, size, 0);
    free(frame);
    wire_message_t message;
    bool received = false;
    for (int i = 0; i < 500 && !received; i++) {
        assert_int_equal(wire_receive(socket, false, &message, &received).code, RESULT_OK);
        rig_sleep(0.01);
    }
    assert_true(received);
    assert_int_equal(message.envelope->body_case, LM__ENVELOPE__BODY_REFUSAL);
    assert_int_equal(message.envelope->request, 7);
    assert_true(message.envelope->refusal->reason[0] != '\0');
    wire_free(&message);
    zmq_close(socket);
    zmq_ctx_term(context);
    rig_destroy(&rig);
}

/* A welcome that sends the worker's bulk traffic to the second hostile socket, then an assignment of
 * nonsense. */
static void mislead_worker(void *socket, const zmq_msg_t *identity, int port, unsigned *seed)
{
    Lm__Welcome welcome = LM__WELCOME__INIT;
    welcome.protocol_version = WIRE_VERSION;
    welcome.worker = 1;
    welcome.bulk_port = (uint32_t)port + 1;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_WELCOME;
    envelope.welcome = &welcome;
    size_t size;
    uint8_t *frame = pack(&envelope, &size);
    zmq_send(socket, zmq_msg_data((zmq_msg_t *)identity), zmq_msg_size(identity), ZMQ_SNDMORE);
    zmq_send(socket, frame, size, 0);
    free(frame);
    Lm__Settings settings = LM__SETTINGS__INIT;
    wire_settings_put(&(job_settings_t){.integrator = INTEGRATOR_BDPT,
                                        .sampler = SAMPLER_SOBOL,
                                        .width = 64,
                                        .height = 64,
                                        .max_depth = 8,
                                        .spp = 16,
                                        .tile_size = 32,
                                        .film_scale = 32},
                      &settings);
    static uint8_t hash[HASH_BYTES];
    Lm__Unit unit = LM__UNIT__INIT;
    unit.count = 16;
    Lm__Unit *units[] = {&unit};
    Lm__Assignment assignment = LM__ASSIGNMENT__INIT;
    assignment.job = 5;
    assignment.settings = &settings;
    assignment.blob = (ProtobufCBinaryData){sizeof hash, hash};
    assignment.blob_size = 1000;
    assignment.n_units = 1;
    assignment.units = units;
    envelope.body_case = LM__ENVELOPE__BODY_ASSIGNMENT;
    envelope.assignment = &assignment;
    for (int round = 0; round < 60; round++) {
        frame = pack(&envelope, &size);
        for (int i = 0; i < round % 4; i++) frame[rand_r(seed) % size] ^= (uint8_t)(1u << (rand_r(seed) % 8));
        send_frames(socket, identity, frame, round % 5 == 4 ? rand_r(seed) % size : size, true, seed);
        free(frame);
    }
    zmq_send(socket, zmq_msg_data((zmq_msg_t *)identity), zmq_msg_size(identity), ZMQ_SNDMORE);
    frame = pack(&envelope, &size);
    zmq_send(socket, frame, size, 0);
    free(frame);
}

/* Answers everything that comes with nonsense for `seconds`. */
static void play_master(void *sockets[2], int port, double seconds)
{
    unsigned seed = 2;
    bool misled = false;
    for (double end = clock_now() + seconds; clock_now() < end; rig_sleep(0.01)) {
        for (int which = 0; which < 2; which++) {
            zmq_msg_t identity, rest;
            zmq_msg_init(&identity);
            zmq_msg_init(&rest);
            if (zmq_msg_recv(&identity, sockets[which], ZMQ_DONTWAIT) >= 0) {
                while (zmq_msg_more(&identity) && zmq_msg_recv(&rest, sockets[which], 0) >= 0 &&
                       zmq_msg_more(&rest)) {
                }
                if (which == 0 && !misled) mislead_worker(sockets[0], &identity, port, &seed);
                misled = true;
                send_mutants(sockets[which], &identity, &seed, 12);
            }
            zmq_msg_close(&rest);
            zmq_msg_close(&identity);
        }
    }
}

static void a_worker_survives(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    void *context = zmq_ctx_new(), *sockets[2];
    int linger = 0;
    for (int i = 0; i < 2; i++) {
        char *endpoint = mem_printf("tcp://127.0.0.1:%d", rig->port + i);
        sockets[i] = zmq_socket(context, ZMQ_ROUTER);
        zmq_setsockopt(sockets[i], ZMQ_LINGER, &linger, sizeof linger);
        assert_int_equal(zmq_bind(sockets[i], endpoint), 0);
        free(endpoint);
    }
    pid_t worker = rig_start_worker(rig);
    play_master(sockets, rig->port, 3);
    for (int i = 0; i < 2; i++) zmq_close(sockets[i]);
    zmq_ctx_term(context);
    kill(worker, SIGTERM);
    assert_int_equal(rig_wait_exit(rig, worker, 40), 0);
    rig_destroy(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_master_survives),
        cmocka_unit_test(a_wrong_version_is_refused),
        cmocka_unit_test(a_worker_survives),
    };
    return cmocka_run_group_tests_name("hostile bytes", tests, NULL, NULL);
}
