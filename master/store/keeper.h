/* keeper: the thread that keeps films on the disk. It writes checkpoints while the farm goes on, loads the
 * films of jobs that a restart or an extension brings back, and deletes those that nobody needs. It also
 * looks at scenes that may be damaged.
 *
 * Of a job that is not over the two latest checkpoints stay, of one that is over the last.
 */
#ifndef LIGHTMILL_KEEPER_H
#define LIGHTMILL_KEEPER_H

#include "master/farm/farm.h"
#include "master/store/blob_store.h"
#include "master/store/film_store.h"
#include "master/store/journal.h"

typedef struct keeper keeper_t;

typedef struct {
    farm_t *farm; /* kept by the caller, like the next three; all outlive the keeper */
    film_store_t *films;
    blob_store_t *blobs;
    journal_t *journal;
    double interval;     /* seconds between the checkpoints of a job, at least */
    uint64_t keep_bytes; /* what films of jobs that are over and not retained may take on the disk */
    int checkpoint_wake; /* the farm's eventfd */
} keeper_options_t;

/* Starts the thread. */
result_t keeper_start(const keeper_options_t *options, keeper_t **keeper);
/* Writes last checkpoints of the jobs that are not over, when the farm has been shut down, and joins the
 * thread. The calls below may still be made. */
void keeper_finish(keeper_t *keeper);
/* Finishes, if that was not done, frees everything and sets *keeper to NULL. */
void keeper_stop(keeper_t **keeper);

/* farm_order, in such a way that a film that the order needs does not go at the same time; from any thread.
 * RESULT_INPUT also when a job is to be extended whose film is no longer kept. */
result_t keeper_order(keeper_t *keeper, double now, const job_order_t *order);
/* Deletes the films of a job that is no longer known; from any thread. */
void keeper_delete(keeper_t *keeper, uint64_t job);
/* Deletes films of jobs that are over and not retained, the first to end first, until so many bytes are free
 * on the disk. False when they are not; from any thread. */
bool keeper_make_room(keeper_t *keeper, uint64_t bytes);

#endif
