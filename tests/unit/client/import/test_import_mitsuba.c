/* What the importer of Mitsuba's scenes makes of them, and what it says to files that are wrong or hostile.
 */
#include "tests/unit/client/import/test_import.h"

#include <png.h>
#include <sys/stat.h>
#include <zlib.h>

#include "client/import/mitsuba/daylight_emitter.h"
#include "common/base.h"
#include "common/image/image.h"
#include "common/job.h"

#define SCENE(body) "<scene version=\"0.6.0\">" body "</scene>"
#define RECTANGLE "<shape type=\"rectangle\"/>"
#define RED "<bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"1,0,0\"/></bsdf>"
#define LAMP "<emitter type=\"constant\"/>"
#define SENSOR(body) "<sensor type=\"perspective\"><float name=\"fov\" value=\"60\"/>" body "</sensor>"

static void run_text(bench_t *bench, const char *text)
{
    bench_write(bench, "s.xml", text, strlen(text));
    bench_import_file(bench, "s.xml");
}

/* A scene that has a sensor and light besides. */
static void run(bench_t *bench, const char *body)
{
    char *text = mem_printf(SCENE("%s" SENSOR("") LAMP), body);
    run_text(bench, text);
    free(text);
}

/* A rectangle with that bsdf. */
static void run_bsdf(bench_t *bench, const char *bsdf)
{
    char *body = mem_printf("<shape type=\"rectangle\">%s</shape>", bsdf);
    run(bench, body);
    free(body);
}

static const blob_material_t *material_of(const bench_t *bench)
{
    bench_expect_ok(bench);
    assert_true(bench->blob.counts[BLOB_SECTION_SHAPES] > 0);
    return &bench->blob.materials[bench->blob.shapes[0].material];
}

static double number(const bench_t *bench, material_value_t value)
{
    return (double)material_of(bench)->values[value].factor.x;
}

static void expect_error(bench_t *bench, const char *body, const char *text)
{
    run(bench, body);
    assert_int_equal(bench->result.code, RESULT_INPUT);
    expect_text(bench->result.message, text);
}

static void expect_bad_file(bench_t *bench, const char *file, const char *text)
{
    run_text(bench, file);
    assert_int_equal(bench->result.code, RESULT_INPUT);
    expect_text(bench->result.message, text);
}

/* ---- the file ------------------------------------------------------------------------------------------ */

static void parameters_stand_for_their_values(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench,
             SCENE("<default name=\"n\" value=\"16\"/><default name=\"n\" value=\"99\"/>"
                   "<default name=\"name\" value=\"box\"/>" SENSOR(
                       "<sampler type=\"halton\"><integer name=\"sampleCount\" value=\"$n\"/></sampler>"
                       "<film type=\"ldrfilm\"><integer name=\"width\" value=\"$n4\"/>"
                       "<rfilter type=\"$name\"/></film>") LAMP RECTANGLE));
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->spp, 16);
    assert_int_equal(bench.blob.scene->width, 164);
    assert_int_equal(bench.blob.scene->filter.kind, FILTER_BOX);
    expect_error(&bench, "<shape type=\"sphere\"><float name=\"radius\" value=\"$r\"/></shape>",
                 "s.xml:1:45: the parameter $r has no value; give it one by the option --define r=VALUE");
    bench_close(&bench);
}

/* Imports the text with these definitions. */
static void run_defined(bench_t *bench, const char *text, const char **definitions, size_t count)
{
    import_wishes_t wishes = import_wishes_none();
    wishes.definitions = (option_list_t){definitions, count};
    bench->wishes = &wishes;
    run_text(bench, text);
    bench->wishes = NULL;
}

static void definitions_go_before_the_defaults_of_the_scene(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *scene = SCENE(SENSOR(
        "<sampler type=\"halton\"><integer name=\"sampleCount\" value=\"$n\"/></sampler>"
        "<film type=\"ldrfilm\"><default name=\"my-w\" value=\"70\"/><integer name=\"width\" "
        "value=\"$my-w\"/>"
        "<default name=\"h\" value=\"90\"/><integer name=\"height\" value=\"$h\"/></film>") LAMP RECTANGLE);
    run_defined(&bench, scene, (const char *[]){"n=3", "my-w=80", "n=5"}, 3);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.scene->spp, 5); /* the last */
    assert_int_equal(bench.blob.scene->width, 80);
    assert_int_equal(bench.blob.scene->height, 90);
    run_defined(&bench, scene, (const char *[]){"n=3", "weight=1"}, 2);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "--define: nothing in the scene uses the parameter $weight");
    run_defined(&bench, scene, (const char *[]){"n"}, 1);
    assert_int_equal(bench.result.code, RESULT_USAGE);
    expect_text(bench.result.message, "--define takes NAME=VALUE, not 'n'");
    bench_close(&bench);
}

static void definitions_are_for_scenes_that_have_parameters(void **state)
{
    (void)state;
    bench_t bench = {0};
    import_wishes_t wishes = import_wishes_none();
    wishes.definitions = (option_list_t){(const char *[]){"n=3"}, 1};
    bench.wishes = &wishes;
    bench_run_v3(&bench, "");
    assert_int_equal(bench.result.code, RESULT_USAGE);
    expect_text(bench.result.message, "--define is for scenes of Mitsuba");
    bench_close(&bench);
}

static void includes_are_read_and_may_not_go_in_circles(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *part =
        SCENE("<bsdf type=\"diffuse\" id=\"b\"><float name=\"reflectance\" value=\".3\"/></bsdf>"
              "<alias id=\"b\" as=\"c\"/>");
    bench_write(&bench, "part.xml", part, strlen(part));
    run(&bench, "<include filename=\"part.xml\"/><shape type=\"rectangle\"><ref id=\"c\"/></shape>");
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.3, 1e-6);
    expect_error(&bench, "<include filename=\"s.xml\"/>", "includes in one another");
    expect_error(&bench, "<include filename=\"none.xml\"/>", "none.xml");
    bench_close(&bench);
}

static void files_are_relative_to_the_main_scene_first(void **state)
{
    (void)state;
    bench_t bench = {0};
    char *folder = bench_path(&bench, "sub"), *included = bench_path(&bench, "sub/part.xml"),
         *other = bench_path(&bench, "sub/b.obj");
    const char *part = SCENE("<shape type=\"obj\"><string name=\"filename\" value=\"a.obj\"/></shape>"
                             "<shape type=\"obj\"><string name=\"filename\" value=\"b.obj\"/></shape>");
    const char *obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    assert_int_equal(mkdir(folder, 0700), 0);
    bench_write(&bench, "sub/part.xml", part, strlen(part));
    bench_write(&bench, "a.obj", obj, strlen(obj));
    bench_write(&bench, "sub/b.obj", obj, strlen(obj));
    run(&bench, "<include filename=\"sub/part.xml\"/>");
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 2);
    unlink(included);
    unlink(other);
    rmdir(folder);
    free(folder);
    free(included);
    free(other);
    bench_close(&bench);
}

static void entities_are_refused_before_they_grow(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_bad_file(&bench,
                    "<!DOCTYPE s [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;&a;&a;&a;&a;\">"
                    "<!ENTITY c \"&b;&b;&b;&b;&b;&b;&b;&b;\">]><scene version=\"&c;\"/>",
                    "s.xml:1:25: entities may not be declared");
    expect_bad_file(&bench,
                    "<!DOCTYPE s [<!ENTITY x SYSTEM \"/etc/passwd\">]><scene version=\"0.6\">&x;</scene>",
                    "entities may not be declared");
    expect_bad_file(&bench, "<!DOCTYPE s [<!ENTITY % p SYSTEM \"http://127.0.0.1/x\">%p;]><scene/>",
                    "entities may not be declared");
    bench_close(&bench);
}

static void parameters_may_not_grow_without_bound(void **state)
{
    (void)state;
    bench_t bench = {0};
    char *text = mem_printf("<scene version=\"0.6\"><default name=\"p0\" value=\"0123456789\"/>");
    for (int i = 1; i < 30; ++i) {
        char *more = mem_printf("%s<default name=\"p%d\" value=\"$p%d;$p%d;$p%d;$p%d;\"/>", text, i, i - 1,
                                i - 1, i - 1, i - 1);
        free(text);
        text = more;
    }
    expect_bad_file(&bench, text, "make too much text");
    free(text);
    bench_close(&bench);
}

static void what_is_no_scene_is_told(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_bad_file(&bench, "", "not XML");
    expect_bad_file(&bench, "<scene version=\"0.6\">", "s.xml:1:22: not XML");
    expect_bad_file(&bench, "<svg/>", "its root must be <scene>");
    expect_bad_file(&bench, "<scene version=\"3.0.0\"/>", "is a scene of Mitsuba 3.0.0");
    expect_bad_file(&bench, "<scene version=\"0.3.0\"/>", "open and save it with Mitsuba 0.6");
    expect_bad_file(&bench, "<scene><mesh/></scene>", "neither a shape nor a version");
    run_text(&bench, SCENE(""));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "no shape that could be rendered");
    char *deep = mem_zalloc(8 * 1000, 1);
    for (int i = 0; i < 1000; ++i) strcat(deep, "<scene>");
    expect_bad_file(&bench, deep, "elements deep");
    free(deep);
    bench_close(&bench);
}

static void unknown_things_are_errors_or_substitutes(void **state)
{
    (void)state;
    static const char *const bodies[] = {
        "<shape type=\"hair\"/>" RECTANGLE,
        "<shape type=\"rectangle\"><bsdf type=\"irawan\"/></shape>",
        "<shape type=\"rectangle\"><medium type=\"homogeneous\" name=\"interior\"/></shape>" RECTANGLE,
        "<shape type=\"rectangle\"><bsdf type=\"diffuse\"><texture type=\"wireframe\" name=\"reflectance\"/>"
        "</bsdf></shape>",
        "<emitter type=\"moon\"/>" RECTANGLE,
        "<integrator type=\"motion\"/>" RECTANGLE,
        "<hide/>" RECTANGLE,
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(bodies); ++i) {
        bench.lenient = false;
        expect_error(&bench, bodies[i], "is not supported");
        bench.lenient = true;
        run(&bench, bodies[i]);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, "the nearest is");
    }
    bench_close(&bench);
}

/* As in other formats. Mitsuba does not go on without them. */
static void a_lenient_import_does_without_files_that_are_missing(void **state)
{
    (void)state;
#define NAMED(name) "<string name=\"filename\" value=\"" name "\"/>"
    static const struct {
        const char *body, *place, *warning;
    } cases[] = {
        {"<shape type=\"rectangle\"><bsdf type=\"diffuse\"><texture type=\"bitmap\" "
         "name=\"reflectance\">" NAMED("no.png") "</texture></bsdf></shape>",
         "s.xml:1:69: ", "the texture is grey"},
        {"<emitter type=\"envmap\">" NAMED("no.exr") "</emitter>" RECTANGLE,
         "s.xml:1:24: ", "the light has no image"},
        {"<shape type=\"ply\">" NAMED("no.ply") RED "</shape>" RECTANGLE,
         "s.xml:1:24: ", "the nearest is to leave the shape out"},
        {"<shape type=\"obj\">" NAMED("no.obj") RED "</shape>" RECTANGLE,
         "s.xml:1:24: ", "the nearest is to leave the shape out"},
        {"<shape type=\"serialized\">" NAMED("no.serialized") RED "</shape>" RECTANGLE,
         "s.xml:1:24: ", "the nearest is to leave the shape out"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench.lenient = false;
        expect_error(&bench, cases[i].body, cases[i].place);
        bench.lenient = true;
        run(&bench, cases[i].body);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, cases[i].warning);
        assert_null(strstr(bench.warnings, "is not supported"));
        assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    }
    bench_close(&bench);
}

/* What Mitsuba goes on after, and what it then does. */
static void slips_are_taken_as_mitsuba_takes_them(void **state)
{
    (void)state;
    static const struct {
        const char *body, *warning;
    } slips[] = {
        {"hello" RECTANGLE, "text between elements means nothing: Mitsuba ignores it"},
        {"<shape type=\"rectangle\"><float name=\"size\" value=\"1\"/></shape>",
         "float \"size\" means nothing in shape \"rectangle\": Mitsuba ignores it"},
        {"<shape type=\"sphere\"><float name=\"radius\" value=\"1\"/><float name=\"radius\" value=\"2\"/>"
         "</shape>",
         "\"radius\" is given again below: Mitsuba takes the last"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(slips); ++i) {
        bench.strict = true;
        expect_error(&bench, slips[i].body, slips[i].warning);
        bench.strict = false;
        run(&bench, slips[i].body);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, slips[i].warning);
    }
    expect_near((double)bench.blob.quadrics[0].radius, 2, 0);
    run(&bench, "<shape type=\"RectAngle\"><bsdf type=\"twoSided\"><bsdf type=\"Diffuse\"/></bsdf></shape>");
    bench_expect_silence(&bench);
    bench_close(&bench);
}

