/* What the pbrt importer makes of image files: the colours that an EXR says it has, and alpha. */
#include "tests/unit/client/import/test_import.h"

#include <png.h>

/* ---- files --------------------------------------------------------------------------------------------- */

typedef struct {
    uint8_t bytes[2048];
    size_t size;
} file_bytes_t;

static void put(file_bytes_t *file, const void *data, size_t size)
{
    assert_true(file->size + size <= sizeof file->bytes);
    memcpy(file->bytes + file->size, data, size);
    file->size += size;
}

static void put_int(file_bytes_t *file, uint32_t value)
{
    put(file, &value, sizeof value);
}

static void put_attribute(file_bytes_t *file, const char *name, const char *type, const void *value,
                          size_t size)
{
    put(file, name, strlen(name) + 1);
    put(file, type, strlen(type) + 1);
    put_int(file, (uint32_t)size);
    put(file, value, size);
}

static void put_channels(file_bytes_t *file)
{
    file_bytes_t list = {0};
    for (const char *name = "BGR"; *name; ++name) {
        const uint32_t what[4] = {2, 0, 1, 1}; /* floats, one for each pixel */
        put(&list, (const char[2]){*name, 0}, 2);
        put(&list, what, sizeof what);
    }
    put(&list, "", 1);
    put_attribute(file, "channels", "chlist", list.bytes, list.size);
}

/* An EXR file of 2 x 2 pixels of one colour; `xy` are its chromaticities, or NULL. */
static void write_exr(bench_t *bench, const char *name, const float rgb[3], const float *xy)
{
    file_bytes_t file = {0};
    const uint32_t window[4] = {0, 0, 1, 1};
    put_int(&file, 20000630);
    put_int(&file, 2);
    put_channels(&file);
    if (xy) put_attribute(&file, "chromaticities", "chromaticities", xy, 8 * sizeof *xy);
    put_attribute(&file, "compression", "compression", "", 1);
    put_attribute(&file, "dataWindow", "box2i", window, sizeof window);
    put_attribute(&file, "displayWindow", "box2i", window, sizeof window);
    put_attribute(&file, "lineOrder", "lineOrder", "", 1);
    put_attribute(&file, "pixelAspectRatio", "float", &(float){1}, 4);
    put_attribute(&file, "screenWindowCenter", "v2f", (const float[2]){0}, 8);
    put_attribute(&file, "screenWindowWidth", "float", &(float){1}, 4);
    put(&file, "", 1);
    for (uint64_t y = 0, at = file.size + 16; y < 2; ++y, at += 32) put(&file, &at, sizeof at);
    for (uint32_t y = 0; y < 2; ++y) {
        put_int(&file, y);
        put_int(&file, 24);
        for (int c = 2; c >= 0; --c) put(&file, (const float[2]){rgb[c], rgb[c]}, 8);
    }
    bench_write(bench, name, file.bytes, file.size);
}

static const float aces[8] = {0.7347f, 0.2653f, 0, 1, 0.0001f, -0.077f, 0.32168f, 0.33767f};
static const float rec2020[8] = {0.708f, 0.292f, 0.17f, 0.797f, 0.131f, 0.046f, 0.3127f, 0.329f};
static const float srgb[8] = {0.64f, 0.33f, 0.3f, 0.6f, 0.15f, 0.06f, 0.3127f, 0.329f};
static const float adobe[8] = {0.64f, 0.33f, 0.21f, 0.71f, 0.15f, 0.06f, 0.3127f, 0.329f};

/* ---- scenes -------------------------------------------------------------------------------------------- */

static void run(bench_t *bench, bool v4, const char *world)
{
    char *text = mem_printf(v4 ? "Film \"rgb\"\nWorldBegin\n%s\n" : "WorldBegin\n%s\nWorldEnd\n", world);
    bench_run(bench, text);
    free(text);
}

/* The first pixel of an image of floats. */
static vec3_t first_pixel(const bench_t *bench, blob_ref_t image)
{
    assert_true(image > 0 && image <= count_of(bench, BLOB_SECTION_IMAGES));
    const blob_image_t *record = &bench->blob.images[image - 1];
    assert_int_equal(record->format, TEXELS_RGB32F);
    float rgb[3];
    memcpy(rgb, bench->blob.texels + record->first_word, sizeof rgb);
    return vec3(rgb[0], rgb[1], rgb[2]);
}

#define SPHERE "Shape \"sphere\"\n"
#define IMAGE_LIGHT "LightSource \"infinite\" \"string filename\" \"a.exr\""
#define IMAGEMAP(type) "Texture \"" type "\" \"" type "\" \"imagemap\" \"string filename\" \"a.exr\"\n"

static vec3_t image_of_light(const bench_t *bench)
{
    assert_true(count_of(bench, BLOB_SECTION_LIGHTS) > 0);
    return first_pixel(bench, bench->blob.lights[0].image);
}

/* ---- colour spaces ------------------------------------------------------------------------------------- */

