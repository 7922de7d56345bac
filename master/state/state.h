/* state: what the farm is made of: workers, jobs, their tables and the lock, with what only looks things up
 * or notes them down. Data without behaviour and without verdicts: trust (what is held against workers) and
 * farm (what happens to jobs and workers) stand on it, and neither servers nor tests of behaviour include it.
 *
 * Everything here is guarded by the farm's lock and called under it, unless it says otherwise. */
#ifndef LIGHTMILL_STATE_STATE_H
#define LIGHTMILL_STATE_STATE_H

#include "common/id_table.h"
#include "common/wake.h"
#include "master/state/types.h"
#include "master/store/error_history.h"
#include "master/store/job_record.h"
#include "proto/serve/rate_limit.h"

#include <pthread.h>

typedef struct {
    uint64_t id;
    char name[FARM_MAX_NAME + 1];
    char key[WIRE_KEY_TEXT + 1];        /* empty without keys */
    char address[WIRE_MAX_ADDRESS + 1]; /* of its host; empty in the same process */
    char party_text[FARM_MAX_PARTY + 1];
    hash_t fingerprint;
    bool relay;
    identity_t identity;
    uint32_t threads;
    bool connected;
    bool limited;     /* it is to be given more when it has delivered */
    bool lapsed;      /* it lost units that it had not delivered, and has delivered none since */
    bool reached;     /* it reaches the bulk socket; before that it gets no work */
    bool idle;        /* was told that there is no work */
    bool begins;      /* no other machines that make the same bits have more threads, so it may begin jobs */
    bool drained;     /* it is to leave: it is given nothing more */
    bool outcast;     /* put aside: nothing of it is taken any more */
    bool charged;     /* that it died is held against its party */
    bool fell;        /* it fell silent, which is held for its death until it is heard of again */
    uint64_t party;   /* who is judged for what it does (trust/standing.c) */
    uint64_t source;  /* the name, of all of the party */
    uint64_t process; /* number of the process, as it says; 0: it does not */
    double joined, last_seen; /* seconds */
    double asked;             /* seconds, when it last asked for work, or joined */
    double wanted;            /* seconds, when it last asked for some, or joined */
    double delivered;         /* seconds, when it last sent a batch, or was given units and had none */
    double held;              /* pixel samples that it was given and has not delivered, as far as is known */
    double speed;             /* pixel samples a second that it delivers; 0: not measured */
    uint64_t speed_job;       /* the job that it was measured with */
    double rated_samples, rated_seconds; /* what it was measured from */
    double gap;                          /* seconds from one batch to the next, about; 0: there was none */
    double transfer;                     /* seconds that a batch is on its way to us, about */
    double empty; /* seconds, since when it says that it holds nothing, though it was given units; 0 */
    double
        offered; /* seconds, when it last said that a batch is ready of what it holds; 0: that was answered */
    double granted;      /* seconds, when it was first let send one since the last that counted; 0: not yet */
    uint64_t quarantine; /* the job that it is alone with suspects of, or will be when it holds nothing; 0 */
    uint64_t job;        /* that it has loaded or was assigned last */
    uint64_t batches, batches_refused, units_reissued, bytes;
    char trouble[FARM_MAX_TROUBLE + 1]; /* why it asks for no work, in its own words; empty: nothing does */
    double troubled;                    /* seconds, when such words were logged last; 0: not yet */
    bool told;                          /* these were */
} worker_t;

/* A process that cannot render a job. */
typedef struct {
    uint64_t source, party; /* worker_t.source, .party */
    uint32_t count;
    double until; /* seconds, before when it is given no units of the job */
} decline_t;

/* What trust knows of a farm's workers, */
typedef struct trust trust_t;
/* of the units of a job that are rendered twice (trust/checks.c), */
typedef struct job_checks job_checks_t;
/* and of those that were in the hands of workers who died (trust/suspects.c). */
typedef struct job_suspects job_suspects_t;

/* The life of a job is its state (job_state_t, wire.h) and the next four; farm/jobs.c has the table of what
 * follows what. Where the film of a job is: */
typedef enum {
    FILM_NONE,     /* nowhere: the job has not begun, or is over */
    FILM_STORED,   /* on the disk, where it is to be loaded from before the job can go on, */
    FILM_WANTED,   /* and now, as soon as there is room, */
    FILM_LOADING,  /* which is under way; farm_t.film_bytes has it already */
    FILM_OPEN,     /* in memory, and batches are taken */
    FILM_CLOSED,   /* in memory, until image and checkpoint are written */
    FILM_CONDEMNED /* in memory, until the last lets go of it */
} job_film_t;

