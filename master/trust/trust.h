/* trust: verdicts on workers. This is the only header of the folder that others include: what the farm tells
 * it, and asks it.
 *
 * The folder knows five things. The farm sees only what follows from them:
 *
 *   - what is held against parties, which are put aside for it (standing.c);
 *   - how much a worker may hold, by what was delivered of late (window.c);
 *   - units that workers died with, which are handed out apart, or left out (suspects.c);
 *   - units that are rendered twice and compared (checks.c);
 *   - batches that are kept until their job is over, so that they can be taken out of the film again
 *     (evidence.c, settle.c).
 *
 * Trust calls nothing of the farm's. It writes its decisions into the state, and the farm acts on them:
 *
 *     worker_t.outcast, farm_t.cast_out   this worker is to be disconnected (farm_cast_out)
 *     worker_t.quarantine                 it is to have nothing but suspects, of this job
 *     job_t.progress_due                  the job may be complete (farm_tick)
 *     job_t.kept.message, job_t.remark    what its users are to know
 *
 * All is called under the farm's lock, unless it says otherwise. */
#ifndef LIGHTMILL_TRUST_H
#define LIGHTMILL_TRUST_H

#include "common/scene/scene_blob.h"
#include "master/state/state.h"

trust_t *trust_new(void);
/* Frees it and sets *trust to NULL. */
void trust_destroy(trust_t **trust);
/* Frees what is known of a job. */
void trust_forget(job_t *job);

/* ---- workers ------------------------------------------------------------------------------------------- */

/* Finds the party of a worker that says hello. RESULT_CANCELLED, with the reason, when it
 * may not join now. */
result_t trust_admit(const farm_t *farm, double now, worker_t *worker);
/* Why the worker is put aside; NULL when it is not. */
const char *trust_reason(const farm_t *farm, double now, const worker_t *worker);
/* The worker did something that is held against it: `why` completes "it ...". */
void trust_failed(farm_t *farm, double now, worker_t *worker, const char *why);
/* The worker fell silent and is held for dead; what it holds is about to be released. `back`: its process is
 * connected anew, it only lost its connection. */
void trust_died(farm_t *farm, double now, worker_t *worker, bool back);
/* One that was held for dead is heard of. */
void trust_lives(farm_t *farm, worker_t *worker);
/* What the worker held of a job was released. */
void trust_released(farm_t *farm, double now, job_t *job, uint64_t worker);
/* The worker is gone, and what it was to compare with it. */
void trust_left(farm_t *farm, const worker_t *worker);

/* ---- giving -------------------------------------------------------------------------------------------- */

typedef enum {
    TRUST_ANY,     /* it may be given any units, */
    TRUST_WAIT,    /* it gets nothing before it holds nothing */
    TRUST_GIVEN,   /* it was given units of the job */
    TRUST_COMPARES /* it was given units to render once more */
} trust_answer_t;

/* What a worker that asks for work is to be given of a job. */
trust_answer_t trust_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work);

/* How many pixel samples more the worker may be given of a job at which it is expected to do `speed` a
 * second; 0 or less: none before it delivers. */
double trust_room(const farm_t *farm, double now, const job_t *job, const worker_t *worker, double speed);
/* Seconds after its last delivery, or after it was given units, until a worker loses what it holds to one
 * that is idle. */
double trust_patience(const farm_t *farm, const worker_t *worker, const worker_t *idle);
/* The worker lost units since it did not deliver them in that time, or had never delivered any when another
 * overtook it. */
void trust_lapsed(farm_t *farm, double now, worker_t *worker);

/* ---- batches ------------------------------------------------------------------------------------------- */

/* RESULT_MISMATCH when nobody asked this worker for a batch with this number; else what it is of, in fresh
 * memory, without the digest. */
result_t trust_asked(const farm_t *farm, const job_t *job, uint64_t worker, uint64_t check, sample_t *sample);
/* Finds the digest of a batch from its payloads; fails when it has other units. Called without the farm's
 * lock. */
result_t trust_digest(const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch, sample_t *sample);
/* Decides over a batch that bears a number, by its digest: *merge is true when no rendering of its units is
 * in the film, and it goes there; *confirmed when it is then as another one that was doubted. Fails as
 * trust_asked does. */
