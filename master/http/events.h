/* events: what happens on the farm, as a stream of server-sent events (docs/http.md).
 *
 * DESIGN. Once a second, and less often when many listen, a thread compares jobs and workers with what they
 * were, and writes what changed into a ring. A stream is a place in that ring. One that is not read takes no
 * memory: when the ring has gone past it, it is told that it has lost events, and goes on with the newest. A
 * while after the last reader has left, the thread sleeps. */
#ifndef LIGHTMILL_HTTP_EVENTS_H
#define LIGHTMILL_HTTP_EVENTS_H

#include "master/http/request.h"

typedef struct http_events http_events_t;

/* Starts the thread. The farm is kept by the caller. So many events are kept (0: 4096). */
result_t http_events_start(farm_t *farm, uint32_t kept, http_events_t **events);
/* Ends all streams and joins the thread; before the server's thread ends. NULL is allowed, here and below. */
void http_events_end(http_events_t *events);
/* Frees everything, after the server's thread has ended, and sets *events to NULL. */
void http_events_free(http_events_t **events);
/* Answers with the stream. */
void http_events_answer(http_events_t *events, http_request_t *request);

#endif
