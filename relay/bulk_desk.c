/* bulk_desk: see bulk_desk.h.
 *
 * DESIGN. As in the master (bulk_server.c): one thread owns the socket, batches are admitted by grants and
 * added by the threads of a pool. */
#include "relay/bulk_desk.h"

#include "proto/serve/grants.h"
#include "proto/serve/merge_pool.h"

#include <stdlib.h>
#include <string.h>

struct bulk_desk {
    bulk_desk_options_t options;
    desk_t *thread; /* the owner's */
    desk_t *desk;   /* the same, for the thread itself */
    grants_t *grants;
    merge_pool_t *adders;
};

/* ---- batches ------------------------------------------------------------------------------------------- */

static void on_offer(bulk_desk_t *bulk, const wire_message_t *message)
{
    const Lm__BatchOffer *body = message->envelope->batch_offer;
    batch_offer_t offer = {.identity.size = message->identity_size,
                           .request = message->envelope->request,
                           .worker = body->worker,
                           .job = body->job,
                           .bytes = body->bytes};
    memcpy(offer.identity.bytes, message->identity, message->identity_size);
    result_t result =
        pool_batch_wanted(bulk->options.pool, clock_now(), body->worker, body->job, &body->content);
    if (result.code == RESULT_OK || result.code == RESULT_LIMIT)
        result = grants_offer(bulk->grants, clock_now(), &offer);
    if (result.code != RESULT_OK) desk_refuse(bulk->desk, message, result);
}

static result_t still_wanted(void *context, const batch_offer_t *offer)
{
    static const ProtobufCBinaryData any_content = {0, NULL}; /* it was looked at when the offer came */
    bulk_desk_t *bulk = context;
    return pool_batch_wanted(bulk->options.pool, clock_now(), offer->worker, offer->job, &any_content);
}

/* Answers the offers that can be answered now. */
static void send_grants(bulk_desk_t *bulk)
{
    batch_offer_t offer;
    result_t verdict;
    while (grants_next(bulk->grants, clock_now(), still_wanted, bulk, &offer, &verdict)) {
        Lm__BatchGrant grant = LM__BATCH_GRANT__INIT;
        Lm__Refusal refusal = LM__REFUSAL__INIT;
        Lm__Envelope envelope = LM__ENVELOPE__INIT;
        envelope.request = offer.request;
        envelope.body_case = LM__ENVELOPE__BODY_BATCH_GRANT;
        envelope.batch_grant = &grant;
        if (verdict.code != RESULT_OK) {
            refusal.code = verdict.code;
            refusal.reason = verdict.message;
            envelope.body_case = LM__ENVELOPE__BODY_REFUSAL;
            envelope.refusal = &refusal;
        }
        if (!desk_send(bulk->desk, offer.identity.bytes, offer.identity.size, &envelope))
            grants_forget(bulk->grants, &offer.identity);
        else if (verdict.code == RESULT_OK)
            pool_batch_granted(bulk->options.pool, clock_now(), offer.worker);
    }
}

static void on_batch(bulk_desk_t *bulk, wire_message_t **taken)
{
    wire_message_t *message = *taken;
    identity_t identity = {.size = message->identity_size};
    memcpy(identity.bytes, message->identity, message->identity_size);
    if (!grants_admit(bulk->grants, &identity, message->memory)) {
        desk_refuse(bulk->desk, message,
                    result_fail(RESULT_LIMIT, "there is no room for a batch of %zu bytes now: offer it first",
                                message->bytes));
        return;
    }
    merge_pool_put(bulk->adders, message, message->memory);
    *taken = NULL;
}

/* For the threads of the pool. */
static result_t add_batch(void *context, const wire_message_t *message)
{
    return pool_batch_add(context, clock_now(), message);
}

static void answer_batch(bulk_desk_t *bulk, const wire_message_t *message, result_t *result)
{
    const Lm__BatchResult *body = message->envelope->batch_result;
    Lm__BatchReply reply = LM__BATCH_REPLY__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    if (result->code != RESULT_OK)
        desk_complain(bulk->desk, "a batch of job %llu is refused: %s", (unsigned long long)body->job,
                      result->message);
    reply.sequence = body->sequence;
    reply.accepted = result->code == RESULT_OK;
    reply.reason = result->message;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_REPLY;
    envelope.batch_reply = &reply;
    desk_reply(bulk->desk, message, &envelope, NULL);
}

