/* `lightmill mix`: an image with two light groups goes through the command; what comes out is computed here
 * by itself. */
#include "client/commands/commands.h"
#include "common/image/image.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { WIDTH = 5, HEIGHT = 3, PIXELS = WIDTH * HEIGHT };

typedef struct {
    char *folder, *from, *to, *png;
} mix_t;

/* What a channel of a group has at a pixel. */
static float value_of(int group, bool light, int colour, size_t pixel)
{
    return 0.25f * (float)(1 + group) + 0.5f * (float)light + 0.125f * (float)colour + 0.0625f * (float)pixel;
}

static void add(image_t *image, const char *layer, bool eye, bool light, int only)
{
    float *rgb[3];
    assert_true(image_add_rgb(image, layer, PIXEL_FLOAT, rgb));
    for (int c = 0; c < 3; c++)
        for (size_t p = 0; p < PIXELS; p++)
            for (int g = 0; g < 2; g++) {
                if (only >= 0 && g != only) continue;
                if (eye) rgb[c][p] += value_of(g, false, c, p);
                if (light && g == 0) rgb[c][p] += value_of(g, true, c, p); /* the second has no light */
            }
}

static int set_up(void **state)
{
    mix_t *mix = mem_zalloc(1, sizeof *mix);
    mix->folder = scratch_new();
    mix->from = scratch_path(mix->folder, "a.exr");
    mix->to = scratch_path(mix->folder, "b.exr");
    mix->png = scratch_path(mix->folder, "b.png");
    image_t image;
    image_init(&image, WIDTH, HEIGHT);
    add(&image, NULL, true, true, -1);
    add(&image, "eye", true, false, -1);
    add(&image, "light", false, true, -1);
    add(&image, "noise", true, false, -1);
    add(&image, "half0", true, false, -1);
    add(&image, "albedo", true, false, 0);
    add(&image, "group.key.eye", true, false, 0);
    add(&image, "group.key.light", false, true, 0);
    add(&image, "group.sky-2.eye", true, false, 1);
    image_set_string(&image, "lightmill.scene", "a scene");
    image_set_float(&image, "lightmill.error", 0.5f);
    assert_int_equal(image_write_exr(mix->from, &image).code, RESULT_OK);
    image_free(&image);
    *state = mix;
    return 0;
}

static int tear_down(void **state)
{
    mix_t *mix = *state;
    scratch_destroy(&mix->folder);
    free(mix->from);
    free(mix->to);
    free(mix->png);
    free(mix);
    return 0;
}

/* Runs the command with up to four words more. */
static result_t run(const mix_t *mix, const char *const words[4])
{
    char *argv[8] = {(char *)"mix", mix->from};
    int argc = 2;
    for (int i = 0; i < 4 && words[i] != NULL; i++) argv[argc++] = (char *)words[i];
    return command_run(&mix_command, argc, argv);
}

static void expect(const mix_t *mix, const double key[3], const double sky[3])
{
    image_t image;
    assert_string_equal(image_read_exr(mix->to, &image).message, "");
    const image_channel_t *rgb[3], *eye[3], *light[3];
    assert_true(image_find_rgb(&image, NULL, rgb) && image_find_rgb(&image, "eye", eye) &&
                image_find_rgb(&image, "light", light));
    for (int c = 0; c < 3; c++)
        for (size_t p = 0; p < PIXELS; p++) {
            double e = key[c] * (double)value_of(0, false, c, p) + sky[c] * (double)value_of(1, false, c, p);
            double l = key[c] * (double)value_of(0, true, c, p);
            assert_true(fabs((double)eye[c]->data[p] - e) < 1e-6);
            assert_true(fabs((double)light[c]->data[p] - l) < 1e-6);
            assert_true(fabs((double)rgb[c]->data[p] - e - l) < 1e-6);
        }
    assert_non_null(image_find(&image, "albedo.G"));
    assert_null(image_find(&image, "noise.R"));
    assert_null(image_find(&image, "half0.R"));
    assert_null(image_find(&image, "group.key.eye.R"));
    assert_string_equal(image_attribute(&image, "lightmill.scene")->text, "a scene");
    bool plain = true;
    for (int c = 0; c < 3; c++) plain = plain && key[c] == 1 && sky[c] == 1;
    assert_int_equal(image_attribute(&image, "lightmill.error") != NULL, plain);
    image_free(&image);
}

