/* Planned jobs (master/schedule/next_round.h) with the real renderer: the error that ends a job is the error,
 * adaptive images are right on average and better than others where the noise is uneven, and the same bits
 * however they were made. */
#include "client/import/import.h"
#include "tests/films.h"
#include "tests/reference.h"
#include "tests/render_here.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const rgb_t black = {0, 0, 0};

/* ---- the error ----------------------------------------------------------------------------------------- */

static void check_error(const char *scene, double target, bool adaptive, uint64_t seed)
{
    char *path = mem_printf("scenes/%s/scene.pbrt", scene);
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    planned_t planned;
    assert_int_equal(import_scene_blob(path, NULL, &bytes, &size).code, RESULT_OK);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    job_settings_t settings = blob_default_settings(&blob);
    settings.spp = JOB_MAX_SPP;
    settings.error = target;
    settings.adaptive = adaptive;
    settings.features = false;
    settings.seed = seed;
    film_t *film = render_planned(&blob, &settings, 1 << 20, 1, &planned);
    estimate_image_t estimate = reference_estimate(film), reference = reference_read(scene);
    double error = reference_error(&estimate, &reference);
    print_message("%s%s: to %g in %u rounds, %.1f samples a pixel, estimate %.4f, true %.4f\n", scene,
                  adaptive ? ", adaptive" : "", target, planned.rounds, planned.samples, planned.error,
                  error);
    assert_true(planned.error <= target && planned.error > 0.8 * target);
    assert_true(planned.error == film_noise(film, NULL));
    assert_true(error > 0.75 * target && error < 1.25 * target);
    estimate_image_free(&estimate);
    estimate_image_free(&reference);
    film_destroy(&film);
    free(planned.shown);
    free(bytes);
    free(path);
}

/* Against the images of another renderer. */
static void the_error_that_ends_a_job_is_the_error(void **state)
{
    (void)state;
    check_error("cornell", 0.05, false, 1);
    check_error("seed-hidden", 0.08, false, 2);
    check_error("cornell", 0.06, true, 3);
}

/* ---- adaptive images ----------------------------------------------------------------------------------- */

static blob_material_t diffuse(float reflectance)
{
    blob_material_t material = {.kind = MATERIAL_DIFFUSE};
    material.values[VALUE_REFLECTANCE] = blob_constant(reflectance);
    return material;
}

/* A small lamp and a ball in a room. The light that reaches the camera over one surface can be had in two
 * ways: a path from there runs into the lamp (s = 0, t = 3), which is rare, or it is joined to the lamp (s =
 * 1, t = 2). */
static test_scene_t lamp_scene(int resolution, float ball, float lamp, bool room)
{
    test_scene_t scene = test_scene_begin(vec3(0, 0, -0.9f), 60, resolution);
    uint32_t wall = test_scene_material(&scene, diffuse(0.7f));
    if (room) test_scene_room(&scene, vec3(-1, -1, -1), vec3(1, 1, 1), wall, black);
    test_scene_sphere(&scene, vec3(-0.1f, -0.1f, 0.3f), ball, wall, black);
    test_scene_sphere(&scene, vec3(0.2f, 0.9f - lamp, -0.2f), lamp, wall, vec3(10, 10, 10));
    test_scene_finish(&scene);
    return scene;
}

static job_settings_t one_strategy(const scene_blob_t *blob, int s, int t)
{
    job_settings_t settings = blob_default_settings(blob);
    settings.sampler = SAMPLER_INDEPENDENT;
    settings.features = false;
    settings.tile_size = 8;
    settings.max_depth = 2;
    settings.strategy_s = s;
    settings.strategy_t = t;
    settings.unweighted = s + t > 0;
    return settings;
}

enum { TILES = 4, MEANS = TILES + 1 };

/* Running sums over many images: of the means of the tiles and of the image. */
typedef struct {
    double sum[MEANS], square[MEANS];
    int count;
} tally_t;

