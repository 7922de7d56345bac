/* bsdf: sums of lobes: see bsdf.h. */
#include "worker/render/bsdf/bsdf.h"

#include "worker/render/bsdf/lobe.h"

/* ---- making one ---------------------------------------------------------------------------------------- */

/* Without any lobe light is lost, but that is no Dirac lobe. */
static bool only_specular(const bsdf_t *bsdf)
{
    for (int i = 0; i < bsdf->count; i++)
        if (!(bsdf->lobes[i].kind->flags & LOBE_SPECULAR)) return false;
    return bsdf->count > 0;
}

/* Until here a lobe's chance was its share. */
static void normalize_chances(bsdf_t *bsdf)
{
    if (bsdf->count == 1) {
        bsdf->lobes[0].chance = 1;
        return;
    }
    float sum = 0;
    for (int i = 0; i < bsdf->count; i++) sum += bsdf->lobes[i].chance;
    for (int i = 0; i < bsdf->count; i++) bsdf->lobes[i].chance /= sum;
}

void bsdf_complete(bsdf_t *bsdf)
{
    normalize_chances(bsdf);
    bsdf->specular = only_specular(bsdf);
}

bool bsdf_is_broad(const bsdf_t *bsdf)
{
    const float broad = 0.1f;
    for (int i = 0; i < bsdf->count; i++) {
        const lobe_t *lobe = &bsdf->lobes[i];
        if (lobe->kind->flags & LOBE_SPECULAR) continue;
        bool narrow =
            (lobe->kind->flags & LOBE_MICROFACETS) && lobe->alpha[0] < broad && lobe->alpha[1] < broad;
        if (!narrow) return true;
    }
    return false;
}

void bsdf_regularize(bsdf_t *bsdf)
{
    for (int i = 0; i < bsdf->count; i++)
        if (bsdf->lobes[i].kind->regularize != NULL) bsdf->lobes[i].kind->regularize(&bsdf->lobes[i]);
    bsdf->specular = only_specular(bsdf);
}

void lobe_regularize_pair(float alpha[2])
{
    for (int i = 0; i < 2; i++)
        if (alpha[i] < 0.3f) alpha[i] = float_clamp(2 * alpha[i], 0.1f, 0.3f);
}

void lobe_regularize_alphas(lobe_t *lobe)
{
    lobe_regularize_pair(lobe->alpha);
}

bool lobe_complete(vec3_t wo, vec3_t wi, const bsdf_value_t *value, bsdf_sample_t *sample)
{
    if (!(value->pdf > 0)) return false;
    *sample = (bsdf_sample_t){.wi = wo.z > 0 ? wi : v_neg(wi),
                              .weight = v_scale(value->f, fabsf(wi.z) / value->pdf),
                              .pdf = value->pdf,
                              .pdf_rev = value->pdf_rev};
    return true;
}

bool lobe_eval_mirrored(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                        bsdf_value_t *value)
{
    (void)reflect, (void)mode;
    if (!(wo.z > 0)) wo = v_neg(wo), wi = v_neg(wi);
    return lobe->kind->eval_above(lobe, wo, wi, value);
}

bool lobe_sample_mirrored(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                          bsdf_sample_t *sample)
{
    (void)mode;
    vec3_t up = wo.z > 0 ? wo : v_neg(wo), wi;
    bsdf_value_t value;
    return lobe->kind->draw_above(lobe, up, u, choice, &wi) && lobe->kind->eval_above(lobe, up, wi, &value) &&
           lobe_complete(wo, wi, &value, sample);
}

rgb_t bsdf_albedo(const bsdf_t *bsdf)
{
    rgb_t sum = {0, 0, 0};
    for (int i = 0; i < bsdf->count; i++) sum = v_add(sum, bsdf->lobes[i].scale);
    return vec3(float_min(sum.x, 1), float_min(sum.y, 1), float_min(sum.z, 1));
}

/* ---- using one ----------------------------------------------------------------------------------------- */

static inline bool same_side(const bsdf_t *bsdf, vec3_t a, vec3_t b)
{
    return v_dot(a, bsdf->ng) * v_dot(b, bsdf->ng) > 0;
}

/* The sum over the lobes, each by its chance; directions in shading coordinates. */
static bool eval_lobes(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                       bsdf_value_t *value)
{
    uint32_t side = reflect ? LOBE_REFLECTS : LOBE_TRANSMITS;
    bool any = false;
    *value = (bsdf_value_t){.pdf = 0};
    for (int i = 0; i < bsdf->count; i++) {
        const lobe_t *lobe = &bsdf->lobes[i];
        bsdf_value_t part;
        if ((lobe->kind->flags & (side | LOBE_SPECULAR)) != side ||
            !lobe->kind->eval(lobe, wo, wi, reflect, mode, &part))
            continue;
        value->f = v_add(value->f, v_mul(lobe->scale, part.f));
        value->pdf += lobe->chance * part.pdf;
        value->pdf_rev += lobe->chance * part.pdf_rev;
        any = true;
    }
    return any;
}

