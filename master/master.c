/* master: see master.h. Puts the pieces together and takes them apart in the right order.
 *
 * DESIGN. Threads beside the caller's: the control server (heartbeats, assignments, clients), the bulk server
 * (batches, blobs, images), the image writer (image files), the journal writer (what clients order, written
 * down), the checkpointer (films on the disk) and, where somebody is to be told of jobs that are over, the
 * notifier. They share the farm, which is passive. Each sleeps on its socket or an eventfd; the eventfds
 * belong to the master.
 *
 * The journal, the films and the scenes are looked at before anybody can ask for anything (restart.h), so
 * whoever connects finds the jobs as they are. When the process ends, the servers go first, so that nothing
 * changes any more; then the checkpointer writes what no checkpoint holds, and last the journal writer how it
 * stands with the jobs. */
#include "master/master.h"

#include "common/memory_limit.h"
#include "common/own_directory.h"
#include "common/wake.h"
#include "master/threads/client_bulk.h"
#include "master/threads/client_control.h"
#include "master/threads/farm_service.h"
#include "master/threads/http_calls.h"
#include "master/threads/notifier.h"
#include "master/threads/restart.h"
#include "proto/serve/server.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

struct master {
    int lock_file;
    /* eventfds */
    int control_wake, bulk_wake, image_wake, journal_writer_wake, checkpoint_wake, news_wake;
    char *data_dir, *spool_dir;
    journal_t *journal;
    film_store_t *films;
    blob_store_t *store;
    farm_t *farm;
    image_writer_t *image_writer;
    checkpointer_t *checkpointer;
    journal_writer_t *journal_writer;
    notifier_t *notifier; /* NULL: nobody is to be told */
    server_t *server;
    farm_service_t service; /* what it calls, */
    client_control_t client_control;
    client_bulk_t client_bulk;  /* and what clients ask of it */
    blob_writer_t *blob_writer; /* NULL: there is no page */
    http_calls_t http_calls;    /* what the page asks */
    http_server_t *http;
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
                              .checkpoint_max = 120,
                              .keep_bytes = (uint64_t)20000000000,
                              .evidence_bytes = (uint64_t)20000000000,
                              .blob_limit = (uint64_t)100000000000,
                              .snapshot_limit = (uint64_t)20000000000};
}

/* ---- options ------------------------------------------------------------------------------------------- */

static server_options_t server_options(const master_t *master, const master_options_t *options)
{
    return (server_options_t){.context = options->context,
                              .control_endpoint = options->control_endpoint,
                              .bulk_endpoint = options->bulk_endpoint,
                              .data_dir = options->data_dir,
                              .gate = options->gate,
                              .heartbeat = options->heartbeat,
                              .lease = options->lease,
                              .batch_interval = options->batch_interval,
                              .batch_memory = options->batch_memory,
                              .merge_threads = options->merge_threads,
                              .control_wake = master->control_wake,
                              .bulk_wake = master->bulk_wake,
                              .pulse = options->pulse};
}

static result_t check_options(const master_t *master, const master_options_t *options)
{
    server_options_t server = server_options(master, options);
    TRY(server_check_seconds("checkpoint interval", options->checkpoint, 0.1));
    TRY(server_check_seconds("longest checkpoint interval", options->checkpoint_max, 0.1));
    return server_check(&server);
}

/* ---- setting up ---------------------------------------------------------------------------------------- */

