/* Every material and lobe against what any BSDF must obey: samples follow the density that evaluation claims,
 * forwards and backwards; the sampled weight is the value over that density, and misses nothing; radiance and
 * importance are adjoint; nothing shines that is not lit. And single materials against closed forms. The
 * random numbers are fixed, so a result is pass or fail for good. */
#include "common/sampler.h"
#include "tests/chi_square.h"
#include "tests/render_here.h"
#include "worker/render/bsdf/fresnel.h"
#include "worker/render/bsdf/lobe.h"
#include "worker/render/material/material.h"
#include "worker/render/material/shading_frame.h"
#include "worker/render/sampling/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* ---- materials ----------------------------------------------------------------------------------------- */

typedef struct {
    const char *name;
    blob_material_t material;
    bool lossy; /* may not throw back more than it gets; the rest are Disney's, Duer's and hair, which do not
                   promise that */
} test_case_t;

#define NUMBER(place, x) .values[place] = {{x, x, x}, 0}
#define COLOUR(place, r, g, b) .values[place] = {{r, g, b}, 0}
#define ROUGHNESS(u, v) NUMBER(VALUE_ROUGHNESS_U, u), NUMBER(VALUE_ROUGHNESS_V, v)
#define GLASS(eta) NUMBER(VALUE_REFLECTANCE, 1), NUMBER(VALUE_TRANSMITTANCE, 1), NUMBER(VALUE_ETA, eta)
#define GOLD COLOUR(VALUE_ETA, 0.143f, 0.375f, 1.442f), COLOUR(VALUE_K, 3.983f, 2.386f, 1.603f)
#define DISNEY                                                                                               \
    .kind = MATERIAL_DISNEY, COLOUR(VALUE_REFLECTANCE, 0.6f, 0.4f, 0.2f), NUMBER(VALUE_ETA, 1.5f),           \
    NUMBER(VALUE_DIFFUSE_TRANSMISSION, 1)

#define WARD COLOUR(VALUE_REFLECTANCE, 0.2f, 0.5f, 0.1f), COLOUR(VALUE_SPECULAR, 0.8f, 0.4f, 0.2f)

/* Order as in `cases`; a mix refers to what is before it. */
enum { MATTE, VELVET, CONDUCTOR, FROSTED };
static const test_case_t cases[] = {
    [MATTE] = {"lambert", {.kind = MATERIAL_DIFFUSE, COLOUR(VALUE_REFLECTANCE, 0.5f, 0.6f, 0.7f)}, true},
    [VELVET] = {"oren-nayar",
                {.kind = MATERIAL_DIFFUSE,
                 COLOUR(VALUE_REFLECTANCE, 0.7f, 0.25f, 0.2f),
                 NUMBER(VALUE_SIGMA, 30)},
                true},
    [CONDUCTOR] = {"conductor",
                   {.kind = MATERIAL_CONDUCTOR, NUMBER(VALUE_REFLECTANCE, 1), GOLD, ROUGHNESS(0.4f, 0.4f)},
                   true},
    [FROSTED] = {"rough glass", {.kind = MATERIAL_DIELECTRIC, GLASS(1.5f), ROUGHNESS(0.4f, 0.4f)}, true},
    {"anisotropic conductor",
     {.kind = MATERIAL_CONDUCTOR, NUMBER(VALUE_REFLECTANCE, 1), GOLD, ROUGHNESS(0.5f, 0.2f)},
     true},
    {"anisotropic glass", {.kind = MATERIAL_DIELECTRIC, GLASS(1.8f), ROUGHNESS(0.6f, 0.25f)}, true},
    {"air in glass", {.kind = MATERIAL_DIELECTRIC, GLASS(0.75f), ROUGHNESS(0.5f, 0.5f)}, true},
    {"tinted glass",
     {.kind = MATERIAL_DIELECTRIC,
      COLOUR(VALUE_REFLECTANCE, 0.9f, 0.5f, 0.1f),
      COLOUR(VALUE_TRANSMITTANCE, 0.1f, 0.3f, 0.2f),
      NUMBER(VALUE_ETA, 1.5f),
      ROUGHNESS(0.5f, 0.5f)},
     true},
    {"glass that only transmits",
     {.kind = MATERIAL_DIELECTRIC,
      NUMBER(VALUE_TRANSMITTANCE, 1),
      NUMBER(VALUE_ETA, 1.5f),
      ROUGHNESS(0.5f, 0.5f)},
     true},
    {"plastic",
     {.kind = MATERIAL_PLASTIC,
      COLOUR(VALUE_REFLECTANCE, 0.15f, 0.4f, 0.2f),
      NUMBER(VALUE_SPECULAR, 0.35f),
      ROUGHNESS(0.3f, 0.3f)},
     true},
    {"uber",
     {.kind = MATERIAL_UBER,
      COLOUR(VALUE_REFLECTANCE, 0.3f, 0.15f, 0.1f),
      NUMBER(VALUE_SPECULAR, 0.25f),
      NUMBER(VALUE_MIRROR, 0.25f),
      NUMBER(VALUE_TRANSMITTANCE, 0.2f),
      COLOUR(VALUE_OPACITY, 0.6f, 0.7f, 0.8f),
      NUMBER(VALUE_ETA, 1.5f),
      ROUGHNESS(0.3f, 0.5f)},
     true},
    {"substrate",
     {.kind = MATERIAL_SUBSTRATE,
      COLOUR(VALUE_REFLECTANCE, 0.45f, 0.12f, 0.35f),
      NUMBER(VALUE_SPECULAR, 0.1f),
      ROUGHNESS(0.3f, 0.5f)},
     true},
    {"translucent",
     {.kind = MATERIAL_TRANSLUCENT,
      COLOUR(VALUE_REFLECTANCE, 0.6f, 0.65f, 0.3f),
      NUMBER(VALUE_SPECULAR, 0.2f),
      NUMBER(VALUE_REFLECT, 0.5f),
      NUMBER(VALUE_TRANSMIT, 0.4f),
      ROUGHNESS(0.4f, 0.4f)},
     true},
    {"diffuse transmission",
     {.kind = MATERIAL_DIFFUSE_TRANSMISSION,
      COLOUR(VALUE_REFLECTANCE, 0.2f, 0.3f, 0.1f),
      COLOUR(VALUE_TRANSMITTANCE, 0.6f, 0.2f, 0.5f)},
     true},
    {"phong",
     {.kind = MATERIAL_PHONG,
      COLOUR(VALUE_REFLECTANCE, 0.3f, 0.5f, 0.1f),
      COLOUR(VALUE_SPECULAR, 0.7f, 0.5f, 0.2f),
      NUMBER(VALUE_EXPONENT, 20)},
     true},
    {"ward-duer", {WARD, .kind = MATERIAL_WARD_DUER, ROUGHNESS(0.3f, 0.15f)}, false},
    {"balanced ward", {WARD, .kind = MATERIAL_WARD_BALANCED, ROUGHNESS(0.6f, 0.2f)}, true},
    {"hair", /* on a surface: its importance may be more than it gets */
     {.kind = MATERIAL_HAIR,
      COLOUR(VALUE_ATTENUATION, 0.1f, 0.3f, 0.5f),
      NUMBER(VALUE_ETA, 1.55f),
      NUMBER(VALUE_TILT, 2),
      ROUGHNESS(0.5f, 0.4f)},
     false},
    {"mix",
     {.kind = MATERIAL_MIX, .parts = {MATTE, FROSTED}, COLOUR(VALUE_AMOUNT, 0.25f, 0.5f, 0.75f)},
     true},
    {"disney",
     {DISNEY, NUMBER(VALUE_METALLIC, 0.3f), NUMBER(VALUE_ROUGHNESS_U, 0.6f),
      NUMBER(VALUE_SPECULAR_TINT, 0.5f), NUMBER(VALUE_ANISOTROPIC, 0.5f), NUMBER(VALUE_SHEEN, 0.8f),
      NUMBER(VALUE_SHEEN_TINT, 0.5f)},
     false},
    {"disney glass", {DISNEY, NUMBER(VALUE_ROUGHNESS_U, 0.7f), NUMBER(VALUE_TRANSMISSION, 0.6f)}, false},
    {"disney sheet",
     {DISNEY, .flags = MATERIAL_THIN, NUMBER(VALUE_ROUGHNESS_U, 0.8f), NUMBER(VALUE_TRANSMISSION, 0.4f),
      NUMBER(VALUE_FLATNESS, 0.5f)},
     false},
    {"disney coat",
     {DISNEY, NUMBER(VALUE_METALLIC, 1), NUMBER(VALUE_ROUGHNESS_U, 0.6f), NUMBER(VALUE_CLEARCOAT, 1),
      NUMBER(VALUE_CLEARCOAT_GLOSS, 0)},
     false},
};
enum { CASES = ARRAY_LENGTH(cases), MOST_MATERIALS = 40 };

