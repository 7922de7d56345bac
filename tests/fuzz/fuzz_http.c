/* fuzz_http: lines as what a request says in its head: method, path, Host, Origin, Sec-Fetch-Site,
 * Sec-Fetch-Mode, Authorization, Content-Range, Last-Event-ID and an exposure. What gets past the guard names
 * a host of ours and no other origin; what has a right shows a token, letter by letter. */
#include "tests/fuzz/fuzz.h"

#include "master/http/access/guard.h"
#include "master/http/routes.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum { LINES = 10, MAX_HOST = 100 };

static const char view[] = "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";
static const char operate[] = "fedcba9876543210fedcba9876543210fedcba9876543210fedcba9876543210";

/* Without its port, in lower case, a host that is let in is one of these; said once more, by another way. */
static bool is_ours(const char *host)
{
    static const char *const names[] = {"localhost", "127.0.0.1", "[::1]", "192.0.2.7", "farm.example"};
    char name[MAX_HOST];
    size_t length = strlen(host), digits = 0;
    while (digits < length && isdigit((unsigned char)host[length - 1 - digits])) digits++;
    if (digits > 0 && digits < length && host[length - 1 - digits] == ':') length -= digits + 1;
    if (length >= sizeof name) return false;
    for (size_t i = 0; i < length; i++) name[i] = (char)tolower((unsigned char)host[i]);
    name[length] = '\0';
    for (size_t i = 0; i < ARRAY_LENGTH(names); i++)
        if (strcmp(name, names[i]) == 0) return true;
    return false;
}

static void check_guard(char *const lines[LINES])
{
    static const char *more[] = {"farm.example"};
    const option_list_t names = {more, 1};
    guard_t guard;
    fuzz_expect(guard_init(&guard, "192.0.2.7", &names).code == RESULT_OK, "a guard that knows no names");
    for (int page = 0; page < 2; page++) {
        const guard_request_t told = {
            .host = lines[2], .origin = lines[3], .site = lines[4], .mode = lines[5], .page = page};
        const char *reason = NULL;
        unsigned status = guard_check(&guard, &told, &reason);
        fuzz_expect(reason != NULL && (status == 0) == (reason[0] == '\0'), "a refusal without a reason");
        fuzz_expect(status == 0 || status == 400 || status == 403 || status == 421, "a status of its own");
        if (status != 0) continue;
        fuzz_expect(told.host != NULL && is_ours(told.host), "a host that is not ours");
        const char *at = told.origin != NULL ? strstr(told.origin, "://") : NULL;
        fuzz_expect(told.origin == NULL || (at != NULL && strcasecmp(at + 3, told.host) == 0),
                    "another origin");
        bool same =
            told.site == NULL || strcmp(told.site, "same-origin") == 0 || strcmp(told.site, "none") == 0;
        fuzz_expect(same || (page && told.mode != NULL && strcmp(told.mode, "navigate") == 0),
                    "another site");
    }
    guard_free(&guard);
}

static void check_token(const char *authorization)
{
    http_tokens_t tokens;
    memcpy(tokens.view, view, sizeof view);
    memcpy(tokens.operate, operate, sizeof operate);
    http_right_t right = http_tokens_right(&tokens, authorization);
    if (right == HTTP_ANYBODY) return;
    fuzz_expect(strncasecmp(authorization, "bearer ", 7) == 0, "a right without the scheme");
    fuzz_expect(strcmp(authorization + 7, right == HTTP_VIEW ? view : operate) == 0,
                "a right without its token");
}

static void check_route(const char *method, const char *path)
{
    http_request_t request = {.path = path};
    unsigned status = http_route_find(&request, method);
    fuzz_expect(status == 0 || status == MHD_HTTP_NOT_FOUND || status == MHD_HTTP_METHOD_NOT_ALLOWED,
                "a status of its own");
    fuzz_expect((status == 0) == (request.route != NULL), "a refusal with a route");
    fuzz_expect((status == MHD_HTTP_METHOD_NOT_ALLOWED) <= (request.allowed[0] != '\0'),
                "no method is named");
    if (status != 0) return;
    bool api = strncmp(path, "/api/", 5) == 0 || strcmp(path, "/metrics") == 0;
    fuzz_expect(!api || request.route->right != HTTP_ANYBODY, "the API without a token");
    bool reads = strcmp(method, "GET") == 0 || strcmp(method, "HEAD") == 0;
    fuzz_expect(reads || request.route->right == HTTP_OPERATE, "a change without the right to it");
}

static void check_fields(const char *range, const char *id, const char *exposure)
{
    uint64_t first = 0, length = 0, size = 0, number = 0;
    float stops = NAN;
    if (http_range_parse(range, &first, &length, &size))
        fuzz_expect(length > 0 && length <= size && first <= size - length, "a range outside");
    if (http_event_id_parse(id, 0x1234abcd, &number)) {
        char *same = mem_printf("1234abcd-%llu", (unsigned long long)number);
        fuzz_expect(strtoull(strchr(id, '-') + 1, NULL, 10) == number && strncmp(id, same, 9) == 0,
                    "another event");
        free(same);
    }
    if (http_stops_parse(exposure, 50, &stops))
        fuzz_expect(stops >= -50 && stops <= 50, "an exposure out of bounds");
}

int fuzz_http(const uint8_t *data, size_t size)
{
    char *text = mem_alloc(size + 1), *lines[LINES] = {NULL}, *rest = text;
    if (size > 0) memcpy(text, data, size);
    text[size] = '\0';
    for (size_t i = 0; i < LINES && rest != NULL; i++) {
        lines[i] = strsep(&rest, "\n");
        if (strcmp(lines[i], "-") == 0) lines[i] = NULL; /* it is not said */
    }
    check_guard(lines);
    check_token(lines[6]);
    if (lines[0] != NULL && lines[1] != NULL) check_route(lines[0], lines[1]);
    check_fields(lines[7] ? lines[7] : "", lines[8] ? lines[8] : "", lines[9] ? lines[9] : "");
    free(text);
    return 0;
}
