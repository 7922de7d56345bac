/* serve_handler: what the servers know of the program that they serve. The control and the bulk server
 * (control_server.h, bulk_server.h) talk to workers; all that they want from the program goes through the
 * calls below. In a master the farm answers them (master/threads/farm_service.h), in a relay its pool
 * (relay/pool.h). proto/uplink/uplink_handler.h is the counterpart at the other end of the wire.
 *
 * The calls have no messages in them: the servers translate. Times are seconds of clock_now(), handed in, so
 * that a test can make time pass. */
#ifndef LIGHTMILL_SERVE_HANDLER_H
#define LIGHTMILL_SERVE_HANDLER_H

#include "proto/wire/wire.h"

enum {
    SERVE_MAX_WORKERS = 4096,    /* connected at a time */
    SERVE_WORKER_THREADS = 4096, /* that a worker may have, */
    SERVE_RELAY_THREADS = 65536, /* and a relay, of all of its workers */
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
    const char *key;     /* public key in Z85, empty without keys */
    const char *address; /* of its host; empty or NULL in the same process */
    uint32_t threads;
    hash_t fingerprint; /* of its bits; all zero: it has not said */
    uint64_t process;   /* a number of the process alone; 0: it has not said */
    bool relay;
} worker_hello_t;

/* Work for a worker. */
typedef struct {
    uint64_t job; /* 0: there is none */
    job_settings_t settings;
    hash_t blob;
    uint64_t blob_size;
    unit_t *units;   /* the caller's, room for WIRE_MAX_UNITS, */
    issue_t *issues; /* and for as many of these, of the units */
    size_t unit_count;
    uint64_t check;                /* not 0: the units make a batch of their own */
    hash_t plans[LEARNING_PASSES]; /* by pass, of those that the units are of; all zero: there is none */
} work_t;

/* A worker lives. */
typedef struct {
    uint64_t worker, job; /* that it has loaded; 0: none */
    uint32_t units_held;
    uint32_t threads;    /* those of a relay change; 0: as it said at first */
    const char *trouble; /* why it asks for no work, for people; empty: nothing hinders it */
} heartbeat_t;

/* A worker asks for work. */
typedef struct {
    uint64_t worker, job;  /* that it has loaded; 0: none */
    uint64_t samples;      /* pixel samples wanted in all */
    uint64_t unit_samples; /* that make a good unit */
} work_request_t;

/* What a worker has in hand of a job, from an earlier life of this program or a lease that ended. */
typedef struct {
    uint64_t worker, job;
    const hash_t *content; /* job_content_hash of that job; NULL: not said */
    const unit_t *units;   /* not checked against the job */
    const issue_t *issues; /* of the units */
    size_t unit_count;
} claim_t;

/* Something to tell a worker unasked: JobReady (job 0) or JobOver, or Leave. */
typedef struct {
    identity_t identity;
    uint64_t job;
    bool flush, leave;
} notice_t;

/* A batch that a worker would like to send. */
typedef struct {
    identity_t identity;
    int connection;   /* wire_message_t.connection */
    uint64_t request; /* to be repeated in the answer */
    uint64_t worker, job;
    bool named; /* it was said what the job is, */
    hash_t content;
    uint64_t bytes; /* about what it will take */
} batch_offer_t;

/* A batch that has come. */
typedef struct {
    uint64_t worker, job;
    uint64_t check;        /* the number that it bears; 0: none */
    const hash_t *content; /* as in claim_t */
    batch_t *batch;        /* its counts and units, not checked against the job, without settings; who takes
                              it over leaves an empty one */
    const issue_t *issues; /* of the units */
    const zmq_msg_t *payload; /* [BATCH_PAYLOADS]: its sums */
    size_t bytes;             /* of the message */
} incoming_batch_t;

/* All calls may come from several threads at once. */
typedef struct {
    /* ---- control ---- */

    /* Admits a worker and names it, or says why not. RESULT_CANCELLED: it is put aside, which is known. */
    result_t (*hello)(void *self, double now, const identity_t *identity, const worker_hello_t *hello,
                      uint64_t *worker);
    /* False when the worker is not known (any more). */
    bool (*heartbeat)(void *self, double now, const identity_t *identity, const heartbeat_t *beat);
    /* The worker leaves: its units go to others. `job` is one that it cannot render, or 0. */
    void (*goodbye)(void *self, double now, uint64_t worker, uint64_t job, const char *reason);
    /* What a worker has begun or finished is its own again, unless somebody else has it. */
    void (*claim)(void *self, double now, const claim_t *claim);
    /* Work for a worker. RESULT_UNREACHABLE when it is not known: it should say hello again. */
    result_t (*take)(void *self, double now, const identity_t *identity, const work_request_t *request,
                     work_t *work);
    bool (*next_notice)(void *self, notice_t *notice);
    /* Time passes: leases end. To be called a few times a second, when all messages that came have been
     * handled. */
    void (*tick)(void *self, double now);

    /* ---- batches ---- */

    /* A worker's probe has come, so it reaches the bulk socket: before that it gets no work.
     * RESULT_UNREACHABLE when it is not known. */
    result_t (*reached)(void *self, double now, uint64_t worker);
    /* An offer has come: may it wait to be granted? */
    result_t (*offered)(void *self, double now, const batch_offer_t *offer);
    /* Is it still wanted? Asked often while it waits. RESULT_LIMIT: not yet; else it waits no more. */
    result_t (*wanted)(void *self, double now, const batch_offer_t *offer);
    /* It was granted. */
    void (*granted)(void *self, double now, uint64_t worker);
    /* Counts and adds up a batch whole, or refuses it whole: then what the sender holds of its units goes to
     * others. RESULT_UNREACHABLE and RESULT_LIMIT: nothing is decided over it, and the sender keeps it. Takes
     * as long as a pass over the film. */
    result_t (*add)(void *self, double now, const incoming_batch_t *incoming);

    /* ---- scenes ---- */

    /* The size of a blob that is here, in bytes; RESULT_INPUT when it is not. */
    result_t (*blob_size)(void *self, const hash_t *hash, uint64_t *size);
    /* Copies `length` bytes from `offset` on, which lie within the blob. */
    result_t (*blob_read)(void *self, const hash_t *hash, uint64_t offset, void *bytes, size_t length);
} serve_calls_t;

typedef struct {
    const serve_calls_t *calls;
    void *self;
} serve_handler_t;

#endif
