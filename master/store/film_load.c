/* film_load: see film_load.h. */
#include "master/store/film_load.h"

#include <stdlib.h>

/* Is this the film of this job, and does the schedule take it? */
static result_t check_fit(const job_record_t *record, const film_load_t *load, const char *path)
{
    schedule_t *schedule = NULL;
    job_settings_t settings = record->settings;
    if (load->info.record.job != record->job || !hash_equal(&load->info.record.blob, &record->blob))
        return result_fail(RESULT_INPUT, "%.300s is of another job", path);
    result_t result = schedule_restore(&settings, &load->state, &schedule);
    schedule_destroy(&schedule);
    return result;
}

static result_t load_file(const char *path, const job_record_t *record, int threads, film_load_t *load)
{
    checkpoint_t *checkpoint;
    TRY(checkpoint_open(path, &checkpoint));
    load->info = *checkpoint_info(checkpoint);
    if (load->info.samples > load->most) load->most = load->info.samples;
    result_t result = checkpoint_load(checkpoint, &record->settings, threads, &load->film, &load->state);
    checkpoint_close(&checkpoint);
    TRY(result);
    result = check_fit(record, load, path);
    if (result.code == RESULT_OK) return result;
    film_destroy(&load->film);
    schedule_state_free(&load->state);
    return result;
}

film_load_t film_load(film_store_t *films, const job_record_t *record, int threads)
{
    film_load_t load = {.failure = result_ok()};
    size_t count;
    film_file_t *files = film_store_list(films, record->job, &count);
    for (size_t i = 0; i < count && load.film == NULL; i++) {
        char *path = film_store_path(films, record->job, files[i].generation);
        result_t result = load_file(path, record, threads, &load);
        if (result.code == RESULT_INPUT) {
            log_error("A CHECKPOINT IS DAMAGED: %s", result.message);
            film_store_set_aside(films, record->job, files[i].generation);
        } else if (result.code != RESULT_OK) {
            log_error("a checkpoint cannot be used: %s", result.message);
            load.unreadable = true;
        }
        if (load.failure.code == RESULT_OK) load.failure = result;
        free(path);
    }
    free(files);
    return load;
}
