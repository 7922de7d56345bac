/* What the pbrt importer makes of lights that have no surface, in both dialects. */
#include "tests/unit/client/import/test_import.h"

static const double pi = 3.14159265358979323846;

static const blob_light_t *light(const bench_t *bench, uint64_t index)
{
    assert_true(index < bench->blob.counts[BLOB_SECTION_LIGHTS]);
    return &bench->blob.lights[index];
}

static void run(bench_t *bench, bool v4, const char *world)
{
    char *text = mem_printf(v4 ? "Film \"rgb\"\nWorldBegin\n%s\n" : "WorldBegin\n%s\nWorldEnd\n", world);
    bench_run(bench, text);
    free(text);
}

static void write_pfm(bench_t *bench, const char *name, int width, int height, const float *rgb_from_bottom)
{
    char head[64];
    int length = snprintf(head, sizeof head, "PF\n%d %d\n-1\n", width, height);
    size_t size = (size_t)(width * height) * 12;
    char *file = mem_alloc((size_t)length + size);
    memcpy(file, head, (size_t)length);
    memcpy(file + length, rgb_from_bottom, size);
    bench_write(bench, name, file, (size_t)length + size);
    free(file);
}

static vec3_t origin(const blob_light_t *l)
{
    return xform_point(&l->world_from_light, vec3(0, 0, 0));
}

static vec3_t axis(const blob_light_t *l, float x, float y, float z)
{
    return xform_vector(&l->world_from_light, vec3(x, y, z));
}

/* A light's frame keeps lengths, apart from what it mirrors. */
static void expect_rigid(const blob_light_t *l)
{
    const vec3_t x = axis(l, 1, 0, 0), y = axis(l, 0, 1, 0), z = axis(l, 0, 0, 1);
    expect_near((double)v_length(x), 1, 1e-5);
    expect_near((double)v_length(y), 1, 1e-5);
    expect_near((double)v_length(z), 1, 1e-5);
    expect_near((double)v_dot(x, y), 0, 1e-5);
    expect_near((double)v_dot(y, z), 0, 1e-5);
    expect_near((double)v_dot(z, x), 0, 1e-5);
}

/* ---- at a point ---------------------------------------------------------------------------------------- */

static void a_point_light_becomes_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false,
        "Scale 2 2 2 LightSource \"point\" \"rgb I\" [1 2 3] \"rgb scale\" [2 2 2] \"point from\" [1 0 0]");
    bench_expect_silence(&bench);
    assert_int_equal(light(&bench, 0)->kind, LIGHT_POINT);
    expect_vec3(light(&bench, 0)->radiance.factor, 2, 4, 6);
    expect_vec3(origin(light(&bench, 0)), 1, 0, 0); /* pbrt-v3: the origin, and "from" in the world */
    run(&bench, false, "Translate 0 5 0 Rotate 90 0 0 1 LightSource \"point\" \"point from\" [1 2 3]");
    expect_vec3(origin(light(&bench, 0)), 1, 7, 3);
    run(&bench, true, "Scale 2 2 2 LightSource \"point\" \"point3 from\" [1 0 0]");
    expect_vec3(origin(light(&bench, 0)), 2, 0, 0);
    run(&bench, true, "LightSource \"point\" \"rgb I\" [1 1 .5] \"float scale\" 2 \"float power\" 100");
    bench_expect_silence(&bench);
    expect_near((double)light(&bench, 0)->radiance.factor.x, 2 * 100 / (4 * pi), 1e-4);
    expect_near((double)light(&bench, 0)->radiance.factor.z, 100 / (4 * pi), 1e-4);
    bench_close(&bench);
}