static void references_are_followed_and_checked(void **state)
{
    (void)state;
    bench_t bench = {0};
    expect_error(&bench, "<shape type=\"rectangle\"><ref id=\"none\"/></shape>",
                 "no object with the id \"none\"");
    expect_error(&bench, "<bsdf type=\"diffuse\" id=\"a\"/><bsdf type=\"diffuse\" id=\"a\"/>", "given twice");
    expect_error(
        &bench,
        "<bsdf type=\"twosided\" id=\"a\"><ref id=\"a\"/></bsdf><shape type=\"cube\"><ref id=\"a\"/></shape>",
        "or one that holds itself");
    expect_error(&bench,
                 "<texture type=\"scale\" id=\"t\"><ref id=\"t\"/></texture><shape type=\"cube\">"
                 "<bsdf type=\"diffuse\"><ref id=\"t\" name=\"reflectance\"/></bsdf></shape>",
                 "textures in one another");
    bench_close(&bench);
}

/* ---- camera -------------------------------------------------------------------------------------------- */

static void sensors_look_where_mitsubas_do(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(
        &bench,
        SCENE(
            "<integrator type=\"bdpt\"><integer name=\"maxDepth\" value=\"7\"/></integrator>"
            "<sensor type=\"thinlens\"><float name=\"fov\" value=\"60\"/>"
            "<float name=\"apertureRadius\" value=\".25\"/><float name=\"focusDistance\" value=\"3\"/>"
            "<transform name=\"toWorld\"><lookat origin=\"0,0,5\" target=\"0,0,0\" up=\"0,1,0\"/></transform>"
            "<film type=\"hdrfilm\"><integer name=\"width\" value=\"200\"/>"
            "<integer name=\"height\" value=\"100\"/><integer name=\"cropOffsetX\" value=\"50\"/>"
            "<integer name=\"cropWidth\" value=\"100\"/></film></sensor>" LAMP RECTANGLE));
    bench_expect_ok(&bench);
    const blob_scene_t *scene = bench.blob.scene;
    expect_near((double)scene->fov, 2 * atan(tan(30 / 57.29577951308232) / 2) * 57.29577951308232, 1e-4);
    expect_vec3(xform_vector(&scene->world_from_camera, vec3(1, 0, 0)), 1, 0, 0); /* x is to the right */
    expect_vec3(xform_vector(&scene->world_from_camera, vec3(0, 0, 1)), 0, 0, -1);
    expect_near((double)scene->lens_radius, 0.25, 0);
    expect_near((double)scene->focal_distance, 3, 0);
    assert_int_equal(scene->width, 100);
    assert_int_equal(scene->height, 100);
    expect_near((double)scene->film_window[0], 0.25, 1e-6);
    expect_near((double)scene->film_window[1], 0.75, 1e-6);
    expect_near((double)scene->screen_window[1], 2, 1e-6);
    assert_int_equal(scene->max_depth, 6);
    assert_int_equal(scene->integrator, INTEGRATOR_BDPT);
    assert_int_equal(scene->filter.kind, FILTER_GAUSSIAN);
    bench_close(&bench);
}

static void a_spherical_sensor_begins_behind_itself(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench, SCENE("<sensor type=\"spherical\"/>" LAMP RECTANGLE));
    bench_expect_silence(&bench);
    const blob_scene_t *scene = bench.blob.scene;
    assert_int_equal(scene->camera, CAMERA_SPHERICAL);
    expect_vec3(xform_vector(&scene->world_from_camera, vec3(1, 0, 0)), 0, 0, -1); /* its first column */
    expect_vec3(xform_vector(&scene->world_from_camera, vec3(0, 0, 1)), 1, 0, 0);
    bench_close(&bench);
}

/* A left-handed sensor, as Mitsuba's own editor writes it: without the scale its x is -x of the image. */
static void a_sensor_that_mirrors_shows_a_mirrored_picture(void **state)
{
    (void)state;
#define MIRRORED(type, scale, after)                                                                         \
    SCENE("<sensor type=\"" type "\"><transform name=\"toWorld\"><scale " scale "/>" after                   \
          "</transform></sensor>" LAMP RECTANGLE)
    static const struct {
        const char *text;
        double axes[3][3]; /* of the blob's camera, in the world */
    } cases[] = {
        {MIRRORED("perspective", "x=\"-1\"", "<lookat origin=\"0,0,5\" target=\"0,0,0\" up=\"0,1,0\"/>"),
         {{-1, 0, 0}, {0, 1, 0}, {0, 0, -1}}},
        {MIRRORED("telecentric", "y=\"-1\"", ""), {{-1, 0, 0}, {0, -1, 0}, {0, 0, 1}}},
        {MIRRORED("orthographic", "z=\"-2\"", ""), {{-1, 0, 0}, {0, 1, 0}, {0, 0, -1}}},
        {MIRRORED("spherical", "y=\"-1\"", ""), {{0, 0, -1}, {0, -1, 0}, {1, 0, 0}}},
        {MIRRORED("perspective", "x=\"-1\" y=\"-1\"", ""), {{1, 0, 0}, {0, -1, 0}, {0, 0, 1}}},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        run_text(&bench, cases[i].text);
        bench_expect_ok(&bench);
        for (int k = 0; k < 3; ++k) {
            const double *axis = cases[i].axes[k];
            vec3_t unit = vec3(k == 0, k == 1, k == 2);
            expect_vec3(xform_vector(&bench.blob.scene->world_from_camera, unit), axis[0], axis[1], axis[2]);
        }
    }
    bench_close(&bench);
}

static void integrators_about_others_become_those(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        "<integrator type=\"adaptive\"><integrator type=\"multichannel\"><integrator type=\"field\"/>"
        "<integrator type=\"bdpt\"><integer name=\"maxDepth\" value=\"4\"/>"
        "<boolean name=\"hideEmitters\" value=\"true\"/></integrator></integrator></integrator>" RECTANGLE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->integrator, INTEGRATOR_BDPT);
    assert_int_equal(bench.blob.scene->max_depth, 3);
    expect_text(bench.warnings, "of integrator \"adaptive\" only \"multichannel\" within is rendered");
    expect_text(bench.warnings, "hideEmitters: they stay");
    expect_error(&bench, "<integrator type=\"adaptive\"/>" RECTANGLE, "holds none that shows light");
    expect_error(&bench, "<integrator type=\"adaptive\" id=\"i\"><ref id=\"i\"/></integrator>" RECTANGLE,
                 "integrators in one another");
    bench_close(&bench);
}

static void a_telecentric_sensor_is_orthographic_with_a_lens(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench, SCENE("<sensor type=\"telecentric\"><float name=\"apertureRadius\" value=\".25\"/>"
                           "<float name=\"focusDistance\" value=\"3\"/><transform name=\"toWorld\">"
                           "<scale value=\"4\"/></transform></sensor>" LAMP RECTANGLE));
    bench_expect_ok(&bench);
    const blob_scene_t *scene = bench.blob.scene;
    assert_int_equal(scene->camera, CAMERA_ORTHOGRAPHIC);
    expect_near((double)scene->screen_window[1], 4, 1e-6);
    expect_near((double)scene->lens_radius, 0.25, 0); /* the world's units, whatever the scale */
    expect_near((double)scene->focal_distance, 3, 0);
    bench_close(&bench);
}

static void a_radiance_meter_looks_along_one_ray(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench, SCENE("<sensor type=\"radiancemeter\"/>" LAMP RECTANGLE));
    bench_expect_ok(&bench);
    const blob_scene_t *scene = bench.blob.scene;
    assert_int_equal(scene->camera, CAMERA_PERSPECTIVE);
    expect_near((double)scene->fov, 1e-3, 1e-9);
    expect_near((double)scene->world_from_camera.m[2][2], 1, 0);
    bench_close(&bench);
}

static void a_film_of_numbers_is_one_pixel(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench, SCENE("<sensor type=\"perspective\"><film type=\"mfilm\"/></sensor>" LAMP RECTANGLE));
    bench_expect_ok(&bench);
    const blob_scene_t *scene = bench.blob.scene;
    assert_int_equal(scene->width, 1);
    assert_int_equal(scene->height, 1);
    assert_int_equal(scene->filter.kind, FILTER_BOX);
    bench_close(&bench);
}

static void occlusion_reaches_as_far_as_in_mitsuba(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "<integrator type=\"ao\"/><shape type=\"cube\"/>");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->integrator, INTEGRATOR_AO);
    expect_near((double)bench.blob.scene->occlusion_distance, sqrt(3) / 2, 1e-6);
    run(&bench, "<integrator type=\"ao\"><float name=\"rayLength\" value=\"7\"/></integrator>" RECTANGLE);
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.scene->occlusion_distance, 7, 0);
    bench_close(&bench);
}

static double fov_of(bench_t *bench, const char *lens)
{
    char *text = mem_printf(
        SCENE("<sensor type=\"perspective\">%s<film type=\"hdrfilm\"><integer name=\"width\" "
              "value=\"100\"/><integer name=\"height\" value=\"200\"/></film></sensor>" LAMP RECTANGLE),
        lens);
    run_text(bench, text);
    free(text);
    bench_expect_ok(bench);
    expect_near((double)bench->blob.scene->screen_window[1], 0, 0); /* made from the resolution */
    return tan((double)bench->blob.scene->fov / 2 / 57.29577951308232);
}

/* Half the width at distance 1 of an image that is twice as high as wide. */
static void the_field_of_view_has_its_axis(void **state)
{
    (void)state;
    bench_t bench = {0};
    const double half = tan(20 / 57.29577951308232);
#define FOV(axis) "<float name=\"fov\" value=\"40\"/><string name=\"fovAxis\" value=\"" axis "\"/>"
    expect_near(fov_of(&bench, FOV("x")), half, 1e-6);
    expect_near(fov_of(&bench, FOV("smaller")), half, 1e-6);
    expect_near(fov_of(&bench, FOV("y")), half / 2, 1e-6);
    expect_near(fov_of(&bench, FOV("larger")), half / 2, 1e-6);
    expect_near(fov_of(&bench, FOV("Diagonal")), half / sqrt(5), 1e-6); /* in any case */
    expect_near(fov_of(&bench, "<string name=\"focalLength\" value=\"25mm\"/>"),
                sqrt(36.0 * 36 + 24 * 24) / 50 / sqrt(5), 1e-6);
    bench_close(&bench);
}

/* ---- shapes -------------------------------------------------------------------------------------------- */

static void steps_of_a_transform_are_applied_in_their_order(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench,
        "<shape type=\"rectangle\"><transform name=\"toWorld\"><translate x=\"1\"/><scale value=\"2\"/>"
        "<rotate z=\"1\" angle=\"90\"/><matrix value=\"1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 "
        "1\"/></transform></shape>");
    bench_expect_ok(&bench);
    expect_vec3(positions_of(&bench, 0)[0], 2, 0, 5); /* from (-1 -1 0) */
    expect_vec3(positions_of(&bench, 0)[2], -2, 4, 5);
    bench_close(&bench);
}

/* The volume that a mesh encloses, positive when it winds outward. */
static double volume_of(const bench_t *bench)
{
    const blob_mesh_t *mesh = &bench->blob.meshes[bench->blob.shapes[0].geometry];
    double sum = 0;
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        const uint32_t *v = bench->blob.triangles[mesh->first_triangle + i].v;
        const vec3_t *p = positions_of(bench, 0);
        sum += (double)v_dot(p[v[0]], v_cross(p[v[1]], p[v[2]])) / 6;
    }
    return sum;
}

static void shapes_stand_where_mitsubas_do(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "<shape type=\"cube\"/>");
    bench_expect_ok(&bench);
    expect_near(volume_of(&bench), 8, 1e-5);
    run(&bench, RECTANGLE);
    const vec3_t *p = positions_of(&bench, 0);
    assert_true(v_cross(v_sub(p[1], p[0]), v_sub(p[2], p[0])).z > 0);
    run(&bench,
        "<shape type=\"sphere\"><point name=\"center\" x=\"1\" y=\"2\" z=\"3\"/>"
        "<float name=\"radius\" value=\"2\"/><boolean name=\"flipNormals\" value=\"true\"/></shape>"
        "<shape type=\"cylinder\"><point name=\"p0\" x=\"1\"/><point name=\"p1\" x=\"1\" y=\"3\"/></shape>"
        "<shape type=\"disk\"/>");
    bench_expect_ok(&bench);
    const blob_quadric_t *q = bench.blob.quadrics;
    expect_vec3(xform_point(&q[0].object_from_quadric, vec3(0, 0, 0)), 1, 2, 3);
    expect_near((double)q[0].radius, 2, 0);
    assert_int_equal(bench.blob.shapes[0].flags, SHAPE_FLIP);
    expect_vec3(xform_point(&q[1].object_from_quadric, vec3(0, 0, 0)), 1, 0, 0);
    expect_vec3(xform_point(&q[1].object_from_quadric, vec3(0, 0, q[1].z_max)), 1, 3, 0);
    assert_int_equal(q[2].kind, QUADRIC_DISK);
    bench_close(&bench);
}