/* The last image of a job. */
typedef enum {
    IMAGE_NONE,    /* it is not time for it */
    IMAGE_DUE,     /* the image writer has to see to it, */
    IMAGE_WRITING, /* and does */
    IMAGE_FAILED,  /* it could not be written: it is due again at image_retry */
    IMAGE_WRITTEN,
    IMAGE_GIVEN_UP /* the job's end does not wait for it: somebody cancelled that */
} job_image_t;

/* Whether the film has sums that no checkpoint holds. */
typedef enum {
    SAVE_DONE,
    SAVE_DUE,
    SAVE_OFF /* they will not be saved: the job failed, or somebody cancelled that */
} job_save_t;

/* The attempt to write a checkpoint. */
typedef enum {
    WRITE_IDLE,
    WRITE_OPEN,   /* a snapshot of the film is open */
    WRITE_FAILED, /* the last one did */
    WRITE_RETRIED /* and a snapshot is open again */
} job_write_t;

struct job {
    /* What outlives the process. Three of it are as they were: the time that it took before this process, or
     * before it was paused or extended; the workers before this process; and the account when there was no
     * schedule. */
    job_record_t kept;
    job_film_t film;
    job_image_t image;
    uint32_t image_failures;    /* attempts to write it that failed, one after the other */
    double image_retry;         /* seconds, when to try again: IMAGE_FAILED */
    job_image_t milestone;      /* the image of the milestone that the film stands at (farm/milestones.c) */
    uint32_t milestone_spp;     /* which one; the next three while there is one */
    uint64_t milestone_version; /* kept.batches when it was taken up */
    double milestone_retry;     /* seconds, likewise */
    job_save_t save;
    job_write_t write;
    bool scene_due;                     /* its scene has to be looked at: it may be damaged */
    bool planning;                      /* the next round is being planned */
    bool teaching;                      /* the plan of the next pass is being made */
    hash_t plans[LEARNING_PASSES];      /* of passes that are open; all zero: there is none */
    bool gone;                          /* deleted: freed when the last pin goes */
    bool record_due;                    /* the record has changed since the journal got it */
    double last_checkpoint;             /* seconds, when its snapshot was taken; 0: none */
    double unsaved_since;               /* seconds, when the first batch after it was counted; 0: not known */
    double started, ended;              /* seconds; 0: not yet */
    double flush_until;                 /* seconds, while a flush goes on */
    double service;                     /* thread-seconds that it was given, in the sense of farm/shares.c */
    uint32_t threads;                   /* that work on it now */
    double claim;                       /* on the worker that is being served, likewise */
    bool held_back;                     /* likewise: it is not its turn to begin */
    schedule_t *schedule;               /* NULL before the first assignment and when the job is over */
    shared_film_t *shared_film;         /* from FILM_OPEN to FILM_CONDEMNED, else NULL */
    int shared_film_users;              /* that look at it without the farm's lock */
    int merging;                        /* batches that are counted and being added to the film */
    error_history_t history;            /* of the estimated error (farm/errors.c) */
    bool history_due;                   /* it has changed since the journal got it */
    double next_estimate;               /* seconds, when the error may be estimated again */
    id_table_t seen;                    /* workers that contributed to it in this process */
    decline_t declined[FARM_DECLINERS]; /* who said that they cannot render it (farm/declines.c), */
    uint32_t decline_count;             /* how many these are, */
    uint32_t declines;                  /* how often it was said, */
    double first_decline;               /* since when, seconds, */
    char decline_reason[260];           /* and why, the last time */
    double rate_time[2];                /* two earlier points of the progress, for the speed */
    uint64_t rate_samples[2];
    job_checks_t *checks;     /* NULL: none */
    job_suspects_t *suspects; /* NULL: none */
    double brightest;         /* light of its scene (trust/plausible.c); 0: not looked for yet */
    uint64_t
        confirmed[BATCH_SUMS]; /* the largest magnitudes that two renderings agreed on beyond its bounds */
    bool several_bits;         /* machines with different bits have worked on it */
    bool progress_due;         /* it may be complete: farm_tick sees to it */
    bool stuck;                /* it is finishing, and its end waits for room on the disk */
    uint32_t news_count;       /* what was to be told of it so far in this process */
    uint32_t news_failures;    /* attempts to tell the last of it that failed */
    double news_since;         /* seconds, the first of these attempts; 0: none yet */
    double news_retry;         /* seconds, when to try again; 0: now */
    char remark[300];          /* what is to be known of it for the moment, beside the message */
    int pins;
};

