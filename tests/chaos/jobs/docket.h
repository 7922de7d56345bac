/* docket: the jobs of a run: submits one after the other, asks for the status of all again and again, and
 * knows which of them are proved. */
#ifndef LIGHTMILL_DOCKET_H
#define LIGHTMILL_DOCKET_H

#include "tests/chaos/passes.h"
#include "tests/chaos/report.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct docket docket_t;

typedef struct {
    report_t *report;
    const char *folder; /* for images, references and logs */
    const char *master; /* its address */
    const passes_t *passes;
    uint64_t seed;
    size_t at_a_time; /* jobs that are open */
} docket_setup_t;

docket_t *docket_new(const docket_setup_t *setup);
void docket_free(docket_t **docket);
/* Does what is due; with `more` new jobs are submitted when old ones complete. */
void docket_tick(docket_t *docket, double now, bool more);
/* True when no job is open. */
bool docket_settled(const docket_t *docket);
/* A new master answers: what it has counted may be less. */
void docket_new_master(docket_t *docket);

typedef struct {
    size_t submitted, proved;
    uint64_t issued, counted; /* pixel samples */
    uint64_t batches, batches_refused, units_reissued;
    uint64_t questions; /* answers of status that were checked */
    double longest;     /* seconds from the submission of a job to its proof */
} docket_sum_t;
docket_sum_t docket_sum(const docket_t *docket);
/* Says what is not proved and why. */
void docket_describe(const docket_t *docket);

#endif
