/* docket: the jobs of a run, from `lightmill submit` to the proof that the image is the right one and the
 * account holds. Everything goes through the command as a user would use it, again and again until it works.
 *
 * For each job there is a reference: the same settings in `lightmill render`, which nobody disturbs. What the
 * master says of a job is checked every time it is asked:
 *
 *   - issued = counted + returned + out, always;
 *   - what is counted is never more than what is wanted, and never falls as long as the master lives;
 *   - a job that was accepted is known ever after;
 *   - at the end nothing is out, all is counted, nothing is skipped, and the pixels are those of the
 * reference.
 */
#ifndef LIGHTMILL_CHAOS_DOCKET_H
#define LIGHTMILL_CHAOS_DOCKET_H

#include "tests/chaos/dice.h"
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
/* True when every job that was submitted is proved. */
bool docket_settled(const docket_t *docket);
/* A new master answers: what it has counted may be less. */
void docket_new_master(docket_t *docket);
/* How many samples a job may lose when the master dies: not known here, so the most that was seen. */
typedef struct {
    size_t submitted, proved;
    uint64_t issued, counted; /* pixel samples of the proved jobs */
    uint64_t batches, batches_refused, units_reissued;
    uint64_t questions; /* answers of status that were checked */
    double longest;     /* seconds from the submission of a job to its proof */
} docket_sum_t;
docket_sum_t docket_sum(const docket_t *docket);
/* Says what is not proved and why. */
void docket_describe(const docket_t *docket);

#endif
