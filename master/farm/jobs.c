/* jobs: the life of a job: its start, its rounds and its end (see farm.h).
 *
 * DESIGN. A job is in one state of each of these kinds at a time; what is not in a row does not happen.
 *
 *     state    from        to          when
 *              queued      running     its first units are handed out, or its film was loaded
 *              queued      cancelled   it is cancelled and has no film; likewise when it is paused
 *              queued      finishing   it is cancelled and has a film on the disk; likewise when paused
 *              queued      paused      by order, or its scene is lost
 *              running     paused      likewise; its workers are asked for what they have (flush)
 *              running     finishing   all is counted
 *              running     finishing   it is cancelled, or its time is up (flush); likewise when paused
 *              paused      running     it is resumed and has a film in memory; else queued
 *              finishing   queued      it came back to be written down, but there is no checkpoint of it
 *              finishing   outcome     image and last checkpoint are written: done, cancelled or failed
 *              any so far  failed      its sums overflow, it cannot be begun, loaded or rendered
 *              outcome     queued      it is extended
 *
 *     film     none        open        the job begins
 *              none        stored      it is extended and has a film on the disk
 *              none        wanted      the process begins, and the job is not over
 *              stored      wanted      it is its turn, or somebody has a batch of it, or wants to see it
 *              wanted      loading     there is room
 *              loading     open        or none: there is no checkpoint, or it cannot be read
 *              open        closed      the last batch is in
 *              closed      none        the job is over; or condemned, while somebody holds it
 *              condemned   none        the last lets go of it
 *
 *     image    none        due         the job is closed
 *              due         writing     the image writer takes it up
 *              writing     written     or failed
 *              failed      due         after a while
 *              any but written         given up: the job is cancelled once more after a failure
 *              any         none        the job goes on (extend, a film was loaded)
 *
 *     milestone  as the image: none, due, writing, failed, due, and none when it is written (milestones.c)
 *
 *     save     done        due         a batch is merged, or taken out; a checkpoint could not be written
 *              due         done        a snapshot of the film is open
 *              any         off         the job fails, or is given up
 *
 *     write    idle        open        a snapshot is open
 *              open        idle        it is written; or failed
 *              failed      retried     a snapshot is open again: then idle, or failed
 *
 * The film is made when the first units are handed out, not at submission, so that a long queue costs
 * nothing, and freed when image and checkpoint are written. While a job is flushed (cut short or paused),
 * batches are taken until each worker has answered or a grace period is over. A job whose image or last
 * checkpoint cannot be written (a full disk) keeps its film and is tried again; to cancel it gives that up. A
 * job comes back with its film (after a restart, or when it is extended) by way of the queue: keep.c. */
#include "master/farm/parts.h"

#include "master/schedule/next_round.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

double farm_job_elapsed(const job_t *job, double now)
{
    if (job->started <= 0) return job->kept.elapsed;
    return job->kept.elapsed + (job->ended > 0 ? job->ended : now) - job->started;
}

job_record_t farm_job_record(const job_t *job, double now)
{
    job_record_t record = job->kept;
    record.elapsed = farm_job_elapsed(job, now);
    record.workers_seen += (uint32_t)job->seen.count;
    if (job->schedule != NULL) record.account = schedule_account(job->schedule);
    return record;
}

/* ---- memory -------------------------------------------------------------------------------------------- */

void farm_job_free(farm_t *farm, job_t *job)
{
    farm_job_free_film(farm, job);
    schedule_destroy(&job->schedule);
    trust_forget(job);
    id_table_free(&job->seen);
    free(job);
}

void farm_job_unpin(farm_t *farm, job_t *job)
{
    job->pins--;
    if (job->gone && job->pins == 0) farm_job_free(farm, job);
}

void farm_job_remove(farm_t *farm, job_t *job)
{
    size_t at = 0;
    while (farm->jobs[at] != job) at++;
    memmove(farm->jobs + at, farm->jobs + at + 1, (--farm->job_count - at) * sizeof *farm->jobs);
    farm->removed = mem_realloc(farm->removed, (farm->removed_count + 1) * sizeof *farm->removed);
    farm->removed[farm->removed_count++] = job->kept.job;
    wake_up(farm->options.journal_writer_wake);
    job->gone = true;
    if (job->pins == 0) farm_job_free(farm, job);
}

