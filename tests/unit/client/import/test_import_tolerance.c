/* Slips that pbrt forgives: each is taken with a warning that says what pbrt does, means what pbrt makes of
 * it, and is an error when the import is strict. What pbrt refuses stays an error. */
#include "tests/unit/client/import/test_import.h"

#define SPHERE "Shape \"sphere\"\n"
#define V3(text) text "\nWorldEnd\n"

/* Imports a scene that only says `warning`, which the strict import fails with. */
static void expect_forgiven(bench_t *bench, const char *text, const char *warning)
{
    bench->strict = true;
    bench_run(bench, text);
    assert_int_equal(bench->result.code, RESULT_INPUT);
    char *place = mem_printf("%.*s", (int)strcspn(warning, " "), warning);
    expect_text(bench->result.message, place);
    free(place);
    bench->strict = false;
    bench_run(bench, text);
    bench_expect_ok(bench);
    char *expected = mem_printf("s.pbrt:%s", warning);
    expect_text(bench->warnings, expected);
    free(expected);
}

/* The same in the dialect that is asked for. */
static void expect_forgiven_in(bench_t *bench, bool v3, const char *text, const char *warning)
{
    char *whole = mem_printf("%s%s", text, v3 ? "\nWorldEnd\n" : "");
    expect_forgiven(bench, whole, warning);
    free(whole);
}

static void expect_refused(bench_t *bench, const char *text, const char *message)
{
    bench_run(bench, text);
    if (bench->result.code != RESULT_INPUT) fail_msg("accepted: %s", text);
    expect_text(bench->result.message, message);
}

static rgb_t colour_of(const bench_t *bench, uint64_t shape, material_value_t slot)
{
    assert_true(shape < bench->blob.counts[BLOB_SECTION_SHAPES]);
    blob_value_t value = bench->blob.materials[bench->blob.shapes[shape].material].values[slot];
    assert_int_equal(value.texture, 0);
    return value.factor;
}

static vec3_t centre_of(const bench_t *bench, uint64_t shape)
{
    const blob_quadric_t *quadric = &bench->blob.quadrics[bench->blob.shapes[shape].geometry];
    return xform_point(&quadric->object_from_quadric, vec3(0, 0, 0));
}

/* ---- settings ------------------------------------------------------------------------------------------ */

#define TWO_FILMS(type)                                                                                      \
    "Film \"" type "\" \"integer xresolution\" 100 \"float cropwindow\" [0 0.5 0 1]\n"                       \
    "Film \"" type "\" \"integer yresolution\" 50\nWorldBegin " SPHERE

static void the_last_setting_of_each_kind_counts(void **state)
{
    (void)state;
    bench_t bench = {0};
    for (int v3 = 0; v3 < 2; ++v3) {
        expect_forgiven_in(&bench, v3, v3 ? TWO_FILMS("image") : TWO_FILMS("rgb"),
                           "2:1: a second Film; the first, in line 1 of");
        assert_int_equal(bench.blob.scene->width, 1280); /* the default: nothing of the first is left */
        assert_int_equal(bench.blob.scene->height, 50);
        expect_forgiven_in(&bench, v3,
                           "Sampler \"sobol\" \"integer pixelsamples\" 9\n"
                           "Sampler \"halton\" \"integer pixelsamples\" 7\nWorldBegin " SPHERE,
                           "2:1: a second Sampler; the first, in line 1 of");
        assert_int_equal(bench.blob.scene->spp, 7);
        expect_forgiven_in(&bench, v3,
                           "Integrator \"bdpt\" \"integer maxdepth\" 3\nIntegrator \"path\"\n"
                           "WorldBegin " SPHERE,
                           "2:1: a second Integrator;");
        assert_int_equal(bench.blob.scene->integrator, INTEGRATOR_PATH);
        assert_int_equal(bench.blob.scene->max_depth, 5);
        expect_forgiven_in(&bench, v3, "PixelFilter \"box\"\nPixelFilter \"triangle\"\nWorldBegin " SPHERE,
                           "2:1: a second PixelFilter;");
        assert_int_equal(bench.blob.scene->filter.kind, FILTER_TRIANGLE);
        expect_forgiven_in(&bench, v3,
                           "Camera \"orthographic\" \"float screenwindow\" [0 1 0 1]\n"
                           "Translate 0 0 3\nCamera \"perspective\"\nWorldBegin " SPHERE,
                           "3:1: a second Camera;");
        assert_int_equal(bench.blob.scene->camera, CAMERA_PERSPECTIVE);
        expect_near((double)bench.blob.scene->screen_window[0], 0, 0);
        expect_vec3(xform_point(&bench.blob.scene->world_from_camera, vec3(0, 0, 0)), 0, 0, -3);
        expect_forgiven_in(&bench, v3, "Accelerator \"bvh\"\nAccelerator \"kdtree\"\nWorldBegin " SPHERE,
                           "2:1: a second Accelerator;");
    }
    bench_close(&bench);
}

