/* glTF's material against the formulas of its standard, written down again in other arithmetic, and against
 * what physics demands. */
#include "common/sampler.h"
#include "tests/scattering.h"
#include "worker/render/bsdf/lobe.h"
#include "worker/render/sampling/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

static const double colour[3] = {0.8, 0.5, 0.1};

/* The standard's defaults with a colour. */
static blob_material_t plain(float metallic, float roughness)
{
    blob_material_t m = {.kind = MATERIAL_GLTF, .flags = MATERIAL_REMAP_SQUARE | MATERIAL_THIN};
    m.values[VALUE_REFLECTANCE] =
        blob_colour_value(vec3((float)colour[0], (float)colour[1], (float)colour[2]));
    m.values[VALUE_METALLIC] = blob_constant(metallic);
    m.values[VALUE_ROUGHNESS_U] = blob_constant(roughness);
    m.values[VALUE_ETA] = blob_constant(1.5f);
    m.values[VALUE_SPECULAR] = m.values[VALUE_SPECULAR_COLOUR] = blob_constant(1);
    return m;
}

static blob_material_t with(blob_material_t m, material_value_t value, float number)
{
    m.values[value] = blob_constant(number);
    return m;
}

static blob_material_t solid(blob_material_t m)
{
    m.flags &= ~(uint32_t)MATERIAL_THIN;
    return m;
}

/* White below a coat whose normal is tilted, as scattering.h has it. */
static blob_material_t tilted_coat(float metallic, float roughness, float coat_roughness)
{
    blob_material_t m = with(plain(metallic, roughness), VALUE_CLEARCOAT, 0.8f);
    m = with(with(m, VALUE_REFLECTANCE, 1), VALUE_CLEARCOAT_ROUGHNESS, coat_roughness);
    m.flags |= MATERIAL_COAT_NORMAL;
    m.coat_normal_map = 1;
    m.coat_normal_scale = 1;
    return m;
}

/* ---- the standard's formulas --------------------------------------------------------------------------- */

typedef struct {
    double metallic, alpha, ior, specular, tint[3], coat, coat_alpha;
} gltf_t;

static double schlick(double f0, double f90, double cos)
{
    return f0 + (f90 - f0) * pow(1 - cos, 5);
}

/* D times the joint shadowing over 4 NL NV. */
static double facets(double alpha, double nv, double nl, double nh)
{
    double a2 = alpha * alpha, d = nh * nh * (a2 - 1) + 1;
    double v = nl * sqrt(nv * nv * (1 - a2) + a2) + nv * sqrt(nl * nl * (1 - a2) + a2);
    return a2 / (M_PI * d * d) * 0.5 / v;
}

static double standard(const gltf_t *g, int channel, vec3_t v, vec3_t l)
{
    double nv = (double)v.z, nl = (double)l.z;
    double hx = (double)v.x + (double)l.x, hy = (double)v.y + (double)l.y, hz = nv + nl;
    double h = sqrt(hx * hx + hy * hy + hz * hz), nh = hz / h, vh = h / 2;
    double f0 = pow((g->ior - 1) / (g->ior + 1), 2), most = 0;
    for (int i = 0; i < 3; i++)
        most = fmax(most, schlick(fmin(f0 * g->tint[i], 1) * g->specular, g->specular, vh));
    double glossy = facets(g->alpha, nv, nl, nh);
    double fresnel = schlick(fmin(f0 * g->tint[channel], 1) * g->specular, g->specular, vh);
    double dielectric = (1 - most) * colour[channel] / M_PI + fresnel * glossy;
    double metal = glossy * schlick(colour[channel], 1, vh);
    double below = (1 - g->metallic) * dielectric + g->metallic * metal;
    if (g->coat == 0) return below;
    return below * (1 - g->coat * schlick(0.04, 1, fmin(nv, nl))) +
           g->coat * schlick(0.04, 1, vh) * facets(g->coat_alpha, nv, nl, nh);
}

