/* Normal maps of the parts of a mix (MATERIAL_CHOSEN): the mix is as bright as its parts are in the mean. And
 * bumps where uvs say nothing. */
#include "client/import/import.h"
#include "tests/render_here.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

enum { SIDE = 24 };

/* A white wall whose normal map leans so far to one side. */
static uint32_t add_leaning(test_scene_t *scene, float lean)
{
    blob_texture_t map = {.kind = TEXTURE_MIX};
    for (size_t i = 0; i < 3; i++) map.inputs[i].factor = vec3(0.5f, 0.5f + 0.5f * lean, 1);
    blob_material_t material = {.kind = MATERIAL_DIFFUSE, .normal_scale = 1};
    material.normal_map = 1 + blob_builder_add(scene->builder, BLOB_SECTION_TEXTURES, &map, 1);
    material.values[VALUE_REFLECTANCE] = blob_constant(0.5f);
    return test_scene_material(scene, material);
}

/* The mean of a picture of the wall, on which light falls at an angle; of the mix, or of one part. */
static double brightness(bool mixed, float lean, float other, float amount)
{
    test_scene_t scene = test_scene_begin(vec3(0, 0, -3), 40, SIDE);
    uint32_t wall = add_leaning(&scene, lean);
    if (mixed) {
        blob_material_t mix = {.kind = MATERIAL_MIX, .flags = MATERIAL_CHOSEN};
        mix.parts[0] = wall;
        mix.parts[1] = add_leaning(&scene, other);
        mix.values[VALUE_AMOUNT] = blob_constant(amount);
        wall = test_scene_material(&scene, mix);
    }
    test_scene_rectangle(&scene, vec3(-9, -9, 1), vec3(0, 18, 0), vec3(18, 0, 0), wall, vec3(0, 0, 0));
    blob_light_t sun = {.kind = LIGHT_DISTANT,
                        .radiance = blob_constant(1),
                        .world_from_light = {{{-0.8f, 0, 0.6f, 0}, {0, 1, 0, 0}, {-0.6f, 0, -0.8f, 0}}}};
    blob_builder_add(scene.builder, BLOB_SECTION_LIGHTS, &sun, 1);
    test_scene_finish(&scene);
    job_settings_t settings = blob_default_settings(&scene.blob);
    settings.spp = 16;
    film_t *film = render_here(&scene.blob, &settings);
    film_image_t image;
    double sum = 0;
    film_resolve(film, &image);
    for (size_t i = 0; i < 3 * SIDE * SIDE; i++) sum += (double)image.sum[i] / (3 * SIDE * SIDE);
    film_image_free(&image);
    film_destroy(&film);
    test_scene_end(&scene);
    return sum;
}

static void parts_keep_their_relief(void **state)
{
    (void)state;
    double left = brightness(false, -0.6f, 0, 0), right = brightness(false, 0.6f, 0, 0);
    assert_true(fabs(left - right) > 0.3 * (left + right));
    for (int i = 0; i <= 4; i++) {
        double mixed = brightness(true, -0.6f, 0.6f, (float)i / 4), expected = left + i * (right - left) / 4;
        print_message("%d / 4: %.4f, expected %.4f\n", i, mixed, expected);
        double most = i % 4 == 0 ? 1e-5 : 0.02 * (left + right);
        assert_float_equal(mixed, expected, most);
    }
}

/* A texture of space bumps a mesh, though the uvs of all its corners are the same. */
static void bumps_need_no_uvs(void **state)
{
    (void)state;
    static const char text[] =
        "LookAt 0 0 -3  0 0 0  0 1 0\nCamera \"perspective\"\nFilm \"rgb\" \"integer xresolution\" [24] "
        "\"integer yresolution\" [24]\nWorldBegin\n"
        "LightSource \"distant\" \"point3 from\" [-1 0 -1] \"point3 to\" [0 0 0]\n"
        "Texture \"b\" \"float\" \"fbm\"\nMaterial \"diffuse\" \"texture displacement\" \"b\"\n"
        "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point2 uv\" [0 0 0 0 0 0 0 0] "
        "\"point3 P\" [-9 -9 0  9 -9 0  9 9 0  -9 9 0]\n";
    char *folder = scratch_new(), *path = scratch_path(folder, "scene.pbrt");
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    film_image_t image;
    scratch_write(path, text, sizeof text - 1);
    assert_int_equal(import_scene_blob(path, NULL, &bytes, &size).code, RESULT_OK);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    job_settings_t settings = blob_default_settings(&blob);
    settings.spp = 4;
    film_t *film = render_here(&blob, &settings);
    film_resolve(film, &image);
    float least = INFINITY, most = 0;
    for (size_t i = 0; i < 3 * SIDE * SIDE; i++) {
        least = fminf(least, image.sum[i]);
        most = fmaxf(most, image.sum[i]);
    }
    print_message("from %.3f to %.3f\n", (double)least, (double)most);
    assert_true(most > 1.2f * least);
    film_image_free(&image);
    film_destroy(&film);
    free(bytes);
    free(path);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(parts_keep_their_relief),
                                       cmocka_unit_test(bumps_need_no_uvs)};
    return cmocka_run_group_tests_name("relief", tests, NULL, NULL);
}
