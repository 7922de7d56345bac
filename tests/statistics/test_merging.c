/* vcm: what merging adds is weighed rightly, vanishes with its radius, and brings what connections do not
 * find. It is biased, so images are held to what merging may blur, or are rendered with a small radius. */
#include "client/import/import.h"
#include "tests/reference.h"
#include "tests/render_here.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static char *folder;

typedef struct {
    integrator_t integrator;
    uint32_t spp;
    double radius;
    int max_depth, side; /* 0: the scene's */
    uint64_t seed;
    bool learn;
} wish_t;

static film_t *render_film(const char *path, const wish_t *wish)
{
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    result_t made = import_scene_blob(path, NULL, &bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    job_settings_t settings = blob_default_settings(&blob);
    settings.integrator = wish->integrator;
    settings.spp = wish->spp;
    settings.merge_radius = wish->radius;
    settings.seed = 5 + wish->seed;
    settings.learn = wish->learn;
    settings.features = false;
    if (wish->max_depth > 0) settings.max_depth = wish->max_depth;
    if (wish->side > 0) settings.width = settings.height = wish->side;
    film_t *film = render_here(&blob, &settings);
    assert_int_equal(film->counts.dropped, 0);
    assert_int_equal(film->counts.overflows, 0);
    free(bytes);
    return film;
}

static estimate_image_t render(const char *path, const wish_t *wish)
{
    film_t *film = render_film(path, wish);
    estimate_image_t image = reference_estimate(film);
    film_destroy(&film);
    return image;
}

static estimate_image_t render_text(const char *text, const wish_t *wish)
{
    char *path = scratch_path(folder, "scene.pbrt");
    scratch_write(path, text, strlen(text));
    estimate_image_t image = render(path, wish);
    free(path);
    return image;
}

/* Mean of all values and its standard error. */
static double mean_of(const estimate_image_t *image, double *error)
{
    double sum = 0, variance = 0, values = 3.0 * image->width * image->height;
    for (size_t i = 0; i < (size_t)values; i++) sum += image->mean[i], variance += image->variance[i];
    *error = sqrt(variance) / values;
    return sum / values;
}

/* ---- weights ------------------------------------------------------------------------------------------- */

/* Inside a sphere that shines with L = 1 and reflects a share r, all is 1 + r + ... + r^maxdepth bright.
 * Photons lie evenly, and the part of a sphere that is nearer than d has the area pi d^2, curved as it is. So
 * merging has no bias but for the directions of photons, which are off by d / R. All strategies count for as
 * much as their weights say: if these do not add up to one, the radiance is not that. */
static void check_furnace(double radius, int depth)
{
    static const char scene[] =
        "LookAt 0.1 0.2 0  1 0 0.3  0 1 0\nCamera \"perspective\" \"float fov\" [60]\n"
        "Film \"image\" \"integer xresolution\" [64] \"integer yresolution\" [64]\n"
        "PixelFilter \"box\" \"float xwidth\" [0.5] \"float ywidth\" [0.5]\nWorldBegin\n"
        "Material \"matte\" \"rgb Kd\" [0.6 0.6 0.6]\nReverseOrientation\n"
        "AreaLightSource \"diffuse\" \"rgb L\" [1 1 1]\nShape \"sphere\" \"float radius\" [1]\nWorldEnd\n";
    wish_t wish = {.integrator = INTEGRATOR_VCM, .spp = 2, .radius = radius, .max_depth = depth};
    estimate_image_t image = render_text(scene, &wish);
    double error, mean = mean_of(&image, &error), truth = (1 - pow(0.6, depth + 1)) / 0.4;
    print_message("furnace, radius %g, depth %d: %.5f +- %.5f, expected %.5f\n", radius, depth, mean, error,
                  truth);
    assert_true(error < 0.001 * truth);
    assert_true(fabs(mean - truth) < 4.5 * error + 0.001 * truth);
    estimate_image_free(&image);
}

/* Within a sphere that lets through half of all light by chance, in another that shines with L = 1: half of
 * that, and of what the inner one reflects. */
static void alpha_counts_once(void **state)
{
    (void)state;
    static const char scene[] =
        "LookAt 0.1 0.2 0  1 0 0.3  0 1 0\nCamera \"perspective\" \"float fov\" [60]\n"
        "Film \"rgb\" \"integer xresolution\" [64] \"integer yresolution\" [64]\n"
        "PixelFilter \"box\" \"float xradius\" [0.5] \"float yradius\" [0.5]\nWorldBegin\n"
        "Material \"diffuse\" \"rgb reflectance\" [0.9 0.9 0.9]\nReverseOrientation\n"
        "Shape \"sphere\" \"float radius\" [1] \"float alpha\" [0.5]\n"
        "Material \"diffuse\" \"rgb reflectance\" [0 0 0]\n"
        "AreaLightSource \"diffuse\" \"rgb L\" [1 1 1]\nShape \"sphere\" \"float radius\" [2]\n";
    wish_t wish = {.integrator = INTEGRATOR_VCM, .spp = 16, .radius = 0.2, .max_depth = 5};
    estimate_image_t image = render_text(scene, &wish);
    double error, mean = mean_of(&image, &error), truth = 0.5 * (1 - pow(0.45, 6)) / 0.55;
    print_message("alpha of a half: %.5f +- %.5f, expected %.5f\n", mean, error, truth);
    assert_true(error < 0.002 * truth);
    assert_true(fabs(mean - truth) < 4.5 * error + 0.001 * truth);
    estimate_image_free(&image);
}

static void a_furnace_keeps_its_radiance(void **state)
{
    (void)state;
    for (int depth = 1; depth <= 5; depth += 2) {
        check_furnace(0.03, depth);
        check_furnace(0.06, depth);
    }
}

/* ---- against other renderers and integrators ------------------------------------------------------------
 */

typedef struct {
    const char *scene;
    uint32_t spp;
    double radius; /* hardly blurs the picture */
} reference_case_t;

static const reference_case_t references[] = {
    {"cornell", 24, 0.01},      {"seed-hidden", 24, 0.01}, {"caustic", 48, 0.004},
    {"lights-delta", 48, 0.01}, {"materials", 24, 0.01},
};

static bool check_reference(const reference_case_t *c)
{
    char path[256];
    snprintf(path, sizeof path, "scenes/%s/scene.pbrt", c->scene);
    wish_t wish = {.integrator = INTEGRATOR_VCM, .spp = c->spp, .radius = c->radius};
    estimate_image_t reference = reference_read(c->scene), image = render(path, &wish);
    agreement_limits_t limits = agreement_default_limits();
    limits.max_z = 10; /* pixels share photons: the two halves know the noise of a block badly */
    agreement_t agreement;
    agreement_measure(&image, &reference, &agreement);
    bool holds = agreement_holds(&agreement, &limits);
    print_message("%s, radius %g: relMSE %.6f, mean ratio %.4f %.4f %.4f, z rms %.3f max %.2f%s\n", path,
                  c->radius, agreement.relmse, agreement.mean_ratio[0], agreement.mean_ratio[1],
                  agreement.mean_ratio[2], agreement.rms_z, agreement.max_z, holds ? "" : "  <-- differs");
    agreement_free(&agreement);
    estimate_image_free(&image);
    estimate_image_free(&reference);
    return holds;
}

static void a_small_radius_has_no_bias_that_shows(void **state)
{
    (void)state;
    int differing = 0;
    for (size_t i = 0; i < ARRAY_LENGTH(references); i++) differing += !check_reference(&references[i]);
    assert_int_equal(differing, 0);
}

/* With the radius that a job has by itself: the mean is right within 1 %, and the error falls. */
static void the_error_falls_with_samples(void **state)
{
    (void)state;
    static const char *const scenes[] = {"cornell", "caustic", "seed-specular"};
    for (size_t i = 0; i < ARRAY_LENGTH(scenes); i++) {
        char path[256];
        snprintf(path, sizeof path, "scenes/%s/scene.pbrt", scenes[i]);
        estimate_image_t reference = reference_read(scenes[i]);
        double relmse[2];
        for (int k = 0; k < 2; k++) {
            wish_t wish = {.integrator = INTEGRATOR_VCM, .spp = k == 0 ? 2 : 32};
            estimate_image_t image = render(path, &wish);
            agreement_t agreement;
            agreement_measure(&image, &reference, &agreement);
            relmse[k] = agreement.relmse - agreement.relmse_floor;
            print_message("%s, %u spp: relMSE %.6f, mean ratio %.4f %.4f %.4f\n", path, wish.spp, relmse[k],
                          agreement.mean_ratio[0], agreement.mean_ratio[1], agreement.mean_ratio[2]);
            for (int c = 0; k == 1 && c < 3; c++) assert_true(fabs(agreement.mean_ratio[c] - 1) < 0.01);
            agreement_free(&agreement);
            estimate_image_free(&image);
        }
        assert_true(relmse[1] < 0.2 * relmse[0]);
        estimate_image_free(&reference);
    }
}

/* ---- what only merging finds ----------------------------------------------------------------------------
 */

/* The pool with another lamp, as bright in all. */
static char *pool_with_lamp(double radius)
{
    uint8_t *bytes;
    size_t size;
    assert_int_equal(file_read("tests/statistics/pool.pbrt", 1 << 20, &bytes, &size).code, RESULT_OK);
    char *text = (char *)bytes, *lamp = strstr(text, "AreaLightSource");
    assert_non_null(lamp);
    double share = 0.05 * 0.05 / (radius * radius);
    char *changed =
        mem_printf("%.*sAreaLightSource \"diffuse\" \"rgb L\" [%g %g %g]\nShape \"disk\" \"float radius\" "
                   "[%g]\nAttributeEnd\nWorldEnd\n",
                   (int)(lamp - text), text, 900 * share, 850 * share, 770 * share, radius);
    free(bytes);
    return changed;
}

/* Brute force meets a large lamp through the water often enough. */
static void a_pool_agrees_with_brute_force(void **state)
{
    (void)state;
    char *text = pool_with_lamp(0.8);
    wish_t force = {.integrator = INTEGRATOR_PATH, .spp = 4096, .side = 48},
           merging = {.integrator = INTEGRATOR_VCM, .spp = 256, .side = 48, .radius = 0.08},
           seeking = {.integrator = INTEGRATOR_BDPT, .spp = 512, .side = 48, .learn = true};
    estimate_image_t truth = render_text(text, &force);
    for (int k = 0; k < 2; k++) {
        const wish_t *wish = k == 0 ? &merging : &seeking;
        estimate_image_t image = render_text(text, wish);
        agreement_t agreement;
        agreement_measure(&image, &truth, &agreement);
        print_message("pool, large lamp, %s: relMSE %.6f (floor %.6f), mean ratio %.4f %.4f %.4f, z rms %.2f "
                      "max %.2f\n",
                      integrator_name(wish->integrator), agreement.relmse, agreement.relmse_floor,
                      agreement.mean_ratio[0], agreement.mean_ratio[1], agreement.mean_ratio[2],
                      agreement.rms_z, agreement.max_z);
        for (int c = 0; c < 3; c++) assert_true(fabs(agreement.mean_ratio[c] - 1) < (k == 0 ? 0.01 : 0.005));
        assert_true(agreement.rms_z < (k == 0 ? 2 : 1.3));
        agreement_free(&agreement);
        estimate_image_free(&image);
    }
    estimate_image_free(&truth);
    free(text);
}

/* Of a small one connections find next to nothing: with 16 times the samples bdpt is noisier by far, unless
 * it learns where to look (caustics.h). */
static void a_small_lamp_is_seen_through_water(void **state)
{
    (void)state;
    enum { FEW, MORE, JOINED, SOUGHT, WAYS };
    char *text = pool_with_lamp(0.05);
    wish_t much = {.integrator = INTEGRATOR_VCM, .spp = 512, .side = 32, .seed = 1};
    const wish_t wishes[WAYS] = {
        [FEW] = {.integrator = INTEGRATOR_VCM, .spp = 16, .side = 32},
        [MORE] = {.integrator = INTEGRATOR_VCM, .spp = 128, .side = 32},
        [JOINED] = {.integrator = INTEGRATOR_BDPT, .spp = 256, .side = 32},
        [SOUGHT] = {.integrator = INTEGRATOR_BDPT, .spp = 256, .side = 32, .learn = true},
    };
    estimate_image_t truth = render_text(text, &much);
    double errors[WAYS];
    for (int k = 0; k < WAYS; k++) {
        estimate_image_t image = render_text(text, &wishes[k]);
        errors[k] = reference_error(&image, &truth);
        estimate_image_free(&image);
    }
    print_message(
        "pool, small lamp: error %.4f of vcm at 16, %.4f at 128, %.4f of bdpt at 256, %.4f where it "
        "learns\n",
        errors[FEW], errors[MORE], errors[JOINED], errors[SOUGHT]);
    assert_true(errors[FEW] < 0.25 * errors[JOINED]);
    assert_true(errors[MORE] < 0.6 * errors[FEW]); /* each sample index has photons of its own */
    assert_true(errors[SOUGHT] < 0.2 * errors[JOINED]);
    estimate_image_free(&truth);
    free(text);
}

int main(int argc, char **argv)
{
    if (argc > 1) cmocka_set_test_filter(argv[1]); /* one test alone */
    folder = scratch_new();
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_furnace_keeps_its_radiance),
        cmocka_unit_test(alpha_counts_once),
        cmocka_unit_test(a_small_radius_has_no_bias_that_shows),
        cmocka_unit_test(the_error_falls_with_samples),
        cmocka_unit_test(a_pool_agrees_with_brute_force),
        cmocka_unit_test(a_small_lamp_is_seen_through_water),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    scratch_destroy(&folder);
    return failed;
}
