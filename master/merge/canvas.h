/* canvas: the film of a job, that many threads merge into while others copy or read it.
 *
 * Three kinds of users:
 *
 *   - mergers enter (any number at a time), add a batch, and leave. What is added under one canvas_enter is
 * seen by the other kinds whole or not at all;
 *   - readers lock: they wait for the mergers that are in, and keep new ones out meanwhile;
 *   - a checkpoint takes a snapshot under the lock, which costs next to nothing, and reads it at leisure: a
 * page of the film is copied when it is read, or just before the first merge that would change it (copy on
 * write). Merging goes on meanwhile; the price is the memory of the pages that were changed and not yet read.
 *
 * A page is CANVAS_PAGE_BYTES of one of the film's arrays, the last one of each array shorter. Pages are
 * numbered through all arrays: eye, splat, samples, features.
 *
 * Thread-safe. Lock order: the canvas, then the farm, then a page.
 */
#ifndef LIGHTMILL_CANVAS_H
#define LIGHTMILL_CANVAS_H

#include "proto/wire.h"

enum { CANVAS_PAGE_BYTES = 1 << 20 };

typedef struct canvas canvas_t;
typedef struct canvas_snapshot canvas_snapshot_t;

/* A canvas around a film, which it takes over. */
canvas_t *canvas_new(film_t *film);
/* Frees canvas and film and sets *canvas to NULL; nobody is in, no snapshot is open. */
void canvas_destroy(canvas_t **canvas);

/* ---- mergers ---- */

void canvas_enter(canvas_t *canvas);
void canvas_leave(canvas_t *canvas);
/* Adds a batch from its payloads; `weights` has the weight of each of its units (schedule_weight), NULL: all
 * 1. With `sign` -1 what was added before is taken out again. To be called between enter and leave. `batch`
 * has settings, checked units and counts; its arrays are not used. The film's counts are updated too.
 * RESULT_PROTOCOL when the payloads do not decode to exactly the right size, or hold features that no sample
 * can have; then the film is as it was. Sums that overflow are left out and counted. */
result_t canvas_merge_payload(canvas_t *canvas, const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch,
                              const uint32_t *weights, int sign);
/* The film's counts, at any time. */
film_counts_t canvas_counts(canvas_t *canvas);

/* ---- readers ---- */

const film_t *canvas_lock(canvas_t *canvas);
void canvas_unlock(canvas_t *canvas);

/* ---- checkpoints ---- */

/* Takes a snapshot; the canvas is locked by the caller. One at a time; to be freed before the canvas is. */
canvas_snapshot_t *canvas_snapshot(canvas_t *canvas);
/* The counts as they were. */
film_counts_t canvas_snapshot_counts(const canvas_snapshot_t *snapshot);
/* Copies page `index` as it was to `bytes` (CANVAS_PAGE_BYTES of room); returns its size. Each page can be
 * read once. */
size_t canvas_snapshot_read(canvas_snapshot_t *snapshot, size_t index, void *bytes);
void canvas_snapshot_free(canvas_snapshot_t **snapshot);

/* The number of pages of a film, and where one lies in it. */
size_t canvas_page_count(const job_settings_t *settings);
void *canvas_page(const film_t *film, size_t index, size_t *size);

#endif
