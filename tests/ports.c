/* ports: see ports.h. */
#include "tests/ports.h"

#include "common/base.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <unistd.h>

enum { TRIES = 1000, LEAST = 100 };

void ports_range(int *first, int *last)
{
    const char *range = getenv("TEST_PORTS");
    int end = 0;
    *first = 20000;
    *last = 31999;
    if (range == NULL) return;
    bool read = sscanf(range, "%5d-%5d%n", first, last, &end) == 2 && range[end] == '\0';
    if (read && *first > 0 && *first + LEAST <= *last && *last < 65536) return;
    fprintf(stderr, "TEST_PORTS=%s is no range of ports\n", range);
    abort();
}

bool port_is_free(int port)
{
    int descriptor = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    bool available = bind(descriptor, (struct sockaddr *)&address, sizeof address) == 0;
    close(descriptor);
    return available;
}

int ports_choose(int count)
{
    int first, last, found;
    ports_range(&first, &last);
    unsigned seed = (unsigned)getpid() * 2654435761u + (unsigned)(1e6 * clock_now());
    for (int i = 0; i < TRIES; i++) {
        int port = first + count * (rand_r(&seed) % ((last - first + 1) / count));
        for (found = 0; found < count && port_is_free(port + found);) found++;
        if (found == count) return port;
    }
    fprintf(stderr, "there are no %d free ports from %d to %d\n", count, first, last);
    abort();
}
