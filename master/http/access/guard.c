/* guard: see guard.h. */
#include "master/http/access/guard.h"

#include "common/address.h"

#include <ctype.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* ---- the names ----------------------------------------------------------------------------------------- */

static void add_name(guard_t *guard, const char *name)
{
    guard->names = mem_realloc(guard->names, (guard->count + 1) * sizeof *guard->names);
    guard->names[guard->count++] = mem_strdup(name);
}

result_t guard_init(guard_t *guard, const char *bound, const option_list_t *names)
{
    *guard = (guard_t){0};
    add_name(guard, "localhost");
    add_name(guard, "127.0.0.1");
    add_name(guard, "[::1]");
    add_name(guard, bound);
    for (size_t i = 0; i < names->count; i++) {
        address_t address;
        if (address_parse(names->texts[i], 1, &address).code != RESULT_OK ||
            strcmp(address.host, names->texts[i]) != 0)
            return result_fail(RESULT_USAGE,
                               "--http-host takes a name as in the browser's address, without port: '%.200s'",
                               names->texts[i]);
        add_name(guard, address.host);
    }
    return result_ok();
}

void guard_free(guard_t *guard)
{
    for (size_t i = 0; i < guard->count; i++) free(guard->names[i]);
    free(guard->names);
    *guard = (guard_t){0};
}

/* ---- the checks ---------------------------------------------------------------------------------------- */

/* The length of the name in "name", "name:80", "[v6]:80"; 0 when it is none of these. */
static size_t name_length(const char *host)
{
    size_t length = host[0] == '[' ? strcspn(host, "]") + 1 : strcspn(host, ":");
    if (host[0] == '[' && host[length - 1] != ']') return 0;
    const char *rest = host + length;
    if (*rest == '\0') return length;
    if (*rest != ':' || rest[1] == '\0' || rest[1 + strspn(rest + 1, "0123456789")] != '\0') return 0;
    return length;
}

static bool is_known(const guard_t *guard, const char *host)
{
    size_t length = name_length(host);
    for (size_t i = 0; length > 0 && i < guard->count; i++)
        if (strlen(guard->names[i]) == length && strncasecmp(guard->names[i], host, length) == 0) return true;
    return false;
}

/* "https://farm.example:8443" against the Host "farm.example:8443". */
static bool same_origin(const char *origin, const char *host)
{
    if (strncmp(origin, "http://", 7) == 0) return strcasecmp(origin + 7, host) == 0;
    return strncmp(origin, "https://", 8) == 0 && strcasecmp(origin + 8, host) == 0;
}

/* A browser that follows a link or reads an address bar asks for a page; any other request of a foreign site
 * is a script's, an image's or a frame's. */
static bool is_foreign(const guard_request_t *request)
{
    if (request->origin != NULL && !same_origin(request->origin, request->host)) return true;
    if (request->site == NULL || strcmp(request->site, "same-origin") == 0 ||
        strcmp(request->site, "none") == 0)
        return false;
    return !(request->page && request->mode != NULL && strcmp(request->mode, "navigate") == 0);
}

unsigned guard_check(const guard_t *guard, const guard_request_t *request, const char **reason)
{
    *reason = "";
    if (request->host == NULL) {
        *reason = "the request names no Host";
        return 400;
    }
    if (!is_known(guard, request->host)) {
        *reason = "this server is not known by that host name: start the master with --http-host NAME for "
                  "each name by which it is reached";
        return 421;
    }
    if (!is_foreign(request)) return 0;
    *reason = "the request comes from another web site";
    return 403;
}
