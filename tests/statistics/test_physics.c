/* What physics demands of the renderer: furnaces whose radiance is known in closed form, one result from all
 * integrators, and one from all ways to cut a job. */
#include "tests/films.h"
#include "tests/render_here.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

static const rgb_t black = {0, 0, 0}, white = {1, 1, 1};

static blob_material_t diffuse(float reflectance)
{
    blob_material_t material = {.kind = MATERIAL_DIFFUSE};
    material.values[VALUE_REFLECTANCE] = blob_constant(reflectance);
    return material;
}

static blob_material_t glass(float eta, float alpha)
{
    blob_material_t material = {.kind = MATERIAL_DIELECTRIC};
    material.values[VALUE_REFLECTANCE] = material.values[VALUE_TRANSMITTANCE] = blob_constant(1);
    material.values[VALUE_ETA] = blob_constant(eta);
    material.values[VALUE_ROUGHNESS_U] = material.values[VALUE_ROUGHNESS_V] = blob_constant(alpha);
    return material;
}

/* A metal that absorbs nothing: with eta = 0 the Fresnel reflectance is one at every angle. */
static blob_material_t perfect_metal(float alpha)
{
    blob_material_t material = {.kind = MATERIAL_CONDUCTOR};
    material.values[VALUE_REFLECTANCE] = blob_constant(1);
    material.values[VALUE_K] = blob_constant(3);
    material.values[VALUE_ROUGHNESS_U] = material.values[VALUE_ROUGHNESS_V] = blob_constant(alpha);
    return material;
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
    uint32_t ball = test_scene_material(&scene, glass(1.5f, 0));
    test_scene_room(&scene, vec3(-3, -3, -3), vec3(3, 3, 3), wall, white);
    test_scene_sphere(&scene, vec3(0, 0, 0), 1, ball, black);
    test_scene_finish(&scene);
    assert_estimate("path", estimate(&scene.blob, INTEGRATOR_PATH, 64, 40), 1, 1e-4);
    assert_estimate("bdpt", estimate(&scene.blob, INTEGRATOR_BDPT, 64, 40), 1, 1e-4);
    test_scene_end(&scene);
}

/* A diffuse room with a small lamp, a ball lamp, balls of rough metal and rough glass, and sheets of many
 * lobes: all three integrators agree. (No specular surface, which light tracing could not see.) */
static void integrators_agree(void **state)
{
    (void)state;
    test_scene_t scene = test_scene_begin(vec3(0, 0, -0.9f), 60, 24);
    uint32_t wall = test_scene_material(&scene, diffuse(0.7f)),
             lamp = test_scene_material(&scene, diffuse(0));
    uint32_t metal = test_scene_material(&scene, perfect_metal(0.3f));
    uint32_t frosted = test_scene_material(&scene, glass(1.5f, 0.3f));
    blob_material_t principled = {.kind = MATERIAL_DISNEY};
    principled.values[VALUE_REFLECTANCE] = blob_colour_value(vec3(0.6f, 0.4f, 0.2f));
    principled.values[VALUE_ROUGHNESS_U] = blob_constant(0.5f);
    principled.values[VALUE_ETA] = blob_constant(1.5f);
    principled.values[VALUE_SHEEN] = blob_constant(0.5f);
    principled.values[VALUE_CLEARCOAT] = blob_constant(0.5f);
    blob_material_t leaf = {.kind = MATERIAL_TRANSLUCENT};
    leaf.values[VALUE_REFLECTANCE] = leaf.values[VALUE_SPECULAR] = blob_constant(0.5f);
    leaf.values[VALUE_REFLECT] = leaf.values[VALUE_TRANSMIT] = blob_constant(0.5f);
    leaf.values[VALUE_ROUGHNESS_U] = leaf.values[VALUE_ROUGHNESS_V] = blob_constant(0.4f);
    uint32_t disney = test_scene_material(&scene, principled), sheet = test_scene_material(&scene, leaf);
    test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), wall, black);
    test_scene_rectangle(&scene, vec3(-0.2f, 0.98f, 0.1f), vec3(0.4f, 0, 0), vec3(0, 0, 0.4f), lamp,
                         vec3(9, 8, 7));
    test_scene_sphere(&scene, vec3(0.4f, -0.6f, 0.4f), 0.35f, metal, black);
    test_scene_sphere(&scene, vec3(-0.5f, -0.2f, 0.5f), 0.1f, lamp, vec3(20, 10, 10));
    test_scene_sphere(&scene, vec3(-0.4f, -0.7f, 0.1f), 0.25f, frosted, black);
    test_scene_rectangle(&scene, vec3(-0.9f, 0.2f, 0.9f), vec3(0.8f, 0, 0), vec3(0, 0.6f, -0.3f), disney,
                         black);
    test_scene_rectangle(&scene, vec3(0.2f, 0.1f, 0.9f), vec3(0.7f, 0, 0), vec3(0, 0.6f, -0.3f), sheet,
                         black);
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
    uint32_t ball = test_scene_material(&scene, glass(1.5f, 0));
    test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), wall, black);
    test_scene_rectangle(&scene, vec3(-0.2f, 0.98f, 0.1f), vec3(0.4f, 0, 0), vec3(0, 0, 0.4f), wall, white);
    test_scene_sphere(&scene, vec3(0.4f, -0.6f, 0.4f), 0.35f, ball, black);
    test_scene_finish(&scene);
    job_settings_t settings = blob_default_settings(&scene.blob);
    settings.spp = 13;
    settings.learn = false; /* so that units may be any samples */
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
            assert_int_equal(merge_as_master(parts, &batch, NULL, 1).code, RESULT_OK);
            batch_clear(&batch);
        }
    assert_int_equal(merge_as_master(parts, &batch, NULL, 1).code, RESULT_OK);
    assert_true(same_film(whole, parts));
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
        cmocka_unit_test(white_furnace),
        cmocka_unit_test(glass_vanishes_in_a_furnace),
        cmocka_unit_test(integrators_agree),
        cmocka_unit_test(units_add_up_exactly),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
