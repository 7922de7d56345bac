/* What the pbrt importer makes of participating media: their parameters, and which shapes, lights and cameras
 * have them, in both dialects. */
#include "tests/unit/client/import/test_import.h"

#define FOG "MakeNamedMedium \"fog\" \"string type\" \"homogeneous\"\n"
#define MILK "MakeNamedMedium \"milk\" \"string type\" \"homogeneous\" \"string preset\" \"Skimmilk\"\n"
#define STRANGE(name) "MakeNamedMedium \"" name "\" \"string type\" \"strange\"\n"
#define SPHERE "Shape \"sphere\"\n"
#define TRIANGLE "Shape \"trianglemesh\" \"point P\" [0 0 0 1 0 0 0 1 0] \"integer indices\" [0 1 2]\n"
#define POINT_LIGHT "LightSource \"point\"\n"

/* In v3 with an integrator that knows media. */
static void run(bench_t *bench, bool v4, const char *world)
{
    char *text = mem_printf(
        v4 ? "Film \"rgb\"\nWorldBegin\n%s\n" : "Integrator \"volpath\"\nWorldBegin\n%s\nWorldEnd\n", world);
    bench_run(bench, text);
    free(text);
}

static void run_quietly(bench_t *bench, bool v4, const char *world)
{
    run(bench, v4, world);
    bench_expect_silence(bench);
}

static void expect_error(bench_t *bench, bool v4, const char *world, const char *message)
{
    run(bench, v4, world);
    assert_int_equal(bench->result.code, RESULT_INPUT);
    expect_text(bench->result.message, message);
}

static const blob_medium_t *medium(const bench_t *bench, uint64_t index)
{
    assert_true(index < count_of(bench, BLOB_SECTION_MEDIA));
    return &bench->blob.media[index];
}

static const blob_field_t *density_of(const bench_t *bench, const blob_medium_t *m)
{
    assert_true(m->density > 0 && m->density <= count_of(bench, BLOB_SECTION_FIELDS));
    return &bench->blob.fields[m->density - 1];
}

static const blob_shape_t *shape(const bench_t *bench, uint64_t index)
{
    assert_true(index < count_of(bench, BLOB_SECTION_SHAPES));
    return &bench->blob.shapes[index];
}

static const blob_light_t *light(const bench_t *bench, uint64_t index)
{
    assert_true(index < count_of(bench, BLOB_SECTION_LIGHTS));
    return &bench->blob.lights[index];
}

static void expect_media(const blob_shape_t *s, blob_ref_t inside, blob_ref_t outside)
{
    assert_int_equal(s->media[0], inside);
    assert_int_equal(s->media[1], outside);
    assert_int_equal((s->flags & SHAPE_INTERFACE) != 0, inside != outside);
}

/* ---- what they are made of ----------------------------------------------------------------------------- */

static void a_medium_has_its_coefficients(void **state)
{
    (void)state;
    for (int v4 = 0; v4 < 2; ++v4) {
        bench_t bench = {0};
        run_quietly(&bench, v4,
                    POINT_LIGHT
                    "Scale 3 3 3\nMakeNamedMedium \"a\" \"string type\" \"homogeneous\" \"rgb sigma_a\" "
                    "[1 2 3] \"rgb sigma_s\" [4 5 6] \"float scale\" 2 \"float g\" -0.5\n");
        const blob_medium_t *m = medium(&bench, 0);
        assert_int_equal(count_of(&bench, BLOB_SECTION_MEDIA), 1);
        expect_vec3(m->absorption, 2, 4, 6);
        expect_vec3(m->scattering, 8, 10, 12);
        expect_vec3(m->emission, 0, 0, 0);
        expect_near((double)m->g, -0.5, 0);
        assert_string_equal(bench.blob.strings + m->name, "a");
        assert_int_equal(m->density, 0);
        bench_close(&bench);
    }
}

/* pbrt-v3's are those of milk; pbrt-v4's code has 1. */
static void coefficients_have_the_defaults_of_the_dialect(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, false, POINT_LIGHT FOG);
    expect_vec3(medium(&bench, 0)->absorption, 0.0011, 0.0024, 0.014);
    expect_vec3(medium(&bench, 0)->scattering, 2.55, 3.21, 3.77);
    expect_near((double)medium(&bench, 0)->g, 0, 0);
    run_quietly(&bench, true, POINT_LIGHT FOG);
    expect_vec3(medium(&bench, 0)->absorption, 1, 1, 1);
    expect_vec3(medium(&bench, 0)->scattering, 1, 1, 1);
    bench_close(&bench);
}

