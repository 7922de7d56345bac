/* film_store: the checkpoints of all jobs on the disk.
 *
 * DIR/job-<number>.<generation>.film is a checkpoint (checkpoint.h) that was written whole. A damaged one is
 * renamed to ....film.damaged and is deleted with its job. Temporary files of unfinished checkpoints are
 * deleted; other files are not touched.
 *
 * Thread-safe.
 */
#ifndef LIGHTMILL_FILM_STORE_H
#define LIGHTMILL_FILM_STORE_H

#include "common/base.h"

typedef struct film_store film_store_t;

/* Opens the store, making the directory when it is missing, and looks at what is there. */
result_t film_store_open(const char *directory, film_store_t **store);
/* Frees the store and sets *store to NULL; the files stay. */
void film_store_close(film_store_t **store);

typedef struct {
    uint64_t job, generation;
    uint64_t bytes;
    double seconds; /* that it took to write; 0: an earlier process wrote it */
} film_file_t;

/* The checkpoints of a job (0: of all), by job and then latest first, in fresh memory that the caller frees;
 * NULL and *count 0 when there are none. */
film_file_t *film_store_list(film_store_t *store, uint64_t job, size_t *count);
/* Bytes of all checkpoints of a job; 0: there are none. */
uint64_t film_store_bytes(film_store_t *store, uint64_t job);
/* A number that no checkpoint of the job has had, as far as is known; later ones have larger ones. */
uint64_t film_store_next(film_store_t *store, uint64_t job);
/* The path of a checkpoint, in fresh memory. */
char *film_store_path(const film_store_t *store, uint64_t job, uint64_t generation);

/* A checkpoint was written: it is known from now on. Of the job, the latest `keep` stay, older ones are
 * deleted. */
void film_store_add(film_store_t *store, const film_file_t *file, size_t keep);
/* A checkpoint is damaged: it is set aside. */
void film_store_set_aside(film_store_t *store, uint64_t job, uint64_t generation);
/* Deletes all files of a job, for good when it returns: a film that comes back after a power cut would be
 * taken for one whose job the journal has lost. Returns the bytes of its checkpoints. */
uint64_t film_store_delete(film_store_t *store, uint64_t job);

/* Bytes that are free on the disk; UINT64_MAX when that is not known. */
uint64_t film_store_room(const film_store_t *store);

#endif
