/* Tests of `lightmill info` and of text.h: what it says about images, scenes and blobs, the hashes, and that
 * a file's bytes cannot command the terminal. Runs from the top of the tree, for scenes/. */
#include "client/commands/commands.h"
#include "client/scene/loaded_scene.h"
#include "common/image/image.h"
#include "common/text/text.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static int setup(void **state)
{
    *state = scratch_new();
    return 0;
}

static int teardown(void **state)
{
    scratch_destroy((char **)state);
    return 0;
}

/* Runs info with an option (or NULL) on a file; the output in fresh memory. */
static result_t run(const char *folder, const char *option, const char *path, char **output)
{
    char *argv[4] = {"info"};
    int argc = 1;
    if (option != NULL) argv[argc++] = (char *)option;
    if (path != NULL) argv[argc++] = (char *)path;
    scratch_capture_t capture = scratch_capture(folder, 1);
    result_t result = command_run(&info_command, argc, argv);
    *output = scratch_uncapture(&capture);
    return result;
}

static void assert_result(result_t result, result_code_t code, const char *part)
{
    if (result.code != code || strstr(result.message, part) == NULL)
        fail_msg("expected code %d with '%s', got code %d: %s", code, part, result.code, result.message);
}

static void assert_says(const char *folder, const char *option, const char *path, const char *part)
{
    char *text;
    assert_result(run(folder, option, path, &text), RESULT_OK, "");
    if (strstr(text, part) == NULL) fail_msg("'%s' is missing in: %s", part, text);
    free(text);
}

static void assert_refuses(const char *folder, const char *option, const char *path, result_code_t code,
                           const char *part)
{
    char *text;
    assert_result(run(folder, option, path, &text), code, part);
    assert_string_equal(text, "");
    free(text);
}

/* ---- images ---- */

static const char hostile[] = "\x1b[2J\xc2\x9b"
                              "5m\xff\"\\\n\xc3\xa9\xed\xa0\x80";

static char *write_image(const char *folder, const char *name, const char *note, float first)
{
    char *path = scratch_path(folder, name);
    image_t image;
    image_init(&image, 4, 2);
    float *red = image_add_channel(&image, "R", PIXEL_FLOAT);
    float *noise = image_add_channel(&image, "noise.R", PIXEL_HALF);
    for (size_t p = 0; p < 8; p++) red[p] = (float)p;
    red[0] = first;
    noise[3] = NAN;
    image_set_string(&image, "lightmill.note", note);
    image_set_int(&image, "lightmill.spp", 64);
    image_set_float(&image, "lightmill.nan", NAN);
    assert_int_equal(image_write_exr(path, &image).code, RESULT_OK);
    image_free(&image);
    return path;
}

static void images_are_described(void **state)
{
    char *path = write_image(*state, "a.exr", "hello", 0.0f);
    assert_says(*state, NULL, path, "OpenEXR image, 4 x 2 pixels, 2 channels");
    assert_says(*state, NULL, path, "R                float              0             7           3.5\n");
    assert_says(*state, NULL, path,
                "noise.R          half               0             0             0  1 not finite\n");
    assert_says(*state, NULL, path, "lightmill.note: hello\n");
    assert_says(*state, "--json", path, "\"kind\": \"image\", \"width\": 4, \"height\": 2, ");
    assert_says(*state, "--json", path,
                "{\"name\": \"R\", \"type\": \"float\", \"min\": 0.0, \"max\": 7.0, \"mean\": 3.5, "
                "\"not_finite\": 0}");
    assert_says(*state, "--json", path, "\"lightmill.spp\": 64");
    assert_says(*state, "--json", path, "\"lightmill.nan\": null");
    free(path);
}

static void the_hash_is_of_the_pixels(void **state)
{
    char *paths[] = {write_image(*state, "a.exr", "one", 0.0f), write_image(*state, "b.exr", "another", 0.0f),
                     write_image(*state, "c.exr", "one", 1e-30f)};
    char *hashes[3];
    image_t image;
    for (size_t i = 0; i < 3; i++) assert_result(run(*state, "--hash", paths[i], &hashes[i]), RESULT_OK, "");
    assert_string_equal(hashes[0], hashes[1]);
    assert_string_not_equal(hashes[0], hashes[2]);
    assert_int_equal(image_read_exr(paths[0], &image).code, RESULT_OK);
    hash_t hash = image_hash(&image);
    char expected[2 * HASH_BYTES + 2];
    hash_to_hex(&hash, expected);
    strcat(expected, "\n");
    assert_string_equal(hashes[0], expected);
    image_free(&image);
    for (size_t i = 0; i < 3; i++) {
        free(paths[i]);
        free(hashes[i]);
    }
}

