/* request: what a handler of the HTTP server sees of a request, and how it answers.
 *
 * Handlers run on the server's one thread and answer at once, from memory: one that would have to wait for
 * another thread calls http_wait, and goes on when that thread calls http_go. Every handler ends with one of
 * the calls http_reply... or http_wait. */
#ifndef LIGHTMILL_HTTP_REQUEST_H
#define LIGHTMILL_HTTP_REQUEST_H

#include "master/http/access/tokens.h"
#include "master/http/master_calls.h"
#include "master/http/parse/fields.h"

#include <microhttpd.h>

enum {
    HTTP_MAX_NUMBERS = 4,    /* in a path */
    HTTP_MAX_BODY = 4 << 10, /* bytes */
    HTTP_MAX_UPLOADS = 8,    /* at a time */
    HTTP_MAX_IMAGES = 32,    /* requests that wait for an image, or read one */
    HTTP_MAX_WAITING = 256   /* requests that wait for another thread */
};

typedef struct http_server http_server_t;
typedef struct http_request http_request_t;

/* A kind of request. In the path a segment "#" stands for a whole number from 1, which is in
 * request->numbers, and a segment "@" for a hash, in request->hash. GET answers HEAD too. The handler of a
 * PUT is called before the body, which may have any length: it answers, or sets request->take and
 * request->then. */
typedef struct {
    const char *method, *path;
    http_right_t right;
    void (*handle)(http_request_t *request);
} http_route_t;
typedef struct {
    const http_route_t *routes;
    size_t count;
} http_table_t;

struct http_request {
    http_server_t *server;
    const http_master_t *master;
    struct MHD_Connection *connection;
    const http_route_t *route;
    const char *path; /* of the URL; during the handler's call only */
    uint64_t numbers[HTTP_MAX_NUMBERS];
    hash_t hash;
    /* Takes bytes of a body as they come, *size of them; leaves in *size how many it could not take, which
     * come again. NULL: the body is collected. */
    void (*take)(http_request_t *request, const char *bytes, size_t *size);
    char *body; /* ends with '\0'; NULL: there is none */
    size_t body_size;
    bool body_too_large;
    char location[40]; /* where what was made is; empty: nothing was */
    char allowed[32];  /* the methods of this path, when the request's is none of them */
    void (*then)(
        http_request_t *request); /* of http_wait, or what follows the body of a PUT; NULL: the handler */
    result_t result;              /* for `then`: what the other thread found, */
    uint64_t value;               /* and a number of it */
    void *own;                    /* the handler's, */
    void (*release)(http_request_t *request); /* which frees it when the request has ended; NULL: nothing */
    enum MHD_Result answered;
};

/* ---- what was asked ------------------------------------------------------------------------------------ */

/* A header of the request; NULL when there is none. */
const char *http_header(const http_request_t *request, const char *name);
/* RESULT_USAGE when the query has another parameter than these; NULL ends them. */
result_t http_query_only(const http_request_t *request, const char *const names[]);
/* A parameter of the query ("?level=3"); NULL when there is none. */
const char *http_query(const http_request_t *request, const char *name);
/* The same as a whole number from `least` to `most`, or `missing` when there is none. RESULT_USAGE names the
 * range. */
result_t http_query_number(const http_request_t *request, const char *name, uint64_t least, uint64_t most,
                           uint64_t missing, uint64_t *value);
/* The body as a JSON object, which the caller frees; an empty body is an empty object. RESULT_USAGE says
 * where it is wrong. */
result_t http_body_object(const http_request_t *request, json_t **object);

/* ---- answers ------------------------------------------------------------------------------------------- */

/* Bytes in memory, which are copied, freed with free(), or stay, as `mode` says. */
void http_reply(http_request_t *request, unsigned status, const char *type, void *bytes, size_t size,
                enum MHD_ResponseMemoryMode mode);
/* Bytes that stay, with an ETag; a client that has them already gets 304 without them. `etag` has its quotes.
 */
void http_reply_tagged(http_request_t *request, const char *type, const char *etag, const void *bytes,
                       size_t size);
/* True, and answered with 304, when the client has what `etag` names. */
bool http_reply_unchanged(http_request_t *request, const char *etag);
/* JSON in one line; frees the object. */
void http_reply_json(http_request_t *request, unsigned status, json_t *object);
/* An error as application/problem+json (RFC 9457); `detail` says what is wrong and what helps. */
void http_reply_problem(http_request_t *request, unsigned status, const char *detail);
/* The same for a failure; the status follows from its code. */
void http_reply_failure(http_request_t *request, const result_t *failure);
/* A response that the caller made, which is taken over; NULL: memory ran out. */
void http_reply_response(http_request_t *request, unsigned status, const char *type,
                         struct MHD_Response *response);

/* ---- answers that take a while ------------------------------------------------------------------------- */

/* Puts the request aside until http_go, after which `then` is called on the server's thread. To be called
 * before the other thread is asked. False, and answered with 503, when too many wait or the server ends. */
bool http_wait(http_request_t *request, void (*then)(http_request_t *request));
/* Goes on with a request that waits, once; it belongs to the server's thread again. From any thread. */
void http_go(http_request_t *request);

#endif
