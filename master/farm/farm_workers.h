/* farm_workers: what the files about workers share: farm_workers.c, farm_take.c, farm_standing.c,
 * farm_suspects.c, farm_checks.c, farm_evidence.c, farm_settle.c, farm_batches.c. All is called under the
 * farm's lock. */
#ifndef LIGHTMILL_FARM_WORKERS_H
#define LIGHTMILL_FARM_WORKERS_H

#include "master/farm/farm_state.h"
#include "master/store/spool.h"

/* ---- farm_workers.c ---- */

/* A connected worker, which is hereby heard of; NULL when it is not known (any more). */
worker_t *farm_worker_hear(farm_t *farm, double now, const identity_t *identity, uint64_t worker);
/* Units that a worker holds, of all jobs. */
size_t farm_worker_units(const farm_t *farm, const worker_t *worker);
/* Takes back what a worker holds, of all jobs; returns the number of units. */
size_t farm_worker_take_back(farm_t *farm, double now, worker_t *worker);
enum {
    FARM_ASK_BATCHES = 12,  /* batch intervals in which a worker asks for work, if it does not hang, */
    FARM_LOAD_BATCHES = 120 /* or load a scene */
};
/* So many batch intervals, or seconds if that is longer. */
double farm_patience(const farm_t *farm, int batches);
/* True when a worker is connected and has asked for work within farm_patience. Those that have enough to do
 * ask every second or so; one that loads a scene, or waits for its batch to be let in, does not for a while;
 * one that hangs does not ask. */
bool farm_worker_asks(const farm_t *farm, double now, const worker_t *worker, int batches);
/* Pixel samples of units. */
double farm_unit_samples(const job_t *job, const unit_t *units, size_t count);

/* ---- farm_take.c ---- */

/* True when the bits of a machine fit those that the job is made of. */
bool farm_bits_fit(const job_t *job, const hash_t *fingerprint);
/* A worker was given units, or delivers some: the bits are those of its machine. */
void farm_note_bits(farm_t *farm, job_t *job, const worker_t *worker);
/* A worker has delivered something: if it holds nothing any more and waits for that, it is called. */
void farm_worker_relieved(farm_t *farm, worker_t *worker);
/* A worker was given work, or delivered some: when is the rest to be here? */
void farm_worker_expect(const farm_t *farm, double now, worker_t *worker);

/* ---- farm_standing.c ---- */

/* Finds the names of a worker's machine and process. */
void farm_standing_identify(worker_t *worker);
/* Why a worker may not join now, as a failure; RESULT_OK when it may. */
result_t farm_standing_check(const farm_t *farm, double now, const worker_t *worker);
/* Why this machine or process is aside; NULL when it is not. */
const char *farm_standing_reason(const farm_t *farm, double now, const worker_t *worker);
/* A worker fell silent while it held units that are above suspicion; then it was heard of again after all. */
void farm_standing_fell(farm_t *farm, double now, worker_t *worker);
void farm_standing_lives(farm_t *farm, worker_t *worker);
void farm_standing_delivered(farm_t *farm, double now, const worker_t *worker);
/* The process sent wrong sums: it is put aside, whoever of it is connected. */
void farm_standing_lied(farm_t *farm, double now, uint64_t source, const char *name, const char *why);

/* ---- farm_suspects.c ---- */

/* A worker is held for dead, and what it holds is about to be released. *apart is true when it held nothing
 * but suspects. Returns true when its death may be the fault of what it held. */
bool farm_suspects_died(farm_t *farm, double now, job_t *job, const worker_t *worker, bool *apart);
/* A worker that was held for dead is alive. */
void farm_suspects_lives(farm_t *farm, uint64_t worker);
/* What a worker held was released: what is suspect of it is kept from others, or left out. */
void farm_suspects_returned(farm_t *farm, double now, job_t *job, uint64_t worker);
/* Units were counted: they are above suspicion. */
void farm_suspects_delivered(farm_t *farm, job_t *job, const unit_t *units, size_t count);

typedef enum {
    SUSPECTS_NONE, /* there are none for this worker */
    SUSPECTS_WAIT, /* it is to have some, when it holds nothing else: nothing for now */
    SUSPECTS_GIVEN
} suspects_answer_t;
suspects_answer_t farm_suspects_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work);
/* Writes how many units are kept apart; returns 0 when none. */
size_t farm_suspects_count(const job_t *job);

/* ---- farm_checks.c ---- */

/* A source of batches of a job: a process, as it is known across its connections. */
typedef struct {
    uint64_t id, machine; /* worker_t.source, .machine */
    char name[FARM_MAX_NAME + 1];
    char key[WIRE_KEY_TEXT + 1];
    uint32_t unvouched; /* batches since it was vouched for */
    uint32_t unkept;    /* those that could not be written to the disk, in all */
    double condemned;   /* seconds, when it was found to send wrong sums; < 0: it was not */
    double seen;        /* seconds, when it was last seen to be connected, about; 0: not looked for yet */
} source_t;

