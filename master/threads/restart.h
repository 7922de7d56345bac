/* restart: reads what a master finds in its data directory when it starts, and restores the jobs from it. */
#ifndef LIGHTMILL_RESTART_H
#define LIGHTMILL_RESTART_H

#include "master/farm/farm.h"
#include "master/store/blob_store.h"
#include "master/store/film_store.h"
#include "master/store/journal.h"

/* The number of the first job that none before it in this directory had. */
uint64_t restart_first_job(const journal_t *journal, film_store_t *films, const char *data_dir);

/* Makes the farm know the jobs of the journal, and those that only their films know, and says what there is.
 */
result_t restart_farm(farm_t *farm, journal_t *journal, film_store_t *films, blob_store_t *blobs);

#endif
