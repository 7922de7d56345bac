/* lobe_specular: Dirac lobes: the mirror, smooth metal, the smooth interface of a dielectric, the pane, and
 * the way straight through. A lobe that may reflect or transmit chooses with a probability that is the same
 * from both ends of the path, so its reverse probability equals the forward one. */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/bsdf/film.h"

static void set_mirrored(vec3_t wo, rgb_t weight, float probability, bsdf_sample_t *s)
{
    *s = (bsdf_sample_t){.wi = vec3(-wo.x, -wo.y, wo.z),
                         .weight = weight,
                         .pdf = probability,
                         .pdf_rev = probability,
                         .specular = true};
}

static bool sample_mirror(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                          bsdf_sample_t *s)
{
    (void)lobe, (void)u, (void)choice, (void)mode;
    set_mirrored(wo, vec3(1, 1, 1), 1, s);
    return true;
}

/* A perfect mirror is a metal whose Fresnel reflectance is one at every angle: eta = 0. */
static void regularize_mirror(lobe_t *lobe)
{
    lobe->kind = &lobe_rough_conductor;
    lobe->conductor.eta = vec3(0, 0, 0);
    lobe->conductor.k = vec3(1, 1, 1);
    lobe->alpha[0] = lobe->alpha[1] = 0;
    lobe_rough_conductor.regularize(lobe);
}

static bool sample_conductor(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                             bsdf_sample_t *s)
{
    (void)u, (void)choice, (void)mode;
    set_mirrored(wo, fresnel_conductor(fabsf(wo.z), lobe->conductor.eta, lobe->conductor.k), 1, s);
    return true;
}

static void regularize_conductor(lobe_t *lobe)
{
    lobe->kind = &lobe_rough_conductor;
    lobe->alpha[0] = lobe->alpha[1] = 0;
    lobe_rough_conductor.regularize(lobe);
}

static bool sample_dielectric(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                              bsdf_sample_t *s)
{
    (void)u;
    rgb_t r = lobe->dielectric.r, t = lobe->dielectric.t;
    float eta = lobe_relative_index(lobe, wo), cos_t;
    float f = fresnel_dielectric(fabsf(wo.z), eta, &cos_t), chance;
    film_on_interface(&lobe->dielectric, wo.z > 0 ? wo.z : cos_t, f, &r, &t);
    if (!lobe_reflect_chance(f, r, t, &chance)) return false;
    if (choice < chance) {
        set_mirrored(wo, v_scale(r, f / chance), chance, s);
        return true;
    }
    /* Radiance is compressed into the smaller cone: scaled by (index near / index far)^2 on the way that an
     * eye subpath goes (Veach 1997, equation 5.12); importance is not. */
    float scale = (1 - f) / (1 - chance) * (mode == TRANSPORT_RADIANCE ? 1 / (eta * eta) : 1);
    *s = (bsdf_sample_t){.wi = vec3(-wo.x / eta, -wo.y / eta, wo.z > 0 ? -cos_t : cos_t),
                         .weight = v_scale(t, scale),
                         .pdf = 1 - chance,
                         .pdf_rev = 1 - chance,
                         .specular = true};
    return cos_t > 0;
}

static void regularize_dielectric(lobe_t *lobe)
{
    if (fabsf(lobe->dielectric.ior - 1) < LOBE_LEAST_REFRACTION) return;
    lobe->kind = &lobe_rough_dielectric;
    lobe->alpha[0] = lobe->alpha[1] = 0;
    lobe_rough_dielectric.regularize(lobe);
}

/* Light goes back and forth between the two faces of a pane: R' = R + T R T + T R R R T + ... (Stokes 1862),
 * T' = 1 - R', and leaves straight on. The index is that of the pane, from either side. */
static bool sample_pane(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                        bsdf_sample_t *s)
{
    (void)u, (void)mode;
    rgb_t r = lobe->dielectric.r, t = lobe->dielectric.t;
    float cos_t, f = fresnel_dielectric(fabsf(wo.z), lobe->dielectric.ior, &cos_t), chance;
    if (f < 1) f += (1 - f) * (1 - f) * f / (1 - f * f);
    if (!lobe_reflect_chance(f, r, t, &chance)) return false;
    if (choice < chance) {
        set_mirrored(wo, v_scale(r, f / chance), chance, s);
        return true;
    }
    *s = (bsdf_sample_t){.wi = v_neg(wo),
                         .weight = v_scale(t, (1 - f) / (1 - chance)),
                         .pdf = 1 - chance,
                         .pdf_rev = 1 - chance,
                         .specular = true};
    return true;
}

static bool sample_straight(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                            bsdf_sample_t *s)
{
    (void)lobe, (void)u, (void)choice, (void)mode;
    *s = (bsdf_sample_t){.wi = v_neg(wo), .weight = {1, 1, 1}, .pdf = 1, .pdf_rev = 1, .specular = true};
    return true;
}

enum { BOTH = LOBE_REFLECTS | LOBE_TRANSMITS | LOBE_SPECULAR };
const lobe_kind_t lobe_mirror = {
    .flags = LOBE_REFLECTS | LOBE_SPECULAR, .sample = sample_mirror, .regularize = regularize_mirror};
const lobe_kind_t lobe_smooth_conductor = {
    .flags = LOBE_REFLECTS | LOBE_SPECULAR, .sample = sample_conductor, .regularize = regularize_conductor};
const lobe_kind_t lobe_smooth_dielectric = {
    .flags = BOTH | LOBE_REFRACTS, .sample = sample_dielectric, .regularize = regularize_dielectric};
const lobe_kind_t lobe_pane = {.flags = BOTH, .sample = sample_pane};
const lobe_kind_t lobe_straight = {.flags = LOBE_TRANSMITS | LOBE_SPECULAR, .sample = sample_straight};
