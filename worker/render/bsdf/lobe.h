/* lobe: what lobes share, and the materials that add them. */
#ifndef LIGHTMILL_LOBE_H
#define LIGHTMILL_LOBE_H

#include "worker/render/bsdf/bsdf.h"
#include "worker/render/bsdf/fresnel.h"

/* An index of refraction that differs from 1 by less does not turn light enough to tell a rough surface. */
#define LOBE_LEAST_REFRACTION 1e-3f

/* The reflectance of a clear coat of glTF's at normal incidence: index 1.5. */
#define SCHLICK_COAT_F0 0.04f

/* Roughens alphas below 0.3 (pbrt-v4's rule: twice the alpha, from 0.1 to 0.3). */
void lobe_regularize_alphas(lobe_t *lobe);
void lobe_regularize_pair(float alpha[2]);

/* The share of the light leaving a Lambertian base that a smooth coat, or the way there and back through an
 * absorbing medium, sends back to it: the integral over the hemisphere of 2 cos R(cos) exp(-2 thickness /
 * cos) where R is the Fresnel reflectance from inside. `ior` is that of the inside over the outside. */
float lobe_layered_returns(float ior, float thickness);

/* Charlie sheen of weight one at the cosine `cos` >= 0: the share of the light that it reflects. */
float lobe_sheen_albedo(float cos, float roughness);
/* The mean of it over the hemisphere, weighed by the cosine. */
float lobe_sheen_mean(float roughness);
/* A sheen's roughness within the limits of its table. */
float lobe_sheen_roughness(float roughness);

/* What the cover of a lobe leaves to it of the light between wo and wi: 1 - c F of a coat of weight c, and
 * 1 - c E of a sheen. The standard takes the coat's F at the angle of the viewer; here it is that of the more
 * grazing of both directions, as it is for the sheen, so that the sum is reciprocal and still not more than
 * what comes in. The coat's angles are those to its normal, which may be its own. */
float lobe_cover_passes(const lobe_cover_t *cover, vec3_t wo, vec3_t wi);
/* About the mean of that. */
float lobe_cover_mean(const lobe_cover_t *cover);

/* The sum of what goes by all modes of a hair, seen straight on at its offset h. */
rgb_t lobe_hair_albedo(const lobe_hair_t *hair);

/* Evaluate and sample a lobe that is the same from both sides and in both modes, by its eval_above and
 * draw_above. */
bool lobe_eval_mirrored(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                        bsdf_value_t *value);
bool lobe_sample_mirrored(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                          bsdf_sample_t *sample);
/* Completes a sample of a rough lobe: `wi` was drawn for wo turned above the surface, where `value` is what
 * the lobe says of the two. False when that is nothing. */
bool lobe_complete(vec3_t wo, vec3_t wi, const bsdf_value_t *value, bsdf_sample_t *sample);

/* Draws wi by the cosine, on the side of the surface where wo is, or on the other one. */
bool lobe_sample_cosine(vec3_t wo, vec2_t u, bool same_side, bsdf_sample_t *sample);
/* Sets the densities of this, where `allowed`: the pair lies on the sides that are drawn. */
void lobe_cosine_densities(vec3_t wo, vec3_t wi, bool allowed, bsdf_value_t *value);

/* The index of the far side of an interface over that of the near side, as seen from w. */
static inline float lobe_relative_index(const lobe_t *lobe, vec3_t w)
{
    return w.z > 0 ? lobe->dielectric.ior : 1 / lobe->dielectric.ior;
}

/* An index of refraction within sensible limits; 0 counts as 1, no interface. */
static inline float lobe_sane_ior(float ior)
{
    return ior == 0 ? 1 : float_clamp(ior, 0.01f, 100);
}

/* Whether values and densities of a table can be divided by one another without overflow; a density that is
 * next to nothing becomes 0. Tables of files may say anything. */
static inline bool lobe_is_sane(bsdf_value_t *value)
{
    const float largest = 1e15f, least = 1e-20f;
    if (!(value->pdf >= least)) value->pdf = 0;
    if (!(value->pdf_rev >= least)) value->pdf_rev = 0;
    return v_is_finite(value->f) && v_max(value->f) <= largest && value->pdf <= largest &&
           value->pdf_rev <= largest;
}

/* The probability of reflecting, where the Fresnel reflectance is `f` and the rest is transmitted, each with
 * its factor. False when neither carries anything. */
static inline bool lobe_reflect_chance(float f, rgb_t reflected, rgb_t transmitted, float *chance)
{
    float r = f * v_max(reflected), t = (1 - f) * v_max(transmitted);
    if (!(r + t > 0)) return false;
    *chance = r / (r + t);
    return true;
}

#endif
