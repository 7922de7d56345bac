/* bulk: see bulk.h.
 *
 * DESIGN. One straight loop: ask the handler for the next duty, do it to its end, ask again. Each duty is a
 * plain sequence of requests and answers on one socket, and gives up early when the thread is told to stop,
 * when the link is renewed (link.h), or when the job is over.
 *
 * A batch is offered before it is closed: as long as the master has no room for it, it grows. When it is
 * granted it is closed, encoded, and kept in memory until the master has answered for it. What can go wrong
 * in between:
 *
 *   - the connection breaks, or the master is another process: the batch is offered anew, and sent again
 *     when that is granted. The master, who knows what its film holds, refuses it if it had arrived after
 *     all;
 *   - the master does not answer on a connection that lives: the batch is not sent twice over a link that
 *     may just be slow. It is offered again; that small message arrives behind the batch, so an answer to
 *     it proves that the batch arrived too. Only if its verdict then still does not come, it is sent again.
 *
 * Scenes are fetched with several chunk requests under way, so that the speed does not depend on the round
 * trip. On a thin link that takes minutes. When a batch is ready meanwhile, no more is asked for, and as soon
 * as what was asked for is here, the batch has its turn: the master's answers about it would come behind
 * those chunks in any case, and nothing is fetched twice. Then the scene goes on from its part
 * (blob_cache.h).
 *
 * When no chunk comes for too long, the link is made anew. Its queue would fill with requests otherwise, as
 * long as the master is away. A link whose queue is full all the same is made anew too.
 */
#include "proto/uplink/bulk.h"

#include "common/thread.h"
#include "common/wake.h"
#include "proto/uplink/blob_cache.h"
#include "proto/uplink/link.h"
#include "proto/uplink/probe.h"
#include "proto/wire/wire.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { CHUNK_BYTES = 1 << 20, CHUNK_WINDOW = 4, DOWNLOAD_ATTEMPTS = 3 };
static const double BATCH_BYTES_PER_SECOND = 2e5; /* of an uplink that is waited for, if it is not slower */
static const double PAUSE = 0.25;                 /* seconds before something is tried again */
static const double FIRST_RATIO = 0.3;            /* of coded to plain bytes, before any is known */
static const double PROBE_TURN = 1;               /* second for an answer, before the thread looks around */

/* Where the control thread says the master is. */
typedef struct {
    char *endpoint; /* NULL when down */
    uint64_t worker;
    uint64_t changes; /* counts them */
    double batch_interval;
} address_book_t;

struct bulk {
    bulk_options_t options;
    blob_cache_t *cache;
    pthread_t thread;
    atomic_bool quit;
    pthread_mutex_t lock; /* guards book */
    address_book_t book;

    /* The thread's own. */
    link_t link;
    uint64_t changes; /* that it knows of */
    uint64_t worker;
    double batch_interval;
    double ratio;     /* of coded to plain bytes in the last batch */
    uint64_t request; /* the last number used */
    probe_t probe;

    /* For the control thread. */
    atomic_ullong ready; /* the worker that the bulk socket answered; 0: it has to be probed */
    atomic_bool silent;  /* it does not answer */
};

/* ---- the link ----------------------------------------------------------------------------------------- */

static void set_book(bulk_t *bulk, const char *endpoint, uint64_t worker, double batch_interval)
{
    pthread_mutex_lock(&bulk->lock);
    free(bulk->book.endpoint);
    bulk->book.endpoint = endpoint ? mem_strdup(endpoint) : NULL;
    bulk->book.worker = worker;
    bulk->book.batch_interval = batch_interval;
    bulk->book.changes++;
    atomic_store(&bulk->ready, 0);
    pthread_mutex_unlock(&bulk->lock);
    wake_up(bulk->options.wake);
}

void bulk_link_up(bulk_t *bulk, const char *endpoint, uint64_t worker, double batch_interval)
{
    set_book(bulk, endpoint, worker, batch_interval);
}

void bulk_link_down(bulk_t *bulk)
{
    set_book(bulk, NULL, 0, 1);
}

/* Follows what the control thread said last, and renews a broken link. True when anything is new. */
static bool refresh_link(bulk_t *bulk)
{
    pthread_mutex_lock(&bulk->lock);
    bool renewed = bulk->changes != bulk->book.changes;
    if (renewed) {
        bulk->changes = bulk->book.changes;
        bulk->worker = bulk->book.worker;
        bulk->batch_interval = bulk->book.batch_interval;
        link_set(&bulk->link, bulk->book.endpoint);
    }
    pthread_mutex_unlock(&bulk->lock);
    return link_refresh(&bulk->link) || renewed;
}

