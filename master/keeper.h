/* keeper: the thread that keeps films on the disk. It writes checkpoints while the farm goes on, loads the
 * films of jobs that a restart or an extension brings back, and deletes those that nobody needs.
 *
 * DATA/films/job-<number>.<generation>.film is a checkpoint (checkpoint.h). Of a job that is not over the two
 * latest generations stay, of one that is over the last.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_KEEPER_H
#define LIGHTMILL_KEEPER_H

#include "master/farm.h"
#include "master/journal.h"

typedef struct keeper keeper_t;

typedef struct {
    farm_t *farm; /* kept by the caller, like the journal; both outlive the keeper */
    journal_t *journal;
    double interval;     /* seconds between checkpoints of a job, at least */
    uint64_t keep_bytes; /* what the films of jobs that are over and not retained may take on the disk */
    bool fleeting;       /* the directory goes with the process: nothing is written */
    int checkpoint_wake; /* the farm's eventfd */
} keeper_options_t;

#endif