/* ---- beginning ----------------------------------------------------------------------------------------- */

void farm_job_install(farm_t *farm, double now, job_t *job, film_t *film, schedule_t *schedule)
{
    job->kept.counts = film->counts;
    job->shared_film = shared_film_new(film);
    job->schedule = schedule;
    job->kept.samples_done = schedule_done(schedule);
    job->film = FILM_OPEN;
    job->image = IMAGE_NONE;
    job->save = SAVE_DONE;
    job->write = WRITE_IDLE;
    job->declines = job->decline_count = 0;
    memset(job->plans, 0, sizeof job->plans);
    farm_milestone_installed(job);
    farm_job_joins(farm, job);
    job->rate_time[0] = job->rate_time[1] = now;
    job->rate_samples[0] = job->rate_samples[1] = job->kept.samples_done;
}

/* What the films take of jobs that were begun and are to be loaded next. No other job may take that room:
 * workers may hold batches of these, and take up nothing else before they are rid of them. */
static uint64_t awaited_bytes(const farm_t *farm)
{
    uint64_t bytes = farm->film_bytes;
    for (size_t i = 0; i < farm->job_count; i++) {
        const job_t *job = farm->jobs[i];
        if (job->film != FILM_WANTED || job->kept.state == JOB_PAUSED) continue;
        uint64_t more = film_bytes(&job->kept.settings);
        if (bytes + more <= farm->options.film_limit) bytes += more;
    }
    return bytes - farm->film_bytes;
}

/* The tiles of a round, in fresh memory. */
static round_t round_new(uint32_t tiles)
{
    return (round_t){mem_zalloc(tiles, sizeof(uint32_t)), mem_zalloc(tiles, sizeof(uint32_t))};
}

static void round_free(round_t *round)
{
    free(round->ends);
    free(round->weights);
}

/* The first round needs no film to be planned from. */
static void open_first_round(job_t *job)
{
    if (!job_is_planned(&job->kept.settings)) return;
    round_t first = round_new(job_tile_count(&job->kept.settings));
    double error;
    if (next_round(&job->kept.settings, 0, NULL, NULL, &first, &error) == ROUND_NEXT)
        schedule_open_round(job->schedule, first.ends, first.weights);
    round_free(&first);
}

bool farm_job_has_room(const farm_t *farm, const job_t *job)
{
    uint64_t bytes = film_bytes(&job->kept.settings);
    return farm->film_bytes + awaited_bytes(farm) + bytes <= farm->options.film_limit;
}

bool farm_job_start(farm_t *farm, double now, job_t *job)
{
    if (job_awaits_film(job)) {
        farm_want_film(farm, job);
        return false;
    }
    if (!farm_job_has_room(farm, job)) return false;
    film_t *film;
    result_t result = film_new(&job->kept.settings, &film);
    if (result.code != RESULT_OK) {
        snprintf(job->kept.message, sizeof job->kept.message, "%s", result.message);
        log_error("job %llu: %s", (unsigned long long)job->kept.job, result.message);
        farm_job_close(farm, now, job, JOB_FAILED);
        return false;
    }
    farm->film_bytes += film_bytes(&job->kept.settings);
    farm_job_install(farm, now, job, film, schedule_new(&job->kept.settings));
    open_first_round(job);
    job->kept.state = JOB_RUNNING;
    job->started = now;
    farm_record_changed(farm, job);
    log_info("job %llu starts: %s, %d x %d, %s", (unsigned long long)job->kept.job, job->kept.terms.name,
             job->kept.settings.width, job->kept.settings.height,
             integrator_name(job->kept.settings.integrator));
    return true;
}

/* ---- rounds -------------------------------------------------------------------------------------------- */

/* What next_round is asked with, copied, since it is asked without the lock. */
typedef struct {
    job_settings_t settings;
    uint32_t round_count;
    round_t last, next;
    uint64_t samples, batches;
} question_t;

