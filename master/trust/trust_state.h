/* trust_state: what the files of this folder have for one another. Each calls those before it alone:
 * standing, window, then checks and evidence (which call each other: what is compared and what is kept are
 * two sides of one list), suspects, settle; trust.c turns the hooks of trust.h into their calls. All is
 * called under the farm's lock, unless it says otherwise. */
#ifndef LIGHTMILL_TRUST_STATE_H
#define LIGHTMILL_TRUST_STATE_H

#include "master/store/spool.h"
#include "master/trust/trust.h"

/* What is held against a party or a process (standing.c). */
typedef struct {
    uint64_t who; /* worker_t.party or .source */
    uint32_t failures;
    uint32_t passed;                     /* comparisons of its batches since it last sent wrong sums */
    double last_failure, until, touched; /* seconds */
    uint32_t lapses;                     /* of units since they were made up for by deliveries (window.c) */
    double lapsed;                       /* seconds, the last */
    double fruitless; /* seconds, since when units lapse and nothing is delivered; 0: not so */
    double length;    /* of the last time aside, seconds; 0: there was none */
    char reason[FARM_MAX_NAME + 1];
} standing_t;

struct trust {
    standing_t *standings;
    size_t standing_count;
    id_table_t by_who; /* indices of standings */
};

/* ---- standing.c ---- */

/* Finds a worker's party (from its key and address, if party_text is empty), and its process. */
void standing_identify(worker_t *worker);
/* A worker fell silent while it held units that are above suspicion; then it was heard of again after all. */
void standing_fell(farm_t *farm, double now, worker_t *worker);
void standing_lives(farm_t *farm, worker_t *worker);
void standing_delivered(farm_t *farm, double now, const worker_t *worker);
/* A party or a process sent wrong sums: it is put aside, whoever of it is connected. */
void standing_lied(farm_t *farm, double now, uint64_t who, const char *name, const char *why);

/* What is known of a party or a process; a new entry if need be. */
standing_t *standing_of(farm_t *farm, double now, uint64_t who);
/* NULL when nothing is. */
standing_t *standing_find(const farm_t *farm, uint64_t who);
/* True when no other party is connected. */
bool standing_alone(const farm_t *farm, uint64_t party);

/* ---- window.c ---- */

/* Units of the worker came back undelivered. True when its party has delivered nothing for very long, and
 * this is to be held against it. */
bool window_lapsed(farm_t *farm, double now, worker_t *worker);
/* A batch of the worker was counted: the window of its party opens again. */
void window_delivered(farm_t *farm, worker_t *worker);

/* ---- suspects.c ---- */

/* A worker is held for dead, and what it holds is about to be released. Returns true when its death may be
 * the fault of what it held. */
bool suspects_died(farm_t *farm, job_t *job, const worker_t *worker);
/* A worker is about to lose what it holds of the job, to one that is idle. */
void suspects_recalled(const farm_t *farm, job_t *job, uint64_t worker);
/* A worker that was held for dead is alive. */
void suspects_lives(farm_t *farm, uint64_t worker);
/* Units were counted: they are above suspicion. */
void suspects_delivered(job_t *job, const unit_t *units, size_t count);

/* Suspects for a worker: TRUST_ANY when there are none for it, TRUST_WAIT when it is to have some once it
 * holds nothing else, or TRUST_GIVEN. */
trust_answer_t suspects_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work);
/* True while there are units that are handed out alone. */
bool suspects_waiting(const job_t *job);
void suspects_free(job_suspects_t **suspects);

/* ---- checks.c ---- */

/* A source of batches of a job: a process, as it is known across its connections. */
typedef struct {
    uint64_t id, party; /* worker_t.source, .party */
    char name[FARM_MAX_NAME + 1];
    char party_text[FARM_MAX_PARTY + 1];
    uint32_t unkept; /* batches that are in the film and not on the disk */
} source_t;

