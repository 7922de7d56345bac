/* farm_settle: what the comparison of renderings calls for on the disk and in the films (farm_evidence.c has
 * the scheme): batches that are wrong are taken out, those that are no longer needed deleted. By the keeper's
 * thread, without the farm's lock. */
#include "master/farm/farm_workers.h"
#include "master/store/spool.h"

#include <stdlib.h>

enum { SAFE_AFTER = 2 }; /* checkpoints after which a batch that was taken out is not needed any more */

/* ---- taking out ---------------------------------------------------------------------------------------- */

/* The samples are free again, from now on. Returns the weights with which they were added; NULL when the job
 * has no schedule any more. */
static uint32_t *uncount(farm_t *farm, job_t *job, const spool_head_t *head, evidence_t *evidence)
{
    uint32_t *weights = NULL;
    farm_lock(farm);
    if (job->schedule != NULL) {
        weights = mem_alloc(head->unit_count * sizeof *weights);
        for (size_t i = 0; i < head->unit_count; i++)
            weights[i] = schedule_weight(job->schedule, &head->units[i]);
        schedule_uncount(job->schedule, head->units, head->unit_count);
        schedule_account_t account = schedule_account(job->schedule);
        evidence->out_clock = farm_evidence_clock(&account);
        job->merging++;
    }
    farm_unlock(farm);
    return weights;
}

/* Takes a batch out of the film, and notes on the disk that it is. RESULT_CANCELLED: the job is over. */
static result_t subtract(farm_t *farm, job_t *job, canvas_t *canvas, evidence_t *evidence,
                         const batch_t *batch, const spool_head_t *head,
                         const zmq_msg_t payload[BATCH_PAYLOADS])
{
    spool_name_t from = farm_evidence_name(evidence);
    uint32_t *weights = uncount(farm, job, head, evidence);
    if (weights == NULL) return result_fail(RESULT_CANCELLED, "the job is over");
    result_t result = canvas_merge_payload(canvas, payload, batch, weights, -1);
    free(weights);
    if (result.code == RESULT_OK) {
        evidence->state = EVIDENCE_OUT;
        spool_name_t to = farm_evidence_name(evidence);
        result_t renamed = spool_rename(farm->options.spool_dir, job->id, &from, &to);
        if (renamed.code != RESULT_OK) log_error("%s", renamed.message);
    }
    farm_lock(farm);
    if (result.code != RESULT_OK) (void)schedule_accept(job->schedule, head->units, head->unit_count);
    job->merging--;
    farm_unlock(farm);
    return result;
}

/* The film is without the batch. Under the lock. */
static void note_out(farm_t *farm, job_t *job, const evidence_t *out, film_counts_t counts)
{
    evidence_t *evidence = farm_evidence_find(job->checks, out->serial);
    job->counts = counts;
    if (job->schedule != NULL) job->samples_done = schedule_done(job->schedule);
    job->unsaved = true;
    farm->spooled = true;
    job->progress_due = true;
    if (evidence != NULL) {
        evidence->state = EVIDENCE_OUT;
        evidence->out_clock = out->out_clock;
        evidence->saved = job->checks->saved + job->saving;
    }
    farm_notify_idle(farm);
}

/* The batch cannot be taken out. Under the lock. */
static void note_lost(farm_t *farm, job_t *job, const evidence_t *lost, const char *why)
{
    evidence_t *evidence = farm_evidence_find(job->checks, lost->serial);
    log_error("job %llu: a batch with wrong sums stays in the film: %s", (unsigned long long)job->id, why);
    farm_job_tell(farm, job, "a batch with wrong sums is in the image: render it again");
    job->progress_due = true;
    if (evidence != NULL) evidence->state = EVIDENCE_NEEDLESS;
}

static void take_out(farm_t *farm, job_t *job, evidence_t evidence)
{
    const char *dir = farm->options.spool_dir;
    spool_head_t head;
    zmq_msg_t payload[BATCH_PAYLOADS];
    job_settings_t settings = farm_job_settings(farm, job);
    canvas_t *canvas = farm_canvas_hold(farm, job);
    if (canvas == NULL) return; /* the job was closed just now */
    spool_name_t name = farm_evidence_name(&evidence);
    result_t result = spool_read(dir, job->id, &name, &settings, &head, payload);
    film_counts_t counts = {.rays = 0};
    if (result.code == RESULT_OK) {
        batch_t batch = {
            .settings = settings, .units = head.units, .unit_count = head.unit_count, .counts = head.counts};
        canvas_enter(canvas);
        result = subtract(farm, job, canvas, &evidence, &batch, &head, payload);
        counts = canvas_counts(canvas);
        canvas_leave(canvas);
        spool_head_free(&head);
        for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    }
    farm_lock(farm);
    if (result.code == RESULT_OK)
        note_out(farm, job, &evidence, counts);
    else if (result.code != RESULT_CANCELLED)
        note_lost(farm, job, &evidence, result.message);
    farm_unlock(farm);
    farm_canvas_let_go(farm, job);
}

