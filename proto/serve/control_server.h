/* control_server: the control socket of a master or a relay. Workers say hello, ask for work and show that
 * they live; the handler's notices are sent to them, and its time passes. Nothing here takes longer than
 * microseconds, so a heartbeat never waits. */
#ifndef LIGHTMILL_CONTROL_SERVER_H
#define LIGHTMILL_CONTROL_SERVER_H

#include "proto/serve/peer_server.h"

typedef struct control_server control_server_t;

typedef struct {
    serve_handler_t handler;
    const char *program;   /* "master" or "relay"; kept by the caller, like elsewhere */
    const char *elsewhere; /* peer_server.h */
    message_table_t more;  /* what this program is asked beside */
    void *socket;          /* a bound ROUTER; closed by the server's thread */
    gate_t *gate;          /* kept by the caller; NULL: everybody may do everything */
    int wake;              /* eventfd, written when there are notices, or something for `more` */
    uint32_t bulk_port;    /* told to workers; 0: inproc */
    double heartbeat, lease, batch_interval; /* seconds, told to workers */
    pulse_t *pulse;                          /* kept by the caller; NULL: none */
} control_server_options_t;

/* Starts the thread; on failure the socket is still the caller's. */
result_t control_server_start(const control_server_options_t *options, control_server_t **server);
/* Ends the thread, closes the socket and sets *server to NULL. */
void control_server_stop(control_server_t **server);

#endif
