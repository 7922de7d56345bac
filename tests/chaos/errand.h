/* errand: a `lightmill` command that runs while other things happen. */
#ifndef LIGHTMILL_ERRAND_H
#define LIGHTMILL_ERRAND_H

#include "common/base.h"

#include <sys/types.h>

typedef enum { ERRAND_NONE, ERRAND_RUNS, ERRAND_DONE, ERRAND_FAILED } errand_state_t;

typedef struct {
    pid_t process; /* 0: none */
    char *output;  /* the file that it writes */
    double started;
    int how; /* it ended, as process_how reads it */
} errand_t;

/* Starts BUILD/lightmill with these arguments; what it says goes to `output`, which is emptied first. */
void errand_start(errand_t *errand, const char *output, const char *const *arguments, bool background);
/* ERRAND_DONE (exit code 0) and ERRAND_FAILED are said once. One that takes longer than `limit` seconds is
 * killed, and has failed: errand->how is PROCESS_SIGNALLED + SIGKILL. */
errand_state_t errand_poll(errand_t *errand, double now, double limit);
/* What it wrote, in fresh memory. */
char *errand_said(const errand_t *errand);
/* Kills it if it runs. */
void errand_end(errand_t *errand);

#endif