static void what_is_wrong_with_a_dropped_setting_does_not_count(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "Film \"wurst\" \"float xresolution\" 3\nFilm \"rgb\"\nWorldBegin " SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 2); /* the second Film, and no light */
    expect_refused(&bench, "Film \"rgb\"\nFilm \"wurst\"\nWorldBegin " SPHERE, "2:1: unknown film \"wurst\"");
    bench_close(&bench);
}

/* ---- parameters ---------------------------------------------------------------------------------------- */

static void the_last_of_two_parameters_counts(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_forgiven(&bench, "Camera \"perspective\" \"float fov\" 40 \"float fov\" 41\nWorldBegin " SPHERE,
                    "1:37: parameter \"fov\" is given twice; as in pbrt, that of line 1 is dropped");
    expect_near((double)bench.blob.scene->fov, 41, 0);
    /* v3: all colours are one type */
    expect_forgiven(&bench,
                    V3("WorldBegin\nMaterial \"matte\" \"rgb Kd\" [1 0 0] \"xyz Kd\" [0 0 0] \"color Kd\" [0 "
                       "0 1]\n" SPHERE),
                    "2:35: parameter \"Kd\" is given twice");
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0, 0, 1);
    bench_close(&bench);
}

static void v3_leaves_out_numbers_too_many(void **state)
{
    (void)state;
    static const struct {
        const char *parameter, *warning;
        double red, green;
    } cases[] = {
        {"\"rgb Kd\" [.1 .2 .3 .4]", "1:29: parameter \"Kd\" takes 3 numbers at a time, found 4;", 0.1, 0.2},
        {"\"spectrum Kd\" [500 .5 600]", "1:29: parameter \"Kd\" takes 2 numbers at a time, found 3;", 0.601,
         0.473},
        {"\"blackbody Kd\" [6500 0 1]", "1:29: parameter \"Kd\" takes 2 numbers at a time, found 3;", 0, 0},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *text = mem_printf(V3("WorldBegin Material \"matte\" %s\n" SPHERE), cases[i].parameter);
        expect_forgiven(&bench, text, cases[i].warning);
        rgb_t colour = colour_of(&bench, 0, VALUE_REFLECTANCE);
        expect_near((double)colour.x, cases[i].red, 1e-3);
        expect_near((double)colour.y, cases[i].green, 1e-3);
        free(text);
    }
    expect_refused(&bench, V3("WorldBegin Material \"matte\" \"rgb Kd\" [.1 .2]\n" SPHERE), "three numbers");
    expect_refused(&bench, "WorldBegin Material \"diffuse\" \"rgb reflectance\" [.1 .2 .3 .4]\n" SPHERE,
                   "three numbers, found 4");
    bench_close(&bench);
}

/* v3 looks for a texture first; v4 takes what comes last, and refuses to have the other unused. */
static void of_two_types_each_pbrt_takes_its_own(void **state)
{
    (void)state;
    static const char texture[] =
        "WorldBegin\nTexture \"t\" \"spectrum\" \"constant\" \"rgb value\" [0 1 0]\n";
    bench_t bench = {0};
    char *text = mem_printf(
        "%sMaterial \"matte\" \"texture Kd\" \"t\" \"rgb Kd\" [1 0 0]\n" SPHERE "WorldEnd\n", texture);
    bench_run(&bench, text);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:3:35: unused parameter \"rgb Kd\"");
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0, 1, 0);
    free(text);
    text = mem_printf(
        "%sMaterial \"diffuse\" \"texture reflectance\" \"t\" \"rgb reflectance\" [1 0 0]\n" SPHERE, texture);
    expect_refused(&bench, text, "3:20: this material has no parameter \"texture reflectance\"");
    free(text);
    bench_close(&bench);
}

static void a_parameter_of_the_wrong_type_is_not_there_in_v3(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_forgiven(
        &bench, V3("Camera \"perspective\" \"integer fov\" 40\nWorldBegin " SPHERE),
        "1:22: parameter \"fov\" must be of type float, not integer; it is ignored, as by pbrt-v3");
    expect_near((double)bench.blob.scene->fov, 90, 0);
    expect_refused(&bench, "Camera \"perspective\" \"integer fov\" 40\nWorldBegin " SPHERE,
                   "1:22: parameter \"fov\" must be of type float, not integer");
    bench_close(&bench);
}

static void a_parameter_of_several_values_is_not_the_one_of_v3(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char *const values[] = {"[2 3]", "[]"};
    for (size_t i = 0; i < ARRAY_LENGTH(values); ++i) {
        char *text = mem_printf("WorldBegin\nShape \"sphere\" \"float radius\" %s", values[i]);
        expect_refused(&bench, text, "2:16: parameter \"radius\" takes one value, found");
        char *v3 = mem_printf("%s\nWorldEnd\n", text);
        expect_forgiven(&bench, v3, "2:16: parameter \"radius\" takes one value, found");
        expect_text(bench.warnings, "; it is ignored, as by pbrt-v3");
        expect_near((double)bench.blob.quadrics[0].radius, 1, 0);
        free(v3);
        free(text);
    }
    bench_close(&bench);
}