/* A scene with a unit square for each material, at (0, 0, index), facing +z, and its surfaces. */
typedef struct {
    test_scene_t builder;
    scene_t *scene;
    surface_t surfaces[MOST_MATERIALS];
} sheets_t;

static sheets_t *sheets_new(const blob_material_t *materials, size_t count, const blob_texture_t *textures,
                            uint32_t texture_count)
{
    sheets_t *sheets = calloc(1, sizeof *sheets);
    sheets->builder = test_scene_begin(vec3(0, 0, -5), 40, 8);
    blob_builder_add(sheets->builder.builder, BLOB_SECTION_TEXTURES, textures, texture_count);
    for (size_t i = 0; i < count; i++) {
        uint32_t material = test_scene_material(&sheets->builder, materials[i]);
        test_scene_rectangle(&sheets->builder, vec3(0, 0, (float)i), vec3(1, 0, 0), vec3(0, 1, 0), material,
                             vec3(0, 0, 0));
    }
    test_scene_finish(&sheets->builder);
    assert_int_equal(scene_new(&sheets->builder.blob, &sheets->scene).code, RESULT_OK);
    for (size_t i = 0; i < count; i++) {
        surface_t *surface = &sheets->surfaces[i];
        assert_true(
            scene_intersect(sheets->scene, vec3(0.7f, 0.3f, (float)i + 0.5f), vec3(0, 0, -1), 0, surface));
        assert_ptr_equal(surface->material, &sheets->builder.blob.materials[i]);
    }
    return sheets;
}

static void sheets_destroy(sheets_t *sheets)
{
    scene_destroy(&sheets->scene);
    test_scene_end(&sheets->builder);
    free(sheets);
}

static int set_up(void **state)
{
    blob_material_t materials[CASES];
    for (size_t i = 0; i < CASES; i++) materials[i] = cases[i].material;
    *state = sheets_new(materials, CASES, NULL, 0);
    return 0;
}

static int tear_down(void **state)
{
    sheets_destroy(*state);
    return 0;
}

static bsdf_t bsdf_of(const sheets_t *sheets, size_t i)
{
    bsdf_t bsdf;
    material_bsdf(sheets->scene, &sheets->surfaces[i], &bsdf);
    return bsdf;
}

static bsdf_t bsdf_turned(const sheets_t *sheets, size_t i, vec3_t ng, vec3_t ns)
{
    bsdf_t bsdf;
    surface_t surface = sheets->surfaces[i];
    surface.ng = ng;
    surface.ns = ns;
    material_bsdf(sheets->scene, &surface, &bsdf);
    return bsdf;
}

/* One material by itself; the BSDF needs no scene afterwards. */
static bsdf_t bsdf_alone(blob_material_t material)
{
    sheets_t *sheets = sheets_new(&material, 1, NULL, 0);
    bsdf_t bsdf = bsdf_of(sheets, 0);
    sheets_destroy(sheets);
    return bsdf;
}

static vec3_t direction(float x, float y, float z)
{
    return v_normalize(vec3(x, y, z));
}

/* ---- densities ----------------------------------------------------------------------------------------- */

enum { DRAWS = 200000, ROWS = 20, COLUMNS = 40, CELLS = ROWS * COLUMNS, FINE = 16 };
/* Right routines fail by chance in one build of a thousand. */
static const double level = 1e-5;

/* Equal solid angles: rows in cos theta, columns in phi. */
static size_t direction_cell(vec3_t w)
{
    double phi = atan2((double)w.y, (double)w.x);
    int row = (int)(((double)w.z + 1) / 2 * ROWS), column = (int)((phi + M_PI) / (2 * M_PI) * COLUMNS);
    return (size_t)int_min(int_max(row, 0), ROWS - 1) * COLUMNS +
           (size_t)int_min(int_max(column, 0), COLUMNS - 1);
}

typedef struct {
    double expected[CELLS]; /* share of draws in each cell */
    double albedo;          /* of the lobes that can be evaluated, in green */
} integral_t;

static void integrate(const bsdf_t *bsdf, vec3_t wo, integral_t *sum)
{
    const double area = 4 * M_PI / ((double)CELLS * FINE * FINE);
    *sum = (integral_t){.albedo = 0};
    for (int row = 0; row < ROWS * FINE; row++)
        for (int column = 0; column < COLUMNS * FINE; column++) {
            double z = -1 + 2 * (row + 0.5) / (ROWS * FINE), r = sqrt(1 - z * z);
            double phi = -M_PI + 2 * M_PI * (column + 0.5) / (COLUMNS * FINE);
            vec3_t wi = vec3((float)(r * cos(phi)), (float)(r * sin(phi)), (float)z);
            bsdf_value_t value;
            if (!bsdf_eval(bsdf, wo, wi, TRANSPORT_RADIANCE, &value)) continue;
            sum->expected[(size_t)(row / FINE) * COLUMNS + (size_t)(column / FINE)] +=
                (double)value.pdf * area;
            sum->albedo += (double)value.f.y * fabs((double)v_dot(wi, bsdf->ns)) * area;
        }
}

