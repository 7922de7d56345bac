/* complaint: limits the warnings that a peer can provoke to a few a second, so that hostile bytes cannot fill
 * a disk. */
#ifndef LIGHTMILL_COMPLAINT_H
#define LIGHTMILL_COMPLAINT_H

#include "common/base.h"

/* Zeroed to begin with; one thread's. */
typedef struct {
    double window;  /* seconds, when the present window began */
    unsigned count; /* complaints in it */
} complaint_t;

/* True when a warning may be written now; says how many were left out when a window ends. */
bool complaint_allowed(complaint_t *complaint, double now);

#endif
