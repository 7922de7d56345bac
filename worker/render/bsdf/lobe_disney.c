/* lobe_disney: the lobes of Disney's principled BSDF (Burley 2012, "Physically Based Shading at Disney";
 * Burley 2015, "Extending the Disney BRDF to a BSDF with Integrated Subsurface Scattering"), as pbrt-v3 has
 * them. */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/bsdf/microfacet.h"
#include "worker/render/sampling/warp.h"

/* ---- diffuse reflection and sheen: drawn by the cosine --------------------------------------------------
 */

/* The cosine between wi and the half vector; false when there is none. */
static bool half_cosine(vec3_t wo, vec3_t wi, float *cos)
{
    vec3_t m = v_add(wo, wi);
    float length2 = v_length2(m);
    if (!(length2 > 0)) return false;
    *cos = v_dot(wi, m) / sqrtf(length2);
    return true;
}

static float mix(float amount, float a, float b)
{
    return (1 - amount) * a + amount * b;
}

/* pi f: the base with its Fresnel darkening and the retro-reflection of rough surfaces (Burley 2015, equation
 * 4), and the flat look of subsurface scattering (Burley 2012, section 5.3, after Hanrahan and Krueger). */
static bool diffuse(const lobe_t *lobe, vec3_t wo, vec3_t wi, float *value)
{
    float cos, co = fabsf(wo.z), ci = fabsf(wi.z), roughness = lobe->disney_diffuse.roughness;
    if (!half_cosine(wo, wi, &cos) || !(co + ci > 0)) return false;
    float fo = fresnel_schlick_weight(co), fi = fresnel_schlick_weight(ci);
    float base = (1 - 0.5f * fo) * (1 - 0.5f * fi);
    float grazing = cos * cos * roughness, turned = 2 * grazing;
    float scattered = mix(fo, 1, grazing) * mix(fi, 1, grazing);
    float flat = 1.25f * (scattered * (1 / (co + ci) - 0.5f) + 0.5f);
    float retro = turned * (fo + fi + fo * fi * (turned - 1));
    *value = lobe->disney_diffuse.base * base + lobe->disney_diffuse.flat * flat +
             lobe->disney_diffuse.retro * retro;
    return true;
}

/* pi f. */
static bool sheen(const lobe_t *lobe, vec3_t wo, vec3_t wi, float *value)
{
    (void)lobe;
    float cos;
    if (!half_cosine(wo, wi, &cos)) return false;
    *value = PI_F * fresnel_schlick_weight(cos);
    return true;
}

typedef bool matte_t(const lobe_t *lobe, vec3_t wo, vec3_t wi, float *value);

static bool eval_matte(matte_t *matte, const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    float f;
    if (!matte(lobe, wo, wi, &f)) return false;
    value->f = vec3(f * INV_PI_F, f * INV_PI_F, f * INV_PI_F);
    lobe_cosine_densities(wo, wi, wo.z * wi.z > 0, value);
    return true;
}

static bool sample_matte(matte_t *matte, const lobe_t *lobe, vec3_t wo, vec2_t u, bsdf_sample_t *s)
{
    float f;
    if (!lobe_sample_cosine(wo, u, true, s) || !matte(lobe, wo, s->wi, &f)) return false;
    s->weight = vec3(f, f, f);
    return true;
}

static bool eval_diffuse(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                         bsdf_value_t *value)
{
    (void)reflect, (void)mode;
    return eval_matte(diffuse, lobe, wo, wi, value);
}

static bool sample_diffuse(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                           bsdf_sample_t *s)
{
    (void)choice, (void)mode;
    return sample_matte(diffuse, lobe, wo, u, s);
}

static bool eval_sheen(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                       bsdf_value_t *value)
{
    (void)reflect, (void)mode;
    return eval_matte(sheen, lobe, wo, wi, value);
}

static bool sample_sheen(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                         bsdf_sample_t *s)
{
    (void)choice, (void)mode;
    return sample_matte(sheen, lobe, wo, u, s);
}

const lobe_kind_t lobe_disney_diffuse = {
    .flags = LOBE_REFLECTS, .eval = eval_diffuse, .sample = sample_diffuse};
const lobe_kind_t lobe_disney_sheen = {.flags = LOBE_REFLECTS, .eval = eval_sheen, .sample = sample_sheen};

/* ---- specular reflection and clear coat: mirrored about microfacets -------------------------------------
 */

/* For both directions turned above the surface, and whether they were below. */
typedef bool facets_t(const lobe_t *lobe, bool below, vec3_t wo, vec3_t wi, bsdf_value_t *value);

/* Dielectric reflectance and Schlick's approximation from the metal's colour, mixed. pbrt-v3's cosines are
 * negative below the surface, where a metal is white to it. */
