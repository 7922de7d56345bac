/* What --environment makes of a scene: colours, images and skies, seen as the renderer sees them. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/environment/sky.h"
#include "worker/render/light/light.h"

#define SPHERE "WorldBegin\nShape \"sphere\"\nWorldEnd\n"
#define LIT "WorldBegin\nLightSource \"infinite\"\nLightSource \"point\"\nShape \"sphere\"\nWorldEnd\n"

/* The lights of an imported scene, ready to be asked. */
typedef struct {
    bench_t bench;
    import_wishes_t wishes;
    scene_t *scene;
    lights_t *lights;
} lit_t;

static void light(lit_t *lit, const char *text, const char *environment)
{
    lit->wishes.environment = environment;
    lit->bench.wishes = &lit->wishes;
    bench_run(&lit->bench, text);
    bench_expect_ok(&lit->bench);
    assert_int_equal(scene_new(&lit->bench.blob, &lit->scene).code, RESULT_OK);
    lit->lights = lights_new(lit->scene);
}

static void unlight(lit_t *lit)
{
    lights_destroy(&lit->lights);
    scene_destroy(&lit->scene);
}

/* What comes from a direction. */
static rgb_t seen(const lit_t *lit, double x, double y, double z)
{
    rgb_t sum = vec3(0, 0, 0);
    light_hit_t hit;
    vec3_t w = v_normalize(vec3((float)x, (float)y, (float)z));
    for (uint32_t k = 0; k < lights_sky_count(lit->lights); ++k)
        if (lights_escape(lit->lights, k, vec3(0, 0, 0), w, &hit)) sum = v_add(sum, hit.radiance);
    return sum;
}

/* The irradiance on a surface that faces `up`, by drawing places as the renderer does. */
static double irradiance(const lit_t *lit, vec3_t up)
{
    enum { SIDE = 100 };
    double sum = 0;
    for (int i = 0; i < SIDE * SIDE; ++i) {
        light_view_t view;
        vec2_t place = {((float)(i % SIDE) + 0.5f) / SIDE, ((float)(i / SIDE) + 0.5f) / SIDE};
        double golden = 0.6180339887498949 * i;
        if (lights_illuminate(lit->lights, vec3(0, 0, 0), (float)(golden - floor(golden)), place, &view))
            sum += (double)(rgb_luminance(view.radiance) * float_max(v_dot(view.w, up), 0) / view.pdf_place);
    }
    return sum / (SIDE * SIDE);
}

static void a_colour_comes_from_everywhere(void **state)
{
    (void)state;
    lit_t lit = {.wishes = import_wishes_none()};
    lit.wishes.environment_factor = 2;
    light(&lit, SPHERE, "1,2,.5");
    bench_expect_silence(&lit.bench);
    assert_int_equal(lights_sky_count(lit.lights), 1);
    expect_vec3(seen(&lit, 1, -2, 3), 2, 4, 1);
    unlight(&lit);
    bench_close(&lit.bench);
}

/* 16 x 8 pixels: the middle two columns are red, those at three quarters green, the top rows blue. */
static void write_image(lit_t *lit)
{
    static const char head[] = "PF\n16 8\n-1.0\n";
    struct {
        char head[sizeof head - 1];
        uint8_t pixels[8 * 16 * 12];
    } file;
    memcpy(file.head, head, sizeof file.head);
    for (int i = 0; i < 8 * 16; ++i) {
        int x = i % 16, y = 7 - i / 16; /* PFM begins at the bottom */
        const float rgb[3] = {x == 7 || x == 8, x == 11 || x == 12, y < 2};
        memcpy(file.pixels + 12 * i, rgb, sizeof rgb);
    }
    bench_write(&lit->bench, "sky.pfm", &file, sizeof file);
}

