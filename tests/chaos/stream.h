/* stream: one way of a proxied connection: what came in, the mischief that is done to it, and when each piece
 * may go out. */
#ifndef LIGHTMILL_STREAM_H
#define LIGHTMILL_STREAM_H

#include "tests/chaos/dice.h"
#include "tests/chaos/proxy.h"

enum { STREAM_MAX_QUEUED = 32 << 20 }; /* bytes; a reader stops here */

typedef struct stream_piece stream_piece_t;

typedef struct {
    proxy_link_t *link;
    uint8_t *in; /* not yet understood */
    size_t in_size, in_capacity;
    size_t greeted; /* bytes of the greeting that have passed */
    bool raw;       /* nothing that we understand: bytes pass as they come */
    uint8_t *held;  /* a message that waits to be overtaken; NULL: none */
    size_t held_size;
    double held_until;
    stream_piece_t *first, *last; /* on their way */
    size_t queued;                /* bytes of them */
    double free_at;               /* when the line is free again */
} stream_t;

void stream_init(stream_t *stream, proxy_link_t *link);
void stream_free(stream_t *stream);
/* Takes in what the sender sent. */
void stream_take(stream_t *stream, dice_t *dice, double now, const uint8_t *bytes, size_t size);
/* Lets go what waited for company that did not come. */
void stream_tick(stream_t *stream, dice_t *dice, double now);
/* Writes what is due to a socket that does not block; false when the connection is broken. */
bool stream_send(stream_t *stream, double now, int socket);
/* True when nothing is on its way. */
bool stream_idle(const stream_t *stream);
/* When there is something to do, seconds; INFINITY: nothing. */
double stream_due(const stream_t *stream);

#endif
