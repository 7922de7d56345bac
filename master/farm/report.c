/* report: the jobs as clients see them (see farm.h). */
#include "master/farm/parts.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Pixel samples that the job is likely to take in all; 0: not known. */
static double likely_total(const job_t *job)
{
    double total = (double)job_total_samples(&job->kept.settings);
    const error_point_t *last = error_history_last(&job->history);
    if (job->kept.settings.error <= 0 || last == NULL) return total;
    double ratio = last->error / job->kept.settings.error; /* the error falls with the root of the samples */
    double enough = fmax((double)last->samples * ratio * ratio, (double)job->kept.samples_done);
    return total > 0 ? fmin(total, enough) : enough;
}

/* Seconds until the job is done at the speed of the last minute or two; < 0 when not known. */
static double remaining_time(const job_t *job, double now)
{
    if (job->kept.state == JOB_FINISHING || job_state_final(job->kept.state)) return 0;
    if (job->kept.state != JOB_RUNNING) return -1;
    double remaining = -1;
    if (job->kept.settings.time_limit > 0)
        remaining = fmax(0, job->kept.settings.time_limit - farm_job_elapsed(job, now));
    double seconds = now - job->rate_time[0];
    double samples = (double)job->kept.samples_done - (double)job->rate_samples[0], total = likely_total(job);
    if (total <= 0 || samples <= 0 || seconds <= 0) return remaining;
    double left = (total - (double)job->kept.samples_done) / (samples / seconds);
    return remaining < 0 ? left : fmin(left, remaining);
}

void farm_add_remark(char *message, size_t size, const char *remark)
{
    size_t used = strlen(message);
    if (remark[0] != '\0' && used < size)
        snprintf(message + used, size - used, "%s%s", used > 0 ? "; " : "", remark);
}

job_report_t farm_report_job(const job_t *job, double now)
{
    const error_point_t *last = error_history_last(&job->history);
    job_report_t report = {.record = farm_job_record(job, now),
                           .checkpoint_age =
                               job->last_checkpoint > 0 ? fmax(now - job->last_checkpoint, 0) : -1,
                           .samples_total = job_total_samples(&job->kept.settings),
                           .remaining = remaining_time(job, now),
                           .workers = job->schedule != NULL ? (uint32_t)schedule_holders(job->schedule) : 0,
                           .error = last != NULL ? last->error : job->kept.error,
                           .evidence = trust_evidence(job)};
    if (job->film == FILM_OPEN || job->kept.state == JOB_FINISHING)
        farm_add_remark(report.record.message, sizeof report.record.message, job->remark);
    return report;
}

job_report_t *farm_report(farm_t *farm, double now, uint64_t id, size_t *count, uint32_t *workers)
{
    farm_lock(farm);
    size_t room = id == 0 ? farm->job_count : 1;
    job_report_t *reports = mem_alloc((room + 1) * sizeof *reports);
    *count = 0;
    for (size_t i = 0; i < farm->job_count; i++)
        if (id == 0 || farm->jobs[i]->kept.job == id) {
            reports[*count] = farm_report_job(farm->jobs[i], now);
            reports[(*count)++].evidence_limit = farm->options.evidence_limit;
        }
    *workers = 0;
    for (size_t i = 0; i < farm->worker_count; i++) *workers += farm->workers[i].connected;
    farm_unlock(farm);
    if (*count > 0) return reports;
    free(reports);
    return NULL;
}