/* The vertices of Mitsuba's cube.cpp, four a face, whose texture coordinates are the same on all faces. */
static void a_cube_has_the_texture_coordinates_of_mitsubas(void **state)
{
    (void)state;
    static const vec3_t theirs[6][4] = {{{1, -1, -1}, {1, -1, 1}, {-1, -1, 1}, {-1, -1, -1}},
                                        {{1, 1, -1}, {-1, 1, -1}, {-1, 1, 1}, {1, 1, 1}},
                                        {{1, -1, -1}, {1, 1, -1}, {1, 1, 1}, {1, -1, 1}},
                                        {{1, -1, 1}, {1, 1, 1}, {-1, 1, 1}, {-1, -1, 1}},
                                        {{-1, -1, 1}, {-1, 1, 1}, {-1, 1, -1}, {-1, -1, -1}},
                                        {{1, 1, -1}, {1, -1, -1}, {-1, -1, -1}, {-1, 1, -1}}};
    static const double uvs[4][2] = {{0, 1}, {1, 1}, {1, 0}, {0, 0}};
    bench_t bench = {0};
    run(&bench, "<shape type=\"cube\"/>");
    bench_expect_ok(&bench);
    const blob_mesh_t *mesh = mesh_of(&bench, 0);
    const vec3_t *p = positions_of(&bench, 0);
    int found = 0;
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        const uint32_t *v = bench.blob.triangles[mesh->first_triangle + i].v;
        vec3_t normal = v_cross(v_sub(p[v[1]], p[v[0]]), v_sub(p[v[2]], p[v[0]]));
        for (int face = 0; face < 6; ++face)
            for (int k = 0; k < 12; ++k) { /* corner k % 3 and their vertex k / 3 */
                const vec3_t *q = theirs[face];
                vec3_t theirs_out = v_cross(v_sub(q[1], q[0]), v_sub(q[2], q[0]));
                if (!v_is_zero(v_sub(normal, theirs_out)) || !v_is_zero(v_sub(p[v[k % 3]], q[k / 3])))
                    continue;
                vec2_t uv = bench.blob.uvs[mesh->first_uv + v[k % 3]];
                expect_vec3(vec3(uv.x, uv.y, 0), uvs[k / 3][0], uvs[k / 3][1], 0);
                ++found;
            }
    }
    assert_int_equal(found, 36);
    bench_close(&bench);
}

#define OBJ_SHAPE(body) "<shape type=\"obj\"><string name=\"filename\" value=\"a.obj\"/>" body "</shape>"

static void meshes_without_normals_are_smooth_unless_asked(void **state)
{
    (void)state;
    bench_t bench = {0};
    /* a roof: at the ridge the normals of both sides meet */
    const char *obj = "v 0 0 0\nv 1 0 1\nv 2 0 0\nv 0 1 0\nv 1 1 1\nv 2 1 0\nvt .25 .25\n"
                      "usemtl left\nf 1/1 2/1 5/1 4/1\nf 2/1 3/1 6/1 5/1\n";
    bench_write(&bench, "a.obj", obj, strlen(obj));
    run(&bench, OBJ_SHAPE(""));
    bench_expect_ok(&bench);
    const blob_mesh_t *mesh = &bench.blob.meshes[0];
    assert_int_equal(mesh->vertex_count, 6);
    const vec3_t *n = bench.blob.normals + mesh->first_normal;
    expect_vec3(n[1], 0, 0, 1);
    expect_vec3(n[0], -sqrt(0.5), 0, sqrt(0.5));
    run(&bench, OBJ_SHAPE("<boolean name=\"faceNormals\" value=\"true\"/>"));
    assert_int_equal(bench.blob.meshes[0].first_normal, BLOB_NONE);
    run(&bench,
        OBJ_SHAPE("<bsdf type=\"diffuse\" name=\"right\"/><bsdf type=\"dielectric\" name=\"left\"/>"));
    assert_int_equal(material_of(&bench)->kind, MATERIAL_DIELECTRIC);
    bench_close(&bench);
}

#define MIRROR "<transform name=\"toWorld\"><scale x=\"-1\"/></transform>"
#define SERIALIZED(index, body)                                                                              \
    "<shape type=\"serialized\"><string name=\"filename\" value=\"a.serialized\"/>"                          \
    "<integer name=\"shapeIndex\" value=\"" index "\"/>" body "</shape>"
#define PLY_SHAPE(body) "<shape type=\"ply\"><string name=\"filename\" value=\"a.ply\"/>" body "</shape>"

static size_t write_serialized(uint8_t *file, bool wide, uint16_t version);

/* Its triangle winds about +z, and in the mirror about -z. Normals that a file has stay on their side. */
static void mirrored_meshes_look_where_mitsubas_do(void **state)
{
    (void)state;
#define FLAT "<boolean name=\"faceNormals\" value=\"true\"/>"
#define CREASED "<float name=\"maxSmoothAngle\" value=\"30\"/>"
#define FLIPPED "<boolean name=\"flipNormals\" value=\"true\"/>"
    static const struct {
        const char *corners, *body;
        double normal; /* its z; 0: none */
        uint32_t flags;
    } cases[] = {
        {"1 2 3", OBJ_SHAPE(MIRROR), -1, 0},
        {"1 2 3", OBJ_SHAPE(MIRROR CREASED), -1, 0},
        {"1 2 3", OBJ_SHAPE(MIRROR FLIPPED), 1, SHAPE_FLIP},
        {"1 2 3", OBJ_SHAPE(MIRROR FLAT), 0, 0},
        {"1 2 3", OBJ_SHAPE(MIRROR FLAT FLIPPED), 0, SHAPE_FLIP},
        {"1//1 2//1 3//1", OBJ_SHAPE(MIRROR), 1, SHAPE_FLIP},
        {"1//1 2//1 3//1", OBJ_SHAPE(MIRROR CREASED), -1, 0},
        {"1//1 2//1 3//1", OBJ_SHAPE(MIRROR FLIPPED), -1, 0},
        {"", PLY_SHAPE(MIRROR), -1, 0},
        {"", PLY_SHAPE(MIRROR FLAT), 0, 0},
        {"", SERIALIZED("0", MIRROR), 1, SHAPE_FLIP},
        {"", SERIALIZED("0", MIRROR FLAT), 0, SHAPE_FLIP},
        {"", SERIALIZED("0", MIRROR CREASED), 1, SHAPE_FLIP},
        {"", "<shape type=\"rectangle\">" MIRROR "</shape>", 0, SHAPE_FLIP},
    };
    const char *ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
                      "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
                      "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    uint8_t serialized[2048];
    bench_t bench = {0};
    bench_write(&bench, "a.ply", ply, strlen(ply));
    bench_write(&bench, "a.serialized", serialized, write_serialized(serialized, false, 4));
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *obj = mem_printf("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf %s\n", cases[i].corners);
        bench_write(&bench, "a.obj", obj, strlen(obj));
        free(obj);
        run(&bench, cases[i].body);
        bench_expect_silence(&bench);
        assert_int_equal(bench.blob.shapes[0].flags, cases[i].flags);
        const blob_mesh_t *mesh = mesh_of(&bench, 0);
        assert_int_equal(mesh->first_normal == BLOB_NONE, cases[i].normal == 0);
        if (cases[i].normal != 0) expect_vec3(bench.blob.normals[mesh->first_normal], 0, 0, cases[i].normal);
    }
    bench_close(&bench);
}

/* A corner of a box has the mean of its three sides, however the box is stretched. */
static void normals_are_made_in_the_world(void **state)
{
    (void)state;
    const double third = sqrt(1.0 / 3);
    const char *obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\n";
    bench_t bench = {0};
    bench_write(&bench, "a.obj", obj, strlen(obj));
    run(&bench, OBJ_SHAPE("<transform name=\"toWorld\"><scale x=\"10\"/></transform>"));
    bench_expect_ok(&bench);
    expect_vec3(bench.blob.normals[mesh_of(&bench, 0)->first_normal], third, third, third);
    expect_error(&bench, OBJ_SHAPE("<transform name=\"toWorld\"><scale x=\"0\"/></transform>"),
                 "transform is singular");
    bench_close(&bench);
}

/* The roof with a ridge for each side: in an OBJ file, what lies in one place and has one texture coordinate
 * is one vertex. In a PLY file it is not. */
static void vertices_of_an_obj_that_are_alike_are_one(void **state)
{
    (void)state;
    static const struct {
        const char *uv;
        uint32_t vertices;
    } cases[] = {{"vt 0.5 1\nvt 0.5 1\n", 6}, {"vt 0.5 -0\nvt 0.5 0\n", 6}, {"vt 0.5 1\nvt 0.25 1\n", 8}};
    const char *ply = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
                      "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
                      "0 0 0\n1 0 1\n1 1 1\n0 1 0\n1 0 1\n2 0 0\n2 1 0\n1 1 1\n4 0 1 2 3\n4 4 5 6 7\n";
    bench_t bench = {0};
    for (size_t i = 0; i <= ARRAY_LENGTH(cases); ++i) {
        bool of_obj = i < ARRAY_LENGTH(cases);
        char *obj = mem_printf("v 0 0 0\nv 1 0 1\nv 1 1 1\nv 0 1 0\nv 1 -0.0 1\nv 2 0 0\nv 2 1 0\nv 1 1 1\n%s"
                               "f 1/1 2/1 3/1 4/1\nf 5/2 6/2 7/2 8/2\n",
                               cases[of_obj ? i : 0].uv);
        bench_write(&bench, "a.obj", obj, strlen(obj));
        bench_write(&bench, "a.ply", ply, strlen(ply));
        free(obj);
        run(&bench, of_obj ? OBJ_SHAPE("") : PLY_SHAPE(""));
        bench_expect_silence(&bench);
        const blob_mesh_t *mesh = mesh_of(&bench, 0);
        uint32_t vertices = of_obj ? cases[i].vertices : 8;
        assert_int_equal(mesh->vertex_count, vertices);
        assert_int_equal(mesh->triangle_count, 4);
        const vec3_t *n = bench.blob.normals + mesh->first_normal;
        double side = vertices == 6 ? 0 : -sqrt(0.5);
        expect_vec3(n[1], side, 0, sqrt(1 - side * side)); /* at the ridge */
        expect_vec3(n[0], -sqrt(0.5), 0, sqrt(0.5));
    }
    bench_close(&bench);
}

/* The same roof, its left side of two faces; at the ridge they are 90 degrees apart. */
static void edges_are_smooth_up_to_the_angle(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *obj =
        "v -1 0 -1\nv 0 0 0\nv 1 0 1\nv 2 0 0\nv -1 1 -1\nv 0 1 0\nv 1 1 1\nv 2 1 0\n"
        "vn 1 0 0\nvn 0 1 0\nf 1//1 2//1 6//1 5//1\nf 2//2 3//2 7//2 6//2\nf 3//1 4//1 8//1 7//1\n";
    bench_write(&bench, "a.obj", obj, strlen(obj));
    run(&bench, OBJ_SHAPE("<float name=\"maxSmoothAngle\" value=\"80\"/>"));
    bench_expect_ok(&bench);
    const blob_mesh_t *mesh = &bench.blob.meshes[0];
    assert_int_equal(mesh->triangle_count, 6);
    assert_int_equal(mesh->vertex_count, 10); /* those of the ridge are two each */
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        const blob_triangle_t *triangle = &bench.blob.triangles[mesh->first_triangle + i];
        double side = i < 4 ? -sqrt(0.5) : sqrt(0.5);
        for (int k = 0; k < 3; ++k)
            expect_vec3(bench.blob.normals[mesh->first_normal + triangle->v[k]], side, 0, sqrt(0.5));
    }
    run(&bench, OBJ_SHAPE("<float name=\"maxSmoothAngle\" value=\"100\"/>"));
    mesh = &bench.blob.meshes[0];
    assert_int_equal(mesh->vertex_count, 8);
    const blob_triangle_t *last = &bench.blob.triangles[mesh->first_triangle + 5];
    for (int k = 0; k < 3; ++k) {
        vec3_t p = bench.blob.positions[mesh->first_position + last->v[k]];
        if (p.z == 1) expect_vec3(bench.blob.normals[mesh->first_normal + last->v[k]], 0, 0, 1);
    }
    bench_close(&bench);
}

