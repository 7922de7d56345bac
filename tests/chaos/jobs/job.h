/* job: one job of a run, from `lightmill submit` to the proof that its image is the right one and its account
 * holds. Everything goes through the command as a user would use it, again and again until it works.
 *
 * What the master says of a job is checked every time it is asked:
 *
 *   - issued = counted + returned + out, always;
 *   - what is counted is never more than what is wanted, and never falls as long as the master lives;
 *   - a job that was accepted is known until it is deleted, and what an order did is not undone;
 *   - at the end nothing is out, all is counted, nothing is skipped, and the pixels are those of the
 *     reference. */
#ifndef LIGHTMILL_CHAOS_JOB_H
#define LIGHTMILL_CHAOS_JOB_H

#include "tests/chaos/jobs/account.h"
#include "tests/chaos/jobs/references.h"
#include "tests/chaos/passes.h"

/* What the jobs of a run share. */
typedef struct {
    report_t *report;
    const char *folder; /* for images and logs */
    const char *master; /* its address */
    const passes_t *passes;
    references_t *references;
} job_setup_t;

typedef enum {
    JOB_SENDING,   /* the submission runs, or waits for its next attempt */
    JOB_UNSURE,    /* it failed: the next status tells whether the master has the job */
    JOB_RENDERING, /* the master has it */
    JOB_FETCHING,  /* it is done; the image is being fetched */
    JOB_COMPARING, /* the image is here, the reference may not be */
    JOB_EXTENDING, /* proved; the order for more samples is under way */
    JOB_PAUSING,   /* ordered once, whatever comes of it */
    JOB_RESUMING,  /* ordered until it goes on */
    JOB_DELETING,  /* proved; ordered until it is gone */
    JOB_PROVED,
    JOB_WRONG
} job_stage_t;

typedef struct {
    const job_setup_t *setup;
    const job_kind_t *kind;
    char *name;
    unsigned seed;
    job_stage_t stage;
    unsigned sent;    /* orders to submit it */
    bool promised;    /* its submission succeeded: the master may never forget it, until it is deleted */
    bool resumed;     /* so did the order to go on after a pause */
    uint64_t deleted; /* and that to delete the job of this number: it may never come back */
    bool lasting;     /* and that to extend it: it may never want as little as before */
    bool extended, paused;
    uint64_t first_total; /* samples that were wanted before it was extended */
    command_t command;
    double submitted, changed, next_try;
    const reference_t *reference;
    account_t account;   /* what the master said last */
    uint64_t counted;    /* when samples were out last: what the film really held, */
    unsigned counted_by; /* under this master */
    char *image;
    hash_t hash;
} job_t;

/* Which answer of the master a job's status comes from. */
typedef struct {
    double asked;    /* when the question was put */
    unsigned master; /* how many there have been; 0: another one has come since the question */
} job_answer_t;

/* The one with this number, from 1 on. `setup` stays the caller's. */
void job_begin(job_t *job, const job_setup_t *setup, const job_kind_t *kind, unsigned seed, size_t number,
               double now);
void job_free(job_t *job);
/* Does what is due. */
void job_tick(job_t *job, double now);
/* Takes what the master says of it; NULL: it does not know such a job. */
void job_take(job_t *job, const json_t *object, const job_answer_t *answer, double now);
/* Neither proved nor wrong. */
bool job_is_open(const job_t *job);
/* Says what it is at. */
void job_describe(const job_t *job);

/* The words of every command to the master: who it is, who we are. */
void job_master_words(const job_setup_t *setup, words_t *words);

#endif
