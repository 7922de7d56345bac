/* local_farm: see local_farm.h.
 *
 * DESIGN. The master's data live in a temporary directory that is removed at the end. The folder in which it
 * keeps scenes is the workers' cache, too, where files have the same names: so they find each scene there and
 * check it, and none is copied, which for a large one would take minutes and its size again. Worker processes
 * get a process group of their own, so that Ctrl-C reaches only this process, which decides what to do about
 * it; and they are killed by the kernel when this process dies, however it dies.
 */
#include "client/farm/local_farm.h"

#include "common/memory_limit.h"
#include "common/thread.h"
#include "master/http/access/tokens.h"
#include "master/master.h"
#include "worker/worker.h"

#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <malloc.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static const double LEAVE_TIMEOUT = 5.0;   /* seconds before a worker process that does not leave is killed */
static const double ANSWER_TIMEOUT = 60.0; /* seconds: our own master is there, it may only be busy */
static const char CONTROL_ENDPOINT[] = "inproc://control";
static const char BULK_ENDPOINT[] = "inproc://bulk";

struct local_farm {
    local_farm_options_t options;
    void *context; /* inproc */
    char *dir;     /* temporary, holds the master's data */
    char *cache_dir;
    char *endpoint; /* control, of whichever transport */
    master_t *master;

    /* The worker inside this process. */
    pthread_t thread;
    bool thread_started;
    atomic_int stop;
    atomic_bool ended; /* the thread has set `outcome` */
    result_t outcome;

    /* Worker processes; 0 for one that has ended. */
    pid_t children[LOCAL_FARM_MAX_WORKERS];
    int child_count;
};

/* ---- the temporary directory -------------------------------------------------------------------------- */

static result_t make_directory(local_farm_t *farm)
{
    const char *base = getenv("TMPDIR");
    farm->dir = mem_printf("%s/lightmill-XXXXXX", base && base[0] ? base : "/tmp");
    if (mkdtemp(farm->dir) == NULL) {
        result_t result = result_fail(RESULT_IO, "cannot create %.300s: %s; set TMPDIR to another directory",
                                      farm->dir, strerror(errno));
        free(farm->dir);
        farm->dir = NULL;
        return result;
    }
    farm->cache_dir = mem_printf("%s/master/blobs", farm->dir); /* master.c's name of it */
    return result_ok();
}

static int remove_entry(const char *path, const struct stat *status, int type, struct FTW *walk)
{
    (void)status, (void)type, (void)walk;
    if (remove(path) != 0) log_warning("cannot remove %s: %s", path, strerror(errno));
    return 0;
}

static void remove_directory(const char *dir)
{
    if (dir) nftw(dir, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}

/* ---- the master --------------------------------------------------------------------------------------- */

static result_t start_master(local_farm_t *farm)
{
    bool inproc = farm->options.workers == 0;
    char *data_dir = mem_printf("%s/master", farm->dir);
    master_options_t options = master_options_default();
    options.context = inproc ? farm->context : NULL;
    options.control_endpoint = inproc ? CONTROL_ENDPOINT : "tcp://127.0.0.1:*";
    options.bulk_endpoint = inproc ? BULK_ENDPOINT : "tcp://127.0.0.1:*";
    options.data_dir = data_dir;
    options.fleeting = true;
    options.batch_interval = farm->options.batch_interval;
    options.http = farm->options.http;
    result_t result = master_start(&options, &farm->master);
    free(data_dir);
    TRY(result);
    farm->endpoint = inproc ? mem_strdup(CONTROL_ENDPOINT)
                            : mem_printf("tcp://127.0.0.1:%d", master_control_port(farm->master));
    return result_ok();
}

/* ---- the worker inside this process ------------------------------------------------------------------- */

static void *worker_thread(void *argument)
{
    local_farm_t *farm = argument;
    worker_options_t options = worker_options_default();
    options.context = farm->context;
    options.control_endpoint = CONTROL_ENDPOINT;
    options.bulk_endpoint = BULK_ENDPOINT;
    options.cache_dir = farm->cache_dir;
    options.threads = farm->options.threads;
    options.local = true;
    farm->outcome = worker_run(&options, &farm->stop);
    atomic_store(&farm->ended, true);
    return NULL;
}

/* Each batch takes about what the one before it took. The C library is to keep that: fresh pages cost a short
 * render several percent of its time. The master gives back now and then what is not used (bulk_server.c). */
static void keep_memory(void)
{
    mallopt(M_MMAP_THRESHOLD, 32 << 20); /* the largest that there is */
    mallopt(M_TRIM_THRESHOLD, 512 << 20);
}

static result_t start_thread(local_farm_t *farm)
{
    keep_memory();
    TRY(thread_start(&farm->thread, "worker", worker_thread, farm));
    farm->thread_started = true;
    return result_ok();
}

/* ---- worker processes --------------------------------------------------------------------------------- */

/* The path of a program that lies beside this one; the caller frees it. */
static result_t sibling_path(const char *name, char **path)
{
    char self[4000];
    ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length < 0) return result_fail(RESULT_IO, "cannot read /proc/self/exe: %s", strerror(errno));
    self[length] = '\0';
    char *slash = strrchr(self, '/');
    if (slash) *slash = '\0';
    *path = mem_printf("%s/%s", self, name);
    if (access(*path, X_OK) == 0) return result_ok();
    result_t result = result_fail(RESULT_IO, "cannot run %.300s: %s", *path, strerror(errno));
    free(*path);
    *path = NULL;
    return result;
}

