/* bulk_server: see bulk_server.h.
 *
 * DESIGN. One thread owns the socket and does little that takes long: batches are added by the threads of the
 * pool, which tell it through the eventfd when they are done. What batches take of memory is bounded by
 * grants (grants.h): a worker offers a batch, and sends it when it is told to. A batch that comes without
 * that is taken if there is room for it. */
#include "proto/serve/bulk_server.h"

#include "proto/serve/grants.h"
#include "proto/serve/merge_pool.h"

#include <malloc.h>
#include <stdlib.h>

enum { TURN_MS = 500, MESSAGES_A_TURN = 64 };
static const double TRIM_INTERVAL = 10; /* seconds */

struct bulk_server {
    server_options_t options;
    serve_handler_t handler;
    gate_t *gate;
    peer_server_t *thread;
    merge_pool_t *pool;
    grants_t *grants;
    double next_trim; /* clock */
};

result_t bulk_hash_get(const ProtobufCBinaryData *bytes, hash_t *hash)
{
    if (wire_hash_get(bytes, hash)) return result_ok();
    return result_fail(RESULT_PROTOCOL, "a hash of %zu bytes, not %d", bytes->len, HASH_BYTES);
}

/* ---- probes -------------------------------------------------------------------------------------------- */

static void on_probe(void *self, peer_server_t *server, const wire_message_t *message)
{
    const serve_handler_t *handler = &((bulk_server_t *)self)->handler;
    Lm__ProbeReply answer = LM__PROBE_REPLY__INIT;
    result_t result = result_ok();
    if (message->payload_count != 1 || zmq_msg_size(&message->payload[0]) > WIRE_MAX_PROBE)
        result = result_fail(RESULT_PROTOCOL, "a probe has one payload of at most %d bytes", WIRE_MAX_PROBE);
    if (result.code == RESULT_OK)
        result = handler->calls->reached(handler->self, clock_now(), message->envelope->probe->worker);
    if (result.code == RESULT_OK)
        peer_reply(server, message, LM__ENVELOPE__BODY_PROBE_REPLY, &answer, NULL);
    else
        peer_refuse(server, message, result);
}

/* ---- offers -------------------------------------------------------------------------------------------- */

static result_t take_offer(bulk_server_t *bulk, const wire_message_t *message)
{
    const serve_handler_t *handler = &bulk->handler;
    const Lm__BatchOffer *body = message->envelope->batch_offer;
    batch_offer_t offer = {.identity = peer_identity(message),
                           .connection = message->connection,
                           .request = message->envelope->request,
                           .worker = body->worker,
                           .job = body->job,
                           .named = body->content.len > 0,
                           .bytes = body->bytes};
    if (offer.named) TRY(bulk_hash_get(&body->content, &offer.content));
    TRY(handler->calls->offered(handler->self, clock_now(), &offer));
    return grants_offer(bulk->grants, clock_now(), &offer);
}

static void on_offer(void *self, peer_server_t *server, const wire_message_t *message)
{
    result_t result = take_offer(self, message);
    if (result.code != RESULT_OK) peer_refuse(server, message, result);
}

static result_t still_wanted(void *context, const batch_offer_t *offer)
{
    const serve_handler_t *handler = context;
    return handler->calls->wanted(handler->self, clock_now(), offer);
}

static void grant(bulk_server_t *bulk, peer_server_t *server, const batch_offer_t *offer)
{
    const serve_handler_t *handler = &bulk->handler;
    Lm__BatchGrant body = LM__BATCH_GRANT__INIT;
    gate_expect(bulk->gate, offer->connection, 2 * offer->bytes); /* a guess; more is refused */
    if (peer_send(server, &offer->identity, offer->request, LM__ENVELOPE__BODY_BATCH_GRANT, &body, NULL))
        handler->calls->granted(handler->self, clock_now(), offer->worker);
    else
        grants_forget(bulk->grants, &offer->identity);
}

