/* lobe_blend: a glossy coat over a diffuse base, after Ashikhmin and Shirley 2000, "An Anisotropic Phong BRDF
 * Model", with the Trowbridge-Reitz distribution in place of Phong's as in pbrt. Numbers: both colours; no
 * shadowing. Half of the directions are drawn by the cosine and half about visible normals. */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/bsdf/microfacet.h"
#include "worker/render/sampling/warp.h"

static float fifth_power(float x)
{
    float x2 = x * x;
    return x2 * x2 * x;
}

/* For wo above the surface. The value does not ask where wi is with respect to the shading normal. */
static bool eval_above(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    float ax = lobe->alpha[0], ay = lobe->alpha[1];
    rgb_t diffuse = lobe->blend.diffuse, glossy = lobe->blend.glossy;
    float co = wo.z, ci = fabsf(wi.z);
    vec3_t m = v_add(wo, wi);
    float length2 = v_length2(m);
    if (!(length2 > 0) || !(co > 0 && ci > 0)) return false;
    m = v_scale(m, 1 / sqrtf(length2));
    float cos = v_dot(wo, m), d = microfacet_distribution(ax, ay, m), grazing = fresnel_schlick_weight(cos);
    if (!(cos > 0)) return false;
    float base = 28 / (23 * PI_F) * (1 - fifth_power(1 - 0.5f * ci)) * (1 - fifth_power(1 - 0.5f * co));
    float coat = d / (4 * cos * float_max(co, ci));
    rgb_t fresnel = v_mad(glossy, grazing, v_sub(vec3(1, 1, 1), glossy));
    rgb_t below = v_mul(diffuse, v_sub(vec3(1, 1, 1), glossy));
    value->f = v_mul(lobe->blend.factor, v_mad(v_scale(below, base), coat, fresnel));
    value->pdf = value->pdf_rev = 0;
    if (wi.z > 0) {
        value->pdf = 0.5f * (ci * INV_PI_F + d / (4 * (1 + microfacet_lambda(ax, ay, wo)) * co));
        value->pdf_rev = 0.5f * (co * INV_PI_F + d / (4 * (1 + microfacet_lambda(ax, ay, wi)) * ci));
    }
    return true;
}

static bool draw_above(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi)
{
    if (choice >= 0.5f) return microfacet_mirror(lobe->alpha[0], lobe->alpha[1], wo, u, wi);
    *wi = warp_cosine_hemisphere(u);
    return true;
}

const lobe_kind_t lobe_fresnel_blend = {.flags = LOBE_REFLECTS,
                                        .eval = lobe_eval_mirrored,
                                        .sample = lobe_sample_mirrored,
                                        .eval_above = eval_above,
                                        .draw_above = draw_above,
                                        .regularize = lobe_regularize_alphas};
