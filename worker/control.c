/* control: see control.h.
 *
 * DESIGN. A small state machine on one thread that never does anything long, so that heartbeats are always in
 * time:
 *
 *   DIALLING --Welcome--> UP --silence, or "unknown worker"--> DIALLING
 *       |  ^                 \--cannot render here, Goodbye--> RESTING
 *       |  +--back-off--------------------------------------------+
 *       +--Refusal (wrong version, not admitted)--> RESTING
 *
 * Every dial is a fresh socket: nothing that was queued for a dead master reaches its successor, and no
 * answer of the old one is taken for one of the new. Within one dial libzmq itself retries the connection, so
 * the back-off only bounds how often a Hello is repeated.
 *
 * When the master is silent, rendering goes on with what is in hand, and what is being delivered stays on its
 * way: the bulk connection is another one. Only a new welcome shows what became of it: units that were not
 * begun have been given to others and are dropped; the batch so far is offered at once, and the master takes
 * it or refuses it, since it alone knows what is still missing. The first request for work after that names
 * what is in hand (WorkRequest.kept), so that it is not given to somebody else as well.
 *
 * A master that was restarted is found within a second: libzmq tries to connect twice a second, the
 * heartbeats that waited meanwhile reach the new process, and its answer is that it does not know the worker.
 */
#include "worker/control.h"

#include "common/address.h"
#include "proto/wire.h"

#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>

enum { CLAIMS_A_REQUEST = 512 };         /* so that it stays far below the limit of a control message */
static const double TICK = 0.1;          /* seconds: the longest sleep, so that a signal is seen soon */
static const double FIRST_BACKOFF = 1.0; /* seconds between Hellos */
static const double MAX_BACKOFF = 10.0;
static const double REST = 10.0;            /* seconds before a refusing master is asked again */
static const double REQUEST_TIMEOUT = 2.0;  /* seconds before an unanswered request for work is repeated */
static const double SENDING_SHARE = 0.4;    /* of the grace period is for delivering, */
static const double SENDING_TIME = 10.0;    /* but not more seconds than this */
static const double FAREWELL_TIMEOUT = 1.0; /* seconds for the answer to a Goodbye */
static const double REPORT_INTERVAL = 60.0; /* seconds between lines on what is going on */

typedef enum { PHASE_DIALLING, PHASE_UP, PHASE_RESTING } phase_t;

typedef struct {
    control_setup_t setup;
    void *socket; /* NULL while resting */
    dial_watch_t watch;
    phase_t phase;
    double deadline; /* DIALLING, RESTING: when to dial again */
    double backoff;
    uint64_t request; /* the last number used */
    uint64_t dials;
    bool was_up; /* there was a welcome before */
    hash_t said; /* the fingerprint in the last Hello */
    double last_complaint;

    /* While up. */
    uint64_t worker;
    double heartbeat, lease, batch_interval; /* seconds */
    double last_heard, next_heartbeat, next_report;
    uint64_t work_request; /* unanswered, 0: none */
    /* What was in hand at the welcome and is still to be named in requests for work. */
    unit_t *claims;
    size_t claim_count, claims_sent, claims_asked; /* in all; answered; with the request that is not */
    uint64_t claim_job;
    hash_t claim_content;
    double next_request; /* when to ask for work again */

    double leave_by;   /* 0: not leaving */
    double give_up_at; /* what is not finished then is given up */
    bool gave_up;
    bool farewell; /* the Goodbye was answered */
    result_t fatal;
} control_t;

static const crew_calls_t *crew_calls(const control_t *control)
{
    return control->setup.crew.calls;
}

static crew_state_t crew_state(const control_t *control)
{
    return control->setup.crew.calls->state(control->setup.crew.self);
}

static result_t send_body(control_t *control, Lm__Envelope *envelope)
{
    envelope->request = ++control->request;
    return wire_send(control->socket, NULL, 0, envelope, NULL, 0);
}

static void log_unsent(const char *what, result_t result)
{
    if (result.code != RESULT_OK) log_debug("%s was not sent: %s", what, result.message);
}

/* ---- dialling ----------------------------------------------------------------------------------------- */

static void hang_up(control_t *control)
{
    dial_watch_close(&control->watch, control->socket);
    if (control->socket) zmq_close(control->socket);
    control->socket = NULL;
}

static void send_hello(control_t *control)
{
    static const hash_t unknown = {{0}};
    crew_state_t state = crew_state(control);
    control->said = state.fingerprint;
    Lm__Hello hello = LM__HELLO__INIT;
    hello.protocol_version = WIRE_VERSION;
    hello.software = (char *)control->setup.software;
    hello.name = (char *)control->setup.name;
    hello.threads = state.threads;
    hello.relay = control->setup.relay;
    if (!hash_equal(&control->said, &unknown)) hello.fingerprint = wire_hash_put(&control->said);
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_HELLO;
    envelope.hello = &hello;
    log_unsent("a hello", send_body(control, &envelope));
}

