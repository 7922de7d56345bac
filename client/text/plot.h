/* plot: how the error of a job falls, drawn in characters for a terminal. */
#ifndef LIGHTMILL_PLOT_H
#define LIGHTMILL_PLOT_H

#include "proto/wire/wire.h"

enum { PLOT_MIN_WIDTH = 40, PLOT_MAX_WIDTH = 120 };

/* The history in a job's status as lines of at most `width` ASCII characters (within the limits above):
 * error against samples a pixel, both logarithmic, with the job's target and the line that an error falls on
 * when it falls with the root of the samples. A last line says what that line promises of the target. Fresh
 * memory; NULL when there is nothing to draw: no history, or no settings. */
char *plot_error(const Lm__JobStatus *status, int width);

#endif
