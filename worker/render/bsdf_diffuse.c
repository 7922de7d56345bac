/* bsdf_diffuse: Lambert's law, f = reflectance / pi, on both sides of the surface. */
#include "worker/render/bsdf.h"

#include "worker/render/warp.h"

static bool eval(const blob_material_t *material, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                 bsdf_value_t *value)
{
    (void)mode;
    if (!reflect) return false;
    value->f = v_scale(material->reflectance, INV_PI_F);
    bool same_hemisphere = wo.z * wi.z > 0;
    value->pdf = same_hemisphere ? fabsf(wi.z) * INV_PI_F : 0;
    value->pdf_rev = same_hemisphere ? fabsf(wo.z) * INV_PI_F : 0;
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
