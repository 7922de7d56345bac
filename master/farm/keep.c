/* keep: what of the farm outlives the process (see farm.h): the records of jobs, which the journal
 * writer writes down, and their films, which the checkpointer writes and loads.
 *
 * DESIGN. A record is given out whenever it has changed, as often as it takes: the journal holds the last
 * one. It says what the job is and how far it was, but not which samples are counted. That is in the
 * checkpoint, with the sums: the two are never apart, so no sample is lost or counted twice, however old a
 * checkpoint is. A job whose record and checkpoint do not tell the same (the process ended between the two)
 * is what its checkpoint says, and as far as its record says beyond that, only its counters differ.
 *
 * So a job that comes back (farm_restore) is put in the queue, and waits for its film if it ever had one.
 * What it does next is decided when the film is there: go on, or be closed if it was only its image that was
 * due. The same path is taken by a job that was over and is extended. */
#include "master/farm/parts.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- records ------------------------------------------------------------------------------------------- */

static job_record_t make_record(const job_t *job, double now)
{
    job_record_t record = farm_job_record(job, now);
    record.account.returned += record.account.out; /* that is what becomes of it */
    record.account.out = 0;
    return record;
}

bool farm_next_record(farm_t *farm, double now, job_record_t *record)
{
    bool found = false;
    farm_lock(farm);
    if (farm->removed_count > 0) {
        *record = (job_record_t){.job = farm->removed[--farm->removed_count], .removed = true};
        found = true;
    }
    for (size_t i = 0; i < farm->job_count && !found; i++) {
        found = farm->jobs[i]->record_due;
        if (!found) continue;
        farm->jobs[i]->record_due = false;
        *record = make_record(farm->jobs[i], now);
    }
    farm_unlock(farm);
    return found;
}

void farm_record_unsaved(farm_t *farm, uint64_t id)
{
    farm_lock(farm);
    job_t *job = farm_find_job(farm, id);
    if (job != NULL) {
        job->record_due = true;
    } else {
        farm->removed = mem_realloc(farm->removed, (farm->removed_count + 1) * sizeof *farm->removed);
        farm->removed[farm->removed_count++] = id;
    }
    farm_unlock(farm);
}

job_record_t farm_record(farm_t *farm, double now, const job_t *job)
{
    farm_lock(farm);
    job_record_t record = make_record(job, now);
    farm_unlock(farm);
    return record;
}

void farm_note(farm_t *farm, job_t *job, const char *note)
{
    farm_lock(farm);
    if (job->kept.state != JOB_FAILED) {
        snprintf(job->kept.message, sizeof job->kept.message, "%s", note);
        farm_record_changed(farm, job);
    }
    farm_unlock(farm);
}

/* ---- coming back --------------------------------------------------------------------------------------- */

static job_t *job_from_record(const job_record_t *record)
{
    job_t *job = mem_zalloc(1, sizeof *job);
    job->kept = *record;
    job->kept.message[sizeof job->kept.message - 1] = '\0';
    if (record->state == JOB_RUNNING) job->kept.state = JOB_QUEUED;
    bool touched = record->state != JOB_QUEUED || record->elapsed > 0 || record->batches > 0;
    job->scene_due = !job_state_final(job->kept.state);
    job->film = touched && !job_state_final(job->kept.state) ? FILM_WANTED : FILM_NONE;
    return job;
}

/* Puts a job in its place: the list is in the order of the numbers. */
static void insert_job(farm_t *farm, job_t *job)
{
    farm->jobs = mem_realloc(farm->jobs, (farm->job_count + 1) * sizeof(job_t *));
    size_t at = farm->job_count++;
    for (; at > 0 && farm->jobs[at - 1]->kept.job > job->kept.job; at--) farm->jobs[at] = farm->jobs[at - 1];
    farm->jobs[at] = job;
}

void farm_restore(farm_t *farm, double now, const job_record_t *record)
{
    farm_lock(farm);
    if (record->job > 0 && farm_find_job(farm, record->job) == NULL) {
        job_t *job = job_from_record(record);
        insert_job(farm, job);
        farm_news_restore(farm, job);
        if (record->job >= farm->next_job) farm->next_job = record->job + 1;
        uint64_t bytes = film_bytes(&job->kept.settings);
        if (!job_state_final(job->kept.state) && bytes > farm->options.film_limit) {
            snprintf(job->kept.message, sizeof job->kept.message,
                     "its film takes %.1f GB and this machine has room for %.1f GB; it is kept on the disk: "
                     "extend the job on a larger one",
                     1e-9 * (double)bytes, 1e-9 * (double)farm->options.film_limit);
            job->film = FILM_NONE;
            farm_job_close(farm, now, job, JOB_FAILED);
        }
        wake_up(farm->options.checkpoint_wake);
    }
    farm_unlock(farm);
}

