/* lobe_schlick: the parts of glTF's metallic-roughness material (glTF 2.0, appendix B, with the extensions of
 * specular, clear coat, sheen, iridescence and transmission): a microfacet reflection with Schlick's Fresnel
 * reflectance F, and with what it leaves, 1 - F at the microfacet normal, a diffuse base that reflects and
 * transmits, and a thin transmission. They are the same from both sides. Alphas that count as smooth make
 * Dirac lobes (mirror, straight). */
#include "worker/render/bsdf/lobe.h"

#include "worker/render/bsdf/film.h"
#include "worker/render/bsdf/microfacet.h"
#include "worker/render/sampling/warp.h"

static rgb_t reflectance(const lobe_t *lobe, float cos)
{
    float grazing = fresnel_schlick_weight(cos);
    rgb_t plain = v_mad(v_scale(lobe->schlick.f0, 1 - grazing), grazing, lobe->schlick.f90);
    return film_cover(&lobe->schlick.film, lobe->schlick.f0, plain, cos);
}

/* Without a film the factor is in both reflectances. */
static rgb_t reflected(const lobe_t *lobe, float cos)
{
    rgb_t share = reflectance(lobe, cos);
    return lobe->schlick.film.strength == 0 ? share : v_mul(lobe->schlick.gain, share);
}

/* The standard takes the largest channel, so that the base keeps its hue. */
static float passed(const lobe_t *lobe, float cos)
{
    return lobe->schlick.factor * float_max(0, 1 - v_max(reflectance(lobe, cos)));
}

static float below_cover(const lobe_t *lobe, vec3_t wo, vec3_t wi)
{
    const lobe_cover_t *cover = &lobe->schlick.cover;
    return cover->coat == 0 && cover->sheen == 0 ? 1 : lobe_cover_passes(cover, wo, wi);
}

/* All of the following are for wo above the surface. */

/* ---- microfacets --------------------------------------------------------------------------------------- */

static bool facets(const lobe_t *lobe, vec3_t wo, vec3_t wi, microfacet_t *facet, float *f,
                   bsdf_value_t *value)
{
    if (!microfacet_reflection(lobe->alpha[0], lobe->alpha[1], wo, wi, facet)) return false;
    *f = facet->density * microfacet_correlated(facet->lambda_o, facet->lambda_i);
    value->pdf = facet->pdf;
    value->pdf_rev = facet->pdf_rev;
    return true;
}

static bool eval_reflection(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    microfacet_t facet;
    float f;
    if (!facets(lobe, wo, wi, &facet, &f, value)) return false;
    value->f = v_scale(reflected(lobe, facet.cos), f * below_cover(lobe, wo, wi));
    return true;
}

/* A transmission is the reflection that it mirrors. */
static bool eval_through(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    microfacet_t facet;
    float f;
    if (!facets(lobe, wo, vec3(wi.x, wi.y, -wi.z), &facet, &f, value)) return false;
    f = f * below_cover(lobe, wo, wi) * passed(lobe, facet.cos);
    value->f = vec3(f, f, f);
    return true;
}

static bool draw_reflection(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi)
{
    (void)choice;
    return microfacet_mirror(lobe->alpha[0], lobe->alpha[1], wo, u, wi);
}

static bool draw_through(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi)
{
    if (!draw_reflection(lobe, wo, u, choice, wi)) return false;
    wi->z = -wi->z;
    return true;
}

/* ---- diffuse ------------------------------------------------------------------------------------------- */

/* `up` is wi above the surface. */
static bool diffuse(const lobe_t *lobe, vec3_t wo, vec3_t wi, vec3_t up, bsdf_value_t *value)
{
    float length2 = v_length2(v_add(wo, up));
    if (!(wo.z > 0 && up.z > 0)) return false;
    /* |wo + wi| is twice the cosine between either and the vector half-way. */
    float f = INV_PI_F * passed(lobe, float_min(0.5f * sqrtf(length2), 1)) * below_cover(lobe, wo, wi);
    value->f = vec3(f, f, f);
    value->pdf = up.z * INV_PI_F;
    value->pdf_rev = wo.z * INV_PI_F;
    return true;
}