/* pbrt-v3 reads as much of a word as is a number. */
static void commas_behind_numbers_are_v3s(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_forgiven(&bench, V3("LookAt 0, 0, -4 0 0 0 0 1 0\nCamera \"perspective\"\nWorldBegin " SPHERE),
                    "1:8: '0,' is read as 0, as by pbrt-v3, and others in this line likewise");
    assert_int_equal(bench.warning_count, 2); /* one of two commas, and no light */
    expect_vec3(xform_point(&bench.blob.scene->world_from_camera, vec3(0, 0, 0)), 0, 0, -4);
    expect_forgiven(&bench, V3("WorldBegin\nMaterial \"matte\" \"rgb Kd\" [.1, .2, .3]\n" SPHERE),
                    "2:28: '.1,' is read as .1");
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0.1, 0.2, 0.3);
    expect_refused(&bench, V3("Scale 2,2,2\nWorldBegin " SPHERE), "2:1: Scale takes 3 numbers"); /* has one */
    expect_refused(&bench, V3("Scale 2 2 , 2\nWorldBegin " SPHERE), "1:11: Scale takes 3 numbers");
    expect_refused(&bench, "Scale 2, 2, 2\nWorldBegin " SPHERE, "1:7: Scale takes 3 numbers");
    bench_close(&bench);
}

/* ---- files --------------------------------------------------------------------------------------------- */

/* A file that ends within a directive goes on behind its Include: in either pbrt. */
static void parameters_go_on_behind_an_include(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char v3[] = "Material \"matte\" \"float sigma\" 30", v4[] = "Material \"dielectric\"";
    bench_write(&bench, "material.pbrt", v3, strlen(v3));
    bench_run_v3(&bench, "Include \"material.pbrt\" \"rgb Kd\" [.1 .2 .3] " SPHERE "LightSource \"point\"");
    bench_expect_silence(&bench);
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0.1, 0.2, 0.3);
    expect_vec3(colour_of(&bench, 0, VALUE_SIGMA), 30, 30, 30);
    bench_write(&bench, "material.pbrt", v4, strlen(v4));
    static const char list[] = "Include \"material.pbrt\" \"float eta\" [1";
    bench_write(&bench, "list.pbrt", list, strlen(list));
    bench_run(&bench, "WorldBegin Include \"list.pbrt\"\n.25] " SPHERE "LightSource \"point\"");
    expect_text(bench.result.message, "takes one value, found 2");
    bench_run(&bench, "WorldBegin Include \"list.pbrt\"\n] " SPHERE "LightSource \"point\"");
    bench_expect_silence(&bench);
    expect_vec3(colour_of(&bench, 0, VALUE_ETA), 1, 1, 1);
    /* what stands alone ends with its file */
    bench_run(&bench, "WorldBegin Import \"list.pbrt\"\n] " SPHERE);
    expect_text(bench.result.message, "this '[' has no ']'");
    bench_close(&bench);
}

/* As many as there are directives, while files that include one another again and again are bounded
 * (test_import_errors.c). */
static void a_long_scene_may_include_many_files(void **state)
{
    (void)state;
    enum { TIMES = 66000, LINE = 13 };
    bench_t bench = {0};
    char *text = mem_alloc(TIMES * LINE + 100), *end = text;
    end += sprintf(end, "WorldBegin\n");
    for (int i = 0; i < TIMES; ++i) end += sprintf(end, "Include\"e\"\n");
    bench_write(&bench, "e", "", 0);
    for (int v3 = 0; v3 < 2; ++v3) {
        sprintf(end, SPHERE "LightSource \"point\"\n%s", v3 ? "WorldEnd\n" : "");
        bench_run(&bench, text);
        bench_expect_silence(&bench);
        assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    }
    free(text);
    bench_close(&bench);
}

