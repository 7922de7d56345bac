/* lobe_layered: a base under a coat, after Guo, Hasan and Zhao 2018, "Position-Free Monte Carlo Simulation
 * for Arbitrary Layered BSDFs".
 *
 * What the coat itself reflects is known in closed form. What comes from below it is estimated by random
 * walks between the layers: light enters through the coat from one direction, goes on until it is absorbed,
 * and at each scattering by the base or the medium is joined to the other direction through the coat, which
 * is sampled from outside; where the coat is rough, walks that come to it leave there as well, and both ways
 * of leaving are weighted by the power heuristic. The random numbers are a hash of the two directions and
 * the point: the value is a function of its arguments, noisy but right on average over them. Walks start at
 * the direction that is closer to the normal, so the value is exactly reciprocal.
 *
 * The densities are those of a mixture that is sampled instead of the walks and known in closed form: visible
 * normals of the coat; for metal, visible normals of the base as if seen through a smooth coat (the base then
 * counts as rougher by what the real coat adds); and the cosine.
 *
 * Where the coat is smooth or tinted, its reflection is a lobe of its own (lobe_smooth_coat,
 * lobe_rough_coat). Two cases need no walks: the smooth coat and absorbing medium over Lambert
 * (lobe_coated_lambert), where light below the coat is a geometric series, and both interfaces smooth
 * (lobe_smooth_layers), likewise. */
#include "worker/render/bsdf/lobe.h"

#include "common/sampler.h"
#include "worker/render/bsdf/microfacet.h"
#include "worker/render/sampling/warp.h"

#include <string.h>

enum {
    WALKS = 2,         /* averaged for one value */
    LONGEST_WALK = 100 /* interfaces and scatterings met, after which what little is left is dropped */
};

static float power(float a, float b)
{
    return a * a / (a * a + b * b);
}

static float fade(float thickness, vec3_t w)
{
    return expf(-thickness / fabsf(w.z));
}

/* ---- random numbers ------------------------------------------------------------------------------------ */

typedef struct {
    uint64_t state;
} stream_t;

static uint64_t pair_bits(float a, float b)
{
    uint32_t low, high;
    memcpy(&low, &a, sizeof low);
    memcpy(&high, &b, sizeof high);
    return (uint64_t)high << 32 | low;
}

static stream_t stream_of(float seed, vec3_t a, vec3_t b)
{
    uint64_t key = sampler_mix(pair_bits(seed, 1) + 0x9E3779B97F4A7C15u);
    key = sampler_mix(key ^ pair_bits(a.x, a.y));
    key = sampler_mix(key ^ pair_bits(a.z, b.x));
    return (stream_t){sampler_mix(key ^ pair_bits(b.y, b.z))};
}

static vec2_t next_2d(stream_t *stream)
{
    uint64_t bits = sampler_mix(stream->state += 0x9E3779B97F4A7C15u);
    return (vec2_t){sampler_float((uint32_t)(bits >> 32)), sampler_float((uint32_t)bits)};
}

static float next_1d(stream_t *stream)
{
    return next_2d(stream).x;
}

/* ---- the layers ---------------------------------------------------------------------------------------- */

/* The interfaces as lobes: those of the renderer. */
typedef struct {
    lobe_t through; /* the coat, transmitting alone */
    lobe_t back;    /* reflecting alone */
    lobe_t base;
    rgb_t base_colour;
    float thickness, g;
    rgb_t albedo;
    bool smooth, scatters;
} layers_t;

static void make_layers(const lobe_t *lobe, layers_t *layers)
{
    const lobe_layered_t *all = &lobe->layered;
    rgb_t white = {1, 1, 1};
    bool smooth = all->smooth, metal = all->has_metal;
    *layers = (layers_t){.base_colour = metal ? white : all->reflectance,
                         .thickness = all->thickness,
                         .g = all->g,
                         .albedo = all->albedo,
                         .smooth = smooth};
    layers->scatters = !v_is_zero(layers->albedo);
    layers->through.kind = smooth ? &lobe_smooth_dielectric : &lobe_rough_transmission;
    memcpy(layers->through.alpha, lobe->alpha, sizeof lobe->alpha);
    layers->through.dielectric.ior = all->ior;
    layers->back = layers->through;
    layers->through.dielectric.t = white;
    layers->back.dielectric.r = white;
    if (!smooth) layers->back.kind = &lobe_rough_reflection;
    layers->base.kind = metal ? &lobe_rough_conductor : &lobe_lambert;
    if (!metal) return;
    memcpy(layers->base.alpha, all->base_alpha, sizeof all->base_alpha);
    layers->base.conductor = all->metal;
}

