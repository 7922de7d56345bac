/* control_server: the control socket of a master or a relay. Workers say hello, ask for work and show that
 * they live; the handler's notices are sent to them, and its time passes. Nothing here takes longer than
 * microseconds, so a heartbeat never waits. */
#ifndef LIGHTMILL_CONTROL_SERVER_H
#define LIGHTMILL_CONTROL_SERVER_H

#include "proto/serve/peer_server.h"

typedef struct control_server control_server_t;

/* Starts the thread; on failure the socket is still the caller's. Workers are told the port of the other
 * socket, 0: inproc. The options are copied, here and in bulk_server.h. */
result_t control_server_start(const server_options_t *options, const served_socket_t *served,
                              uint32_t bulk_port, control_server_t **server);
/* Ends the thread, closes the socket and sets *server to NULL. */
void control_server_stop(control_server_t **server);

#endif
