/* lobe_phase: how a point in a medium scatters light: Henyey and Greenstein's phase function (1941). It
 * stands in a frame whose normal is wo, so that z is the cosine between both directions, and its integral
 * over all directions is 1. g is the mean cosine between the way of the light before and
 * after. There are no cosines to any surface: `weight` is the value over the density, which is 1. */
#include "worker/render/bsdf/lobe.h"

/* By the cosine between the directions in which light is, which both leave the point. */
static float phase(float g, float z)
{
    float wide = 1 + g * (g + 2 * z); /* g > 0: most where wi is opposite wo */
    return (1 - g * g) * (0.25f * INV_PI_F) / (wide * sqrtf(float_max(wide, 1e-20f)));
}

static bool eval(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value)
{
    (void)wo, (void)reflect, (void)mode;
    float p = phase(lobe->phase.g, wi.z);
    *value = (bsdf_value_t){vec3(p, p, p), p, p};
    return p > 0;
}

static bool sample(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                   bsdf_sample_t *sample)
{
    (void)wo, (void)choice, (void)mode;
    float g = lobe->phase.g, z = 1 - 2 * u.x;
    if (fabsf(g) > 1e-3f) {
        float part = (1 - g * g) / (1 + g - 2 * g * u.x);
        z = (part * part - 1 - g * g) / (2 * g);
    }
    z = float_clamp(z, -1, 1);
    float r = sqrtf(float_max(0, 1 - z * z)), phi = TWO_PI_F * u.y, p = phase(g, z);
    *sample = (bsdf_sample_t){.wi = vec3(r * cosf(phi), r * sinf(phi), z),
                              .weight = vec3(1, 1, 1),
                              .pdf = p,
                              .pdf_rev = p,
                              .squeeze = 1};
    return true;
}

const lobe_kind_t lobe_phase = {.flags = LOBE_REFLECTS | LOBE_TRANSMITS, .eval = eval, .sample = sample};
