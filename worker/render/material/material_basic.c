/* material_basic: the materials of one lobe: diffuse, mirror, dielectric, conductor, and the diffuse
 * transmitter. */
#include "worker/render/material/material.h"

void material_diffuse(const shading_t *shading)
{
    rgb_t reflectance = shading_colour(shading, VALUE_REFLECTANCE);
    float sigma = float_clamp(shading_number(shading, VALUE_SIGMA), 0, 90) * (PI_F / 180);
    if (sigma == 0) {
        shading_add(shading, &lobe_lambert, reflectance, v_max(reflectance));
        return;
    }
    lobe_t *lobe = shading_add(shading, &lobe_oren_nayar, reflectance, v_max(reflectance));
    if (lobe == NULL) return;
    float sigma2 = sigma * sigma;
    lobe->oren_nayar.a = 1 - 0.5f * sigma2 / (sigma2 + 0.33f);
    lobe->oren_nayar.b = 0.45f * sigma2 / (sigma2 + 0.09f);
}

void material_mirror(const shading_t *shading)
{
    rgb_t reflectance = shading_colour(shading, VALUE_REFLECTANCE);
    shading_add(shading, &lobe_mirror, reflectance, v_max(reflectance));
}

void material_dielectric(const shading_t *shading)
{
    float alpha[2], ior = lobe_sane_ior(shading_number(shading, VALUE_ETA));
    rgb_t r = shading_colour(shading, VALUE_REFLECTANCE), t = shading_colour(shading, VALUE_TRANSMITTANCE);
    bool rough = shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V, alpha);
    if (shading->material->flags & MATERIAL_TINTED_BODY) t = v_mul(t, shading_root(shading, VALUE_ALBEDO));
    float iors[3];
    if (shading->material->flags & MATERIAL_THIN) {
        shading_add_dielectric(shading, &lobe_pane, r, t, ior, alpha);
        return;
    }
    if (shading_disperses(shading, VALUE_ETA, iors)) {
        const lobe_kind_t *kind = rough ? &lobe_rough_dispersion : &lobe_smooth_dispersion;
        lobe_t *lobe = shading_add_dielectric(shading, kind, r, t, ior, alpha);
        for (int k = 0; k < 3 && lobe != NULL; k++) lobe->dielectric.iors[k] = iors[k];
        return;
    }
    if (rough && fabsf(ior - 1) >= LOBE_LEAST_REFRACTION)
        shading_add_dielectric(shading, &lobe_rough_dielectric, r, t, ior, alpha);
    else
        shading_add_dielectric(shading, &lobe_smooth_dielectric, r, t, ior, alpha);
}

void material_conductor(const shading_t *shading)
{
    float alpha[2];
    rgb_t reflectance = shading_colour(shading, VALUE_REFLECTANCE), eta = shading_colour(shading, VALUE_ETA),
          k = shading_absorption_index(shading, VALUE_ETA);
    bool rough = shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V, alpha);
    lobe_t *lobe = shading_add(shading, rough ? &lobe_rough_conductor : &lobe_smooth_conductor, reflectance,
                               v_max(v_mul(reflectance, fresnel_conductor(1, eta, k))));
    if (lobe == NULL) return;
    lobe->alpha[0] = alpha[0];
    lobe->alpha[1] = alpha[1];
    lobe->conductor.eta = eta;
    lobe->conductor.k = k;
}

void material_diffuse_transmission(const shading_t *shading)
{
    rgb_t r = shading_colour(shading, VALUE_REFLECTANCE), t = shading_colour(shading, VALUE_TRANSMITTANCE);
    shading_add(shading, &lobe_lambert, r, v_max(r));
    shading_add(shading, &lobe_lambert_transmission, t, v_max(t));
}