static void presets_are_known_by_name(void **state)
{
    (void)state;
#define PRESET(name) "MakeNamedMedium \"a\" \"string type\" \"homogeneous\" \"string preset\" \"" name "\" "
    bench_t bench = {0};
    run_quietly(&bench, false, POINT_LIGHT PRESET("Espresso") "\"float scale\" 10 \"rgb sigma_a\" [1 0 0]\n");
    expect_vec3(medium(&bench, 0)->absorption, 10, 0, 0);
    expect_vec3(medium(&bench, 0)->scattering, 7.2378, 8.4557, 10.247);
    run_quietly(&bench, true, POINT_LIGHT PRESET("Skin1") "\"float g\" 0.9\n");
    expect_vec3(medium(&bench, 0)->absorption, 0.032, 0.17, 0.48);
    expect_vec3(medium(&bench, 0)->scattering, 0.74, 0.88, 1.01);
    expect_error(&bench, true, POINT_LIGHT PRESET("Skin1") "\"rgb sigma_a\" [1 0 0]\n",
                 "s.pbrt:4:73: MakeNamedMedium \"a\" has no parameter \"rgb sigma_a\"");
    run(&bench, false, POINT_LIGHT PRESET("Wurst"));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:4:49: no preset is called \"Wurst\"; it is ignored, as by pbrt");
    expect_vec3(medium(&bench, 0)->scattering, 2.55, 3.21, 3.77);
    run(&bench, true, POINT_LIGHT PRESET("Wurst") "\"rgb sigma_s\" [2 3 4]\n");
    bench_expect_ok(&bench);
    expect_vec3(medium(&bench, 0)->scattering, 2, 3, 4);
    bench_close(&bench);
#undef PRESET
}

/* The grid's box is of the current transform's space. */
static void a_grid_has_its_densities_and_its_place(void **state)
{
    (void)state;
    for (int v4 = 0; v4 < 2; ++v4) {
        bench_t bench = {0};
        char *text = mem_printf(
            POINT_LIGHT
            "Translate 10 0 0 Scale 2 2 2\nMakeNamedMedium \"a\" \"string type\" \"%s\" \"integer nx\" 3 "
            "\"integer ny\" 2 \"integer nz\" 1 \"float density\" [0 1 2 3 4 5.5] \"point3 p0\" [-1 0 1] "
            "\"point3 p1\" [2 1 3] \"rgb sigma_a\" [1 2 3] \"rgb sigma_s\" [6 5 4] \"float scale\" 2 "
            "\"float g\" 0.25\n",
            v4 ? "uniformgrid" : "heterogeneous");
        run_quietly(&bench, v4, text);
        const blob_medium_t *m = medium(&bench, 0);
        const blob_field_t *f = density_of(&bench, m);
        assert_true(f->kind == FIELD_CELLS && f->cells[0] == 3 && f->cells[1] == 2 && f->cells[2] == 1);
        for (int i = 0; i < 6; ++i) expect_near((double)bench.blob.numbers[f->first + i], i < 5 ? i : 5.5, 0);
        expect_vec3(xform_point(&f->world_from_field, vec3(0, 0, 0)), 8, 0, 2);
        expect_vec3(xform_point(&f->world_from_field, vec3(1, 1, 1)), 14, 2, 6);
        expect_vec3(m->absorption, 2, 4, 6);
        expect_vec3(m->scattering, 12, 10, 8);
        expect_near((double)m->g, 0.25, 0);
        free(text);
        bench_close(&bench);
    }
}

static void pbrt_v3s_grids_are_grey(void **state)
{
    (void)state;
#define GRID                                                                                                 \
    POINT_LIGHT                                                                                              \
    "MakeNamedMedium \"a\" \"string type\" \"heterogeneous\" \"float density\" 7 \"rgb sigma_a\" "           \
    "[.6 .7 .9] "
    bench_t bench = {0};
    run_quietly(&bench, false, GRID "\"rgb sigma_s\" [2.4 2.3 2.1]\n");
    run(&bench, false, GRID "\"rgb sigma_s\" [2.4 2.3 2.2]\n");
    bench_expect_ok(&bench);
    expect_text(bench.warnings,
                "s.pbrt:4:1: sigma_a + sigma_s differs between colours: pbrt-v3 takes that of red");
    expect_vec3(medium(&bench, 0)->scattering, 2.4, 2.3, 2.2);
#undef GRID
    bench_close(&bench);
}

static void a_grid_fills_the_unit_cube_if_nothing_is_said(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false,
        POINT_LIGHT "MakeNamedMedium \"a\" \"string type\" \"heterogeneous\" \"float density\" 7\n");
    bench_expect_ok(&bench);
    const blob_medium_t *m = medium(&bench, 0);
    const blob_field_t *f = density_of(&bench, m);
    assert_true(f->cells[0] == 1 && f->cells[1] == 1 && f->cells[2] == 1);
    expect_vec3(xform_point(&f->world_from_field, vec3(1, 1, 1)), 1, 1, 1);
    expect_vec3(m->scattering, 2.55, 3.21, 3.77);
    run_quietly(&bench, true,
                POINT_LIGHT "MakeNamedMedium \"a\" \"string type\" \"uniformgrid\" \"float density\" 7\n");
    expect_vec3(medium(&bench, 0)->absorption, 1, 1, 1);
    bench_close(&bench);
}