static void check_density(const char *name, const bsdf_t *bsdf, vec3_t wo)
{
    integral_t *integral = malloc(sizeof *integral);
    double *observed = calloc(CELLS, sizeof *observed), albedo = 0, square = 0;
    for (uint32_t i = 0; i < DRAWS; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (!bsdf_sample(bsdf, wo, u, sampler_1d(&sampler), TRANSPORT_RADIANCE, &sample) || sample.specular)
            continue;
        observed[direction_cell(sample.wi)]++;
        albedo += (double)sample.weight.y / DRAWS;
        square += (double)sample.weight.y * (double)sample.weight.y / DRAWS;
    }
    integrate(bsdf, wo, integral);
    for (size_t i = 0; i < CELLS; i++) integral->expected[i] *= DRAWS;
    double p = chi_square_p(observed, integral->expected, CELLS, DRAWS);
    double error = sqrt(fmax(0, square - albedo * albedo) / DRAWS), truth = integral->albedo;
    free(observed);
    free(integral);
    if (!(p > level))
        fail_msg("%s: p = %g for wo = %g %g %g", name, p, (double)wo.x, (double)wo.y, (double)wo.z);
    if (!(fabs(albedo - truth) < 4.5 * error + 1e-3 * truth))
        fail_msg("%s: samples see %g, the value is %g", name, albedo, truth);
}

static const vec3_t outgoing[] = {{0.1f, 0.2f, 0.9f}, {0.9f, -0.3f, 0.2f}, {-0.7f, 0.1f, -0.5f}};

static void samples_follow_the_density(void **state)
{
    for (size_t i = 0; i < CASES; i++)
        for (size_t k = 0; k < ARRAY_LENGTH(outgoing); k++) {
            bsdf_t bsdf = bsdf_of(*state, i);
            check_density(cases[i].name, &bsdf, v_normalize(outgoing[k]));
        }
}

/* Geometric and shading normals that differ: what leaks is not drawn, and the rest is as claimed. */
static void shading_normals_keep_the_density(void **state)
{
    for (size_t i = 0; i < CASES; i++) {
        bsdf_t bsdf = bsdf_turned(*state, i, direction(0.2f, 0.3f, -1), direction(0.2f, 0.3f, -1));
        check_density(cases[i].name, &bsdf, direction(0.5f, 0.1f, -0.6f));
    }
    bsdf_t bsdf = bsdf_turned(*state, MATTE, direction(0, 0, 1), direction(0.5f, 0, 1));
    for (uint32_t i = 0; i < 5000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 3, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (bsdf_sample(&bsdf, direction(1, 0, 0.1f), u, 0, TRANSPORT_RADIANCE, &sample))
            assert_true(sample.wi.z > 0);
    }
}

static void assert_near(const char *name, const char *what, float a, float b)
{
    if (!(fabsf(a - b) <= 2e-3f * float_max(fabsf(a), fabsf(b)) + 1e-6f))
        fail_msg("%s: %s %g, but %g", name, what, (double)a, (double)b);
}

/* What a sample says of itself is what evaluation says of its direction, forwards and backwards. */
static void samples_agree_with_evaluation(void **state)
{
    for (size_t i = 0; i < CASES; i++) {
        const char *name = cases[i].name;
        bsdf_t bsdf = bsdf_of(*state, i);
        int checked = 0;
        for (uint32_t n = 0; n < 3000; n++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 2, (uint32_t)i, n);
            vec3_t wo = warp_sphere(sampler_2d(&sampler));
            vec2_t u = sampler_2d(&sampler);
            transport_t mode = n % 2 ? TRANSPORT_RADIANCE : TRANSPORT_IMPORTANCE;
            bsdf_sample_t sample;
            bsdf_value_t there, back;
            if (!bsdf_sample(&bsdf, wo, u, sampler_1d(&sampler), mode, &sample) || sample.specular) continue;
            if (fabsf(wo.z) < 0.01f || fabsf(sample.wi.z) < 0.01f) continue; /* lost in rounding */
            assert_true(bsdf_eval(&bsdf, wo, sample.wi, mode, &there));
            assert_near(name, "density", sample.pdf, there.pdf);
            assert_near(name, "reverse density", sample.pdf_rev, there.pdf_rev);
            assert_near(name, "weight", sample.weight.y, there.f.y * fabsf(sample.wi.z) / there.pdf);
            transport_t other = mode == TRANSPORT_RADIANCE ? TRANSPORT_IMPORTANCE : TRANSPORT_RADIANCE;
            assert_true(bsdf_eval(&bsdf, sample.wi, wo, other, &back));
            assert_near(name, "density backwards", back.pdf, there.pdf_rev);
            assert_near(name, "reverse density backwards", back.pdf_rev, there.pdf);
            checked++;
        }
        if (checked < 500) fail_msg("%s: only %d samples to check", name, checked);
    }
}

/* Importance sees the surface from one end as radiance sees it from the other. */
static void radiance_and_importance_are_adjoint(void **state)
{
    for (size_t i = 0; i < CASES; i++) {
        bsdf_t bsdf = bsdf_of(*state, i);
        int compared = 0;
        for (uint32_t n = 0; n < 5000; n++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 4, 0, n);
            vec3_t a = warp_sphere(sampler_2d(&sampler)), b = warp_sphere(sampler_2d(&sampler));
            bsdf_value_t there = {.f = {0, 0, 0}}, back = {.f = {0, 0, 0}};
            bool any = bsdf_eval(&bsdf, a, b, TRANSPORT_RADIANCE, &there);
            bool other = bsdf_eval(&bsdf, b, a, TRANSPORT_IMPORTANCE, &back);
            if (!any && !other) continue;
            if (fabsf(a.z) < 0.01f || fabsf(b.z) < 0.01f) continue;
            assert_near(cases[i].name, "importance", back.f.x, there.f.x);
            assert_near(cases[i].name, "importance", back.f.z, there.f.z);
            compared++;
        }
        assert_true(compared > 500);
    }
}

