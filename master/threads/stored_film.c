/* stored_film: see stored_film.h. The job stays as it is: what is loaded here is thrown away again. */
#include "master/threads/stored_film.h"

#include "master/store/film_load.h"

#include <stdlib.h>

static result_t no_film(const job_record_t *record)
{
    return result_fail(RESULT_INPUT,
                       "the film of job %llu is no longer kept, and its image has no halves: submit it again "
                       "with --halves (retain a job whose film you want to keep)",
                       (unsigned long long)record->job);
}

/* The last checkpoint may be damaged, or was given up: then an earlier one is not the film of the image. */
static result_t check_whole(const job_record_t *record, const film_load_t *load)
{
    if (load->info.samples == record->samples_done) return result_ok();
    return result_fail(RESULT_INPUT,
                       "the film of job %llu that is kept has %llu samples, and its image %llu: submit it "
                       "again with --halves",
                       (unsigned long long)record->job, (unsigned long long)load->info.samples,
                       (unsigned long long)record->samples_done);
}

/* The film of an adaptive job knows the weights of its samples, the state their number. */
static void show_samples(const job_record_t *record, const schedule_state_t *state, film_image_t *image)
{
    job_settings_t settings = record->settings;
    schedule_t *schedule = NULL;
    if (schedule_restore(&settings, state, &schedule).code != RESULT_OK) return;
    uint32_t *samples = mem_alloc(job_tile_count(&settings) * sizeof *samples);
    schedule_tile_samples(schedule, samples);
    schedule_show_samples(&settings, samples, 0, settings.height, image->samples);
    free(samples);
    schedule_destroy(&schedule);
}

static result_t load_and_resolve(film_store_t *films, const job_record_t *record, const film_extras_t *extras,
                                 film_image_t *image)
{
    film_load_t load = film_load(films, record, 1);
    if (load.film == NULL) return load.failure.code == RESULT_OK ? no_film(record) : load.failure;
    result_t result = check_whole(record, &load);
    if (result.code == RESULT_OK) {
        film_resolve(load.film, image);
        film_resolve_extras(load.film, extras, image);
        if (record->settings.adaptive) show_samples(record, &load.state, image);
    }
    film_destroy(&load.film);
    schedule_state_free(&load.state);
    return result;
}

result_t stored_film_resolve(farm_t *farm, film_store_t *films, const job_record_t *record,
                             const film_extras_t *extras, film_image_t *image)
{
    uint64_t bytes = film_bytes(&record->settings);
    if (film_store_bytes(films, record->job) == 0) return no_film(record);
    if (!farm_claim_memory(farm, bytes))
        return result_fail(RESULT_LIMIT,
                           "the film of job %llu takes %.1f GB, and jobs at work leave no room for it: try "
                           "again later",
                           (unsigned long long)record->job, 1e-9 * (double)bytes);
    result_t result = load_and_resolve(films, record, extras, image);
    farm_return_memory(farm, bytes);
    return result;
}