/* v3 does without; v4 does not, but a lenient import. */
static void missing_files_have_what_v3_puts_in_their_place(void **state)
{
    (void)state;
    static const struct {
        const char *v3, *v4, *warning;
    } cases[] = {
        {"Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"no.exr\" \"float scale\" 0.5\n"
         "Material \"matte\" \"texture Kd\" \"t\"\n",
         "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"no.exr\" \"float scale\" 0.5\n"
         "Material \"diffuse\" \"texture reflectance\" \"t\"\n",
         "it is grey, 0.5"},
        {"LightSource \"infinite\" \"string mapname\" \"no.exr\" \"rgb L\" [1 2 3]\n",
         "LightSource \"infinite\" \"string filename\" \"no.exr\"\n", "the light has no image"},
        {"Shape \"plymesh\" \"string filename\" \"no.ply\"\n",
         "Shape \"plymesh\" \"string filename\" \"no.ply\"\n", "the shape is left out"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *text = mem_printf("WorldBegin\n%s" SPHERE "WorldEnd\n", cases[i].v3);
        expect_forgiven(&bench, text, "2:");
        expect_text(bench.warnings, cases[i].warning);
        free(text);
        text = mem_printf("WorldBegin\n%s" SPHERE, cases[i].v4);
        expect_refused(&bench, text, "cannot be opened: No such file");
        bench.lenient = true;
        bench_run(&bench, text);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, cases[i].warning);
        assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
        bench.lenient = false;
        free(text);
    }
    bench_run_v3(&bench, cases[0].v3);
    expect_forgiven(&bench,
                    V3("WorldBegin\nTexture \"t\" \"float\" \"imagemap\" \"string filename\" \"n.png\"\n"
                       "Material \"matte\" \"texture sigma\" \"t\" \"spectrum Kd\" \"n.spd\"\n" SPHERE),
                    "2:");
    expect_text(bench.warnings,
                "n.spd: cannot be opened: No such file or directory; it is black, as by pbrt-v3");
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0, 0, 0);
    expect_vec3(colour_of(&bench, 0, VALUE_SIGMA), 0.214041, 0.214041, 0.214041); /* decoded */
    expect_forgiven(&bench, V3("WorldBegin\nMaterial \"glass\" \"spectrum eta\" \"n.spd\"\n" SPHERE), "2:");
    expect_text(bench.warnings, "the default is taken, as by pbrt-v3");
    expect_forgiven(&bench, V3("WorldBegin\nInclude \"no.pbrt\"\n" SPHERE), "2:1: ");
    expect_text(bench.warnings, "no.pbrt cannot be included: No such file or directory; it is left out");
    expect_refused(&bench, "WorldBegin\nInclude \"no.pbrt\"\n" SPHERE, "no.pbrt cannot be included");
    bench_close(&bench);
}

/* ---- textures ------------------------------------------------------------------------------------------ */

static const blob_texture_t *only_texture(const bench_t *bench)
{
    assert_int_equal(bench->blob.counts[BLOB_SECTION_TEXTURES], 1);
    return bench->blob.textures;
}

static void unknown_ways_to_look_an_image_up_are_the_usual_ones(void **state)
{
    (void)state;
#define IMAGE "WorldBegin\nTexture \"t\" \"float\" \"imagemap\" \"string filename\" \"t.pfm\"\n"
    static const char image[] = "Pf\n1 1\n-1\n\0\0\0";
    bench_t bench = {0};
    bench_write(&bench, "t.pfm", image, sizeof image);
    static const char mapping[] = IMAGE "\"string mapping\" \"cubic\"\n" SPHERE;
    for (int v3 = 0; v3 < 2; ++v3) {
        expect_forgiven_in(&bench, v3, mapping, "3:1: unknown mapping \"cubic\"; it is \"uv\", as by pbrt");
        assert_int_equal(only_texture(&bench)->mapping, MAPPING_UV);
        expect_near((double)only_texture(&bench)->matrix[0][0], 1, 0);
    }
    expect_forgiven(&bench, V3(IMAGE "\"string wrap\" \"mirror\"\n" SPHERE),
                    "3:1: unknown wrap \"mirror\"; repeat, clamp and black are known; it is \"repeat\"");
    assert_int_equal(only_texture(&bench)->wrap_s, WRAP_REPEAT);
    expect_refused(&bench, IMAGE "\"string wrap\" \"mirror\"\n" SPHERE, "3:1: unknown wrap \"mirror\"");
    expect_forgiven(&bench, IMAGE "\"string filter\" \"sharp\"\n" SPHERE,
                    "3:1: unknown filter \"sharp\"; it is that of other images, as by pbrt");
    assert_int_equal(only_texture(&bench)->flags & TEXTURE_NEAREST, 0);
    bench_close(&bench);
}

/* ---- meshes -------------------------------------------------------------------------------------------- */

#define MESH "WorldBegin\n" SPHERE "Shape \"trianglemesh\" "
#define CORNERS "\"point3 P\" [0 0 0 1 0 0 0 1 0] "

static void meshes_lose_what_does_not_fit(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const struct {
        const char *text, *warning;
    } left_out[] = {
        {MESH "\"point3 P\" [] \"integer indices\" [0 1 2]", "3:22: a triangle mesh needs vertices"},
        {MESH "\"point3 P\" [0 0 0]", "3:1: a mesh of more than three vertices needs"},
        {MESH CORNERS "\"integer indices\" [0 1 3]", "3:53: index number 2 is 3"}};
    for (size_t i = 0; i < ARRAY_LENGTH(left_out); ++i) {
        expect_refused(&bench, left_out[i].text, left_out[i].warning);
        char *v3 = mem_printf("%s\nWorldEnd\n", left_out[i].text);
        expect_forgiven(&bench, v3, left_out[i].warning);
        expect_text(bench.warnings, "; the shape is left out, as by pbrt-v3");
        assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
        free(v3);
    }
    expect_forgiven(&bench, MESH CORNERS "\"normal N\" [0 0 1]",
                    "3:53: 1 normals for 3 vertices; they are ignored, as by pbrt");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_NORMALS], 0);
    expect_forgiven(&bench, V3(MESH CORNERS "\"integer indices\" [0 1 2 0] \"point2 uv\" [0 0]"),
                    "3:81: 1 uv coordinates for 3 vertices; they are ignored, as by pbrt");
    expect_text(bench.warnings,
                "3:53: parameter \"indices\" takes groups of 3 numbers, but has 4; the rest is");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_TRIANGLES], 1);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_UVS], 0);
    bench_close(&bench);
}

