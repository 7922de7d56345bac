/* processes: see processes.h. */
#include "tests/sim/processes.h"

#include "tests/ports.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MAX_ARGUMENTS = 40, MAX_PATH = 4000 };
static const double PATIENCE = 60; /* seconds, for a process to end */

static char *program_folder(void)
{
    char path[MAX_PATH];
    ssize_t length = readlink("/proc/self/exe", path, sizeof path - 1);
    path[length > 0 ? length : 0] = '\0';
    for (int i = 0; i < 3; i++)
        if (strrchr(path, '/') != NULL) *strrchr(path, '/') = '\0';
    return mem_strdup(path);
}

result_t processes_new(processes_t *processes)
{
    const char *base = getenv("TMPDIR");
    *processes = (processes_t){.bin = program_folder()};
    processes->folder =
        mem_printf("%s/lightmill-sim-XXXXXX", base != NULL && base[0] != '\0' ? base : "/tmp");
    if (mkdtemp(processes->folder) != NULL) return result_ok();
    return result_fail(RESULT_IO, "cannot make the folder %s: %s", processes->folder, strerror(errno));
}

static int remove_entry(const char *path, const struct stat *status, int type, struct FTW *walk)
{
    (void)status, (void)type, (void)walk;
    return remove(path);
}

void processes_free(processes_t *processes)
{
    if (processes->folder != NULL) nftw(processes->folder, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
    free(processes->folder);
    free(processes->bin);
    *processes = (processes_t){0};
}

int process_ports(processes_t *processes)
{
    int first, last;
    ports_range(&first, &last);
    if (processes->next_port == 0) processes->next_port = ports_choose(2);
    for (;;) {
        int port = processes->next_port;
        processes->next_port = port + 3 <= last ? port + 2 : first;
        if (port_is_free(port) && port_is_free(port + 1)) return port;
    }
}

pid_t process_start(const processes_t *processes, const char *program, char *line)
{
    char *path = mem_printf("%s/%s", processes->bin, program);
    char *log = mem_printf("%s/%s.log", processes->folder, program);
    char *argv[MAX_ARGUMENTS] = {path}, *save;
    int count = 1;
    for (char *word = strtok_r(line, " ", &save); word != NULL && count + 1 < MAX_ARGUMENTS;
         word = strtok_r(NULL, " ", &save))
        argv[count++] = word;
    int file = open(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    pid_t process = fork();
    if (process == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        dup2(file, STDOUT_FILENO);
        dup2(file, STDERR_FILENO);
        execv(path, argv);
        _exit(127);
    }
    close(file);
    free(path);
    free(log);
    free(line);
    return process;
}

static void copy_log(const processes_t *processes, const char *program)
{
    char *path = mem_printf("%s/%s.log", processes->folder, program);
    uint8_t *text;
    size_t size;
    if (file_read(path, 1 << 24, &text, &size).code == RESULT_OK) {
        fwrite(text, 1, size, stderr);
        free(text);
    }
    free(path);
}

result_t process_end(const processes_t *processes, pid_t process, const char *program)
{
    int status = 0;
    pid_t ended = 0;
    if (process <= 0) return result_ok();
    kill(process, SIGTERM);
    for (double deadline = clock_now() + PATIENCE; ended == 0 && clock_now() < deadline; usleep(10000))
        ended = waitpid(process, &status, WNOHANG);
    if (ended == process && WIFEXITED(status) && WEXITSTATUS(status) == 0) return result_ok();
    if (ended == 0) {
        kill(process, SIGKILL);
        waitpid(process, &status, 0);
    }
    copy_log(processes, program);
    return result_fail(RESULT_IO, "%s ended badly (status %d)", program, status);
}

double process_memory(pid_t process)
{
    char path[100];
    snprintf(path, sizeof path, "/proc/%d/statm", (int)process);
    FILE *file = fopen(path, "r");
    unsigned long size, resident = 0;
    if (file == NULL || fscanf(file, "%lu %lu", &size, &resident) != 2) resident = 0;
    if (file != NULL) fclose(file);
    return (double)resident * (double)sysconf(_SC_PAGESIZE);
}

/* The CPU seconds of a "stat" file of /proc, 0 unless the process or thread has this name (NULL: any). */
static double stat_cpu(const char *path, const char *name)
{
    char text[1000] = "";
    unsigned long user = 0, system = 0;
    FILE *file = fopen(path, "r");
    bool read = file != NULL && fgets(text, sizeof text, file) != NULL;
    if (file != NULL) fclose(file);
    char *first = strchr(text, '('), *last = strrchr(text, ')');
    if (!read || first == NULL || last == NULL) return 0;
    *last = '\0';
    if (name != NULL && strcmp(first + 1, name) != 0) return 0;
    if (sscanf(last + 1, " %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user, &system) != 2)
        return 0;
    return (double)(user + system) / (double)sysconf(_SC_CLK_TCK);
}

double process_cpu(pid_t process)
{
    char path[100];
    snprintf(path, sizeof path, "/proc/%d/stat", (int)process);
    return stat_cpu(path, NULL);
}

double process_thread_cpu(pid_t process, const char *thread)
{
    char path[100 + NAME_MAX];
    double sum = 0;
    snprintf(path, sizeof path, "/proc/%d/task", (int)process);
    DIR *folder = opendir(path);
    if (folder == NULL) return 0;
    for (struct dirent *entry; (entry = readdir(folder)) != NULL;) {
        if (entry->d_name[0] == '.') continue;
        snprintf(path, sizeof path, "/proc/%d/task/%s/stat", (int)process, entry->d_name);
        sum += stat_cpu(path, thread);
    }
    closedir(folder);
    return sum;
}
