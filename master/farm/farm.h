/* farm: the master's state: the queue of jobs and the workers, and everything that can happen to them. It
 * knows no sockets: the servers (proto/serve/) make the calls below by way of threads/farm_service.c, a test
 * makes them itself.
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

#include "master/state/types.h"
#include "master/store/error_history.h"
#include "master/store/job_record.h"

farm_t *farm_new(const farm_options_t *options);
/* Frees the farm and sets *farm to NULL; no job may be pinned. */
void farm_destroy(farm_t **farm);

/* ---- workers ------------------------------------------------------------------------------------------- */

/* Admits a worker and names it. RESULT_LIMIT when there are too many; RESULT_CANCELLED, with the reason, when
 * it is put aside. */
result_t farm_hello(farm_t *farm, double now, const identity_t *identity, const worker_hello_t *hello,
                    uint64_t *worker);
/* False when the worker is not known (any more). What it says that it does not hold goes back after a while.
 */
bool farm_heartbeat(farm_t *farm, double now, const identity_t *identity, uint64_t worker, uint64_t job,
                    uint32_t units_held);
/* The worker reaches the bulk socket; before that it gets no work. RESULT_UNREACHABLE when it is not known.
 */
result_t farm_worker_reached(farm_t *farm, double now, uint64_t worker);
/* What a worker says hinders it, for people; empty: nothing does. A new trouble is logged. */
void farm_worker_trouble(farm_t *farm, double now, uint64_t worker, const char *trouble);
/* The threads of a relay are those of its workers, and change. */
void farm_worker_threads(farm_t *farm, uint64_t worker, uint32_t threads);
/* The worker has units in hand, from an earlier life of this master or a lease that ended: those that nobody
 * else has are its own again. A job that waits in the queue begins for it: it had begun before. Nothing
 * happens when the units were not issued to it. */
void farm_reclaim(farm_t *farm, double now, const claim_t *claim);
/* The worker leaves: its units go back. `job` is one that it cannot render, for the reason it gives, or 0. A
 * job that nobody can render fails one day (declines.c). */
void farm_goodbye(farm_t *farm, double now, uint64_t worker, uint64_t job, const char *reason);
/* Work for a worker. RESULT_UNREACHABLE when the worker is not known: it should say hello again. */
result_t farm_take(farm_t *farm, double now, const identity_t *identity, uint64_t worker, uint64_t loaded_job,
                   uint64_t samples, uint64_t unit_samples, work_t *work);

bool farm_next_notice(farm_t *farm, notice_t *notice);

/* Time passes: leases and time limits end. To be called a few times a second, when all messages that came
 * have been handled. */
void farm_tick(farm_t *farm, double now);

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* Puts a job in the queue; settings and terms are checked, the blob is in the store. RESULT_LIMIT when the
 * queue is full of jobs that are not over or are retained, or the film does not fit into memory. */
result_t farm_submit(farm_t *farm, double now, const job_terms_t *terms, const job_settings_t *settings,
                     const hash_t *blob, uint64_t blob_size, uint64_t *job);
/* Does what a client orders (wire.h). RESULT_INPUT when there is no such job, or its state
 * does not allow it. After ORDER_DELETE the job is unknown here; its files are the caller's to delete. */
result_t farm_order(farm_t *farm, double now, const job_order_t *order);

/* A scene that should be looked at, since its job came back or a worker could not use it; false when there is
 * none. */
bool farm_next_scene(farm_t *farm, hash_t *blob);
/* A scene is gone or damaged: jobs that it belongs to pause, with the message FARM_NO_SCENE. */
void farm_scene_lost(farm_t *farm, double now, const hash_t *blob);

/* A job as clients see it. */
typedef struct {
    job_record_t record;     /* as it is now; the message with what is true for the moment */
    double checkpoint_age;   /* seconds; < 0: no checkpoint */
    uint64_t samples_total;  /* pixel samples; 0: only time ends the job */
    double remaining;        /* seconds; < 0: not known */
    uint32_t workers;        /* that hold units now */
    double error;            /* of the image, when it was last estimated; 0: not known */
    uint64_t evidence;       /* bytes on the disk of what can be taken out of it again, */
    uint64_t evidence_limit; /* and that all jobs may take */
} job_report_t;