static void a_curve_of_an_unknown_type_is_round(void **state)
{
    (void)state;
    bench_t bench = {0};
    for (int v3 = 0; v3 < 2; ++v3) {
        expect_forgiven_in(
            &bench, v3,
            "WorldBegin\nShape \"curve\" \"point3 P\" [0 0 0 1 0 0 1 1 0 0 1 0]\n"
            "\"string type\" \"tape\"",
            "3:1: a curve is of type \"flat\", \"ribbon\" or \"cylinder\", not \"tape\"; it is");
        assert_int_equal(bench.blob.curves[0].kind, CURVES_ROUND);
    }
    bench_close(&bench);
}

/* ---- names --------------------------------------------------------------------------------------------- */

static void undefined_names_have_what_v3_gives_them(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_forgiven(
        &bench, V3("WorldBegin\nMaterial \"matte\" \"rgb Kd\" [1 0 0]\nNamedMaterial \"x\"\n" SPHERE),
        "3:1: no MakeNamedMaterial \"x\" came before; the material stays what it was, as by pbrt-v3");
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 1, 0, 0);
    expect_forgiven(&bench, V3("WorldBegin\nMaterial \"wurst\" \"rgb Kd\" [0 1 0]\n" SPHERE),
                    "2:1: unknown material \"wurst\"; that is \"matte\", as by pbrt-v3");
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0, 1, 0);
    expect_forgiven(&bench,
                    V3("WorldBegin\nTexture \"t\" \"spectrum\" \"wurst\"\n"
                       "Material \"matte\" \"texture Kd\" \"t\"\n" SPHERE),
                    "2:1: unknown texture \"wurst\"; it is left out, as by pbrt-v3");
    expect_text(bench.warnings,
                "3:18: no spectrum Texture \"t\" has been defined before; the parameter has its "
                "default, as by pbrt-v3");
    expect_vec3(colour_of(&bench, 0, VALUE_REFLECTANCE), 0.5, 0.5, 0.5);
    expect_forgiven(&bench, V3("WorldBegin\nTexture \"t\" \"rgb\" \"constant\"\n" SPHERE),
                    "2:1: a Texture is of type \"float\" or \"spectrum\", not \"rgb\"; it is left out");
    expect_forgiven(&bench,
                    V3("WorldBegin\nMakeNamedMaterial \"a\" \"string type\" \"mirror\"\n"
                       "Material \"mix\" \"string namedmaterial1\" \"a\"\n" SPHERE),
                    "3:1: a mix needs \"string namedmaterial2\"; that is \"matte\"");
    expect_forgiven(&bench, V3("WorldBegin\nMakeNamedMaterial \"a\"\nNamedMaterial \"a\"\n" SPHERE),
                    "2:1: MakeNamedMaterial needs a parameter \"string type\"; that is an interface");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 0);
    bench_close(&bench);
}

static void unknown_kinds_are_left_out_in_v3(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_forgiven(&bench, V3("WorldBegin\nLightSource \"wurst\" \"float hot\" 3\n" SPHERE),
                    "2:1: unknown light \"wurst\"; it is left out, as by pbrt-v3");
    expect_forgiven(&bench, V3("WorldBegin\nAreaLightSource \"diffuse\"\nAreaLightSource \"wurst\"\n" SPHERE),
                    "3:1: unknown area light \"wurst\"; it is left out");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 0);
    expect_forgiven(&bench, V3("WorldBegin\nShape \"wurst\"\n" SPHERE),
                    "2:1: unknown shape \"wurst\"; it is");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    expect_forgiven(&bench, V3("WorldBegin\nObjectInstance \"x\"\n" SPHERE),
                    "2:1: no object \"x\" has been defined before; it is left out");
    bench_close(&bench);
}

static void a_coordinate_system_that_nobody_named_changes_nothing(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char warning[] = "3:1: no CoordinateSystem \"x\" has been named before; this is left out";
    static const char text[] = "WorldBegin\nTranslate 1 2 3\nCoordSysTransform \"x\"\n" SPHERE;
    for (int v3 = 0; v3 < 2; ++v3) {
        expect_forgiven_in(&bench, v3, text, warning);
        expect_vec3(centre_of(&bench, 0), 1, 2, 3);
    }
    bench_close(&bench);
}

