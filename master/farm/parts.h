/* parts: what the files of this folder have for one another. Each calls those before it alone: shares,
 * plans, jobs with errors and milestones, declines, workers, take, report, news, batches; then keep, orders
 * and farm. All is called under the farm's lock. */
#ifndef LIGHTMILL_FARM_PARTS_H
#define LIGHTMILL_FARM_PARTS_H

#include "master/farm/farm.h"
#include "master/state/state.h"
#include "master/trust/trust.h"

/* ---- shares.c ---- */

/* The job takes part in the sharing out (again), or at another priority: it is owed nothing for before. */
void farm_job_joins(farm_t *farm, job_t *job);
/* Jobs that a worker may be given units of, the one whose turn it is first, in memory of the farm that is
 * good until the next call; `fits` says which ones the worker may have at all. */
job_t *const *farm_rank_jobs(farm_t *farm, const worker_t *worker,
                             bool (*fits)(const worker_t *worker, const job_t *job), size_t *count);
/* True when the job has units to hand out, or may be started. */
bool farm_job_has_work(const job_t *job);
/* The workers have worked on for so many seconds. */
void farm_shares_tick(farm_t *farm, double seconds);

/* ---- jobs.c ---- */

/* Seconds that were spent on the job. */
double farm_job_elapsed(const job_t *job, double now);
/* All that outlives the process, as it is now. */
job_record_t farm_job_record(const job_t *job, double now);
void farm_job_free(farm_t *farm, job_t *job);
/* A pin less; a job that is gone is freed with its last. */
void farm_job_unpin(farm_t *farm, job_t *job);
/* Takes the job off the list. It is freed at once, or when its last pin goes; its record and its files are to
 * go. */
void farm_job_remove(farm_t *farm, job_t *job);
/* True when there is memory for one more film, that of this job. */
bool farm_job_has_room(const farm_t *farm, const job_t *job);
/* Makes film and schedule; false when it has to wait for memory, or for its film. A job that can never start
 * fails. */
bool farm_job_start(farm_t *farm, double now, job_t *job);
/* Gives a job its film and its schedule, which are taken over. */
void farm_job_install(farm_t *farm, double now, job_t *job, film_t *film, schedule_t *schedule);
/* The last batch is in: nothing more is taken, the image writer has the next word. */
void farm_job_close(farm_t *farm, double now, job_t *job, job_state_t outcome);
/* The job fails since its sums became too large (job->kept.counts.overflows). */
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

/* ---- plans.c ---- */

/* Opens the passes of a job that can be opened. Called like farm_job_progress. */
void farm_job_open_passes(farm_t *farm, job_t *job);
/* The hashes of the plans that were made from a film, which nobody else has yet. */
void plans_of_film(const film_t *film, const hash_t *blob, hash_t plans[LEARNING_PASSES]);
/* Names the plans that the units of a job go by. */
void farm_name_plans(const job_t *job, work_t *work);

/* ---- errors.c ---- */

/* The error of a job's image of so many pixel samples goes into its history; nothing happens when it is not
 * known (infinite). */
void farm_job_note_error(farm_t *farm, double now, job_t *job, uint64_t samples, double error);
/* The same of an image that was just resolved, where it is worth a point: the image is the last one, or has
 * enough more samples. Called without the farm's lock, with the shared film locked. */
void farm_note_image_error(farm_t *farm, double now, job_t *job, double error);
/* The job has fewer samples than before: its history ends with them. */
void farm_job_cut_history(farm_t *farm, job_t *job);

/* ---- milestones.c ---- */

/* The round of a job is counted: true when nothing goes on before an image is on the disk, which is seen to.
 */
bool farm_milestone_waits(farm_t *farm, job_t *job);
/* The job got its schedule: images of earlier rounds are there. */
void farm_milestone_installed(job_t *job);
/* The job is closed: an image that is due is tried once, of one that fails not at all. */
void farm_milestone_closed(job_t *job, job_state_t outcome);
/* The job's end does not wait for the image. */
void farm_milestone_give_up(job_t *job);
/* Time passes. */
void farm_milestone_tick(farm_t *farm, double now, job_t *job);

/* ---- declines.c ---- */

/* The worker, which held units of the job, cannot render it: the job may fail for that. */
void farm_declined(farm_t *farm, double now, job_t *job, const worker_t *worker, const char *reason);
/* True while the worker's process is not to be given units of the job, since it declined it. */
bool farm_has_declined(const job_t *job, const worker_t *worker, double now);
/* Writes what is to be said of a job that only was declined so far, "" for nothing. */
void farm_decline_remark(const job_t *job, char *text, size_t size);

/* ---- report.c ---- */

/* Adds a remark, unless it is "", to a text. */
void farm_add_remark(char *text, size_t size, const char *remark);

/* ---- workers.c ---- */

/* A connected worker, which is hereby heard of; NULL when it is not known (any more). */
worker_t *farm_worker_hear(farm_t *farm, double now, const identity_t *identity, uint64_t worker);
/* Takes back what a worker holds, of all jobs; returns the number of units. */
size_t farm_worker_take_back(farm_t *farm, double now, worker_t *worker);
/* The worker is given up since it was silent for too long. */
void farm_worker_fall(farm_t *farm, double now, worker_t *worker);
/* Disconnects those that a verdict has made outcasts. */
void farm_cast_out(farm_t *farm, double now);
/* What farm_tick does for the workers, beside their leases. Lets the lock go meanwhile. */
void farm_workers_tick(farm_t *farm, double now);
/* Adds units that were taken back to the counters. */
void farm_count_reissued(job_t *job, worker_t *worker, size_t units);
/* Threads of connected workers whose bits fit a job. */
uint32_t farm_fitting_threads(const farm_t *farm, const job_t *job);

/* ---- take.c ---- */

/* A batch of this worker is counted: the bits are those of its machine. */
void farm_note_bits(farm_t *farm, double now, job_t *job, const worker_t *worker);
/* The job is made of these bits from now on; who makes others and holds units of it loses them. */
void farm_bind(farm_t *farm, double now, job_t *job, const hash_t *fingerprint);
/* If nothing of the job is counted (any more), it is bound to no kind of machines. */
void farm_unbind(farm_t *farm, job_t *job);
/* A worker of the kind that has most threads; NULL when none is connected. */
const worker_t *farm_largest_kind(const farm_t *farm, double now);
/* A batch of this worker was counted: its speed is known anew. */
void farm_worker_delivered(farm_t *farm, double now, worker_t *worker, job_t *job, const unit_t *units,
                           size_t count);
/* A worker has delivered something: if it waits for that, it is called. */
void farm_worker_relieved(farm_t *farm, worker_t *worker);

/* ---- report.c ---- */

job_report_t farm_report_job(const job_t *job, double now);

/* ---- news.c ---- */

/* The job's end waits for room on the disk: the operator is told once. */
void farm_job_stuck(farm_t *farm, job_t *job);
/* The job is back after a restart: what was not told yet is to be told, if anybody is. */
void farm_news_restore(farm_t *farm, job_t *job);

#endif