/* The reports of one job or (job 0) of all in the order of submission, in fresh memory that the caller frees;
 * NULL and *count 0 when there are none. *workers is the number of connected workers. */
job_report_t *farm_report(farm_t *farm, double now, uint64_t job, size_t *count, uint32_t *workers);

/* A worker as clients see it. */
typedef struct {
    uint64_t number; /* of this connection: no other worker has it, while the master lives */
    char name[FARM_MAX_NAME + 1];
    char key[KEY_MAX_NAME + 1];         /* public key in Z85, or the name that the list of keys has for it */
    char address[WIRE_MAX_ADDRESS + 1]; /* of its host */
    uint32_t threads;
    hash_t fingerprint;
    bool relay, connected;
    char aside[FARM_MAX_NAME + 1]; /* why it is given no work; empty: it is */
    uint64_t job;
    uint32_t units_held;
    double speed; /* pixel samples a second */
    uint64_t batches, batches_refused, units_reissued, bytes;
    double last_seen; /* seconds ago */
} worker_report_t;

/* The reports of all workers, connected first, in fresh memory that the caller frees; NULL and 0 when none.
 */
worker_report_t *farm_worker_report(farm_t *farm, double now, size_t *count);

/* Connected workers of this name or host (wire_worker_is) get no more units and are asked to leave; they
 * deliver what they have begun. Returns how many there are. */
size_t farm_drain(farm_t *farm, const char *wanted);
/* Forgets the workers that are gone, which farm_tick does after an hour, or 5 minutes when they delivered
 * nothing. Those that are put aside stay on the list. Returns how many went. */
size_t farm_purge(farm_t *farm, double now);

/* ---- the error, and how it fell ------------------------------------------------------------------------ */

/* A copy of the history of a job's error, *count points from the first to the latest (error_history.h), in
 * fresh memory that the caller frees; NULL and *count 0 when there are none, or no such job. */
error_point_t *farm_job_history(farm_t *farm, uint64_t job, size_t *count);

/* Pins a job whose error is to be estimated now; NULL when there is none. A job's turn comes when it has a
 * few percent more samples, some seconds after the last time. */
job_t *farm_next_estimate(farm_t *farm, double now);
/* Estimates the error of a pinned job; takes some 45 ms of a core at most, in which nothing is merged into
 * its film. No picture and no decision depends on it. */
void farm_estimate(farm_t *farm, double now, job_t *job);

/* The next history that has changed since it was given out, and its job; false when there is none. */
bool farm_next_history(farm_t *farm, uint64_t *job, error_history_t *history);
/* It was not saved: it is given out again. */
void farm_history_unsaved(farm_t *farm, uint64_t job);
/* Gives a job that was made known again (farm_restore) its history. */
void farm_restore_history(farm_t *farm, uint64_t job, const error_history_t *history);

/* ---- what survives the process ------------------------------------------------------------------------- */

/* The next record that has changed since it was given out; false when there is none. Records change with
 * every order, every change of state and every checkpoint. */
bool farm_next_record(farm_t *farm, double now, job_record_t *record);
/* The record was not saved: it is given out again. */
void farm_record_unsaved(farm_t *farm, uint64_t job);
/* The record of a pinned job as it is now, for its checkpoint. */
job_record_t farm_record(farm_t *farm, double now, const job_t *job);
/* Tells the users of a pinned job something (its message), unless it has failed. */
void farm_note(farm_t *farm, job_t *job, const char *note);
/* Makes a job known again at the start of the process. One that is not over and has been worked on waits for
 * its film: farm_next_load gives it out. Until then its state is JOB_QUEUED, or JOB_PAUSED or JOB_FINISHING
 * as it was. */
void farm_restore(farm_t *farm, double now, const job_record_t *record);
/* Pins the job whose film is wanted first (a restart, an extended job whose turn it is) and sets memory aside
 * for it; NULL when there is none, or no memory. It is answered with one of the next two, then unpinned. */
job_t *farm_next_load(farm_t *farm);
/* Sets memory aside for a film that somebody looks at beside those of jobs; false when there is none. */
bool farm_claim_memory(farm_t *farm, uint64_t bytes);
void farm_return_memory(farm_t *farm, uint64_t bytes);
/* The film of a pinned job and the state of its schedule, both taken over (the state's arrays, not the
 * struct); film NULL: there is no checkpoint, it begins anew. RESULT_INPUT when the state does not fit the
 * job, which then begins anew. */
