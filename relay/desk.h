/* desk: a thread that owns a ROUTER socket and serves the workers that write to it. */
#ifndef LIGHTMILL_DESK_H
#define LIGHTMILL_DESK_H

#include "proto/serve/gate.h"

typedef struct desk desk_t;

typedef struct {
    const char *name; /* of the thread and in the log, at most 15 characters; kept by the caller */
    void *socket;     /* a bound ROUTER; closed by the desk's thread */
    gate_t *gate;     /* says who may send what; kept by the caller */
    int wake;         /* eventfd that asks for a turn; kept by the caller */
    void *self;       /* of the calls below, which are made on the desk's thread */
    /* A message has come; what is to be kept of it is taken over by setting *message to NULL: it lies in
     * memory of its own (free). */
    void (*handle)(void *self, desk_t *desk, wire_message_t **message);
    /* A turn is over: when there was a message or a wake-up, and a few times a second. `quiet`: no message
     * waits. */
    void (*turn)(void *self, desk_t *desk, bool quiet);
} desk_options_t;

/* Starts the thread; on failure the socket is still the caller's. */
result_t desk_start(const desk_options_t *options, desk_t **desk);
/* Ends the thread, closes the socket and sets *desk to NULL. */
void desk_stop(desk_t **desk);

/* ---- for the calls ---- */

/* Answers a message, with one payload or NULL. */
void desk_reply(desk_t *desk, const wire_message_t *message, Lm__Envelope *answer, zmq_msg_t *payload);
/* Refuses it. */
void desk_refuse(desk_t *desk, const wire_message_t *message, result_t reason);
/* Sends a message to a peer. False when that is gone or does not keep up. */
bool desk_send(desk_t *desk, const uint8_t *identity, size_t size, Lm__Envelope *envelope);
/* A warning that a peer can provoke, at most a few a second. */
void desk_complain(desk_t *desk, const char *format, ...) __attribute__((format(printf, 2, 3)));

#endif
