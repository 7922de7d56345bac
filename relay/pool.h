/* pool: what a relay holds: the units that it took from above, the workers below that render them, and the
 * sums of what these have delivered.
 *
 * To the threads that talk to the master above, it is a handler (proto/uplink/uplink_handler.h). To those
 * that talk to the workers below, it is what the farm is to a master. It knows no sockets.
 *
 * Workers of one relay make the same bits: the first one decides which.
 *
 * Thread-safe. Times are seconds of clock_now(), handed in by the caller, so that a test can make time pass.
 */
#ifndef LIGHTMILL_POOL_H
#define LIGHTMILL_POOL_H

#include "proto/serve/serve_handler.h"
#include "proto/uplink/uplink_handler.h"

typedef struct pool pool_t;

typedef struct {
    double lease;          /* seconds of silence after which a worker is given up */
    double batch_interval; /* seconds between its batches */
    uint64_t memory;       /* bytes that this process may use */
    /* eventfds, kept by the caller: */
    int control_wake; /* written when the thread that talks to the master has something new to look at, */
    int bulk_wake;    /* when the one that delivers has, */
    int notice_wake;  /* when there are notices, */
    int grant_wake;   /* and when there may be room for batches again */
} pool_options_t;

pool_t *pool_new(const pool_options_t *options);
/* Frees the pool and sets *pool to NULL; all threads that use it have ended. */
void pool_destroy(pool_t **pool);
/* The calls of the threads that talk to the master. */
uplink_handler_t pool_handler(pool_t *pool);

/* ---- workers ------------------------------------------------------------------------------------------- */

/* Admits a worker and names it. RESULT_MISMATCH when it makes other bits than those that are here,
 * RESULT_LIMIT when there are too many. */
result_t pool_hello(pool_t *pool, double now, const identity_t *identity, const worker_hello_t *hello,
                    uint64_t *worker);
/* False when the worker is not known (any more). `threads` 0: as it said at first. */
bool pool_heartbeat(pool_t *pool, double now, const identity_t *identity, uint64_t worker, uint64_t job,
                    uint32_t units_held, uint32_t threads);
/* The worker leaves: its units go to others. `job` is one that it cannot render, or 0; when nobody here can,
 * the master is told. */
void pool_goodbye(pool_t *pool, double now, uint64_t worker, uint64_t job, const char *reason);
/* After a new hello: what a worker has begun or finished of a job, and will deliver, is not given to others.
 */
void pool_claim(pool_t *pool, uint64_t worker, uint64_t job, const hash_t *content, const unit_t *units,
                size_t count);
/* The settings of a job; false when it is not here. */
bool pool_job_settings(pool_t *pool, uint64_t job, job_settings_t *settings);
/* Work for a worker; the caller gives room for WIRE_MAX_UNITS units. RESULT_UNREACHABLE when the worker is
 * not known: it should say hello again. */
result_t pool_take(pool_t *pool, double now, const identity_t *identity, uint64_t worker, uint64_t loaded_job,
                   uint64_t samples, uint64_t unit_samples, work_t *work);
bool pool_next_notice(pool_t *pool, notice_t *notice);
/* Time passes: leases and flushes end. To be called a few times a second, when all messages that came have
 * been handled. */
void pool_tick(pool_t *pool, double now);

/* ---- batches ------------------------------------------------------------------------------------------- */

/* May this worker send a batch of this job? RESULT_LIMIT: not yet, the sums are as large as they may be; any
 * other failure says why it is not wanted. */
result_t pool_batch_wanted(pool_t *pool, double now, uint64_t worker, uint64_t job,
                           const ProtobufCBinaryData *content);
/* It was told so. */
void pool_batch_granted(pool_t *pool, double now, uint64_t worker);
/* Adds up the batch of a BatchResult, whole, or refuses it whole: then what the sender holds of its units
 * goes to others. RESULT_UNREACHABLE: the sender is not known, and nothing is decided over its batch. Several
 * threads may be at it at once. */
result_t pool_batch_add(pool_t *pool, double now, const wire_message_t *message);

/* ---- scenes -------------------------------------------------------------------------------------------- */

/* The size of a blob that is here; RESULT_INPUT when it is not. */
result_t pool_blob_size(pool_t *pool, const hash_t *hash, uint64_t *size);
/* Copies `length` bytes at `offset`, which lie within the blob. */
result_t pool_blob_read(pool_t *pool, const hash_t *hash, uint64_t offset, void *bytes, size_t length);

#endif
