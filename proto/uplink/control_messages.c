/* control_messages: builds the messages to the master on the control socket, and acts on its answers (see
 * control.h and the note in control.c). */
#include "proto/uplink/control_state.h"

#include "common/address.h"

#include <stdlib.h>
#include <string.h>

enum { CLAIMS_A_REQUEST = 384 };           /* of 41 bytes at most: a control message may have 16 KiB */
static const double REQUEST_TIMEOUT = 2.0; /* seconds before an unanswered request for work is repeated */

static result_t send_body(control_t *control, Lm__Envelope *envelope)
{
    envelope->request = ++control->request;
    return wire_send(control->socket, NULL, 0, envelope, NULL, 0);
}

static void log_unsent(const char *what, result_t result)
{
    if (result.code != RESULT_OK) log_debug("%s was not sent: %s", what, result.message);
}

/* ---- what is said ------------------------------------------------------------------------------------- */

void control_send_hello(control_t *control)
{
    uplink_state_t state = control_handler_state(control);
    control->said = state.fingerprint;
    Lm__Hello hello = LM__HELLO__INIT;
    hello.protocol_version = WIRE_VERSION;
    hello.software = (char *)control->setup.software;
    hello.name = (char *)control->setup.name;
    hello.threads = state.threads;
    hello.relay = control->setup.relay;
    hello.process = control->process;
    if (!hash_is_zero(&control->said)) hello.fingerprint = wire_hash_put(&control->said);
    log_unsent("a hello", send_body(control, &WIRE_ENVELOPE(HELLO, hello, &hello)));
}

void control_send_heartbeat(control_t *control, const uplink_state_t *state)
{
    Lm__Heartbeat heartbeat = LM__HEARTBEAT__INIT;
    heartbeat.worker = control->worker;
    heartbeat.job = state->job;
    heartbeat.units_held = state->units_held;
    heartbeat.threads = state->threads;
    heartbeat.trouble = control->trouble;
    log_unsent("a heartbeat", send_body(control, &WIRE_ENVELOPE(HEARTBEAT, heartbeat, &heartbeat)));
    control->next_heartbeat = clock_now() + control->heartbeat;
}

void control_send_goodbye(control_t *control, uint64_t declined, const char *reason)
{
    Lm__Goodbye goodbye = LM__GOODBYE__INIT;
    goodbye.worker = control->worker;
    goodbye.reason = (char *)reason;
    goodbye.job = declined;
    log_unsent("a goodbye", send_body(control, &WIRE_ENVELOPE(GOODBYE, goodbye, &goodbye)));
}

bool control_claims_pending(const control_t *control)
{
    return control->claims_sent < control->claim_count;
}

/* Adds what fits of the claims; new units are asked for only with the last of them. */
static void add_claims(control_t *control, Lm__WorkRequest *work)
{
    size_t left = control->claim_count - control->claims_sent;
    work->n_kept = left < CLAIMS_A_REQUEST ? left : CLAIMS_A_REQUEST;
    work->kept = wire_units_new(control->claims + control->claims_sent,
                                control->claim_issues + control->claims_sent, work->n_kept);
    work->job = control->claim_job;
    work->content = wire_hash_put(&control->claim_content);
    if (left > CLAIMS_A_REQUEST) work->samples = 0;
    control->claims_asked = work->n_kept;
}

void control_request_work(control_t *control, const uplink_state_t *state)
{
    Lm__WorkRequest work = LM__WORK_REQUEST__INIT;
    work.worker = control->worker;
    work.job = state->job;
    work.samples = state->samples;
    work.unit_samples = state->unit_samples;
    if (control_claims_pending(control)) add_claims(control, &work);
    log_unsent("a request for work", send_body(control, &WIRE_ENVELOPE(WORK_REQUEST, work_request, &work)));
    control->work_request = control->request;
    control->next_request = clock_now() + REQUEST_TIMEOUT;
    free(work.kept);
}

/* ---- what is heard ------------------------------------------------------------------------------------ */

/* The endpoint of the bulk socket that a welcome names; the caller frees it. */
static char *bulk_endpoint(const control_t *control, uint32_t port)
{
    const control_setup_t *setup = &control->setup;
    address_t address;
    if (setup->bulk_endpoint) return mem_strdup(setup->bulk_endpoint);
    if (port < 1 || port > 65535) return NULL;
    if (address_parse(setup->control_endpoint, WIRE_DEFAULT_PORT, &address).code != RESULT_OK) return NULL;
    return address_endpoint(&address, (int)port);
}