static void values_are_the_standards(void **state)
{
    (void)state;
    const gltf_t models[] = {
        {0, 0.25, 1.5, 1, {1, 1, 1}, 0, 0},        {1, 0.25, 1.5, 1, {1, 1, 1}, 0, 0},
        {0.3, 0.64, 1.5, 1, {1, 1, 1}, 0, 0},      {0, 0.16, 1.8, 0.6, {1, 0.5, 1.2}, 0, 0},
        {0.5, 0.36, 1.33, 1, {30, 1, 60}, 0, 0},   {0, 0.25, 0, 0.5, {1, 1, 1}, 0, 0},
        {0.2, 0.49, 1.5, 1, {1, 1, 1}, 0.7, 0.09},
    };
    for (size_t k = 0; k < sizeof models / sizeof *models; k++) {
        const gltf_t *g = &models[k];
        blob_material_t m = plain((float)g->metallic, (float)sqrt(g->alpha));
        m = with(m, VALUE_ETA, (float)g->ior);
        m = with(m, VALUE_SPECULAR, (float)g->specular);
        m = with(m, VALUE_CLEARCOAT, (float)g->coat);
        m = with(m, VALUE_CLEARCOAT_ROUGHNESS, (float)sqrt(g->coat_alpha));
        m.values[VALUE_SPECULAR_COLOUR] =
            blob_colour_value(vec3((float)g->tint[0], (float)g->tint[1], (float)g->tint[2]));
        scattering_t s;
        scattering_begin(&s, m);
        for (uint32_t i = 0; i < 1000; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
            vec3_t v = warp_cosine_hemisphere(sampler_2d(&sampler)),
                   l = warp_cosine_hemisphere(sampler_2d(&sampler));
            bsdf_value_t value, behind;
            assert_true(bsdf_eval(&s.bsdf, v, l, TRANSPORT_RADIANCE, &value));
            const float f[3] = {value.f.x, value.f.y, value.f.z};
            for (int c = 0; c < 3; c++) {
                double truth = standard(g, c, v, l);
                if (!(fabs((double)f[c] - truth) <= 1e-3 * truth + 1e-5))
                    fail_msg("model %zu, channel %d: %g for %g", k, c, (double)f[c], truth);
            }
            /* The same from behind. */
            assert_true(bsdf_eval(&s.bsdf, v_neg(v), v_neg(l), TRANSPORT_RADIANCE, &behind));
            assert_float_equal(behind.f.x, value.f.x, 1e-5f * value.f.x);
        }
        scattering_end(&s);
    }
}

/* The coat's part is that of a level one, where both directions are turned back by what the normal is turned,
 * times the ratio of the cosines. */
static void a_tilted_coat_is_a_level_one_turned(void **state)
{
    (void)state;
    const vec3_t n = v_normalize(vec3(0.4f, -0.2f, 1));
    vec3_t s, t;
    v_frame(n, &s, &t);
    scattering_t tilted;
    scattering_begin(&tilted, tilted_coat(0, 1, 0.4f));
    double alpha = 0.16, seen = 0;
    for (uint32_t i = 0; i < 1000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 9, 0, i);
        vec3_t a = warp_cosine_hemisphere(sampler_2d(&sampler)),
               b = warp_cosine_hemisphere(sampler_2d(&sampler));
        double v = (double)v_dot(a, n), l = (double)v_dot(b, n), h = (double)v_length(v_add(a, b)) / 2;
        double most = 1 - 0.96 * pow(1 - h, 5) - 0.04, grazing = fmin(fabs(v), fabs(l));
        double below = 1 - 0.8 * schlick(0.04, 1, grazing), coat = 0, base = below * most / M_PI;
        base +=
            below * schlick(0.04, 1, h) * facets(1, (double)a.z, (double)b.z, (double)(a.z + b.z) / (2 * h));
        if (v > 1e-3 && l > 1e-3)
            coat = 0.8 * schlick(0.04, 1, h) * facets(alpha, v, l, (v + l) / (2 * h)) * l / (double)b.z;
        bsdf_value_t value;
        assert_true(bsdf_eval(&tilted.bsdf, a, b, TRANSPORT_RADIANCE, &value));
        if (fabs(v) < 1e-3 || fabs(l) < 1e-3) continue;
        assert_float_equal((double)value.f.y, base + coat, 2e-3 * (base + coat));
        seen += coat > 0.1 * base;
    }
    assert_true(seen > 10);
    scattering_end(&tilted);
}

