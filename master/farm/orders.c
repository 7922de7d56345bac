/* orders: jobs that are submitted, and what clients order done with them (see farm.h). */
#include "master/farm/parts.h"

#include <stdio.h>
#include <string.h>

/* ---- submitting ---------------------------------------------------------------------------------------- */

/* Makes room in the list of jobs; false when none can be forgotten. */
static bool forget_oldest(farm_t *farm)
{
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (!job_state_final(job->kept.state) || job->kept.retained || job->image == IMAGE_DUE ||
            job->pins > 0)
            continue;
        log_info("job %llu is forgotten, to make room", (unsigned long long)job->kept.job);
        farm_job_remove(farm, job);
        return true;
    }
    return false;
}

result_t farm_submit(farm_t *farm, double now, const job_terms_t *terms, const job_settings_t *settings,
                     const hash_t *blob, uint64_t blob_size, uint64_t *id)
{
    (void)now;
    uint64_t bytes = film_bytes(settings), limit = farm->options.film_limit;
    if (bytes > limit)
        return result_fail(RESULT_LIMIT,
                           "a film of %d x %d pixels takes %.1f GB, this master has room for %.1f GB",
                           settings->width, settings->height, 1e-9 * (double)bytes, 1e-9 * (double)limit);
    farm_lock(farm);
    if (farm->job_count >= farm->options.job_limit && !forget_oldest(farm)) {
        farm_unlock(farm);
        return result_fail(RESULT_LIMIT, "the queue is full: %zu jobs wait, work or are retained",
                           farm->options.job_limit);
    }
    job_t *job = mem_zalloc(1, sizeof *job);
    job->kept.job = farm->next_job++;
    job->kept.settings = *settings;
    job->kept.blob = *blob;
    job->kept.blob_size = blob_size;
    job->kept.state = JOB_QUEUED;
    job->kept.terms = *terms;
    job->kept.submitted = clock_wall();
    farm->jobs = mem_realloc(farm->jobs, (farm->job_count + 1) * sizeof(job_t *));
    farm->jobs[farm->job_count++] = job;
    *id = job->kept.job;
    farm_record_changed(farm, job);
    log_info("job %llu is submitted: %s", (unsigned long long)job->kept.job, job->kept.terms.name);
    farm_notify_idle(farm);
    farm_unlock(farm);
    return result_ok();
}

/* ---- orders; all under the lock ------------------------------------------------------------------------ */

static result_t refuse(const job_t *job, const char *cure)
{
    return result_fail(RESULT_INPUT, "job %llu is %s%s", (unsigned long long)job->kept.job,
                       job_state_name((uint32_t)job->kept.state), cure);
}

/* A job that never had a film ends without one. */
static void cancel_unstarted(farm_t *farm, job_t *job)
{
    job->kept.state = JOB_CANCELLED;
    job->kept.finished = clock_wall();
    farm_job_news(farm, job);
    farm_notify_idle(farm);
}

/* Ends the attempts to write the image or the last checkpoint. */
static void give_up(farm_t *farm, job_t *job)
{
    if (job->image != IMAGE_WRITTEN) job->kept.outcome = JOB_FAILED;
    if (job->remark[0] != '\0') farm_job_tell(farm, job, "%s", job->remark);
    if (job->image != IMAGE_WRITTEN) job->image = IMAGE_GIVEN_UP;
    job->save = SAVE_OFF;
    farm_milestone_give_up(job);
    farm_job_settle(farm, job);
}

static result_t cancel(farm_t *farm, double now, job_t *job)
{
    if (job_state_final(job->kept.state)) return refuse(job, " already");
    if (job->kept.state == JOB_FINISHING) {
        bool failed = job->image_failures > 0 || job->write == WRITE_FAILED || job->write == WRITE_RETRIED;
        if (failed || trust_delayed(job)) give_up(farm, job);
        return result_ok(); /* else it is left to finish */
    }
    if (job_awaits_film(job)) {
        job->kept.state = JOB_FINISHING;
        job->kept.outcome = JOB_CANCELLED;
        farm_want_film(farm, job);
    } else if (!job_has_film(job)) {
        cancel_unstarted(farm, job);
    } else {
        farm_job_cut_short(farm, now, job, JOB_CANCELLED);
    }
    return result_ok();
}

