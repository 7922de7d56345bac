/* control_desk: the relay's control socket: workers say hello, ask for work and show that they live. */
#ifndef LIGHTMILL_CONTROL_DESK_H
#define LIGHTMILL_CONTROL_DESK_H

#include "proto/serve/gate.h"
#include "relay/desk.h"
#include "relay/pool.h"

typedef struct control_desk control_desk_t;

typedef struct {
    pool_t *pool;                            /* kept by the caller */
    void *socket;                            /* a bound ROUTER; closed by the desk's thread */
    gate_t *gate;                            /* who may write to it; kept by the caller */
    int wake;                                /* eventfd, written when there are notices; kept by the caller */
    uint32_t bulk_port;                      /* told to workers; 0: inproc */
    double heartbeat, lease, batch_interval; /* seconds, told to workers */
    const char *master;                      /* where the master is, for who asks the relay instead */
} control_desk_options_t;

/* Starts the thread; on failure the socket is still the caller's. */
result_t control_desk_start(const control_desk_options_t *options, control_desk_t **desk);
/* Ends the thread, closes the socket and sets *desk to NULL. */
void control_desk_stop(control_desk_t **desk);

#endif