result_t trust_compare(farm_t *farm, double now, job_t *job, uint64_t worker, uint64_t check,
                       const hash_t *digest, bool *merge, bool *confirmed);
/* A batch that a connected or lost worker delivered, with this number or 0, has sums that are too large to be
 * believed (plausible.c), and is not in the film; its units are free. They are rendered once more, by another
 * party if there is one, and compared. */
void trust_doubt(farm_t *farm, job_t *job, const worker_t *worker, uint64_t check, const unit_t *units,
                 size_t count, const hash_t *digest);
/* True when batches of the job are no longer doubted, since no two workers make the same bits of it. */
bool trust_believes_all(const job_t *job);

/* A batch that is kept until its job is over. */
typedef struct trust_keep trust_keep_t;
/* The units of a batch were counted just now, inside the shared film; NULL when it is not to be kept. */
trust_keep_t *trust_keep_begin(farm_t *farm, job_t *job, const worker_t *worker, const batch_t *batch);
/* It was merged: its payloads are written to the disk. Called without the farm's lock, inside the same. */
void trust_keep_write(farm_t *farm, const job_t *job, trust_keep_t *keep, const batch_t *batch,
                      const zmq_msg_t payload[BATCH_PAYLOADS]);
/* It is on the list from now on, if it was merged. Frees it and sets *keep to NULL. */
void trust_keep_end(farm_t *farm, job_t *job, trust_keep_t **keep, bool merged);
/* A batch of this worker was counted. */
void trust_delivered(farm_t *farm, double now, worker_t *worker, job_t *job, const unit_t *units,
                     size_t count);

/* ---- plausible.c --------------------------------------------------------------------------------------- */

/* The brightest light of a scene, in the sense of plausible.c. The blob was peeked at. */
double plausible_brightest(const scene_blob_t *blob);
/* What the values of a batch of the job may be, */
sum_limits_t plausible_limits(const job_t *job);
/* and of one that is believed, whatever it holds. */
sum_limits_t plausible_anything(void);
/* Values as large as in a batch that was merged within these limits are believed from now on. */
void plausible_confirm(job_t *job, const sum_limits_t *limits);

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* True when there are units to hand out of which the schedule says nothing: suspects, others to compare. */
bool trust_waiting(const job_t *job);
/* True while renderings to compare are out or to be had, or sums are to be taken out of the film; the job is
 * not complete before. */
bool trust_pending(const job_t *job);
/* Bytes on the disk of what can be taken out of the job. */
uint64_t trust_evidence(const job_t *job);
/* All that a party (by its key or address) or a worker (by its name) delivered to a job whose film is open is
 * taken out, and rendered again. RESULT_INPUT when nothing of it is there. */
result_t trust_take_out(farm_t *farm, job_t *job, const char *who);
/* True while there are sums to take out of the job's film. */
bool trust_wrong(const job_t *job);
/* True while that could not be done, and is tried again. */
bool trust_delayed(const job_t *job);
/* Write what is to be said now of the job's suspects and comparisons, "" for nothing. */
void suspects_remark(const job_t *job, char *text, size_t size);
void checks_remark(const farm_t *farm, double now, const job_t *job, char *text, size_t size);

/* ---- time, and the disk -------------------------------------------------------------------------------- */

/* Time passes. */
void trust_tick(farm_t *farm, double now);
/* A checkpoint of the job is safe on the disk. */
void trust_checkpointed(job_t *job);
/* The rest is called without the farm's lock. The film of a pinned job is about to be put in its place, with
 * this state (NULL: it begins anew): what is kept of its batches is looked through. */
void trust_loaded(farm_t *farm, job_t *job, const schedule_state_t *state);
/* Takes the sums that are wrong out of the film of a pinned job, and deletes what is kept for nothing. */
void trust_settle(farm_t *farm, job_t *job);
/* Deletes what is left of jobs that are over. */
void trust_tidy(farm_t *farm);
/* What is kept of batches is safe on the disk when this succeeds. */
result_t trust_sync(farm_t *farm);

#endif
