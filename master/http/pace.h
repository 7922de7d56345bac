/* pace: how fast tiles go out to all who watch.
 *
 * To resolve an image costs the same for one watcher and for a hundred; to send it does not. So what is sent
 * in all has a rate that grows with the farm: a master of many workers has more to show, and the share that
 * watching takes stays the same. Who is early waits, as a request that is put aside (request.h). Whose turn
 * comes is drawn by lot, so that nobody is left out for long, whatever the number of those who wait. After
 * PACE_PATIENCE the answer is that there is nothing new yet, and who asks again is in the next draw. A
 * watcher who has seen nothing yet hardly waits: the others pay for it, but half of the rate stays theirs.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_HTTP_PACE_H
#define LIGHTMILL_HTTP_PACE_H

#include "master/http/request.h"

enum { PACE_MAX_WAITING = 160 }; /* requests */
#define PACE_A_THREAD 1e6        /* bytes a second for each render thread of the farm; 0.02 to 0.05 % of it */
#define PACE_LEAST 3e6           /* bytes a second, in any case: the page takes 2.5e6 */
#define PACE_PATIENCE 20.0       /* seconds; less than proxies have */
#define PACE_ADVANCE 30.0        /* seconds by which a first answer may be early */

typedef struct pace pace_t;

/* Starts the thread; the farm outlives it. */
result_t pace_start(farm_t *farm, pace_t **pace);
/* All that wait go on, and nobody waits from now on. NULL is allowed, here and below. */
void pace_end(pace_t *pace);
/* Frees everything, after the server's thread has ended, and sets *pace to NULL. */
void pace_free(pace_t **pace);

/* May tiles be sent now? `first`: to somebody who has none yet. */
bool pace_may_send(pace_t *pace, bool first);
/* Puts the request aside until its turn. `then` is called with the request's value 1, or 0 when the turn has
 * not come in time. The request may be answered with 503 instead, when too many wait. */
void pace_wait(pace_t *pace, http_request_t *request, void (*then)(http_request_t *request));
/* So many bytes are being sent, `turn`: to somebody who has waited. */
void pace_sent(pace_t *pace, size_t bytes, bool turn);

#endif
