/* job: settings and units (see job.h). */
#include "common/job.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int unit_order(const void *a, const void *b)
{
    const unit_t *u = a, *v = b;
    if (u->tile != v->tile) return u->tile < v->tile ? -1 : 1;
    return u->first < v->first ? -1 : u->first > v->first;
}

unit_t *units_sorted(const unit_t *units, size_t count)
{
    unit_t *sorted = mem_alloc((count + 1) * sizeof *sorted);
    memcpy(sorted, units, count * sizeof *sorted);
    qsort(sorted, count, sizeof *sorted, unit_order);
    return sorted;
}

bool units_same(const unit_t *a, size_t a_count, const unit_t *b, size_t b_count)
{
    if (a_count != b_count) return false;
    unit_t *x = units_sorted(a, a_count), *y = units_sorted(b, b_count);
    bool same = memcmp(x, y, a_count * sizeof *x) == 0;
    free(x);
    free(y);
    return same;
}

result_t units_check_apart(const unit_t *units, size_t count)
{
    unit_t *sorted = units_sorted(units, count);
    result_t result = result_ok();
    for (size_t i = 1; i < count && result.code == RESULT_OK; i++)
        if (sorted[i].tile == sorted[i - 1].tile &&
            sorted[i].first - sorted[i - 1].first < sorted[i - 1].count)
            result = result_fail(RESULT_MISMATCH, "tile %u, sample %u is in the batch twice", sorted[i].tile,
                                 sorted[i].first);
    free(sorted);
    return result;
}

job_settings_t job_settings_default(void)
{
    return (job_settings_t){.integrator = INTEGRATOR_BDPT,
                            .sampler = SAMPLER_SOBOL,
                            .width = 1280,
                            .height = 720,
                            .max_depth = 8,
                            .spp = 64,
                            .tile_size = 32,
                            .film_scale = FILM_DEFAULT_SCALE,
                            .features = true,
                            .learn = true};
}

static result_t check_range(const char *name, int64_t value, int64_t low, int64_t high)
{
    if (value >= low && value <= high) return result_ok();
    return result_fail(RESULT_USAGE, "%s is %lld, must be from %lld to %lld", name, (long long)value,
                       (long long)low, (long long)high);
}

bool job_strategy_exists(int s, int t)
{
    return s >= 0 && t >= 1 && (t >= 2 || s >= 2);
}

static result_t check_strategy(const job_settings_t *settings)
{
    int s = settings->strategy_s, t = settings->strategy_t;
    TRY(check_range("light vertices of the strategy (s)", s, 0, JOB_MAX_DEPTH + 1));
    TRY(check_range("eye vertices of the strategy (t)", t, 0, JOB_MAX_DEPTH + 2));
    if (s == 0 && t == 0) {
        if (!settings->unweighted) return result_ok();
        return result_fail(RESULT_USAGE,
                           "unweighted without a strategy: strategies are only comparable one by one");
    }
    if (settings->integrator != INTEGRATOR_BDPT)
        return result_fail(RESULT_USAGE, "the strategy s = %d, t = %d belongs to bdpt, not to %s", s, t,
                           integrator_name(settings->integrator));
    if (!job_strategy_exists(s, t))
        return result_fail(RESULT_USAGE, "bdpt has no strategy s = %d, t = %d", s, t);
    if (s + t - 1 > settings->max_depth + 1)
        return result_fail(RESULT_USAGE,
                           "the strategy s = %d, t = %d makes paths of %d segments, max depth %d allows %d",
                           s, t, s + t - 1, settings->max_depth, settings->max_depth + 1);
    return result_ok();
}

static result_t check_merge_radius(const job_settings_t *settings)
{
    if (!(settings->merge_radius >= 0) || !(settings->merge_radius <= JOB_MAX_MERGE_RADIUS))
        return result_fail(
            RESULT_USAGE,
            "the merge radius is %g, must be 0 (as the scene's size says) or positive, at most %d",
            settings->merge_radius, JOB_MAX_MERGE_RADIUS);
    if (settings->merge_radius == 0 || settings->integrator == INTEGRATOR_VCM) return result_ok();
    return result_fail(RESULT_USAGE, "a merge radius belongs to the integrator vcm, and %s merges nothing",
                       integrator_name(settings->integrator));
}