bool bsdf_eval(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, transport_t mode, bsdf_value_t *value)
{
    if (bsdf->specular) return false;
    bool reflect = same_side(bsdf, wo, wi);
    vec3_t local_o = bsdf_to_local(bsdf, wo), local_i = bsdf_to_local(bsdf, wi);
    /* What no lobe can draw, since the two normals disagree about the sides, is black: else only those
     * strategies would find its light that join subpaths. */
    if ((local_o.z * local_i.z > 0) != reflect) return false;
    if (bsdf->count != 1) return eval_lobes(bsdf, local_o, local_i, reflect, mode, value);
    const lobe_t *lobe = &bsdf->lobes[0];
    if (!(lobe->kind->flags & (reflect ? LOBE_REFLECTS : LOBE_TRANSMITS)) ||
        !lobe->kind->eval(lobe, local_o, local_i, reflect, mode, value))
        return false;
    value->f = v_mul(lobe->scale, value->f);
    return true;
}

bool bsdf_eval_split(const bsdf_t *bsdf, vec3_t wo, vec3_t wi, transport_t mode, bsdf_value_t *value)
{
    if (bsdf->specular) return false;
    bool reflect = same_side(bsdf, wo, wi);
    vec3_t local_o = bsdf_to_local(bsdf, wo), local_i = bsdf_to_local(bsdf, wi);
    if ((local_o.z * local_i.z > 0) == reflect) return false;
    local_i.z = -local_i.z;
    return eval_lobes(bsdf, local_o, local_i, reflect, mode, value);
}

/* The lobe that *choice falls on; *choice is stretched to [0, 1) again. */
static const lobe_t *choose_lobe(const bsdf_t *bsdf, float *choice)
{
    int i = 0;
    float left = *choice;
    while (i < bsdf->count - 1 && left >= bsdf->lobes[i].chance) left -= bsdf->lobes[i++].chance;
    *choice = float_clamp(left / bsdf->lobes[i].chance, 0, 0x1.fffffep-1f);
    return &bsdf->lobes[i];
}

/* What the direction that one lobe drew is worth among all of them. */
static bool weigh_sample(const bsdf_t *bsdf, const lobe_t *lobe, vec3_t wo, bool reflect, transport_t mode,
                         bsdf_sample_t *sample)
{
    if (sample->specular) {
        sample->weight = v_mul(sample->weight, v_scale(lobe->scale, 1 / lobe->chance));
        sample->pdf *= lobe->chance;
        sample->pdf_rev *= lobe->chance;
        return true;
    }
    bsdf_value_t value;
    if (!eval_lobes(bsdf, wo, sample->wi, reflect, mode, &value) || !(value.pdf > 0)) return false;
    sample->weight = v_scale(value.f, fabsf(sample->wi.z) / value.pdf);
    sample->pdf = value.pdf;
    sample->pdf_rev = value.pdf_rev;
    return true;
}

/* (index near / index far)^2 where radiance passes the interface of a lobe; else 1. */
static float squeeze_of(const lobe_t *lobe, vec3_t wo, bool reflect, transport_t mode)
{
    if (reflect || mode != TRANSPORT_RADIANCE || !(lobe->kind->flags & LOBE_REFRACTS)) return 1;
    float eta = lobe_relative_index(lobe, wo);
    return 1 / (eta * eta);
}

bool bsdf_sample(const bsdf_t *bsdf, vec3_t wo, vec2_t u, float choice, transport_t mode,
                 bsdf_sample_t *sample)
{
    vec3_t local = bsdf_to_local(bsdf, wo);
    if (local.z == 0 || bsdf->count == 0) return false;
    const lobe_t *lobe = bsdf->count == 1 ? &bsdf->lobes[0] : choose_lobe(bsdf, &choice);
    if (!lobe->kind->sample(lobe, local, u, choice, mode, sample)) return false;
    bool reflect = sample->wi.z * local.z > 0;
    sample->squeeze = squeeze_of(lobe, local, reflect, mode);
    if (bsdf->count == 1)
        sample->weight = v_mul(lobe->scale, sample->weight);
    else if (!weigh_sample(bsdf, lobe, local, reflect, mode, sample))
        return false;
    sample->wi = bsdf_to_world(bsdf, sample->wi);
    /* A direction on the wrong side of the true surface carries nothing. */
    return reflect == same_side(bsdf, wo, sample->wi);
}
