/* test_import_v4: what pbrt-v4 does otherwise than v3, and what scenes of its public collection rely on. */
#include <zlib.h>

#include "tests/unit/client/import/test_import.h"

#define SPHERE "Shape \"sphere\"\n"
#define POINT_LIGHT "LightSource \"point\"\n"

static void run(bench_t *bench, const char *world)
{
    char *text = mem_printf("Film \"rgb\"\nWorldBegin\n%s", world);
    bench_run(bench, text);
    free(text);
}

static const blob_light_t *light(const bench_t *bench, uint32_t index)
{
    assert_true(index < bench->blob.counts[BLOB_SECTION_LIGHTS]);
    return &bench->blob.lights[index];
}

/* ---- directives ---------------------------------------------------------------------------------------- */

static void options_that_change_no_picture_are_ignored(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "Option \"disable-pixel_Jitter\" true\nOption \"seed\" 7\nOption \"forcediffuse\" false\n"
              "Option \"msereferenceimage\" \"a.exr\"\nWorldBegin\n" POINT_LIGHT SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:1:1: Option \"disablepixeljitter\" is ignored");
    expect_text(bench.warnings, "s.pbrt:2:1: Option \"seed\" is ignored");
    assert_int_equal(bench.warning_count, 3);
    bench_run(&bench, "Option \"forcediffuse\" true\nWorldBegin\n");
    expect_text(bench.result.message, "1:1: Option \"forcediffuse\": not supported");
    bench_run(&bench, "Option \"colour\" true\nWorldBegin\n");
    expect_text(bench.result.message, "1:1: unknown Option \"colour\"");
    bench_run(&bench, "Option \"seed\"");
    expect_text(bench.result.message, "Option \"seed\" needs a value");
    bench_close(&bench);
}

static void transform_begin_saves_everything(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, POINT_LIGHT "TransformBegin\nMaterial \"conductor\"\nTranslate 1 0 0\nTransformEnd\n" SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.materials[bench.blob.shapes[0].material].kind, MATERIAL_DIFFUSE);
    expect_vec3(xform_point(&bench.blob.quadrics[0].object_from_quadric, vec3(0, 0, 0)), 0, 0, 0);
    run(&bench, "TransformBegin\nTranslate 1 0 0\n" SPHERE);
    expect_text(bench.result.message, "s.pbrt:3:1: this block is never closed");
    bench_close(&bench);
}

static void named_coordinates_set_both_times(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, POINT_LIGHT "ActiveTransform StartTime\nTranslate 5 0 0\nCoordSysTransform \"world\"\n" SPHERE
                            "ActiveTransform EndTime\nTranslate 5 0 0\nCoordSysTransform \"world\"\n" SPHERE);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 0); /* nothing moves */
    bench_close(&bench);
}

static void compressed_files_are_included(void **state)
{
    (void)state;
    static const char text[] = SPHERE SPHERE;
    bench_t bench = {0};
    bench_write(&bench, "more.pbrt.gz", "", 0);
    char *path = bench_path(&bench, "more.pbrt.gz");
    gzFile file = gzopen(path, "wb");
    assert_non_null(file);
    assert_int_equal(gzwrite(file, text, sizeof text - 1), sizeof text - 1);
    assert_int_equal(gzclose(file), Z_OK);
    free(path);
    run(&bench, POINT_LIGHT "Include \"more.pbrt.gz\"\n" SPHERE);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 3);
    bench_write(&bench, "more.pbrt.gz", "\x1f\x8b\x08 damaged", 11);
    run(&bench, "Include \"more.pbrt.gz\"\n");
    expect_text(bench.result.message, "more.pbrt.gz");
    bench_close(&bench);
}

static void media_of_unknown_types_are_left_out_on_request(void **state)
{
    (void)state;
    bench_t bench = {.lenient = true};
    run(&bench, POINT_LIGHT
        "MakeNamedMedium \"fog\" \"string type\" \"plasma\"\nMediumInterface \"fog\" \"\"\n" SPHERE SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings,
                "s.pbrt:4:1: medium \"fog\": the type \"plasma\" is not supported; the nearest is "
                "empty space");
    assert_int_equal(bench.warning_count, 2);
    assert_int_equal(bench.blob.shapes[0].flags, 0);
    bench_close(&bench);
}