static void terminals_are_safe(void **state)
{
    char *path = write_image(*state, "a.exr", hostile, 0.0f), *text;
    assert_result(run(*state, NULL, path, &text), RESULT_OK, "");
    assert_null(strchr(text, '\x1b'));
    assert_null(strstr(text, "\xc2\x9b"));
    assert_non_null(strstr(text, "\\x1b[2J\\xc2\\x9b5m\\xff\"\\\\x0a\xc3\xa9\\xed\\xa0\\x80"));
    free(text);
    assert_says(*state, "--json", path,
                "\"\\u001B[2J\\u009B5m\\uFFFD\\\"\\\\\\n\\u00E9\\uFFFD\\uFFFD\\uFFFD\"");
    free(path);
}

/* ---- scenes ---- */

static void scenes_are_described(void **state)
{
    assert_says(*state, NULL, "scenes/cornell", "triangles  32\n");
    assert_says(*state, NULL, "scenes/cornell/scene.pbrt", "fov 39.3077 degrees");
    assert_says(*state, NULL, "scenes/cornell", "128 x 128 pixels");
    assert_says(*state, NULL, "scenes/cornell", "light 0: area  radiance 18.4 15.6 8");
    assert_says(*state, NULL, "scenes/caustic",
                "dielectric  reflectance 1 1 1  transmittance 1 1 1  eta 1.5");
    assert_says(*state, NULL, "scenes/caustic", "conductor   reflectance 1 1 1");
    assert_says(*state, NULL, "scenes/caustic", "eta 0.143 0.375 1.442");
    assert_says(*state, "--json", "scenes/caustic", "\"quadrics\": 1");
    assert_says(*state, "--json", "scenes/seed-specular", "\"mirror\"");
}

static void textures_images_and_lights_are_described(void **state)
{
    static const uint8_t grey[] = {0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 1, 0, 8, 0, 10, 20};
    static const char scene[] =
        "WorldBegin\nTexture \"a\" \"float\" \"imagemap\" \"string filename\" \"a.tga\" \"float scale\" 2\n"
        "Texture \"b\" \"spectrum\" \"checkerboard\" \"rgb tex2\" [.5 .25 0]\n"
        "MakeNamedMaterial \"m\" \"string type\" \"plastic\" \"texture Kd\" \"b\" \"texture bumpmap\" \"a\"\n"
        "MakeNamedMaterial \"n\" \"string type\" \"mirror\"\n"
        "Material \"mix\" \"string namedmaterial1\" \"m\" \"string namedmaterial2\" \"n\"\nShape \"sphere\"\n"
        "LightSource \"point\" \"rgb I\" [1 2 3]\nWorldEnd\n";
    char *image = scratch_path(*state, "a.tga"), *path = scratch_path(*state, "s.pbrt");
    scratch_write(image, grey, sizeof grey);
    scratch_write(path, scene, sizeof scene - 1);
    assert_says(*state, NULL, path, "textures   2\nimages     1\nlights     1\n");
    assert_says(*state, NULL, path, "texture 0: image  over uv  image 0  input 2 2 2\n");
    assert_says(*state, NULL, path, "texture 1: checkerboard  over uv  input 1 1 1  input 0.5 0.25 0\n");
    assert_says(*state, NULL, path, "image 0: 2 x 1 pixels, grey, 8 bits, sRGB\n");
    assert_says(*state, NULL, path, "plastic     reflectance 1 1 1 x texture 1  specular 0.25 0.25 0.25");
    assert_says(*state, NULL, path, "bumps of texture 0");
    assert_says(*state, NULL, path, "material 2: mix         of 0 and 1  amount 0.5 0.5 0.5");
    assert_says(*state, NULL, path, "light 0: point  intensity 1 2 3\n");
    assert_says(*state, "--json", path, "\"material_kinds\": [\"mirror\", \"plastic\", \"mix\"]");
    free(image);
    free(path);
}

