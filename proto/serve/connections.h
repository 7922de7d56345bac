/* connections: what libzmq does not bound on a listening socket. It keeps the frames of a message until the
 * last one has come, however many there are (ZMQ_RCVHWM counts whole messages, ZMQ_MAXMSGSIZE holds for one
 * frame), and it keeps connections on which nothing is ever said.
 *
 * Not thread-safe but for the counters of what was heard: the gate's thread makes the calls. */
#ifndef LIGHTMILL_CONNECTIONS_H
#define LIGHTMILL_CONNECTIONS_H

#include "proto/serve/complaint.h"

#include <stdatomic.h>

enum { CONNECTIONS_MAX = 1 << 16 }; /* those with a higher file descriptor are not watched */

/* What those who take messages from the sockets tell of a connection; by file descriptor. */
typedef struct {
    _Atomic uint32_t messages[CONNECTIONS_MAX]; /* that were taken, of all connections that had the number */
    _Atomic uint64_t expected[CONNECTIONS_MAX]; /* bytes that its messages may have beyond `unfinished` */
} heard_t;

typedef struct {
    double silence;      /* seconds after which a connection that has not sent one whole message is closed */
    uint64_t unfinished; /* bytes of a message that has not come to its end, of a connection */
    uint64_t all;        /* and of all of them together */
} connection_limits_t;

typedef struct connections connections_t;

/* `name` of the socket, for the log, and `heard` are kept by the caller. */
connections_t *connections_new(const char *name, const connection_limits_t *limits, heard_t *heard);
void connections_destroy(connections_t **connections);

/* libzmq has accepted a connection, or closed it. */
void connections_opened(connections_t *connections, double now, int descriptor);
void connections_closed(connections_t *connections, int descriptor);
/* The host of a connection that is open; "somewhere" when it is not known. */
const char *connections_address(const connections_t *connections, int descriptor);
/* Ends the connections that are beyond a limit. To be called a few times a second. */
void connections_patrol(connections_t *connections, double now, complaint_t *complaint);

#endif
