/* server: the master's HTTP server: the page, the API that it uses, and what monitoring asks for
 * (docs/http.md).
 *
 * DESIGN. libmicrohttpd on one thread of its own with epoll. A request is looked at in this order: is it
 * meant for this host (guard.h), does it come from a page of ours, is there such a path (the tables of
 * routes), does its token have the right (tokens.h). Then its handler answers from memory (request.h).
 * Nothing is carried by cookies, so no other web site can use the rights of who looks at it.
 */
#ifndef LIGHTMILL_HTTP_SERVER_H
#define LIGHTMILL_HTTP_SERVER_H

#include "common/options/options.h"
#include "master/http/request.h"

typedef struct {
    const char *listen;     /* "[HOST:]PORT"; NULL: no server */
    option_list_t hosts;    /* further names by which it is reached */
    const char *cert, *key; /* files in PEM; NULL: no TLS */
    double patience;        /* seconds for the headers of a request (patience.h); 0: as long as usual */
    uint32_t events_kept;   /* for who comes back; 0: as many as usual */
} http_options_t;
extern const option_group_t http_options;

/* Makes the tokens if there are none, writes to DATA/http where the page is, and starts the thread. *server
 * is NULL, and nothing is done, without options->listen. RESULT_USAGE when it would be reached from other
 * machines without TLS. `master` is copied, what it points to is kept by the caller, and so is
 * `data_dir`. */
result_t http_server_start(const http_options_t *options, const http_master_t *master, const char *data_dir,
                           http_server_t **server);
/* Ends all requests, joins the thread, removes DATA/http and sets *server to NULL. What carries out calls of
 * http_master_t must still run. */
void http_server_stop(http_server_t **server);
/* "http://127.0.0.1:7480/". */
const char *http_server_url(const http_server_t *server);

/* The file that says where the page is, in fresh memory. */
char *http_url_path(const char *data_dir);
/* False when the file, of which the caller has a descriptor, was left by a master that is gone. */
bool http_url_is_served(int descriptor);

#endif