/* A batch that was merged, and is kept on the disk. */
typedef struct {
    spool_name_t name; /* of its file; `clock` is that of the schedule when it was in the film (evidence.c) */
    spool_kind_t kind; /* what the file is to be called; SPOOL_NONE: it is to be deleted */
    size_t source;     /* index */
    uint64_t saved;    /* checkpoints that were safe, or begun, when it was taken out */
} evidence_t;

enum { CHECK_RENDERINGS = 5, CHECK_LOSERS = 8, MAX_CHECKS = 1 << 16 };

/* Whether a rendering is in the film of units whose first was doubted (plausible.c). */
typedef enum {
    DOUBT_NONE,    /* it was not */
    DOUBT_OPEN,    /* no; they are kept from others meanwhile */
    DOUBT_ANSWERED /* yes, or it is being merged */
} doubt_t;

/* Units that are rendered by several workers. */
typedef struct {
    uint64_t number;   /* random, not 0 */
    uint64_t evidence; /* serial of the batch that it is about; 0: that is not kept */
    bool whole;        /* all of a batch, splats too; else tiles alone */
    unit_t *units;     /* sorted */
    size_t count;
    double samples; /* pixel samples */
    hash_t fingerprint;
    struct {
        size_t source;
        hash_t digest;
    } renderings[CHECK_RENDERINGS]; /* the first is in the film, */
    doubt_t doubt;                  /* unless it was doubted */
    size_t rendering_count;
    uint64_t with;               /* the worker that renders it now; 0: none */
    double deadline;             /* seconds, of that worker */
    uint32_t tries;              /* that were in vain, */
    uint64_t lost[CHECK_LOSERS]; /* and the parties that lost it last */
} check_t;

struct job_checks {
    source_t *sources;
    size_t source_count;
    id_table_t by_id;     /* indices of sources */
    evidence_t *evidence; /* in no order */
    size_t evidence_count;
    uint64_t bytes; /* of it on the disk */
    check_t *checks;
    size_t check_count;
    uint64_t last_serial;
    uint64_t saved;  /* checkpoints that are safe on the disk */
    uint64_t unmade; /* comparisons that nobody could make */
    uint64_t unkept; /* batches that were not kept */
    bool given_up;   /* the job cannot be verified: its message says why */
    bool delayed;    /* wrong sums could not be taken out at the last attempt */
};

void checks_free(job_checks_t **checks);
/* True while there are renderings to compare that nobody does yet. */
bool checks_waiting(const job_t *job);
/* The state of a job's comparisons, made if need be. */
job_checks_t *checks_of(job_t *job);
/* The index of the process that a worker is, made if need be. */
size_t checks_source(job_checks_t *checks, const worker_t *worker);
/* What is to be compared of a batch of a party: its units, or some of them, in fresh memory. */
sample_t checks_sample(const farm_t *farm, const job_t *job, uint64_t party, const unit_t *units,
                       size_t count);
/* Finds the digest of what was chosen of a batch. Called without the lock. */
result_t checks_digest(const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch, sample_t *sample);
/* Wants another rendering of a sample (copied) of a batch: its evidence has this serial, 0: none. */
void checks_want(farm_t *farm, job_t *job, sample_t *sample, uint64_t evidence, size_t source,
                 const hash_t *fingerprint);
/* A source was found to send wrong sums: comparisons of its own batches are needless, others need another
 * rendering. */
void checks_forget(job_t *job, size_t source);
/* Work that is to be compared, for a worker; false when there is none. */
bool checks_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work);
/* True when a worker has units to compare. */
bool checks_held(const farm_t *farm, const worker_t *worker);

/* ---- evidence.c ---- */

/* The clock of a schedule with this account. */
uint64_t evidence_clock(const schedule_account_t *account);
/* The batch of a serial; NULL when there is none. */
evidence_t *evidence_find(const job_checks_t *checks, uint64_t serial);
/* All that a party or a process has in the film of any job is wrong, and is taken out of those that can be
 * rendered again. */
void evidence_condemn(farm_t *farm, uint64_t who);

#endif
