/* server: all of what a master or a relay listens with: the two sockets, the gate before them, and the two
 * servers that answer. The handler says what kind of program it is. */
#ifndef LIGHTMILL_SERVER_H
#define LIGHTMILL_SERVER_H

#include "proto/serve/peer_server.h"

typedef struct server server_t;

typedef struct {
    void *context;                /* ZeroMQ context to share (inproc), or NULL to make one */
    const char *control_endpoint; /* "tcp://127.0.0.1:7420", "tcp://127.0.0.1:*" or "inproc://name" */
    const char *bulk_endpoint;    /* likewise; all texts are kept by the caller */
    const char *data_dir;         /* keys are in DATA/keys, unless `gate` says otherwise */
    const char *elsewhere;        /* told to who asks for what this program does not do; NULL: just that */
    gate_options_t gate;          /* keys; and whether it is a relay */
    double heartbeat, lease, batch_interval; /* seconds, told to workers */
    uint64_t
        batch_memory;  /* bytes for batches that are under way or wait to be added; 0: grants_usual_credit */
    int merge_threads; /* that add batches; 0: one for each core */
    int control_wake;  /* eventfd, kept by the caller: there are notices, or something for its table */
    int bulk_wake;     /* likewise: a batch may be granted now, or there is something for its table */
    pulse_t *pulse;    /* of the control socket's thread; kept by the caller; NULL: none */
} server_options_t;

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
