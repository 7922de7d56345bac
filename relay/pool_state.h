/* pool_state: what the pool is made of, for pool*.c alone. Everything here is guarded by the pool's lock and
 * called under it, unless it says otherwise. */
#ifndef LIGHTMILL_POOL_STATE_H
#define LIGHTMILL_POOL_STATE_H

#include "common/wake.h"
#include "proto/uplink/issued.h"
#include "relay/ledger.h"
#include "relay/pool.h"
#include "relay/sums.h"

#include <pthread.h>

enum {
    POOL_MAX_JOBS = 16,
    PARCEL_READY_UNITS = WIRE_MAX_UNITS / 4, /* a parcel is offered when it has so many units, */
    PARCEL_MAX_UNITS = WIRE_MAX_UNITS,       /* and cannot have more than this */
    POOL_MAX_UNITS = WIRE_MAX_UNITS          /* no more is asked for when so many are here */
};

/* A worker below. */
typedef struct {
    uint64_t id;
    char name[SERVE_MAX_NAME + 1];
    char party[WIRE_MAX_ADDRESS + 1]; /* its key, or the address of its host without keys */
    identity_t identity;
    uint32_t threads;
    bool relay;            /* it is a relay itself */
    bool reached;          /* it reaches the bulk socket; before that it gets no work */
    bool troubled;         /* what hinders it was logged */
    bool idle;             /* was told that there is no work */
    double last_seen;      /* seconds */
    double delivered;      /* when it last sent or offered a batch, or was given units and had none */
    double granted;        /* when it was first let send the batch that it offers; 0: not yet */
    uint64_t job;          /* that it has loaded or was assigned last */
    uint64_t unit_samples; /* pixel samples of a unit that is good for it */
} member_t;

/* A check of the master's, passed on to one worker: its units make a batch of their own. */
typedef struct {
    uint64_t number;
    unit_t *units;
    issued_t issued; /* how the master issued them */
    size_t count;
    uint64_t worker; /* that has it; 0: nobody */
    bool done;       /* the batch is here */
    bool under_way;  /* the bulk thread has it */
    batch_t batch;
} relay_check_t;

/* A sum on its way up. */
typedef struct parcel {
    sum_t *sum;
    double since; /* seconds, when the first batch was added */
    size_t units; /* that it has or is about to have, */
    size_t bytes; /* and its size, as it was when the last one had been added */
    struct parcel *next;
} parcel_t;

typedef struct {
    uint64_t id;
    hash_t content, blob_hash;
    job_settings_t settings;
    uint64_t blob_size;
    bool loaded;                          /* the blob is here */
    scene_blob_t blob;                    /* mapped */
    hash_t plans[LEARNING_PASSES];        /* by pass; all zero: none was named */
    uint8_t *plan_bytes[LEARNING_PASSES]; /* NULL: it is not here; else ledger.plans has its bit */
    ledger_t ledger;
    issued_t issued; /* how the master issued what is in it */
    relay_check_t **checks;
    size_t check_count;
    pthread_rwlock_t adding; /* read to add to a parcel, written to close it; before the pool's lock */
    parcel_t *parcels;       /* those that wait to be sent; the last one is open */
    parcel_t *under_way;     /* that the bulk thread has */
    bool over;               /* nothing more of it is handed out, */
    bool flush;              /* but what was rendered is wanted */
    double flush_until;
    bool hurry;        /* the sums are wanted soon */
    bool gone;         /* to be freed when nobody uses it */
    int users;         /* threads that look at it without the pool's lock */
    int merging;       /* batches that were accepted and are not in a sum yet */
    uint32_t declines; /* workers that said they cannot render it */
    bool delivered;    /* somebody could */
    double last_used;  /* seconds */
} relay_job_t;

/* A notice by worker number. */
typedef struct {
    uint64_t worker, job;
    bool flush;
} pool_notice_t;

struct pool {
    pool_options_t options;
    pthread_mutex_t lock;
    relay_job_t *jobs[POOL_MAX_JOBS]; /* in the order in which they came */
    size_t job_count;
    member_t *members;
    size_t member_count;
    hash_t group;    /* the fingerprint of the members */
    double deserted; /* seconds, when the last one went */
    pool_notice_t *notices;
    size_t notice_count, notice_capacity;
    double uplink_interval; /* seconds between the batches that the master wants */
    bool no_more, draining;
    bool offered; /* the last duty, but for plans, was to offer a batch */
    bool fetched; /* the last duty was to fetch a plan */
    uint64_t sequence;
    double last_tick;
    result_t failure;
    uint64_t failed; /* job */
};

void pool_lock(pool_t *pool);
void pool_unlock(pool_t *pool);

/* ---- pool.c ---- */

/* Time passes: leases and flushes end. Not under the lock. */
void pool_tick(void *pool, double now);

/* NULL when there is none. */
relay_job_t *pool_find_job(pool_t *pool, uint64_t id);
member_t *pool_find_member(pool_t *pool, uint64_t id);
/* Calls the idle workers when there is something to do. */
void pool_notify_idle(pool_t *pool);
/* Tells the workers that have a job that it is over. */
void pool_notify_over(pool_t *pool, const relay_job_t *job, bool flush);
/* Nothing of the job is here but its scene. */
bool pool_job_empty(const relay_job_t *job);
/* Nothing of any job is. */
bool pool_empty(const pool_t *pool);
/* Bytes of the parcels that wait, of all jobs. */
size_t pool_bytes(const pool_t *pool);
/* Bytes that these, or the tiles of one batch, may take. */
uint64_t pool_bytes_limit(const pool_t *pool);
/* What a worker has of a job is free again, or dropped if the job is over; returns the number of units. */
size_t pool_take_back(relay_job_t *job, uint64_t worker);
/* A worker is gone: what it has goes to others; returns the number of units. */
size_t pool_remove_member(pool_t *pool, double now, member_t *member);
/* Lets a job go: its workers are told. It is freed once nobody uses it. */
void pool_drop_job(pool_t *pool, relay_job_t *job);
/* Frees what is gone and not used. */
void pool_sweep(pool_t *pool);
/* What workers have not sent of a job that is called in is not waited for any more. */
void pool_end_flush(pool_t *pool, relay_job_t *job);
void pool_check_remove(relay_job_t *job, size_t index);

void pool_parcel_free(parcel_t *parcel);

#endif
