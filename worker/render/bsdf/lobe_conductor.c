/* lobe_conductor: rough metal after Torrance and Sparrow (1967) with the Trowbridge-Reitz distribution. */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/bsdf/microfacet.h"

/* For wo and wi above the surface. */
static bool eval_above(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    microfacet_t facet;
    if (!microfacet_reflection(lobe->alpha[0], lobe->alpha[1], wo, wi, &facet)) return false;
    rgb_t fresnel = fresnel_conductor(facet.cos, lobe->conductor.eta, lobe->conductor.k);
    value->f = v_scale(fresnel, facet.density * microfacet_correlated(facet.lambda_o, facet.lambda_i));
    value->pdf = facet.pdf;
    value->pdf_rev = facet.pdf_rev;
    return true;
}

static bool eval(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value)
{
    (void)reflect, (void)mode;
    microfacet_upright(&wo, &wi);
    return eval_above(lobe, wo, wi, value);
}

static bool sample(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode, bsdf_sample_t *s)
{
    (void)choice, (void)mode;
    vec3_t up = wo.z > 0 ? wo : v_neg(wo), wi;
    bsdf_value_t value;
    return microfacet_mirror(lobe->alpha[0], lobe->alpha[1], up, u, &wi) &&
           eval_above(lobe, up, wi, &value) && lobe_complete(wo, wi, &value, s);
}

const lobe_kind_t lobe_rough_conductor = {LOBE_REFLECTS, eval, sample, lobe_regularize_alphas};
