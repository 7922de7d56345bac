/* films: what tests do with batches and films: merge as the master does, merge in the plainest way, compare.
 * Nothing here ends a test. */
#ifndef LIGHTMILL_FILMS_H
#define LIGHTMILL_FILMS_H

#include "common/film/film.h"
#include "proto/wire/payload.h"

/* The payloads of a batch, which keeps its sums: coded as they go over a network, or as within a process. */
result_t encode_either(const batch_t *batch, bool compress, zmq_msg_t payload[BATCH_PAYLOADS]);
/* Adds a batch as the master does: encodes it and adds its payloads through a shared film around this one
 * (shared_film_merge_payload, which says what `weights` and `sign` are and when it fails). */
result_t merge_as_master(film_t *film, const batch_t *batch, const uint32_t *weights, int sign);
/* Adds a batch value by value, to be compared with what the product makes. */
void merge_plainly(film_t *film, const batch_t *batch);
/* True when all sums are the same. */
bool same_film(const film_t *a, const film_t *b);
bool same_sums(const batch_t *a, const batch_t *b);

#endif