/* Sends on the link. RESULT_UNREACHABLE when its queue is full: what waits there is not worth waiting for. */
static result_t say(bulk_t *bulk, const Lm__Envelope *envelope, zmq_msg_t *payload, int payload_count)
{
    result_t result = wire_send(bulk->link.socket, NULL, 0, envelope, payload, payload_count);
    if (result.code != RESULT_LIMIT) return result;
    bulk->link.broken = true;
    return result_fail(RESULT_UNREACHABLE, "%.300s", result.message);
}

static void pause_briefly(bulk_t *bulk)
{
    link_wait(&bulk->link, bulk->options.wake, PAUSE);
}

/* Takes in what nobody waits for. */
static void discard_strays(bulk_t *bulk)
{
    for (bool received = bulk->link.socket != NULL; received;) {
        wire_message_t message;
        result_t result = wire_receive(bulk->link.socket, false, &message, &received);
        if (result.code == RESULT_OK && received)
            wire_free(&message);
        else
            received = result.code == RESULT_PROTOCOL;
    }
}

static bool unwanted(const bulk_t *bulk, uint64_t job)
{
    return bulk->options.handler.calls->unwanted(bulk->options.handler.self, job);
}

/* True when a batch waits for a scene to give way. */
static bool pressing(const bulk_t *bulk)
{
    const uplink_handler_t *handler = &bulk->options.handler;
    return handler->calls->pressing != NULL && handler->calls->pressing(handler->self);
}

static bool is_denial(const Lm__Envelope *envelope)
{
    return envelope->body_case == LM__ENVELOPE__BODY_REFUSAL && envelope->refusal->code == RESULT_DENIED;
}

/* The key of this connection is not on the master's list any more. The next one is made with the key that
 * there is by then, and what was asked is asked again. */
static result_t on_denial(bulk_t *bulk, wire_message_t *message, bool *received)
{
    result_t result = result_fail(RESULT_UNREACHABLE, "%.300s", message->envelope->refusal->reason);
    wire_free(message);
    *received = false;
    bulk->link.broken = true;
    bulk->probe.silent = 0; /* this was an answer */
    return result;
}

/* Waits for the next well-formed message; *received is false when it is worth looking around meanwhile.
 * RESULT_UNREACHABLE at the deadline or when the link was renewed, RESULT_CANCELLED when the thread is to
 * stop. */
static result_t receive(bulk_t *bulk, double deadline, wire_message_t *message, bool *received)
{
    *received = false;
    if (atomic_load(&bulk->quit)) return result_fail(RESULT_CANCELLED, "the worker leaves");
    if (bulk->link.socket) {
        result_t result = wire_receive(bulk->link.socket, false, message, received);
        if (result.code != RESULT_OK) log_warning("dropped a message of the master: %s", result.message);
        if (*received && is_denial(message->envelope)) return on_denial(bulk, message, received);
        if (result.code != RESULT_OK || *received) return result_ok();
    }
    if (refresh_link(bulk)) return result_fail(RESULT_UNREACHABLE, "the link to the master was renewed");
    double left = deadline - clock_now();
    if (left <= 0) return result_fail(RESULT_UNREACHABLE, "the master does not answer");
    link_wait(&bulk->link, bulk->options.wake, left);
    return result_ok();
}

/* ---- probes ------------------------------------------------------------------------------------------- */

bool bulk_ready(const bulk_t *bulk, uint64_t worker)
{
    return worker != 0 && atomic_load(&bulk->ready) == worker;
}

bool bulk_silent(const bulk_t *bulk)
{
    return atomic_load(&bulk->silent);
}

/* Tells the control thread what is new. */
static void publish(bulk_t *bulk)
{
    bool ready = probe_done(&bulk->probe, bulk->link.conversation, bulk->worker);
    bool silent = probe_is_silent(&bulk->probe, clock_now(), BULK_SILENT_SECONDS);
    pthread_mutex_lock(&bulk->lock); /* so that it is of the number that holds now */
    uint64_t worker = ready && bulk->changes == bulk->book.changes ? bulk->worker : 0;
    uint64_t was = atomic_exchange(&bulk->ready, worker);
    pthread_mutex_unlock(&bulk->lock);
    bool was_silent = atomic_exchange(&bulk->silent, silent);
    if (was != worker || was_silent != silent) wake_up(bulk->options.control_wake);
}

