/* stored_film: the film of a job that is over, from its last checkpoint: for what its image does not have. */
#ifndef LIGHTMILL_STORED_FILM_H
#define LIGHTMILL_STORED_FILM_H

#include "master/farm/farm.h"
#include "master/store/film_store.h"

/* Loads the film and resolves it, as farm_resolve does; the caller frees the image. It takes the memory of a
 * film meanwhile: RESULT_LIMIT when those of jobs at work leave none. RESULT_INPUT when there is no film, or
 * none with all samples of the job. */
result_t stored_film_resolve(farm_t *farm, film_store_t *films, const job_record_t *record,
                             const film_extras_t *extras, film_image_t *image);

#endif