static result_t check_save_at(const job_settings_t *settings)
{
    const save_at_t *save_at = &settings->save_at;
    TRY(check_range("sample counts to save images at", save_at->count, 0, JOB_MAX_SAVES));
    for (uint32_t i = 0; i < save_at->count; i++) {
        TRY(check_range("a sample count to save an image at", save_at->spp[i], 1, JOB_MAX_SPP));
        if (i > 0 && save_at->spp[i] <= save_at->spp[i - 1])
            return result_fail(RESULT_USAGE,
                               "images are to be saved at %u samples and then at %u: the counts "
                               "must rise",
                               save_at->spp[i - 1], save_at->spp[i]);
    }
    if (save_at->count == 0 || !settings->adaptive) return result_ok();
    return result_fail(RESULT_USAGE,
                       "an adaptive job has no moment at which every pixel has %u samples: "
                       "save images at sample counts (--save-at) without --adaptive",
                       save_at->spp[0]);
}

result_t job_settings_check(const job_settings_t *settings)
{
    TRY(check_range("integrator", settings->integrator, INTEGRATOR_BDPT, INTEGRATOR_VCM));
    TRY(check_range("sampler", settings->sampler, SAMPLER_SOBOL, SAMPLER_INDEPENDENT));
    TRY(check_range("width", settings->width, 1, JOB_MAX_RESOLUTION));
    TRY(check_range("height", settings->height, 1, JOB_MAX_RESOLUTION));
    TRY(check_range("pixels in all", (int64_t)settings->width * settings->height, 1, JOB_MAX_PIXELS));
    TRY(check_range("max depth", settings->max_depth, 0, JOB_MAX_DEPTH));
    TRY(check_range("samples a pixel", settings->spp, 1, JOB_MAX_SPP));
    TRY(check_range("tile size", settings->tile_size, JOB_MIN_TILE, JOB_MAX_TILE));
    TRY(check_range("film scale", settings->film_scale, FILM_MIN_SCALE, FILM_MAX_SCALE));
    if (!(settings->time_limit >= 0) || !isfinite(settings->time_limit))
        return result_fail(RESULT_USAGE, "time limit is %g, must be 0 (none) or positive seconds",
                           settings->time_limit);
    if (!(settings->error >= 0) || !(settings->error < 1))
        return result_fail(RESULT_USAGE, "error is %g, must be 0 (none) or below 1", settings->error);
    if (settings->adaptive && settings->spp < JOB_MAX_SPP)
        TRY(check_range("samples a pixel of an adaptive job", settings->spp, 1, JOB_MAX_ADAPTIVE_SPP));
    TRY(check_save_at(settings));
    TRY(check_merge_radius(settings));
    if (settings->cryptomatte && settings->integrator == INTEGRATOR_LIGHT)
        return result_fail(RESULT_USAGE, "cryptomatte shows what eye rays meet, and the integrator light "
                                         "follows none: use bdpt or path");
    if (settings->spectral &&
        (settings->integrator == INTEGRATOR_AO || settings->integrator == INTEGRATOR_VCM))
        return result_fail(RESULT_USAGE, "a spectral render goes with bdpt, path and light, not with %s: %s",
                           integrator_name(settings->integrator),
                           settings->integrator == INTEGRATOR_AO
                               ? "ambient occlusion has no colours"
                               : "photons of other samples have other wavelengths");
    TRY(light_groups_check(settings->light_groups));
    if (settings->light_groups[0] != '\0' && settings->integrator == INTEGRATOR_AO)
        return result_fail(RESULT_USAGE, "light groups tell lights apart, and the integrator ao (ambient "
                                         "occlusion) looks at none: use bdpt or path");
    TRY(check_range("pixels in all times light groups",
                    (int64_t)settings->width * settings->height *
                        (int64_t)light_groups_count(settings->light_groups),
                    0, JOB_MAX_GROUP_PIXELS));
    return check_strategy(settings);
}

result_t job_terms_check(const job_terms_t *terms)
{
    TRY(check_range("priority", terms->priority, -JOB_MAX_PRIORITY, JOB_MAX_PRIORITY));
    if (terms->verify >= 0 && terms->verify <= 1) return result_ok();
    return result_fail(RESULT_USAGE, "the share of verified units is %g, must be from 0 to 1", terms->verify);
}

static uint32_t tiles_across(const job_settings_t *settings)
{
    return (uint32_t)((settings->width + settings->tile_size - 1) / settings->tile_size);
}

uint32_t job_tile_count(const job_settings_t *settings)
{
    return tiles_across(settings) *
           (uint32_t)((settings->height + settings->tile_size - 1) / settings->tile_size);
}

rect_t job_tile_rect(const job_settings_t *settings, uint32_t tile)
{
    int32_t size = settings->tile_size;
    int32_t x = (int32_t)(tile % tiles_across(settings)) * size;
    int32_t y = (int32_t)(tile / tiles_across(settings)) * size;
    return (rect_t){x, y, int_min(x + size, settings->width), int_min(y + size, settings->height)};
}

uint32_t job_tile_pixels(const job_settings_t *settings, uint32_t tile)
{
    rect_t rect = job_tile_rect(settings, tile);
    return (uint32_t)((rect.x1 - rect.x0) * (rect.y1 - rect.y0));
}

