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

static bool draw_above(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi)
{
    (void)choice;
    return microfacet_mirror(lobe->alpha[0], lobe->alpha[1], wo, u, wi);
}

const lobe_kind_t lobe_rough_conductor = {.flags = LOBE_REFLECTS | LOBE_MICROFACETS,
                                          .eval = lobe_eval_mirrored,
                                          .sample = lobe_sample_mirrored,
                                          .eval_above = eval_above,
                                          .draw_above = draw_above,
                                          .regularize = lobe_regularize_alphas};