/* Between fork and exec: only calls that are safe while other threads may hold locks. */
static void become_worker(const char *path, char *const *arguments)
{
    setpgid(0, 0);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    execv(path, arguments);
    _exit(RESULT_IO);
}

static result_t spawn_worker(local_farm_t *farm, const char *path, int threads)
{
    char *count = mem_printf("%d", threads), *name = mem_printf("%d", farm->child_count + 1);
    char *arguments[] = {(char *)path, farm->endpoint,
                         "--threads",  count,
                         "--name",     name,
                         "--cache",    farm->cache_dir,
                         "--insecure", farm->options.verbose ? "--verbose" : "--quiet",
                         NULL};
    pid_t child = fork();
    if (child == 0) become_worker(path, arguments);
    free(count);
    free(name);
    if (child < 0) return result_fail(RESULT_LIMIT, "cannot start a process: %s", strerror(errno));
    farm->children[farm->child_count++] = child;
    return result_ok();
}

static result_t start_processes(local_farm_t *farm)
{
    int threads = farm->options.threads;
    if (threads == 0) threads = int_max(1, core_count() / farm->options.workers);
    char *path = NULL;
    TRY(sibling_path("lightmill-worker", &path));
    result_t result = result_ok();
    for (int i = 0; i < farm->options.workers && result.code == RESULT_OK; i++)
        result = spawn_worker(farm, path, threads);
    free(path);
    return result;
}

/* Notes the children that have ended; returns how many are left. */
static int reap(local_farm_t *farm, bool report)
{
    int left = 0;
    for (int i = 0; i < farm->child_count; i++) {
        int status;
        if (farm->children[i] == 0) continue;
        if (waitpid(farm->children[i], &status, WNOHANG) != farm->children[i]) {
            left++;
            continue;
        }
        if (report && WIFSIGNALED(status))
            log_warning("worker %d was ended by signal %d; the others go on", i + 1, WTERMSIG(status));
        else if (report)
            log_warning("worker %d left with exit code %d; the others go on", i + 1, WEXITSTATUS(status));
        farm->children[i] = 0;
    }
    return left;
}

static void signal_children(local_farm_t *farm, int number)
{
    for (int i = 0; i < farm->child_count; i++)
        if (farm->children[i] > 0) kill(farm->children[i], number);
}

static void stop_processes(local_farm_t *farm)
{
    signal_children(farm, SIGTERM);
    double deadline = clock_now() + LEAVE_TIMEOUT;
    bool killed = false;
    while (reap(farm, false) > 0) {
        if (!killed && clock_now() > deadline) {
            signal_children(farm, SIGKILL);
            killed = true;
        }
        nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
    }
}

/* ---- the whole ---------------------------------------------------------------------------------------- */

static result_t start_all(local_farm_t *farm)
{
    TRY(make_directory(farm));
    TRY(start_master(farm));
    return farm->options.workers == 0 ? start_thread(farm) : start_processes(farm);
}

result_t local_farm_start(const local_farm_options_t *options, local_farm_t **farm_pointer)
{
    local_farm_t *farm = mem_zalloc(1, sizeof *farm);
    farm->options = *options;
    farm->context = zmq_ctx_new();
    result_t result = start_all(farm);
    if (result.code != RESULT_OK) local_farm_stop(&farm);
    *farm_pointer = farm;
    return result;
}

result_t local_farm_connect(local_farm_t *farm, remote_t **remote)
{
    bool inproc = farm->options.workers == 0;
    return remote_open(farm->context, farm->endpoint, inproc ? BULK_ENDPOINT : NULL, ANSWER_TIMEOUT, remote);
}

char *local_farm_page(const local_farm_t *farm)
{
    const char *url = master_page_url(farm->master);
    char *data_dir = mem_printf("%s/master", farm->dir), *page = NULL;
    http_tokens_t tokens;
    if (url != NULL && http_tokens_read(data_dir, &tokens).code == RESULT_OK) {
        page = mem_printf("%s#token=%s", url, tokens.operate);
        http_tokens_forget(&tokens);
    }
    free(data_dir);
    return page;
}

result_t local_farm_check(local_farm_t *farm)
{
    if (farm->options.workers == 0) {
        if (!atomic_load(&farm->ended)) return result_ok();
        if (farm->outcome.code != RESULT_OK) return farm->outcome;
        return result_fail(RESULT_CANCELLED, "the worker has left");
    }
    if (reap(farm, true) > 0) return result_ok();
    return result_fail(RESULT_IO, "all %d worker processes have ended", farm->options.workers);
}

void local_farm_stop(local_farm_t **farm_pointer)
{
    local_farm_t *farm = *farm_pointer;
    if (farm == NULL) return;
    atomic_store(&farm->stop, 1);
    stop_processes(farm);
    if (farm->thread_started) pthread_join(farm->thread, NULL);
    master_stop(&farm->master);
    zmq_ctx_term(farm->context);
    remove_directory(farm->dir);
    free(farm->dir);
    free(farm->cache_dir);
    free(farm->endpoint);
    free(farm);
    *farm_pointer = NULL;
}
