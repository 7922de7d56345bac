/* The extensions of glTF's material that scatter in their own way, against the formulas of their
 * specifications, written down again in other arithmetic or integrated anew, and against what physics demands
 * of any BSDF: it draws as it says, it is reciprocal, and nothing is gained. */
#include "common/sampler.h"
#include "tests/scattering.h"
#include "worker/render/bsdf/film.h"
#include "worker/render/bsdf/lobe.h"
#include "worker/render/material/shading_frame.h"
#include "worker/render/sampling/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

/* White, without specular reflection. */
static blob_material_t white(float metallic, float roughness)
{
    blob_material_t m = {.kind = MATERIAL_GLTF, .flags = MATERIAL_REMAP_SQUARE | MATERIAL_THIN};
    m.values[VALUE_REFLECTANCE] = m.values[VALUE_SPECULAR_COLOUR] = blob_constant(1);
    m.values[VALUE_METALLIC] = blob_constant(metallic);
    m.values[VALUE_ROUGHNESS_U] = blob_constant(roughness);
    m.values[VALUE_ETA] = blob_constant(1.5f);
    return m;
}

static blob_material_t with(blob_material_t m, material_value_t value, float number)
{
    m.values[value] = blob_constant(number);
    return m;
}

static blob_material_t with_colour(blob_material_t m, material_value_t value, float r, float g, float b)
{
    m.values[value] = blob_colour_value(vec3(r, g, b));
    return m;
}

static blob_material_t velvet(blob_material_t m, float roughness)
{
    m = with(m, VALUE_SHEEN_ROUGHNESS, roughness);
    return with_colour(m, VALUE_SHEEN_COLOUR, 0.9f, 0.6f, 0.3f);
}

static blob_material_t brushed(blob_material_t m, float strength, float angle)
{
    m = with_colour(m, VALUE_ANISOTROPY_DIRECTION, 1, 0.5f, 0);
    m = with_colour(m, VALUE_ANISOTROPY_TURN, cosf(angle), sinf(angle), 0);
    return with(m, VALUE_ANISOTROPIC, strength);
}

static blob_material_t filmed(blob_material_t m, float strength, float eta, float thickness)
{
    m = with(with(m, VALUE_IRIDESCENCE, strength), VALUE_IRIDESCENCE_ETA, eta);
    return with(m, VALUE_IRIDESCENCE_THICKNESS, thickness);
}

static blob_material_t leaf(blob_material_t m, float share)
{
    m = with_colour(m, VALUE_TRANSMITTANCE, 0.9f, 0.7f, 0.2f);
    return with(m, VALUE_DIFFUSE_TRANSMISSION, share);
}

/* A solid of glass. */
static blob_material_t glass(float roughness)
{
    blob_material_t m = with(with(white(0, roughness), VALUE_TRANSMISSION, 1), VALUE_SPECULAR, 1);
    m.flags &= ~(uint32_t)MATERIAL_THIN;
    return m;
}

static blob_material_t prism(float roughness)
{
    return with(glass(roughness), VALUE_DISPERSION, 4);
}

static bsdf_t bsdf_of(blob_material_t material)
{
    scattering_t s;
    scattering_begin(&s, material);
    bsdf_t bsdf = s.bsdf;
    scattering_end(&s);
    return bsdf;
}

static rgb_t value_of(const bsdf_t *bsdf, vec3_t wo, vec3_t wi)
{
    bsdf_value_t value;
    return bsdf_eval(bsdf, wo, wi, TRANSPORT_RADIANCE, &value) ? value.f : vec3(0, 0, 0);
}

typedef struct {
    double c[3];
} mean_t;