static void an_image_lies_as_in_cycles(void **state)
{
    (void)state;
    lit_t lit = {.wishes = import_wishes_none()};
    write_image(&lit);
    char *path = bench_path(&lit.bench, "sky.pfm");
    light(&lit, SPHERE, path);
    bench_expect_silence(&lit.bench);
    expect_vec3(seen(&lit, 1, 0, 0), 1, 0, 0);
    expect_vec3(seen(&lit, 0, 0, 1), 0, 1, 0);
    expect_vec3(seen(&lit, 0.01, 0.3, 0.01), 0, 0, 1);
    unlight(&lit);
    lit.wishes.environment_turn = 90; /* counter-clockwise from above: from +x to -z */
    light(&lit, SPHERE, path);
    expect_vec3(seen(&lit, 0, 0, -1), 1, 0, 0);
    expect_vec3(seen(&lit, 1, 0, 0), 0, 1, 0);
    unlight(&lit);
    lit.wishes.environment_up = "z"; /* from +x to +y */
    light(&lit, SPHERE, path);
    expect_vec3(seen(&lit, 0, 1, 0), 1, 0, 0);
    expect_vec3(seen(&lit, 1, 0, 0), 0, 1, 0);
    expect_vec3(seen(&lit, 0.01, 0.01, 0.3), 0, 0, 1);
    unlight(&lit);
    free(path);
    bench_close(&lit.bench);
}

/* sky.h promises an irradiance of pi on flat ground, most of it from the sun where that is high. */
static void a_sky_makes_flat_white_ground_as_bright_as_1(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        double elevation;
    } skies[] = {{"sky:0", 0}, {"sky:10", 10}, {"sky", 40}, {"sky:90", 90}};
    double warmth = INFINITY;
    for (size_t i = 0; i < ARRAY_LENGTH(skies); ++i) {
        lit_t lit = {.wishes = import_wishes_none()};
        light(&lit, SPHERE, skies[i].text);
        bench_expect_silence(&lit.bench);
        expect_near(irradiance(&lit, vec3(0, 1, 0)), 3.14159265, 0.03);
        expect_near((double)rgb_luminance(seen(&lit, 0.1, -1, 0.2)), 0.2, 0.002); /* the ground */
        double angle = skies[i].elevation * 3.14159265 / 180, off = angle + 0.006;
        rgb_t sun = seen(&lit, cos(angle), sin(angle), 0), beside = seen(&lit, cos(off), sin(off), 0);
        assert_true(sun.x > (skies[i].elevation > 0 ? 100 : 2) * beside.x);
        if (skies[i].elevation > 0) assert_true((double)(sun.x / sun.z) < warmth); /* redder when low */
        if (skies[i].elevation > 0) warmth = (double)(sun.x / sun.z);
        rgb_t zenith = seen(&lit, -0.3, 1, 0);
        assert_true(zenith.z > zenith.x);
        unlight(&lit);
        bench_close(&lit.bench);
    }
}

/* The sun is as bright as its irradiance says, and the sky as bright as measured clear skies: 60 to 80 klx
 * with the sun 40 degrees high. */
static void a_sky_has_the_light_of_nature(void **state)
{
    (void)state;
    sky_t sky;
    sky_init(&sky, 40, SKY_TURBIDITY);
    assert_true(sky.illuminance > 60 && sky.illuminance < 80);
    /* Their zenith luminance at turbidity 3: (4.0453 T - 4.9710) tan chi - 0.2155 T + 2.4192. */
    double zenith = (double)rgb_luminance(sky_radiance(&sky, (double[3]){0, 1, 0}));
    expect_near(zenith / (double)sky.scale, 6.52, 0.01);
    lit_t lit = {.wishes = import_wishes_none()};
    lit.wishes.environment_factor = 3;
    light(&lit, SPHERE, "sky:40");
    double sum = 0;
    for (int i = 0; i < 4000; ++i) { /* rings about the sun */
        double angle = (i + 0.5) * 0.006 / 4000, c = cos(angle), s = sin(angle);
        double w[3] = {sky.sun[0] * c - sky.sun[1] * s, sky.sun[1] * c + sky.sun[0] * s, 0};
        double sun = (double)rgb_luminance(seen(&lit, w[0], w[1], w[2])) / 3;
        sun -= (double)rgb_luminance(sky_radiance(&sky, w));
        sum += sun * 2 * 3.14159265 * s * 0.006 / 4000;
    }
    double wanted = (double)rgb_luminance(sky.sun_irradiance);
    expect_near(sum, wanted, 0.005 * wanted);
    unlight(&lit);
    bench_close(&lit.bench);
}

