/* peer: see peer.h. */
#include "tests/peer.h"

#include "common/scene/blob_builder.h"
#include "proto/wire/checksum.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static const double PATIENCE = 60; /* seconds for an answer, on a machine that does other things too */

static void *connect_to(void *context, const char *host, int port)
{
    void *socket;
    char endpoint[64];
    snprintf(endpoint, sizeof endpoint, "tcp://%s:0;127.0.0.1:%d", host, port);
    assert_int_equal(wire_socket(context, ZMQ_DEALER, &socket).code, RESULT_OK);
    assert_int_equal(zmq_connect(socket, endpoint), 0);
    return socket;
}

peer_t *peer_new(int control_port)
{
    return peer_new_from("127.0.0.1", control_port);
}

peer_t *peer_new_from(const char *host, int control_port)
{
    peer_t *peer = mem_zalloc(1, sizeof *peer);
    peer->context = zmq_ctx_new();
    peer->control = connect_to(peer->context, host, control_port);
    Lm__JobStatusRequest request = LM__JOB_STATUS_REQUEST__INIT;
    Lm__Envelope envelope = WIRE_ENVELOPE(JOB_STATUS_REQUEST, job_status_request, &request);
    wire_message_t answer = peer_ask_control(peer, &envelope);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_JOB_STATUS_REPLY);
    peer->bulk = connect_to(peer->context, host, (int)answer.envelope->job_status_reply->bulk_port);
    wire_free(&answer);
    return peer;
}

void peer_destroy(peer_t **peer)
{
    zmq_close((*peer)->control);
    zmq_close((*peer)->bulk);
    zmq_ctx_term((*peer)->context);
    issued_free(&(*peer)->issued);
    free(*peer);
    *peer = NULL;
}

void *peer_raw_socket(peer_t *peer, bool bulk)
{
    char endpoint[100];
    size_t size = sizeof endpoint;
    int linger = 200;
    assert_int_equal(zmq_getsockopt(bulk ? peer->bulk : peer->control, ZMQ_LAST_ENDPOINT, endpoint, &size),
                     0);
    void *socket = zmq_socket(peer->context, ZMQ_DEALER);
    zmq_setsockopt(socket, ZMQ_LINGER, &linger, sizeof linger);
    assert_int_equal(zmq_connect(socket, endpoint), 0);
    return socket;
}

/* ---- asking -------------------------------------------------------------------------------------------- */

static void take_push(peer_t *peer, const Lm__Envelope *envelope)
{
    if (envelope->body_case == LM__ENVELOPE__BODY_JOB_READY) peer->job_ready++;
    if (envelope->body_case != LM__ENVELOPE__BODY_JOB_OVER) return;
    peer->job_over++;
    peer->flush += envelope->job_over->flush;
    peer->over_job = envelope->job_over->job;
}

/* Waits for the next message of any kind; false when none comes in time. */
static bool next_message(void *socket, double until, wire_message_t *message)
{
    for (;;) {
        bool received;
        result_t result = wire_receive(socket, false, message, &received);
        if (result.code != RESULT_OK) fail_msg("the master sent nonsense: %s", result.message);
        if (received) return true;
        double left = until - clock_now();
        if (left <= 0) return false;
        zmq_pollitem_t item = {.socket = socket, .events = ZMQ_POLLIN};
        zmq_poll(&item, 1, (long)(1000 * left) + 1);
    }
}

static wire_message_t await(peer_t *peer, void *socket, uint64_t request)
{
    wire_message_t message;
    double until = clock_now() + PATIENCE;
    while (next_message(socket, until, &message)) {
        if (message.envelope->request == request) return message;
        take_push(peer, message.envelope);
        wire_free(&message);
    }
    fail_msg("no answer from the master");
    return message;
}

static wire_message_t ask(peer_t *peer, void *socket, Lm__Envelope *envelope, zmq_msg_t *payload,
                          int payloads)
{
    envelope->request = ++peer->requests;
    result_t result = wire_send(socket, NULL, 0, envelope, payload, payloads);
    if (result.code != RESULT_OK) fail_msg("cannot send: %s", result.message);
    return await(peer, socket, envelope->request);
}

