/* network: machines that are not there. A site is a network namespace at the end of a virtual cable; workers
 * that run in it reach the driver's side, where the master listens, through that cable alone. It can be cut
 * in either direction (iptables) and made thin (tc tbf, which also loses packets when its queue is full).
 *
 * The driver moves into namespaces of its own first, so nothing of this is seen by the rest of the machine
 * and all of it ends with the driver. */
#ifndef LIGHTMILL_NETWORK_H
#define LIGHTMILL_NETWORK_H

#include "common/base.h"

enum { NETWORK_MAX_SITES = 4 };

typedef enum { NETWORK_INWARD = 1, NETWORK_OUTWARD = 2, NETWORK_BOTH = 3 } network_way_t;

typedef struct network network_t;

/* Gives the process its own network and mounts, with the right to change them: as root, or as the root of a
 * user namespace. To be called before threads are started. RESULT_MISMATCH, saying why, where that is not
 * allowed; nothing has changed then. */
result_t network_separate(void);

/* Makes the sites; needs network_separate. RESULT_MISMATCH, saying why, when it cannot. */
result_t network_new(size_t sites, network_t **network);
void network_destroy(network_t **network);

/* The namespace of a site, for process_setup_t. */
int network_site(const network_t *network, size_t site);
/* The address of the driver's side, where a master is reached from all sites. */
#define NETWORK_HOST "10.77.100.1"

/* Drops all packets to (inward) or from (outward) a site. */
result_t network_cut(network_t *network, size_t site, network_way_t way);
/* Lets so many bytes a second through, each way. */
result_t network_thin(network_t *network, size_t site, unsigned bytes_per_second);
/* As it was made. */
result_t network_heal(network_t *network, size_t site);

#endif
