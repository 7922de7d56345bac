/* job_list: the jobs of a run: submits one after the other, asks for the status of all again and again, and
 * knows which of them are proved. */
#ifndef LIGHTMILL_JOB_LIST_H
#define LIGHTMILL_JOB_LIST_H

#include "tests/chaos/passes.h"
#include "tests/chaos/report.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct job_list job_list_t;

typedef struct {
    report_t *report;
    const char *folder; /* for images, references and logs */
    const char *master; /* its address */
    const passes_t *passes;
    uint64_t seed;
    unsigned smaller; /* what the samples of jobs are divided by */
    size_t at_a_time; /* jobs that are open */
} job_list_setup_t;

job_list_t *job_list_new(const job_list_setup_t *setup);
void job_list_free(job_list_t **job_list);
/* Does what is due; with `more` new jobs are submitted when old ones complete. */
void job_list_tick(job_list_t *job_list, double now, bool more);
/* True when no job is open. */
bool job_list_settled(const job_list_t *job_list);
/* A new master answers: what it has counted may be less. */
void job_list_new_master(job_list_t *job_list);

typedef struct {
    size_t submitted, proved;
    uint64_t issued, counted; /* pixel samples */
    uint64_t batches, batches_refused, units_reissued;
    uint64_t questions; /* answers of status that were checked */
    double longest;     /* seconds from the submission of a job to its proof */
} job_list_sum_t;
job_list_sum_t job_list_sum(const job_list_t *job_list);
/* Says what is not proved and why. */
void job_list_describe(const job_list_t *job_list);

#endif