static void a_spot_light_has_its_cone(void **state)
{
    (void)state;
    bench_t bench = {0};
    for (int v4 = 0; v4 < 2; ++v4) {
        run(&bench, v4 != 0,
            "Translate 0 5 0 Scale 2 2 2 LightSource \"spot\" \"point3 from\" [1 0 0] "
            "\"point3 to\" [1 1 0] \"float coneangle\" 60 \"float conedeltaangle\" 15");
        bench_expect_silence(&bench);
        const blob_light_t *l = light(&bench, 0);
        assert_int_equal(l->kind, LIGHT_SPOT);
        assert_int_equal(l->flags, v4 ? LIGHT_SMOOTHSTEP : 0);
        expect_vec3(origin(l), 2, 5, 0);
        expect_vec3(axis(l, 0, 0, 1), 0, 1, 0);
        expect_rigid(l);
        expect_near((double)l->parameters[0], 0.5, 1e-6);
        expect_near((double)l->parameters[1], sqrt(0.5), 1e-6);
    }
    run(&bench, true,
        "LightSource \"spot\" \"float coneangle\" 60 \"float conedeltaangle\" 60 \"float power\" 7");
    bench_expect_silence(&bench); /* the mean of the smooth step over its range is a half */
    expect_near((double)light(&bench, 0)->radiance.factor.x, 7 / (2 * pi * 0.25), 1e-5);
    run(&bench, false, "LightSource \"spot\" \"float coneangle\" 20 \"float conedeltaangle\" 30");
    expect_near((double)light(&bench, 0)->parameters[1], cos(pi / 18), 1e-6);
    run(&bench, false, "LightSource \"spot\" \"point from\" [0 0 1]");
    expect_text(bench.result.message, "no direction");
    run(&bench, false, "Scale 1 2 1 LightSource \"spot\"");
    expect_text(bench.warnings, "its cone stays round");
    bench_close(&bench);
}

static void a_goniometric_light_has_its_image(void **state)
{
    (void)state;
    const float pixels[12] = {1, 2, 3, 1, 2, 3, 0, 0, 0, 4, 4, 4};
    bench_t bench = {0};
    write_pfm(&bench, "g.pfm", 2, 2, pixels);
    run(&bench, false, "Translate 1 2 3 LightSource \"goniometric\" \"string mapname\" \"g.pfm\"");
    bench_expect_silence(&bench);
    assert_int_equal(light(&bench, 0)->kind, LIGHT_GONIOMETRIC);
    assert_int_equal(light(&bench, 0)->mapping, LIGHT_LATLONG_Y);
    expect_vec3(origin(light(&bench, 0)), 1, 2, 3);
    expect_vec3(axis(light(&bench, 0), 0, 1, 0), 0, 1, 0);
    assert_int_equal(bench.blob.images[light(&bench, 0)->image - 1].format, TEXELS_RGB32F);

    run(&bench, true, "LightSource \"goniometric\" \"string filename\" \"g.pfm\" \"float power\" 10");
    bench_expect_silence(&bench);
    const blob_light_t *l = light(&bench, 0);
    assert_int_equal(l->mapping, LIGHT_OCTAHEDRAL);
    expect_vec3(axis(l, 0, 1, 0), 0, 0, 1); /* the map's pole is y */
    expect_vec3(axis(l, 0, 0, 1), 0, 1, 0);
    const blob_image_t *image = &bench.blob.images[l->image - 1];
    assert_int_equal(image->format, TEXELS_R32F);
    float grey[4];
    memcpy(grey, bench.blob.texels + image->first_word, sizeof grey);
    expect_near((double)grey[2], 4, 0); /* the right column comes second, in it the upper row first */
    expect_near((double)grey[1], 2, 0); /* the mean of 1, 2, 3 */
    expect_near((double)l->radiance.factor.x, 10 / (4 * pi * 2), 1e-6);

    run(&bench, true, "LightSource \"goniometric\"");
    expect_text(bench.warnings, "is a point light");
    assert_int_equal(light(&bench, 0)->kind, LIGHT_POINT);
    bench_close(&bench);
}

