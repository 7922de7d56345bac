/* request: see request.h. */
#include "master/http/request.h"

#include "common/own_directory.h"
#include "master/http/server_state.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

/* ---- what was asked ------------------------------------------------------------------------------------ */

const char *http_header(const http_request_t *request, const char *name)
{
    return MHD_lookup_connection_value(request->connection, MHD_HEADER_KIND, name);
}

const char *http_query(const http_request_t *request, const char *name)
{
    return MHD_lookup_connection_value(request->connection, MHD_GET_ARGUMENT_KIND, name);
}

typedef struct {
    const char *const *names;
    const char *unknown; /* NULL: none so far */
} known_t;

static enum MHD_Result check_name(void *context, enum MHD_ValueKind kind, const char *name, const char *value)
{
    known_t *known = context;
    (void)kind, (void)value;
    const char *const *at = known->names;
    while (*at != NULL && strcmp(*at, name) != 0) at++;
    if (*at == NULL) known->unknown = name;
    return *at == NULL ? MHD_NO : MHD_YES;
}

result_t http_query_only(const http_request_t *request, const char *const names[])
{
    known_t known = {names, NULL};
    MHD_get_connection_values(request->connection, MHD_GET_ARGUMENT_KIND, check_name, &known);
    if (known.unknown == NULL) return result_ok();
    return result_fail(RESULT_USAGE, "there is no '%.60s' to ask for here", known.unknown);
}

result_t http_query_number(const http_request_t *request, const char *name, uint64_t least, uint64_t most,
                           uint64_t missing, uint64_t *value)
{
    const char *text = http_query(request, name);
    *value = missing;
    if (text == NULL) return result_ok();
    if (http_number_parse(text, strlen(text), value) && *value >= least && *value <= most) return result_ok();
    return result_fail(RESULT_USAGE, "%s is a whole number from %" PRIu64 " to %" PRIu64 ", not '%.60s'",
                       name, least, most, text);
}

result_t http_body_object(const http_request_t *request, json_t **object)
{
    return body_parse(request->body, request->body_size, object);
}

/* ---- answers ------------------------------------------------------------------------------------------- */

/* The page may load what this server gives out, nothing else, and be framed by nobody. */
static const struct {
    const char *name, *value;
} security_headers[] = {
    {"Content-Security-Policy",
     "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
     "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"},
    {"X-Content-Type-Options", "nosniff"},
    {"Cross-Origin-Resource-Policy", "same-origin"},
    {"Cross-Origin-Opener-Policy", "same-origin"},
    {"Referrer-Policy", "no-referrer"},
};

/* The page's files may be kept, if they are asked for again each time; what the token protects may not. */
static const char *cache_control(const http_request_t *request)
{
    return request->route == NULL || request->route->right != HTTP_ANYBODY ? "no-store" : "no-cache";
}

void http_reply_response(http_request_t *request, unsigned status, const char *type,
                         struct MHD_Response *response)
{
    request->answered = MHD_NO; /* the connection is closed */
    if (response == NULL) return;
    for (size_t i = 0; i < ARRAY_LENGTH(security_headers); i++)
        MHD_add_response_header(response, security_headers[i].name, security_headers[i].value);
    MHD_add_response_header(response, MHD_HTTP_HEADER_CACHE_CONTROL, cache_control(request));
    if (type != NULL) MHD_add_response_header(response, MHD_HTTP_HEADER_CONTENT_TYPE, type);
    if (request->location[0] != '\0')
        MHD_add_response_header(response, MHD_HTTP_HEADER_LOCATION, request->location);
    request->answered = MHD_queue_response(request->connection, status, response);
    MHD_destroy_response(response);
}

void http_reply(http_request_t *request, unsigned status, const char *type, void *bytes, size_t size,
                enum MHD_ResponseMemoryMode mode)
{
    http_reply_response(request, status, type, MHD_create_response_from_buffer(size, bytes, mode));
}

bool http_reply_unchanged(http_request_t *request, const char *etag)
{
    const char *known = http_header(request, MHD_HTTP_HEADER_IF_NONE_MATCH);
    if (known == NULL || strcmp(known, etag) != 0) return false;
    struct MHD_Response *response = MHD_create_response_from_buffer(0, "", MHD_RESPMEM_PERSISTENT);
    if (response != NULL) MHD_add_response_header(response, MHD_HTTP_HEADER_ETAG, etag);
    http_reply_response(request, MHD_HTTP_NOT_MODIFIED, NULL, response);
    return true;
}

