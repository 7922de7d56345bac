/* bulk_server: see bulk_server.h.
 *
 * DESIGN. One thread decodes and merges: at some GB/s of sums it is far from what a network delivers. One
 * batch is decoded into memory that is kept from batch to batch of the same job. A batch is decoded before
 * any lock is taken; the farm then decides whether it counts. */
#include "master/bulk_server.h"

#include "master/complaint.h"

#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <unistd.h>

enum { POLL_MS = 500, MESSAGES_A_TURN = 64 };

struct bulk_server {
    bulk_server_options_t options;
    pthread_t thread;
    atomic_bool stop;
    complaint_t complaint;
    batch_t batch; /* the one being decoded; memory is kept */
    uint64_t messages, bytes, malformed;
};

/* ---- answers ------------------------------------------------------------------------------------------- */

static void send_to(bulk_server_t *server, const uint8_t *identity, size_t size, uint64_t request,
                    Lm__Envelope *answer, zmq_msg_t *payload)
{
    answer->request = request;
    result_t result =
        wire_send(server->options.socket, identity, size, answer, payload, payload == NULL ? 0 : 1);
    if (result.code != RESULT_OK) log_debug("an answer was not sent: %s", result.message);
}

static void reply(bulk_server_t *server, const wire_message_t *message, Lm__Envelope *answer,
                  zmq_msg_t *payload)
{
    uint64_t request = message->envelope != NULL ? message->envelope->request : 0;
    send_to(server, message->identity, message->identity_size, request, answer, payload);
}

static Lm__Envelope refusal_envelope(Lm__Refusal *refusal, result_t *reason)
{
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    lm__refusal__init(refusal);
    refusal->code = reason->code;
    refusal->reason = reason->message;
    envelope.body_case = LM__ENVELOPE__BODY_REFUSAL;
    envelope.refusal = refusal;
    return envelope;
}

static void refuse(bulk_server_t *server, const wire_message_t *message, result_t reason)
{
    Lm__Refusal refusal;
    Lm__Envelope answer = refusal_envelope(&refusal, &reason);
    reply(server, message, &answer, NULL);
}

/* ---- batches ------------------------------------------------------------------------------------------- */

/* Makes the batch memory fit the job and the message's number of units. */
static void prepare_batch(bulk_server_t *server, const job_t *job, size_t units)
{
    batch_t *batch = &server->batch;
    batch->settings = farm_job_settings(server->options.farm, job);
    batch->unit_count = 0;
    if (batch->unit_capacity < units) {
        batch->units = mem_realloc(batch->units, units * sizeof *batch->units);
        batch->unit_capacity = units;
    }
}

static result_t decode_batch(bulk_server_t *server, const wire_message_t *message, job_t *job)
{
    const Lm__BatchResult *result = message->envelope->batch_result;
    batch_t *batch = &server->batch;
    if (message->payload_count != BATCH_PAYLOADS)
        return result_fail(RESULT_PROTOCOL, "a batch has %d payloads, not %d", BATCH_PAYLOADS,
                           message->payload_count);
    if (result->n_units == 0) return result_fail(RESULT_PROTOCOL, "a batch without units");
    TRY(wire_units_get(result->units, result->n_units, &batch->settings, batch->units));
    batch->unit_count = result->n_units;
    wire_counts_get(result->counts, &batch->counts);
    return result_ok();
}

static result_t take_batch(bulk_server_t *server, const wire_message_t *message)
{
    const Lm__BatchResult *body = message->envelope->batch_result;
    farm_t *farm = server->options.farm;
    job_t *job;
    TRY(farm_batch_open(farm, clock_now(), body->worker, body->job, message->bytes, &job));
    prepare_batch(server, job, body->n_units);
    result_t result = decode_batch(server, message, job);
    if (result.code == RESULT_OK)
        result = farm_batch_merge(farm, clock_now(), job, body->worker, body->check, &server->batch,
                                  message->payload);
    else
        farm_batch_refuse(farm, job, body->worker, server->batch.units, server->batch.unit_count);
    farm_unpin(farm, job);
    return result;
}

