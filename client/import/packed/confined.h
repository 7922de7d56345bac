/* confined: work on hostile bytes in a process of its own, for libraries that bytes can break.
 *
 * The process is a copy of this one (fork) that can do nothing but compute, ask for memory and write to the
 * one file of its result, which lies in memory: the kernel refuses all other calls (seccomp). Memory, time
 * and the size of the result are limited. Whatever becomes of it, this process goes on, with a result or an
 * error. What comes back is no more to be trusted than the bytes were.
 */
#ifndef LIGHTMILL_CONFINED_H
#define LIGHTMILL_CONFINED_H

#include "common/base.h"

/* The work: writes its result to the file `output` and returns 0; any other number, 1 to 100, is a failure.
 * It may use memory, and nothing that this process had locked in another thread. */
typedef int confined_work_t(const void *context, int output);

typedef struct {
    uint64_t memory;  /* bytes that it may get, and bytes of its result */
    unsigned seconds; /* of CPU time */
} confined_limits_t;

/* What the work wrote; size 0: nothing. */
typedef struct {
    const uint8_t *data;
    size_t size;
    int failure; /* what the work returned; -1: it was ended, by a fault or by a limit */
} confined_result_t;

/* Runs the work and waits for it. RESULT_LIMIT when the process cannot be made or confined. */
result_t confined_run(confined_work_t *work, const void *context, const confined_limits_t *limits,
                      confined_result_t *result);
/* Frees what confined_run mapped. */
void confined_free(confined_result_t *result);

#endif
