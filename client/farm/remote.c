/* remote: see remote.h.
 *
 * DESIGN. Strictly one question at a time on either socket, so an answer is known by its request number, and
 * what comes late for an abandoned question is thrown away by the same test. Chunks are large (4 MB), so even
 * one at a time they fill all but the longest links.
 *
 * A question that was not answered in time is taken back: its socket is closed with all that it has queued,
 * and the next question opens another. Otherwise those who ask a master that is away again and again would
 * fill the queue until nothing more can be asked, and the master would get all of it when it is back.
 */
#include "client/farm/remote.h"

#include "common/address.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double SLOW_ANSWER = 120.0; /* seconds for answers that a master must work for, */
static const double SLOW_BYTES = 1e7;    /* and bytes a second that it reads at least, from a slow disk */
static const double STUCK = 600.0; /* seconds without progress, after which an image is not waited for */
/* Images are checked against this before memory is allocated: 26 channels of the largest film, 6 of halves,
 * 24 of mattes, those of light groups, and more. */
static const uint64_t MAX_IMAGE_BYTES = (uint64_t)JOB_MAX_PIXELS * 256 + (uint64_t)JOB_MAX_GROUP_PIXELS * 24;

/* One of the master's two sockets, as seen from here. */
typedef struct {
    char *endpoint; /* NULL: not known yet */
    size_t limit;   /* bytes of a frame */
    void *socket;   /* NULL: closed */
    dial_watch_t watch;
    unsigned lost; /* connections that had broken when the last request was sent */
} line_t;

struct remote {
    void *context;
    bool own_context;
    dial_keys_t keys;
    line_t control, bulk;
    double timeout;
    uint64_t request;         /* the last number used */
    const image_wish_t *wish; /* the image that the master makes; NULL: none */
    uint32_t before;          /* what was last heard of it: images before it, */
    double share;             /* how much of it is made, */
    double progressed;        /* and when that changed, seconds */
};

static void close_line(line_t *line)
{
    dial_watch_close(&line->watch, line->socket);
    if (line->socket != NULL) zmq_close(line->socket);
    line->socket = NULL;
}

/* Closes a line without sending what it has queued. */
static void drop_line(line_t *line)
{
    const int at_once = 0;
    if (line->socket != NULL) zmq_setsockopt(line->socket, ZMQ_LINGER, &at_once, sizeof at_once);
    close_line(line);
}

static result_t connect_line(remote_t *remote, line_t *line)
{
    TRY(wire_socket(remote->context, ZMQ_DEALER, &line->socket));
    TRY(wire_socket_limit(line->socket, line->limit));
    TRY(dial_keys_apply(&remote->keys, line->socket));
    TRY(dial_watch_open(&line->watch, remote->context, line->socket, &remote->keys));
    if (zmq_connect(line->socket, line->endpoint) == 0) return result_ok();
    return result_fail(RESULT_USAGE, "cannot connect to %s: %s", line->endpoint, zmq_strerror(zmq_errno()));
}

/* Opens a line unless it is open. */
static result_t open_line(remote_t *remote, line_t *line)
{
    if (line->socket != NULL) return result_ok();
    result_t result = connect_line(remote, line);
    if (result.code != RESULT_OK) drop_line(line);
    return result;
}

result_t remote_open(void *context, const char *control_endpoint, const char *bulk_endpoint, double timeout,
                     remote_t **remote)
{
    return remote_open_with(context, control_endpoint, bulk_endpoint, timeout, NULL, remote);
}

result_t remote_open_with(void *context, const char *control_endpoint, const char *bulk_endpoint,
                          double timeout, dial_keys_t *keys, remote_t **remote_pointer)
{
    remote_t *remote = mem_zalloc(1, sizeof *remote);
    if (keys != NULL) remote->keys = *keys;
    remote->own_context = context == NULL;
    remote->context = context ? context : zmq_ctx_new();
    remote->control = (line_t){.endpoint = mem_strdup(control_endpoint), .limit = WIRE_MAX_CONTROL_FRAME};
    remote->bulk =
        (line_t){.endpoint = bulk_endpoint ? mem_strdup(bulk_endpoint) : NULL, .limit = WIRE_MAX_CHUNK};
    remote->timeout = timeout;
    result_t result = open_line(remote, &remote->control);
    if (result.code != RESULT_OK) remote_close(&remote);
    *remote_pointer = remote;
    return result;
}

