/* ledger: the jobs of a run, from `lightmill submit` to the proof that the image is the right one and the
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
#ifndef LIGHTMILL_CHAOS_LEDGER_H
#define LIGHTMILL_CHAOS_LEDGER_H

#include "tests/chaos/dice.h"
#include "tests/chaos/passes.h"
#include "tests/chaos/report.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct ledger ledger_t;

typedef struct {
    report_t *report;
    const char *folder; /* for images, references and logs */
    const char *master; /* its address */
    const passes_t *passes;
    uint64_t seed;
    size_t at_a_time; /* jobs that are open */
} ledger_setup_t;

ledger_t *ledger_new(const ledger_setup_t *setup);
void ledger_free(ledger_t **ledger);
/* Does what is due; with `more` new jobs are submitted when old ones complete. */
void ledger_tick(ledger_t *ledger, double now, bool more);
/* True when every job that was submitted is proved. */
bool ledger_settled(const ledger_t *ledger);
/* A new master answers: what it has counted may be less. */
void ledger_new_master(ledger_t *ledger);
/* How many samples a job may lose when the master dies: not known here, so the most that was seen. */
typedef struct {
    size_t submitted, proved;
    uint64_t issued, counted; /* pixel samples of the proved jobs */
    uint64_t batches, batches_refused, units_reissued;
    uint64_t questions; /* answers of status that were checked */
    double longest;     /* seconds from the submission of a job to its proof */
} ledger_sum_t;
ledger_sum_t ledger_sum(const ledger_t *ledger);
/* Says what is not proved and why. */
void ledger_describe(const ledger_t *ledger);

#endif
