/* bsdf_diffuse: Lambert's law, f = reflectance / pi, on both sides of the surface. */
#include "worker/render/bsdf.h"

#include "worker/render/warp.h"

static bool eval(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value)
{
    (void)mode;
    if (!reflect) return false;
    float cos_o = v_dot(wo, bsdf->ns), cos_i = v_dot(wi, bsdf->ns);
    bool same_hemisphere = cos_o * cos_i > 0;
    value->f = v_scale(bsdf->material->reflectance, INV_PI_F);
    value->pdf = same_hemisphere ? fabsf(cos_i) * INV_PI_F : 0;
    value->pdf_rev = same_hemisphere ? fabsf(cos_o) * INV_PI_F : 0;
    return true;
}

static bool sample(const blob_material_t *material, vec3_t wo, vec2_t u, float choice, transport_t mode,
                   bsdf_sample_t *s)
{
    (void)choice, (void)mode;
    vec3_t wi = warp_cosine_hemisphere(u);
    if (wi.z == 0) return false;
    if (wo.z < 0) wi.z = -wi.z;
    *s = (bsdf_sample_t){.wi = wi,
                         .weight = material->reflectance,
                         .pdf = fabsf(wi.z) * INV_PI_F,
                         .pdf_rev = fabsf(wo.z) * INV_PI_F};
    return true;
}

const bsdf_kind_t bsdf_diffuse = {eval, sample};