/* ---- blocks and objects -------------------------------------------------------------------------------- */

static void an_object_is_redefined_in_v3(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char text[] = "WorldBegin\nObjectBegin \"a\"\n" SPHERE "ObjectEnd\nObjectInstance \"a\"\n"
                               "ObjectBegin \"a\" Shape \"disk\" ObjectEnd\nObjectInstance \"a\"\n";
    expect_refused(&bench, text, "6:1: the object \"a\" has been defined before, in line 2");
    char *v3 = mem_printf("%sWorldEnd\n", text);
    expect_forgiven(&bench, v3,
                    "6:1: the object \"a\" has been defined before, in line 2; it is replaced for");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 2);
    assert_int_not_equal(bench.blob.instances[0].object, bench.blob.instances[1].object);
    free(v3);
    bench_close(&bench);
}

static void blocks_end_as_in_v3(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_forgiven(
        &bench,
        V3("WorldBegin\nObjectBegin \"a\"\nTranslate 1 0 0\n" SPHERE "AttributeEnd\n" SPHERE
           "ObjectEnd\n" SPHERE "ObjectInstance \"a\"\n"),
        "5:1: AttributeEnd, but the innermost open block is the ObjectBegin of line 2; it is closed");
    expect_text(bench.warnings, "s.pbrt:7:1: ObjectEnd without ObjectBegin; it is left out, as by pbrt");
    assert_int_equal(bench.blob.objects[0].shape_count, 1); /* the world's, which is the last */
    assert_int_equal(bench.blob.objects[1].shape_count, 2);
    expect_vec3(centre_of(&bench, 0), 0, 0, 0);
    expect_forgiven(&bench, V3("WorldBegin\nAttributeBegin\nTranslate 1 0 0\n" SPHERE),
                    "6:1: WorldEnd, but the block of line 2 is still open; it ends here, as by pbrt-v3");
    /* AttributeEnd has the transform of the inner TransformBegin, TransformEnd that of the outer block. */
    expect_forgiven(&bench,
                    V3("WorldBegin\nAttributeBegin\nTranslate 1 0 0\nTransformBegin\nTranslate 1 0 0\n"
                       "AttributeEnd\n" SPHERE "TransformEnd\n" SPHERE),
                    "6:1: AttributeEnd, but the innermost open block is the TransformBegin of line 4");
    expect_vec3(centre_of(&bench, 0), 1, 0, 0);
    expect_vec3(centre_of(&bench, 1), 0, 0, 0);
    expect_forgiven(&bench,
                    V3("WorldBegin\nTransformBegin\nTranslate 1 0 0\nAttributeEnd\n" SPHERE "TransformEnd"),
                    "4:1: AttributeEnd without AttributeBegin; it is left out, as by pbrt");
    expect_vec3(centre_of(&bench, 0), 1, 0, 0);
    bench_close(&bench);
}

static void an_end_too_many_is_left_out_in_either(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char warning[] = "2:1: AttributeEnd without AttributeBegin; it is left out, as by pbrt";
    expect_forgiven(&bench, "WorldBegin\nAttributeEnd\n" SPHERE, warning);
    expect_forgiven(&bench, V3("WorldBegin\nAttributeEnd\n" SPHERE), warning);
    expect_refused(&bench, "WorldBegin\nObjectEnd\n" SPHERE, "2:1: ObjectEnd without ObjectBegin");
    expect_refused(&bench, "WorldBegin\nObjectBegin \"a\"\nAttributeEnd\n" SPHERE,
                   "3:1: AttributeEnd, but the innermost open block is the ObjectBegin of line 2");
    bench_close(&bench);
}

static void directives_in_the_wrong_place_are_left_out_in_v3(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_forgiven(&bench,
                    V3("Shape \"trianglemesh\" \"point P\" [0 0 0 1 0 0 0 1 0]\nWorldBegin\n"
                       "Film \"image\" \"integer xresolution\" [ 7 ]\n" SPHERE),
                    "1:1: Shape must come after WorldBegin; it is left out, as by pbrt-v3");
    expect_text(bench.warnings, "s.pbrt:3:1: Film must come before WorldBegin; it is left out");
    assert_int_equal(bench.blob.scene->width, 1280);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    expect_refused(&bench, "WorldBegin\nFilm \"rgb\"\n" SPHERE, "2:1: Film must come before WorldBegin");
    bench_close(&bench);
}

/* ---- transforms ---------------------------------------------------------------------------------------- */

#define FLAT "AttributeBegin\nScale 1 0 1\n"
#define SKEW "AttributeBegin\nConcatTransform [1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1]\n"