/* Henyey and Greenstein's phase function (1941); `cos` of the angle by which light is turned. */
static float phase(float g, float cos)
{
    float d = 1 + g * g - 2 * g * cos;
    return INV_PI_F / 4 * (1 - g * g) / (d * sqrtf(d));
}

static vec3_t sample_phase(float g, vec3_t w, vec2_t u)
{
    float cos = 1 - 2 * u.x;
    if (fabsf(g) > 1e-3f) {
        float q = (1 - g * g) / (1 + g * cos);
        cos = float_clamp((1 + g * g - q * q) / (2 * g), -1, 1);
    }
    float sin = sqrtf(1 - cos * cos), phi = TWO_PI_F * u.y;
    vec3_t s, t;
    v_frame(w, &s, &t);
    vec3_t across = v_add(v_scale(s, sin * cosf(phi)), v_scale(t, sin * sinf(phi)));
    return v_normalize(v_mad(across, cos, w));
}

/* ---- walks --------------------------------------------------------------------------------------------- */

typedef struct {
    vec3_t w; /* where it goes */
    float z;  /* height above the base */
    rgb_t weight;
    float pdf; /* of w at the last scattering by the base or the medium; 0 before */
} walk_t;

/* How walks are joined to the direction in which they are to leave. */
typedef struct {
    vec3_t out;
    vec3_t up;    /* direction below the coat from which light is refracted into `out`, drawn from there */
    rgb_t weight; /* the coat's f |up.z| / pdf for radiance; 0 when nothing was drawn */
    float pdf;
    /* One step further back: light that leaves the base along `before_up` is reflected by the coat, and by
     * the base into `up`. Drawn from there, by base_both_ways. */
    vec3_t before_up;
    rgb_t before_weight; /* to `out` */
    float before_pdf;
} exit_t;

static bool draw(const lobe_t *lobe, vec3_t wo, transport_t mode, stream_t *stream, bsdf_sample_t *sample)
{
    return lobe->kind->sample(lobe, wo, next_2d(stream), 0.5f, mode, sample);
}

static float exit_share(const layers_t *layers, const exit_t *exit, float pdf)
{
    return layers->smooth ? 1 : power(exit->pdf, pdf);
}

/* On to the next interface, or to where the medium scatters first: then true. */
static bool fly(const layers_t *layers, walk_t *walk, stream_t *stream)
{
    bool up = walk->w.z > 0;
    if (layers->scatters) {
        float z = walk->z - walk->w.z * log1pf(-next_1d(stream));
        walk->z = z;
        if (up ? z < layers->thickness : z > 0) return true;
    } else {
        walk->weight = v_scale(walk->weight, fade(layers->thickness, walk->w));
    }
    walk->z = up ? layers->thickness : 0;
    return false;
}

static rgb_t scatter_in_medium(const layers_t *layers, const exit_t *exit, walk_t *walk, stream_t *stream)
{
    rgb_t left = {0, 0, 0};
    walk->weight = v_mul(walk->weight, layers->albedo);
    if (exit->pdf > 0) {
        float towards = phase(layers->g, v_dot(walk->w, exit->up));
        float value = towards * exit_share(layers, exit, towards) *
                      fade(layers->thickness - walk->z, exit->up) / exit->up.z;
        left = v_scale(v_mul(walk->weight, exit->weight), value);
    }
    vec3_t w = sample_phase(layers->g, walk->w, next_2d(stream));
    walk->pdf = phase(layers->g, v_dot(walk->w, w));
    walk->w = w;
    return left;
}

/* Where a coat is smooth, the way from the base to the coat and back is one direction, which can be drawn
 * from either end: a metal that is nearly smooth would, drawn from one alone, rarely be met and then be
 * dazzling. */
static bool base_both_ways(const layers_t *layers)
{
    return layers->smooth && !layers->scatters && layers->base.kind != &lobe_lambert;
}

static void draw_before(const layers_t *layers, stream_t *stream, exit_t *exit)
{
    bsdf_sample_t base, coat;
    exit->before_pdf = 0;
    if (!draw(&layers->base, exit->up, TRANSPORT_RADIANCE, stream, &base) ||
        !draw(&layers->back, v_neg(base.wi), TRANSPORT_RADIANCE, stream, &coat))
        return;
    float way = fade(layers->thickness, base.wi);
    exit->before_up = v_neg(coat.wi);
    exit->before_pdf = base.pdf;
    exit->before_weight = v_mul(v_mul(v_scale(base.weight, way * way), coat.weight),
                                v_scale(exit->weight, fade(layers->thickness, exit->up)));
}

