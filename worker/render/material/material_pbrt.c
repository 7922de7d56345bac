/* material_pbrt: pbrt-v3's sums of lobes: plastic, uber, substrate, translucent, and the mix. */
#include "worker/render/material/material.h"

static rgb_t rest(rgb_t c)
{
    return vec3(float_max(0, 1 - c.x), float_max(0, 1 - c.y), float_max(0, 1 - c.z));
}

void material_plastic(const shading_t *shading)
{
    float alpha[2];
    rgb_t diffuse = shading_colour(shading, VALUE_REFLECTANCE);
    shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V, alpha);
    shading_add(shading, &lobe_lambert, diffuse, v_max(diffuse));
    /* pbrt-v3's plastic has its indices the wrong way round: it reflects like the surface of a solid of index
     * 1.5 seen from inside. Its pictures are what its users expect. */
    shading_add_reflection(shading, shading_colour(shading, VALUE_SPECULAR), 1 / 1.5f, alpha);
}

void material_uber(const shading_t *shading)
{
    float alpha[2], ior = lobe_sane_ior(shading_number(shading, VALUE_ETA));
    rgb_t opacity = shading_colour(shading, VALUE_OPACITY), through = rest(opacity);
    rgb_t diffuse = v_mul(opacity, shading_colour(shading, VALUE_REFLECTANCE));
    shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V, alpha);
    shading_add(shading, &lobe_straight, through, v_max(through));
    shading_add(shading, &lobe_lambert, diffuse, v_max(diffuse));
    shading_add_reflection(shading, v_mul(opacity, shading_colour(shading, VALUE_SPECULAR)), ior, alpha);
    const float smooth[2] = {0, 0};
    shading_add_dielectric(shading, &lobe_smooth_dielectric,
                           v_mul(opacity, shading_colour(shading, VALUE_MIRROR)),
                           v_mul(opacity, shading_colour(shading, VALUE_TRANSMITTANCE)), ior, smooth);
}

void material_substrate(const shading_t *shading)
{
    float alpha[2];
    rgb_t diffuse = shading_colour(shading, VALUE_REFLECTANCE),
          glossy = shading_colour(shading, VALUE_SPECULAR);
    if (v_is_zero(diffuse) && v_is_zero(glossy)) return;
    glossy = vec3(float_min(glossy.x, 1), float_min(glossy.y, 1), float_min(glossy.z, 1));
    /* Schlick's reflectance has the mean glossy + (1 - glossy) / 21. */
    rgb_t passed = rest(glossy), mean = v_mad(glossy, 1 / 21.0f, passed);
    rgb_t albedo = v_add(mean, v_mul(diffuse, passed));
    shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V, alpha);
    lobe_t *lobe = shading_add(shading, &lobe_fresnel_blend, albedo, v_max(albedo));
    if (lobe == NULL) return;
    lobe->alpha[0] = alpha[0];
    lobe->alpha[1] = alpha[1];
    lobe->blend.diffuse = diffuse;
    lobe->blend.glossy = glossy;
    lobe->blend.factor = vec3(1 / albedo.x, 1 / albedo.y, 1 / albedo.z);
}

void material_translucent(const shading_t *shading)
{
    float alpha[2];
    rgb_t reflect = shading_colour(shading, VALUE_REFLECT),
          transmit = shading_colour(shading, VALUE_TRANSMIT);
    rgb_t diffuse = shading_colour(shading, VALUE_REFLECTANCE),
          glossy = shading_colour(shading, VALUE_SPECULAR);
    rgb_t back = v_mul(reflect, diffuse), through = v_mul(transmit, diffuse);
    shading_alphas(shading, VALUE_ROUGHNESS_U, VALUE_ROUGHNESS_V, alpha);
    shading_add(shading, &lobe_lambert, back, v_max(back));
    shading_add(shading, &lobe_lambert_transmission, through, v_max(through));
    shading_add_dielectric(shading, &lobe_rough_dielectric, v_mul(reflect, glossy), v_mul(transmit, glossy),
                           1.5f, alpha);
}

void material_mix(const shading_t *shading)
{
    rgb_t amount = shading_colour(shading, VALUE_AMOUNT);
    const uint32_t *parts = shading->material->parts;
    rgb_t first = rest(amount);
    if (!v_is_zero(first)) shading_delegate(shading, parts[0], first);
    if (!v_is_zero(amount)) shading_delegate(shading, parts[1], amount);
}