/* The figures are those of an rgb value in a ColorSpace. */
static void an_exr_has_the_colours_that_it_says(void **state)
{
    (void)state;
    const float colour[3] = {0.5f, 0.25f, 0.125f}, white[3] = {1, 1, 1};
    static const struct {
        const float *xy;
        const char *space;
    } cases[] = {{aces, "aces2065-1"}, {rec2020, "rec2020"}, {srgb, "srgb"}, {NULL, "srgb"}};
    bench_t bench = {0};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        char *constant =
            mem_printf("ColorSpace \"%s\" LightSource \"infinite\" \"rgb L\" [.5 .25 .125]", cases[i].space);
        run(&bench, true, constant);
        bench_expect_ok(&bench);
        vec3_t same = bench.blob.lights[0].radiance.factor;
        write_exr(&bench, "a.exr", colour, cases[i].xy);
        run(&bench, true, IMAGE_LIGHT);
        bench_expect_silence(&bench);
        vec3_t found = image_of_light(&bench);
        expect_vec3(found, (double)same.x, (double)same.y, (double)same.z);
        free(constant);
    }
    write_exr(&bench, "a.exr", white, aces); /* warmer than sRGB's */
    run(&bench, true, IMAGE_LIGHT);
    vec3_t warm = image_of_light(&bench);
    assert_true(warm.x > warm.y && warm.y > warm.z + 0.05f);
    run(&bench, true, "AreaLightSource \"diffuse\" \"string filename\" \"a.exr\" " SPHERE);
    vec3_t area = first_pixel(&bench, bench.blob.textures[0].image);
    expect_vec3(area, (double)warm.x, (double)warm.y, (double)warm.z);
    run(&bench, true, "LightSource \"projection\" \"string filename\" \"a.exr\"");
    vec3_t projected = image_of_light(&bench);
    expect_vec3(projected, (double)warm.x, (double)warm.y, (double)warm.z);
    bench_close(&bench);
}

/* What reflects has the white of the scene, numbers are taken as they are; each has its image. */
static void an_image_is_converted_for_its_use(void **state)
{
    (void)state;
    const float white[3] = {1, 1, 1}, colour[3] = {0.25f, 0.5f, 0.75f};
    bench_t bench = {0};
    write_exr(&bench, "a.exr", white, aces);
    run(&bench, true,
        IMAGE_LIGHT IMAGEMAP("spectrum")
            IMAGEMAP("float") "Material \"diffuse\" \"texture reflectance\" \"spectrum\" " SPHERE);
    bench_expect_silence(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_IMAGES), 3);
    assert_true(image_of_light(&bench).z < 0.95f);
    expect_vec3(first_pixel(&bench, bench.blob.textures[0].image), 1, 1, 1);
    write_exr(&bench, "a.exr", colour, aces);
    run(&bench, true,
        IMAGEMAP("float") "Material \"diffuse\" \"string normalmap\" \"a.exr\" " SPHERE
                          "LightSource \"goniometric\" \"string filename\" \"a.exr\"");
    bench_expect_ok(&bench);
    for (uint64_t i = 0; i < count_of(&bench, BLOB_SECTION_TEXTURES); ++i)
        expect_vec3(first_pixel(&bench, bench.blob.textures[i].image), 0.25, 0.5, 0.75);
    write_exr(&bench, "a.exr", colour, srgb); /* where there is nothing to convert, one image serves all */
    run(&bench, true, IMAGE_LIGHT IMAGEMAP("spectrum") IMAGEMAP("float"));
    bench_expect_silence(&bench);
    assert_int_equal(count_of(&bench, BLOB_SECTION_IMAGES), 1);
    bench_close(&bench);
}

/* ACES's luminance of (1, 0, 0) is 0.3440, of (0, 1, 0) 0.7282. Outside of sRGB's gamut red is 0. */
static void power_counts_what_was_converted(void **state)
{
    (void)state;
    const float reddish[3] = {0.6f, 0.4f, 0.4f}, green[3] = {0, 1, 0};
    bench_t bench = {0};
    write_exr(&bench, "a.exr", reddish, aces);
    run(&bench, true, "LightSource \"projection\" \"string filename\" \"a.exr\" \"float power\" 1");
    bench_expect_silence(&bench);
    double aces_factor = (double)bench.blob.lights[0].radiance.factor.x;
    write_exr(&bench, "a.exr", reddish, NULL);
    run(&bench, true, "LightSource \"projection\" \"string filename\" \"a.exr\" \"float power\" 1");
    expect_near(aces_factor / (double)bench.blob.lights[0].radiance.factor.x, 0.44252 / 0.4688, 1e-3);
    write_exr(&bench, "a.exr", green, aces);
    run(&bench, true, IMAGE_LIGHT);
    assert_true(image_of_light(&bench).x == 0 && image_of_light(&bench).y > 1);
    bench_close(&bench);
}

