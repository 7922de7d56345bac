/* server: see server.h. */
#include "proto/serve/server.h"

#include "common/address.h"
#include "proto/serve/bulk_server.h"
#include "proto/serve/control_server.h"
#include "proto/serve/grants.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum {
    MAX_INTERVAL = 3600, /* seconds, of heartbeats, leases and batches */
    ENDPOINT_SIZE = 300,
    MAX_BULK_IO = 4, /* threads of libzmq for the bulk socket */
    /* Seconds until a connection that says nothing is closed: those who dial the control socket have
     * something to say, the bulk socket may be dialled long before it is needed. */
    CONTROL_SILENCE = 30,
    BULK_SILENCE = 300
};
/* Messages of a connection to the bulk socket that libzmq holds: they may be large. A peer that fetches
 * something has a few requests under way, and its batches are answered one by one. On a connection with keys
 * one less is received: libzmq counts the user id as a message that nobody ever reads. */
enum { BULK_RECEIVED = 2, BULK_SENT = 16 };

struct server {
    server_options_t options;
    void *context;
    gate_t *gate;
    void *control_socket, *bulk_socket; /* until a server's thread owns them */
    int control_port, bulk_port;
    control_server_t *control;
    bulk_server_t *bulk;
};

/* ---- checking the options ------------------------------------------------------------------------------ */

/* True for an endpoint that other machines reach. The host, without "tcp://" and port, goes to `host`. */
static bool is_exposed(const char *endpoint, char host[ENDPOINT_SIZE])
{
    host[0] = '\0';
    if (strncmp(endpoint, "tcp://", 6) != 0) return false;
    snprintf(host, ENDPOINT_SIZE, "%s", endpoint + 6);
    char *colon = strrchr(host, ':');
    if (colon != NULL) *colon = '\0';
    return !address_is_loopback(host) && strcmp(host, "lo") != 0;
}

static result_t check_endpoint(const char *endpoint, const gate_options_t *gate)
{
    char host[ENDPOINT_SIZE];
    if (strncmp(endpoint, "inproc://", 9) != 0 && strncmp(endpoint, "tcp://", 6) != 0)
        return result_fail(RESULT_USAGE, "cannot listen on %s: it must begin with tcp:// or inproc://",
                           endpoint);
    if (gate->insecure && is_exposed(endpoint, host))
        log_warning("INSECURE: %s is open to everybody on its network: anyone there can %s", endpoint + 6,
                    gate->relay ? "take work and send results" : "submit jobs, send results and read images");
    return result_ok();
}

result_t server_check_seconds(const char *name, double value, double least)
{
    if (isfinite(value) && value >= least && value <= MAX_INTERVAL) return result_ok();
    return result_fail(RESULT_USAGE, "%s is %g s, must be from %g to %d", name, value, least, MAX_INTERVAL);
}

result_t server_check(const server_options_t *options)
{
    TRY(server_check_seconds("heartbeat", options->heartbeat, 0.05));
    TRY(server_check_seconds("lease", options->lease, 0.1));
    TRY(server_check_seconds("batch interval", options->batch_interval, 0.1));
    if (options->lease < 2 * options->heartbeat)
        return result_fail(RESULT_USAGE, "the lease (%g s) must be at least two heartbeats (%g s)",
                           options->lease, options->heartbeat);
    TRY(check_endpoint(options->control_endpoint, &options->gate));
    return check_endpoint(options->bulk_endpoint, &options->gate);
}

/* ---- sockets ------------------------------------------------------------------------------------------- */

/* libzmq's own threads: the first is the control socket's, so that neither bulk data nor its encryption
 * delays a heartbeat; the others are the bulk socket's. */
static int bulk_io_threads(void)
{
    return int_max(1, int_min(MAX_BULK_IO, (int)sysconf(_SC_NPROCESSORS_ONLN) / 4));
}

static result_t open_context(server_t *server)
{
    server->context = server->options.context;
    if (server->context != NULL) return result_ok();
    server->context = zmq_ctx_new();
    if (server->context == NULL)
        return result_fail(RESULT_IO, "cannot start ZeroMQ: %s", zmq_strerror(errno));
    zmq_ctx_set(server->context, ZMQ_IO_THREADS, 1 + bulk_io_threads());
    return result_ok();
}

/* What connections may leave unfinished. A message to the control socket has one small frame; one to the bulk
 * socket is a part of a scene, or a batch, which was granted (gate_expect). */
static connection_limits_t connection_limits(const server_t *server, bool bulk)
{
    static const uint64_t MB = 1 << 20;
    uint64_t credit = server->options.batch_memory > 0 ? server->options.batch_memory : grants_usual_credit();
    if (bulk) return (connection_limits_t){BULK_SILENCE, 64 * MB, 2 * credit + 256 * MB};
    return (connection_limits_t){CONTROL_SILENCE, 2 * MB, 64 * MB};
}

