/* master: see master.h. Puts the pieces together and takes them apart in the right order.
 *
 * DESIGN. Threads beside the caller's: the control server (heartbeats, assignments, clients), the bulk server
 * (batches, blobs, images), the image writer (image files), the journal writer (what clients order, written
 * down) and the checkpointer (films on the disk). They share the farm, which is passive. Each sleeps on its
 * socket or an eventfd; the eventfds belong to the master.
 *
 * The journal, the films and the scenes are looked at before anybody can ask for anything (restart.h), so
 * whoever connects finds the jobs as they are. When the process ends, the servers go first, so that nothing
 * changes any more; then the checkpointer writes what no checkpoint holds, and last the journal writer how it
 * stands with the jobs. */
#include "master/master.h"

#include "common/address.h"
#include "common/memory_limit.h"
#include "master/threads/client_bulk.h"
#include "master/threads/client_control.h"
#include "master/threads/farm_service.h"
#include "master/threads/restart.h"
#include "proto/serve/bulk_server.h"
#include "proto/serve/control_server.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

enum { MAX_INTERVAL = 3600 }; /* seconds, of heartbeats, leases and batches */
enum { ENDPOINT_SIZE = 300 };
enum { MAX_BULK_IO = 4 }; /* threads of libzmq for the bulk socket */
/* Messages of a connection to the bulk socket that libzmq holds: they may be large. A peer that fetches
 * something has a few requests under way, and its batches are answered one by one. On a connection with keys
 * one less is received: libzmq counts the user id as a message that nobody ever reads. */
enum { BULK_RECEIVED = 2, BULK_SENT = 16 };

struct master {
    void *context;
    bool own_context;
    int lock_file;
    int control_wake, bulk_wake, image_wake, journal_writer_wake, checkpoint_wake; /* eventfds */
    void *control_socket, *bulk_socket; /* until a server's thread owns them */
    int control_port, bulk_port;
    char *spool_dir;
    journal_t *journal;
    film_store_t *films;
    blob_store_t *store;
    farm_t *farm;
    image_writer_t *image_writer;
    checkpointer_t *checkpointer;
    journal_writer_t *journal_writer;
    gate_t *gate;
    farm_service_t service; /* what the servers call, */
    client_control_t client_control;
    client_bulk_t client_bulk; /* and what they are asked by clients */
    control_server_t *control;
    bulk_server_t *bulk;
};

master_options_t master_options_default(void)
{
    return (master_options_t){.control_endpoint = "tcp://127.0.0.1:7420",
                              .bulk_endpoint = "tcp://127.0.0.1:7421",
                              .data_dir = "lightmill-data",
                              .heartbeat = 1,
                              .lease = 5,
                              .batch_interval = 10,
                              .checkpoint = 10,
                              .keep_bytes = (uint64_t)20000000000,
                              .blob_limit = (uint64_t)100000000000};
}

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

static result_t check_endpoint(const char *endpoint, bool insecure)
{
    char host[ENDPOINT_SIZE];
    if (strncmp(endpoint, "inproc://", 9) != 0 && strncmp(endpoint, "tcp://", 6) != 0)
        return result_fail(RESULT_USAGE, "cannot listen on %s: it must begin with tcp:// or inproc://",
                           endpoint);
    if (insecure && is_exposed(endpoint, host))
        log_warning("INSECURE: %s is open to everybody on its network: anyone there can submit jobs, send "
                    "results and "
                    "read images",
                    endpoint + 6);
    return result_ok();
}

static result_t check_seconds(const char *name, double value, double least)
{
    if (isfinite(value) && value >= least && value <= MAX_INTERVAL) return result_ok();
    return result_fail(RESULT_USAGE, "%s is %g s, must be from %g to %d", name, value, least, MAX_INTERVAL);
}

static result_t check_options(const master_options_t *options)
{
    TRY(check_seconds("heartbeat", options->heartbeat, 0.05));
    TRY(check_seconds("lease", options->lease, 0.1));
    TRY(check_seconds("batch interval", options->batch_interval, 0.1));
    TRY(check_seconds("checkpoint interval", options->checkpoint, 0.1));
    if (options->lease < 2 * options->heartbeat)
        return result_fail(RESULT_USAGE, "the lease (%g s) must be at least two heartbeats (%g s)",
                           options->lease, options->heartbeat);
    TRY(check_endpoint(options->control_endpoint, options->gate.insecure));
    return check_endpoint(options->bulk_endpoint, options->gate.insecure);
}