/* ---- options of the whole picture ---------------------------------------------------------------------- */

static void exposure_scales_the_picture(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "Camera \"perspective\" \"float shutteropen\" 1 \"float shutterclose\" 1.25\n"
                      "Film \"rgb\" \"float iso\" 200\nWorldBegin\n" POINT_LIGHT SPHERE);
    bench_expect_silence(&bench);
    expect_vec3(light(&bench, 0)->radiance.factor, 0.5, 0.5, 0.5);
    bench_run(&bench, "Camera \"perspective\" \"float shutterclose\" 0\nFilm \"rgb\"\nWorldBegin\n");
    expect_text(bench.result.message, "s.pbrt:1:22: the shutter closes at 0, but opens at 0");
    /* v3's shutter says nothing of the exposure */
    bench_run(
        &bench,
        "Camera \"perspective\" \"float shutterclose\" 0\nFilm \"image\"\nWorldBegin\n" POINT_LIGHT SPHERE
        "WorldEnd\n");
    bench_expect_silence(&bench);
    expect_vec3(light(&bench, 0)->radiance.factor, 1, 1, 1);
    bench_close(&bench);
}

static void sensors_have_their_gain(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench,
              "Film \"rgb\" \"string sensor\" \"canon_eos_100d\" \"float iso\" 50\nWorldBegin\n" POINT_LIGHT
                  SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:1:12: sensor \"canon_eos_100d\": \"cie1931\" is used");
    expect_vec3(light(&bench, 0)->radiance.factor, 0.5, 0.5, 0.5);
    bench_close(&bench);
}

/* By hand from the formulae: x and y of daylight, Bradford's matrix, and back. */
static void white_is_balanced_by_bradfords_matrix(void **state)
{
    (void)state;
    static const struct {
        int kelvin;
        double rgb[3];
    } cases[] = {
        {4500, {0.7400, 1.0361, 1.5938}}, {6500, {1.0004, 0.9998, 1.0012}}, {9000, {1.1456, 0.9876, 0.7545}}};
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *text = mem_printf("Film \"rgb\" \"float whitebalance\" %d\nWorldBegin\n" POINT_LIGHT SPHERE,
                                cases[i].kelvin);
        bench_run(&bench, text);
        free(text);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, "1:12: the white balance is put into the lights");
        rgb_t factor = light(&bench, 0)->radiance.factor;
        expect_near((double)factor.x, cases[i].rgb[0], 1e-3);
        expect_near((double)factor.y, cases[i].rgb[1], 1e-3);
        expect_near((double)factor.z, cases[i].rgb[2], 1e-3);
    }
    bench_run(&bench, "Film \"rgb\" \"float whitebalance\" 0\nWorldBegin\n" POINT_LIGHT SPHERE);
    bench_expect_silence(&bench);
    expect_vec3(light(&bench, 0)->radiance.factor, 1, 1, 1);
    bench_run(&bench, "Film \"rgb\" \"float whitebalance\" 9\nWorldBegin\n");
    expect_text(bench.result.message, "must be from 1667 to 25000");
    bench_close(&bench);
}

static void the_crop_window_goes_before_pixel_bounds(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "Film \"rgb\" \"integer xresolution\" 100 \"integer yresolution\" 50 \"float "
                      "cropwindow\" [0 0.5 0 1] "
                      "\"integer pixelbounds\" [60 70 0 10]\nWorldBegin\n" POINT_LIGHT SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "the cropwindow goes before it");
    assert_int_equal(bench.blob.scene->width, 50);
    assert_int_equal(bench.blob.scene->height, 50);
    bench_close(&bench);
}

/* ---- textures ------------------------------------------------------------------------------------------ */

#define PFM_2X1 "PF\n2 1\n-1\n\0\0\200?\0\0\200?\0\0\200?\0\0\0\0\0\0\0\0\0\0\0\0"
#define IMAGE "\"imagemap\" \"string filename\" \"a.pfm\" "

static const blob_material_t *material(const bench_t *bench)
{
    return &bench->blob.materials[bench->blob.shapes[0].material];
}

