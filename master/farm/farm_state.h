/* farm_state: what the farm is made of, for farm*.c alone. Everything here is guarded by the farm's lock and
 * called under it, unless it says otherwise. */
#ifndef LIGHTMILL_FARM_STATE_H
#define LIGHTMILL_FARM_STATE_H

#include "master/farm/farm.h"

#include <pthread.h>

typedef struct {
    uint64_t id;
    char name[FARM_MAX_NAME + 1];
    char key[WIRE_KEY_TEXT + 1]; /* empty without keys */
    hash_t fingerprint;
    bool relay;
    identity_t identity;
    uint32_t threads;
    bool connected;
    bool idle;        /* was told that there is no work */
    bool begins;      /* no other machines that make the same bits have more threads, so it may begin jobs */
    bool outcast;     /* put aside: nothing of it is taken any more */
    bool charged;     /* that it died is held against its machine */
    bool fell;        /* it fell silent, which is held for its death until it is heard of again */
    uint64_t machine; /* names its machine (farm_standing.c) */
    uint64_t source;  /* and the process itself */
    double joined, last_seen; /* seconds */
    double asked;             /* seconds, when it last asked for work, or joined */
    double delivered;         /* seconds, when it last sent a batch, or was given units and had none */
    double held;              /* pixel samples that it was given and has not delivered, as far as is known */
    double speed;             /* pixel samples a second that it delivers; 0: not measured */
    uint64_t speed_job;       /* the job that it was measured with */
    double rated_samples, rated_seconds; /* what it was measured from */
    double deadline; /* seconds, when what it holds should have come; 0: it holds nothing */
    double empty;    /* seconds, since when it says that it holds nothing, though it was given units; 0 */
    double offered;  /* seconds, when it last said that a batch is ready; 0: that was answered */
    double granted;  /* seconds, when it was first let send it; 0: not yet, or that was answered */
    uint64_t ward;   /* the job that it is alone with suspects of, or will be when it holds nothing; 0 */
    uint64_t job;    /* that it has loaded or was assigned last */
    uint64_t batches, batches_refused, units_reissued, bytes;
} worker_t;

/* farm_checks.c: the units of a job that are rendered twice. */
typedef struct job_checks job_checks_t;
/* farm_suspects.c: the units of a job that were in the hands of workers who died. */
typedef struct job_suspects job_suspects_t;

struct job {
    uint64_t id;
    job_terms_t terms;
    job_settings_t settings;
    hash_t blob;
    uint64_t blob_size;
    job_state_t state;
    job_state_t outcome; /* the state after finishing */
    bool retained;
    bool taking;            /* batches are taken */
    bool image_due;         /* the image writer has to see to it */
    bool image_written;     /* the last image is in its file */
    double image_retry;     /* seconds, when to try again to write it; 0: it did not fail */
    bool scene_due;         /* its scene has to be looked at: it may be damaged */
    bool film_due;          /* its film has to be loaded before it can go on */
    bool film_wanted;       /* now */
    bool loading;           /* it is being loaded; film_bytes has it already */
    bool unsaved;           /* the film has sums that no checkpoint holds */
    bool saving;            /* a snapshot of the film is open */
    bool save_failed;       /* the last attempt to write a checkpoint did */
    bool given_up;          /* its end waits for neither image nor checkpoint: somebody cancelled that */
    bool planning;          /* the next round is being planned */
    bool gone;              /* deleted: freed when the last pin goes */
    bool record_due;        /* the record has changed since the journal got it */
    double last_checkpoint; /* seconds; 0: none */
    double
        elapsed_before; /* seconds of work on it before this process, or before it was paused or extended */
    double submitted, finished; /* seconds since 1970; 0: not yet */
    double started, ended;      /* seconds; 0: not yet */
    double flush_until;         /* seconds, while a flush goes on */
    double service;       /* thread-seconds that it was given, in the sense of fair shares (farm_shares) */
    uint32_t threads;     /* that work on it now */
    double claim;         /* on the worker that is being served, see farm_shares */
    bool held_back;       /* likewise: it is not its turn to begin */
    schedule_t *schedule; /* NULL before the first assignment and when the job is over */
    shared_film_t *shared_film; /* the film; NULL before the first assignment and when the job is over */
    int shared_film_users;      /* that look at the shared film without the farm's lock */
    bool shared_film_condemned; /* to be freed by the last of them */
    int merging;                /* batches that are counted and being added to the film */
    film_counts_t counts;       /* of the film, readable under the farm's lock */
    hash_t fingerprint;         /* of the machines that may work on it; all zero: none yet */
    double error;               /* estimated relative error at the last fixed point; 0: not known */
    uint64_t error_samples;     /* pixel samples counted then */
    uint64_t samples_done;
    uint64_t *seen; /* workers that contributed */
    size_t seen_count;
    uint32_t seen_before; /* workers that contributed before this process */
    uint64_t bytes, batches, batches_refused, units_reissued, checks_passed, checks_failed;
    schedule_account_t account; /* the last one, when there is no schedule */
    uint32_t declines;          /* workers that said they cannot render it */
    double rate_time[2];        /* two earlier points of the progress, for the speed */
    uint64_t rate_samples[2];
    job_checks_t *checks;     /* NULL: none */
    job_suspects_t *suspects; /* NULL: none */
    bool several_bits;        /* machines with different bits have worked on it */
    bool progress_due;        /* it may be complete: farm_tick sees to it */
    char remark[300];         /* what is to be known of it for the moment, beside the message */
    char message[500];
    int pins;
};