/* Mean weight of samples, the Dirac lobes' included. */
static rgb_t albedo(const bsdf_t *bsdf, vec3_t wo, transport_t mode)
{
    double sum[3] = {0, 0, 0};
    enum { N = 40000 };
    for (uint32_t i = 0; i < N; i++) {
        sampler_t sampler = sampler_new(SAMPLER_SOBOL, 2, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (!bsdf_sample(bsdf, wo, u, sampler_1d(&sampler), mode, &sample)) continue;
        sum[0] += (double)sample.weight.x / N;
        sum[1] += (double)sample.weight.y / N;
        sum[2] += (double)sample.weight.z / N;
    }
    return vec3((float)sum[0], (float)sum[1], (float)sum[2]);
}

static void scattering_loses_energy(void **state)
{
    for (size_t i = 0; i < CASES; i++)
        for (int k = -10; k <= 10 && cases[i].lossy; k++) {
            if (k == 0) continue;
            float z = (float)k / 10, r = sqrtf(1 - z * z);
            bsdf_t bsdf = bsdf_of(*state, i);
            rgb_t back = albedo(&bsdf, vec3(0.6f * r, 0.8f * r, z), TRANSPORT_IMPORTANCE);
            if (!(v_max(back) < 1.005f && back.y > 0))
                fail_msg("%s throws back %g of the light at cos %g", cases[i].name, (double)v_max(back),
                         (double)z);
        }
}

/* ---- closed forms -------------------------------------------------------------------------------------- */

static float value_at(const bsdf_t *bsdf, vec3_t wo, vec3_t wi)
{
    bsdf_value_t value = {.f = {0, 0, 0}};
    return bsdf_eval(bsdf, wo, wi, TRANSPORT_RADIANCE, &value) ? value.f.y : 0;
}

/* What does not absorb gives everything back: exactly where smooth, nearly where a little rough. */
static void clear_things_lose_nothing(void **state)
{
    (void)state;
    bsdf_t things[] = {
        bsdf_alone((blob_material_t){.kind = MATERIAL_DIFFUSE, NUMBER(VALUE_REFLECTANCE, 1)}),
        bsdf_alone((blob_material_t){.kind = MATERIAL_MIRROR, NUMBER(VALUE_REFLECTANCE, 1)}),
        bsdf_alone((blob_material_t){.kind = MATERIAL_DIELECTRIC, GLASS(1.5f)}),
        bsdf_alone((blob_material_t){.kind = MATERIAL_DIELECTRIC, .flags = MATERIAL_THIN, GLASS(1.5f)}),
        bsdf_alone((blob_material_t){.kind = MATERIAL_DIELECTRIC, GLASS(1.5f), ROUGHNESS(0.02f, 0.02f)}),
        bsdf_alone((blob_material_t){.kind = MATERIAL_CONDUCTOR,
                                     NUMBER(VALUE_REFLECTANCE, 1),
                                     NUMBER(VALUE_K, 3),
                                     ROUGHNESS(0.02f, 0.02f)}),
        bsdf_alone((blob_material_t){.kind = MATERIAL_UBER, ROUGHNESS(0.1f, 0.1f)}), /* opacity 0 */
        bsdf_alone((blob_material_t){.kind = MATERIAL_DIELECTRIC, GLASS(1), ROUGHNESS(0.3f, 0.3f)}),
        bsdf_alone((blob_material_t){
            .kind = MATERIAL_DIFFUSE, .flags = MATERIAL_UNIT, NUMBER(VALUE_REFLECTANCE, 4)}),
    };
    for (size_t i = 0; i < ARRAY_LENGTH(things); i++)
        for (int k = 3; k <= 10; k++) {
            float z = (float)k / 10,
                  loss = 1 - albedo(&things[i], vec3(sqrtf(1 - z * z), 0, z), TRANSPORT_IMPORTANCE).y;
            assert_true(fabsf(loss) < (i == 4 || i == 5 ? 0.01f : 1e-3f));
        }
    bsdf_t rough = bsdf_alone((blob_material_t){
        .kind = MATERIAL_CONDUCTOR, NUMBER(VALUE_REFLECTANCE, 1), NUMBER(VALUE_K, 3), ROUGHNESS(0.8f, 0.8f)});
    float kept = albedo(&rough, direction(1, 0, 1), TRANSPORT_IMPORTANCE).y;
    assert_float_equal(kept, 0.48025f, 3e-3f); /* by quadrature; what would have bounced again is lost */
}

/* Radiance grows by the squared index on the way into glass, and shrinks on the way out. */
static void refraction_scales_radiance(void **state)
{
    (void)state;
    bsdf_t bsdf = bsdf_alone((blob_material_t){.kind = MATERIAL_DIELECTRIC, GLASS(1.5f)});
    assert_true(bsdf.specular);
    for (int side = 0; side < 2; side++) {
        vec3_t wo = vec3(0.6f, 0, side == 0 ? 0.8f : -0.8f);
        float factor = side == 0 ? 1 / 2.25f : 2.25f;
        bsdf_sample_t radiance, importance;
        assert_true(bsdf_sample(&bsdf, wo, (vec2_t){0, 0}, 0.999f, TRANSPORT_RADIANCE, &radiance));
        assert_true(bsdf_sample(&bsdf, wo, (vec2_t){0, 0}, 0.999f, TRANSPORT_IMPORTANCE, &importance));
        assert_float_equal(radiance.weight.x, factor * importance.weight.x, 1e-5f);
        assert_float_equal(radiance.squeeze, factor, 1e-5f);
        assert_float_equal(importance.squeeze, 1, 0);
        assert_float_equal(fabsf(radiance.wi.x), side == 0 ? 0.4f : 0.9f, 1e-5f); /* Snell */
        assert_true(radiance.wi.z * wo.z < 0);
        assert_true(radiance.wi.x * wo.x < 0);
    }
}

/* The probability and the weight of the specular sample with this choice. */
static bsdf_sample_t specular_at(const bsdf_t *bsdf, vec3_t wo, float choice)
{
    bsdf_sample_t sample = {.pdf = 0};
    assert_true(bsdf_sample(bsdf, wo, (vec2_t){0.5f, 0.5f}, choice, TRANSPORT_RADIANCE, &sample));
    assert_true(sample.specular);
    return sample;
}

static void panes_reflect_with_both_faces(void **state)
{
    (void)state;
    bsdf_t bsdf =
        bsdf_alone((blob_material_t){.kind = MATERIAL_DIELECTRIC, .flags = MATERIAL_THIN, GLASS(1.5f)});
    const float both = 2 * 0.04f / 1.04f; /* 2 R / (1 + R) */
    for (int side = -1; side <= 1; side += 2) {
        vec3_t wo = vec3(0, 0, (float)side);
        bsdf_sample_t back = specular_at(&bsdf, wo, 0), on = specular_at(&bsdf, wo, 0.999f);
        assert_float_equal(back.pdf * back.weight.x, both, 1e-5f);
        assert_float_equal(on.pdf * on.weight.x, 1 - both, 1e-5f);
        assert_float_equal(back.wi.z * wo.z, 1, 1e-6f);
        assert_float_equal(on.wi.z * wo.z, -1, 1e-6f);
    }
}

static void uber_shares_out_the_light(void **state)
{
    (void)state;
    bsdf_t bsdf = bsdf_alone((blob_material_t){.kind = MATERIAL_UBER,
                                               NUMBER(VALUE_REFLECTANCE, 0.4f),
                                               NUMBER(VALUE_MIRROR, 0.5f),
                                               NUMBER(VALUE_OPACITY, 0.75f),
                                               NUMBER(VALUE_ETA, 1.5f),
                                               ROUGHNESS(0.1f, 0.1f)});
    assert_false(bsdf.specular);
    vec3_t wo = vec3(0, 0, 1);
    double straight = 0, mirrored = 0;
    enum { N = 100000 };
    for (uint32_t i = 0; i < N; i++) {
        sampler_t sampler = sampler_new(SAMPLER_SOBOL, 5, 0, i);
        bsdf_sample_t s;
        vec2_t u = sampler_2d(&sampler);
        if (!bsdf_sample(&bsdf, wo, u, sampler_1d(&sampler), TRANSPORT_RADIANCE, &s) || !s.specular) continue;
        *(s.wi.z < 0 ? &straight : &mirrored) += (double)s.weight.x / N;
    }
    assert_true(fabs(straight - 0.25) < 1e-3);
    assert_true(fabs(mirrored - 0.75 * 0.5 * 0.04) < 1e-3);
    assert_float_equal(value_at(&bsdf, wo, direction(1, 0, 1)), 0.75f * 0.4f * INV_PI_F, 1e-6f);
    assert_true(value_at(&bsdf, wo, direction(1, 0, -1)) == 0);
}

static void values_follow_their_formulas(void **state)
{
    vec3_t up = vec3(0, 0, 1), slant = direction(1, 0, 1);
    /* Oren-Nayar, sigma 30 degrees: A at normal incidence; in one plane at 45 degrees, both ways. */
    bsdf_t velvet = bsdf_of(*state, VELVET);
    const float s2 = PI_F / 6 * (PI_F / 6), a = 1 - 0.5f * s2 / (s2 + 0.33f), b = 0.45f * s2 / (s2 + 0.09f);
    const float k = 0.25f * INV_PI_F;
    assert_float_equal(value_at(&velvet, up, slant), k * a, 1e-5f);
    assert_float_equal(value_at(&velvet, slant, slant), k * (a + b * sqrtf(0.5f)), 1e-5f);
    assert_float_equal(value_at(&velvet, slant, direction(-1, 0, 1)), k * a, 1e-5f);
    vec3_t shallow = direction(2, 0, 1), high = direction(1, 0, 2);
    const float term = 0.4f / high.z; /* the product of the sines over the larger cosine */
    assert_float_equal(value_at(&velvet, shallow, high), k * (a + b * term), 1e-5f);
    assert_float_equal(value_at(&velvet, high, shallow), k * (a + b * term), 1e-5f);
    /* A facet straight ahead: D = 1 / (pi alpha^2), no shadowing, 4 per cent. */
    bsdf_t glass = bsdf_of(*state, FROSTED);
    assert_float_equal(value_at(&glass, up, up), 0.04f / (4 * PI_F * 0.16f), 1e-5f);
    /* Straight through: (1 - R) D eta^2 / (eta - 1)^2, over eta^2 for radiance. */
    assert_float_equal(value_at(&glass, up, vec3(0, 0, -1)), 0.96f / (PI_F * 0.16f * 0.25f), 1e-3f);
    /* The blend straight ahead. */
    bsdf_t coat = bsdf_alone((blob_material_t){.kind = MATERIAL_SUBSTRATE,
                                               NUMBER(VALUE_REFLECTANCE, 0.5f),
                                               NUMBER(VALUE_SPECULAR, 0.1f),
                                               ROUGHNESS(0.5f, 0.5f)});
    const float half = 1 - powf(0.5f, 5);
    assert_float_equal(value_at(&coat, up, up),
                       28 / (23 * PI_F) * 0.5f * 0.9f * half * half + 0.1f / (PI_F * 0.25f * 4), 1e-5f);
    /* pbrt-v3's plastic seen from above reflects totally beyond the critical angle. */
    bsdf_t plastic = bsdf_alone(
        (blob_material_t){.kind = MATERIAL_PLASTIC, NUMBER(VALUE_SPECULAR, 1), ROUGHNESS(0.5f, 0.5f)});
    bsdf_t mirror = bsdf_alone((blob_material_t){
        .kind = MATERIAL_CONDUCTOR, NUMBER(VALUE_REFLECTANCE, 1), NUMBER(VALUE_K, 1), ROUGHNESS(0.5f, 0.5f)});
    vec3_t left = direction(-1, 0, 1), steep = direction(-0.5f, 0, 1), other = direction(0.5f, 0, 1);
    assert_float_equal(value_at(&plastic, slant, left) / value_at(&mirror, slant, left), 1, 1e-5f);
    assert_true(value_at(&plastic, steep, other) < 0.2f * value_at(&mirror, steep, other));
    /* Disney's metal has its colour once, and in pbrt-v3 none at all from behind; a dielectric has 4 per cent
     * whatever its colour, also beside a coat. */
    const float facing = 1 / (4 * PI_F * 0.25f * 0.25f); /* D / 4 at roughness 0.5 */
    blob_material_t principled = {DISNEY, NUMBER(VALUE_METALLIC, 1), NUMBER(VALUE_ROUGHNESS_U, 0.5f)};
    principled.values[VALUE_REFLECTANCE] = blob_constant(0.3f);
    bsdf_t metal = bsdf_alone(principled);
    assert_float_equal(value_at(&metal, up, up), 0.3f * facing, 1e-4f);
    assert_float_equal(value_at(&metal, v_neg(up), v_neg(up)), facing, 1e-4f);
    principled.values[VALUE_METALLIC] = blob_constant(0);
    bsdf_t body = bsdf_alone(principled);
    assert_float_equal(value_at(&body, up, up), 0.3f * INV_PI_F + 0.04f * facing, 1e-4f);
    assert_float_equal(value_at(&body, v_neg(up), v_neg(up)), 0.3f * INV_PI_F + 0.04f * facing, 1e-4f);
    /* A mix is the mean of its parts. */
    size_t mixed = 0;
    while (cases[mixed].material.kind != MATERIAL_MIX) mixed++;
    bsdf_t matte = bsdf_of(*state, MATTE), mix = bsdf_of(*state, mixed);
    assert_float_equal(value_at(&mix, slant, steep),
                       0.5f * value_at(&matte, slant, steep) + 0.5f * value_at(&glass, slant, steep), 1e-5f);
}

/* The formulas of Mitsuba's documentation and of the papers, by angles. */
static double ward_by_angles(uint32_t model, double ax, double ay, vec3_t wo, vec3_t wi)
{
    vec3_t h = v_normalize(v_add(wo, wi));
    double to = acos((double)wo.z), ti = acos((double)wi.z), th = acos((double)h.z),
           ph = atan2((double)h.y, (double)h.x),
           apart = atan2((double)wo.y, (double)wo.x) - atan2((double)wi.y, (double)wi.x);
    double e = exp(-pow(tan(th), 2) * (pow(cos(ph) / ax, 2) + pow(sin(ph) / ay, 2))) / (M_PI * ax * ay);
    if (model == MATERIAL_WARD) return e / (4 * sqrt(cos(to) * cos(ti)));
    if (model == MATERIAL_WARD_DUER) return e / (4 * cos(to) * cos(ti));
    return e * 2 * (1 + cos(to) * cos(ti) + sin(to) * sin(ti) * cos(apart)) / pow(cos(to) + cos(ti), 4);
}

static void highlights_follow_their_formulas(void **state)
{
    (void)state;
    vec3_t wo = direction(0.5f, 0.2f, 0.6f), up = vec3(0, 0, 1);
    for (uint32_t model = MATERIAL_WARD; model <= MATERIAL_WARD_BALANCED; model++) {
        bsdf_t ward =
            bsdf_alone((blob_material_t){.kind = model, NUMBER(VALUE_SPECULAR, 1), ROUGHNESS(0.4f, 0.2f)});
        for (int i = 0; i < 20; i++) {
            vec3_t wi = direction(0.1f * (float)(i % 5) - 0.6f, 0.1f * (float)(i / 5) - 0.3f, 0.5f);
            double expected = ward_by_angles(model, 0.4, 0.2, wo, wi);
            assert_true(fabs((double)value_at(&ward, wo, wi) / expected - 1) < 1e-4);
            assert_true(fabs((double)value_at(&ward, v_neg(wo), v_neg(wi)) / expected - 1) < 1e-4);
        }
    }
    blob_material_t material = {.kind = MATERIAL_PHONG, NUMBER(VALUE_SPECULAR, 1), NUMBER(VALUE_EXPONENT, 7)};
    bsdf_t phong = bsdf_alone(material);
    const float cosine = v_dot(direction(-0.5f, -0.2f, 0.6f), up);
    assert_float_equal(value_at(&phong, wo, up), 9 / (2 * PI_F) * powf(cosine, 7), 1e-5f);
    assert_float_equal(value_at(&phong, direction(1, 0, 0.5f), direction(1, 0, 0.5f)), 0, 0);
    /* Straight on nothing is lost, and of a narrow one what the cosine takes; it is still drawn and valued.
     */
    assert_float_equal(albedo(&phong, up, TRANSPORT_IMPORTANCE).x, 1, 2e-3f);
    material.values[VALUE_EXPONENT] = blob_constant(1e6f);
    bsdf_t narrow = bsdf_alone(material);
    assert_float_equal(albedo(&narrow, wo, TRANSPORT_IMPORTANCE).x, wo.z, 2e-3f);
    assert_float_equal(value_at(&narrow, wo, vec3(-wo.x, -wo.y, wo.z)) * TWO_PI_F, 1e6f, 10);
    /* An alpha of 0.1 for 2 / (n + 2) below its square, twice the alpha below 0.3. */
    bsdf_regularize(&narrow);
    assert_float_equal(narrow.lobes[0].phong.exponent, 198, 1e-2f);
    bsdf_regularize(&narrow);
    assert_float_equal(narrow.lobes[0].phong.exponent, 48, 1e-2f);
    check_density("roughened phong", &narrow, wo);
    bsdf_regularize(&phong);
    assert_float_equal(phong.lobes[0].phong.exponent, 7, 1e-4f);
}

/* ---- alphas, regularisation ---------------------------------------------------------------------------- */

static blob_material_t rough(material_kind_t kind, uint32_t flags, float u, float v)
{
    return (blob_material_t){.kind = kind, .flags = flags, GLASS(1.5f), NUMBER(VALUE_K, 2), ROUGHNESS(u, v)};
}

static void roughness_becomes_alpha(void **state)
{
    (void)state;
    const struct {
        material_kind_t kind;
        uint32_t flags;
        float roughness[2], alpha[2]; /* alpha 0: specular */
    } table[] = {
        {MATERIAL_CONDUCTOR, 0, {0.3f, 0.2f}, {0.3f, 0.2f}},
        {MATERIAL_CONDUCTOR, MATERIAL_REMAP_SQRT, {0.09f, 0.04f}, {0.3f, 0.2f}},
        {MATERIAL_CONDUCTOR, MATERIAL_REMAP_SQUARE, {0.5f, 0.5f}, {0.25f, 0.25f}},
        {MATERIAL_CONDUCTOR, MATERIAL_REMAP_V3, {1, 1}, {1.62142f, 1.62142f}},
        {MATERIAL_CONDUCTOR, MATERIAL_REMAP_V3, {0.1f, 0.1f}, {0.46176f, 0.46176f}},
        /* pbrt-v4 takes a tiny alpha for smooth, unless the other is not. */
        {MATERIAL_CONDUCTOR, 0, {0.0009f, 0}, {0, 0}},
        {MATERIAL_DIELECTRIC, 0, {0.0009f, 0}, {0, 0}},
        {MATERIAL_DIELECTRIC, 0, {0.1f, 0}, {0.1f, 1e-4f}},
        /* pbrt-v3's metal is never smooth; its glass only where the roughness is 0. */
        {MATERIAL_CONDUCTOR, MATERIAL_ALPHA_V3, {0, 0}, {1e-3f, 1e-3f}},
        {MATERIAL_DIELECTRIC, MATERIAL_ALPHA_V3, {0, 0}, {0, 0}},
        {MATERIAL_DIELECTRIC, MATERIAL_ALPHA_V3, {0.0005f, 0}, {1e-3f, 1e-3f}},
        {MATERIAL_DIELECTRIC, MATERIAL_REMAP_V3, {0, 0}, {0, 0}},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(table); i++) {
        bsdf_t bsdf =
            bsdf_alone(rough(table[i].kind, table[i].flags, table[i].roughness[0], table[i].roughness[1]));
        assert_int_equal(bsdf.count, 1);
        assert_int_equal(bsdf.specular, table[i].alpha[0] == 0);
        for (int k = 0; k < 2 && !bsdf.specular; k++)
            assert_float_equal(bsdf.lobes[0].alpha[k], table[i].alpha[k], 1e-4f);
    }
}

static void regularizing_roughens_what_is_smooth(void **state)
{
    const struct {
        blob_material_t material;
        float alpha;
    } table[] = {
        {rough(MATERIAL_CONDUCTOR, 0, 0, 0), 0.1f},       {rough(MATERIAL_DIELECTRIC, 0, 0, 0), 0.1f},
        {rough(MATERIAL_MIRROR, 0, 0, 0), 0.1f},          {rough(MATERIAL_CONDUCTOR, 0, 0.01f, 0.01f), 0.1f},
        {rough(MATERIAL_CONDUCTOR, 0, 0.1f, 0.1f), 0.2f}, {rough(MATERIAL_DIELECTRIC, 0, 0.2f, 0.2f), 0.3f},
        {rough(MATERIAL_CONDUCTOR, 0, 0.4f, 0.4f), 0.4f},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(table); i++) {
        bsdf_t bsdf = bsdf_alone(table[i].material);
        rgb_t before = albedo(&bsdf, vec3(0, 0.6f, 0.8f), TRANSPORT_IMPORTANCE);
        bsdf_regularize(&bsdf);
        assert_false(bsdf.specular);
        assert_float_equal(bsdf.lobes[0].alpha[0], table[i].alpha, 1e-6f);
        rgb_t after = albedo(&bsdf, vec3(0, 0.6f, 0.8f), TRANSPORT_IMPORTANCE);
        assert_float_equal(after.x, before.x, 0.03f);
        check_density("roughened", &bsdf, direction(0.1f, 0.6f, 0.8f));
    }
    bsdf_t matte = bsdf_of(*state, MATTE), same = matte;
    bsdf_regularize(&same);
    assert_float_equal(value_at(&same, vec3(0, 0, 1), vec3(0, 0, 1)),
                       value_at(&matte, vec3(0, 0, 1), vec3(0, 0, 1)), 0);
}

/* ---- frames -------------------------------------------------------------------------------------------- */

static void assert_frame(const bsdf_t *bsdf)
{
    assert_float_equal(v_length(bsdf->s), 1, 1e-5f);
    assert_float_equal(v_length(bsdf->t), 1, 1e-5f);
    assert_float_equal(v_length(bsdf->ns), 1, 1e-5f);
    assert_float_equal(v_dot(bsdf->s, bsdf->ns), 0, 1e-5f);
    assert_float_equal(v_dot(v_cross(bsdf->ns, bsdf->s), bsdf->t), 1, 1e-5f);
    assert_true(v_dot(bsdf->ns, bsdf->ng) >= 0);
}

static void assert_vector(vec3_t a, vec3_t b)
{
    if (!(v_length(v_sub(a, b)) < 1e-3f))
        fail_msg("(%g %g %g) is not (%g %g %g)", (double)a.x, (double)a.y, (double)a.z, (double)b.x,
                 (double)b.y, (double)b.z);
}

/* The squares have pbrt's default (u, v): in the lower triangle dp/du = x, dp/dv = y. */
static void maps_turn_the_normal(void **state)
{
    (void)state;
    const blob_texture_t textures[] = {
        {.kind = TEXTURE_UV, .mapping = MAPPING_UV, .matrix = {{0.5f, 0, 0}, {0, 0.25f, 0}}},
        {.kind = TEXTURE_SCALE, .inputs = {{{0.8f, 0.65f, 0.9f}, 0, 0}, {{1, 1, 1}, 0, 0}}},
        {.kind = TEXTURE_SCALE, .inputs = {{{0.5f, 0.5f, 0}, 0, 0}, {{1, 1, 1}, 0, 0}}},
        {.kind = TEXTURE_SCALE, .inputs = {{{0.5f, 0.5f, 0.5f}, 0, 0}, {{1, 1, 1}, 0, 0}}},
    };
    blob_material_t matte = cases[MATTE].material, materials[] = {matte, matte, matte, matte, matte};
    materials[0].bump = 1;
    materials[1].normal_map = 2, materials[1].normal_scale = 1;
    materials[2].normal_map = 2, materials[2].normal_scale = 0.5f;
    materials[3].normal_map = 3, materials[3].normal_scale = 1; /* (0, 0, -1): upside down */
    materials[4].normal_map = 4, materials[4].normal_scale = 1; /* (0, 0, 0): nothing */
    sheets_t *sheets = sheets_new(materials, ARRAY_LENGTH(materials), textures, ARRAY_LENGTH(textures));
    surface_details_t details;
    scene_details(sheets->scene, &sheets->surfaces[0], &details);
    assert_vector(details.dpdu, vec3(1, 0, 0));
    assert_vector(details.dpdv, vec3(0, 1, 0));
    bsdf_t bsdf[ARRAY_LENGTH(materials)];
    for (size_t i = 0; i < ARRAY_LENGTH(materials); i++) {
        bsdf[i] = bsdf_of(sheets, i);
        assert_frame(&bsdf[i]);
    }
    /* The displacement is u / 2, whose normal leans back against u. */
    assert_vector(bsdf[0].ns, direction(-0.5f, 0, 1));
    assert_vector(bsdf[0].s, direction(1, 0, 0.5f));
    assert_vector(bsdf[1].ns, direction(0.6f, 0.3f, 0.8f));
    assert_vector(bsdf[2].ns, direction(0.3f, 0.15f, 0.8f));
    assert_vector(bsdf[3].ns, vec3(0, 0, 1));
    assert_vector(bsdf[4].ns, vec3(0, 0, 1));
    sheets_destroy(sheets);
}

/* Where uvs are mirrored, y lies along dp/dv, but in pbrt-v4 along n x dp/du. */
static void normal_maps_may_follow_pbrt_v4(void **state)
{
    (void)state;
    const blob_texture_t map = {.kind = TEXTURE_SCALE,
                                .inputs = {{{0.8f, 0.65f, 0.9f}, 0, 0}, {{1, 1, 1}, 0, 0}}};
    blob_material_t materials[2] = {cases[MATTE].material, cases[MATTE].material};
    materials[0].normal_map = materials[1].normal_map = 1;
    materials[0].normal_scale = materials[1].normal_scale = 1;
    materials[1].flags |= MATERIAL_NORMALS_V4;
    sheets_t *sheets = sheets_new(materials, ARRAY_LENGTH(materials), &map, 1);
    for (int mirrored = 0; mirrored < 2; mirrored++)
        for (int v4 = 0; v4 < 2; v4++) {
            bsdf_t bsdf = {.ng = {0, 0, 1}, .ns = {0, 0, 1}};
            texture_point_t at = {.n = {0, 0, 1}};
            surface_details_t details = {.dpdu = {1, 0, 0}, .dpdv = {0, mirrored ? -1 : 1, 0}};
            shading_frame_turn(&bsdf, sheets->scene, &materials[v4], &details, &at);
            assert_frame(&bsdf);
            assert_vector(bsdf.ns, direction(0.6f, mirrored && !v4 ? -0.3f : 0.3f, 0.8f));
        }
    sheets_destroy(sheets);
}

/* The normal at (0.7, 0.3) of a rectangle of 2 by 4 with vertex normals and a bump map. */
static vec3_t bumped_normal(const blob_texture_t *map, uint32_t flags)
{
    const vec3_t normals[4] = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}, {0, 0, 1}};
    test_scene_t builder = test_scene_begin(vec3(0, 0, -5), 40, 8);
    blob_builder_add(builder.builder, BLOB_SECTION_TEXTURES, map, 1);
    blob_material_t bumped = cases[MATTE].material;
    bumped.bump = 1;
    uint32_t material = test_scene_material(&builder, bumped);
    test_scene_rectangle(&builder, vec3(0, 0, 0), vec3(2, 0, 0), vec3(0, 4, 0), material, vec3(0, 0, 0));
    blob_mesh_t *mesh = blob_builder_records(builder.builder, BLOB_SECTION_MESHES);
    mesh->first_normal = blob_builder_add(builder.builder, BLOB_SECTION_NORMALS, normals, 4);
    ((blob_shape_t *)blob_builder_records(builder.builder, BLOB_SECTION_SHAPES))->flags = flags;
    test_scene_finish(&builder);
    scene_t *scene;
    surface_t surface;
    bsdf_t bsdf;
    assert_int_equal(scene_new(&builder.blob, &scene).code, RESULT_OK);
    assert_true(scene_intersect(scene, vec3(0.7f, 0.3f, 1), vec3(0, 0, -1), 0, &surface));
    material_bsdf(scene, &surface, &bsdf);
    assert_frame(&bsdf);
    scene_destroy(&scene);
    test_scene_end(&builder);
    return bsdf.ns;
}

