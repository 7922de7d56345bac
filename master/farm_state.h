/* farm_state: what the farm is made of, for farm*.c alone. Everything here is guarded by the farm's lock and
 * called under it, unless it says otherwise. */
#ifndef LIGHTMILL_FARM_STATE_H
#define LIGHTMILL_FARM_STATE_H

#include "master/farm.h"
#include "master/schedule.h"

#include <pthread.h>

typedef struct {
    uint64_t id;
    char name[FARM_MAX_NAME + 1];
    identity_t identity;
    uint32_t threads;
    bool connected;
    bool idle;        /* was told that there is no work */
    double last_seen; /* seconds */
    double delivered; /* seconds, when it last sent a batch, or was given units and had none */
    uint64_t job;     /* that it has loaded or was assigned last */
    uint64_t batches, batches_refused, units_reissued, bytes;
} worker_t;

struct job {
    uint64_t id;
    char name[FARM_MAX_NAME + 1];
    job_settings_t settings;
    hash_t blob;
    uint64_t blob_size;
    job_state_t state;
    job_state_t outcome;   /* the state after finishing */
    bool taking;           /* batches are taken */
    bool image_due;        /* the image writer has to see to it */
    double started, ended; /* seconds; 0: not yet */
    double flush_until;    /* seconds, while a flush goes on */
    schedule_t *schedule;  /* NULL before the first assignment and when the job is over */
    pthread_mutex_t film_lock;
    film_t *film;
    film_counts_t counts; /* of the film, readable under the farm's lock */
    uint64_t samples_done;
    uint64_t *seen; /* workers that contributed */
    size_t seen_count;
    uint64_t bytes, batches, batches_refused, units_reissued;
    uint32_t declines;   /* workers that said they cannot render it */
    double rate_time[2]; /* two earlier points of the progress, for the speed */
    uint64_t rate_samples[2];
    char message[500];
    int pins;
};

/* A notice by worker number. */
typedef struct {
    uint64_t worker, job;
    bool flush;
} pending_t;

struct farm {
    farm_options_t options;
    pthread_mutex_t lock;
    job_t **jobs;
    size_t job_count;
    uint64_t next_job;
    uint64_t film_bytes; /* of all films */
    worker_t *workers;
    size_t worker_count;
    pending_t *notices;
    size_t notice_count, notice_capacity;
    double last_tick;
};

void farm_lock(farm_t *farm);
void farm_unlock(farm_t *farm);
/* Writes an eventfd; harmless on -1. */
void farm_wake(int descriptor);

/* ---- farm.c ---- */

/* NULL when there is none of that number. */
job_t *farm_find_job(const farm_t *farm, uint64_t id);
worker_t *farm_find_worker(const farm_t *farm, uint64_t id);
/* Calls the idle workers when there is something to do. */
void farm_notify_idle(farm_t *farm);
/* Tells the workers that have a job that it is over. */
void farm_notify_over(farm_t *farm, const job_t *job, bool flush);

/* ---- farm_workers.c ---- */

/* The worker is gone: what it holds goes back. `why` completes "worker NAME ...". */
void farm_worker_disconnect(farm_t *farm, double now, worker_t *worker, const char *why);
/* Adds units that were taken back to the counters. */
void farm_count_reissued(job_t *job, worker_t *worker, size_t units);

/* ---- farm_jobs.c ---- */

void farm_job_free(farm_t *farm, job_t *job);
void farm_job_free_film(farm_t *farm, job_t *job);
/* True when the job has units to hand out. */
bool farm_job_has_work(const job_t *job);
/* Makes film and schedule; false when it has to wait for memory. A job that can never start fails. */
bool farm_job_start(farm_t *farm, double now, job_t *job);
/* The last batch is in: nothing more is taken, the image writer has the next word. */
void farm_job_close(farm_t *farm, double now, job_t *job, job_state_t outcome);
/* A job ends before all is counted: what workers have finished is asked for. */
void farm_job_cut_short(farm_t *farm, double now, job_t *job, job_state_t outcome);
/* A worker has nothing (more) to send for a job that is being flushed. */
void farm_job_flushed(farm_t *farm, double now, job_t *job, uint64_t worker);
job_report_t farm_report_job(const job_t *job, double now);

#endif
