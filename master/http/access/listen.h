/* listen: the socket at which the HTTP server listens. */
#ifndef LIGHTMILL_HTTP_LISTEN_H
#define LIGHTMILL_HTTP_LISTEN_H

#include "common/address.h"

typedef struct {
    address_t address; /* as it was written, with the port that it got */
    int socket;
    bool exposed; /* other machines reach it */
} http_listen_t;

/* Binds "[HOST:]PORT" (HOST 127.0.0.1 by default, PORT 0 for a free one). `secured`: there is TLS; without it
 * RESULT_USAGE for an address that other machines reach. */
result_t http_listen(const char *text, bool secured, http_listen_t *listening);

#endif
