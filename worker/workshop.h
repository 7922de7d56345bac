/* workshop: the crew of a worker (crew.h): the job in hand, its queue of units, the render threads and the
 * batches that they fill.
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
#ifndef LIGHTMILL_WORKSHOP_H
#define LIGHTMILL_WORKSHOP_H

#include "worker/crew.h"

typedef struct workshop workshop_t;

typedef struct {
    int threads;                 /* that render */
    hash_t fingerprint;          /* of this machine's bits; all zero: not known */
    uint64_t memory;             /* bytes that this process may use */
    int control_wake, bulk_wake; /* eventfds, kept by the caller: written when the control or the bulk thread
                                    has something new to look at */
} workshop_options_t;

/* Starts the render threads. */
workshop_t *workshop_new(const workshop_options_t *options);
/* Cancels what is being rendered and joins the threads. */
void workshop_stop(workshop_t *shop);
/* Stops, frees everything and sets *shop to NULL; the bulk thread has ended. */
void workshop_destroy(workshop_t **shop);
/* The calls of the control and the bulk thread. */
crew_t workshop_crew(workshop_t *shop);

#endif