/* A notice by worker number. */
typedef struct {
    uint64_t worker, job;
    bool flush, leave;
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
    id_table_t by_id;      /* indices of workers */
    rate_limit_t *comings; /* lines in the log on workers that come and go, by party, */
    uint64_t untold;       /* and those that were left out since untold_since (seconds) */
    double untold_since;
    trust_t *trust;
    double remarked; /* seconds, when the remarks of jobs were made */
    bool cast_out;   /* workers are outcasts that are connected still: farm_cast_out sees to it */
    bool work_due;   /* there may be something to do for idle workers: farm_next_notice sees to it */
    job_t **ranked;  /* see farm_rank_jobs */
    pending_t *notices;
    size_t notice_first, notice_count, notice_capacity; /* [first, count) are to be sent */
    double last_tick;
};

void farm_lock(farm_t *farm);
void farm_unlock(farm_t *farm);

/* ---- finding ------------------------------------------------------------------------------------------- */

/* NULL when there is none of that number. */
job_t *farm_find_job(const farm_t *farm, uint64_t id);
worker_t *farm_find_worker(const farm_t *farm, uint64_t id);

/* ---- noting -------------------------------------------------------------------------------------------- */

/* There may be something to do: idle workers are to be called. */
void farm_notify_idle(farm_t *farm);
/* A notice for a worker. */
void farm_notify(farm_t *farm, uint64_t worker, uint64_t job, bool flush);
/* Asks a worker to leave. */
void farm_notify_leave(farm_t *farm, uint64_t worker);
/* Tells the workers that have a job that it is over. */
void farm_notify_over(farm_t *farm, const job_t *job, bool flush);
/* The job's record has changed: the journal is to get it. */
void farm_record_changed(farm_t *farm, job_t *job);
/* The operator is to be told of the state that the job has now (farm/news.c). Called before
 * farm_record_changed. */
void farm_job_news(farm_t *farm, job_t *job);
/* Tells the users of a job something that stays true: adds it to the job's message. */
void farm_job_tell(farm_t *farm, job_t *job, const char *format, ...) __attribute__((format(printf, 3, 4)));

/* ---- workers ------------------------------------------------------------------------------------------- */

/* Units that a worker holds, of all jobs. */
size_t farm_worker_units(const farm_t *farm, const worker_t *worker);
enum {
    FARM_ASK_BATCHES = 12,  /* batch intervals in which a worker asks for work, if it does not hang, */
    FARM_LOAD_BATCHES = 120 /* or load a scene */
};
/* So many batch intervals, or seconds if that is longer. */
double farm_patience(const farm_t *farm, int batches);
/* True when a worker is connected, reaches the bulk socket, and has asked for work within farm_patience.
 * Those that have enough to do ask every second or so; one that loads a scene, or waits for its batch to be
 * let in, does not for a while; one that hangs does not ask. */
bool farm_worker_asks(const farm_t *farm, double now, const worker_t *worker, int batches);

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* Pixel samples of units. */
double farm_unit_samples(const job_t *job, const unit_t *units, size_t count);
/* True when the bits of a machine fit those that the job is made of. */
bool farm_bits_fit(const job_t *job, const hash_t *fingerprint);
/* True when the job_content_hash that somebody knows a job by is that of this one, or NULL. */
bool farm_content_fits(const job_t *job, const hash_t *content);
/* The MACs of units of a job that a worker is issued, or delivers; `check` is the number of the check, or 0.
 */
unit_mac_t farm_unit_mac(const farm_t *farm, const worker_t *worker, const job_t *job, uint64_t check);
/* True while the film of a job is in memory, */
bool job_has_film(const job_t *job);
/* has to be loaded first, */
bool job_awaits_film(const job_t *job);
/* and while a snapshot of it is open. */
bool job_is_saving(const job_t *job);
/* The film has sums that no checkpoint holds. */
void job_unsaved(job_t *job);
/* The film of a job is needed now: it is loaded if it is on the disk. */
void farm_want_film(farm_t *farm, job_t *job);
/* Frees the film, or has it freed by the last of those who hold it. */
void farm_job_free_film(farm_t *farm, job_t *job);
/* The shared film of a pinned job, kept from being freed until it is let go; NULL when it has none. */
shared_film_t *farm_job_film_hold(job_t *job);
void farm_job_film_let_go(farm_t *farm, job_t *job);
/* The same, called without the farm's lock, like the next. */
shared_film_t *job_film_hold(farm_t *farm, job_t *job);
void job_film_let_go(farm_t *farm, job_t *job);
job_settings_t farm_job_settings(farm_t *farm, const job_t *job);

#endif
