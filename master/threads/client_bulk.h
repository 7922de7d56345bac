/* client_bulk: what clients ask on the bulk socket: to store a scene, to fetch an image. */
#ifndef LIGHTMILL_CLIENT_BULK_H
#define LIGHTMILL_CLIENT_BULK_H

#include "master/store/blob_store.h"
#include "master/threads/image_writer.h"
#include "proto/serve/peer_server.h"

typedef struct {
    blob_store_t *store;          /* kept by the caller, like the image writer, */
    image_writer_t *image_writer; /* whose answers wake the server */
    double next_news;             /* seconds, when those who wait for images are told again; 0 at first */
} client_bulk_t;

/* The messages that are answered so; `client` is kept by the caller. */
message_table_t client_bulk_table(client_bulk_t *client);

#endif