result_t farm_loaded(farm_t *farm, double now, job_t *job, film_t *film, schedule_state_t *state);
/* The film cannot be had for the moment or ever: the job fails with this message. */
void farm_load_failed(farm_t *farm, double now, job_t *job, const char *why);

/* Pins a job that has sums that no checkpoint holds: one that waits for its last checkpoint to be over (or
 * any, when the process ends), else the one whose last is oldest. NULL when there is none; *age is for how
 * long, seconds, work on it has been in none, and *last whether it is waited for. */
job_t *farm_next_checkpoint(farm_t *farm, double now, double *age, bool *last);
/* A snapshot of a pinned job's film and exactly the samples that it holds. False when it has no film (any
 * more), or a snapshot is open. The snapshot is freed by the caller, then farm_checkpointed is called. */
bool farm_snapshot(farm_t *farm, job_t *job, schedule_state_t *state, shared_film_snapshot_t **snapshot);
/* A checkpoint was written of a snapshot that was `taken` then; or it could not be: then farm_next_checkpoint
 * gives the job out again, and one that is finishing waits for a better time with its film. */
void farm_checkpointed(farm_t *farm, double taken, job_t *job, result_t written);

/* ---- batches ------------------------------------------------------------------------------------------- */

/* May this worker send a batch of this job? RESULT_LIMIT: not yet, its film is being loaded (grant_wake tells
 * when); any other failure says why it is not wanted. One of a job that waits in the queue may come, if there
 * is memory for its film: it shows whether the job had begun before. */
result_t farm_batch_wanted(farm_t *farm, double now, uint64_t worker, uint64_t job);
/* It was told so. */
void farm_batch_granted(farm_t *farm, double now, uint64_t worker);
/* RESULT_INPUT when `content` is not the job_content_hash of the job: it is of another one, which had its
 * number before this master lost its data. Nothing is said of an unknown job or when it is NULL. */
result_t farm_content_check(farm_t *farm, uint64_t job, const hash_t *content);
/* What is said of a batch that comes. */
typedef struct {
    uint64_t worker, job;
    uint64_t check;        /* the number that it bears, 0: none */
    const hash_t *content; /* farm_content_check; NULL: not said */
    const unit_t *units;   /* not checked against the job, */
    const issue_t *issues; /* and how they were issued */
    size_t unit_count;
    uint64_t bytes; /* of the message */
} batch_head_t;

/* A batch on its way into the film. */
typedef struct {
    job_settings_t settings; /* of the job, to decode the batch with; the rest is the farm's */
    job_t *job;
    uint64_t worker, check;
    hash_t blob; /* its job's scene, */
    bool dark;   /* and nobody has looked yet how bright that is (farm_batch_lights) */
    shared_film_t *shared_film;
    result_t asked;  /* of one that bears a number: whether it was asked for, */
    sample_t sample; /* and what was */
} farm_batch_t;

/* Pins the job that a batch is for; the reason for a failure is for the sender. RESULT_DENIED when not all of
 * its units were issued to the sender, which is held against it; RESULT_LIMIT: not yet, the film of the job
 * is being loaded. A job that waits in the queue begins. After success exactly one of the
 * next two is called. */
result_t farm_batch_begin(farm_t *farm, double now, const batch_head_t *head, farm_batch_t *open);
/* Tells how bright the scene of its job is, which was peeked at; it bounds the sums of batches. */
void farm_batch_lights(farm_t *farm, farm_batch_t *open, const scene_blob_t *blob);
/* Counts and merges a batch whole, or refuses it whole: then what the sender holds of its units goes back.
 * One whose sums are too large to be believed is refused (RESULT_MISMATCH), and its units are rendered once
 * more. `batch` has settings, checked units and counts; its sums are in the payloads. Takes as long as a pass
 * over the film; batches of one job may be merged by several threads at once. */
result_t farm_batch_commit(farm_t *farm, double now, farm_batch_t *open, const batch_t *batch,
                           const zmq_msg_t payload[BATCH_PAYLOADS]);
/* The batch was no good: what the sender holds of its units goes back. */
void farm_batch_abort(farm_t *farm, farm_batch_t *open, const unit_t *units, size_t count);

