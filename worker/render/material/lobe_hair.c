/* lobe_hair: how a hair scatters light, near by (Chiang, Bitterli, Tappan and Burley 2016, "A Practical and
 * Controllable Hair and Fur Model for Production Path Tracing"; Pharr 2016, "The Implementation of a Hair
 * Scattering Model").
 *
 * A hair is a cylinder of glass that absorbs, with tilted scales. x runs along it. theta is the angle of a
 * direction to the cross-section, phi the azimuth in it. The eye sees it at an offset h from its middle.
 * Light goes by four modes p: reflected (R), through (TT), reflected once inside (TRT), and all the rest.
 * Each is a product (Chiang et al., equation 1; d'Eon et al. 2011, "An Energy-Conserving Hair Reflectance
 * Model"):
 *
 *   S_p(o, i) = A_p(theta_o, h) M_p(theta_i, theta_o) N_p(phi_i - phi_o, theta_o, h)
 *
 * A_p is attenuation, M_p and N_p are densities, per cos theta dtheta and per dphi. So the integral of S over
 * all directions i of light is the sum of A_p, which is 1 where nothing is absorbed. The value is S over the
 * cosine of i to the normal, since the renderer multiplies by it.
 *
 * The eye's direction o and the light's i do not change places: h is the eye's, and A_p is taken at o. So in
 * both transport modes the value is that of light which goes from i to o. Directions of light subpaths are
 * drawn as if o were i, with the offset -h, at which a ray from i meets the point that mirrors it to o: N_p
 * is the same then, but for refraction.
 *
 * An evaluation wants the modes as seen from o, and as seen from i: eight LANES, kept side by side, for which
 * the compiler makes vector instructions. */
#include "worker/render/bsdf/lobe.h"

enum { MODES = 4, LANES = 2 * MODES }; /* R, TT, TRT, the rest: from o, then from i */

/* ---- functions ----------------------------------------------------------------------------------------- */

/* exp(x) of x <= 1, to within 1e-5 of itself; 0 below -87. 2^f of the rest is its Taylor series. */
static inline void exponentials(const float x[LANES], float e[LANES])
{
    for (int k = 0; k < LANES; k++) {
        float y = float_max(x[k] * 1.44269504f, -126), n = rintf(y), f = (y - n) * 0.69314718f;
        union {
            int32_t bits;
            float power;
        } two = {.bits = ((int32_t)n + 127) << 23};
        float series =
            1 + f * (1 + f * (0.5f + f * (1 / 6.0f + f * (1 / 24.0f + f * (1 / 120.0f + f * (1 / 720.0f))))));
        e[k] = y > -126 ? two.power * series : 0;
    }
}

/* Abramowitz and Stegun, 4.4.46; to within 1e-7. */
static inline float arc_sine(float x)
{
    float a = fabsf(x);
    float series = 1.5707963f + a * (-0.2145988f + a * (0.0889789880f + a * -0.0501743046f));
    series +=
        a * a * a * a * (0.0308918810f + a * (-0.0170881256f + a * (0.0066700901f + a * -0.0012624911f)));
    return copysignf(0.5f * PI_F - sqrtf(float_max(1 - a, 0)) * series, x);
}

/* Abramowitz and Stegun, 4.4.49; to within 1e-7. 0 for no direction. */
static inline float azimuth_of(float x, float y)
{
    float ax = fabsf(x), ay = fabsf(y), large = float_max(ax, ay), small = float_min(ax, ay);
    float t = large > 0 ? small / large : 0, t2 = t * t;
    float series =
        1 + t2 * (-0.3333314528f + t2 * (0.1999355085f + t2 * (-0.1420889944f + t2 * 0.1065626393f)));
    float t8 = t2 * t2 * t2 * t2;
    series += t8 * t2 * (-0.0752896400f + t2 * (0.0429096138f + t2 * (-0.0161657367f + t2 * 0.0028662257f)));
    float angle = t * series;
    if (ay > ax) angle = 0.5f * PI_F - angle;
    if (x < 0) angle = PI_F - angle;
    return y < 0 ? -angle : angle;
}

/* I_0(x) of Bessel (Abramowitz and Stegun, 9.8.1), and exp(-x) times it for larger x (9.8.2). */
static inline float bessel_small(float x)
{
    float t = x * (1 / 3.75f), t2 = t * t;
    return 1 + t2 * (3.5156229f +
                     t2 * (3.0899424f +
                           t2 * (1.2067492f + t2 * (0.2659732f + t2 * (0.0360768f + t2 * 0.0045813f)))));
}

