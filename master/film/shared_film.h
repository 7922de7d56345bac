/* shared_film: the film of a job, that many threads merge into while others copy or read it.
 *
 * Three kinds of users:
 *
 *   - mergers enter (any number at a time), add a batch, and leave. What is added under one
 *     shared_film_enter is seen by the other kinds whole or not at all;
 *   - readers lock: they wait for the mergers that are in, and keep new ones out meanwhile;
 *   - a checkpoint takes a snapshot under the lock, which costs next to nothing, and reads it at leisure: a
 *     page of the film is copied when it is read, or just before the first merge that would change it (copy
 *     on write). Merging goes on meanwhile; the price is the memory of the pages that were changed and not
 *     yet read.
 *
 * A page is SHARED_FILM_PAGE_BYTES of one of the film's arrays, the last one of each array shorter. Pages are
 * numbered through all arrays in the order of film_page_order.
 *
 * Thread-safe. Lock order: the shared film, then the farm, then a page.
 */
#ifndef LIGHTMILL_SHARED_FILM_H
#define LIGHTMILL_SHARED_FILM_H

#include "common/film/film.h"
#include "proto/wire/payload.h"

enum { SHARED_FILM_PAGE_BYTES = 1 << 20 };

typedef struct shared_film shared_film_t;
typedef struct shared_film_snapshot shared_film_snapshot_t;

/* A shared film around a film, which it takes over. */
shared_film_t *shared_film_new(film_t *film);
/* Frees shared film and film and sets *shared_film to NULL; nobody is in, no snapshot is open. */
void shared_film_destroy(shared_film_t **shared_film);

/* ---- mergers ---- */

void shared_film_enter(shared_film_t *shared_film);
void shared_film_leave(shared_film_t *shared_film);
/* Adds a batch from its payloads; `weights` has the weight of each of its units (schedule_weight), NULL: all
 * 1. With `sign` -1 what was added before is taken out again. To be called between enter and leave. `batch`
 * has settings, checked units and counts; its arrays are not used. The film's counts are updated too.
 * RESULT_PROTOCOL when the payloads do not decode to exactly the right size, or hold sums that no sample
 * can have; then the film is as it was. Sums that overflow are left out and counted. */
result_t shared_film_merge_payload(shared_film_t *shared_film, const zmq_msg_t payload[BATCH_PAYLOADS],
                                   const batch_t *batch, const uint32_t *weights, int sign);

/* How large the values of a batch may be. The magnitude of one, before it is weighted, must be less than the
 * next power of two after once + each * samples; samples are those of its unit, of a frame those of one pixel
 * on average. What has no bound here has `once` 0. */
typedef struct {
    uint64_t once[BATCH_SUMS], each[BATCH_SUMS]; /* in the units of the sum, each at most 2^62 */
    bool measured;                               /* the following is wanted */
    uint64_t top[BATCH_SUMS]; /* result: no magnitude was larger, and one is more than half of it */
} sum_limits_t;
/* Adds a batch as shared_film_merge_payload does with sign 1, unless it has a value beyond the limits or
 * makes a sum of the film overflow: then RESULT_CANCELLED, and the film is as it was. `top` is then not
 * known. */
result_t shared_film_merge_within(shared_film_t *shared_film, const zmq_msg_t payload[BATCH_PAYLOADS],
                                  const batch_t *batch, const uint32_t *weights, sum_limits_t *limits);
/* The film's counts, at any time. */
film_counts_t shared_film_counts(shared_film_t *shared_film);

/* ---- readers ---- */

const film_t *shared_film_lock(shared_film_t *shared_film);
void shared_film_unlock(shared_film_t *shared_film);
/* Settles the lessons of so many passes (film_t.settled). The shared film is locked by the caller. */
void shared_film_settle(shared_film_t *shared_film, uint32_t passes);
/* The lessons of the film, NULL when it has none. Those that are settled may be read at any time. */
const int64_t *shared_film_lessons(const shared_film_t *shared_film);

/* ---- checkpoints ---- */

/* Takes a snapshot; the shared film is locked by the caller. One at a time; to be freed before the shared
 * film is. */
shared_film_snapshot_t *shared_film_snapshot(shared_film_t *shared_film);
/* The counts as they were. */
film_counts_t shared_film_snapshot_counts(const shared_film_snapshot_t *snapshot);
/* Copies page `index` as it was to `bytes` (SHARED_FILM_PAGE_BYTES of room); returns its size. Each page can
 * be read once. */
size_t shared_film_snapshot_read(shared_film_snapshot_t *snapshot, size_t index, void *bytes);
void shared_film_snapshot_free(shared_film_snapshot_t **snapshot);

/* The number of pages of a film, and where one lies in it. */
size_t shared_film_page_count(const job_settings_t *settings);
void *shared_film_page(const film_t *film, size_t index, size_t *size);

#endif
