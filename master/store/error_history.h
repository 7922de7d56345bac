/* error_history: how the estimated error of a job fell, with the time and the samples that it took.
 *
 * A history holds at most ERROR_HISTORY_POINTS points, however long the job. When it is full, the point goes
 * whose neighbours are nearest to each other on a logarithmic scale of samples: what stays is spread evenly
 * over that scale, which is the one that an error falls straight on. The first and the last point stay.
 */
#ifndef LIGHTMILL_ERROR_HISTORY_H
#define LIGHTMILL_ERROR_HISTORY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { ERROR_HISTORY_POINTS = 200 };

typedef struct {
    double elapsed;   /* seconds of work on the job */
    uint64_t samples; /* pixel samples in the film */
    double error;     /* estimated relative error of the image (film_noise) */
} error_point_t;

/* The points have more samples one after the other, and do not go back in time. */
typedef struct {
    size_t count;
    error_point_t points[ERROR_HISTORY_POINTS];
} error_history_t;

/* True for what a point can be: some samples, an error above zero, all of it finite. */
bool error_point_valid(const error_point_t *point);
/* True when so many samples are enough more than those of the last point, or fewer, to be worth another. */
bool error_history_wants(const error_history_t *history, uint64_t samples);
/* Adds a valid point. Points of more samples go: what they tell of was lost, or taken out of the film. One of
 * as many samples gets the new error and keeps its time. */
void error_history_add(error_history_t *history, const error_point_t *point);
/* Drops the points of more samples; false when there were none. */
bool error_history_cut(error_history_t *history, uint64_t samples);
/* The last point; NULL when there is none. */
const error_point_t *error_history_last(const error_history_t *history);

#endif
