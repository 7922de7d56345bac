/* processes: our programs, started in a folder of their own and watched from outside, for what measures them.
 */
#ifndef LIGHTMILL_PROCESSES_H
#define LIGHTMILL_PROCESSES_H

#include "common/base.h"

#include <sys/types.h>

typedef struct {
    char *folder; /* scratch: data, logs */
    char *bin;    /* where the programs are */
    int next_port;
} processes_t;

/* Makes the folder, under $TMPDIR or /tmp. This program is BUILD/tests/FOLDER/NAME. */
result_t processes_new(processes_t *processes);
/* Removes the folder; harmless on a zeroed one. */
void processes_free(processes_t *processes);

/* Two ports in a row that nobody listens on, and that were not given out before. */
int process_ports(processes_t *processes);
/* Starts a program; `line` has its arguments, separated by spaces, in fresh memory that is taken over. What
 * it writes goes to "folder/program.log"; it dies with this process. */
pid_t process_start(const processes_t *processes, const char *program, char *line);
/* Ends a process (none: 0) kindly; unless it ends well, that is an error, and its log is copied to stderr. */
result_t process_end(const processes_t *processes, pid_t process, const char *program);

/* Bytes of memory in use. */
double process_memory(pid_t process);
/* CPU seconds so far, of all its threads, or of those of this name only. */
double process_cpu(pid_t process);
double process_thread_cpu(pid_t process, const char *thread);

#endif
