/* server: all of what a master or a relay listens with: the two sockets, the gate before them, and the two
 * servers that answer. The handler says what kind of program it is. */
#ifndef LIGHTMILL_SERVER_H
#define LIGHTMILL_SERVER_H

#include "proto/serve/peer_server.h"

typedef struct server server_t;

/* RESULT_USAGE for a time or an endpoint that cannot be; warns of one that is open to everybody. */
result_t server_check(const server_options_t *options);
/* RESULT_USAGE for a time that is not from `least` seconds to an hour. */
result_t server_check_seconds(const char *name, double value, double least);

/* Reads or makes the keys and binds the sockets; nobody is answered yet. After a failure *server is closed by
 * the caller likewise. */
result_t server_open(const server_options_t *options, server_t **server);
/* Starts to answer. The tables have what this program alone is asked on each socket; they may be empty. */
result_t server_start(server_t *server, serve_handler_t handler, message_table_t control,
                      message_table_t bulk);
/* Nobody is answered any more: the threads have ended. NULL is allowed, here and below. */
void server_stop(server_t *server);
/* Stops it and frees everything, the context too unless it is shared: its other sockets are closed. Sets
 * *server to NULL. */
void server_close(server_t **server);

void *server_context(const server_t *server);
gate_t *server_gate(const server_t *server);
/* TCP ports; 0 on inproc. */
int server_control_port(const server_t *server);
int server_bulk_port(const server_t *server);

#endif
