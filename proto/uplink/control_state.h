/* control_state: the state of the conversation with the master, for control*.c alone. Not thread-safe. */
#ifndef LIGHTMILL_CONTROL_STATE_H
#define LIGHTMILL_CONTROL_STATE_H

#include "proto/uplink/control.h"
#include "proto/wire/wire.h"

static const double TICK = 0.1;             /* seconds: the longest sleep, so that a signal is seen soon */
static const double FIRST_BACKOFF = 1.0;    /* seconds between Hellos */
static const double REST = 10.0;            /* seconds before a refusing master is asked again */
static const double REPORT_INTERVAL = 60.0; /* seconds between lines on what is going on */

typedef enum { PHASE_DIALLING, PHASE_UP, PHASE_RESTING } phase_t;

typedef struct {
    control_setup_t setup;
    void *socket; /* NULL while resting */
    dial_watch_t watch;
    phase_t phase;
    double deadline; /* DIALLING, RESTING: when to dial again */
    double backoff;
    uint64_t request;       /* the last number used */
    uint64_t process;       /* random: another one has another */
    bool was_up;            /* there was a welcome before, */
    char key[KEY_TEXT + 1]; /* to this key of ours */
    hash_t said;            /* the fingerprint in the last Hello */
    double last_complaint;

    /* While up. */
    uint64_t worker;
    double heartbeat, lease, batch_interval; /* seconds */
    double last_heard, next_heartbeat, next_report;
    uint32_t bulk_port;    /* that the master names; 0: inproc */
    char trouble[300];     /* why no work is asked for, for people; empty: nothing hinders us */
    uint64_t work_request; /* unanswered, 0: none */
    /* What was in hand at the welcome and is still to be named in requests for work. */
    unit_t *claims;
    issue_t *claim_issues;                         /* of these */
    size_t claim_count, claims_sent, claims_asked; /* in all; answered; with the request that is not */
    uint64_t claim_job;
    hash_t claim_content;
    double next_request; /* when to ask for work again */

    bool told_to_leave; /* by the master */
    double leave_by;    /* 0: not leaving */
    double give_up_at;  /* what is not finished then is given up */
    bool gave_up;
    bool farewell; /* the Goodbye was answered */
    result_t fatal;
} control_t;

const uplink_calls_t *control_calls(const control_t *control);
uplink_state_t control_handler_state(const control_t *control);

/* ---- control.c ---- */

/* Waits before the next dial, for reasons that a quick retry would not cure. */
void control_rest(control_t *control);
/* Says hello anew because the link is gone or the master forgot us. */
void control_redial(control_t *control, const char *why);
/* This machine cannot render the job: another may, so the units go back and the worker stays away for a
 * while. */
void control_give_up_job(control_t *control, uint64_t job, result_t why);

/* ---- control_messages.c ---- */

void control_send_hello(control_t *control);
void control_send_heartbeat(control_t *control, const uplink_state_t *state);
/* `declined`: a job that cannot be rendered here, or 0. */
void control_send_goodbye(control_t *control, uint64_t declined, const char *reason);
/* Asks for what the handler wants, and names what it has in hand as long as there is something to name. */
void control_request_work(control_t *control, const uplink_state_t *state);
/* True while something in hand is still to be named. */
bool control_claims_pending(const control_t *control);
/* Takes in everything that has come. */
void control_receive_all(control_t *control);

#endif
