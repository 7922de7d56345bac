/* local_farm: a master and its workers on this machine, for `lightmill render`.
 *
 * Without worker processes, everything is in this process over inproc://: the master's threads, one worker,
 * the client. With them, the master listens on a free port of the loopback device and each worker is a
 * process of the program lightmill-worker, found beside this one. Either way it is the code that a real farm
 * runs.
 */
#ifndef LIGHTMILL_LOCAL_FARM_H
#define LIGHTMILL_LOCAL_FARM_H

#include "client/farm/remote.h"
#include "master/http/server.h"

typedef struct local_farm local_farm_t;

typedef struct {
    int workers;           /* processes; 0: one worker inside this process */
    int threads;           /* render threads a worker; 0: the cores, shared out */
    double batch_interval; /* seconds */
    bool verbose;          /* workers log what they do */
    http_options_t http;   /* the page; off by default */
} local_farm_options_t;

enum { LOCAL_FARM_MAX_WORKERS = 256 };

/* Starts master and workers. */
result_t local_farm_start(const local_farm_options_t *options, local_farm_t **farm);
/* A client's connection to the master; to be closed before the farm is stopped. */
result_t local_farm_connect(local_farm_t *farm, remote_t **remote);
/* Where the page is with the right to operate, in fresh memory; NULL without a page. */
char *local_farm_page(const local_farm_t *farm);
/* Fails when no worker is left to render. */
result_t local_farm_check(local_farm_t *farm);
/* Sends the workers away, stops the master, removes the temporary files and sets *farm to NULL. */
void local_farm_stop(local_farm_t **farm);

#endif