static void a_projection_light_has_its_image(void **state)
{
    (void)state;
    const float pixels[24] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
    bench_t bench = {0};
    write_pfm(&bench, "p.pfm", 4, 2, pixels);
    run(&bench, false,
        "Scale 3 3 3 LightSource \"projection\" \"string mapname\" \"p.pfm\" \"float fov\" 90");
    bench_expect_silence(&bench);
    const blob_light_t *l = light(&bench, 0);
    assert_int_equal(l->kind, LIGHT_PROJECTION);
    expect_near((double)l->parameters[0], -2, 1e-6);
    expect_near((double)l->parameters[1], 2, 1e-6);
    expect_near((double)l->parameters[2], -1, 1e-6);
    expect_near((double)l->parameters[3], 1, 1e-6);
    expect_rigid(l);
    expect_vec3(axis(l, 0, 1, 0), 0, -1, 0); /* v3 projects upside down */
    run(&bench, true,
        "LightSource \"projection\" \"string filename\" \"p.pfm\" \"float scale\" 3 \"float power\" 5");
    bench_expect_silence(&bench);
    l = light(&bench, 0);
    expect_vec3(axis(l, 0, 1, 0), 0, 1, 0);
    /* eight pixels of the window 4 x 2, at the cube of their cosines, each counted from its centre */
    double sum = 0;
    for (int i = 0; i < 8; ++i) {
        double x = -1.5 + i % 4, y = i < 4 ? 0.5 : -0.5;
        sum += pow(1 + x * x + y * y, -1.5);
    }
    expect_near((double)l->radiance.factor.x, 3 * 5 / sum, 1e-4);
    run(&bench, true, "LightSource \"projection\"");
    expect_text(bench.result.message, "needs its image");
    run(&bench, false, "LightSource \"projection\" \"float fov\" 60");
    bench_expect_silence(&bench);
    expect_near((double)light(&bench, 0)->parameters[3], tan(pi / 6), 1e-6);
    bench_close(&bench);
}

/* ---- at infinity --------------------------------------------------------------------------------------- */

static void a_distant_light_becomes_ours(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false,
        "Translate 7 0 0 Scale 1 4 1 LightSource \"distant\" \"rgb L\" [1 2 3] \"point from\" [0 1 3]");
    bench_expect_silence(&bench); /* from (0 1 3) to (0 0 1) is (0 4 2) of the world */
    const blob_light_t *l = light(&bench, 0);
    assert_int_equal(l->kind, LIGHT_DISTANT);
    expect_vec3(axis(l, 0, 0, 1), 0, 2 / sqrt(5), 1 / sqrt(5));
    expect_rigid(l);
    expect_vec3(l->radiance.factor, 1, 2, 3);
    run(&bench, true, "LightSource \"distant\" \"rgb L\" [1 2 3] \"float illuminance\" 10");
    bench_expect_silence(&bench);
    expect_vec3(light(&bench, 0)->radiance.factor, 10, 20, 30);
    expect_vec3(axis(light(&bench, 0), 0, 0, 1), 0, 0, -1);
    run(&bench, false, "LightSource \"distant\" \"point to\" [0 0 0]");
    expect_text(bench.result.message, "no direction");
    bench_close(&bench);
}