static result_t pause_job(farm_t *farm, double now, job_t *job)
{
    if (job->kept.state != JOB_QUEUED && job->kept.state != JOB_RUNNING)
        return refuse(job, ", there is nothing to pause");
    bool running = job->kept.state == JOB_RUNNING;
    job->kept.elapsed = farm_job_elapsed(job, now);
    job->started = 0;
    job->kept.state = JOB_PAUSED;
    if (running) farm_job_flush(farm, now, job);
    return result_ok();
}

bool farm_next_scene(farm_t *farm, hash_t *blob)
{
    bool found = false;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (!job->scene_due || (found && !hash_equal(&job->kept.blob, blob))) continue;
        *blob = job->kept.blob;
        found = true;
        job->scene_due = false;
    }
    farm_unlock(farm);
    return found;
}

void farm_scene_lost(farm_t *farm, double now, const hash_t *blob)
{
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++) {
        job_t *job = farm->jobs[i];
        if (!hash_equal(&job->kept.blob, blob) || pause_job(farm, now, job).code != RESULT_OK) continue;
        snprintf(job->kept.message, sizeof job->kept.message, "%s", FARM_NO_SCENE);
        log_error("job %llu is paused: %s", (unsigned long long)job->kept.job, job->kept.message);
        farm_job_news(farm, job);
        farm_record_changed(farm, job);
    }
    farm_unlock(farm);
}

static result_t resume(farm_t *farm, double now, job_t *job)
{
    if (job->kept.state != JOB_PAUSED) return refuse(job, ", not paused");
    if (strcmp(job->kept.message, FARM_NO_SCENE) == 0) job->kept.message[0] = '\0';
    job->kept.news = 0;
    if (job->flush_until > 0) farm_job_flush_end(farm, now, job); /* its workers were told to drop the rest */
    job->kept.state = job_has_film(job) ? JOB_RUNNING : JOB_QUEUED;
    if (job_has_film(job)) job->started = now;
    job->rate_time[0] = job->rate_time[1] = now;
    job->rate_samples[0] = job->rate_samples[1] = job->kept.samples_done;
    farm_job_joins(farm, job);
    farm_notify_idle(farm);
    return result_ok();
}

static result_t set_priority(farm_t *farm, job_t *job, int32_t priority)
{
    job_terms_t terms = job->kept.terms;
    terms.priority = priority;
    TRY(job_terms_check(&terms));
    job->kept.terms.priority = priority; /* alone: the others are read without the lock */
    farm_job_joins(farm, job);
    return result_ok();
}

static result_t delete_job(farm_t *farm, job_t *job)
{
    if (!job_state_final(job->kept.state)) return refuse(job, ": cancel it first");
    farm_job_remove(farm, job);
    return result_ok();
}

/* ---- more samples ---- */

/* True when all samples are there that spp asks for. */
static bool spp_reached(const job_t *job)
{
    uint64_t wanted = job_total_samples(&job->kept.settings);
    return wanted > 0 && job->kept.samples_done >= wanted;
}

/* What the job is to reach from now on. What it has reached already and what the order says nothing of no
 * longer ends it. */
static job_settings_t new_goals(const job_t *job, double now, const job_order_t *order)
{
    job_settings_t goals = job->kept.settings;
    double elapsed = farm_job_elapsed(job, now);
    bool over = job_state_final(job->kept.state);
    if (order->spp > 0)
        goals.spp = order->spp;
    else if ((order->error > 0 && goals.error <= 0) || (over && spp_reached(job)))
        goals.spp = JOB_MAX_SPP;
    if (order->error > 0)
        goals.error = order->error;
    else if (over && goals.error > 0 && job->kept.error > 0 && job->kept.error <= goals.error)
        goals.error = 0;
    if (order->time_limit > 0)
        goals.time_limit = elapsed + order->time_limit;
    else if (goals.time_limit > 0 && elapsed >= goals.time_limit)
        goals.time_limit = 0;
    return goals;
}

