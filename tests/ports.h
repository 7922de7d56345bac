/* ports: TCP ports for the farms of tests. */
#ifndef LIGHTMILL_PORTS_H
#define LIGHTMILL_PORTS_H

#include <stdbool.h>

/* The ports that this program may take, from `first` to `last`: those of $TEST_PORTS, "FIRST-LAST", which
 * run.sh gives each program that it runs beside others; by default 20000-31999, which lie below those that
 * the system gives away by itself. */
void ports_range(int *first, int *last);
/* Whether nobody listens at the port on loopback. */
bool port_is_free(int port);
/* The first of `count` free ports side by side, chosen by chance in the range; ends the program when there
 * are none. Two answers for the same count are the same or have no port in common. */
int ports_choose(int count);

#endif
