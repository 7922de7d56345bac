/* routes: see routes.h. */
#include "master/http/routes.h"

#include "master/http/files.h"

#include <stdio.h>
#include <string.h>

static const http_table_t *const tables[] = {&http_report_routes, &http_order_routes, &http_metrics_routes,
                                             &http_tile_routes,   &http_image_routes, &http_upload_routes};

static void serve_file(http_request_t *request)
{
    if (!http_files_serve(request)) http_reply_problem(request, MHD_HTTP_NOT_FOUND, "there is no such file");
}

static const http_route_t file_route = {"GET", "", HTTP_ANYBODY, serve_file};

/* The length of a number, from 1, at the beginning of the text, or of a hash; 0 when there is none. */
static size_t take_number(http_request_t *request, size_t count, const char *text)
{
    size_t length = strspn(text, "0123456789");
    uint64_t *number = &request->numbers[count];
    return count < HTTP_MAX_NUMBERS && http_number_parse(text, length, number) && *number != 0 ? length : 0;
}

static size_t take_hash(http_request_t *request, const char *text)
{
    size_t length = strspn(text, "0123456789abcdef");
    return hash_from_hex(text, length, &request->hash) ? length : 0;
}

/* Does the request's path fit the pattern? */
static bool fits(const char *pattern, http_request_t *request)
{
    const char *path = request->path;
    for (size_t count = 0; *pattern != '\0'; pattern++) {
        bool number = *pattern == '#', hash = *pattern == '@';
        size_t length = number ? take_number(request, count++, path)
                        : hash ? take_hash(request, path)
                               : (size_t)(*path == *pattern);
        if (length == 0) return false;
        path += length;
    }
    return *path == '\0';
}

static bool takes(const http_route_t *route, const char *method)
{
    return strcmp(route->method, method) == 0 ||
           (strcmp(method, "HEAD") == 0 && strcmp(route->method, "GET") == 0);
}

/* Looks at one route whose path may be the request's. */
static bool try_route(http_request_t *request, const http_route_t *route, const char *method)
{
    if (takes(route, method)) {
        request->route = route;
        return true;
    }
    size_t used = strlen(request->allowed);
    snprintf(request->allowed + used, sizeof request->allowed - used, "%s%s", used > 0 ? ", " : "",
             route->method);
    return false;
}

unsigned http_route_find(http_request_t *request, const char *method)
{
    for (size_t t = 0; t < ARRAY_LENGTH(tables); t++)
        for (size_t r = 0; r < tables[t]->count; r++) {
            const http_route_t *route = &tables[t]->routes[r];
            if (fits(route->path, request) && try_route(request, route, method)) return 0;
        }
    if (http_files_have(request->path) && try_route(request, &file_route, method)) return 0;
    return request->allowed[0] != '\0' ? MHD_HTTP_METHOD_NOT_ALLOWED : MHD_HTTP_NOT_FOUND;
}
