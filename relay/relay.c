/* relay: see relay.h.
 *
 * DESIGN. Upward it is a worker: the same two threads (proto/uplink/control.c, proto/uplink/bulk.c), with
 * another handler. Downward it is a master: the same server (proto/serve/server.c), with another handler.
 * Between them is the pool (pool.c), which is passive. This file only puts them together and takes them apart
 * in the right order. */
#include "relay/relay.h"

#include "common/memory_limit.h"
#include "common/own_directory.h"
#include "common/wake.h"
#include "proto/serve/server.h"
#include "proto/uplink/control.h"
#include "relay/pool.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { WAKE_CONTROL, WAKE_BULK, WAKE_NOTICES, WAKE_GRANTS, WAKES };
static const uint64_t DEFAULT_CACHE_LIMIT = 20000000000; /* bytes */

typedef struct {
    const relay_options_t *options;
    int wakes[WAKES]; /* eventfds */
    server_t *server; /* downward, */
    bulk_t *bulk;     /* and upward */
    pool_t *pool;
    char *elsewhere; /* what clients are told */
    char *cache_dir;
} relay_t;

relay_options_t relay_options_default(void)
{
    return (relay_options_t){.gate = {.relay = true},
                             .master_endpoint = "tcp://127.0.0.1:7420",
                             .control_endpoint = "tcp://127.0.0.1:7430",
                             .bulk_endpoint = "tcp://127.0.0.1:7431",
                             .data_dir = "lightmill-relay-data",
                             .cache_limit = DEFAULT_CACHE_LIMIT,
                             .heartbeat = 1,
                             .lease = 5,
                             .batch_interval = 10,
                             .grace = 25,
                             .patience = 20};
}

/* ---- putting together ---------------------------------------------------------------------------------- */

static result_t make_wakes(relay_t *relay)
{
    for (int i = 0; i < WAKES; i++) TRY(wake_new(&relay->wakes[i]));
    return result_ok();
}

static server_options_t server_options(const relay_t *relay)
{
    const relay_options_t *options = relay->options;
    return (server_options_t){.control_endpoint = options->control_endpoint,
                              .bulk_endpoint = options->bulk_endpoint,
                              .data_dir = options->data_dir,
                              .elsewhere = relay->elsewhere,
                              .gate = options->gate,
                              .heartbeat = options->heartbeat,
                              .lease = options->lease,
                              .batch_interval = options->batch_interval,
                              .batch_memory = options->batch_memory,
                              .merge_threads = options->threads,
                              .control_wake = relay->wakes[WAKE_NOTICES],
                              .bulk_wake = relay->wakes[WAKE_GRANTS]};
}

static result_t start(relay_t *relay)
{
    static const char *const names[] = {"keys", "scenes", NULL};
    const relay_options_t *options = relay->options;
    TRY(own_directory_open(options->data_dir, names));
    TRY(make_wakes(relay));
    relay->elsewhere = mem_printf("this is a relay, which only workers can use; the master is at %s",
                                  options->master_endpoint);
    server_options_t server = server_options(relay);
    TRY(server_check(&server));
    TRY(server_open(&server, &relay->server));
    unit_secret_t secret;
    TRY(unit_secret_load(options->data_dir, &secret));
    relay->cache_dir = mem_printf("%s/scenes", options->data_dir);
    pool_options_t pool = {.lease = options->lease,
                           .batch_interval = options->batch_interval,
                           .memory = memory_limit(),
                           .secret = secret,
                           .control_wake = relay->wakes[WAKE_CONTROL],
                           .bulk_wake = relay->wakes[WAKE_BULK],
                           .notice_wake = relay->wakes[WAKE_NOTICES],
                           .grant_wake = relay->wakes[WAKE_GRANTS]};
    relay->pool = pool_new(&pool);
    bulk_options_t bulk = {.context = server_context(relay->server),
                           .handler = pool_uplink(relay->pool),
                           .wake = relay->wakes[WAKE_BULK],
                           .control_wake = relay->wakes[WAKE_CONTROL],
                           .cache_dir = relay->cache_dir,
                           .cache_limit = options->cache_limit,
                           .memory = pool.memory / 2,
                           .keys = options->keys,
                           .patience = options->patience};
    TRY(bulk_start(&bulk, &relay->bulk));
    return server_start(relay->server, pool_serve(relay->pool), (message_table_t){0}, (message_table_t){0});
}

/* Takes apart whatever was put together. */
static void dismantle(relay_t *relay)
{
    server_stop(relay->server);
    bulk_stop(&relay->bulk);
    pool_destroy(&relay->pool);
    server_close(&relay->server);
    for (int i = 0; i < WAKES; i++) wake_close(relay->wakes[i]);
    free(relay->cache_dir);
    free(relay->elsewhere);
}

static result_t serve(relay_t *relay, const atomic_int *stop)
{
    const relay_options_t *options = relay->options;
    control_setup_t setup = {.context = server_context(relay->server),
                             .handler = pool_uplink(relay->pool),
                             .bulk = relay->bulk,
                             .wake = relay->wakes[WAKE_CONTROL],
                             .control_endpoint = options->master_endpoint,
                             .name = options->name,
                             .software = "lightmill-relay " LIGHTMILL_VERSION,
                             .relay = true,
                             .grace = options->grace,
                             .pulse = options->pulse,
                             .keys = options->keys};
    return control_run(&setup, stop);
}

result_t relay_run(const relay_options_t *options, const atomic_int *stop, atomic_int *listening)
{
    relay_t relay = {.options = options, .wakes = {-1, -1, -1, -1}};
    result_t result = start(&relay);
    if (result.code == RESULT_OK && listening != NULL)
        atomic_store(listening, server_control_port(relay.server));
    if (result.code == RESULT_OK) result = serve(&relay, stop);
    dismantle(&relay);
    return result;
}