/* farm_standing.c: what is held against a machine or a process. */
typedef struct standing standing_t;

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
    uint64_t *removed;   /* jobs whose records and files are to go */
    size_t removed_count;
    bool shut; /* nothing more is handed out or taken */
    worker_t *workers;
    size_t worker_count;
    standing_t *standings;
    size_t standing_count;
    double deaths, worker_seconds; /* of late: how often workers die of nothing in particular */
    bool spooled;                  /* batches were written that are not safe on the disk yet */
    double rated, remarked;        /* seconds, when these were counted, and the remarks of jobs made */
    double gone_looked;            /* seconds, when it was looked who is gone (farm_evidence.c) */
    job_t **ranked;                /* see farm_rank_jobs */
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
/* The job's record has changed: the journal is to get it. */
void farm_record_changed(farm_t *farm, job_t *job);

/* ---- farm_workers.c ---- */

/* The worker is gone: what it holds goes back. `why` completes "worker NAME ...". */
void farm_worker_disconnect(farm_t *farm, double now, worker_t *worker, const char *why);
/* The worker is given up since it was silent for too long. */
void farm_worker_fall(farm_t *farm, double now, worker_t *worker);
/* What farm_tick does for the workers, beside their leases. Lets the lock go meanwhile. */
void farm_workers_tick(farm_t *farm, double now);
/* Tells the users of a job something that stays true: adds it to the job's message. */
void farm_job_tell(farm_t *farm, job_t *job, const char *format, ...) __attribute__((format(printf, 3, 4)));
/* Adds units that were taken back to the counters. */
void farm_count_reissued(job_t *job, worker_t *worker, size_t units);
/* A batch of this worker was counted: its speed and its deadline are known anew. */
void farm_worker_delivered(farm_t *farm, double now, worker_t *worker, job_t *job, const unit_t *units,
                           size_t count);

/* ---- farm_standing.c ---- */

/* A worker sent something that cannot be right: a batch that is malformed. `why` completes "it ...". */
void farm_worker_failed(farm_t *farm, double now, worker_t *worker, const char *why);
/* ---- farm_shares.c ---- */

/* The job takes part in the sharing out (again), or at another priority: it is owed nothing for before. */
void farm_job_joins(farm_t *farm, job_t *job);
/* Jobs that a worker may be given units of, the one whose turn it is first, in memory of the farm that is
 * good until the next call; `fits` says which ones the worker may have at all. */
job_t *const *farm_rank_jobs(farm_t *farm, const worker_t *worker,
                             bool (*fits)(const worker_t *worker, const job_t *job), size_t *count);
/* The workers have worked on for so many seconds. */
void farm_shares_tick(farm_t *farm, double seconds);

/* ---- farm_batches.c ---- */

/* The shared film of a pinned job, kept from being freed until it is let go; NULL when it has none. Both are
 * called without the farm's lock. */
shared_film_t *farm_shared_film_hold(farm_t *farm, job_t *job);
void farm_shared_film_let_go(farm_t *farm, job_t *job);

/* ---- farm_checks.c ---- */

/* RESULT_MISMATCH when nobody asked this worker for a batch with this number and these units. */
result_t farm_check_asked(const farm_t *farm, const job_t *job, uint64_t worker, uint64_t check,
                          const unit_t *units, size_t count);
/* Decides over a batch that bears a number: *merge is true when it is the first rendering of its units and
 * goes into the film. The digest is of its decoded sums. Fails as farm_check_asked does. */
