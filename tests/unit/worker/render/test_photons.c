/* Photons: the grid finds what is near, each once; sets do not depend on who asks for them, nor in which
 * order; what is cancelled can be gone on with. */
#include "tests/films.h"
#include "tests/render_here.h"
#include "worker/render/integrator/photons.h"

#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static float random_float(uint64_t *state)
{
    *state = sampler_mix(*state + 0x9E3779B97F4A7C15u);
    return sampler_float((uint32_t)*state);
}

/* ---- the grid ------------------------------------------------------------------------------------------ */

enum { POINTS = 2000 };

static void check_grid(float scale, float radius)
{
    uint64_t random = 1;
    vec3_t points[POINTS];
    uint32_t order[POINTS], from[POINTS];
    photon_grid_t grid;
    for (int i = 0; i < POINTS; i++)
        points[i] = vec3(scale * (random_float(&random) - 0.5f), scale * (random_float(&random) - 0.5f),
                         scale * 0.1f * random_float(&random));
    photon_grid_build(&grid, points, POINTS, radius, order);
    for (uint32_t i = 0; i < POINTS; i++) from[order[i]] = i;
    int met = 0;
    for (int k = 0; k < POINTS; k++) {
        vec3_t p = points[k];
        uint8_t found[POINTS] = {0};
        photon_range_t ranges[PHOTON_CELLS];
        int count = photon_grid_near(&grid, p, ranges);
        for (int r = 0; r < count; r++)
            for (uint32_t i = ranges[r].first; i < ranges[r].end; i++) {
                found[from[i]]++;
                if (i > ranges[r].first) assert_true(from[i] > from[i - 1]); /* in their order */
            }
        for (int i = 0; i < POINTS; i++) {
            bool near = v_length2(v_sub(points[i], p)) < 0.999f * radius * radius;
            if (near) assert_int_equal(found[i], 1);
            assert_true(found[i] <= 1);
            met += near;
        }
    }
    assert_true(met >= POINTS); /* each finds itself */
    photon_grid_free(&grid);
}

static void the_grid_finds_all_once(void **state)
{
    (void)state;
    check_grid(1, 0.02f);
    check_grid(1, 0.2f);
    check_grid(1, 3); /* everything in a few cells */
    check_grid(1e6f, 1e3f);
    check_grid(1e6f, 1e-6f); /* coordinates beyond what cells can count */
}

static void an_empty_grid_finds_nothing(void **state)
{
    (void)state;
    photon_grid_t grid;
    photon_range_t ranges[PHOTON_CELLS];
    photon_grid_build(&grid, NULL, 0, 1, NULL);
    assert_int_equal(photon_grid_near(&grid, vec3(0, 0, 0), ranges), 0);
    photon_grid_free(&grid);
}

/* ---- sets ---------------------------------------------------------------------------------------------- */

static blob_material_t diffuse(float reflectance)
{
    blob_material_t material = {.kind = MATERIAL_DIFFUSE};
    material.values[VALUE_REFLECTANCE] = blob_constant(reflectance);
    return material;
}

static test_scene_t glass_room(void)
{
    blob_material_t glass = {.kind = MATERIAL_DIELECTRIC};
    glass.values[VALUE_REFLECTANCE] = glass.values[VALUE_TRANSMITTANCE] = blob_constant(1);
    glass.values[VALUE_ETA] = blob_constant(1.5f);
    test_scene_t scene = test_scene_begin(vec3(0, 0, -0.9f), 60, 40);
    uint32_t wall = test_scene_material(&scene, diffuse(0.7f)), ball = test_scene_material(&scene, glass);
    test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), wall, vec3(0, 0, 0));
    test_scene_rectangle(&scene, vec3(-0.2f, 0.98f, 0.1f), vec3(0.4f, 0, 0), vec3(0, 0, 0.4f), wall,
                         vec3(1, 1, 1));
    test_scene_sphere(&scene, vec3(0.4f, -0.6f, 0.4f), 0.35f, ball, vec3(0, 0, 0));
    test_scene_finish(&scene);
    return scene;
}

