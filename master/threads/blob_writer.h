/* blob_writer: the thread that writes to the blob store what comes by HTTP, so that a slow disk, and the
 * check of a large scene (about a second a GB), hold up neither the page nor the other sockets.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_BLOB_WRITER_H
#define LIGHTMILL_BLOB_WRITER_H

#include "master/store/blob_store.h"

enum { BLOB_WRITER_MAX_WAITING = 16 }; /* pieces */

typedef struct blob_writer blob_writer_t;

/* A piece of a blob, as blob_store_put takes it. */
typedef struct {
    hash_t hash;
    uint64_t offset, size;
    const void *bytes; /* kept by the caller until `done` */
    size_t length;
    /* Is called on the blob writer's thread, which it must not hold up; `next` as in blob_store_put. */
    void (*done)(void *context, const result_t *result, uint64_t next);
    void *context;
} blob_piece_t;

/* Starts the thread. The store is kept by the caller and outlives it. */
result_t blob_writer_start(blob_store_t *store, blob_writer_t **blob_writer);
/* Writes what waits, joins the thread, frees everything and sets *blob_writer to NULL. */
void blob_writer_stop(blob_writer_t **blob_writer);
/* Has a piece written. RESULT_LIMIT, and no call of `done`, when too many wait. */
result_t blob_writer_put(blob_writer_t *blob_writer, const blob_piece_t *piece);

#endif
