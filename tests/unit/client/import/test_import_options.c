/* What the pbrt importer makes of cameras, films, filters, integrators, and their motion. */
#include "tests/unit/client/import/test_import.h"

/* Imports a scene of these options, with one light. */
static const blob_scene_t *run(bench_t *bench, bool v4, const char *options)
{
    char *text = mem_printf("%s\nWorldBegin\nLightSource \"point\"\n%s", options, v4 ? "" : "WorldEnd\n");
    char *whole = mem_printf("%s%s", v4 ? "ColorSpace \"srgb\"\n" : "", text);
    bench_run(bench, whole);
    free(whole);
    free(text);
    return bench->blob.scene;
}

static void expect_error(bench_t *bench, bool v4, const char *options, const char *message)
{
    run(bench, v4, options);
    assert_int_equal(bench->result.code, RESULT_INPUT);
    expect_text(bench->result.message, message);
}

static void expect_four(const float numbers[4], double a, double b, double c, double d)
{
    expect_near((double)numbers[0], a, 1e-6);
    expect_near((double)numbers[1], b, 1e-6);
    expect_near((double)numbers[2], c, 1e-6);
    expect_near((double)numbers[3], d, 1e-6);
}

/* ---- cameras ------------------------------------------------------------------------------------------- */

static void what_is_not_said_has_its_default(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene = run(&bench, false, "");
    bench_expect_silence(&bench);
    assert_int_equal(scene->camera, CAMERA_PERSPECTIVE);
    expect_near((double)scene->fov, 90, 0);
    expect_near((double)scene->lens_radius, 0, 0);
    expect_near((double)scene->focal_distance, 1e6, 0);
    expect_four(scene->film_window, 0, 1, 0, 1);
    expect_four(scene->screen_window, 0, 0, 0, 0);
    assert_true(isinf(scene->max_luminance));
    assert_int_equal(scene->regularize, 0);
    assert_memory_equal(&scene->world_from_camera, &scene->world_from_camera_end, sizeof(xform_t));
    bench_close(&bench);
}

static void a_lens_has_its_focus_and_radius(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene =
        run(&bench, false,
            "Camera \"perspective\" \"float lensradius\" .5 \"float focaldistance\" 7 \"float fov\" 30");
    bench_expect_silence(&bench);
    expect_near((double)scene->lens_radius, 0.5, 0);
    expect_near((double)scene->focal_distance, 7, 0);
    expect_near((double)scene->fov, 30, 0);
    expect_error(&bench, false, "Camera \"perspective\" \"float lensradius\" .5 \"float focaldistance\" 0",
                 "focaldistance is 0");
    expect_error(&bench, false, "Camera \"perspective\" \"float lensradius\" -1", "lensradius");
    bench_close(&bench);
}

static void other_cameras_become_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene =
        run(&bench, false, "Camera \"orthographic\" \"float screenwindow\" [-3 3 -2 2]");
    bench_expect_silence(&bench);
    assert_int_equal(scene->camera, CAMERA_ORTHOGRAPHIC);
    expect_four(scene->screen_window, -3, 3, -2, 2);
    assert_int_equal(run(&bench, false, "Camera \"environment\"")->camera, CAMERA_SPHERICAL);
    bench_expect_silence(&bench);
    assert_int_equal(run(&bench, true, "Camera \"spherical\"")->camera, CAMERA_EQUAL_AREA);
    assert_int_equal(run(&bench, true, "Camera \"spherical\" \"string mapping\" \"equirectangular\"")->camera,
                     CAMERA_SPHERICAL);
    expect_error(&bench, true, "Camera \"spherical\" \"string mapping\" \"cube\"", "cube");
    expect_error(&bench, false, "Camera \"realistic\" \"string lensfile\" \"l.dat\"", "l.dat");
    expect_error(&bench, false, "Camera \"realistic\"", "needs a \"lensfile\"");
    bench.lenient = true;
    assert_int_equal(run(&bench, false, "Camera \"realistic\" \"string lensfile\" \"l.dat\"")->camera,
                     CAMERA_PERSPECTIVE);
    expect_text(bench.warnings, "a perspective camera of 90 degrees is used");
    bench_close(&bench);
}

/* pbrt's rays start on the lens, and meet the film's place in the plane of focus. */
static void a_lens_gives_an_orthographic_camera_perspective(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene = run(&bench, false,
                                    "Camera \"orthographic\" \"float screenwindow\" [-3 3 -2 2] \"float "
                                    "lensradius\" .5 \"float focaldistance\" 7");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "all rays start on the lens");
    assert_int_equal(scene->camera, CAMERA_PERSPECTIVE);
    expect_four(scene->screen_window, -3, 3, -2, 2);
    expect_near(7 * tan((double)scene->fov * M_PI / 360), 1, 1e-6);
    expect_near((double)scene->lens_radius, 0.5, 0);
    expect_near((double)scene->focal_distance, 7, 0);
    static const char *const distances[] = {"1e-4", "1e9"};
    for (size_t i = 0; i < ARRAY_LENGTH(distances); ++i) {
        char *camera = mem_printf("Camera \"orthographic\" \"float lensradius\" 1 \"float focaldistance\" %s",
                                  distances[i]);
        expect_error(&bench, true, camera, "needs a focaldistance from 1e-3 to 1e8");
        free(camera);
    }
    bench_close(&bench);
}

