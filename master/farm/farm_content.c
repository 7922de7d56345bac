/* farm_content: is what a worker has of this job, or of another one that had its number? (see farm.h) */
#include "master/farm/farm_state.h"

result_t farm_content_check(farm_t *farm, uint64_t id, const ProtobufCBinaryData *content)
{
    hash_t said;
    if (content->len == 0) return result_ok();
    if (!wire_hash_get(content, &said))
        return result_fail(RESULT_PROTOCOL, "a hash of %zu bytes, not %d", content->len, HASH_BYTES);
    farm_lock(farm);
    const job_t *job = farm_find_job(farm, id);
    bool same = true;
    if (job != NULL) {
        hash_t own = job_content_hash(&job->settings, &job->blob);
        same = hash_equal(&said, &own);
    }
    farm_unlock(farm);
    if (same) return result_ok();
    return result_fail(RESULT_INPUT, "job %llu is another one than the batch was rendered for",
                       (unsigned long long)id);
}
