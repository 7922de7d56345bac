/* confined: see confined.h. */
#include "client/import/packed/confined.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

/* Codes of the process that are not the work's. */
enum { NOT_CONFINED = 101 };
/* Time on the clock for a second of CPU time, for machines that do other things too. */
enum { PATIENCE = 10 };

/* ---- in the process of the work ------------------------------------------------------------------------ */

/* BPF (Linux: Documentation/userspace-api/seccomp_filter.rst): the number of the call, or the low word of an
 * argument, is loaded and compared. */
#define LOAD(field) BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, field))
#define SKIP_IF(value, yes, no) BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (uint32_t)(value), yes, no)
#define ANSWER(answer) BPF_STMT(BPF_RET | BPF_K, answer)
#define ALLOW(call) SKIP_IF(call, 0, 1), ANSWER(SECCOMP_RET_ALLOW)

/* Lets the process ask for memory, write to `output`, and end. */
static bool allow_little(int output)
{
    struct sock_filter rules[] = {
        LOAD(arch),
        SKIP_IF(AUDIT_ARCH_X86_64, 1, 0),
        ANSWER(SECCOMP_RET_KILL_PROCESS),
        LOAD(nr),
        ALLOW(SYS_brk),
        ALLOW(SYS_munmap),
        ALLOW(SYS_mremap),
        ALLOW(SYS_mprotect),
        ALLOW(SYS_madvise),
        ALLOW(SYS_futex),
        ALLOW(SYS_sigaltstack), /* what the address sanitizer asks before it ends */
        ALLOW(SYS_exit),
        ALLOW(SYS_exit_group),
        /* no files, this process's open ones included */
        SKIP_IF(SYS_mmap, 0, 3),
        LOAD(args[4]),
        SKIP_IF(-1, 0, 4),
        ANSWER(SECCOMP_RET_ALLOW),
        SKIP_IF(SYS_write, 0, 2),
        LOAD(args[0]),
        SKIP_IF(output, 1, 0),
        ANSWER(SECCOMP_RET_ERRNO | EPERM),
        ANSWER(SECCOMP_RET_ALLOW),
    };
    struct sock_fprog program = {.len = ARRAY_LENGTH(rules), .filter = rules};
    return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 &&
           prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0;
}

static bool limit(__rlimit_resource_t what, uint64_t most)
{
    return setrlimit(what, &(struct rlimit){most, most}) == 0;
}

/* This process may have handlers that write files, or report to a debugger; here a fault just ends it. */
static void forget_handlers(void)
{
    for (int number = 1; number < SIGRTMIN; ++number) signal(number, SIG_DFL);
    sigset_t none;
    sigemptyset(&none);
    sigprocmask(SIG_SETMASK, &none, NULL);
}

/* `address_space`: bytes that are in use before the work begins. */
static bool confine(const confined_limits_t *limits, uint64_t address_space, int output)
{
    forget_handlers();
    int nowhere = open("/dev/null", O_WRONLY | O_CLOEXEC);
    if (nowhere >= 0) dup2(nowhere, STDERR_FILENO); /* what the C library says of a damaged heap */
    alarm(limits->seconds * PATIENCE);
    return prctl(PR_SET_PDEATHSIG, SIGKILL) == 0 && limit(RLIMIT_CORE, 0) &&
           limit(RLIMIT_CPU, limits->seconds) && limit(RLIMIT_FSIZE, limits->memory) &&
           limit(RLIMIT_AS, address_space + limits->memory) && allow_little(output);
}

/* ---- in this process ----------------------------------------------------------------------------------- */

/* Bytes of the address space that are in use; 0 when the kernel does not tell. */
static uint64_t address_space_in_use(void)
{
    unsigned long pages = 0;
    FILE *file = fopen("/proc/self/statm", "re");
    if (!file) return 0;
    if (fscanf(file, "%lu", &pages) != 1) pages = 0;
    fclose(file);
    return pages * (uint64_t)sysconf(_SC_PAGESIZE);
}

/* The exit code, or -1 when a signal ended it. */
static int wait_for(pid_t process)
{
    int status;
    while (waitpid(process, &status, 0) < 0)
        if (errno != EINTR) return -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

static result_t read_output(int output, confined_result_t *result)
{
    struct stat about;
    if (fstat(output, &about) != 0)
        return result_fail(RESULT_LIMIT, "a decoder's result is gone: %s", strerror(errno));
    if (about.st_size == 0) return result_ok();
    void *data = mmap(NULL, (size_t)about.st_size, PROT_READ, MAP_PRIVATE, output, 0);
    if (data == MAP_FAILED) return result_fail(RESULT_LIMIT, "no memory for a decoder's result");
    result->data = data;
    result->size = (size_t)about.st_size;
    return result_ok();
}

static result_t run(confined_work_t *work, const void *context, const confined_limits_t *limits, int output,
                    confined_result_t *result)
{
    uint64_t in_use = address_space_in_use();
    pid_t process = fork();
    if (process < 0) return result_fail(RESULT_LIMIT, "no process for a decoder: %s", strerror(errno));
    if (process == 0) _exit(confine(limits, in_use, output) ? work(context, output) : NOT_CONFINED);
    result->failure = wait_for(process);
    if (result->failure == NOT_CONFINED)
        return result_fail(RESULT_LIMIT, "the kernel does not let a decoder be confined (prctl, setrlimit); "
                                         "does the container forbid it?");
    return read_output(output, result);
}

result_t confined_run(confined_work_t *work, const void *context, const confined_limits_t *limits,
                      confined_result_t *result)
{
    *result = (confined_result_t){0};
    int output = memfd_create("decoded", MFD_CLOEXEC);
    if (output < 0) return result_fail(RESULT_LIMIT, "no memory file for a decoder: %s", strerror(errno));
    result_t done = run(work, context, limits, output, result);
    close(output);
    return done;
}

void confined_free(confined_result_t *result)
{
    if (result->data) munmap((void *)(uintptr_t)result->data, result->size);
    *result = (confined_result_t){0};
}