static inline float bessel_scaled(float x)
{
    float r = 3.75f / x;
    float series =
        0.00916281f + r * (-0.02057706f + r * (0.02635537f + r * (-0.01647633f + r * 0.00392377f)));
    return (0.39894228f + r * (0.01328592f + r * (0.00225319f + r * (-0.00157565f + r * series)))) / sqrtf(x);
}

/* ---- attenuation --------------------------------------------------------------------------------------- */

/* What depends on one direction, which the hair is looked at from. */
typedef struct {
    float sine, cosine; /* theta */
    float gamma_t;      /* of the refracted ray in the cross-section */
    float length;       /* of the way through, in radii */
    float fresnel;
    rgb_t a[MODES];
    float chances[MODES]; /* in proportion to a */
} look_t;

static inline void look_along(const lobe_hair_t *hair, float sine, look_t *look)
{
    float eta = hair->ior, sine2 = sine * sine, cosine_f;
    look->sine = sine;
    look->cosine = sqrtf(float_max(0, 1 - sine2));
    /* Bravais: in the cross-section the index is eta' = sqrt(eta^2 - sin^2 theta) / cos theta. */
    float sine_t = float_clamp(hair->h * look->cosine / sqrtf(float_max(eta * eta - sine2, 1e-6f)), -1, 1);
    look->gamma_t = arc_sine(sine_t);
    look->length = 2 * sqrtf((1 - sine_t * sine_t) / float_max(1 - sine2 / (eta * eta), 1e-6f));
    look->fresnel = fresnel_dielectric(look->cosine * sqrtf(1 - hair->h * hair->h), eta, &cosine_f);
}

/* A_p (Chiang et al., equations 12 and 13), with the sum of the geometric series for the rest; `through` is
 * what absorption leaves on the way through. */
static inline void attenuate(look_t *look, rgb_t through)
{
    float f = look->fresnel;
    rgb_t inside = v_scale(through, f); /* what is left after each further way */
    rgb_t *a = look->a;
    a[0] = vec3(f, f, f);
    a[1] = v_scale(through, (1 - f) * (1 - f));
    a[2] = v_mul(a[1], inside);
    rgb_t last = v_mul(a[2], inside);
    a[3] = vec3(last.x / float_max(1 - inside.x, 1e-6f), last.y / float_max(1 - inside.y, 1e-6f),
                last.z / float_max(1 - inside.z, 1e-6f));
    float chances[MODES] = {f, rgb_luminance(a[1]), rgb_luminance(a[2]), rgb_luminance(a[3])};
    float sum = chances[0] + chances[1] + chances[2] + chances[3], scale = sum > 0 ? 1 / sum : 0;
    for (int p = 0; p < MODES; p++) look->chances[p] = chances[p] * scale;
}

/* Looks from two directions. */
static inline void look_both(const lobe_hair_t *hair, float sine_o, float sine_i, look_t looks[2])
{
    float lengths[LANES], left[LANES];
    look_along(hair, sine_o, &looks[0]);
    look_along(hair, sine_i, &looks[1]);
    const float absorption[3] = {hair->absorption.x, hair->absorption.y, hair->absorption.z};
    for (int k = 0; k < LANES; k++)
        lengths[k] = k % MODES < 3 ? -looks[k / MODES].length * absorption[k % MODES] : 0;
    exponentials(lengths, left);
    for (int k = 0; k < 2; k++)
        attenuate(&looks[k], vec3(left[MODES * k], left[MODES * k + 1], left[MODES * k + 2]));
}

/* From one alone. */
static void look_from(const lobe_hair_t *hair, float sine, look_t *look)
{
    rgb_t a = hair->absorption;
    look_along(hair, sine, look);
    attenuate(look, vec3(expf(-look->length * a.x), expf(-look->length * a.y), expf(-look->length * a.z)));
}

rgb_t lobe_hair_albedo(const lobe_hair_t *hair)
{
    look_t look;
    look_from(hair, 0, &look);
    return v_add(v_add(look.a[0], look.a[1]), v_add(look.a[2], look.a[3]));
}

/* ---- along the hair ------------------------------------------------------------------------------------ */

/* 1 / v and exp(-2 / v) of a mode; the variances are v, v / 4 and 4 v (Chiang et al., section 4.1). */
typedef struct {
    float narrowness, gap;
} spread_t;

