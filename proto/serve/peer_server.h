/* peer_server: a thread that owns a ROUTER socket and serves the peers that write to it.
 *
 * What is done with a message is a row of a table: the kind, the right that its sender needs, the function
 * that handles it. There are two such tables, that of the server itself and one of the program's. */
#ifndef LIGHTMILL_PEER_SERVER_H
#define LIGHTMILL_PEER_SERVER_H

#include "common/health.h"
#include "proto/serve/gate.h"
#include "proto/serve/serve_handler.h"

typedef struct peer_server peer_server_t;

typedef struct {
    Lm__Envelope__BodyCase kind;
    unsigned right; /* RIGHT_... */
    /* On the server's thread: the control socket's takes microseconds. */
    void (*handle)(void *self, peer_server_t *server, const wire_message_t *message);
} message_kind_t;

typedef struct {
    const message_kind_t *kinds;
    size_t count;
    /* What else there is to do: after messages or a wake-up, and a few times a second. `more`: messages wait.
     * NULL: nothing. */
    void (*turn)(void *self, peer_server_t *server, bool more);
    void *self; /* of these calls */
} message_table_t;

enum { PEER_SERVER_TABLES = 2 };

typedef struct {
    const char *name;      /* of the socket, for people; kept by the caller */
    const char *elsewhere; /* told to who sends what is in no table; kept by the caller; NULL: just that */
    void *socket;          /* a bound ROUTER; closed by the server's thread */
    const char *data_dir;  /* no peer is told its path; kept by the caller; NULL: there is none */
    gate_t *gate;          /* who may send what; kept by the caller; NULL: everybody everything */
    int wake;              /* eventfd that asks for a turn; kept by the caller */
    int turn_ms;           /* between turns when nothing happens */
    int turn_messages;     /* before there is a turn, at most */
    bool limited;          /* peers may send so many messages a second, and no more */
    pulse_t *pulse;        /* kept by the caller; NULL: none */
    message_table_t tables[PEER_SERVER_TABLES];
} peer_server_options_t;

/* What a master or a relay is told: server.h. */
typedef struct {
    void *context;                /* ZeroMQ context to share (inproc), or NULL to make one */
    const char *control_endpoint; /* "tcp://127.0.0.1:7420", "tcp://127.0.0.1:*" or "inproc://name" */
    const char *bulk_endpoint;    /* likewise; all texts are kept by the caller */
    const char *data_dir;         /* keys are in DATA/keys, unless `gate` says otherwise */
    const char *elsewhere;        /* told to who asks for what this program does not do; NULL: just that */
    gate_options_t gate;          /* keys; and whether it is a relay */
    double heartbeat, lease, batch_interval; /* seconds, told to workers */
    uint64_t batch_memory; /* bytes for batches under way or waiting to be added; 0: grants_usual_credit */
    int merge_threads;     /* that add batches; 0: one for each core */
    int control_wake;      /* eventfd, kept by the caller: there are notices, or something for its table */
    int bulk_wake;         /* likewise: a batch may be granted now, or there is something for its table */
    pulse_t *pulse;        /* of the control socket's thread; kept by the caller; NULL: none */
} server_options_t;

/* One of its two sockets, and who answers there. */
typedef struct {
    serve_handler_t handler;
    message_table_t more; /* what this program is asked beside */
    void *socket;         /* a bound ROUTER; closed by the server's thread */
    gate_t *gate;         /* kept by the caller; NULL: everybody may do everything */
} served_socket_t;

/* Starts the thread; on failure the socket is still the caller's. */
result_t peer_server_start(const peer_server_options_t *options, peer_server_t **server);
/* Ends the thread, closes the socket and sets *server to NULL. */
void peer_server_stop(peer_server_t **server);

/* ---- for the functions of the tables ---- */

/* Answers a message. `body` is the Lm__ struct of `kind`; `payload`, one or NULL, is consumed. */
void peer_reply(peer_server_t *server, const wire_message_t *message, Lm__Envelope__BodyCase kind, void *body,
                zmq_msg_t *payload);
void peer_refuse(peer_server_t *server, const wire_message_t *message, result_t reason);
/* The same for a message that is gone: its sender and its number (0: nobody asked). False when the peer is
 * gone or does not keep up. */
bool peer_send(peer_server_t *server, const identity_t *identity, uint64_t request,
               Lm__Envelope__BodyCase kind, void *body, zmq_msg_t *payload);
bool peer_send_refusal(peer_server_t *server, const identity_t *identity, uint64_t request, result_t reason);
/* What a peer is told of a failure: the same without the path of our data directory, with which it is in the
 * log then. Refusals have been through it. */
result_t peer_told(peer_server_t *server, result_t reason);
/* A warning that a peer can provoke, at most a few a second. */
void peer_complain(peer_server_t *server, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* Takes over the message that is being handled, to be freed with wire_free and free. */
wire_message_t *peer_keep(peer_server_t *server);
identity_t peer_identity(const wire_message_t *message);

#endif