/* The mean weight of samples of a subpath that carries the given channels. */
static mean_t albedo(const bsdf_t *bsdf, vec3_t wo, rgb_t carried, uint32_t samples)
{
    mean_t mean = {{0, 0, 0}};
    bsdf_t carrying = *bsdf;
    bsdf_carry(&carrying, carried);
    for (uint32_t i = 0; i < samples; i++) {
        sampler_t sampler = sampler_new(SAMPLER_SOBOL, 7, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (!bsdf_sample(&carrying, wo, u, sampler_1d(&sampler), TRANSPORT_IMPORTANCE, &sample)) continue;
        rgb_t weight = v_mul(sample.weight, carried);
        mean.c[0] += (double)weight.x / samples;
        mean.c[1] += (double)weight.y / samples;
        mean.c[2] += (double)weight.z / samples;
    }
    return mean;
}

static mean_t albedo_of(blob_material_t material, float cos, uint32_t samples)
{
    bsdf_t bsdf = bsdf_of(material);
    return albedo(&bsdf, scattering_direction(cos, 1), vec3(1, 1, 1), samples);
}

/* ---- what every lobe is asked -------------------------------------------------------------------------- */

static const struct {
    const char *name;
    float metallic, roughness, sheen, anisotropy, film, leaf;
    bool solid;
    float dispersion, coat;
} cases[] = {
    {.name = "velvet", .roughness = 1, .sheen = 0.4f},
    {.name = "coated velvet", .roughness = 0.5f, .sheen = 0.7f, .coat = 0.6f},
    {.name = "brushed metal", .metallic = 1, .roughness = 0.4f, .anisotropy = 0.6f},
    {.name = "iridescent half metal", .metallic = 0.5f, .roughness = 0.6f, .film = 0.8f},
    {.name = "iridescent glass", .roughness = 0.6f, .film = 1, .solid = true},
    {.name = "leaf", .roughness = 0.6f, .leaf = 0.6f},
    {.name = "rough prism", .roughness = 0.7f, .solid = true, .dispersion = 4},
};
enum { CASES = sizeof cases / sizeof *cases };

static blob_material_t case_material(size_t i)
{
    blob_material_t m = cases[i].solid
                            ? glass(cases[i].roughness)
                            : with(white(cases[i].metallic, cases[i].roughness), VALUE_SPECULAR, 1);
    m = with_colour(m, VALUE_REFLECTANCE, 0.8f, 0.5f, 0.2f);
    if (cases[i].sheen > 0) m = velvet(m, cases[i].sheen);
    if (cases[i].anisotropy > 0) m = brushed(m, cases[i].anisotropy, 0.5f);
    if (cases[i].film > 0) m = filmed(m, cases[i].film, 1.8f, 350);
    if (cases[i].leaf > 0) m = leaf(m, cases[i].leaf);
    m = with(with(m, VALUE_CLEARCOAT, cases[i].coat), VALUE_CLEARCOAT_ROUGHNESS, 0.5f);
    return with(m, VALUE_DISPERSION, cases[i].dispersion);
}

static void sampling_matches_densities(void **state)
{
    (void)state;
    for (size_t i = 0; i < CASES; i++) {
        bsdf_t bsdf = bsdf_of(case_material(i));
        scattering_check_densities(&bsdf);
        scattering_check_draws(&bsdf, scattering_direction(i % 2 ? -0.4f : 0.8f, 2));
    }
    /* What is smooth becomes rough. */
    bsdf_t regular = bsdf_of(prism(0));
    assert_true(regular.specular);
    bsdf_regularize(&regular);
    assert_false(regular.specular);
    scattering_check_draws(&regular, scattering_direction(-0.7f, 1));
}

static void scattering_is_reciprocal(void **state)
{
    (void)state;
    for (size_t k = 0; k < CASES; k++) {
        bsdf_t bsdf = bsdf_of(case_material(k));
        int compared = 0;
        for (uint32_t i = 0; i < 2000; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 4, 0, i);
            vec3_t a = warp_sphere(sampler_2d(&sampler)), b = warp_sphere(sampler_2d(&sampler));
            bsdf_value_t there = {.f = {0, 0, 0}}, back = {.f = {0, 0, 0}};
            bsdf_eval(&bsdf, a, b, TRANSPORT_RADIANCE, &there);
            bsdf_eval(&bsdf, b, a, TRANSPORT_IMPORTANCE, &back);
            if (fabsf(a.z) < 0.01f || fabsf(b.z) < 0.01f) continue;
            const float f[3] = {there.f.x, there.f.y, there.f.z}, g[3] = {back.f.x, back.f.y, back.f.z};
            for (int c = 0; c < 3; c++)
                if (!(fabsf(f[c] - g[c]) <= 4e-3f * f[c] + 1e-6f))
                    fail_msg("%s: %g and %g", cases[k].name, (double)f[c], (double)g[c]);
            compared += v_max(there.f) > 0;
        }
        assert_true(compared > 500);
    }
}

