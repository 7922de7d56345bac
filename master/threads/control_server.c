/* control_server: see control_server.h. Translates messages into calls of the farm, and back. */
#include "master/threads/control_server.h"

#include "master/threads/control_reports.h"
#include "proto/serve/complaint.h"
#include "proto/serve/rate_limit.h"

#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <unistd.h>

enum {
    TICK_MS = 100,
    MESSAGES_A_TURN = 256, /* before notices and the clock get their turn */
    RETRY_MS = 2000,       /* after which an idle worker asks again, if no JobReady comes */
    FLOOD_TICK_MS = 1000,  /* between looks at the leases while messages never end */
    PEER_RATE = 2000,      /* messages a second from one connection, */
    PEER_BURST = 4000,     /* and at once */
    PEERS = 16384,         /* connections that are counted apart */
    KEY_RATE = 20000,      /* from all who have the same key: thousands of workers may share one */
    KEY_BURST = 20000,
    TOKEN_BYTES = 256, /* a longer message counts as several */
    KEYS = 4096
};

struct control_server {
    control_server_options_t options;
    pthread_t thread;
    atomic_bool stop;
    complaint_t complaint;
    complaint_t refused;                  /* of those whom the gate or the limit refused */
    rate_limit_t *peer_limit, *key_limit; /* by connection, by key */
    unit_t *units;                        /* room for one assignment */
    uint64_t messages, bytes, malformed, over_limit;
};

/* Who asks for a report. */
typedef struct {
    control_server_t *server;
    const wire_message_t *message;
} question_t;

static void reply(control_server_t *server, const wire_message_t *message, Lm__Envelope *answer)
{
    answer->request = message->envelope != NULL ? message->envelope->request : 0;
    result_t result =
        wire_send(server->options.socket, message->identity, message->identity_size, answer, NULL, 0);
    if (result.code != RESULT_OK) log_debug("an answer was not sent: %s", result.message);
}

static void refuse(control_server_t *server, const wire_message_t *message, result_t reason)
{
    Lm__Refusal refusal = LM__REFUSAL__INIT;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    refusal.code = reason.code;
    refusal.reason = reason.message;
    answer.body_case = LM__ENVELOPE__BODY_REFUSAL;
    answer.refusal = &refusal;
    reply(server, message, &answer);
}

static void done(control_server_t *server, const wire_message_t *message)
{
    Lm__Done body = LM__DONE__INIT;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    answer.body_case = LM__ENVELOPE__BODY_DONE;
    answer.done = &body;
    reply(server, message, &answer);
}

static identity_t sender(const wire_message_t *message)
{
    identity_t identity = {.size = message->identity_size};
    memcpy(identity.bytes, message->identity, message->identity_size);
    return identity;
}

static uint32_t milliseconds(double seconds)
{
    return (uint32_t)(1000 * seconds + 0.5);
}

/* ---- workers ------------------------------------------------------------------------------------------- */

static void on_hello(control_server_t *server, const wire_message_t *message)
{
    const Lm__Hello *hello = message->envelope->hello;
    const control_server_options_t *options = &server->options;
    if (hello->protocol_version != WIRE_VERSION) {
        result_t reason = result_fail(RESULT_PROTOCOL,
                                      "the worker speaks protocol %u, this master (" LIGHTMILL_VERSION
                                      ") speaks %d: both need the same version of Lightmill",
                                      hello->protocol_version, WIRE_VERSION);
        if (complaint_allowed(&server->complaint, clock_now()))
            log_warning("worker %s is refused: %s", hello->name, reason.message);
        refuse(server, message, reason);
        return;
    }
    Lm__Welcome welcome = LM__WELCOME__INIT;
    identity_t identity = sender(message);
    worker_hello_t said = {
        .name = hello->name, .key = message->key, .threads = hello->threads, .relay = hello->relay};
    wire_hash_get(&hello->fingerprint, &said.fingerprint);
    result_t result = farm_hello(options->farm, clock_now(), &identity, &said, &welcome.worker);
    if (result.code != RESULT_OK) {
        refuse(server, message, result);
        return;
    }
    char *capabilities[] = {"raw", "planes"};
    welcome.protocol_version = WIRE_VERSION;
    welcome.software = "lightmill-master " LIGHTMILL_VERSION;
    welcome.heartbeat_ms = milliseconds(options->heartbeat);
    welcome.lease_ms = milliseconds(options->lease);
    welcome.batch_ms = milliseconds(options->batch_interval);
    welcome.bulk_port = options->bulk_port;
    welcome.n_capabilities = ARRAY_LENGTH(capabilities);
    welcome.capabilities = capabilities;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    answer.body_case = LM__ENVELOPE__BODY_WELCOME;
    answer.welcome = &welcome;
    reply(server, message, &answer);
}