/* ---- setting up ---------------------------------------------------------------------------------------- */

/* Makes the directory and its parents. */
static result_t make_directories(const char *path)
{
    char *copy = mem_strdup(path);
    result_t result = result_ok();
    for (char *slash = copy + (*copy == '/'); result.code == RESULT_OK; slash++) {
        char end = *slash;
        if (end != '/' && end != '\0') continue;
        *slash = '\0';
        if (mkdir(copy, 0777) != 0 && errno != EEXIST)
            result = result_fail(RESULT_IO, "cannot make the directory %s: %s", copy, strerror(errno));
        *slash = end;
        if (end == '\0') break;
    }
    free(copy);
    return result;
}

/* Two masters on one directory would write over each other's images. */
static result_t lock_directory(const char *path, int *descriptor)
{
    char *name = mem_printf("%s/lock", path);
    result_t result = result_ok();
    *descriptor = open(name, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (*descriptor < 0)
        result = result_fail(RESULT_IO, "cannot write in the data directory: %s: %s", name, strerror(errno));
    else if (flock(*descriptor, LOCK_EX | LOCK_NB) != 0)
        result =
            result_fail(RESULT_IO, "another master uses the data directory %s: give this one its own", path);
    free(name);
    return result;
}

static result_t make_eventfd(int *descriptor)
{
    *descriptor = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (*descriptor >= 0) return result_ok();
    return result_fail(RESULT_LIMIT, "cannot make an eventfd: %s", strerror(errno));
}

/* libzmq's own threads: the first is the control socket's, so that neither bulk data nor its encryption
 * delays a heartbeat; the others are the bulk socket's. */
static int bulk_io_threads(void)
{
    return int_max(1, int_min(MAX_BULK_IO, (int)sysconf(_SC_NPROCESSORS_ONLN) / 4));
}

/* Makes the socket; `threads` are the bits of the libzmq threads that serve it. */
static result_t make_socket(master_t *master, const char *name, uint64_t threads, size_t largest_frame,
                            void **socket)
{
    TRY(wire_socket(master->context, ZMQ_ROUTER, socket));
    TRY(wire_socket_limit(*socket, largest_frame));
    if (master->own_context && zmq_setsockopt(*socket, ZMQ_AFFINITY, &threads, sizeof threads) != 0)
        return result_fail(RESULT_IO, "cannot choose a socket's threads: %s", zmq_strerror(errno));
    return gate_guard(master->gate, *socket, name);
}

/* `bound` becomes the endpoint with the port that was chosen. */
static result_t bind_socket(const char *endpoint, void **socket, char bound[ENDPOINT_SIZE], int *port)
{
    int v6 = strchr(endpoint, '[') != NULL;
    if (zmq_setsockopt(*socket, ZMQ_IPV6, &v6, sizeof v6) != 0 || zmq_bind(*socket, endpoint) != 0)
        return result_fail(RESULT_IO, "cannot listen on %s: %s%s", endpoint, zmq_strerror(errno),
                           errno == EADDRINUSE ? "; is another master running? --listen chooses another port"
                                               : "");
    size_t size = ENDPOINT_SIZE;
    if (zmq_getsockopt(*socket, ZMQ_LAST_ENDPOINT, bound, &size) != 0)
        return result_fail(RESULT_IO, "cannot find the port of %s: %s", endpoint, zmq_strerror(errno));
    const char *colon = strrchr(bound, ':');
    *port = strncmp(bound, "tcp://", 6) == 0 && colon != NULL ? atoi(colon + 1) : 0;
    return result_ok();
}

static result_t open_context(master_t *master, const master_options_t *options)
{
    master->context = options->context != NULL ? options->context : zmq_ctx_new();
    master->own_context = options->context == NULL;
    if (master->context == NULL)
        return result_fail(RESULT_IO, "cannot start ZeroMQ: %s", zmq_strerror(errno));
    if (master->own_context) zmq_ctx_set(master->context, ZMQ_IO_THREADS, 1 + bulk_io_threads());
    return result_ok();
}

static result_t open_sockets(master_t *master, const master_options_t *options)
{
    char control[ENDPOINT_SIZE], bulk[ENDPOINT_SIZE], host[ENDPOINT_SIZE], bulk_host[ENDPOINT_SIZE];
    TRY(open_context(master, options));
    bool exposed = is_exposed(options->control_endpoint, host);
    if (is_exposed(options->bulk_endpoint, bulk_host)) exposed = true;
    TRY(gate_new(&options->gate, options->data_dir, master->context, exposed, &master->gate));
    TRY(make_socket(master, "control", 1, WIRE_MAX_CONTROL_ASKED, &master->control_socket));
    TRY(make_socket(master, "bulk", ~(uint64_t)1, WIRE_MAX_PAYLOAD, &master->bulk_socket));
    TRY(wire_socket_queue(master->bulk_socket, BULK_RECEIVED, BULK_SENT));
    TRY(bind_socket(options->control_endpoint, &master->control_socket, control, &master->control_port));
    TRY(bind_socket(options->bulk_endpoint, &master->bulk_socket, bulk, &master->bulk_port));
    log_info("listening on %s (control) and %s (bulk), data in %s", control, bulk, options->data_dir);
    return gate_start(master->gate, host, master->control_port);
}

/* Three quarters of the memory, unless it is said. */
static uint64_t film_limit(const master_options_t *options)
{
    return options->film_memory > 0 ? options->film_memory : memory_limit() / 4 * 3;
}

static result_t open_blobs(master_t *master, const master_options_t *options)
{
    char *path = mem_printf("%s/blobs", options->data_dir);
    blob_store_options_t store = {
        .directory = path, .limit = options->blob_limit, .fleeting = options->fleeting};
    result_t result = blob_store_open(&store, &master->store);
    free(path);
    return result;
}

static result_t open_films(master_t *master, const master_options_t *options)
{
    char *path = mem_printf("%s/films", options->data_dir);
    result_t result = film_store_open(path, &master->films);
    free(path);
    return result;
}

static result_t open_journal(master_t *master, const master_options_t *options)
{
    char *path = mem_printf("%s/lightmill.db", options->data_dir);
    result_t result = journal_open(path, options->fleeting, &master->journal);
    free(path);
    return result;
}

/* Opens all that is in the data directory. */
static result_t open_data(master_t *master, const master_options_t *options)
{
    TRY(make_directories(options->data_dir));
    TRY(lock_directory(options->data_dir, &master->lock_file));
    TRY(open_journal(master, options));
    TRY(open_films(master, options));
    return open_blobs(master, options);
}

static result_t make_eventfds(master_t *master)
{
    TRY(make_eventfd(&master->control_wake));
    TRY(make_eventfd(&master->bulk_wake));
    TRY(make_eventfd(&master->image_wake));
    TRY(make_eventfd(&master->journal_writer_wake));
    return make_eventfd(&master->checkpoint_wake);
}

/* The farm with the jobs that were there before. */
static result_t make_farm(master_t *master, const master_options_t *options, uint64_t first_job)
{
    master->spool_dir = mem_printf("%s/spool", options->data_dir);
    farm_options_t farm = {.lease = options->lease,
                           .batch_interval = options->batch_interval,
                           .film_limit = film_limit(options),
                           .first_job = first_job,
                           .job_limit = options->job_limit,
                           .spool_dir = options->fleeting ? NULL : master->spool_dir,
                           .control_wake = master->control_wake,
                           .image_wake = master->image_wake,
                           .journal_writer_wake = master->journal_writer_wake,
                           .checkpoint_wake = options->fleeting ? -1 : master->checkpoint_wake,
                           .grant_wake = master->bulk_wake};
    master->farm = farm_new(&farm);
    return restart_farm(master->farm, master->journal, master->films, master->store);
}

static bool make_room(void *master, uint64_t bytes)
{
    return checkpointer_make_room(((master_t *)master)->checkpointer, bytes);
}

static result_t start_keeping(master_t *master, const master_options_t *options, uint64_t first_job)
{
    checkpointer_options_t checkpointer = {.farm = master->farm,
                                           .films = master->films,
                                           .blobs = master->store,
                                           .journal = master->journal,
                                           .interval = options->checkpoint,
                                           .keep_bytes = options->keep_bytes,
                                           .checkpoint_wake = master->checkpoint_wake};
    if (!options->fleeting) {
        TRY(checkpointer_start(&checkpointer, &master->checkpointer));
        blob_store_on_full(master->store, make_room, master);
    }
    journal_writer_options_t journal_writer = {.farm = master->farm,
                                               .store = master->store,
                                               .journal = master->journal,
                                               .checkpointer = master->checkpointer,
                                               .data_dir = options->data_dir,
                                               .first_job = first_job,
                                               .journal_writer_wake = master->journal_writer_wake,
                                               .answer_wake = master->control_wake};
    return journal_writer_start(&journal_writer, &master->journal_writer);
}

static result_t start_serving(master_t *master, const master_options_t *options)
{
    image_writer_options_t image_writer = {.farm = master->farm,
                                           .checkpointer = master->checkpointer,
                                           .data_dir = options->data_dir,
                                           .image_wake = master->image_wake,
                                           .answer_wake = master->bulk_wake};
    TRY(image_writer_start(&image_writer, &master->image_writer));
    master->service = (farm_service_t){master->farm, master->store};
    master->client_bulk = (client_bulk_t){master->store, master->image_writer};
    master->client_control =
        (client_control_t){master->farm, master->journal_writer, master->gate, (uint32_t)master->bulk_port};
    bulk_server_options_t bulk = {.handler = farm_service_handler(&master->service),
                                  .more = client_bulk_table(&master->client_bulk),
                                  .gate = master->gate,
                                  .socket = master->bulk_socket,
                                  .wake = master->bulk_wake,
                                  .batch_memory = options->batch_memory,
                                  .merge_threads = options->merge_threads};
    TRY(bulk_server_start(&bulk, &master->bulk));
    master->bulk_socket = NULL;
    control_server_options_t control = {.handler = farm_service_handler(&master->service),
                                        .program = "master",
                                        .more = client_control_table(&master->client_control),
                                        .gate = master->gate,
                                        .socket = master->control_socket,
                                        .wake = master->control_wake,
                                        .bulk_port = (uint32_t)master->bulk_port,
                                        .heartbeat = options->heartbeat,
                                        .lease = options->lease,
                                        .batch_interval = options->batch_interval,
                                        .pulse = options->pulse};
    TRY(control_server_start(&control, &master->control));
    master->control_socket = NULL;
    return result_ok();
}

static result_t start(master_t *master, const master_options_t *options)
{
    TRY(check_options(options));
    TRY(open_data(master, options));
    TRY(make_eventfds(master));
    TRY(open_sockets(master, options));
    uint64_t first_job = restart_first_job(master->journal, master->films, options->data_dir);
    TRY(make_farm(master, options, first_job));
    TRY(start_keeping(master, options, first_job));
    return start_serving(master, options);
}

static void close_descriptor(int descriptor)
{
    if (descriptor >= 0) close(descriptor);
}

/* Takes apart whatever was put together. */
static void dismantle(master_t *master)
{
    control_server_stop(&master->control);
    bulk_server_stop(&master->bulk);
    if (master->farm != NULL) farm_shut_down(master->farm);
    image_writer_stop(&master->image_writer);
    checkpointer_finish(master->checkpointer);
    journal_writer_stop(&master->journal_writer); /* it may ask the checkpointer for room */
    checkpointer_stop(&master->checkpointer);
    farm_destroy(&master->farm);
    blob_store_close(&master->store);
    film_store_close(&master->films);
    journal_close(&master->journal);
    if (master->control_socket != NULL) zmq_close(master->control_socket);
    if (master->bulk_socket != NULL) zmq_close(master->bulk_socket);
    gate_stop(&master->gate);
    if (master->own_context && master->context != NULL) zmq_ctx_term(master->context);
    close_descriptor(master->control_wake);
    close_descriptor(master->bulk_wake);
    close_descriptor(master->image_wake);
    close_descriptor(master->journal_writer_wake);
    close_descriptor(master->checkpoint_wake);
    close_descriptor(master->lock_file);
    free(master->spool_dir);
    free(master);
}

result_t master_start(const master_options_t *options, master_t **out)
{
    master_t *master = mem_zalloc(1, sizeof *master);
    master->lock_file = master->control_wake = master->bulk_wake = master->image_wake = -1;
    master->journal_writer_wake = master->checkpoint_wake = -1;
    result_t result = start(master, options);
    if (result.code != RESULT_OK) dismantle(master);
    *out = result.code == RESULT_OK ? master : NULL;
    return result;
}

int master_control_port(const master_t *master)
{
    return master->control_port;
}

void master_reload(master_t *master)
{
    gate_reload(master->gate);
}

result_t master_stop(master_t **master)
{
    if (*master != NULL) dismantle(*master);
    *master = NULL;
    return result_ok();
}