static void a_singular_transform_that_nothing_uses_does_no_harm(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char end[] = "LightSource \"infinite\" \"rgb L\" [1 2 3]\nAttributeEnd\n" SPHERE;
    static const struct {
        const char *begin, *warning;
    } cases[] = {
        {FLAT, "3:1: the current transform becomes singular or too large here; nothing must use it"},
        {SKEW, "3:1: ConcatTransform: not an affine transform"},
        {"AttributeBegin\nRotate 90 0 0 0\n", "3:1: the axis of this Rotate has no direction; nothing"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        for (int v3 = 0; v3 < 2; ++v3) {
            char *text = mem_printf("WorldBegin\n%s%s", cases[i].begin, end);
            expect_forgiven_in(&bench, v3, text, cases[i].warning);
            assert_int_equal(bench.warning_count, 1);
            assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 1);
            free(text);
            text = mem_printf("WorldBegin\n%s\nScale 2 2 2\n" SPHERE "%s", cases[i].begin,
                              v3 ? "WorldEnd\n" : "");
            expect_refused(&bench, text, ":6:1: the current transform is singular or not finite");
            free(text);
        }
    }
    expect_refused(&bench, "WorldBegin\n" FLAT "ObjectBegin \"a\" ObjectEnd\n" SPHERE,
                   "5:1: the current trans");
    expect_refused(
        &bench, V3("WorldBegin\n" FLAT "Texture \"t\" \"float\" \"dots\" \"string mapping\" \"spherical\""),
        "4:1: a number of a texture is infinite");
    expect_refused(&bench, V3("Scale 0 0 0\nCamera \"perspective\"\nWorldBegin\n" SPHERE),
                   "2:1: the current transform is singular or not finite");
    bench_close(&bench);
}

static void a_look_at_along_up_is_left_out_in_v3(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_forgiven(
        &bench, V3("LookAt 0 0 0 0 1 0 0 1 0\nTranslate 0 0 1\nCamera \"perspective\"\nWorldBegin\n" SPHERE),
        "1:1: this LookAt has no direction");
    expect_vec3(xform_point(&bench.blob.scene->world_from_camera, vec3(0, 0, 0)), 0, 0, -1);
    expect_refused(&bench, "LookAt 0 0 0 0 1 0 0 1 0\nWorldBegin " SPHERE,
                   "1:1: this LookAt has no direction");
    expect_refused(&bench, V3("LookAt 0 0 0 0 0 0 0 1 0\nWorldBegin " SPHERE), "1:1: this LookAt has no");
    bench_close(&bench);
}

/* ---- v4's index, and forks ------------------------------------------------------------------------------
 */

static void an_index_of_v4_may_be_a_colour(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char grey[] =
        "WorldBegin\nMaterial \"dielectric\" \"rgb eta\" [1.5 1.5 1.5]\n" SPHERE "LightSource \"point\"";
    bench_run(&bench, grey);
    bench_expect_silence(&bench);
    expect_near((double)colour_of(&bench, 0, VALUE_ETA).x, 1.5, 1e-6);
    bench_run(&bench, "WorldBegin\nMaterial \"coateddiffuse\" \"rgb eta\" [1 2 1]\n" SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "2:26: parameter \"eta\": there is no dispersion, 1.71");
    expect_near((double)colour_of(&bench, 0, VALUE_ETA).x, 1.7152, 1e-4);
    expect_refused(&bench, "WorldBegin\nMaterial \"dielectric\" \"rgb eta\" [0 0 0]\n" SPHERE,
                   "2:23: the index of refraction is 0, but must be positive");
    bench_run_v3(&bench, "Material \"glass\" \"rgb eta\" [2 2 2]\n" SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "2:18: parameter \"eta\" must be of type");
    expect_near((double)colour_of(&bench, 0, VALUE_ETA).x, 1.5, 1e-6);
    bench_close(&bench);
}

