/* What the glTF importer makes of a scene's image-based light (EXT_lights_image_based), seen as the renderer
 * sees it. */
#include "tests/unit/client/import/test_import.h"

#include "worker/render/light/light.h"

/* 2 x 2 texels: red, green; blue, grey 188 with alpha 51 */
#define PNG_URI                                                                                              \
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAYAAABytg0kAAAAFklEQVR4nGP4z8DwHwyB9P89e/"       \
    "YYAwBGoQhi2ARC4gAAAABJRU5ErkJggg=="

#define TRIANGLE                                                                                             \
    "\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{"                \
    "\"attributes\":{\"POSITION\":0}}]}],\"buffers\":[{\"uri\":\"p.bin\",\"byteLength\":36}],"               \
    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"accessors\":[{\"bufferView\":0,"                   \
    "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}],"                                                \
    "\"extensionsRequired\":[\"EXT_lights_image_based\"],"

static void write_pfm(bench_t *bench, const char *name, const char *head, const float *values, size_t count)
{
    char file[64];
    size_t used = strlen(head);
    memcpy(file, head, used);
    memcpy(file + used, values, count * sizeof *values);
    bench_write(bench, name, file, used + count * sizeof *values);
}

/* A scene with one light of these properties; images 0 to 5 are faces of one texel each, 6 the PNG, 7 has
 * four texels, 8 is no square, 9 no image. */
static void run(bench_t *bench, const char *light)
{
    static const float points[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    bench_write(bench, "p.bin", points, sizeof points);
    for (int i = 0; i < 6; ++i) {
        char name[8];
        snprintf(name, sizeof name, "%d.pfm", i);
        write_pfm(bench, name, "PF\n1 1\n-1\n", (float[]){(float)i + 1, i == 4 ? 7 : 0, 0}, 3);
    }
    /* 1 2 above 3 4: PFM has the lower row first */
    write_pfm(bench, "four.pfm", "Pf\n2 2\n-1\n", (float[]){3, 4, 1, 2}, 4);
    write_pfm(bench, "two.pfm", "Pf\n2 1\n-1\n", (float[]){1, 2}, 2);
    char *text = mem_printf(
        "{" TRIANGLE
        "\"scenes\":[{},{\"nodes\":[0],\"extensions\":{\"EXT_lights_image_based\":{\"light\":0}}}],"
        "\"scene\":1,\"extensions\":{\"EXT_lights_image_based\":{\"lights\":[{%s}]}},"
        "\"images\":[{\"uri\":\"0.pfm\"},{\"uri\":\"1.pfm\"},{\"uri\":\"2.pfm\"},{\"uri\":\"3.pfm\"},"
        "{\"uri\":\"4.pfm\"},{\"uri\":\"5.pfm\"},{\"uri\":\"" PNG_URI "\"},{\"uri\":\"four.pfm\"},"
        "{\"uri\":\"two.pfm\"},{\"uri\":\"p.bin\"}]}",
        light);
    bench_write(bench, "s.gltf", text, strlen(text));
    bench_import_file(bench, "s.gltf");
    free(text);
}

/* What comes from a direction. */
static rgb_t seen(const bench_t *bench, vec3_t w)
{
    scene_t *scene;
    light_hit_t hit;
    rgb_t sum = vec3(0, 0, 0);
    assert_int_equal(scene_new(&bench->blob, &scene).code, RESULT_OK);
    lights_t *lights = lights_new(scene);
    assert_int_equal(lights_sky_count(lights), 1);
    if (lights_escape(lights, 0, vec3(0, 0, 0), v_normalize(w), &hit)) sum = hit.radiance;
    lights_destroy(&lights);
    scene_destroy(&scene);
    return sum;
}

static const vec3_t axes[6] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
#define CUBE "\"specularImages\":[[0,1,2,3,4,5],[6,6,6,6,6,6]]"

static void faces_come_from_their_axes(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, CUBE ",\"intensity\":2");
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 2); /* the other scene, the camera */
    for (int i = 0; i < 6; ++i) {
        rgb_t radiance = seen(&bench, v_add(axes[i], vec3(0.2f, 0.1f, -0.3f)));
        expect_near((double)radiance.x, 2 * (i + 1), 1e-4);
        expect_near((double)radiance.y, i == 4 ? 14 : 0, 1e-4);
    }
    /* a quarter turn about y takes +z to +x, +x to -z */
    run(&bench, CUBE ",\"rotation\":[0,0.70710678,0,0.70710678]");
    bench_expect_ok(&bench);
    expect_near((double)seen(&bench, axes[0]).x, 5, 1e-4);
    expect_near((double)seen(&bench, axes[5]).x, 1, 1e-4);
    expect_near((double)seen(&bench, axes[2]).x, 3, 1e-4);
    bench_close(&bench);
}

