/* overrides: see overrides.h. */
#include "common/scene/overrides.h"

#include <stdlib.h>

overrides_t overrides_none(void)
{
    return (overrides_t){.max_depth = -1, .film_scale = -1};
}

/* Images at more samples than the job is to have would never come. */
static result_t check_reached(const job_settings_t *settings)
{
    const save_at_t *save_at = &settings->save_at;
    if (save_at->count == 0 || save_at->spp[save_at->count - 1] <= settings->spp) return result_ok();
    uint32_t last = save_at->spp[save_at->count - 1];
    return result_fail(RESULT_USAGE,
                       "an image is to be kept at %u samples a pixel, and the job has %u: use %u or more",
                       last, settings->spp, last);
}

static result_t group_lights(const overrides_t *overrides, const scene_blob_t *blob, job_settings_t *settings)
{
    if (overrides->light_groups == NULL) return result_ok();
    grouped_light_t *lights = blob_grouped_lights(blob);
    result_t result = light_groups_resolve(overrides->light_groups, lights, blob->counts[BLOB_SECTION_LIGHTS],
                                           settings->light_groups);
    free(lights);
    return result;
}

result_t overrides_apply(const overrides_t *overrides, const scene_blob_t *blob, job_settings_t *settings)
{
    *settings = blob_default_settings(blob);
    if (overrides->integrator) settings->integrator = overrides->integrator;
    if (overrides->sampler) settings->sampler = overrides->sampler;
    if (overrides->has_seed) settings->seed = overrides->seed;
    if (overrides->max_depth >= 0) settings->max_depth = overrides->max_depth;
    if (overrides->tile_size > 0) settings->tile_size = overrides->tile_size;
    if (overrides->width > 0) {
        settings->width = overrides->width;
        settings->height = overrides->height;
    }
    settings->time_limit = overrides->time_limit;
    settings->error = overrides->error;
    settings->adaptive = overrides->adaptive;
    if (overrides->time_limit > 0 || overrides->error > 0) settings->spp = JOB_MAX_SPP;
    if (overrides->spp > 0) settings->spp = overrides->spp;
    settings->save_at = overrides->save_at;
    TRY(check_reached(settings));
    if (overrides->no_layers) settings->features = false;
    settings->cryptomatte = overrides->cryptomatte;
    if (overrides->no_learn) settings->learn = false;
    settings->merge_radius = overrides->merge_radius;
    settings->spectral = overrides->spectral;
    settings->film_scale = blob_film_scale(blob);
    /* Samples that count JOB_MEAN_BOOST times in the mean take two bits of the sums. */
    if (settings->adaptive) settings->film_scale = int_max(FILM_MIN_SCALE, settings->film_scale - 2);
    if (overrides->film_scale >= 0) settings->film_scale = overrides->film_scale;
    TRY(group_lights(overrides, blob, settings));
    TRY(blob_check_settings(blob, settings));
    return job_settings_check(settings);
}