void peer_seal(uint8_t *header, size_t size, const void *const *payloads, const size_t *sizes, int count)
{
    if (size < PEER_ENVELOPE_AT) return;
    uint32_t sum = checksum_add(0, header + PEER_ENVELOPE_AT, size - PEER_ENVELOPE_AT);
    for (int i = 0; i < count; i++) {
        uint64_t length = sizes[i];
        sum = checksum_add(sum, &length, sizeof length);
        sum = checksum_add(sum, payloads[i], sizes[i]);
    }
    memcpy(header + PEER_ENVELOPE_AT - sizeof sum, &sum, sizeof sum);
}

wire_message_t peer_ask_control(peer_t *peer, Lm__Envelope *envelope)
{
    return ask(peer, peer->control, envelope, NULL, 0);
}

wire_message_t peer_ask_bulk(peer_t *peer, Lm__Envelope *envelope, zmq_msg_t *payload, int payloads)
{
    return ask(peer, peer->bulk, envelope, payload, payloads);
}

void peer_listen(peer_t *peer, double seconds)
{
    wire_message_t message;
    if (!next_message(peer->control, clock_now() + seconds, &message)) return;
    take_push(peer, message.envelope);
    wire_free(&message);
}

/* The failure in a Refusal; anything but the expected answer ends the test. Frees a refusal. */
static result_t verdict(wire_message_t *answer, Lm__Envelope__BodyCase expected)
{
    if (answer->envelope->body_case == expected) return result_ok();
    assert_int_equal(answer->envelope->body_case, LM__ENVELOPE__BODY_REFUSAL);
    const Lm__Refusal *refusal = answer->envelope->refusal;
    assert_int_not_equal(refusal->code, RESULT_OK);
    result_t result = result_fail((result_code_t)refusal->code, "%s", refusal->reason);
    assert_true(strlen(refusal->reason) > 0);
    wire_free(answer);
    return result;
}

/* ---- a worker ------------------------------------------------------------------------------------------ */

void peer_hello(peer_t *peer, uint32_t version, uint32_t threads, result_t *refused)
{
    Lm__Hello hello = LM__HELLO__INIT;
    hello.protocol_version = version;
    hello.software = "peer";
    static const hash_t none;
    hello.name = peer->name != NULL ? (char *)peer->name : "peer";
    if (!hash_equal(&peer->fingerprint, &none)) hello.fingerprint = wire_hash_put(&peer->fingerprint);
    hello.threads = threads;
    Lm__Envelope envelope = WIRE_ENVELOPE(HELLO, hello, &hello);
    wire_message_t answer = peer_ask_control(peer, &envelope);
    result_t result = verdict(&answer, LM__ENVELOPE__BODY_WELCOME);
    if (refused != NULL) *refused = result;
    if (result.code != RESULT_OK) {
        assert_non_null(refused);
        return;
    }
    peer->worker = answer.envelope->welcome->worker;
    assert_true(peer->worker != 0);
    assert_true(answer.envelope->welcome->heartbeat_ms > 0);
    wire_free(&answer);
    if (peer->unprobed) return;
    result = peer_probe(peer, 0);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

result_t peer_probe(peer_t *peer, size_t bytes)
{
    Lm__Probe probe = LM__PROBE__INIT;
    probe.worker = peer->worker;
    Lm__Envelope envelope = WIRE_ENVELOPE(PROBE, probe, &probe);
    zmq_msg_t payload;
    zmq_msg_init_size(&payload, bytes);
    memset(zmq_msg_data(&payload), 0, bytes);
    wire_message_t answer = peer_ask_bulk(peer, &envelope, &payload, 1);
    result_t result = verdict(&answer, LM__ENVELOPE__BODY_PROBE_REPLY);
    if (result.code == RESULT_OK) wire_free(&answer);
    return result;
}

bool peer_heartbeat(peer_t *peer, uint64_t job, uint32_t units_held)
{
    Lm__Heartbeat beat = LM__HEARTBEAT__INIT;
    beat.worker = peer->worker;
    beat.job = job;
    beat.units_held = units_held;
    Lm__Envelope envelope = WIRE_ENVELOPE(HEARTBEAT, heartbeat, &beat);
    wire_message_t answer = peer_ask_control(peer, &envelope);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_HEARTBEAT_REPLY);
    bool known = answer.envelope->heartbeat_reply->known;
    wire_free(&answer);
    return known;
}