void remote_close(remote_t **remote_pointer)
{
    remote_t *remote = *remote_pointer;
    if (remote == NULL) return;
    close_line(&remote->control);
    close_line(&remote->bulk);
    if (remote->own_context) zmq_ctx_term(remote->context);
    dial_keys_free(&remote->keys);
    free(remote->control.endpoint);
    free(remote->bulk.endpoint);
    free(remote);
    *remote_pointer = NULL;
}

/* ---- questions and answers ---------------------------------------------------------------------------- */

static result_t unreachable(const char *endpoint, double timeout)
{
    return result_fail(
        RESULT_UNREACHABLE,
        "no answer from the master at %s within %.1f s: is lightmill-master running there, and "
        "is the port open?",
        endpoint, timeout);
}

static result_t refused(const Lm__Refusal *refusal)
{
    bool known = refusal->code > RESULT_OK && refusal->code <= RESULT_DENIED;
    return result_fail(known ? (result_code_t)refusal->code : RESULT_PROTOCOL, "the master says: %.400s",
                       refusal->reason);
}

/* A master makes an image: notes how far it is. True when it is not stuck. */
static bool note_progress(remote_t *remote, const Lm__ImageProgress *progress)
{
    const image_wish_t *wish = remote->wish;
    double now = clock_now(), share = fmin(fmax((double)progress->share, 0), 1);
    if (wish == NULL) return false;
    if (progress->before != remote->before || share != remote->share) remote->progressed = now;
    remote->before = progress->before;
    remote->share = share;
    if (wish->making != NULL) wish->making(wish->context, remote->before, share);
    return now - remote->progressed < STUCK;
}

/* Waits for the answer with the number of the last request. */
static result_t await_answer(remote_t *remote, line_t *line, double timeout, wire_message_t *message)
{
    double deadline = clock_now() + timeout;
    for (;;) {
        bool received = false;
        TRY(wire_receive(line->socket, false, message, &received));
        bool ours = received && message->envelope->request == remote->request;
        bool news = ours && message->envelope->body_case == LM__ENVELOPE__BODY_IMAGE_PROGRESS;
        if (ours && !news) return result_ok();
        if (news && note_progress(remote, message->envelope->image_progress))
            deadline = clock_now() + timeout;
        if (received) {
            wire_free(message);
            continue;
        }
        result_t verdict = dial_watch_poll(&line->watch);
        if (line->watch.lost != line->lost)
            return result_fail(RESULT_UNREACHABLE, "the connection to %s broke before the answer came",
                               line->endpoint);
        double left = deadline - clock_now();
        if (verdict.code == RESULT_DENIED || (verdict.code != RESULT_OK && left <= 0))
            return result_fail(verdict.code, "%s: %s", line->endpoint, verdict.message);
        if (left <= 0) return unreachable(line->endpoint, timeout);
        zmq_pollitem_t items[] = {{.socket = line->socket, .events = ZMQ_POLLIN},
                                  {.socket = line->watch.monitor, .events = ZMQ_POLLIN}};
        zmq_poll(items, ARRAY_LENGTH(items), (long)(1e3 * left) + 1);
    }
}

/* Sends a request and waits for its answer. A payload is consumed. */
static result_t exchange(remote_t *remote, line_t *line, Lm__Envelope *envelope, zmq_msg_t *payload,
                         double timeout, wire_message_t *answer)
{
    dial_watch_poll(&line->watch);
    line->lost = line->watch.lost;
    envelope->request = ++remote->request;
    TRY(wire_send(line->socket, NULL, 0, envelope, payload, payload ? 1 : 0));
    result_t result = await_answer(remote, line, timeout, answer);
    if (result.code == RESULT_UNREACHABLE) drop_line(line);
    return result;
}

