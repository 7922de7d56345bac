/* relay: a program between a master and many workers. To the master it is one worker, to the workers a
 * master: units go down, sums of batches go up. Sums are exact, so the image has the same bits.
 */
#ifndef LIGHTMILL_RELAY_H
#define LIGHTMILL_RELAY_H

#include "common/health.h"
#include "proto/serve/gate.h"
#include "proto/wire/dial.h"

#include <stdatomic.h>

typedef struct {
    const char *master_endpoint;                  /* "tcp://host:7420", of the master or another relay */
    const char *control_endpoint, *bulk_endpoint; /* where workers dial: "tcp://host:port", "tcp://host:*" */
    const char *data_dir;                         /* keys, the list of those who may dial, scenes */
    uint64_t cache_limit;                         /* bytes that scenes may take */
    const char *name;                             /* NULL: host name and process id */
    double heartbeat, lease, batch_interval;      /* seconds, told to workers */
    double grace;                                 /* seconds for leaving in order */
    pulse_t *pulse;                               /* of the upper side; kept by the caller; NULL: none */
    double patience;       /* seconds for an answer of the master, on a connection that lives */
    uint64_t batch_memory; /* bytes for batches under way; 0: an eighth of the memory, at least 1 GiB */
    int threads;           /* that add batches; 0: one a core */
    gate_options_t gate;   /* who may dial */
    dial_keys_t keys;      /* for the master; kept by the caller */
} relay_options_t;

relay_options_t relay_options_default(void);
/* Serves until *stop becomes non-zero. 1: calls in what the workers have finished, delivers it, says goodbye;
 * 2: leaves at once. Returns RESULT_OK when all was delivered, RESULT_UNREACHABLE when it could not be within
 * the grace period. `listening`, if it is not NULL, becomes the port of the control socket. */
result_t relay_run(const relay_options_t *options, const atomic_int *stop, atomic_int *listening);

#endif
