/* bulk_server: the bulk socket of a master or a relay. Workers offer and deliver batches, which are handed to
 * the threads that add them up (merge_pool.h), and fetch scenes. */
#ifndef LIGHTMILL_BULK_SERVER_H
#define LIGHTMILL_BULK_SERVER_H

#include "proto/serve/peer_server.h"

typedef struct bulk_server bulk_server_t;

/* Starts the threads; on failure the socket is still the caller's. */
result_t bulk_server_start(const server_options_t *options, const served_socket_t *served,
                           bulk_server_t **server);
/* Ends the threads, closes the socket and sets *server to NULL. */
void bulk_server_stop(bulk_server_t **server);

/* For those who serve files in parts: opens a payload for `length` bytes, but not more than a chunk, nor than
 * there are from `offset` to `size`. */
result_t bulk_chunk_open(uint64_t offset, uint32_t length, uint64_t size, zmq_msg_t *payload);
/* The hash in a field of a message. */
result_t bulk_hash_get(const ProtobufCBinaryData *bytes, hash_t *hash);

#endif
