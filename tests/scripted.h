/* scripted: a master that does as a test says, on real sockets, to see what a worker (or a relay) makes of
 * it: it can withhold grants and verdicts, forget its workers, break connections and come back as another
 * process would.
 *
 * It acts only while scripted_run or scripted_step is called.
 */
#ifndef LIGHTMILL_SCRIPTED_H
#define LIGHTMILL_SCRIPTED_H

#include "common/scene/scene_blob.h"
#include "proto/wire/wire.h"

enum { SCRIPTED_MAX = 64 };

/* A batch as it came; its sums are decoded. */
typedef struct {
    uint64_t worker, job, check, sequence;
    hash_t content;
    batch_t batch;
} scripted_batch_t;

typedef struct {
    uint8_t identity[WIRE_MAX_IDENTITY];
    size_t identity_size;
    uint64_t request, worker, job, sequence;
    hash_t content;
} scripted_question_t;

typedef struct {
    void *context, *control, *bulk;
    int control_port, bulk_port;
    const scene_blob_t *blob;
    job_settings_t settings;

    /* What it does; a test changes these at will. */
    bool deaf;             /* probes are not answered */
    bool granting;         /* offers are granted at once */
    result_t refusal;      /* offers are refused with this, unless it is RESULT_OK */
    bool answering;        /* batches get their verdict at once, */
    bool counting;         /* and this is it */
    double batch_interval; /* seconds, told at hello */
    uint64_t job;          /* the next assignment: answers one request for work; no units: NoWork */
    uint64_t check;
    unit_t units[SCRIPTED_MAX];
    size_t unit_count;

    /* What it saw. */
    uint64_t worker; /* the number that it gave out last */
    int hellos, goodbyes, heartbeats, work_requests, offers, batch_count;
    int same_offers; /* how many offers in a row were of as many bytes as the one before */
    uint64_t offered_bytes;
    Lm__Hello *hello; /* the last one; owned */
    uint32_t heartbeat_threads;
    char trouble[WIRE_MAX_STRING + 1]; /* of the last heartbeat */
    int probes;
    size_t probe_bytes;        /* of the last one */
    unit_t kept[SCRIPTED_MAX]; /* of the last request for work that had any */
    size_t kept_count;
    hash_t kept_content;
    scripted_question_t offer;    /* the last one that was neither granted nor refused, and of a batch */
    scripted_question_t question; /* the last one without a verdict */
    scripted_batch_t batches[SCRIPTED_MAX];
    char nonsense[500]; /* what the protocol does not allow, or empty */
} scripted_t;

scripted_t *scripted_new(const scene_blob_t *blob, const job_settings_t *settings);
void scripted_destroy(scripted_t **script);
/* "tcp://127.0.0.1:PORT" of the control socket; the caller frees it. */
char *scripted_endpoint(const scripted_t *script);

/* Handles what comes within a few ms. */
void scripted_step(scripted_t *script);
/* Runs until the condition holds; fails the test with its text after `seconds`. */
#define scripted_run(script, condition, seconds)                                                             \
    do {                                                                                                     \
        double scripted_start_ = clock_now();                                                                \
        while (!(condition)) {                                                                               \
            scripted_step(script);                                                                           \
            if (clock_now() - scripted_start_ > (seconds)) scripted_fail(script, #condition);                \
        }                                                                                                    \
    } while (0)
void scripted_fail(const scripted_t *script, const char *condition);
/* Runs for so long. */
void scripted_sleep(scripted_t *script, double seconds);

/* The MAC that it sends with a unit that it assigns. Batches and requests for work must bear it; a test fails
 * if they do not. */
uint64_t scripted_mac(const unit_t *unit, uint64_t check);
/* Assigns units with the next request for work. */
void scripted_assign(scripted_t *script, uint64_t job, uint64_t check, const unit_t *units, size_t count);
/* Answers the offer, or the batch, that waits. */
void scripted_grant(scripted_t *script);
/* Grants all offers, from when the next assignment is in the peer's hands on: a master gives no unit that it
 * has counted, so the peer has to look for it in what it still holds. */
void scripted_grant_when_taken(scripted_t *script, double patience);
void scripted_verdict(scripted_t *script, bool counted);
void scripted_job_over(scripted_t *script, uint64_t job, bool flush);
/* Forgets its worker, as after its lease. */
void scripted_forget(scripted_t *script);
/* Closes its sockets for some seconds, as if the process were killed; comes back at the same ports, knowing
 * nobody. */
void scripted_restart(scripted_t *script, double seconds);
/* Breaks the bulk connections and takes new ones at the same port. */
void scripted_break_bulk(scripted_t *script);

/* Samples of a tile in all batches so far. */
uint32_t scripted_samples(const scripted_t *script, uint32_t tile);

#endif
