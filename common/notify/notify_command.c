/* notify_command: a command that tells (see notify.h).
 *
 * DESIGN. posix_spawn and not fork: a master may hold tens of gigabytes of films, whose page tables a fork
 * would copy, and its other threads may hold locks. The JSON lies in a file in memory, which never blocks a
 * writer, however little the command reads. The command has a process group of its own, so that it can be
 * killed with all that it has started, and a Ctrl-C in the terminal of `lightmill render` does not reach it.
 */
#include "common/notify/notify.h"

#include <errno.h>
#include <math.h>
#include <signal.h>
#include <spawn.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { UNKNOWN_EXIT = 255 }; /* for the exit code of a command that the system does not tell */
static const long POLL_NANOSECONDS = 20000000; /* between looks at the command */
static const double GRACE = 2;                 /* seconds between SIGTERM and SIGKILL */

/* ---- starting ------------------------------------------------------------------------------------------ */

/* A file in memory with the JSON, to be read from its beginning. */
static result_t make_input(const news_t *news, int *file)
{
    char *json = news_json(news);
    size_t size = strlen(json);
    *file = memfd_create("lightmill-news", MFD_CLOEXEC);
    bool written = *file >= 0 && write(*file, json, size) == (ssize_t)size && lseek(*file, 0, SEEK_SET) == 0;
    result_t result = result_ok();
    if (!written) result = result_fail(RESULT_IO, "cannot make its input: %s", strerror(errno));
    if (!written && *file >= 0) close(*file);
    free(json);
    return result;
}

/* What the process gets of ours: no other files, no blocked or ignored signals. */
static void describe(posix_spawn_file_actions_t *files, posix_spawnattr_t *attributes, int input)
{
    sigset_t none, all;
    sigemptyset(&none);
    sigfillset(&all);
    posix_spawn_file_actions_init(files);
    posix_spawn_file_actions_adddup2(files, input, STDIN_FILENO);
    posix_spawn_file_actions_adddup2(files, STDERR_FILENO, STDOUT_FILENO);
    posix_spawn_file_actions_addclosefrom_np(files, STDERR_FILENO + 1);
    posix_spawnattr_init(attributes);
    posix_spawnattr_setflags(attributes,
                             POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    posix_spawnattr_setpgroup(attributes, 0);
    posix_spawnattr_setsigmask(attributes, &none);
    posix_spawnattr_setsigdefault(attributes, &all);
}

static result_t start(const char *command, const news_t *news, int input, pid_t *process)
{
    posix_spawn_file_actions_t files;
    posix_spawnattr_t attributes;
    char **environment = news_environment(news);
    char *const arguments[] = {"sh", "-c", (char *)command, NULL};
    describe(&files, &attributes, input);
    int error = posix_spawn(process, "/bin/sh", &files, &attributes, arguments, environment);
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&files);
    news_environment_free(environment);
    if (error == 0) return result_ok();
    return result_fail(RESULT_IO, "cannot start the command: %s", strerror(error));
}

/* ---- waiting ------------------------------------------------------------------------------------------- */

/* True when the process has ended before the deadline, or before *stop became true. */
static bool wait_until(pid_t process, double deadline, const atomic_bool *stop, int *status)
{
    for (pid_t ended; (ended = waitpid(process, status, WNOHANG)) != process;) {
        if (ended < 0) *status = UNKNOWN_EXIT << 8; /* we were started with SIGCHLD ignored */
        if (ended < 0) return true;
        if (clock_now() >= deadline || (stop != NULL && atomic_load(stop))) return false;
        nanosleep(&(struct timespec){.tv_nsec = POLL_NANOSECONDS}, NULL);
    }
    return true;
}

/* Ends the process and all that it has started. */
static void end_group(pid_t process)
{
    int status;
    kill(-process, SIGTERM);
    bool ended = wait_until(process, clock_now() + GRACE, NULL, &status);
    kill(-process, SIGKILL); /* those of the group that are left */
    if (!ended) waitpid(process, &status, 0);
}

static result_t judge(int status)
{
    if (WIFSIGNALED(status))
        return result_fail(RESULT_IO, "the command was ended by signal %d", WTERMSIG(status));
    if (WEXITSTATUS(status) == 0) return result_ok();
    return result_fail(RESULT_IO, "the command ended with exit code %d", WEXITSTATUS(status));
}

result_t notify_command(const char *command, const news_t *news, double limit, const atomic_bool *stop)
{
    int input, status = 0;
    pid_t process;
    TRY(make_input(news, &input));
    result_t result = start(command, news, input, &process);
    close(input);
    TRY(result);
    if (wait_until(process, clock_now() + limit, stop, &status)) return judge(status);
    end_group(process);
    if (stop != NULL && atomic_load(stop)) return result_fail(RESULT_CANCELLED, "the command was ended");
    return result_fail(RESULT_IO, "the command did not end within %g s and was killed", limit);
}
