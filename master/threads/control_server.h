/* control_server: the thread that owns the control socket. It answers workers and clients, sends the farm's
 * notices and makes its time pass. Nothing that it does takes longer than microseconds, so a heartbeat never
 * waits. */
#ifndef LIGHTMILL_CONTROL_SERVER_H
#define LIGHTMILL_CONTROL_SERVER_H

#include "common/health.h"
#include "master/farm/farm.h"
#include "master/threads/journal_writer.h"
#include "proto/serve/gate.h"

typedef struct control_server control_server_t;

typedef struct {
    farm_t *farm; /* kept by the caller, like the journal writer */
    journal_writer_t *journal_writer;
    gate_t *gate; /* likewise; NULL: everybody may do everything */
    void *socket; /* a bound ROUTER; closed by the server's thread */
    int wake;     /* eventfd, written by the farm when there are notices, by the journal writer when it has an
                     answer */
    uint32_t bulk_port;                      /* told to peers; 0: inproc */
    double heartbeat, lease, batch_interval; /* seconds, told to workers */
    pulse_t *pulse;                          /* kept by the caller; NULL: none */
} control_server_options_t;

/* Starts the thread; on failure the socket is still the caller's. */
result_t control_server_start(const control_server_options_t *options, control_server_t **server);
/* Ends the thread, closes the socket and sets *server to NULL. */
void control_server_stop(control_server_t **server);

#endif