static result_t open_socket(control_t *control)
{
    TRY(wire_socket(control->setup.context, ZMQ_DEALER, &control->socket));
    TRY(wire_socket_limit(control->socket, WIRE_MAX_CONTROL_FRAME));
    TRY(dial_keys_apply(&control->setup.keys, control->socket));
    TRY(dial_watch_open(&control->watch, control->setup.context, control->socket, &control->setup.keys));
    const char *endpoint = control->setup.control_endpoint;
    if (zmq_connect(control->socket, endpoint) == 0) return result_ok();
    return result_fail(RESULT_IO, "cannot connect to %s: %s", endpoint, zmq_strerror(zmq_errno()));
}

/* Waits before the next dial, for reasons that a quick retry would not cure. */
static void rest(control_t *control)
{
    hang_up(control);
    bulk_link_down(control->setup.bulk);
    control->phase = PHASE_RESTING;
    control->deadline = clock_now() + REST;
}

static void dial(control_t *control)
{
    hang_up(control);
    result_t result = open_socket(control);
    if (result.code != RESULT_OK) {
        log_error("%s", result.message);
        rest(control);
        return;
    }
    control->phase = PHASE_DIALLING;
    control->deadline = clock_now() + control->backoff;
    control->backoff = control->backoff * 2 < MAX_BACKOFF ? control->backoff * 2 : MAX_BACKOFF;
    control->dials++;
    send_hello(control);
}

/* Says hello anew because the link is gone or the master forgot us. */
static void redial(control_t *control, const char *why)
{
    log_warning("%s; saying hello again", why);
    control->backoff = FIRST_BACKOFF;
    dial(control);
}

/* Complains that nobody answers: at the first time-out, then once a minute. */
static void complain(control_t *control)
{
    double now = clock_now();
    result_t verdict = dial_watch_poll(&control->watch);
    if (control->last_complaint > 0 && now - control->last_complaint < REPORT_INTERVAL) return;
    control->last_complaint = now;
    log_warning("no master answers at %s%s%s; trying on", control->setup.control_endpoint,
                verdict.code == RESULT_OK ? "" : ": ", verdict.message);
}

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
    crew_state_t state = crew_state(control);
    if (control->claims == NULL) control->claims = mem_alloc(WIRE_MAX_UNITS * sizeof *control->claims);
    control->claim_job = state.job;
    control->claim_content = state.content;
    control->claims_sent = control->claims_asked = 0;
    control->claim_count = state.job == 0 ? 0
                                          : crew_calls(control)->kept(control->setup.crew.self, state.job,
                                                                      control->claims, WIRE_MAX_UNITS);
}

static void on_welcome(control_t *control, const Lm__Welcome *welcome)
{
    if (control->phase != PHASE_DIALLING) return;
    char *endpoint = bulk_endpoint(control, welcome->bulk_port);
    if (endpoint == NULL || welcome->protocol_version != WIRE_VERSION) {
        log_error("the master (%.100s, protocol %u) names bulk port %u; this worker speaks protocol %d",
                  welcome->software, welcome->protocol_version, welcome->bulk_port, WIRE_VERSION);
        free(endpoint);
        rest(control);
        return;
    }
    double now = clock_now();
    control->phase = PHASE_UP;
    control->worker = welcome->worker;
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
             welcome->software, crew_state(control).threads);
    if (control->was_up) {
        crew_calls(control)->forget(control->setup.crew.self);
        note_claims(control);
    }
    control->was_up = true;
    bulk_link_up(control->setup.bulk, endpoint, control->worker, control->batch_interval);
    free(endpoint);
}

/* ---- while up ----------------------------------------------------------------------------------------- */

static void send_heartbeat(control_t *control, const crew_state_t *state)
{
    Lm__Heartbeat heartbeat = LM__HEARTBEAT__INIT;
    heartbeat.worker = control->worker;
    heartbeat.job = state->job;
    heartbeat.units_held = state->units_held;
    heartbeat.threads = state->threads;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_HEARTBEAT;
    envelope.heartbeat = &heartbeat;
    log_unsent("a heartbeat", send_body(control, &envelope));
    control->next_heartbeat = clock_now() + control->heartbeat;
}

static bool claims_pending(const control_t *control)
{
    return control->claims_sent < control->claim_count;
}

