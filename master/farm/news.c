/* news: what the operator of the master is to be told of jobs (see farm.h).
 *
 * DESIGN. There is no queue beside the list of jobs, so nothing can overflow: a job has one piece of news at
 * most, the state that it came into last, and none once it has gone on from there. It is part of the job's
 * record: what a master did not live to tell, the next one does. Told twice is possible (the process ended
 * between the telling and the writing down), not told at all is not, unless it fails for as long as the
 * notifier tries. */
#include "master/farm/parts.h"

#include <math.h>

void farm_job_stuck(farm_t *farm, job_t *job)
{
    if (job->stuck || job->kept.state != JOB_FINISHING) return;
    job->stuck = true;
    farm_job_news(farm, job);
}

/* That a job is stuck is found out anew. */
void farm_news_restore(farm_t *farm, job_t *job)
{
    bool due = job->kept.news == job->kept.state && job->kept.news != JOB_FINISHING;
    if (job->kept.news == 0) return;
    job->kept.news = 0;
    if (due) farm_job_news(farm, job);
    farm_record_changed(farm, job);
}

static bool has_news(const job_t *job)
{
    return job->kept.news != 0 && job->kept.news == job->kept.state;
}

bool farm_next_news(farm_t *farm, double now, farm_news_t *news, double *wait)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++)
        if (has_news(farm->jobs[i]) && (found == NULL || farm->jobs[i]->news_retry < found->news_retry))
            found = farm->jobs[i];
    *wait = found == NULL ? INFINITY : fmax(found->news_retry - now, 0);
    bool due = found != NULL && *wait <= 0;
    if (due) {
        if (found->news_since <= 0) found->news_since = now;
        *news = (farm_news_t){farm_report_job(found, now), found->news_count, found->news_failures,
                              found->news_since};
    }
    farm_unlock(farm);
    return due;
}

/* The job that the news was of, if nothing newer is to be told of it. */
static job_t *find_job(farm_t *farm, const farm_news_t *news)
{
    job_t *job = farm_find_job(farm, news->report.record.job);
    return job != NULL && job->news_count == news->number ? job : NULL;
}

void farm_news_told(farm_t *farm, const farm_news_t *news)
{
    farm_lock(farm);
    job_t *job = find_job(farm, news);
    if (job != NULL) {
        job->kept.news = 0;
        farm_record_changed(farm, job);
    }
    farm_unlock(farm);
}

void farm_news_failed(farm_t *farm, const farm_news_t *news, double retry)
{
    farm_lock(farm);
    job_t *job = find_job(farm, news);
    if (job != NULL) {
        job->news_failures++;
        job->news_retry = retry;
    }
    farm_unlock(farm);
}
