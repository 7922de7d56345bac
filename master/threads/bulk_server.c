/* bulk_server: see bulk_server.h.
 *
 * DESIGN. One thread owns the socket and does little that takes long: batches are merged by the threads of
 * the pool, images are made by the image writer, and both tell it through the eventfd when they have
 * something to send. (A scene whose last byte has come is checked here, about a second a GB; batches wait so
 * long, and nothing is lost by it.) What batches take of memory is bounded by grants (grants.h): a worker
 * offers a batch, and sends it when it is told to. A batch that comes without that is taken if there is room
 * for it.
 */
#include "master/threads/bulk_server.h"

#include "proto/serve/complaint.h"
#include "proto/serve/grants.h"
#include "proto/serve/merge_pool.h"

#include <errno.h>
#include <malloc.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <unistd.h>

enum { POLL_MS = 500, MESSAGES_A_TURN = 64 };
static const double TRIM_INTERVAL = 10; /* seconds */

struct bulk_server {
    bulk_server_options_t options;
    pthread_t thread;
    atomic_bool stop;
    complaint_t complaint;
    merge_pool_t *pool;
    grants_t *grants;
    wire_message_t *message; /* the one that is being handled, until something takes it over */
    double next_trim;        /* clock */
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

static result_t check_hash(const ProtobufCBinaryData *bytes, hash_t *hash)
{
    if (wire_hash_get(bytes, hash)) return result_ok();
    return result_fail(RESULT_PROTOCOL, "a hash of %zu bytes, not %d", bytes->len, HASH_BYTES);
}

/* ---- batches ------------------------------------------------------------------------------------------- */

static result_t batch_wanted(void *context, const batch_offer_t *offer)
{
    bulk_server_t *server = context;
    return farm_batch_wanted(server->options.farm, clock_now(), offer->worker, offer->job, offer->named);
}

static result_t check_content(farm_t *farm, uint64_t job, const ProtobufCBinaryData *bytes)
{
    hash_t content;
    if (bytes->len == 0) return farm_content_check(farm, job, NULL);
    TRY(check_hash(bytes, &content));
    return farm_content_check(farm, job, &content);
}

static void on_offer(bulk_server_t *server, const wire_message_t *message)
{
    const Lm__BatchOffer *body = message->envelope->batch_offer;
    batch_offer_t offer = {.identity.size = message->identity_size,
                           .request = message->envelope->request,
                           .worker = body->worker,
                           .job = body->job,
                           .named = body->content.len > 0,
                           .bytes = body->bytes};
    memcpy(offer.identity.bytes, message->identity, message->identity_size);
    result_t result = check_content(server->options.farm, body->job, &body->content);
    if (result.code == RESULT_OK) result = grants_offer(server->grants, clock_now(), &offer);
    if (result.code != RESULT_OK) refuse(server, message, result);
}

/* Answers the offers that can be answered now. */
static void send_grants(bulk_server_t *server)
{
    batch_offer_t offer;
    result_t verdict;
    while (grants_next(server->grants, clock_now(), batch_wanted, server, &offer, &verdict)) {
        Lm__BatchGrant grant = LM__BATCH_GRANT__INIT;
        Lm__Refusal refusal;
        Lm__Envelope envelope = LM__ENVELOPE__INIT;
        envelope.body_case = LM__ENVELOPE__BODY_BATCH_GRANT;
        envelope.batch_grant = &grant;
        if (verdict.code != RESULT_OK) envelope = refusal_envelope(&refusal, &verdict);
        envelope.request = offer.request;
        result_t sent =
            wire_send(server->options.socket, offer.identity.bytes, offer.identity.size, &envelope, NULL, 0);
        if (sent.code != RESULT_OK)
            grants_forget(server->grants, &offer.identity);
        else if (verdict.code == RESULT_OK)
            farm_batch_granted(server->options.farm, clock_now(), offer.worker);
    }
}

/* Adds a batch to its job's film; for the threads of the pool. */
static result_t merge_batch(void *context, const wire_message_t *message)
{
    farm_t *farm = context;
    const Lm__BatchResult *body = message->envelope->batch_result;
    hash_t content;
    farm_batch_t open;
    batch_t batch;
    if (body->content.len > 0) TRY(check_hash(&body->content, &content));
    batch_head_t head = {.worker = body->worker,
                         .job = body->job,
                         .check = body->check,
                         .content = body->content.len > 0 ? &content : NULL,
                         .bytes = message->bytes};
    TRY(farm_batch_begin(farm, clock_now(), &head, &open));
    batch_init(&batch, &open.settings);
    result_t result = wire_batch_get(message, &batch);
    if (result.code == RESULT_OK)
        result = farm_batch_commit(farm, clock_now(), &open, &batch, message->payload);
    else
        farm_batch_abort(farm, &open, batch.units, batch.unit_count);
    batch_free(&batch);
    return result;
}

static void on_batch(bulk_server_t *server, const wire_message_t *message)
{
    identity_t identity = {.size = message->identity_size};
    memcpy(identity.bytes, message->identity, message->identity_size);
    if (!grants_admit(server->grants, &identity, message->memory)) {
        refuse(server, message,
               result_fail(RESULT_LIMIT, "there is no room for a batch of %zu bytes now: offer it first",
                           message->bytes));
        return;
    }
    merge_pool_put(server->pool, server->message, message->memory);
    server->message = NULL;
}

static void answer_batch(bulk_server_t *server, const wire_message_t *message, result_t *result)
{
    const Lm__BatchResult *body = message->envelope->batch_result;
    Lm__BatchReply answer = LM__BATCH_REPLY__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    if (result->code != RESULT_OK && complaint_allowed(&server->complaint, clock_now()))
        log_warning("a batch of job %llu is refused: %s", (unsigned long long)body->job, result->message);
    answer.sequence = body->sequence;
    answer.accepted = result->code == RESULT_OK;
    answer.reason = result->message;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_REPLY;
    envelope.batch_reply = &answer;
    reply(server, message, &envelope, NULL);
}

static void send_verdicts(bulk_server_t *server)
{
    for (merge_verdict_t verdict; merge_pool_next(server->pool, &verdict);) {
        grants_release(server->grants, verdict.memory);
        answer_batch(server, verdict.message, &verdict.result);
        wire_free(verdict.message);
        free(verdict.message);
    }
}

/* ---- blobs --------------------------------------------------------------------------------------------- */

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
    TRY(image_writer_read(server->options.image_writer, snapshot, 0, NULL, &length, &size));
    chunk->size = size;
    TRY(chunk_open(request->offset, request->length, size, payload));
    length = zmq_msg_size(payload);
    result_t result = image_writer_read(server->options.image_writer, snapshot, request->offset,
                                        zmq_msg_data(payload), &length, &size);
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
    result_t result = image_writer_ask(server->options.image_writer, &request);
    if (result.code != RESULT_OK) refuse(server, message, result);
}