/* With vertex normals pbrt-v3's tangents have unit length and point backwards: what goes by (u, v) is seen
 * from below and has its own height, what goes by the point is right. */
static void bumps_of_pbrt_v3_stand_on_unit_tangents(void **state)
{
    (void)state;
    const blob_texture_t by_uv = {.kind = TEXTURE_UV, .mapping = MAPPING_UV, .matrix = {{0.5f, 0, 0}}};
    const blob_texture_t by_point = {.kind = TEXTURE_UV,
                                     .mapping = MAPPING_PLANAR,
                                     .texture_from_world = {{{0.25f, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 0, 0}}}};
    assert_vector(bumped_normal(&by_uv, 0), direction(-0.25f, 0, 1));
    assert_vector(bumped_normal(&by_uv, SHAPE_BUMPS_V3), direction(0.5f, 0, 1));
    assert_vector(bumped_normal(&by_point, 0), direction(-0.25f, 0, 1));
    assert_vector(bumped_normal(&by_point, SHAPE_BUMPS_V3), direction(-0.25f, 0, 1));
}

/* A normal turned by 45 degrees: light from beyond its horizon is black to all but pbrt-v3's direct light. */
static void split_directions_have_a_value_of_their_own(void **state)
{
    bsdf_t bsdf = bsdf_of(*state, MATTE);
    bsdf_value_t value;
    bsdf.ns = direction(1, 0, 1);
    bsdf.s = direction(1, 0, -1);
    bsdf.t = v_cross(bsdf.ns, bsdf.s);
    vec3_t up = vec3(0, 0, 1), beyond = direction(-2, 0, 1), below = direction(2, 0, -1);
    assert_false(bsdf_eval(&bsdf, up, beyond, TRANSPORT_RADIANCE, &value));
    assert_true(bsdf_eval_split(&bsdf, up, beyond, TRANSPORT_RADIANCE, &value));
    assert_float_equal(value.f.y, value_at(&bsdf, up, up), 1e-6f);
    assert_false(bsdf_eval_split(&bsdf, up, up, TRANSPORT_RADIANCE, &value));
    assert_false(bsdf_eval_split(&bsdf, up, below, TRANSPORT_RADIANCE, &value)); /* would be transmitted */
}