/* Asks and waits for an answer of the kind `expected`. A payload is consumed. */
static result_t ask(remote_t *remote, line_t *line, Lm__Envelope *envelope, zmq_msg_t *payload,
                    double timeout, Lm__Envelope__BodyCase expected, wire_message_t *answer)
{
    result_t result = open_line(remote, line);
    if (result.code != RESULT_OK && payload != NULL) zmq_msg_close(payload);
    TRY(result);
    TRY(exchange(remote, line, envelope, payload, timeout, answer));
    if (answer->envelope->body_case == expected) return result_ok();
    result = answer->envelope->body_case == LM__ENVELOPE__BODY_REFUSAL
                 ? refused(answer->envelope->refusal)
                 : result_fail(RESULT_PROTOCOL, "the master answered with a message of kind %d, not %d",
                               (int)answer->envelope->body_case, (int)expected);
    wire_free(answer);
    return result;
}

/* Asks, once, where the bulk socket is. */
static result_t need_bulk(remote_t *remote)
{
    wire_message_t message;
    address_t address;
    if (remote->bulk.endpoint != NULL) return result_ok();
    TRY(remote_status(remote, 0, &message));
    uint32_t port = message.envelope->job_status_reply->bulk_port;
    wire_free(&message);
    TRY(address_parse(remote->control.endpoint, WIRE_DEFAULT_PORT, &address));
    if (port < 1 || port > 65535)
        return result_fail(RESULT_PROTOCOL, "the master names %u as its bulk port", port);
    remote->bulk.endpoint = address_endpoint(&address, (int)port);
    return result_ok();
}

/* ---- jobs --------------------------------------------------------------------------------------------- */

result_t remote_submit_job(remote_t *remote, const job_terms_t *terms, const job_settings_t *settings,
                           const hash_t *blob, uint64_t *job)
{
    Lm__Settings wire_settings = LM__SETTINGS__INIT;
    Lm__Terms wire_terms = LM__TERMS__INIT;
    wire_settings_put(settings, &wire_settings);
    wire_terms_put(terms, &wire_terms);
    Lm__JobSubmit submit = LM__JOB_SUBMIT__INIT;
    submit.name = (char *)terms->name;
    submit.settings = &wire_settings;
    submit.terms = &wire_terms;
    submit.blob = wire_hash_put(blob);
    Lm__Envelope envelope = WIRE_ENVELOPE(JOB_SUBMIT, job_submit, &submit);
    wire_message_t answer;
    result_t result = ask(remote, &remote->control, &envelope, NULL, remote->timeout,
                          LM__ENVELOPE__BODY_JOB_ACCEPTED, &answer);
    if (result.code == RESULT_UNREACHABLE)
        return result_fail(result.code, "%s (the job may be there all the same: lightmill status tells)",
                           result.message);
    TRY(result);
    *job = answer.envelope->job_accepted->job;
    if (answer.envelope->job_accepted->save_at != settings->save_at.count)
        log_warning("this master is older than --save-at: it keeps no images on the way");
    if (terms->halves && !answer.envelope->job_accepted->halves)
        log_warning("this master is older than --halves: its images are without");
    wire_free(&answer);
    return result_ok();
}

result_t remote_submit(remote_t *remote, const char *name, const job_settings_t *settings, const hash_t *blob,
                       uint64_t *job)
{
    job_terms_t terms = {0};
    snprintf(terms.name, sizeof terms.name, "%s", name);
    return remote_submit_job(remote, &terms, settings, blob, job);
}

static result_t request_status(remote_t *remote, Lm__JobStatusRequest *request, wire_message_t *message)
{
    Lm__Envelope envelope = WIRE_ENVELOPE(JOB_STATUS_REQUEST, job_status_request, request);
    return ask(remote, &remote->control, &envelope, NULL, remote->timeout,
               LM__ENVELOPE__BODY_JOB_STATUS_REPLY, message);
}

