/* plans: what the units of a job that learns are rendered by (common/film/learning.h).
 *
 * DESIGN. A plan is the sum of the lessons of some passes, which lie in the film: the first planes of one of
 * its sums. So a plan takes no memory of its own but its hash: what somebody fetches of it is added up then.
 * When a pass is about to open, the lessons of those that make its plan are settled: from then on nothing is
 * added to them or taken out of them, whatever becomes of the samples that they come from. So the plan stays
 * what it was, as long as the job lives, and is read without a lock. A pass does not open before what is
 * known to be wrong has been taken out.
 *
 * A checkpoint has the film, and how many passes are settled. So after a restart the plans are there again,
 * with the same hashes.
 *
 * A pass opens in three steps: in the locked film, where what is counted is in the sums, lessons are settled;
 * without any lock the plan is hashed; under the farm's lock the pass opens. */
#include "master/farm/parts.h"

#include <stdlib.h>
#include <string.h>

static hash_t plan_hash(const int64_t *lessons, const hash_t *content, uint32_t pass)
{
    size_t size = learning_plan_bytes();
    uint8_t *bytes = mem_alloc(size);
    learning_plan_write(pass, lessons, content, 0, bytes, size);
    hash_t hash = hash_bytes(bytes, size);
    free(bytes);
    return hash;
}

static hash_t content_of(const job_t *job)
{
    return job_content_hash(&job->kept.settings, &job->kept.blob);
}

/* The pass that may open now; 0: none. */
static uint32_t next_pass(const job_t *job)
{
    return job->film == FILM_OPEN && !trust_wrong(job) ? schedule_next_pass(job->schedule) : 0;
}

/* Called and left with the lock held, which is let go meanwhile. */
static void open_pass(farm_t *farm, job_t *job)
{
    shared_film_t *shared_film = farm_job_film_hold(job);
    hash_t content = content_of(job), hash;
    job->teaching = true;
    farm_unlock(farm);
    shared_film_lock(shared_film);
    farm_lock(farm);
    uint32_t pass = next_pass(job);
    if (pass > 0) {
        schedule_teach(job->schedule);
        shared_film_settle(shared_film, learning_teachers(pass));
    }
    farm_unlock(farm);
    shared_film_unlock(shared_film);
    if (pass > 0) hash = plan_hash(shared_film_lessons(shared_film), &content, pass);
    farm_lock(farm);
    farm_job_film_let_go(farm, job);
    job->teaching = false;
    if (pass == 0 || job->film != FILM_OPEN) return;
    job->plans[pass] = hash;
    schedule_open_pass(job->schedule);
    char hex[2 * HASH_BYTES + 1];
    hash_to_hex(&hash, hex);
    log_debug("job %llu: samples from %u on go by the plan %.8s", (unsigned long long)job->kept.job,
              learning_pass_begin(&job->kept.settings, pass), hex);
    farm_notify_idle(farm);
}

void farm_job_open_passes(farm_t *farm, job_t *job)
{
    while (!job->teaching && next_pass(job) > 0) open_pass(farm, job);
}

void plans_of_film(const film_t *film, const hash_t *blob, hash_t plans[LEARNING_PASSES])
{
    hash_t content = job_content_hash(&film->settings, blob);
    for (uint32_t pass = 0; pass < LEARNING_PASSES; pass++) {
        uint32_t teachers = learning_teachers(pass);
        bool made = teachers > 0 && teachers <= film->settled;
        plans[pass] = made ? plan_hash(film->sums[SUM_LESSONS], &content, pass) : (hash_t){{0}};
    }
}

void farm_name_plans(const job_t *job, work_t *work)
{
    for (uint32_t pass = 0; pass < LEARNING_PASSES; pass++) work->plans[pass] = (hash_t){{0}};
    if (!job_learns(&job->kept.settings)) return;
    for (size_t i = 0; i < work->unit_count; i++) {
        uint32_t pass = learning_pass(&job->kept.settings, work->units[i].first);
        work->plans[pass] = job->plans[pass];
    }
}

/* ---- for those who fetch them -------------------------------------------------------------------------- */

/* The job whose film has a plan; NULL when none has. */
static job_t *find_plan(const farm_t *farm, const hash_t *hash, uint32_t *pass)
{
    for (size_t i = 0; i < farm->job_count && !hash_is_zero(hash); i++)
        for (*pass = 0; *pass < LEARNING_PASSES && job_has_film(farm->jobs[i]); ++*pass)
            if (hash_equal(&farm->jobs[i]->plans[*pass], hash)) return farm->jobs[i];
    return NULL;
}

static result_t no_plan(void)
{
    return result_fail(RESULT_INPUT, "this master does not have the blob");
}

result_t farm_plan_size(farm_t *farm, const hash_t *hash, uint64_t *size)
{
    uint32_t pass;
    farm_lock(farm);
    bool found = find_plan(farm, hash, &pass) != NULL;
    farm_unlock(farm);
    if (!found) return no_plan();
    *size = learning_plan_bytes();
    return result_ok();
}

result_t farm_plan_read(farm_t *farm, const hash_t *hash, uint64_t offset, void *bytes, size_t length)
{
    uint32_t pass;
    hash_t content;
    farm_lock(farm);
    job_t *job = find_plan(farm, hash, &pass);
    shared_film_t *shared_film = job != NULL ? farm_job_film_hold(job) : NULL;
    if (shared_film != NULL) {
        job->pins++;
        content = content_of(job);
    }
    farm_unlock(farm);
    if (shared_film == NULL) return no_plan();
    learning_plan_write(pass, shared_film_lessons(shared_film), &content, offset, bytes, length);
    farm_lock(farm);
    farm_job_film_let_go(farm, job);
    farm_job_unpin(farm, job);
    farm_unlock(farm);
    return result_ok();
}
