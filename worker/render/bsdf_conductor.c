/* bsdf_conductor: rough metal after Torrance and Sparrow (1967) with the Trowbridge-Reitz (GGX) distribution,
 * Smith's height-correlated shadowing, and sampling of visible normals; alpha 0 is a coloured mirror. */
#include "worker/render/bsdf.h"

#include "worker/render/fresnel.h"
#include "worker/render/warp.h"

/* Density of microfacet normals at m, per steradian and unit area (Walter et al. 2007, equation 33;
 * anisotropic as in Heitz 2014, "Understanding the Masking-Shadowing Function", equation 85). */
static float distribution(float ax, float ay, vec3_t m)
{
    float x = m.x / ax, y = m.y / ay, d = x * x + y * y + m.z * m.z;
    return 1 / (PI_F * ax * ay * d * d);
}

/* Smith's Lambda (Heitz 2014, equation 86). */
static float lambda(float ax, float ay, vec3_t w)
{
    float x = ax * w.x, y = ay * w.y, z2 = w.z * w.z;
    return 0.5f * (sqrtf(1 + (x * x + y * y) / z2) - 1);
}

/* A normal visible from w, w.z > 0 (Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with Spherical
 * Caps"). */
static vec3_t sample_visible(float ax, float ay, vec3_t w, vec2_t u)
{
    vec3_t stretched = v_normalize(vec3(ax * w.x, ay * w.y, w.z));
    float z = (1 - u.y) * (1 + stretched.z) - stretched.z, r = sqrtf(float_clamp(1 - z * z, 0, 1));
    float phi = TWO_PI_F * u.x;
    vec3_t half = v_add(vec3(r * cosf(phi), r * sinf(phi), z), stretched);
    return v_normalize(vec3(ax * half.x, ay * half.y, float_max(0, half.z)));
}

/* For wo and wi in shading coordinates, both above the surface. */
static bool eval_above(const blob_material_t *material, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    vec3_t m = v_normalize(v_add(wo, wi));
    float ax = material->alpha_u, ay = material->alpha_v, d = distribution(ax, ay, m), cos = v_dot(wo, m);
    if (!(cos > 0)) return false;
    float lo = lambda(ax, ay, wo), li = lambda(ax, ay, wi);
    value->f =
        v_scale(fresnel_conductor(cos, material->eta, material->k), d / (4 * wo.z * wi.z * (1 + lo + li)));
    /* The visible density of m over the Jacobian 4 cos of reflection. */
    value->pdf = d / (4 * (1 + lo) * wo.z);
    value->pdf_rev = d / (4 * (1 + li) * wi.z);
    return true;
}

static bool eval(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value)
{
    (void)mode;
    vec3_t o = bsdf_to_local(bsdf, wo), i = bsdf_to_local(bsdf, wi);
    if (!reflect || o.z * i.z <= 0) return false;
    return o.z > 0 ? eval_above(bsdf->material, o, i, value)
                   : eval_above(bsdf->material, v_neg(o), v_neg(i), value);
}

static bool sample_smooth(const blob_material_t *material, vec3_t wo, bsdf_sample_t *s)
{
    *s = (bsdf_sample_t){.wi = vec3(-wo.x, -wo.y, wo.z),
                         .weight = fresnel_conductor(fabsf(wo.z), material->eta, material->k),
                         .pdf = 1,
                         .pdf_rev = 1,
                         .specular = true};
    return true;
}

static bool sample(const blob_material_t *material, vec3_t wo, vec2_t u, float choice, transport_t mode,
                   bsdf_sample_t *s)
{
    (void)choice, (void)mode;
    float ax = material->alpha_u, ay = material->alpha_v;
    if (ax == 0 || ay == 0) return sample_smooth(material, wo, s);
    vec3_t up = wo.z > 0 ? wo : v_neg(wo);
    vec3_t m = sample_visible(ax, ay, up, u);
    vec3_t wi = v_sub(v_scale(m, 2 * v_dot(up, m)), up);
    bsdf_value_t value;
    if (!(wi.z > 0) || !eval_above(material, up, wi, &value) || !(value.pdf > 0)) return false;
    *s = (bsdf_sample_t){.wi = wo.z > 0 ? wi : v_neg(wi),
                         .weight = v_scale(value.f, wi.z / value.pdf),
                         .pdf = value.pdf,
                         .pdf_rev = value.pdf_rev};
    return true;
}

const bsdf_kind_t bsdf_conductor = {eval, sample};