static void on_batch(bulk_server_t *server, const wire_message_t *message)
{
    double start = clock_now();
    result_t result = take_batch(server, message);
    const Lm__BatchResult *body = message->envelope->batch_result;
    if (result.code == RESULT_OK)
        log_debug("a batch of %zu units, %zu bytes, merged in %.3f s", body->n_units, message->bytes,
                  clock_now() - start);
    else if (complaint_allowed(&server->complaint, clock_now()))
        log_warning("a batch of job %llu is refused: %s", (unsigned long long)body->job, result.message);
    Lm__BatchReply answer = LM__BATCH_REPLY__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    answer.sequence = body->sequence;
    answer.accepted = result.code == RESULT_OK;
    answer.reason = result.message;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_REPLY;
    envelope.batch_reply = &answer;
    reply(server, message, &envelope, NULL);
}

/* ---- blobs --------------------------------------------------------------------------------------------- */

static result_t check_hash(const ProtobufCBinaryData *bytes, hash_t *hash)
{
    if (wire_hash_get(bytes, hash)) return result_ok();
    return result_fail(RESULT_PROTOCOL, "a hash of %zu bytes, not %d", bytes->len, HASH_BYTES);
}

static result_t put_blob(bulk_server_t *server, const wire_message_t *message, uint64_t *next)
{
    const Lm__BlobPut *put = message->envelope->blob_put;
    zmq_msg_t *payload = (zmq_msg_t *)&message->payload[0];
    hash_t hash;
    TRY(check_hash(&put->blob, &hash));
    if (message->payload_count != 1 || zmq_msg_size(payload) > WIRE_MAX_CHUNK)
        return result_fail(RESULT_PROTOCOL, "a part of a blob comes in one payload of at most %d bytes",
                           WIRE_MAX_CHUNK);
    if (put->offset > put->size)
        return result_fail(RESULT_PROTOCOL, "an offset beyond the blob's %llu bytes",
                           (unsigned long long)put->size);
    return blob_store_put(server->options.store, &hash, put->offset, put->size, zmq_msg_data(payload),
                          zmq_msg_size(payload), next);
}

static void on_blob_put(bulk_server_t *server, const wire_message_t *message)
{
    Lm__BlobPutReply answer = LM__BLOB_PUT_REPLY__INIT;
    result_t result = put_blob(server, message, &answer.next);
    if (result.code != RESULT_OK) {
        if (complaint_allowed(&server->complaint, clock_now()))
            log_warning("an upload is refused: %s", result.message);
        refuse(server, message, result);
        return;
    }
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_BLOB_PUT_REPLY;
    envelope.blob_put_reply = &answer;
    reply(server, message, &envelope, NULL);
}

/* Opens a payload for `length` bytes, but not more than a chunk, nor than there are from `offset` to `size`.
 */
static result_t chunk_open(uint64_t offset, uint32_t length, uint64_t size, zmq_msg_t *payload)
{
    if (offset > size)
        return result_fail(RESULT_INPUT, "an offset beyond the end, %llu bytes", (unsigned long long)size);
    uint64_t count = length < WIRE_MAX_CHUNK ? length : WIRE_MAX_CHUNK;
    if (count > size - offset) count = size - offset;
    if (zmq_msg_init_size(payload, (size_t)count) == 0) return result_ok();
    return result_fail(RESULT_LIMIT, "no memory for a chunk");
}