static void tally_add(tally_t *tally, const film_t *film)
{
    film_image_t image;
    double means[MEANS] = {0};
    film_resolve(film, &image);
    for (uint32_t t = 0; t < TILES; t++) {
        rect_t rect = job_tile_rect(&film->settings, t);
        for (int y = rect.y0; y < rect.y1; y++)
            for (int x = rect.x0; x < rect.x1; x++)
                means[t] +=
                    (double)image.sum[3 * (y * image.width + x)] / job_tile_pixels(&film->settings, t);
        means[TILES] += means[t] / TILES;
    }
    for (int i = 0; i < MEANS; i++) {
        tally->sum[i] += means[i];
        tally->square[i] += means[i] * means[i];
    }
    tally->count++;
    film_image_free(&image);
}

static double tally_mean(const tally_t *tally, int tile)
{
    return tally->sum[tile] / tally->count;
}

static double tally_variance(const tally_t *tally, int tile)
{
    double mean = tally_mean(tally, tile);
    return (tally->square[tile] / tally->count - mean * mean) / (tally->count - 1);
}

/* Eight long renders of so many samples. They need no more, in all, than the images that are held to them. */
static tally_t tally_truth(const scene_blob_t *blob, job_settings_t settings, uint32_t spp)
{
    tally_t truth = {0};
    settings.spp = spp;
    for (int seed = 1; seed <= 8; seed++) {
        settings.seed = (uint64_t)seed << 32;
        film_t *film = render_here(blob, &settings);
        tally_add(&truth, film);
        film_destroy(&film);
    }
    return truth;
}

static void check_means(const char *name, const tally_t *means, const tally_t *truth)
{
    for (int t = 0; t < MEANS; t++) {
        double a = tally_mean(means, t), p = tally_mean(truth, t);
        double z = (a - p) / sqrt(tally_variance(means, t) + tally_variance(truth, t));
        print_message("%s, mean %d: %.5f, truth %.5f, z %.2f\n", name, t, a, p, z);
        assert_true(fabs(z) < 4);
    }
}

/* The mean of adaptive images of 64 samples in three rounds. */
static void check_bias(const scene_blob_t *blob, job_settings_t settings, int seeds, job_settings_t truth,
                       uint32_t spp)
{
    tally_t adaptive = {0}, plain = tally_truth(blob, truth, spp);
    settings.spp = 64;
    settings.adaptive = true;
    for (int seed = 1; seed <= seeds; seed++) {
        planned_t planned;
        settings.seed = (uint64_t)seed;
        film_t *film = render_planned(blob, &settings, 1 << 20, 1, &planned);
        assert_true(planned.samples == 64 && planned.rounds == 3);
        tally_add(&adaptive, film);
        free(planned.shown);
        film_destroy(&film);
    }
    char name[64];
    snprintf(name, sizeof name, "adaptive, s = %d, t = %d", settings.strategy_s, settings.strategy_t);
    check_means(name, &adaptive, &plain);
}

/* Few samples, specks of light, tiles of 64 pixels: an image whose rounds had shares by their samples would
 * be darker by 8 % here, since a tile that had luck with a speck would get more samples that dilute it. */
static void adaptive_images_are_right_on_average(void **state)
{
    (void)state;
    test_scene_t scene = lamp_scene(16, 0.35f, 0.04f, true);
    check_bias(&scene.blob, one_strategy(&scene.blob, 0, 3), 400, one_strategy(&scene.blob, 1, 2), 128);
    check_bias(&scene.blob, one_strategy(&scene.blob, 0, 0), 20, one_strategy(&scene.blob, 0, 0), 256);
    test_scene_end(&scene);
}

/* Fifty images of 64 samples, the last 60 of which go by plans. Their mean is known seven times as sharply as
 * one of them, so that a plan which tilted them would show. */
static void images_that_learn_are_right_on_average(void **state)
{
    (void)state;
    test_scene_t scene = lamp_scene(16, 0.35f, 0.04f, true);
    job_settings_t settings = blob_default_settings(&scene.blob), plain;
    settings.tile_size = 8;
    plain = settings;
    tally_t learned = {0};
    settings.spp = 64;
    settings.learn = true;
    plain.learn = false;
    for (int seed = 1; seed <= 50; seed++) {
        settings.seed = (uint64_t)seed;
        film_t *film = render_here(&scene.blob, &settings);
        tally_add(&learned, film);
        film_destroy(&film);
    }
    tally_t truth = tally_truth(&scene.blob, plain, 384);
    check_means("learned", &learned, &truth);
    test_scene_end(&scene);
}