/* What Blender writes of a surface without specular reflection, and of a mirror. */
static void no_specular_colour_is_lambert(void **state)
{
    (void)state;
    blob_material_t m = with(with(plain(0, 1), VALUE_SPECULAR_COLOUR, 0), VALUE_ETA, 1.45f);
    scattering_t s;
    scattering_begin(&s, m);
    assert_int_equal(s.bsdf.count, 1);
    for (uint32_t i = 0; i < 1000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
        bsdf_value_t value;
        assert_true(bsdf_eval(&s.bsdf, warp_cosine_hemisphere(sampler_2d(&sampler)),
                              warp_cosine_hemisphere(sampler_2d(&sampler)), TRANSPORT_RADIANCE, &value));
        assert_float_equal(value.f.y, 0.5f / PI_F, 1e-6f);
    }
    scattering_end(&s);
    scattering_begin(&s, with(plain(1, 0), VALUE_SPECULAR_COLOUR, 0));
    assert_int_equal(s.bsdf.count, 1);
    assert_true(s.bsdf.specular);
    bsdf_sample_t sample;
    vec3_t wo = scattering_direction(0.5f, 1);
    assert_true(bsdf_sample(&s.bsdf, wo, (vec2_t){0, 0}, 0.5f, TRANSPORT_RADIANCE, &sample));
    assert_true(sample.specular);
    assert_float_equal(sample.weight.y, schlick(0.5, 1, 0.5), 1e-5f);
    assert_float_equal(sample.wi.x, -wo.x, 1e-6f);
    assert_float_equal(sample.wi.z, wo.z, 1e-6f);
    scattering_end(&s);
}

/* ---- physics ------------------------------------------------------------------------------------------- */

static void sampling_matches_densities(void **state)
{
    (void)state;
    blob_material_t coated =
        with(with(plain(0.3f, 0.7f), VALUE_CLEARCOAT, 0.8f), VALUE_CLEARCOAT_ROUGHNESS, 0.5f);
    const blob_material_t materials[] = {
        plain(0, 0.5f),
        plain(0, 0),
        plain(1, 0.6f),
        coated,
        with(coated, VALUE_CLEARCOAT_ROUGHNESS, 0),
        with(plain(0, 0.6f), VALUE_TRANSMISSION, 0.7f),
        with(solid(plain(0, 0.6f)), VALUE_TRANSMISSION, 0.7f),
        with(solid(plain(0.2f, 0.6f)), VALUE_TRANSMISSION, 1),
        tilted_coat(1, 0.6f, 0.5f),
        with(tilted_coat(0, 1, 0), VALUE_TRANSMISSION, 0.5f),
    };
    for (size_t i = 0; i < sizeof materials / sizeof *materials; i++) {
        scattering_t s;
        scattering_begin(&s, materials[i]);
        scattering_check_densities(&s.bsdf);
        scattering_check_draws(&s.bsdf, scattering_direction(0.8f, 1));
        scattering_check_draws(&s.bsdf, scattering_direction(-0.4f, 2));
        bsdf_regularize(&s.bsdf);
        scattering_check_draws(&s.bsdf, scattering_direction(0.5f, 1));
        scattering_end(&s);
    }
}

/* Refraction, seen as light goes, is the reverse of refraction seen as the eye looks. */
static void scattering_is_reciprocal(void **state)
{
    (void)state;
    blob_material_t coated =
        with(with(plain(0.3f, 0.7f), VALUE_CLEARCOAT, 0.8f), VALUE_CLEARCOAT_ROUGHNESS, 0.5f);
    const blob_material_t materials[] = {
        coated,
        with(coated, VALUE_TRANSMISSION, 0.7f),
        with(solid(plain(0, 0.6f)), VALUE_TRANSMISSION, 0.7f),
        with(solid(coated), VALUE_TRANSMISSION, 0.7f),
        with(tilted_coat(0.5f, 0.6f, 0.5f), VALUE_TRANSMISSION, 0.7f),
    };
    for (size_t k = 0; k < sizeof materials / sizeof *materials; k++) {
        scattering_t s;
        scattering_begin(&s, materials[k]);
        int across = 0;
        for (uint32_t i = 0; i < 3000; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 4, 0, i);
            vec3_t a = warp_sphere(sampler_2d(&sampler)), b = warp_sphere(sampler_2d(&sampler));
            bsdf_value_t there, back;
            bool any = bsdf_eval(&s.bsdf, a, b, TRANSPORT_RADIANCE, &there);
            assert_int_equal(any, bsdf_eval(&s.bsdf, b, a, TRANSPORT_IMPORTANCE, &back));
            if (!any) continue;
            assert_float_equal(there.f.y, back.f.y, 2e-3f * there.f.y + 1e-6f);
            across += a.z * b.z < 0 && there.f.y > 0;
        }
        assert_int_equal(across > 0, k > 0);
        scattering_end(&s);
    }
}