typedef enum {
    EVIDENCE_KEPT,    /* in the film, may have to be taken out */
    EVIDENCE_WRONG,   /* in the film, is to be taken out */
    EVIDENCE_OUT,     /* was taken out; kept until no checkpoint has it that may be needed */
    EVIDENCE_NEEDLESS /* its file is to be deleted */
} evidence_state_t;

/* A batch that was merged, and is kept on the disk (spool.h). */
typedef struct {
    uint64_t clock;     /* of the schedule, when it was in the film (farm_evidence.c) */
    uint64_t serial;    /* names it, from 1 */
    uint64_t out_clock; /* when it was taken out */
    size_t source;      /* index */
    evidence_state_t state;
    bool checked;   /* its units are being compared: its name on the disk says so, */
    bool branded;   /* and that it is wrong */
    uint64_t saved; /* checkpoints that were safe, or begun, when it was taken out */
} evidence_t;

enum { CHECK_RENDERINGS = 5, MAX_CHECKS = 1024 };

/* Units that are rendered by several workers. */
typedef struct {
    uint64_t number;   /* random, not 0 */
    uint64_t evidence; /* serial of the batch that it is about; 0: that is not there yet */
    uint64_t clock;    /* of that batch */
    unit_t *units;     /* sorted */
    size_t count;
    double samples; /* pixel samples */
    hash_t fingerprint;
    struct {
        size_t source;
        hash_t digest;
    } renderings[CHECK_RENDERINGS]; /* the first is in the film */
    size_t rendering_count;
    uint64_t with;   /* the worker that renders it now; 0: none */
    double deadline; /* seconds, of that worker */
    uint32_t tries;  /* that were in vain */
    double hopeless; /* seconds, since when nobody can make it; 0: somebody can */
} check_t;

struct job_checks {
    source_t *sources;
    size_t source_count;
    evidence_t *evidence; /* in no order */
    size_t evidence_count;
    check_t *checks;
    size_t check_count;
    uint64_t last_serial;
    uint64_t saved;  /* checkpoints that are safe on the disk */
    uint64_t unmade; /* comparisons that nobody could make */
    bool given_up;   /* the job cannot be verified: its message says why */
    bool delayed;    /* wrong sums could not be taken out at the last attempt */
};

/* The state of a job's comparisons, made if need be. */
job_checks_t *farm_checks_of(job_t *job);
/* The index of a source, made if need be. */
size_t farm_checks_source(job_checks_t *checks, uint64_t id, uint64_t machine, const char *name,
                          const char *key);
/* Wants another rendering of the units (copied) of a batch, whose own rendering has `digest`. */
void farm_checks_want(farm_t *farm, job_t *job, const evidence_t *evidence, const unit_t *units, size_t count,
                      const hash_t *fingerprint, const hash_t *digest);
/* The comparison that was begun with these units, by a source, and whose batch has just been merged; NULL
 * when there is none. */
check_t *farm_checks_begun(job_checks_t *checks, size_t source, const unit_t *units, size_t count);
/* True while a batch of a source is to be compared. */
bool farm_checks_open(const job_checks_t *checks, size_t source);
/* A source was found to send wrong sums: comparisons of its own batches are needless, others need another
 * rendering. */
void farm_checks_forget(job_t *job, size_t source);
/* Work that is to be compared, for a worker; false when there is none. */
bool farm_checks_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work);
/* True when the next unit of a worker that cannot be checked afterwards, a relay, is to be chosen beforehand;
 * it would be given about so many. */
bool farm_checks_marks(const farm_t *farm, const job_t *job, const worker_t *worker, double units);
/* What was just issued is its first rendering. */
void farm_checks_mark(farm_t *farm, double now, job_t *job, const worker_t *worker, work_t *work);
/* True when a worker has units to compare. */
bool farm_checks_held(const farm_t *farm, const worker_t *worker);
/* A worker has lost what it was to compare. */
void farm_checks_lost(farm_t *farm, const worker_t *worker);
/* Deadlines of comparisons; those that nobody can make. */
void farm_checks_tick(farm_t *farm, double now);
/* Writes what is to be said of the comparisons of a job now, "" for nothing. */
void farm_checks_remark(const farm_t *farm, double now, const job_t *job, char *text, size_t size);

/* ---- farm_evidence.c ---- */

/* The clock of a schedule with this account. */
uint64_t farm_evidence_clock(const schedule_account_t *account);
/* The batch of a serial; NULL when there is none. */
evidence_t *farm_evidence_find(const job_checks_t *checks, uint64_t serial);
/* What it is called on the disk. */
spool_name_t farm_evidence_name(const evidence_t *evidence);
/* A source is vouched for up to a clock; its evidence goes, but for what is still being compared. */
void farm_evidence_vouch(farm_t *farm, job_t *job, size_t source, uint64_t clock);
/* True when a source that is connected has delivered so many batches since it was vouched for that they must
 * not become more. */
bool farm_evidence_piles_up(const farm_t *farm, const job_t *job, size_t source);
/* Evidence of sources that are gone goes. To be called now and then. */
void farm_evidence_tick(farm_t *farm, double now);
/* All that a source has in the film of any job is wrong, and is taken out of those that can be rendered
 * again.
 */
void farm_evidence_condemn(farm_t *farm, double now, uint64_t source);

#endif