static void a_camera_may_move(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene =
        run(&bench, false,
            "TransformTimes 0 2\nTranslate 0 0 -1 ActiveTransform EndTime Translate -4 0 0 "
            "ActiveTransform All\nCamera \"perspective\" \"float shutterclose\" 1\n");
    bench_expect_silence(&bench);
    expect_vec3(xform_point(&scene->world_from_camera, vec3(0, 0, 0)), 0, 0, 1);
    expect_vec3(xform_point(&scene->world_from_camera_end, vec3(0, 0, 0)), 2, 0, 1);
    expect_error(&bench, false, "TransformTimes 1 0", "must not come after");
    bench_close(&bench);
}

/* The coordinates of the camera keep both of its places, and WorldBegin makes all transforms active again. */
static void camera_coordinates_keep_both_places(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(
        &bench,
        "ActiveTransform EndTime Translate -4 0 0\nCamera \"perspective\"\nWorldBegin\n"
        "LightSource \"point\" CoordSysTransform \"camera\" Translate 0 1 0 Shape \"sphere\"\nWorldEnd\n");
    bench_expect_silence(&bench);
    expect_vec3(xform_point(&bench.blob.instances[0].world_from_object, vec3(0, 0, 0)), 0, 1, 0);
    expect_vec3(xform_point(&bench.blob.instances[0].world_from_object_end, vec3(0, 0, 0)), 4, 1, 0);
    bench_close(&bench);
}

/* ---- film ---------------------------------------------------------------------------------------------- */

static void a_crop_is_a_part_of_the_film(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene = run(&bench, false,
                                    "Film \"image\" \"integer xresolution\" 100 \"integer yresolution\" 50 "
                                    "\"float cropwindow\" [.101 .5 1 0.25]");
    bench_expect_silence(&bench);
    assert_int_equal(scene->width, 39);  /* from pixel 11 to 50 */
    assert_int_equal(scene->height, 37); /* from 13 to 50 */
    expect_four(scene->film_window, 0.11, 0.5, 0.26, 1);
    expect_four(scene->screen_window, -2, 2, -1, 1); /* of the whole film */
    scene = run(&bench, true,
                "Film \"rgb\" \"integer xresolution\" 100 \"integer yresolution\" 200 "
                "\"integer pixelbounds\" [20 30 -5 150]");
    bench_expect_silence(&bench);
    assert_int_equal(scene->width, 10);
    assert_int_equal(scene->height, 150);
    expect_four(scene->film_window, 0.2, 0.3, 0, 0.75);
    expect_four(scene->screen_window, -1, 1, -2, 2);
    scene = run(&bench, false,
                "Film \"image\" \"float cropwindow\" [0 .5 0 .5]\nCamera \"perspective\" "
                "\"float frameaspectratio\" 3");
    expect_four(scene->screen_window, -3, 3, -1, 1);
    scene = run(&bench, false, "Film \"image\" \"float cropwindow\" [0 1 0 1]");
    expect_four(scene->screen_window, 0, 0, 0, 0);
    expect_error(&bench, false, "Film \"image\" \"float cropwindow\" [.5 .5 0 1]", "no pixel is left");
    expect_error(&bench, false, "Film \"image\" \"float cropwindow\" [0 1 0]", "found 3 numbers");
    expect_error(&bench, true, "Film \"rgb\" \"integer pixelbounds\" [0 1e30 0 1]", "pixelbounds takes");
    expect_error(&bench, true, "Film \"rgb\" \"integer pixelbounds\" [5000 6000 0 1]", "no pixel is left");
    bench_close(&bench);
}

static void films_have_their_size_and_scale(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, true, "Film \"gbuffer\" \"integer xresolution\" 7");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "only its picture");
    assert_int_equal(bench.blob.scene->width, 7);
    expect_error(&bench, true, "Film \"spectral\" \"integer nbuckets\" 3", "spectral");
    bench.lenient = true;
    run(&bench, true, "Film \"spectral\" \"integer nbuckets\" 3");
    bench_expect_ok(&bench);
    bench_close(&bench);
}

/* ---- filters ------------------------------------------------------------------------------------------- */

