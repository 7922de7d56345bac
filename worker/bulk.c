/* bulk: see bulk.h.
 *
 * DESIGN. One straight loop: ask the workshop for the next duty, do it to its end, ask again. Each duty is a
 * plain sequence of requests and answers on one socket, and gives up early when the thread is told to stop,
 * when the link changes (a new welcome: a new socket, so that nothing of the old conversation can be mistaken
 * for an answer), or when the job is over.
 *
 * A batch stays encoded in memory until the master has answered for it. No answer in good time means that a
 * connection broke underneath; the same bytes are sent again, and the master, who knows what its film holds,
 * refuses them if they had arrived after all. Scenes are fetched with several chunk requests under way, so
 * that the speed does not depend on the round trip.
 */
#include "worker/bulk.h"

#include "proto/wire.h"
#include "worker/blob_cache.h"

#include <poll.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

enum { CHUNK_BYTES = 1 << 20, CHUNK_WINDOW = 4, DOWNLOAD_ATTEMPTS = 3 };
static const double CHUNK_TIMEOUT = 15;           /* seconds without a chunk */
static const double BATCH_TIMEOUT = 20;           /* seconds for an answer, and */
static const double BATCH_BYTES_PER_SECOND = 2e5; /* the slowest uplink that is waited for */
static const double PAUSE = 0.25;                 /* seconds before something is tried again */

/* Where the control thread says the master is. */
typedef struct {
    char *endpoint; /* NULL when down */
    uint64_t worker;
    uint64_t generation; /* counts changes */
    double batch_interval;
} link_t;

struct bulk {
    bulk_options_t options;
    blob_cache_t *cache;
    pthread_t thread;
    atomic_bool quit;
    pthread_mutex_t lock; /* guards link */
    link_t link;

    /* The thread's own. */
    void *socket; /* NULL when the link is down */
    link_watch_t watch;
    uint64_t generation;
    uint64_t worker;
    double batch_interval;
    uint64_t request; /* the last number used */
    scene_blob_t blob;
    renderer_t *renderer;
};

/* ---- the link ----------------------------------------------------------------------------------------- */

static void set_link(bulk_t *bulk, const char *endpoint, uint64_t worker, double batch_interval)
{
    pthread_mutex_lock(&bulk->lock);
    free(bulk->link.endpoint);
    bulk->link.endpoint = endpoint ? mem_strdup(endpoint) : NULL;
    bulk->link.worker = worker;
    bulk->link.batch_interval = batch_interval;
    bulk->link.generation++;
    pthread_mutex_unlock(&bulk->lock);
    eventfd_write(bulk->options.wake, 1);
}

void bulk_link_up(bulk_t *bulk, const char *endpoint, uint64_t worker, double batch_interval)
{
    set_link(bulk, endpoint, worker, batch_interval);
}

void bulk_link_down(bulk_t *bulk)
{
    set_link(bulk, NULL, 0, 1);
}

static void close_socket(bulk_t *bulk)
{
    link_watch_close(&bulk->watch, bulk->socket);
    if (bulk->socket) zmq_close(bulk->socket);
    bulk->socket = NULL;
}

static result_t open_socket(bulk_t *bulk, const char *endpoint)
{
    TRY(wire_socket(bulk->options.context, ZMQ_DEALER, &bulk->socket));
    TRY(link_keys_apply(&bulk->options.keys, bulk->socket));
    TRY(link_watch_open(&bulk->watch, bulk->options.context, bulk->socket, &bulk->options.keys));
    if (zmq_connect(bulk->socket, endpoint) == 0) return result_ok();
    return result_fail(RESULT_IO, "cannot connect to %s: %s", endpoint, zmq_strerror(zmq_errno()));
}

static void connect_socket(bulk_t *bulk, const char *endpoint)
{
    result_t result = open_socket(bulk, endpoint);
    if (result.code == RESULT_OK) return;
    log_error("%s", result.message);
    close_socket(bulk);
}

static bool link_changed(bulk_t *bulk)
{
    pthread_mutex_lock(&bulk->lock);
    bool changed = bulk->generation != bulk->link.generation;
    pthread_mutex_unlock(&bulk->lock);
    return changed;
}