static double clamp(double value, double least, double most)
{
    return value < least ? least : value > most ? most : value;
}

/* After a new hello: notes what is in hand, to be named in the next requests for work. */
static void note_claims(control_t *control)
{
    uplink_state_t state = control_handler_state(control);
    if (control->claims == NULL) {
        control->claims = mem_alloc(WIRE_MAX_UNITS * sizeof *control->claims);
        control->claim_issues = mem_alloc(WIRE_MAX_UNITS * sizeof *control->claim_issues);
    }
    control->claim_job = state.job;
    control->claim_content = state.content;
    control->claims_sent = control->claims_asked = 0;
    control->claim_count =
        state.job == 0 ? 0
                       : control_calls(control)->kept(control->setup.handler.self, state.job, control->claims,
                                                      control->claim_issues, WIRE_MAX_UNITS);
}

/* With another key we are somebody else to the master, who takes nothing of what the first one was given. */
static void drop_if_key_changed(control_t *control)
{
    if (strcmp(control->key, control->setup.keys.own.open) == 0) return;
    uplink_state_t state;
    while ((state = control_handler_state(control)).job != 0)
        control_calls(control)->job_over(control->setup.handler.self, state.job, false);
}

static void on_welcome(control_t *control, const Lm__Welcome *welcome)
{
    if (control->phase != PHASE_DIALLING) return;
    char *endpoint = bulk_endpoint(control, welcome->bulk_port);
    if (endpoint == NULL || welcome->protocol_version != WIRE_VERSION) {
        log_error("the master (%.100s, protocol %u) names bulk port %u; this worker speaks protocol %d",
                  welcome->software, welcome->protocol_version, welcome->bulk_port, WIRE_VERSION);
        free(endpoint);
        control_rest(control);
        return;
    }
    double now = clock_now();
    control->phase = PHASE_UP;
    control->worker = welcome->worker;
    control->bulk_port = welcome->bulk_port;
    control->heartbeat = clamp(1e-3 * welcome->heartbeat_ms, 0.05, 60);
    control->lease = clamp(1e-3 * welcome->lease_ms, 0.5, 3600);
    control->batch_interval = clamp(1e-3 * welcome->batch_ms, 0.05, 3600);
    control->last_heard = now;
    control->next_heartbeat = now + control->heartbeat;
    control->next_report = now + REPORT_INTERVAL;
    control->work_request = 0;
    control->next_request = now;
    control->backoff = FIRST_BACKOFF;
    control->last_complaint = 0;
    log_info("joined the master at %s (%.100s), %u threads", control->setup.control_endpoint,
             welcome->software, control_handler_state(control).threads);
    if (control->was_up) {
        drop_if_key_changed(control);
        control_calls(control)->forget(control->setup.handler.self);
        note_claims(control);
    }
    control->was_up = true;
    memcpy(control->key, control->setup.keys.own.open, sizeof control->key);
    bulk_link_up(control->setup.bulk, endpoint, control->worker, control->batch_interval);
    free(endpoint);
}

/* The units of an assignment and their MACs, in one piece of memory. */
static result_t read_units(const Lm__Assignment *message, assignment_t *assignment)
{
    size_t count = message->n_units;
    if (count > WIRE_MAX_UNITS) return result_fail(RESULT_LIMIT, "an assignment of %zu units", count);
    size_t macs_at = (count * sizeof(unit_t) + 7) & ~(size_t)7;
    uint8_t *memory = mem_alloc(macs_at + (count + 1) * sizeof(uint64_t));
    assignment->unit_count = count;
    assignment->units = (unit_t *)memory;
    assignment->macs = (uint64_t *)(memory + macs_at);
    for (size_t i = 0; i < count; i++) assignment->macs[i] = message->units[i]->mac;
    result_t result = wire_units_get(message->units, count, &assignment->settings, assignment->units, NULL);
    if (result.code != RESULT_OK) free(memory);
    return result;
}

static result_t read_assignment(const Lm__Assignment *message, assignment_t *assignment)
{
    *assignment =
        (assignment_t){.job = message->job, .check = message->check, .blob_size = message->blob_size};
    if (message->settings == NULL || message->job == 0)
        return result_fail(RESULT_PROTOCOL, "an assignment without a job or without settings");
    TRY(wire_settings_get(message->settings, &assignment->settings));
    if (!wire_hash_get(&message->blob, &assignment->blob))
        return result_fail(RESULT_PROTOCOL, "an assignment without the hash of a scene");
    if (message->blob_size == 0 || message->blob_size > BLOB_MAX_BYTES)
        return result_fail(RESULT_LIMIT, "a scene of %llu bytes", (unsigned long long)message->blob_size);
    assignment->content = job_content_hash(&assignment->settings, &assignment->blob);
    TRY(read_units(message, assignment));
    result_t result = wire_plans_get(message->plans, message->n_plans, &assignment->settings,
                                     assignment->units, assignment->unit_count, assignment->plans);
    if (result.code != RESULT_OK) free(assignment->units);
    return result;
}