/* As OpenGL's specification has them. */
static void faces_lie_as_in_opengl(void **state)
{
    (void)state;
    static const vec3_t right[6] = {{0, 0, -1}, {0, 0, 1}, {1, 0, 0}, {1, 0, 0}, {1, 0, 0}, {-1, 0, 0}},
                        down[6] = {{0, -1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}, {0, -1, 0}, {0, -1, 0}};
    bench_t bench = {0};
    run(&bench, "\"specularImages\":[[7,7,7,7,7,7]]");
    bench_expect_ok(&bench);
    for (int face = 0; face < 6; ++face)
        for (int i = 0; i < 4; ++i) {
            vec3_t w = v_mad(axes[face], i % 2 ? 0.5f : -0.5f, right[face]);
            rgb_t radiance = seen(&bench, v_mad(w, i / 2 ? 0.5f : -0.5f, down[face]));
            expect_near((double)radiance.x, i + 1, 0.05);
        }
    bench_close(&bench);
}

/* Colours are encoded as in PNGs, and divided by the alpha. */
static void pngs_with_alpha_are_rgbd(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, "\"specularImages\":[[6,6,6,6,6,6]]");
    bench_expect_ok(&bench);
    expect_near((double)seen(&bench, vec3(0.5f, -0.5f, 1)).x, 0.502886 / 0.2, 0.05);
    rgb_t red = seen(&bench, vec3(-0.6f, 0.6f, 1));
    expect_near((double)red.x, 1, 0.01);
    expect_near((double)red.y, 0, 0.01);
    bench_close(&bench);
}

static void an_environment_takes_its_place(void **state)
{
    (void)state;
    bench_t bench = {0};
    import_wishes_t wishes = import_wishes_none();
    wishes.environment = "4,5,6";
    bench.wishes = &wishes;
    run(&bench, "\"specularImages\":[[9]]"); /* is not even read */
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "lights[0]: gives way to --environment");
    expect_vec3(seen(&bench, axes[0]), 4, 5, 6);
    bench_close(&bench);
}

static void what_is_no_cube_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *light, *expected;
    } cases[] = {
        {"\"specularImages\":[[0,1,2,3,4]]", "[0]: must be the 6 faces of a cube, found 5"},
        {"\"specularImages\":[3]", "[0]: must be an array"},
        {"\"specularImages\":[[0,1,2,3,4,10]]", "element 5 must be the index of one of the 10 images"},
        {"\"specularImages\":[[0,1,-2,3,4,5]]", "element 2 must be the index"},
        {"\"specularImages\":[[0,1,2,3,4,7]]", "images[7]: has 2 x 2 pixels; the faces of a cube"},
        {"\"specularImages\":[[8,8,8,8,8,8]]", "images[8]: has 2 x 1 pixels"},
        {"\"specularImages\":[[9,9,9,9,9,9]]", "images[9]: "},
        {CUBE ",\"rotation\":[0,1,0]", "rotation: must be 4 numbers, found 3"}};
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        run(&bench, cases[i].light);
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, cases[i].expected);
    }
    run(&bench, "\"specularImages\":[]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "lights[0]: has no specularImages");
    bench.lenient = true;
    run(&bench, cases[0].light);
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "the scene's surroundings are left out");
    expect_vec3(seen(&bench, axes[0]), 1, 1, 1); /* the white sky of a scene without light */
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(faces_come_from_their_axes), cmocka_unit_test(faces_lie_as_in_opengl),
        cmocka_unit_test(pngs_with_alpha_are_rgbd),   cmocka_unit_test(an_environment_takes_its_place),
        cmocka_unit_test(what_is_no_cube_is_refused),
    };
    return cmocka_run_group_tests_name("image-based lights of glTF", tests, NULL, NULL);
}
