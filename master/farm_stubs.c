/* farm_stubs: stands in for what other parts bring: weak, so that the real ones take their place. To be
 * deleted when they are there. */
#include "master/farm_state.h"
#include "master/plan.h"

#include <stdlib.h>

#define STUB __attribute__((weak))

STUB bool farm_checks_pending(const farm_t *farm, const job_t *job)
{
    (void)farm, (void)job;
    return false;
}

STUB void farm_checks_free(job_checks_t **checks)
{
    *checks = NULL;
}

STUB void farm_suspects_free(job_suspects_t **suspects)
{
    *suspects = NULL;
}

STUB plan_verdict_t plan_next(const job_settings_t *settings, uint32_t round_count, const plan_round_t *last,
                              const film_t *film, plan_round_t *next, double *error)
{
    (void)settings, (void)round_count, (void)last, (void)film, (void)next;
    *error = 0;
    return PLAN_DONE;
}

STUB worker_report_t *farm_worker_report(farm_t *farm, double now, size_t *count)
{
    (void)farm, (void)now;
    *count = 0;
    return NULL;
}