static void height_on_a_cylinder_is_its_coordinate(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_write(&bench, "a.pfm", PFM_2X1, sizeof PFM_2X1 - 1);
    run(&bench, POINT_LIGHT "Scale 1 1 4\nTexture \"a\" \"spectrum\" " IMAGE
                            "\"string mapping\" \"cylindrical\" \"string wrap\" \"clamp\"\nIdentity\n"
                            "Material \"diffuse\" \"texture reflectance\" \"a\"\n" SPHERE);
    bench_expect_silence(&bench);
    const blob_texture_t *texture = &bench.blob.textures[0];
    assert_int_equal(texture->mapping, MAPPING_CYLINDER);
    assert_int_equal(texture->wrap_t, WRAP_CLAMP);
    /* the bottom row, t = 1, where z = 0, the top one at z = 4 */
    expect_vec3(xform_point(&texture->texture_from_world, vec3(2, 3, 0)), 2, 3, 1);
    expect_vec3(xform_point(&texture->texture_from_world, vec3(2, 3, 4)), 2, 3, 0);
    bench_run_v3(&bench, "Texture \"a\" \"spectrum\" " IMAGE
                         "\"string mapping\" \"cylindrical\" \"string wrap\" \"clamp\"");
    expect_text(bench.result.message, "an image on a cylinder can only repeat");
    bench_close(&bench);
}

static void what_is_reflected_is_at_most_one(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_write(&bench, "a.pfm", PFM_2X1, sizeof PFM_2X1 - 1);
    run(&bench, POINT_LIGHT "Texture \"a\" \"spectrum\" " IMAGE "\"float scale\" 3\n"
                            "Texture \"b\" \"float\" " IMAGE "\"float scale\" 3 \"bool invert\" true\n"
                            "Material \"diffuse\" \"texture reflectance\" \"a\"\n" SPHERE
                            "Material \"coateddiffuse\" \"texture roughness\" \"b\"\n" SPHERE
                            "Material \"diffusetransmission\" \"float scale\" 9\n" SPHERE);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.textures[0].flags, TEXTURE_UNIT);
    assert_int_equal(bench.blob.textures[1].flags, TEXTURE_INVERT);
    expect_vec3(bench.blob.textures[1].inputs[0].factor, 3, 3, 3);
    assert_int_equal(material(&bench)->flags, MATERIAL_UNIT);
    assert_int_equal(material(&bench)[1].flags, MATERIAL_REMAP_SQRT);
    assert_int_equal(material(&bench)[2].flags, MATERIAL_UNIT);
    bench_close(&bench);
}

/* A spectrum may have a colour beyond sRGB: that is taken for 1, and the spectrum stays what it is. */
static void a_spectrum_beyond_srgb_is_kept(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        POINT_LIGHT "Material \"diffuse\" \"spectrum reflectance\" [400 .05 520 .05 580 .9 700 .9]\n" SPHERE);
    bench_expect_silence(&bench);
    const blob_value_t *value = &material(&bench)->values[VALUE_REFLECTANCE];
    assert_float_equal(value->factor.x, 1, 0);
    float most = 0;
    for (int i = 0; i < BLOB_SPECTRUM_SAMPLES; i++)
        most = float_max(most, bench.blob.spectra[value->spectrum - 1].samples[i]);
    assert_float_equal(most * v_max(value->factor), 0.9f, 1e-3f);
    bench_close(&bench);
}

/* ---- names that come later ----------------------------------------------------------------------------- */