void peer_goodbye(peer_t *peer)
{
    Lm__Goodbye goodbye = LM__GOODBYE__INIT;
    goodbye.worker = peer->worker;
    goodbye.reason = "the script says so";
    Lm__Envelope envelope = WIRE_ENVELOPE(GOODBYE, goodbye, &goodbye);
    wire_message_t answer = peer_ask_control(peer, &envelope);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_DONE);
    wire_free(&answer);
}

void peer_work(peer_t *peer, uint64_t samples, uint64_t unit_samples, peer_work_t *work)
{
    Lm__WorkRequest request = LM__WORK_REQUEST__INIT;
    request.worker = peer->worker;
    request.samples = samples;
    request.unit_samples = unit_samples;
    Lm__Envelope envelope = WIRE_ENVELOPE(WORK_REQUEST, work_request, &request);
    wire_message_t answer = peer_ask_control(peer, &envelope);
    work->job = 0;
    work->unit_count = 0;
    work->refused = result_ok();
    if (answer.envelope->body_case == LM__ENVELOPE__BODY_NO_WORK) {
        assert_true(answer.envelope->no_work->retry_ms > 0);
        wire_free(&answer);
        return;
    }
    work->refused = verdict(&answer, LM__ENVELOPE__BODY_ASSIGNMENT);
    if (work->refused.code != RESULT_OK) return;
    const Lm__Assignment *assignment = answer.envelope->assignment;
    work->job = assignment->job;
    work->check = assignment->check;
    work->unit_count = assignment->n_units;
    assert_int_equal(wire_settings_get(assignment->settings, &work->settings).code, RESULT_OK);
    assert_int_equal(
        wire_units_get(assignment->units, assignment->n_units, &work->settings, work->units, work->issues)
            .code,
        RESULT_OK);
    for (size_t i = 0; i < work->unit_count; i++)
        issued_add(&peer->issued, &work->units[i], &work->issues[i].mac, 1);
    wire_free(&answer);
}

issue_t *peer_issues(peer_t *peer, const unit_t *units, size_t count)
{
    issue_t *issues = mem_alloc((count + 1) * sizeof *issues);
    issued_find(&peer->issued, units, count, issues);
    return issues;
}

batch_t peer_render(const job_settings_t *settings, const unit_t *units, size_t count)
{
    batch_t batch;
    unit_result_t result = {0};
    splat_t splats[2];
    batch_init(&batch, settings);
    for (size_t i = 0; i < count; i++) {
        unit_result_reset(&result, settings, &units[i]);
        size_t values = sum_unit_values(settings, SUM_EYE, &units[i]);
        for (size_t v = 0; v < values; v++)
            result.sums[SUM_EYE].values[v] = (int64_t)(units[i].tile * 1000 + v) * units[i].count << 20;
        first_hit_t hit = {.hit = true, .depth = (float)units[i].tile + 0.5f, .object = units[i].tile + 1};
        for (uint32_t p = 0; p < job_tile_pixels(settings, units[i].tile); p++)
            for (uint32_t s = units[i].first; s < units[i].first + units[i].count && s < FEATURE_SAMPLES; s++)
                unit_result_feature(&result, p, s, &hit);
        for (uint32_t s = 0; s < 2; s++)
            splats[s] = (splat_t){(units[i].tile * 7 + s) % (uint32_t)(settings->width * settings->height) |
                                      (s == 0 ? 0 : SPLAT_HALF_BIT),
                                  {0.5f * (float)units[i].count, 0.25f, 0.125f}};
        result.splats = splats;
        result.splat_count = 2;
        for (int half = 0; half < 2; half++)
            result.counts.light_paths[half] =
                (uint64_t)unit_half_count(&units[i], half) * job_tile_pixels(settings, units[i].tile);
        result.counts.rays = 10;
        batch_add(&batch, &result);
    }
    result.splats = NULL;
    unit_result_free(&result);
    return batch;
}

