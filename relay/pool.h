/* pool: the state of a relay: the units that it took from its master, its workers, and the sums of what they
 * delivered.
 *
 * The threads that talk to the master call it as an uplink_handler (proto/uplink/uplink_handler.h), those
 * that talk to the workers as a serve_handler (proto/serve/serve_handler.h). It knows no sockets.
 *
 * Workers of one relay make the same bits: the first one decides which.
 *
 * Thread-safe. Times are seconds of clock_now(), handed in by the caller, so that a test can make time pass.
 */
#ifndef LIGHTMILL_POOL_H
#define LIGHTMILL_POOL_H

#include "proto/serve/serve_handler.h"
#include "proto/serve/unit_mac.h"
#include "proto/uplink/uplink_handler.h"

typedef struct pool pool_t;

typedef struct {
    double lease;          /* seconds of silence after which a worker is given up */
    double batch_interval; /* seconds between its batches */
    uint64_t memory;       /* bytes that this process may use */
    unit_secret_t secret;  /* shows the relay which units its workers have from it */
    /* eventfds, kept by the caller: */
    int control_wake; /* written when the thread that talks to the master has something new to look at, */
    int bulk_wake;    /* when the one that delivers has, */
    int notice_wake;  /* when there are notices, */
    int grant_wake;   /* and when there may be room for batches again */
} pool_options_t;

pool_t *pool_new(const pool_options_t *options);
/* Frees the pool and sets *pool to NULL; all threads that use it have ended. */
void pool_destroy(pool_t **pool);
/* The calls of the threads that talk to the master above, */
uplink_handler_t pool_uplink(pool_t *pool);
/* and of those that talk to the workers below. A worker is refused with RESULT_MISMATCH when it makes other
 * bits than those that are here. A batch is not wanted for the moment when the sums are as large as they may
 * be. */
serve_handler_t pool_serve(pool_t *pool);

#endif
