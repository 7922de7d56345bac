/* scripted: see scripted.h. */
#include "tests/scripted.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { STEP_MS = 5, HEARTBEAT_MS = 100, LEASE_MS = 2000, RETRY_MS = 50 };

/* ---- sockets ------------------------------------------------------------------------------------------- */

static void *bind_to(void *context, int *port)
{
    void *socket;
    char endpoint[64];
    size_t size = sizeof endpoint;
    const int at_once = 0;
    assert_int_equal(wire_socket(context, ZMQ_ROUTER, &socket).code, RESULT_OK);
    zmq_setsockopt(socket, ZMQ_LINGER, &at_once, sizeof at_once);
    snprintf(endpoint, sizeof endpoint, *port > 0 ? "tcp://127.0.0.1:%d" : "tcp://127.0.0.1:*", *port);
    /* The port of a socket that was just closed is free a moment later. */
    for (double start = clock_now(); zmq_bind(socket, endpoint) != 0;)
        if (clock_now() - start > 5) fail_msg("cannot bind to %s: %s", endpoint, zmq_strerror(errno));
    assert_int_equal(zmq_getsockopt(socket, ZMQ_LAST_ENDPOINT, endpoint, &size), 0);
    *port = atoi(strrchr(endpoint, ':') + 1);
    return socket;
}

scripted_t *scripted_new(const scene_blob_t *blob, const job_settings_t *settings)
{
    scripted_t *script = mem_zalloc(1, sizeof *script);
    script->context = zmq_ctx_new();
    script->blob = blob;
    script->settings = *settings;
    script->control = bind_to(script->context, &script->control_port);
    script->bulk = bind_to(script->context, &script->bulk_port);
    script->granting = script->answering = script->counting = true;
    script->batch_interval = 0.1;
    script->worker = 1000;
    return script;
}

void scripted_destroy(scripted_t **pointer)
{
    scripted_t *script = *pointer;
    for (int i = 0; i < script->batch_count; i++) batch_free(&script->batches[i].batch);
    if (script->hello != NULL) lm__hello__free_unpacked(script->hello, NULL);
    zmq_close(script->control);
    zmq_close(script->bulk);
    zmq_ctx_term(script->context);
    free(script);
    *pointer = NULL;
}

char *scripted_endpoint(const scripted_t *script)
{
    return mem_printf("tcp://127.0.0.1:%d", script->control_port);
}

void scripted_break_bulk(scripted_t *script)
{
    zmq_close(script->bulk);
    script->bulk = bind_to(script->context, &script->bulk_port);
    script->offer = script->question = (scripted_question_t){0};
}

void scripted_forget(scripted_t *script)
{
    script->worker++;
}

void scripted_restart(scripted_t *script, double seconds)
{
    zmq_close(script->control);
    zmq_close(script->bulk);
    for (double end = clock_now() + seconds; clock_now() < end;) zmq_poll(NULL, 0, 10);
    script->control = bind_to(script->context, &script->control_port);
    script->bulk = bind_to(script->context, &script->bulk_port);
    script->offer = script->question = (scripted_question_t){0};
    scripted_forget(script);
}

/* ---- answers ------------------------------------------------------------------------------------------- */

static void say(void *socket, const uint8_t *identity, size_t size, uint64_t request, Lm__Envelope *envelope,
                zmq_msg_t *payload)
{
    envelope->request = request;
    wire_send(socket, identity, size, envelope, payload, payload != NULL);
}

static void answer(void *socket, const wire_message_t *message, Lm__Envelope *envelope)
{
    say(socket, message->identity, message->identity_size, message->envelope->request, envelope, NULL);
}

static void refuse(void *socket, const wire_message_t *message, result_t why)
{
    Lm__Refusal refusal = LM__REFUSAL__INIT;
    refusal.code = why.code;
    refusal.reason = why.message;
    Lm__Envelope envelope = WIRE_ENVELOPE(REFUSAL, refusal, &refusal);
    answer(socket, message, &envelope);
}

static bool knows(const scripted_t *script, uint64_t worker)
{
    return worker == script->worker;
}

static void on_hello(scripted_t *script, const wire_message_t *message)
{
    const Lm__Hello *hello = message->envelope->hello;
    if (script->hello != NULL) lm__hello__free_unpacked(script->hello, NULL);
    uint8_t packed[4096];
    assert_true(lm__hello__get_packed_size(hello) <= sizeof packed);
    script->hello = lm__hello__unpack(NULL, lm__hello__pack(hello, packed), packed);
    script->hellos++;
    Lm__Welcome welcome = LM__WELCOME__INIT;
    welcome.protocol_version = WIRE_VERSION;
    welcome.software = "scripted";
    welcome.worker = ++script->worker;
    welcome.heartbeat_ms = HEARTBEAT_MS;
    welcome.lease_ms = LEASE_MS;
    welcome.batch_ms = (uint32_t)(1e3 * script->batch_interval);
    welcome.bulk_port = (uint32_t)script->bulk_port;
    Lm__Envelope envelope = WIRE_ENVELOPE(WELCOME, welcome, &welcome);
    answer(script->control, message, &envelope);
}

