/* Spectra: what is read and refused, the colours they become, and the tables behind the names. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/files/spectrum.h"

static const position_t nowhere = {"scene.pbrt", 7, 3};

static void expect_rgb(rgb_t c, double r, double g, double b, double relative)
{
    expect_near((double)c.x, r, relative * r);
    expect_near((double)c.y, g, relative * g);
    expect_near((double)c.z, b, relative * b);
}

static spectrum_t from_pairs(const double *numbers, size_t count)
{
    spectrum_t s;
    result_t result = spectrum_from_pairs(numbers, count, nowhere, &s);
    assert_string_equal(result.message, "");
    return s;
}

static spectrum_t constant(double value)
{
    return from_pairs((double[]){550, value}, 2);
}

static spectrum_t named(const char *name)
{
    spectrum_t s;
    if (!spectrum_named(name, &s)) fail_msg("no spectrum %s", name);
    return s;
}

/* ---- samples ------------------------------------------------------------------------------------------- */

static void samples_are_sorted_and_interpolated(void **state)
{
    (void)state;
    spectrum_t s = from_pairs((double[]){700, 4, 400, 1, 500, 2}, 6);
    assert_int_equal(s.count, 3);
    expect_near(spectrum_at(&s, 0), 1, 0);
    expect_near(spectrum_at(&s, 400), 1, 0);
    expect_near(spectrum_at(&s, 450), 1.5, 1e-15);
    expect_near(spectrum_at(&s, 500), 2, 0);
    expect_near(spectrum_at(&s, 650), 3.5, 1e-15);
    expect_near(spectrum_at(&s, 9000), 4, 0);
    spectrum_free(&s);
    assert_null(s.lambda);
}

static void expect_refused(const double *numbers, size_t count, const char *part)
{
    spectrum_t s;
    result_t result = spectrum_from_pairs(numbers, count, nowhere, &s);
    assert_int_equal(result.code, RESULT_INPUT);
    expect_text(result.message, "scene.pbrt:7:3: ");
    expect_text(result.message, part);
    assert_null(s.lambda);
    assert_null(s.value);
}

static void impossible_pairs_are_refused(void **state)
{
    (void)state;
    expect_refused(NULL, 0, "found none");
    expect_refused((double[]){400, 1, 500}, 3, "found 3 numbers");
    expect_refused((double[]){400, 1, 500, NAN}, 4, "finite");
    expect_refused((double[]){400, 1, (double)INFINITY, 1}, 4, "finite");
    expect_refused((double[]){400, 1, -1, 1}, 4, "-1 nm");
    expect_refused((double[]){400, 1, 500, 2, 400, 1}, 6, "two values for 400 nm");
    expect_refused((double[]){400, -2e30}, 2, "limit");
}

/* ---- colours ------------------------------------------------------------------------------------------- */

enum { WHITE_EQUAL_ENERGY, WHITE_D65 };

/* A reflectance under a white, without the factor that is pbrt-v3's own. */
static rgb_t spectrum_rgb(const spectrum_t *spectrum, int white)
{
    if (white == WHITE_D65) return spectrum_colour(spectrum, SPECTRUM_REFLECTANCE, SPECTRUM_PBRT_V4);
    return v_scale(spectrum_colour(spectrum, SPECTRUM_REFLECTANCE, SPECTRUM_PBRT_V3), 471.0f / 470.0f);
}

static void constants_have_the_colour_of_the_white(void **state)
{
    (void)state;
    spectrum_t one = constant(1), quarter = constant(0.25);
    expect_rgb(spectrum_rgb(&one, WHITE_D65), 1, 1, 1, 1e-7);
    expect_rgb(spectrum_rgb(&quarter, WHITE_D65), 0.25, 0.25, 0.25, 1e-7);
    /* the matrix's rows summed: X = Y = Z = 1, but for the observer's own rounding */
    expect_rgb(spectrum_rgb(&one, WHITE_EQUAL_ENERGY), 1.204794, 0.948291, 0.908916, 5e-4);
    expect_near((double)rgb_luminance(spectrum_rgb(&one, WHITE_EQUAL_ENERGY)), 1, 1e-3);
    expect_rgb(spectrum_rgb(&quarter, WHITE_EQUAL_ENERGY), 0.25 * 1.204794, 0.25 * 0.948291, 0.25 * 0.908916,
               5e-4);
    spectrum_free(&one);
    spectrum_free(&quarter);
}