static result_t get_blob(bulk_server_t *server, const Lm__BlobGet *get, uint64_t *size, zmq_msg_t *payload)
{
    hash_t hash;
    TRY(check_hash(&get->blob, &hash));
    if (!blob_store_find(server->options.store, &hash, size))
        return result_fail(RESULT_INPUT, "this master does not have the blob");
    TRY(chunk_open(get->offset, get->length, *size, payload));
    size_t length = zmq_msg_size(payload);
    result_t result =
        blob_store_get(server->options.store, &hash, get->offset, zmq_msg_data(payload), &length);
    if (result.code == RESULT_OK && length != zmq_msg_size(payload))
        result = result_fail(RESULT_IO, "the blob's file is shorter than it was");
    if (result.code != RESULT_OK) zmq_msg_close(payload);
    return result;
}

static void on_blob_get(bulk_server_t *server, const wire_message_t *message)
{
    const Lm__BlobGet *get = message->envelope->blob_get;
    Lm__BlobChunk chunk = LM__BLOB_CHUNK__INIT;
    zmq_msg_t payload;
    result_t result = get_blob(server, get, &chunk.size, &payload);
    if (result.code != RESULT_OK) {
        refuse(server, message, result);
        return;
    }
    chunk.blob = get->blob;
    chunk.offset = get->offset;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_BLOB_CHUNK;
    envelope.blob_chunk = &chunk;
    reply(server, message, &envelope, &payload);
}

/* ---- images -------------------------------------------------------------------------------------------- */

static result_t get_image(bulk_server_t *server, uint64_t snapshot, const image_request_t *request,
                          Lm__ImageChunk *chunk, zmq_msg_t *payload)
{
    uint64_t size = 0;
    size_t length = 0;
    chunk->snapshot = snapshot;
    chunk->offset = request->offset;
    TRY(gallery_read(server->options.gallery, snapshot, 0, NULL, &length, &size));
    chunk->size = size;
    TRY(chunk_open(request->offset, request->length, size, payload));
    length = zmq_msg_size(payload);
    result_t result = gallery_read(server->options.gallery, snapshot, request->offset, zmq_msg_data(payload),
                                   &length, &size);
    if (result.code == RESULT_OK && length != zmq_msg_size(payload))
        result = result_fail(RESULT_IO, "the image's file is shorter than it was");
    if (result.code != RESULT_OK) zmq_msg_close(payload);
    return result;
}

static void answer_image(bulk_server_t *server, const image_request_t *request, uint64_t snapshot,
                         result_t result)
{
    Lm__ImageChunk chunk = LM__IMAGE_CHUNK__INIT;
    Lm__Refusal refusal;
    zmq_msg_t payload;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    if (result.code == RESULT_OK) result = get_image(server, snapshot, request, &chunk, &payload);
    bool good = result.code == RESULT_OK;
    if (good) {
        envelope.body_case = LM__ENVELOPE__BODY_IMAGE_CHUNK;
        envelope.image_chunk = &chunk;
    } else {
        envelope = refusal_envelope(&refusal, &result);
    }
    send_to(server, request->identity.bytes, request->identity.size, request->request, &envelope,
            good ? &payload : NULL);
}

static void on_image_get(bulk_server_t *server, const wire_message_t *message)
{
    const Lm__ImageGet *get = message->envelope->image_get;
    image_request_t request = {.identity.size = message->identity_size,
                               .request = message->envelope->request,
                               .job = get->job,
                               .half = get->half,
                               .offset = get->offset,
                               .length = get->length};
    memcpy(request.identity.bytes, message->identity, message->identity_size);
    if (get->snapshot != 0) {
        answer_image(server, &request, get->snapshot, result_ok());
        return;
    }
    result_t result = gallery_ask(server->options.gallery, &request);
    if (result.code != RESULT_OK) refuse(server, message, result);
}

