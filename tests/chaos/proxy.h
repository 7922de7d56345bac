/* proxy: a process between workers and a master that does to their TCP connections what networks do.
 *
 * A link is an address of its own on which the proxy listens, at the master's control port and the one after
 * it; what comes there goes on to the same port of the master. The links' weather lies in memory that the
 * driver and the proxy share: the driver writes what is to happen, the proxy counts what it did.
 */
#ifndef LIGHTMILL_PROXY_H
#define LIGHTMILL_PROXY_H

#include "common/base.h"

#include <stdatomic.h>
#include <sys/types.h>

enum { PROXY_MAX_LINKS = 8, PROXY_PORTS = 2 };

/* What is done to single pieces of a stream, so many times each. The first four do not care what the bytes
 * mean; the others know where messages begin and end, and leave the stream around them whole. */
typedef enum {
    PROXY_FLIP_BYTES,
    PROXY_REPEAT_BYTES,
    PROXY_SWAP_BYTES,
    PROXY_LOSE_BYTES,
    PROXY_FLIP_MESSAGE,
    PROXY_REPEAT_MESSAGE,
    PROXY_SWAP_MESSAGES,
    PROXY_LOSE_MESSAGE,
    PROXY_MISCHIEFS
} proxy_mischief_t;

typedef struct {
    /* Written by the driver. */
    atomic_uint delay_ms, jitter_ms; /* that every piece waits */
    atomic_uint bytes_per_second;    /* each way of a connection; 0: no limit */
    atomic_bool stalled;             /* connections stay, and nothing passes */
    atomic_bool refusing;            /* new connections are closed at once */
    atomic_bool bulk_closed;         /* those to the second port */
    atomic_uint cuts;                /* counted up: all connections are reset */
    atomic_uint todo[PROXY_MISCHIEFS];
    /* Written by the proxy. */
    atomic_uint done[PROXY_MISCHIEFS];
    atomic_uint connections, reset;
    atomic_ullong bytes;
} proxy_link_t;

typedef struct proxy proxy_t;

/* Listens on `hosts[i]` for link i, and starts the process. Connections go on to `target`. The process dies
 * with the one that started it. */
result_t proxy_start(const char *const *hosts, size_t count, const char *target, int port, uint64_t seed,
                     proxy_t **proxy);
proxy_link_t *proxy_link(proxy_t *proxy, size_t index);
/* Ends all mischief on a link: what is under way arrives. */
void proxy_heal(proxy_link_t *link);
/* True while the process lives. */
bool proxy_alive(proxy_t *proxy);
/* Ends the process, frees everything and sets *proxy to NULL. */
void proxy_stop(proxy_t **proxy);

#endif
