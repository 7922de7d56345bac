/* options: see options.h. */
#include "client/options.h"

#include "common/film/film.h"

#include <ctype.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char settings_usage[] =
    "  --spp N            samples a pixel\n"
    "  --time SECONDS     stop after so long, with --spp whichever comes first\n"
    "  --error E          stop when the estimated relative error is at most E (0.01 or 1%, a good "
    "picture),\n"
    "                     with --spp and --time whichever comes first\n"
    "  --adaptive         more samples where there is more noise; --spp is their mean\n"
    "  --integrator NAME  bdpt, path or light\n"
    "  --max-depth N      longest path: N + 1 segments, as pbrt counts\n"
    "  --seed N           random numbers; the same seed makes the same image, bit by bit\n"
    "  --resolution WxH   pixels\n"
    "  --sampler NAME     sobol or independent\n"
    "  --tile-size N      pixels a side of the pieces that the image is cut into\n"
    "  --no-layers        without the layers of what is seen: albedo, normal, position, depth, ...\n"
    "  --lenient          take the nearest substitute for what a scene has and Lightmill has not, and warn\n";

result_t option_integer(const char *option, const char *text, long long least, long long most,
                        long long *value)
{
    char *end;
    errno = 0;
    *value = strtoll(text, &end, 10);
    if (end == text || *end != '\0' || errno != 0 || *value < least || *value > most)
        return result_fail(RESULT_USAGE, "--%s takes a whole number from %lld to %lld, not '%.100s'", option,
                           least, most, text);
    return result_ok();
}

result_t option_real(const char *option, const char *text, double least, double most, double *value)
{
    char *end;
    errno = 0;
    *value = strtod(text, &end);
    if (end == text || *end != '\0' || errno != 0 || !(*value >= least && *value <= most))
        return result_fail(RESULT_USAGE, "--%s takes a number from %g to %g, not '%.100s'", option, least,
                           most, text);
    return result_ok();
}

result_t option_share(const char *option, const char *text, double *value)
{
    char *end;
    errno = 0;
    *value = strtod(text, &end);
    if (end != text && *end == '%') {
        *value /= 100;
        end++;
    }
    if (end == text || *end != '\0' || errno != 0 || !(*value >= 0 && *value <= 1))
        return result_fail(RESULT_USAGE, "--%s takes a share like 1%% or 0.01, at most 1, not '%.100s'",
                           option, text);
    return result_ok();
}

result_t option_error(const char *text, double *value)
{
    result_t result = option_share("error", text, value);
    if (result.code == RESULT_OK && *value > 0 && *value < 1) return result;
    return result_fail(RESULT_USAGE,
                       "--error takes a number between 0 and 1, such as 0.01 or 1%%, not '%.100s'", text);
}

result_t option_job(const char *text, uint64_t *job)
{
    char *end;
    errno = 0;
    *job = strtoull(text, &end, 10);
    if (!isdigit((unsigned char)text[0]) || *end != '\0' || errno != 0 || *job == 0)
        return result_fail(RESULT_USAGE, "'%.100s' is no job number; see lightmill status", text);
    return result_ok();
}

overrides_t overrides_none(void)
{
    return (overrides_t){.max_depth = -1};
}

static result_t parse_resolution(overrides_t *overrides, const char *value)
{
    int width, height, used = 0;
    if (sscanf(value, "%d%*1[xX]%d%n", &width, &height, &used) != 2 || value[used] != '\0' || width < 1 ||
        height < 1 || width > JOB_MAX_RESOLUTION || height > JOB_MAX_RESOLUTION)
        return result_fail(RESULT_USAGE, "--resolution takes WIDTHxHEIGHT up to %d a side, not '%.100s'",
                           JOB_MAX_RESOLUTION, value);
    overrides->width = width;
    overrides->height = height;
    return result_ok();
}

static result_t parse_integrator(overrides_t *overrides, const char *value)
{
    if (integrator_from_name(value, &overrides->integrator)) return result_ok();
    return result_fail(RESULT_USAGE, "--integrator takes bdpt, path or light, not '%.100s'", value);
}

static result_t parse_sampler(overrides_t *overrides, const char *value)
{
    if (sampler_from_name(value, &overrides->sampler)) return result_ok();
    return result_fail(RESULT_USAGE, "--sampler takes sobol or independent, not '%.100s'", value);
}

static result_t parse_seed(overrides_t *overrides, const char *value)
{
    char *end;
    errno = 0;
    overrides->seed = strtoull(value, &end, 0);
    overrides->has_seed = true;
    if (!isdigit((unsigned char)value[0]) || *end != '\0' || errno != 0)
        return result_fail(RESULT_USAGE, "--seed takes a whole number below 2^64, not '%.100s'", value);
    return result_ok();
}

result_t overrides_option(overrides_t *overrides, const char *option, const char *value, bool *taken)
{
    long long number = 0;
    *taken = true;
    if (strcmp(option, "spp") == 0) {
        TRY(option_integer(option, value, 1, JOB_MAX_SPP, &number));
        overrides->spp = (uint32_t)number;
    } else if (strcmp(option, "time") == 0) {
        TRY(option_real(option, value, 0.1, 1e9, &overrides->time_limit));
    } else if (strcmp(option, "error") == 0) {
        return option_error(value, &overrides->error);
    } else if (strcmp(option, "adaptive") == 0) {
        overrides->adaptive = true;
    } else if (strcmp(option, "max-depth") == 0) {
        TRY(option_integer(option, value, 0, JOB_MAX_DEPTH, &number));
        overrides->max_depth = (int32_t)number;
    } else if (strcmp(option, "tile-size") == 0) {
        TRY(option_integer(option, value, JOB_MIN_TILE, JOB_MAX_TILE, &number));
        overrides->tile_size = (int32_t)number;
    } else if (strcmp(option, "no-layers") == 0) {
        overrides->no_layers = true;
    } else if (strcmp(option, "integrator") == 0) {
        return parse_integrator(overrides, value);
    } else if (strcmp(option, "sampler") == 0) {
        return parse_sampler(overrides, value);
    } else if (strcmp(option, "seed") == 0) {
        return parse_seed(overrides, value);
    } else if (strcmp(option, "resolution") == 0) {
        return parse_resolution(overrides, value);
    } else if (strcmp(option, "lenient") == 0) {
        overrides->lenient = true;
    } else {
        *taken = false;
    }
    return result_ok();
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
    if (overrides->no_layers) settings->features = false;
    settings->film_scale = blob_film_scale(blob);
    /* Samples that count JOB_MEAN_BOOST times in the mean take two bits of the sums. */
    if (settings->adaptive) settings->film_scale = int_max(FILM_MIN_SCALE, settings->film_scale - 2);
    return job_settings_check(settings);
}
