/* workshop: the job in hand, its queue of units, the render threads and the batches that they fill.
 *
 * One job at a time. The control thread brings assignments and news (no more work, job over, leave); the bulk
 * thread asks what there is to do for it (load a scene, send a batch, let a scene go) and does it; the render
 * threads take units and add what they made to the open batch. All functions may be called from any thread.
 *
 * At most two batches exist: the open one, and one that is closed and being sent. While a batch is under way
 * the open one simply grows, so rendering never waits for the network.
 */
#ifndef LIGHTMILL_WORKSHOP_H
#define LIGHTMILL_WORKSHOP_H

#include "common/film.h"
#include "common/scene_blob.h"
#include "worker/render/renderer.h"

typedef struct workshop workshop_t;

/* Work from the master. */
typedef struct {
    uint64_t job;
    job_settings_t settings; /* checked */
    hash_t blob;
    uint64_t blob_size; /* bytes */
    unit_t *units;      /* valid for the job; taken over by workshop_assign */
    size_t unit_count;
} assignment_t;

/* A closed batch on its way: the workshop's own until workshop_sent. */
typedef struct {
    uint64_t job;
    uint64_t sequence;
    const batch_t *batch;
} closed_batch_t;

typedef enum {
    DUTY_NONE,
    DUTY_LOAD, /* fetch the blob of `assignment`, make a renderer, call workshop_loaded or workshop_refuse */
    DUTY_SEND, /* send `closed`, call workshop_sent when it was answered */
    DUTY_RELEASE /* the job is over: call workshop_release, then destroy renderer and blob */
} duty_kind_t;

typedef struct {
    duty_kind_t kind;
    assignment_t assignment; /* DUTY_LOAD; without units */
    closed_batch_t closed;   /* DUTY_SEND */
    double wait;             /* DUTY_NONE: seconds until it is worth asking again, if nobody wakes us */
} duty_t;

/* What the control thread needs to know to ask for work, to send heartbeats and to leave. */
typedef struct {
    uint64_t job;          /* that is loaded or being loaded, 0: none */
    uint32_t units_held;   /* queued, being rendered, or in a batch that is not acknowledged */
    uint64_t samples;      /* pixel samples to ask for now; 0: there is enough in hand */
    uint64_t unit_samples; /* pixel samples of a good unit */
    double samples_per_second;
    bool idle;        /* nothing is queued, rendering, open or under way */
    result_t failure; /* of the last load, until workshop_clear_failure */
    uint64_t failed;  /* the job that it was of */
} workshop_state_t;

/* Starts `threads` render threads. `control_wake` and `bulk_wake` are eventfds, kept by the caller, that are
 * written when the control or the bulk thread has something new to look at. */
workshop_t *workshop_new(int threads, int control_wake, int bulk_wake);
/* Cancels what is being rendered and joins the threads; from then on no renderer is used. */
void workshop_stop(workshop_t *shop);
/* Stops, frees everything and sets *shop to NULL. */
void workshop_destroy(workshop_t **shop);

/* ---- news from the master ---- */

/* Adds units; an assignment of another job waits until the present one is finished. */
void workshop_assign(workshop_t *shop, const assignment_t *assignment);
/* The master has no more work now: the batch is closed as soon as all units in hand are finished. */
void workshop_no_more(workshop_t *shop);
/* Drops everything of a job: queued units, those being rendered, and the open batch too unless `flush`: then
 * it is sent at once. */
void workshop_job_over(workshop_t *shop, uint64_t job, bool flush);
/* The master does not know this worker any more: drops the queue, closes the batch early. */
void workshop_forget(workshop_t *shop);
/* Begins no more units, and closes the last batch when those begun are finished. */
void workshop_drain(workshop_t *shop);
void workshop_clear_failure(workshop_t *shop);
/* A snapshot of the state, with the amount of work to ask for. */
workshop_state_t workshop_state(workshop_t *shop);

/* ---- for the bulk thread ---- */

/* The next thing to do. A batch is closed when it is `batch_interval` seconds old, or as soon as nothing is
 * left to add to it. */
duty_t workshop_duty(workshop_t *shop, double batch_interval);
/* True when the job in hand is over, so that loading its scene is to be given up. */
bool workshop_unwanted(workshop_t *shop);
/* Hands the renderer of the job in hand over for use; it stays the caller's to destroy after DUTY_RELEASE. */
void workshop_loaded(workshop_t *shop, const renderer_t *renderer);
/* The job cannot be rendered here: drops its units and keeps `why` for the control thread. */
void workshop_refuse(workshop_t *shop, result_t why);
/* The batch of DUTY_SEND was answered or given up: its memory is free for the next one. */
void workshop_sent(workshop_t *shop);
void workshop_release(workshop_t *shop);

#endif