uint64_t unit_samples(const job_settings_t *settings, const unit_t *unit)
{
    return (uint64_t)unit->count * job_tile_pixels(settings, unit->tile);
}

uint64_t job_total_samples(const job_settings_t *settings)
{
    uint64_t pixels = (uint64_t)settings->width * (uint64_t)settings->height;
    return settings->spp < JOB_MAX_SPP ? pixels * settings->spp : 0;
}

bool job_is_planned(const job_settings_t *settings)
{
    return job_follows_noise(settings) || settings->save_at.count > 0;
}

bool job_follows_noise(const job_settings_t *settings)
{
    return settings->error > 0 || settings->adaptive;
}

uint32_t job_next_milestone(const job_settings_t *settings, uint32_t spp)
{
    for (uint32_t i = 0; i < settings->save_at.count; i++)
        if (settings->save_at.spp[i] > spp) return settings->save_at.spp[i];
    return JOB_MAX_SPP + 1;
}

uint32_t job_sample_limit(const job_settings_t *settings)
{
    if (!settings->adaptive || settings->spp > JOB_MAX_ADAPTIVE_SPP) return settings->spp;
    return settings->spp * JOB_MAX_BOOST;
}

bool job_unit_valid(const job_settings_t *settings, const unit_t *unit)
{
    uint32_t limit = job_sample_limit(settings);
    return unit->tile < job_tile_count(settings) && unit->count > 0 && unit->count <= limit &&
           unit->first <= limit - unit->count;
}

uint32_t job_run_end(const job_settings_t *settings, uint32_t first)
{
    if (settings->integrator != INTEGRATOR_VCM) return UINT32_MAX;
    return first - first % JOB_PHOTON_RUN + JOB_PHOTON_RUN;
}

result_t job_check_units(const job_settings_t *settings, const unit_t *units, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!job_unit_valid(settings, &units[i]))
            return result_fail(RESULT_PROTOCOL, "unit (tile %u, samples %u + %u) is not of this job",
                               units[i].tile, units[i].first, units[i].count);
    return result_ok();
}

bool job_has_features(const job_settings_t *settings)
{
    return settings->features && settings->integrator != INTEGRATOR_LIGHT;
}

bool job_has_mattes(const job_settings_t *settings)
{
    return settings->cryptomatte && settings->integrator != INTEGRATOR_LIGHT;
}

bool job_has_splats(const job_settings_t *settings)
{
    return settings->integrator == INTEGRATOR_BDPT || settings->integrator == INTEGRATOR_LIGHT ||
           settings->integrator == INTEGRATOR_VCM;
}

hash_t job_content_hash(const job_settings_t *settings, const hash_t *blob)
{
    char hex[2 * HASH_BYTES + 1], text[440 + sizeof settings->light_groups];
    hash_to_hex(blob, hex);
    int length = snprintf(
        text, sizeof text,
        "scene %s integrator %d sampler %d seed %llu size %dx%d depth %d tile %d scale %d "
        "strategy %d %d unweighted %d features %d",
        hex, (int)settings->integrator, (int)settings->sampler, (unsigned long long)settings->seed,
        settings->width, settings->height, settings->max_depth, settings->tile_size, settings->film_scale,
        settings->strategy_s, settings->strategy_t, settings->unweighted, settings->features);
    if (settings->cryptomatte)
        length += snprintf(text + length, sizeof text - (size_t)length, " cryptomatte");
    if (settings->learn) /* an adaptive job has other passes */
        length += snprintf(text + length, sizeof text - (size_t)length,
                           settings->adaptive ? " learn adaptive" : " learn");
    if (settings->light_groups[0] != '\0')
        length += snprintf(text + length, sizeof text - (size_t)length, " groups %s", settings->light_groups);
    if (settings->merge_radius > 0)
        length +=
            snprintf(text + length, sizeof text - (size_t)length, " merge %.17g", settings->merge_radius);
    if (settings->spectral) length += snprintf(text + length, sizeof text - (size_t)length, " spectral");
    return hash_bytes(text, (size_t)length);
}

uint32_t unit_half_count(const unit_t *unit, int half)
{
    uint32_t even = (unit->count + 1 - (unit->first & 1)) / 2;
    return half == 0 ? even : unit->count - even;
}

const char *const integrator_names[] = {"bdpt", "path", "light", "ao", "vcm", NULL};
const char *const sampler_names[] = {"sobol", "independent", NULL};

const char *integrator_name(integrator_t integrator)
{
    return integrator_names[integrator - INTEGRATOR_BDPT];
}

const char *sampler_name(sampler_kind_t sampler)
{
    return sampler_names[sampler - SAMPLER_SOBOL];
}
