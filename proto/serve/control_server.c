/* control_server: see control_server.h. Translates messages into calls of the handler, and back. */
#include "proto/serve/control_server.h"

#include <stdio.h>
#include <stdlib.h>

enum {
    TICK_MS = 100,
    MESSAGES_A_TURN = 256, /* before notices and the clock get their turn */
    RETRY_MS = 2000,       /* after which an idle worker asks again, if no JobReady comes */
    FLOOD_TICK_MS = 1000   /* between looks at the leases while messages never end */
};

struct control_server {
    server_options_t options;
    serve_handler_t handler;
    uint32_t bulk_port;
    peer_server_t *thread;
    char software[64];
    unit_t *units;   /* room for one assignment, */
    issue_t *issues; /* and how it is issued */
    double last_tick;
};

static const char *program(const server_options_t *options)
{
    return options->gate.relay ? "relay" : "master";
}

static uint32_t milliseconds(double seconds)
{
    return (uint32_t)(1000 * seconds + 0.5);
}

/* ---- coming and going ---------------------------------------------------------------------------------- */

static result_t admit(control_server_t *control, const wire_message_t *message, uint64_t *worker)
{
    const Lm__Hello *hello = message->envelope->hello;
    const serve_handler_t *handler = &control->handler;
    identity_t identity = peer_identity(message);
    worker_hello_t said = {.name = hello->name,
                           .key = message->key,
                           .address = message->address,
                           .threads = hello->threads,
                           .process = hello->process,
                           .relay = hello->relay};
    if (hello->protocol_version != WIRE_VERSION)
        return result_fail(RESULT_PROTOCOL,
                           "the worker speaks protocol %u, this %s (" LIGHTMILL_VERSION
                           ") speaks %d: both need the same version of Lightmill",
                           hello->protocol_version, program(&control->options), WIRE_VERSION);
    wire_hash_get(&hello->fingerprint, &said.fingerprint);
    return handler->calls->hello(handler->self, clock_now(), &identity, &said, worker);
}

static void on_hello(void *self, peer_server_t *server, const wire_message_t *message)
{
    control_server_t *control = self;
    const server_options_t *options = &control->options;
    Lm__Welcome welcome = LM__WELCOME__INIT;
    result_t result = admit(control, message, &welcome.worker);
    if (result.code != RESULT_OK) {
        if (result.code != RESULT_CANCELLED)
            peer_complain(server, "worker %s is refused: %s", message->envelope->hello->name, result.message);
        peer_refuse(server, message, result);
        return;
    }
    char *capabilities[] = {"raw", "planes", "streams"};
    welcome.protocol_version = WIRE_VERSION;
    welcome.software = control->software;
    welcome.heartbeat_ms = milliseconds(options->heartbeat);
    welcome.lease_ms = milliseconds(options->lease);
    welcome.batch_ms = milliseconds(options->batch_interval);
    welcome.bulk_port = control->bulk_port;
    welcome.n_capabilities = ARRAY_LENGTH(capabilities);
    welcome.capabilities = capabilities;
    peer_reply(server, message, LM__ENVELOPE__BODY_WELCOME, &welcome, NULL);
}

static void on_heartbeat(void *self, peer_server_t *server, const wire_message_t *message)
{
    const serve_handler_t *handler = &((control_server_t *)self)->handler;
    const Lm__Heartbeat *body = message->envelope->heartbeat;
    Lm__HeartbeatReply answer = LM__HEARTBEAT_REPLY__INIT;
    identity_t identity = peer_identity(message);
    heartbeat_t beat = {.worker = body->worker,
                        .job = body->job,
                        .units_held = body->units_held,
                        .threads = body->threads,
                        .trouble = body->trouble};
    answer.known = handler->calls->heartbeat(handler->self, clock_now(), &identity, &beat);
    peer_reply(server, message, LM__ENVELOPE__BODY_HEARTBEAT_REPLY, &answer, NULL);
}

static void on_goodbye(void *self, peer_server_t *server, const wire_message_t *message)
{
    const serve_handler_t *handler = &((control_server_t *)self)->handler;
    const Lm__Goodbye *body = message->envelope->goodbye;
    Lm__Done done = LM__DONE__INIT;
    handler->calls->goodbye(handler->self, clock_now(), body->worker, body->job, body->reason);
    peer_reply(server, message, LM__ENVELOPE__BODY_DONE, &done, NULL);
}

/* ---- work ---------------------------------------------------------------------------------------------- */

/* What a worker says that it has of a job. */
static void take_claim(control_server_t *control, const Lm__WorkRequest *request)
{
    const serve_handler_t *handler = &control->handler;
    hash_t content;
    bool named = request->content.len > 0;
    if (request->n_kept == 0 || (named && !wire_hash_get(&request->content, &content))) return;
    if (wire_units_get(request->kept, request->n_kept, NULL, control->units, control->issues).code !=
        RESULT_OK)
        return;
    claim_t claim = {.worker = request->worker,
                     .job = request->job,
                     .content = named ? &content : NULL,
                     .units = control->units,
                     .issues = control->issues,
                     .unit_count = request->n_kept};
    handler->calls->claim(handler->self, clock_now(), &claim);
}

