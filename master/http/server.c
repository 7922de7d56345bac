/* server: see server.h. */
#include "master/http/server.h"

#include "common/atomic_file.h"
#include "master/http/access/listen.h"
#include "master/http/routes.h"
#include "master/http/server_state.h"
#include "proto/wire/keys.h"

#include <errno.h>
#include <fcntl.h>
#include <sodium.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <unistd.h>

enum {
    CONNECTIONS = 1024,          /* at a time */
    CONNECTIONS_A_PEER = 160,    /* of them from one address, unless all come from this machine */
    IDLE = 30,                   /* seconds without a byte, after which a connection is closed */
    HEADERS = 30,                /* seconds in which a connection is to say what it wants */
    CONNECTION_BYTES = 32 << 10, /* for the headers of a request */
    MAX_PEM = 1 << 20            /* bytes of a file with certificates */
};

static const option_t rows[] = {
    OPTION(
        http_options_t, listen, "http", "[HOST:]PORT",
        "serve the page and its API there (default: not at all; HOST 127.0.0.1; port 0 chooses a free one); "
        "lightmill open shows the page"),
    OPTION_BY(option_list, http_options_t, hosts, "http-host", "NAME",
              "a further name by which browsers reach the page, without port; may be said more than once"),
    OPTION(http_options_t, cert, "http-cert", "FILE",
           "the certificate for https, in PEM; needed when other machines reach the page"),
    OPTION(http_options_t, key, "http-key", "FILE", "its key, in PEM"),
};
const option_group_t http_options = OPTION_GROUP("Page (docs/http.md)", rows);

/* ---- a request ----------------------------------------------------------------------------------------- */

static void refuse(http_request_t *request, unsigned status, const char *detail)
{
    request->then = NULL;
    http_reply_problem(request, status, detail);
}

/* Is it meant for us, is there such a thing, has its token the right? */
static bool admit(http_request_t *request, const char *method)
{
    const char *reason;
    unsigned missing = http_route_find(request, method);
    guard_request_t told = {.host = http_header(request, "Host"),
                            .origin = http_header(request, "Origin"),
                            .site = http_header(request, "Sec-Fetch-Site"),
                            .mode = http_header(request, "Sec-Fetch-Mode"),
                            .page = missing == 0 && request->route->right == HTTP_ANYBODY};
    unsigned status = guard_check(&request->server->guard, &told, &reason);
    http_right_t right = http_tokens_right(&request->server->tokens, http_header(request, "Authorization"));
    if (status != 0)
        refuse(request, status, reason);
    else if (missing == MHD_HTTP_NOT_FOUND)
        refuse(request, missing, "there is nothing at this path: see docs/openapi.yaml");
    else if (missing != 0)
        refuse(request, missing, "this path does not take that method");
    else if (right == HTTP_ANYBODY && request->route->right != HTTP_ANYBODY)
        refuse(request, MHD_HTTP_UNAUTHORIZED,
               "send a token of DATA/keys/http, as Authorization: Bearer TOKEN; lightmill open opens the "
               "page with it");
    else if (right < request->route->right)
        refuse(request, MHD_HTTP_FORBIDDEN, "this needs the token with the right to operate");
    else
        return true;
    return false;
}

static bool body_fits(http_request_t *request)
{
    const char *text = http_header(request, "Content-Length");
    uint64_t length;
    if (text == NULL || (http_number_parse(text, strlen(text), &length) && length <= HTTP_MAX_BODY))
        return true;
    refuse(request, MHD_HTTP_CONTENT_TOO_LARGE, "the body is too large");
    return false;
}

/* The headers are there: a refusal need not wait for the body. */
static enum MHD_Result begin(http_request_t *request, const char *method)
{
    if (!admit(request, method)) return request->answered;
    bool any_length = strcmp(request->route->method, MHD_HTTP_METHOD_PUT) == 0;
    if (!any_length && !body_fits(request)) return request->answered;
    request->answered = MHD_YES;
    if (any_length) request->route->handle(request);
    return request->answered;
}

/* A body without a length is read to its end, but not kept beyond what fits. */
static void take_body(http_request_t *request, const char *data, size_t size)
{
    if (size > HTTP_MAX_BODY - request->body_size) request->body_too_large = true;
    if (request->body_too_large) return;
    request->body = mem_realloc(request->body, request->body_size + size + 1);
    memcpy(request->body + request->body_size, data, size);
    request->body_size += size;
    request->body[request->body_size] = '\0';
}

static enum MHD_Result answer(http_request_t *request)
{
    void (*then)(http_request_t *) = request->then != NULL ? request->then : request->route->handle;
    request->then = NULL;
    if (request->body_too_large)
        refuse(request, MHD_HTTP_CONTENT_TOO_LARGE, "the body is too large");
    else
        then(request);
    return request->answered;
}

static patient_t *patient_of(struct MHD_Connection *connection)
{
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    return info != NULL ? info->socket_context : NULL;
}