static void extreme_values_are_harmless(void **state)
{
    (void)state;
    const float extremes[] = {0, -1, 1, 1e-30f, 1e30f, 1e-3f};
    const material_value_t values[] = {
        VALUE_SHEEN_COLOUR,         VALUE_SHEEN_ROUGHNESS, VALUE_ANISOTROPIC,     VALUE_ANISOTROPY_DIRECTION,
        VALUE_ANISOTROPY_TURN,      VALUE_IRIDESCENCE,     VALUE_IRIDESCENCE_ETA, VALUE_IRIDESCENCE_THICKNESS,
        VALUE_DIFFUSE_TRANSMISSION, VALUE_TRANSMITTANCE,   VALUE_DISPERSION,      VALUE_ETA,
        VALUE_ROUGHNESS_U};
    enum { VALUES = sizeof values / sizeof *values };
    for (uint32_t i = 0; i < 700; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 8, 0, i);
        blob_material_t m = case_material(i % CASES);
        for (int j = 0; j < 4; j++) {
            vec2_t u = sampler_2d(&sampler);
            m = with(m, values[(int)(u.x * VALUES)], extremes[(int)(u.y * 6)]);
        }
        bsdf_t bsdf = bsdf_of(m);
        scattering_check_finite(&bsdf, i, 1e-5f);
        bsdf_carry(&bsdf, vec3(0, 1, 0));
        scattering_check_finite(&bsdf, i, 1e-5f);
    }
}

/* ---- sheen --------------------------------------------------------------------------------------------- */

static double fit(double x, double alpha)
{
    double m = pow(1 - alpha, 2);
    double a = 21.5473 * (1 - m) + 25.3245 * m, b = 3.82987 * (1 - m) + 3.32435 * m,
           c = 0.19823 * (1 - m) + 0.16801 * m, d = -1.97760 * (1 - m) - 1.27393 * m,
           e = -4.32054 * (1 - m) - 4.85967 * m;
    return a / (1 + b * pow(x, c)) + d * x + e;
}

static double lambda(double cos, double alpha)
{
    return cos < 0.5 ? exp(fit(cos, alpha)) : exp(2 * fit(0.5, alpha) - fit(1 - cos, alpha));
}

/* The specification's f of a white sheen. */
static double charlie(double nv, double nl, double cos_between, double roughness)
{
    double alpha = roughness * roughness, nh2 = (nv + nl) * (nv + nl) / (2 + 2 * cos_between);
    double d = (2 + 1 / alpha) * pow(fmax(0, 1 - nh2), 0.5 / alpha) / (2 * M_PI);
    nv = fmax(nv, 1e-3), nl = fmax(nl, 1e-3);
    return d / ((1 + lambda(nv, alpha) + lambda(nl, alpha)) * 4 * nv * nl);
}

/* The light that it throws back: over the square root of the cosine, and half the azimuths. */
static double charlie_albedo(double nv, double roughness)
{
    enum { STEPS = 80 };
    double sum = 0;
    for (int i = 0; i < STEPS; i++)
        for (int j = 0; j < STEPS; j++) {
            double root = (i + 0.5) / STEPS, nl = root * root, phi = M_PI * (j + 0.5) / STEPS;
            double between = nv * nl + sqrt((1 - nv * nv) * (1 - nl * nl)) * cos(phi);
            sum += charlie(nv, nl, between, roughness) * nl * 2 * root * 2 * M_PI / (STEPS * STEPS);
        }
    return sum;
}