/* Two masters on one directory would write over each other's images. */
static result_t lock_directory(const char *path, int *descriptor)
{
    char *name = mem_printf("%s/lock", path);
    result_t result = result_ok();
    *descriptor = open(name, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (*descriptor < 0)
        result = result_fail(RESULT_IO, "cannot write in the data directory: %s: %s", name, strerror(errno));
    else if (flock(*descriptor, LOCK_EX | LOCK_NB) != 0)
        result =
            result_fail(RESULT_IO, "another master uses the data directory %s: give this one its own", path);
    free(name);
    return result;
}

static result_t open_server(master_t *master, const master_options_t *options)
{
    server_options_t server = server_options(master, options);
    return server_open(&server, &master->server);
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
    static const char *const names[] = {"lock",      "lightmill.db*", "films", "blobs",     "spool",
                                        "snapshots", "keys",          "http",  "job-*.exr", NULL};
    TRY(own_directory_open(options->data_dir, names));
    TRY(lock_directory(options->data_dir, &master->lock_file));
    TRY(open_journal(master, options));
    TRY(open_films(master, options));
    return open_blobs(master, options);
}

static result_t make_eventfds(master_t *master)
{
    TRY(wake_new(&master->control_wake));
    TRY(wake_new(&master->bulk_wake));
    TRY(wake_new(&master->image_wake));
    TRY(wake_new(&master->journal_writer_wake));
    TRY(wake_new(&master->news_wake));
    return wake_new(&master->checkpoint_wake);
}

/* The farm with the jobs that were there before. */
static result_t make_farm(master_t *master, const master_options_t *options, uint64_t first_job)
{
    unit_secret_t secret;
    TRY(unit_secret_load(options->data_dir, &secret));
    master->spool_dir = mem_printf("%s/spool", options->data_dir);
    farm_options_t farm = {.lease = options->lease,
                           .batch_interval = options->batch_interval,
                           .film_limit = film_limit(options),
                           .first_job = first_job,
                           .job_limit = options->job_limit,
                           .secret = secret,
                           .spool_dir = options->fleeting ? NULL : master->spool_dir,
                           .evidence_limit = options->evidence_bytes,
                           .control_wake = master->control_wake,
                           .image_wake = master->image_wake,
                           .journal_writer_wake = master->journal_writer_wake,
                           .checkpoint_wake = options->fleeting ? -1 : master->checkpoint_wake,
                           .news_wake = options->notify != NULL ? master->news_wake : -1,
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
                                           .most = options->checkpoint_max,
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
                                           .blobs = master->store,
                                           .films = master->films,
                                           .checkpointer = master->checkpointer,
                                           .data_dir = options->data_dir,
                                           .image_wake = master->image_wake,
                                           .answer_wake = master->bulk_wake,
                                           .snapshot_limit = options->snapshot_limit};
    TRY(image_writer_start(&image_writer, &master->image_writer));
    master->service = (farm_service_t){master->farm, master->store};
    master->client_bulk = (client_bulk_t){.store = master->store, .image_writer = master->image_writer};
    master->client_control =
        (client_control_t){master->farm, master->journal_writer, server_gate(master->server),
                           (uint32_t)server_bulk_port(master->server)};
    return server_start(master->server, farm_service_handler(&master->service),
                        client_control_table(&master->client_control),
                        client_bulk_table(&master->client_bulk));
}

static result_t start_telling(master_t *master, const master_options_t *options)
{
    notifier_options_t notifier = {.farm = master->farm,
                                   .target = options->notify,
                                   .data_dir = options->data_dir,
                                   .news_wake = master->news_wake};
    return options->notify != NULL ? notifier_start(&notifier, &master->notifier) : result_ok();
}

static result_t start_page(master_t *master, const master_options_t *options)
{
    if (options->http.listen != NULL) TRY(blob_writer_start(master->store, &master->blob_writer));
    master->http_calls =
        (http_calls_t){master->journal_writer, master->image_writer, master->blob_writer, master->store};
    http_master_t calls = http_calls_master(&master->http_calls, master->farm, server_gate(master->server));
    return http_server_start(&options->http, &calls, options->data_dir, &master->http);
}

static result_t start(master_t *master, const master_options_t *options)
{
    TRY(check_options(master, options));
    TRY(open_data(master, options));
    TRY(make_eventfds(master));
    TRY(open_server(master, options));
    uint64_t first_job = restart_first_job(master->journal, master->films, options->data_dir);
    TRY(make_farm(master, options, first_job));
    TRY(start_keeping(master, options, first_job));
    TRY(start_telling(master, options));
    TRY(start_serving(master, options));
    return start_page(master, options);
}

/* Takes apart whatever was put together. */
static void dismantle(master_t *master)
{
    image_writer_close(master->image_writer); /* the page's requests end */
    http_server_stop(&master->http);
    server_stop(master->server);
    if (master->farm != NULL) farm_shut_down(master->farm);
    blob_writer_stop(&master->blob_writer);
    image_writer_stop(&master->image_writer);
    notifier_stop(&master->notifier);
    checkpointer_finish(master->checkpointer);
    journal_writer_stop(&master->journal_writer); /* it may ask the checkpointer for room */
    checkpointer_stop(&master->checkpointer);
    farm_destroy(&master->farm);
    blob_store_close(&master->store);
    film_store_close(&master->films);
    journal_close(&master->journal);
    server_close(&master->server);
    wake_close(master->control_wake);
    wake_close(master->bulk_wake);
    wake_close(master->image_wake);
    wake_close(master->journal_writer_wake);
    wake_close(master->checkpoint_wake);
    wake_close(master->news_wake);
    if (master->lock_file >= 0) close(master->lock_file);
    free(master->data_dir);
    free(master->spool_dir);
    free(master);
}

result_t master_start(const master_options_t *options, master_t **out)
{
    master_t *master = mem_zalloc(1, sizeof *master);
    master->lock_file = master->control_wake = master->bulk_wake = master->image_wake = -1;
    master->journal_writer_wake = master->checkpoint_wake = master->news_wake = -1;
    master->data_dir = mem_strdup(options->data_dir);
    master_options_t kept = *options;
    kept.data_dir = master->data_dir; /* the servers look at it as long as they run */
    result_t result = start(master, &kept);
    if (result.code != RESULT_OK) dismantle(master);
    *out = result.code == RESULT_OK ? master : NULL;
    return result;
}

int master_control_port(const master_t *master)
{
    return server_control_port(master->server);
}

const char *master_page_url(const master_t *master)
{
    return master->http != NULL ? http_server_url(master->http) : NULL;
}

void master_reload(master_t *master)
{
    gate_reload(server_gate(master->server));
}

void master_stop(master_t **master)
{
    if (*master != NULL) dismantle(*master);
    *master = NULL;
}
