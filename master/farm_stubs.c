/* farm_stubs: stands in for what other parts bring: weak, so that the real ones take their place. To be
 * deleted when they are there. */
#include "master/farm_state.h"
#include "master/plan.h"

#include <stdlib.h>

#define STUB __attribute__((weak))

STUB plan_verdict_t plan_next(const job_settings_t *settings, uint32_t round_count, const plan_round_t *last,
                              const film_t *film, plan_round_t *next, double *error)
{
    (void)settings, (void)round_count, (void)last, (void)film, (void)next;
    *error = 0;
    return PLAN_DONE;
}
