/* master: accepts jobs, keeps blobs, hands out units, merges batches, writes images. Runs on threads of its
 * own until it is stopped; the process around it (main.c, or `lightmill render`) only starts and stops it. */
#ifndef LIGHTMILL_MASTER_H
#define LIGHTMILL_MASTER_H

#include "master/gate.h"

typedef struct {
    void *context;                /* ZeroMQ context to share (inproc), or NULL to make one */
    const char *control_endpoint; /* "tcp://127.0.0.1:7420", "tcp://127.0.0.1:*" or "inproc://name" */
    const char *bulk_endpoint;    /* likewise */
    const char *data_dir;         /* blobs, snapshots and finished images; created when missing */
    double heartbeat;             /* seconds between a worker's heartbeats, default 1 */
    double lease;                 /* seconds of silence after which a worker loses its units, default 5 */
    double batch_interval;        /* seconds between batches, default 10 */
    gate_options_t gate;          /* keys */
} master_options_t;

typedef struct master master_t;

master_options_t master_options_default(void);
/* Binds and starts the master's threads. */
result_t master_start(const master_options_t *options, master_t **master);
/* The TCP port of the control socket, 0 on inproc. */
int master_control_port(const master_t *master);
/* Reads the list of keys again. From any thread. */
void master_reload(master_t *master);
/* Stops taking work in, writes the image so far of every unfinished job, joins the threads, frees everything
 * and sets *master to NULL. */
result_t master_stop(master_t **master);

#endif
