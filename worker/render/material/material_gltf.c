/* material_gltf: glTF 2.0's metallic-roughness material (appendix B) with KHR_materials_specular, ior,
 * clearcoat, transmission and volume. Metal and dielectric have the same distribution of normals, so that one
 * reflection serves both, with the mixture of their reflectances. What transmits as a solid is a dielectric
 * interface of its own, which reflects by Fresnel's equations from both sides. */
#include "worker/render/material/material.h"

typedef struct {
    float alpha[2];
    bool smooth;
    float coat;
    vec3_t coat_normal;
} surface_finish_t;

static float unit(const shading_t *shading, material_value_t value)
{
    return float_clamp(shading_number(shading, value), 0, 1);
}

static rgb_t at_most_one(rgb_t c)
{
    return vec3(float_min(c.x, 1), float_min(c.y, 1), float_min(c.z, 1));
}

static float inverse(float x)
{
    return x > 0 ? 1 / x : 0;
}

static void set_finish(lobe_t *lobe, const surface_finish_t *finish)
{
    lobe->alpha[0] = finish->alpha[0];
    lobe->alpha[1] = finish->alpha[1];
    lobe->schlick.coat = finish->coat;
    lobe->schlick.coat_normal = finish->coat_normal;
}

/* Schlick's reflectance weighed by the cosine. */
static rgb_t mean_reflectance(rgb_t f0, rgb_t f90)
{
    return v_mad(v_scale(f0, 20 / 21.0f), 1 / 21.0f, f90);
}

/* The mean goes into the scale, which then is about the albedo. */
static void add_reflection(const shading_t *shading, const lobe_kind_t *kind, rgb_t f0, rgb_t f90,
                           float weight, const surface_finish_t *finish)
{
    rgb_t mean = mean_reflectance(f0, f90), factor = vec3(inverse(mean.x), inverse(mean.y), inverse(mean.z));
    rgb_t scale = v_scale(mean, weight);
    lobe_t *lobe = shading_add(shading, kind, scale, v_max(scale));
    if (lobe == NULL) return;
    set_finish(lobe, finish);
    lobe->schlick.f0 = v_mul(f0, factor);
    lobe->schlick.f90 = v_mul(f90, factor);
}

/* What a reflectance leaves to a part of the given colour. */
static void add_rest(const shading_t *shading, const lobe_kind_t *kind, rgb_t colour, rgb_t f0, rgb_t f90,
                     const surface_finish_t *finish)
{
    float left = 1 - v_max(mean_reflectance(f0, f90));
    if (!(left > 1e-4f)) return;
    rgb_t scale = v_scale(colour, left);
    lobe_t *lobe = shading_add(shading, kind, scale, v_max(scale));
    if (lobe == NULL) return;
    set_finish(lobe, finish);
    lobe->schlick.f0 = f0;
    lobe->schlick.f90 = f90;
    lobe->schlick.factor = 1 / left;
}

/* Of the given weight; the coat leaves its mean to it. */
static void add_solid(const shading_t *shading, rgb_t colour, rgb_t tint, float weight, float ior,
                      const surface_finish_t *finish)
{
    bool rough = !finish->smooth && fabsf(ior - 1) >= LOBE_LEAST_REFRACTION;
    float left = weight * (1 - finish->coat * (SCHLICK_COAT_F0 + (1 - SCHLICK_COAT_F0) / 21));
    if (left == 0) return;
    shading_add_dielectric(shading, rough ? &lobe_rough_dielectric : &lobe_smooth_dielectric,
                           v_scale(tint, left), v_scale(colour, left), ior, finish->alpha);
    shading->bsdf->attenuation = shading_colour(shading, VALUE_ATTENUATION);
    shading->bsdf->absorbs = !v_is_zero(shading->bsdf->attenuation);
}

static void add_clearcoat(const shading_t *shading, float weight)
{
    surface_finish_t finish = {.coat = 0, .coat_normal = shading->coat_normal};
    rgb_t white = {1, 1, 1};
    bool own = shading->material->flags & MATERIAL_COAT_NORMAL;
    finish.smooth =
        !shading_alphas(shading, VALUE_CLEARCOAT_ROUGHNESS, VALUE_CLEARCOAT_ROUGHNESS, finish.alpha);
    const lobe_kind_t *kind = own             ? finish.smooth ? &lobe_schlick_coat_mirror : &lobe_schlick_coat
                              : finish.smooth ? &lobe_schlick_mirror
                                              : &lobe_schlick_reflection;
    add_reflection(shading, kind, v_scale(white, SCHLICK_COAT_F0), white, weight, &finish);
}

void material_gltf(const shading_t *shading)
{
    rgb_t colour = at_most_one(shading_colour(shading, VALUE_REFLECTANCE));
    rgb_t tint = shading_colour(shading, VALUE_SPECULAR_COLOUR);
    float metallic = unit(shading, VALUE_METALLIC), transmission = unit(shading, VALUE_TRANSMISSION);
    float specular = unit(shading, VALUE_SPECULAR), ior = float_max(shading_number(shading, VALUE_ETA), 0);
    bool thin = shading->material->flags & MATERIAL_THIN;
    surface_finish_t finish = {.coat = unit(shading, VALUE_CLEARCOAT), .coat_normal = shading->coat_normal};
    finish.smooth = !shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_U, finish.alpha);

    /* An index of 0 stands for complete reflection, as the standard has it. A reflectance below that of any
     * liquid or solid (2 %) fades out at grazing angles as well, where the standard would leave a white rim:
     * black means no reflection at all (Lagarde and de Rousiers 2014, "Moving Frostbite to PBR", section
     * 3.1). */
    float normal = (float_min(ior, 1e3f) - 1) / (float_min(ior, 1e3f) + 1);
    rgb_t f0 = at_most_one(v_scale(tint, normal * normal)), white = {1, 1, 1};
    float grazing = float_min(1, 50 * v_max(f0));
    rgb_t f90 = v_scale(white, specular * grazing);
    f0 = v_scale(f0, specular);

    float solid = thin ? 0 : transmission, dielectric = (1 - metallic) * (1 - solid);
    rgb_t base = v_scale(colour, 1 - metallic);
    add_reflection(shading, finish.smooth ? &lobe_schlick_mirror : &lobe_schlick_reflection,
                   v_mad(v_scale(f0, dielectric), metallic, colour),
                   v_mad(v_scale(f90, dielectric), metallic, white), 1, &finish);
    add_rest(shading, &lobe_schlick_diffuse, v_scale(base, 1 - transmission), f0, f90, &finish);
    if (thin)
        add_rest(shading, finish.smooth ? &lobe_schlick_straight : &lobe_schlick_through,
                 v_scale(base, transmission), f0, f90, &finish);
    else
        add_solid(shading, colour, at_most_one(v_scale(tint, specular)), (1 - metallic) * transmission,
                  lobe_sane_ior(ior), &finish);
    if (finish.coat > 0) add_clearcoat(shading, finish.coat);
}
