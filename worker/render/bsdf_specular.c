/* bsdf_specular: Dirac lobes: the perfect mirror and the smooth dielectric interface. */
#include "worker/render/bsdf.h"

#include "worker/render/fresnel.h"

static bool sample_mirror(const blob_material_t *material, vec3_t wo, vec2_t u, float choice,
                          transport_t mode, bsdf_sample_t *s)
{
    (void)u, (void)choice, (void)mode;
    *s = (bsdf_sample_t){.wi = vec3(-wo.x, -wo.y, wo.z),
                         .weight = material->reflectance,
                         .pdf = 1,
                         .pdf_rev = 1,
                         .specular = true};
    return true;
}

/* Reflects with the Fresnel reflectance as probability, else refracts. The reflectance is the same from both
 * sides, so the reverse probability equals the forward one. */
static bool sample_dielectric(const blob_material_t *material, vec3_t wo, vec2_t u, float choice,
                              transport_t mode, bsdf_sample_t *s)
{
    (void)u;
    float eta = wo.z > 0 ? material->eta.x : 1 / material->eta.x, cos_t;
    float reflectance = fresnel_dielectric(fabsf(wo.z), eta, &cos_t);
    if (choice < reflectance) {
        *s = (bsdf_sample_t){.wi = vec3(-wo.x, -wo.y, wo.z),
                             .weight = material->reflectance,
                             .pdf = reflectance,
                             .pdf_rev = reflectance,
                             .specular = true};
        return true;
    }
    /* Radiance is compressed into the smaller cone: scaled by (index near / index far)^2 on the way that an
     * eye subpath goes (Veach 1997, equation 5.12); importance is not. */
    float scale = mode == TRANSPORT_RADIANCE ? 1 / (eta * eta) : 1;
    *s = (bsdf_sample_t){.wi = vec3(-wo.x / eta, -wo.y / eta, wo.z > 0 ? -cos_t : cos_t),
                         .weight = v_scale(material->transmittance, scale),
                         .pdf = 1 - reflectance,
                         .pdf_rev = 1 - reflectance,
                         .specular = true};
    return cos_t > 0;
}

const bsdf_kind_t bsdf_mirror = {NULL, sample_mirror};
const bsdf_kind_t bsdf_dielectric = {NULL, sample_dielectric};
