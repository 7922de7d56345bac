/* lobe_dispersion: the interface of a dielectric whose index of refraction differs from colour to colour, so
 * that it splits light (KHR_materials_dispersion; the indices of a spectral job): smooth, or rough as
 * lobe_dielectric.c.
 *
 * DESIGN. Light has three channels, so there are three indices, and what is refracted goes three ways. In RGB
 * a spectrum becomes three edges of colour; in a spectral job samples have all wavelengths. A reflection
 * keeps all channels together, each with its own reflectance.
 *
 * Of the smooth interface a sample chooses a colour that it goes on with, and the others become black. Where
 * the subpath has come to one colour already (bsdf_carry) it keeps that one, so that the price is paid once,
 * however many interfaces follow. Of the rough interface all three ways end in a lobe, and a direction is
 * worth what each of them says of it; its density is the mean of the three.
 *
 * What a strategy says of its density must not depend on what its subpath went through before, else the
 * weights of the strategies for one path would not add up to one. So the densities that leave this file are
 * those of a subpath that has all colours; a weight is the value over the density that was really drawn
 * from. Of Dirac lobes, whose densities cancel, only that both directions agree counts. */
#include "worker/render/bsdf/lobe.h"

#include "common/base.h"
#include "worker/render/bsdf/microfacet.h"

enum { CHANNELS = 3 };

static float channel_of(rgb_t c, int channel)
{
    return channel == 0 ? c.x : channel == 1 ? c.y : c.z;
}

static rgb_t in_channel(float value, int channel)
{
    return vec3(channel == 0 ? value : 0, channel == 1 ? value : 0, channel == 2 ? value : 0);
}

/* Index of the far side over that of the near side. */
static float relative_index(const lobe_t *lobe, bool outside, int channel)
{
    float ior = lobe->dielectric.iors[channel];
    return outside ? ior : 1 / ior;
}

/* What meets the interface. */
typedef struct {
    float eta[CHANNELS], f[CHANNELS], cos_t[CHANNELS];
    float chance; /* of reflecting */
} split_t;

/* Of the channels from `first` to `last` the chance is that of the brightest, so that what one of them
 * reflects or transmits is drawn. False when nothing is reflected and nothing transmitted. */
static bool split(const lobe_t *lobe, bool outside, float cos, int first, int last, split_t *s)
{
    float reflected = 0, transmitted = 0;
    for (int k = 0; k < CHANNELS; k++) {
        s->eta[k] = relative_index(lobe, outside, k);
        s->f[k] = fresnel_dielectric(cos, s->eta[k], &s->cos_t[k]);
        if (k < first || k > last) continue;
        reflected = float_max(reflected, s->f[k] * channel_of(lobe->dielectric.r, k));
        transmitted = float_max(transmitted, (1 - s->f[k]) * channel_of(lobe->dielectric.t, k));
    }
    s->chance = reflected / (reflected + transmitted);
    return reflected + transmitted > 0;
}

static bool split_all(const lobe_t *lobe, bool outside, float cos, split_t *s)
{
    return split(lobe, outside, cos, 0, CHANNELS - 1, s);
}

static rgb_t reflectance(const lobe_t *lobe, const split_t *s)
{
    return v_mul(lobe->dielectric.r, vec3(s->f[0], s->f[1], s->f[2]));
}

/* The channel to go on with, by what is left of the choice once it has fallen on transmission. */
static int choose_channel(const lobe_t *lobe, const split_t *s, float choice)
{
    if (lobe->dielectric.only != 0) return (int)lobe->dielectric.only - 1;
    return int_min((int)(CHANNELS * (choice - s->chance) / (1 - s->chance)), CHANNELS - 1);
}

/* ---- smooth -------------------------------------------------------------------------------------------- */

static bool sample_smooth(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                          bsdf_sample_t *sample)
{
    (void)u;
    int only = (int)lobe->dielectric.only;
    split_t s;
    if (!split(lobe, wo.z > 0, fabsf(wo.z), only ? only - 1 : 0, only ? only - 1 : CHANNELS - 1, &s))
        return false;
    *sample = (bsdf_sample_t){.wi = vec3(-wo.x, -wo.y, wo.z), .specular = true};
    if (choice < s.chance) {
        sample->weight = v_scale(reflectance(lobe, &s), 1 / s.chance);
        sample->pdf = sample->pdf_rev = s.chance;
        return true;
    }
    int k = choose_channel(lobe, &s, choice);
    float eta = s.eta[k], passed = 1 - s.f[k];
    float scale = (only ? 1 : CHANNELS) / (1 - s.chance) * (mode == TRANSPORT_RADIANCE ? 1 / (eta * eta) : 1);
    sample->wi = vec3(-wo.x / eta, -wo.y / eta, wo.z > 0 ? -s.cos_t[k] : s.cos_t[k]);
    sample->weight = in_channel(channel_of(lobe->dielectric.t, k) * passed * scale, k);
    sample->pdf = sample->pdf_rev = passed;
    return s.cos_t[k] > 0;
}

/* ---- rough: for wo above the surface ------------------------------------------------------------------- */

static bool eval_reflection(const lobe_t *lobe, bool outside, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    microfacet_t facet;
    split_t s;
    if (!microfacet_reflection(lobe->alpha[0], lobe->alpha[1], wo, wi, &facet) ||
        !split_all(lobe, outside, facet.cos, &s) || s.chance == 0)
        return false;
    value->f =
        v_scale(reflectance(lobe, &s), facet.density * microfacet_correlated(facet.lambda_o, facet.lambda_i));
    value->pdf = s.chance * facet.pdf;
    value->pdf_rev = s.chance * facet.pdf_rev;
    return true;
}