static void the_scene_s_own_environment_gives_way(void **state)
{
    (void)state;
    lit_t lit = {.wishes = import_wishes_none()};
    light(&lit, LIT, "0,0,2");
    expect_text(lit.bench.warnings,
                "--environment: takes the place of the scene's own environment (1 lights)");
    expect_vec3(seen(&lit, 0, 1, 0), 0, 0, 2);
    assert_int_equal(lit.bench.blob.lights[1].kind, LIGHT_POINT);
    expect_vec3(lit.bench.blob.lights[1].radiance.factor, 1, 1, 1);
    unlight(&lit);
    bench_close(&lit.bench);
}

static void a_blob_can_be_given_one_too(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, LIT);
    bench_expect_ok(&bench);
    import_wishes_t wishes = import_wishes_none();
    assert_false(import_changes_blobs(&wishes));
    wishes.environment = "4,5,6";
    assert_true(import_changes_blobs(&wishes));
    import_report_t report = {.warn = bench_warn, .context = &bench, .wishes = &wishes};
    int file;
    scene_blob_t blob;
    assert_int_equal(import_changed_file(&bench.blob, &report, &file).code, RESULT_OK);
    assert_int_equal(blob_open_descriptor(file, "it", &blob).code, RESULT_OK);
    close(file);
    assert_int_equal(blob.counts[BLOB_SECTION_LIGHTS], 3);
    expect_vec3(blob.lights[2].radiance.factor, 4, 5, 6);
    /* and is the one that importing with the wish makes */
    bench.wishes = &wishes;
    bench_run(&bench, LIT);
    assert_int_equal(bench.size, blob.size);
    assert_memory_equal(bench.bytes, blob.bytes, blob.size);
    blob_close(&blob);
    bench_close(&bench);
}

static void what_is_no_environment_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *message;
        int code;
    } cases[] = {{"sky:91", "0 to 90 degrees, not '91'", RESULT_USAGE},
                 {"sky:", "0 to 90 degrees, not ''", RESULT_USAGE},
                 {"sky:4x", "0 to 90 degrees, not '4x'", RESULT_USAGE},
                 {"1,2,-3", "takes numbers from 0 to 1e20", RESULT_USAGE},
                 {"1,2", "there is no image '1,2' that can be read", RESULT_INPUT},
                 {"skyline.hdr", "there is no image 'skyline.hdr'", RESULT_INPUT},
                 {"README.md", "README.md", RESULT_INPUT}};
    import_wishes_t wishes = import_wishes_none();
    bench_t bench = {.wishes = &wishes};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        wishes.environment = cases[i].text;
        bench_run(&bench, SPHERE);
        assert_int_equal(bench.result.code, cases[i].code);
        expect_text(bench.result.message, cases[i].message);
        expect_text(bench.result.message, "--environment");
    }
    bench_close(&bench);
}

/* Of a scene and of a blob, which is not read again where nothing changes it. */
static void how_an_environment_stands_says_nothing_without_one(void **state)
{
    (void)state;
    for (int i = 0; i < 3; ++i) {
        import_wishes_t wishes = import_wishes_none();
        bench_t bench = {.wishes = &wishes};
        if (i == 0) wishes.environment_turn = 10;
        if (i == 1) wishes.environment_factor = 2;
        if (i == 2) wishes.environment_up = "z";
        assert_true(import_changes_blobs(&wishes));
        bench_run(&bench, SPHERE);
        assert_int_equal(bench.result.code, RESULT_USAGE);
        expect_text(bench.result.message, "need --environment");
        bench_close(&bench);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_colour_comes_from_everywhere),
        cmocka_unit_test(an_image_lies_as_in_cycles),
        cmocka_unit_test(a_sky_makes_flat_white_ground_as_bright_as_1),
        cmocka_unit_test(a_sky_has_the_light_of_nature),
        cmocka_unit_test(the_scene_s_own_environment_gives_way),
        cmocka_unit_test(a_blob_can_be_given_one_too),
        cmocka_unit_test(what_is_no_environment_is_refused),
        cmocka_unit_test(how_an_environment_stands_says_nothing_without_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