static result_t send_probe(bulk_t *bulk, size_t bytes)
{
    zmq_msg_t payload;
    if (zmq_msg_init_size(&payload, bytes) != 0) return result_fail(RESULT_LIMIT, "no memory for a probe");
    memset(zmq_msg_data(&payload), 0, bytes);
    Lm__Probe probe = LM__PROBE__INIT;
    probe.worker = bulk->worker;
    Lm__Envelope envelope = WIRE_ENVELOPE(PROBE, probe, &probe);
    envelope.request = ++bulk->request;
    return say(bulk, &envelope, &payload, 1);
}

typedef struct delivery delivery_t;
static result_t on_message(bulk_t *bulk, delivery_t *delivery, const Lm__Envelope *envelope);

/* Waits for the answer to the probe that is under way, until the deadline. What the master says of a batch
 * meanwhile counts: it may be the verdict on what was sent before the master forgot this worker. */
static result_t await_probe(bulk_t *bulk, delivery_t *delivery, double deadline)
{
    probe_t *probe = &bulk->probe;
    result_t result = result_ok();
    while (result.code == RESULT_OK && probe->request != 0) {
        wire_message_t message;
        bool received;
        TRY(receive(bulk, deadline, &message, &received));
        if (!received) continue;
        const Lm__Envelope *envelope = message.envelope;
        bool answers = envelope->request == probe->request;
        if (answers && envelope->body_case == LM__ENVELOPE__BODY_PROBE_REPLY) {
            probe_answered(probe, clock_now(), !bulk->options.local);
        } else if (answers) { /* it does not know this worker: the control thread is about to say hello */
            probe->request = 0;
            probe->silent = 0;
            result = result_fail(RESULT_UNREACHABLE, "the master does not take a probe");
        } else if (delivery != NULL) {
            on_message(bulk, delivery, envelope); /* if it is to be offered again, that comes next */
        }
        wire_free(&message);
    }
    return result;
}

/* The first: is the socket there? */
static result_t reach(bulk_t *bulk, delivery_t *delivery)
{
    probe_t *probe = &bulk->probe;
    if (probe->request == 0) {
        TRY(send_probe(bulk, 0));
        probe_sent(probe, clock_now(), bulk->request);
    }
    result_t result = await_probe(bulk, delivery, clock_now() + PROBE_TURN);
    if (result.code == RESULT_UNREACHABLE && probe->request != 0 &&
        clock_now() - probe->sent > bulk->options.patience)
        bulk->link.broken = true; /* the next connection may fare better */
    return result;
}

/* The second: how fast is it? */
static result_t measure(bulk_t *bulk, delivery_t *delivery)
{
    probe_t *probe = &bulk->probe;
    if (probe->request == 0) {
        TRY(send_probe(bulk, PROBE_BYTES));
        probe_sent(probe, clock_now(), bulk->request);
    }
    double deadline = probe->sent + BULK_SILENT_SECONDS;
    result_t result = await_probe(bulk, delivery, deadline);
    if (result.code == RESULT_UNREACHABLE && clock_now() >= deadline &&
        probe->conversation == bulk->link.conversation) {
        probe_give_up_measuring(probe, clock_now());
        result = result_ok();
    }
    if (result.code == RESULT_OK)
        log_debug("the link to %s carries %.0f kB/s", bulk->link.endpoint, 1e-3 * probe->rate);
    return result;
}

/* Begins a conversation, maybe with a batch on its way: RESULT_UNREACHABLE until the master's bulk socket has
 * answered and the link is measured. Waits no longer than some seconds. */
static result_t open_link(bulk_t *bulk, delivery_t *delivery)
{
    probe_t *probe = &bulk->probe;
    if (bulk->link.socket == NULL) {
        probe->silent = 0;
        publish(bulk);
        return result_fail(RESULT_UNREACHABLE, "there is no link to the master");
    }
    probe_follow(probe, bulk->link.conversation, bulk->worker);
    if (probe->stage == PROBE_DONE) return result_ok();
    publish(bulk);
    result_t result = probe->stage == PROBE_REACHING ? reach(bulk, delivery) : result_ok();
    if (result.code == RESULT_OK && probe->stage == PROBE_MEASURING) result = measure(bulk, delivery);
    publish(bulk);
    return result;
}

/* ---- scenes ------------------------------------------------------------------------------------------- */