/* Tiles that cut the blocks of light subpaths, most of which a plan leaves out: a sample brings as many
 * splats in each tile. Splats are divided by the samples of all tiles, and an adaptive image has more in
 * some. */
static void all_tiles_bring_light(void **state)
{
    (void)state;
    enum { SIDE = 32, FIRST = 32, SAMPLES = 32 };
    test_scene_t scene = lamp_scene(SIDE, 0.25f, 0.3f, false);
    job_settings_t settings = blob_default_settings(&scene.blob);
    settings.tile_size = SIDE / 2;
    settings.spp = FIRST;
    settings.learn = true;
    batch_t batch;
    renderer_t *renderer;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    double brought[TILES] = {0}, mean = 0;
    render_batch_here(&scene.blob, &settings, &batch);
    settings.spp = FIRST + SAMPLES;
    assert_int_equal(renderer_new(&scene.blob, &settings, &renderer).code, RESULT_OK);
    plan_here(renderer, &settings, learning_pass(&settings, FIRST), batch_frame(&batch, SUM_LESSONS));
    for (uint32_t tile = 0; tile < TILES; tile++) {
        unit_t unit = {tile, FIRST, SAMPLES};
        assert_true(renderer_unit(renderer, &unit, &result, &cancel));
        for (size_t i = 0; i < result.splat_count; i++) brought[tile] += (double)result.splats[i].rgb[1];
        mean += brought[tile] / TILES;
    }
    for (uint32_t tile = 0; tile < TILES; tile++) {
        print_message("tile %u brings %.3f of what a tile brings\n", tile, brought[tile] / mean);
        assert_float_equal(brought[tile] / mean, 1, 0.2);
    }
    unit_result_free(&result);
    renderer_destroy(&renderer);
    batch_free(&batch);
    test_scene_end(&scene);
}

/* What is splatted by a unit of one tile of all, of a pass that goes by the plan which a job made. */
static size_t splats_of_pass(const scene_blob_t *blob, const job_settings_t *settings, uint32_t pass,
                             const int64_t *lessons)
{
    renderer_t *renderer;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    unit_t unit = {0, learning_pass_begin(settings, pass), 2};
    assert_int_equal(renderer_new(blob, settings, &renderer).code, RESULT_OK);
    plan_here(renderer, settings, pass, lessons);
    assert_true(renderer_unit(renderer, &unit, &result, &cancel));
    size_t count = result.splat_count;
    unit_result_free(&result);
    renderer_destroy(&renderer);
    return count;
}

/* A spot behind a ball of glass, and nothing else lit: no eye subpath sees a thing, so that they teach
 * nothing of how bright the picture is. Light subpaths must not get rare for that. */
static void what_only_light_subpaths_find_is_learned(void **state)
{
    (void)state;
    static const char text[] =
        "LookAt 0 3 -5  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" [40]\n"
        "Film \"image\" \"integer xresolution\" [32] \"integer yresolution\" [32]\n"
        "Sampler \"sobol\" \"integer pixelsamples\" [32]\nIntegrator \"bdpt\"\nWorldBegin\n"
        "LightSource \"spot\" \"point from\" [0 4 0] \"point to\" [0 0 0] \"float coneangle\" [12]\n"
        "Material \"matte\"\nShape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3]"
        " \"point P\" [-4 0 -4  4 0 -4  4 0 4  -4 0 4]\n"
        "Material \"glass\"\nTranslate 0 2.6 0\nShape \"sphere\" \"float radius\" [0.8]\nWorldEnd\n";
    char *folder = scratch_new(), *path = scratch_path(folder, "spot.pbrt");
    scratch_write(path, text, sizeof text - 1);
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    batch_t batch;
    assert_int_equal(import_scene_blob(path, NULL, &bytes, &size).code, RESULT_OK);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    job_settings_t settings = blob_default_settings(&blob);
    settings.tile_size = 32;
    render_batch_here(&blob, &settings, &batch);
    const int64_t *lessons = batch_frame(&batch, SUM_LESSONS);
    size_t first = splats_of_pass(&blob, &settings, 0, lessons),
           planned = splats_of_pass(&blob, &settings, 4, lessons);
    print_message("%zu splats of two samples before there are plans, %zu with one\n", first, planned);
    assert_true(2 * planned > first);
    batch_free(&batch);
    free(bytes);
    free(path);
    scratch_destroy(&folder);
}