static result_t check_goals(const job_t *job, const job_settings_t *goals, const job_order_t *order)
{
    bool nothing = order->spp == 0 && order->error <= 0 && order->time_limit <= 0;
    if (nothing && job->kept.state == JOB_DONE)
        return refuse(job, ": say how far it is to go, by samples, error or time");
    if (nothing && !job_state_final(job->kept.state))
        return refuse(job, ": say how much further it is to go");
    if (order->spp > 0 && order->spp <= job->kept.settings.spp && job->kept.settings.spp < JOB_MAX_SPP &&
        !(job_state_final(job->kept.state) && !spp_reached(job)))
        return result_fail(RESULT_INPUT, "job %llu is to have %u samples a pixel already",
                           (unsigned long long)job->kept.job, job->kept.settings.spp);
    double pixels = (double)job->kept.settings.width * job->kept.settings.height;
    if (order->spp > 0 && (double)job->kept.samples_done >= pixels * order->spp)
        return result_fail(RESULT_INPUT, "job %llu has %.4g samples a pixel already",
                           (unsigned long long)job->kept.job, (double)job->kept.samples_done / pixels);
    if (order->error > 0 && job->kept.error > 0 && order->error >= job->kept.error)
        return result_fail(RESULT_INPUT, "the error of job %llu is %.3g already",
                           (unsigned long long)job->kept.job, job->kept.error);
    return job_settings_check(goals);
}

static result_t extend(farm_t *farm, double now, job_t *job, const job_order_t *order)
{
    if (job->kept.state == JOB_FINISHING || (job_state_final(job->kept.state) && job_has_film(job)))
        return refuse(job, ": try again when it is over and put away");
    bool touched = job->kept.batches > 0 || farm_job_elapsed(job, now) > 0;
    if (job_state_final(job->kept.state) && touched && farm->options.checkpoint_wake < 0)
        return refuse(job, ", and its film was not kept");
    job_settings_t goals = new_goals(job, now, order);
    TRY(check_goals(job, &goals, order));
    job->kept.settings.spp = goals.spp; /* these alone: the others are read without the lock */
    job->kept.settings.error = goals.error;
    job->kept.settings.time_limit = goals.time_limit;
    if (job->schedule != NULL) {
        schedule_extend(job->schedule, &job->kept.settings);
        farm_job_progress(farm, now, job); /* what was counted may be a whole round now */
    }
    if (job_state_final(job->kept.state)) {
        job->kept.elapsed = farm_job_elapsed(job, now);
        job->started = job->ended = job->kept.finished = 0;
        job->kept.state = JOB_QUEUED;
        job->film = touched ? FILM_STORED : FILM_NONE;
        job->image = IMAGE_NONE;
        job->kept.message[0] = '\0';
        farm_job_joins(farm, job);
    }
    farm_notify_idle(farm);
    return result_ok();
}

/* ---- the kind of machines ---- */

static result_t let_mix(farm_t *farm, job_t *job)
{
    if (job->kept.terms.mixed) return refuse(job, ", and machines of all kinds may work on it already");
    job->kept.terms.mixed = true;
    farm_notify_idle(farm);
    return result_ok();
}

static result_t rebind(farm_t *farm, double now, job_t *job)
{
    if (job->kept.terms.mixed) return refuse(job, ", and machines of all kinds may work on it");
    if (hash_is_zero(&job->kept.fingerprint))
        return refuse(job, ": nothing of it is counted, so it is bound to no kind of machines yet");
    const worker_t *worker = farm_largest_kind(farm, now);
    if (worker == NULL)
        return result_fail(RESULT_INPUT,
                           "no worker is connected: connect those that are to go on with job %llu",
                           (unsigned long long)job->kept.job);
    if (hash_equal(&worker->fingerprint, &job->kept.fingerprint))
        return refuse(job, ", and bound to the kind of machines that has most threads already");
    char from[2 * HASH_BYTES + 1], to[2 * HASH_BYTES + 1];
    hash_to_hex(&job->kept.fingerprint, from);
    hash_to_hex(&worker->fingerprint, to);
    farm_job_tell(
        farm, job, "it is made of two kinds of bits: %.8s, and %.8s after %.4g samples a pixel", from, to,
        (double)job->kept.samples_done / ((double)job->kept.settings.width * job->kept.settings.height));
    farm_bind(farm, now, job, &worker->fingerprint);
    return result_ok();
}