static void send_images(bulk_server_t *server)
{
    image_request_t request;
    result_t result;
    uint64_t snapshot;
    while (gallery_next_answer(server->options.gallery, &request, &result, &snapshot))
        answer_image(server, &request, snapshot, result);
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

/* False, and a refusal, when the sender's key does not give it the right. */
static bool allowed(bulk_server_t *server, wire_message_t *message)
{
    result_t result = gate_check(server->options.gate, message);
    if (result.code == RESULT_OK) return true;
    if (complaint_allowed(&server->complaint, clock_now()))
        log_warning("a message from %s is refused: %s", message->address, result.message);
    refuse(server, message, result);
    return false;
}

static void dispatch(bulk_server_t *server, wire_message_t *message)
{
    if (!allowed(server, message)) return;
    switch (message->envelope->body_case) {
    case LM__ENVELOPE__BODY_BATCH_RESULT:
        on_batch(server, message);
        break;
    case LM__ENVELOPE__BODY_BLOB_PUT:
        on_blob_put(server, message);
        break;
    case LM__ENVELOPE__BODY_BLOB_GET:
        on_blob_get(server, message);
        break;
    case LM__ENVELOPE__BODY_IMAGE_GET:
        on_image_get(server, message);
        break;
    default:
        refuse(server, message,
               result_fail(RESULT_PROTOCOL, "a message of kind %d does not belong on the bulk socket",
                           (int)message->envelope->body_case));
    }
}

static void on_malformed(bulk_server_t *server, const wire_message_t *message, result_t reason)
{
    server->malformed++;
    if (complaint_allowed(&server->complaint, clock_now()))
        log_warning("a peer sent nonsense to the bulk socket: %s", reason.message);
    if (message->identity_size > 0) refuse(server, message, reason);
}

/* Handles what has come; true when there may be more. */
static bool receive_some(bulk_server_t *server)
{
    for (int i = 0; i < MESSAGES_A_TURN && !atomic_load(&server->stop); i++) {
        wire_message_t message;
        bool received;
        result_t result = wire_receive(server->options.socket, true, &message, &received);
        if (result.code == RESULT_OK && !received) return false;
        server->messages++;
        server->bytes += message.bytes;
        if (received)
            dispatch(server, &message);
        else if (result.code == RESULT_PROTOCOL)
            on_malformed(server, &message, result);
        else
            return false;
        wire_free(&message);
    }
    return true;
}

static void *bulk_server_run(void *argument)
{
    bulk_server_t *server = argument;
    bool more = false;
    prctl(PR_SET_NAME, "lm-bulk");
    while (!atomic_load(&server->stop)) {
        zmq_pollitem_t items[] = {{.socket = server->options.socket, .events = ZMQ_POLLIN},
                                  {.fd = server->options.wake, .events = ZMQ_POLLIN}};
        zmq_poll(items, ARRAY_LENGTH(items), more ? 0 : POLL_MS);
        uint64_t count;
        if (items[1].revents != 0 && read(server->options.wake, &count, sizeof count) < 0 && errno != EAGAIN)
            log_debug("cannot read an eventfd: %s", strerror(errno));
        send_images(server);
        more = receive_some(server);
    }
    log_info("bulk socket: %llu messages, %.1f MB (%llu bytes) received, %llu malformed",
             (unsigned long long)server->messages, 1e-6 * (double)server->bytes,
             (unsigned long long)server->bytes, (unsigned long long)server->malformed);
    zmq_close(server->options.socket);
    return NULL;
}

result_t bulk_server_start(const bulk_server_options_t *options, bulk_server_t **out)
{
    bulk_server_t *server = mem_zalloc(1, sizeof *server);
    server->options = *options;
    int error = pthread_create(&server->thread, NULL, bulk_server_run, server);
    if (error == 0) {
        *out = server;
        return result_ok();
    }
    free(server);
    return result_fail(RESULT_LIMIT, "cannot start a thread: %s", strerror(error));
}

void bulk_server_stop(bulk_server_t **out)
{
    bulk_server_t *server = *out;
    if (server == NULL) return;
    atomic_store(&server->stop, true);
    uint64_t one = 1;
    if (write(server->options.wake, &one, sizeof one) < 0) log_debug("the bulk thread is awake already");
    pthread_join(server->thread, NULL);
    batch_free(&server->batch);
    free(server);
    *out = NULL;
}