/* What one channel says of wi below the surface: as eval_transmission in lobe_dielectric.c. */
static bool eval_channel(const lobe_t *lobe, bool outside, int k, vec3_t wo, vec3_t wi, transport_t mode,
                         bsdf_value_t *value)
{
    float ax = lobe->alpha[0], ay = lobe->alpha[1], eta = relative_index(lobe, outside, k);
    vec3_t m = v_mad(wo, eta, wi);
    float length2 = v_length2(m);
    split_t near_side, far_side;
    if (!(length2 > 0) || m.z == 0) return false;
    m = v_scale(m, (m.z < 0 ? -1 : 1) / sqrtf(length2));
    float co = float_min(v_dot(wo, m), 1), ci = float_min(-v_dot(wi, m), 1);
    if (!(co > 0 && ci > 0) || !split_all(lobe, outside, co, &near_side) ||
        !split_all(lobe, !outside, ci, &far_side))
        return false;
    float passed = 1 - (outside ? near_side.f[k] : far_side.f[k]), cos_m = co - eta * ci;
    float common = microfacet_distribution(ax, ay, m) * co * ci / (cos_m * cos_m);
    float lo = microfacet_lambda(ax, ay, wo), li = microfacet_lambda(ax, ay, wi);
    float f = channel_of(lobe->dielectric.t, k) * passed * common * microfacet_correlated(lo, li) /
              (wo.z * -wi.z) * (mode == TRANSPORT_RADIANCE ? 1 : eta * eta);
    *value = (bsdf_value_t){.f = in_channel(f, k),
                            .pdf = (1 - near_side.chance) * common * eta * eta / ((1 + lo) * wo.z),
                            .pdf_rev = (1 - far_side.chance) * common / ((1 + li) * -wi.z)};
    return true;
}

static bool eval_transmission(const lobe_t *lobe, bool outside, vec3_t wo, vec3_t wi, transport_t mode,
                              bsdf_value_t *value)
{
    *value = (bsdf_value_t){.pdf = 0};
    if (!(wo.z > MICROFACET_LEAST_COSINE && wi.z < -MICROFACET_LEAST_COSINE)) return false;
    for (int k = 0; k < CHANNELS; k++) {
        bsdf_value_t part;
        if (!eval_channel(lobe, outside, k, wo, wi, mode, &part)) continue;
        value->f = v_add(value->f, part.f);
        value->pdf += part.pdf / CHANNELS;
        value->pdf_rev += part.pdf_rev / CHANNELS;
    }
    return value->pdf > 0 || value->pdf_rev > 0;
}

static bool eval_pair(const lobe_t *lobe, bool outside, vec3_t up, vec3_t wi, bool reflect, transport_t mode,
                      bsdf_value_t *value)
{
    return reflect ? eval_reflection(lobe, outside, up, wi, value)
                   : eval_transmission(lobe, outside, up, wi, mode, value);
}

static bool eval_rough(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                       bsdf_value_t *value)
{
    bool outside = wo.z > 0;
    microfacet_upright(&wo, &wi);
    return eval_pair(lobe, outside, wo, wi, reflect, mode, value);
}

/* The direction drawn, for w above the surface, and the channel that it was drawn for. */
static bool draw(const lobe_t *lobe, bool outside, vec3_t w, vec2_t u, float choice, vec3_t *wi,
                 bool *reflect, int *channel)
{
    vec3_t m = microfacet_sample(lobe->alpha[0], lobe->alpha[1], w, u);
    float cos = float_min(v_dot(w, m), 1);
    split_t s;
    if (!(cos > 0) || !split_all(lobe, outside, cos, &s)) return false;
    *reflect = choice < s.chance;
    if (*reflect) {
        *wi = v_sub(v_scale(m, 2 * cos), w);
        return wi->z > 0;
    }
    int k = *channel = choose_channel(lobe, &s, choice);
    *wi = v_sub(v_scale(m, cos / s.eta[k] - s.cos_t[k]), v_scale(w, 1 / s.eta[k]));
    return s.cos_t[k] > 0 && wi->z < 0;
}

static bool sample_rough(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                         bsdf_sample_t *sample)
{
    bool outside = wo.z > 0, reflect;
    vec3_t up = outside ? wo : v_neg(wo), wi;
    bsdf_value_t value, drawn;
    int k;
    if (!draw(lobe, outside, up, u, choice, &wi, &reflect, &k) ||
        !eval_pair(lobe, outside, up, wi, reflect, mode, &value) || !lobe_complete(wo, wi, &value, sample))
        return false;
    if (reflect || lobe->dielectric.only == 0) return true;
    /* The other colours are black, and were not drawn. */
    if (!eval_channel(lobe, outside, k, up, wi, mode, &drawn) || !(drawn.pdf > 0)) return false;
    sample->weight = v_scale(drawn.f, fabsf(wi.z) / drawn.pdf);
    return true;
}

static void regularize_smooth(lobe_t *lobe)
{
    lobe->kind = &lobe_rough_dispersion;
    lobe_regularize_alphas(lobe);
}

enum { BOTH = LOBE_REFLECTS | LOBE_TRANSMITS | LOBE_DISPERSES | LOBE_REFRACTS };
const lobe_kind_t lobe_smooth_dispersion = {
    .flags = BOTH | LOBE_SPECULAR, .sample = sample_smooth, .regularize = regularize_smooth};
const lobe_kind_t lobe_rough_dispersion = {.flags = BOTH | LOBE_MICROFACETS,
                                           .eval = eval_rough,
                                           .sample = sample_rough,
                                           .regularize = lobe_regularize_alphas};