/* A ball in front of nothing: the noise is in a part of the image. */
static void adaptive_images_are_better(void **state)
{
    (void)state;
    enum { SIDE = 64, SEEDS = 2 };
    test_scene_t scene = lamp_scene(SIDE, 0.25f, 0.3f, false);
    job_settings_t settings = one_strategy(&scene.blob, 1, 2);
    settings.spp = 512;
    film_t *film = render_here(&scene.blob, &settings);
    estimate_image_t truth = reference_estimate(film);
    double error[2] = {0, 0};
    film_destroy(&film);
    settings = one_strategy(&scene.blob, 0, 3);
    settings.spp = 128;
    for (int seed = 1; seed <= SEEDS; seed++)
        for (int adaptive = 0; adaptive < 2; adaptive++) {
            planned_t planned = {0};
            settings.seed = (uint64_t)seed;
            settings.adaptive = adaptive;
            film = adaptive ? render_planned(&scene.blob, &settings, 1 << 20, 1, &planned)
                            : render_here(&scene.blob, &settings);
            estimate_image_t estimate = reference_estimate(film);
            error[adaptive] += pow(reference_error(&estimate, &truth), 2) / SEEDS;
            estimate_image_free(&estimate);
            if (adaptive) {
                film_image_t image;
                double shown = 0;
                film_resolve(film, &image);
                for (size_t p = 0; p < SIDE * SIDE; p++) shown += (double)planned.shown[p] / (SIDE * SIDE);
                assert_true(fabs(shown - 128) < 1e-6);
                assert_true(image.samples[0] == 128); /* what the film knows: the mean */
                film_image_free(&image);
                free(planned.shown);
            }
            film_destroy(&film);
        }
    print_message("uneven noise, 128 samples a pixel: error %.4f, adaptive %.4f\n", sqrt(error[0]),
                  sqrt(error[1]));
    assert_true(error[1] < 0.5 * error[0]);
    estimate_image_free(&truth);
    test_scene_end(&scene);
}

static void planned_images_are_reproducible(void **state)
{
    (void)state;
    test_scene_t scene = lamp_scene(48, 0.35f, 0.15f, true);
    job_settings_t settings = blob_default_settings(&scene.blob);
    settings.tile_size = 8;
    settings.spp = 100;
    settings.adaptive = true;
    settings.error = 0.02;
    planned_t first, second;
    film_t *a = render_planned(&scene.blob, &settings, 1 << 20, 1, &first);
    film_t *b = render_planned(&scene.blob, &settings, 64 * 3, 5, &second);
    size_t pixels = 48 * 48;
    assert_int_equal(first.rounds, second.rounds);
    assert_true(first.error == second.error);
    assert_memory_equal(first.shown, second.shown, pixels * sizeof(float));
    assert_true(same_film(a, b));
    film_destroy(&a);
    film_destroy(&b);
    free(first.shown);
    free(second.shown);
    test_scene_end(&scene);
}

int main(int argc, char **argv)
{
    if (argc > 1) cmocka_set_test_filter(argv[1]); /* one test alone */
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_error_that_ends_a_job_is_the_error),
                                       cmocka_unit_test(adaptive_images_are_right_on_average),
                                       cmocka_unit_test(images_that_learn_are_right_on_average),
                                       cmocka_unit_test(all_tiles_bring_light),
                                       cmocka_unit_test(what_only_light_subpaths_find_is_learned),
                                       cmocka_unit_test(adaptive_images_are_better),
                                       cmocka_unit_test(planned_images_are_reproducible)};
    return cmocka_run_group_tests_name("convergence", tests, NULL, NULL);
}