/* In v4 what absorbs emits: Le times sigma_a. The film's exposure counts, as for lights. */
static void media_glow(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "Film \"rgb\" \"float iso\" 200\nWorldBegin\nMakeNamedMedium \"a\" \"string type\" "
                      "\"homogeneous\" \"rgb sigma_a\" [1 2 3] \"rgb Le\" [5 6 7] \"float Lescale\" 3 "
                      "\"float scale\" 10\n");
    bench_expect_silence(&bench); /* it is the scene's light */
    expect_vec3(medium(&bench, 0)->emission, 2 * 150, 2 * 360, 2 * 630);
#define GRID                                                                                                 \
    "MakeNamedMedium \"a\" \"string type\" \"uniformgrid\" \"integer nx\" 2 \"float density\" [1 2] "        \
    "\"rgb sigma_a\" [1 2 3] \"rgb Le\" [5 6 7] "
    run_quietly(&bench, true, GRID);
    expect_vec3(medium(&bench, 0)->emission, 5, 12, 21);
#undef GRID
    bench_close(&bench);
}

static void attributes_are_defaults_of_media(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, true,
                POINT_LIGHT
                "AttributeBegin\nAttribute \"medium\" \"float g\" 0.5 \"rgb sigma_s\" [1 2 3]\n" FOG
                "AttributeEnd\n" MILK);
    expect_near((double)medium(&bench, 0)->g, 0.5, 0);
    expect_vec3(medium(&bench, 0)->scattering, 1, 2, 3);
    expect_near((double)medium(&bench, 1)->g, 0, 0);
    bench_close(&bench);
}

static void media_that_make_no_sense_are_errors(void **state)
{
    (void)state;
#define GRID "MakeNamedMedium \"a\" \"string type\" \"heterogeneous\" \"integer nx\" 2 \"integer ny\" 3 "
    static const struct {
        const char *text, *message;
    } cases[] = {
        {GRID "\"float density\" [1 2 3 4 5]",
         "s.pbrt:3:81: 5 densities for a grid of nx x ny x nz = 2 x 3 x 1 cells; give 6"},
        {GRID, "s.pbrt:3:1: 0 densities for a grid of nx x ny x nz = 2 x 3 x 1 cells; give 6"},
        {GRID "\"integer nz\" 0",
         "s.pbrt:3:81: parameter \"nz\" is 0, but must be an integer from 1 to 4096"},
        {GRID "\"float density\" [1 2 -3 4 5 6]", "s.pbrt:3:81: density number 2 is -3, but must be from 0"},
        {GRID "\"float density\" [1 2 3 4 5 2e9]", "s.pbrt:3:81: density number 5 is 2e+09, but must be"},
        {GRID "\"float density\" [1 2 3 4 5 6] \"point p1\" [1 0 1]",
         "s.pbrt:3:1: the box of this medium's grid, from p0 to p1"},
        {FOG "MakeNamedMedium \"b\" \"string type\" \"homogeneous\" \"float g\" 1",
         "s.pbrt:4:49: g is 1, but must be over -1 and below 1"},
        {"MakeNamedMedium \"b\" \"string type\" \"homogeneous\" \"float g\" -1",
         "3:49: g is -1, but must be"},
        {"MakeNamedMedium \"b\" \"string type\" \"homogeneous\" \"rgb sigma_s\" [1 2 -3]",
         "3:49: parameter \"sigma_s\" must be a colour without negative components"},
        {"MakeNamedMedium \"b\" \"string type\" \"homogeneous\" \"float scale\" -1",
         "3:49: parameter \"scale\" is -1, but must be from 0"},
        {"MakeNamedMedium \"b\" \"string type\" \"homogeneous\" \"float scale\" 1e9",
         "3:1: sigma_a and sigma_s, times the scale, must be from 0 to 1e+09"},
        {"MakeNamedMedium \"\" \"string type\" \"homogeneous\"", "3:1: the medium's name is empty"},
        {"MakeNamedMedium \"b\" \"string type\" \"uniformgrid\"", "\"uniformgrid\" is pbrt-v4's"},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_t bench = {0};
        expect_error(&bench, false, cases[i].text, cases[i].message);
        bench_close(&bench);
    }
#undef GRID
}