/* Follows what the control thread said last. */
static void refresh_link(bulk_t *bulk)
{
    pthread_mutex_lock(&bulk->lock);
    if (bulk->generation != bulk->link.generation) {
        close_socket(bulk);
        bulk->generation = bulk->link.generation;
        bulk->worker = bulk->link.worker;
        bulk->batch_interval = bulk->link.batch_interval;
        if (bulk->link.endpoint) connect_socket(bulk, bulk->link.endpoint);
    }
    pthread_mutex_unlock(&bulk->lock);
}

/* Waits for traffic or for a wake-up, at most `seconds`. */
static void wait_events(bulk_t *bulk, double seconds)
{
    zmq_pollitem_t items[2] = {{.fd = bulk->options.wake, .events = ZMQ_POLLIN},
                               {.socket = bulk->socket, .events = ZMQ_POLLIN}};
    long ms = seconds > 0 ? (long)(1e3 * seconds) + 1 : 0;
    zmq_poll(items, bulk->socket ? 2 : 1, ms);
    if (items[0].revents & ZMQ_POLLIN) {
        eventfd_t count;
        eventfd_read(bulk->options.wake, &count);
    }
}

/* A socket that was denied does not dial again: true when there is to be a new one. The key may be on the
 * master's list again by then. */
static bool denied(bulk_t *bulk)
{
    if (link_watch_poll(&bulk->watch).code != RESULT_DENIED) return false;
    bulk->generation--;
    return true;
}

/* Waits for the next well-formed message. RESULT_UNREACHABLE at the deadline or when the link changed,
 * RESULT_CANCELLED when the thread is to stop. */
static result_t receive(bulk_t *bulk, double deadline, wire_message_t *message)
{
    for (;;) {
        if (atomic_load(&bulk->quit)) return result_fail(RESULT_CANCELLED, "the worker leaves");
        if (denied(bulk) || link_changed(bulk))
            return result_fail(RESULT_UNREACHABLE, "the link to the master was renewed");
        bool received = false;
        result_t result = wire_receive(bulk->socket, false, message, &received);
        if (result.code != RESULT_OK)
            log_warning("dropped a message of the master: %s", result.message);
        else if (received)
            return result_ok();
        else if (clock_now() >= deadline)
            return result_fail(RESULT_UNREACHABLE, "the master does not answer");
        else
            wait_events(bulk, deadline - clock_now());
    }
}

/* ---- scenes ------------------------------------------------------------------------------------------- */

static result_t request_chunk(bulk_t *bulk, const blob_download_t *download, uint64_t offset)
{
    uint64_t left = download->size - offset;
    Lm__BlobGet get = LM__BLOB_GET__INIT;
    get.blob = wire_hash_put(&download->hash);
    get.offset = offset;
    get.length = left < CHUNK_BYTES ? (uint32_t)left : CHUNK_BYTES;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.request = ++bulk->request;
    envelope.body_case = LM__ENVELOPE__BODY_BLOB_GET;
    envelope.blob_get = &get;
    return wire_send(bulk->socket, NULL, 0, &envelope, NULL, 0);
}

/* Appends the bytes of one answer. */
static result_t take_chunk(blob_download_t *download, wire_message_t *message)
{
    const Lm__Envelope *envelope = message->envelope;
    if (envelope->body_case == LM__ENVELOPE__BODY_REFUSAL && envelope->refusal->code == RESULT_DENIED)
        return result_fail(RESULT_UNREACHABLE, "%.300s", envelope->refusal->reason);
    if (envelope->body_case == LM__ENVELOPE__BODY_REFUSAL)
        return result_fail(RESULT_INPUT, "the master refuses the scene: %.300s", envelope->refusal->reason);
    if (envelope->body_case != LM__ENVELOPE__BODY_BLOB_CHUNK || message->payload_count != 1)
        return result_fail(RESULT_PROTOCOL,
                           "the master answered with something else than a chunk of the scene");
    const Lm__BlobChunk *chunk = envelope->blob_chunk;
    size_t size = zmq_msg_size(&message->payload[0]);
    if (chunk->offset != download->have || size == 0)
        return result_fail(RESULT_PROTOCOL, "the master sent a chunk of the scene that nobody asked for");
    return blob_download_append(download, zmq_msg_data(&message->payload[0]), size);
}

