/* address: where a master listens, "HOST[:PORT]" as people write it, and the ZeroMQ endpoints made from it.
 */
#ifndef LIGHTMILL_ADDRESS_H
#define LIGHTMILL_ADDRESS_H

#include "common/base.h"

enum { ADDRESS_MAX_HOST = 255 };

typedef struct {
    char host[ADDRESS_MAX_HOST + 1]; /* a name, an IPv4 address, or an IPv6 address in brackets */
    int port;                        /* 1 to 65535 */
} address_t;

/* Reads "host", "host:port", "[v6]:port" or any of them after "tcp://". RESULT_USAGE when it is none of
 * these. */
result_t address_parse(const char *text, int default_port, address_t *address);
/* True for a host that only this machine reaches: localhost, 127.x.y.z, [::1]. */
bool address_is_loopback(const char *host);
/* "tcp://host:port" in fresh memory; the caller frees it. */
char *address_endpoint(const address_t *address, int port);
/* The endpoints of the two sockets that listen at "HOST[:PORT]", the second at the next port; both at free
 * ports of the host for port 0. The caller frees them; on failure they are NULL. */
result_t address_listen(const char *text, int default_port, char **control, char **bulk);

#endif