/* Light from infinity gets through fog only where this ends. */
static void fog_without_an_end_is_told(void **state)
{
    (void)state;
    static const struct {
        const char *light, *outside, *more;
        bool told;
    } cases[] = {
        {"distant", "a", "", true},
        {"infinite", "a", "", true},
        {"point", "a", "", false},
        {"distant", "", "", false},
        {"distant", "a", "MediumInterface \"a\" \"\"\nMaterial \"interface\"\n" SPHERE, false},
        {"distant", "a",
         "MakeNamedMedium \"b\" \"string type\" \"homogeneous\"\nMediumInterface \"b\" \"a\"\n"
         "Material \"interface\"\n" SPHERE,
         true}, /* a cloud in it is no end */
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_t bench = {0};
        char *text =
            mem_printf("MakeNamedMedium \"a\" \"string type\" \"homogeneous\"\n"
                       "MediumInterface \"\" \"%s\"\nCamera \"perspective\"\nFilm \"rgb\"\nWorldBegin\n"
                       "LightSource \"%s\"\n" SPHERE "%s",
                       cases[i].outside, cases[i].light, cases[i].more);
        bench_run(&bench, text);
        bench_expect_ok(&bench);
        assert_true((strstr(bench.warnings, "a medium without an end") != NULL) == cases[i].told);
        free(text);
        bench_close(&bench);
    }
}

/* A grid about the camera without an interface gets one of its own, so that light from infinity enters it. It
 * does not touch what stands on the faces of the box. */
static void a_grid_about_the_camera_ends(void **state)
{
    (void)state;
    static const struct {
        const char *more;
        uint32_t shapes;
    } cases[] = {{"", 2}, {"MediumInterface \"a\" \"\"\nMaterial \"interface\"\n" SPHERE, 2}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_t bench = {0};
        char *text =
            mem_printf("Scale -1 1 1\nMakeNamedMedium \"a\" \"string type\" \"uniformgrid\"\n"
                       "\"integer nx\" 1 \"integer ny\" 1 \"integer nz\" 1 \"float density\" 1\n"
                       "\"point3 p0\" [ 1 1 1 ] \"point3 p1\" [ 3 4 5 ]\n"
                       "MediumInterface \"\" \"a\"\nCamera \"perspective\"\nFilm \"rgb\"\nWorldBegin\n"
                       "LightSource \"infinite\"\n" SPHERE "%s",
                       cases[i].more);
        bench_run(&bench, text);
        bench_expect_ok(&bench);
        bench_expect_silence(&bench);
        assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], cases[i].shapes);
        const blob_shape_t *shape = &bench.blob.shapes[1];
        assert_true(shape->flags & SHAPE_INTERFACE);
        assert_true(shape->media[0] == bench.blob.scene->medium && shape->media[1] == 0);
        if (shape->kind == SHAPE_MESH) {
            const blob_mesh_t *mesh = &bench.blob.meshes[shape->geometry];
            const blob_triangle_t *triangle = &bench.blob.triangles[mesh->first_triangle];
            const vec3_t *positions = &bench.blob.positions[mesh->first_position];
            assert_int_equal(mesh->triangle_count, 12);
            for (size_t k = 0; k < 12; ++k) {
                vec3_t a = positions[triangle[k].v[0]], b = positions[triangle[k].v[1]],
                       c = positions[triangle[k].v[2]], middle = vec3(-2, 2.5f, 3);
                vec3_t n = v_cross(v_sub(b, a), v_sub(c, a));
                if (shape->flags & SHAPE_FLIP) n = v_neg(n);
                assert_true(v_dot(n, v_sub(a, middle)) > 0);
                assert_true(fabsf(a.x + 2) > 1 && fabsf(a.y - 2.5f) > 1.5f && fabsf(a.z - 3) > 2);
                assert_true(fabsf(a.x + 2) < 1.01f && fabsf(a.y - 2.5f) < 1.51f && fabsf(a.z - 3) < 2.01f);
            }
        }
        free(text);
        bench_close(&bench);
    }
}

static void emission_must_be_finite(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_error(
        &bench, true,
        "MakeNamedMedium \"b\" \"string type\" \"homogeneous\" \"rgb Le\" [1 1 1] \"float Lescale\" 1e20",
        "s.pbrt:3:49: Le, times sigma_a, must be from 0 to 1e+09");
    expect_error(&bench, true, "MakeNamedMedium \"b\" \"string type\" \"heterogeneous\"",
                 "\"heterogeneous\" is pbrt-v3's");
    bench_close(&bench);
}

/* ---- names --------------------------------------------------------------------------------------------- */

static void a_type_that_is_not_supported_is_an_error_where_it_is_used(void **state)
{
    (void)state;
    static const char *const types[] = {"strange", "vdb"};
    for (size_t i = 0; i < ARRAY_LENGTH(types); ++i) {
        bench_t bench = {0};
        char *text = mem_printf(POINT_LIGHT "MakeNamedMedium \"a\" \"string type\" \"%s\"\n", types[i]);
        char *used = mem_printf("%sMediumInterface \"a\" \"\"\n" SPHERE SPHERE, text);
        char *message = mem_printf(
            "s.pbrt:4:1: medium \"a\": the type \"%s\" is not supported; the nearest is empty space",
            types[i]);
        run(&bench, true, text);
        bench_expect_ok(&bench);
        assert_int_equal(bench.warning_count, 1);
        expect_text(bench.warnings, "s.pbrt:4:1: medium \"a\" is ignored");
        expect_error(&bench, true, used, message);
        bench.lenient = true;
        run(&bench, true, used);
        bench_expect_ok(&bench);
        assert_int_equal(bench.warning_count, 2);
        expect_text(bench.warnings, message);
        expect_media(shape(&bench, 0), 0, 0);
        free(text);
        free(used);
        free(message);
        bench_close(&bench);
    }
}