static inline spread_t spread_of(const lobe_hair_t *hair, int p)
{
    if (p >= 2) return (spread_t){hair->narrowness, hair->gap};
    float square = hair->gap * hair->gap, fourth = square * square;
    if (p == 0) return (spread_t){4 * hair->narrowness, fourth};
    fourth *= fourth;
    return (spread_t){16 * hair->narrowness, fourth * fourth};
}

/* M_p (d'Eon et al. 2011, equation 7): exp(-b) I_0(a) / (2 v sinh(1 / v)), with a = cos cos / v and b = sin
 * sin / v. Scales turn theta_o (Chiang et al., section 4.1), maybe beyond a right angle. */
static inline void longitudinals(const lobe_hair_t *hair, const look_t looks[2], float m[LANES])
{
    const float sines[MODES] = {hair->sine[0], hair->sine[1], hair->sine[2], 0};
    const float cosines[MODES] = {hair->cosine[0], hair->cosine[1], hair->cosine[2], 1};
    const float n = hair->narrowness, narrowness[MODES] = {4 * n, 16 * n, n, n};
    float a[LANES], exponents[LANES], e[LANES], factors[MODES];
    for (int p = 0; p < MODES; p++) factors[p] = narrowness[p] / (1 - spread_of(hair, p).gap);
    for (int k = 0; k < 2; k++) {
        float sine_o = looks[k].sine, cosine_o = looks[k].cosine;
        float sine_i = looks[1 - k].sine, cosine_i = looks[1 - k].cosine;
        for (int p = 0; p < MODES; p++) {
            float sine = sine_o * cosines[p] + cosine_o * sines[p];
            float cosine = fabsf(cosine_o * cosines[p] - sine_o * sines[p]);
            a[MODES * k + p] = cosine_i * cosine * narrowness[p];
            exponents[MODES * k + p] = -sine_i * sine * narrowness[p] - narrowness[p];
        }
    }
    for (int k = 0; k < LANES; k++) exponents[k] += a[k] < 3.75f ? 0 : a[k];
    exponentials(exponents, e);
    for (int k = 0; k < LANES; k++) {
        float small = bessel_small(float_min(a[k], 3.75f)), scaled = bessel_scaled(float_max(a[k], 3.75f));
        m[k] = e[k] * (a[k] < 3.75f ? small : scaled);
    }
    for (int p = 0; p < MODES; p++) m[p] *= factors[p], m[MODES + p] *= factors[p];
}

/* ---- about the hair ------------------------------------------------------------------------------------ */

/* How far the perfect cylinder turns light of a mode (Marschner et al. 2003, "Light Scattering from Human
 * Hair Fibers"): 2 p gamma_t - 2 gamma_o + p pi. */
static inline float deflection(const lobe_hair_t *hair, int p, float gamma_t)
{
    return (float)p * (2 * gamma_t + PI_F) - 2 * hair->gamma;
}

/* N_p (Chiang et al., equation 11): of p < 3 a logistic distribution on (-pi, pi). */
static inline void azimuthals(const lobe_hair_t *hair, const look_t looks[2], float phi, float n[LANES])
{
    float x[LANES], e[LANES];
    for (int k = 0; k < 2; k++)
        for (int p = 0; p < MODES; p++) x[MODES * k + p] = phi - deflection(hair, p, looks[k].gamma_t);
    for (int k = 0; k < LANES; k++)
        x[k] = -fabsf(x[k] - TWO_PI_F * rintf(x[k] * (0.5f * INV_PI_F))) * hair->inv_scale;
    exponentials(x, e);
    for (int k = 0; k < LANES; k++) n[k] = hair->norm * hair->inv_scale * e[k] / ((1 + e[k]) * (1 + e[k]));
    n[3] = n[7] = 0.5f * INV_PI_F;
}

/* ---- the lobe ------------------------------------------------------------------------------------------ */

static inline float cosine_of(vec3_t w)
{
    return float_max(fabsf(w.z), 1e-6f);
}

/* The value for light that goes from i to o, with the density of i as the eye would draw it and that of o as
 * light would. */
