/* trust: see trust.h. */
#include "master/trust/trust_state.h"

#include <stdlib.h>

trust_t *trust_new(void)
{
    return mem_zalloc(1, sizeof(trust_t));
}

void trust_destroy(trust_t **trust)
{
    if (*trust == NULL) return;
    free((*trust)->standings);
    id_table_free(&(*trust)->by_who);
    free(*trust);
    *trust = NULL;
}

void trust_forget(job_t *job)
{
    checks_free(&job->checks);
    suspects_free(&job->suspects);
}

/* ---- workers ------------------------------------------------------------------------------------------- */

void trust_died(farm_t *farm, double now, worker_t *worker, bool back)
{
    bool excused = back || farm_worker_units(farm, worker) == 0;
    for (size_t i = 0; i < farm->job_count && !back; i++)
        excused |= suspects_died(farm, farm->jobs[i], worker);
    if (excused) return;
    standing_fell(farm, now, worker);
    window_lapsed(farm, now, worker);
}

void trust_lapsed(farm_t *farm, double now, worker_t *worker)
{
    for (size_t i = 0; i < farm->job_count; i++) suspects_recalled(farm, farm->jobs[i], worker->id);
    if (window_lapsed(farm, now, worker) && !standing_alone(farm, worker->party))
        trust_failed(farm, now, worker, "takes units again and again and delivers none");
}

void trust_lives(farm_t *farm, worker_t *worker)
{
    suspects_lives(farm, worker->id);
    standing_lives(farm, worker);
}

void trust_delivered(farm_t *farm, double now, worker_t *worker, job_t *job, const unit_t *units,
                     size_t count)
{
    standing_delivered(farm, now, worker);
    window_delivered(farm, worker);
    suspects_delivered(job, units, count);
}

/* ---- giving -------------------------------------------------------------------------------------------- */

trust_answer_t trust_take(farm_t *farm, double now, job_t *job, worker_t *worker, work_t *work)
{
    if (worker->quarantine == 0 && checks_take(farm, now, job, worker, work)) return TRUST_COMPARES;
    return suspects_take(farm, now, job, worker, work);
}

/* ---- jobs ---------------------------------------------------------------------------------------------- */

bool trust_waiting(const job_t *job)
{
    return suspects_waiting(job) || checks_waiting(job);
}