static void pbrt_v3_forgets_what_is_not_made(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false, POINT_LIGHT "MediumInterface \"a\" \"\"\n" SPHERE SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings,
                "s.pbrt:4:1: there is no MakeNamedMedium \"a\"; that is empty space, as by pbrt-v3");
    expect_media(shape(&bench, 0), 0, 0);
    run(&bench, false, POINT_LIGHT "MakeNamedMedium \"a\"\n" SPHERE);
    bench_expect_ok(&bench);
    expect_text(bench.warnings,
                "s.pbrt:4:1: MakeNamedMedium needs a parameter \"string type\"; it is left out");
    bench.strict = true;
    expect_error(&bench, false, "MediumInterface \"a\"\n" SPHERE, "3:1: there is no MakeNamedMedium \"a\"");
    expect_error(&bench, true, "MediumInterface \"a\"\n" SPHERE, "3:1: there is no MakeNamedMedium \"a\"");
    expect_error(&bench, true, "MakeNamedMedium \"a\"\n", "3:1: MakeNamedMedium needs a parameter");
    bench_close(&bench);
}

/* A name's meaning is that of the moment when a shape has it. */
static void pbrt_v3_may_make_a_medium_again(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false, POINT_LIGHT "MediumInterface \"fog\" \"\"\n" FOG SPHERE FOG SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "s.pbrt:7:1: the medium \"fog\" of line 5 is replaced");
    expect_media(shape(&bench, 0), 1, 0);
    expect_media(shape(&bench, 1), 2, 0);
    expect_error(&bench, true, FOG FOG, "s.pbrt:4:1: the medium \"fog\" has been made before, in line 3");
    run(&bench, false, POINT_LIGHT FOG "MediumInterface \"fog\" \"\"\n" STRANGE("fog") SPHERE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings,
                "s.pbrt:6:1: unknown type of medium \"strange\"; it is left out, as by pbrt-v3");
    expect_media(shape(&bench, 0), 1, 0);
    bench_close(&bench);
}

static void pbrt_v4_may_make_a_medium_later(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, true,
                "MediumInterface \"fog\" \"milk\"\n" POINT_LIGHT SPHERE "ObjectBegin \"o\"\n" SPHERE
                "ObjectEnd\nObjectInstance \"o\"\n" MILK FOG);
    expect_media(shape(&bench, 0), 2, 1);
    expect_media(shape(&bench, 1), 2, 1);
    assert_int_equal(light(&bench, 0)->medium, 1);
    bench.lenient = true;
    run(&bench, true, "MediumInterface \"a\" \"\"\n" POINT_LIGHT SPHERE STRANGE("a"));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:6:1: medium \"a\": the type \"strange\" is not supported");
    assert_int_equal(shape(&bench, 0)->media[0], 0);
    bench_close(&bench);
}

/* ---- where they are ------------------------------------------------------------------------------------ */

static void a_shape_parts_what_differs(void **state)
{
    (void)state;
    for (int v4 = 0; v4 < 2; ++v4) {
        bench_t bench = {0};
        run_quietly(&bench, v4,
                    FOG MILK POINT_LIGHT SPHERE
                    "MediumInterface \"fog\" \"\"\n" SPHERE TRIANGLE "MediumInterface \"fog\"\n" SPHERE
                    "AttributeBegin\nMediumInterface \"milk\" \"fog\"\n" SPHERE "AttributeEnd\n" SPHERE
                    "MediumInterface \"\" \"milk\"\n" SPHERE
                    "Shape \"curve\" \"string type\" \"cylinder\" \"point P\" [0 0 0 1 0 0 2 0 0 3 0 "
                    "0]\nMediumInterface \"\"\n");
        expect_media(shape(&bench, 0), 0, 0);
        expect_media(shape(&bench, 1), 1, 0);
        expect_media(shape(&bench, 2), 1, 0);
        expect_media(shape(&bench, 3), 0, 0); /* a single name is both sides */
        expect_media(shape(&bench, 4), 2, 1);
        expect_media(shape(&bench, 5), 0, 0); /* restored */
        expect_media(shape(&bench, 6), 0, 2);
        expect_media(shape(&bench, 7), 0, 0); /* a curve has no inside */
        bench_close(&bench);
    }
}

/* v3's TransformBegin saves the transform alone, v4's all of the state. */
static void transform_begin_saves_media_in_v4(void **state)
{
    (void)state;
    for (int v4 = 0; v4 < 2; ++v4) {
        bench_t bench = {0};
        run_quietly(&bench, v4,
                    FOG POINT_LIGHT "TransformBegin\nMediumInterface \"fog\" \"\"\nTransformEnd\n" SPHERE);
        expect_media(shape(&bench, 0), v4 ? 0 : 1, 0);
        bench_close(&bench);
    }
}

