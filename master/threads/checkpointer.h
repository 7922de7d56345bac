/* checkpointer: the thread that keeps films on the disk. It writes checkpoints while the farm goes on, loads
 * the films of jobs after a restart or for an extension, and deletes films that nobody needs. It also checks
 * scenes that may be damaged.
 *
 * A job that is not over keeps its two latest checkpoints, a job that is over its last one.
 */
#ifndef LIGHTMILL_CHECKPOINTER_H
#define LIGHTMILL_CHECKPOINTER_H

#include "master/farm/farm.h"
#include "master/store/blob_store.h"
#include "master/store/film_store.h"
#include "master/store/journal.h"

typedef struct checkpointer checkpointer_t;

typedef struct {
    farm_t *farm; /* kept by the caller, like the next three; all outlive the checkpointer */
    film_store_t *films;
    blob_store_t *blobs;
    journal_t *journal;
    double interval;     /* seconds between the checkpoints of a job, at least */
    double most;         /* seconds that a job's last checkpoint may be old; `interval` where that is more */
    uint64_t keep_bytes; /* what films of jobs that are over and not retained may take on the disk */
    int checkpoint_wake; /* the farm's eventfd */
} checkpointer_options_t;

/* Starts the thread. */
result_t checkpointer_start(const checkpointer_options_t *options, checkpointer_t **checkpointer);
/* Writes last checkpoints of the jobs that are not over, when the farm has been shut down, and joins the
 * thread. The calls below may still be made. */
void checkpointer_finish(checkpointer_t *checkpointer);
/* Finishes, if that was not done, frees everything and sets *checkpointer to NULL. */
void checkpointer_stop(checkpointer_t **checkpointer);

/* farm_order, in such a way that a film that the order needs does not go at the same time; from any thread.
 * RESULT_INPUT also when a job is to be extended whose film is no longer kept. */
result_t checkpointer_order(checkpointer_t *checkpointer, double now, const job_order_t *order);
/* Deletes the films of a job that is no longer known; from any thread. */
void checkpointer_delete(checkpointer_t *checkpointer, uint64_t job);
/* Deletes films of jobs that are over and not retained, the first to end first, until so many bytes are free
 * on the disk. False when they are not; from any thread. */
bool checkpointer_make_room(checkpointer_t *checkpointer, uint64_t bytes);

#endif