static void send_assignment(control_server_t *server, const wire_message_t *message, const work_t *work)
{
    Lm__Settings settings = LM__SETTINGS__INIT;
    Lm__Assignment assignment = LM__ASSIGNMENT__INIT;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    wire_settings_put(&work->settings, &settings);
    assignment.job = work->job;
    assignment.settings = &settings;
    assignment.blob = wire_hash_put(&work->blob);
    assignment.blob_size = work->blob_size;
    assignment.check = work->check;
    assignment.n_units = work->unit_count;
    assignment.units = wire_units_new(work->units, work->unit_count);
    answer.body_case = LM__ENVELOPE__BODY_ASSIGNMENT;
    answer.assignment = &assignment;
    reply(server, message, &answer);
    free(assignment.units);
}

/* What a worker says that it has of a job. */
static void take_claim(control_server_t *server, const Lm__WorkRequest *request)
{
    hash_t content;
    bool named = request->content.len > 0;
    if (request->n_kept == 0 || (named && !wire_hash_get(&request->content, &content))) return;
    if (wire_units_get(request->kept, request->n_kept, NULL, server->units).code != RESULT_OK) return;
    farm_reclaim(server->options.farm, clock_now(), request->worker, request->job, named ? &content : NULL,
                 server->units, request->n_kept);
}

static void on_work_request(control_server_t *server, const wire_message_t *message)
{
    const Lm__WorkRequest *request = message->envelope->work_request;
    work_t work = {.units = server->units};
    identity_t identity = sender(message);
    take_claim(server, request);
    result_t result = farm_take(server->options.farm, clock_now(), &identity, request->worker, request->job,
                                request->samples, request->unit_samples, &work);
    if (result.code != RESULT_OK) {
        refuse(server, message, result);
    } else if (work.job != 0) {
        send_assignment(server, message, &work);
    } else {
        Lm__NoWork none = LM__NO_WORK__INIT;
        Lm__Envelope answer = LM__ENVELOPE__INIT;
        none.retry_ms = RETRY_MS;
        answer.body_case = LM__ENVELOPE__BODY_NO_WORK;
        answer.no_work = &none;
        reply(server, message, &answer);
    }
}

static void on_heartbeat(control_server_t *server, const wire_message_t *message)
{
    const Lm__Heartbeat *beat = message->envelope->heartbeat;
    Lm__HeartbeatReply body = LM__HEARTBEAT_REPLY__INIT;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    identity_t identity = sender(message);
    body.known = farm_heartbeat(server->options.farm, clock_now(), &identity, beat->worker, beat->job,
                                beat->units_held);
    if (body.known && beat->threads > 0)
        farm_worker_threads(server->options.farm, beat->worker, beat->threads);
    answer.body_case = LM__ENVELOPE__BODY_HEARTBEAT_REPLY;
    answer.heartbeat_reply = &body;
    reply(server, message, &answer);
}

static void on_goodbye(control_server_t *server, const wire_message_t *message)
{
    const Lm__Goodbye *goodbye = message->envelope->goodbye;
    farm_goodbye(server->options.farm, clock_now(), goodbye->worker, goodbye->job, goodbye->reason);
    done(server, message);
}

/* ---- clients ------------------------------------------------------------------------------------------- */

static journal_writer_request_t journal_writer_request(const wire_message_t *message,
                                                       journal_writer_kind_t kind)
{
    return (journal_writer_request_t){
        .identity = sender(message), .request = message->envelope->request, .kind = kind};
}

static result_t submit(control_server_t *server, const wire_message_t *message)
{
    const Lm__JobSubmit *submission = message->envelope->job_submit;
    journal_writer_request_t request = journal_writer_request(message, JOURNAL_WRITER_SUBMIT);
    TRY(wire_settings_get(submission->settings, &request.settings));
    TRY(wire_terms_get(submission->terms, submission->name, &request.terms));
    if (!wire_hash_get(&submission->blob, &request.blob))
        return result_fail(RESULT_PROTOCOL, "the scene's hash has %zu bytes, not %d", submission->blob.len,
                           HASH_BYTES);
    return journal_writer_ask(server->options.journal_writer, &request);
}

static void on_submit(control_server_t *server, const wire_message_t *message)
{
    result_t result = submit(server, message);
    if (result.code != RESULT_OK) refuse(server, message, result);
}

static void send_report(void *context, Lm__Envelope *answer)
{
    const question_t *question = context;
    reply(question->server, question->message, answer);
}

static void on_status(control_server_t *server, const wire_message_t *message)
{
    question_t question = {server, message};
    result_t result = report_jobs(server->options.farm, clock_now(), message->envelope->job_status_request,
                                  server->options.bulk_port, send_report, &question);
    if (result.code != RESULT_OK) refuse(server, message, result);
}

