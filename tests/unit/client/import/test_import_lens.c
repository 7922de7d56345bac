/* What the pbrt importer makes of the realistic camera and its lens files, good and bad. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/files/lens_file.h"

/* A glass of 100 mm, with a stop. */
#define GLASS "# radius thickness eta aperture\n100 2 1.5 20\n-100 1 0 20\n0 7 0 10 # the stop"

static const blob_scene_t *run(bench_t *bench, bool v4, const char *lens, const char *parameters)
{
    char *text = mem_printf(
        "%sFilm \"%s\" \"integer xresolution\" 40 \"integer yresolution\" 30 \"float diagonal\" 50\n"
        "Camera \"realistic\" \"string lensfile\" \"a.dat\" %s\nWorldBegin\nLightSource \"point\"\n%s",
        v4 ? "ColorSpace \"srgb\"\n" : "", v4 ? "rgb" : "image", parameters, v4 ? "" : "WorldEnd\n");
    bench_write(bench, "a.dat", lens, strlen(lens));
    bench_run(bench, text);
    free(text);
    return bench->blob.scene;
}

static double area_of(const blob_pupil_t *pupil)
{
    return (double)(pupil->x_max - pupil->x_min) * (double)(pupil->y_max - pupil->y_min);
}

static void a_lens_is_read_and_focused(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene =
        run(&bench, true, GLASS, "\"float aperturediameter\" 4 \"float focusdistance\" 2");
    bench_expect_silence(&bench);
    assert_int_equal(scene->camera, CAMERA_REALISTIC);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LENS], 3);
    const blob_lens_element_t *e = bench.blob.lens;
    expect_near((double)e[0].curvature_radius, 0.1, 1e-8);
    expect_near((double)e[0].thickness, 0.002, 1e-9);
    expect_near((double)e[1].eta, 1, 0);
    expect_near((double)e[1].aperture_radius, 0.01, 1e-9);
    expect_near((double)e[2].aperture_radius, 0.002, 1e-9);
    /* The film's diagonal is 50 mm: a 3-4-5 triangle. */
    expect_near((double)scene->screen_window[1], 0.020, 1e-8);
    expect_near((double)scene->screen_window[3], 0.015, 1e-8);
    expect_near((double)scene->screen_window[0], -0.020, 1e-8);
    /* 1 / b + 1 / (2 - b) = 1 / f for a thin lens; this one is near to that, and 3 mm before the rear. */
    double f = 0.1, b = 1 - sqrt(1 - 2 * f);
    expect_near((double)e[2].thickness + 0.002, b, 1e-3);
    expect_near((double)scene->lens_exposure * (double)(e[2].thickness * e[2].thickness), 1, 1e-5);
    bench_close(&bench);
}

static void weights_are_those_of_either_pbrt(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene = run(&bench, false, GLASS, "\"float aperturediameter\" 4");
    bench_expect_ok(&bench);
    expect_near((double)scene->lens_exposure * area_of(&bench.blob.pupils[0]), 1,
                1e-5); /* simple weighting */
    scene = run(&bench, false, GLASS, "\"bool simpleweighting\" \"false\" \"float shutterclose\" .25");
    bench_expect_ok(&bench);
    double rear = (double)bench.blob.lens[2].thickness;
    expect_near((double)scene->lens_exposure * rear * rear, 0.25, 1e-5);
    /* pbrt's box of the middle pupil: the stop, as the rear, and 2 sqrt(18) / 1024 of the rear's radius. */
    double side = 0.0005 * (2 + 4 * sqrt(18) / 1024);
    expect_near(area_of(&bench.blob.pupils[0]), side * side, 0.01 * side * side);
    bench_close(&bench);
}

static void apertures_have_shapes(void **state)
{
    (void)state;
    static const char *const shapes[] = {"gaussian", "square", "pentagon", "star", "a.pfm"};
    static const double shares[] = {0, 0.25, 0, 0, 0.5}; /* of the square that is open; 0: not looked at */
    bench_t bench = {0};
    bench_write(&bench, "a.pfm", "Pf\n2 1\n-1\n\0\0\0\0\0\0\200?", 18);
    for (size_t i = 0; i < ARRAY_LENGTH(shapes); ++i) {
        char *parameters = mem_printf("\"float aperturediameter\" 4 \"string aperture\" \"%s\"", shapes[i]);
        const blob_scene_t *scene = run(&bench, true, GLASS, parameters);
        free(parameters);
        bench_expect_ok(&bench);
        assert_int_equal(scene->aperture, bench.blob.counts[BLOB_SECTION_IMAGES]);
        const blob_image_t *image = &bench.blob.images[scene->aperture - 1];
        assert_int_equal(image->format, TEXELS_R32F);
        double sum = 0, open = 0, count = (double)image->width * image->height;
        for (size_t k = 0; k < (size_t)count; ++k) {
            float value;
            memcpy(&value, bench.blob.texels + image->first_word + k, sizeof value);
            sum += (double)value;
            open += value > 0;
        }
        expect_near(sum / count, M_PI / 4, 1e-4);
        if (shares[i] > 0) expect_near(open / count, shares[i], 0);
        /* The boxes have room for the square's corners. */
        assert_true(area_of(&bench.blob.pupils[0]) > 7.9e-6 * 4);
    }
    run(&bench, true, GLASS, "\"string aperture\" \"missing.png\"");
    assert_int_equal(bench.result.code, RESULT_INPUT);
    bench_close(&bench);
}