/* Fetches what is missing of a download. */
static result_t fetch_rest(bulk_t *bulk, blob_download_t *download)
{
    uint64_t first_request = bulk->request + 1, answered = bulk->request, asked = download->have;
    while (download->have < download->size) {
        while (asked < download->size && bulk->request - answered < CHUNK_WINDOW) {
            TRY(request_chunk(bulk, download, asked));
            asked += download->size - asked < CHUNK_BYTES ? download->size - asked : CHUNK_BYTES;
        }
        wire_message_t message;
        TRY(receive(bulk, clock_now() + CHUNK_TIMEOUT, &message));
        result_t result = result_ok();
        if (message.envelope->request >= first_request) {
            answered++;
            result = take_chunk(download, &message);
        }
        wire_free(&message);
        TRY(result);
        if (workshop_unwanted(bulk->options.shop)) return result_fail(RESULT_CANCELLED, "the job is over");
    }
    return result_ok();
}

/* Downloads the blob unless another worker of this machine is at it; *done is false then. */
static result_t download_blob(bulk_t *bulk, const assignment_t *assignment, bool *done)
{
    blob_download_t download;
    bool busy;
    *done = false;
    if (bulk->socket == NULL) return result_fail(RESULT_UNREACHABLE, "there is no link to the master");
    TRY(blob_cache_download(bulk->cache, &assignment->blob, assignment->blob_size, &download, &busy));
    if (busy) return result_ok();
    if (download.have > 0)
        log_info("the scene is here up to byte %llu; fetching the rest", (unsigned long long)download.have);
    double start = clock_now();
    result_t result = fetch_rest(bulk, &download);
    if (result.code == RESULT_OK) result = blob_download_finish(bulk->cache, &download, &bulk->blob);
    blob_download_close(&download);
    *done = result.code == RESULT_OK;
    if (*done)
        log_debug("fetched the scene, %.1f MB, in %.2f s", 1e-6 * (double)assignment->blob_size,
                  clock_now() - start);
    return result;
}

/* Brings the blob of an assignment into memory, from the cache or from the master. */
static result_t obtain_blob(bulk_t *bulk, const assignment_t *assignment)
{
    for (int failures = 0;;) {
        bool done;
        TRY(blob_cache_open(bulk->cache, &assignment->blob, &bulk->blob, &done));
        if (done) return result_ok();
        result_t result = download_blob(bulk, assignment, &done);
        if (done) return result_ok();
        if (result.code == RESULT_INPUT && ++failures < DOWNLOAD_ATTEMPTS)
            log_warning("%s; fetching the scene again", result.message);
        else if (result.code != RESULT_OK)
            return result;
        if (atomic_load(&bulk->quit) || workshop_unwanted(bulk->options.shop))
            return result_fail(RESULT_CANCELLED, "the job is over");
        wait_events(bulk, PAUSE);
    }
}

/* Two splat frames must fit into memory with something to spare for the scene. */
static result_t check_memory(const job_settings_t *settings)
{
    double need = 2.0 * (double)sizeof(int64_t) * (double)batch_splat_values(settings);
    double have = (double)sysconf(_SC_PHYS_PAGES) * (double)sysconf(_SC_PAGESIZE);
    if (need < 0.75 * have) return result_ok();
    return result_fail(RESULT_LIMIT, "an image of %d x %d takes %.1f GB of sums; this machine has %.1f GB",
                       settings->width, settings->height, 1e-9 * need, 1e-9 * have);
}

static result_t prepare_scene(bulk_t *bulk, const assignment_t *assignment)
{
    TRY(check_memory(&assignment->settings));
    TRY(obtain_blob(bulk, assignment));
    double start = clock_now();
    TRY(renderer_new(&bulk->blob, &assignment->settings, &bulk->renderer));
    log_debug("the scene was made ready to trace in %.2f s", clock_now() - start);
    return result_ok();
}

static void drop_scene(bulk_t *bulk)
{
    renderer_destroy(&bulk->renderer);
    blob_close(&bulk->blob);
}

