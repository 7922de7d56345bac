/* worker: see worker.h.
 *
 * DESIGN. Three kinds of threads share one workshop: the calling thread talks to the master (control.c), one
 * thread moves bytes and makes scenes ready (bulk.c), the rest render (workshop.c). They wake one another
 * through two eventfds, since those can be waited for together with ZeroMQ sockets. This file only puts them
 * together and takes them apart in the right order: bulk first, then the render threads, then the scene that
 * they looked at.
 */
#include "worker/worker.h"

#include "worker/blob_cache.h"
#include "worker/bulk.h"
#include "worker/control.h"

#include <errno.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>
#include <zmq.h>

static const uint64_t DEFAULT_CACHE_LIMIT = (uint64_t)20 << 30;

worker_options_t worker_options_default(void)
{
    return (worker_options_t){.control_endpoint = "tcp://127.0.0.1:7420", .cache_limit = DEFAULT_CACHE_LIMIT};
}

/* Cores that this process may run on. */
static int core_count(void)
{
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof set, &set) == 0) return int_max(1, CPU_COUNT(&set));
    return int_max(1, (int)sysconf(_SC_NPROCESSORS_ONLN));
}

/* "host:pid"; the caller frees it. */
static char *default_name(void)
{
    char host[200] = "";
    if (gethostname(host, sizeof host - 1) != 0) strcpy(host, "worker");
    return mem_printf("%s:%d", host, (int)getpid());
}

static result_t run_threads(const worker_options_t *options, void *context, int wakes[2],
                            const atomic_int *stop)
{
    control_setup_t setup = {.options = options, .context = context, .wake = wakes[0]};
    setup.threads = options->threads > 0 ? options->threads : core_count();
    char *name = options->name ? mem_strdup(options->name) : default_name();
    char *cache_dir = options->cache_dir ? mem_strdup(options->cache_dir) : blob_cache_default_dir();
    setup.name = name;
    setup.shop = workshop_new(setup.threads, wakes[0], wakes[1]);
    bulk_options_t bulk = {.context = context,
                           .shop = setup.shop,
                           .wake = wakes[1],
                           .cache_dir = cache_dir,
                           .cache_limit = options->cache_limit,
                           .keys = options->keys,
                           .local = options->local};
    result_t result = bulk_start(&bulk, &setup.bulk);
    if (result.code == RESULT_OK) result = control_run(&setup, stop);
    bulk_stop(&setup.bulk);
    workshop_destroy(&setup.shop);
    free(cache_dir);
    free(name);
    return result;
}

result_t worker_run(const worker_options_t *options, const atomic_int *stop)
{
    void *context = options->context ? options->context : zmq_ctx_new();
    if (context == NULL)
        return result_fail(RESULT_LIMIT, "cannot make a ZeroMQ context: %s", strerror(errno));
    int wakes[2] = {eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC), eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)};
    result_t result = result_fail(RESULT_LIMIT, "cannot make an eventfd: %s", strerror(errno));
    if (wakes[0] >= 0 && wakes[1] >= 0) result = run_threads(options, context, wakes, stop);
    for (int i = 0; i < 2; i++)
        if (wakes[i] >= 0) close(wakes[i]);
    if (!options->context) zmq_ctx_term(context);
    return result;
}