static void on_connection(void *context, struct MHD_Connection *connection, void **state,
                          enum MHD_ConnectionNotificationCode what)
{
    http_server_t *server = context;
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    if (what == MHD_CONNECTION_NOTIFY_CLOSED)
        patience_gone(server->patience, *state);
    else if (info != NULL)
        *state = patience_begin(server->patience, info->connect_fd);
}

static enum MHD_Result on_request(void *context, struct MHD_Connection *connection, const char *url,
                                  const char *method, const char *version, const char *data, size_t *size,
                                  void **state)
{
    (void)version;
    http_request_t *request = *state;
    bool first = request == NULL;
    if (first) {
        http_server_t *server = context;
        *state = request = mem_zalloc(1, sizeof *request);
        *request = (http_request_t){.server = server, .master = &server->master, .connection = connection};
    }
    request->path = url;
    if (first) {
        patience_asked(request->server->patience, patient_of(connection));
        return begin(request, method);
    }
    if (*size == 0) return answer(request);
    request->answered = MHD_YES;
    if (request->take != NULL) {
        request->take(request, data, size);
        return request->answered;
    }
    take_body(request, data, *size);
    *size = 0;
    return MHD_YES;
}

static void on_end(void *context, struct MHD_Connection *connection, void **state,
                   enum MHD_RequestTerminationCode code)
{
    (void)code;
    http_request_t *request = *state;
    if (request == NULL) return;
    patience_answered(((http_server_t *)context)->patience, patient_of(connection));
    if (request->release != NULL) request->release(request);
    free(request->body);
    free(request);
    *state = NULL;
}

static void on_log(void *context, const char *format, va_list arguments)
    __attribute__((format(printf, 2, 0)));
static void on_log(void *context, const char *format, va_list arguments)
{
    (void)context;
    char text[400];
    vsnprintf(text, sizeof text, format, arguments);
    text[strcspn(text, "\r\n")] = '\0';
    log_debug("http: %s", text);
}

/* ---- starting ------------------------------------------------------------------------------------------ */

static result_t check_options(const http_options_t *options)
{
    if ((options->cert == NULL) != (options->key == NULL))
        return result_fail(RESULT_USAGE, "--http-cert and --http-key belong together");
    if (options->listen == NULL && (options->cert != NULL || options->hosts.count > 0))
        return result_fail(RESULT_USAGE, "--http-cert and --http-host need --http [HOST:]PORT");
    return result_ok();
}

static result_t read_pem(const char *path, char **text)
{
    uint8_t *bytes;
    size_t size;
    TRY(file_read(path, MAX_PEM, &bytes, &size));
    *text = mem_alloc(size + 1);
    memcpy(*text, bytes, size);
    (*text)[size] = '\0';
    sodium_memzero(bytes, size);
    free(bytes);
    return result_ok();
}

static result_t read_certificate(http_server_t *server, const http_options_t *options)
{
    if (options->cert == NULL) return result_ok();
    TRY(read_pem(options->cert, &server->cert));
    key_file_check_mode(options->key);
    return read_pem(options->key, &server->key);
}

/* "All addresses" are no host that a browser could name. */
static const char *bound_host(const address_t *address)
{
    bool all = strcmp(address->host, "0.0.0.0") == 0 || strcmp(address->host, "[::]") == 0;
    return all ? "localhost" : address->host;
}

/* The address for browsers; with a name that is said, since the certificate is for it. */
static char *make_url(const http_server_t *server, const http_options_t *options, const address_t *address)
{
    const char *host = options->hosts.count > 0 ? options->hosts.texts[0] : bound_host(address);
    return mem_printf("http%s://%s:%d/", server->cert != NULL ? "s" : "", host, address->port);
}

/* `exposed`: other machines reach it. Otherwise all come from one address, a proxy or the ends of tunnels,
 * and a limit for it would be one for all. */
static result_t start_daemon(http_server_t *server, const http_options_t *options, bool exposed)
{
    unsigned flags =
        MHD_USE_EPOLL_INTERNAL_THREAD | MHD_ALLOW_SUSPEND_RESUME | MHD_USE_ITC | MHD_USE_ERROR_LOG;
    struct MHD_OptionItem tls[] = {
        {MHD_OPTION_HTTPS_MEM_CERT, 0, server->cert},
        {MHD_OPTION_HTTPS_MEM_KEY, 0, server->key},
        {MHD_OPTION_HTTPS_PRIORITIES, 0, "NORMAL:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2"},
        {MHD_OPTION_END, 0, NULL}};
    if (server->cert == NULL) tls[0].option = MHD_OPTION_END;
    if (server->cert != NULL) flags |= MHD_USE_TLS;
    server->daemon = MHD_start_daemon(
        flags, 0, NULL, NULL, on_request, server, MHD_OPTION_EXTERNAL_LOGGER, on_log, NULL,
        MHD_OPTION_LISTEN_SOCKET, server->listener, MHD_OPTION_NOTIFY_COMPLETED, on_end, server,
        MHD_OPTION_NOTIFY_CONNECTION, on_connection, server, MHD_OPTION_CONNECTION_LIMIT,
        (unsigned)CONNECTIONS, MHD_OPTION_PER_IP_CONNECTION_LIMIT,
        exposed ? (unsigned)CONNECTIONS_A_PEER : (unsigned)CONNECTIONS, MHD_OPTION_CONNECTION_TIMEOUT,
        (unsigned)IDLE, MHD_OPTION_CONNECTION_MEMORY_LIMIT, (size_t)CONNECTION_BYTES, MHD_OPTION_ARRAY, tls,
        MHD_OPTION_END);
    if (server->daemon != NULL) return result_ok();
    if (server->cert == NULL) return result_fail(RESULT_LIMIT, "cannot start the HTTP server's thread");
    return result_fail(RESULT_INPUT,
                       "cannot serve https: are %.200s and %.200s a certificate and its key, in PEM?",
                       options->cert, options->key);
}

