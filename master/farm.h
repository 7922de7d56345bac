/* farm: the master's state: the queue of jobs and the workers, and everything that can happen to them. It
 * knows no sockets: the control and the bulk server translate messages into the calls below, a test makes the
 * calls itself.
 *
 * Thread-safe. One lock guards all of it and is held for microseconds only, so that heartbeats never wait for
 * a merge. The film of a job has a lock of its own, held while sums are merged or resolved. Where both are
 * needed, the film's is taken first. Units are marked as counted while the film is locked: who holds the
 * film's lock sees exactly the sums of the units that are counted.
 *
 * Times are seconds of clock_now(), handed in by the caller, so that a test can make time pass.
 */
#ifndef LIGHTMILL_FARM_H
#define LIGHTMILL_FARM_H

#include "common/film.h"
#include "proto/wire.h"

enum {
    FARM_MAX_JOBS = 1000,    /* known at a time; the oldest finished ones are forgotten */
    FARM_MAX_WORKERS = 4096, /* connected, and as many again that were lost and may still send a batch */
    FARM_MAX_NAME = 200,
    FARM_MAX_DECLINES = 3 /* of a job that no worker has rendered any of */
};

typedef struct farm farm_t;
typedef struct job job_t; /* a job that the caller has pinned: it is not forgotten */

typedef struct {
    double lease;          /* seconds */
    double batch_interval; /* seconds */
    uint64_t film_limit;   /* bytes that the films of all jobs may take */
    uint64_t first_job;    /* number of the first job */
    int control_wake;      /* eventfd, written when there are notices to send; -1: none */
    int image_wake;        /* eventfd, written when a job waits for its image; -1: none */
} farm_options_t;

farm_t *farm_new(const farm_options_t *options);
/* Frees the farm and sets *farm to NULL; no job may be pinned. */
void farm_destroy(farm_t **farm);

/* ---- workers ------------------------------------------------------------------------------------------- */

/* Where a worker's messages come from. */
typedef struct {
    uint8_t bytes[WIRE_MAX_IDENTITY];
    size_t size;
} identity_t;

/* Admits a worker and names it. RESULT_LIMIT when there are too many. */
result_t farm_hello(farm_t *farm, double now, const identity_t *identity, const char *name, uint32_t threads,
                    uint64_t *worker);
/* False when the worker is not known (any more). */
bool farm_heartbeat(farm_t *farm, double now, const identity_t *identity, uint64_t worker, uint64_t job,
                    uint32_t units_held);
/* The worker leaves: its units go back. `job` is one that it cannot render, for the reason it gives, or 0. A
 * job that nobody has delivered anything of fails when it was declined FARM_MAX_DECLINES times and nobody is
 * at it. */
void farm_goodbye(farm_t *farm, double now, uint64_t worker, uint64_t job, const char *reason);
/* Work for a worker; the caller gives room for WIRE_MAX_UNITS units. */
typedef struct {
    uint64_t job; /* 0: there is none */
    job_settings_t settings;
    hash_t blob;
    uint64_t blob_size;
    unit_t *units;
    size_t unit_count;
} farm_work_t;

/* RESULT_UNREACHABLE when the worker is not known: it should say hello again. */
result_t farm_take(farm_t *farm, double now, const identity_t *identity, uint64_t worker, uint64_t loaded_job,
                   uint64_t samples, uint64_t unit_samples, farm_work_t *work);

/* Something to tell a worker unasked: JobReady (job 0) or JobOver. */
typedef struct {
    identity_t identity;
    uint64_t job;
    bool flush;
} notice_t;

bool farm_next_notice(farm_t *farm, notice_t *notice);

/* Time passes: leases and time limits end. To be called a few times a second, when all messages that came
 * have been handled. */
void farm_tick(farm_t *farm, double now);

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* Puts a job in the queue; settings are checked, the blob is in the store. */
result_t farm_submit(farm_t *farm, double now, const char *name, const job_settings_t *settings,
                     const hash_t *blob, uint64_t blob_size, uint64_t *job);
/* Ends a job early; its image is written from what is there. RESULT_INPUT when it does not exist or is over.
 */
result_t farm_cancel(farm_t *farm, double now, uint64_t job);

/* A job as clients see it. */
typedef struct {
    uint64_t job;
    char name[FARM_MAX_NAME + 1];
    job_state_t state;
    job_settings_t settings;
    hash_t blob;
    uint64_t samples_done, samples_total; /* pixel samples; total 0: only time ends the job */
    double elapsed, remaining;            /* seconds; remaining < 0: not known */
    uint32_t workers, workers_seen;       /* that hold units now; that have contributed */
    uint64_t bytes_received, batches, batches_refused, units_reissued;
    film_counts_t counts;
    char message[500];
} job_report_t;

/* The reports of one job or (job 0) of all in the order of submission, in fresh memory that the caller frees;
 * NULL and *count 0 when there are none. *workers is the number of connected workers. */
job_report_t *farm_report(farm_t *farm, double now, uint64_t job, size_t *count, uint32_t *workers);

/* ---- batches ------------------------------------------------------------------------------------------- */

/* Pins the job that a batch is for, to be unpinned; the reason for a failure is for the sender. `bytes` is
 * the size of the message. */
result_t farm_batch_open(farm_t *farm, double now, uint64_t worker, uint64_t job, uint64_t bytes,
                         job_t **pinned);
const job_settings_t *farm_job_settings(const job_t *job);
uint64_t farm_job_id(const job_t *job);
/* Counts and merges a batch whole, or refuses it whole: then what the sender holds of its units goes back.
 * Takes as long as a pass over the film. */
result_t farm_batch_merge(farm_t *farm, double now, job_t *job, uint64_t worker, const batch_t *batch);
/* The batch was no good: what the sender holds of its units goes back. */
void farm_batch_refuse(farm_t *farm, job_t *job, uint64_t worker, const unit_t *units, size_t count);
void farm_unpin(farm_t *farm, job_t *job);

/* ---- images -------------------------------------------------------------------------------------------- */

/* Pins a job, to be unpinned; NULL when there is none of that number. */
job_t *farm_pin(farm_t *farm, uint64_t job);
/* Pins a job that is over and whose image is to be written or, if it failed, whose film is to be freed; NULL
 * when there is none. */
job_t *farm_next_finished(farm_t *farm);
/* Resolves the sums so far; the caller frees the image. RESULT_INPUT when nothing has been rendered yet, or
 * when the job is over and its image is in its file. */
result_t farm_resolve(farm_t *farm, double now, job_t *job, film_image_t *image, job_report_t *report);
/* Batches merged so far, the version of the image, and whether the job has its last state. */
uint64_t farm_image_version(farm_t *farm, job_t *job, bool *over);
/* The image of a job that farm_next_finished gave out was written, or could not be: the job gets its last
 * state and its film is freed. */
void farm_finished(farm_t *farm, double now, job_t *job, result_t written, const char *path);
/* Ends every job that is not over, as cancelled by the shutdown, so that farm_next_finished gives them out.
 */
void farm_shut_down(farm_t *farm, double now);

#endif
