/* routes: see routes.h. */
#include "master/http/routes.h"

#include "master/http/files.h"

#include <stdio.h>
#include <string.h>

static const http_table_t *const tables[] = {&http_report_routes, &http_order_routes, &http_metrics_routes,
                                             &http_tile_routes, &http_image_routes};

static void serve_file(http_request_t *request)
{
    if (!http_files_serve(request)) http_reply_problem(request, MHD_HTTP_NOT_FOUND, "there is no such file");
}

static const http_route_t file_route = {"GET", "", HTTP_ANYBODY, serve_file};

/* Does the path fit the pattern? Each "#" takes a whole number from 1. */
static bool fits(const char *pattern, const char *path, uint64_t numbers[HTTP_MAX_NUMBERS])
{
    for (size_t count = 0; *pattern != '\0'; pattern++) {
        if (*pattern != '#') {
            if (*path++ != *pattern) return false;
            continue;
        }
        size_t length = strspn(path, "0123456789");
        if (count == HTTP_MAX_NUMBERS || !http_number_parse(path, length, &numbers[count]) ||
            numbers[count] == 0)
            return false;
        count++;
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
            if (fits(route->path, request->path, request->numbers) && try_route(request, route, method))
                return 0;
        }
    if (http_files_have(request->path) && try_route(request, &file_route, method)) return 0;
    return request->allowed[0] != '\0' ? MHD_HTTP_METHOD_NOT_ALLOWED : MHD_HTTP_NOT_FOUND;
}