static void sheen_keeps_its_table(void **state)
{
    (void)state;
    for (int i = 0; i < 9; i++) {
        double roughness = 0.1 + 0.9 * (i + 0.3) / 9, mean = 0;
        for (int j = 0; j < 12; j++) {
            double cos = (j + 0.4) / 12, truth = fmin(charlie_albedo(cos, roughness), 1);
            double found = (double)lobe_sheen_albedo((float)cos, (float)roughness);
            if (!(fabs(found - truth) < 0.02))
                fail_msg("E(%g, %g) is %g, not %g", cos, roughness, found, truth);
            mean += 2 * cos * truth / 12;
        }
        assert_true(fabs((double)lobe_sheen_mean((float)roughness) - mean) < 0.03);
    }
}

static void sheen_follows_its_formula(void **state)
{
    (void)state;
    const double colour[3] = {0.9, 0.6, 0.3}, roughness = 0.5;
    bsdf_t bare = bsdf_of(white(0.4f, 0.5f)), covered = bsdf_of(velvet(white(0.4f, 0.5f), 0.5f));
    for (uint32_t i = 0; i < 25; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
        vec3_t v = warp_cosine_hemisphere(sampler_2d(&sampler)),
               l = warp_cosine_hemisphere(sampler_2d(&sampler));
        rgb_t base = value_of(&bare, v, l), both = value_of(&covered, v, l);
        double left =
            1 - 0.9 * fmax(charlie_albedo((double)v.z, roughness), charlie_albedo((double)l.z, roughness));
        double sheen = charlie((double)v.z, (double)l.z, (double)v_dot(v, l), roughness);
        const float f[3] = {both.x, both.y, both.z}, below[3] = {base.x, base.y, base.z};
        for (int c = 0; c < 3; c++)
            assert_true(fabs((double)f[c] - colour[c] * sheen - (double)below[c] * left) <
                        0.01 * (double)below[c] + 1e-3);
        /* The same from behind. */
        assert_float_equal(value_of(&covered, v_neg(v), v_neg(l)).x, both.x, 1e-5f * both.x);
    }
}

static void sheen_gains_nothing(void **state)
{
    (void)state;
    const float roughness[] = {0, 0.3f, 0.6f, 1};
    for (int k = 0; k < 4; k++)
        for (int i = 1; i <= 4; i++) {
            blob_material_t mirror = with(white(1, 0), VALUE_SHEEN_ROUGHNESS, roughness[k]);
            mirror = with(mirror, VALUE_SHEEN_COLOUR, 1);
            /* What the sheen leaves, a white mirror gives back. */
            double kept = albedo_of(mirror, 0.25f * (float)i, 8000).c[0];
            assert_true(fabs(kept - 1) < 0.02);
            assert_true(albedo_of(with(mirror, VALUE_METALLIC, 0), 0.25f * (float)i, 8000).c[0] < 1.005);
        }
}

/* ---- anisotropy ---------------------------------------------------------------------------------------- */

/* The specification's D and V, with the tangent at an angle to x. */
static double brushed_value(vec3_t v, vec3_t l, double alpha, double strength, double angle)
{
    double at = alpha + (1 - alpha) * strength * strength, c = cos(angle), s = sin(angle);
    double hx = (double)v.x + (double)l.x, hy = (double)v.y + (double)l.y, hz = (double)v.z + (double)l.z;
    double h = sqrt(hx * hx + hy * hy + hz * hz), th = (c * hx + s * hy) / h, bh = (-s * hx + c * hy) / h;
    double a2 = at * alpha, x = alpha * th, y = at * bh, z = a2 * hz / h;
    double d = a2 * pow(a2 / (x * x + y * y + z * z), 2) / M_PI;
    double tv = c * (double)v.x + s * (double)v.y, bv = -s * (double)v.x + c * (double)v.y,
           tl = c * (double)l.x + s * (double)l.y, bl = -s * (double)l.x + c * (double)l.y;
    double gv = (double)l.z * sqrt(pow(at * tv, 2) + pow(alpha * bv, 2) + pow((double)v.z, 2));
    double gl = (double)v.z * sqrt(pow(at * tl, 2) + pow(alpha * bl, 2) + pow((double)l.z, 2));
    return d * 0.5 / (gv + gl);
}

