/* command: a `lightmill` command that runs while other things happen. */
#ifndef LIGHTMILL_COMMAND_H
#define LIGHTMILL_COMMAND_H

#include "common/base.h"

#include <sys/types.h>

typedef enum { COMMAND_NONE, COMMAND_RUNS, COMMAND_DONE, COMMAND_FAILED } command_state_t;

typedef struct {
    pid_t process; /* 0: none */
    char *output;  /* the file that it writes */
    double started;
    int how; /* it ended, as process_how reads it */
} command_t;

/* Starts BUILD/lightmill with these arguments; what it says goes to `output`, which is emptied first. */
void command_start(command_t *command, const char *output, const char *const *arguments, bool background);
/* COMMAND_DONE (exit code 0) and COMMAND_FAILED are said once. One that takes longer than `limit` seconds is
 * killed, and has failed: command->how is PROCESS_SIGNALLED + SIGKILL. */
command_state_t command_poll(command_t *command, double now, double limit);
/* What it wrote, in fresh memory. */
char *command_said(const command_t *command);
/* Kills it if it runs. */
void command_end(command_t *command);

#endif
