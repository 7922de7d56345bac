/* http_client: see http_client.h. */
#include "tests/http_client.h"

#include "common/base.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const double ANSWER_SECONDS = 20;

int http_open(int port, const char *bytes)
{
    struct sockaddr_in address = {
        .sin_family = AF_INET, .sin_port = htons((uint16_t)port), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int connection = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (connect(connection, (struct sockaddr *)&address, sizeof address) != 0)
        fail_msg("nobody listens at port %d", port);
    send(connection, bytes, strlen(bytes), MSG_NOSIGNAL);
    return connection;
}

/* Reads more into the text, which grows; false at the end or when the time is over. */
static bool read_more(int connection, double deadline, char **text, size_t *size)
{
    struct pollfd wait = {.fd = connection, .events = POLLIN};
    double left = deadline - clock_now();
    if (left <= 0 || poll(&wait, 1, (int)(1e3 * left) + 1) <= 0) return false;
    *text = mem_realloc(*text, *size + 65536 + 1);
    ssize_t got = read(connection, *text + *size, 65536);
    if (got <= 0) return false;
    *size += (size_t)got;
    (*text)[*size] = '\0';
    return true;
}

char *http_read_until(int connection, const char *wanted, double seconds)
{
    char *text = mem_strdup("");
    size_t size = 0;
    double deadline = clock_now() + seconds;
    while (strstr(text, wanted) == NULL)
        if (!read_more(connection, deadline, &text, &size)) {
            free(text);
            return NULL;
        }
    return text;
}

http_answer_t http_ask_raw(int port, const char *method, const char *path, const char *lines,
                           const char *body)
{
    char *length = body != NULL ? mem_printf("Content-Length: %zu\r\n", strlen(body)) : mem_strdup("");
    char *bytes = mem_printf("%s %s HTTP/1.1\r\n%sConnection: close\r\n%s\r\n%s", method, path,
                             lines ? lines : "", length, body ? body : "");
    int connection = http_open(port, bytes);
    char *text = mem_strdup("");
    size_t size = 0;
    for (double deadline = clock_now() + ANSWER_SECONDS; read_more(connection, deadline, &text, &size);)
        continue;
    close(connection);
    free(bytes);
    free(length);
    http_answer_t answer = {0};
    char *end = strstr(text, "\r\n\r\n");
    if (end == NULL || sscanf(text, "HTTP/1.1 %d", &answer.status) != 1)
        fail_msg("%s %s: no answer: '%s'", method, path, text);
    *end = '\0';
    answer.head = mem_strdup(text);
    answer.size = size - (size_t)(end + 4 - text);
    answer.body = mem_alloc(answer.size + 1);
    memcpy(answer.body, end + 4, answer.size);
    answer.body[answer.size] = '\0';
    free(text);
    return answer;
}

http_answer_t http_ask(int port, const char *method, const char *path, const char *token, const char *body)
{
    char *lines = token == NULL
                      ? mem_printf("Host: 127.0.0.1:%d\r\n", port)
                      : mem_printf("Host: 127.0.0.1:%d\r\nAuthorization: Bearer %s\r\n", port, token);
    http_answer_t answer = http_ask_raw(port, method, path, lines, body);
    free(lines);
    return answer;
}

void http_answer_free(http_answer_t *answer)
{
    free(answer->head);
    free(answer->body);
    *answer = (http_answer_t){0};
}

int http_status_of(http_answer_t answer)
{
    int status = answer.status;
    http_answer_free(&answer);
    return status;
}

json_t *http_json_of(http_answer_t answer, int status)
{
    if (answer.status != status) fail_msg("%s\n%s", answer.head, answer.body);
    json_error_t error;
    json_t *object = json_loads(answer.body, 0, &error);
    if (object == NULL) fail_msg("%s in: %s", error.text, answer.body);
    http_answer_free(&answer);
    return object;
}