/* White points of CIE 15, as chromaticities of the 2-degree observer. */
static void white_points_are_those_of_the_standard(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        double x, y;
    } whites[] = {
        {"stdillum-A", 0.44758, 0.40745},   {"stdillum-D50", 0.34567, 0.35851},
        {"stdillum-D65", 0.31272, 0.32903}, {"illum-acesD60", 0.32163, 0.33774},
        {"stdillum-F1", 0.3131, 0.3371},    {"stdillum-F2", 0.3721, 0.3751},
        {"stdillum-F3", 0.4091, 0.3941},    {"stdillum-F4", 0.4402, 0.4031},
        {"stdillum-F5", 0.3138, 0.3452},    {"stdillum-F6", 0.3779, 0.3882},
        {"stdillum-F7", 0.3129, 0.3292},    {"stdillum-F8", 0.3458, 0.3586},
        {"stdillum-F9", 0.3741, 0.3727},    {"stdillum-F10", 0.3458, 0.3588},
        {"stdillum-F11", 0.3805, 0.3771},   {"stdillum-F12", 0.4369, 0.4044},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(whites); ++i) {
        spectrum_t s = named(whites[i].name);
        /* back to XYZ by the inverse matrix; all of these lie in sRGB */
        rgb_t c = spectrum_rgb(&s, WHITE_EQUAL_ENERGY);
        double r = (double)c.x, g = (double)c.y, b = (double)c.z;
        double x = 0.412453 * r + 0.357580 * g + 0.180423 * b;
        double y = 0.212671 * r + 0.715160 * g + 0.072169 * b;
        double z = 0.019334 * r + 0.119193 * g + 0.950227 * b;
        if (fabs(x / (x + y + z) - whites[i].x) > 2e-4 || fabs(y / (x + y + z) - whites[i].y) > 2e-4)
            fail_msg("%s: %.5f %.5f", whites[i].name, x / (x + y + z), y / (x + y + z));
        spectrum_free(&s);
    }
}

static void colour_is_linear(void **state)
{
    (void)state;
    const double a[] = {420, 0.2, 500, 0.9, 560, 0.7, 650, 0.8},
                 b[] = {420, 0.6, 500, 0.3, 560, 0.5, 650, 0.9};
    double mixed[8];
    for (int i = 0; i < 8; ++i) mixed[i] = i % 2 ? 2 * a[i] + 3 * b[i] : a[i];
    spectrum_t s = from_pairs(a, 8), t = from_pairs(b, 8), u = from_pairs(mixed, 8);
    for (int white = 0; white < 2; ++white) {
        rgb_t p = spectrum_rgb(&s, white), q = spectrum_rgb(&t, white);
        expect_rgb(spectrum_rgb(&u, white), (double)(2 * p.x + 3 * q.x), (double)(2 * p.y + 3 * q.y),
                   (double)(2 * p.z + 3 * q.z), 1e-6);
    }
    spectrum_free(&s);
    spectrum_free(&t);
    spectrum_free(&u);
}

static void colours_outside_of_srgb_are_clipped(void **state)
{
    (void)state;
    spectrum_t laser = from_pairs((double[]){514, 0, 515, 1, 516, 0}, 6);
    for (int white = 0; white < 2; ++white) {
        rgb_t c = spectrum_rgb(&laser, white);
        assert_true(c.x == 0 && c.y > 0 && c.z == 0);
    }
    spectrum_free(&laser);
}