/* Which of two jobs is to have its film first. */
static bool loads_before(const job_t *a, const job_t *b)
{
    bool waits_a = a->kept.state == JOB_PAUSED, waits_b = b->kept.state == JOB_PAUSED;
    if (waits_a != waits_b) return waits_b;
    return a->kept.terms.priority > b->kept.terms.priority; /* else the one that was submitted first */
}

job_t *farm_next_load(farm_t *farm)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count && !farm->shut; i++) {
        job_t *job = farm->jobs[i];
        if (job->film != FILM_WANTED) continue;
        if (farm->film_bytes + film_bytes(&job->kept.settings) > farm->options.film_limit) continue;
        if (found == NULL || loads_before(job, found)) found = job;
    }
    if (found != NULL) {
        found->film = FILM_LOADING;
        found->pins++;
        farm->film_bytes += film_bytes(&found->kept.settings);
    }
    farm_unlock(farm);
    return found;
}

bool farm_claim_memory(farm_t *farm, uint64_t bytes)
{
    farm_lock(farm);
    bool room = farm->film_bytes + bytes <= farm->options.film_limit;
    if (room) farm->film_bytes += bytes;
    farm_unlock(farm);
    return room;
}

void farm_return_memory(farm_t *farm, uint64_t bytes)
{
    farm_lock(farm);
    farm->film_bytes -= bytes;
    wake_up(farm->options.checkpoint_wake); /* a film may have waited for it */
    farm_unlock(farm);
}

/* The film is there, or there is none: the job no longer waits for it. */
static void stop_waiting(farm_t *farm, job_t *job)
{
    job->film = FILM_NONE;
    wake_up(farm->options.grant_wake);
}

/* There is no checkpoint: what was counted is lost. */
static void begin_anew(farm_t *farm, double now, job_t *job)
{
    farm->film_bytes -= film_bytes(&job->kept.settings);
    if (job->gone) return;
    job->kept.samples_done = 0;
    job->kept.elapsed = 0; /* the time that it may take is that of what it has */
    job->kept.account = (schedule_account_t){0};
    job->kept.counts = (film_counts_t){0};
    job->kept.error = 0;
    farm_job_cut_history(farm, job);
    job->kept.saved = 0;
    if (job->kept.state == JOB_FINISHING && job->kept.outcome != JOB_DONE)
        farm_job_close(farm, now, job, job->kept.outcome);
    else if (job->kept.state == JOB_FINISHING)
        job->kept.state = JOB_QUEUED;
    farm_record_changed(farm, job);
    farm_notify_idle(farm);
}

/* The film is in its place: the job does what it was about to do. */
static void go_on(farm_t *farm, double now, job_t *job)
{
    job->last_checkpoint = now;
    farm_job_cut_history(farm, job);
    log_info("job %llu: its film is here, with %llu samples", (unsigned long long)job->kept.job,
             (unsigned long long)job->kept.samples_done);
    if (job->kept.counts.overflows > 0) {
        farm_job_fail_overflow(farm, now, job);
    } else if (job->kept.state == JOB_FINISHING && job->kept.outcome != JOB_DONE) {
        farm_job_close(farm, now, job, job->kept.outcome);
    } else if (job->kept.state != JOB_PAUSED) {
        job->kept.state = JOB_RUNNING;
        job->started = now;
        job->ended = 0;
        farm_record_changed(farm, job);
    }
    farm_job_progress(farm, now, job);
    farm_notify_idle(farm);
}

result_t farm_loaded(farm_t *farm, double now, job_t *job, film_t *film, schedule_state_t *state)
{
    schedule_t *schedule = NULL;
    result_t result = result_ok();
    hash_t plans[LEARNING_PASSES] = {{{0}}};
    if (film != NULL) plans_of_film(film, &job->kept.blob, plans);
    trust_loaded(farm, job, film != NULL ? state : NULL);
    farm_lock(farm);
    stop_waiting(farm, job);
    if (film != NULL && !job->gone) result = schedule_restore(&job->kept.settings, state, &schedule);
    if (film != NULL) schedule_state_free(state);
    if (schedule == NULL) film_destroy(&film);
    if (schedule != NULL) {
        farm_job_install(farm, now, job, film, schedule);
        memcpy(job->plans, plans, sizeof plans);
        go_on(farm, now, job);
    } else {
        begin_anew(farm, now, job);
    }
    farm_unlock(farm);
    return result;
}

