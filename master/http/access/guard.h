/* guard: is a request meant for this server, and does it come from a page of ours?
 *
 * DESIGN. A web site can make its visitor's browser send requests to any address, and can give its own name
 * the address 127.0.0.1 (DNS rebinding), after which the browser takes our answers for the site's own. So the
 * Host of a request must be one of the names by which this server is known; and a request that a browser says
 * comes from another origin is refused. */
#ifndef LIGHTMILL_HTTP_GUARD_H
#define LIGHTMILL_HTTP_GUARD_H

#include "common/options/options.h"

typedef struct {
    char **names; /* lower case, without ports */
    size_t count;
} guard_t;

/* Knows localhost, 127.0.0.1, [::1], the host that is listened at, and further names. RESULT_USAGE when one
 * of these is no name. */
result_t guard_init(guard_t *guard, const char *bound, const option_list_t *names);
void guard_free(guard_t *guard);

/* What a browser says of a request; NULL: it does not say. */
typedef struct {
    const char *host, *origin, *site, *mode; /* Host, Origin, Sec-Fetch-Site, Sec-Fetch-Mode */
    bool page; /* a file that anybody may have, so that links from other sites work */
} guard_request_t;

/* 0, or the HTTP status of the refusal (400, 403, 421) and its reason, which is constant. */
unsigned guard_check(const guard_t *guard, const guard_request_t *request, const char **reason);

#endif
