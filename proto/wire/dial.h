/* dial: the keys with which a worker or a client dials a master, and how dialling ends.
 *
 * To another machine nobody dials without keys, unless told to with --insecure. To loopback keys are used
 * when they are given. Keys that came from files are read again for every connection, so that a key can be
 * exchanged while the program runs.
 */
#ifndef LIGHTMILL_DIAL_H
#define LIGHTMILL_DIAL_H

#include "common/options/options.h"
#include "proto/wire/keys.h"

/* What the command line says; the rest comes from the environment and from ~/.config/lightmill. */
typedef struct {
    const char *role;       /* "worker" or "client": the default key is ROLE.secret */
    const char *key;        /* the .secret file of the own key; NULL: not said */
    const char *master_key; /* the master's public key, or a file that holds it; NULL: not said */
    bool insecure;          /* no keys */
} dial_options_t;
extern const option_group_t dial_options;

/* The keys of one side of a connection. A copy shares the paths with its original and must not outlive it. */
typedef struct {
    bool used; /* false: without keys, and nothing else holds */
    key_pair_t own;
    char master[KEY_TEXT + 1];
    char *own_path, *master_path; /* files to read again; NULL: the key was given itself */
} dial_keys_t;

/* Finds the keys for a master on `host`. RESULT_DENIED says what is missing and how to get it. */
result_t dial_keys_find(const dial_options_t *options, const char *host, dial_keys_t *keys);
/* The endpoint of the master at `address`, "HOST[:PORT]" (NULL: this machine), and the keys for it. The
 * caller frees *endpoint, which is NULL on failure, and the keys. */
result_t dial_find(const dial_options_t *options, const char *address, dial_keys_t *keys, char **endpoint);
/* Gives the keys to a socket that is about to connect, as the files hold them now; a file that cannot be read
 * any more is worth a warning, and the key that it held before is used. `keys` NULL or not used: nothing is
 * done. */
result_t dial_keys_apply(dial_keys_t *keys, void *socket);
void dial_keys_free(dial_keys_t *keys);

/* Watches the handshakes of a socket that connects. The thread that owns the socket makes all calls. */
typedef struct {
    void *monitor;          /* NULL: not watching */
    char key[KEY_TEXT + 1]; /* the own public key; empty: without keys */
    unsigned broken;        /* handshakes that broke off since the last good one */
    bool up;                /* the last handshake was good, and the connection has not broken since */
    unsigned lost;          /* connections that broke after a good handshake */
    bool denied;            /* the master said no, and this socket will not dial again */
    result_t verdict;
} dial_watch_t;

/* Begins, before the socket connects with these keys (NULL: none). */
result_t dial_watch_open(dial_watch_t *watch, void *context, void *socket, const dial_keys_t *keys);
/* Takes in what happened and gives its verdict: RESULT_OK when nothing speaks against the connection;
 * RESULT_DENIED when the master does not accept us and this socket will not dial again; RESULT_UNREACHABLE,
 * with the likely reason, when handshakes break off but are tried again. To be called again and again while
 * the socket lives: libzmq holds some thousand events, and then its threads wait. */
result_t dial_watch_poll(dial_watch_t *watch);
/* Ends; before the socket is closed. Harmless when it never began. */
void dial_watch_close(dial_watch_t *watch, void *socket);

#endif