static void load(bulk_t *bulk, const assignment_t *assignment)
{
    const job_settings_t *settings = &assignment->settings;
    result_t result = prepare_scene(bulk, assignment);
    if (result.code == RESULT_OK) {
        log_info("job %llu: %d x %d, %s, scene of %.1f MB ready", (unsigned long long)assignment->job,
                 settings->width, settings->height, integrator_name(settings->integrator),
                 1e-6 * (double)assignment->blob_size);
        workshop_loaded(bulk->options.shop, bulk->renderer);
        return;
    }
    drop_scene(bulk);
    if (result.code == RESULT_CANCELLED) return;
    if (result.code == RESULT_UNREACHABLE) {
        log_debug("%s; trying again", result.message);
        wait_events(bulk, PAUSE);
        return;
    }
    log_error("job %llu cannot be rendered here: %s", (unsigned long long)assignment->job, result.message);
    workshop_refuse(bulk->options.shop, result);
}

/* ---- batches ------------------------------------------------------------------------------------------ */

static result_t put_batch(bulk_t *bulk, const closed_batch_t *closed, zmq_msg_t encoded[BATCH_PAYLOADS])
{
    const batch_t *batch = closed->batch;
    Lm__Unit **units = wire_units_new(batch->units, batch->unit_count);
    Lm__Counts counts = LM__COUNTS__INIT;
    wire_counts_put(&batch->counts, &counts);
    Lm__BatchResult message = LM__BATCH_RESULT__INIT;
    message.worker = bulk->worker;
    message.job = closed->job;
    message.sequence = closed->sequence;
    message.n_units = batch->unit_count;
    message.units = units;
    message.counts = &counts;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.request = ++bulk->request;
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_RESULT;
    envelope.batch_result = &message;
    zmq_msg_t copies[BATCH_PAYLOADS];
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        zmq_msg_init(&copies[i]);
        zmq_msg_copy(&copies[i], &encoded[i]);
    }
    result_t result = wire_send(bulk->socket, NULL, 0, &envelope, copies, BATCH_PAYLOADS);
    free(units);
    return result;
}

/* True when the message is the master's answer for this batch. */
static bool is_answer(const bulk_t *bulk, const closed_batch_t *closed, const Lm__Envelope *envelope)
{
    if (envelope->body_case == LM__ENVELOPE__BODY_BATCH_REPLY)
        return envelope->batch_reply->sequence == closed->sequence;
    return envelope->body_case == LM__ENVELOPE__BODY_REFUSAL && envelope->request == bulk->request;
}

static void report_answer(const closed_batch_t *closed, const Lm__Envelope *envelope)
{
    bool refusal = envelope->body_case == LM__ENVELOPE__BODY_REFUSAL;
    bool accepted = !refusal && envelope->batch_reply->accepted;
    const char *reason = refusal ? envelope->refusal->reason : envelope->batch_reply->reason;
    if (accepted)
        log_debug("batch %llu was counted", (unsigned long long)closed->sequence);
    else
        log_warning("the master refused batch %llu of job %llu (%zu units): %.300s",
                    (unsigned long long)closed->sequence, (unsigned long long)closed->job,
                    closed->batch->unit_count, reason);
}

/* Waits for the answer for the batch that was sent last. */
static result_t await_answer(bulk_t *bulk, const closed_batch_t *closed, double timeout)
{
    double deadline = clock_now() + timeout;
    for (;;) {
        wire_message_t message;
        TRY(receive(bulk, deadline, &message));
        const Lm__Envelope *envelope = message.envelope;
        bool mine = is_answer(bulk, closed, envelope);
        /* Who is not admitted for the moment may be welcome later, with this batch. */
        bool later = mine && envelope->body_case == LM__ENVELOPE__BODY_REFUSAL &&
                     envelope->refusal->code == RESULT_DENIED;
        if (mine && !later) report_answer(closed, envelope);
        wire_free(&message);
        if (later)
            return result_fail(RESULT_UNREACHABLE, "the master does not accept the key of this worker");
        if (mine) return result_ok();
    }
}