static void send_verdicts(bulk_desk_t *bulk)
{
    for (merge_verdict_t verdict; merge_pool_next(bulk->adders, &verdict);) {
        grants_release(bulk->grants, verdict.memory);
        if (verdict.result.code == RESULT_UNREACHABLE) /* the worker keeps it, and offers it again */
            desk_refuse(bulk->desk, verdict.message, verdict.result);
        else
            answer_batch(bulk, verdict.message, &verdict.result);
        wire_free(verdict.message);
        free(verdict.message);
    }
}

/* ---- scenes -------------------------------------------------------------------------------------------- */

static result_t read_chunk(bulk_desk_t *bulk, const Lm__BlobGet *get, uint64_t *size, zmq_msg_t *payload)
{
    hash_t hash;
    if (!wire_hash_get(&get->blob, &hash))
        return result_fail(RESULT_PROTOCOL, "a hash of %zu bytes, not %d", get->blob.len, HASH_BYTES);
    TRY(pool_blob_size(bulk->options.pool, &hash, size));
    if (get->offset > *size)
        return result_fail(RESULT_INPUT, "an offset beyond the end, %llu bytes", (unsigned long long)*size);
    uint64_t length = get->length < WIRE_MAX_CHUNK ? get->length : WIRE_MAX_CHUNK;
    if (length > *size - get->offset) length = *size - get->offset;
    if (zmq_msg_init_size(payload, (size_t)length) != 0)
        return result_fail(RESULT_LIMIT, "no memory for a chunk");
    result_t result =
        pool_blob_read(bulk->options.pool, &hash, get->offset, zmq_msg_data(payload), (size_t)length);
    if (result.code != RESULT_OK) zmq_msg_close(payload);
    return result;
}

static void on_blob_get(bulk_desk_t *bulk, const wire_message_t *message)
{
    const Lm__BlobGet *get = message->envelope->blob_get;
    Lm__BlobChunk chunk = LM__BLOB_CHUNK__INIT;
    zmq_msg_t payload;
    result_t result = read_chunk(bulk, get, &chunk.size, &payload);
    if (result.code != RESULT_OK) {
        desk_refuse(bulk->desk, message, result);
        return;
    }
    chunk.blob = get->blob;
    chunk.offset = get->offset;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_BLOB_CHUNK;
    envelope.blob_chunk = &chunk;
    desk_reply(bulk->desk, message, &envelope, &payload);
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

static void handle(void *self, desk_t *desk, wire_message_t **taken)
{
    bulk_desk_t *bulk = self;
    const wire_message_t *message = *taken;
    bulk->desk = desk;
    switch (message->envelope->body_case) {
    case LM__ENVELOPE__BODY_BATCH_OFFER:
        on_offer(bulk, message);
        break;
    case LM__ENVELOPE__BODY_BATCH_RESULT:
        on_batch(bulk, taken);
        break;
    case LM__ENVELOPE__BODY_BLOB_GET:
        on_blob_get(bulk, message);
        break;
    default:
        desk_refuse(desk, message,
                    result_fail(RESULT_PROTOCOL,
                                "a message of kind %d does not belong on a relay's bulk socket",
                                (int)message->envelope->body_case));
    }
}

static void turn(void *self, desk_t *desk, bool quiet)
{
    bulk_desk_t *bulk = self;
    (void)quiet;
    bulk->desk = desk;
    send_verdicts(bulk);
    grants_tick(bulk->grants, clock_now());
    send_grants(bulk);
}

result_t bulk_desk_start(const bulk_desk_options_t *options, bulk_desk_t **out)
{
    bulk_desk_t *bulk = mem_zalloc(1, sizeof *bulk);
    bulk->options = *options;
    bulk->grants = grants_new(options->credit);
    merge_pool_options_t adders = {
        .merge = add_batch, .context = options->pool, .threads = options->threads, .wake = options->wake};
    desk_options_t desk = {.name = "relay bulk",
                           .socket = options->socket,
                           .gate = options->gate,
                           .wake = options->wake,
                           .self = bulk,
                           .handle = handle,
                           .turn = turn};
    result_t result = merge_pool_start(&adders, &bulk->adders);
    if (result.code == RESULT_OK) result = desk_start(&desk, &bulk->thread);
    if (result.code != RESULT_OK) bulk_desk_stop(&bulk);
    *out = bulk;
    return result;
}

void bulk_desk_stop(bulk_desk_t **out)
{
    bulk_desk_t *bulk = *out;
    if (bulk == NULL) return;
    desk_stop(&bulk->thread);
    merge_pool_stop(&bulk->adders);
    grants_destroy(&bulk->grants);
    free(bulk);
    *out = NULL;
}
