/* listen: see listen.h. */
#include "master/http/access/listen.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netdb.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { BACKLOG = 128 };

/* "[HOST:]PORT", where an address_t has no port 0: it becomes -1. */
static result_t parse(const char *text, address_t *address)
{
    bool port_alone = text[0] != '\0' && text[strspn(text, "0123456789")] == '\0';
    size_t length = strlen(text);
    bool any_port = strcmp(text, "0") == 0 || (length > 2 && strcmp(text + length - 2, ":0") == 0);
    char *whole = port_alone ? mem_printf("127.0.0.1:%s", text) : mem_strdup(text);
    if (any_port) *strrchr(whole, ':') = '\0';
    result_t result = address_parse(whole, any_port ? 1 : 65536, address);
    free(whole);
    if (any_port) address->port = 0;
    if (result.code != RESULT_OK || address->port > 65535)
        return result_fail(RESULT_USAGE, "--http takes [HOST:]PORT, for example 7480, not '%.200s'", text);
    return result;
}

static bool is_loopback(const struct sockaddr *address)
{
    if (address->sa_family == AF_INET)
        return ntohl(((const struct sockaddr_in *)address)->sin_addr.s_addr) >> 24 == 127;
    return address->sa_family == AF_INET6 &&
           IN6_IS_ADDR_LOOPBACK(&((const struct sockaddr_in6 *)address)->sin6_addr);
}

static result_t resolve(const char *text, const address_t *address, struct addrinfo **found)
{
    char host[ADDRESS_MAX_HOST + 1], port[16];
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE | AI_NUMERICSERV};
    bool bracketed = address->host[0] == '[';
    snprintf(host, sizeof host, "%s", address->host + bracketed);
    if (bracketed) host[strlen(host) - 1] = '\0';
    snprintf(port, sizeof port, "%d", address->port);
    hints.ai_family = strcmp(host, "localhost") == 0 ? AF_INET : AF_UNSPEC;
    int error = getaddrinfo(host, port, &hints, found);
    if (error == 0) return result_ok();
    return result_fail(RESULT_USAGE, "--http %.200s: %s", text, gai_strerror(error));
}

static result_t bind_to(const char *text, const struct addrinfo *info, http_listen_t *listening)
{
    static const int yes = 1;
    struct sockaddr_storage bound;
    socklen_t length = sizeof bound;
    listening->socket = socket(info->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (listening->socket < 0 ||
        setsockopt(listening->socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0 ||
        bind(listening->socket, info->ai_addr, info->ai_addrlen) != 0 ||
        listen(listening->socket, BACKLOG) != 0 ||
        getsockname(listening->socket, (struct sockaddr *)&bound, &length) != 0)
        return result_fail(RESULT_IO, "cannot listen for HTTP at %.200s: %s", text, strerror(errno));
    listening->address.port = ntohs(bound.ss_family == AF_INET6 ? ((struct sockaddr_in6 *)&bound)->sin6_port
                                                                : ((struct sockaddr_in *)&bound)->sin_port);
    return result_ok();
}

result_t http_listen(const char *text, bool secured, http_listen_t *listening)
{
    struct addrinfo *found;
    *listening = (http_listen_t){.socket = -1};
    TRY(parse(text, &listening->address));
    TRY(resolve(text, &listening->address, &found));
    listening->exposed = !is_loopback(found->ai_addr);
    result_t result = result_ok();
    if (listening->exposed && !secured)
        result =
            result_fail(RESULT_USAGE,
                        "other machines reach --http %.200s, so it needs TLS: give --http-cert FILE and "
                        "--http-key FILE, or listen on 127.0.0.1 and put a proxy with TLS in front of it "
                        "(docs/http.md)",
                        text);
    if (result.code == RESULT_OK) result = bind_to(text, found, listening);
    freeaddrinfo(found);
    if (result.code == RESULT_OK) return result;
    if (listening->socket >= 0) close(listening->socket);
    listening->socket = -1;
    return result;
}
