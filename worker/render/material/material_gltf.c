/* material_gltf: glTF 2.0's metallic-roughness material (appendix B) with KHR_materials_specular, ior,
 * anisotropy, clearcoat, sheen, iridescence, transmission, diffuse transmission, volume and dispersion. Metal
 * and dielectric have the same distribution of normals, so that one reflection serves both, with the mixture
 * of their reflectances. What transmits as a solid is a dielectric interface of its own, which reflects by
 * Fresnel's equations from both sides. */
#include "worker/render/material/material.h"

#include "worker/render/bsdf/film.h"

typedef struct {
    float alpha[2];
    bool smooth;
    lobe_cover_t cover;
    lobe_film_t film;
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

/* Draws the highlight out along s, whose direction is that of shading_frame.c. */
static void add_anisotropy(const shading_t *shading, surface_finish_t *finish)
{
    float strength = unit(shading, VALUE_ANISOTROPIC);
    finish->alpha[0] += (1 - finish->alpha[0]) * strength * strength;
    finish->smooth = finish->smooth && finish->alpha[0] < 1e-3f;
}

static void set_finish(lobe_t *lobe, const surface_finish_t *finish)
{
    lobe->alpha[0] = finish->alpha[0];
    lobe->alpha[1] = finish->alpha[1];
    lobe->schlick.cover = finish->cover;
    lobe->schlick.film = finish->film;
}

/* Schlick's reflectance weighed by the cosine; about that of a film, and not so little of it that one angle
 * would speak for all. */
static rgb_t mean_reflectance(rgb_t f0, rgb_t f90, const lobe_film_t *film)
{
    rgb_t mean = v_mad(v_scale(f0, 20 / 21.0f), 1 / 21.0f, f90);
    if (film->strength == 0) return mean;
    mean = film_cover(film, f0, mean, 2 / 3.0f);
    return vec3(float_max(mean.x, 0.02f), float_max(mean.y, 0.02f), float_max(mean.z, 0.02f));
}

static lobe_film_t read_film(const shading_t *shading)
{
    float strength = unit(shading, VALUE_IRIDESCENCE);
    if (strength == 0) return (lobe_film_t){.strength = 0};
    lobe_film_t film = {.strength = strength,
                        .ior = float_clamp(shading_number(shading, VALUE_IRIDESCENCE_ETA), 1, 100),
                        .thickness = float_max(shading_number(shading, VALUE_IRIDESCENCE_THICKNESS), 0)};
    for (int k = 0; k < WAVES && shading->waves != NULL; k++)
        film.waves[k] = (uint16_t)(shading->waves->nm[k] * FILM_PART);
    return film;
}

/* The mean goes into the scale, which then is about the albedo. */
static void add_reflection(const shading_t *shading, const lobe_kind_t *kind, rgb_t f0, rgb_t f90,
                           float weight, const surface_finish_t *finish)
{
    rgb_t mean = mean_reflectance(f0, f90, &finish->film),
          factor = vec3(inverse(mean.x), inverse(mean.y), inverse(mean.z));
    rgb_t scale = v_scale(mean, weight);
    lobe_t *lobe = shading_add(shading, kind, scale, v_max(scale));
    if (lobe == NULL) return;
    set_finish(lobe, finish);
    /* Of a film the factor stays apart, since f0 also says which index is below it. */
    bool film = finish->film.strength != 0;
    lobe->schlick.f0 = film ? f0 : v_mul(f0, factor);
    lobe->schlick.f90 = film ? f90 : v_mul(f90, factor);
    if (film) lobe->schlick.gain = factor;
}

/* The dielectric's reflection of weight `dielectric`, and the metal's. */
static void add_gloss(const shading_t *shading, rgb_t f0, rgb_t f90, rgb_t colour, float dielectric,
                      float metallic, const surface_finish_t *finish)
{
    const lobe_kind_t *kind = finish->smooth ? &lobe_schlick_mirror : &lobe_schlick_reflection;
    rgb_t white = {1, 1, 1};
    if (finish->film.strength == 0) {
        add_reflection(shading, kind, v_mad(v_scale(f0, dielectric), metallic, colour),
                       v_mad(v_scale(f90, dielectric), metallic, white), 1, finish);
        return;
    }
    /* The reflectance of a film on a mixture is not the mixture of two. */
    add_reflection(shading, kind, f0, f90, dielectric, finish);
    add_reflection(shading, kind, colour, white, metallic, finish);
}

/* What a reflectance leaves to a part of the given colour. */
static void add_rest(const shading_t *shading, const lobe_kind_t *kind, rgb_t colour, rgb_t f0, rgb_t f90,
                     const surface_finish_t *finish)
{
    float left = 1 - v_max(mean_reflectance(f0, f90, &finish->film));
    if (!(left > 1e-4f)) return;
    rgb_t scale = v_scale(colour, left);
    lobe_t *lobe = shading_add(shading, kind, scale, v_max(scale));
    if (lobe == NULL) return;
    set_finish(lobe, finish);
    lobe->schlick.f0 = f0;
    lobe->schlick.f90 = f90;
    lobe->schlick.factor = 1 / left;
}

/* What is absorbed so that white light has the given colour after the given way, at each wavelength. */
static rgb_t absorption_of_colour(const shading_t *shading)
{
    rgb_t a = shading->material->values[VALUE_ATTENUATION].factor;
    float d = shading->material->values[VALUE_THICKNESS].factor.x;
    rgb_t left = waves_reflectance(shading->waves, vec3(expf(-a.x * d), expf(-a.y * d), expf(-a.z * d)));
    const float least = 1e-6f;
    return vec3(-logf(float_clamp(left.x, least, 1)) / d, -logf(float_clamp(left.y, least, 1)) / d,
                -logf(float_clamp(left.z, least, 1)) / d);
}

/* Of a body that light enters. */
static void add_absorption(const shading_t *shading)
{
    bool spectral = shading->waves != NULL && shading->material->values[VALUE_THICKNESS].factor.x > 0;
    shading->bsdf->attenuation =
        spectral ? absorption_of_colour(shading) : shading_colour(shading, VALUE_ATTENUATION);
    shading->bsdf->absorbs = !v_is_zero(shading->bsdf->attenuation);
}

/* Of the given weight; the cover leaves its mean to it. */
static void add_solid(const shading_t *shading, rgb_t colour, rgb_t tint, float weight, float ior,
                      const surface_finish_t *finish)
{
    bool rough = !finish->smooth && fabsf(ior - 1) >= LOBE_LEAST_REFRACTION;
    float left = weight * lobe_cover_mean(&finish->cover);
    if (left == 0) return;
    /* A film has one phase for all channels, and stays on an interface that does not disperse. */
    float dispersion = finish->film.strength == 0 ? shading_number(shading, VALUE_DISPERSION) : 0;
    bool disperses = dispersion > 0 && ior > 1 + 2 * LOBE_LEAST_REFRACTION;
    const lobe_kind_t *kind = disperses ? rough ? &lobe_rough_dispersion : &lobe_smooth_dispersion
                              : rough   ? &lobe_rough_dielectric
                                        : &lobe_smooth_dielectric;
    lobe_t *lobe =
        shading_add_dielectric(shading, kind, v_scale(tint, left), v_scale(colour, left), ior, finish->alpha);
    add_absorption(shading);
    if (lobe == NULL) return;
    if (disperses) shading_spread(shading, ior, dispersion, lobe->dielectric.iors);
    lobe->dielectric.film = finish->film;
    lobe->dielectric.film_f0 = (ior - 1) / (ior + 1) * ((ior - 1) / (ior + 1));
}

/* The base reflects and transmits as Lambert's law has it; `share` is what other transmission leaves to it.
 */
static void add_diffuse(const shading_t *shading, rgb_t base, float share, rgb_t f0, rgb_t f90,
                        const surface_finish_t *finish)
{
    float through = unit(shading, VALUE_DIFFUSE_TRANSMISSION);
    add_rest(shading, &lobe_schlick_diffuse, v_scale(base, share * (1 - through)), f0, f90, finish);
    if (through == 0) return;
    rgb_t colour = at_most_one(shading_colour(shading, VALUE_TRANSMITTANCE));
    share *= (1 - unit(shading, VALUE_METALLIC)) * through;
    add_rest(shading, &lobe_schlick_diffuse_through, v_scale(colour, share), f0, f90, finish);
    if (share > 0 && !(shading->material->flags & MATERIAL_THIN)) add_absorption(shading);
}

/* On all but the coat. */
static void add_sheen(const shading_t *shading, rgb_t colour, const lobe_cover_t *cover)
{
    float roughness = cover->sheen_roughness, mean = lobe_sheen_mean(roughness);
    rgb_t scale = v_scale(colour, mean);
    lobe_t *lobe = shading_add(shading, &lobe_sheen, scale, v_max(scale));
    if (lobe == NULL) return;
    lobe->sheen =
        (lobe_sheen_t){{.coat = cover->coat, .coat_normal = cover->coat_normal}, roughness, 1 / mean};
}

static void add_clearcoat(const shading_t *shading, float weight)
{
    surface_finish_t finish = {.cover = {.coat_normal = shading->coat_normal}};
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
    rgb_t sheen = at_most_one(shading_colour(shading, VALUE_SHEEN_COLOUR));
    surface_finish_t finish = {.film = read_film(shading),
                               .cover = {.coat = unit(shading, VALUE_CLEARCOAT),
                                         .coat_normal = shading->coat_normal,
                                         .sheen = v_max(sheen)}};
    finish.cover.sheen_roughness = lobe_sheen_roughness(shading_number(shading, VALUE_SHEEN_ROUGHNESS));
    finish.smooth = !shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_U, finish.alpha);
    if (shading->material->values[VALUE_ANISOTROPIC].factor.x != 0) add_anisotropy(shading, &finish);

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
    add_gloss(shading, f0, f90, colour, dielectric, metallic, &finish);
    add_diffuse(shading, base, 1 - transmission, f0, f90, &finish);
    if (thin)
        add_rest(shading, finish.smooth ? &lobe_schlick_straight : &lobe_schlick_through,
                 v_scale(base, transmission), f0, f90, &finish);
    else
        add_solid(shading, colour, at_most_one(v_scale(tint, specular)), (1 - metallic) * transmission,
                  lobe_sane_ior(ior), &finish);
    if (finish.cover.sheen > 0) add_sheen(shading, sheen, &finish.cover);
    if (finish.cover.coat > 0) add_clearcoat(shading, finish.cover.coat);
}
