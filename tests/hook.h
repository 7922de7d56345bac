/* hook: a small HTTP server on loopback that is told things, for tests: it keeps what is posted to it and
 * answers as it is told to. Calls end the test on failure. */
#ifndef LIGHTMILL_HOOK_H
#define LIGHTMILL_HOOK_H

#include <stddef.h>

typedef struct hook hook_t;

enum { HOOK_SILENCE = 1 }; /* a status that is never sent: the connection stays open */

/* Listens on a port of 127.0.0.1, 0: any. Answers the first requests with these statuses, in order, and all
 * others with the last. 3xx lead to itself. */
hook_t *hook_start(int port, const int *statuses, size_t count);
/* Ends it and frees all. */
void hook_stop(hook_t **hook);
/* "http://127.0.0.1:PORT/secret", the hook's. */
const char *hook_url(const hook_t *hook);
/* How many requests have come. */
size_t hook_count(hook_t *hook);
/* Waits for request `index` (from 0), at most so many seconds, and returns it whole, head and body; fresh
 * memory.
 */
char *hook_wait(hook_t *hook, size_t index, double seconds);

#endif
