/* error_history: see error_history.h. */
#include "master/store/error_history.h"

#include <math.h>
#include <string.h>

/* Samples that a point has more than the one before, as a factor: 47 points for ten times the samples. */
static const double growth = 1.05;

bool error_point_valid(const error_point_t *point)
{
    return point->samples > 0 && isfinite(point->elapsed) && point->elapsed >= 0 && isfinite(point->error) &&
           point->error > 0;
}

const error_point_t *error_history_last(const error_history_t *history)
{
    return history->count > 0 ? &history->points[history->count - 1] : NULL;
}

bool error_history_wants(const error_history_t *history, uint64_t samples)
{
    const error_point_t *last = error_history_last(history);
    if (last == NULL) return samples > 0;
    return samples < last->samples || (double)samples >= growth * (double)last->samples;
}

bool error_history_cut(error_history_t *history, uint64_t samples)
{
    size_t before = history->count;
    while (history->count > 0 && history->points[history->count - 1].samples > samples) history->count--;
    return history->count < before;
}

/* Drops the point, neither first nor last, whose neighbours are nearest to each other. */
static void thin(error_history_t *history)
{
    const error_point_t *points = history->points;
    size_t nearest = 1;
    double least = INFINITY;
    for (size_t i = 1; i + 1 < history->count; i++) {
        double ratio = (double)points[i + 1].samples / (double)points[i - 1].samples;
        if (ratio >= least) continue;
        least = ratio;
        nearest = i;
    }
    history->count--;
    memmove(history->points + nearest, history->points + nearest + 1,
            (history->count - nearest) * sizeof *points);
}

void error_history_add(error_history_t *history, const error_point_t *point)
{
    error_history_cut(history, point->samples);
    error_point_t *last = history->count > 0 ? &history->points[history->count - 1] : NULL;
    if (last != NULL && last->samples == point->samples) {
        last->error = point->error;
        return;
    }
    double elapsed = last != NULL ? fmax(last->elapsed, point->elapsed) : point->elapsed;
    if (history->count == ERROR_HISTORY_POINTS) thin(history);
    history->points[history->count] = *point;
    history->points[history->count++].elapsed = elapsed;
}