/* The side on which the normal of a ray's hit points in pbrt is outside: the normal is turned by
 * ReverseOrientation and by a mirroring transform, and SHAPE_FLIP says when. So media never change places,
 * but with a mirrored quadric that emits, whose SHAPE_FLIP is that of its light. */
static void media_keep_to_the_sides_of_the_normal(void **state)
{
    (void)state;
    bench_t bench = {0};
#define TURNED(shape)                                                                                        \
    shape "ReverseOrientation\n" shape "Scale -1 1 1\n" shape "ReverseOrientation\n" shape "Scale -1 1 1\n"
    run_quietly(&bench, false,
                FOG POINT_LIGHT "MediumInterface \"fog\" \"\"\n" TURNED(TRIANGLE) TURNED(SPHERE));
    for (uint64_t i = 0; i < 8; ++i) {
        expect_media(shape(&bench, i), 1, 0);
        assert_int_equal(shape(&bench, i)->flags & SHAPE_FLIP, i % 2 == 1 ? SHAPE_FLIP : 0);
    }
    run_quietly(&bench, false,
                FOG "AreaLightSource \"diffuse\"\nMediumInterface \"fog\" \"\"\n" TURNED(SPHERE));
    for (uint64_t i = 0; i < 4; ++i) {
        bool mirrored = i >= 2;
        expect_media(shape(&bench, i), mirrored ? 0 : 1, mirrored ? 1 : 0);
        assert_int_equal(shape(&bench, i)->flags & SHAPE_FLIP, i == 1 || i == 2 ? SHAPE_FLIP : 0);
    }
#define CONE "Shape \"cone\"\n"
    run_quietly(&bench, false,
                FOG "AreaLightSource \"diffuse\"\nMediumInterface \"fog\" \"\"\n" TURNED(CONE));
    expect_media(shape(&bench, 1), 1, 0);
    expect_media(shape(&bench, 2), 0, 1);
#undef CONE
#undef TURNED
    bench_close(&bench);
}

static void lights_shine_into_the_medium_outside(void **state)
{
    (void)state;
    for (int v4 = 0; v4 < 2; ++v4) {
        bench_t bench = {0};
        run_quietly(&bench, v4,
                    FOG MILK "MediumInterface \"milk\" \"fog\"\n" POINT_LIGHT
                             "LightSource \"spot\"\nLightSource \"distant\"\nLightSource \"infinite\"\n"
                             "AreaLightSource \"diffuse\"\n" SPHERE "MediumInterface \"fog\"\n" SPHERE
                             "MediumInterface \"fog\" \"\"\n" POINT_LIGHT);
        static const uint32_t expected[] = {1, 1, 0, 0, 0, 1, 0};
        for (uint64_t i = 0; i < ARRAY_LENGTH(expected); ++i)
            assert_int_equal(light(&bench, i)->medium, expected[i]);
        expect_media(shape(&bench, 0), 2, 1);
        bench_close(&bench);
    }
}

static void lights_with_images_do_so_too(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false,
        FOG "MediumInterface \"\" \"fog\"\nLightSource \"goniometric\"\nLightSource \"projection\"\n");
    bench_expect_ok(&bench);
    assert_int_equal(light(&bench, 0)->medium, 1);
    assert_int_equal(light(&bench, 1)->medium, 1);
    bench_close(&bench);
}

/* That of the interface at Camera, wherever the camera's transform is. */
static void the_camera_stands_outside(void **state)
{
    (void)state;
    for (int v4 = 0; v4 < 2; ++v4) {
        bench_t bench = {0};
        char *text =
            mem_printf("%s" FOG MILK "MediumInterface \"milk\" \"fog\"\nCamera \"perspective\"\n"
                       "WorldBegin\n" POINT_LIGHT "AttributeBegin MediumInterface \"\" \"\" AttributeEnd\n%s",
                       v4 ? "Film \"rgb\"\n" : "Integrator \"volpath\"\n", v4 ? "" : "WorldEnd\n");
        bench_run(&bench, text);
        bench_expect_silence(&bench);
        assert_int_equal(bench.blob.scene->medium, 1);
        free(text);
        bench_close(&bench);
    }
    bench_t bench = {0};
    bench_run(&bench, "Camera \"perspective\"\nFilm \"rgb\"\nWorldBegin\n" POINT_LIGHT FOG
                      "MediumInterface \"\" \"fog\"\n" SPHERE);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.scene->medium, 0);
    bench_close(&bench);
}