/* The defaults of v3's metal, and the other metals, each as published with 6 digits. */
static void metals_have_their_published_colours(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        double r, g, b, relative;
    } metals[] = {
        {"metal-Cu-eta", 0.200438, 0.924033, 1.102212, 2e-4},
        {"metal-Cu-k", 3.912949, 2.452848, 2.142188, 2e-4},
        {"metal-Au-eta", 0.143119, 0.374957, 1.442479, 2e-4},
        {"metal-Au-k", 3.983160, 2.385721, 1.603215, 2e-4},
        {"metal-Ag-eta", 0.155265, 0.116723, 0.138381, 2e-4},
        {"metal-Ag-k", 4.828343, 3.122246, 2.147050, 2e-4},
        {"metal-Al-eta", 1.657460, 0.880369, 0.521229, 2e-4},
        {"metal-Al-k", 9.223869, 6.269523, 4.837001, 2e-4},
        {"metal-CuZn-eta", 0.519769, 0.488506, 1.042010, 1e-3},
        {"metal-CuZn-k", 4.330583, 2.548106, 1.591891, 1e-3},
        {"metal-MgO-eta", 2.089589, 1.650722, 1.594876, 1e-3},
        {"metal-TiO2-eta", 3.456620, 2.801708, 2.905149, 1e-3},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(metals); ++i) {
        spectrum_t s = named(metals[i].name);
        expect_rgb(spectrum_rgb(&s, WHITE_EQUAL_ENERGY), metals[i].r, metals[i].g, metals[i].b,
                   metals[i].relative);
        double v3 = 470.0 / 471;
        expect_rgb(spectrum_colour(&s, SPECTRUM_INDEX, SPECTRUM_PBRT_V3), v3 * metals[i].r, v3 * metals[i].g,
                   v3 * metals[i].b, metals[i].relative);
        spectrum_free(&s);
    }
}

static void spectra_are_found_by_name(void **state)
{
    (void)state;
    spectrum_t s = named("glass-BK7");
    expect_near(spectrum_at(&s, SPECTRUM_D_LINE), 1.5168, 1e-12);
    spectrum_free(&s);
    s = named("metal-Cu-eta");
    assert_int_equal(s.count, 56);
    expect_near(s.lambda[0], 298.7570554, 1e-6);
    expect_near(s.lambda[55], 885.6012714, 1e-6);
    spectrum_free(&s);
    s = named("metal-MgO-k");
    expect_near(spectrum_at(&s, 500), 0, 0);
    spectrum_free(&s);
    s = named("metal-TiO2-k");
    expect_near(spectrum_at(&s, 305.972), 1.95, 0);
    spectrum_free(&s);
    assert_false(spectrum_named("metal-Unobtainium-eta", &s));
    assert_null(s.lambda);
}

/* Every table must be a spectrum: ascending wavelengths, finite values. */
static void named_spectra_are_sound(void **state)
{
    (void)state;
    static const char *const names[] = {"glass-BAF10", "glass-FK51A",  "glass-LASF9",    "glass-F5",
                                        "glass-F10",   "glass-F11",    "metal-TiO2-eta", "metal-MgO-eta",
                                        "stdillum-A",  "metal-CuZn-k", "stdillum-F12",   "metal-Al-k"};
    for (size_t i = 0; i < ARRAY_LENGTH(names); ++i) {
        spectrum_t s = named(names[i]);
        assert_true(s.count > 0);
        for (size_t j = 0; j < s.count; ++j) {
            assert_true(isfinite(s.value[j]));
            if (j > 0) assert_true(s.lambda[j] > s.lambda[j - 1]);
        }
        spectrum_free(&s);
    }
}

/* ---- light --------------------------------------------------------------------------------------------- */