/* Answers the offers that can be answered now. */
static void send_grants(bulk_server_t *bulk, peer_server_t *server)
{
    batch_offer_t offer;
    result_t verdict;
    while (grants_next(bulk->grants, clock_now(), still_wanted, &bulk->handler, &offer, &verdict)) {
        if (verdict.code == RESULT_OK)
            grant(bulk, server, &offer);
        else
            peer_send_refusal(server, &offer.identity, offer.request, verdict);
    }
}

/* ---- batches ------------------------------------------------------------------------------------------- */

static void on_batch(void *self, peer_server_t *server, const wire_message_t *message)
{
    bulk_server_t *bulk = self;
    identity_t identity = peer_identity(message);
    if (grants_admit(bulk->grants, &identity, message->memory))
        merge_pool_put(bulk->pool, peer_keep(server), message->memory);
    else
        peer_refuse(server, message,
                    result_fail(RESULT_LIMIT, "there is no room for a batch of %zu bytes now: offer it first",
                                message->bytes));
}

/* For the threads of the pool. */
static result_t add_batch(void *context, wire_message_t *message)
{
    const serve_handler_t *handler = context;
    const Lm__BatchResult *body = message->envelope->batch_result;
    batch_t batch = {0};
    issue_t *issues = NULL;
    hash_t content;
    bool named = body->content.len > 0;
    if (named) TRY(bulk_hash_get(&body->content, &content));
    result_t result = wire_batch_get(message, &batch, &issues);
    incoming_batch_t incoming = {.worker = body->worker,
                                 .job = body->job,
                                 .check = body->check,
                                 .content = named ? &content : NULL,
                                 .batch = &batch,
                                 .issues = issues,
                                 .payload = message->payload,
                                 .bytes = message->bytes};
    if (result.code == RESULT_OK) result = handler->calls->add(handler->self, clock_now(), &incoming);
    batch_free(&batch);
    free(issues);
    return result;
}

static void answer_batch(peer_server_t *server, const wire_message_t *message, result_t *result)
{
    const Lm__BatchResult *body = message->envelope->batch_result;
    Lm__BatchReply answer = LM__BATCH_REPLY__INIT;
    if (result->code != RESULT_OK)
        peer_complain(server, "a batch of job %llu is refused: %s", (unsigned long long)body->job,
                      result->message);
    result_t told = peer_told(server, *result);
    answer.sequence = body->sequence;
    answer.accepted = result->code == RESULT_OK;
    answer.reason = told.message;
    peer_reply(server, message, LM__ENVELOPE__BODY_BATCH_REPLY, &answer, NULL);
}

static void send_verdicts(bulk_server_t *bulk, peer_server_t *server)
{
    for (merge_verdict_t verdict; merge_pool_next(bulk->pool, &verdict);) {
        grants_release(bulk->grants, verdict.memory);
        /* The worker keeps it, and offers it again. */
        if (verdict.result.code == RESULT_UNREACHABLE || verdict.result.code == RESULT_LIMIT)
            peer_refuse(server, verdict.message, verdict.result);
        else
            answer_batch(server, verdict.message, &verdict.result);
        wire_free(verdict.message);
        free(verdict.message);
    }
}

/* ---- scenes -------------------------------------------------------------------------------------------- */

result_t bulk_chunk_open(uint64_t offset, uint32_t length, uint64_t size, zmq_msg_t *payload)
{
    if (offset > size)
        return result_fail(RESULT_INPUT, "an offset beyond the end, %llu bytes", (unsigned long long)size);
    uint64_t count = length < WIRE_MAX_CHUNK ? length : WIRE_MAX_CHUNK;
    if (count > size - offset) count = size - offset;
    if (zmq_msg_init_size(payload, (size_t)count) == 0) return result_ok();
    return result_fail(RESULT_LIMIT, "no memory for a chunk");
}