static rgb_t join_before(const layers_t *layers, const exit_t *exit, const walk_t *walk)
{
    bsdf_value_t value;
    if (!(exit->before_pdf > 0) || !layers->base.kind->eval(&layers->base, v_neg(walk->w), exit->before_up,
                                                            true, TRANSPORT_IMPORTANCE, &value))
        return vec3(0, 0, 0);
    return v_scale(v_mul(v_mul(walk->weight, exit->before_weight), value.f),
                   power(exit->before_pdf, value.pdf));
}

static rgb_t meet_base(const layers_t *layers, const exit_t *exit, walk_t *walk, stream_t *stream)
{
    rgb_t left = {0, 0, 0};
    vec3_t from = v_neg(walk->w);
    bsdf_value_t value;
    bsdf_sample_t next = {.wi = {0, 0, 1}};
    walk->weight = v_mul(walk->weight, layers->base_colour);
    if (exit->pdf > 0 &&
        layers->base.kind->eval(&layers->base, from, exit->up, true, TRANSPORT_IMPORTANCE, &value)) {
        float factor = exit_share(layers, exit, value.pdf) * fade(layers->thickness, exit->up);
        if (walk->pdf > 0 && base_both_ways(layers)) factor *= power(walk->pdf, value.pdf_rev);
        left = v_scale(v_mul(v_mul(walk->weight, exit->weight), value.f), factor);
    }
    left = v_add(left, join_before(layers, exit, walk));
    if (!draw(&layers->base, from, TRANSPORT_IMPORTANCE, stream, &next)) next.weight = vec3(0, 0, 0);
    walk->weight = v_mul(walk->weight, next.weight);
    walk->w = next.wi;
    walk->pdf = next.pdf;
    return left;
}

/* Both transport modes agree on what enters and leaves; below the coat walks carry power (importance). */
static rgb_t meet_coat(const layers_t *layers, const exit_t *exit, walk_t *walk, stream_t *stream)
{
    rgb_t left = {0, 0, 0};
    vec3_t from = v_neg(walk->w);
    bsdf_value_t value;
    bsdf_sample_t next = {.wi = {0, 0, 1}};
    if (!layers->smooth &&
        layers->through.kind->eval(&layers->through, from, exit->out, false, TRANSPORT_IMPORTANCE, &value))
        left = v_scale(v_mul(walk->weight, value.f), power(walk->pdf, value.pdf_rev));
    if (!draw(&layers->back, from, TRANSPORT_IMPORTANCE, stream, &next)) next.weight = vec3(0, 0, 0);
    walk->weight = v_mul(walk->weight, next.weight);
    walk->w = next.wi;
    return left;
}

/* False when the walk ends. Walks below this weight end by Russian roulette. */
#define FAINT 0.25f

static bool roulette(walk_t *walk, stream_t *stream)
{
    float most = v_max(walk->weight);
    if (!(most > 0)) return false;
    if (most >= FAINT) return true;
    if (next_1d(stream) * FAINT >= most) return false;
    walk->weight = v_scale(walk->weight, FAINT / most);
    return true;
}

static rgb_t walk_through(const layers_t *layers, vec3_t wo, vec3_t wi, stream_t *stream)
{
    bsdf_sample_t in, out;
    rgb_t sum = {0, 0, 0};
    exit_t exit = {.out = wi};
    if (!draw(&layers->through, wo, TRANSPORT_IMPORTANCE, stream, &in)) return sum;
    if (draw(&layers->through, wi, TRANSPORT_RADIANCE, stream, &out)) {
        exit.up = v_neg(out.wi);
        exit.weight = out.weight;
        exit.pdf = out.pdf;
        if (base_both_ways(layers)) draw_before(layers, stream, &exit);
    } else if (layers->smooth) {
        return sum;
    }
    walk_t walk = {.w = in.wi, .z = layers->thickness, .weight = in.weight};
    for (int i = 0; i < LONGEST_WALK; i++) {
        rgb_t left;
        if (fly(layers, &walk, stream))
            left = scatter_in_medium(layers, &exit, &walk, stream);
        else if (walk.w.z > 0)
            left = meet_coat(layers, &exit, &walk, stream);
        else
            left = meet_base(layers, &exit, &walk, stream);
        sum = v_add(sum, left);
        if (!roulette(&walk, stream)) break;
    }
    return sum;
}