static void the_camera_may_come_before_its_medium(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(
        &bench,
        "Film \"rgb\"\nMediumInterface \"fog\"\nCamera \"perspective\"\nWorldBegin\n" POINT_LIGHT MILK FOG);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.scene->medium, 2);
    bench_run(&bench,
              "Film \"rgb\"\nMediumInterface \"fog\"\nCamera \"perspective\"\nWorldBegin\n" POINT_LIGHT);
    expect_text(bench.result.message, "s.pbrt:2:1: there is no MakeNamedMedium \"fog\"");
    bench_close(&bench);
}

static void pbrt_v3_may_put_the_camera_elsewhere(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "Integrator \"volpath\"\n" FOG "MediumInterface \"\" \"fog\"\nCamera \"perspective\"\n"
                      "WorldBegin\nMediumInterface \"\" \"\"\n" POINT_LIGHT "WorldEnd\n");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->medium, 1);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings,
                "s.pbrt:4:1: the camera stands in the medium outside of the MediumInterface at "
                "Camera; pbrt-v3 puts it into that at WorldEnd");
    bench_close(&bench);
}

/* They move with their instance, while the grid stands in the world. */
static void shapes_of_objects_have_media(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, false,
                FOG POINT_LIGHT
                "MediumInterface \"fog\" \"\"\nObjectBegin \"o\"\nMaterial \"\"\n" SPHERE TRIANGLE
                "ObjectEnd\nObjectInstance \"o\"\n");
    assert_int_equal(count_of(&bench, BLOB_SECTION_SHAPES), 2);
    expect_media(shape(&bench, 0), 1, 0);
    expect_media(shape(&bench, 1), 1, 0);
    assert_int_equal(bench.blob.materials[shape(&bench, 0)->material].kind, MATERIAL_INTERFACE);
    bench_close(&bench);
}

/* ---- interfaces ---------------------------------------------------------------------------------------- */

static uint32_t kind_of(const bench_t *bench, uint64_t index)
{
    return bench->blob.materials[shape(bench, index)->material].kind;
}

static void an_interface_stays_where_it_parts_media(void **state)
{
    (void)state;
    static const char *const materials[] = {"Material \"\"\n", "Material \"none\"\n",
                                            "Material \"interface\"\n"};
    for (int i = 0; i < 3; ++i) {
        bench_t bench = {0};
        bool v4 = i == 2;
        char *text = mem_printf(FOG POINT_LIGHT "%s" SPHERE "MediumInterface \"fog\"\n" SPHERE
                                                "MediumInterface \"\" \"fog\"\n" SPHERE TRIANGLE
                                                "Shape \"curve\" \"point P\" [0 0 0 1 0 0 2 0 0 3 0 0]\n",
                                materials[i]);
        run(&bench, v4, text);
        bench_expect_ok(&bench);
        assert_int_equal(count_of(&bench, BLOB_SECTION_SHAPES), 2);
        assert_int_equal(count_of(&bench, BLOB_SECTION_MATERIALS), 1); /* shared */
        for (uint64_t k = 0; k < 2; ++k) {
            expect_media(shape(&bench, k), 0, 1);
            assert_int_equal(kind_of(&bench, k), MATERIAL_INTERFACE);
            assert_int_equal(shape(&bench, k)->light, BLOB_NONE);
        }
        free(text);
        bench_close(&bench);
    }
}

static void an_interface_keeps_its_alpha(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_quietly(&bench, true,
                FOG POINT_LIGHT
                "Material \"interface\" MediumInterface \"fog\" \"\"\nShape \"sphere\" \"float "
                "alpha\" 0.5\n");
    expect_near((double)shape(&bench, 0)->alpha.factor.x, 0.5, 0);
    assert_int_equal(kind_of(&bench, 0), MATERIAL_INTERFACE);
    bench_close(&bench);
}

/* As without media: a black surface in v3, which is no other shape's; no light in v4. */
static void an_interface_that_emits_is_what_it_was(void **state)
{
    (void)state;
#define EMITS                                                                                                \
    "MediumInterface \"fog\" \"\"\nAttributeBegin\nAreaLightSource \"diffuse\"\n" SPHERE SPHERE              \
    "AttributeEnd\n" SPHERE
    bench_t bench = {0};
    run(&bench, false, FOG "Material \"none\"\n" EMITS);
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1);
    expect_text(bench.warnings, "s.pbrt:4:1: an interface that emits light is a black surface");
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 2);
    assert_int_equal(count_of(&bench, BLOB_SECTION_MATERIALS), 2);
    for (uint64_t i = 0; i < 3; ++i) {
        expect_media(shape(&bench, i), 1, 0);
        assert_int_equal(kind_of(&bench, i), i < 2 ? MATERIAL_DIFFUSE : MATERIAL_INTERFACE);
    }
    run(&bench, true, POINT_LIGHT FOG "Material \"interface\"\n" EMITS);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "s.pbrt:5:1: an interface does not emit, as in pbrt");
    assert_int_equal(count_of(&bench, BLOB_SECTION_LIGHTS), 1);
    for (uint64_t i = 0; i < 3; ++i) assert_int_equal(kind_of(&bench, i), MATERIAL_INTERFACE);
    bench_close(&bench);