static result_t request_chunk(bulk_t *bulk, const blob_download_t *download, uint64_t offset)
{
    uint64_t left = download->size - offset;
    Lm__BlobGet get = LM__BLOB_GET__INIT;
    get.blob = wire_hash_put(&download->hash);
    get.offset = offset;
    get.length = left < CHUNK_BYTES ? (uint32_t)left : CHUNK_BYTES;
    Lm__Envelope envelope = WIRE_ENVELOPE(BLOB_GET, blob_get, &get);
    envelope.request = ++bulk->request;
    return say(bulk, &envelope, NULL, 0);
}

/* Appends the bytes of one answer. */
static result_t take_chunk(blob_download_t *download, wire_message_t *message)
{
    const Lm__Envelope *envelope = message->envelope;
    if (envelope->body_case == LM__ENVELOPE__BODY_REFUSAL)
        return result_fail(RESULT_INPUT, "the master refuses the blob: %.300s", envelope->refusal->reason);
    if (envelope->body_case != LM__ENVELOPE__BODY_BLOB_CHUNK || message->payload_count != 1)
        return result_fail(RESULT_PROTOCOL,
                           "the master answered with something else than a chunk of the blob");
    const Lm__BlobChunk *chunk = envelope->blob_chunk;
    size_t size = zmq_msg_size(&message->payload[0]);
    if (chunk->offset != download->have || size == 0)
        return result_fail(RESULT_PROTOCOL, "the master sent a chunk of the blob that nobody asked for");
    return blob_download_append(download, zmq_msg_data(&message->payload[0]), size);
}

/* Waits for a message until the deadline; then what was asked on this link is not waited for any more. */
static result_t receive_chunk(bulk_t *bulk, double deadline, wire_message_t *message, bool *received)
{
    result_t result = receive(bulk, deadline, message, received);
    if (result.code == RESULT_UNREACHABLE && clock_now() >= deadline) bulk->link.broken = true;
    return result;
}

/* Fetches what is missing of a download, or a part of it: RESULT_CANCELLED when a batch is to go first. */
static result_t fetch_rest(bulk_t *bulk, uint64_t job, blob_download_t *download)
{
    double deadline = clock_now() + bulk->options.patience;
    uint64_t first_request = bulk->request + 1, answered = bulk->request;
    uint64_t begin = download->have, asked = download->have;
    while (download->have < download->size) {
        bool give_way = download->have > begin && pressing(bulk);
        if (give_way && bulk->request == answered) return result_fail(RESULT_CANCELLED, "a batch goes first");
        while (!give_way && asked < download->size && bulk->request - answered < CHUNK_WINDOW) {
            TRY(request_chunk(bulk, download, asked));
            asked += download->size - asked < CHUNK_BYTES ? download->size - asked : CHUNK_BYTES;
        }
        wire_message_t message;
        bool received;
        TRY(receive_chunk(bulk, deadline, &message, &received));
        result_t result = result_ok();
        if (received && message.envelope->request >= first_request) {
            answered++;
            deadline = clock_now() + bulk->options.patience;
            result = take_chunk(download, &message);
        }
        if (received) wire_free(&message);
        TRY(result);
        if (unwanted(bulk, job)) return result_fail(RESULT_CANCELLED, "the job is over");
    }
    return result_ok();
}

/* Bytes that the scene of a job may take of the memory: what two frames of sums leave. */
static uint64_t scene_memory(const bulk_t *bulk, const job_settings_t *settings)
{
    uint64_t frames = 2 * (uint64_t)sum_frame_bytes(settings);
    return frames < bulk->options.memory ? bulk->options.memory - frames : 0;
}

/* Downloads the blob unless another worker of this machine is at it; *done is false then. */
static result_t download_blob(bulk_t *bulk, const assignment_t *assignment, scene_blob_t *blob, bool *done)
{
    blob_download_t download;
    bool busy;
    *done = false;
    TRY(open_link(bulk, NULL));
    blob_cache_allow_memory(bulk->cache, scene_memory(bulk, &assignment->settings));
    TRY(blob_cache_download(bulk->cache, clock_now(), &assignment->blob, assignment->blob_size, &download,
                            &busy));
    if (busy) return result_ok();
    if (download.have > 0)
        log_debug("the scene is here up to byte %llu; fetching the rest", (unsigned long long)download.have);
    double start = clock_now();
    result_t result = fetch_rest(bulk, assignment->job, &download);
    if (result.code == RESULT_OK) result = blob_download_finish(bulk->cache, &download, blob);
    blob_download_close(&download);
    *done = result.code == RESULT_OK;
    if (*done)
        log_debug("fetched the scene, %.1f MB, in %.2f s", 1e-6 * (double)assignment->blob_size,
                  clock_now() - start);
    return result;
}