static bool eval_diffuse(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    return diffuse(lobe, wo, wi, wi, value);
}

static bool eval_diffuse_through(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    return diffuse(lobe, wo, wi, vec3(wi.x, wi.y, -wi.z), value);
}

static bool draw_diffuse(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi)
{
    (void)lobe, (void)wo, (void)choice;
    *wi = warp_cosine_hemisphere(u);
    return true;
}

static bool draw_diffuse_through(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi)
{
    draw_diffuse(lobe, wo, u, choice, wi);
    wi->z = -wi->z;
    return true;
}

/* ---- Dirac --------------------------------------------------------------------------------------------- */

static void set_specular(const lobe_t *lobe, vec3_t wo, vec3_t wi, rgb_t weight, bsdf_sample_t *s)
{
    *s = (bsdf_sample_t){.wi = wi,
                         .weight = v_scale(weight, below_cover(lobe, wo, wi)),
                         .pdf = 1,
                         .pdf_rev = 1,
                         .specular = true};
}

static bool sample_mirror(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                          bsdf_sample_t *s)
{
    (void)u, (void)choice, (void)mode;
    set_specular(lobe, wo, vec3(-wo.x, -wo.y, wo.z), reflected(lobe, fabsf(wo.z)), s);
    return true;
}

static bool sample_straight(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                            bsdf_sample_t *s)
{
    (void)u, (void)choice, (void)mode;
    float share = passed(lobe, fabsf(wo.z));
    set_specular(lobe, wo, v_neg(wo), vec3(share, share, share), s);
    return true;
}

/* ---- a coat with a normal of its own ------------------------------------------------------------------- */

/* Its frame, whose tangents are any, in shading coordinates. */
typedef struct {
    vec3_t s, t, n;
} coat_frame_t;

static coat_frame_t coat_frame(const lobe_t *lobe)
{
    coat_frame_t frame = {.n = lobe->schlick.cover.coat_normal};
    v_frame(frame.n, &frame.s, &frame.t);
    return frame;
}

static vec3_t to_coat(const coat_frame_t *frame, vec3_t w)
{
    return vec3(v_dot(w, frame->s), v_dot(w, frame->t), v_dot(w, frame->n));
}

static vec3_t from_coat(const coat_frame_t *frame, vec3_t w)
{
    return v_add(v_add(v_scale(frame->s, w.x), v_scale(frame->t, w.y)), v_scale(frame->n, w.z));
}

/* Below it directions count as along the surface, where nothing is seen. */
#define LEAST_COSINE 1e-6f

/* The coat receives light by the cosine to its own normal, while that to the shading normal is what values
 * are multiplied by: their ratio, for the direction to the light, belongs to the value (Veach 1997, section
 * 5.3: shading normals). Both directions lie above both surfaces, else there is nothing. */
static bool eval_coat_above(const lobe_t *lobe, const coat_frame_t *frame, vec3_t wo, vec3_t wi,
                            transport_t mode, bsdf_value_t *value)
{
    vec3_t o = to_coat(frame, wo), i = to_coat(frame, wi);
    bool above = o.z > LEAST_COSINE && i.z > LEAST_COSINE && wo.z > LEAST_COSINE && wi.z > LEAST_COSINE;
    if (!above || !eval_reflection(lobe, o, i, value)) return false;
    value->f = v_scale(value->f, mode == TRANSPORT_RADIANCE ? i.z / wi.z : o.z / wo.z);
    return true;
}

static bool eval_coat(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                      bsdf_value_t *value)
{
    (void)reflect;
    coat_frame_t frame = coat_frame(lobe);
    if (!(wo.z > 0)) wo = v_neg(wo), wi = v_neg(wi);
    return eval_coat_above(lobe, &frame, wo, wi, mode, value);
}