static void on_worker_list(control_server_t *server, const wire_message_t *message)
{
    question_t question = {server, message};
    report_workers(server->options.farm, server->options.gate, clock_now(),
                   message->envelope->worker_list_request, send_report, &question);
}

static void on_order(control_server_t *server, const wire_message_t *message)
{
    journal_writer_request_t request = journal_writer_request(message, JOURNAL_WRITER_ORDER);
    result_t result = wire_order_get(message->envelope->job_order, &request.order);
    if (result.code == RESULT_OK) result = journal_writer_ask(server->options.journal_writer, &request);
    if (result.code != RESULT_OK) refuse(server, message, result);
}

/* What the journal writer has seen to. */
static void send_answers(control_server_t *server)
{
    for (journal_writer_answer_t done_now;
         journal_writer_next_answer(server->options.journal_writer, &done_now);) {
        Lm__Envelope request = LM__ENVELOPE__INIT, answer = LM__ENVELOPE__INIT;
        Lm__JobAccepted accepted = LM__JOB_ACCEPTED__INIT;
        wire_message_t asker = {.envelope = &request, .identity_size = done_now.identity.size};
        memcpy(asker.identity, done_now.identity.bytes, done_now.identity.size);
        request.request = done_now.request;
        if (done_now.result.code != RESULT_OK) {
            refuse(server, &asker, done_now.result);
        } else if (done_now.kind == JOURNAL_WRITER_ORDER) {
            done(server, &asker);
        } else {
            accepted.job = done_now.job;
            answer.body_case = LM__ENVELOPE__BODY_JOB_ACCEPTED;
            answer.job_accepted = &accepted;
            reply(server, &asker, &answer);
        }
    }
}

/* ---- who may ask what ---------------------------------------------------------------------------------- */

static const char *sender_name(const wire_message_t *message)
{
    return message->key[0] != '\0' ? message->key : message->address;
}

/* False when the sender sends too much: the message, not decoded yet, is not looked at. It is told once. */
static bool within_limit(control_server_t *server, const wire_message_t *message)
{
    double now = clock_now();
    double tokens = 1 + (double)(message->bytes / TOKEN_BYTES);
    rate_verdict_t verdict =
        rate_limit_take(server->peer_limit, now, message->identity, message->identity_size, tokens);
    if (verdict == RATE_PASS && message->key[0] != '\0')
        verdict = rate_limit_take(server->key_limit, now, message->key, WIRE_KEY_TEXT, tokens);
    if (verdict == RATE_PASS) return true;
    server->over_limit++;
    if (verdict == RATE_DROP) return false;
    if (complaint_allowed(&server->refused, now))
        log_warning("messages of %s are dropped: more than %d a second", sender_name(message), PEER_RATE);
    refuse(server, message,
           result_fail(RESULT_LIMIT, "more than %d messages a second: those over the limit are dropped",
                       PEER_RATE));
    return false;
}