/* Brings the blob of an assignment into memory, from the cache or from the master. Other workers of this
 * machine may be fetching it at the same time. */
static result_t obtain_blob(bulk_t *bulk, const assignment_t *assignment, scene_blob_t *blob)
{
    for (int failures = 0;;) {
        bool done;
        TRY(blob_cache_open(bulk->cache, &assignment->blob, blob, &done));
        if (done) return result_ok();
        result_t result = download_blob(bulk, assignment, blob, &done);
        if (done) return result_ok();
        if (result.code == RESULT_INPUT && ++failures < DOWNLOAD_ATTEMPTS)
            log_warning("%s; fetching the scene again", result.message);
        else if (result.code != RESULT_OK)
            return result;
        if (atomic_load(&bulk->quit) || unwanted(bulk, assignment->job))
            return result_fail(RESULT_CANCELLED, "the job is over");
        if (result.code == RESULT_OK && pressing(bulk))
            return result_fail(RESULT_CANCELLED, "a batch goes first");
        refresh_link(bulk);
        discard_strays(bulk); /* what is left to be read would end the pause at once */
        pause_briefly(bulk);
    }
}

static void load(bulk_t *bulk, const assignment_t *assignment)
{
    const job_settings_t *settings = &assignment->settings;
    const uplink_handler_t *handler = &bulk->options.handler;
    scene_blob_t blob;
    result_t result = obtain_blob(bulk, assignment, &blob);
    if (result.code == RESULT_OK) result = handler->calls->loaded(handler->self, assignment->job, &blob);
    if (result.code == RESULT_OK) {
        log_info("job %llu: %d x %d, %s, scene of %.1f MB ready", (unsigned long long)assignment->job,
                 settings->width, settings->height, integrator_name(settings->integrator),
                 1e-6 * (double)assignment->blob_size);
    } else if (result.code == RESULT_UNREACHABLE) {
        log_debug("%s; trying again", result.message);
        pause_briefly(bulk);
    } else if (result.code != RESULT_CANCELLED) {
        log_error("job %llu cannot be rendered here: %s", (unsigned long long)assignment->job,
                  result.message);
        handler->calls->refuse(handler->self, assignment->job, result);
    }
}

/* ---- plans --------------------------------------------------------------------------------------------- */

/* Brings a plan into memory, from the master, whose film has it. */
static result_t obtain_plan(bulk_t *bulk, const assignment_t *assignment, uint32_t pass, uint8_t **bytes,
                            size_t *size)
{
    blob_download_t download;
    *size = learning_plan_bytes();
    TRY(open_link(bulk, NULL));
    TRY(blob_download_in_memory(&assignment->plans[pass], *size, &download));
    result_t result = fetch_rest(bulk, assignment->job, &download);
    if (result.code == RESULT_INPUT) /* the job is over, or not there yet after a restart: we are told soon */
        result.code = RESULT_UNREACHABLE;
    if (result.code == RESULT_OK) result = blob_download_bytes(&download, bytes);
    blob_download_close(&download);
    return result;
}

static void fetch_plan(bulk_t *bulk, const assignment_t *assignment, uint32_t pass)
{
    const uplink_handler_t *handler = &bulk->options.handler;
    double start = clock_now();
    uint8_t *bytes = NULL;
    size_t size;
    result_t result = obtain_plan(bulk, assignment, pass, &bytes, &size);
    if (result.code == RESULT_OK)
        result = handler->calls->planned(handler->self, assignment, pass, bytes, size);
    free(bytes);
    if (result.code == RESULT_OK) {
        log_debug("job %llu: the plan of pass %u, %.2f MB, was here and ready after %.3f s",
                  (unsigned long long)assignment->job, pass, 1e-6 * (double)size, clock_now() - start);
    } else if (result.code == RESULT_UNREACHABLE) {
        log_debug("a plan: %s; trying again", result.message);
        pause_briefly(bulk);
    } else if (result.code != RESULT_CANCELLED) {
        result = result_fail(result.code, "its plan of pass %u: %.350s", pass, result.message);
        log_error("job %llu cannot be rendered here: %s", (unsigned long long)assignment->job,
                  result.message);
        handler->calls->refuse(handler->self, assignment->job, result);
    }
}

/* ---- batches ------------------------------------------------------------------------------------------ */

