/* bulk_server: the thread that owns the bulk socket: batches of workers come in and are handed to the threads
 * that merge them (merge_pool.h), blobs come and go, images are fetched. */
#ifndef LIGHTMILL_BULK_SERVER_H
#define LIGHTMILL_BULK_SERVER_H

#include "master/farm/farm.h"
#include "master/store/blob_store.h"
#include "master/threads/image_writer.h"
#include "proto/serve/gate.h"

typedef struct bulk_server bulk_server_t;

typedef struct {
    farm_t *farm; /* kept by the caller, like the store and the image writer */
    blob_store_t *store;
    image_writer_t *image_writer;
    gate_t *gate; /* likewise; NULL: everybody may do everything */
    void *socket; /* a bound ROUTER; closed by the server's thread */
    int wake;     /* eventfd, written when an image is ready, a batch is merged, or one may be granted */
    uint64_t batch_memory; /* bytes for batches that are under way or wait to be merged (grants.h) */
    int merge_threads;     /* 0: one for each core */
} bulk_server_options_t;

/* Starts the thread; on failure the socket is still the caller's. */
result_t bulk_server_start(const bulk_server_options_t *options, bulk_server_t **server);
/* Ends the thread, closes the socket and sets *server to NULL. */
void bulk_server_stop(bulk_server_t **server);

#endif