/* Does what the comparison of renderings calls for on the disk: takes the sums of those that were wrong out
 * of their films, and deletes what is no longer needed, the folders of unknown jobs too. To be called when
 * checkpoint_wake is written, by one thread, the one that loads films. */
void farm_settle(farm_t *farm);
/* What is kept of batches is safe on the disk: to be called between a snapshot and the moment at which its
 * checkpoint counts. */
result_t farm_sync(farm_t *farm);

/* ---- news (news.c) ------------------------------------------------------------------------------------- */

/* What the operator is to be told of a job: report.record.state says that it is over, or paused since its
 * scene is gone, or finishing and waiting for room on the disk. */
typedef struct {
    job_report_t report;
    uint32_t number;   /* for the answer */
    uint32_t failures; /* attempts so far */
    double since;      /* seconds, the first attempt */
} farm_news_t;
/* The next that is to be told now, those first that were not tried yet. False when there is none; *wait,
 * seconds, says when there is to be one again, INFINITY: not known. It is given out until one of the next two
 * is called, or the job goes on to another state, or is deleted. */
bool farm_next_news(farm_t *farm, double now, farm_news_t *news, double *wait);
/* It was told, or will never be. */
void farm_news_told(farm_t *farm, const farm_news_t *news);
/* That failed: it is given out again at `retry`. */
void farm_news_failed(farm_t *farm, const farm_news_t *news, double retry);

/* ---- images -------------------------------------------------------------------------------------------- */

/* Pins a job, to be unpinned; NULL when there is none of that number. */
job_t *farm_pin(farm_t *farm, uint64_t job);
void farm_unpin(farm_t *farm, job_t *job);
job_settings_t farm_job_settings(farm_t *farm, const job_t *job);
/* True when the images of the job that are kept have the halves (job_terms_t.halves). */
bool farm_job_halves(farm_t *farm, const job_t *job);
uint64_t farm_job_id(const job_t *job);
/* Pins a job that has all its samples and whose image is to be written or, if it failed, whose film is to be
 * freed; NULL when there is none. */
job_t *farm_next_finished(farm_t *farm);
/* Pins a job whose film stands at a milestone (job_settings_t.save_at), *spp samples a pixel, that an image
 * is to be written of; NULL when there is none. It comes before the job's last image. */
job_t *farm_next_milestone(farm_t *farm, uint32_t *spp);
/* That image was written to `path`: the job goes on. Or it could not be: the job waits, and it is given out
 * again after a while. */
void farm_milestone_written(farm_t *farm, double now, job_t *job, result_t written, const char *path);
/* Resolves the sums so far, with `extras` (NULL: none); the caller frees the image. RESULT_INPUT when nothing
 * has been rendered yet, or when the job is over and its image is in its file. */
result_t farm_resolve(farm_t *farm, double now, job_t *job, const film_extras_t *extras, film_image_t *image,
                      job_report_t *report);
/* Resolves some rows (film_resolve_rows) of the sums so far, without an estimate of the error. Rows that are
 * resolved one after the other may be of different moments; merges wait for each of them, not for the whole.
 */
result_t farm_resolve_rows(farm_t *farm, job_t *job, const film_rows_t *rows, film_image_t *image);
/* Batches merged so far, the version of the image, and whether the job has its last state. */
uint64_t farm_image_version(farm_t *farm, job_t *job, bool *over);
/* The image of a job that farm_next_finished gave out was written: when its last checkpoint is made too, it
 * gets its last state and its film is freed. Or the image could not be written: it is given out again after a
 * while. */
void farm_finished(farm_t *farm, double now, job_t *job, result_t written, const char *path);
/* The size of the plan of some job that has this hash, in bytes; RESULT_INPUT when none has. */
result_t farm_plan_size(farm_t *farm, const hash_t *hash, uint64_t *size);
/* Copies `length` bytes of it from `offset` on, which lie within it. */
result_t farm_plan_read(farm_t *farm, const hash_t *hash, uint64_t offset, void *bytes, size_t length);
/* The process ends: nothing more is handed out or taken. Jobs that are not over stay so; farm_next_checkpoint
 * gives out those that have sums to save. */
void farm_shut_down(farm_t *farm);

#endif
