/* bulk: the thread that owns the worker's bulk socket. It fetches scenes and delivers batches. So neither the
 * control thread nor the render threads ever wait for the network or a compressor. */
#ifndef LIGHTMILL_BULK_H
#define LIGHTMILL_BULK_H

#include "proto/uplink/uplink_handler.h"
#include "proto/wire/dial.h"

typedef struct bulk bulk_t;

enum { BULK_SILENT_SECONDS = 5 };

typedef struct {
    void *context;            /* ZeroMQ context, kept by the caller */
    uplink_handler_t handler; /* likewise */
    int wake;                 /* eventfd that the handler and bulk_* write to; kept by the caller */
    int control_wake;         /* likewise, written when bulk_ready or bulk_silent say something new */
    const char *cache_dir;
    uint64_t cache_limit; /* bytes */
    uint64_t memory;      /* bytes that a job may take, its frames included; scenes may be kept there that the
                             disk does not take */
    bool local;           /* payloads are handed over as they are */
    dial_keys_t keys;     /* what they point to is kept by the caller */
    double patience;      /* seconds for an answer of the master, on a connection that lives */
} bulk_options_t;

/* Opens the cache and starts the thread. */
result_t bulk_start(const bulk_options_t *options, bulk_t **bulk);
/* Gives up what is under way, joins the thread and sets *bulk to NULL. */
void bulk_stop(bulk_t **bulk);

/* The master has welcomed this worker: bulk traffic goes to `endpoint` (copied) under the number `worker`.
 * What is under way on an unbroken connection to the same endpoint stays so. */
void bulk_link_up(bulk_t *bulk, const char *endpoint, uint64_t worker, double batch_interval);
/* The master refuses this worker: what is under way waits for the next welcome. */
void bulk_link_down(bulk_t *bulk);

/* True when the master's bulk socket has answered this worker: it is worth asking for work. */
bool bulk_ready(const bulk_t *bulk, uint64_t worker);
/* True when it has not answered for BULK_SILENT_SECONDS, and is asked on. */
bool bulk_silent(const bulk_t *bulk);

#endif
