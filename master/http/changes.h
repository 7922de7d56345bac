/* changes: what has changed of jobs and workers since it was looked at last. */
#ifndef LIGHTMILL_CHANGES_H
#define LIGHTMILL_CHANGES_H

#include "common/text/json.h"
#include "master/farm/farm.h"

/* What was seen last. */
typedef struct {
    double time; /* of the look (clock_now) */
    job_report_t *jobs;
    size_t job_count;
    worker_report_t *workers;
    size_t worker_count;
} changes_t;

/* Takes over `data`. */
typedef void (*change_fn)(void *context, const char *type, json_t *data);

/* Looks at the farm, and tells nothing. */
void changes_begin(changes_t *changes, farm_t *farm);
/* Looks again, and calls `tell` for each change: "job", "image", "note", "worker". */
void changes_tell(changes_t *changes, farm_t *farm, change_fn tell, void *context);
void changes_free(changes_t *changes);

#endif