/* Adds what fits of the claims; new units are asked for only with the last of them. */
static void add_claims(control_t *control, Lm__WorkRequest *work)
{
    size_t left = control->claim_count - control->claims_sent;
    work->n_kept = left < CLAIMS_A_REQUEST ? left : CLAIMS_A_REQUEST;
    work->kept = wire_units_new(control->claims + control->claims_sent, work->n_kept);
    work->job = control->claim_job;
    work->content = wire_hash_put(&control->claim_content);
    if (left > CLAIMS_A_REQUEST) work->samples = 0;
    control->claims_asked = work->n_kept;
}

static void request_work(control_t *control, const crew_state_t *state)
{
    Lm__WorkRequest work = LM__WORK_REQUEST__INIT;
    work.worker = control->worker;
    work.job = state->job;
    work.samples = state->samples;
    work.unit_samples = state->unit_samples;
    if (claims_pending(control)) add_claims(control, &work);
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_WORK_REQUEST;
    envelope.work_request = &work;
    log_unsent("a request for work", send_body(control, &envelope));
    control->work_request = control->request;
    control->next_request = clock_now() + REQUEST_TIMEOUT;
    free(work.kept);
}

static void send_goodbye(control_t *control, uint64_t declined, const char *reason)
{
    Lm__Goodbye goodbye = LM__GOODBYE__INIT;
    goodbye.worker = control->worker;
    goodbye.reason = (char *)reason;
    goodbye.job = declined;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    envelope.body_case = LM__ENVELOPE__BODY_GOODBYE;
    envelope.goodbye = &goodbye;
    log_unsent("a goodbye", send_body(control, &envelope));
}

/* This machine cannot render the job: another may, so the units go back and the worker stays away for a
 * while. */
static void give_up_job(control_t *control, uint64_t job, result_t why)
{
    crew_calls(control)->clear_failure(control->setup.crew.self);
    if (control->setup.local) {
        control->fatal = why;
        return;
    }
    log_warning("staying away for %.0f s, since the job cannot be rendered here: %s", REST, why.message);
    send_goodbye(control, job, why.message);
    rest(control);
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
    if (message->n_units > WIRE_MAX_UNITS)
        return result_fail(RESULT_LIMIT, "an assignment of %zu units", message->n_units);
    assignment->unit_count = message->n_units;
    assignment->units = mem_alloc((message->n_units + 1) * sizeof *assignment->units);
    result_t result =
        wire_units_get(message->units, message->n_units, &assignment->settings, assignment->units);
    if (result.code != RESULT_OK) free(assignment->units);
    return result;
}

static void on_assignment(control_t *control, const Lm__Assignment *message)
{
    assignment_t assignment;
    result_t result = read_assignment(message, &assignment);
    if (result.code != RESULT_OK) {
        give_up_job(control, message->job, result);
        return;
    }
    log_debug("assigned %zu units of job %llu", assignment.unit_count, (unsigned long long)assignment.job);
    /* An empty assignment is as good as none: do not ask again at once. */
    control->next_request = clock_now() + (assignment.unit_count == 0 ? TICK : 0);
    crew_calls(control)->assign(control->setup.crew.self, &assignment);
}

