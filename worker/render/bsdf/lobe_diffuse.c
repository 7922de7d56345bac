/* lobe_diffuse: Lambert's law in reflection and in transmission, f = 1 / pi, and Oren and Nayar's rough
 * diffuse reflection. All are the same from both sides and sampled by the cosine. */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/sampling/warp.h"

void lobe_cosine_densities(vec3_t wo, vec3_t wi, bool allowed, bsdf_value_t *value)
{
    value->pdf = allowed ? fabsf(wi.z) * INV_PI_F : 0;
    value->pdf_rev = allowed ? fabsf(wo.z) * INV_PI_F : 0;
}

bool lobe_sample_cosine(vec3_t wo, vec2_t u, bool same_side, bsdf_sample_t *s)
{
    vec3_t wi = warp_cosine_hemisphere(u);
    if (wi.z == 0) return false;
    if ((wo.z > 0) != same_side) wi.z = -wi.z;
    *s = (bsdf_sample_t){
        .wi = wi, .weight = {1, 1, 1}, .pdf = fabsf(wi.z) * INV_PI_F, .pdf_rev = fabsf(wo.z) * INV_PI_F};
    return true;
}

static bool eval_reflection(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                            bsdf_value_t *value)
{
    (void)lobe, (void)reflect, (void)mode;
    value->f = vec3(INV_PI_F, INV_PI_F, INV_PI_F);
    lobe_cosine_densities(wo, wi, wo.z * wi.z > 0, value);
    return true;
}

static bool sample_reflection(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                              bsdf_sample_t *s)
{
    (void)lobe, (void)choice, (void)mode;
    return lobe_sample_cosine(wo, u, true, s);
}

static bool eval_transmission(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                              bsdf_value_t *value)
{
    (void)lobe, (void)reflect, (void)mode;
    value->f = vec3(INV_PI_F, INV_PI_F, INV_PI_F);
    lobe_cosine_densities(wo, wi, wo.z * wi.z < 0, value);
    return true;
}

static bool sample_transmission(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                                bsdf_sample_t *s)
{
    (void)lobe, (void)choice, (void)mode;
    return lobe_sample_cosine(wo, u, false, s);
}

const lobe_kind_t lobe_lambert = {
    .flags = LOBE_REFLECTS, .eval = eval_reflection, .sample = sample_reflection};
const lobe_kind_t lobe_lambert_transmission = {
    .flags = LOBE_TRANSMITS, .eval = eval_transmission, .sample = sample_transmission};

/* ---- Oren and Nayar ------------------------------------------------------------------------------------ */

/* pi f, after Oren and Nayar 1994, "Generalization of Lambert's Reflectance Model", the qualitative model
 * (equation 30), with numbers A and B. */
static float oren_nayar(const lobe_t *lobe, vec3_t wo, vec3_t wi)
{
    float so2 = wo.x * wo.x + wo.y * wo.y, si2 = wi.x * wi.x + wi.y * wi.y;
    float co = fabsf(wo.z), ci = fabsf(wi.z);
    /* sin(alpha) tan(beta) is the product of the sines over the larger cosine; the cosine of the difference
     * in azimuth, times the product of the sines, is the dot product in the plane. */
    float plane = so2 > 1e-8f && si2 > 1e-8f ? wo.x * wi.x + wo.y * wi.y : 0;
    return lobe->oren_nayar.a + lobe->oren_nayar.b * float_max(0, plane) / float_max(co, ci);
}

static bool eval_oren_nayar(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                            bsdf_value_t *value)
{
    (void)reflect, (void)mode;
    if (wo.z == 0 && wi.z == 0) return false;
    float f = oren_nayar(lobe, wo, wi) * INV_PI_F;
    value->f = vec3(f, f, f);
    lobe_cosine_densities(wo, wi, wo.z * wi.z > 0, value);
    return true;
}

static bool sample_oren_nayar(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                              bsdf_sample_t *s)
{
    (void)choice, (void)mode;
    if (!lobe_sample_cosine(wo, u, true, s)) return false;
    s->weight = v_scale(s->weight, oren_nayar(lobe, wo, s->wi));
    return true;
}

const lobe_kind_t lobe_oren_nayar = {
    .flags = LOBE_REFLECTS, .eval = eval_oren_nayar, .sample = sample_oren_nayar};