/* Writes the address down for lightmill open, in a file that stays locked while we serve it: one that was
 * left by a master that is gone is not. */
static result_t write_url(http_server_t *server)
{
    server->url_path = http_url_path(server->data_dir);
    char *line = mem_printf("%s\n", server->url);
    result_t result = file_write_atomic(server->url_path, line, strlen(line));
    free(line);
    TRY(result);
    server->url_lock = open(server->url_path, O_RDONLY | O_CLOEXEC);
    if (server->url_lock < 0 || flock(server->url_lock, LOCK_EX | LOCK_NB) != 0)
        log_warning("lightmill open will not find the page: cannot lock %s: %s", server->url_path,
                    strerror(errno));
    return result_ok();
}

bool http_url_is_served(int descriptor)
{
    if (flock(descriptor, LOCK_SH | LOCK_NB) != 0) return true;
    flock(descriptor, LOCK_UN);
    return false;
}

static result_t start(http_server_t *server, const http_options_t *options)
{
    http_listen_t listening;
    TRY(read_certificate(server, options));
    TRY(http_tokens_load(server->data_dir, &server->tokens));
    tiles_options_t tiles = {
        .farm = server->master.farm, .image_path = server->master.image_path, .data_dir = server->data_dir};
    TRY(tiles_start(&tiles, &server->tiles));
    TRY(patience_start(options->patience > 0 ? options->patience : HEADERS, &server->patience));
    TRY(pace_start(server->master.farm, &server->pace));
    TRY(http_events_start(server->master.farm, options->events_kept, &server->events));
    TRY(http_listen(options->listen, server->cert != NULL, &listening));
    server->listener = listening.socket;
    TRY(guard_init(&server->guard, bound_host(&listening.address), &options->hosts));
    server->url = make_url(server, options, &listening.address);
    TRY(start_daemon(server, options, listening.exposed));
    TRY(write_url(server));
    log_info("the page is at %s (lightmill open --data %s)", server->url, server->data_dir);
    return result_ok();
}

/* Takes apart whatever was put together. */
static void dismantle(http_server_t *server)
{
    http_events_end(server->events);
    pace_end(server->pace);
    if (server->daemon != NULL)
        MHD_stop_daemon(server->daemon); /* closes the listener */
    else if (server->listener >= 0)
        close(server->listener);
    http_events_free(&server->events);
    tiles_stop(&server->tiles);
    pace_free(&server->pace);
    patience_stop(&server->patience);
    if (server->url_path != NULL) unlink(server->url_path);
    if (server->url_lock >= 0) close(server->url_lock);
    if (server->key != NULL) sodium_memzero(server->key, strlen(server->key));
    http_tokens_forget(&server->tokens);
    guard_free(&server->guard);
    pthread_cond_destroy(&server->idle);
    pthread_mutex_destroy(&server->lock);
    free(server->cert);
    free(server->key);
    free(server->url);
    free(server->url_path);
    free(server);
}

result_t http_server_start(const http_options_t *options, const http_master_t *master, const char *data_dir,
                           http_server_t **out)
{
    *out = NULL;
    TRY(check_options(options));
    if (options->listen == NULL) return result_ok();
    http_server_t *server = mem_zalloc(1, sizeof *server);
    server->master = *master;
    server->listener = server->url_lock = -1;
    server->started = clock_now();
    server->data_dir = data_dir;
    pthread_mutex_init(&server->lock, NULL);
    pthread_cond_init(&server->idle, NULL);
    result_t result = start(server, options);
    if (result.code != RESULT_OK) dismantle(server);
    *out = result.code == RESULT_OK ? server : NULL;
    return result;
}

void http_server_stop(http_server_t **out)
{
    http_server_t *server = *out;
    if (server == NULL) return;
    pthread_mutex_lock(&server->lock);
    server->ending = true;
    pthread_mutex_unlock(&server->lock);
    pace_end(server->pace); /* what waits for its turn goes on */
    pthread_mutex_lock(&server->lock);
    while (server->waiting > 0) pthread_cond_wait(&server->idle, &server->lock);
    pthread_mutex_unlock(&server->lock);
    dismantle(server);
    *out = NULL;
}

const char *http_server_url(const http_server_t *server)
{
    return server->url;
}

char *http_url_path(const char *data_dir)
{
    return mem_printf("%s/http", data_dir);
}