/* A batch on its way from offer to verdict. */
struct delivery {
    offer_t offer;
    closed_batch_t closed; /* batch is NULL as long as it is open */
    zmq_msg_t encoded[BATCH_PAYLOADS];
    double bytes;          /* of these */
    uint64_t offered, put; /* the requests that carried it last */
    uint64_t put_in;       /* the conversation of the latter, 0: none */
    bool arrived;          /* the master has read what was put there */
    bool granted;
    bool decided, counted;  /* the verdict */
    double start;           /* clock at the first offer */
    char key[KEY_TEXT + 1]; /* our own, at the first offer: its units were issued to that */
    uint64_t mark; /* the probe behind what was put, which is answered when that has arrived; 0: none */
    double marked; /* clock, when it was sent */
};

static bool same_conversation(const bulk_t *bulk, const delivery_t *delivery)
{
    return delivery->put_in == bulk->link.conversation;
}

static result_t send_offer(bulk_t *bulk, delivery_t *delivery)
{
    const offer_t *offer = &delivery->offer;
    Lm__BatchOffer message = LM__BATCH_OFFER__INIT;
    message.worker = bulk->worker;
    message.job = offer->job;
    bool closed = delivery->closed.batch != NULL;
    message.bytes = (uint64_t)(closed ? delivery->bytes : bulk->ratio * (double)offer->bytes);
    message.content = wire_hash_put(&offer->content);
    Lm__Envelope envelope = WIRE_ENVELOPE(BATCH_OFFER, batch_offer, &message);
    envelope.request = delivery->offered = ++bulk->request;
    return say(bulk, &envelope, NULL, 0);
}

/* Messages are read in order, and probes are answered at once: when this one is, the batch has arrived,
 * however long the master takes to add it up. */
static result_t mark_end(bulk_t *bulk, delivery_t *delivery)
{
    TRY(send_probe(bulk, 0));
    delivery->mark = bulk->request;
    delivery->marked = clock_now();
    return result_ok();
}

static result_t put_batch(bulk_t *bulk, delivery_t *delivery)
{
    const batch_t *batch = delivery->closed.batch;
    Lm__Unit **units = wire_units_new(batch->units, delivery->closed.issues, batch->unit_count);
    Lm__Counts counts = LM__COUNTS__INIT;
    wire_counts_put(&batch->counts, &counts);
    Lm__BatchResult message = LM__BATCH_RESULT__INIT;
    message.worker = bulk->worker;
    message.job = delivery->offer.job;
    message.sequence = delivery->closed.sequence;
    message.n_units = batch->unit_count;
    message.units = units;
    message.counts = &counts;
    message.check = delivery->offer.check;
    message.content = wire_hash_put(&delivery->offer.content);
    Lm__Envelope envelope = WIRE_ENVELOPE(BATCH_RESULT, batch_result, &message);
    envelope.request = delivery->put = ++bulk->request;
    zmq_msg_t copies[BATCH_PAYLOADS];
    int count = payload_count(delivery->encoded);
    for (int i = 0; i < count; i++) {
        zmq_msg_init(&copies[i]);
        zmq_msg_copy(&copies[i], &delivery->encoded[i]);
    }
    result_t result = say(bulk, &envelope, copies, count);
    free(units);
    if (result.code != RESULT_OK) return result;
    delivery->put_in = bulk->link.conversation;
    return bulk->options.local ? result : mark_end(bulk, delivery);
}

static void refused(const bulk_t *bulk, delivery_t *delivery, uint32_t code, const char *reason)
{
    const offer_t *offer = &delivery->offer;
    const uplink_handler_t *handler = &bulk->options.handler;
    delivery->decided = true;
    log_warning("the master refuses a batch of job %llu: %.300s", (unsigned long long)offer->job, reason);
    /* What else is in hand of the job will not be wanted either. */
    if (code == RESULT_INPUT || code == RESULT_CANCELLED)
        handler->calls->job_over(handler->self, offer->job, false);
}

static result_t on_refusal(const bulk_t *bulk, delivery_t *delivery, const Lm__Refusal *refusal)
{
    /* It does not know this worker (the control thread is about to say hello again), or has no room. */
    if (refusal->code == RESULT_UNREACHABLE || refusal->code == RESULT_LIMIT)
        return result_fail(RESULT_UNREACHABLE, "%.300s", refusal->reason);
    refused(bulk, delivery, refusal->code, refusal->reason);
    return result_ok();
}