/* Makes the socket; `threads` are the bits of the libzmq threads that serve it. */
static result_t make_socket(server_t *server, bool bulk, uint64_t threads, size_t largest_frame,
                            void **socket)
{
    const char *endpoint = bulk ? server->options.bulk_endpoint : server->options.control_endpoint;
    connection_limits_t limits = connection_limits(server, bulk);
    TRY(wire_socket(server->context, ZMQ_ROUTER, socket));
    TRY(wire_socket_limit(*socket, largest_frame));
    if (server->options.context == NULL &&
        zmq_setsockopt(*socket, ZMQ_AFFINITY, &threads, sizeof threads) != 0)
        return result_fail(RESULT_IO, "cannot choose a socket's threads: %s", zmq_strerror(errno));
    if (strncmp(endpoint, "tcp://", 6) != 0) return result_ok(); /* all peers are in this process */
    return gate_guard(server->gate, *socket, bulk ? "bulk" : "control", &limits);
}

/* `bound` becomes the endpoint with the port that was chosen. */
static result_t bind_socket(const server_t *server, const char *endpoint, void *socket,
                            char bound[ENDPOINT_SIZE], int *port)
{
    int v6 = strchr(endpoint, '[') != NULL;
    if (zmq_setsockopt(socket, ZMQ_IPV6, &v6, sizeof v6) != 0 || zmq_bind(socket, endpoint) != 0) {
        const char *cure = errno != EADDRINUSE ? ""
                           : server->options.gate.relay
                               ? "; --listen chooses another port"
                               : "; is another master running? --listen chooses another port";
        return result_fail(RESULT_IO, "cannot listen on %s: %s%s", endpoint, zmq_strerror(errno), cure);
    }
    size_t size = ENDPOINT_SIZE;
    if (zmq_getsockopt(socket, ZMQ_LAST_ENDPOINT, bound, &size) != 0)
        return result_fail(RESULT_IO, "cannot find the port of %s: %s", endpoint, zmq_strerror(errno));
    const char *colon = strrchr(bound, ':');
    *port = strncmp(bound, "tcp://", 6) == 0 && colon != NULL ? atoi(colon + 1) : 0;
    return result_ok();
}

static result_t open_sockets(server_t *server)
{
    const server_options_t *options = &server->options;
    char control[ENDPOINT_SIZE], bulk[ENDPOINT_SIZE], host[ENDPOINT_SIZE], bulk_host[ENDPOINT_SIZE];
    bool exposed = is_exposed(options->control_endpoint, host);
    if (is_exposed(options->bulk_endpoint, bulk_host)) exposed = true;
    TRY(gate_new(&options->gate, options->data_dir, server->context, exposed, &server->gate));
    TRY(make_socket(server, false, 1, WIRE_MAX_CONTROL_ASKED, &server->control_socket));
    TRY(make_socket(server, true, ~(uint64_t)1, WIRE_MAX_PAYLOAD, &server->bulk_socket));
    TRY(wire_socket_queue(server->bulk_socket, BULK_RECEIVED, BULK_SENT));
    TRY(bind_socket(server, options->control_endpoint, server->control_socket, control,
                    &server->control_port));
    TRY(bind_socket(server, options->bulk_endpoint, server->bulk_socket, bulk, &server->bulk_port));
    log_info("listening on %s (control) and %s (bulk), data in %s", control, bulk, options->data_dir);
    return gate_start(server->gate, host, server->control_port);
}

result_t server_open(const server_options_t *options, server_t **out)
{
    server_t *server = mem_zalloc(1, sizeof *server);
    *out = server;
    server->options = *options;
    TRY(open_context(server));
    return open_sockets(server);
}

/* ---- serving ------------------------------------------------------------------------------------------- */

static result_t start_bulk(server_t *server, serve_handler_t handler, message_table_t more)
{
    served_socket_t served = {handler, more, server->bulk_socket, server->gate};
    TRY(bulk_server_start(&server->options, &served, &server->bulk));
    server->bulk_socket = NULL;
    return result_ok();
}

static result_t start_control(server_t *server, serve_handler_t handler, message_table_t more)
{
    served_socket_t served = {handler, more, server->control_socket, server->gate};
    TRY(control_server_start(&server->options, &served, (uint32_t)server->bulk_port, &server->control));
    server->control_socket = NULL;
    return result_ok();
}

result_t server_start(server_t *server, serve_handler_t handler, message_table_t control,
                      message_table_t bulk)
{
    TRY(start_bulk(server, handler, bulk));
    return start_control(server, handler, control);
}

void server_stop(server_t *server)
{
    if (server == NULL) return;
    control_server_stop(&server->control);
    bulk_server_stop(&server->bulk);
}

void server_close(server_t **out)
{
    server_t *server = *out;
    if (server == NULL) return;
    server_stop(server);
    if (server->control_socket != NULL) zmq_close(server->control_socket);
    if (server->bulk_socket != NULL) zmq_close(server->bulk_socket);
    gate_stop(&server->gate);
    if (server->options.context == NULL && server->context != NULL) zmq_ctx_term(server->context);
    free(server);
    *out = NULL;
}

void *server_context(const server_t *server)
{
    return server->context;
}

gate_t *server_gate(const server_t *server)
{
    return server->gate;
}

int server_control_port(const server_t *server)
{
    return server->control_port;
}

int server_bulk_port(const server_t *server)
{
    return server->bulk_port;
}