static void an_infinite_light_becomes_a_sky(void **state)
{
    (void)state;
    const float four[12] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1}, two[6] = {1, 1, 1, 1, 1, 1};
    bench_t bench = {0};
    write_pfm(&bench, "square.pfm", 2, 2, four);
    write_pfm(&bench, "wide.pfm", 2, 1, two);
    run(&bench, false,
        "Rotate 90 1 0 0 Scale 2 2 2 Translate 1 1 1 LightSource \"infinite\" \"rgb L\" [.5 1 2] "
        "\"string mapname\" \"wide.pfm\" \"integer samples\" 4");
    bench_expect_ok(&bench);
    assert_int_equal(bench.warning_count, 1);
    const blob_light_t *l = light(&bench, 0);
    assert_int_equal(l->kind, LIGHT_INFINITE);
    assert_int_equal(l->mapping, LIGHT_LATLONG);
    expect_vec3(l->radiance.factor, 0.5, 1, 2);
    expect_rigid(l);
    expect_vec3(axis(l, 0, 1, 0), 0, 0, 1);
    expect_vec3(origin(l), 0, 0, 0);

    run(&bench, true,
        "LightSource \"infinite\" \"string filename\" \"square.pfm\" \"float scale\" 3 "
        "\"point3 portal\" [0 0 0 1 0 0 1 1 0 0 1 0]");
    bench_expect_silence(&bench);
    assert_int_equal(light(&bench, 0)->mapping, LIGHT_OCTAHEDRAL);
    expect_vec3(light(&bench, 0)->radiance.factor, 3, 3, 3);
    run(&bench, true, "LightSource \"infinite\" \"rgb L\" [1 1 1] \"float illuminance\" 6");
    bench_expect_silence(&bench);
    expect_near((double)light(&bench, 0)->radiance.factor.x, 6 / pi, 1e-5);
    assert_int_equal(light(&bench, 0)->image, 0);
    run(&bench, true, "LightSource \"infinite\" \"string filename\" \"square.pfm\" \"rgb L\" [1 1 1]");
    expect_text(bench.result.message, "not both");
    run(&bench, true, "LightSource \"infinite\" \"string filename\" \"wide.pfm\"");
    expect_text(bench.result.message, "2 x 1 pixels");
    bench.lenient = true;
    run(&bench, true, "LightSource \"infinite\" \"string filename\" \"wide.pfm\"");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "2 x 1 pixels");
    assert_int_equal(light(&bench, 0)->mapping, LIGHT_LATLONG);
    bench_close(&bench);
}

static void a_portal_is_a_rectangle_of_the_world(void **state)
{
    (void)state;
    const float pixels[12] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
    bench_t bench = {0};
    write_pfm(&bench, "square.pfm", 2, 2, pixels);
#define PORTAL(corners) "LightSource \"infinite\" \"point3 portal\" [" corners "]"
    run(&bench, true, "Translate 5 6 7 Rotate 30 1 2 3 " PORTAL("1 2 3  1 4 3  4 4 3  4 2 3"));
    bench_expect_silence(&bench);
    const blob_light_t *l = light(&bench, 0);
    assert_int_equal(l->flags, LIGHT_PORTAL);
    expect_vec3(l->portal[0], 1, 2, 3);
    expect_vec3(l->portal[1], 3, 0, 0);
    expect_vec3(l->portal[2], 0, 2, 0);
    run(&bench, true,
        "LightSource \"infinite\" \"string filename\" \"square.pfm\" \"point3 portal\" [0 0 0 1 0 0 1 1 0 0 "
        "1 0]");
    assert_int_equal(light(&bench, 0)->flags, LIGHT_PORTAL | LIGHT_SMOOTH);
    run(&bench, true, PORTAL("0 0 0 1 0 0 1 1 0 0 1 0") "\"float illuminance\" 6");
    expect_near((double)light(&bench, 0)->radiance.factor.x, 3 / pi, 1e-5);
    run(&bench, true, PORTAL("0 0 0 1 0 0 1 1 0"));
    expect_text(bench.result.message, "has 4 corners, this one has 3");
    static const char *const crooked[] = {
        PORTAL("0 0 0 1 0 0 1.1 1 0 0.1 1 0"), PORTAL("0 0 0 1 0 0 1 1 0.1 0 1 0"),
        PORTAL("0 0 0 0 0 0 1 1 0 1 1 0"), PORTAL("0 0 0 1e300 0 0 1e300 1 0 0 1 0")};
    for (size_t i = 0; i < ARRAY_LENGTH(crooked); ++i) {
        bench.lenient = false;
        run(&bench, true, crooked[i]);
        expect_text(bench.result.message, "no rectangle");
        bench.lenient = true;
        run(&bench, true, crooked[i]);
        expect_text(bench.warnings, "from all directions");
        assert_int_equal(light(&bench, 0)->flags, 0);
    }
#undef PORTAL
    bench_close(&bench);
}