static result_t on_message(bulk_t *bulk, delivery_t *delivery, const Lm__Envelope *envelope)
{
    bool to_offer = envelope->request == delivery->offered;
    bool to_put = delivery->put_in != 0 && envelope->request == delivery->put;
    if (envelope->body_case == LM__ENVELOPE__BODY_PROBE_REPLY && envelope->request == delivery->mark) {
        if (delivery->mark != 0) probe_learn(&bulk->probe, delivery->bytes, clock_now() - delivery->marked);
        delivery->mark = 0;
    } else if (envelope->body_case == LM__ENVELOPE__BODY_BATCH_GRANT && to_offer) {
        delivery->granted = true;
        delivery->arrived = same_conversation(bulk, delivery);
    } else if (envelope->body_case == LM__ENVELOPE__BODY_BATCH_REPLY && delivery->closed.batch != NULL &&
               envelope->batch_reply->sequence == delivery->closed.sequence) {
        delivery->decided = true;
        delivery->counted = envelope->batch_reply->accepted;
        if (!delivery->counted) refused(bulk, delivery, RESULT_MISMATCH, envelope->batch_reply->reason);
    } else if (envelope->body_case == LM__ENVELOPE__BODY_REFUSAL && (to_offer || to_put)) {
        if (to_put) delivery->put_in = 0; /* it was not taken in */
        return on_refusal(bulk, delivery, envelope->refusal);
    }
    return result_ok();
}

/* Bytes a second that a batch is given time for. */
static double slowest_rate(const bulk_t *bulk)
{
    double half = 0.5 * bulk->probe.rate;
    return half > 0 && half < BATCH_BYTES_PER_SECOND ? half : BATCH_BYTES_PER_SECOND;
}

/* Waits until the offer is granted or (`verdict`) the batch is decided upon. RESULT_UNREACHABLE: it has to be
 * offered again. */
static result_t await_master(bulk_t *bulk, delivery_t *delivery, bool verdict)
{
    double patience = bulk->options.patience;
    if (same_conversation(bulk, delivery)) patience += delivery->bytes / slowest_rate(bulk);
    double deadline = clock_now() + patience;
    while (!delivery->decided && (verdict || !delivery->granted)) {
        wire_message_t message;
        bool received;
        TRY(receive(bulk, deadline, &message, &received));
        if (received) {
            result_t result = on_message(bulk, delivery, message.envelope);
            wire_free(&message);
            TRY(result);
        } else if (delivery->closed.batch == NULL && unwanted(bulk, delivery->offer.job)) {
            return result_fail(RESULT_CANCELLED, "the job is over");
        }
    }
    return result_ok();
}

/* Closes the batch that was granted; from now on it does not grow. */
static result_t close_batch(bulk_t *bulk, delivery_t *delivery)
{
    const uplink_handler_t *handler = &bulk->options.handler;
    delivery->closed = handler->calls->close(handler->self, &delivery->offer);
    if (delivery->closed.batch == NULL) return result_fail(RESULT_CANCELLED, "the job is over");
    batch_t *batch = delivery->closed.batch;
    double raw = (double)batch_bytes(batch);
    result_t result = bulk->options.local ? payload_wrap(batch, delivery->encoded)
                                          : payload_encode(batch, delivery->encoded);
    if (result.code != RESULT_OK) {
        log_error("batch %llu is lost: %s", (unsigned long long)delivery->closed.sequence, result.message);
        handler->calls->sent(handler->self, &delivery->closed, false);
        free(delivery->closed.issues);
        delivery->closed = (closed_batch_t){0};
        return result_fail(RESULT_CANCELLED, "the batch is lost");
    }
    for (int i = 0; i < BATCH_PAYLOADS; i++)
        delivery->bytes += (double)(delivery->closed.coded[i] = zmq_msg_size(&delivery->encoded[i]));
    bulk->ratio = delivery->bytes / raw;
    return result;
}

/* One attempt: offers, closes when that is granted, sends, waits for the verdict. */
static result_t attempt(bulk_t *bulk, delivery_t *delivery)
{
    TRY(open_link(bulk, delivery));
    if (delivery->decided) return result_ok();
    delivery->granted = false;
    TRY(send_offer(bulk, delivery));
    TRY(await_master(bulk, delivery, false));
    if (delivery->decided) return result_ok();
    if (delivery->closed.batch == NULL) TRY(close_batch(bulk, delivery));
    if (same_conversation(bulk, delivery) && delivery->arrived)
        delivery->put_in = 0; /* it is there: if no verdict comes now, it has to go again */
    else
        TRY(put_batch(bulk, delivery));
    return await_master(bulk, delivery, true);
}

