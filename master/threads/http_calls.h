/* http_calls: what the HTTP server asks of the master's threads (master/http/master_calls.h). */
#ifndef LIGHTMILL_HTTP_CALLS_H
#define LIGHTMILL_HTTP_CALLS_H

#include "master/http/master_calls.h"
#include "master/threads/blob_writer.h"
#include "master/threads/image_writer.h"
#include "master/threads/journal_writer.h"

typedef struct {
    journal_writer_t *journal_writer; /* kept by the caller, like the next; outlive the HTTP server */
    image_writer_t *image_writer;
    blob_writer_t *blob_writer;
    blob_store_t *store;
} http_calls_t;

/* The calls are kept by the caller. */
http_master_t http_calls_master(http_calls_t *calls, farm_t *farm, gate_t *gate);

#endif