static void media_are_described(void **state)
{
    static const char scene[] =
        "MakeNamedMedium \"fog\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [1 2 3] \"rgb sigma_s\" [4 "
        "5 6]\n"
        "MediumInterface \"\" \"fog\"\nCamera \"perspective\"\nWorldBegin\nScale 2 2 2\n"
        "MakeNamedMedium \"smoke\" \"string type\" \"uniformgrid\" \"integer ny\" 2 \"float density\" [1 2] "
        "\"float g\" 0.5 \"rgb Le\" [1 2 3]\n"
        "MakeNamedMedium \"cloud\" \"string type\" \"cloud\"\n"
        "MakeNamedMedium \"fire\" \"string type\" \"uniformgrid\" \"float density\" 1 \"float temperature\" "
        "2000\n"
        "LightSource \"point\" Material \"interface\" Shape \"sphere\"\n";
    char *path = scratch_path(*state, "s.pbrt");
    scratch_write(path, scene, sizeof scene - 1);
    assert_says(*state, NULL, path, "lights     1\nmedia      4\n");
    assert_says(*state, NULL, path, "looks along 0 0 1  in medium 0\n");
    assert_says(*state, NULL, path, "light 0: point  intensity 1 1 1  in medium 0\n");
    assert_says(*state, NULL, path, "material 0: interface \n");
    assert_says(*state, NULL, path, "medium 0:  absorption 1 2 3  scattering 4 5 6  g 0  fog\n");
    assert_says(
        *state, NULL, path,
        "medium 1:  absorption 1 1 1  scattering 1 1 1  emission 1 2 3  g 0.5  in 1 x 2 x 1 cells  smoke\n");
    assert_says(*state, NULL, path, "medium 2:  absorption 1 1 1  scattering 1 1 1  g 0  a cloud  cloud\n");
    assert_says(*state, NULL, path, "g 0  in 1 x 1 x 1 cells  glows by its temperature  fire\n");
    assert_says(*state, "--json", path, "\"media\": 4");
    assert_says(*state, "--json", path, "\"material_kinds\": [\"interface\"]");
    free(path);
}

static void blobs_are_described_like_their_scene(void **state)
{
    char *path = scratch_path(*state, "scene.blob"), *of_scene, *of_blob;
    loaded_scene_t scene;
    assert_result(scene_load("scenes/caustic", NULL, &scene), RESULT_OK, "");
    scratch_write(path, scene.blob.bytes, scene.blob.size);
    assert_result(run(*state, "--json", "scenes/caustic", &of_scene), RESULT_OK, "");
    assert_result(run(*state, "--json", path, &of_blob), RESULT_OK, "");
    assert_string_equal(of_scene, of_blob);
    free(of_scene);
    free(of_blob);

    hash_t hash = hash_bytes(scene.blob.bytes, scene.blob.size);
    char expected[2 * HASH_BYTES + 2];
    hash_to_hex(&hash, expected);
    strcat(expected, "\n");
    assert_result(run(*state, "--hash", path, &of_blob), RESULT_OK, "");
    assert_string_equal(of_blob, expected);
    free(of_blob);

    scratch_write(path, scene.blob.bytes, scene.blob.size / 2);
    assert_refuses(*state, NULL, path, RESULT_INPUT, "scene.blob");
    scene_free(&scene);
    free(path);
}

/* ---- errors ---- */

static void errors_name_the_file(void **state)
{
    char *path = scratch_path(*state, "x.dat"), *text;
    scratch_write(path, "neither", 7);
    assert_refuses(*state, NULL, path, RESULT_INPUT, "x.dat");
    scratch_write(path, "\x76\x2f\x31\x01 but no more", 16);
    assert_refuses(*state, NULL, path, RESULT_INPUT, "x.dat: cannot be read as OpenEXR");
    scratch_write(path, "", 0);
    assert_refuses(*state, NULL, path, RESULT_INPUT, "x.dat");
    assert_refuses(*state, NULL, "/nowhere/x.exr", RESULT_INPUT, "/nowhere/x.exr: cannot be opened");
    assert_refuses(*state, NULL, "/dev/null", RESULT_INPUT, "/dev/null: is not a regular file");
    assert_refuses(*state, NULL, NULL, RESULT_USAGE, "expects FILE");
    assert_refuses(*state, "a", "b", RESULT_USAGE, "one argument too many: 'b'");
    assert_refuses(*state, "--bogus", "b", RESULT_USAGE, "--bogus");
    assert_result(run(*state, "--help", NULL, &text), RESULT_OK, "");
    assert_non_null(strstr(text, "usage: lightmill info FILE"));
    free(text);
    free(path);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, setup, teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {TEST(images_are_described),
                                       TEST(the_hash_is_of_the_pixels),
                                       TEST(terminals_are_safe),
                                       TEST(scenes_are_described),
                                       TEST(textures_images_and_lights_are_described),
                                       TEST(media_are_described),
                                       TEST(blobs_are_described_like_their_scene),
                                       TEST(errors_name_the_file)};
    return cmocka_run_group_tests_name("info", tests, NULL, NULL);
}
