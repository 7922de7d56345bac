/* handshakes: reports connections to a listening socket that ended before they were admitted or refused. Such
 * a peer has no key, has the key of another master, or is no peer at all. Not thread-safe. Poll without long
 * pauses: libzmq waits for it. */
#ifndef LIGHTMILL_HANDSHAKES_H
#define LIGHTMILL_HANDSHAKES_H

#include "proto/serve/connections.h"

typedef struct handshakes handshakes_t;

/* Begins to watch a socket, before it is bound. `name` is for the log, `keys` says whether it wants them;
 * `connections`, kept by the caller, is told which there are. */
result_t handshakes_watch(void *context, void *socket, const char *name, bool keys,
                          connections_t *connections, handshakes_t **handshakes);
/* To be polled for ZMQ_POLLIN. */
void *handshakes_socket(const handshakes_t *handshakes);
/* Logs what has happened. */
void handshakes_report(handshakes_t *handshakes, complaint_t *complaint);
/* After the socket was closed. Sets *handshakes to NULL. */
void handshakes_destroy(handshakes_t **handshakes);

#endif