static result_t read_blob(const serve_handler_t *handler, const Lm__BlobGet *get, uint64_t *size,
                          zmq_msg_t *payload)
{
    hash_t hash;
    TRY(bulk_hash_get(&get->blob, &hash));
    TRY(handler->calls->blob_size(handler->self, &hash, size));
    TRY(bulk_chunk_open(get->offset, get->length, *size, payload));
    result_t result = handler->calls->blob_read(handler->self, &hash, get->offset, zmq_msg_data(payload),
                                                zmq_msg_size(payload));
    if (result.code != RESULT_OK) zmq_msg_close(payload);
    return result;
}

static void on_blob_get(void *self, peer_server_t *server, const wire_message_t *message)
{
    const Lm__BlobGet *get = message->envelope->blob_get;
    Lm__BlobChunk chunk = LM__BLOB_CHUNK__INIT;
    zmq_msg_t payload;
    result_t result = read_blob(&((bulk_server_t *)self)->handler, get, &chunk.size, &payload);
    chunk.blob = get->blob;
    chunk.offset = get->offset;
    if (result.code == RESULT_OK)
        peer_reply(server, message, LM__ENVELOPE__BODY_BLOB_CHUNK, &chunk, &payload);
    else
        peer_refuse(server, message, result);
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

/* control_server.c says what a new kind takes. */
static const message_kind_t kinds[] = {{LM__ENVELOPE__BODY_PROBE, RIGHT_WORK, on_probe},
                                       {LM__ENVELOPE__BODY_BATCH_OFFER, RIGHT_WORK, on_offer},
                                       {LM__ENVELOPE__BODY_BATCH_RESULT, RIGHT_WORK, on_batch},
                                       {LM__ENVELOPE__BODY_BLOB_GET, RIGHT_WORK, on_blob_get}};

/* What batches took goes back to the system now and then: the C library keeps it, in pieces. To do so with
 * every batch would cost a third of the merge in page faults. */
static void trim_memory(bulk_server_t *bulk)
{
    if (clock_now() < bulk->next_trim) return;
    malloc_trim(0);
    bulk->next_trim = clock_now() + TRIM_INTERVAL;
}

static void turn(void *self, peer_server_t *server, bool more)
{
    bulk_server_t *bulk = self;
    (void)more;
    send_verdicts(bulk, server);
    grants_tick(bulk->grants, clock_now());
    send_grants(bulk, server);
    trim_memory(bulk);
}

result_t bulk_server_start(const server_options_t *options, const served_socket_t *served,
                           bulk_server_t **out)
{
    bulk_server_t *bulk = mem_zalloc(1, sizeof *bulk);
    bulk->options = *options;
    bulk->handler = served->handler;
    bulk->gate = served->gate;
    bulk->grants = grants_new(options->batch_memory > 0 ? options->batch_memory : grants_usual_credit());
    merge_pool_options_t pool = {.merge = add_batch,
                                 .context = &bulk->handler,
                                 .threads = options->merge_threads,
                                 .wake = options->bulk_wake};
    peer_server_options_t thread = {.name = "bulk",
                                    .data_dir = options->data_dir,
                                    .socket = served->socket,
                                    .gate = served->gate,
                                    .wake = options->bulk_wake,
                                    .turn_ms = TURN_MS,
                                    .turn_messages = MESSAGES_A_TURN,
                                    .tables = {{kinds, ARRAY_LENGTH(kinds), turn, bulk}, served->more}};
    result_t result = merge_pool_start(&pool, &bulk->pool);
    if (result.code == RESULT_OK) result = peer_server_start(&thread, &bulk->thread);
    if (result.code != RESULT_OK) bulk_server_stop(&bulk);
    *out = bulk;
    return result;
}

void bulk_server_stop(bulk_server_t **out)
{
    bulk_server_t *bulk = *out;
    if (bulk == NULL) return;
    bool ran = bulk->thread != NULL;
    peer_server_stop(&bulk->thread);
    merge_pool_stop(&bulk->pool);
    if (ran)
        log_info("bulk socket: batches took at most %.1f MB of memory at a time",
                 1e-6 * (double)grants_state(bulk->grants).most);
    grants_destroy(&bulk->grants);
    free(bulk);
    *out = NULL;
}