uint64_t scripted_mac(const unit_t *unit, uint64_t check)
{
    return ((uint64_t)unit->tile << 40 ^ (uint64_t)unit->first << 20 ^ unit->count ^
            check * 0x9E3779B97F4A7C15u) +
           1;
}

static void on_heartbeat(scripted_t *script, const wire_message_t *message)
{
    Lm__HeartbeatReply reply = LM__HEARTBEAT_REPLY__INIT;
    script->heartbeats++;
    script->heartbeat_threads = message->envelope->heartbeat->threads;
    snprintf(script->trouble, sizeof script->trouble, "%s", message->envelope->heartbeat->trouble);
    reply.known = knows(script, message->envelope->heartbeat->worker);
    Lm__Envelope envelope = WIRE_ENVELOPE(HEARTBEAT_REPLY, heartbeat_reply, &reply);
    answer(script->control, message, &envelope);
}

/* A batch and what is kept bear the MACs of the units that they lie in. */
static void check_issues(const unit_t *units, const issue_t *issues, size_t count, uint64_t check)
{
    for (size_t i = 0; i < count; i++) {
        unit_t issued = {units[i].tile, units[i].first - issues[i].before,
                         issues[i].before + units[i].count + issues[i].after};
        if (issues[i].mac != scripted_mac(&issued, check))
            fail_msg("tile %u, samples %u + %u (%u before, %u after) bear a wrong MAC", units[i].tile,
                     units[i].first, units[i].count, issues[i].before, issues[i].after);
    }
}

static void send_assignment(scripted_t *script, const wire_message_t *message)
{
    Lm__Assignment assignment = LM__ASSIGNMENT__INIT;
    Lm__Settings settings = LM__SETTINGS__INIT;
    wire_settings_put(&script->settings, &settings);
    assignment.job = script->job;
    assignment.check = script->check;
    assignment.settings = &settings;
    assignment.blob = wire_hash_put(&script->blob->hash);
    assignment.blob_size = script->blob->size;
    assignment.n_units = script->unit_count;
    issue_t issues[SCRIPTED_MAX] = {0};
    for (size_t i = 0; i < script->unit_count; i++)
        issues[i].mac = scripted_mac(&script->units[i], script->check);
    assignment.units = wire_units_new(script->units, issues, script->unit_count);
    Lm__Envelope envelope = WIRE_ENVELOPE(ASSIGNMENT, assignment, &assignment);
    answer(script->control, message, &envelope);
    free(assignment.units);
    script->unit_count = 0;
}

static void on_work_request(scripted_t *script, const wire_message_t *message)
{
    const Lm__WorkRequest *request = message->envelope->work_request;
    script->work_requests++;
    if (!knows(script, request->worker)) {
        refuse(script->control, message, result_fail(RESULT_UNREACHABLE, "say hello again"));
        return;
    }
    if (request->n_kept > 0) {
        script->kept_count = request->n_kept < SCRIPTED_MAX ? request->n_kept : SCRIPTED_MAX;
        issue_t issues[SCRIPTED_MAX];
        assert_int_equal(
            wire_units_get(request->kept, script->kept_count, &script->settings, script->kept, issues).code,
            RESULT_OK);
        check_issues(script->kept, issues, script->kept_count, 0);
        assert_true(wire_hash_get(&request->content, &script->kept_content));
    }
    if (script->unit_count > 0) {
        send_assignment(script, message);
        return;
    }
    Lm__NoWork none = LM__NO_WORK__INIT;
    none.retry_ms = RETRY_MS;
    Lm__Envelope envelope = WIRE_ENVELOPE(NO_WORK, no_work, &none);
    answer(script->control, message, &envelope);
}

static void on_goodbye(scripted_t *script, const wire_message_t *message)
{
    Lm__Done done = LM__DONE__INIT;
    script->goodbyes++;
    script->worker++;
    Lm__Envelope envelope = WIRE_ENVELOPE(DONE, done, &done);
    answer(script->control, message, &envelope);
}

static scripted_question_t question_of(const wire_message_t *message)
{
    scripted_question_t question = {.identity_size = message->identity_size,
                                    .request = message->envelope->request};
    memcpy(question.identity, message->identity, message->identity_size);
    return question;
}

