/* shading: see shading.h. */
#include "worker/render/material/shading.h"

#include "common/sampler.h"

#include <string.h>

/* Bounds beyond anything sensible, far enough from overflow for the arithmetic of all lobes. */
#define LARGEST_VALUE 1e6f

static float sane(float x, float low)
{
    return x > low ? float_min(x, LARGEST_VALUE) : low;
}

/* Not textures_value: most values have no texture, and then need no scene. */
static rgb_t value_at(const shading_t *shading, material_value_t value)
{
    const blob_value_t *v = &shading->material->values[value];
    return v->texture == 0 ? v->factor : textures_value(scene_textures(shading->scene), v, shading->at);
}

static bool is_share(material_value_t value)
{
    return value == VALUE_REFLECTANCE || value == VALUE_TRANSMITTANCE || value == VALUE_ALBEDO ||
           value == VALUE_AMOUNT;
}

/* The colour as RGB. */
static inline rgb_t plain_colour(const shading_t *shading, material_value_t value)
{
    rgb_t c = value_at(shading, value);
    if ((shading->material->flags & MATERIAL_UNIT) != 0 && is_share(value))
        c = vec3(float_min(c.x, 1), float_min(c.y, 1), float_min(c.z, 1));
    return vec3(sane(c.x, 0), sane(c.y, 0), sane(c.z, 0));
}

/* Of what is no share of light. */
static bool is_coefficient(material_value_t value)
{
    return value == VALUE_ETA || value == VALUE_K || value == VALUE_BASE_ETA || value == VALUE_ATTENUATION;
}

rgb_t shading_colour(const shading_t *shading, material_value_t value)
{
    rgb_t c = plain_colour(shading, value);
    if (shading->waves == NULL) return c;
    const blob_value_t *v = &shading->material->values[value];
    if (v->spectrum != 0 && v->texture == 0)
        return v_scale(waves_spectrum(shading->waves, &scene_blob(shading->scene)->spectra[v->spectrum - 1]),
                       v_max(c));
    return (is_coefficient(value) ? waves_coefficient : waves_reflectance)(shading->waves, c);
}

float shading_luminance(const shading_t *shading, material_value_t value)
{
    return rgb_luminance(plain_colour(shading, value));
}

float shading_number(const shading_t *shading, material_value_t value)
{
    return sane(value_at(shading, value).x, -LARGEST_VALUE);
}

rgb_t shading_root(const shading_t *shading, material_value_t value)
{
    rgb_t c = shading_colour(shading, value);
    return vec3(sqrtf(float_min(c.x, 1)), sqrtf(float_min(c.y, 1)), sqrtf(float_min(c.z, 1)));
}

rgb_t shading_absorption_index(const shading_t *shading, material_value_t eta)
{
    const blob_value_t *v = &shading->material->values[eta];
    rgb_t k = plain_colour(shading, VALUE_K), k2 = v_mul(k, k), one = {1, 1, 1};
    bool made =
        shading->waves != NULL && v->texture == 0 && v->spectrum == 0 && v_is_zero(v_sub(v->factor, one));
    if (!made) return shading_colour(shading, VALUE_K);
    rgb_t r =
        waves_reflectance(shading->waves, vec3(k2.x / (4 + k2.x), k2.y / (4 + k2.y), k2.z / (4 + k2.z)));
    const float most = 0.9999f; /* as the importer has it */
    r = v_low(r, vec3(most, most, most));
    return vec3(2 * sqrtf(r.x / (1 - r.x)), 2 * sqrtf(r.y / (1 - r.y)), 2 * sqrtf(r.z / (1 - r.z)));
}

bool shading_disperses(const shading_t *shading, material_value_t value, float iors[3])
{
    const blob_value_t *v = &shading->material->values[value];
    if (shading->waves == NULL || v->spectrum == 0 || v->texture != 0) return false;
    rgb_t c = shading_colour(shading, value);
    iors[0] = c.x, iors[1] = c.y, iors[2] = c.z;
    for (int k = 0; k < 3; k++)
        if (!(iors[k] > 1 + 2 * LOBE_LEAST_REFRACTION && iors[k] <= 100)) return false;
    return true;
}

/* n = a + b / wavelength^2; the Abbe number is (n_d - 1) / (n_F - n_C). */
static float cauchy(float ior, float dispersion, float nm)
{
    const float d = 587.56f, f = 486.13f, c = 656.27f;
    float b = (ior - 1) * dispersion / 20 / (1 / (f * f) - 1 / (c * c));
    return ior + b * (1 / (nm * nm) - 1 / (d * d));
}