static bool specular(const lobe_t *lobe, bool below, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    microfacet_t facet;
    if (!microfacet_reflection(lobe->alpha[0], lobe->alpha[1], wo, wi, &facet)) return false;
    rgb_t r0 = lobe->disney_specular.r0;
    float metallic = lobe->disney_specular.metallic, ior = lobe->disney_specular.ior, cos_t;
    float dielectric = (1 - metallic) * fresnel_dielectric(facet.cos, below ? 1 / ior : ior, &cos_t),
          grazing = below ? 1 : fresnel_schlick_weight(facet.cos);
    rgb_t metal = v_mad(r0, grazing, v_sub(vec3(1, 1, 1), r0));
    rgb_t fresnel = v_mad(vec3(dielectric, dielectric, dielectric), metallic, metal);
    value->f = v_scale(v_mul(lobe->disney_specular.factor, fresnel),
                       facet.density * microfacet_separable(facet.lambda_o, facet.lambda_i));
    value->pdf = facet.pdf;
    value->pdf_rev = facet.pdf_rev;
    return true;
}

/* Smith's shadowing of an isotropic surface over twice the cosine: the customary G / (4 cos cos). */
static float coat_shadowing(float cos)
{
    const float alpha2 = 0.25f * 0.25f;
    return 1 / (cos + sqrtf(alpha2 + (1 - alpha2) * cos * cos));
}

/* Density of normals, Burley's GTR with gamma = 1 (2012, appendix B.2, equation 4), per steradian and unit
 * area. */
static float coat_distribution(float alpha, float cos)
{
    float alpha2 = alpha * alpha;
    return (alpha2 - 1) / (PI_F * logf(alpha2) * (1 + (alpha2 - 1) * cos * cos));
}

static bool coat(const lobe_t *lobe, bool below, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    (void)below; /* 4 per cent on either side */
    if (!(wo.z > 0 && wi.z > 0)) return false;
    vec3_t m = v_normalize(v_add(wo, wi));
    float cos = v_dot(wo, m), d = coat_distribution(lobe->disney_coat.alpha, float_min(m.z, 1));
    if (!(cos > 0)) return false;
    float f =
        0.25f * d * mix(fresnel_schlick_weight(cos), 0.04f, 1) * coat_shadowing(wo.z) * coat_shadowing(wi.z);
    value->f = vec3(f, f, f);
    value->pdf = value->pdf_rev = d * m.z / (4 * cos);
    return true;
}

static bool eval_facets(facets_t *facets, const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    bool below = !(wo.z > 0);
    microfacet_upright(&wo, &wi);
    return facets(lobe, below, wo, wi, value);
}

/* Completes a sample whose direction `wi` was drawn for wo turned upright. */
static bool finish_facets(facets_t *facets, const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_sample_t *s)
{
    bsdf_value_t value;
    vec3_t up = wo.z > 0 ? wo : v_neg(wo);
    return facets(lobe, !(wo.z > 0), up, wi, &value) && lobe_complete(wo, wi, &value, s);
}

static bool eval_specular(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                          bsdf_value_t *value)
{
    (void)reflect, (void)mode;
    return eval_facets(specular, lobe, wo, wi, value);
}

static bool sample_specular(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                            bsdf_sample_t *s)
{
    (void)choice, (void)mode;
    vec3_t wi;
    return microfacet_mirror(lobe->alpha[0], lobe->alpha[1], wo.z > 0 ? wo : v_neg(wo), u, &wi) &&
           finish_facets(specular, lobe, wo, wi, s);
}

static bool eval_coat(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                      bsdf_value_t *value)
{
    (void)reflect, (void)mode;
    return eval_facets(coat, lobe, wo, wi, value);
}

/* Draws the normal by its distribution times its cosine (Burley 2012, appendix B.2, equation 2). */
static bool sample_coat(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                        bsdf_sample_t *s)
{
    (void)choice, (void)mode;
    float alpha2 = lobe->disney_coat.alpha * lobe->disney_coat.alpha;
    float z2 = float_clamp((1 - powf(alpha2, u.y)) / (1 - alpha2), 0, 1), r = sqrtf(1 - z2);
    float phi = TWO_PI_F * u.x;
    vec3_t m = vec3(r * cosf(phi), r * sinf(phi), sqrtf(z2)), up = wo.z > 0 ? wo : v_neg(wo);
    float cos = v_dot(up, m);
    vec3_t wi = v_sub(v_scale(m, 2 * cos), up);
    return cos > 0 && wi.z > 0 && finish_facets(coat, lobe, wo, wi, s);
}

static void regularize_coat(lobe_t *lobe)
{
    lobe->disney_coat.alpha = float_max(lobe->disney_coat.alpha, 0.1f);
}

const lobe_kind_t lobe_disney_specular = {.flags = LOBE_REFLECTS | LOBE_MICROFACETS,
                                          .eval = eval_specular,
                                          .sample = sample_specular,
                                          .regularize = lobe_regularize_alphas};
const lobe_kind_t lobe_disney_clearcoat = {
    .flags = LOBE_REFLECTS, .eval = eval_coat, .sample = sample_coat, .regularize = regularize_coat};