static result_t ask_status(remote_t *remote, uint64_t job, uint64_t from, wire_message_t *message)
{
    Lm__JobStatusRequest request = LM__JOB_STATUS_REQUEST__INIT;
    request.job = job;
    request.from = from;
    return request_status(remote, &request, message);
}

/* Moves the items of another page to the end of a list. Returns where the next page begins; 0: no more. */
typedef uint64_t (*append_fn)(Lm__Envelope *list, Lm__Envelope *page);

static uint64_t append_jobs(Lm__Envelope *list, Lm__Envelope *page)
{
    Lm__JobStatusReply *to = list->job_status_reply, *from = page->job_status_reply;
    to->jobs = mem_realloc(to->jobs, (to->n_jobs + from->n_jobs + 1) * sizeof *to->jobs);
    for (size_t i = 0; i < from->n_jobs; i++) to->jobs[to->n_jobs++] = from->jobs[i];
    from->n_jobs = 0;
    return to->n_jobs < WIRE_MAX_UNITS ? from->next : 0;
}

static uint64_t append_workers(Lm__Envelope *list, Lm__Envelope *page)
{
    Lm__WorkerList *to = list->worker_list, *from = page->worker_list;
    to->workers = mem_realloc(to->workers, (to->n_workers + from->n_workers + 1) * sizeof *to->workers);
    for (size_t i = 0; i < from->n_workers; i++) to->workers[to->n_workers++] = from->workers[i];
    from->n_workers = 0;
    return to->n_workers < WIRE_MAX_UNITS ? from->next : 0;
}

/* A list may come in several messages: asks for the rest, from `next` on, and puts it to the first. */
static result_t ask_further(remote_t *remote, uint64_t next, append_fn append,
                            result_t (*ask_page)(remote_t *, uint64_t job, uint64_t from, wire_message_t *),
                            wire_message_t *list)
{
    while (next != 0) {
        wire_message_t page;
        uint64_t from = next;
        TRY(ask_page(remote, 0, from, &page));
        next = append(list->envelope, page.envelope);
        if (next <= from) next = 0;
        wire_free(&page);
    }
    return result_ok();
}

/* An answer is about this job and no other; the message is freed when it is not. */
static result_t check_job(uint64_t job, wire_message_t *message)
{
    const Lm__JobStatusReply *reply = message->envelope->job_status_reply;
    if (reply->n_jobs == 1 && reply->jobs[0]->job == job) return result_ok();
    wire_free(message);
    return result_fail(RESULT_PROTOCOL, "the master's answer is not about job %llu", (unsigned long long)job);
}

result_t remote_status(remote_t *remote, uint64_t job, wire_message_t *message)
{
    TRY(ask_status(remote, job, 0, message));
    if (job != 0) return check_job(job, message);
    uint64_t next = message->envelope->job_status_reply->next;
    result_t result = ask_further(remote, next, append_jobs, ask_status, message);
    if (result.code != RESULT_OK) wire_free(message);
    return result;
}

result_t remote_history(remote_t *remote, uint64_t job, wire_message_t *message)
{
    Lm__JobStatusRequest request = LM__JOB_STATUS_REQUEST__INIT;
    request.job = job;
    request.history = true;
    TRY(request_status(remote, &request, message));
    return check_job(job, message);
}

static result_t ask_workers(remote_t *remote, uint64_t job, uint64_t from, wire_message_t *message)
{
    (void)job;
    Lm__WorkerListRequest request = LM__WORKER_LIST_REQUEST__INIT;
    request.from = (uint32_t)from;
    Lm__Envelope envelope = WIRE_ENVELOPE(WORKER_LIST_REQUEST, worker_list_request, &request);
    return ask(remote, &remote->control, &envelope, NULL, remote->timeout, LM__ENVELOPE__BODY_WORKER_LIST,
               message);
}

