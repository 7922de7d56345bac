/* grants: who may send a batch now, so that the batches that are under way or wait to be merged take no more
 * memory than there is for them.
 *
 * A batch takes from the credit when it is granted, as much as its sender says it will need; when it comes,
 * as much as it does need; and nothing any more when it has been merged. Who must wait is served in the order
 * of asking. A batch larger than half the credit raises it to twice its size: one can be merged while the
 * next comes, whatever the size of the film. So the memory is bounded by the credit or by two of the largest
 * batches.
 *
 * What is granted at a time is less than the credit when the master, and not the network, is slow: batches
 * had better grow at the workers than wait here. It is halved when they wait for more than two seconds, and
 * grows again when they do not.
 *
 * Knows no sockets and no clock. Not thread-safe: the bulk thread's own.
 */
#ifndef LIGHTMILL_GRANTS_H
#define LIGHTMILL_GRANTS_H

#include "proto/serve/serve_handler.h"

typedef struct grants grants_t;

typedef struct {
    size_t waiting, granted; /* offers; grants whose batch has not come */
    uint64_t used, most;     /* bytes: promised or here; the most there have been */
    uint64_t window;         /* bytes that may be used now */
} grants_state_t;

/* The credit where none is said, in bytes: an eighth of the memory, or 1 GB if that is more and is at most a
 * quarter of it. */
uint64_t grants_usual_credit(void);
/* `credit` in bytes. */
grants_t *grants_new(uint64_t credit);
void grants_destroy(grants_t **grants);

/* Takes an offer in. One that is repeated by the same peer keeps its place. RESULT_LIMIT when too many wait.
 */
result_t grants_offer(grants_t *grants, double now, const batch_offer_t *offer);
/* The next offer that can be answered; it waits no more. `wanted` says whether a batch is: RESULT_OK,
 * RESULT_LIMIT for not yet (it keeps waiting), or why not. With *verdict RESULT_OK its bytes are promised. */
bool grants_next(grants_t *grants, double now, result_t (*wanted)(void *context, const batch_offer_t *offer),
                 void *context, batch_offer_t *offer, result_t *verdict);
/* A batch has come. False when there is no room for it: it was not granted, or is much larger than it was
 * said to be. Otherwise it has its room until grants_release. */
bool grants_admit(grants_t *grants, const identity_t *identity, uint64_t bytes);
void grants_release(grants_t *grants, uint64_t bytes);
/* What was promised to a peer is taken back, if there is anything: it has gone, or has been answered. */
void grants_forget(grants_t *grants, const identity_t *identity);
/* Time passes: grants that were not used, and offers that were not repeated, are dropped. To be called often.
 */
void grants_tick(grants_t *grants, double now);
grants_state_t grants_state(const grants_t *grants);

#endif