void shading_spread(const shading_t *shading, float ior, float dispersion, float iors[3])
{
    float spread = (ior - 1) * 0.025f * dispersion;
    for (int k = 0; k < 3; k++) {
        float there = shading->waves != NULL ? cauchy(ior, dispersion, shading->waves->nm[k])
                                             : ior + (float)(k - 1) * spread;
        iors[k] = float_clamp(there, 1 + 2 * LOBE_LEAST_REFRACTION, 100);
    }
}

/* pbrt-v3's fit of an alpha to its older Blinn exponent (TrowbridgeReitzDistribution::RoughnessToAlpha). */
static float alpha_v3(float roughness)
{
    float x = logf(float_max(roughness, 1e-3f));
    return 1.62142f + x * (0.819955f + x * (0.1734f + x * (0.0171201f + x * 0.000640711f)));
}

static float remap(uint32_t flags, float roughness)
{
    if (flags & MATERIAL_REMAP_V3) return alpha_v3(roughness);
    if (flags & MATERIAL_REMAP_SQRT) return sqrtf(roughness);
    if (flags & MATERIAL_REMAP_SQUARE) return roughness * roughness;
    return roughness;
}

bool shading_alphas(const shading_t *shading, material_value_t u, material_value_t v, float alpha[2])
{
    enum { V3 = MATERIAL_REMAP_V3 | MATERIAL_ALPHA_V3 };
    const float largest = 10; /* beyond any sensible surface, and far from overflow */
    uint32_t flags = shading->material->flags;
    float roughness[2] = {float_max(shading_number(shading, u), 0), float_max(shading_number(shading, v), 0)};
    for (int i = 0; i < 2; i++)
        alpha[i] =
            float_clamp(remap(flags, float_min(roughness[i], 100)), flags & V3 ? 1e-3f : 1e-4f, largest);
    if (flags & V3)
        return shading->material->kind != MATERIAL_DIELECTRIC || roughness[0] != 0 || roughness[1] != 0;
    return alpha[0] >= 1e-3f || alpha[1] >= 1e-3f;
}

lobe_t *shading_add(const shading_t *shading, const lobe_kind_t *kind, rgb_t scale, float share)
{
    bsdf_t *bsdf = shading->bsdf;
    scale = v_mul(scale, shading->scale);
    float most = v_max(scale);
    if (!(most > 0) || bsdf->count == BSDF_LOBES) return NULL;
    lobe_t *lobe = &bsdf->lobes[bsdf->count++];
    /* No share may be so small that what only this lobe can draw is never drawn. */
    float chance = float_clamp(share * v_max(shading->scale), 0.01f * float_min(most, 1), 1e6f);
    *lobe = (lobe_t){.kind = kind, .scale = scale, .chance = chance};
    return lobe;
}

lobe_t *shading_add_dielectric(const shading_t *shading, const lobe_kind_t *kind, rgb_t r, rgb_t t, float ior,
                               const float alpha[2])
{
    float share = fresnel_dielectric_mean(ior), both = share * v_max(r) + (1 - share) * v_max(t);
    if (!(both > 0)) return NULL;
    lobe_t *lobe = shading_add(shading, kind, vec3(1, 1, 1), both);
    if (lobe == NULL) return NULL;
    lobe->alpha[0] = alpha[0];
    lobe->alpha[1] = alpha[1];
    lobe->dielectric.ior = ior;
    lobe->dielectric.r = r;
    lobe->dielectric.t = t;
    return lobe;
}

/* The mean reflectance is taken out of the value and into the scale, which then is about the albedo. */
lobe_t *shading_add_reflection(const shading_t *shading, rgb_t r, float ior, const float alpha[2])
{
    float mean = fresnel_dielectric_mean(ior);
    lobe_t *lobe = shading_add(shading, &lobe_rough_reflection, v_scale(r, mean), mean * v_max(r));
    if (lobe == NULL) return NULL;
    lobe->alpha[0] = alpha[0];
    lobe->alpha[1] = alpha[1];
    lobe->dielectric.ior = ior;
    lobe->dielectric.r = vec3(1 / mean, 1 / mean, 1 / mean);
    return lobe;
}

uint64_t shading_point_key(vec3_t p)
{
    uint32_t words[3];
    memcpy(words, &p, sizeof words);
    return sampler_mix_words(0, words, ARRAY_LENGTH(words));
}

void shading_delegate(const shading_t *shading, uint32_t material, rgb_t scale)
{
    shading_t part = *shading;
    part.material = &scene_blob(shading->scene)->materials[material];
    part.scale = v_mul(shading->scale, scale);
    shading->shade(&part);
}
