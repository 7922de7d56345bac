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
 *
 * This file decides when to send. control_messages.c builds the messages and acts on the answers.
 */
#include "proto/uplink/control_state.h"

#include "common/address.h"
#include "common/wake.h"

#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const double MAX_BACKOFF = 10.0;     /* seconds between Hellos */
static const double SENDING_SHARE = 0.4;    /* of the grace period is for delivering, */
static const double SENDING_TIME = 10.0;    /* but not more seconds than this */
static const double FAREWELL_TIMEOUT = 1.0; /* seconds for the answer to a Goodbye */

const uplink_calls_t *control_calls(const control_t *control)
{
    return control->setup.handler.calls;
}

uplink_state_t control_handler_state(const control_t *control)
{
    return control->setup.handler.calls->state(control->setup.handler.self);
}

/* ---- dialling ----------------------------------------------------------------------------------------- */

/* What is queued still goes out, if it can, unless it is to be dropped. */
static void hang_up(control_t *control, bool drop)
{
    const int at_once = 0;
    dial_watch_close(&control->watch, control->socket);
    if (control->socket && drop) zmq_setsockopt(control->socket, ZMQ_LINGER, &at_once, sizeof at_once);
    if (control->socket) zmq_close(control->socket);
    control->socket = NULL;
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

void control_rest(control_t *control)
{
    hang_up(control, false);
    bulk_link_down(control->setup.bulk);
    control->phase = PHASE_RESTING;
    control->deadline = clock_now() + REST;
}

/* What was queued for the master that did not answer must not reach one that comes back. */
static void dial(control_t *control)
{
    hang_up(control, true);
    result_t result = open_socket(control);
    if (result.code != RESULT_OK) {
        log_error("%s", result.message);
        control_rest(control);
        return;
    }
    control->phase = PHASE_DIALLING;
    control->deadline = clock_now() + control->backoff;
    control->backoff = control->backoff * 2 < MAX_BACKOFF ? control->backoff * 2 : MAX_BACKOFF;
    control_send_hello(control);
}

void control_redial(control_t *control, const char *why)
{
    log_warning("%s; saying hello again", why);
    control->backoff = FIRST_BACKOFF;
    dial(control);
}

/* Complains that nobody answers: at the first time-out, then once a minute. */
static void complain(control_t *control)
{
    double now = clock_now();
    const result_t *verdict = &control->watch.verdict;
    if (control->last_complaint > 0 && now - control->last_complaint < REPORT_INTERVAL) return;
    control->last_complaint = now;
    log_warning("no master answers at %s%s%s; trying on", control->setup.control_endpoint,
                verdict->code == RESULT_OK ? "" : ": ", verdict->message);
}

/* ---- while up ----------------------------------------------------------------------------------------- */

void control_give_up_job(control_t *control, uint64_t job, result_t why)
{
    control_calls(control)->clear_failure(control->setup.handler.self);
    if (control->setup.local) {
        control->fatal = why;
        return;
    }
    log_warning("staying away for %.0f s, since the job cannot be rendered here: %s", REST, why.message);
    control_send_goodbye(control, job, why.message);
    control_rest(control);
}

/* What hinders this worker, if anything does. */
static void describe_trouble(const control_t *control, const uplink_state_t *state, char *text, size_t size)
{
    address_t address;
    const char *endpoint = control->setup.control_endpoint;
    snprintf(text, size, "%s", state->trouble);
    bool speaks = clock_now() - control->last_heard < 3 * control->heartbeat; /* else it is not the port */
    if (!bulk_silent(control->setup.bulk) || !speaks) return;
    if (control->bulk_port != 0 && address_parse(endpoint, WIRE_DEFAULT_PORT, &address).code == RESULT_OK)
        snprintf(
            text, size,
            "port %u of %.100s does not answer: open it in the firewall, for workers need both %d and %u",
            control->bulk_port, address.host, address.port, control->bulk_port);
    else
        snprintf(text, size, "the bulk socket of the master at %.200s does not answer", endpoint);
}

/* Says, here and to the master, what hinders this worker, as soon as that changes. */
static void see_to_trouble(control_t *control, const uplink_state_t *state)
{
    char text[sizeof control->trouble];
    describe_trouble(control, state, text, sizeof text);
    if (strcmp(text, control->trouble) == 0) return;
    if (text[0] != '\0')
        log_error("no work is asked for: %s", text);
    else
        log_info("what hindered this worker is over");
    memcpy(control->trouble, text, sizeof text);
    control->next_heartbeat = 0;
}

static void report(control_t *control, const uplink_state_t *state)
{
    control->next_report = clock_now() + REPORT_INTERVAL;
    if (control->trouble[0] != '\0')
        log_warning("still no work is asked for: %s", control->trouble);
    else if (state->job == 0)
        log_info("waiting for work");
    else
        log_info("rendering job %llu: %.0f samples/s, %u units in hand", (unsigned long long)state->job,
                 state->samples_per_second, state->units_held);
}

/* Nobody is left to work, or they are of another kind now: says goodbye, and hello again when there is
 * somebody. */
static void leave_group(control_t *control)
{
    control_send_goodbye(control, 0, "its workers left");
    hang_up(control, false);
    bulk_link_down(control->setup.bulk);
    control->phase = PHASE_RESTING;
    control->deadline = clock_now();
}

static void drive_up(control_t *control)
{
    double now = clock_now();
    if (now - control->last_heard > control->lease + control->heartbeat) {
        control_redial(control, "the master is silent");
        return;
    }
    uplink_state_t state = control_handler_state(control);
    if (state.failure.code != RESULT_OK) {
        control_give_up_job(control, state.failed, state.failure);
        return;
    }
    if (!state.ready || !hash_equal(&state.fingerprint, &control->said)) {
        leave_group(control);
        return;
    }
    see_to_trouble(control, &state);
    if (now >= control->next_heartbeat) control_send_heartbeat(control, &state);
    if (control->work_request != 0 && now >= control->next_request) {
        control->work_request = 0;
        control->claims_asked = 0;
    }
    if ((state.samples > 0 || control_claims_pending(control)) && control->work_request == 0 &&
        now >= control->next_request && bulk_ready(control->setup.bulk, control->worker))
        control_request_work(control, &state);
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
        if (clock_now() >= control->deadline && control_handler_state(control).ready) dial(control);
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
    if (items[0].revents & ZMQ_POLLIN) wake_clear(control->setup.wake);
}

/* ---- leaving ------------------------------------------------------------------------------------------ */

static void begin_leaving(control_t *control)
{
    double grace = control->setup.grace, sending = SENDING_SHARE * grace, now = clock_now();
    log_info("leaving within %g s: finishing the units in hand", grace);
    control->leave_by = now + grace;
    control->give_up_at = control->leave_by - (sending < SENDING_TIME ? sending : SENDING_TIME);
    control_calls(control)->drain(control->setup.handler.self);
}

/* True when everything is delivered, or the grace period is over. */
static bool ready_to_leave(control_t *control)
{
    double now = clock_now();
    if (control_handler_state(control).idle) return true;
    if (now >= control->give_up_at && !control->gave_up) {
        control->gave_up = true;
        control_calls(control)->give_up(control->setup.handler.self);
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
    control_send_goodbye(control, 0, "asked to leave");
    double deadline = clock_now() + FAREWELL_TIMEOUT;
    while (!control->farewell && clock_now() < deadline && control->phase == PHASE_UP) {
        wait_events(control);
        control_receive_all(control);
    }
}

/* "host:pid"; the caller frees it. */
static char *host_and_process(void)
{
    char host[200] = "";
    if (gethostname(host, sizeof host - 1) != 0) snprintf(host, sizeof host, "somewhere");
    return mem_printf("%s:%d", host, (int)getpid());
}

result_t control_run(const control_setup_t *setup, const atomic_int *stop)
{
    control_t control = {.setup = *setup, .phase = PHASE_RESTING, .backoff = FIRST_BACKOFF};
    while (control.process == 0) randombytes_buf(&control.process, sizeof control.process);
    char *name = setup->name == NULL ? host_and_process() : NULL;
    if (name != NULL) control.setup.name = name;
    while (control.fatal.code == RESULT_OK) {
        int asked = atomic_load(stop);
        if (asked >= 2) break;
        bool leaves = asked == 1 || control.told_to_leave;
        if (leaves && control.leave_by == 0) begin_leaving(&control);
        if (control.leave_by > 0 && ready_to_leave(&control)) {
            say_goodbye(&control);
            break;
        }
        drive(&control);
        pulse_beat(setup->pulse, control.phase == PHASE_UP ? "has a master" : "looks for its master");
        wait_events(&control);
        control_receive_all(&control);
        dial_watch_poll(&control.watch); /* libzmq waits for who watches */
    }
    hang_up(&control, false);
    free(control.claims);
    free(control.claim_issues);
    free(name);
    return control.fatal;
}