/* False, and a refusal, when the sender's key does not give it the right. */
static bool allowed(control_server_t *server, wire_message_t *message)
{
    result_t result = gate_check(server->options.gate, message);
    if (result.code == RESULT_OK) return true;
    if (complaint_allowed(&server->refused, clock_now()))
        log_warning("a message from %s is refused: %s", message->address, result.message);
    refuse(server, message, result);
    return false;
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

static void dispatch(control_server_t *server, wire_message_t *message)
{
    if (!allowed(server, message)) return;
    switch (message->envelope->body_case) {
    case LM__ENVELOPE__BODY_HELLO:
        on_hello(server, message);
        break;
    case LM__ENVELOPE__BODY_WORK_REQUEST:
        on_work_request(server, message);
        break;
    case LM__ENVELOPE__BODY_HEARTBEAT:
        on_heartbeat(server, message);
        break;
    case LM__ENVELOPE__BODY_GOODBYE:
        on_goodbye(server, message);
        break;
    case LM__ENVELOPE__BODY_JOB_SUBMIT:
        on_submit(server, message);
        break;
    case LM__ENVELOPE__BODY_JOB_STATUS_REQUEST:
        on_status(server, message);
        break;
    case LM__ENVELOPE__BODY_WORKER_LIST_REQUEST:
        on_worker_list(server, message);
        break;
    case LM__ENVELOPE__BODY_JOB_ORDER:
        on_order(server, message);
        break;
    default:
        refuse(server, message,
               result_fail(RESULT_PROTOCOL, "a message of kind %d does not belong on the control socket",
                           (int)message->envelope->body_case));
    }
}

static void on_malformed(control_server_t *server, const wire_message_t *message, result_t reason)
{
    server->malformed++;
    if (complaint_allowed(&server->complaint, clock_now()))
        log_warning("a peer sent nonsense to the control socket: %s", reason.message);
    if (message->identity_size > 0) refuse(server, message, reason);
}

/* Handles what has come; true when there may be more. */
static bool receive_some(control_server_t *server)
{
    for (int i = 0; i < MESSAGES_A_TURN; i++) {
        wire_message_t message;
        bool received;
        result_t result = wire_receive_frames(server->options.socket, true, &message, &received);
        if (result.code == RESULT_OK && !received) return false;
        if (result.code != RESULT_OK && result.code != RESULT_PROTOCOL)
            return false; /* a broken socket: the loop goes on at the pace of its ticks */
        server->messages++;
        server->bytes += message.bytes;
        if (within_limit(server, &message)) {
            if (received) result = wire_decode(&message);
            if (result.code == RESULT_OK)
                dispatch(server, &message);
            else
                on_malformed(server, &message, result);
        }
        wire_free(&message);
    }
    return true;
}

static void send_notices(control_server_t *server)
{
    for (notice_t notice; farm_next_notice(server->options.farm, &notice);) {
        Lm__JobReady ready = LM__JOB_READY__INIT;
        Lm__JobOver over = LM__JOB_OVER__INIT;
        Lm__Envelope envelope = LM__ENVELOPE__INIT;
        if (notice.job == 0) {
            envelope.body_case = LM__ENVELOPE__BODY_JOB_READY;
            envelope.job_ready = &ready;
        } else {
            over.job = notice.job;
            over.flush = notice.flush;
            envelope.body_case = LM__ENVELOPE__BODY_JOB_OVER;
            envelope.job_over = &over;
        }
        result_t result = wire_send(server->options.socket, notice.identity.bytes, notice.identity.size,
                                    &envelope, NULL, 0);
        if (result.code != RESULT_OK) log_debug("a notice was not sent: %s", result.message);
    }
}

static void *control_server_run(void *argument)
{
    control_server_t *server = argument;
    double last_tick = 0;
    bool more = false;
    prctl(PR_SET_NAME, "lm-control");
    while (!atomic_load(&server->stop)) {
        pulse_beat(server->options.pulse, NULL);
        zmq_pollitem_t items[] = {{.socket = server->options.socket, .events = ZMQ_POLLIN},
                                  {.fd = server->options.wake, .events = ZMQ_POLLIN}};
        zmq_poll(items, ARRAY_LENGTH(items), more ? 0 : TICK_MS);
        uint64_t count;
        if (items[1].revents != 0 && read(server->options.wake, &count, sizeof count) < 0 && errno != EAGAIN)
            log_debug("cannot read an eventfd: %s", strerror(errno));
        more = receive_some(server);
        /* Leases are looked at when no message waits: a heartbeat may be among them. While peers flood the
         * socket, now and then: every connection has had its turn since. */
        if (clock_now() - last_tick >= 1e-3 * (more ? FLOOD_TICK_MS : TICK_MS)) {
            last_tick = clock_now();
            farm_tick(server->options.farm, last_tick);
        }
        send_notices(server);
        send_answers(server);
    }
    log_info("control socket: %llu messages, %.1f MB, %llu malformed, %llu over the limit",
             (unsigned long long)server->messages, 1e-6 * (double)server->bytes,
             (unsigned long long)server->malformed, (unsigned long long)server->over_limit);
    zmq_close(server->options.socket);
    return NULL;
}

static void server_free(control_server_t **server)
{
    rate_limit_destroy(&(*server)->peer_limit);
    rate_limit_destroy(&(*server)->key_limit);
    free((*server)->units);
    free(*server);
    *server = NULL;
}

result_t control_server_start(const control_server_options_t *options, control_server_t **out)
{
    control_server_t *server = mem_zalloc(1, sizeof *server);
    server->options = *options;
    server->units = mem_alloc(WIRE_MAX_UNITS * sizeof *server->units);
    server->peer_limit = rate_limit_new(PEER_RATE, PEER_BURST, PEERS);
    server->key_limit = rate_limit_new(KEY_RATE, KEY_BURST, KEYS);
    int error = pthread_create(&server->thread, NULL, control_server_run, server);
    if (error == 0) {
        *out = server;
        return result_ok();
    }
    server_free(&server);
    return result_fail(RESULT_LIMIT, "cannot start a thread: %s", strerror(error));
}

void control_server_stop(control_server_t **out)
{
    control_server_t *server = *out;
    if (server == NULL) return;
    atomic_store(&server->stop, true);
    uint64_t one = 1;
    if (write(server->options.wake, &one, sizeof one) < 0) log_debug("the control thread is awake already");
    pthread_join(server->thread, NULL);
    server_free(out);
}