static void end_delivery(bulk_t *bulk, delivery_t *delivery)
{
    const uplink_handler_t *handler = &bulk->options.handler;
    if (delivery->closed.batch == NULL && delivery->decided) /* refused before it was closed */
        delivery->closed = handler->calls->close(handler->self, &delivery->offer);
    if (delivery->closed.batch == NULL) return;
    if (delivery->bytes > 0) {
        for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&delivery->encoded[i]);
        if (delivery->counted)
            log_debug("batch %llu: %zu units, %.2f MB, counted after %.3f s",
                      (unsigned long long)delivery->closed.sequence, delivery->closed.batch->unit_count,
                      1e-6 * delivery->bytes, clock_now() - delivery->start);
    }
    handler->calls->sent(handler->self, &delivery->closed, delivery->counted);
    free(delivery->closed.issues);
}

/* With another key we are somebody else to the master, who takes nothing of what the first one was given. */
static void drop_if_key_changed(const bulk_t *bulk, delivery_t *delivery)
{
    if (strcmp(delivery->key, bulk->options.keys.own.open) == 0) return;
    log_warning(
        "a batch of job %llu is dropped: it was rendered under another key, and is rendered once more",
        (unsigned long long)delivery->offer.job);
    delivery->decided = true;
}

static void deliver(bulk_t *bulk, const offer_t *offer)
{
    delivery_t delivery = {.offer = *offer, .start = clock_now()};
    memcpy(delivery.key, bulk->options.keys.own.open, sizeof delivery.key);
    while (!delivery.decided && !atomic_load(&bulk->quit)) {
        result_t result = attempt(bulk, &delivery);
        if (result.code == RESULT_CANCELLED) break;
        if (result.code == RESULT_OK) continue;
        log_debug("a batch waits: %s", result.message);
        refresh_link(bulk);
        pause_briefly(bulk);
        drop_if_key_changed(bulk, &delivery);
        if (delivery.closed.batch == NULL)
            break; /* it may have grown, or not be wanted: the handler is asked */
    }
    end_delivery(bulk, &delivery);
}

/* ---- the thread --------------------------------------------------------------------------------------- */

static void *bulk_thread(void *argument)
{
    bulk_t *bulk = argument;
    const uplink_handler_t *handler = &bulk->options.handler;
    while (!atomic_load(&bulk->quit)) {
        refresh_link(bulk);
        open_link(bulk, NULL);
        duty_t duty = handler->calls->duty(handler->self, bulk->batch_interval, bulk->probe.rate);
        switch (duty.kind) {
        case DUTY_LOAD:
            load(bulk, &duty.assignment);
            break;
        case DUTY_PLAN:
            fetch_plan(bulk, &duty.assignment, duty.pass);
            break;
        case DUTY_OFFER:
            deliver(bulk, &duty.offer);
            break;
        case DUTY_MEASURE:
            bulk->probe.stage = PROBE_MEASURING; /* open_link goes on from there */
            break;
        case DUTY_NONE:
            link_wait(&bulk->link, bulk->options.wake, duty.wait);
            discard_strays(bulk);
            break;
        }
    }
    link_close(&bulk->link);
    return NULL;
}

static void free_bulk(bulk_t *bulk)
{
    blob_cache_destroy(&bulk->cache);
    pthread_mutex_destroy(&bulk->lock);
    free(bulk->book.endpoint);
    free(bulk);
}

result_t bulk_start(const bulk_options_t *options, bulk_t **bulk_pointer)
{
    bulk_t *bulk = mem_zalloc(1, sizeof *bulk);
    bulk->options = *options;
    bulk->batch_interval = 1;
    bulk->ratio = FIRST_RATIO;
    bulk->link.context = options->context;
    bulk->link.keys = &bulk->options.keys;
    pthread_mutex_init(&bulk->lock, NULL);
    result_t result = blob_cache_new(options->cache_dir, options->cache_limit, &bulk->cache);
    if (result.code == RESULT_OK) result = thread_start(&bulk->thread, "bulk", bulk_thread, bulk);
    if (result.code == RESULT_OK)
        *bulk_pointer = bulk;
    else
        free_bulk(bulk);
    return result;
}

void bulk_stop(bulk_t **bulk_pointer)
{
    bulk_t *bulk = *bulk_pointer;
    if (bulk == NULL) return;
    atomic_store(&bulk->quit, true);
    wake_up(bulk->options.wake);
    pthread_join(bulk->thread, NULL);
    free_bulk(bulk);
    *bulk_pointer = NULL;
}