/* ---- densities ----------------------------------------------------------------------------------------- */

/* Chances of the three ways in which directions are drawn. */
typedef struct {
    float coat, base, cosine;
} mixture_t;

static mixture_t mixture_at(const lobe_t *lobe, vec3_t wo)
{
    mixture_t mixture = {0, 0, 0};
    if (lobe->layered.reflects) {
        float cos_t, f = fresnel_dielectric(float_min(wo.z, 1), lobe->layered.ior, &cos_t);
        mixture.coat = float_clamp(f / (f + 0.5f * (1 - f)), 0.05f, 0.9f);
    }
    float spread = 1;
    if (lobe->layered.has_metal) {
        spread = 0.15f;
        if (!v_is_zero(lobe->layered.albedo)) spread += 0.6f * (1 - expf(-2 * lobe->layered.thickness));
    }
    mixture.cosine = (1 - mixture.coat) * spread;
    mixture.base = (1 - mixture.coat) * (1 - spread);
    return mixture;
}

/* Alphas of the base as seen through a smooth coat: each way through the rough one tilts light by about
 * (1 - 1 / index) of the angle by which its normal is tilted, where reflection by the base does by twice. */
static void base_alphas(const lobe_t *lobe, float alpha[2])
{
    float bend = lobe->layered.smooth ? 0 : 1 - 1 / lobe->layered.ior;
    for (int i = 0; i < 2; i++) {
        float base = lobe->layered.base_alpha[i], coat = bend * lobe->alpha[i];
        alpha[i] = float_min(sqrtf(base * base + 0.5f * coat * coat), 1);
    }
}

/* The direction below a smooth coat, mirrored up; false at total reflection. */
static bool below(float ior, vec3_t w, vec3_t *inside)
{
    float x = w.x / ior, y = w.y / ior, z2 = 1 - x * x - y * y;
    *inside = vec3(x, y, sqrtf(float_max(z2, 0)));
    return z2 > 0;
}

/* Of drawing wi for wo about visible normals of the base, and back. */
static void base_densities(const lobe_t *lobe, vec3_t wo, vec3_t wi, float *pdf, float *pdf_rev)
{
    float ior = lobe->layered.ior, alpha[2];
    vec3_t a, b;
    microfacet_t facet;
    *pdf = *pdf_rev = 0;
    base_alphas(lobe, alpha);
    if (!below(ior, wo, &a) || !below(ior, wi, &b) ||
        !microfacet_reflection(alpha[0], alpha[1], a, b, &facet))
        return;
    /* The Jacobian of refraction: cos outside / (index^2 cos inside). */
    *pdf = facet.pdf * wi.z / (ior * ior * b.z);
    *pdf_rev = facet.pdf_rev * wo.z / (ior * ior * a.z);
}

static bool draw_base(const lobe_t *lobe, vec3_t wo, vec2_t u, vec3_t *wi)
{
    float ior = lobe->layered.ior, alpha[2];
    vec3_t a, b;
    base_alphas(lobe, alpha);
    return below(ior, wo, &a) && microfacet_mirror(alpha[0], alpha[1], a, u, &b) && below(1 / ior, b, wi);
}

/* For directions above the surface; `coat` is the reflection by the coat, or NULL. */
static void set_densities(const lobe_t *lobe, vec3_t wo, vec3_t wi, const microfacet_t *coat,
                          bsdf_value_t *value)
{
    mixture_t there = mixture_at(lobe, wo), back = mixture_at(lobe, wi);
    value->pdf = there.cosine * wi.z * INV_PI_F;
    value->pdf_rev = back.cosine * wo.z * INV_PI_F;
    if (coat != NULL) {
        value->pdf += there.coat * coat->pdf;
        value->pdf_rev += back.coat * coat->pdf_rev;
    }
    if (!lobe->layered.has_metal) return;
    float pdf, pdf_rev;
    base_densities(lobe, wo, wi, &pdf, &pdf_rev);
    value->pdf += there.base * pdf;
    value->pdf_rev += back.base * pdf_rev;
}

/* ---- the lobe ------------------------------------------------------------------------------------------ */