static bool evaluate(const lobe_t *lobe, vec3_t o, vec3_t i, bsdf_value_t *value)
{
    const lobe_hair_t *hair = &lobe->hair;
    look_t looks[2]; /* from o, from i */
    float m[LANES], n[LANES], phi = azimuth_of(o.y * i.y + o.z * i.z, o.y * i.z - o.z * i.y);
    look_both(hair, o.x, i.x, looks);
    longitudinals(hair, looks, m);
    azimuthals(hair, looks, phi, n);
    *value = (bsdf_value_t){.pdf = 0};
    for (int p = 0; p < MODES; p++) {
        float density = m[p] * n[p];
        value->f = v_mad(value->f, density, looks[0].a[p]);
        value->pdf += density * looks[0].chances[p];
        value->pdf_rev += m[MODES + p] * n[MODES + p] * looks[1].chances[p];
    }
    value->f = v_scale(v_mul(value->f, hair->factor), 1 / cosine_of(i));
    return lobe_is_sane(value);
}

static bool eval_hair(const lobe_t *lobe, vec3_t wo, vec3_t wi, bool reflect, transport_t mode,
                      bsdf_value_t *value)
{
    (void)reflect;
    if (mode == TRANSPORT_RADIANCE) return evaluate(lobe, wo, wi, value);
    if (!evaluate(lobe, wi, wo, value)) return false;
    float pdf = value->pdf;
    value->pdf = value->pdf_rev;
    value->pdf_rev = pdf;
    return true;
}

/* The mode that *choice falls on; *choice is stretched to [0, 1) again. */
static int choose_mode(const float chances[MODES], float *choice)
{
    int p = 0;
    float left = *choice;
    while (p < MODES - 1 && left >= chances[p]) left -= chances[p++];
    *choice = float_clamp(left / float_max(chances[p], 1e-30f), 0, 0x1.fffffep-1f);
    return p;
}

/* Draws from M_p (d'Eon, Marschner and Hanika 2013, "Importance Sampling for Physically-Based Hair Fiber
 * Models"). Returns sin theta. */
static float draw_along(const lobe_hair_t *hair, int p, const look_t *from, vec2_t u)
{
    spread_t spread = spread_of(hair, p);
    float turn = p < 3 ? hair->sine[p] : 0, keep = p < 3 ? hair->cosine[p] : 1;
    float sine_o = from->sine * keep + from->cosine * turn,
          cosine_o = from->cosine * keep - from->sine * turn;
    float x = float_max(u.x, 0x1p-25f);
    float cosine = float_max(1 + logf(x + (1 - x) * spread.gap) / spread.narrowness, -1);
    float sine = sqrtf(float_max(0, 1 - cosine * cosine));
    return float_clamp(sine * cosf(TWO_PI_F * u.y) * cosine_o - cosine * sine_o, -1, 1);
}

/* Draws from N_p by the inverse of its distribution. Returns the difference of the azimuths. */
static float draw_about(const lobe_hair_t *hair, int p, const look_t *from, float u)
{
    if (p == 3) return TWO_PI_F * u;
    float below = 0.5f - 0.5f / hair->norm; /* of the distribution at -pi */
    float at = below + u / hair->norm;
    float x = float_clamp(-logf(float_max(1 / at - 1, 1e-30f)) / hair->inv_scale, -PI_F, PI_F);
    return deflection(hair, p, from->gamma_t) + x;
}

static bool sample_hair(const lobe_t *lobe, vec3_t wo, vec2_t u, float choice, transport_t mode,
                        bsdf_sample_t *sample)
{
    const lobe_hair_t *hair = &lobe->hair;
    look_t from;
    look_from(hair, wo.x, &from);
    int p = choose_mode(from.chances, &choice);
    float sine = draw_along(hair, p, &from, u), cosine = sqrtf(float_max(0, 1 - sine * sine));
    float turned = draw_about(hair, p, &from, choice);
    if (mode == TRANSPORT_IMPORTANCE) turned = -turned;
    float c = cosf(turned) * cosine, s = sinf(turned) * cosine, across = sqrtf(wo.y * wo.y + wo.z * wo.z);
    vec2_t azimuth = across > 0 ? (vec2_t){wo.y / across, wo.z / across} : (vec2_t){1, 0};
    vec3_t wi = vec3(sine, c * azimuth.x - s * azimuth.y, s * azimuth.x + c * azimuth.y);
    bsdf_value_t value;
    if (!eval_hair(lobe, wo, wi, true, mode, &value) || !(value.pdf > 0)) return false;
    *sample = (bsdf_sample_t){.wi = wi,
                              .weight = v_scale(value.f, cosine_of(wi) / value.pdf),
                              .pdf = value.pdf,
                              .pdf_rev = value.pdf_rev};
    return true;
}

const lobe_kind_t lobe_hair = {
    .flags = LOBE_REFLECTS | LOBE_TRANSMITS, .eval = eval_hair, .sample = sample_hair};