result_t peer_send_batch(peer_t *peer, uint64_t job, const batch_t *batch)
{
    return peer_send_check(peer, job, 0, batch);
}

result_t peer_send_check(peer_t *peer, uint64_t job, uint64_t check, const batch_t *batch)
{
    Lm__BatchResult body = LM__BATCH_RESULT__INIT;
    Lm__Counts counts = LM__COUNTS__INIT;
    zmq_msg_t payload[BATCH_PAYLOADS];
    wire_counts_put(&batch->counts, &counts);
    body.worker = peer->worker;
    body.job = job;
    body.check = check;
    body.sequence = peer->requests;
    body.n_units = batch->unit_count;
    issue_t *issues = peer_issues(peer, batch->units, batch->unit_count);
    body.units = wire_units_new(batch->units, issues, batch->unit_count);
    free(issues);
    body.counts = &counts;
    Lm__Envelope envelope = WIRE_ENVELOPE(BATCH_RESULT, batch_result, &body);
    assert_int_equal(payload_encode(batch, payload).code, RESULT_OK);
    wire_message_t answer = peer_ask_bulk(peer, &envelope, payload, BATCH_PAYLOADS);
    free(body.units);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_BATCH_REPLY);
    const Lm__BatchReply *reply = answer.envelope->batch_reply;
    assert_int_equal(reply->sequence, body.sequence);
    result_t result = reply->accepted ? result_ok() : result_fail(RESULT_MISMATCH, "%s", reply->reason);
    wire_free(&answer);
    return result;
}

/* ---- a client ------------------------------------------------------------------------------------------ */

