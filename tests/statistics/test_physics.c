/* What physics demands of the renderer: reciprocity, energy, furnaces whose radiance is known in closed form,
 * and one result from all integrators. */
#include "common/sampler.h"
#include "tests/render_here.h"
#include "worker/render/bsdf.h"
#include "worker/render/warp.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

static const rgb_t black = {0, 0, 0}, white = {1, 1, 1};

static blob_material_t diffuse(float reflectance)
{
    return (blob_material_t){.kind = MATERIAL_DIFFUSE, .reflectance = v_scale(white, reflectance)};
}

static blob_material_t glass(float eta)
{
    return (blob_material_t){.kind = MATERIAL_DIELECTRIC,
                             .reflectance = white,
                             .transmittance = white,
                             .eta = v_scale(white, eta)};
}

/* A metal that absorbs nothing: with eta = 0 the Fresnel reflectance is one at every angle. */
static blob_material_t perfect_metal(float alpha)
{
    return (blob_material_t){
        .kind = MATERIAL_CONDUCTOR, .k = v_scale(white, 3), .alpha_u = alpha, .alpha_v = alpha};
}

static bsdf_t bsdf_at(const blob_material_t *material)
{
    surface_t surface = {.ng = {0, 0, 1}, .ns = {0, 0, 1}, .material = material};
    bsdf_t bsdf;
    bsdf_init(&bsdf, &surface);
    return bsdf;
}

static void scattering_is_reciprocal(void **state)
{
    (void)state;
    const blob_material_t materials[] = {diffuse(0.5f), perfect_metal(0.3f), perfect_metal(0.05f)};
    for (size_t m = 0; m < ARRAY_LENGTH(materials); m++) {
        bsdf_t bsdf = bsdf_at(&materials[m]);
        int compared = 0;
        for (uint32_t i = 0; i < 5000; i++) {
            sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 1, 0, i);
            vec3_t a = warp_sphere(sampler_2d(&sampler)), b = warp_sphere(sampler_2d(&sampler));
            bsdf_value_t there, back;
            bool any = bsdf_eval(&bsdf, a, b, TRANSPORT_RADIANCE, &there);
            assert_int_equal(any, bsdf_eval(&bsdf, b, a, TRANSPORT_IMPORTANCE, &back));
            if (!any || there.f.x == 0) continue;
            assert_float_equal(there.f.x / back.f.x, 1, 1e-3f);
            compared++;
        }
        assert_true(compared > 1000);
    }
}

/* Mean weight of samples: the albedo. */
static double albedo(const blob_material_t *material, vec3_t wo, transport_t mode)
{
    bsdf_t bsdf = bsdf_at(material);
    double sum = 0;
    enum { N = 50000 };
    for (uint32_t i = 0; i < N; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 2, 0, i);
        bsdf_sample_t sample;
        vec2_t u = sampler_2d(&sampler);
        if (bsdf_sample(&bsdf, wo, u, sampler_1d(&sampler), mode, &sample))
            sum += (double)sample.weight.x / N;
    }
    return sum;
}

static void scattering_keeps_energy(void **state)
{
    (void)state;
    for (int i = 1; i <= 10; i++) {
        float z = (float)i / 10;
        vec3_t wo = vec3(sqrtf(1 - z * z), 0, z);
        blob_material_t materials[] = {diffuse(1), perfect_metal(0), glass(1.5f)};
        for (size_t m = 0; m < ARRAY_LENGTH(materials); m++)
            assert_true(fabs(albedo(&materials[m], wo, TRANSPORT_IMPORTANCE) - 1) < 1e-3);
        /* One bounce off rough metal loses what would have bounced again, the more the rougher. */
        blob_material_t smooth = perfect_metal(0.02f), rough = perfect_metal(0.8f);
        double little = albedo(&smooth, wo, TRANSPORT_RADIANCE),
               more = albedo(&rough, wo, TRANSPORT_RADIANCE);
        assert_true(little <= 1.001 && little > 0.97);
        assert_true(more <= 1.001 && more > 0.4 && more < little);
    }
}