static void anisotropy_follows_its_formula(void **state)
{
    (void)state;
    const double angles[] = {0, 0.5, -2};
    for (int k = 0; k < 3; k++) {
        bsdf_t bsdf = bsdf_of(brushed(white(1, 0.5f), 0.7f, (float)angles[k]));
        for (uint32_t i = 0; i < 500; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
            vec3_t v = warp_cosine_hemisphere(sampler_2d(&sampler)),
                   l = warp_cosine_hemisphere(sampler_2d(&sampler));
            double truth = brushed_value(v, l, 0.25, 0.7, angles[k]), found = (double)value_of(&bsdf, v, l).x;
            if (!(fabs(found - truth) < 2e-3 * truth + 1e-5)) fail_msg("%g for %g", found, truth);
        }
    }
    /* A direction that a texture gives, and that the angle turns further. */
    bsdf_t turned = bsdf_of(brushed(white(1, 0.5f), 0.7f, 1.2f)),
           by_both = bsdf_of(with_colour(brushed(white(1, 0.5f), 0.7f, 1), VALUE_ANISOTROPY_DIRECTION,
                                         0.5f + 0.3f * cosf(0.2f), 0.5f + 0.3f * sinf(0.2f), 0));
    vec3_t v = scattering_direction(0.8f, 0.3f), l = scattering_direction(0.6f, 2);
    assert_float_equal(value_of(&turned, v, l).x, value_of(&by_both, v, l).x, 1e-4f);
    mean_t kept = albedo_of(brushed(white(1, 0.1f), 0.5f, 0), 0.9f, 8000);
    assert_true(kept.c[0] > 0.9 && kept.c[0] < 1.001);
}

/* Counter-clockwise as the texture has it: the other way round where that is mirrored. */
static void anisotropy_turns_with_the_texture(void **state)
{
    (void)state;
    scattering_t s;
    blob_material_t m = brushed(white(1, 0.5f), 0.7f, 0.5f);
    scattering_begin(&s, m);
    for (int mirrored = 0; mirrored < 2; mirrored++) {
        float sign = mirrored ? -1.0f : 1.0f;
        surface_details_t details = {.dpdu = {1, 0, 0}, .dpdv = {0, sign, 0}};
        texture_point_t at = {.p = {0, 0, 0}};
        shading_frame_turn(&s.bsdf, s.scene, &m, &details, &at);
        assert_float_equal(s.bsdf.s.x, cosf(0.5f), 1e-6f);
        assert_float_equal(s.bsdf.s.y, sign * sinf(0.5f), 1e-6f);
    }
    scattering_end(&s);
}

/* ---- iridescence --------------------------------------------------------------------------------------- */

static double schlick(double f0, double cos)
{
    return f0 + (1 - f0) * pow(1 - cos, 5);
}

/* Airy's reflectance of a film: both interfaces' with the cosine of the phase between them, whose sign says
 * which of them turn the phase over. */
static double airy(double upper, double lower, double sign, double phase)
{
    double wave = 2 * sign * sqrt(upper * lower) * cos(phase);
    return (upper + lower + wave) / (1 + upper * lower + wave);
}

/* The integral of it over wave numbers, by the Gaussians of the eye's matching functions, in linear sRGB. */
static void film_truth(double eta, double base, double nm, double cos, double rgb[3])
{
    static const double gaussian[4][3] = {{5.4856e-13, 1.6810e6, 4.3278e9},
                                          {4.4201e-13, 1.7953e6, 9.3046e9},
                                          {5.2481e-13, 2.2084e6, 6.6121e9},
                                          {9.7470e-14, 2.2399e6, 4.5282e9}};
    static const double to_rgb[3][3] = {{3.2404542, -1.5371385, -0.4985314},
                                        {-0.9692660, 1.8760108, 0.0415560},
                                        {0.0556434, -0.2040259, 1.0572252}};
    double inside = sqrt(1 - (1 - cos * cos) / (eta * eta)),
           upper = schlick(pow((eta - 1) / (eta + 1), 2), cos),
           lower = schlick(pow((base - eta) / (base + eta), 2), inside);
    double mean = upper + pow(1 - upper, 2) * lower / (1 - upper * lower), xyz[3] = {0, 0, 0};
    for (int g = 0; g < 4; g++) {
        double weight = gaussian[g][0] * sqrt(2 * M_PI * gaussian[g][2]) / 1.0685e-7, sum = 0, norm = 0;
        for (int i = -300; i <= 300; i++) {
            double x = i / 75.0, at = gaussian[g][1] + x * sqrt(2 * gaussian[g][2]);
            double phase = 2 * M_PI * 2 * eta * nm * 1e-9 * inside * at;
            sum += exp(-x * x / 2) * (airy(upper, lower, base < eta ? -1 : 1, phase) - mean);
            norm += exp(-x * x / 2);
        }
        xyz[g % 3] += weight * sum / norm;
    }
    for (int c = 0; c < 3; c++)
        rgb[c] = mean + to_rgb[c][0] * xyz[0] + to_rgb[c][1] * xyz[1] + to_rgb[c][2] * xyz[2];
}

