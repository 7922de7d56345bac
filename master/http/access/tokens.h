/* tokens: the two secrets that open the HTTP server: DATA/keys/http, which only its owner can read.
 *
 *     view TOKEN        sees jobs, workers and images
 *     operate TOKEN     gives orders too
 *
 * A token is 256 random bits in hexadecimal. A client shows it in the header "Authorization: Bearer TOKEN".
 * To take tokens back, delete the file and start the master again. */
#ifndef LIGHTMILL_HTTP_TOKENS_H
#define LIGHTMILL_HTTP_TOKENS_H

#include "common/base.h"

/* What a request needs. Who has a right has those before it. */
typedef enum {
    HTTP_ANYBODY, /* no token: the page's files, and whether the master is alive */
    HTTP_VIEW,    /* see jobs, workers, images */
    HTTP_OPERATE  /* give orders */
} http_right_t;

enum { HTTP_TOKEN_TEXT = 64 };

typedef struct {
    char view[HTTP_TOKEN_TEXT + 1], operate[HTTP_TOKEN_TEXT + 1];
} http_tokens_t;

/* Reads the tokens; RESULT_INPUT, with the cure, when the file is missing or damaged. */
result_t http_tokens_read(const char *data_dir, http_tokens_t *tokens);
/* Reads them, or makes them where there are none. */
result_t http_tokens_load(const char *data_dir, http_tokens_t *tokens);
void http_tokens_forget(http_tokens_t *tokens);
/* The right of who shows this header (NULL: no header); the time it takes does not tell where a token is
 * wrong. */
http_right_t http_tokens_right(const http_tokens_t *tokens, const char *authorization);

#endif