static void unknown_colours_are_srgb(void **state)
{
    (void)state;
    const float colour[3] = {0.5f, 0.25f, 0.125f};
    bench_t bench = {0};
    write_exr(&bench, "a.exr", colour, adobe);
    run(&bench, true, IMAGE_LIGHT IMAGEMAP("spectrum"));
    bench_expect_ok(&bench);
    expect_text(bench.warnings, "a.exr: no colour space of pbrt-v4 has red (0.64, 0.33), green (0.21, 0.71)");
    assert_int_equal(bench.warning_count, 1);
    expect_vec3(image_of_light(&bench), 0.5, 0.25, 0.125);
    bench_close(&bench);
}

static void v3_takes_an_exr_as_it_is(void **state)
{
    (void)state;
    const float colour[3] = {0.5f, 0.25f, 0.125f};
    bench_t bench = {0};
    write_exr(&bench, "a.exr", colour, aces);
    run(&bench, false, "LightSource \"infinite\" \"string mapname\" \"a.exr\"");
    bench_expect_silence(&bench);
    expect_vec3(image_of_light(&bench), 0.5, 0.25, 0.125);
    bench_close(&bench);
}

/* ---- alpha --------------------------------------------------------------------------------------------- */

static const uint8_t two_pixels[8] = {1, 2, 3, 255, 4, 5, 6, 128};

/* Two pixels, with a channel of alpha or as a palette that has one. */
static void write_png(bench_t *bench, const char *name, bool palette)
{
    uint8_t bytes[512], places[2] = {0, 1};
    png_image image = {.version = PNG_IMAGE_VERSION, .width = 2, .height = 1, .format = PNG_FORMAT_RGBA};
    png_alloc_size_t size = sizeof bytes;
    if (palette) image.format = PNG_FORMAT_RGBA_COLORMAP, image.colormap_entries = 2;
    assert_true(png_image_write_to_memory(&image, bytes, &size, 0, palette ? places : two_pixels, 0,
                                          palette ? two_pixels : NULL));
    bench_write(bench, name, bytes, size);
}

static void write_tga(bench_t *bench, const char *name)
{
    const uint8_t data[18 + 8] = {[2] = 2, [12] = 2, [14] = 1, [16] = 32, [17] = 8, 3,  2,
                                  1,       255,      6,        5,         4,        128};
    bench_write(bench, name, data, sizeof data);
}

static const blob_texture_t *run_float(bench_t *bench, const char *filename)
{
    char *text =
        mem_printf("Texture \"f\" \"float\" \"imagemap\" \"string filename\" \"%s\"\n" SPHERE, filename);
    run(bench, true, text);
    bench_expect_ok(bench);
    free(text);
    assert_int_equal(bench->blob.textures[0].kind, TEXTURE_IMAGE);
    return &bench->blob.textures[0];
}

/* pbrt-v4 decodes it like a colour. */
static void a_number_is_the_alpha_of_a_file_that_has_it(void **state)
{
    (void)state;
    bench_t bench = {0};
    write_png(&bench, "a.png", false);
    const blob_texture_t *t = run_float(&bench, "a.png");
    assert_int_equal(t->channel, CHANNEL_R);
    const blob_image_t *alpha = &bench.blob.images[t->image - 1];
    assert_int_equal(alpha->format, TEXELS_R8);
    expect_near((double)alpha->gamma, 0, 0);
    assert_memory_equal(bench.blob.texels + alpha->first_word, ((uint8_t[]){255, 128}), 2);
    bench_close(&bench);
}

/* pbrt-v4 has already forgotten it. */
static void a_number_is_the_mean_where_alpha_is_no_channel(void **state)
{
    (void)state;
    bench_t bench = {0};
    write_png(&bench, "palette.png", true);
    write_tga(&bench, "a.tga");
    static const char *const names[] = {"palette.png", "a.tga"};
    for (size_t i = 0; i < ARRAY_LENGTH(names); ++i) {
        const blob_texture_t *t = run_float(&bench, names[i]);
        assert_int_equal(t->channel, CHANNEL_MEAN);
        assert_int_equal(count_of(&bench, BLOB_SECTION_IMAGES), 1);
        const blob_image_t *image = &bench.blob.images[t->image - 1];
        assert_int_equal(image->format, TEXELS_RGBA8);
        assert_memory_equal(bench.blob.texels + image->first_word, ((uint8_t[]){1, 2, 3, 255, 4, 5, 6, 255}),
                            8);
    }
    bench_close(&bench);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_exr_has_the_colours_that_it_says),
        cmocka_unit_test(an_image_is_converted_for_its_use),
        cmocka_unit_test(power_counts_what_was_converted),
        cmocka_unit_test(unknown_colours_are_srgb),
        cmocka_unit_test(v3_takes_an_exr_as_it_is),
        cmocka_unit_test(a_number_is_the_alpha_of_a_file_that_has_it),
        cmocka_unit_test(a_number_is_the_mean_where_alpha_is_no_channel),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
