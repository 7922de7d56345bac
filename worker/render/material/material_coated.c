/* material_coated: pbrt-v4's layered materials: a base, diffuse or metal, below a medium and the interface of
 * a dielectric. The medium's extinction is one per unit of thickness; without an albedo it absorbs. */
#include "worker/render/material/material.h"

#include "common/sampler.h"

/* The alpha of a smooth metal where the coat is rough or the medium scatters, so that it is no specular lobe.
 * Far below the coat's, since the tails of both add up. */
#define LEAST_ALPHA 2e-3f

typedef struct {
    float ior, alpha[2], thickness, g;
    rgb_t albedo;
    rgb_t tint; /* of what the coat itself reflects */
    bool smooth;
    bool apart; /* what it reflects is a lobe of its own */
} coat_t;

static rgb_t at_most_one(rgb_t c)
{
    return vec3(float_min(c.x, 1), float_min(c.y, 1), float_min(c.z, 1));
}

static coat_t read_coat(const shading_t *shading)
{
    coat_t coat = {.ior = lobe_sane_ior(shading_number(shading, VALUE_ETA)),
                   .thickness = float_clamp(shading_number(shading, VALUE_THICKNESS), 0, 1e4f),
                   .g = float_clamp(shading_number(shading, VALUE_G), -0.99f, 0.99f),
                   .albedo = at_most_one(shading_colour(shading, VALUE_ALBEDO)),
                   .tint = {1, 1, 1}};
    bool tinted = shading->material->flags & MATERIAL_TINTED;
    if (tinted) coat.tint = shading_colour(shading, VALUE_SPECULAR);
    coat.smooth = !shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V, coat.alpha) ||
                  fabsf(coat.ior - 1) < LOBE_LEAST_REFRACTION;
    coat.apart = coat.smooth || tinted;
    if (coat.thickness == 0) coat.albedo = vec3(0, 0, 0);
    return coat;
}

/* About the albedo of what is below the coat, where the base has the reflectance `base`. */
static float mean_below(const coat_t *coat, float base, float medium)
{
    float enters = 1 - fresnel_dielectric_mean(coat->ior), back = fresnel_dielectric_mean(1 / coat->ior);
    float opacity = 1 - expf(-2 * coat->thickness);
    float reflectance = base * (1 - opacity) + 0.5f * medium * opacity;
    return enters * (1 - back) * reflectance / (1 - back * reflectance);
}

static float inverse(float x)
{
    return x > 0 ? 1 / x : 0;
}

/* Adds a lobe whose scale is about its albedo, given the reflectance of the base, and sets what all lobes of
 * layers have in common. */
static lobe_t *add_layers(const shading_t *shading, const lobe_kind_t *kind, const coat_t *coat, rgb_t base)
{
    float mirror = kind == &lobe_smooth_layers || !coat->apart ? fresnel_dielectric_mean(coat->ior) : 0;
    rgb_t albedo = vec3(mirror + mean_below(coat, base.x, coat->albedo.x),
                        mirror + mean_below(coat, base.y, coat->albedo.y),
                        mirror + mean_below(coat, base.z, coat->albedo.z));
    lobe_t *lobe = shading_add(shading, kind, albedo, v_max(albedo));
    if (lobe == NULL) return NULL;
    lobe->alpha[0] = coat->alpha[0];
    lobe->alpha[1] = coat->alpha[1];
    lobe->layered.ior = coat->ior;
    lobe->layered.thickness = coat->thickness;
    lobe->layered.g = coat->g;
    lobe->layered.smooth = coat->smooth;
    lobe->layered.reflects = !coat->apart;
    lobe->layered.seed = sampler_float((uint32_t)shading_point_key(shading->at->p));
    lobe->layered.albedo = coat->albedo;
    lobe->layered.factor = vec3(inverse(albedo.x), inverse(albedo.y), inverse(albedo.z));
    return lobe;
}

/* What the coat itself reflects; the mean goes into the scale. */
static void add_coat(const shading_t *shading, const coat_t *coat)
{
    if (coat->ior == 1) return;
    float mean = fresnel_dielectric_mean(coat->ior);
    lobe_t *lobe = shading_add(shading, coat->smooth ? &lobe_smooth_coat : &lobe_rough_coat,
                               v_scale(coat->tint, mean), mean * v_max(coat->tint));
    if (lobe == NULL) return;
    for (int i = 0; i < 2 && !coat->smooth; i++) lobe->alpha[i] = coat->alpha[i];
    lobe->dielectric.ior = coat->ior;
    lobe->dielectric.r = vec3(1 / mean, 1 / mean, 1 / mean);
}

void material_coated_diffuse(const shading_t *shading)
{
    coat_t coat = read_coat(shading);
    rgb_t reflectance = at_most_one(shading_colour(shading, VALUE_REFLECTANCE));
    bool walks = !coat.smooth || !v_is_zero(coat.albedo);
    lobe_t *lobe = add_layers(shading, walks ? &lobe_layered : &lobe_coated_lambert, &coat, reflectance);
    if (lobe != NULL) {
        lobe->layered.reflectance = reflectance;
        if (!walks) lobe->layered.returns = lobe_layered_returns(coat.ior, coat.thickness);
    }
    if (coat.apart) add_coat(shading, &coat);
}

void material_coated_conductor(const shading_t *shading)
{
    coat_t coat = read_coat(shading);
    float base_alpha[2];
    bool rough = shading_alphas(shading, VALUE_BASE_ROUGHNESS_U, VALUE_BASE_ROUGHNESS_V, base_alpha);
    /* The metal meets the coat's index. */
    rgb_t eta = v_scale(shading_colour(shading, VALUE_BASE_ETA), 1 / coat.ior);
    rgb_t k = v_scale(shading_absorption_index(shading, VALUE_BASE_ETA), 1 / coat.ior);
    bool mirror =
        coat.smooth && !rough && v_is_zero(coat.albedo) && !(shading->material->flags & MATERIAL_TINTED);
    lobe_t *lobe = add_layers(shading, mirror ? &lobe_smooth_layers : &lobe_layered, &coat,
                              fresnel_conductor(1, eta, k));
    if (lobe != NULL) {
        for (int i = 0; i < 2; i++) lobe->layered.base_alpha[i] = rough ? base_alpha[i] : LEAST_ALPHA;
        lobe->layered.metal.eta = eta;
        lobe->layered.metal.k = k;
        lobe->layered.has_metal = true;
    }
    if (coat.apart && !mirror) add_coat(shading, &coat);
}
