/* http_client: requests to an HTTP server on loopback, byte for byte as a test says. Calls end the test when
 * there is no connection or no answer within seconds. */
#ifndef LIGHTMILL_TESTS_HTTP_CLIENT_H
#define LIGHTMILL_TESTS_HTTP_CLIENT_H

#include <jansson.h>
#include <stddef.h>

typedef struct {
    int status;
    char *head;  /* status line and headers */
    char *body;  /* ends with '\0' */
    size_t size; /* of the body, bytes */
} http_answer_t;

/* Sends "METHOD PATH HTTP/1.1", these lines (each with "\r\n"; NULL: none), the length of the body (NULL: no
 * body), and waits for the answer. There is no Host but what the lines say. */
http_answer_t http_ask_raw(int port, const char *method, const char *path, const char *lines,
                           const char *body);
/* The same with "Host: 127.0.0.1:PORT", and with the token unless it is NULL. */
http_answer_t http_ask(int port, const char *method, const char *path, const char *token, const char *body);
void http_answer_free(http_answer_t *answer);
/* The status alone. */
int http_status_of(http_answer_t answer);
/* The body as JSON, which the caller frees with json_decref; the answer must have this status. Frees the
 * answer. */
json_t *http_json_of(http_answer_t answer, int status);

/* Sends bytes and keeps the connection; the caller closes it. */
int http_open(int port, const char *bytes);
/* Reads until `text` has come, at most so long; fresh memory with all that came. NULL: it has not. */
char *http_read_until(int connection, const char *text, double seconds);

#endif
