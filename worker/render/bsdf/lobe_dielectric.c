/* lobe_dielectric: the rough interface of a dielectric (Walter et al. 2007, "Microfacet Models for Refraction
 * through Rough Surfaces") with the Trowbridge-Reitz distribution: one lobe that reflects and transmits,
 * which it chooses between at the visible normal that it has drawn; and its reflection alone. */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/bsdf/film.h"
#include "worker/render/bsdf/microfacet.h"

static float shadowing(const lobe_t *lobe, float lambda_o, float lambda_i)
{
    return lobe->dielectric.separable ? microfacet_separable(lambda_o, lambda_i)
                                      : microfacet_correlated(lambda_o, lambda_i);
}

/* The factors on what is reflected and transmitted; the film is on the outside. `eta` and Fresnel's
 * reflectance are as seen from the near side. */
static void find_factors(const lobe_t *lobe, float eta, float near_cos, float far_cos, float f, rgb_t *r,
                         rgb_t *t)
{
    *r = lobe->dielectric.r;
    *t = lobe->dielectric.t;
    film_on_interface(&lobe->dielectric, eta == lobe->dielectric.ior ? near_cos : far_cos, f, r, t);
}

/* For wo and wi above the surface; eta as seen from there. */
static bool eval_reflection(const lobe_t *lobe, float eta, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    microfacet_t facet;
    float cos_t, chance;
    if (!microfacet_reflection(lobe->alpha[0], lobe->alpha[1], wo, wi, &facet)) return false;
    rgb_t r, t;
    float f = fresnel_dielectric(facet.cos, eta, &cos_t);
    find_factors(lobe, eta, facet.cos, cos_t, f, &r, &t);
    if (!lobe_reflect_chance(f, r, t, &chance) || chance == 0) return false;
    value->f = v_scale(r, f * facet.density * shadowing(lobe, facet.lambda_o, facet.lambda_i));
    value->pdf = chance * facet.pdf;
    value->pdf_rev = chance * facet.pdf_rev;
    return true;
}

/* For wo above and wi below the surface (Walter et al. 2007, equations 16, 17 and 21). The index may be that
 * of either side over the other: m, which is then turned up, is the same. */
static bool eval_transmission(const lobe_t *lobe, float eta, vec3_t wo, vec3_t wi, transport_t mode,
                              bsdf_value_t *value)
{
    float ax = lobe->alpha[0], ay = lobe->alpha[1];
    if (!(wo.z > MICROFACET_LEAST_COSINE && wi.z < -MICROFACET_LEAST_COSINE)) return false;
    vec3_t m = v_mad(wo, eta, wi);
    float length2 = v_length2(m);
    if (!(length2 > 0) || m.z == 0) return false;
    m = v_scale(m, (m.z < 0 ? -1 : 1) / sqrtf(length2));
    float co = float_min(v_dot(wo, m), 1), ci = -v_dot(wi, m), cos_t, chance;
    if (!(co > 0 && ci > 0)) return false;
    rgb_t r, t;
    /* The same from both sides, but near total reflection only known well from the thinner one. */
    float f = eta >= 1 ? fresnel_dielectric(co, eta, &cos_t)
                       : fresnel_dielectric(float_min(ci, 1), 1 / eta, &cos_t);
    find_factors(lobe, eta, co, ci, f, &r, &t);
    if (!lobe_reflect_chance(f, r, t, &chance) || chance == 1) return false;
    float d = microfacet_distribution(ax, ay, m), lo = microfacet_lambda(ax, ay, wo),
          li = microfacet_lambda(ax, ay, wi), cos_m = co - eta * ci;
    /* d(m) over what all three have in common; the Jacobians of refraction are eta^2 ci / (co - eta ci)^2
     * forwards and co / (co - eta ci)^2 backwards. */
    float common = d * co * ci / (cos_m * cos_m);
    /* Radiance and importance differ as in the smooth interface. */
    float scale = mode == TRANSPORT_RADIANCE ? 1 : eta * eta;
    value->f = v_scale(t, (1 - f) * scale * common * shadowing(lobe, lo, li) / (wo.z * -wi.z));
    value->pdf = (1 - chance) * common * eta * eta / ((1 + lo) * wo.z);
    value->pdf_rev = (1 - chance) * common / ((1 + li) * -wi.z);
    return true;
}

static bool eval_pair(const lobe_t *lobe, float eta, vec3_t up, vec3_t wi, bool reflect, transport_t mode,
                      bsdf_value_t *value)
{
    return reflect ? eval_reflection(lobe, eta, up, wi, value)
                   : eval_transmission(lobe, eta, up, wi, mode, value);
}

static bool eval(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value)
{
    float eta = lobe_relative_index(lobe, wo);
    microfacet_upright(&wo, &wi);
    return eval_pair(lobe, eta, wo, wi, reflect, mode, value);
}

/* The direction drawn, for w above the surface. */
static bool draw(const lobe_t *lobe, float eta, vec3_t w, vec2_t u, float choice, vec3_t *wi, bool *reflect)
{
    vec3_t m = microfacet_sample(lobe->alpha[0], lobe->alpha[1], w, u);
    float cos = float_min(v_dot(w, m), 1), cos_t, chance;
    if (!(cos > 0)) return false;
    float f = fresnel_dielectric(cos, eta, &cos_t);
    rgb_t r, t;
    find_factors(lobe, eta, cos, cos_t, f, &r, &t);
    if (!lobe_reflect_chance(f, r, t, &chance)) return false;
    *reflect = choice < chance;
    if (*reflect) {
        *wi = v_sub(v_scale(m, 2 * cos), w);
        return wi->z > 0;
    }
    *wi = v_sub(v_scale(m, cos / eta - cos_t), v_scale(w, 1 / eta));
    return wi->z < 0;
}

static bool sample(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode, bsdf_sample_t *s)
{
    float eta = lobe_relative_index(lobe, wo);
    vec3_t up = wo.z > 0 ? wo : v_neg(wo), wi;
    bool reflect;
    bsdf_value_t value;
    return draw(lobe, eta, up, u, choice, &wi, &reflect) &&
           eval_pair(lobe, eta, up, wi, reflect, mode, &value) && lobe_complete(wo, wi, &value, s);
}

const lobe_kind_t lobe_rough_dielectric = {.flags = LOBE_REFLECTS | LOBE_TRANSMITS | LOBE_MICROFACETS |
                                                    LOBE_REFRACTS,
                                           .eval = eval,
                                           .sample = sample,
                                           .regularize = lobe_regularize_alphas};
/* The same with T black: never transmits. */
const lobe_kind_t lobe_rough_reflection = {.flags = LOBE_REFLECTS | LOBE_MICROFACETS,
                                           .eval = eval,
                                           .sample = sample,
                                           .regularize = lobe_regularize_alphas};
/* The same with R black: never reflects. */
const lobe_kind_t lobe_rough_transmission = {.flags = LOBE_TRANSMITS | LOBE_MICROFACETS | LOBE_REFRACTS,
                                             .eval = eval,
                                             .sample = sample,
                                             .regularize = lobe_regularize_alphas};
