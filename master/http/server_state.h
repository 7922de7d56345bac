/* server_state: what the HTTP server is made of, for the files of this folder. */
#ifndef LIGHTMILL_HTTP_SERVER_STATE_H
#define LIGHTMILL_HTTP_SERVER_STATE_H

#include "master/http/access/guard.h"
#include "master/http/access/patience.h"
#include "master/http/access/tokens.h"
#include "master/http/events.h"
#include "master/http/pace.h"
#include "master/http/server.h"
#include "master/http/watch/tiles.h"

#include <pthread.h>

struct http_server {
    http_master_t master;
    struct MHD_Daemon *daemon;
    int listener;
    const char *data_dir; /* the caller's; nobody is told its path */
    char *url, *url_path;
    int url_lock;     /* of the file at url_path; -1: none */
    char *cert, *key; /* the texts of the files; NULL: no TLS */
    guard_t guard;
    http_tokens_t tokens;
    tiles_t *tiles;
    pace_t *pace;
    patience_t *patience;
    http_events_t *events;
    double started;
    int images, uploads;  /* requests for images, uploads; of the server's thread alone */
    pthread_mutex_t lock; /* guards what follows */
    pthread_cond_t idle;  /* `waiting` has fallen */
    int waiting;
    bool ending;
};

#endif