/* What no pbrt knows: a lenient import takes the nearest, or leaves it out. */
static void kinds_of_forks_become_the_nearest(void **state)
{
    (void)state;
    static const struct {
        const char *text, *warning;
    } cases[] = {
        {"Integrator \"guidedpath\" \"integer maxdepth\" 7 \"float share\" 1\nWorldBegin ",
         "1:1: unknown integrator \"guidedpath\"; the nearest is \"path\""},
        {"Film \"multi\" \"integer xresolution\" 9 \"bool aovs\" \"true\"\nWorldBegin ",
         "1:1: unknown film \"multi\"; the nearest is \""},
        {"Camera \"fisheye\" \"float fov\" 60\nWorldBegin ",
         "1:1: unknown camera \"fisheye\"; the nearest is"},
        {"Sampler \"bluenoise\" \"integer pixelsamples\" 3\nWorldBegin ",
         "1:1: unknown sampler \"bluenoise\"; the nearest is \"sobol\""},
        {"PixelFilter \"tent\"\nWorldBegin ", "1:1: unknown pixel filter \"tent\"; the nearest is"},
        {"WorldBegin\nLightSource \"sun\" \"float elevation\" 3\n",
         "2:1: unknown light \"sun\"; it is left out"},
        {"WorldBegin\nLightSource \"point\" \"float hot\" 3\n",
         "2:21: LightSource \"point\" has no parameter \"float hot\""},
        {"WorldBegin\nShape \"torus\"\n", "2:1: unknown shape \"torus\"; it is left out"},
        {"WorldBegin\nMaterial \"principled\" \"rgb reflectance\" [1 0 0]\n",
         "2:1: unknown material \"principled\"; the nearest is \"diffuse\""},
        {"WorldBegin\nTexture \"t\" \"float\" \"gabor\"\n",
         "2:1: unknown texture \"gabor\"; the nearest is a"},
        {"Option \"denoise\" true\nWorldBegin\n",
         "1:1: unknown Option \"denoise\"; the nearest is to do without it"},
    };
    enum { SETTINGS = 5 };
    bench_t bench = {0};
    for (size_t i = 0; i < 2 * ARRAY_LENGTH(cases); ++i) {
        const char *begin = cases[i / 2].text, *warning = cases[i / 2].warning;
        bool v3 = i % 2;
        if (v3 && i / 2 >= SETTINGS) continue; /* which it forgives, or does not have */
        char *text = mem_printf("%s" SPHERE "%s", begin, v3 ? "WorldEnd\n" : "");
        bench.lenient = false;
        expect_refused(&bench, text, warning);
        bench.lenient = true;
        bench_run(&bench, text);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, warning);
        free(text);
    }
    bench_close(&bench);
}

static void scenes_of_pbrt_2_are_read_as_v3s(void **state)
{
    (void)state;
    static const char text[] =
        "Renderer \"sampler\"\nSurfaceIntegrator \"photonmap\" \"integer maxdepth\" 7\n"
        "VolumeIntegrator \"emission\" \"float stepsize\" 1\nWorldBegin\n"
        "Volume \"homogeneous\" \"color sigma_a\" [1 1 1]\n"
        "Material \"matte\" \"color Kd\" [.1 .2 .3]\n" SPHERE "WorldEnd\n";
    bench_t bench = {0};
    expect_refused(&bench, text, "s.pbrt:1:1: \"sampler\" belongs to a directive of pbrt-v2");
    expect_refused(&bench, text + strlen("Renderer \"sampler\"\n"), "SurfaceIntegrator is pbrt-v2's");
    bench.lenient = true;
    bench_run(&bench, text);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->max_depth, 7);
    expect_near((double)colour_of(&bench, 0, VALUE_REFLECTANCE).y, 0.2, 1e-6);
    bench.lenient = false; /* what its samplers draw has the same mean */
    bench_run(&bench, V3("Sampler \"bestcandidate\" \"integer pixelsamples\" 9\nWorldBegin " SPHERE));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:1:1: sampler \"bestcandidate\"");
    assert_int_equal(bench.blob.scene->spp, 9);
    assert_int_equal(bench.blob.scene->sampler, SAMPLER_SOBOL);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_last_setting_of_each_kind_counts),
        cmocka_unit_test(what_is_wrong_with_a_dropped_setting_does_not_count),
        cmocka_unit_test(the_last_of_two_parameters_counts),
        cmocka_unit_test(v3_leaves_out_numbers_too_many),
        cmocka_unit_test(of_two_types_each_pbrt_takes_its_own),
        cmocka_unit_test(a_parameter_of_the_wrong_type_is_not_there_in_v3),
        cmocka_unit_test(a_parameter_of_several_values_is_not_the_one_of_v3),
        cmocka_unit_test(commas_behind_numbers_are_v3s),
        cmocka_unit_test(parameters_go_on_behind_an_include),
        cmocka_unit_test(a_long_scene_may_include_many_files),
        cmocka_unit_test(missing_files_have_what_v3_puts_in_their_place),
        cmocka_unit_test(unknown_ways_to_look_an_image_up_are_the_usual_ones),
        cmocka_unit_test(meshes_lose_what_does_not_fit),
        cmocka_unit_test(a_curve_of_an_unknown_type_is_round),
        cmocka_unit_test(undefined_names_have_what_v3_gives_them),
        cmocka_unit_test(unknown_kinds_are_left_out_in_v3),
        cmocka_unit_test(a_coordinate_system_that_nobody_named_changes_nothing),
        cmocka_unit_test(an_object_is_redefined_in_v3),
        cmocka_unit_test(blocks_end_as_in_v3),
        cmocka_unit_test(an_end_too_many_is_left_out_in_either),
        cmocka_unit_test(directives_in_the_wrong_place_are_left_out_in_v3),
        cmocka_unit_test(a_singular_transform_that_nothing_uses_does_no_harm),
        cmocka_unit_test(a_look_at_along_up_is_left_out_in_v3),
        cmocka_unit_test(an_index_of_v4_may_be_a_colour),
        cmocka_unit_test(kinds_of_forks_become_the_nearest),
        cmocka_unit_test(scenes_of_pbrt_2_are_read_as_v3s),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
