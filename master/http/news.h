/* news: what has changed of jobs and workers since it was looked at last. */
#ifndef LIGHTMILL_HTTP_NEWS_H
#define LIGHTMILL_HTTP_NEWS_H

#include "common/text/json.h"
#include "master/farm/farm.h"

/* What was seen last. */
typedef struct {
    job_report_t *jobs;
    size_t job_count;
    worker_report_t *workers;
    size_t worker_count;
} news_t;

/* Takes over `data`. */
typedef void (*news_fn)(void *context, const char *type, json_t *data);

/* Looks at the farm, and tells nothing. */
void news_begin(news_t *news, farm_t *farm);
/* Looks again, and calls `tell` for each change: "job", "image", "worker". */
void news_tell(news_t *news, farm_t *farm, news_fn tell, void *context);
void news_free(news_t *news);

#endif
