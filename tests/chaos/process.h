/* process: the programs of a run. All of them die with the driver. */
#ifndef LIGHTMILL_PROCESS_H
#define LIGHTMILL_PROCESS_H

#include "tests/chaos/world.h"

#include <sys/types.h>

enum { PROCESS_MAX_ARGUMENTS = 60, PROCESS_SIGNALLED = 1000 };

typedef struct {
    const char *program;          /* a path, or a name to be looked for as a shell does */
    const char *const *arguments; /* after the program's name, NULL-terminated */
    const char *log;              /* what it writes is appended to this file */
    int network;                  /* network namespace to run in; -1: the driver's */
    const world_t *world;         /* what it sees; NULL: all as it is */
    bool background;              /* nice: others come first */
} process_setup_t;

/* Ends the driver with a message when no process can be started. */
pid_t process_start(const process_setup_t *setup);
/* True when the process has ended; *how is then its exit code, or PROCESS_SIGNALLED + the signal. */
bool process_ended(pid_t process, int *how);
/* Kills with -9 and waits. */
void process_kill(pid_t process);
/* "exit code 3", "signal 11 (Segmentation fault)"; fresh memory. */
char *process_how(int how);

/* Runs a command of the system to its end. RESULT_IO with the last line that it wrote when it fails. */
result_t process_command(int network, const char *const *command);

/* "BUILD/name": a file beside or above this program, which is BUILD/tests/chaos/chaos; fresh memory. */
char *process_program(const char *name);

#endif