static question_t question_new(const job_t *job)
{
    uint32_t tiles = job_tile_count(&job->kept.settings);
    question_t question = {.settings = job->kept.settings,
                           .round_count = schedule_round_count(job->schedule),
                           .last = round_new(tiles),
                           .next = round_new(tiles),
                           .samples = job->kept.samples_done,
                           .batches = job->kept.batches};
    if (question.round_count > 0) {
        memcpy(question.last.ends, schedule_round_ends(job->schedule), tiles * sizeof(uint32_t));
        memcpy(question.last.weights, schedule_round_weights(job->schedule), tiles * sizeof(uint32_t));
    }
    return question;
}

static void question_free(question_t *question)
{
    round_free(&question->last);
    round_free(&question->next);
}

/* True when the answer is still to the point: nothing was taken out of the film or added meanwhile, or has to
 * be, and no order came. */
static bool question_stands(const question_t *question, const job_t *job)
{
    return job->merging == 0 && job->kept.batches == question->batches &&
           schedule_round_counted(job->schedule) && !trust_pending(job) &&
           job->kept.settings.spp == question->settings.spp &&
           job->kept.settings.error == question->settings.error;
}

/* The job's rounds are decided by its film, which takes a while to look at: the lock is let go meanwhile. */
static void decide_round(farm_t *farm, double now, job_t *job)
{
    question_t question = question_new(job);
    double error = 0;
    shared_film_t *shared_film = farm_job_film_hold(job);
    job->planning = true;
    farm_unlock(farm);
    round_verdict_t verdict =
        next_round(&question.settings, question.round_count, question.round_count > 0 ? &question.last : NULL,
                   shared_film_lock(shared_film), &question.next, &error);
    shared_film_unlock(shared_film);
    farm_lock(farm);
    farm_job_film_let_go(farm, job);
    job->planning = false;
    if (job->film == FILM_OPEN && question_stands(&question, job)) {
        job->kept.error = error;
        farm_job_note_error(farm, now, job, question.samples, error);
        if (verdict == ROUND_NEXT)
            schedule_open_round(job->schedule, question.next.ends, question.next.weights);
        else
            farm_job_close(farm, now, job, JOB_DONE);
        farm_notify_idle(farm);
    }
    question_free(&question);
}

void farm_job_progress(farm_t *farm, double now, job_t *job)
{
    job->pins++;
    farm_job_open_passes(farm, job);
    while (job->film == FILM_OPEN && job->merging == 0 && !job->planning &&
           schedule_round_counted(job->schedule) && !trust_pending(job) && !farm_milestone_waits(farm, job)) {
        if (job_is_planned(&job->kept.settings))
            decide_round(farm, now, job);
        else
            farm_job_close(farm, now, job, JOB_DONE);
        farm_job_open_passes(farm, job);
    }
    farm_job_settle(farm, job);
    farm_job_unpin(farm, job);
}

/* ---- ending -------------------------------------------------------------------------------------------- */

/* What workers hold comes back. */
static void release_all(farm_t *farm, job_t *job)
{
    for (size_t i = 0; i < farm->worker_count; i++)
        if (schedule_held(job->schedule, farm->workers[i].id) > 0)
            schedule_release(job->schedule, farm->workers[i].id);
}

void farm_job_close(farm_t *farm, double now, job_t *job, job_state_t outcome)
{
    farm_notify_over(farm, job, false);
    if (job->schedule != NULL) {
        release_all(farm, job);
        schedule_release(job->schedule, 0); /* what was kept from them */
    }
    if (job->film == FILM_OPEN) job->film = FILM_CLOSED;
    job->remark[0] = '\0';
    job->stuck = false;
    job->flush_until = 0;
    job->ended = job->started > 0 ? now : 0;
    job->kept.outcome = outcome;
    job->kept.state = JOB_FINISHING;
    if (outcome == JOB_FAILED) {
        job->kept.state = JOB_FAILED;
        job->kept.finished = clock_wall();
        job->save = SAVE_OFF;
        farm_job_news(farm, job);
    }
    job->image = IMAGE_DUE;
    job->image_failures = 0;
    farm_milestone_closed(job, outcome);
    farm_record_changed(farm, job);
    wake_up(farm->options.image_wake);
    wake_up(farm->options.checkpoint_wake);
    farm_notify_idle(farm);
}