/* What comes from below the coat. */
static rgb_t eval_inside(const lobe_t *lobe, vec3_t wo, vec3_t wi)
{
    bool swap = wo.z != wi.z ? wo.z < wi.z : wo.x != wi.x ? wo.x < wi.x : wo.y < wi.y;
    vec3_t from = swap ? wi : wo, to = swap ? wo : wi;
    stream_t stream = stream_of(lobe->layered.seed, from, to);
    layers_t layers;
    make_layers(lobe, &layers);
    rgb_t sum = {0, 0, 0};
    for (int i = 0; i < WALKS; i++) sum = v_add(sum, walk_through(&layers, from, to, &stream));
    return v_scale(sum, 1.0f / WALKS);
}

static bool eval_above(const lobe_t *lobe, vec3_t wo, vec3_t wi, bsdf_value_t *value)
{
    float ax = lobe->alpha[0], ay = lobe->alpha[1], cos_t;
    if (!(wo.z > 0 && wi.z > 0)) return false;
    microfacet_t coat;
    bool reflects = lobe->layered.reflects && microfacet_reflection(ax, ay, wo, wi, &coat);
    set_densities(lobe, wo, wi, reflects ? &coat : NULL, value);
    value->f = eval_inside(lobe, wo, wi);
    if (reflects) {
        float f = fresnel_dielectric(coat.cos, lobe->layered.ior, &cos_t) * coat.density *
                  microfacet_correlated(coat.lambda_o, coat.lambda_i);
        value->f = v_add(value->f, vec3(f, f, f));
    }
    value->f = v_mul(value->f, lobe->layered.factor);
    return value->pdf > 0 && v_is_finite(value->f);
}

static bool draw_above(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, vec3_t *wi)
{
    mixture_t mixture = mixture_at(lobe, wo);
    if (choice < mixture.coat) return microfacet_mirror(lobe->alpha[0], lobe->alpha[1], wo, u, wi);
    if (choice < mixture.coat + mixture.base) return draw_base(lobe, wo, u, wi);
    *wi = warp_cosine_hemisphere(u);
    return true;
}

static void regularize(lobe_t *lobe)
{
    if (!lobe->layered.smooth) lobe_regularize_alphas(lobe);
    if (!lobe->layered.has_metal) return;
    lobe_regularize_pair(lobe->layered.base_alpha);
}

const lobe_kind_t lobe_layered = {.flags = LOBE_REFLECTS,
                                  .eval = lobe_eval_mirrored,
                                  .sample = lobe_sample_mirrored,
                                  .eval_above = eval_above,
                                  .draw_above = draw_above,
                                  .regularize = regularize};

/* ---- a smooth coat over Lambert ------------------------------------------------------------------------ */

float lobe_layered_returns(float ior, float thickness)
{
    /* Gauss-Legendre nodes and weights on [0, 1], five on each side of the critical angle. */
    static const float nodes[5] = {0.04691007f, 0.23076534f, 0.5f, 0.76923466f, 0.95308993f};
    static const float weights[5] = {0.11846344f, 0.23931434f, 0.28444444f, 0.23931434f, 0.11846344f};
    float critical = ior > 1 ? sqrtf(1 - 1 / (ior * ior)) : 0, sum = 0, cos_t;
    for (int i = 0; i < 5; i++) {
        float total = critical * nodes[i];
        sum += weights[i] * critical * 2 * total * expf(-2 * thickness / float_max(total, 1e-6f));
        /* Squared nodes: the reflectance rises like a square root at the critical angle. */
        float x = nodes[i] * nodes[i], c = critical + (1 - critical) * x;
        sum += weights[i] * 2 * nodes[i] * (1 - critical) * 2 * c * fresnel_dielectric(c, 1 / ior, &cos_t) *
               expf(-2 * thickness / float_max(c, 1e-6f));
    }
    return sum;
}

/* What passes the coat and the medium from w to the base. */
static float passes(const lobe_t *lobe, vec3_t w)
{
    float cos_t, f = fresnel_dielectric(float_min(w.z, 1), lobe->layered.ior, &cos_t);
    return cos_t > 0 ? (1 - f) * expf(-lobe->layered.thickness / cos_t) : 0;
}

static float series(float reflectance, float returns)
{
    return reflectance / (1 - float_min(reflectance * returns, 0.9999f));
}

static bool eval_lambert(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                         bsdf_value_t *value)
{
    (void)reflect, (void)mode;
    microfacet_upright(&wo, &wi);
    if (!(wo.z > 0 && wi.z > 0)) return false;
    float ior = lobe->layered.ior, back = lobe->layered.returns;
    float ways = passes(lobe, wo) * passes(lobe, wi) * INV_PI_F / (ior * ior);
    rgb_t base = lobe->layered.reflectance;
    value->f = v_scale(vec3(series(base.x, back), series(base.y, back), series(base.z, back)), ways);
    value->f = v_mul(value->f, lobe->layered.factor);
    value->pdf = wi.z * INV_PI_F;
    value->pdf_rev = wo.z * INV_PI_F;
    return true;
}

