/* patience: how long a connection may take to say what it wants.
 *
 * libmicrohttpd closes a connection on which nothing moves. One that sends a byte now and then it keeps for
 * ever, and so it could keep all places. Here a connection has so many seconds, from its beginning or from
 * the end of its last request, until the headers of a request are complete (with TLS, the handshake counts
 * too). Then its socket is shut down, and libmicrohttpd closes it.
 *
 * Thread-safe. */
#ifndef LIGHTMILL_HTTP_PATIENCE_H
#define LIGHTMILL_HTTP_PATIENCE_H

#include "common/base.h"

typedef struct patience patience_t;
typedef struct patient patient_t;

/* Starts the thread. */
result_t patience_start(double seconds, patience_t **patience);
/* Joins the thread and sets *patience to NULL; all connections are gone. NULL is allowed. */
void patience_stop(patience_t **patience);

/* A connection begins; its socket stays open until it is gone. */
patient_t *patience_begin(patience_t *patience, int socket);
/* It is gone: frees it. NULL is allowed. */
void patience_gone(patience_t *patience, patient_t *patient);
/* The headers of a request are complete; its answer may take as long as it likes. */
void patience_asked(patience_t *patience, patient_t *patient);
/* The request is over: the next one has its time from now on. */
void patience_answered(patience_t *patience, patient_t *patient);

#endif