/* Of a fan whose triangles all look elsewhere each corner gets a vertex of its own, in no time. */
static void a_vertex_of_very_many_edges_is_parted(void **state)
{
    (void)state;
    enum { LEAVES = 20000 };
    bench_t bench = {0};
    char *obj = mem_alloc(LEAVES * 80 + 100), *at = obj;
    at += sprintf(at, "v 0 0 0\n");
    for (int i = 0; i < LEAVES; ++i) {
        double angle = 6.28 * i / LEAVES;
        at +=
            sprintf(at, "v %g %g 1\nv %g %g 2\nf 1 -2 -1\n", cos(angle), sin(angle), cos(angle), sin(angle));
    }
    bench_write(&bench, "a.obj", obj, (size_t)(at - obj));
    free(obj);
    run(&bench, OBJ_SHAPE("<float name=\"maxSmoothAngle\" value=\"0\"/>"));
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.meshes[0].triangle_count, LEAVES);
    assert_in_range(bench.blob.meshes[0].vertex_count, 3 * LEAVES - 64, 3 * LEAVES);
    bench_close(&bench);
}

/* Mitsuba's v = 0 is the top row; it turns the v of OBJ files over. */
static void the_v_of_obj_files_runs_up(void **state)
{
    (void)state;
    bench_t bench = {0};
#define CHECKER                                                                                              \
    "<bsdf type=\"diffuse\"><texture type=\"checkerboard\" name=\"reflectance\">"                            \
    "<float name=\"vscale\" value=\"3\"/><float name=\"voffset\" value=\".5\"/></texture></bsdf>"
    const char *obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";
    bench_write(&bench, "a.obj", obj, strlen(obj));
    run(&bench, OBJ_SHAPE(CHECKER));
    const blob_texture_t *texture =
        &bench.blob.textures[material_of(&bench)->values[VALUE_REFLECTANCE].texture - 1];
    expect_near((double)texture->matrix[1][1], -6, 1e-6);
    expect_near((double)texture->matrix[1][2], 7, 1e-6);
    run(&bench, "<shape type=\"rectangle\">" CHECKER "</shape>");
    texture = &bench.blob.textures[material_of(&bench)->values[VALUE_REFLECTANCE].texture - 1];
    expect_near((double)texture->matrix[1][1], 6, 1e-6);
    expect_near((double)texture->matrix[1][2], 1, 1e-6);
    expect_near((double)texture->inputs[0].factor.x, 0.4, 1e-6);
    bench_close(&bench);
}

/* A file of two triangles, the second at z = 7, of single or double precision and version 3 or 4. */
static size_t write_serialized(uint8_t *file, bool wide, uint16_t version)
{
    size_t used = 0, starts[2];
    for (int shape = 0; shape < 2; ++shape) {
        uint8_t plain[512];
        size_t size = 0;
        uint32_t flags = 0x1 | (wide ? 0x2000 : 0x1000), corners[3] = {0, 1, 2};
        uint64_t counts[2] = {3, 1};
        starts[shape] = used;
        memcpy(file + used, &(uint16_t){0x041C}, 2);
        memcpy(file + used + 2, &version, 2);
        memcpy(plain, &flags, 4), size += 4;
        if (version == 4) memcpy(plain + size, "abc", 4), size += 4;
        memcpy(plain + size, counts, 16), size += 16;
        for (int i = 0; i < 18; ++i) { /* three positions, three normals */
            double value = i < 9 ? (i == 3 || i == 7) + (i % 3 == 2) * 7.0 * shape : i % 3 == 2;
            float narrow = (float)value;
            memcpy(plain + size, wide ? (void *)&value : (void *)&narrow, wide ? 8 : 4);
            size += wide ? 8 : 4;
        }
        memcpy(plain + size, corners, 12), size += 12;
        uLongf packed = 512;
        assert_int_equal(compress(file + used + 4, &packed, plain, size), Z_OK);
        used += 4 + packed;
    }
    for (int shape = 0; shape < 2; ++shape) {
        uint64_t start = starts[shape];
        memcpy(file + used, &start, version == 4 ? 8 : 4);
        used += version == 4 ? 8 : 4;
    }
    memcpy(file + used, &(uint32_t){2}, 4);
    return used + 4;
}

static void serialized_meshes_are_read_in_both_precisions_and_versions(void **state)
{
    (void)state;
    bench_t bench = {0};
    for (int i = 0; i < 4; ++i) {
        uint8_t file[2048];
        size_t size = write_serialized(file, i % 2, i < 2 ? 3 : 4);
        bench_write(&bench, "a.serialized", file, size);
        run(&bench, SERIALIZED("1", ""));
        bench_expect_silence(&bench);
        expect_vec3(positions_of(&bench, 0)[1], 1, 0, 7);
        expect_vec3(bench.blob.normals[0], 0, 0, 1);
        expect_error(&bench, SERIALIZED("2", ""), "has 2 meshes");
        for (size_t cut = 0; cut < size; cut += 7) {
            bench_write(&bench, "a.serialized", file, cut);
            run(&bench, SERIALIZED("0", ""));
            assert_int_equal(bench.result.code, RESULT_INPUT);
        }
        for (size_t at = 0; at < size; at += 3) { /* damage: refused or read, never worse */
            file[at] ^= 0x55;
            bench_write(&bench, "a.serialized", file, size);
            run(&bench, SERIALIZED("0", ""));
            file[at] ^= 0x55;
        }
    }
    bench_close(&bench);
}

static void ply_files_have_colours(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
                      "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
                      "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
                      "0 0 0 255 128 0\n1 0 0 0 0 0\n0 1 0 0 0 51\n3 0 1 2\n";
    bench_write(&bench, "a.ply", ply, strlen(ply));
    run(&bench, PLY_SHAPE(""));
    bench_expect_ok(&bench);
    const blob_colour_t *c = bench.blob.colours;
    expect_vec3(vec3(c[0].r, c[0].g, c[0].b), 1, 0.2158605, 0);
    run(&bench, PLY_SHAPE("<boolean name=\"srgb\" value=\"false\"/>"));
    c = bench.blob.colours;
    expect_vec3(vec3(c[2].r, c[2].g, c[2].b), 0, 0, 0.2);
    bench_close(&bench);
}

static void instances_show_their_group(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "<shape type=\"shapegroup\" id=\"g\"><shape type=\"cube\"/><shape type=\"sphere\"/></shape>"
                "<shape type=\"instance\"><ref id=\"g\"/><transform name=\"toWorld\"><translate "
                "x=\"3\"/></transform></shape>"
                "<shape type=\"instance\"><ref id=\"g\"/></shape>");
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 2);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 2);
    expect_near((double)bench.blob.instances[0].world_from_object.m[0][3], 3, 0);
    expect_error(&bench, "<shape type=\"instance\"><shape type=\"cube\"/></shape>",
                 "needs a reference to a shapegroup");
    expect_error(
        &bench,
        "<shape type=\"shapegroup\" id=\"g\"><shape type=\"instance\"><ref id=\"g\"/></shape></shape>"
        "<shape type=\"instance\"><ref id=\"g\"/></shape>",
        "may hold neither");
    bench.lenient = true;
    run(&bench, "<shape type=\"shapegroup\" id=\"g\"><shape type=\"cube\"><emitter type=\"area\"/></shape>"
                "</shape><shape type=\"instance\"><ref id=\"g\"/></shape>");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "cannot emit; the nearest is a dark one");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 1); /* the sky */
    bench_close(&bench);
}

/* ---- motion -------------------------------------------------------------------------------------------- */

#define KEY(time, x) "<transform time=\"" time "\"><translate x=\"" x "\"/></transform>"
#define MOTION(keys) "<animation name=\"toWorld\">" keys "</animation>"
#define MOVING_SENSOR(open, close, keys)                                                                     \
    "<sensor type=\"perspective\"><float name=\"shutterOpen\" value=\"" open                                 \
    "\"/><float name=\"shutterClose\" value=\"" close "\"/>" MOTION(keys) "</sensor>"

static void run_motion(bench_t *bench, const char *sensor, const char *body)
{
    char *text = mem_printf(SCENE("%s%s" LAMP), body, sensor);
    run_text(bench, text);
    free(text);
}

static void expect_way(const bench_t *bench, double open, double close)
{
    const blob_instance_t *instance = bench->blob.instances;
    bench_expect_silence((bench_t *)bench);
    assert_int_equal(bench->blob.counts[BLOB_SECTION_INSTANCES], 1);
    expect_near((double)instance->world_from_object.m[0][3], open, 1e-6);
    expect_near((double)instance->world_from_object_end.m[0][3], close, 1e-6);
}

static void animations_move_while_the_shutter_is_open(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *sphere = "<shape type=\"sphere\">" MOTION(KEY("3", "6") KEY("1", "2")) "</shape>";
    /* In between, beyond, and at one time alone, where it needs no instance. */
    run_motion(&bench, MOVING_SENSOR("1.5", "2", KEY("1", "1") KEY("3", "3")), sphere);
    expect_way(&bench, 3, 4);
    expect_near((double)bench.blob.scene->world_from_camera.m[0][3], 1.5, 1e-6);
    expect_near((double)bench.blob.scene->world_from_camera_end.m[0][3], 2, 1e-6);
    run_motion(&bench, MOVING_SENSOR("0", "9", KEY("0", "1")), sphere);
    assert_int_equal(bench.result.code, RESULT_INPUT);
    expect_text(bench.result.message, "an animation that turns while the shutter is open is not supported");
    bench.lenient = true;
    run_motion(&bench, MOVING_SENSOR("0", "9", KEY("0", "1")), sphere);
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.instances->world_from_object_end.m[0][3], 6, 1e-6);
    bench.lenient = false;
    run_motion(&bench, MOVING_SENSOR("2", "2", KEY("0", "1")), sphere);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_INSTANCES], 0);
    expect_near((double)bench.blob.quadrics->object_from_quadric.m[0][3], 4, 1e-6);
    run_motion(
        &bench, MOVING_SENSOR("1", "3", KEY("0", "1")),
        "<shape type=\"shapegroup\" id=\"g\"><shape type=\"cube\"/></shape><shape type=\"instance\"><ref "
        "id=\"g\"/>" MOTION(KEY("1", "2") KEY("3", "6")) "</shape>");
    expect_way(&bench, 2, 6);
    bench_close(&bench);
}

static void animations_that_cannot_be_are_told(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const struct {
        const char *sensor, *body, *text;
    } scenes[] = {
        {SENSOR(""), "<shape type=\"cube\">" MOTION("") "</shape>", "an animation needs transforms"},
        {SENSOR(""), "<shape type=\"cube\">" MOTION("<transform/>") "</shape>", "transform needs \"time\""},
        {SENSOR(""), "<shape type=\"cube\">" MOTION(KEY("1", "2") KEY("1", "3")) "</shape>",
         "two transforms for the time 1"},
        {SENSOR(""), "<shape type=\"cube\">" MOTION("<lookat/>") "</shape>", "must be a transform"},
        {MOVING_SENSOR("1", "0", KEY("0", "0")), RECTANGLE, "must not come before shutterOpen"},
        {MOVING_SENSOR("0", "1", KEY("0", "0") "<transform time=\"1\"><scale x=\"-1\"/></transform>"),
         RECTANGLE, "a sensor may not move from a transform to its mirror image"},
        {MOVING_SENSOR("0", "1", KEY("0", "0")),
         RECTANGLE "<emitter type=\"spot\">" MOTION(KEY("0", "0") KEY("1", "1")) "</emitter>",
         "emitter \"spot\" that moves is not supported"},
        {MOVING_SENSOR("0", "1", KEY("0", "0")),
         "<shape type=\"cube\"><emitter type=\"area\"/>" MOTION(KEY("0", "0") KEY("1", "1")) "</shape>",
         "a shape that moves, or lies in a shapegroup, cannot emit"},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(scenes); ++i) {
        run_motion(&bench, scenes[i].sensor, scenes[i].body);
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, scenes[i].text);
    }
    bench_close(&bench);
}

/* ---- materials ----------------------------------------------------------------------------------------- */

