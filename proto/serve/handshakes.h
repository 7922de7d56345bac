/* handshakes: tells of connections to a listening socket that broke off before they were admitted or refused:
 * peers without keys, with the key of another master, or that are no peers at all. One thread's, which has to
 * poll without long pauses: libzmq waits for it. */
#ifndef LIGHTMILL_HANDSHAKES_H
#define LIGHTMILL_HANDSHAKES_H

#include "proto/serve/complaint.h"

typedef struct handshakes handshakes_t;

/* Begins to watch a socket, before it is bound. `name` is for the log. */
result_t handshakes_watch(void *context, void *socket, const char *name, handshakes_t **handshakes);
/* To be polled for ZMQ_POLLIN. */
void *handshakes_socket(const handshakes_t *handshakes);
/* Logs what has happened. */
void handshakes_report(handshakes_t *handshakes, complaint_t *complaint);
/* After the socket was closed. Sets *handshakes to NULL. */
void handshakes_destroy(handshakes_t **handshakes);

#endif