static void send_assignment(peer_server_t *server, const wire_message_t *message, const work_t *work)
{
    Lm__Settings settings = LM__SETTINGS__INIT;
    Lm__Assignment assignment = LM__ASSIGNMENT__INIT;
    wire_settings_put(&work->settings, &settings);
    assignment.job = work->job;
    assignment.settings = &settings;
    assignment.blob = wire_hash_put(&work->blob);
    assignment.blob_size = work->blob_size;
    assignment.check = work->check;
    assignment.n_units = work->unit_count;
    assignment.units = wire_units_new(work->units, work->issues, work->unit_count);
    assignment.plans = wire_plans_new(work->plans, &assignment.n_plans);
    peer_reply(server, message, LM__ENVELOPE__BODY_ASSIGNMENT, &assignment, NULL);
    free(assignment.units);
    free(assignment.plans);
}

static void on_work_request(void *self, peer_server_t *server, const wire_message_t *message)
{
    control_server_t *control = self;
    const serve_handler_t *handler = &control->handler;
    const Lm__WorkRequest *body = message->envelope->work_request;
    Lm__NoWork none = LM__NO_WORK__INIT;
    identity_t identity = peer_identity(message);
    work_request_t request = {body->worker, body->job, body->samples, body->unit_samples};
    work_t work = {.units = control->units, .issues = control->issues};
    take_claim(control, body);
    result_t result = handler->calls->take(handler->self, clock_now(), &identity, &request, &work);
    none.retry_ms = RETRY_MS;
    if (result.code != RESULT_OK)
        peer_refuse(server, message, result);
    else if (work.job != 0)
        send_assignment(server, message, &work);
    else
        peer_reply(server, message, LM__ENVELOPE__BODY_NO_WORK, &none, NULL);
}

/* ---- the thread ---------------------------------------------------------------------------------------- */

/* A new kind of message takes four places:
 *
 *   1. its fields in proto/wire/lightmill.proto,
 *   2. its line in proto/wire/PROTOCOL.md,
 *   3. the function that handles it, and
 *   4. its row, in the table of the same file: here, in bulk_server.c or, when a master alone is asked, in
 *      master/threads/client_control.c or master/threads/client_bulk.c.
 *
 * Only when it says something of workers that could not be said before, serve_handler.h gets a call for it,
 * which the farm's service and the relay's pool implement. */
static const message_kind_t kinds[] = {{LM__ENVELOPE__BODY_HELLO, RIGHT_WORK, on_hello},
                                       {LM__ENVELOPE__BODY_WORK_REQUEST, RIGHT_WORK, on_work_request},
                                       {LM__ENVELOPE__BODY_HEARTBEAT, RIGHT_WORK, on_heartbeat},
                                       {LM__ENVELOPE__BODY_GOODBYE, RIGHT_WORK, on_goodbye}};

static void send_notices(const serve_handler_t *handler, peer_server_t *server)
{
    for (notice_t notice; handler->calls->next_notice(handler->self, &notice);) {
        Lm__JobReady ready = LM__JOB_READY__INIT;
        Lm__JobOver over = LM__JOB_OVER__INIT;
        Lm__Leave leave = LM__LEAVE__INIT;
        over.job = notice.job;
        over.flush = notice.flush;
        if (notice.leave)
            peer_send(server, &notice.identity, 0, LM__ENVELOPE__BODY_LEAVE, &leave, NULL);
        else if (notice.job == 0)
            peer_send(server, &notice.identity, 0, LM__ENVELOPE__BODY_JOB_READY, &ready, NULL);
        else
            peer_send(server, &notice.identity, 0, LM__ENVELOPE__BODY_JOB_OVER, &over, NULL);
    }
}

static void turn(void *self, peer_server_t *server, bool more)
{
    control_server_t *control = self;
    const serve_handler_t *handler = &control->handler;
    /* Leases are looked at when no message waits: a heartbeat may be among them. While peers flood the
     * socket, now and then: every connection has had its turn since. */
    if (clock_now() - control->last_tick >= 1e-3 * (more ? FLOOD_TICK_MS : TICK_MS)) {
        control->last_tick = clock_now();
        handler->calls->tick(handler->self, control->last_tick);
    }
    send_notices(handler, server);
}

result_t control_server_start(const server_options_t *options, const served_socket_t *served,
                              uint32_t bulk_port, control_server_t **out)
{
    control_server_t *control = mem_zalloc(1, sizeof *control);
    peer_server_options_t thread = {.name = "control",
                                    .data_dir = options->data_dir,
                                    .elsewhere = options->elsewhere,
                                    .socket = served->socket,
                                    .gate = served->gate,
                                    .wake = options->control_wake,
                                    .turn_ms = TICK_MS,
                                    .turn_messages = MESSAGES_A_TURN,
                                    .limited = true,
                                    .pulse = options->pulse,
                                    .tables = {{kinds, ARRAY_LENGTH(kinds), turn, control}, served->more}};
    control->options = *options;
    control->handler = served->handler;
    control->bulk_port = bulk_port;
    control->units = mem_alloc(WIRE_MAX_UNITS * sizeof *control->units);
    control->issues = mem_alloc(WIRE_MAX_UNITS * sizeof *control->issues);
    snprintf(control->software, sizeof control->software, "lightmill-%s " LIGHTMILL_VERSION,
             program(options));
    result_t result = peer_server_start(&thread, &control->thread);
    if (result.code != RESULT_OK) control_server_stop(&control);
    *out = control;
    return result;
}

void control_server_stop(control_server_t **out)
{
    control_server_t *control = *out;
    if (control == NULL) return;
    peer_server_stop(&control->thread);
    free(control->units);
    free(control->issues);
    free(control);
    *out = NULL;
}