/* Radiance grows by the squared index on the way into glass, and shrinks on the way out. */
static void refraction_scales_radiance(void **state)
{
    (void)state;
    blob_material_t material = glass(1.5f);
    bsdf_t bsdf = bsdf_at(&material);
    const vec3_t outside = {0.6f, 0, 0.8f}, inside = {0.6f, 0, -0.8f};
    bsdf_sample_t radiance, importance;
    for (int side = 0; side < 2; side++) {
        vec3_t wo = side == 0 ? outside : inside;
        float factor = side == 0 ? 1 / 2.25f : 2.25f;
        assert_true(bsdf_sample(&bsdf, wo, (vec2_t){0, 0}, 0.999f, TRANSPORT_RADIANCE, &radiance));
        assert_true(bsdf_sample(&bsdf, wo, (vec2_t){0, 0}, 0.999f, TRANSPORT_IMPORTANCE, &importance));
        assert_float_equal(radiance.weight.x, factor * importance.weight.x, 1e-5f);
        assert_float_equal(fabsf(radiance.wi.x), side == 0 ? 0.4f : 0.9f, 1e-5f); /* Snell */
        assert_true(radiance.wi.z * wo.z < 0);
        assert_true(radiance.wi.x * wo.x < 0);
    }
}

/* ---- images -------------------------------------------------------------------------------------------- */

typedef struct {
    double mean, error; /* of the red channel; the standard error of the mean from the two halves */
} estimate_t;

static estimate_t estimate(const scene_blob_t *blob, integrator_t integrator, uint32_t spp, int max_depth)
{
    job_settings_t settings = blob_default_settings(blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.max_depth = max_depth;
    settings.seed = 77;
    film_t *film = render_here(blob, &settings);
    film_image_t image;
    film_resolve(film, &image);
    assert_int_equal(film->counts.dropped, 0);
    assert_int_equal(film->counts.overflows, 0);
    estimate_t e = {0, 0};
    size_t pixels = (size_t)image.width * (size_t)image.height;
    for (size_t i = 0; i < pixels; i++) {
        e.mean += (double)image.sum[3 * i] / (double)pixels;
        e.error += (double)image.noise[3 * i] * (double)image.noise[3 * i];
    }
    e.error = sqrt(e.error) / (double)pixels;
    film_image_free(&image);
    film_destroy(&film);
    return e;
}

static void assert_estimate(const char *what, estimate_t e, double truth, double slack)
{
    if (!(fabs(e.mean - truth) <= 4.5 * e.error + slack))
        fail_msg("%s: %.6f +- %.6f, expected %.6f", what, e.mean, e.error, truth);
    if (!(e.error < 0.02 * truth)) fail_msg("%s: too noisy to tell: %.6f +- %.6f", what, e.mean, e.error);
}

/* A closed room whose walls all emit L and reflect a share r: L (1 + r + ... + r^maxdepth) everywhere. */
static void white_furnace(void **state)
{
    (void)state;
    test_scene_t scene = test_scene_begin(vec3(0.3f, 0.2f, 0.1f), 70, 16);
    uint32_t wall = test_scene_material(&scene, diffuse(0.6f));
    test_scene_room(&scene, vec3(-1, -1.5f, -2), vec3(2, 1, 3), wall, white);
    test_scene_finish(&scene);
    for (int depth = 0; depth <= 6; depth += 2) {
        double truth = (1 - pow(0.6, depth + 1)) / 0.4;
        assert_estimate("path", estimate(&scene.blob, INTEGRATOR_PATH, 128, depth), truth, 1e-5);
        assert_estimate("bdpt", estimate(&scene.blob, INTEGRATOR_BDPT, 128, depth), truth, 1e-5);
        assert_estimate("light", estimate(&scene.blob, INTEGRATOR_LIGHT, 1024, depth), truth, 1e-5);
    }
    test_scene_end(&scene);
}

/* A ball of clear glass in a room that glows all around and reflects nothing cannot be seen. */
static void glass_vanishes_in_a_furnace(void **state)
{
    (void)state;
    test_scene_t scene = test_scene_begin(vec3(0, 0, -2.2f), 40, 16);
    uint32_t wall = test_scene_material(&scene, diffuse(0));
    uint32_t ball = test_scene_material(&scene, glass(1.5f));
    test_scene_room(&scene, vec3(-3, -3, -3), vec3(3, 3, 3), wall, white);
    test_scene_sphere(&scene, vec3(0, 0, 0), 1, ball, black);
    test_scene_finish(&scene);
    assert_estimate("path", estimate(&scene.blob, INTEGRATOR_PATH, 64, 40), 1, 1e-4);
    assert_estimate("bdpt", estimate(&scene.blob, INTEGRATOR_BDPT, 64, 40), 1, 1e-4);
    test_scene_end(&scene);
}

/* A diffuse room with a small lamp, a metal ball and, seen only from afar, a ball lamp: all three integrators
 * agree. (No specular surface, which light tracing could not see.) */
static void integrators_agree(void **state)
{
    (void)state;
    test_scene_t scene = test_scene_begin(vec3(0, 0, -0.9f), 60, 24);
    uint32_t wall = test_scene_material(&scene, diffuse(0.7f)),
             lamp = test_scene_material(&scene, diffuse(0));
    uint32_t metal = test_scene_material(&scene, perfect_metal(0.3f));
    test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), wall, black);
    test_scene_rectangle(&scene, vec3(-0.2f, 0.98f, 0.1f), vec3(0.4f, 0, 0), vec3(0, 0, 0.4f), lamp,
                         vec3(9, 8, 7));
    test_scene_sphere(&scene, vec3(0.4f, -0.6f, 0.4f), 0.35f, metal, black);
    test_scene_sphere(&scene, vec3(-0.5f, -0.2f, 0.5f), 0.1f, lamp, vec3(20, 10, 10));
    test_scene_finish(&scene);
    estimate_t path = estimate(&scene.blob, INTEGRATOR_PATH, 1024, 5);
    estimate_t bdpt = estimate(&scene.blob, INTEGRATOR_BDPT, 512, 5);
    estimate_t light = estimate(&scene.blob, INTEGRATOR_LIGHT, 4096, 5);
    assert_estimate("bdpt against path", bdpt, path.mean, 4.5 * path.error);
    assert_estimate("light against path", light, path.mean, 4.5 * path.error);
    test_scene_end(&scene);
}