static void bsdfs_of_one_layer_become_their_materials(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_bsdf(&bench, "<bsdf type=\"diffuse\"><srgb name=\"reflectance\" value=\"#ff8000\"/></bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_DIFFUSE);
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 1, 0.2158605, 0);
    run_bsdf(&bench, "<bsdf type=\"dielectric\"><string name=\"intIOR\" value=\"water\"/><float "
                     "name=\"extIOR\" value=\"1\"/></bsdf>");
    expect_near(number(&bench, VALUE_ETA), 1.333, 1e-6);
    run_bsdf(&bench, "<bsdf type=\"thindielectric\"/>");
    expect_near(number(&bench, VALUE_ETA), 1.5046 / 1.000277, 1e-6);
    assert_int_equal(material_of(&bench)->flags, MATERIAL_THIN);
    run_bsdf(&bench, "<bsdf type=\"roughdielectric\"><float name=\"alphaU\" value=\".2\"/><float "
                     "name=\"alphaV\" value=\".3\"/></bsdf>");
    expect_near(number(&bench, VALUE_ROUGHNESS_U), 0.2, 1e-6);
    expect_near(number(&bench, VALUE_ROUGHNESS_V), 0.3, 1e-6);
    expect_text(bench.warnings, "\"beckmann\" is taken for ggx");
    run_bsdf(&bench,
             "<bsdf type=\"conductor\"><rgb name=\"eta\" value=\"1,2,3\"/><rgb name=\"k\" value=\"4,5,6\"/>"
             "<float name=\"extEta\" value=\"2\"/></bsdf>");
    expect_vec3(material_of(&bench)->values[VALUE_ETA].factor, 0.5, 1, 1.5);
    expect_vec3(material_of(&bench)->values[VALUE_K].factor, 2, 2.5, 3);
    run_bsdf(&bench, "<bsdf type=\"conductor\"><string name=\"material\" value=\"none\"/></bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_MIRROR);
    run_bsdf(&bench, "<bsdf type=\"roughconductor\"><string name=\"material\" value=\"Au\"/></bsdf>");
    assert_true(number(&bench, VALUE_ETA) < 0.3); /* gold in red */
    run_bsdf(&bench, "<bsdf type=\"twosided\"><bsdf type=\"roughconductor\"><string name=\"distribution\" "
                     "value=\"GGX\"/></bsdf></bsdf>");
    bench_expect_silence(&bench);
    run_bsdf(&bench, "<bsdf type=\"conductor\"><string name=\"material\" value=\"Cr_palik\"/>"
                     "<float name=\"extEta\" value=\"1\"/><float name=\"k\" value=\"9\"/></bsdf>");
    /* Palik's at 600 nm; colours of equal energy are 1.2 times that in red */
    expect_near(number(&bench, VALUE_ETA) / 1.202, 3.5, 0.2);
    expect_near(number(&bench, VALUE_K), 9, 0);
    run_bsdf(&bench, "<bsdf type=\"conductor\"><string name=\"material\" value=\"Xx\"/></bsdf>");
    expect_text(bench.result.message, "no index is known for the metal \"Xx\"");
    run_bsdf(&bench, "<bsdf type=\"difftrans\"/>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_DIFFUSE_TRANSMISSION);
    run_bsdf(&bench, "<bsdf type=\"roughdiffuse\"><float name=\"alpha\" value=\".3\"/></bsdf>");
    expect_near(number(&bench, VALUE_SIGMA), 0.3 / sqrt(2) * 57.29577951, 1e-4);
    bench_close(&bench);
}

/* Each of several textures is read, in whatever order the bsdf asks for them. */
static void a_bsdf_may_have_several_textures(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench.strict = true;
    run(&bench,
        "<texture type=\"checkerboard\" id=\"t\"/><shape type=\"rectangle\"><bsdf type=\"dielectric\">"
        "<ref name=\"specularReflectance\" id=\"t\"/><ref name=\"specularTransmittance\" id=\"t\"/>"
        "</bsdf></shape>");
    assert_true(material_of(&bench)->values[VALUE_REFLECTANCE].texture != 0);
    assert_true(material_of(&bench)->values[VALUE_TRANSMITTANCE].texture != 0);
    bench_close(&bench);
}

static void a_medium_matters_where_a_shape_has_it(void **state)
{
    (void)state;
    bench_t bench = {0};
#define MEDIUM "<medium type=\"homogeneous\" id=\"m\"><float name=\"scale\" value=\"2\"/></medium>"
    run(&bench, MEDIUM "<shape type=\"sphere\"/>");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "medium \"homogeneous\" is ignored");
    expect_error(&bench, MEDIUM "<shape type=\"sphere\"><ref name=\"interior\" id=\"m\"/></shape>",
                 "ref \"interior\" is not supported in shape \"sphere\"");
    bench_close(&bench);
}

static void glass_does_without_a_clear_coat(void **state)
{
    (void)state;
    bench_t bench = {0};
#define COATED(rest) "<bsdf type=\"coating\"><bsdf type=\"dielectric\"/>" rest "</bsdf>"
    run_bsdf(&bench, COATED(""));
    assert_int_equal(material_of(&bench)->kind, MATERIAL_DIELECTRIC);
    expect_text(bench.warnings, "a clear coat over a dielectric is left out");
    run_bsdf(&bench, COATED("<spectrum name=\"sigmaA\" value=\"1\"/>"));
    assert_int_equal(bench.result.code, RESULT_INPUT);
    bench_close(&bench);
}

/* The inner reflectance of index 1.5 is 0.5964 (by an integral of Fresnel's equations elsewhere). */
static void plastic_is_linear_in_its_colour_unless_asked(void **state)
{
    (void)state;
    bench_t bench = {0};
#define INDEX "<float name=\"intIOR\" value=\"1.5\"/><float name=\"extIOR\" value=\"1\"/>"
    run_bsdf(&bench, "<bsdf type=\"plastic\">" INDEX "<boolean name=\"nonlinear\" value=\"true\"/></bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_COATED_DIFFUSE);
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.5, 1e-6);
    expect_near(number(&bench, VALUE_THICKNESS), 0, 0);
    run_bsdf(&bench, "<bsdf type=\"plastic\">" INDEX "</bsdf>");
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.5 / (1 - 0.5964 + 0.5 * 0.5964), 1e-3);
    run_bsdf(&bench, "<bsdf type=\"roughplastic\">" INDEX
                     "<texture type=\"checkerboard\" name=\"diffuseReflectance\"/></bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_MIX);
    assert_true(material_of(&bench)->values[VALUE_AMOUNT].texture != 0);
    const uint32_t *parts = material_of(&bench)->parts;
    expect_near((double)bench.blob.materials[parts[0]].values[VALUE_REFLECTANCE].factor.x, 0, 0);
    expect_near((double)bench.blob.materials[parts[1]].values[VALUE_REFLECTANCE].factor.x, 1, 0);
    bench_close(&bench);
}

static void phong_and_ward_are_read(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_bsdf(&bench, "<bsdf type=\"twosided\"><bsdf type=\"phong\"/></bsdf>");
    bench_expect_silence(&bench);
    assert_int_equal(material_of(&bench)->kind, MATERIAL_PHONG);
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.5, 0);
    expect_near(number(&bench, VALUE_SPECULAR), 0.2, 1e-6);
    expect_near(number(&bench, VALUE_EXPONENT), 30, 0);
    run_bsdf(&bench, "<bsdf type=\"phong\"><texture name=\"exponent\" type=\"checkerboard\"/></bsdf>");
    assert_true(material_of(&bench)->values[VALUE_EXPONENT].texture != 0);
    static const struct {
        const char *variant;
        material_kind_t kind;
    } variants[] = {
        {"", MATERIAL_WARD_BALANCED},
        {"<string name=\"variant\" value=\"ward\"/>", MATERIAL_WARD},
        {"<string name=\"variant\" value=\"Ward-Duer\"/>", MATERIAL_WARD_DUER},
        {"<string name=\"variant\" value=\"balanced\"/>", MATERIAL_WARD_BALANCED},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(variants); ++i) {
        char *bsdf = mem_printf("<bsdf type=\"twosided\"><bsdf type=\"ward\">%s<float name=\"alphaU\" "
                                "value=\".3\"/></bsdf></bsdf>",
                                variants[i].variant);
        run_bsdf(&bench, bsdf);
        free(bsdf);
        bench_expect_silence(&bench);
        assert_int_equal(material_of(&bench)->kind, variants[i].kind);
        expect_near(number(&bench, VALUE_ROUGHNESS_U), 0.3, 1e-6);
        expect_near(number(&bench, VALUE_ROUGHNESS_V), 0.1, 1e-6);
    }
    run_bsdf(&bench, "<bsdf type=\"ward\"><float name=\"alpha\" value=\".4\"/><float name=\"alphaU\" "
                     "value=\".2\"/></bsdf>");
    expect_near(number(&bench, VALUE_ROUGHNESS_U), 0.2, 1e-6);
    expect_near(number(&bench, VALUE_ROUGHNESS_V), 0.4, 1e-6);
    run_bsdf(&bench, "<bsdf type=\"ward\"><float name=\"alphaV\" value=\".2\"/><float name=\"alpha\" "
                     "value=\".4\"/></bsdf>");
    expect_near(number(&bench, VALUE_ROUGHNESS_U), 0.4, 1e-6);
    expect_near(number(&bench, VALUE_ROUGHNESS_V), 0.2, 1e-6);
    run_bsdf(&bench, "<bsdf type=\"ward\"><string name=\"variant\" value=\"x\"/></bsdf>");
    expect_text(bench.result.message, "must be ward, ward-duer or balanced, found \"x\"");
    bench_close(&bench);
}

/* An image of two pixels, the brighter one (1, 0.25, 0) when its numbers are linear. */
static void write_pixels(bench_t *bench)
{
    static const float pixels[6] = {0.5f, 0.125f, 0, 1, 0.25f, 0};
    char file[64];
    int header = snprintf(file, sizeof file, "PF\n2 1\n-1\n");
    memcpy(file + header, pixels, sizeof pixels);
    bench_write(bench, "a.pfm", file, (size_t)header + sizeof pixels);
}

static void reflectances_that_gain_energy_are_scaled_as_in_mitsuba(void **state)
{
    (void)state;
    bench_t bench = {0};
#define WHITE_PHONG                                                                                          \
    "<bsdf type=\"phong\"><rgb name=\"diffuseReflectance\" value=\".3,.8,.3\"/><rgb "                        \
    "name=\"specularReflectance\" value=\".6,.6,.1\"/>"
    run_bsdf(&bench, WHITE_PHONG "</bsdf>");
    expect_vec3(material_of(&bench)->values[VALUE_SPECULAR].factor, 0.6 * 0.99 / 1.4, 0.6 * 0.99 / 1.4,
                0.1 * 0.99 / 1.4);
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.3 * 0.99 / 1.4, 1e-6);
    expect_text(bench.warnings, "add up to 1.4, and are scaled to 0.99");
    run_bsdf(&bench, WHITE_PHONG "<boolean name=\"ensureEnergyConservation\" value=\"false\"/></bsdf>");
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.3, 1e-6);
    /* Of textures by their largest values: 0.4 of a checkerboard, 1 in red of the image. */
    run_bsdf(&bench, "<bsdf type=\"ward\"><texture name=\"diffuseReflectance\" type=\"checkerboard\"/><float "
                     "name=\"specularReflectance\" value=\".8\"/></bsdf>");
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.99 / 1.2, 1e-6);
    write_pixels(&bench);
#define IMAGE                                                                                                \
    "<texture name=\"diffuseReflectance\" type=\"bitmap\"><string name=\"filename\" "                        \
    "value=\"a.pfm\"/></texture>"
    run_bsdf(&bench,
             "<bsdf type=\"phong\"><rgb name=\"specularReflectance\" value=\".5,.7,.9\"/>" IMAGE "</bsdf>");
    expect_near(number(&bench, VALUE_SPECULAR), 0.5 * 0.99 / 1.5, 1e-6);
    run_bsdf(&bench,
             "<bsdf type=\"phong\"><rgb name=\"specularReflectance\" value=\"0,.75,1\"/>" IMAGE "</bsdf>");
    expect_near(number(&bench, VALUE_REFLECTANCE), 1, 0);
    bench_close(&bench);
}

static void reflectances_above_one_are_scaled_as_in_mitsuba(void **state)
{
    (void)state;
#define TOO_MUCH(type, name, more)                                                                           \
    "<bsdf type=\"" type "\"><float name=\"" name "\" value=\"4\"/>" more "</bsdf>"
#define UNCHECKED "<boolean name=\"ensureEnergyConservation\" value=\"false\"/>"
#define NONLINEAR "<boolean name=\"nonlinear\" value=\"true\"/>"
    static const struct {
        const char *bsdf;
        material_value_t value;
        double expected;
    } cases[] = {
        {TOO_MUCH("diffuse", "reflectance", ""), VALUE_REFLECTANCE, 0.99},
        {TOO_MUCH("diffuse", "reflectance", UNCHECKED), VALUE_REFLECTANCE, 4},
        {TOO_MUCH("roughdiffuse", "diffuseReflectance", ""), VALUE_REFLECTANCE, 0.99},
        {TOO_MUCH("dielectric", "specularReflectance", ""), VALUE_REFLECTANCE, 0.99},
        {TOO_MUCH("thindielectric", "specularTransmittance", ""), VALUE_TRANSMITTANCE, 0.99},
        {TOO_MUCH("roughdielectric", "specularReflectance", ""), VALUE_REFLECTANCE, 0.99},
        {TOO_MUCH("conductor", "specularReflectance", ""), VALUE_REFLECTANCE, 0.99},
        {TOO_MUCH("roughconductor", "specularReflectance", UNCHECKED), VALUE_REFLECTANCE, 4},
        {TOO_MUCH("difftrans", "transmittance", ""), VALUE_TRANSMITTANCE, 0.99},
        {TOO_MUCH("plastic", "diffuseReflectance", NONLINEAR), VALUE_REFLECTANCE, 0.99},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        run_bsdf(&bench, cases[i].bsdf);
        expect_near(number(&bench, cases[i].value), cases[i].expected, 1e-6);
        if (cases[i].expected < 1) expect_text(bench.warnings, "goes up to 4, and is scaled to 0.99");
    }
    run_bsdf(&bench, "<bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"2,1,0.5\"/></bsdf>");
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 0.99, 0.495, 0.2475);
    run_bsdf(&bench, "<bsdf type=\"diffuse\"><float name=\"reflectance\" value=\"1\"/></bsdf>");
    expect_near(number(&bench, VALUE_REFLECTANCE), 1, 0);
    bench_close(&bench);
}

