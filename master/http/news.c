/* news: see news.h. */
#include "master/http/news.h"

#include <stdlib.h>
#include <string.h>

/* ---- jobs ---------------------------------------------------------------------------------------------- */

/* Jobs keep their order, so the one that is looked for is mostly where it was. */
static const job_report_t *find_job(const news_t *news, uint64_t job, size_t hint)
{
    if (hint < news->job_count && news->jobs[hint].record.job == job) return &news->jobs[hint];
    for (size_t i = 0; i < news->job_count; i++)
        if (news->jobs[i].record.job == job) return &news->jobs[i];
    return NULL;
}

static bool job_differs(const job_report_t *a, const job_report_t *b)
{
    const job_record_t *old = &a->record, *now = &b->record;
    return old->state != now->state || old->samples_done != now->samples_done || a->error != b->error ||
           a->samples_total != b->samples_total || a->workers != b->workers ||
           old->retained != now->retained || old->terms.priority != now->terms.priority ||
           old->settings.error != now->settings.error ||
           old->settings.time_limit != now->settings.time_limit || strcmp(old->message, now->message) != 0;
}

static json_t *job_news(const job_report_t *job)
{
    json_t *data = json_object();
    put_count(data, "job", job->record.job);
    put_text(data, "state", job_state_name(job->record.state));
    put_count(data, "samples_done", job->record.samples_done);
    put_count(data, "samples_total", job->samples_total);
    put_real(data, "elapsed", job->record.elapsed);
    put_real(data, "remaining", job->remaining);
    put_real(data, "error", job->error);
    put_count(data, "workers", job->workers);
    return data;
}

static json_t *image_news(const job_report_t *job)
{
    json_t *data = json_object();
    put_count(data, "job", job->record.job);
    put_count(data, "version", job->record.batches);
    return data;
}

static void tell_jobs(const news_t *before, const news_t *after, news_fn tell, void *context)
{
    for (size_t i = 0; i < after->job_count; i++) {
        const job_report_t *now = &after->jobs[i], *old = find_job(before, now->record.job, i);
        if (old == NULL || job_differs(old, now)) tell(context, "job", job_news(now));
        if (now->record.batches != (old != NULL ? old->record.batches : 0))
            tell(context, "image", image_news(now));
    }
    for (size_t i = 0; i < before->job_count; i++) {
        if (find_job(after, before->jobs[i].record.job, i) != NULL) continue;
        json_t *data = json_object();
        put_count(data, "job", before->jobs[i].record.job);
        put_text(data, "state", "deleted");
        tell(context, "job", data);
    }
}

/* ---- workers ------------------------------------------------------------------------------------------- */

static bool same_worker(const worker_report_t *a, const worker_report_t *b)
{
    return strcmp(a->name, b->name) == 0 && strcmp(a->key, b->key) == 0;
}

/* The worker of that name, which is connected rather than not; NULL when there is none. */
static const worker_report_t *find_worker(const news_t *news, const worker_report_t *like, size_t hint)
{
    const worker_report_t *found = NULL;
    if (hint < news->worker_count && news->workers[hint].connected && same_worker(&news->workers[hint], like))
        return &news->workers[hint];
    for (size_t i = 0; i < news->worker_count; i++) {
        if (!same_worker(&news->workers[i], like)) continue;
        if (news->workers[i].connected) return &news->workers[i];
        found = &news->workers[i];
    }
    return found;
}

static void tell_worker(const worker_report_t *worker, const char *what, news_fn tell, void *context)
{
    json_t *data = json_object();
    put_text(data, "name", worker->name);
    put_text(data, "what", what);
    put_text(data, "why", worker->aside);
    tell(context, "worker", data);
}

static void tell_workers(const news_t *before, const news_t *after, news_fn tell, void *context)
{
    for (size_t i = 0; i < after->worker_count; i++) {
        const worker_report_t *now = &after->workers[i], *old = find_worker(before, now, i);
        bool was_aside = old != NULL && old->aside[0] != '\0', is_aside = now->aside[0] != '\0';
        if (now->connected && (old == NULL || !old->connected)) tell_worker(now, "joined", tell, context);
        if (is_aside && !was_aside) tell_worker(now, "aside", tell, context);
        if (was_aside && !is_aside && now->connected) tell_worker(now, "back", tell, context);
    }
    for (size_t i = 0; i < before->worker_count; i++) {
        const worker_report_t *old = &before->workers[i], *now = find_worker(after, old, i);
        if (old->connected && (now == NULL || !now->connected)) tell_worker(old, "left", tell, context);
    }
}

/* ---- both ---------------------------------------------------------------------------------------------- */

static news_t look(farm_t *farm)
{
    news_t news;
    uint32_t connected;
    double now = clock_now();
    news.jobs = farm_report(farm, now, 0, &news.job_count, &connected);
    news.workers = farm_worker_report(farm, now, &news.worker_count);
    return news;
}

void news_begin(news_t *news, farm_t *farm)
{
    news_free(news);
    *news = look(farm);
}

void news_tell(news_t *news, farm_t *farm, news_fn tell, void *context)
{
    news_t now = look(farm);
    tell_jobs(news, &now, tell, context);
    tell_workers(news, &now, tell, context);
    news_free(news);
    *news = now;
}

void news_free(news_t *news)
{
    free(news->jobs);
    free(news->workers);
    *news = (news_t){0};
}