/* What a party delivered is taken out, and rendered again. */
static result_t take_out(farm_t *farm, job_t *job, const char *who)
{
    if (job->kept.terms.verify <= 0 || farm->options.spool_dir == NULL)
        return result_fail(RESULT_INPUT,
                           "job %llu keeps nothing that could be taken out: submit such jobs with --verify",
                           (unsigned long long)job->kept.job);
    if (job_awaits_film(job))
        return result_fail(RESULT_INPUT, "the film of job %llu is not loaded: try again in a moment",
                           (unsigned long long)job->kept.job);
    if (job->film != FILM_OPEN) return refuse(job, ", there is nothing to take out: submit it again");
    return trust_take_out(farm, job, who);
}

static result_t carry_out(farm_t *farm, double now, job_t *job, const job_order_t *order)
{
    switch (order->kind) {
    case ORDER_CANCEL:
        return cancel(farm, now, job);
    case ORDER_PAUSE:
        return pause_job(farm, now, job);
    case ORDER_RESUME:
        return resume(farm, now, job);
    case ORDER_RETAIN:
    case ORDER_RELEASE:
        job->kept.retained = order->kind == ORDER_RETAIN;
        return result_ok();
    case ORDER_DELETE:
        return delete_job(farm, job);
    case ORDER_PRIORITY:
        return set_priority(farm, job, order->priority);
    case ORDER_EXTEND:
        return extend(farm, now, job, order);
    case ORDER_MIXED:
        return let_mix(farm, job);
    case ORDER_REBIND:
        return rebind(farm, now, job);
    case ORDER_TAKE_OUT:
        return take_out(farm, job, order->who);
    }
    return result_fail(RESULT_INPUT, "there is no order of kind %d", (int)order->kind);
}

static const char *const done_names[] = {[ORDER_CANCEL] = "is cancelled",
                                         [ORDER_PAUSE] = "is paused",
                                         [ORDER_RESUME] = "is resumed",
                                         [ORDER_RETAIN] = "is retained",
                                         [ORDER_RELEASE] = "may go",
                                         [ORDER_DELETE] = "is deleted",
                                         [ORDER_PRIORITY] = "is moved to another priority",
                                         [ORDER_EXTEND] = "is extended",
                                         [ORDER_MIXED] = "is open to machines of all kinds",
                                         [ORDER_REBIND] = "is bound to another kind of machines",
                                         [ORDER_TAKE_OUT] = "is rid of what somebody delivered"};

/* Of every job that is not over; it succeeds when there is anything to take out. */
static result_t take_out_of_all(farm_t *farm, const job_order_t *order)
{
    result_t result = result_fail(RESULT_INPUT,
                                  "there is no job that keeps anything of %s: only jobs of "
                                  "submit --verify do, until they are over",
                                  order->who);
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count; i++)
        if (take_out(farm, farm->jobs[i], order->who).code == RESULT_OK) result = result_ok();
    farm_unlock(farm);
    return result;
}

result_t farm_order(farm_t *farm, double now, const job_order_t *order)
{
    if (order->kind == ORDER_TAKE_OUT && order->job == 0) return take_out_of_all(farm, order);
    farm_lock(farm);
    job_t *job = farm_find_job(farm, order->job);
    if (job == NULL) {
        farm_unlock(farm);
        return result_fail(RESULT_INPUT, "there is no job %llu", (unsigned long long)order->job);
    }
    job->pins++;
    result_t result = carry_out(farm, now, job, order);
    if (result.code == RESULT_OK) {
        log_info("job %llu %s", (unsigned long long)order->job, done_names[order->kind]);
        farm_record_changed(farm, job);
    }
    farm_job_unpin(farm, job);
    farm_unlock(farm);
    return result;
}