result_t remote_workers(remote_t *remote, wire_message_t *message)
{
    TRY(ask_workers(remote, 0, 0, message));
    result_t result =
        ask_further(remote, message->envelope->worker_list->next, append_workers, ask_workers, message);
    if (result.code != RESULT_OK) wire_free(message);
    return result;
}

result_t remote_order(remote_t *remote, const job_order_t *order)
{
    Lm__JobOrder body = LM__JOB_ORDER__INIT;
    wire_order_put(order, &body);
    Lm__Envelope envelope = WIRE_ENVELOPE(JOB_ORDER, job_order, &body);
    wire_message_t answer;
    TRY(ask(remote, &remote->control, &envelope, NULL, remote->timeout, LM__ENVELOPE__BODY_DONE, &answer));
    wire_free(&answer);
    return result_ok();
}

result_t remote_order_workers(remote_t *remote, worker_order_t kind, const char *who, uint32_t *count)
{
    Lm__WorkerOrder body = LM__WORKER_ORDER__INIT;
    body.kind = kind;
    body.who = (char *)who;
    Lm__Envelope envelope = WIRE_ENVELOPE(WORKER_ORDER, worker_order, &body);
    wire_message_t answer;
    TRY(ask(remote, &remote->control, &envelope, NULL, remote->timeout, LM__ENVELOPE__BODY_WORKER_ORDERED,
            &answer));
    *count = answer.envelope->worker_ordered->count;
    wire_free(&answer);
    return result_ok();
}

result_t remote_cancel(remote_t *remote, uint64_t job)
{
    return remote_order(remote, &(job_order_t){.job = job, .kind = ORDER_CANCEL});
}

/* ---- blobs -------------------------------------------------------------------------------------------- */

/* Sends `length` bytes from `offset`, none to ask where to begin; *next is where the master wants to go on.
 */
static result_t put_chunk(remote_t *remote, const scene_blob_t *blob, uint64_t offset, size_t length,
                          uint64_t *next)
{
    Lm__BlobPut put = LM__BLOB_PUT__INIT;
    put.blob = wire_hash_put(&blob->hash);
    put.offset = offset;
    put.size = blob->size;
    Lm__Envelope envelope = WIRE_ENVELOPE(BLOB_PUT, blob_put, &put);
    zmq_msg_t payload;
    if (zmq_msg_init_size(&payload, length) != 0) return result_fail(RESULT_LIMIT, "out of memory");
    if (length > 0) memcpy(zmq_msg_data(&payload), blob->bytes + offset, length);
    /* The last chunk makes the master hash the whole blob, which may not fit into its memory. */
    bool last = offset + length == blob->size;
    double timeout = last ? SLOW_ANSWER + (double)blob->size / SLOW_BYTES : remote->timeout;
    if (timeout < remote->timeout) timeout = remote->timeout;
    wire_message_t answer;
    TRY(ask(remote, &remote->bulk, &envelope, &payload, timeout, LM__ENVELOPE__BODY_BLOB_PUT_REPLY, &answer));
    *next = answer.envelope->blob_put_reply->next;
    wire_free(&answer);
    if (*next <= blob->size) return result_ok();
    return result_fail(RESULT_PROTOCOL, "the master asks for bytes beyond the end of the scene");
}

result_t remote_put_blob(remote_t *remote, const scene_blob_t *blob, remote_progress_fn progress,
                         void *progress_context)
{
    TRY(need_bulk(remote));
    uint64_t next;
    TRY(put_chunk(remote, blob, 0, 0, &next));
    /* A master that throws bytes away (a wrong hash on its disk) may go back once, not for ever. */
    int setbacks = 0;
    while (next < blob->size) {
        uint64_t left = blob->size - next, before = next;
        TRY(put_chunk(remote, blob, next, left < WIRE_MAX_CHUNK ? (size_t)left : WIRE_MAX_CHUNK, &next));
        if (next <= before && ++setbacks > 2)
            return result_fail(RESULT_PROTOCOL, "the master does not keep the scene that it is sent");
        if (progress) progress(progress_context, next, blob->size);
    }
    return result_ok();
}

