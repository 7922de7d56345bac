/* totals: see totals.h. */
#include "master/http/totals.h"

#include <math.h>
#include <stdlib.h>

static const double DEMAND_SECONDS = 600; /* in which the workers that are wanted would end all work */

static void add_job(totals_t *totals, const job_report_t *report)
{
    job_state_t state = report->record.state;
    totals->jobs[state]++;
    if (state != JOB_QUEUED && state != JOB_RUNNING) return;
    totals->active++;
    if (report->samples_total > report->record.samples_done)
        totals->left += (double)(report->samples_total - report->record.samples_done);
}

static void add_worker(totals_t *totals, const worker_report_t *report)
{
    if (!report->connected) return;
    totals->workers++;
    totals->aside += report->aside[0] != '\0';
    totals->threads += report->threads;
    totals->speed += report->speed;
}

totals_t totals_take(farm_t *farm)
{
    totals_t totals = {0};
    size_t jobs, workers;
    uint32_t connected;
    job_report_t *job = farm_report(farm, clock_now(), 0, &jobs, &connected);
    worker_report_t *worker = farm_worker_report(farm, clock_now(), &workers);
    for (size_t i = 0; i < jobs; i++) add_job(&totals, &job[i]);
    for (size_t i = 0; i < workers; i++) add_worker(&totals, &worker[i]);
    free(job);
    free(worker);
    return totals;
}

uint64_t totals_wanted(const totals_t *totals)
{
    uint64_t usable = totals->workers - totals->aside;
    if (totals->active == 0) return 0;
    if (totals->speed <= 0 || usable == 0) return 1;
    double wanted = ceil(totals->left / (totals->speed / (double)usable) / DEMAND_SECONDS);
    return (uint64_t)fmin(fmax(wanted, 1), FARM_MAX_WORKERS);
}
