/* address: see address.h.
 *
 * DESIGN. ZeroMQ resolves host names itself, so nothing is looked up here: the text is only cut into host and
 * port and checked for characters that cannot be part of either. That keeps a typing error ("farm:74Z0") an
 * error of the command line instead of a worker that dials nowhere for ever.
 */
#include "common/address.h"

#include <ctype.h>
#include <stdlib.h>
#include <string.h>

static result_t bad_address(const char *text)
{
    return result_fail(RESULT_USAGE, "'%.200s' is no address: expected HOST or HOST:PORT", text);
}

static bool host_plausible(const char *host, size_t length)
{
    if (length == 0 || length > ADDRESS_MAX_HOST) return false;
    bool bracketed = host[0] == '[' && host[length - 1] == ']';
    for (size_t i = 0; i < length; i++) {
        char c = host[i];
        if (isalnum((unsigned char)c) || c == '.' || c == '-' || c == '_') continue;
        if (bracketed && (c == ':' || c == '%' || i == 0 || i == length - 1)) continue;
        return false;
    }
    return true;
}

static bool port_parse(const char *text, int *port)
{
    if (!isdigit((unsigned char)text[0])) return false;
    char *end;
    long value = strtol(text, &end, 10);
    if (*end != '\0' || value < 1 || value > 65535) return false;
    *port = (int)value;
    return true;
}

result_t address_parse(const char *text, int default_port, address_t *address)
{
    const char *host = strncmp(text, "tcp://", 6) == 0 ? text + 6 : text;
    const char *after_bracket = host[0] == '[' ? strchr(host, ']') : NULL;
    const char *colon = strchr(after_bracket ? after_bracket : host, ':');
    size_t length = colon ? (size_t)(colon - host) : strlen(host);
    if (!host_plausible(host, length)) return bad_address(text);
    memcpy(address->host, host, length);
    address->host[length] = '\0';
    address->port = default_port;
    if (colon && !port_parse(colon + 1, &address->port)) return bad_address(text);
    return result_ok();
}

bool address_is_loopback(const char *host)
{
    if (strcmp(host, "localhost") == 0 || strcmp(host, "[::1]") == 0) return true;
    /* "127.example.org" is a name, not an address */
    return strncmp(host, "127.", 4) == 0 && host[strspn(host, "0123456789.")] == '\0';
}

char *address_endpoint(const address_t *address, int port)
{
    return mem_printf("tcp://%s:%d", address->host, port);
}

/* "HOST:0" asks for free ports, which an address cannot say. */
static result_t listen_anywhere(const char *text, size_t length, char **control, char **bulk)
{
    address_t address;
    char *host = mem_strdup(text);
    host[length] = '\0';
    result_t result = address_parse(host, 1, &address);
    free(host);
    TRY(result);
    *control = mem_printf("tcp://%s:*", address.host);
    *bulk = mem_strdup(*control);
    return result_ok();
}

result_t address_listen(const char *text, int default_port, char **control, char **bulk)
{
    address_t address;
    size_t length = strlen(text);
    *control = *bulk = NULL;
    if (length > 2 && strcmp(text + length - 2, ":0") == 0)
        return listen_anywhere(text, length - 2, control, bulk);
    TRY(address_parse(text, default_port, &address));
    if (address.port == 65535) return result_fail(RESULT_USAGE, "port 65535 leaves none for the bulk socket");
    *control = address_endpoint(&address, address.port);
    *bulk = address_endpoint(&address, address.port + 1);
    return result_ok();
}
