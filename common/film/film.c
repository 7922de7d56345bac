/* film: the sums of a job in memory (see film.h). */
#include "common/film/film.h"

#include <stdlib.h>

result_t film_new(const job_settings_t *settings, film_t **film)
{
    film_t *made = mem_zalloc(1, sizeof *made);
    bool complete = true;
    made->settings = *settings;
    for (sum_kind_t k = 0; k < FILM_SUMS; k++) {
        size_t values = sum_image_values(settings, k);
        void *sums = values > 0 ? calloc(values, film_sums[k].bytes) : NULL;
        complete = complete && (values == 0 || sums != NULL);
        if (k == SUM_SAMPLES)
            made->samples = sums;
        else
            made->sums[k] = sums;
    }
    *film = made;
    if (complete) return result_ok();
    film_destroy(film);
    return result_fail(RESULT_LIMIT, "no memory for a film of %d x %d pixels", settings->width,
                       settings->height);
}

void film_destroy(film_t **film)
{
    if (*film == NULL) return;
    for (sum_kind_t k = 0; k < FILM_SUMS; k++) free(film_values(*film, k));
    free(*film);
    *film = NULL;
}

void *film_values(const film_t *film, sum_kind_t kind)
{
    return kind == SUM_SAMPLES ? (void *)film->samples : film->sums[kind];
}

uint64_t film_bytes(const job_settings_t *settings)
{
    uint64_t pixels = (uint64_t)settings->width * (uint64_t)settings->height, bytes = 0;
    uint64_t features = job_has_features(settings) ? FEATURE_VALUES : 0;
    for (sum_kind_t k = 0; k < FILM_SUMS; k++) bytes += sum_image_values(settings, k) * film_sums[k].bytes;
    uint64_t mattes = job_has_mattes(settings) ? 4 * MATTE_LEVELS * MATTE_KINDS : 0;
    uint64_t groups = 3 * (sum_planes(settings, SUM_GROUP_EYE) + sum_planes(settings, SUM_GROUP_SPLAT));
    return bytes + pixels * (13 + features + mattes + groups) * sizeof(float);
}