void farm_job_flush(farm_t *farm, double now, job_t *job)
{
    job->flush_until = now + fmax(farm->options.lease, farm->options.batch_interval);
    if (schedule_holders(job->schedule) == 0)
        farm_job_flush_end(farm, now, job);
    else
        farm_notify_over(farm, job, true);
    farm_notify_idle(farm); /* other jobs may start */
}

void farm_job_cut_short(farm_t *farm, double now, job_t *job, job_state_t outcome)
{
    job->kept.state = JOB_FINISHING;
    job->kept.outcome = outcome;
    farm_record_changed(farm, job);
    farm_job_flush(farm, now, job);
}

void farm_job_flush_end(farm_t *farm, double now, job_t *job)
{
    job->flush_until = 0;
    if (job->kept.state == JOB_PAUSED)
        release_all(farm, job);
    else
        farm_job_close(farm, now, job, job->kept.outcome);
}

void farm_job_flushed(farm_t *farm, double now, job_t *job, uint64_t worker)
{
    schedule_release(job->schedule, worker);
    if (schedule_holders(job->schedule) == 0) farm_job_flush_end(farm, now, job);
}

void farm_job_fail_overflow(farm_t *farm, double now, job_t *job)
{
    snprintf(job->kept.message, sizeof job->kept.message,
             "%llu sums were too large for the film at scale %d: submit the scene again with a smaller one, "
             "such as --film-scale %d",
             (unsigned long long)job->kept.counts.overflows, job->kept.settings.film_scale,
             int_max(job->kept.settings.film_scale - 8, FILM_MIN_SCALE));
    log_error("job %llu failed: %s", (unsigned long long)job->kept.job, job->kept.message);
    farm_job_close(farm, now, job, JOB_FAILED);
}

static void log_end(const job_t *job)
{
    log_info("job %llu is %s after %.1f s: %llu batches (%llu refused), %llu units re-issued, %zu workers, "
             "%.1f MB (%llu bytes) received, %.1f CPU s",
             (unsigned long long)job->kept.job, job_state_name((uint32_t)job->kept.state),
             farm_job_elapsed(job, 0), (unsigned long long)job->kept.batches,
             (unsigned long long)job->kept.batches_refused, (unsigned long long)job->kept.units_reissued,
             job->seen.count + job->kept.workers_seen, 1e-6 * (double)job->kept.bytes,
             (unsigned long long)job->kept.bytes, 1e-6 * (double)job->kept.counts.cpu_us);
    if (job->kept.counts.dropped > 0)
        log_warning("job %llu: %llu contributions were NaN or infinite, and left out",
                    (unsigned long long)job->kept.job, (unsigned long long)job->kept.counts.dropped);
}

/* Frees what only a job that is not over needs. */
static void put_away(farm_t *farm, job_t *job)
{
    if (job->schedule != NULL) job->kept.account = schedule_account(job->schedule);
    schedule_destroy(&job->schedule);
    trust_forget(job);
    farm_job_free_film(farm, job);
    farm_notify_idle(farm); /* a job may have waited for memory */
}

void farm_job_settle(farm_t *farm, job_t *job)
{
    if (job->film == FILM_OPEN || job->merging > 0 || job_is_saving(job)) return;
    if (job->planning || job->teaching) return;
    if (job->milestone != IMAGE_NONE) return;
    bool ends = job->image == IMAGE_WRITTEN || job->image == IMAGE_GIVEN_UP;
    if (job->kept.state == JOB_FINISHING && ends) {
        if (job->save == SAVE_DUE && farm->options.checkpoint_wake >= 0) return;
        job->kept.state = job->kept.outcome;
        job->kept.finished = clock_wall();
        farm_job_news(farm, job);
        farm_record_changed(farm, job);
    }
    if (!job_state_final(job->kept.state) || job->film != FILM_CLOSED || job->image == IMAGE_DUE) return;
    log_end(job);
    put_away(farm, job);
}