static void films_interfere_as_waves(void **state)
{
    (void)state;
    double contrast = 0;
    for (int k = 0; k < 60; k++) {
        double eta = 1.2 + 0.2 * (k % 5), base = k % 2 ? 1.5 : 3, nm = 40.0 * k, cos = 0.3 + 0.14 * (k % 6);
        double rgb[3], f0 = pow((base - 1) / (base + 1), 2);
        film_truth(eta, base, nm, cos, rgb);
        lobe_film_t film = {1, (float)eta, (float)nm, {0}};
        rgb_t found = film_reflectance(&film, vec3((float)f0, (float)f0, (float)f0), (float)cos);
        const float f[3] = {found.x, found.y, found.z};
        for (int c = 0; c < 3; c++)
            if (!(fabs((double)f[c] - fmin(fmax(rgb[c], 0), 1)) < 0.02))
                fail_msg("eta %g on %g, %g nm, cos %g: %g for %g", eta, base, nm, cos, (double)f[c], rgb[c]);
        contrast = fmax(contrast, fabs(rgb[0] - rgb[2]));
    }
    assert_true(contrast > 0.2);
    /* No light passes beyond the critical angle; none is below 0 or above 1. */
    for (int k = 0; k < 200; k++) {
        lobe_film_t film = {1, 1 + 0.02f * (float)k, 5 * (float)k, {0}};
        rgb_t r = film_reflectance(&film, vec3(0.02f, 0.5f, 1), 0.005f * (float)k);
        assert_true(r.x >= 0 && r.y >= 0 && r.z >= 0 && v_max(r) <= 1);
    }
}

static void films_cover_by_their_strength(void **state)
{
    (void)state;
    vec3_t wo = scattering_direction(0.7f, 1), wi = scattering_direction(0.6f, 3.5f);
    float cos = 0.5f * v_length(v_add(wo, wi));
    for (int metal = 0; metal < 2; metal++) {
        blob_material_t m = with(white((float)metal, 0.5f), VALUE_SPECULAR, 1);
        m = with_colour(m, VALUE_REFLECTANCE, 0.9f, 0.5f, 0.2f);
        bsdf_t none = bsdf_of(m), half = bsdf_of(filmed(m, 0.5f, 1.8f, 400)),
               full = bsdf_of(filmed(m, 1, 1.8f, 400)), bright = bsdf_of(with(white(1, 0.5f), VALUE_ETA, 1));
        rgb_t a = value_of(&none, wo, wi), b = value_of(&half, wo, wi), c = value_of(&full, wo, wi);
        /* The base has what the largest channel leaves, which is no mean; metal has none. */
        if (metal) assert_float_equal(b.y, 0.5f * (a.y + c.y), 1e-4f);
        float facets = value_of(&bright, wo, wi).x; /* of white metal */
        lobe_film_t film = {1, 1.8f, 400, {0}};
        rgb_t f0 = metal ? vec3(0.9f, 0.5f, 0.2f) : vec3(0.04f, 0.04f, 0.04f),
              f = film_reflectance(&film, f0, cos);
        rgb_t base = metal ? vec3(0, 0, 0) : v_scale(vec3(0.9f, 0.5f, 0.2f), INV_PI_F * (1 - v_max(f)));
        assert_float_equal(c.x, base.x + f.x * facets, 2e-3f * c.x);
        assert_float_equal(c.z, base.z + f.z * facets, 2e-3f * c.z);
    }
}

