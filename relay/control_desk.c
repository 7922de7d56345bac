/* control_desk: see control_desk.h. Translates messages into calls of the pool, and back. */
#include "relay/control_desk.h"

#include <stdlib.h>
#include <string.h>

enum {
    TICK_MS = 100,
    FLOOD_TICK_MS = 1000, /* between looks at the leases while messages never end */
    RETRY_MS = 2000       /* after which an idle worker asks again, if no JobReady comes */
};

struct control_desk {
    control_desk_options_t options;
    desk_t *thread; /* the owner's */
    desk_t *desk;   /* the same, for the thread itself */
    unit_t *units;  /* room for one assignment */
    double last_tick;
};

static void done(desk_t *desk, const wire_message_t *message)
{
    Lm__Done body = LM__DONE__INIT;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    answer.body_case = LM__ENVELOPE__BODY_DONE;
    answer.done = &body;
    desk_reply(desk, message, &answer, NULL);
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

static result_t admit(control_desk_t *control, const wire_message_t *message, uint64_t *worker)
{
    const Lm__Hello *hello = message->envelope->hello;
    worker_hello_t said = {
        .name = hello->name, .key = message->key, .threads = hello->threads, .relay = hello->relay};
    identity_t identity = sender(message);
    if (hello->protocol_version != WIRE_VERSION)
        return result_fail(RESULT_PROTOCOL,
                           "the worker speaks protocol %u, this relay (" LIGHTMILL_VERSION
                           ") speaks %d: both need the same version of Lightmill",
                           hello->protocol_version, WIRE_VERSION);
    wire_hash_get(&hello->fingerprint, &said.fingerprint);
    return pool_hello(control->options.pool, clock_now(), &identity, &said, worker);
}

static void on_hello(control_desk_t *control, const wire_message_t *message)
{
    const control_desk_options_t *options = &control->options;
    Lm__Welcome welcome = LM__WELCOME__INIT;
    result_t result = admit(control, message, &welcome.worker);
    if (result.code != RESULT_OK) {
        desk_complain(control->desk, "worker %s is refused: %s", message->envelope->hello->name,
                      result.message);
        desk_refuse(control->desk, message, result);
        return;
    }
    char *capabilities[] = {"raw", "planes"};
    welcome.protocol_version = WIRE_VERSION;
    welcome.software = "lightmill-relay " LIGHTMILL_VERSION;
    welcome.heartbeat_ms = milliseconds(options->heartbeat);
    welcome.lease_ms = milliseconds(options->lease);
    welcome.batch_ms = milliseconds(options->batch_interval);
    welcome.bulk_port = options->bulk_port;
    welcome.n_capabilities = ARRAY_LENGTH(capabilities);
    welcome.capabilities = capabilities;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    answer.body_case = LM__ENVELOPE__BODY_WELCOME;
    answer.welcome = &welcome;
    desk_reply(control->desk, message, &answer, NULL);
}

static void send_assignment(control_desk_t *control, const wire_message_t *message, const work_t *work)
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
    desk_reply(control->desk, message, &answer, NULL);
    free(assignment.units);
}

static void send_no_work(control_desk_t *control, const wire_message_t *message)
{
    Lm__NoWork none = LM__NO_WORK__INIT;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    none.retry_ms = RETRY_MS;
    answer.body_case = LM__ENVELOPE__BODY_NO_WORK;
    answer.no_work = &none;
    desk_reply(control->desk, message, &answer, NULL);
}

/* What a worker says that it has of a job. */
static void take_claim(control_desk_t *control, const Lm__WorkRequest *request)
{
    job_settings_t settings;
    hash_t content;
    if (request->n_kept == 0 || !wire_hash_get(&request->content, &content)) return;
    if (!pool_job_settings(control->options.pool, request->job, &settings)) return;
    if (wire_units_get(request->kept, request->n_kept, &settings, control->units).code != RESULT_OK) return;
    pool_claim(control->options.pool, request->worker, request->job, &content, control->units,
               request->n_kept);
}

