/* state: see state.h. */
#include "master/state/state.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

void farm_lock(farm_t *farm)
{
    pthread_mutex_lock(&farm->lock);
}

void farm_unlock(farm_t *farm)
{
    pthread_mutex_unlock(&farm->lock);
}

/* ---- finding ------------------------------------------------------------------------------------------- */

job_t *farm_find_job(const farm_t *farm, uint64_t id)
{
    size_t low = 0, high = farm->job_count; /* the list is in the order of the numbers */
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if (farm->jobs[middle]->kept.job == id) return farm->jobs[middle];
        if (farm->jobs[middle]->kept.job < id)
            low = middle + 1;
        else
            high = middle;
    }
    return NULL;
}

worker_t *farm_find_worker(const farm_t *farm, uint64_t id)
{
    size_t at = id_table_find(&farm->by_id, id);
    return at != SIZE_MAX ? &farm->workers[at] : NULL;
}

/* ---- noting -------------------------------------------------------------------------------------------- */

static void add_notice(farm_t *farm, pending_t pending)
{
    if (farm->notice_count == farm->notice_capacity) {
        farm->notice_capacity = 2 * farm->notice_capacity + 16;
        farm->notices = mem_realloc(farm->notices, farm->notice_capacity * sizeof *farm->notices);
    }
    farm->notices[farm->notice_count++] = pending;
    wake_up(farm->options.control_wake);
}

void farm_notify(farm_t *farm, uint64_t worker, uint64_t job, bool flush)
{
    add_notice(farm, (pending_t){.worker = worker, .job = job, .flush = flush});
}

void farm_notify_leave(farm_t *farm, uint64_t worker)
{
    add_notice(farm, (pending_t){.worker = worker, .leave = true});
}

void farm_notify_idle(farm_t *farm)
{
    if (farm->work_due) return;
    farm->work_due = true;
    wake_up(farm->options.control_wake);
}

void farm_notify_over(farm_t *farm, const job_t *job, bool flush)
{
    for (size_t i = 0; i < farm->worker_count; i++) {
        const worker_t *worker = &farm->workers[i];
        if (!worker->connected) continue;
        if (worker->job == job->kept.job ||
            (job->schedule != NULL && schedule_held(job->schedule, worker->id) > 0))
            farm_notify(farm, worker->id, job->kept.job, flush);
    }
}

void farm_record_changed(farm_t *farm, job_t *job)
{
    job->record_due = true;
    wake_up(farm->options.journal_writer_wake);
}

void farm_job_news(farm_t *farm, job_t *job)
{
    if (farm->options.news_wake < 0) return;
    job->kept.news = job->kept.state;
    job->news_count++;
    job->news_failures = 0;
    job->news_since = job->news_retry = 0;
    wake_up(farm->options.news_wake);
}

void farm_job_tell(farm_t *farm, job_t *job, const char *format, ...)
{
    size_t used = strlen(job->kept.message);
    va_list arguments;
    if (used > 0 && used + 2 < sizeof job->kept.message) {
        memcpy(job->kept.message + used, "; ", 3);
        used += 2;
    }
    va_start(arguments, format);
    vsnprintf(job->kept.message + used, sizeof job->kept.message - used, format, arguments);
    va_end(arguments);
    farm_record_changed(farm, job);
}

/* ---- workers ------------------------------------------------------------------------------------------- */

size_t farm_worker_units(const farm_t *farm, const worker_t *worker)
{
    size_t units = 0;
    for (size_t i = 0; i < farm->job_count; i++)
        if (farm->jobs[i]->schedule != NULL) units += schedule_held(farm->jobs[i]->schedule, worker->id);
    return units;
}

double farm_patience(const farm_t *farm, int batches)
{
    return batches * fmax(farm->options.batch_interval, 1);
}

bool farm_worker_asks(const farm_t *farm, double now, const worker_t *worker, int batches)
{
    return worker->connected && worker->reached && worker->asked >= now - farm_patience(farm, batches);
}

/* ---- jobs ---------------------------------------------------------------------------------------------- */

double farm_unit_samples(const job_t *job, const unit_t *units, size_t count)
{
    double samples = 0;
    for (size_t i = 0; i < count; i++) samples += (double)unit_samples(&job->kept.settings, &units[i]);
    return samples;
}

bool farm_bits_fit(const job_t *job, const hash_t *fingerprint)
{
    return job->kept.terms.mixed || hash_is_zero(&job->kept.fingerprint) ||
           hash_equal(&job->kept.fingerprint, fingerprint);
}

unit_mac_t farm_unit_mac(const farm_t *farm, const worker_t *worker, const job_t *job, uint64_t check)
{
    hash_t content = job_content_hash(&job->kept.settings, &job->kept.blob);
    return unit_mac(&farm->options.secret, worker->party_text, job->kept.job, &content, check);
}

bool job_has_film(const job_t *job)
{
    return job->film >= FILM_OPEN;
}

bool job_awaits_film(const job_t *job)
{
    return job->film >= FILM_STORED && job->film <= FILM_LOADING;
}

bool job_is_saving(const job_t *job)
{
    return job->write == WRITE_OPEN || job->write == WRITE_RETRIED;
}

void job_unsaved(job_t *job)
{
    if (job->save == SAVE_DONE) job->save = SAVE_DUE;
}

void farm_want_film(farm_t *farm, job_t *job)
{
    if (job->film == FILM_STORED) job->film = FILM_WANTED;
    wake_up(farm->options.checkpoint_wake);
}

bool farm_content_fits(const job_t *job, const hash_t *content)
{
    hash_t own = job_content_hash(&job->kept.settings, &job->kept.blob);
    return content == NULL || hash_equal(content, &own);
}

void farm_job_free_film(farm_t *farm, job_t *job)
{
    if (!job_has_film(job)) return;
    job->film = job->shared_film_users > 0 ? FILM_CONDEMNED : FILM_NONE;
    if (job->film == FILM_CONDEMNED) return;
    farm->film_bytes -= film_bytes(&job->kept.settings);
    shared_film_destroy(&job->shared_film);
    wake_up(farm->options.checkpoint_wake); /* a film may have waited for memory to be loaded */
}

shared_film_t *farm_job_film_hold(job_t *job)
{
    shared_film_t *shared_film = job->film == FILM_CONDEMNED ? NULL : job->shared_film;
    job->shared_film_users += shared_film != NULL;
    return shared_film;
}

void farm_job_film_let_go(farm_t *farm, job_t *job)
{
    job->shared_film_users--;
    if (job->film == FILM_CONDEMNED) farm_job_free_film(farm, job);
}

shared_film_t *job_film_hold(farm_t *farm, job_t *job)
{
    farm_lock(farm);
    shared_film_t *shared_film = farm_job_film_hold(job);
    farm_unlock(farm);
    return shared_film;
}

void job_film_let_go(farm_t *farm, job_t *job)
{
    farm_lock(farm);
    farm_job_film_let_go(farm, job);
    farm_unlock(farm);
}

job_settings_t farm_job_settings(farm_t *farm, const job_t *job)
{
    farm_lock(farm);
    job_settings_t settings = job->kept.settings;
    farm_unlock(farm);
    return settings;
}
