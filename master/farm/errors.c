/* errors: the estimated error of every job, and how it fell (see farm.h).
 *
 * DESIGN. Nobody waits for an estimate, and nothing depends on one: rounds are planned by job_record_t.error,
 * which is computed at fixed points only (jobs.c). So estimates may come at any time, and do not change what
 * is rendered.
 *
 * One looks at ESTIMATE_PIXELS of the film at most, which takes some 10 ms of a core in a film of any size.
 * Merges of that film wait meanwhile, so the next one is made when the samples have grown
 * (error_history_wants), and not before ESTIMATE_REST times as long has passed: a hundredth of the time goes
 * into it at most. Where the whole film is looked at anyway (a round is planned, an image is made) the exact
 * error comes for nothing. */
#include "master/farm/parts.h"

#include "common/film/film.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    ESTIMATE_PIXELS = 1 << 17,
    ESTIMATE_INTERVAL = 2, /* seconds between two of one job, at least, */
    ESTIMATE_REST = 100    /* and so many times what the last one took */
};

/* ---- estimating ---------------------------------------------------------------------------------------- */

void farm_job_note_error(farm_t *farm, double now, job_t *job, uint64_t samples, double error)
{
    error_point_t point = {.elapsed = farm_job_elapsed(job, now), .samples = samples, .error = error};
    if (!error_point_valid(&point)) return;
    error_history_add(&job->history, &point);
    job->history_due = true;
    wake_up(farm->options.journal_writer_wake);
}

static bool estimate_due(const job_t *job, double now)
{
    return job->film == FILM_OPEN && now >= job->next_estimate &&
           error_history_wants(&job->history, job->kept.samples_done);
}

job_t *farm_next_estimate(farm_t *farm, double now)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count && found == NULL && !farm->shut; i++)
        if (estimate_due(farm->jobs[i], now)) found = farm->jobs[i];
    if (found != NULL) {
        found->pins++;
        found->next_estimate = now + ESTIMATE_INTERVAL; /* also when there turns out to be no film */
    }
    farm_unlock(farm);
    return found;
}

void farm_estimate(farm_t *farm, double now, job_t *job)
{
    shared_film_t *shared_film = job_film_hold(farm, job);
    if (shared_film == NULL) return;
    const film_t *film = shared_film_lock(shared_film);
    double begun = clock_now(), error = film_noise_of_rows(film, ESTIMATE_PIXELS);
    double took = clock_now() - begun;
    farm_lock(farm); /* in the shared film: what is counted is what the error is of */
    if (job->schedule != NULL) farm_job_note_error(farm, now, job, schedule_done(job->schedule), error);
    job->next_estimate = now + fmax(ESTIMATE_INTERVAL, ESTIMATE_REST * took);
    farm_unlock(farm);
    shared_film_unlock(shared_film);
    job_film_let_go(farm, job);
}

void farm_note_image_error(farm_t *farm, double now, job_t *job, double error)
{
    farm_lock(farm);
    uint64_t samples = job->schedule != NULL ? schedule_done(job->schedule) : 0;
    if (job->film == FILM_CLOSED || error_history_wants(&job->history, samples))
        farm_job_note_error(farm, now, job, samples, error);
    farm_unlock(farm);
}

/* ---- the history --------------------------------------------------------------------------------------- */

error_point_t *farm_job_history(farm_t *farm, uint64_t id, size_t *count)
{
    error_point_t *points = mem_alloc(ERROR_HISTORY_POINTS * sizeof *points);
    farm_lock(farm);
    const job_t *job = farm_find_job(farm, id);
    *count = job != NULL ? job->history.count : 0;
    if (job != NULL) memcpy(points, job->history.points, *count * sizeof *points);
    farm_unlock(farm);
    if (*count > 0) return points;
    free(points);
    return NULL;
}

bool farm_next_history(farm_t *farm, uint64_t *id, error_history_t *history)
{
    job_t *found = NULL;
    farm_lock(farm);
    for (size_t i = 0; i < farm->job_count && found == NULL; i++)
        if (farm->jobs[i]->history_due) found = farm->jobs[i];
    if (found != NULL) {
        found->history_due = false;
        *id = found->kept.job;
        *history = found->history;
    }
    farm_unlock(farm);
    return found != NULL;
}

void farm_history_unsaved(farm_t *farm, uint64_t id)
{
    farm_lock(farm);
    job_t *job = farm_find_job(farm, id);
    if (job != NULL) job->history_due = true;
    farm_unlock(farm);
}

void farm_restore_history(farm_t *farm, uint64_t id, const error_history_t *history)
{
    farm_lock(farm);
    job_t *job = farm_find_job(farm, id);
    if (job != NULL) job->history = *history;
    farm_unlock(farm);
}

void farm_job_cut_history(farm_t *farm, job_t *job)
{
    if (!error_history_cut(&job->history, job->kept.samples_done)) return;
    job->history_due = true;
    wake_up(farm->options.journal_writer_wake);
}