static void on_assignment(control_t *control, const Lm__Assignment *message)
{
    assignment_t assignment;
    result_t result = read_assignment(message, &assignment);
    if (result.code != RESULT_OK) {
        control_give_up_job(control, message->job, result);
        return;
    }
    log_debug("assigned %zu units of job %llu", assignment.unit_count, (unsigned long long)assignment.job);
    /* An empty assignment is as good as none: do not ask again at once. */
    control->next_request = clock_now() + (assignment.unit_count == 0 ? TICK : 0);
    control_calls(control)->assign(control->setup.handler.self, &assignment);
}

static void on_no_work(control_t *control, const Lm__NoWork *message)
{
    if (control->claims_sent + control->claims_asked < control->claim_count) {
        control->next_request = 0; /* nothing was asked for yet */
        return;
    }
    control->next_request = clock_now() + clamp(1e-3 * message->retry_ms, 0.01, 60);
    control_calls(control)->no_more(control->setup.handler.self);
}

static void on_refusal(control_t *control, const Lm__Envelope *envelope)
{
    const Lm__Refusal *refusal = envelope->refusal;
    if (envelope->request == 0 && refusal->code == RESULT_PROTOCOL) {
        /* Something of ours was damaged on its way: it is asked for again when no answer comes. */
        log_warning("the master could not read a message: %.300s", refusal->reason);
    } else if (control->phase == PHASE_DIALLING) {
        log_error("the master does not admit this worker: %.300s; asking again in %.0f s", refusal->reason,
                  REST);
        control_rest(control);
    } else if (refusal->code == RESULT_DENIED && control->leave_by == 0) {
        control_redial(control, refusal->reason); /* with a new key, if there is one by now */
    } else if (envelope->request != 0 && envelope->request == control->work_request &&
               control->leave_by == 0) {
        control_redial(control, refusal->reason);
    } else {
        log_warning("the master refused a message: %.300s", refusal->reason);
    }
}

static void dispatch(control_t *control, const Lm__Envelope *envelope)
{
    control->last_heard = clock_now();
    bool answers_request = envelope->request != 0 && envelope->request == control->work_request;
    switch (envelope->body_case) {
    case LM__ENVELOPE__BODY_WELCOME:
        on_welcome(control, envelope->welcome);
        break;
    case LM__ENVELOPE__BODY_REFUSAL:
        on_refusal(control, envelope);
        break;
    case LM__ENVELOPE__BODY_ASSIGNMENT:
        on_assignment(control, envelope->assignment);
        break;
    case LM__ENVELOPE__BODY_NO_WORK:
        on_no_work(control, envelope->no_work);
        break;
    case LM__ENVELOPE__BODY_JOB_READY:
        control->next_request = 0;
        break;
    case LM__ENVELOPE__BODY_JOB_OVER:
        control_calls(control)->job_over(control->setup.handler.self, envelope->job_over->job,
                                         envelope->job_over->flush);
        break;
    case LM__ENVELOPE__BODY_LEAVE:
        if (!control->told_to_leave) log_info("the master asks this process to leave");
        control->told_to_leave = true;
        break;
    case LM__ENVELOPE__BODY_HEARTBEAT_REPLY:
        if (!envelope->heartbeat_reply->known)
            control_redial(control, "the master does not know this worker any more");
        break;
    case LM__ENVELOPE__BODY_DONE:
        control->farewell = true;
        break;
    default:
        log_debug("ignored a message of kind %d", (int)envelope->body_case);
    }
    if (!answers_request) return;
    control->work_request = 0;
    control->claims_sent += control->claims_asked;
    control->claims_asked = 0;
}

void control_receive_all(control_t *control)
{
    for (bool received = true; received && control->socket;) {
        void *socket = control->socket;
        wire_message_t message;
        result_t result = wire_receive(socket, false, &message, &received);
        if (result.code != RESULT_OK) {
            log_warning("dropped a message of the master: %s", result.message);
            received = result.code == RESULT_PROTOCOL; /* else the socket is broken */
        } else if (received) {
            dispatch(control, message.envelope);
            wire_free(&message);
        }
    }
}
