/* health: tells on a Unix socket whether the process is well. Container engines, init systems and people may
 * ask.
 *
 * A connection is answered with one line, "ok TEXT" or "failing TEXT", and closed. The socket lies in a
 * directory of this machine and carries no secrets. The file's permissions let its owner alone ask. */
#ifndef LIGHTMILL_HEALTH_H
#define LIGHTMILL_HEALTH_H

#include "common/base.h"

#include <stdatomic.h>

typedef struct health health_t;

/* Describes the process in `text`, one line of at most `size` bytes; false when it is not well. Called from a
 * thread of its own. */
typedef bool (*health_report_t)(void *context, char *text, size_t size);

/* Answers at `path` (NULL: nobody is told, *health becomes NULL); a socket that a dead process left there is
 * replaced, a living one's is not. */
result_t health_start(const char *path, health_report_t report, void *context, health_t **health);
/* Removes the socket, frees everything and sets *health to NULL. */
void health_stop(health_t **health);

/* The sign of life of a program's main loop. Zeroed to begin with; any thread may look at it. */
typedef struct {
    atomic_llong beat;           /* clock_now() in ms of the last turn; 0: there was none yet */
    _Atomic(const char *) doing; /* what it is at, a constant; NULL: nothing to tell */
} pulse_t;

/* The loop has made a turn; `pulse` may be NULL. */
void pulse_beat(pulse_t *pulse, const char *doing);
/* The health_report_t of a pulse: well as long as the last turn was within PULSE_LATE seconds. */
enum { PULSE_LATE = 10 };
bool pulse_report(void *pulse, char *text, size_t size);

/* Asks the process that answers at `path`, waiting for a few seconds; `text` gets what it says.
 * RESULT_UNREACHABLE when nobody answers, RESULT_MISMATCH when it is not well. */
result_t health_ask(const char *path, char *text, size_t size);

#endif
