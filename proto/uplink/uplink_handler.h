/* uplink_handler: what the uplink knows of the program that it serves. The control and the bulk thread talk
 * to the master; all that they want from the program goes through the calls below. In a worker the render
 * pool answers them (worker/render_pool.h), in a relay its pool (relay/pool.h). proto/serve/serve_handler.h
 * is the counterpart at the other end of the wire.
 *
 * Calls may come from any thread. Those marked as the bulk thread's come from that thread alone. */
#ifndef LIGHTMILL_UPLINK_HANDLER_H
#define LIGHTMILL_UPLINK_HANDLER_H

#include "common/film/batch.h"
#include "common/scene/scene_blob.h"
#include "proto/wire/wire.h"

/* Work from the master. */
typedef struct {
    uint64_t job;
    uint64_t check;          /* not 0: these units, and no others, make a batch that bears this number */
    job_settings_t settings; /* checked */
    hash_t blob;
    uint64_t blob_size; /* bytes */
    hash_t content;     /* job_content_hash */
    unit_t *units;      /* valid for the job */
    size_t unit_count;
    uint64_t *macs; /* that show that the units were issued, in the same piece of memory; NULL: not known */
    hash_t
        plans[LEARNING_PASSES]; /* hashes of plans, by pass, of those that the units are of; all zero: none */
} assignment_t;

/* False when two name different plans for a pass. */
static inline bool assignment_plans_agree(const hash_t a[LEARNING_PASSES], const hash_t b[LEARNING_PASSES])
{
    bool agree = true;
    for (uint32_t pass = 0; pass < LEARNING_PASSES; pass++)
        agree &= hash_is_zero(&a[pass]) || hash_is_zero(&b[pass]) || hash_equal(&a[pass], &b[pass]);
    return agree;
}

/* A batch that is ready to be closed and sent. */
typedef struct {
    uint64_t job;
    uint64_t check; /* 0: an ordinary batch */
    hash_t content;
    uint64_t bytes; /* what it takes uncompressed */
} offer_t;

/* A closed batch on its way: the handler's own until it is told that it was sent. In a master's own process
 * the messages take its sums over (payload_wrap). */
typedef struct {
    offer_t offer;
    uint64_t sequence;          /* the handler's own count of its batches */
    batch_t *batch;             /* NULL: there is none any more */
    issue_t *issues;            /* of its units, in fresh memory that the caller of `close` frees */
    uint64_t coded[BATCH_SUMS]; /* bytes of its sums as they were sent; 0: they were not */
} closed_batch_t;

typedef enum {
    DUTY_NONE,
    DUTY_LOAD,   /* fetch the blob of `assignment`, call loaded or refuse */
    DUTY_PLAN,   /* fetch a plan of `assignment`, call planned or refuse */
    DUTY_OFFER,  /* ask the master to take `offer`; when it is granted, close, send, call sent */
    DUTY_MEASURE /* see how fast the link is by now */
} duty_kind_t;

typedef struct {
    duty_kind_t kind;
    assignment_t assignment; /* DUTY_LOAD, DUTY_PLAN; without units */
    uint32_t pass;           /* DUTY_PLAN */
    offer_t offer;           /* DUTY_OFFER */
    double wait;             /* DUTY_NONE: seconds until it is worth asking again, if nobody wakes us */
} duty_t;

/* What the control thread needs to know to say hello, to ask for work, to send heartbeats and to leave. */
typedef struct {
    bool ready;            /* there is somebody who can work: it is worth saying hello */
    uint32_t threads;      /* that render */
    hash_t fingerprint;    /* of their bits; all zero: not known */
    uint64_t job;          /* that is loaded or being loaded, 0: none */
    hash_t content;        /* of that job */
    uint32_t units_held;   /* queued, being rendered, or in a batch that is not acknowledged */
    uint32_t rendering;    /* units that are being rendered */
    uint64_t samples;      /* pixel samples to ask for now; 0: there is enough in hand */
    uint64_t unit_samples; /* pixel samples of a good unit */
    double samples_per_second;
    bool idle;         /* nothing is queued, rendering, open or under way */
    result_t failure;  /* of the last load, until clear_failure */
    uint64_t failed;   /* the job that it was of */
    char trouble[200]; /* why nothing is asked for, for people; empty: nothing hinders */
} uplink_state_t;

typedef struct {
    /* ---- news from the master ---- */

    /* Adds units; assignment->units is taken over. Samples that are in hand already are left out. */
    void (*assign)(void *self, const assignment_t *assignment);
    /* The master has no more work now: batches are closed as soon as all units in hand are finished. */
    void (*no_more)(void *self);
    /* Drops everything of a job: queued units, those being rendered, and the open batch too unless `flush`:
     * then it is sent at once. */
    void (*job_over)(void *self, uint64_t job, bool flush);
    /* The master does not know this worker any more: units that were not begun are given to others and are
     * dropped; what was begun is finished, and the open batch is sent soon, since the master may want it. */
    void (*forget)(void *self);
    /* The units of a job that were begun or finished and are not acknowledged, at most `capacity`, and how
     * they were issued; returns how many. */
    size_t (*kept)(void *self, uint64_t job, unit_t *units, issue_t *issues, size_t capacity);
    /* Begins no more units, and closes the last batch when those begun are finished. */
    void (*drain)(void *self);
    /* Gives up the units being rendered, for good: after drain. */
    void (*give_up)(void *self);
    void (*clear_failure)(void *self);
    /* A snapshot of the state, with the amount of work to ask for. */
    uplink_state_t (*state)(void *self);

    /* ---- for the bulk thread ---- */

    /* The next thing to do. A batch is ready when it is `batch_interval` seconds old, or as soon as nothing
     * is left to add to it; until it is closed it grows. `rate`: bytes a second that the link carries; 0: not
     * known, or without limit. */
    duty_t (*duty)(void *self, double batch_interval, double rate);
    /* True when a job is over, so that loading its scene or offering its batch is to be given up. */
    bool (*unwanted)(void *self, uint64_t job);
    /* True when a batch is ready, so that a scene that is being fetched gives way to it after a while: `duty`
     * is asked again, and gives both their turns. NULL: there are no batches as long as a scene is to load.
     */
    bool (*pressing)(void *self);
    /* The scene of a job is here; the blob is taken over in any case. Takes as long as making it ready does;
     * a failure is followed by refuse. */
    result_t (*loaded)(void *self, uint64_t job, scene_blob_t *blob);
    /* A plan of a job is here, the bytes of a blob that has its hash. RESULT_INPUT or RESULT_MISMATCH when it
     * is none of the job's; that is followed by refuse. */
    result_t (*planned)(void *self, const assignment_t *assignment, uint32_t pass, const uint8_t *bytes,
                        size_t size);
    /* The job cannot be rendered here: drops its units and keeps `why` for the control thread. */
    void (*refuse)(void *self, uint64_t job, result_t why);
    /* Closes the batch that was offered. */
    closed_batch_t (*close)(void *self, const offer_t *offer);
    /* A closed batch was counted, refused or given up: its memory is free for the next one. */
    void (*sent)(void *self, const closed_batch_t *closed, bool counted);
} uplink_calls_t;

typedef struct {
    const uplink_calls_t *calls;
    void *self;
} uplink_handler_t;

#endif