/* Sends an encoded batch, again and again, until it is answered or the worker leaves. */
static void deliver(bulk_t *bulk, const closed_batch_t *closed, zmq_msg_t encoded[BATCH_PAYLOADS])
{
    double bytes = 0, start = clock_now();
    for (int i = 0; i < BATCH_PAYLOADS; i++) bytes += (double)zmq_msg_size(&encoded[i]);
    while (!atomic_load(&bulk->quit)) {
        refresh_link(bulk);
        result_t result = result_fail(RESULT_UNREACHABLE, "there is no link to the master");
        if (bulk->socket) result = put_batch(bulk, closed, encoded);
        if (result.code == RESULT_OK)
            result = await_answer(bulk, closed, BATCH_TIMEOUT + bytes / BATCH_BYTES_PER_SECOND);
        if (result.code == RESULT_OK) {
            log_debug("batch %llu: %zu units, %.2f MB, answered in %.3f s",
                      (unsigned long long)closed->sequence, closed->batch->unit_count, 1e-6 * bytes,
                      clock_now() - start);
            return;
        }
        if (result.code != RESULT_CANCELLED)
            log_debug("batch %llu waits: %s", (unsigned long long)closed->sequence, result.message);
        wait_events(bulk, PAUSE);
    }
}

static void send_batch(bulk_t *bulk, const closed_batch_t *closed)
{
    zmq_msg_t encoded[BATCH_PAYLOADS];
    result_t result = payload_encode(closed->batch, !bulk->options.local, encoded);
    if (result.code == RESULT_OK) {
        deliver(bulk, closed, encoded);
        for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&encoded[i]);
    } else {
        log_error("batch %llu is lost: %s", (unsigned long long)closed->sequence, result.message);
    }
    workshop_sent(bulk->options.shop);
}

/* ---- the thread --------------------------------------------------------------------------------------- */

static void discard_strays(bulk_t *bulk)
{
    for (bool received = bulk->socket != NULL; received;) {
        wire_message_t message;
        result_t result = wire_receive(bulk->socket, false, &message, &received);
        if (result.code == RESULT_OK && received)
            wire_free(&message);
        else
            received = result.code != RESULT_OK;
    }
}

static void *bulk_thread(void *argument)
{
    bulk_t *bulk = argument;
    while (!atomic_load(&bulk->quit)) {
        refresh_link(bulk);
        duty_t duty = workshop_duty(bulk->options.shop, bulk->batch_interval);
        switch (duty.kind) {
        case DUTY_LOAD:
            load(bulk, &duty.assignment);
            break;
        case DUTY_SEND:
            send_batch(bulk, &duty.closed);
            break;
        case DUTY_RELEASE:
            workshop_release(bulk->options.shop);
            drop_scene(bulk);
            break;
        case DUTY_NONE:
            wait_events(bulk, duty.wait);
            discard_strays(bulk);
            break;
        }
    }
    close_socket(bulk);
    return NULL;
}

result_t bulk_start(const bulk_options_t *options, bulk_t **bulk_pointer)
{
    bulk_t *bulk = mem_zalloc(1, sizeof *bulk);
    bulk->options = *options;
    bulk->batch_interval = 1;
    pthread_mutex_init(&bulk->lock, NULL);
    result_t result = blob_cache_new(options->cache_dir, options->cache_limit, &bulk->cache);
    if (result.code == RESULT_OK && pthread_create(&bulk->thread, NULL, bulk_thread, bulk) != 0)
        result = result_fail(RESULT_LIMIT, "cannot start a thread");
    if (result.code != RESULT_OK) {
        blob_cache_destroy(&bulk->cache);
        free(bulk);
        return result;
    }
    pthread_setname_np(bulk->thread, "bulk");
    *bulk_pointer = bulk;
    return result_ok();
}

void bulk_stop(bulk_t **bulk_pointer)
{
    bulk_t *bulk = *bulk_pointer;
    if (bulk == NULL) return;
    atomic_store(&bulk->quit, true);
    eventfd_write(bulk->options.wake, 1);
    pthread_join(bulk->thread, NULL);
    workshop_stop(bulk->options.shop);
    drop_scene(bulk);
    blob_cache_destroy(&bulk->cache);
    pthread_mutex_destroy(&bulk->lock);
    free(bulk->link.endpoint);
    free(bulk);
    *bulk_pointer = NULL;
}