static void bad_lenses_are_errors(void **state)
{
    (void)state;
    static const struct {
        const char *lens, *message;
    } cases[] = {
        {"", "a.dat: the lens file has no surfaces"},
        {"# nothing", "a.dat: the lens file has no surfaces"},
        {"1 2 3", "a.dat:1: a lens's surface takes 4 numbers, found 3"},
        {"100 2 1.5 20\n\n-100 1", "a.dat:3: a lens's surface takes 4 numbers, found 2"},
        {"100 2 1.5 nan", "a.dat:1: expected a number"},
        {"100 2 1.5 20\n-100 x 1 20", "a.dat:2: expected a number"},
        {"100 2 1.5 2e9", "a.dat:1: the number 2e+09 is beyond"},
        {"100 2 1.5 1e999", "a.dat:1: expected a number"},
        {"100 2 1.5 0", "a.dat:1: an aperture's diameter is 0 mm"},
        {"100 2 1.5 -20", "a.dat:1: an aperture's diameter is -20 mm"},
        {"100 2 1.5 1e-300", "a.dat:1: an aperture's diameter is 1e-300 mm, which is too small"},
        {"100 2 -1.5 20", "a.dat:1: an index of refraction is -1.5"},
        {"100 -2 1.5 20\n-100 1 1 20", "a.dat:1: the next surface must not lie before this one"},
        {"0 1 1 20", "the lens does not focus light"},
        {"0 1 1 20\n0 1 1 20", "the lens does not focus light"},
        {"-100 2 1.5 20\n100 1 1 20", "spreads it"},
        {"100 2 1.5 20\n-100 1 1 20\n0 5 1 1e-30", "lets no ray through near its axis"},
        {"100 2 1.5 20\n-100 400 1 20\n0 5 1 20", "s.pbrt:3"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        run(&bench, true, cases[i].lens, "\"float aperturediameter\" 1e3");
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, cases[i].message);
    }
    char many[LENS_MAX_ELEMENTS * 16 + 64] = "";
    for (int i = 0; i <= LENS_MAX_ELEMENTS; ++i) strcat(many, "100 2 1.5 20\n");
    run(&bench, true, many, "");
    expect_text(bench.result.message, "a.dat:101: a lens has at most 100 surfaces");
    bench_close(&bench);
}

static void what_is_said_of_a_lens_is_checked(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const struct {
        const char *parameters, *message;
    } cases[] = {{"\"float focusdistance\" .3", "the lens cannot focus on 0.3: the nearest is 0.4"},
                 {"\"float focusdistance\" -1", "focusdistance"},
                 {"\"float aperturediameter\" 0", "aperturediameter"},
                 {"\"float aperturediameter\" .001", "lets no ray through near its axis"},
                 {"\"string lensfile\" \"\"", "lensfile"},
                 {"\"bool simpleweighting\" false", "simpleweighting"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        run(&bench, true, GLASS, cases[i].parameters);
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, cases[i].message);
    }
    run(&bench, false, GLASS, "\"float aperturediameter\" 11");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "aperturediameter 11: 10, the lens's largest, is used");
    expect_near((double)bench.blob.lens[2].aperture_radius, 0.005, 1e-9);
    bench.lenient = true;
    const blob_scene_t *scene = run(&bench, true, GLASS, "\"float focusdistance\" .3");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "a perspective camera of 90 degrees is used");
    assert_int_equal(scene->camera, CAMERA_PERSPECTIVE);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LENS], 0);
    bench_close(&bench);
}

/* A crop shows its part of the same film. */
static void a_crop_is_a_part_of_the_film(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_write(&bench, "a.dat", GLASS, strlen(GLASS));
    bench_run(&bench,
              "Camera \"realistic\" \"string lensfile\" \"a.dat\" \"float aperturediameter\" 4\n"
              "Film \"image\" \"integer xresolution\" 40 \"integer yresolution\" 30 \"float diagonal\" 50 "
              "\"float cropwindow\" [0 .5 0 1]\nWorldBegin\nLightSource \"point\"\nWorldEnd\n");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->width, 20);
    expect_near((double)bench.blob.scene->screen_window[1], 0.020, 1e-8);
    expect_near((double)bench.blob.scene->film_window[1], 0.5, 1e-7);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_lens_is_read_and_focused),
        cmocka_unit_test(weights_are_those_of_either_pbrt),
        cmocka_unit_test(apertures_have_shapes),
        cmocka_unit_test(bad_lenses_are_errors),
        cmocka_unit_test(what_is_said_of_a_lens_is_checked),
        cmocka_unit_test(a_crop_is_a_part_of_the_film),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
