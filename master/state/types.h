/* types: the farm's limits and options. Servers see these and farm.h; what the farm is made of is in state.h.
 */
#ifndef LIGHTMILL_STATE_TYPES_H
#define LIGHTMILL_STATE_TYPES_H

#include "master/film/shared_film.h"
#include "master/schedule/schedule.h"
#include "proto/serve/serve_handler.h"
#include "proto/serve/unit_mac.h"

enum {
    FARM_MAX_JOBS = 1000,                 /* known at a time; the oldest finished ones are forgotten */
    FARM_MAX_WORKERS = SERVE_MAX_WORKERS, /* connected, and as many again that were lost and may still send a
                                             batch */
    FARM_MAX_NAME = SERVE_MAX_NAME,
    FARM_MAX_TROUBLE = 300,                 /* characters of what hinders a worker */
    FARM_MAX_PARTY = WIRE_MAX_ADDRESS + 10, /* of "key ..." or "address ..." */
    FARM_WORKER_THREADS = SERVE_WORKER_THREADS,
    FARM_RELAY_THREADS = SERVE_RELAY_THREADS,
    FARM_MAX_DECLINES = 3,  /* of a job that no worker has rendered any of; farm/declines.c */
    FARM_LONE_DECLINES = 8, /* where only one party could */
    FARM_DECLINERS = 16,    /* processes that are remembered for it, of a job */
    FARM_UNIT_DEATHS =
        12, /* workers that a unit has to end, while it is all they have, before it is left out */
    FARM_MAX_FAILURES = 3 /* of a party without a delivery between them, before it is put aside */
};
#define FARM_ASIDE_SECONDS 60.0 /* that a party is put aside for the first time; trust/standing.c */
/* The message of a job that is paused since it has no scene; it goes when the job is resumed. */
#define FARM_NO_SCENE                                                                                        \
    "its scene is not in the data directory any more: send it again (submit another job with it), then "     \
    "resume this one"

typedef struct farm farm_t;
typedef struct job job_t; /* a job that the caller has pinned: it is not forgotten */

/* What is compared of a batch (trust/checks.c). */
typedef struct {
    unit_t *units; /* of whoever has it */
    size_t count;
    bool whole; /* the whole batch, splats too; else tiles alone */
    hash_t digest;
} sample_t;

typedef struct {
    double lease;            /* seconds */
    double batch_interval;   /* seconds */
    uint64_t film_limit;     /* bytes that the films of all jobs may take */
    uint64_t first_job;      /* number of the first job */
    size_t job_limit;        /* jobs known at a time, at most FARM_MAX_JOBS */
    unit_secret_t secret;    /* shows the farm which units workers have from it */
    const char *spool_dir;   /* where batches of verified jobs are kept; NULL: jobs cannot be verified */
    uint64_t evidence_limit; /* bytes that they may take there */
    /* eventfds; -1: none */
    int control_wake;        /* written when there are notices to send */
    int image_wake;          /* when a job waits for its image */
    int journal_writer_wake; /* when a job's record has changed */
    int checkpoint_wake; /* when a film is to be loaded, or a last checkpoint to be made; -1: no film outlives
                            the process, and jobs end without */
    int news_wake;       /* when the operator is to be told something of a job; -1: nobody is to be told */
    int grant_wake; /* when a batch that was refused for the moment may now be taken: a film was loaded */
} farm_options_t;

#endif