void scripted_grant(scripted_t *script)
{
    Lm__BatchGrant grant = LM__BATCH_GRANT__INIT;
    Lm__Envelope envelope = WIRE_ENVELOPE(BATCH_GRANT, batch_grant, &grant);
    say(script->bulk, script->offer.identity, script->offer.identity_size, script->offer.request, &envelope,
        NULL);
    script->offer = (scripted_question_t){0};
}

static void on_probe(scripted_t *script, const wire_message_t *message)
{
    Lm__ProbeReply reply = LM__PROBE_REPLY__INIT;
    Lm__Envelope envelope = WIRE_ENVELOPE(PROBE_REPLY, probe_reply, &reply);
    assert_int_equal(message->payload_count, 1);
    script->probes++;
    script->probe_bytes = zmq_msg_size(&message->payload[0]);
    if (!knows(script, message->envelope->probe->worker))
        refuse(script->bulk, message, result_fail(RESULT_UNREACHABLE, "say hello again"));
    else if (!script->deaf)
        answer(script->bulk, message, &envelope);
}

static void on_offer(scripted_t *script, const wire_message_t *message)
{
    const Lm__BatchOffer *offer = message->envelope->batch_offer;
    script->offers++;
    script->same_offers = offer->bytes == script->offered_bytes ? script->same_offers + 1 : 0;
    script->offered_bytes = offer->bytes;
    script->offer = question_of(message);
    script->offer.worker = offer->worker;
    script->offer.job = offer->job;
    assert_true(wire_hash_get(&offer->content, &script->offer.content));
    if (!knows(script, offer->worker)) {
        refuse(script->bulk, message, result_fail(RESULT_UNREACHABLE, "say hello again"));
        script->offer = (scripted_question_t){0};
    } else if (script->refusal.code != RESULT_OK) {
        refuse(script->bulk, message, script->refusal);
        script->offer = (scripted_question_t){0};
    } else if (script->granting) {
        scripted_grant(script);
    }
}

void scripted_verdict(scripted_t *script, bool counted)
{
    Lm__BatchReply reply = LM__BATCH_REPLY__INIT;
    reply.sequence = script->question.sequence;
    reply.accepted = counted;
    reply.reason = counted ? "" : "the script says so";
    Lm__Envelope envelope = WIRE_ENVELOPE(BATCH_REPLY, batch_reply, &reply);
    say(script->bulk, script->question.identity, script->question.identity_size, script->question.request,
        &envelope, NULL);
    script->question = (scripted_question_t){0};
}

static void on_batch(scripted_t *script, const wire_message_t *message)
{
    const Lm__BatchResult *result = message->envelope->batch_result;
    assert_true(script->batch_count < SCRIPTED_MAX);
    scripted_batch_t *came = &script->batches[script->batch_count++];
    *came = (scripted_batch_t){
        .worker = result->worker, .job = result->job, .check = result->check, .sequence = result->sequence};
    assert_true(wire_hash_get(&result->content, &came->content));
    batch_init(&came->batch, &script->settings);
    came->batch.units = mem_alloc((result->n_units + 1) * sizeof *came->batch.units);
    came->batch.unit_count = result->n_units;
    issue_t *issues = mem_alloc((result->n_units + 1) * sizeof *issues);
    assert_int_equal(
        wire_units_get(result->units, result->n_units, &script->settings, came->batch.units, issues).code,
        RESULT_OK);
    check_issues(came->batch.units, issues, result->n_units, result->check);
    free(issues);
    wire_counts_get(result->counts, &came->batch.counts);
    zmq_msg_t payload[BATCH_PAYLOADS]; /* empty ones are left out at the end */
    assert_in_range(message->payload_count, BATCH_BASE_PAYLOADS, BATCH_PAYLOADS);
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        zmq_msg_init(&payload[i]);
        if (i < message->payload_count) zmq_msg_copy(&payload[i], (zmq_msg_t *)&message->payload[i]);
    }
    assert_int_equal(payload_decode(payload, &came->batch).code, RESULT_OK);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    script->question = question_of(message);
    script->question.sequence = result->sequence;
    if (script->answering) scripted_verdict(script, script->counting);
}

