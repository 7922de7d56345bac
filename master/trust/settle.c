/* settle: what the comparison of renderings calls for on the disk and in the films (evidence.c has
 * the scheme): batches that are wrong are taken out, those that are no longer needed deleted. By the
 * checkpointer's thread, without the farm's lock. */
#include "master/trust/trust_state.h"

#include <stdio.h>
#include <stdlib.h>

enum { SAFE_AFTER = 2 }; /* checkpoints after which a batch that was taken out is not needed any more */

/* ---- taking out ---------------------------------------------------------------------------------------- */

/* The batch is about to be taken out: finds what its file is called then, and the weights with which its
 * samples were added. Inside the shared film no snapshot is taken, so any clock will do between this moment
 * and the one at which they are free again. NULL when the job has no schedule any more. */
static uint32_t *begin(farm_t *farm, job_t *job, const spool_head_t *head, spool_name_t *out)
{
    uint32_t *weights = NULL;
    farm_lock(farm);
    if (job->schedule != NULL) {
        schedule_account_t account = schedule_account(job->schedule);
        out->kind = SPOOL_OUT;
        out->out_clock = evidence_clock(&account) + 1;
        weights = mem_alloc(head->unit_count * sizeof *weights);
        for (size_t i = 0; i < head->unit_count; i++)
            weights[i] = schedule_weight(job->schedule, &head->units[i]);
        job->merging++;
    }
    farm_unlock(farm);
    return weights;
}

/* The film is without the batch, whose file has this name now: its samples are free again. Under the lock. */
static void note_out(farm_t *farm, job_t *job, const spool_head_t *head, const spool_name_t *name,
                     film_counts_t counts)
{
    evidence_t *evidence = evidence_find(job->checks, name->serial);
    schedule_uncount(job->schedule, head->units, head->unit_count);
    job->kept.counts = counts;
    job->kept.samples_done = schedule_done(job->schedule);
    job_unsaved(job);
    if (evidence != NULL) {
        evidence->name = *name;
        evidence->kind = SPOOL_OUT;
        evidence->saved = job->checks->saved + job_is_saving(job);
    }
    farm_notify_idle(farm);
}

/* Takes a batch out of the film. That it is out is noted on the disk before: the film on the disk has it
 * until a later snapshot is safe, and is told so by the clock. RESULT_CANCELLED: the job is over.
 * RESULT_LIMIT: not now. */
static result_t subtract(farm_t *farm, job_t *job, shared_film_t *shared_film, const spool_name_t *from,
                         const batch_t *batch, const spool_head_t *head,
                         const zmq_msg_t payload[BATCH_PAYLOADS])
{
    const char *dir = farm->options.spool_dir;
    spool_name_t to = *from;
    uint32_t *weights = begin(farm, job, head, &to);
    if (weights == NULL) return result_fail(RESULT_CANCELLED, "the job is over");
    result_t result = spool_rename(dir, job->kept.job, from, &to);
    if (result.code == RESULT_OK) {
        result = shared_film_merge_payload(shared_film, payload, batch, weights, -1);
        if (result.code != RESULT_OK) (void)spool_rename(dir, job->kept.job, &to, from);
    }
    free(weights);
    film_counts_t counts = shared_film_counts(shared_film);
    farm_lock(farm);
    if (result.code == RESULT_OK) note_out(farm, job, head, &to, counts);
    job->merging--;
    job->progress_due = true;
    farm_unlock(farm);
    return result;
}

/* The batch cannot be taken out. Under the lock. */
static void note_lost(farm_t *farm, job_t *job, const evidence_t *lost, const char *why)
{
    evidence_t *evidence = evidence_find(job->checks, lost->name.serial);
    log_error("job %llu: a batch with wrong sums stays in the film: %s", (unsigned long long)job->kept.job,
              why);
    farm_job_tell(farm, job, "a batch with wrong sums is in the image: render it again");
    job->progress_due = true;
    if (evidence != NULL) evidence->kind = SPOOL_NONE;
}

/* False when it cannot be done now, for want of room or memory, and is to be tried again. Under the lock. */
static bool noted(job_t *job, const result_t *result)
{
    job_checks_t *checks = job->checks;
    bool delayed = result->code == RESULT_LIMIT, before = checks != NULL && checks->delayed;
    if (checks != NULL) checks->delayed = delayed;
    if (delayed)
        snprintf(job->remark, sizeof job->remark, "wrong sums are still to be taken out of the film: %.200s",
                 result->message);
    else if (before)
        job->remark[0] = '\0';
    if (delayed && !before)
        log_warning("job %llu: %s; trying on", (unsigned long long)job->kept.job, job->remark);
    return !delayed;
}