result_t farm_check_batch(farm_t *farm, double now, job_t *job, uint64_t worker, uint64_t check,
                          const unit_t *units, size_t count, const hash_t *digest, bool *merge);
/* True while there are renderings to compare that nobody does yet. */
bool farm_checks_waiting(const job_t *job);
/* True while renderings to compare are out or to be had, or sums are to be taken out of the film; the job is
 * not complete before. */
bool farm_checks_pending(const job_t *job);
void farm_checks_free(job_checks_t **checks);

/* ---- farm_evidence.c ---- */

/* Keeps the payloads of a batch that was merged, until its sender is vouched for. Called without the farm's
 * lock, inside the shared film. */
void farm_check_keep(farm_t *farm, job_t *job, uint64_t worker, const batch_t *batch,
                     const zmq_msg_t payload[BATCH_PAYLOADS]);
/* The film of a pinned job is about to be put in its place, with this state (NULL: it begins anew): what is
 * kept of its batches is looked through. Called without the farm's lock, before batches are taken. */
void farm_checks_loaded(farm_t *farm, job_t *job, const schedule_state_t *state);
/* A checkpoint is safe on the disk. */
void farm_checks_checkpointed(job_t *job);
/* True while there are sums to take out of the job's film. */
bool farm_evidence_wrong(const job_t *job);
/* True while that could not be done, and is tried again. */
bool farm_evidence_delayed(const job_t *job);

/* ---- farm_suspects.c ---- */

/* True while there are units that are handed out alone. */
bool farm_suspects_waiting(const job_t *job);
void farm_suspects_free(job_suspects_t **suspects);

/* ---- farm_jobs.c ---- */

/* What the film of a job takes, and resolving it. */
uint64_t farm_film_bytes(const job_settings_t *settings);
/* And those of jobs that were begun and are to be loaded next. No other job may take that room: workers may
 * hold batches of these, and take up nothing else before they are rid of them. */
uint64_t farm_awaited_bytes(const farm_t *farm);
/* Seconds since 1970. */
double farm_wall_time(void);
/* Seconds that were spent on the job. */
double farm_job_elapsed(const job_t *job, double now);
void farm_job_free(farm_t *farm, job_t *job);
void farm_job_free_film(farm_t *farm, job_t *job);
/* A pin less; a job that is gone is freed with its last. */
void farm_job_unpin(farm_t *farm, job_t *job);
/* Takes the job off the list. It is freed at once, or when its last pin goes; its record and its files are to
 * go. */
void farm_job_remove(farm_t *farm, job_t *job);
/* True when the job has units to hand out, or may be started. */
bool farm_job_has_work(const job_t *job);
/* Makes film and schedule; false when it has to wait for memory, or for its film. A job that can never start
 * fails. */
bool farm_job_start(farm_t *farm, double now, job_t *job);
/* Gives a job its film and its schedule, which are taken over. */
void farm_job_install(farm_t *farm, double now, job_t *job, film_t *film, schedule_t *schedule);
/* The last batch is in: nothing more is taken, the image writer has the next word. */
void farm_job_close(farm_t *farm, double now, job_t *job, job_state_t outcome);
/* The job fails since its sums became too large (job->counts.overflows). */
void farm_job_fail_overflow(farm_t *farm, double now, job_t *job);
/* A job ends, or pauses, before all is counted: what workers have finished is asked for. The state has been
 * set: JOB_FINISHING with the outcome, or JOB_PAUSED. */
void farm_job_flush(farm_t *farm, double now, job_t *job);
/* A worker has nothing (more) to send for a job that is being flushed. */
void farm_job_flushed(farm_t *farm, double now, job_t *job, uint64_t worker);
/* The grace period for flushed batches is over. */
void farm_job_flush_end(farm_t *farm, double now, job_t *job);
/* A job ends before all is counted. */
void farm_job_cut_short(farm_t *farm, double now, job_t *job, job_state_t outcome);
/* Gives a finishing job its last state when its image and its last checkpoint are made, and frees the film of
 * one that is over. */
void farm_job_settle(farm_t *farm, job_t *job);
/* Something was counted, skipped or checked, and nothing is being merged: the next round is planned, or the
 * job is closed. Called with the farm's lock, which it lets go meanwhile, inside no shared film. */
void farm_job_progress(farm_t *farm, double now, job_t *job);
job_report_t farm_report_job(const job_t *job, double now);

#endif