enum { SPP = 13 };

static job_settings_t settings_of(const test_scene_t *scene)
{
    job_settings_t settings = blob_default_settings(&scene->blob);
    settings.integrator = INTEGRATOR_VCM;
    settings.spp = SPP;
    return settings;
}

/* What a thread renders: every second unit of one sample, from the last sample down. */
typedef struct {
    const renderer_t *renderer;
    const job_settings_t *settings;
    uint32_t number;
    batch_t batch;
} share_t;

static void *render_share(void *argument)
{
    share_t *share = argument;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    for (uint32_t i = SPP; i-- > 0;)
        for (uint32_t tile = share->number; tile < job_tile_count(share->settings); tile += 2) {
            unit_t unit = {tile, i, 1};
            if (renderer_unit(share->renderer, &unit, &result, &cancel)) batch_add(&share->batch, &result);
        }
    unit_result_free(&result);
    return NULL;
}

static void threads_and_orders_make_no_difference(void **state)
{
    (void)state;
    test_scene_t scene = glass_room();
    job_settings_t settings = settings_of(&scene);
    film_t *whole = render_here(&scene.blob, &settings), *parts;
    renderer_t *renderer;
    assert_int_equal(renderer_new(&scene.blob, &settings, &renderer).code, RESULT_OK);
    assert_int_equal(film_new(&settings, &parts).code, RESULT_OK);
    share_t shares[2];
    pthread_t threads[2];
    for (uint32_t k = 0; k < 2; k++) {
        shares[k] = (share_t){.renderer = renderer, .settings = &settings, .number = k};
        batch_init(&shares[k].batch, &settings);
        assert_int_equal(pthread_create(&threads[k], NULL, render_share, &shares[k]), 0);
    }
    for (int k = 0; k < 2; k++) {
        pthread_join(threads[k], NULL);
        assert_int_equal(merge_as_master(parts, &shares[k].batch, NULL, 1).code, RESULT_OK);
        batch_free(&shares[k].batch);
    }
    assert_true(same_film(whole, parts));
    renderer_destroy(&renderer);
    film_destroy(&whole);
    film_destroy(&parts);
    test_scene_end(&scene);
}

static void what_was_cancelled_goes_on(void **state)
{
    (void)state;
    test_scene_t scene = glass_room();
    job_settings_t settings = settings_of(&scene);
    renderer_t *renderer;
    assert_int_equal(renderer_new(&scene.blob, &settings, &renderer).code, RESULT_OK);
    unit_result_t result = {0};
    unit_t unit = {0, 0, 2};
    atomic_bool cancel = true;
    assert_false(renderer_unit(renderer, &unit, &result, &cancel));
    atomic_store(&cancel, false);
    assert_true(renderer_unit(renderer, &unit, &result, &cancel));
    unit_result_free(&result);
    renderer_destroy(&renderer);
    test_scene_end(&scene);
}

/* A narrow lobe is no place for merging, unless a wide one is beside it. */
static void narrow_lobes_do_not_merge(void **state)
{
    (void)state;
    bsdf_t bsdf = {.count = 1};
    bsdf.lobes[0] = (lobe_t){.kind = &lobe_rough_conductor, .alpha = {0.05f, 0.05f}};
    assert_false(bsdf_is_broad(&bsdf));
    bsdf.lobes[1] = (lobe_t){.kind = &lobe_lambert};
    bsdf.count = 2;
    assert_true(bsdf_is_broad(&bsdf));
    bsdf.lobes[1].kind = &lobe_mirror;
    assert_false(bsdf_is_broad(&bsdf));
    bsdf.lobes[0].alpha[1] = 0.3f;
    assert_true(bsdf_is_broad(&bsdf));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_grid_finds_all_once),
        cmocka_unit_test(an_empty_grid_finds_nothing),
        cmocka_unit_test(threads_and_orders_make_no_difference),
        cmocka_unit_test(what_was_cancelled_goes_on),
        cmocka_unit_test(narrow_lobes_do_not_merge),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