static void emission_follows_the_rules_of_its_program(void **state)
{
    (void)state;
    spectrum_t d65 = named("stdillum-D65"), one = constant(5), dark = constant(0);
    expect_rgb(spectrum_colour(&d65, SPECTRUM_EMISSION, SPECTRUM_PBRT_V4), 1, 1, 1, 1e-6);
    /* v4: the white of equal energy at luminance 1, whatever the value; v3: as it is */
    expect_rgb(spectrum_colour(&one, SPECTRUM_EMISSION, SPECTRUM_PBRT_V4), 1.2048, 0.9483, 0.9089, 1e-3);
    expect_rgb(spectrum_colour(&one, SPECTRUM_EMISSION, SPECTRUM_PBRT_V3), 5 * 1.2022, 5 * 0.9463, 5 * 0.9070,
               1e-3);
    expect_vec3(spectrum_colour(&dark, SPECTRUM_EMISSION, SPECTRUM_PBRT_V4), 0, 0, 0);
    expect_rgb(spectrum_colour(&one, SPECTRUM_REFLECTANCE, SPECTRUM_PBRT_V4), 5, 5, 5, 1e-6);
    expect_rgb(spectrum_colour(&one, SPECTRUM_REFLECTANCE, SPECTRUM_PBRT_V3), 5 * 1.2022, 5 * 0.9463,
               5 * 0.9070, 1e-3);
    spectrum_free(&d65);
    spectrum_free(&one);
    spectrum_free(&dark);
}

static void black_bodies_have_their_published_colours(void **state)
{
    (void)state;
    /* chromaticity (0.31352, 0.32363) of the Planckian locus at 6500 K: near D65, a little pink */
    rgb_t c = spectrum_blackbody(6500, SPECTRUM_PBRT_V4);
    expect_rgb(c, 1.0431, 0.9836, 1.0353, 1e-3);
    expect_near((double)rgb_luminance(c), 1, 2e-4);
    /* 5000 K is yellow, 10000 K is blue */
    c = spectrum_blackbody(5000, SPECTRUM_PBRT_V4);
    assert_true(c.x > c.y && c.y > c.z);
    c = spectrum_blackbody(10000, SPECTRUM_PBRT_V4);
    assert_true(c.z > c.y && c.y > c.x);
    /* clipped: below 2000 K there is no blue in sRGB */
    assert_true(spectrum_blackbody(1500, SPECTRUM_PBRT_V4).z == 0);

    /* v3: at Wien's 5240 K the maximum lies in the middle of the observer, so that Y is nearly 1 */
    expect_near((double)rgb_luminance(spectrum_blackbody(5240, SPECTRUM_PBRT_V3)), 0.98, 0.015);
    /* the same colour in both but for the scale and the sliver between the two whites */
    rgb_t v3 = spectrum_blackbody(3000, SPECTRUM_PBRT_V3), v4 = spectrum_blackbody(3000, SPECTRUM_PBRT_V4);
    double scale = (double)rgb_luminance(v3);
    expect_rgb(v3, scale * (double)v4.x, scale * (double)v4.y, scale * (double)v4.z, 1e-3);
    /* at 555 nm, the middle of ybar, x = c2 / (lambda T) is 8.641: (x/w)^5 expm1(w) / expm1(x) = 0.4017 */
    expect_near(scale, 0.4017, 0.02);
}

static void a_black_body_of_any_temperature_is_finite(void **state)
{
    (void)state;
    static const double kelvins[] = {-1,    0,           1e-300,          1, 20, 300, 1e5, 1e12,
                                     1e300, (double)NAN, (double)INFINITY};
    for (size_t i = 0; i < ARRAY_LENGTH(kelvins); ++i)
        for (int rules = SPECTRUM_PBRT_V3; rules <= SPECTRUM_PBRT_V4; ++rules) {
            rgb_t c = spectrum_blackbody(kelvins[i], rules);
            assert_true(v_is_finite(c));
            assert_true(c.x >= 0 && c.y >= 0 && c.z >= 0);
        }
    assert_true(v_is_zero(spectrum_blackbody(-1, SPECTRUM_PBRT_V3)));
    assert_true(v_is_zero(spectrum_blackbody(0, SPECTRUM_PBRT_V4)));
}