/* Over a fine map of radiance 1 the cosine's integral is pi; pbrt-v4's rule makes it half as much. */
static void the_illuminance_of_a_sky_is_its_integral(void **state)
{
    (void)state;
    enum { SIDE = 64 };
    static float pixels[SIDE * SIDE * 3];
    for (size_t i = 0; i < ARRAY_LENGTH(pixels); ++i) pixels[i] = 1;
    bench_t bench = {0};
    write_pfm(&bench, "m.pfm", SIDE, SIDE, pixels);
    run(&bench, true, "LightSource \"infinite\" \"string filename\" \"m.pfm\" \"float illuminance\" 8");
    bench_expect_silence(&bench);
    expect_near((double)light(&bench, 0)->radiance.factor.x, 8 / (pi / 2), 2e-2);
    bench_close(&bench);
}

/* ---- limits and gain ----------------------------------------------------------------------------------- */

static void the_gain_of_the_film_scales_all_light(void **state)
{
    (void)state;
    bench_t bench = {0};
    bench_run(&bench, "Film \"image\" \"float scale\" 3 \"float maxsampleluminance\" 5\nWorldBegin\n"
                      "LightSource \"point\" AreaLightSource \"diffuse\" Shape \"sphere\"\nWorldEnd\n");
    bench_expect_silence(&bench);
    expect_vec3(light(&bench, 0)->radiance.factor, 3, 3, 3);
    expect_vec3(light(&bench, 1)->radiance.factor, 3, 3, 3);
    expect_near((double)bench.blob.scene->max_luminance, 15, 1e-5);
    bench_run(&bench,
              "Film \"rgb\" \"float iso\" 50 \"float exposuretime\" 4 \"float maxcomponentvalue\" 10\n"
              "WorldBegin\nLightSource \"point\"\n");
    bench_expect_ok(&bench);
    expect_vec3(light(&bench, 0)->radiance.factor, 2, 2, 2);
    expect_near((double)bench.blob.scene->max_luminance, 10, 0);
    bench_close(&bench);
}

static void lights_beyond_limits_are_refused(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, false, "LightSource \"point\" \"rgb I\" [1e30 1 1] \"rgb scale\" [1e30 1 1]");
    expect_text(bench.result.message, "s.pbrt:2:1: this light's radiance is not finite");
    run(&bench, false, "LightSource \"point\" \"rgb I\" [0 0 0]");
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "no light");
    run(&bench, true, "LightSource \"infinite\" \"string filename\" \"absent.exr\"");
    expect_text(bench.result.message, "absent.exr");
    run(&bench, true, "LightSource \"spot\" \"float coneangle\" 0");
    expect_text(bench.result.message, "coneangle");
    run(&bench, true, "LightSource \"point\" \"point3 from\" [0 0 0 1 1 1]");
    expect_text(bench.result.message, "one point");
    bench_run(&bench, "Film \"image\" \"float scale\" 1e30\nWorldBegin LightSource \"point\" \"rgb I\" [1e30 "
                      "1 1] WorldEnd");
    expect_text(bench.result.message, "too bright");
    bench_close(&bench);
}

/* ---- colour spaces ------------------------------------------------------------------------------------- */