static void on_work_request(control_desk_t *control, const wire_message_t *message)
{
    const Lm__WorkRequest *request = message->envelope->work_request;
    work_t work = {.units = control->units};
    identity_t identity = sender(message);
    take_claim(control, request);
    result_t result = pool_take(control->options.pool, clock_now(), &identity, request->worker, request->job,
                                request->samples, request->unit_samples, &work);
    if (result.code != RESULT_OK)
        desk_refuse(control->desk, message, result);
    else if (work.job != 0)
        send_assignment(control, message, &work);
    else
        send_no_work(control, message);
}

static void on_heartbeat(control_desk_t *control, const wire_message_t *message)
{
    const Lm__Heartbeat *beat = message->envelope->heartbeat;
    Lm__HeartbeatReply body = LM__HEARTBEAT_REPLY__INIT;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    identity_t identity = sender(message);
    body.known = pool_heartbeat(control->options.pool, clock_now(), &identity, beat->worker, beat->job,
                                beat->units_held, beat->threads);
    answer.body_case = LM__ENVELOPE__BODY_HEARTBEAT_REPLY;
    answer.heartbeat_reply = &body;
    desk_reply(control->desk, message, &answer, NULL);
}

static void handle(void *self, desk_t *desk, wire_message_t **taken)
{
    control_desk_t *control = self;
    const wire_message_t *message = *taken;
    control->desk = desk;
    switch (message->envelope->body_case) {
    case LM__ENVELOPE__BODY_HELLO:
        on_hello(control, message);
        break;
    case LM__ENVELOPE__BODY_WORK_REQUEST:
        on_work_request(control, message);
        break;
    case LM__ENVELOPE__BODY_HEARTBEAT:
        on_heartbeat(control, message);
        break;
    case LM__ENVELOPE__BODY_GOODBYE:
        pool_goodbye(control->options.pool, clock_now(), message->envelope->goodbye->worker,
                     message->envelope->goodbye->job, message->envelope->goodbye->reason);
        done(desk, message);
        break;
    default:
        desk_refuse(desk, message,
                    result_fail(RESULT_PROTOCOL,
                                "this is a relay, which only workers can use; the master is at %s",
                                control->options.master));
    }
}

static void send_notices(control_desk_t *control)
{
    for (notice_t notice; pool_next_notice(control->options.pool, &notice);) {
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
        desk_send(control->desk, notice.identity.bytes, notice.identity.size, &envelope);
    }
}

static void turn(void *self, desk_t *desk, bool quiet)
{
    control_desk_t *control = self;
    control->desk = desk;
    /* Leases are looked at when no message waits: a heartbeat may be among them. While peers flood the
     * socket, now and then: every connection has had its turn since. */
    if (clock_now() - control->last_tick >= 1e-3 * (quiet ? TICK_MS : FLOOD_TICK_MS)) {
        control->last_tick = clock_now();
        pool_tick(control->options.pool, control->last_tick);
    }
    send_notices(control);
}

result_t control_desk_start(const control_desk_options_t *options, control_desk_t **out)
{
    control_desk_t *control = mem_zalloc(1, sizeof *control);
    control->options = *options;
    control->units = mem_alloc(WIRE_MAX_UNITS * sizeof *control->units);
    desk_options_t desk = {.name = "relay control",
                           .socket = options->socket,
                           .gate = options->gate,
                           .wake = options->wake,
                           .self = control,
                           .handle = handle,
                           .turn = turn};
    result_t result = desk_start(&desk, &control->thread);
    if (result.code != RESULT_OK) control_desk_stop(&control);
    *out = control;
    return result;
}

void control_desk_stop(control_desk_t **out)
{
    control_desk_t *control = *out;
    if (control == NULL) return;
    desk_stop(&control->thread);
    free(control->units);
    free(control);
    *out = NULL;
}
