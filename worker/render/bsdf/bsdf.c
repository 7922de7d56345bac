/* bsdf: sums of lobes (see bsdf.h); the frame in which they stand is made in bsdf_frame.c. */
#include "worker/render/bsdf/bsdf.h"

#include "worker/render/bsdf/bsdf_frame.h"
#include "worker/render/bsdf/lobe.h"

#define TABLE_ENTRY(kind, shade) [kind] = shade,
static material_shade_t *const materials[MATERIAL_KIND_END] = {BSDF_MATERIALS(TABLE_ENTRY)};
#undef TABLE_ENTRY

/* What is not in the table scatters nothing. */
static void shade(const shading_t *shading)
{
    material_shade_t *material = materials[shading->material->kind];
    if (material != NULL) material(shading);
}

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

void bsdf_init(bsdf_t *bsdf, const scene_t *scene, const surface_t *surface)
{
    texture_point_t at = {.p = surface->p, .n = surface->ns, .colour = {1, 1, 1, 1}};
    bsdf->ng = surface->ng;
    bsdf->ns = surface->ns;
    bsdf->attenuation = vec3(0, 0, 0);
    bsdf->absorbs = false;
    bsdf->count = 0;
    if (scene_material_varies(scene, surface->material)) {
        surface_details_t details;
        scene_details(scene, surface, &details);
        at.uv = details.uv;
        at.uv2 = details.uv2;
        at.colour = details.colour;
        bsdf_frame_turn(bsdf, scene, surface->material, &details, &at);
    } else {
        v_frame(bsdf->ns, &bsdf->s, &bsdf->t);
    }
    shading_t shading = {scene, surface->material, &at, vec3(1, 1, 1), bsdf};
    shade(&shading);
    normalize_chances(bsdf);
    bsdf->specular = only_specular(bsdf);
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
            !lobe_eval(lobe, wo, wi, reflect, mode, &part))
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
        !lobe_eval(lobe, local_o, local_i, reflect, mode, value))
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

bool bsdf_sample(const bsdf_t *bsdf, vec3_t wo, vec2_t u, float choice, transport_t mode,
                 bsdf_sample_t *sample)
{
    vec3_t local = bsdf_to_local(bsdf, wo);
    if (local.z == 0 || bsdf->count == 0) return false;
    const lobe_t *lobe = bsdf->count == 1 ? &bsdf->lobes[0] : choose_lobe(bsdf, &choice);
    if (!lobe_sample(lobe, local, u, choice, mode, sample)) return false;
    bool reflect = sample->wi.z * local.z > 0;
    if (bsdf->count == 1)
        sample->weight = v_mul(lobe->scale, sample->weight);
    else if (!weigh_sample(bsdf, lobe, local, reflect, mode, sample))
        return false;
    sample->wi = bsdf_to_world(bsdf, sample->wi);
    /* A direction on the wrong side of the true surface carries nothing. */
    return reflect == same_side(bsdf, wo, sample->wi);
}

/* ---- for materials ------------------------------------------------------------------------------------- */

/* Bounds beyond anything sensible, far enough from overflow for the arithmetic of all lobes. */
#define LARGEST_VALUE 1e6f

static float sane(float x, float low)
{
    return x > low ? float_min(x, LARGEST_VALUE) : low;
}

/* Not textures_value: most values have no texture, and then need no scene. */
static rgb_t value_at(const shading_t *shading, material_value_t value)
{
    const blob_value_t *v = &shading->material->values[value];
    return v->texture == 0 ? v->factor : textures_value(scene_textures(shading->scene), v, shading->at);
}

static bool is_share(material_value_t value)
{
    return value == VALUE_REFLECTANCE || value == VALUE_TRANSMITTANCE || value == VALUE_ALBEDO ||
           value == VALUE_AMOUNT;
}

rgb_t shading_colour(const shading_t *shading, material_value_t value)
{
    rgb_t c = value_at(shading, value);
    if ((shading->material->flags & MATERIAL_UNIT) != 0 && is_share(value))
        c = vec3(float_min(c.x, 1), float_min(c.y, 1), float_min(c.z, 1));
    return vec3(sane(c.x, 0), sane(c.y, 0), sane(c.z, 0));
}

float shading_number(const shading_t *shading, material_value_t value)
{
    return sane(value_at(shading, value).x, -LARGEST_VALUE);
}

/* pbrt-v3's fit of an alpha to its older Blinn exponent (TrowbridgeReitzDistribution::RoughnessToAlpha). */
static float alpha_v3(float roughness)
{
    float x = logf(float_max(roughness, 1e-3f));
    return 1.62142f + x * (0.819955f + x * (0.1734f + x * (0.0171201f + x * 0.000640711f)));
}

static float remap(uint32_t flags, float roughness)
{
    if (flags & MATERIAL_REMAP_V3) return alpha_v3(roughness);
    if (flags & MATERIAL_REMAP_SQRT) return sqrtf(roughness);
    if (flags & MATERIAL_REMAP_SQUARE) return roughness * roughness;
    return roughness;
}

bool shading_alphas(const shading_t *shading, material_value_t u, material_value_t v, float alpha[2])
{
    enum { V3 = MATERIAL_REMAP_V3 | MATERIAL_ALPHA_V3 };
    const float largest = 10; /* beyond any sensible surface, and far from overflow */
    uint32_t flags = shading->material->flags;
    float roughness[2] = {float_max(shading_number(shading, u), 0), float_max(shading_number(shading, v), 0)};
    for (int i = 0; i < 2; i++)
        alpha[i] =
            float_clamp(remap(flags, float_min(roughness[i], 100)), flags & V3 ? 1e-3f : 1e-4f, largest);
    if (flags & V3)
        return shading->material->kind != MATERIAL_DIELECTRIC || roughness[0] != 0 || roughness[1] != 0;
    return alpha[0] >= 1e-3f || alpha[1] >= 1e-3f;
}

lobe_t *shading_add(const shading_t *shading, const lobe_kind_t *kind, rgb_t scale, float share)
{
    bsdf_t *bsdf = shading->bsdf;
    scale = v_mul(scale, shading->scale);
    float most = v_max(scale);
    if (!(most > 0) || bsdf->count == BSDF_LOBES) return NULL;
    lobe_t *lobe = &bsdf->lobes[bsdf->count++];
    /* No share may be so small that what only this lobe can draw is never drawn. */
    float chance = float_clamp(share * v_max(shading->scale), 0.01f * float_min(most, 1), 1e6f);
    *lobe = (lobe_t){.kind = kind, .scale = scale, .chance = chance};
    return lobe;
}

void shading_delegate(const shading_t *shading, uint32_t material, rgb_t scale)
{
    shading_t part = *shading;
    part.material = &scene_blob(shading->scene)->materials[material];
    part.scale = v_mul(shading->scale, scale);
    shade(&part);
}