static bool sample_coat(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                        bsdf_sample_t *s)
{
    coat_frame_t frame = coat_frame(lobe);
    vec3_t up = wo.z > 0 ? wo : v_neg(wo), o = to_coat(&frame, up), i;
    bsdf_value_t value;
    if (!(o.z > LEAST_COSINE) || !draw_reflection(lobe, o, u, choice, &i)) return false;
    vec3_t wi = from_coat(&frame, i);
    return eval_coat_above(lobe, &frame, up, wi, mode, &value) && lobe_complete(wo, wi, &value, s);
}

/* The same as a Dirac lobe: both cosines to the coat's normal are equal, so that only those to the shading
 * normal are left. */
static bool sample_coat_mirror(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                               bsdf_sample_t *s)
{
    (void)u, (void)choice;
    vec3_t n = lobe->schlick.cover.coat_normal, up = wo.z > 0 ? wo : v_neg(wo);
    float cos = v_dot(up, n);
    vec3_t wi = v_mad(v_neg(up), 2 * cos, n);
    if (!(cos > LEAST_COSINE && wi.z > LEAST_COSINE && up.z > LEAST_COSINE)) return false;
    rgb_t weight = v_scale(reflectance(lobe, cos), mode == TRANSPORT_RADIANCE ? 1 : wi.z / up.z);
    set_specular(lobe, wo, wo.z > 0 ? wi : v_neg(wi), weight, s);
    return true;
}

static void regularize_coat_mirror(lobe_t *lobe)
{
    lobe->kind = &lobe_schlick_coat;
    lobe_regularize_alphas(lobe);
}

static void regularize_mirror(lobe_t *lobe)
{
    lobe->kind = &lobe_schlick_reflection;
    lobe_regularize_alphas(lobe);
}

static void regularize_straight(lobe_t *lobe)
{
    lobe->kind = &lobe_schlick_through;
    lobe_regularize_alphas(lobe);
}

const lobe_kind_t lobe_schlick_reflection = {.flags = LOBE_REFLECTS | LOBE_MICROFACETS,
                                             .eval = lobe_eval_mirrored,
                                             .sample = lobe_sample_mirrored,
                                             .eval_above = eval_reflection,
                                             .draw_above = draw_reflection,
                                             .regularize = lobe_regularize_alphas};
const lobe_kind_t lobe_schlick_diffuse = {.flags = LOBE_REFLECTS,
                                          .eval = lobe_eval_mirrored,
                                          .sample = lobe_sample_mirrored,
                                          .eval_above = eval_diffuse,
                                          .draw_above = draw_diffuse};
const lobe_kind_t lobe_schlick_diffuse_through = {.flags = LOBE_TRANSMITS,
                                                  .eval = lobe_eval_mirrored,
                                                  .sample = lobe_sample_mirrored,
                                                  .eval_above = eval_diffuse_through,
                                                  .draw_above = draw_diffuse_through};
const lobe_kind_t lobe_schlick_through = {.flags = LOBE_TRANSMITS,
                                          .eval = lobe_eval_mirrored,
                                          .sample = lobe_sample_mirrored,
                                          .eval_above = eval_through,
                                          .draw_above = draw_through,
                                          .regularize = lobe_regularize_alphas};
const lobe_kind_t lobe_schlick_mirror = {
    .flags = LOBE_REFLECTS | LOBE_SPECULAR, .sample = sample_mirror, .regularize = regularize_mirror};
const lobe_kind_t lobe_schlick_straight = {
    .flags = LOBE_TRANSMITS | LOBE_SPECULAR, .sample = sample_straight, .regularize = regularize_straight};
const lobe_kind_t lobe_schlick_coat = {.flags = LOBE_REFLECTS | LOBE_MICROFACETS,
                                       .eval = eval_coat,
                                       .sample = sample_coat,
                                       .regularize = lobe_regularize_alphas};
const lobe_kind_t lobe_schlick_coat_mirror = {.flags = LOBE_REFLECTS | LOBE_SPECULAR,
                                              .sample = sample_coat_mirror,
                                              .regularize = regularize_coat_mirror};
