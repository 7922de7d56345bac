/* health: a process that says of itself whether it is well, to whoever asks on a Unix socket: container
 * engines, init systems, people.
 *
 * A connection is answered with one line, "ok TEXT" or "failing TEXT", and closed. The socket lives in a
 * directory of this machine and carries no secrets; who may ask is decided by the file's permissions (the
 * owner alone).
 */
#ifndef LIGHTMILL_HEALTH_H
#define LIGHTMILL_HEALTH_H

#include "common/base.h"

typedef struct health health_t;

/* Describes the process in `text`, one line of at most `size` bytes; false when it is not well. Called from a
 * thread of its own. */
typedef bool (*health_report_t)(void *context, char *text, size_t size);

/* The path that the environment names (LIGHTMILL_HEALTH), NULL when it does not. */
const char *health_default_path(void);
/* Answers at `path`; a socket that a dead process left there is replaced, a living one's is not. */
result_t health_start(const char *path, health_report_t report, void *context, health_t **health);
/* Removes the socket, frees everything and sets *health to NULL. */
void health_stop(health_t **health);

/* Asks the process that answers at `path`, waiting for a few seconds; `text` gets what it says.
 * RESULT_UNREACHABLE when nobody answers, RESULT_MISMATCH when it is not well. */
result_t health_ask(const char *path, char *text, size_t size);

#endif