static double albedo_from(blob_material_t m, vec3_t wo, transport_t mode)
{
    scattering_t s;
    scattering_begin(&s, m);
    scattering_mean_t mean = scattering_albedo(&s.bsdf, wo, mode, 100000);
    assert_true(mean.error < 0.005);
    scattering_end(&s);
    return mean.mean;
}

static double albedo(blob_material_t m, float cos)
{
    return albedo_from(m, scattering_direction(cos, 1), TRANSPORT_IMPORTANCE);
}

/* In a white furnace nothing is brighter than white, from whatever side of the coat one looks. */
static void a_tilted_coat_adds_no_energy(void **state)
{
    (void)state;
    for (int i = 0; i < 12; i++) {
        vec3_t wo = scattering_direction(0.15f + 0.2f * (float)(i % 4), 2 * (float)i);
        for (int k = 0; k < 4; k++) {
            double a =
                albedo_from(tilted_coat(1, k & 1 ? 0.5f : 0, k & 2 ? 0.4f : 0), wo, TRANSPORT_RADIANCE);
            if (!(a > 0.2 && a < 1.005)) fail_msg("albedo %g at cosine %g", a, (double)wo.z);
        }
    }
}

static void clear_and_metal_surfaces_keep_energy(void **state)
{
    (void)state;
    for (int i = 1; i <= 5; i++) {
        float cos = 0.2f * (float)i;
        blob_material_t glass = with(with(plain(0, 0), VALUE_REFLECTANCE, 1), VALUE_TRANSMISSION, 1);
        assert_true(fabs(albedo(glass, cos) - 1) < 5e-3);
        assert_true(fabs(albedo(solid(glass), cos) - 1) < 5e-3);
        assert_true(fabs(albedo(solid(glass), -cos) - 1) < 5e-3);
        blob_material_t metal = with(plain(1, 0), VALUE_REFLECTANCE, 1);
        assert_true(fabs(albedo(metal, cos) - 1) < 1e-3);
        double rough = albedo(with(metal, VALUE_ROUGHNESS_U, 0.5f), cos);
        assert_true(rough > 0.8 && rough < 1.001);
        /* A coat adds nothing to what is white already. */
        blob_material_t coated = with(metal, VALUE_CLEARCOAT, 1);
        assert_true(fabs(albedo(coated, cos) - 1) < 5e-3);
        assert_true(albedo(with(coated, VALUE_ROUGHNESS_U, 0.5f), cos) < 1.005);
        coated = with(with(plain(0, 1), VALUE_SPECULAR, 0), VALUE_CLEARCOAT, 1);
        assert_true(albedo(with(coated, VALUE_REFLECTANCE, 1), cos) < 1.005);
        assert_true(albedo(with(coated, VALUE_REFLECTANCE, 1), cos) > 0.8);
    }
}

/* The standard's sum is a little more than one for white at grazing angles: its diffuse part knows only what
 * the specular reflects about the microfacet normal. This says how much. */
static void white_dielectric_is_near_one(void **state)
{
    (void)state;
    double sum = 0;
    for (int i = 0; i < 10; i++) {
        float cos = ((float)i + 0.5f) / 10;
        double a = albedo(with(plain(0, 0.5f), VALUE_REFLECTANCE, 1), cos);
        assert_true(a > 0.9);
        sum += 0.2 * (double)cos * a;
    }
    assert_true(sum > 0.95 && sum < 1.05);
}