static void on_blob_get(scripted_t *script, const wire_message_t *message)
{
    const Lm__BlobGet *get = message->envelope->blob_get;
    Lm__BlobChunk chunk = LM__BLOB_CHUNK__INIT;
    zmq_msg_t payload;
    assert_true(get->offset + get->length <= script->blob->size && get->length <= WIRE_MAX_CHUNK);
    zmq_msg_init_size(&payload, get->length);
    memcpy(zmq_msg_data(&payload), (const uint8_t *)script->blob->bytes + get->offset, get->length);
    chunk.blob = get->blob;
    chunk.offset = get->offset;
    chunk.size = script->blob->size;
    Lm__Envelope envelope = WIRE_ENVELOPE(BLOB_CHUNK, blob_chunk, &chunk);
    say(script->bulk, message->identity, message->identity_size, message->envelope->request, &envelope,
        &payload);
}

void scripted_job_over(scripted_t *script, uint64_t job, bool flush)
{
    Lm__JobOver over = LM__JOB_OVER__INIT;
    over.job = job;
    over.flush = flush;
    Lm__Envelope envelope = WIRE_ENVELOPE(JOB_OVER, job_over, &over);
    /* To where the next control message comes from: there is one at least every heartbeat. */
    wire_message_t message;
    bool received = false;
    while (!received) {
        assert_int_equal(wire_receive(script->control, true, &message, &received).code, RESULT_OK);
        if (!received) zmq_poll(NULL, 0, 1);
    }
    say(script->control, message.identity, message.identity_size, 0, &envelope, NULL);
    wire_free(&message);
}

/* ---- running ------------------------------------------------------------------------------------------- */

static void dispatch(scripted_t *script, const wire_message_t *message)
{
    switch (message->envelope->body_case) {
    case LM__ENVELOPE__BODY_HELLO:
        on_hello(script, message);
        break;
    case LM__ENVELOPE__BODY_HEARTBEAT:
        on_heartbeat(script, message);
        break;
    case LM__ENVELOPE__BODY_WORK_REQUEST:
        on_work_request(script, message);
        break;
    case LM__ENVELOPE__BODY_GOODBYE:
        on_goodbye(script, message);
        break;
    case LM__ENVELOPE__BODY_PROBE:
        on_probe(script, message);
        break;
    case LM__ENVELOPE__BODY_BATCH_OFFER:
        on_offer(script, message);
        break;
    case LM__ENVELOPE__BODY_BATCH_RESULT:
        on_batch(script, message);
        break;
    case LM__ENVELOPE__BODY_BLOB_GET:
        on_blob_get(script, message);
        break;
    default:
        snprintf(script->nonsense, sizeof script->nonsense, "a message of kind %d",
                 (int)message->envelope->body_case);
    }
}

static void receive_all(scripted_t *script, void *socket)
{
    for (bool received = true; received;) {
        wire_message_t message;
        result_t result = wire_receive(socket, true, &message, &received);
        if (result.code != RESULT_OK) fail_msg("nonsense came: %s", result.message);
        if (!received) return;
        dispatch(script, &message);
        wire_free(&message);
    }
}

void scripted_step(scripted_t *script)
{
    zmq_pollitem_t items[] = {{.socket = script->control, .events = ZMQ_POLLIN},
                              {.socket = script->bulk, .events = ZMQ_POLLIN}};
    zmq_poll(items, 2, STEP_MS);
    receive_all(script, script->control);
    receive_all(script, script->bulk);
    if (script->nonsense[0] != '\0') fail_msg("%s", script->nonsense);
}

void scripted_sleep(scripted_t *script, double seconds)
{
    for (double end = clock_now() + seconds; clock_now() < end;) scripted_step(script);
}

void scripted_fail(const scripted_t *script, const char *condition)
{
    fail_msg("waited in vain for %s (%d hellos, %d heartbeats, %d requests for work, %d offers, %d batches)",
             condition, script->hellos, script->heartbeats, script->work_requests, script->offers,
             script->batch_count);
}

void scripted_grant_when_taken(scripted_t *script, double patience)
{
    scripted_run(script, script->unit_count == 0, patience);
    int requests = script->work_requests; /* another one: the assignment was read */
    scripted_run(script, script->work_requests > requests && script->offer.identity_size > 0, patience);
    script->granting = true;
    scripted_grant(script);
}

void scripted_assign(scripted_t *script, uint64_t job, uint64_t check, const unit_t *units, size_t count)
{
    assert_true(count <= SCRIPTED_MAX);
    script->job = job;
    script->check = check;
    memcpy(script->units, units, count * sizeof *units);
    script->unit_count = count;
}

uint32_t scripted_samples(const scripted_t *script, uint32_t tile)
{
    uint32_t samples = 0;
    for (int b = 0; b < script->batch_count; b++)
        for (size_t i = 0; i < script->batches[b].batch.unit_count; i++) {
            const unit_t *unit = &script->batches[b].batch.units[i];
            if (unit->tile == tile) samples += unit->count;
        }
    return samples;
}
