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

STUB result_t farm_check_batch(farm_t *farm, double now, job_t *job, uint64_t worker, uint64_t check,
                               const unit_t *units, size_t count, const hash_t *digest, bool *merge)
{
    (void)farm, (void)now, (void)job, (void)worker, (void)check, (void)units, (void)count, (void)digest;
    *merge = true;
    return result_ok();
}

STUB void farm_check_keep(farm_t *farm, job_t *job, uint64_t worker, const batch_t *batch,
                          const zmq_msg_t payload[BATCH_PAYLOADS])
{
    (void)farm, (void)job, (void)worker, (void)batch, (void)payload;
}

STUB void farm_worker_delivered(farm_t *farm, double now, worker_t *worker, const job_t *job,
                                const unit_t *units, size_t count)
{
    (void)farm, (void)now, (void)worker, (void)job, (void)units, (void)count;
}

void batch_digest(const batch_t *batch, hash_t *hash);
STUB void batch_digest(const batch_t *batch, hash_t *hash)
{
    (void)batch;
    *hash = (hash_t){{0}};
}