static void on_no_work(control_t *control, const Lm__NoWork *message)
{
    if (control->claims_sent + control->claims_asked < control->claim_count) {
        control->next_request = 0; /* nothing was asked for yet */
        return;
    }
    control->next_request = clock_now() + clamp(1e-3 * message->retry_ms, 0.01, 60);
    crew_calls(control)->no_more(control->setup.crew.self);
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
        rest(control);
    } else if (refusal->code == RESULT_DENIED && control->leave_by == 0) {
        redial(control, refusal->reason); /* with a new key, if there is one by now */
    } else if (envelope->request != 0 && envelope->request == control->work_request &&
               control->leave_by == 0) {
        redial(control, refusal->reason);
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
        crew_calls(control)->job_over(control->setup.crew.self, envelope->job_over->job,
                                      envelope->job_over->flush);
        break;
    case LM__ENVELOPE__BODY_HEARTBEAT_REPLY:
        if (!envelope->heartbeat_reply->known)
            redial(control, "the master does not know this worker any more");
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

/* Takes in everything that has come. */
static void receive_all(control_t *control)
{
    for (bool received = true; received && control->socket;) {
        void *socket = control->socket;
        wire_message_t message;
        result_t result = wire_receive(socket, false, &message, &received);
        if (result.code != RESULT_OK) {
            log_warning("dropped a message of the master: %s", result.message);
            received = true;
        } else if (received) {
            dispatch(control, message.envelope);
            wire_free(&message);
        }
    }
}

static void report(control_t *control, const crew_state_t *state)
{
    control->next_report = clock_now() + REPORT_INTERVAL;
    if (state->job == 0)
        log_info("waiting for work");
    else
        log_info("rendering job %llu: %.0f samples/s, %u units in hand", (unsigned long long)state->job,
                 state->samples_per_second, state->units_held);
}

/* Nobody is left to work, or they are of another kind now: says goodbye, and hello again when there is
 * somebody. */
static void leave_group(control_t *control)
{
    send_goodbye(control, 0, "its workers left");
    hang_up(control);
    bulk_link_down(control->setup.bulk);
    control->phase = PHASE_RESTING;
    control->deadline = clock_now();
}

static void drive_up(control_t *control)
{
    double now = clock_now();
    if (now - control->last_heard > control->lease + control->heartbeat) {
        redial(control, "the master is silent");
        return;
    }
    crew_state_t state = crew_state(control);
    if (state.failure.code != RESULT_OK) {
        give_up_job(control, state.failed, state.failure);
        return;
    }
    if (!state.ready || !hash_equal(&state.fingerprint, &control->said)) {
        leave_group(control);
        return;
    }
    if (now >= control->next_heartbeat) send_heartbeat(control, &state);
    if (control->work_request != 0 && now >= control->next_request) {
        control->work_request = 0;
        control->claims_asked = 0;
    }
    if ((state.samples > 0 || claims_pending(control)) && control->work_request == 0 &&
        now >= control->next_request)
        request_work(control, &state);
    if (now >= control->next_report) report(control, &state);
}

/* Does what is due. */
static void drive(control_t *control)
{
    switch (control->phase) {
    case PHASE_UP:
        drive_up(control);
        break;
    case PHASE_DIALLING:
        if (clock_now() < control->deadline) break;
        complain(control);
        dial(control);
        break;
    case PHASE_RESTING:
        if (clock_now() >= control->deadline && crew_state(control).ready) dial(control);
        break;
    }
}

static void wait_events(control_t *control)
{
    zmq_pollitem_t items[2] = {{.fd = control->setup.wake, .events = ZMQ_POLLIN},
                               {.socket = control->socket, .events = ZMQ_POLLIN}};
    double wait = TICK;
    if (control->phase == PHASE_UP && control->next_heartbeat - clock_now() < wait)
        wait = control->next_heartbeat - clock_now();
    zmq_poll(items, control->socket ? 2 : 1, wait > 0 ? (long)(1e3 * wait) + 1 : 0);
    if (items[0].revents & ZMQ_POLLIN) {
        eventfd_t count;
        eventfd_read(control->setup.wake, &count);
    }
}

/* ---- leaving ------------------------------------------------------------------------------------------ */

static void begin_leaving(control_t *control)
{
    double grace = control->setup.grace, sending = SENDING_SHARE * grace, now = clock_now();
    log_info("leaving within %g s: finishing the units in hand", grace);
    control->leave_by = now + grace;
    control->give_up_at = control->leave_by - (sending < SENDING_TIME ? sending : SENDING_TIME);
    crew_calls(control)->drain(control->setup.crew.self);
}

/* True when everything is delivered, or the grace period is over. */
static bool ready_to_leave(control_t *control)
{
    double now = clock_now();
    if (crew_state(control).idle) return true;
    if (now >= control->give_up_at && !control->gave_up) {
        control->gave_up = true;
        crew_calls(control)->give_up(control->setup.crew.self);
    }
    if (now < control->leave_by) return false;
    control->fatal = result_fail(RESULT_UNREACHABLE,
                                 "the last batch was not acknowledged within %g s; others will render it",
                                 control->setup.grace);
    return true;
}

/* Says goodbye and gives the message time to leave the process. */
static void say_goodbye(control_t *control)
{
    if (control->phase != PHASE_UP) return;
    control->farewell = false;
    send_goodbye(control, 0, "asked to leave");
    double deadline = clock_now() + FAREWELL_TIMEOUT;
    while (!control->farewell && clock_now() < deadline && control->phase == PHASE_UP) {
        wait_events(control);
        receive_all(control);
    }
}

result_t control_run(const control_setup_t *setup, const atomic_int *stop)
{
    control_t control = {.setup = *setup, .phase = PHASE_RESTING, .backoff = FIRST_BACKOFF};
    while (control.fatal.code == RESULT_OK) {
        int asked = atomic_load(stop);
        if (asked >= 2) break;
        if (asked == 1 && control.leave_by == 0) begin_leaving(&control);
        if (control.leave_by > 0 && ready_to_leave(&control)) {
            say_goodbye(&control);
            break;
        }
        drive(&control);
        pulse_beat(setup->pulse, control.phase == PHASE_UP ? "has a master" : "looks for its master");
        wait_events(&control);
        receive_all(&control);
    }
    hang_up(&control);
    free(control.claims);
    return control.fatal;
}
