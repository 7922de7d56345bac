/* material_disney: Disney's principled BSDF as pbrt-v3 defines it. Over a body that scatters light below the
 * surface it has the interface of a dielectric, of the same roughness, in the place of what is diffuse. */
#include "worker/render/material/material.h"

static float unit(const shading_t *shading, material_value_t value)
{
    return float_clamp(shading_number(shading, value), 0, 1);
}

static rgb_t mix(float amount, rgb_t a, rgb_t b)
{
    return v_mad(v_scale(a, 1 - amount), amount, b);
}

static rgb_t tint_of(const shading_t *shading, rgb_t colour)
{
    float luminance = shading_luminance(shading, VALUE_REFLECTANCE);
    return luminance > 0 ? v_scale(colour, 1 / luminance) : vec3(1, 1, 1);
}

static void add_diffuse(const shading_t *shading, rgb_t colour, float weight, float transmitted)
{
    float flatness = 0, kept = 1, roughness = unit(shading, VALUE_ROUGHNESS_U);
    if (shading->material->flags & MATERIAL_THIN) {
        flatness = unit(shading, VALUE_FLATNESS);
        kept = 1 - transmitted;
    }
    lobe_t *lobe = shading_add(shading, &lobe_disney_diffuse, v_scale(colour, weight),
                               weight * (kept + 0.1f) * v_max(colour));
    if (lobe != NULL) {
        lobe->disney_diffuse.base = (1 - flatness) * kept;
        lobe->disney_diffuse.flat = flatness * kept;
        lobe->disney_diffuse.retro = 1;
        lobe->disney_diffuse.roughness = roughness;
    }
}

static void add_sheen(const shading_t *shading, rgb_t colour, float weight)
{
    float amount = float_max(shading_number(shading, VALUE_SHEEN), 0);
    if (amount == 0) return;
    rgb_t sheen = v_scale(mix(unit(shading, VALUE_SHEEN_TINT), vec3(1, 1, 1), tint_of(shading, colour)),
                          weight * amount);
    shading_add(shading, &lobe_disney_sheen, sheen, 0.1f * v_max(sheen));
}

/* Alphas of the Trowbridge-Reitz distribution; roughness is squared, and anisotropy draws it out along u. */
static void set_alphas(const shading_t *shading, float roughness, float alpha[2])
{
    float aspect = sqrtf(1 - 0.9f * unit(shading, VALUE_ANISOTROPIC)), alpha0 = roughness * roughness;
    alpha[0] = float_max(1e-3f, alpha0 / aspect);
    alpha[1] = float_max(1e-3f, alpha0 * aspect);
}

/* `weight`: of all of it. */
static void add_specular(const shading_t *shading, rgb_t colour, float metallic, float weight, float ior,
                         const float alpha[2])
{
    float mean = fresnel_dielectric_mean(ior), normal = (ior - 1) / (ior + 1);
    /* About the albedo, and never black, since what a black metal reflects at grazing angles is white. */
    rgb_t albedo = mix(metallic, vec3(mean, mean, mean), colour);
    albedo = vec3(float_max(albedo.x, 0.01f), float_max(albedo.y, 0.01f), float_max(albedo.z, 0.01f));
    lobe_t *lobe =
        shading_add(shading, &lobe_disney_specular, v_scale(albedo, weight), weight * v_max(albedo));
    if (lobe == NULL) return;
    lobe->disney_specular.factor = vec3(1 / albedo.x, 1 / albedo.y, 1 / albedo.z);
    rgb_t tinted = mix(unit(shading, VALUE_SPECULAR_TINT), vec3(1, 1, 1), tint_of(shading, colour));
    lobe->alpha[0] = alpha[0];
    lobe->alpha[1] = alpha[1];
    lobe->disney_specular.ior = ior;
    lobe->disney_specular.metallic = metallic;
    lobe->disney_specular.r0 = mix(metallic, v_scale(tinted, normal * normal), colour);
}

static void add_clearcoat(const shading_t *shading)
{
    float coat = float_max(shading_number(shading, VALUE_CLEARCOAT), 0);
    lobe_t *lobe = shading_add(shading, &lobe_disney_clearcoat, vec3(coat, coat, coat), 0.05f * coat);
    if (lobe == NULL) return;
    lobe->disney_coat.alpha = 0.1f - 0.099f * unit(shading, VALUE_CLEARCOAT_GLOSS);
}

static void add_transmission(const shading_t *shading, rgb_t colour, float amount, float ior,
                             const float alpha[2])
{
    rgb_t root = vec3(sqrtf(colour.x), sqrtf(colour.y), sqrtf(colour.z)), black = {0, 0, 0};
    bool thin = shading->material->flags & MATERIAL_THIN;
    float roughness[2] = {alpha[0], alpha[1]};
    /* A thin sheet blurs what passes through it the less the less it refracts (Burley 2015, figure 15). */
    if (thin) set_alphas(shading, (0.65f * ior - 0.35f) * unit(shading, VALUE_ROUGHNESS_U), roughness);
    rgb_t factor = v_scale(root, amount);
    if (fabsf(ior - 1) < LOBE_LEAST_REFRACTION) {
        shading_add(shading, &lobe_straight, factor, v_max(factor));
        return;
    }
    lobe_t *lobe = shading_add_dielectric(shading, &lobe_rough_transmission, black, factor, ior, roughness);
    if (lobe == NULL) return;
    lobe->dielectric.separable = !thin;
}

/* What light enters a body through, and comes out again. What it reflects is that of a dielectric. */
static void add_interface(const shading_t *shading, float weight, float ior, const float alpha[2])
{
    bool smooth = fabsf(ior - 1) < LOBE_LEAST_REFRACTION;
    shading_add_dielectric(shading, smooth ? &lobe_smooth_dielectric : &lobe_rough_dielectric,
                           vec3(weight, weight, weight), v_scale(shading_root(shading, VALUE_ALBEDO), weight),
                           ior, alpha);
}

void material_disney(const shading_t *shading)
{
    rgb_t colour = shading_colour(shading, VALUE_REFLECTANCE);
    float metallic = unit(shading, VALUE_METALLIC), transmission = unit(shading, VALUE_TRANSMISSION);
    float ior = lobe_sane_ior(shading_number(shading, VALUE_ETA)), alpha[2];
    float weight = (1 - metallic) * (1 - transmission);
    /* pbrt-v3's 0 reflects all and 2 transmits all. */
    float transmitted = float_clamp(0.5f * shading_number(shading, VALUE_DIFFUSE_TRANSMISSION), 0, 1);
    set_alphas(shading, unit(shading, VALUE_ROUGHNESS_U), alpha);
    if (shading->material->flags & MATERIAL_TINTED_BODY) {
        add_interface(shading, 1 - metallic, ior, alpha);
        add_sheen(shading, colour, weight);
        add_specular(shading, colour, 1, metallic, ior, alpha);
        add_clearcoat(shading);
        return;
    }
    add_diffuse(shading, colour, weight, transmitted);
    add_sheen(shading, colour, weight);
    add_specular(shading, colour, metallic, 1, ior, alpha);
    add_clearcoat(shading);
    add_transmission(shading, colour, transmission, ior, alpha);
    if (shading->material->flags & MATERIAL_THIN) {
        rgb_t through = v_scale(colour, transmitted);
        shading_add(shading, &lobe_lambert_transmission, through, v_max(through));
    }
}