static void filters_become_ours(void **state)
{
    (void)state;
    static const struct {
        bool v4;
        const char *text;
        filter_kind_t kind;
        double radius, a, b;
    } cases[] = {
        {false, "PixelFilter \"box\"", FILTER_BOX, 0.5, 0, 0},
        {false, "PixelFilter \"triangle\"", FILTER_TRIANGLE, 2, 0, 0},
        {false, "PixelFilter \"gaussian\"", FILTER_GAUSSIAN, 2, 0.5, 0},
        {true, "PixelFilter \"gaussian\" \"float sigma\" .25", FILTER_GAUSSIAN, 1.5, 0.25, 0},
        {false, "PixelFilter \"mitchell\"", FILTER_MITCHELL, 2, 1.0 / 3, 1.0 / 3},
        {true, "PixelFilter \"mitchell\" \"float B\" 1 \"float C\" 0 \"float xradius\" 3", FILTER_MITCHELL, 3,
         1, 0},
        {false, "PixelFilter \"sinc\"", FILTER_SINC, 4, 3, 0},
        {false, "PixelFilter \"sinc\" \"float tau\" 2 \"float xwidth\" 5", FILTER_SINC, 5, 2, 0},
    };
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench_t bench = {0};
        const blob_filter_t *filter = &run(&bench, cases[i].v4, cases[i].text)->filter;
        bench_expect_ok(&bench);
        assert_int_equal(filter->kind, cases[i].kind);
        expect_near((double)filter->radius_x, cases[i].radius, 1e-6);
        expect_near((double)filter->parameters[0], cases[i].a, 1e-6);
        expect_near((double)filter->parameters[1], cases[i].b, 1e-6);
        bench_close(&bench);
    }
}

/* ---- integrators --------------------------------------------------------------------------------------- */

static void integrators_are_read_with_their_depth(void **state)
{
    (void)state;
    bench_t bench = {0};
    assert_int_equal(run(&bench, true, "Integrator \"path\" \"bool regularize\" true")->regularize, 1);
    assert_int_equal(run(&bench, true, "Integrator \"bdpt\"")->regularize, 0);
    expect_error(&bench, false, "Integrator \"path\" \"integer pixelbounds\" [0 1 0 1]", "cropwindow");
    bench_close(&bench);
}

static void ambient_occlusion_is_as_bright_as_in_pbrt(void **state)
{
    (void)state;
    bench_t bench = {0};
    const blob_scene_t *scene = run(&bench, true, "Integrator \"ambientocclusion\" \"float maxdistance\" 3");
    bench_expect_silence(&bench);
    assert_int_equal(scene->integrator, INTEGRATOR_AO);
    expect_near((double)scene->occlusion_distance, 3, 0);
    expect_near((double)scene->occlusion_radiance.y, 1, 0);
    scene = run(&bench, true,
                "Integrator \"ambientocclusion\" \"bool cossample\" false Film \"rgb\" \"float iso\" 50");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "only the noise differs");
    assert_true(isinf(scene->occlusion_distance));
    expect_near((double)scene->occlusion_radiance.y, 0.5, 0);
    scene = run(&bench, false,
                "Sampler \"random\" \"integer pixelsamples\" 3 Integrator \"ambientocclusion\" \"integer "
                "nsamples\" 10 Film \"image\" \"float scale\" 2");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "10 rays in each of 3 samples a pixel: it becomes 30 samples");
    expect_near((double)scene->occlusion_radiance.y, 2 * M_PI, 1e-6);
    assert_int_equal(scene->spp, 30);
    expect_error(&bench, true, "Integrator \"ambientocclusion\" \"float maxdistance\" 0", "maxdistance");
    expect_error(&bench, false, "Integrator \"ambientocclusion\" \"integer nsamples\" 0", "nsamples");
    bench_close(&bench);
}

/* ---- progress ------------------------------------------------------------------------------------------ */

typedef struct {
    int calls;
    double last;
} progress_log_t;

static void note_progress(void *context, double fraction)
{
    progress_log_t *seen = context;
    assert_true(fraction >= 0 && fraction <= 1);
    ++seen->calls;
    seen->last = fraction;
}

static void progress_is_told(void **state)
{
    (void)state;
    enum { LINES = 20000 };
    static const char line[] = "Shape \"sphere\" \"float radius\" 1\n";
    static const char head[] = "WorldBegin LightSource \"point\"\n", tail[] = "WorldEnd\n";
    char *text = mem_alloc(sizeof head + LINES * sizeof line + sizeof tail), *end = text;
    end = stpcpy(end, head);
    for (int i = 0; i < LINES; ++i) end = stpcpy(end, line);
    stpcpy(end, tail);
    bench_t bench = {0};
    bench_write(&bench, "s.pbrt", text, strlen(text));
    char *path = bench_path(&bench, "s.pbrt");
    progress_log_t seen = {0};
    import_report_t report = {.context = &seen, .progress = note_progress};
    bench.result = import_scene_blob(path, &report, &bench.bytes, &bench.size);
    bench_expect_ok(&bench);
    assert_true(seen.calls >= 5 && seen.calls <= 20);
    assert_true(seen.last > 0.85);
    free(path);
    free(text);
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_not_said_has_its_default),
        cmocka_unit_test(a_lens_has_its_focus_and_radius),
        cmocka_unit_test(other_cameras_become_ours),
        cmocka_unit_test(a_lens_gives_an_orthographic_camera_perspective),
        cmocka_unit_test(a_camera_may_move),
        cmocka_unit_test(camera_coordinates_keep_both_places),
        cmocka_unit_test(a_crop_is_a_part_of_the_film),
        cmocka_unit_test(films_have_their_size_and_scale),
        cmocka_unit_test(filters_become_ours),
        cmocka_unit_test(integrators_are_read_with_their_depth),
        cmocka_unit_test(ambient_occlusion_is_as_bright_as_in_pbrt),
        cmocka_unit_test(progress_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
