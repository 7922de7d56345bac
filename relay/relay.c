/* relay: see relay.h.
 *
 * DESIGN. Upward it is a worker: the same two threads (proto/uplink/control.c, proto/uplink/bulk.c), with
 * another handler. Downward it is a master: the same two servers (proto/serve/control_server.c,
 * proto/serve/bulk_server.c), with another handler. Between them is the pool (pool.c), which is passive. This
 * file only puts them together and takes them apart in the right order. */
#include "relay/relay.h"

#include "common/address.h"
#include "common/memory_limit.h"
#include "proto/serve/bulk_server.h"
#include "proto/serve/control_server.h"
#include "proto/uplink/control.h"
#include "relay/pool.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

enum { ENDPOINT_SIZE = 300, WAKES = 4, MAX_INTERVAL = 3600 };
enum { WAKE_CONTROL, WAKE_BULK, WAKE_NOTICES, WAKE_GRANTS };
static const uint64_t DEFAULT_CACHE_LIMIT = (uint64_t)20 << 30;

typedef struct {
    const relay_options_t *options;
    void *context;
    int wakes[WAKES]; /* eventfds */
    gate_t *gate;
    void *control_socket, *bulk_socket; /* until a server's thread owns them */
    int control_port, bulk_port;
    pool_t *pool;
    char *elsewhere; /* what clients are told */
    control_server_t *control_server;
    bulk_server_t *bulk_server;
    bulk_t *bulk;
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

/* ---- checking the options ------------------------------------------------------------------------------ */

static result_t check_seconds(const char *name, double value, double least)
{
    if (isfinite(value) && value >= least && value <= MAX_INTERVAL) return result_ok();
    return result_fail(RESULT_USAGE, "%s is %g s, must be from %g to %d", name, value, least, MAX_INTERVAL);
}

static result_t check_options(const relay_options_t *options)
{
    TRY(check_seconds("heartbeat", options->heartbeat, 0.05));
    TRY(check_seconds("lease", options->lease, 0.1));
    TRY(check_seconds("batch interval", options->batch_interval, 0.1));
    if (options->lease >= 2 * options->heartbeat) return result_ok();
    return result_fail(RESULT_USAGE, "the lease (%g s) must be at least two heartbeats (%g s)",
                       options->lease, options->heartbeat);
}

/* ---- sockets ------------------------------------------------------------------------------------------- */

/* True when other machines reach the endpoint, whose host it tells ("" for the port of any). */
static bool is_exposed(const char *endpoint, char host[ENDPOINT_SIZE])
{
    const char *start = strncmp(endpoint, "tcp://", 6) == 0 ? endpoint + 6 : endpoint;
    const char *colon = strrchr(start, ':');
    snprintf(host, ENDPOINT_SIZE, "%.*s", colon != NULL ? (int)(colon - start) : (int)strlen(start), start);
    return !address_is_loopback(host);
}

/* libzmq's own threads, as the bits of a mask: neither batches nor their encryption delay a heartbeat. */
enum { IO_THREADS = 2, CONTROL_THREAD = 1, BULK_THREAD = 2 };
/* Messages of a connection to the bulk socket that libzmq holds: few, as in the master (master.c). */
enum { BULK_RECEIVED = 2, BULK_SENT = 16 };

static result_t make_socket(relay_t *relay, const char *name, uint64_t threads, size_t largest_frame,
                            void **socket)
{
    TRY(wire_socket(relay->context, ZMQ_ROUTER, socket));
    TRY(wire_socket_limit(*socket, largest_frame));
    if (zmq_setsockopt(*socket, ZMQ_AFFINITY, &threads, sizeof threads) != 0)
        return result_fail(RESULT_IO, "cannot choose a socket's threads: %s", zmq_strerror(errno));
    return gate_guard(relay->gate, *socket, name);
}

static result_t bind_socket(const char *endpoint, void *socket, int *port)
{
    char bound[ENDPOINT_SIZE];
    size_t size = sizeof bound;
    int v6 = strchr(endpoint, '[') != NULL;
    if (zmq_setsockopt(socket, ZMQ_IPV6, &v6, sizeof v6) != 0 || zmq_bind(socket, endpoint) != 0)
        return result_fail(RESULT_IO, "cannot listen on %s: %s%s", endpoint, zmq_strerror(errno),
                           errno == EADDRINUSE ? "; --listen chooses another port" : "");
    if (zmq_getsockopt(socket, ZMQ_LAST_ENDPOINT, bound, &size) != 0)
        return result_fail(RESULT_IO, "cannot find the port of %s: %s", endpoint, zmq_strerror(errno));
    *port = atoi(strrchr(bound, ':') + 1);
    return result_ok();
}

static result_t open_sockets(relay_t *relay)
{
    const relay_options_t *options = relay->options;
    char host[ENDPOINT_SIZE];
    bool exposed = is_exposed(options->control_endpoint, host);
    if (exposed && options->gate.insecure)
        log_warning("INSECURE: the relay on %s is open to everybody on its network: anyone there can take "
                    "work and send results",
                    host);
    TRY(gate_new(&options->gate, options->data_dir, relay->context, exposed, &relay->gate));
    TRY(make_socket(relay, "control", CONTROL_THREAD, WIRE_MAX_CONTROL_ASKED, &relay->control_socket));
    TRY(make_socket(relay, "bulk", BULK_THREAD, WIRE_MAX_PAYLOAD, &relay->bulk_socket));
    TRY(wire_socket_queue(relay->bulk_socket, BULK_RECEIVED, BULK_SENT));
    TRY(bind_socket(options->control_endpoint, relay->control_socket, &relay->control_port));
    TRY(bind_socket(options->bulk_endpoint, relay->bulk_socket, &relay->bulk_port));
    log_info("listening on %s:%d (control) and :%d (bulk) for workers of %s", host, relay->control_port,
             relay->bulk_port, options->master_endpoint);
    return gate_start(relay->gate, host, relay->control_port);
}

/* ---- putting together ---------------------------------------------------------------------------------- */

static result_t make_wakes(relay_t *relay)
{
    for (int i = 0; i < WAKES; i++) {
        relay->wakes[i] = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
        if (relay->wakes[i] < 0)
            return result_fail(RESULT_LIMIT, "cannot make an eventfd: %s", strerror(errno));
    }
    return result_ok();
}

static result_t start_servers(relay_t *relay)
{
    const relay_options_t *options = relay->options;
    bulk_server_options_t bulk = {.handler = pool_serve(relay->pool),
                                  .socket = relay->bulk_socket,
                                  .gate = relay->gate,
                                  .wake = relay->wakes[WAKE_GRANTS],
                                  .batch_memory = options->batch_memory,
                                  .merge_threads = options->threads};
    TRY(bulk_server_start(&bulk, &relay->bulk_server));
    relay->bulk_socket = NULL;
    relay->elsewhere = mem_printf("this is a relay, which only workers can use; the master is at %s",
                                  options->master_endpoint);
    control_server_options_t control = {.handler = pool_serve(relay->pool),
                                        .program = "relay",
                                        .elsewhere = relay->elsewhere,
                                        .socket = relay->control_socket,
                                        .gate = relay->gate,
                                        .wake = relay->wakes[WAKE_NOTICES],
                                        .bulk_port = (uint32_t)relay->bulk_port,
                                        .heartbeat = options->heartbeat,
                                        .lease = options->lease,
                                        .batch_interval = options->batch_interval};
    TRY(control_server_start(&control, &relay->control_server));
    relay->control_socket = NULL;
    return result_ok();
}

static result_t start(relay_t *relay)
{
    const relay_options_t *options = relay->options;
    TRY(check_options(options));
    TRY(make_wakes(relay));
    relay->context = zmq_ctx_new();
    if (relay->context == NULL)
        return result_fail(RESULT_LIMIT, "cannot make a ZeroMQ context: %s", strerror(errno));
    zmq_ctx_set(relay->context, ZMQ_IO_THREADS, IO_THREADS);
    relay->cache_dir = mem_printf("%s/scenes", options->data_dir);
    pool_options_t pool = {.lease = options->lease,
                           .batch_interval = options->batch_interval,
                           .memory = memory_limit(),
                           .control_wake = relay->wakes[WAKE_CONTROL],
                           .bulk_wake = relay->wakes[WAKE_BULK],
                           .notice_wake = relay->wakes[WAKE_NOTICES],
                           .grant_wake = relay->wakes[WAKE_GRANTS]};
    relay->pool = pool_new(&pool);
    bulk_options_t bulk = {.context = relay->context,
                           .handler = pool_uplink(relay->pool),
                           .wake = relay->wakes[WAKE_BULK],
                           .cache_dir = relay->cache_dir,
                           .cache_limit = options->cache_limit,
                           .keys = options->keys,
                           .patience = options->patience};
    TRY(bulk_start(&bulk, &relay->bulk));
    TRY(open_sockets(relay));
    return start_servers(relay);
}

/* Takes apart whatever was put together. */
static void dismantle(relay_t *relay)
{
    control_server_stop(&relay->control_server);
    bulk_server_stop(&relay->bulk_server);
    bulk_stop(&relay->bulk);
    pool_destroy(&relay->pool);
    if (relay->control_socket != NULL) zmq_close(relay->control_socket);
    if (relay->bulk_socket != NULL) zmq_close(relay->bulk_socket);
    gate_stop(&relay->gate);
    if (relay->context != NULL) zmq_ctx_term(relay->context);
    for (int i = 0; i < WAKES; i++)
        if (relay->wakes[i] >= 0) close(relay->wakes[i]);
    free(relay->cache_dir);
    free(relay->elsewhere);
}

static result_t serve(relay_t *relay, const atomic_int *stop)
{
    const relay_options_t *options = relay->options;
    control_setup_t setup = {.context = relay->context,
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
    if (result.code == RESULT_OK && listening != NULL) atomic_store(listening, relay.control_port);
    if (result.code == RESULT_OK) result = serve(&relay, stop);
    dismantle(&relay);
    return result;
}