/* The texture of a value, which has no factor. */
static const blob_texture_t *texture_of(const bench_t *bench, const blob_value_t *value)
{
    assert_true(value->texture != 0);
    expect_vec3(value->factor, 1, 1, 1);
    return &bench->blob.textures[value->texture - 1];
}

static void numbers_are_the_mean_or_the_luminance_of_a_colour(void **state)
{
    (void)state;
#define COLOURED(name)                                                                                       \
    "<texture name=\"" name "\" type=\"bitmap\"><string name=\"filename\" value=\"a.pfm\"/></texture>"
#define CHECKED(name)                                                                                        \
    "<texture name=\"" name "\" type=\"checkerboard\"><rgb name=\"color0\" value=\".9,.3,0\"/></texture>"
    static const struct {
        const char *bsdf;
        material_value_t value;
    } means[] = {
        {"<bsdf type=\"roughdielectric\">" COLOURED("alpha") "</bsdf>", VALUE_ROUGHNESS_V},
        {"<bsdf type=\"roughconductor\">" COLOURED("alphaU") "</bsdf>", VALUE_ROUGHNESS_U},
        {"<bsdf type=\"ward\">" COLOURED("alphaV") "</bsdf>", VALUE_ROUGHNESS_V},
        {"<bsdf type=\"phong\">" COLOURED("exponent") "</bsdf>", VALUE_EXPONENT},
        {"<bsdf type=\"blendbsdf\">" COLOURED("weight") RED RED "</bsdf>", VALUE_AMOUNT},
    };
    bench_t bench = {0};
    write_pixels(&bench);
    for (size_t i = 0; i < ARRAY_LENGTH(means); ++i) {
        run_bsdf(&bench, means[i].bsdf);
        const blob_value_t *value = &material_of(&bench)->values[means[i].value];
        assert_int_equal(texture_of(&bench, value)->channel, CHANNEL_MEAN);
    }
    run_bsdf(&bench, "<bsdf type=\"blendbsdf\">" CHECKED("weight") RED RED "</bsdf>");
    const blob_texture_t *weight = texture_of(&bench, &material_of(&bench)->values[VALUE_AMOUNT]);
    expect_vec3(weight->inputs[0].factor, 0.4, 0.4, 0.4);
    expect_vec3(weight->inputs[1].factor, 0.2, 0.2, 0.2);
    run_bsdf(&bench, "<bsdf type=\"blendbsdf\"><texture name=\"weight\" type=\"scale\"><rgb name=\"scale\" "
                     "value=\"1,0,2\"/>" COLOURED("") "</texture>" RED RED "</bsdf>");
    weight = texture_of(&bench, &material_of(&bench)->values[VALUE_AMOUNT]);
    assert_int_equal(weight->kind, TEXTURE_CHANNEL);
    assert_int_equal(weight->channel, CHANNEL_MEAN);
    expect_vec3(weight->inputs[0].factor, 1, 0, 2);
    run_bsdf(&bench, "<bsdf type=\"mask\">" COLOURED("opacity") RED "</bsdf>");
    bench_expect_ok(&bench);
    const blob_texture_t *mask = texture_of(&bench, &bench.blob.shapes[0].alpha);
    assert_int_equal(texture_of(&bench, &mask->inputs[0])->channel, CHANNEL_LUMINANCE);
    run_bsdf(&bench, "<bsdf type=\"mask\"><rgb name=\"opacity\" value=\".9,.3,0\"/>" RED "</bsdf>");
    bench_expect_ok(&bench);
    expect_near((double)bench.blob.shapes[0].alpha.factor.x, 0.2126 * 0.9 + 0.7152 * 0.3, 1e-6);
    bench_close(&bench);
}

static void a_channel_of_an_image_is_taken_or_told(void **state)
{
    (void)state;
#define CHANNEL(name)                                                                                        \
    "<bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"bitmap\"><string name=\"filename\" "        \
    "value=\"a.pfm\"/><string name=\"channel\" value=\"" name "\"/></texture></bsdf>"
    bench_t bench = {0};
    write_pixels(&bench);
    run_bsdf(&bench, CHANNEL("G"));
    assert_int_equal(material_of(&bench)->values[VALUE_REFLECTANCE].texture, 1);
    assert_int_equal(bench.blob.textures[0].channel, CHANNEL_G);
    expect_error(&bench, "<shape type=\"cube\">" CHANNEL("z") "</shape>",
                 "channel \"z\" is not supported; it may be r, g, b or a");
    bench_close(&bench);
}

/* An EXR of two pixels: 300, 0.001, 0.5 with an alpha of 1, and black with 0.25. */
static void write_exr_with_alpha(bench_t *bench)
{
    static const float values[4][2] = {{300, 0}, {0.001f, 0}, {0.5f, 0}, {1, 0.25f}};
    static const char *const names[] = {"R", "G", "B", "A"};
    image_t image;
    uint8_t *bytes;
    size_t size;
    char *path = bench_path(bench, "a.exr");
    image_init(&image, 2, 1);
    for (int k = 0; k < 4; ++k) image_add_view(&image, names[k], PIXEL_FLOAT, values[k], 1);
    assert_int_equal(image_write_exr(path, &image).code, RESULT_OK);
    assert_int_equal(file_read(path, 1 << 20, &bytes, &size).code, RESULT_OK);
    bench_write(bench, "a.exr", bytes, size); /* which removes it in the end */
    image_free(&image);
    free(bytes);
    free(path);
}

/* A PNG of 16 bits: the grey 1000 / 65535, encoded, and a black pixel whose alpha is a half. */
static void write_png_of_16_bits(bench_t *bench, uint32_t format)
{
    const uint16_t colours[8] = {1000, 1000, 1000, 65535, 0, 0, 0, 32768}, greys[4] = {1000, 65535, 0, 32768};
    uint8_t bytes[1024];
    png_image image = {.version = PNG_IMAGE_VERSION, .width = 2, .height = 1, .format = format};
    png_alloc_size_t size = sizeof bytes;
    const void *pixels = format == PNG_FORMAT_LINEAR_Y_ALPHA ? greys : colours;
    assert_true(png_image_write_to_memory(&image, bytes, &size, 0, pixels, 0, NULL));
    bench_write(bench, "a.png", bytes, size);
}

/* The first two texels of the image of the reflectance's texture, which is to have that channel. */
static const float *floats_of(const bench_t *bench, channel_t channel, texels_t format)
{
    const blob_texture_t *texture =
        &bench->blob.textures[material_of(bench)->values[VALUE_REFLECTANCE].texture - 1];
    const blob_image_t *image = &bench->blob.images[texture->image - 1];
    assert_int_equal(texture->channel, channel);
    assert_int_equal(image->format, format);
    return (const float *)(bench->blob.texels + image->first_word);
}

/* Mitsuba keeps halves. */
static void images_of_floats_stay_so_beside_alpha(void **state)
{
    (void)state;
#define BITMAP(name, more)                                                                                   \
    "<bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"bitmap\"><string name=\"filename\" "        \
    "value=\"" name "\"/>" more "</texture></bsdf>"
#define ALPHA "<string name=\"channel\" value=\"a\"/>"
    static const uint32_t formats[] = {PNG_FORMAT_LINEAR_RGB_ALPHA, PNG_FORMAT_LINEAR_Y_ALPHA};
    const double decoded = 1000.0 / 65535 / 12.92;
    bench_t bench = {0};
    write_exr_with_alpha(&bench);
    run_bsdf(&bench, BITMAP("a.exr", ""));
    const float *floats = floats_of(&bench, CHANNEL_RGB, TEXELS_RGB32F);
    expect_vec3(vec3(floats[0] / 300, floats[1] * 1000, floats[2]), 1, 1, 0.5);
    run_bsdf(&bench, BITMAP("a.exr", ALPHA));
    expect_near((double)floats_of(&bench, CHANNEL_R, TEXELS_R32F)[1], 0.25, 0);
    for (size_t i = 0; i < ARRAY_LENGTH(formats); ++i) {
        write_png_of_16_bits(&bench, formats[i]);
        run_bsdf(&bench, BITMAP("a.png", ""));
        floats = floats_of(&bench, CHANNEL_RGB, i == 0 ? TEXELS_RGB32F : TEXELS_R32F);
        expect_near((double)floats[0], decoded, 1e-9);
        run_bsdf(&bench, BITMAP("a.png", ALPHA)); /* linear, whatever the colours are */
        floats = floats_of(&bench, CHANNEL_R, TEXELS_R32F);
        expect_near((double)floats[0], 1, 0);
        expect_near((double)floats[1], 32768.0 / 65535, 1e-6);
    }
    bench_close(&bench);
}