/* ---- images ------------------------------------------------------------------------------------------- */

typedef struct {
    image_wish_t wish;
    uint64_t snapshot; /* 0: the first answer names it */
    uint64_t size;
    uint8_t *bytes;
    uint64_t have;
} image_fetch_t;

static result_t take_image_chunk(image_fetch_t *fetch, wire_message_t *answer)
{
    const Lm__ImageChunk *chunk = answer->envelope->image_chunk;
    if (answer->payload_count != 1) return result_fail(RESULT_PROTOCOL, "a chunk of an image without bytes");
    if (chunk->at != fetch->wish.at)
        return result_fail(RESULT_INPUT,
                           "this master keeps no images at sample counts: it is older than --at");
    if (fetch->wish.halves && !chunk->halves)
        return result_fail(RESULT_INPUT, "this master makes no halves: it is older than --halves");
    size_t length = zmq_msg_size(&answer->payload[0]);
    if (fetch->snapshot == 0) {
        if (chunk->size == 0 || chunk->size > MAX_IMAGE_BYTES)
            return result_fail(RESULT_LIMIT, "an image of %llu bytes", (unsigned long long)chunk->size);
        fetch->snapshot = chunk->snapshot;
        fetch->size = chunk->size;
        fetch->bytes = malloc(fetch->size);
        if (fetch->bytes == NULL)
            return result_fail(RESULT_LIMIT, "no memory for an image of %llu bytes",
                               (unsigned long long)chunk->size);
    }
    if (chunk->offset != fetch->have || length == 0 || length > fetch->size - fetch->have)
        return result_fail(RESULT_PROTOCOL, "a chunk of an image that nobody asked for");
    memcpy(fetch->bytes + fetch->have, zmq_msg_data(&answer->payload[0]), length);
    fetch->have += length;
    return result_ok();
}

static result_t get_image_chunk(remote_t *remote, image_fetch_t *fetch)
{
    uint64_t left = fetch->size - fetch->have;
    Lm__ImageGet get = LM__IMAGE_GET__INIT;
    get.job = fetch->wish.job;
    get.snapshot = fetch->snapshot;
    get.offset = fetch->have;
    get.length = fetch->size == 0 || left > WIRE_MAX_CHUNK ? WIRE_MAX_CHUNK : (uint32_t)left;
    get.half = fetch->wish.half;
    get.at = fetch->wish.at;
    get.halves = fetch->wish.halves;
    get.progress = fetch->snapshot == 0;
    Lm__Envelope envelope = WIRE_ENVELOPE(IMAGE_GET, image_get, &get);
    double timeout = fetch->snapshot == 0 && remote->timeout < SLOW_ANSWER ? SLOW_ANSWER : remote->timeout;
    wire_message_t answer;
    remote->wish = &fetch->wish;
    remote->progressed = clock_now();
    result_t result =
        ask(remote, &remote->bulk, &envelope, NULL, timeout, LM__ENVELOPE__BODY_IMAGE_CHUNK, &answer);
    remote->wish = NULL;
    TRY(result);
    result = take_image_chunk(fetch, &answer);
    wire_free(&answer);
    return result;
}

result_t remote_fetch_image(remote_t *remote, const image_wish_t *wish, uint8_t **bytes, size_t *size)
{
    TRY(need_bulk(remote));
    image_fetch_t fetch = {.wish = *wish};
    do {
        result_t result = get_image_chunk(remote, &fetch);
        if (result.code != RESULT_OK) {
            free(fetch.bytes);
            return result;
        }
        if (wish->fetching != NULL) wish->fetching(wish->context, fetch.have, fetch.size);
    } while (fetch.have < fetch.size);
    *bytes = fetch.bytes;
    *size = fetch.size;
    return result_ok();
}
