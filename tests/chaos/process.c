/* process: see process.h. */
#include "tests/chaos/process.h"

#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

static void give_up(const char *what)
{
    fprintf(stderr, "chaos: %s: %s\n", what, strerror(errno));
    exit(RESULT_IO);
}

char *process_program(const char *name)
{
    char self[4000];
    ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length <= 0) give_up("/proc/self/exe");
    self[length] = '\0';
    for (int i = 0; i < 3; i++) {
        char *slash = strrchr(self, '/');
        if (slash) *slash = '\0';
    }
    return mem_printf("%s/%s", self, name);
}

/* In the new process: becomes the program. */
static void become(const process_setup_t *setup, int log, char *const *argv)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (setup->network >= 0 && setns(setup->network, CLONE_NEWNET) != 0) _exit(126);
    if (setup->background) setpriority(PRIO_PROCESS, 0, 10);
    if (setup->world) world_preload(setup->world);
    dup2(log, STDOUT_FILENO);
    dup2(log, STDERR_FILENO);
    execvp(argv[0], argv);
    dprintf(STDERR_FILENO, "%s: %s\n", argv[0], strerror(errno));
    _exit(127);
}

pid_t process_start(const process_setup_t *setup)
{
    const char *argv[PROCESS_MAX_ARGUMENTS + 2] = {setup->program};
    for (int i = 0; i < PROCESS_MAX_ARGUMENTS && setup->arguments[i]; i++) argv[i + 1] = setup->arguments[i];
    int log = open(setup->log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    if (log < 0) give_up(setup->log);
    pid_t process = fork();
    if (process == 0) become(setup, log, (char *const *)argv);
    if (process < 0) give_up("cannot start a process");
    close(log);
    return process;
}

bool process_ended(pid_t process, int *how)
{
    int status;
    if (waitpid(process, &status, WNOHANG) != process) return false;
    *how = WIFSIGNALED(status) ? PROCESS_SIGNALLED + WTERMSIG(status) : WEXITSTATUS(status);
    return true;
}

void process_kill(pid_t process)
{
    kill(process, SIGKILL);
    while (waitpid(process, NULL, 0) < 0 && errno == EINTR) {
    }
}

char *process_how(int how)
{
    if (how < PROCESS_SIGNALLED) return mem_printf("exit code %d", how);
    return mem_printf("signal %d (%s)", how - PROCESS_SIGNALLED, strsignal(how - PROCESS_SIGNALLED));
}

/* The last line of what a descriptor gives, in `line`. */
static void read_last_line(int file, char *line, size_t size)
{
    char text[4000];
    size_t have = 0;
    for (ssize_t n = 1; n > 0 && have + 1 < sizeof text; have += n > 0 ? (size_t)n : 0)
        n = read(file, text + have, sizeof text - 1 - have);
    while (have > 0 && text[have - 1] == '\n') have--;
    text[have] = '\0';
    const char *last = strrchr(text, '\n');
    snprintf(line, size, "%.*s", (int)size - 1, last ? last + 1 : text);
}

result_t process_command(int network, const char *const *command)
{
    int output[2], status = 0;
    if (pipe2(output, O_CLOEXEC) != 0) give_up("pipe");
    pid_t process = fork();
    if (process == 0) {
        const process_setup_t setup = {.network = network};
        become(&setup, output[1], (char *const *)command);
    }
    if (process < 0) give_up("cannot start a process");
    close(output[1]);
    char line[300];
    read_last_line(output[0], line, sizeof line);
    close(output[0]);
    while (waitpid(process, &status, 0) < 0 && errno == EINTR) {
    }
    if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return result_ok();
    return result_fail(RESULT_IO, "%s %s: %.300s", command[0], command[1] ? command[1] : "",
                       line[0] ? line : "failed");
}
