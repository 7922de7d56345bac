/* bsdf: frames and dispatch to the kinds of material (see bsdf.h). */
#include "worker/render/bsdf.h"

static const bsdf_kind_t *const kinds[] = {
    [MATERIAL_DIFFUSE] = &bsdf_diffuse,
    [MATERIAL_MIRROR] = &bsdf_mirror,
    [MATERIAL_DIELECTRIC] = &bsdf_dielectric,
    [MATERIAL_CONDUCTOR] = &bsdf_conductor,
};

static bool is_specular(const blob_material_t *material)
{
    return kinds[material->kind]->eval == NULL ||
           (material->kind == MATERIAL_CONDUCTOR && (material->alpha_u == 0 || material->alpha_v == 0));
}

void bsdf_init(bsdf_t *bsdf, const surface_t *surface)
{
    *bsdf = (bsdf_t){.material = surface->material,
                     .ng = surface->ng,
                     .ns = surface->ns,
                     .specular = is_specular(surface->material)};
    /* Gram-Schmidt keeps the tangent's direction where the material needs one. */
    vec3_t tangent = v_mad(surface->tangent, -v_dot(surface->tangent, surface->ns), surface->ns);
    float length2 = v_length2(tangent);
    if (length2 > 0) {
        bsdf->s = v_scale(tangent, 1 / sqrtf(length2));
        bsdf->t = v_cross(bsdf->ns, bsdf->s);
    } else {
        v_frame(bsdf->ns, &bsdf->s, &bsdf->t);
    }
}

static inline bool same_side(const bsdf_t *bsdf, vec3_t a, vec3_t b)
{
    return v_dot(a, bsdf->ng) * v_dot(b, bsdf->ng) > 0;
}

bool bsdf_eval(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, transport_t mode, bsdf_value_t *value)
{
    if (bsdf->specular) return false;
    return kinds[bsdf->material->kind]->eval(bsdf, wo, wi, same_side(bsdf, wo, wi), mode, value);
}

bool bsdf_sample(const bsdf_t *bsdf, vec3_t wo, vec2_t u, float choice, transport_t mode,
                 bsdf_sample_t *sample)
{
    vec3_t local = bsdf_to_local(bsdf, wo);
    if (local.z == 0 || !kinds[bsdf->material->kind]->sample(bsdf->material, local, u, choice, mode, sample))
        return false;
    bool reflect = sample->wi.z * local.z > 0;
    sample->wi = bsdf_to_world(bsdf, sample->wi);
    /* A direction on the wrong side of the true surface carries nothing. */
    return reflect == same_side(bsdf, wo, sample->wi);
}