void farm_load_failed(farm_t *farm, double now, job_t *job, const char *why)
{
    farm_lock(farm);
    stop_waiting(farm, job);
    farm->film_bytes -= film_bytes(&job->kept.settings);
    snprintf(job->kept.message, sizeof job->kept.message, "%s", why);
    log_error("job %llu: %s", (unsigned long long)job->kept.job, job->kept.message);
    if (!job->gone) farm_job_close(farm, now, job, JOB_FAILED);
    farm_unlock(farm);
}

/* ---- checkpoints --------------------------------------------------------------------------------------- */

/* For how long work is in no checkpoint. What the first batch after the last one brought was rendered within
 * a batch interval; before that there was none. */
static double checkpoint_age(const farm_t *farm, const job_t *job, double now)
{
    return now -
           fmax(fmax(job->last_checkpoint, job->started), job->unsaved_since - farm->options.batch_interval);
}

job_t *farm_next_checkpoint(farm_t *farm, double now, double *age, bool *last)
{
    job_t *found = NULL;
    *last = false;
    *age = 0;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (!job_has_film(job) || job->film == FILM_CONDEMNED) continue;
        if (job->save != SAVE_DUE || job_is_saving(job)) continue;
        bool waits = farm->shut || job->film == FILM_CLOSED;
        if (found != NULL && (waits != *last ? *last : checkpoint_age(farm, job, now) <= *age)) continue;
        found = job;
        *last = waits;
        *age = checkpoint_age(farm, job, now);
    }
    if (found != NULL) found->pins++;
    farm_unlock(farm);
    return found;
}

bool farm_snapshot(farm_t *farm, job_t *job, schedule_state_t *state, shared_film_snapshot_t **snapshot)
{
    shared_film_t *shared_film = job_film_hold(farm, job);
    if (shared_film == NULL) return false;
    shared_film_lock(shared_film); /* nobody is merging: what is counted is in the sums */
    farm_lock(farm);
    bool take = !job_is_saving(job) && job->schedule != NULL;
    if (take) {
        schedule_save(job->schedule, state);
        job->write = job->write == WRITE_FAILED ? WRITE_RETRIED : WRITE_OPEN;
        if (job->save == SAVE_DUE) job->save = SAVE_DONE;
    }
    farm_unlock(farm);
    if (take) *snapshot = shared_film_snapshot(shared_film);
    shared_film_unlock(shared_film);
    if (!take) job_film_let_go(farm, job); /* else farm_checkpointed does */
    return take;
}

void farm_checkpointed(farm_t *farm, double taken, job_t *job, result_t written)
{
    farm_lock(farm);
    bool saving = job_is_saving(job), failed = job->write == WRITE_FAILED || job->write == WRITE_RETRIED;
    if (failed && job->image_failures == 0) job->remark[0] = '\0';
    job->write = written.code == RESULT_OK ? WRITE_IDLE : WRITE_FAILED;
    if (written.code == RESULT_OK) {
        job->last_checkpoint = taken;
        trust_checkpointed(job);
        farm_record_changed(farm, job);
    } else {
        job->unsaved_since = 0; /* what came after the snapshot is not the first any more */
        job_unsaved(job);
        if (job->film != FILM_OPEN && job->image_failures == 0) {
            snprintf(job->remark, sizeof job->remark,
                     "its last checkpoint cannot be written, and is tried again: %.200s", written.message);
            farm_job_stuck(farm, job);
        }
    }
    if (saving) farm_job_film_let_go(farm, job);
    farm_job_settle(farm, job);
    farm_unlock(farm);
}

/* ---- what is kept of batches --------------------------------------------------------------------------- */

/* Pins a job that has evidence, the first after number `after`. */
static job_t *next_job(farm_t *farm, uint64_t after)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (job->checks != NULL && job->kept.job > after &&
            (found == NULL || job->kept.job < found->kept.job))
            found = job;
    }
    if (found != NULL) found->pins++;
    farm_unlock(farm);
    return found;
}

void farm_settle(farm_t *farm)
{
    if (farm->options.spool_dir == NULL) return;
    uint64_t id = 0;
    for (job_t *job; (job = next_job(farm, id)) != NULL;) {
        id = job->kept.job;
        trust_settle(farm, job);
        farm_unpin(farm, job);
    }
    trust_tidy(farm);
}

result_t farm_sync(farm_t *farm)
{
    return trust_sync(farm);
}