static void light_without_luminance_is_black(void **state)
{
    (void)state;
    spectrum_t s = constant(1e-320);
    assert_true(v_is_zero(spectrum_colour(&s, SPECTRUM_EMISSION, SPECTRUM_PBRT_V4)));
    spectrum_free(&s);
}

/* ---- files --------------------------------------------------------------------------------------------- */

static result_t read_text(bench_t *bench, const char *text, size_t size, spectrum_t *s)
{
    bench_write(bench, "a.spd", text, size);
    char *path = bench_path(bench, "a.spd");
    result_t result = spectrum_read(path, s);
    free(path);
    return result;
}

static void a_spectrum_is_read_from_a_file(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char text[] = "# a lamp\r\n500 2 # green\n\n\t400\n1e0#value\n 600 +.3e1";
    spectrum_t s;
    result_t result = read_text(&bench, text, strlen(text), &s);
    assert_string_equal(result.message, "");
    assert_int_equal(s.count, 3);
    expect_near(spectrum_at(&s, 450), 1.5, 1e-15);
    expect_near(spectrum_at(&s, 600), 3, 0);
    spectrum_free(&s);
    bench_close(&bench);
}

static void files_that_are_wrong_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *part;
    } cases[] = {
        {"", "a.spd: the spectrum file has no numbers"},
        {"# nothing\n \n", "a.spd: the spectrum file has no numbers"},
        {"400 1\n500 two\n", "a.spd:2: expected a number"},
        {"# one\n400 1\n500,2\n", "a.spd:3: expected a number"},
        {"400 1\n500 2x\n", "a.spd:2: expected a number"},
        {"400 1\n500 nan\n", "a.spd:2: expected a number"},
        {"400 1\n500 1e999\n", "a.spd:2: expected a number"},
        {"400 1\n\n500\n\n", "a.spd:3: the wavelength 500 nm has no value"},
        {"400 1\n-500 1\n", "a.spd:2: a spectrum's wavelength is -500 nm"},
        {"400 1\n500 1\n\n400 2\n600 1", "a.spd:4: a spectrum has two values for 400 nm"},
        {"400 1\n500 1e31\n", "a.spd:2: a spectrum's value is 1e+31"},
    };
    bench_t bench = {0};
    spectrum_t s;
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        result_t result = read_text(&bench, cases[i].text, strlen(cases[i].text), &s);
        assert_int_equal(result.code, RESULT_INPUT);
        expect_text(result.message, cases[i].part);
        assert_null(s.lambda);
    }
    result_t zeroes = read_text(&bench, "400\0 1", 6, &s);
    assert_int_equal(zeroes.code, RESULT_INPUT);
    result_t missing = spectrum_read("/nonexistent/lamp.spd", &s);
    assert_int_equal(missing.code, RESULT_INPUT);
    expect_text(missing.message, "/nonexistent/lamp.spd");
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(samples_are_sorted_and_interpolated),
        cmocka_unit_test(impossible_pairs_are_refused),
        cmocka_unit_test(constants_have_the_colour_of_the_white),
        cmocka_unit_test(white_points_are_those_of_the_standard),
        cmocka_unit_test(colour_is_linear),
        cmocka_unit_test(colours_outside_of_srgb_are_clipped),
        cmocka_unit_test(metals_have_their_published_colours),
        cmocka_unit_test(spectra_are_found_by_name),
        cmocka_unit_test(named_spectra_are_sound),
        cmocka_unit_test(emission_follows_the_rules_of_its_program),
        cmocka_unit_test(black_bodies_have_their_published_colours),
        cmocka_unit_test(a_black_body_of_any_temperature_is_finite),
        cmocka_unit_test(light_without_luminance_is_black),
        cmocka_unit_test(a_spectrum_is_read_from_a_file),
        cmocka_unit_test(files_that_are_wrong_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
