/* serve_handler: those whose workers dial in. The control and the bulk server (control_server.h,
 * bulk_server.h) know them only by these calls: the handler of a master is its farm, that of a relay its pool
 * (relay/pool.h). It is the counterpart of proto/uplink/uplink_handler.h, at the other end of the wire.
 *
 * There are no messages in it: the servers translate. Times are seconds of clock_now(), handed in, so that a
 * test can make time pass. */
#ifndef LIGHTMILL_SERVE_HANDLER_H
#define LIGHTMILL_SERVE_HANDLER_H

#include "proto/wire/wire.h"

enum {
    SERVE_MAX_WORKERS = 4096, /* connected at a time */
    SERVE_MAX_NAME = JOB_MAX_NAME
};

/* Where a worker's messages come from. */
typedef struct {
    uint8_t bytes[WIRE_MAX_IDENTITY];
    size_t size;
} identity_t;

/* What a worker says of itself, and what is known of it. */
typedef struct {
    const char *name;
    const char *key; /* public key in Z85, empty without keys */
    uint32_t threads;
    hash_t fingerprint; /* of its bits; all zero: it has not said */
    bool relay;
} worker_hello_t;

/* Work for a worker. */
typedef struct {
    uint64_t job; /* 0: there is none */
    job_settings_t settings;
    hash_t blob;
    uint64_t blob_size;
    unit_t *units; /* the caller's, room for WIRE_MAX_UNITS */
    size_t unit_count;
    uint64_t check; /* not 0: the units make a batch of their own */
} work_t;

/* Something to tell a worker unasked: JobReady (job 0) or JobOver. */
typedef struct {
    identity_t identity;
    uint64_t job;
    bool flush;
} notice_t;

#endif
