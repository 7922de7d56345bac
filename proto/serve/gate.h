/* gate: who may speak to the master, and what about.
 *
 * On an address that other machines reach, the master's sockets use CURVE: connections are encrypted, peers
 * know the master's public key beforehand, and the master admits the keys of its list only (allow_list.h).
 * The list is read again when its file changes; what a connected peer may do is looked up in the list as it
 * is at every message, so a key that is taken out loses its rights at once.
 *
 * With keys and without, it ends connections that libzmq would let take memory, or a place, for ever
 * (connections.h). */
#ifndef LIGHTMILL_GATE_H
#define LIGHTMILL_GATE_H

#include "common/options/options.h"
#include "proto/serve/connections.h"
#include "proto/wire/wire.h"

typedef struct {
    const char *key;   /* the master's .secret file; NULL: DATA/keys/master.secret, made when it is needed */
    const char *allow; /* the list; NULL: DATA/keys/allow */
    bool insecure;     /* no keys on any address */
    bool relay;        /* it is a relay's, which workers alone dial */
} gate_options_t;

extern const option_group_t gate_options; /* of a master */

typedef struct gate gate_t;

/* Reads (or makes) key and list when an endpoint of the master can be reached from other machines (`exposed`)
 * or a key was given, and gets ready to be asked by the sockets of the context. */
result_t gate_new(const gate_options_t *options, const char *data_dir, void *context, bool exposed,
                  gate_t **gate);
/* Gives a socket that is about to be bound to TCP the master's key, if keys are used, and watches its
 * connections; `name` is for the log. At most two sockets. */
result_t gate_guard(gate_t *gate, void *socket, const char *name, const connection_limits_t *limits);
/* Starts the thread that admits connections and watches them, and says for people which key this master has
 * and, when it is new, what to do with it. `host` and `port` are where it listens. */
result_t gate_start(gate_t *gate, const char *host, int port);
/* Ends the thread and frees everything; after the sockets that it guards were closed. Sets *gate to NULL. */
void gate_stop(gate_t **gate);

/* Reads the list again, soon. From any thread. */
void gate_reload(gate_t *gate);

/* A message was taken from a connection (wire_message_t.connection), well-formed or not. From any thread;
 * `gate` NULL, and connections of -1, are allowed here and below. */
void gate_heard(gate_t *gate, int connection);
/* Messages from it may have so many bytes more than the limit of its socket, from now on. */
void gate_expect(gate_t *gate, int connection, uint64_t bytes);

/* Says what the sender may do now, in message->rights, and whether that covers what the message needs (0:
 * nothing but a key on the list): else RESULT_DENIED with the reason. From any thread. `gate` NULL: everybody
 * may do everything. */
result_t gate_check(gate_t *gate, wire_message_t *message, unsigned needed);
/* The name that the list has for a key; "" when it has none. From any thread. */
void gate_key_name(gate_t *gate, const char *key, char name[KEY_MAX_NAME + 1]);
/* The key that the list has under a name; false when there is none. Likewise. */
bool gate_find_key(gate_t *gate, const char *name, char key[KEY_TEXT + 1]);

#endif
