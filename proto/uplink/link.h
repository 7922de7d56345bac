/* link: a worker's connection to its master's bulk socket.
 *
 * A connection that breaks may have lost what was on its way in either direction, and behind its address may
 * be another process afterwards. So a broken link is opened anew, with a socket that has nothing queued, and
 * its conversation gets another number. What was asked in an earlier conversation is never answered.
 *
 * The kernel tells when a connection broke: at once when the other process ended, after some seconds when
 * nothing that was sent is acknowledged any more (wire_socket). A link that is merely slow is not broken.
 *
 * Not thread-safe.
 */
#ifndef LIGHTMILL_LINK_H
#define LIGHTMILL_LINK_H

#include "proto/wire/dial.h"

typedef struct {
    void *context;         /* ZeroMQ context, kept by the owner */
    dial_keys_t *keys;     /* likewise; NULL: none */
    void *socket;          /* DEALER; NULL while the link is down */
    void *monitor;         /* PAIR that tells of broken connections; NULL likewise */
    char *endpoint;        /* NULL: down */
    uint64_t conversation; /* counts sockets, from 1 */
    double opened;         /* clock */
    bool broken;           /* is to be opened anew */
} link_t;

/* Goes to another endpoint (copied; NULL: down). Does nothing when it is there already. True when there is
 * another conversation now. */
bool link_set(link_t *link, const char *endpoint);
/* Looks whether the connection broke, and opens it anew, at most a few times a second. True when there is
 * another conversation now. */
bool link_refresh(link_t *link);
/* Waits for a message, a broken connection or the descriptor `wake` (which is read), at most `seconds`. */
void link_wait(link_t *link, int wake, double seconds);
void link_close(link_t *link);

#endif