/* How a job is cut into units must not show in a single bit. */
static void units_add_up_exactly(void **state)
{
    (void)state;
    test_scene_t scene = test_scene_begin(vec3(0, 0, -0.9f), 60, 40);
    uint32_t wall = test_scene_material(&scene, diffuse(0.7f));
    uint32_t ball = test_scene_material(&scene, glass(1.5f));
    test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), wall, black);
    test_scene_rectangle(&scene, vec3(-0.2f, 0.98f, 0.1f), vec3(0.4f, 0, 0), vec3(0, 0, 0.4f), wall, white);
    test_scene_sphere(&scene, vec3(0.4f, -0.6f, 0.4f), 0.35f, ball, black);
    test_scene_finish(&scene);
    job_settings_t settings = blob_default_settings(&scene.blob);
    settings.spp = 13;
    film_t *whole = render_here(&scene.blob, &settings), *parts;
    assert_int_equal(film_new(&settings, &parts).code, RESULT_OK);
    renderer_t *renderer;
    assert_int_equal(renderer_new(&scene.blob, &settings, &renderer).code, RESULT_OK);
    unit_result_t result = {0};
    batch_t batch;
    batch_init(&batch, &settings);
    atomic_bool cancel = false;
    for (uint32_t first = 0; first < settings.spp; first += 5)
        for (uint32_t tile = job_tile_count(&settings); tile-- > 0;) {
            unit_t unit = {tile, first, (uint32_t)int_min(5, (int)(settings.spp - first))};
            assert_true(renderer_unit(renderer, &unit, &result, &cancel));
            batch_add(&batch, &result);
            if (tile != 1) continue;
            film_merge(parts, &batch);
            batch_clear(&batch);
        }
    film_merge(parts, &batch);
    size_t bytes = batch_splat_values(&settings) * sizeof *whole->eye;
    assert_memory_equal(whole->eye, parts->eye, bytes);
    assert_memory_equal(whole->splat, parts->splat, bytes);
    assert_memory_equal(whole->samples, parts->samples, bytes / sizeof(int64_t) / 3 * sizeof(uint32_t));
    assert_memory_equal(whole->counts.light_paths, parts->counts.light_paths,
                        sizeof whole->counts.light_paths);
    unit_result_free(&result);
    batch_free(&batch);
    renderer_destroy(&renderer);
    film_destroy(&whole);
    film_destroy(&parts);
    test_scene_end(&scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(scattering_is_reciprocal),    cmocka_unit_test(scattering_keeps_energy),
        cmocka_unit_test(refraction_scales_radiance),  cmocka_unit_test(white_furnace),
        cmocka_unit_test(glass_vanishes_in_a_furnace), cmocka_unit_test(integrators_agree),
        cmocka_unit_test(units_add_up_exactly),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