static void coats_may_be_tinted(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_bsdf(&bench,
             "<bsdf type=\"roughplastic\"><rgb name=\"specularReflectance\" value=\".2,.4,.6\"/></bsdf>");
    assert_int_equal(material_of(&bench)->flags & MATERIAL_TINTED, MATERIAL_TINTED);
    expect_vec3(material_of(&bench)->values[VALUE_SPECULAR].factor, 0.2, 0.4, 0.6);
    run_bsdf(&bench, "<bsdf type=\"plastic\"><float name=\"specularReflectance\" value=\"1\"/></bsdf>");
    assert_int_equal(material_of(&bench)->flags & MATERIAL_TINTED, 0);
    run_bsdf(&bench,
             "<bsdf type=\"coating\"><texture name=\"specularReflectance\" type=\"checkerboard\"/><bsdf "
             "type=\"conductor\"/></bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_COATED_CONDUCTOR);
    assert_int_equal(material_of(&bench)->flags & MATERIAL_TINTED, MATERIAL_TINTED);
    assert_true(material_of(&bench)->values[VALUE_SPECULAR].texture != 0);
    run_bsdf(&bench, "<bsdf type=\"plastic\"><float name=\"specularReflectance\" value=\"4\"/></bsdf>");
    expect_near(number(&bench, VALUE_SPECULAR), 0.99, 1e-6);
    bench_close(&bench);
}

#define BLUE "<bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"0,0,1\"/></bsdf>"

static void bsdfs_may_hold_others(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_bsdf(&bench, "<bsdf type=\"mask\"><float name=\"opacity\" value=\".25\"/><bsdf type=\"twosided\">" RED
                     "</bsdf></bsdf>");
    bench_expect_silence(&bench);
    expect_near((double)bench.blob.shapes[0].alpha.factor.x, 0.25, 0);
    run_bsdf(&bench, "<bsdf type=\"blendbsdf\"><float name=\"weight\" value=\".3\"/>" RED BLUE "</bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_MIX);
    assert_int_equal(material_of(&bench)->flags & MATERIAL_CHOSEN, 0);
    expect_near(number(&bench, VALUE_AMOUNT), 0.3, 1e-6);
    run_bsdf(&bench, "<bsdf type=\"blendbsdf\"><bsdf type=\"bumpmap\"><texture type=\"checkerboard\"/>" RED
                     "</bsdf>" BLUE "</bsdf>");
    assert_true(material_of(&bench)->flags & MATERIAL_CHOSEN); /* the parts keep their relief */
    run_bsdf(&bench,
             "<bsdf type=\"mixturebsdf\"><string name=\"weights\" value=\".25, .25\"/>" RED BLUE "</bsdf>");
    expect_near(number(&bench, VALUE_AMOUNT), 0.5, 1e-6); /* the other half is black */
    const blob_material_t *inner = &bench.blob.materials[material_of(&bench)->parts[1]];
    expect_near((double)inner->values[VALUE_AMOUNT].factor.x, 0.5, 1e-6);
    run_bsdf(&bench, "<bsdf type=\"bumpmap\"><texture type=\"scale\"><float name=\"scale\" value=\"2\"/>"
                     "<texture type=\"checkerboard\"/></texture>" RED "</bsdf>");
    assert_true(material_of(&bench)->bump != 0);
    expect_near((double)bench.blob.textures[material_of(&bench)->bump - 1].inputs[0].factor.x, 2, 0);
    run_text(&bench, "<scene version=\"0.4.0\">" SENSOR("") LAMP
             "<shape type=\"rectangle\"><bsdf type=\"bump\"><texture type=\"checkerboard\"/>" RED
             "</bsdf></shape></scene>");
    assert_true(material_of(&bench)->bump != 0); /* what bumpmap was called */
    run_bsdf(&bench, "<bsdf type=\"normalmap\"><texture type=\"checkerboard\"/>" RED "</bsdf>");
    assert_true(material_of(&bench)->normal_map != 0);
    run_bsdf(&bench, "<bsdf type=\"coating\"><float name=\"sigmaA\" value=\".5\"/><float name=\"thickness\" "
                     "value=\"2\"/>" RED "</bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_COATED_DIFFUSE);
    expect_near(number(&bench, VALUE_THICKNESS), 1, 1e-6);
    run_bsdf(&bench, "<bsdf type=\"coating\"><bsdf type=\"roughconductor\"/></bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_COATED_CONDUCTOR);
    run_bsdf(&bench, "<bsdf type=\"coating\"><bsdf type=\"bumpmap\"><texture type=\"checkerboard\"/>" RED
                     "</bsdf></bsdf>");
    assert_int_equal(material_of(&bench)->kind, MATERIAL_COATED_DIFFUSE);
    assert_true(material_of(&bench)->bump != 0);
    expect_text(bench.warnings, "the bumps of what is coated are those of the coat, too");
    run(&bench, "<shape type=\"rectangle\"><bsdf type=\"null\"/></shape>" RECTANGLE);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    expect_error(
        &bench,
        "<shape type=\"cube\"><bsdf type=\"mixturebsdf\"><string name=\"weights\" value=\".25\"/>" RED BLUE
        "</bsdf></shape>",
        "for each of its 2 bsdfs");
    expect_error(&bench, "<shape type=\"cube\"><bsdf type=\"mask\"/></shape>", "needs a bsdf within");
    bench_close(&bench);
}

static void relief_that_is_lost_is_told(void **state)
{
    (void)state;
#define RELIEF(type, inner) "<bsdf type=\"" type "\"><texture type=\"checkerboard\"/>" inner "</bsdf>"
#define BLEND(inner) "<bsdf type=\"blendbsdf\">" inner BLUE "</bsdf>"
    static const struct {
        const char *bsdf, *warning;
    } cases[] = {
        {RELIEF("bumpmap", RELIEF("bumpmap", RED)), "this bumpmap takes the place of the one within it"},
        {RELIEF("normalmap", RELIEF("normalmap", RED)), "this normalmap takes the place of the one within"},
        {RELIEF("bumpmap", RELIEF("normalmap", RED)), NULL},
        {RELIEF("normalmap", RELIEF("bumpmap", RED)), NULL},
        {RELIEF("bumpmap", BLEND(RED)), NULL},
        {RELIEF("bumpmap", BLEND(RELIEF("bumpmap", RED))), "this bumpmap is left out: parts of the mixture"},
        {RELIEF("normalmap", BLEND(RELIEF("bumpmap", RED))), "this normalmap is left out: parts of the"},
    };
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *bsdf = mem_printf("<bsdf type=\"twosided\">%s</bsdf>", cases[i].bsdf);
        run_bsdf(&bench, bsdf);
        free(bsdf);
        if (cases[i].warning) expect_text(bench.warnings, cases[i].warning);
        assert_int_equal(bench.warning_count, cases[i].warning != NULL);
    }
    bench_close(&bench);
}

/* The last bsdf counts; a name in an OBJ file's shape is that of a material of the file. */
static void shapes_have_the_bsdf_that_mitsuba_gives_them(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl left\nf 1 2 3\n";
    bench_write(&bench, "a.obj", obj, strlen(obj));
    run_bsdf(&bench, RED BLUE);
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 0, 0, 1);
    run(&bench, OBJ_SHAPE(RED "<bsdf type=\"dielectric\" name=\"right\"/>"));
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 1, 0, 0);
    run(&bench, OBJ_SHAPE("<bsdf type=\"dielectric\" name=\"right\"/>"));
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 0.5, 0.5, 0.5);
    run(&bench, OBJ_SHAPE("<emitter type=\"area\"/>"));
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 0, 0, 0);
    bench.lenient = true;
    run(&bench, "<shape type=\"cube\"><medium type=\"homogeneous\" name=\"interior\"/></shape>" RECTANGLE);
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SHAPES], 1);
    bench_close(&bench);
}

/* Mitsuba takes a library's colours as sRGB; a bsdf of the scene goes before its material. */
static void obj_files_bring_their_materials(void **state)
{
    (void)state;
    bench_t bench = {0};
    const char *obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl left\nf 1 2 3\n";
    const char *mtl = "newmtl left\nKd 1 0.50196 0\nd 0.5\n";
    bench_write(&bench, "a.obj", obj, strlen(obj));
    bench_write(&bench, "a.mtl", mtl, strlen(mtl));
    run(&bench, OBJ_SHAPE(""));
    bench_expect_silence(&bench);
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 1, 0.2158605, 0);
    expect_near((double)bench.blob.shapes[0].alpha.factor.x, 0.5, 0);
    run(&bench, OBJ_SHAPE(BLUE));
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 0, 0, 1);
    run(&bench, OBJ_SHAPE("<boolean name=\"loadMaterials\" value=\"false\"/>"));
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, 0.5, 0.5, 0.5);
    bench_write(&bench, "a.mtl", "newmtl left\nillum 7\n", 20);
    run(&bench, OBJ_SHAPE(""));
    assert_int_equal(material_of(&bench)->kind, MATERIAL_DIELECTRIC);
    expect_text(bench.warnings, "\"left\" of its MTL library becomes what it is in an OBJ file");
    bench_write(&bench, "a.mtl", "Kd 1 1 1\n", 9);
    expect_error(&bench, OBJ_SHAPE(""), "a.mtl:1:");
    bench_close(&bench);
}

static void colours_are_what_their_elements_say(void **state)
{
    (void)state;
    bench_t bench = {0};
#define DIFFUSE(element) "<bsdf type=\"diffuse\">" element "</bsdf>"
    run_bsdf(&bench, DIFFUSE("<spectrum name=\"reflectance\" value=\".25\"/>"));
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.25, 1e-6);
    run_bsdf(&bench, DIFFUSE("<spectrum name=\"reflectance\" value=\"400:.2, 500:.2, 700:.2\"/>"));
    expect_near(number(&bench, VALUE_REFLECTANCE), 0.2 * 1.202, 1e-3); /* equal energy, as pbrt-v3's */
    run_bsdf(&bench, DIFFUSE("<rgb name=\"reflectance\" value=\".1 .2 .3\"/>"));
    expect_vec3(material_of(&bench)->values[VALUE_REFLECTANCE].factor, .1, .2, .3);
    run_bsdf(&bench, DIFFUSE("<rgb name=\"reflectance\" value=\".1 .2\"/>"));
    expect_text(bench.result.message, "one number, three, or #rrggbb");
    run_bsdf(&bench, DIFFUSE("<string name=\"reflectance\" value=\"red\"/>"));
    expect_text(bench.result.message, "must be a colour");
    run_bsdf(&bench, DIFFUSE("<spectrum name=\"reflectance\" value=\"400:.2 500\"/>"));
    assert_int_equal(bench.result.code, RESULT_INPUT);
    bench_close(&bench);
}

/* ---- emitters ------------------------------------------------------------------------------------------ */

static void emitters_shine_where_mitsubas_do(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench,
             SCENE(SENSOR("") "<emitter type=\"point\"><point name=\"position\" x=\"1\" y=\"2\" z=\"3\"/>"
                              "<float name=\"intensity\" value=\"5\"/></emitter>"
                              "<emitter type=\"directional\"><vector name=\"direction\" y=\"-1\" x=\"0\" "
                              "z=\"0\"/></emitter>"
                              "<emitter type=\"spot\"><transform name=\"toWorld\"><lookat origin=\"0 4 0\" "
                              "target=\"0 0 0\" up=\"1 0 0\"/></transform></emitter>"
                              "<shape type=\"rectangle\"><emitter type=\"area\"><rgb name=\"radiance\" "
                              "value=\"1 2 3\"/></emitter></shape>"
                              "<emitter type=\"constant\"><blackbody name=\"radiance\" temperature=\"5000K\" "
                              "scale=\"1e-4\"/></emitter>"));
    bench_expect_ok(&bench);
    const blob_light_t *light = bench.blob.lights;
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 5);
    assert_int_equal(light[0].kind, LIGHT_AREA);
    expect_vec3(light[0].radiance.factor, 1, 2, 3);
    assert_int_equal(light[1].kind, LIGHT_POINT);
    expect_vec3(xform_point(&light[1].world_from_light, vec3(0, 0, 0)), 1, 2, 3);
    expect_vec3(xform_vector(&light[2].world_from_light, vec3(0, 0, 1)), 0, 1, 0); /* it stands above */
    expect_vec3(xform_vector(&light[3].world_from_light, vec3(0, 0, 1)), 0, -1, 0);
    expect_near((double)light[3].parameters[0], cos(20 / 57.29577951), 1e-6);
    expect_near((double)light[3].parameters[1], cos(15 / 57.29577951), 1e-6);
    /* Planck's law at 5000 K has 1.2e4 W / (m^2 sr nm) about 555 nm; red above blue */
    expect_near((double)rgb_luminance(light[4].radiance.factor), 1.24, 0.05);
    assert_true(light[4].radiance.factor.x > light[4].radiance.factor.z);
    bench_close(&bench);
}

/* The rows of table 2 of Blanco-Muriel et al. are not at hand: the sun of the June solstice stands 23.44
 * degrees from the zenith of the equator at noon, in the north; that of an equinox rises in the east. */
static void the_sun_stands_where_it_does(void **state)
{
    (void)state;
    const double degree = 3.14159265358979323846 / 180;
    double zenith, azimuth;
    sun_position(2010, 6, 21, 12.03, 0, 0, &zenith, &azimuth); /* the equation of time is 1.8 minutes */
    expect_near(zenith, 23.44 * degree, 0.02 * degree);
    expect_near(azimuth, 0, 0.2 * degree);
    sun_position(2010, 3, 20, 6 + 7.4 / 60, 0, 0, &zenith, &azimuth);
    expect_near(zenith, 90 * degree, 0.1 * degree);
    expect_near(azimuth, 90 * degree, 0.2 * degree);
}

#define SUN(body) "<vector name=\"sunDirection\" x=\"0\" y=\"3\" z=\"-4\"/>" body

static void daylight_comes_from_where_it_is_said_to(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench, SCENE(SENSOR("") RECTANGLE
                           "<emitter type=\"sun\">" SUN("<float name=\"sunRadiusScale\" value=\"0\"/>"
                                                        "<float name=\"scale\" value=\"2\"/>") "</emitter>"));
    bench_expect_silence(&bench);
    const blob_light_t *light = bench.blob.lights;
    assert_int_equal(light->kind, LIGHT_DISTANT);
    expect_vec3(xform_vector(&light->world_from_light, vec3(0, 0, 1)), 0, 0.6, -0.8);
    /* Beams on a clear day have some 80 klx at this height: 683 lm/W, and 106.857 nm of the eye. */
    double sun = (double)rgb_luminance(light->radiance.factor) / 2;
    expect_near(sun * 683 * 106.857 / 1000, 80, 8);
    run_text(&bench, SCENE(SENSOR("") RECTANGLE "<emitter type=\"sunsky\">" SUN(
                         "<transform name=\"toWorld\"><rotate y=\"1\" angle=\"25\"/></transform>"
                         "<float name=\"sunScale\" value=\"3\"/>") "</emitter>"));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "the sky is Preetham's here, Hosek and Wilkie's in Mitsuba");
    light = bench.blob.lights;
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 2);
    vec3_t side = xform_vector(&light[0].world_from_light, vec3(1, 0, 0)); /* the sky's, below its sun */
    expect_vec3(side, 0, 0, -1);
    expect_vec3(xform_vector(&light[0].world_from_light, vec3(0, 0, 1)), 1, 0, 0);      /* not mirrored */
    expect_vec3(xform_vector(&light[1].world_from_light, vec3(0, 1, 0)), 0, 0.6, -0.8); /* the disc's pole */
    /* noon of the June solstice at the equator: 23.4 degrees to the north, which is -z */
    run_text(&bench, SCENE(SENSOR("") RECTANGLE
                           "<emitter type=\"sun\"><float name=\"sunRadiusScale\" value=\"0\"/>"
                           "<integer name=\"month\" value=\"6\"/><integer name=\"day\" value=\"21\"/>"
                           "<float name=\"hour\" value=\"13\"/><float name=\"minute\" value=\"1.8\"/>"
                           "<float name=\"timezone\" value=\"1\"/><float name=\"latitude\" value=\"0\"/>"
                           "<float name=\"longitude\" value=\"0\"/></emitter>"));
    bench_expect_silence(&bench);
    vec3_t noon = xform_vector(&bench.blob.lights->world_from_light, vec3(0, 0, 1));
    expect_near((double)noon.z, -sin(23.44 / 57.29577951), 1e-3);
    expect_near((double)noon.y, cos(23.44 / 57.29577951), 1e-3);
    run_text(&bench, SCENE(SENSOR("") RECTANGLE
                           "<emitter type=\"sun\"><float name=\"sunRadiusScale\" value=\"0\"/>"
                           "<transform name=\"toWorld\"><scale z=\"-1\"/></transform>"
                           "<integer name=\"month\" value=\"6\"/><integer name=\"day\" value=\"21\"/>"
                           "<float name=\"hour\" value=\"13\"/><float name=\"minute\" value=\"1.8\"/>"
                           "<float name=\"timezone\" value=\"1\"/><float name=\"latitude\" value=\"0\"/>"
                           "<float name=\"longitude\" value=\"0\"/></emitter>"));
    bench_expect_silence(&bench);
    vec3_t mirrored = xform_vector(&bench.blob.lights->world_from_light, vec3(0, 0, 1));
    expect_vec3(mirrored, (double)noon.x, (double)noon.y, -(double)noon.z);
    expect_error(&bench, RECTANGLE "<emitter type=\"sky\"><vector name=\"sunDirection\" y=\"-1\"/></emitter>",
                 "the sun is below the horizon");
    expect_error(&bench, RECTANGLE "<emitter type=\"sky\"><float name=\"turbidity\" value=\"11\"/></emitter>",
                 "must lie between 1 and 10");
    bench_close(&bench);
}

