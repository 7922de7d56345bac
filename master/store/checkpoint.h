/* checkpoint: one file with the film of a job and exactly the samples in it. The file appears whole or not at
 * all.
 *
 * The file holds the job's whole record (job_record_t), so the job can go on from this file and the scene
 * alone. Checksums cover every byte: what is read is right, or is refused. docs/durability.md gives the
 * layout.
 */
#ifndef LIGHTMILL_CHECKPOINT_H
#define LIGHTMILL_CHECKPOINT_H

#include "master/film/shared_film.h"
#include "master/store/job_record.h"

/* What a checkpoint says of itself. */
typedef struct {
    job_record_t record; /* as it was when the film was */
    uint64_t generation; /* the job's checkpoints are counted from 1 */
    double written;      /* seconds since 1970 */
    film_counts_t counts;
    uint64_t samples; /* pixel samples that the film holds */
} checkpoint_info_t;

/* What it took. */
typedef struct {
    uint64_t bytes;   /* size of the file */
    double wall, cpu; /* seconds */
} checkpoint_cost_t;

/* Writes a checkpoint of a snapshot and the state that goes with it, with `threads` threads. The file is on
 * the disk, under its name, when this returns RESULT_OK; otherwise there is none, and an older one of that
 * name is as it was. `info` gives record, generation and time; the rest is filled in. */
result_t checkpoint_write(const char *path, checkpoint_info_t *info, const schedule_state_t *state,
                          shared_film_snapshot_t *snapshot, int threads, checkpoint_cost_t *cost);

typedef struct checkpoint checkpoint_t; /* an open file, whose head is right */

/* Opens a checkpoint and checks its head. RESULT_INPUT, naming the file and what is wrong with it, when it is
 * damaged; RESULT_MISMATCH when it is of another version; RESULT_IO when it cannot be read. */
result_t checkpoint_open(const char *path, checkpoint_t **checkpoint);
const checkpoint_info_t *checkpoint_info(const checkpoint_t *checkpoint);
/* Reads and checks all of it with `threads` threads. The film is made with `settings`, which differ from
 * the record's in nothing but when to stop; it and the state are the caller's. Failures are those of
 * checkpoint_open, and RESULT_LIMIT when memory lacks. */
result_t checkpoint_load(checkpoint_t *checkpoint, const job_settings_t *settings, int threads, film_t **film,
                         schedule_state_t *state);
/* Closes it and sets *checkpoint to NULL. */
void checkpoint_close(checkpoint_t **checkpoint);

#endif