void http_reply_tagged(http_request_t *request, const char *type, const char *etag, const void *bytes,
                       size_t size)
{
    if (http_reply_unchanged(request, etag)) return;
    struct MHD_Response *response =
        MHD_create_response_from_buffer(size, (void *)bytes, MHD_RESPMEM_PERSISTENT);
    if (response != NULL) MHD_add_response_header(response, MHD_HTTP_HEADER_ETAG, etag);
    http_reply_response(request, MHD_HTTP_OK, type, response);
}

static void reply_object(http_request_t *request, unsigned status, const char *type, json_t *object)
{
    char *text = json_dumps(object, JSON_COMPACT | JSON_REAL_PRECISION(15));
    json_decref(object);
    if (text == NULL) text = mem_strdup("{}");
    http_reply(request, status, type, text, strlen(text), MHD_RESPMEM_MUST_FREE);
}

void http_reply_json(http_request_t *request, unsigned status, json_t *object)
{
    reply_object(request, status, "application/json", object);
}

static const char *status_title(unsigned status)
{
    const char *title = MHD_get_reason_phrase_for(status);
    return title != NULL ? title : "Error";
}

/* What else a refusal is to say. */
static void add_remedy(const http_request_t *request, unsigned status, struct MHD_Response *response)
{
    if (status == MHD_HTTP_UNAUTHORIZED)
        MHD_add_response_header(response, MHD_HTTP_HEADER_WWW_AUTHENTICATE, "Bearer realm=\"lightmill\"");
    if (status == MHD_HTTP_SERVICE_UNAVAILABLE)
        MHD_add_response_header(response, MHD_HTTP_HEADER_RETRY_AFTER, "1");
    if (status == MHD_HTTP_METHOD_NOT_ALLOWED && request->allowed[0] != '\0')
        MHD_add_response_header(response, MHD_HTTP_HEADER_ALLOW, request->allowed);
}

void http_reply_problem(http_request_t *request, unsigned status, const char *detail)
{
    json_t *object = json_object();
    put_text(object, "type", "about:blank");
    put_text(object, "title", status_title(status));
    put_count(object, "status", status);
    char *told = mem_strdup(detail);
    if (own_directory_hide(request->server->data_dir, told)) log_warning("%s", detail);
    put_text(object, "detail", told);
    free(told);
    char *text = json_dumps(object, JSON_COMPACT);
    json_decref(object);
    struct MHD_Response *response =
        text == NULL ? NULL : MHD_create_response_from_buffer(strlen(text), text, MHD_RESPMEM_MUST_FREE);
    if (response != NULL) add_remedy(request, status, response);
    http_reply_response(request, status, "application/problem+json", response);
}

void http_reply_failure(http_request_t *request, const result_t *failure)
{
    static const unsigned statuses[] = {[RESULT_USAGE] = MHD_HTTP_BAD_REQUEST,
                                        [RESULT_INPUT] = MHD_HTTP_CONFLICT,
                                        [RESULT_IO] = MHD_HTTP_INTERNAL_SERVER_ERROR,
                                        [RESULT_LIMIT] = MHD_HTTP_SERVICE_UNAVAILABLE,
                                        [RESULT_DENIED] = MHD_HTTP_FORBIDDEN};
    unsigned status = (size_t)failure->code < ARRAY_LENGTH(statuses) ? statuses[failure->code] : 0;
    http_reply_problem(request, status != 0 ? status : MHD_HTTP_INTERNAL_SERVER_ERROR, failure->message);
}

/* ---- answers that take a while ------------------------------------------------------------------------- */

bool http_wait(http_request_t *request, void (*then)(http_request_t *request))
{
    http_server_t *server = request->server;
    pthread_mutex_lock(&server->lock);
    bool room = !server->ending && server->waiting < HTTP_MAX_WAITING;
    if (room) server->waiting++;
    pthread_mutex_unlock(&server->lock);
    if (!room) {
        http_reply_problem(request, MHD_HTTP_SERVICE_UNAVAILABLE,
                           "too many requests wait for their answers already, or the master ends: try again");
        return false;
    }
    request->then = then;
    request->answered = MHD_YES;
    MHD_suspend_connection(request->connection);
    return true;
}

void http_go(http_request_t *request)
{
    http_server_t *server = request->server;
    MHD_resume_connection(request->connection);
    pthread_mutex_lock(&server->lock);
    server->waiting--;
    pthread_cond_broadcast(&server->idle);
    pthread_mutex_unlock(&server->lock);
}