static void degenerate_derivatives_leave_a_frame(void **state)
{
    const sheets_t *sheets = *state;
    const vec3_t tangents[] = {{0, 0, 0}, {0, 0, 1}, {1e-30f, 0, 0}, {1e30f, 0, 1e30f}, {0, 1e-4f, 1}};
    for (size_t i = 0; i < ARRAY_LENGTH(tangents); i++) {
        bsdf_t bsdf = bsdf_of(sheets, MATTE);
        texture_point_t at = {.n = {0, 0, 1}};
        surface_details_t details = {.dpdu = tangents[i], .dpdv = tangents[i]};
        shading_frame_turn(&bsdf, sheets->scene, sheets->surfaces[MATTE].material, &details, &at);
        assert_frame(&bsdf);
        assert_vector(bsdf.ns, vec3(0, 0, 1));
    }
}

/* A square that is brushed along u: the highlight is wide along s = dp/du only. */
static void roughness_lies_along_dpdu(void **state)
{
    (void)state;
    bsdf_t bsdf = bsdf_alone(rough(MATERIAL_CONDUCTOR, 0, 0.5f, 0.1f));
    vec3_t up = vec3(0, 0, 1);
    assert_vector(bsdf.s, vec3(1, 0, 0));
    assert_true(value_at(&bsdf, up, direction(1, 0, 2)) > 10 * value_at(&bsdf, up, direction(0, 1, 2)));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(samples_follow_the_density),
        cmocka_unit_test(shading_normals_keep_the_density),
        cmocka_unit_test(samples_agree_with_evaluation),
        cmocka_unit_test(radiance_and_importance_are_adjoint),
        cmocka_unit_test(scattering_loses_energy),
        cmocka_unit_test(clear_things_lose_nothing),
        cmocka_unit_test(refraction_scales_radiance),
        cmocka_unit_test(panes_reflect_with_both_faces),
        cmocka_unit_test(uber_shares_out_the_light),
        cmocka_unit_test(values_follow_their_formulas),
        cmocka_unit_test(highlights_follow_their_formulas),
        cmocka_unit_test(roughness_becomes_alpha),
        cmocka_unit_test(regularizing_roughens_what_is_smooth),
        cmocka_unit_test(maps_turn_the_normal),
        cmocka_unit_test(normal_maps_may_follow_pbrt_v4),
        cmocka_unit_test(bumps_of_pbrt_v3_stand_on_unit_tangents),
        cmocka_unit_test(split_directions_have_a_value_of_their_own),
        cmocka_unit_test(degenerate_derivatives_leave_a_frame),
        cmocka_unit_test(roughness_lies_along_dpdu),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