static void solids_absorb_and_sheets_do_not(void **state)
{
    (void)state;
    blob_material_t glass = with(with(plain(0, 0.3f), VALUE_TRANSMISSION, 1), VALUE_ATTENUATION, 2);
    scattering_t s;
    scattering_begin(&s, glass);
    assert_false(s.bsdf.absorbs);
    scattering_end(&s);
    scattering_begin(&s, solid(glass));
    assert_true(s.bsdf.absorbs);
    assert_float_equal(bsdf_attenuation(&s.bsdf, vec3(0, 0, -1)).x, 2, 0);
    assert_float_equal(bsdf_attenuation(&s.bsdf, vec3(0, 0, 1)).x, 0, 0);
    scattering_end(&s);
    scattering_begin(&s, solid(with(glass, VALUE_TRANSMISSION, 0)));
    assert_false(s.bsdf.absorbs);
    scattering_end(&s);
}

/* A thin sheet blurs what it lets through about the way straight on; the base tints it. */
static void thin_transmission_goes_straight(void **state)
{
    (void)state;
    blob_material_t sheet = with(plain(0, 0.3f), VALUE_TRANSMISSION, 1);
    scattering_t s;
    scattering_begin(&s, sheet);
    vec3_t wo = scattering_direction(0.7f, 0.5f), bent = scattering_direction(-0.4f, 0.5f + PI_F);
    bsdf_value_t on, off;
    assert_true(bsdf_eval(&s.bsdf, wo, v_neg(wo), TRANSPORT_RADIANCE, &on));
    assert_true(bsdf_eval(&s.bsdf, wo, bent, TRANSPORT_RADIANCE, &off));
    assert_true(on.f.x > 5 * off.f.x);
    assert_float_equal(on.f.y / on.f.x, colour[1] / colour[0], 1e-4f);
    scattering_end(&s);
    scattering_begin(&s, with(sheet, VALUE_ROUGHNESS_U, 0));
    bsdf_sample_t sample;
    assert_true(bsdf_sample(&s.bsdf, wo, (vec2_t){0, 0}, 0.999f, TRANSPORT_RADIANCE, &sample));
    assert_true(sample.specular);
    assert_float_equal(v_dot(sample.wi, wo), -1, 1e-5f);
    scattering_end(&s);
}

static void extreme_values_are_harmless(void **state)
{
    (void)state;
    const float extremes[] = {0, -1, 1, 1e-30f, 1e30f, 1e-3f};
    const material_value_t values[] = {
        VALUE_REFLECTANCE,     VALUE_METALLIC,  VALUE_ROUGHNESS_U,         VALUE_ETA,         VALUE_SPECULAR,
        VALUE_SPECULAR_COLOUR, VALUE_CLEARCOAT, VALUE_CLEARCOAT_ROUGHNESS, VALUE_TRANSMISSION};
    for (uint32_t i = 0; i < 600; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 8, 0, i);
        blob_material_t m = plain(i % 3 * 0.5f, 0.4f);
        if (i % 2) m = solid(m);
        for (int j = 0; j < 4; j++) {
            vec2_t u = sampler_2d(&sampler);
            m = with(m, values[(int)(u.x * 9)], extremes[(int)(u.y * 6)]);
        }
        scattering_t s;
        scattering_begin(&s, m);
        scattering_check_finite(&s.bsdf, i, 1e-5f);
        scattering_end(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(values_are_the_standards),
        cmocka_unit_test(no_specular_colour_is_lambert),
        cmocka_unit_test(sampling_matches_densities),
        cmocka_unit_test(scattering_is_reciprocal),
        cmocka_unit_test(a_tilted_coat_is_a_level_one_turned),
        cmocka_unit_test(a_tilted_coat_adds_no_energy),
        cmocka_unit_test(clear_and_metal_surfaces_keep_energy),
        cmocka_unit_test(white_dielectric_is_near_one),
        cmocka_unit_test(solids_absorb_and_sheets_do_not),
        cmocka_unit_test(thin_transmission_goes_straight),
        cmocka_unit_test(extreme_values_are_harmless),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
