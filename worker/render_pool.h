/* render_pool: the render threads of a worker, the job in hand, its queue of units, and the batches that the
 * threads fill. The worker's handler (proto/uplink/uplink_handler.h).
 *
 * One job at a time. The control thread brings assignments and news (no more work, job over, leave); the bulk
 * thread asks what there is to do for it (load a scene, send a batch) and does it; the render threads take
 * units and add what they made to the open batch.
 *
 * At most two ordinary batches exist: the open one, and one that is closed and being sent. While a batch is
 * offered or under way the open one simply grows, so rendering does not wait for the network; it pauses only
 * when the open batch has reached its limit. Units that a master wants to check are rendered into a third
 * batch, which has them alone.
 */
#ifndef LIGHTMILL_RENDER_POOL_H
#define LIGHTMILL_RENDER_POOL_H

#include "proto/uplink/uplink_handler.h"

typedef struct render_pool render_pool_t;

typedef struct {
    int threads;                 /* that render */
    hash_t fingerprint;          /* of this machine's bits; all zero: not known */
    uint64_t memory;             /* bytes that this process may use */
    int control_wake, bulk_wake; /* eventfds, kept by the caller: written when the control or the bulk thread
                                    has something new to look at */
} render_pool_options_t;

/* Starts the render threads. */
render_pool_t *render_pool_new(const render_pool_options_t *options);
/* Cancels what is being rendered, joins the threads, frees everything and sets *pool to NULL; the bulk thread
 * has ended. */
void render_pool_destroy(render_pool_t **pool);
/* The calls of the control and the bulk thread. */
uplink_handler_t render_pool_handler(render_pool_t *pool);

#endif