static void colour_spaces_are_converted(void **state)
{
    (void)state;
    bench_t bench = {0};
    run(&bench, true,
        "LightSource \"point\" \"rgb I\" [.5 .5 .5]\n"
        "AttributeBegin ColorSpace \"rec2020\" LightSource \"point\" \"rgb I\" [.5 .5 .5] AttributeEnd\n"
        "ColorSpace \"dci-p3\" LightSource \"point\" \"rgb I\" [.5 .6 .7]\n"
        "ColorSpace \"aces2065-1\" LightSource \"point\" \"rgb I\" [1 1 1]\n"
        "Material \"diffuse\" \"rgb reflectance\" [.5 .5 .5] Shape \"sphere\"");
    bench_expect_ok(&bench);
    expect_vec3(light(&bench, 1)->radiance.factor, 0.5, 0.5, 0.5);
    rgb_t p3 =
        light(&bench, 2)->radiance.factor; /* by the matrix 1.2249 -0.2247 0 / -0.0420 1.0419 0 / ... */
    expect_near((double)p3.x, 1.2249 * 0.5 - 0.2247 * 0.6, 2e-4);
    expect_near((double)p3.y, -0.0420 * 0.5 + 1.0419 * 0.6, 2e-4);
    rgb_t d60 = light(&bench, 3)->radiance.factor; /* a warm white */
    assert_true(d60.x > 1.02f && d60.z < 0.95f);
    expect_near(0.2126 * (double)d60.x + 0.7152 * (double)d60.y + 0.0722 * (double)d60.z, 1, 1e-3);
    expect_vec3(bench.blob.materials[bench.blob.shapes[0].material].values[VALUE_REFLECTANCE].factor, 0.5,
                0.5, 0.5);
    run(&bench, true, "ColorSpace \"adobe\"");
    expect_text(bench.result.message, "unknown colour space");
    bench_close(&bench);
}

/* As if each said "rgb" [1 1 1]; but an image has colours of its own, which a goniometric light does not use.
 */
static void lights_without_a_colour_have_the_white_of_their_space(void **state)
{
    (void)state;
#define ACES "ColorSpace \"aces2065-1\" "
    static const float grey[3] = {1, 1, 1};
    static const struct {
        const char *light;
        bool white;
    } cases[] = {
        {"LightSource \"point\"", false},
        {"LightSource \"spot\"", false},
        {"LightSource \"distant\"", false},
        {"LightSource \"infinite\"", false},
        {"LightSource \"goniometric\" \"string filename\" \"a.pfm\"", false},
        {"AreaLightSource \"diffuse\" Shape \"sphere\"", false},
        {"LightSource \"infinite\" \"string filename\" \"a.pfm\"", true},
        {"LightSource \"projection\" \"string filename\" \"a.pfm\"", true},
        {"AreaLightSource \"diffuse\" \"string filename\" \"a.pfm\" Shape \"sphere\"", true},
    };
    bench_t bench = {0};
    write_pfm(&bench, "a.pfm", 1, 1, grey);
    run(&bench, true, ACES "LightSource \"point\" \"rgb I\" [1 1 1]");
    rgb_t d60 = light(&bench, 0)->radiance.factor;
    assert_true(d60.x > 1.02f);
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *world = mem_printf(ACES "%s", cases[i].light);
        rgb_t expected = cases[i].white ? vec3(1, 1, 1) : d60;
        run(&bench, true, world);
        bench_expect_ok(&bench);
        expect_vec3(light(&bench, 0)->radiance.factor, (double)expected.x, (double)expected.y,
                    (double)expected.z);
        free(world);
    }
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_point_light_becomes_ours),
        cmocka_unit_test(a_spot_light_has_its_cone),
        cmocka_unit_test(a_goniometric_light_has_its_image),
        cmocka_unit_test(a_projection_light_has_its_image),
        cmocka_unit_test(a_distant_light_becomes_ours),
        cmocka_unit_test(an_infinite_light_becomes_a_sky),
        cmocka_unit_test(a_portal_is_a_rectangle_of_the_world),
        cmocka_unit_test(the_illuminance_of_a_sky_is_its_integral),
        cmocka_unit_test(the_gain_of_the_film_scales_all_light),
        cmocka_unit_test(lights_beyond_limits_are_refused),
        cmocka_unit_test(colour_spaces_are_converted),
        cmocka_unit_test(lights_without_a_colour_have_the_white_of_their_space),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
