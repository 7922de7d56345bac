/* tiles: the images that people watch while they converge: a pyramid of tiles (tile_pyramid.h) of each layer
 * that somebody looks at.
 *
 * Nothing is done for a job that nobody asks for. The first question begins a watch: a thread of its own
 * resolves the film, and again when more has been merged, at most once a second. All that it makes anew takes
 * at most TILES_SHARE of its time, whatever the number of jobs and of watchers, so that watching large images
 * does not take the master from its work. What nobody has asked for during TILES_KEEP is freed.
 *
 * Memory is bounded: by TILES_MAX_BYTES for all layers, by TILES_BAND_PIXELS for what is being resolved, and
 * by TILES_MAX_ANSWERS for what slow readers have not taken yet.
 */
#ifndef LIGHTMILL_TILES_H
#define LIGHTMILL_TILES_H

#include "master/farm/farm.h"
#include "master/http/watch/tile_pyramid.h"

enum {
    TILES_MAX_JOBS = 8,            /* watched at a time */
    TILES_BAND_PIXELS = 1 << 16,   /* that are resolved at a time, or one row: 12 MB at most */
    TILES_MAX_ANSWERS = 256 << 20, /* bytes of answers that are not sent yet, before the last of them */
};
#define TILES_MAX_BYTES                                                                                      \
    (UINT64_C(3) << 29)          /* of all pyramids; a sixteenth of the memory, where that is less */
#define TILES_INTERVAL 1.0       /* seconds between two snapshots of a layer, at least */
#define TILES_BUSY_INTERVAL 20.0 /* the same while turns are long in coming (pace.h) */
#define TILES_SHARE 0.015        /* of the thread's time */
#define TILES_KEEP 30.0          /* seconds */
#define TILES_HOLD 5.0           /* seconds for which a layer that was asked for does not go to make room */

typedef struct {
    farm_t *farm;
    /* The path of the image of a job that is over, in fresh memory; `data_dir` is handed in. */
    char *(*image_path)(const char *data_dir, uint64_t job);
    const char *data_dir; /* copied */
    uint64_t max_bytes;   /* of all pyramids; 0: TILES_MAX_BYTES */
    uint64_t max_answers; /* bytes; 0: TILES_MAX_ANSWERS */
} tiles_options_t;

typedef struct tiles tiles_t;

/* Starts the thread. The farm must outlive it. */
result_t tiles_start(const tiles_options_t *options, tiles_t **tiles);
/* Ends the thread, frees all pyramids and sets *tiles to NULL. */
void tiles_stop(tiles_t **tiles);

/* Answers at once with what there is, as pyramid_answer does, and sees to it that there will be something
 * newer. As long as there is nothing, the version is 0 and there are no tiles. The caller hands the answer to
 * tiles_release. RESULT_UNREACHABLE: there is no such job; RESULT_USAGE: the question is wrong; RESULT_INPUT:
 * the job has no such layer, or its image cannot be read; RESULT_LIMIT: too many jobs are watched already, or
 * there is no memory for one more layer or answer. */
result_t tiles_get(tiles_t *tiles, uint64_t job, layer_t layer, const tile_query_t *query, uint8_t **bytes,
                   size_t *size);
/* True when tiles_get would give something newer than the watcher has, query->since; the layer counts as
 * asked for. */
bool tiles_newer(tiles_t *tiles, uint64_t job, layer_t layer, const tile_query_t *query);
/* As tiles_get, but says that nothing has changed since query->since. */
result_t tiles_get_nothing(tiles_t *tiles, uint64_t job, const tile_query_t *query, uint8_t **bytes,
                           size_t *size);
/* Somebody has waited for tiles in vain: those that are there will not be seen by all for long, and newer
 * ones can wait too. */
void tiles_note_wait(tiles_t *tiles);
/* Frees an answer when it has been sent, from any thread. */
void tiles_release(tiles_t *tiles, uint8_t *bytes, size_t size);

#endif