static void send_images(bulk_server_t *server)
{
    image_request_t request;
    result_t result;
    uint64_t snapshot;
    while (image_writer_next_answer(server->options.image_writer, &request, &result, &snapshot))
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
    case LM__ENVELOPE__BODY_BATCH_OFFER:
        on_offer(server, message);
        break;
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
        bool received;
        if (server->message == NULL) server->message = mem_alloc(sizeof *server->message);
        result_t result = wire_receive(server->options.socket, true, server->message, &received);
        if (result.code == RESULT_OK && !received) return false;
        server->messages++;
        server->bytes += server->message->bytes;
        if (received)
            dispatch(server, server->message);
        else if (result.code == RESULT_PROTOCOL)
            on_malformed(server, server->message, result);
        else
            return false;
        if (server->message != NULL) wire_free(server->message);
    }
    return true;
}

/* What batches took goes back to the system now and then: the C library keeps it, in pieces. To do so with
 * every batch would cost a third of the merge in page faults. */
static void trim_memory(bulk_server_t *server)
{
    if (clock_now() < server->next_trim) return;
    malloc_trim(0);
    server->next_trim = clock_now() + TRIM_INTERVAL;
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
        send_verdicts(server);
        more = receive_some(server);
        grants_tick(server->grants, clock_now());
        send_grants(server);
        trim_memory(server);
    }
    grants_state_t state = grants_state(server->grants);
    log_info("bulk socket: batches took at most %.1f MB of memory at a time", 1e-6 * (double)state.most);
    log_info("bulk socket: %llu messages, %.1f MB (%llu bytes) received, %llu malformed",
             (unsigned long long)server->messages, 1e-6 * (double)server->bytes,
             (unsigned long long)server->bytes, (unsigned long long)server->malformed);
    zmq_close(server->options.socket);
    return NULL;
}

static void server_free(bulk_server_t *server)
{
    merge_pool_stop(&server->pool);
    grants_destroy(&server->grants);
    free(server->message);
    free(server);
}

result_t bulk_server_start(const bulk_server_options_t *options, bulk_server_t **out)
{
    bulk_server_t *server = mem_zalloc(1, sizeof *server);
    server->options = *options;
    server->grants = grants_new(options->batch_memory);
    merge_pool_options_t pool = {.merge = merge_batch,
                                 .context = options->farm,
                                 .threads = options->merge_threads,
                                 .wake = options->wake};
    result_t result = merge_pool_start(&pool, &server->pool);
    if (result.code == RESULT_OK) {
        int error = pthread_create(&server->thread, NULL, bulk_server_run, server);
        if (error != 0) result = result_fail(RESULT_LIMIT, "cannot start a thread: %s", strerror(error));
    }
    if (result.code == RESULT_OK)
        *out = server;
    else
        server_free(server);
    return result;
}

void bulk_server_stop(bulk_server_t **out)
{
    bulk_server_t *server = *out;
    if (server == NULL) return;
    atomic_store(&server->stop, true);
    uint64_t one = 1;
    if (write(server->options.wake, &one, sizeof one) < 0) log_debug("the bulk thread is awake already");
    pthread_join(server->thread, NULL);
    server_free(server);
    *out = NULL;
}