/* Power is intensity times the solid angle of the cone. */
static void a_beam_keeps_its_power(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench, SCENE(SENSOR("") RECTANGLE
                           "<emitter type=\"collimated\"><float name=\"power\" value=\"5\"/></emitter>"));
    bench_expect_ok(&bench);
    const blob_light_t *light = bench.blob.lights;
    assert_int_equal(light->kind, LIGHT_SPOT);
    double angle = 2 * 3.14159265 * (1 - (double)light->parameters[0]);
    expect_near((double)light->radiance.factor.x * angle, 5, 1e-4);
    expect_near(angle, 6e-5, 1e-6);
    bench_close(&bench);
}

static void run_environment(bench_t *bench, const char *body)
{
    uint8_t *bytes;
    size_t size;
    assert_int_equal(file_read("tests/fuzz/assets/sky.exr", 1 << 20, &bytes, &size).code, RESULT_OK);
    bench_write(bench, "sky.exr", bytes, size);
    free(bytes);
    char *text = mem_printf(
        SCENE(SENSOR("") RECTANGLE
              "<emitter type=\"envmap\"><string name=\"filename\" value=\"sky.exr\"/>%s</emitter>"),
        body);
    run_text(bench, text);
    free(text);
    bench_expect_ok(bench);
}

/* The image's first column is at -z, the next quarter at +x; the top row at +y. */
static void an_environment_stands_as_mitsubas_does(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_environment(&bench, "<float name=\"scale\" value=\"2\"/>");
    const blob_light_t *light = bench.blob.lights;
    assert_int_equal(light->mapping, LIGHT_LATLONG);
    expect_near((double)light->radiance.factor.x, 2, 0);
    expect_vec3(xform_vector(&light->world_from_light, vec3(1, 0, 0)), 0, 0, -1);
    expect_vec3(xform_vector(&light->world_from_light, vec3(0, 1, 0)), 1, 0, 0);
    expect_vec3(xform_vector(&light->world_from_light, vec3(0, 0, 1)), 0, 1, 0);
    bench_close(&bench);
}

static void an_environment_may_be_mirrored(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_environment(&bench, "<transform name=\"toWorld\"><scale x=\"-1\"/></transform>");
    const xform_t *frame = &bench.blob.lights->world_from_light;
    expect_vec3(xform_vector(frame, vec3(1, 0, 0)), 0, 0, -1);
    expect_vec3(xform_vector(frame, vec3(0, 1, 0)), -1, 0, 0);
    expect_vec3(xform_vector(frame, vec3(0, 0, 1)), 0, 1, 0);
    run_environment(&bench, "<transform name=\"toWorld\"><scale z=\"-3\"/></transform>");
    frame = &bench.blob.lights->world_from_light;
    expect_vec3(xform_vector(frame, vec3(1, 0, 0)), 0, 0, 1);
    expect_vec3(xform_vector(frame, vec3(0, 1, 0)), 1, 0, 0);
    expect_vec3(xform_vector(frame, vec3(0, 0, 1)), 0, 1, 0);
    bench_close(&bench);
}

static void what_a_scene_lacks_is_as_in_mitsuba(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench, SCENE("<shape type=\"sphere\"><float name=\"radius\" value=\"2\"/></shape>"));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "no light: a clear day lights it, as in Mitsuba");
    expect_text(bench.warnings, "no sensor: one that sees all of it");
    assert_int_equal(bench.blob.counts[BLOB_SECTION_LIGHTS], 2); /* sky and sun */
    assert_int_equal(bench.blob.lights[0].kind, LIGHT_INFINITE);
    const blob_scene_t *scene = bench.blob.scene;
    expect_near((double)scene->fov, 2 * atan(tan(22.5 / 57.29577951) * 0.75) * 57.29577951, 1e-4);
    expect_vec3(xform_point(&scene->world_from_camera, vec3(0, 0, 0)), 0, 0,
                -2 - 2 / tan(22.5 / 57.29577951));
    expect_vec3(xform_vector(&scene->world_from_camera, vec3(1, 0, 0)), -1, 0, 0);
    assert_int_equal(scene->integrator, INTEGRATOR_PATH);
    assert_int_equal(scene->max_depth, 1);
    assert_int_equal(scene->spp, 4);
    bench_close(&bench);
}

static void the_last_of_several_sensors_counts(void **state)
{
    (void)state;
    bench_t bench = {0};
    run_text(&bench, SCENE("<sensor type=\"orthographic\"/>" SENSOR("") LAMP RECTANGLE));
    bench_expect_ok(&bench);
    assert_int_equal(bench.blob.scene->camera, CAMERA_PERSPECTIVE);
    expect_text(bench.warnings, "s.xml:1:24: another sensor follows");
    bench_close(&bench);
}

static void run_camera(bench_t *bench, const char *wanted)
{
    import_wishes_t wishes = import_wishes_none();
    wishes.camera = wanted;
    bench->wishes = &wishes;
    run_text(bench, SCENE("<sensor type=\"orthographic\" id=\"plan\"/>" SENSOR("") LAMP RECTANGLE));
    bench->wishes = NULL;
}

static void a_sensor_is_taken_by_its_id_or_number(void **state)
{
    (void)state;
    static const struct {
        const char *wanted;
        camera_kind_t camera;
    } cases[] = {{"plan", CAMERA_ORTHOGRAPHIC}, {"1", CAMERA_ORTHOGRAPHIC}, {"2", CAMERA_PERSPECTIVE}};
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        run_camera(&bench, cases[i].wanted);
        bench_expect_silence(&bench);
        assert_int_equal(bench.blob.scene->camera, cases[i].camera);
    }
    run_camera(&bench, "3");
    expect_text(bench.result.message, "--camera: the scene has no sensor '3'; it has 2");
    assert_int_equal(bench.result.code, RESULT_USAGE);
    bench_close(&bench);
}

/* An instance by its own id, which tells it from others of its group. */
static void focus_finds_an_instance(void **state)
{
    (void)state;
    import_wishes_t wishes = import_wishes_none();
    wishes.lens_radius = 1;
    bench_t bench = {.wishes = &wishes};
    static const char *const ids[] = {"first", "second"};
    for (int i = 0; i < 2; ++i) {
        wishes.focus = ids[i];
        run(&bench, "<shape type=\"shapegroup\" id=\"g\"><shape type=\"cube\" id=\"c\"/></shape>"
                    "<shape type=\"instance\" id=\"first\"><ref id=\"g\"/><transform name=\"toWorld\">"
                    "<translate z=\"5\"/></transform></shape>"
                    "<shape type=\"instance\" id=\"second\"><ref id=\"g\"/><transform name=\"toWorld\">"
                    "<translate z=\"8\"/></transform></shape>");
        bench_expect_ok(&bench);
        expect_near((double)bench.blob.scene->focal_distance, i == 0 ? 5 : 8, 1e-5);
    }
    wishes.focus = "c";
    run(&bench, "<shape type=\"cube\" id=\"d\"/>");
    expect_text(bench.result.message, "of a Mitsuba file its id); there is no 'c'");
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(parameters_stand_for_their_values),
        cmocka_unit_test(definitions_go_before_the_defaults_of_the_scene),
        cmocka_unit_test(definitions_are_for_scenes_that_have_parameters),
        cmocka_unit_test(includes_are_read_and_may_not_go_in_circles),
        cmocka_unit_test(files_are_relative_to_the_main_scene_first),
        cmocka_unit_test(entities_are_refused_before_they_grow),
        cmocka_unit_test(parameters_may_not_grow_without_bound),
        cmocka_unit_test(what_is_no_scene_is_told),
        cmocka_unit_test(unknown_things_are_errors_or_substitutes),
        cmocka_unit_test(a_lenient_import_does_without_files_that_are_missing),
        cmocka_unit_test(slips_are_taken_as_mitsuba_takes_them),
        cmocka_unit_test(references_are_followed_and_checked),
        cmocka_unit_test(sensors_look_where_mitsubas_do),
        cmocka_unit_test(a_spherical_sensor_begins_behind_itself),
        cmocka_unit_test(a_sensor_that_mirrors_shows_a_mirrored_picture),
        cmocka_unit_test(integrators_about_others_become_those),
        cmocka_unit_test(a_telecentric_sensor_is_orthographic_with_a_lens),
        cmocka_unit_test(a_radiance_meter_looks_along_one_ray),
        cmocka_unit_test(a_film_of_numbers_is_one_pixel),
        cmocka_unit_test(occlusion_reaches_as_far_as_in_mitsuba),
        cmocka_unit_test(the_field_of_view_has_its_axis),
        cmocka_unit_test(steps_of_a_transform_are_applied_in_their_order),
        cmocka_unit_test(shapes_stand_where_mitsubas_do),
        cmocka_unit_test(a_cube_has_the_texture_coordinates_of_mitsubas),
        cmocka_unit_test(meshes_without_normals_are_smooth_unless_asked),
        cmocka_unit_test(mirrored_meshes_look_where_mitsubas_do),
        cmocka_unit_test(normals_are_made_in_the_world),
        cmocka_unit_test(vertices_of_an_obj_that_are_alike_are_one),
        cmocka_unit_test(edges_are_smooth_up_to_the_angle),
        cmocka_unit_test(a_vertex_of_very_many_edges_is_parted),
        cmocka_unit_test(the_v_of_obj_files_runs_up),
        cmocka_unit_test(serialized_meshes_are_read_in_both_precisions_and_versions),
        cmocka_unit_test(ply_files_have_colours),
        cmocka_unit_test(instances_show_their_group),
        cmocka_unit_test(bsdfs_of_one_layer_become_their_materials),
        cmocka_unit_test(a_bsdf_may_have_several_textures),
        cmocka_unit_test(a_medium_matters_where_a_shape_has_it),
        cmocka_unit_test(animations_move_while_the_shutter_is_open),
        cmocka_unit_test(animations_that_cannot_be_are_told),
        cmocka_unit_test(phong_and_ward_are_read),
        cmocka_unit_test(reflectances_that_gain_energy_are_scaled_as_in_mitsuba),
        cmocka_unit_test(reflectances_above_one_are_scaled_as_in_mitsuba),
        cmocka_unit_test(numbers_are_the_mean_or_the_luminance_of_a_colour),
        cmocka_unit_test(a_channel_of_an_image_is_taken_or_told),
        cmocka_unit_test(images_of_floats_stay_so_beside_alpha),
        cmocka_unit_test(coats_may_be_tinted),
        cmocka_unit_test(glass_does_without_a_clear_coat),
        cmocka_unit_test(plastic_is_linear_in_its_colour_unless_asked),
        cmocka_unit_test(bsdfs_may_hold_others),
        cmocka_unit_test(relief_that_is_lost_is_told),
        cmocka_unit_test(shapes_have_the_bsdf_that_mitsuba_gives_them),
        cmocka_unit_test(obj_files_bring_their_materials),
        cmocka_unit_test(colours_are_what_their_elements_say),
        cmocka_unit_test(emitters_shine_where_mitsubas_do),
        cmocka_unit_test(the_sun_stands_where_it_does),
        cmocka_unit_test(daylight_comes_from_where_it_is_said_to),
        cmocka_unit_test(a_beam_keeps_its_power),
        cmocka_unit_test(an_environment_stands_as_mitsubas_does),
        cmocka_unit_test(an_environment_may_be_mirrored),
        cmocka_unit_test(what_a_scene_lacks_is_as_in_mitsuba),
        cmocka_unit_test(the_last_of_several_sensors_counts),
        cmocka_unit_test(a_sensor_is_taken_by_its_id_or_number),
        cmocka_unit_test(focus_finds_an_instance),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