static void films_lose_nothing_of_glass(void **state)
{
    (void)state;
    for (int k = 0; k < 6; k++) {
        float cos = (k % 2 ? -1.0f : 1.0f) * (0.3f + 0.3f * (float)(k / 2));
        mean_t sum = albedo_of(filmed(glass(0), 0.9f, 1.7f, 500), cos, 8000);
        for (int c = 0; c < 3; c++) assert_true(fabs(sum.c[c] - 1) < 0.01);
        /* Filmed sheets, by the standard, keep less, and never more. */
        mean_t sheet =
            albedo_of(filmed(with(with(white(0, 0), VALUE_SPECULAR, 1), VALUE_TRANSMISSION, 1), 1, 1.7f, 500),
                      cos, 8000);
        for (int c = 0; c < 3; c++) assert_true(sheet.c[c] > 0.5 && sheet.c[c] < 1.005);
    }
}

/* ---- diffuse transmission ------------------------------------------------------------------------------ */

static void leaves_share_out_the_light(void **state)
{
    (void)state;
    const vec3_t wo = scattering_direction(0.6f, 1), wi = scattering_direction(0.8f, 2), away = v_neg(wi);
    bsdf_t bsdf = bsdf_of(leaf(white(0, 1), 0.25f));
    assert_float_equal(value_of(&bsdf, wo, wi).x, 0.75f * INV_PI_F, 1e-5f);
    assert_float_equal(value_of(&bsdf, wo, away).x, 0.25f * 0.9f * INV_PI_F, 1e-5f);
    assert_float_equal(value_of(&bsdf, v_neg(wo), wi).z, 0.25f * 0.2f * INV_PI_F, 1e-5f);
    /* A clear transmission goes first, and metal has none; the coat of gloss is on both sides of the base. */
    bsdf_t clear = bsdf_of(with(leaf(white(0, 1), 1), VALUE_TRANSMISSION, 1));
    assert_true(value_of(&clear, wo, wi).x == 0);
    bsdf_t metal = bsdf_of(leaf(white(1, 1), 1));
    assert_true(value_of(&metal, wo, away).x == 0);
    blob_material_t glossy = with(leaf(white(0, 0.5f), 1), VALUE_SPECULAR, 1);
    bsdf_t with_gloss = bsdf_of(glossy);
    float half = 0.5f * v_length(v_add(wo, vec3(away.x, away.y, -away.z)));
    assert_float_equal(value_of(&with_gloss, wo, away).x,
                       0.9f * INV_PI_F * (1 - (0.04f + 0.96f * powf(1 - half, 5))), 1e-4f);
    for (int i = 1; i <= 4; i++) {
        blob_material_t paper = with(leaf(white(0, 1), 0.5f), VALUE_TRANSMITTANCE, 1);
        assert_true(fabs(albedo_of(paper, 0.25f * (float)i, 4000).c[0] - 1) < 1e-3);
    }
    /* A body fades inside; a sheet has no inside. */
    glossy = with(glossy, VALUE_ATTENUATION, 2);
    assert_false(bsdf_of(glossy).absorbs);
    glossy.flags &= ~(uint32_t)MATERIAL_THIN;
    assert_true(bsdf_of(glossy).absorbs);
}

/* ---- dispersion ---------------------------------------------------------------------------------------- */