/* False when it cannot be done now. */
static bool take_out(farm_t *farm, job_t *job, evidence_t evidence)
{
    const char *dir = farm->options.spool_dir;
    spool_head_t head;
    zmq_msg_t payload[BATCH_PAYLOADS];
    job_settings_t settings = farm_job_settings(farm, job);
    shared_film_t *shared_film = job_film_hold(farm, job);
    if (shared_film == NULL) return true; /* the job was closed just now */
    result_t result = spool_read(dir, job->kept.job, &evidence.name, &settings, &head, payload);
    if (result.code == RESULT_OK) {
        batch_t batch = {
            .settings = settings, .units = head.units, .unit_count = head.unit_count, .counts = head.counts};
        shared_film_enter(shared_film);
        result = subtract(farm, job, shared_film, &evidence.name, &batch, &head, payload);
        shared_film_leave(shared_film);
        spool_head_free(&head);
        for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    }
    farm_lock(farm);
    if (result.code != RESULT_OK && result.code != RESULT_LIMIT && result.code != RESULT_CANCELLED)
        note_lost(farm, job, &evidence, result.message);
    bool done = noted(job, &result);
    farm_unlock(farm);
    job_film_let_go(farm, job);
    return done;
}

/* ---- settling ------------------------------------------------------------------------------------------ */

typedef enum { TASK_NONE, TASK_DELETE, TASK_RENAME, TASK_TAKE_OUT } task_t;

/* What is to be done about a batch. */
static task_t task_for(const job_t *job, const evidence_t *evidence)
{
    bool safe = evidence->kind == SPOOL_OUT && job->checks->saved >= evidence->saved + SAFE_AFTER;
    if (safe || evidence->kind == SPOOL_NONE) return TASK_DELETE;
    if (evidence->kind != evidence->name.kind) return TASK_RENAME;
    bool possible = job->schedule != NULL && job_has_film(job) && job->film != FILM_CONDEMNED;
    return evidence->kind == SPOOL_WRONG && possible ? TASK_TAKE_OUT : TASK_NONE;
}

/* The next thing to do for a job, and a copy of what it is about: room is made first; that batches are wrong
 * is noted before the first is taken out. */
static task_t next_task(farm_t *farm, job_t *job, evidence_t *about)
{
    task_t task = TASK_NONE;
    farm_lock(farm);
    const job_checks_t *checks = job->checks;
    for (size_t i = 0; checks != NULL && i < checks->evidence_count && task != TASK_DELETE; i++) {
        task_t here = task_for(job, &checks->evidence[i]);
        if (here == TASK_NONE || (task != TASK_NONE && here >= task)) continue;
        task = here;
        *about = checks->evidence[i];
    }
    farm_unlock(farm);
    return task;
}

/* The file is needed no more. */
static bool delete_it(farm_t *farm, job_t *job, evidence_t evidence)
{
    spool_delete(farm->options.spool_dir, job->kept.job, &evidence.name);
    farm_lock(farm);
    evidence_t *found = evidence_find(job->checks, evidence.name.serial);
    if (found != NULL) {
        *found = job->checks->evidence[--job->checks->evidence_count];
        job->checks->bytes -= evidence.name.bytes;
    }
    farm_unlock(farm);
    return true;
}

/* Notes on the disk what a batch is; false when it cannot be done now. */
static bool rename_it(farm_t *farm, job_t *job, evidence_t evidence)
{
    spool_name_t to = evidence.name;
    to.kind = evidence.kind;
    result_t result = spool_rename(farm->options.spool_dir, job->kept.job, &evidence.name, &to);
    farm_lock(farm);
    evidence_t *found = evidence_find(job->checks, to.serial);
    if (found != NULL && result.code == RESULT_OK) found->name = to;
    if (result.code != RESULT_OK && result.code != RESULT_LIMIT)
        note_lost(farm, job, &evidence, result.message);
    bool done = noted(job, &result);
    farm_unlock(farm);
    return done;
}

void trust_settle(farm_t *farm, job_t *job)
{
    static bool (*const carry_out[])(farm_t *, job_t *, evidence_t) = {
        [TASK_DELETE] = delete_it, [TASK_RENAME] = rename_it, [TASK_TAKE_OUT] = take_out};
    evidence_t evidence;
    bool goes_on = true;
    for (task_t task; goes_on && (task = next_task(farm, job, &evidence)) != TASK_NONE;)
        goes_on = carry_out[task](farm, job, evidence);
}

void trust_tidy(farm_t *farm)
{
    size_t count;
    uint64_t *jobs = spool_jobs(farm->options.spool_dir, &count);
    for (size_t i = 0; i < count; i++) {
        farm_lock(farm);
        const job_t *job = farm_find_job(farm, jobs[i]);
        bool over = job == NULL || job_state_final(job->kept.state);
        farm_unlock(farm);
        if (over) spool_delete_job(farm->options.spool_dir, jobs[i]);
    }
    free(jobs);
}

result_t trust_sync(farm_t *farm)
{
    bool due = false;
    if (farm->options.spool_dir == NULL) return result_ok();
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++) due = due || farm->jobs[i]->checks != NULL;
    farm_unlock(farm);
    return due ? spool_sync(farm->options.spool_dir) : result_ok();
}
