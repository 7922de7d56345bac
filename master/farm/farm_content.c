/* farm_content: is what a worker has of this job, or of another one that had its number? (see farm.h) */
#include "master/farm/farm_state.h"

result_t farm_content_check(farm_t *farm, uint64_t id, const hash_t *content)
{
    if (content == NULL) return result_ok();
    farm_lock(farm);
    const job_t *job = farm_find_job(farm, id);
    bool same = true;
    if (job != NULL) {
        hash_t own = job_content_hash(&job->settings, &job->blob);
        same = hash_equal(content, &own);
    }
    farm_unlock(farm);
    if (same) return result_ok();
    return result_fail(RESULT_INPUT, "job %llu is another one than the batch was rendered for",
                       (unsigned long long)id);
}