uint8_t *peer_blob(uint32_t variant, uint64_t *size, hash_t *hash)
{
    blob_builder_t *builder = blob_builder_new();
    blob_scene_t scene = blob_default_scene();
    scene.width = scene.height = 64;
    scene.spp = 1 + variant;
    blob_object_t world = {0};
    uint8_t *bytes;
    blob_builder_add(builder, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(builder, BLOB_SECTION_OBJECTS, &world, 1);
    result_t result = blob_builder_finish(builder, &bytes, size);
    if (result.code != RESULT_OK) fail_msg("the test's blob is not valid: %s", result.message);
    blob_builder_destroy(&builder);
    *hash = hash_bytes(bytes, *size);
    return bytes;
}

result_t peer_put_chunk(peer_t *peer, const hash_t *hash, uint64_t offset, uint64_t size, const void *bytes,
                        size_t length, uint64_t *next)
{
    Lm__BlobPut put = LM__BLOB_PUT__INIT;
    zmq_msg_t payload;
    zmq_msg_init_size(&payload, length);
    if (length > 0) memcpy(zmq_msg_data(&payload), bytes, length);
    put.blob = wire_hash_put(hash);
    put.offset = offset;
    put.size = size;
    Lm__Envelope envelope = WIRE_ENVELOPE(BLOB_PUT, blob_put, &put);
    wire_message_t answer = peer_ask_bulk(peer, &envelope, &payload, 1);
    TRY(verdict(&answer, LM__ENVELOPE__BODY_BLOB_PUT_REPLY));
    *next = answer.envelope->blob_put_reply->next;
    wire_free(&answer);
    return result_ok();
}

result_t peer_put_blob(peer_t *peer, const uint8_t *bytes, uint64_t size, const hash_t *hash, size_t chunk)
{
    uint64_t next;
    TRY(peer_put_chunk(peer, hash, 0, size, NULL, 0, &next));
    while (next < size) {
        size_t length = size - next < chunk ? (size_t)(size - next) : chunk;
        TRY(peer_put_chunk(peer, hash, next, size, bytes + next, length, &next));
    }
    return result_ok();
}

result_t peer_submit(peer_t *peer, const char *name, const job_settings_t *settings, const hash_t *hash,
                     uint64_t *job)
{
    Lm__JobSubmit submit = LM__JOB_SUBMIT__INIT;
    Lm__Settings message = LM__SETTINGS__INIT;
    wire_settings_put(settings, &message);
    submit.name = (char *)name;
    submit.settings = &message;
    submit.blob = wire_hash_put(hash);
    Lm__Envelope envelope = WIRE_ENVELOPE(JOB_SUBMIT, job_submit, &submit);
    wire_message_t answer = peer_ask_control(peer, &envelope);
    TRY(verdict(&answer, LM__ENVELOPE__BODY_JOB_ACCEPTED));
    *job = answer.envelope->job_accepted->job;
    wire_free(&answer);
    return result_ok();
}

result_t peer_cancel(peer_t *peer, uint64_t job)
{
    Lm__JobOrder cancel = LM__JOB_ORDER__INIT;
    cancel.kind = ORDER_CANCEL;
    cancel.job = job;
    Lm__Envelope envelope = WIRE_ENVELOPE(JOB_ORDER, job_order, &cancel);
    wire_message_t answer = peer_ask_control(peer, &envelope);
    TRY(verdict(&answer, LM__ENVELOPE__BODY_DONE));
    wire_free(&answer);
    return result_ok();
}

const Lm__JobStatus *peer_status(peer_t *peer, uint64_t job, wire_message_t *message)
{
    Lm__JobStatusRequest request = LM__JOB_STATUS_REQUEST__INIT;
    request.job = job;
    Lm__Envelope envelope = WIRE_ENVELOPE(JOB_STATUS_REQUEST, job_status_request, &request);
    *message = peer_ask_control(peer, &envelope);
    if (verdict(message, LM__ENVELOPE__BODY_JOB_STATUS_REPLY).code != RESULT_OK) return NULL;
    assert_int_equal(message->envelope->job_status_reply->n_jobs, 1);
    return message->envelope->job_status_reply->jobs[0];
}

job_state_t peer_wait(peer_t *peer, uint64_t job, double seconds)
{
#ifdef __SANITIZE_THREAD__
    seconds *= 10; /* the master is so much slower */
#endif
    double until = clock_now() + seconds;
    for (;;) {
        wire_message_t message;
        const Lm__JobStatus *status = peer_status(peer, job, &message);
        assert_non_null(status);
        job_state_t state = (job_state_t)status->state;
        wire_free(&message);
        if (job_state_final((uint32_t)state) || clock_now() > until) return state;
        usleep(20000);
    }
}

/* One ImageGet; appends what comes to the file. */
static result_t fetch_chunk(peer_t *peer, Lm__ImageGet *get, FILE *file, uint64_t *size)
{
    Lm__Envelope envelope = WIRE_ENVELOPE(IMAGE_GET, image_get, get);
    wire_message_t answer = peer_ask_bulk(peer, &envelope, NULL, 0);
    TRY(verdict(&answer, LM__ENVELOPE__BODY_IMAGE_CHUNK));
    const Lm__ImageChunk *chunk = answer.envelope->image_chunk;
    assert_int_equal(answer.payload_count, 1);
    assert_true(chunk->offset == get->offset);
    size_t length = zmq_msg_size(&answer.payload[0]);
    assert_true(length > 0 && length <= get->length);
    assert_int_equal(fwrite(zmq_msg_data(&answer.payload[0]), 1, length, file), length);
    get->snapshot = chunk->snapshot;
    get->offset += length;
    *size = chunk->size;
    wire_free(&answer);
    return result_ok();
}

result_t peer_fetch(peer_t *peer, uint64_t job, bool half, uint32_t chunk, const char *path)
{
    Lm__ImageGet get = LM__IMAGE_GET__INIT;
    uint64_t size = 1;
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    get.job = job;
    get.half = half;
    get.length = chunk;
    result_t result = result_ok();
    while (result.code == RESULT_OK && get.offset < size) result = fetch_chunk(peer, &get, file, &size);
    fclose(file);
    return result;
}