static void names_may_come_later(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_write(&bench, "a.pfm", PFM_2X1, sizeof PFM_2X1 - 1);
    run(&bench, POINT_LIGHT
        "NamedMaterial \"mix\"\n" SPHERE "Material \"diffuse\" \"texture reflectance\" \"picture\"\n" SPHERE
        "MakeNamedMaterial \"mix\" \"string type\" \"mix\" \"string materials\" [\"one\" \"two\"]\n"
        "MakeNamedMaterial \"two\" \"string type\" \"conductor\"\n"
        "MakeNamedMaterial \"one\" \"string type\" \"diffuse\" \"texture reflectance\" \"picture\"\n"
        "Texture \"picture\" \"spectrum\" " IMAGE "\nNamedMaterial \"one\"\n" SPHERE);
    bench_expect_silence(&bench);
    const blob_material_t *materials = bench.blob.materials, *mix = material(&bench);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    assert_int_equal(materials[mix->parts[0]].kind, MATERIAL_DIFFUSE);
    assert_int_equal(materials[mix->parts[0]].values[VALUE_REFLECTANCE].texture, 1);
    assert_int_equal(materials[mix->parts[1]].kind, MATERIAL_CONDUCTOR);
    assert_int_equal(materials[bench.blob.shapes[1].material].values[VALUE_REFLECTANCE].texture, 1);
    assert_int_equal(bench.blob.shapes[2].material, mix->parts[0]);
    assert_int_equal(mix->flags & MATERIAL_CHOSEN, 0);

    run(&bench, POINT_LIGHT
        "Texture \"waves\" \"float\" \"wrinkled\"\n"
        "MakeNamedMaterial \"one\" \"string type\" \"diffuse\" \"texture displacement\" \"waves\"\n"
        "MakeNamedMaterial \"two\" \"string type\" \"conductor\"\n"
        "MakeNamedMaterial \"three\" \"string type\" \"mix\" \"string materials\" [\"two\" \"one\"]\n"
        "Material \"mix\" \"string materials\" [\"two\" \"three\"]\n" SPHERE);
    bench_expect_silence(&bench);
    assert_true(material(&bench)->flags & MATERIAL_CHOSEN); /* of a mix with relief */

    run(&bench, POINT_LIGHT "NamedMaterial \"absent\"\n" SPHERE);
    expect_text(bench.result.message, "s.pbrt:4:1: there is no MakeNamedMaterial \"absent\"");
    run(&bench, POINT_LIGHT "Material \"diffuse\" \"texture reflectance\" \"absent\"\n" SPHERE);
    expect_text(bench.result.message, "s.pbrt:4:20: no spectrum Texture \"absent\"");
    run(&bench, POINT_LIGHT "NamedMaterial \"glue\"\n" SPHERE
                            "MakeNamedMaterial \"glue\" \"string type\" \"interface\"\n");
    expect_text(bench.result.message, "s.pbrt:6:1: an interface must be made before a shape has it");
    run(&bench,
        POINT_LIGHT "NamedMaterial \"m\"\n" SPHERE
                    "MakeNamedMaterial \"m\" \"string type\" \"mix\" \"string materials\" [\"m\" \"m\"]\n");
    expect_text(bench.result.message, "this mix contains itself");
    run(&bench, POINT_LIGHT "NamedMaterial \"unused\"\nMaterial \"diffuse\"\n" SPHERE);
    bench_expect_silence(&bench);
    bench_close(&bench);
}

static void materials_keep_their_colour_space(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, POINT_LIGHT "ColorSpace \"rec2020\"\nMakeNamedMaterial \"m\" \"string type\" \"diffuse\" "
                            "\"rgb reflectance\" [0.2 0.4 0.2]\nColorSpace \"srgb\"\n"
                            "NamedMaterial \"m\"\n" SPHERE);
    bench_expect_silence(&bench);
    assert_true(material(&bench)->values[VALUE_REFLECTANCE].factor.y > 0.42f);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(options_that_change_no_picture_are_ignored),
        cmocka_unit_test(transform_begin_saves_everything),
        cmocka_unit_test(named_coordinates_set_both_times),
        cmocka_unit_test(compressed_files_are_included),
        cmocka_unit_test(media_of_unknown_types_are_left_out_on_request),
        cmocka_unit_test(exposure_scales_the_picture),
        cmocka_unit_test(sensors_have_their_gain),
        cmocka_unit_test(white_is_balanced_by_bradfords_matrix),
        cmocka_unit_test(the_crop_window_goes_before_pixel_bounds),
        cmocka_unit_test(height_on_a_cylinder_is_its_coordinate),
        cmocka_unit_test(what_is_reflected_is_at_most_one),
        cmocka_unit_test(a_spectrum_beyond_srgb_is_kept),
        cmocka_unit_test(names_may_come_later),
        cmocka_unit_test(materials_keep_their_colour_space),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
