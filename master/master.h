/* master: accepts jobs, keeps blobs, hands out units, merges batches, writes images and checkpoints. Runs on
 * threads of its own until it is stopped; the process around it (main.c, or `lightmill render`) only starts
 * and stops it. */
#ifndef LIGHTMILL_MASTER_H
#define LIGHTMILL_MASTER_H

#include "common/health.h"
#include "master/http/server.h"
#include "proto/serve/gate.h"

typedef struct {
    void *context;                /* ZeroMQ context to share (inproc), or NULL to make one */
    const char *control_endpoint; /* "tcp://127.0.0.1:7420", "tcp://127.0.0.1:*" or "inproc://name" */
    const char *bulk_endpoint;    /* likewise */
    const char *data_dir;    /* all that outlives the process (docs/durability.md); created when missing */
    bool fleeting;           /* the directory goes with the process: nothing in it needs to be safe */
    double heartbeat;        /* seconds between a worker's heartbeats, default 1 */
    double lease;            /* seconds of silence after which a worker loses its units, default 5 */
    double batch_interval;   /* seconds between batches, default 10 */
    double checkpoint;       /* seconds between checkpoints of a job, at least; default 10 */
    double checkpoint_max;   /* and at most, default 120; no less than `checkpoint` */
    uint64_t keep_bytes;     /* what the films of jobs that are over may take on the disk, default 20 GB */
    uint64_t evidence_bytes; /* what batches of verified jobs may take on the disk, default 20 GB */
    uint64_t blob_limit;     /* what scenes may take on the disk, default 100 GB */
    uint64_t snapshot_limit; /* what images that clients fetch may take on the disk, default 20 GB */
    uint64_t batch_memory;   /* bytes for batches under way and waiting to be merged (docs/scale.md); 0: an
                                eighth of the machine's memory, at least 1 GiB */
    uint64_t film_memory; /* bytes for the films of jobs at work; 0: three quarters of the machine's memory */
    size_t job_limit;     /* jobs known at a time; 0: as many as there can be (farm.h) */
    int merge_threads;    /* 0: one for each core */
    const char *notify;   /* the operator's URL or command that is told of the ends of jobs; NULL: none */
    gate_options_t gate;  /* keys */
    http_options_t http;  /* the page; off by default */
    pulse_t *pulse;       /* of the control thread; kept by the caller; NULL: none */
} master_options_t;

typedef struct master master_t;

master_options_t master_options_default(void);
/* Goes on from what is in the data directory, binds and starts the master's threads. */
result_t master_start(const master_options_t *options, master_t **master);
/* The TCP port of the control socket, 0 on inproc. */
int master_control_port(const master_t *master);
/* Where the page is, NULL without one. */
const char *master_page_url(const master_t *master);
/* Reads the list of keys again. From any thread. */
void master_reload(master_t *master);
/* Stops taking work in, writes a last checkpoint of every job that is not over, joins the threads, frees
 * everything and sets *master to NULL. The jobs go on when a master is started with this directory again. */
void master_stop(master_t **master);

#endif