/* Blue is bent more than red, each by its own index, 20 / Abbe number = 4 / 20 of the distance to 1 apart. */
static void prisms_split_colours(void **state)
{
    (void)state;
    bsdf_t bsdf = bsdf_of(prism(0));
    vec3_t wo = scattering_direction(0.6f, 0);
    const double eta[3] = {1.45, 1.5, 1.55};
    int seen[3] = {0, 0, 0}, reflections = 0;
    for (uint32_t i = 0; i < 300; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        assert_true(bsdf_sample(&bsdf, wo, u, sampler_1d(&sampler), TRANSPORT_IMPORTANCE, &sample));
        const float w[3] = {sample.weight.x, sample.weight.y, sample.weight.z};
        if (sample.wi.z > 0) {
            reflections++;
            assert_true(w[0] > 0 && w[0] < w[1] && w[1] < w[2]); /* all of them together */
            continue;
        }
        int channel = w[0] > 0 ? 0 : w[1] > 0 ? 1 : 2;
        assert_true((w[0] > 0) + (w[1] > 0) + (w[2] > 0) == 1);
        assert_true(fabs((double)sample.wi.x + 0.8 / eta[channel]) < 1e-5);
        seen[channel]++;
    }
    assert_true(reflections > 5 && seen[0] > 50 && seen[1] > 50 && seen[2] > 50);
}

static void prisms_lose_nothing(void **state)
{
    (void)state;
    static const rgb_t carried[] = {{1, 1, 1}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}};
    for (int rough = 0; rough < 2; rough++) {
        bsdf_t bsdf = bsdf_of(prism(rough ? 0.15f : 0));
        for (int k = 0; k < 4; k++) {
            /* From the inside also where red gets out, and blue does not. */
            vec3_t wo = scattering_direction(k == 0 ? 0.5f : k == 1 ? -0.9f : k == 2 ? -0.745f : 0.95f, 1);
            for (int j = 0; j < 5; j++) {
                mean_t sum = albedo(&bsdf, wo, carried[j], rough ? 16000 : 8000);
                const float c[3] = {carried[j].x, carried[j].y, carried[j].z};
                for (int i = 0; i < 3; i++)
                    if (!(fabs(sum.c[i] - (double)c[i]) < 0.03))
                        fail_msg("%s, cos %g, carried %d: channel %d keeps %g", rough ? "rough" : "smooth",
                                 (double)wo.z, j, i, sum.c[i]);
            }
        }
    }
}

/* Once a subpath has one colour its samples are that colour's, and no dearer. */
static void one_colour_is_chosen_once(void **state)
{
    (void)state;
    bsdf_t bsdf = bsdf_of(prism(0));
    bsdf_carry(&bsdf, vec3(0, 0, 0.5f));
    for (uint32_t i = 0; i < 200; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        assert_true(bsdf_sample(&bsdf, scattering_direction(0.6f, 0), u, sampler_1d(&sampler),
                                TRANSPORT_IMPORTANCE, &sample));
        assert_float_equal(sample.weight.z, 1, 1e-5f);
    }
    /* The claimed densities do not change with it. */
    bsdf_t rough = bsdf_of(prism(0.5f)), carrying = rough;
    bsdf_carry(&carrying, vec3(0, 0, 1));
    scattering_check_densities(&carrying);
    bsdf_value_t a, b;
    vec3_t wo = scattering_direction(0.6f, 0), wi = scattering_direction(-0.7f, 3);
    assert_true(bsdf_eval(&rough, wo, wi, TRANSPORT_RADIANCE, &a));
    assert_true(bsdf_eval(&carrying, wo, wi, TRANSPORT_RADIANCE, &b));
    assert_true(a.pdf == b.pdf && a.pdf_rev == b.pdf_rev && a.f.x == b.f.x && a.f.x > 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sampling_matches_densities),     cmocka_unit_test(scattering_is_reciprocal),
        cmocka_unit_test(extreme_values_are_harmless),    cmocka_unit_test(sheen_keeps_its_table),
        cmocka_unit_test(sheen_follows_its_formula),      cmocka_unit_test(sheen_gains_nothing),
        cmocka_unit_test(anisotropy_follows_its_formula), cmocka_unit_test(anisotropy_turns_with_the_texture),
        cmocka_unit_test(films_interfere_as_waves),       cmocka_unit_test(films_cover_by_their_strength),
        cmocka_unit_test(films_lose_nothing_of_glass),    cmocka_unit_test(leaves_share_out_the_light),
        cmocka_unit_test(prisms_split_colours),           cmocka_unit_test(prisms_lose_nothing),
        cmocka_unit_test(one_colour_is_chosen_once),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