static void groups_are_scaled_and_tinted(void **state)
{
    mix_t *mix = *state;
    const struct {
        const char *words[4];
        double key[3], sky[3];
    } cases[] = {{{"key=2"}, {2, 2, 2}, {1, 1, 1}},
                 {{"key=0"}, {0, 0, 0}, {1, 1, 1}},
                 {{"sky-2=1,0.5,0", "key=0.25"}, {0.25, 0.25, 0.25}, {1, 0.5, 0}},
                 {{"--solo=sky-2"}, {0, 0, 0}, {1, 1, 1}},
                 {{"--solo=key", "key=3,2,1"}, {3, 2, 1}, {0, 0, 0}},
                 {{"key=1", "sky-2=1,1,1"}, {1, 1, 1}, {1, 1, 1}},
                 {{NULL}, {1, 1, 1}, {1, 1, 1}}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        const char *const *w = cases[i].words;
        char *output = mem_printf("-o%s", mix->to);
        const char *words[4] = {output, w[0], w[0] != NULL ? w[1] : NULL, NULL};
        assert_string_equal(run(mix, words).message, "");
        free(output);
        expect(mix, cases[i].key, cases[i].sky);
    }
}

static void what_is_mixed_is_told(void **state)
{
    mix_t *mix = *state;
    image_t image;
    char *output = mem_printf("-o%s", mix->to);
    assert_int_equal(run(mix, (const char *[4]){output, "key=0.5,1,2"}).code, RESULT_OK);
    assert_int_equal(image_read_exr(mix->to, &image).code, RESULT_OK);
    assert_string_equal(image_attribute(&image, "lightmill.mix")->text, "key=0.5,1,2 sky-2=1,1,1");
    image_free(&image);
    free(output);
}

static void a_png_is_made_like_others(void **state)
{
    mix_t *mix = *state;
    char *output = mem_printf("-o%s", mix->png), *other = scratch_path(mix->folder, "c.png");
    assert_string_equal(run(mix, (const char *[4]){output, "--exposure=-1", "key=0.5"}).message, "");
    uint8_t *made, *expected;
    size_t made_size, expected_size;
    char *exr = mem_printf("-o%s", mix->to);
    image_t image;
    assert_int_equal(run(mix, (const char *[4]){exr, "key=0.5"}).code, RESULT_OK);
    assert_int_equal(image_read_exr(mix->to, &image).code, RESULT_OK);
    assert_int_equal(image_write_png(other, &image, -1).code, RESULT_OK);
    assert_int_equal(file_read(mix->png, 1 << 20, &made, &made_size).code, RESULT_OK);
    assert_int_equal(file_read(other, 1 << 20, &expected, &expected_size).code, RESULT_OK);
    assert_int_equal(made_size, expected_size);
    assert_memory_equal(made, expected, made_size);
    image_free(&image);
    free(made);
    free(expected);
    free(exr);
    free(other);
    free(output);
}

static void mistakes_are_named(void **state)
{
    mix_t *mix = *state;
    char *output = mem_printf("-o%s", mix->to);
    const struct {
        const char *words[4], *says;
    } cases[] = {{{output, "lamp=1"}, "no light group 'lamp'; it has key, sky-2"},
                 {{output, "key"}, "'key' sets no light group"},
                 {{output, "key="}, "not ''"},
                 {{output, "key=-1"}, "from 0 to 1e+06"},
                 {{output, "key=1e7"}, "from 0 to 1e+06"},
                 {{output, "key=nan"}, "from 0 to 1e+06"},
                 {{output, "key=1,2"}, "three for red, green and blue"},
                 {{output, "key=1,2,3,4"}, "not '1,2,3,4'"},
                 {{output, "key=1x"}, "not '1x'"},
                 {{output, "key=1", "key=2"}, "'key' is set twice"},
                 {{output, "--solo=x"}, "no light group 'x'"},
                 {{output, "--solo=key", "sky-2=1"}, "--solo key puts out the light group 'sky-2'"},
                 {{"key=1"}, "say where the mixed image goes"},
                 {{"-oa.tiff"}, "must end in .exr or .png"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        result_t result = run(mix, cases[i].words);
        assert_int_equal(result.code, RESULT_USAGE);
        if (strstr(result.message, cases[i].says) == NULL)
            fail_msg("'%s' says not '%s'", result.message, cases[i].says);
    }
    image_t image;
    image_init(&image, WIDTH, HEIGHT);
    add(&image, NULL, true, true, -1);
    add(&image, "group.k\033[2J.eye", true, false, 0); /* which would clear the terminal */
    assert_int_equal(image_write_exr(mix->from, &image).code, RESULT_OK);
    image_free(&image);
    result_t result = run(mix, (const char *[4]){output});
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "a.exr: has no light groups; render it with --light-groups"));
    free(output);
}

#define TEST(function) cmocka_unit_test_setup_teardown(function, set_up, tear_down)

int main(void)
{
    const struct CMUnitTest tests[] = {TEST(groups_are_scaled_and_tinted), TEST(what_is_mixed_is_told),
                                       TEST(a_png_is_made_like_others), TEST(mistakes_are_named)};
    return cmocka_run_group_tests_name("mix", tests, NULL, NULL);
}
