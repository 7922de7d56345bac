/* film_load: finds the film of a job: the latest of its checkpoints that is whole.
 *
 * A damaged checkpoint is set aside, and the one before is used. A checkpoint that cannot be read for the
 * moment (an I/O error, a later version) is left alone. */
#ifndef LIGHTMILL_FILM_LOAD_H
#define LIGHTMILL_FILM_LOAD_H

#include "master/store/checkpoint.h"
#include "master/store/film_store.h"

typedef struct {
    film_t *film;           /* NULL: there is none */
    schedule_state_t state; /* of the film */
    checkpoint_info_t info; /* of the film */
    bool unreadable;        /* a checkpoint may be whole, but could not be read */
    result_t failure;       /* of the first checkpoint that could not be used */
    uint64_t most;          /* pixel samples of the best checkpoint, as its head says; 0: no head was whole */
} film_load_t;

/* Film and state are the caller's. `record` is the job as it is now, which may have been extended since. */
film_load_t film_load(film_store_t *films, const job_record_t *record, int threads);

#endif
