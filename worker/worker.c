/* worker: see worker.h.
 *
 * DESIGN. Three kinds of threads share one render pool: the calling thread talks to the master (control.c),
 * one thread moves bytes and makes scenes ready (bulk.c), the rest render (render_pool.c). They wake one
 * another through two eventfds, since those can be waited for together with ZeroMQ sockets. This file only
 * puts them together and takes them apart in the right order: bulk first, then the render threads, then the
 * scene that they looked at.
 */
#include "worker/worker.h"

#include "common/memory_limit.h"
#include "common/wake.h"
#include "proto/uplink/blob_cache.h"
#include "proto/uplink/bulk.h"
#include "proto/uplink/control.h"
#include "worker/render/fingerprint.h"
#include "worker/render_pool.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <zmq.h>

static const uint64_t DEFAULT_CACHE_LIMIT = 20000000000; /* bytes */
static const double DEFAULT_PATIENCE = 20;               /* seconds */

worker_options_t worker_options_default(void)
{
    return (worker_options_t){.control_endpoint = "tcp://127.0.0.1:7420",
                              .cache_limit = DEFAULT_CACHE_LIMIT,
                              .grace = WORKER_DEFAULT_GRACE,
                              .patience = DEFAULT_PATIENCE};
}

/* Without one the worker is in a group of its own, which is a pity but no error. */
static hash_t own_fingerprint(void)
{
    hash_t hash = {{0}};
    result_t result = renderer_fingerprint(&hash);
    if (result.code == RESULT_OK) return hash;
    log_warning("this machine's bits cannot be told from others': %s", result.message);
    return (hash_t){{0}};
}

static result_t run_threads(const worker_options_t *options, void *context, int wakes[2],
                            const atomic_int *stop)
{
    render_pool_options_t pool_options = {.threads = options->threads > 0 ? options->threads : core_count(),
                                          .fingerprint = own_fingerprint(),
                                          .memory = memory_limit(),
                                          .control_wake = wakes[0],
                                          .bulk_wake = wakes[1]};
    render_pool_t *pool = render_pool_new(&pool_options);
    char *cache_dir = options->cache_dir ? mem_strdup(options->cache_dir) : blob_cache_default_dir();
    control_setup_t setup = {.context = context,
                             .handler = render_pool_handler(pool),
                             .wake = wakes[0],
                             .control_endpoint = options->control_endpoint,
                             .bulk_endpoint = options->bulk_endpoint,
                             .name = options->name,
                             .software = "lightmill-worker " LIGHTMILL_VERSION,
                             .local = options->local,
                             .grace = options->grace,
                             .pulse = options->pulse,
                             .keys = options->keys};
    bulk_options_t bulk = {.context = context,
                           .handler = setup.handler,
                           .wake = wakes[1],
                           .control_wake = wakes[0],
                           .cache_dir = cache_dir,
                           .cache_limit = options->cache_limit,
                           .memory = pool_options.memory / 4 * 3,
                           .keys = options->keys,
                           .local = options->local,
                           .patience = options->patience};
    result_t result = bulk_start(&bulk, &setup.bulk);
    if (result.code == RESULT_OK) result = control_run(&setup, stop);
    bulk_stop(&setup.bulk);
    render_pool_destroy(&pool);
    free(cache_dir);
    return result;
}

result_t worker_run(const worker_options_t *options, const atomic_int *stop)
{
    void *context = options->context ? options->context : zmq_ctx_new();
    if (context == NULL)
        return result_fail(RESULT_LIMIT, "cannot make a ZeroMQ context: %s", strerror(errno));
    int wakes[2] = {-1, -1};
    result_t result = wake_new(&wakes[0]);
    if (result.code == RESULT_OK) result = wake_new(&wakes[1]);
    if (result.code == RESULT_OK) result = run_threads(options, context, wakes, stop);
    for (int i = 0; i < 2; i++) wake_close(wakes[i]);
    if (!options->context) zmq_ctx_term(context);
    return result;
}
