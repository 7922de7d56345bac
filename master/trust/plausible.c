/* plausible: how large the values of a batch may be, before another rendering is asked for.
 *
 * DESIGN. What an integrator adds to a pixel is, with multiple importance sampling, seldom more than the
 * radiance of the brightest light; a firefly is more, and a pixel that sees the light has it in every sample,
 * with what the light itself reflects. So the bound of a value is
 *
 *     brightest light * (2^FIREFLY_BITS + 2^SEEN_BITS * samples)
 *
 * with the samples of the unit, or of a splat frame those of a mean pixel. In none of the scenes of scenes/
 * comes a value nearer to it than 1 in 7. `light` weighs nothing, and its fireflies are LIGHT_GAIN times as
 * large. What a light without size, or an image of unknown values, makes of a surface near it or a mirror is
 * not known without rendering: such lights have UNKNOWN_GAIN as much. A scene that is dim all over is taken
 * for DIMMEST. A job with a smaller film scale than the usual one expects larger sums by as much.
 *
 * This bound does not follow what was counted, or else a liar could raise it in small steps. It rises only
 * when two renderings agree on a value beyond it, by far enough that this happens a few times at most in the
 * life of a job: RAISE_BITS each time, of 62.
 *
 * There is no rule that sums are not negative: the lobes of the filters of Mitchell and Lanczos make such,
 * and honest ones. */
#include "master/trust/trust.h"

#include <math.h>

enum { RAISE_BITS = 4, FIREFLY_BITS = 7, SEEN_BITS = 2 };
static const double LARGEST = 0x1p61, UNKNOWN_GAIN = 0x1p10, LIGHT_GAIN = 0x1p6, DIMMEST = 16;

/* ---- lights -------------------------------------------------------------------------------------------- */

double plausible_brightest(const scene_blob_t *blob)
{
    double brightest = fmax(DIMMEST, (double)v_max(blob->scene->occlusion_radiance));
    for (uint64_t i = 0; i < blob->counts[BLOB_SECTION_LIGHTS]; i++) {
        const blob_light_t *light = &blob->lights[i];
        bool bounded = light->kind == LIGHT_AREA && light->radiance.texture == 0;
        brightest = fmax(brightest, (double)v_max(light->radiance.factor) * (bounded ? 1 : UNKNOWN_GAIN));
    }
    return brightest;
}

/* ---- limits -------------------------------------------------------------------------------------------- */

static bool is_radiance(sum_kind_t kind)
{
    return kind == SUM_EYE || kind == SUM_SPLAT || kind == SUM_GROUP_EYE || kind == SUM_GROUP_SPLAT;
}

sum_limits_t plausible_limits(const job_t *job)
{
    int scale = int_max(job->kept.settings.film_scale, FILM_DEFAULT_SCALE);
    double light = ldexp(job->brightest > 0 ? job->brightest : UNKNOWN_GAIN, scale);
    if (job->kept.settings.integrator == INTEGRATOR_LIGHT) light *= LIGHT_GAIN;
    sum_limits_t limits = {.once = {0}};
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) {
        if (!is_radiance(k)) continue;
        double raised = ldexp((double)job->confirmed[k], RAISE_BITS);
        limits.once[k] = (uint64_t)fmin(fmax(ldexp(light, FIREFLY_BITS), raised), LARGEST);
        limits.each[k] = limits.once[k] >> (FIREFLY_BITS - SEEN_BITS);
    }
    return limits;
}

sum_limits_t plausible_anything(void)
{
    sum_limits_t limits = {.measured = true};
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (is_radiance(k)) limits.once[k] = UINT64_C(1) << 62;
    return limits;
}

void plausible_confirm(job_t *job, const sum_limits_t *limits)
{
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        if (job->confirmed[k] < limits->top[k]) job->confirmed[k] = limits->top[k];
}