#undef EMITS
}

static void pbrt_v4_may_make_the_interface_later(void **state)
{
    (void)state;
#define GLUE "MakeNamedMaterial \"glue\" \"string type\" \"interface\"\n"
    bench_t bench = {0};
    run_quietly(&bench, true,
                FOG POINT_LIGHT "NamedMaterial \"glue\" MediumInterface \"fog\" \"\"\n" SPHERE GLUE);
    assert_int_equal(kind_of(&bench, 0), MATERIAL_INTERFACE);
    expect_media(shape(&bench, 0), 1, 0);
    expect_error(&bench, true, FOG POINT_LIGHT "NamedMaterial \"glue\"\n" SPHERE GLUE,
                 "s.pbrt:7:1: an interface must be made before a shape has it");
    expect_error(
        &bench, true,
        FOG "NamedMaterial \"glue\" MediumInterface \"fog\" \"\"\nAreaLightSource \"diffuse\"\n" SPHERE GLUE,
        "s.pbrt:7:1: an interface must be made before a shape has it");
#undef GLUE
    bench_close(&bench);
}

/* ---- integrators --------------------------------------------------------------------------------------- */

static void integrators_that_know_no_media_are_told(void **state)
{
    (void)state;
    static const struct {
        bool v4;
        const char *name, *warning;
    } cases[] = {
        {false, "volpath", NULL},
        {false, "bdpt", NULL},
        {true, "volpath", NULL},
        {true, "bdpt", NULL},
        {false, "path", "s.pbrt:1:1: the scene has media, which pbrt's integrator does not show"},
        {true, "path", "s.pbrt:1:1: the scene has media, which pbrt's integrator does not show"},
        {true, "simplevolpath",
         "s.pbrt:1:1: integrator \"simplevolpath\": path is used instead; only the noise"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *text =
            mem_printf("Integrator \"%s\"\nFilm \"%s\"\nWorldBegin\n" POINT_LIGHT FOG "%s", cases[i].name,
                       cases[i].v4 ? "rgb" : "image", cases[i].v4 ? "" : "WorldEnd\n");
        bench_run(&bench, text);
        bench_expect_ok(&bench);
        assert_int_equal(bench.warning_count, cases[i].warning ? 1 : 0);
        if (cases[i].warning) expect_text(bench.warnings, cases[i].warning);
        free(text);
    }
    bench_run_v3(&bench, POINT_LIGHT FOG); /* path */
    expect_text(bench.warnings, "the scene has media, which pbrt's integrator does not show");
    bench_run(&bench, "WorldBegin\n" POINT_LIGHT FOG); /* volpath */
    bench_expect_silence(&bench);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_medium_has_its_coefficients),
        cmocka_unit_test(coefficients_have_the_defaults_of_the_dialect),
        cmocka_unit_test(presets_are_known_by_name),
        cmocka_unit_test(a_grid_has_its_densities_and_its_place),
        cmocka_unit_test(pbrt_v3s_grids_are_grey),
        cmocka_unit_test(a_grid_fills_the_unit_cube_if_nothing_is_said),
        cmocka_unit_test(media_glow),
        cmocka_unit_test(attributes_are_defaults_of_media),
        cmocka_unit_test(media_that_make_no_sense_are_errors),
        cmocka_unit_test(fog_without_an_end_is_told),
        cmocka_unit_test(a_grid_about_the_camera_ends),
        cmocka_unit_test(emission_must_be_finite),
        cmocka_unit_test(a_type_that_is_not_supported_is_an_error_where_it_is_used),
        cmocka_unit_test(pbrt_v3_forgets_what_is_not_made),
        cmocka_unit_test(pbrt_v3_may_make_a_medium_again),
        cmocka_unit_test(pbrt_v4_may_make_a_medium_later),
        cmocka_unit_test(a_shape_parts_what_differs),
        cmocka_unit_test(transform_begin_saves_media_in_v4),
        cmocka_unit_test(media_keep_to_the_sides_of_the_normal),
        cmocka_unit_test(lights_shine_into_the_medium_outside),
        cmocka_unit_test(lights_with_images_do_so_too),
        cmocka_unit_test(the_camera_stands_outside),
        cmocka_unit_test(the_camera_may_come_before_its_medium),
        cmocka_unit_test(pbrt_v3_may_put_the_camera_elsewhere),
        cmocka_unit_test(shapes_of_objects_have_media),
        cmocka_unit_test(an_interface_stays_where_it_parts_media),
        cmocka_unit_test(an_interface_keeps_its_alpha),
        cmocka_unit_test(an_interface_that_emits_is_what_it_was),
        cmocka_unit_test(pbrt_v4_may_make_the_interface_later),
        cmocka_unit_test(integrators_that_know_no_media_are_told),
    };
    return cmocka_run_group_tests_name("import_media", tests, NULL, NULL);
}