static bool sample_lambert(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                           bsdf_sample_t *s)
{
    (void)choice;
    vec3_t wi = warp_cosine_hemisphere(u);
    bsdf_value_t value;
    if (wo.z < 0) wi = v_neg(wi);
    if (!eval_lambert(lobe, wo, wi, true, mode, &value)) return false;
    *s = (bsdf_sample_t){
        .wi = wi, .weight = v_scale(value.f, PI_F), .pdf = value.pdf, .pdf_rev = value.pdf_rev};
    return true;
}

const lobe_kind_t lobe_coated_lambert = {
    .flags = LOBE_REFLECTS, .eval = eval_lambert, .sample = sample_lambert};

/* ---- mirrors ------------------------------------------------------------------------------------------- */

static void set_mirrored(vec3_t wo, rgb_t weight, bsdf_sample_t *s)
{
    *s = (bsdf_sample_t){
        .wi = vec3(-wo.x, -wo.y, wo.z), .weight = weight, .pdf = 1, .pdf_rev = 1, .specular = true};
}

/* The mirror reflection of a smooth coat. */
static bool sample_smooth_coat(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                               bsdf_sample_t *s)
{
    (void)u, (void)choice, (void)mode;
    float cos_t, f = fresnel_dielectric(float_min(fabsf(wo.z), 1), lobe->dielectric.ior, &cos_t);
    set_mirrored(wo, v_scale(lobe->dielectric.r, f), s);
    return f > 0;
}

/* A smooth coat over a smooth metal: R + T B T + T B R B T + ... */
static bool sample_smooth_layers(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                                 bsdf_sample_t *s)
{
    (void)u, (void)choice, (void)mode;
    float cos_t, f = fresnel_dielectric(float_min(fabsf(wo.z), 1), lobe->layered.ior, &cos_t);
    rgb_t sum = {f, f, f};
    if (cos_t > 0) {
        float way = expf(-2 * lobe->layered.thickness / cos_t);
        rgb_t base = fresnel_conductor(cos_t, lobe->layered.metal.eta, lobe->layered.metal.k);
        rgb_t there = v_scale(base, way);
        rgb_t below_coat = vec3(series(there.x, f), series(there.y, f), series(there.z, f));
        sum = v_mad(sum, (1 - f) * (1 - f), below_coat);
    }
    set_mirrored(wo, v_mul(sum, lobe->layered.factor), s);
    return true;
}

static void regularize_smooth_layers(lobe_t *lobe)
{
    lobe->kind = &lobe_layered;
    lobe->layered.smooth = false;
    lobe->layered.reflects = true;
    regularize(lobe);
}

static bool eval_rough_coat(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                            bsdf_value_t *value)
{
    microfacet_upright(&wo, &wi);
    return lobe_rough_reflection.eval(lobe, wo, wi, reflect, mode, value);
}

static bool sample_rough_coat(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                              bsdf_sample_t *s)
{
    if (wo.z > 0) return lobe_rough_reflection.sample(lobe, wo, u, choice, mode, s);
    if (!lobe_rough_reflection.sample(lobe, v_neg(wo), u, choice, mode, s)) return false;
    s->wi = v_neg(s->wi);
    return true;
}

/* Rough reflection, the same from both sides. */
const lobe_kind_t lobe_rough_coat = {.flags = LOBE_REFLECTS | LOBE_MICROFACETS,
                                     .eval = eval_rough_coat,
                                     .sample = sample_rough_coat,
                                     .regularize = lobe_regularize_alphas};

static void regularize_smooth_coat(lobe_t *lobe)
{
    lobe->kind = &lobe_rough_coat;
    lobe_regularize_alphas(lobe);
}

const lobe_kind_t lobe_smooth_coat = {.flags = LOBE_REFLECTS | LOBE_SPECULAR,
                                      .sample = sample_smooth_coat,
                                      .regularize = regularize_smooth_coat};
const lobe_kind_t lobe_smooth_layers = {.flags = LOBE_REFLECTS | LOBE_SPECULAR,
                                        .sample = sample_smooth_layers,
                                        .regularize = regularize_smooth_layers};
