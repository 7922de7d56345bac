/* totals: what the farm has in all: jobs by state, workers, speed, and how many workers it could use. */
#ifndef LIGHTMILL_TOTALS_H
#define LIGHTMILL_TOTALS_H

#include "master/farm/farm.h"

enum { TOTALS_STATES = JOB_PAUSED + 1 }; /* of jobs; the first is not used */

/* What is there in all. */
typedef struct {
    uint64_t jobs[TOTALS_STATES];
    uint32_t workers, aside;
    uint64_t threads;
    double speed;    /* pixel samples a second */
    double left;     /* pixel samples that jobs wait for */
    uint64_t active; /* jobs that wait for samples */
} totals_t;

totals_t totals_take(farm_t *farm);
/* The workers, like those that are connected, which would end the work that is left in ten minutes; at
 * least one while there is work. A job that only time or its error ends asks for no number of samples, so for
 * one. */
uint64_t totals_wanted(const totals_t *totals);

#endif