/* ---- settling ------------------------------------------------------------------------------------------ */

static bool is_needless(const job_checks_t *checks, const evidence_t *evidence)
{
    return evidence->state == EVIDENCE_NEEDLESS ||
           (evidence->state == EVIDENCE_OUT && checks->saved >= evidence->saved + SAFE_AFTER);
}

typedef enum { TASK_NONE, TASK_DELETE, TASK_BRAND, TASK_TAKE_OUT } task_t;

/* What is to be done about a batch. */
static task_t task_for(const job_t *job, const evidence_t *evidence)
{
    if (is_needless(job->checks, evidence)) return TASK_DELETE;
    if (evidence->state != EVIDENCE_WRONG) return TASK_NONE;
    if (!evidence->branded) return TASK_BRAND;
    bool possible = job->schedule != NULL && job->canvas != NULL && !job->canvas_condemned;
    return possible ? TASK_TAKE_OUT : TASK_NONE;
}

/* The next thing to do for a job, and a copy of what it is about: that batches are wrong is noted before the
 * first is taken out. One that is to be deleted is taken off the list. */
static task_t next_task(farm_t *farm, job_t *job, evidence_t *about)
{
    task_t task = TASK_NONE;
    farm_lock(farm);
    job_checks_t *checks = job->checks;
    for (size_t i = 0; checks != NULL && i < checks->evidence_count; i++) {
        task_t here = task_for(job, &checks->evidence[i]);
        if (here == TASK_NONE || (task != TASK_NONE && here >= task)) continue;
        task = here;
        *about = checks->evidence[i];
        if (task != TASK_DELETE) continue;
        checks->evidence[i] = checks->evidence[--checks->evidence_count];
        break;
    }
    farm_unlock(farm);
    return task;
}

/* Notes on the disk that a batch is wrong. */
static void brand(farm_t *farm, job_t *job, evidence_t evidence)
{
    spool_name_t from = farm_evidence_name(&evidence);
    evidence.branded = true;
    spool_name_t to = farm_evidence_name(&evidence);
    result_t result = spool_rename(farm->options.spool_dir, job->id, &from, &to);
    farm_lock(farm);
    evidence_t *found = farm_evidence_find(job->checks, evidence.serial);
    if (found != NULL && result.code == RESULT_OK) found->branded = true;
    farm->spooled = true;
    if (result.code != RESULT_OK) note_lost(farm, job, &evidence, result.message);
    farm_unlock(farm);
}

static void settle_job(farm_t *farm, job_t *job)
{
    evidence_t evidence;
    for (task_t task; (task = next_task(farm, job, &evidence)) != TASK_NONE;) {
        spool_name_t name = farm_evidence_name(&evidence);
        if (task == TASK_DELETE)
            spool_delete(farm->options.spool_dir, job->id, &name);
        else if (task == TASK_BRAND)
            brand(farm, job, evidence);
        else
            take_out(farm, job, evidence);
    }
}

/* Pins a job that has evidence, the first after number `after`. */
static job_t *next_job(farm_t *farm, uint64_t after)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (job->checks != NULL && job->id > after && (found == NULL || job->id < found->id)) found = job;
    }
    if (found != NULL) found->pins++;
    farm_unlock(farm);
    return found;
}

/* Deletes what is left of jobs that are over. */
static void tidy(farm_t *farm)
{
    size_t count;
    uint64_t *jobs = spool_jobs(farm->options.spool_dir, &count);
    for (size_t i = 0; i < count; i++) {
        farm_lock(farm);
        const job_t *job = farm_find_job(farm, jobs[i]);
        bool over = job == NULL || job_state_final(job->state);
        farm_unlock(farm);
        if (over) spool_delete_job(farm->options.spool_dir, jobs[i]);
    }
    free(jobs);
}

void farm_settle_checks(farm_t *farm, double now)
{
    (void)now;
    if (farm->options.spool_dir == NULL) return;
    uint64_t id = 0;
    for (job_t *job; (job = next_job(farm, id)) != NULL;) {
        id = job->id;
        settle_job(farm, job);
        farm_unpin(farm, job);
    }
    tidy(farm);
}

result_t farm_sync_checks(farm_t *farm)
{
    farm_lock(farm);
    bool due = farm->spooled;
    farm->spooled = false;
    farm_unlock(farm);
    if (!due) return result_ok();
    result_t result = spool_sync(farm->options.spool_dir);
    farm_lock(farm);
    if (result.code != RESULT_OK) farm->spooled = true;
    farm_unlock(farm);
    return result;
}
