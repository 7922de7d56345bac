/* rate_limit: limits how many messages a second each peer may send, with memory for a fixed number of peers.
 *
 * A peer has a bucket that holds `burst` tokens and gains `rate` a second. A message takes one or more; when
 * they lack, it is over the limit. Not thread-safe. */
#ifndef LIGHTMILL_RATE_LIMIT_H
#define LIGHTMILL_RATE_LIMIT_H

#include "common/base.h"

typedef struct rate_limit rate_limit_t;

typedef enum {
    RATE_PASS, /* within the limit */
    RATE_TELL, /* over it, for the first time since the peer was last well within: it should be told */
    RATE_DROP  /* over it, and the peer knows */
} rate_verdict_t;

/* `peers` is rounded up to a power of two. */
rate_limit_t *rate_limit_new(double rate, double burst, size_t peers);
void rate_limit_destroy(rate_limit_t **limit);
/* Takes `tokens`, at most `burst`, of the peer that has this name of `size` bytes. */
rate_verdict_t rate_limit_take(rate_limit_t *limit, double now, const void *peer, size_t size, double tokens);

#endif
