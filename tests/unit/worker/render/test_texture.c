/* Tests of worker/render/texture/texture.c and its parts: images against a reference that looks texels up one
 * by one, procedural textures against numbers computed elsewhere from their published formulas, combinations
 * by hand, and coordinates that no sane scene has. */
#include "worker/render/texture/texture.h"

#include "common/base.h"
#include "worker/render/texture/texture_blocks.h"

#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cmocka.h>

/* ---- a scene of textures alone ---- */

enum { TEXTURES_MAX = 1100, IMAGES_MAX = 8 };

typedef struct {
    scene_blob_t blob;
    blob_texture_t list[TEXTURES_MAX];
    blob_image_t images[IMAGES_MAX];
    uint32_t texels[1024];
    textures_t *textures;
} rig_t;

static rig_t *rig_new(void)
{
    rig_t *rig = mem_zalloc(1, sizeof *rig);
    rig->blob.textures = rig->list;
    rig->blob.images = rig->images;
    rig->blob.texels = rig->texels;
    return rig;
}

static uint32_t add_image(rig_t *rig, texels_t format, uint32_t width, uint32_t height, uint32_t first_word,
                          float gamma)
{
    uint32_t index = (uint32_t)rig->blob.counts[BLOB_SECTION_IMAGES]++;
    rig->images[index] = (blob_image_t){format, width, height, first_word, gamma};
    return index;
}

static blob_texture_t plain(texture_kind_t kind, mapping_t mapping)
{
    return (blob_texture_t){
        .kind = kind,
        .mapping = mapping,
        .matrix = {{1, 0, 0}, {0, 1, 0}},
        .texture_from_world = xform_identity(),
        .channel = CHANNEL_RGB,
        .wrap_s = WRAP_REPEAT,
        .wrap_t = WRAP_REPEAT,
        .inputs = {blob_constant(1), blob_constant(2), blob_constant(4), blob_constant(8)}};
}

static uint32_t add(rig_t *rig, blob_texture_t texture)
{
    uint32_t index = (uint32_t)rig->blob.counts[BLOB_SECTION_TEXTURES]++;
    rig->list[index] = texture;
    return index;
}

static blob_texture_t image_texture(uint32_t image)
{
    blob_texture_t texture = plain(TEXTURE_IMAGE, MAPPING_UV);
    texture.image = 1 + image;
    return texture;
}

static void rig_free(rig_t *rig)
{
    textures_destroy(&rig->textures);
    assert_null(rig->textures);
    free(rig);
}

static texture_point_t point_uv(float u, float v)
{
    return (texture_point_t){.uv = {u, v}, .n = {0, 0, 1}, .colour = {1, 1, 1, 1}};
}

static texture_point_t point_at(float x, float y, float z)
{
    return (texture_point_t){.p = {x, y, z}, .n = {0, 0, 1}, .colour = {1, 1, 1, 1}};
}

static rgb_t eval(rig_t *rig, uint32_t index, texture_point_t at)
{
    if (rig->textures == NULL) rig->textures = textures_new(&rig->blob);
    return textures_eval(rig->textures, index, &at);
}

static void assert_rgb(rgb_t got, float r, float g, float b, float tolerance)
{
    if (!(fabsf(got.x - r) <= tolerance && fabsf(got.y - g) <= tolerance && fabsf(got.z - b) <= tolerance))
        fail_msg("expected %.7g %.7g %.7g, got %.7g %.7g %.7g", (double)r, (double)g, (double)b,
                 (double)got.x, (double)got.y, (double)got.z);
}

static void assert_grey(rgb_t got, float value, float tolerance)
{
    assert_rgb(got, value, value, value, tolerance);
}

/* ---- images ---- */

static void fill_bytes(rig_t *rig)
{
    uint64_t state = 1;
    for (size_t i = 0; i < ARRAY_LENGTH(rig->texels); i++) {
        state = state * 6364136223846793005u + 1442695040888963407u;
        rig->texels[i] = (uint32_t)(state >> 32);
    }
}

static double srgb(int code)
{
    double x = code / 255.0;
    return x <= 0.04045 ? x / 12.92 : pow((x + 0.055) / 1.055, 2.4);
}

/* The index that a texel outside stands for, or -1 for black. */
static int wrapped(int i, int n, wrap_t wrap)
{
    int m = ((i % (2 * n)) + 2 * n) % (2 * n);
    switch (wrap) {
    case WRAP_CLAMP:
        return i < 0 ? 0 : i >= n ? n - 1 : i;
    case WRAP_BLACK:
        return i < 0 || i >= n ? -1 : i;
    case WRAP_MIRROR:
        return m < n ? m : 2 * n - 1 - m;
    default:
        return m % n;
    }
}

/* Where a pixel lies in an image by what blob_image_t says: behind the bands above it, behind the columns to
 * its left in its own, and behind the pixels above it there. */
static size_t in_bands(uint32_t width, uint32_t height, uint32_t x, uint32_t y)
{
    uint32_t band = y / 32, rows = band == height / 32 ? height % 32 : 32;
    return (size_t)band * 32 * width + (size_t)x * rows + y % 32;
}

static double reference_texel(const rig_t *rig, int width, int height, int x, int y, wrap_t wrap_x,
                              wrap_t wrap_y, int channel)
{
    int i = wrapped(x, width, wrap_x), j = wrapped(y, height, wrap_y);
    if (i < 0 || j < 0) return 0;
    size_t at = in_bands((uint32_t)width, (uint32_t)height, (uint32_t)i, (uint32_t)j);
    return srgb((int)(rig->texels[at] >> (8 * channel) & 255));
}

static double reference_lookup(const rig_t *rig, int width, int height, wrap_t wrap_x, wrap_t wrap_y,
                               double s, double t, int channel)
{
    double x = s * width - 0.5, y = t * height - 0.5;
    int i = (int)floor(x), j = (int)floor(y);
    double dx = x - i, dy = y - j, sum = 0;
    for (int k = 0; k < 4; k++)
        sum += (k & 1 ? dx : 1 - dx) * (k & 2 ? dy : 1 - dy) *
               reference_texel(rig, width, height, i + (k & 1), j + (k >> 1), wrap_x, wrap_y, channel);
    return sum;
}

/* Every pair of wrap modes, inside and far outside, at texel centres, edges and in between. */
static void expect_wraps(int width, int height)
{
    rig_t *rig = rig_new();
    fill_bytes(rig);
    uint32_t image = add_image(rig, TEXELS_RGBA8, (uint32_t)width, (uint32_t)height, 0, 0);
    for (uint32_t wraps = 0; wraps < 16; wraps++) {
        blob_texture_t texture = image_texture(image);
        texture.wrap_s = WRAP_REPEAT + wraps % 4;
        texture.wrap_t = WRAP_REPEAT + wraps / 4;
        add(rig, texture);
    }
    for (int k = 0; k < 16 * 2000; k++) {
        uint32_t index = (uint32_t)k % 16;
        const blob_texture_t *t = &rig->list[index];
        int a = k / 16 * 37 % 1201 - 600, b = k / 16 * 53 % 997 - 498;
        float u = (float)a / 200.0f, v = (float)b / 150.0f;
        rgb_t got = eval(rig, index, point_uv(u, v));
        float expected[3];
        for (int c = 0; c < 3; c++)
            expected[c] =
                (float)reference_lookup(rig, width, height, t->wrap_s, t->wrap_t, (double)u, (double)v, c);
        assert_rgb(got, expected[0], expected[1], expected[2], 1e-5f);
        rgb_t direct = textures_image(rig->textures, image, t->wrap_s, t->wrap_t, (vec2_t){u, v});
        assert_memory_equal(&direct, &got, sizeof got);
    }
    rig_free(rig);
}

static void an_image_wraps_and_interpolates(void **state)
{
    (void)state;
    expect_wraps(5, 3);
    expect_wraps(14, 70); /* two bands of rows and a part of one */
}

static void at_their_centres_texels_are_exact(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    fill_bytes(rig);
    add_image(rig, TEXELS_RGBA8, 8, 4, 7, 1);
    add_image(rig, TEXELS_R8, 8, 4, 7, 2.2f);
    rig->textures = textures_new(&rig->blob);
    for (uint32_t y = 0; y < 4; y++)
        for (uint32_t x = 0; x < 8; x++) {
            vec2_t at = {((float)x + 0.5f) / 8, ((float)y + 0.5f) / 4};
            size_t place = in_bands(8, 4, x, y);
            uint32_t word = rig->texels[7 + place];
            uint8_t byte = ((const uint8_t *)(rig->texels + 7))[place];
            rgb_t colour = textures_texel(rig->textures, 0, x, y),
                  level = textures_texel(rig->textures, 1, x, y);
            assert_rgb(colour, (float)(word & 255) / 255, (float)(word >> 8 & 255) / 255,
                       (float)(word >> 16 & 255) / 255, 0);
            assert_grey(level, (float)pow(byte / 255.0, (double)2.2f), 0);
            rgb_t looked = textures_image(rig->textures, 0, WRAP_BLACK, WRAP_REPEAT, at);
            assert_memory_equal(&looked, &colour, sizeof looked);
            looked = textures_image(rig->textures, 1, WRAP_MIRROR, WRAP_CLAMP, at);
            assert_memory_equal(&looked, &level, sizeof looked);
        }
    rig_free(rig);
}

static void tables_of_blocks_fit_the_memory(void **state)
{
    (void)state;
    const uint64_t mib = 1 << 20;
    assert_int_equal(texture_blocks_slots(0, 1024 * mib), 0);
    assert_int_equal(texture_blocks_slots(64 * mib, 1024 * mib), 0); /* few */
    assert_int_equal(texture_blocks_slots(4096 * mib, 1024 * mib), 128 * 16);
    assert_int_equal(texture_blocks_slots(100 * mib, 64 * 1024 * mib), 64 * 16);
    assert_int_equal(texture_blocks_slots(4096 * mib, 1), 64);
    assert_int_equal(texture_blocks_slots(BLOB_MAX_BYTES, UINT64_MAX), 1 << 20);
}

/* An image of 71.5 million bytes that begins amid a page, in a file. */
static void many_texels_are_read_in_blocks(void **state)
{
    (void)state;
    enum { WIDTH = 65000, HEIGHT = 1100, FIRST = 300 };
    rig_t *rig = rig_new();
    uint64_t words = FIRST + WIDTH / 4 * HEIGHT, size = words * sizeof(uint32_t);
    int file = memfd_create("texels", MFD_CLOEXEC);
    assert_int_equal(ftruncate(file, (off_t)size), 0);
    uint8_t *bytes = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    assert_ptr_not_equal(bytes, MAP_FAILED);
    rig->blob.texels = (const uint32_t *)(const void *)bytes;
    rig->blob.counts[BLOB_SECTION_TEXELS] = words;
    rig->blob.mapped = true;
    add_image(rig, TEXELS_R8, WIDTH, HEIGHT, FIRST, 1);
    rig->textures = textures_new(&rig->blob);
    static const uint32_t places[][2] = {{0, 0}, {64999, 0}, {777, 555}, {0, 1099}, {64999, 1099}};
    for (size_t i = 0; i < ARRAY_LENGTH(places); i++) {
        uint32_t x = places[i][0], y = places[i][1];
        bytes[4 * FIRST + in_bands(WIDTH, HEIGHT, x, y)] = (uint8_t)(51 * (i + 1));
        for (int again = 0; again < 2; again++)
            assert_grey(textures_texel(rig->textures, 0, x, y), 0.2f * (float)(i + 1), 1e-7f);
        vec2_t at = {((float)x + 0.5f) / WIDTH, ((float)y + 0.5f) / HEIGHT};
        rgb_t looked = textures_image(rig->textures, 0, WRAP_REPEAT, WRAP_REPEAT, at);
        assert_grey(looked, 0.2f * (float)(i + 1), 0.02f);
    }
    rig_free(rig);
    munmap(bytes, size);
    close(file);
}

/* A block stays known until another takes its slot. */
static void blocks_are_known_until_others_come(void **state)
{
    (void)state;
    enum { SLOTS = 64 };
    uint64_t size = (uint64_t)(SLOTS + 2) << TEXTURE_BLOCK_BITS;
    uint8_t *bytes = mem_zalloc(1, size);
    texture_blocks_t blocks = {.start = bytes, .end = bytes + size - 5, .mask = SLOTS - 1};
    blocks.slots = mem_zalloc(SLOTS, sizeof *blocks.slots);
    texture_blocks_touch(&blocks, bytes + (2 << TEXTURE_BLOCK_BITS) - 1);
    assert_int_equal(atomic_load(&blocks.slots[1]), 2);
    texture_blocks_touch(&blocks, blocks.end - 1);
    assert_int_equal(atomic_load(&blocks.slots[1]), SLOTS + 2);
    assert_int_equal(atomic_load(&blocks.slots[0]), 0);
    texture_blocks_touch(&blocks, bytes + (1 << TEXTURE_BLOCK_BITS));
    assert_int_equal(atomic_load(&blocks.slots[1]), 2);
    free((void *)blocks.slots);
    free(bytes);
}

/* Black and white sRGB: half way is half the light, not the light of code 128. */
static void an_image_is_decoded_before_it_is_interpolated(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    rig->texels[0] = 0xFF00;
    add_image(rig, TEXELS_R8, 2, 1, 0, 0);
    rig->textures = textures_new(&rig->blob);
    assert_grey(textures_image(rig->textures, 0, WRAP_CLAMP, WRAP_CLAMP, (vec2_t){0.5f, 0}), 0.5f, 0);
    assert_grey(textures_image(rig->textures, 0, WRAP_CLAMP, WRAP_CLAMP, (vec2_t){0.375f, 0}), 0.25f, 0);
    rig_free(rig);
}

static void set_floats(rig_t *rig, uint32_t word, const float *values, size_t count)
{
    memcpy(rig->texels + word, values, count * sizeof *values);
}

static void every_image_format_gives_its_values(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    set_floats(rig, 3, (const float[]){0.25f, 1e4f, -3, 7}, 4);
    set_floats(rig, 9, (const float[]){1, 2, 3, 4, 5, 6}, 6);
    add_image(rig, TEXELS_R32F, 2, 2, 3, 0);
    add_image(rig, TEXELS_RGB32F, 1, 2, 9, 0);
    rig->textures = textures_new(&rig->blob);
    assert_grey(textures_texel(rig->textures, 0, 1, 0), -3, 0);
    assert_grey(textures_texel(rig->textures, 0, 0, 1), 1e4f, 0);
    assert_rgb(textures_texel(rig->textures, 1, 0, 1), 4, 5, 6, 0);
    assert_grey(textures_image(rig->textures, 0, WRAP_CLAMP, WRAP_CLAMP, (vec2_t){0.25f, 0.25f}), 0.25f, 0);
    assert_rgb(textures_image(rig->textures, 1, WRAP_CLAMP, WRAP_CLAMP, (vec2_t){0, 0.5f}), 2.5f, 3.5f, 4.5f,
               0);
    rig_free(rig);
}

static void a_channel_of_an_image_can_be_chosen(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    rig->texels[0] = 51u << 24 | 255u << 16 | 128u << 8 | 64u;
    uint32_t rgba = add_image(rig, TEXELS_RGBA8, 1, 1, 0, 0), grey = add_image(rig, TEXELS_R8, 1, 1, 0, 0);
    for (channel_t channel = CHANNEL_RGB; channel <= CHANNEL_MEAN; channel++) {
        blob_texture_t texture = image_texture(rgba);
        texture.channel = channel;
        add(rig, texture);
    }
    blob_texture_t opaque = image_texture(grey), inverted = image_texture(rgba);
    opaque.channel = CHANNEL_A;
    opaque.wrap_s = WRAP_BLACK;
    uint32_t opaque_index = add(rig, opaque);
    inverted.flags = TEXTURE_INVERT;
    inverted.inputs[0] = blob_colour_value(vec3(2, 3, 4));
    uint32_t inverted_index = add(rig, inverted);
    inverted.flags = TEXTURE_UNIT;
    uint32_t limited_index = add(rig, inverted);
    texture_point_t at = point_uv(0.5f, 0.5f);
    float r = 0.05126946f, g = 0.21586050f, b = 1;
    assert_rgb(eval(rig, 0, at), r, g, b, 1e-7f);
    assert_grey(eval(rig, 1, at), r, 1e-7f);
    assert_grey(eval(rig, 2, at), g, 1e-7f);
    assert_grey(eval(rig, 3, at), b, 1e-7f);
    assert_grey(eval(rig, 4, at), 0.2f, 1e-7f);
    assert_grey(eval(rig, 5, at), 0.212671f * r + 0.715160f * g + 0.072169f * b, 1e-6f);
    assert_grey(eval(rig, 6, at), (r + g + b) / 3, 1e-6f);
    assert_grey(eval(rig, opaque_index, at), 1, 0);
    assert_rgb(eval(rig, inverted_index, at), 1 - 2 * r, 1 - 3 * g, 0, 1e-6f);
    assert_rgb(eval(rig, limited_index, at), 2 * r, 3 * g, 1, 1e-6f);
    rig_free(rig);
}

static void nearest_lookups_do_not_interpolate(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    rig->texels[0] = 0x04030201;
    uint32_t image = add_image(rig, TEXELS_R8, 4, 1, 0, 1);
    static const struct {
        wrap_t wrap;
        float s;
        int code;
    } cases[] = {{WRAP_REPEAT, 0, 1},      {WRAP_REPEAT, 0.2499f, 1}, {WRAP_REPEAT, 0.25f, 2},
                 {WRAP_REPEAT, 0.999f, 4}, {WRAP_REPEAT, 1, 1},       {WRAP_REPEAT, -0.1f, 4},
                 {WRAP_CLAMP, -5, 1},      {WRAP_CLAMP, 1, 4},        {WRAP_CLAMP, 9, 4},
                 {WRAP_BLACK, -0.001f, 0}, {WRAP_BLACK, 0.6f, 3},     {WRAP_BLACK, 1, 0},
                 {WRAP_MIRROR, -0.1f, 1},  {WRAP_MIRROR, 1.1f, 4},    {WRAP_MIRROR, 1.4f, 3},
                 {WRAP_REPEAT, -1e-9f, 4}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        blob_texture_t texture = image_texture(image);
        texture.flags = TEXTURE_NEAREST;
        texture.wrap_s = cases[i].wrap;
        add(rig, texture);
    }
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++)
        assert_grey(eval(rig, (uint32_t)i, point_uv(cases[i].s, 0.5f)), (float)cases[i].code / 255, 0);
    rig_free(rig);
}

/* ---- where to look ---- */

static void every_mapping_places_points_by_its_formula(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    blob_texture_t texture = plain(TEXTURE_UV, MAPPING_UV);
    const float matrix[2][3] = {{0.5f, 0.25f, 0.125f}, {0, -1, 1}};
    memcpy(texture.matrix, matrix, sizeof matrix);
    texture.texture_from_world = (xform_t){{{0, 1, 0, 0}, {0, 0, 1, 0}, {1, 0, 0, 0}}}; /* (y, z, x) */
    for (mapping_t mapping = MAPPING_UV; mapping <= MAPPING_CYLINDER; mapping++) {
        texture.mapping = mapping;
        add(rig, texture);
    }
    texture_point_t at = {.uv = {0.5f, 0.25f}, .uv2 = {1, 0.75f}, .p = {0.6f, 0.3f, 0.2f}};
    assert_rgb(eval(rig, 0, at), 0.4375f, 0.75f, 0, 0);
    assert_rgb(eval(rig, 1, at), 0.8125f, 0.25f, 0, 0);
    assert_rgb(eval(rig, 2, at), 0.3f, 0.2f, 0, 0);
    /* q = (0.3, 0.2, 0.6), of length 0.7 */
    float theta = acosf(6.0f / 7), phi = atan2f(2, 3);
    assert_rgb(eval(rig, 3, at), theta / PI_F, phi / TWO_PI_F, 0, 1e-6f);
    assert_rgb(eval(rig, 4, at), 0.5f + phi / TWO_PI_F, 6.0f / 7, 0, 1e-6f);
    assert_rgb(eval(rig, 5, at), 0.3f, 0.2f, 0, 0);
    assert_rgb(eval(rig, 6, at), 0.5f + phi / TWO_PI_F, 0.6f, 0, 1e-6f);
    rig_free(rig);
}

/* Behind, azimuths are more than pi and not negative: q = (-3, -2, 0). A bilerp shows t as it is. */
static void azimuths_behind_the_axis_are_not_negative(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    blob_texture_t texture = plain(TEXTURE_BILERP, MAPPING_SPHERICAL);
    texture.inputs[0] = texture.inputs[2] = blob_constant(0);
    texture.inputs[1] = texture.inputs[3] = blob_constant(1);
    add(rig, texture);
    texture.mapping = MAPPING_CYLINDRICAL; /* now s */
    texture.inputs[1] = blob_constant(0);
    texture.inputs[2] = blob_constant(1);
    add(rig, texture);
    float phi = atan2f(2, 3);
    assert_grey(eval(rig, 0, point_at(-3, -2, 0)), 0.5f + phi / TWO_PI_F, 1e-6f);
    assert_grey(eval(rig, 1, point_at(-3, -2, 0)), phi / TWO_PI_F, 1e-6f);
    rig_free(rig);
}

/* ---- combinations ---- */

static void combinations_follow_their_formulas(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    uint32_t uv = add(rig, plain(TEXTURE_UV, MAPPING_UV)); /* (0.25, 0.5, 0) below */
    blob_texture_t scale = plain(TEXTURE_SCALE, 0), mix = plain(TEXTURE_MIX, 0),
                   direction = plain(TEXTURE_DIRECTION_MIX, 0), bilerp = plain(TEXTURE_BILERP, MAPPING_UV),
                   channel = plain(TEXTURE_CHANNEL, 0), threshold = plain(TEXTURE_THRESHOLD, 0),
                   colour = plain(TEXTURE_COLOUR, 0);
    scale.inputs[0] = (blob_value_t){{1, 10, 100}, 1 + uv, 0};
    mix.inputs[2] = (blob_value_t){{1, 1, 1}, 1 + uv, 0};
    direction.parameters[2] = -0.25f;
    channel.inputs[0].texture = threshold.inputs[0].texture = 1 + uv;
    channel.channel = CHANNEL_G;
    threshold.parameters[0] = 0.25f;
    uint32_t first = add(rig, scale);
    add(rig, mix);
    add(rig, direction);
    add(rig, bilerp);
    add(rig, channel);
    add(rig, threshold);
    add(rig, colour);
    colour.channel = CHANNEL_A;
    add(rig, colour);
    texture_point_t at = point_uv(0.25f, 0.5f);
    at.colour = (blob_colour_t){0.1f, 0.2f, 0.3f, 0.4f};
    assert_rgb(eval(rig, first, at), 0.5f, 10, 0, 0);
    assert_rgb(eval(rig, first + 1, at), 1.25f, 1.5f, 1, 0);
    assert_grey(eval(rig, first + 2, at), 1.25f, 0);
    /* v00 = 1, v01 = 2, v10 = 4, v11 = 8 at s = 1/4, t = 1/2: 0.5 (1.75 + 3.5) */
    assert_grey(eval(rig, first + 3, at), 2.625f, 0);
    assert_grey(eval(rig, first + 4, at), 0.5f, 0);
    assert_grey(eval(rig, first + 5, at), 1, 0);
    assert_grey(eval(rig, first + 5, point_uv(0.2499f, 0)), 0, 0);
    assert_rgb(eval(rig, first + 6, at), 0.1f, 0.2f, 0.3f, 0);
    assert_grey(eval(rig, first + 7, at), 0.4f, 0);
    blob_value_t value = {{2, 2, 2}, 1 + uv, 0};
    assert_rgb(textures_value(rig->textures, &value, &at), 0.5f, 1, 0, 0);
    value.texture = 0;
    assert_grey(textures_value(rig->textures, &value, &at), 2, 0);
    rig_free(rig);
}

static void checks_alternate(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    add(rig, plain(TEXTURE_CHECKERBOARD, MAPPING_UV));
    add(rig, plain(TEXTURE_CHECKERBOARD, MAPPING_POINT));
    for (int x = -3; x < 3; x++)
        for (int y = -3; y < 3; y++)
            for (int z = -3; z < 3; z++) {
                float u = (float)x + 0.3f, v = (float)y + 0.6f;
                assert_grey(eval(rig, 0, point_uv(u, v)), (x + y) % 2 == 0 ? 1 : 2, 0);
                assert_grey(eval(rig, 1, point_at(u, v, (float)z)), (x + y + z) % 2 == 0 ? 1 : 2, 0);
            }
    rig_free(rig);
}

/* As many textures in a row as a blob may have. */
static void the_longest_chain_of_textures_is_evaluated(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    uint32_t last = add(rig, plain(TEXTURE_UV, MAPPING_UV));
    for (int i = 1; i < BLOB_MAX_TEXTURE_COST; i++) {
        blob_texture_t texture = plain(TEXTURE_SCALE, 0);
        texture.inputs[0].texture = 1 + last;
        texture.inputs[1] = blob_constant(i % 2 == 0 ? 2 : 0.5f);
        last = add(rig, texture);
    }
    assert_rgb(eval(rig, last, point_uv(0.5f, 0.25f)), 0.25f, 0.125f, 0, 0);
    rig_free(rig);
}

/* ---- noise ---- */

/* From the published formulas, in double precision. The second point's value is a widely known check of
 * Perlin's own implementation. */
static void noise_has_published_values(void **state)
{
    (void)state;
    static const struct {
        vec3_t p;
        float noise, fbm, turbulence, windy;
        rgb_t marble;
    } cases[] = {{{0.3f, 0.6f, 0.7f},
                  0.013562947f,
                  0.273177410f,
                  0.437128936f,
                  0.059887046f,
                  {0.745641f, 0.745641f, 0.811640f}},
                 {{3.14f, 42, 7},
                  0.136919959f,
                  0.466081010f,
                  0.481633010f,
                  0.003013904f,
                  {0.894871f, 0.882377f, 0.874928f}},
                 {{-1.25f, 7.5f, -300.375f},
                  -0.161864288f,
                  -0.437839827f,
                  0.465358343f,
                  -0.102548920f,
                  {0.869903f, 0.869903f, 0.899879f}},
                 {{17.875f, -2.125f, 255.5f},
                  -0.156753076f,
                  -0.292177628f,
                  0.344809759f,
                  -0.022646566f,
                  {0.811118f, 0.805900f, 0.802917f}},
                 {{0.5f, 0.5f, 0.5f},
                  -0.125f,
                  -0.142272742f,
                  0.219436202f,
                  -0.030882870f,
                  {0.869884f, 0.869884f, 0.899918f}},
                 {{128.25f, 64.75f, -0.625f},
                  0.241145640f,
                  0.392412155f,
                  0.562847302f,
                  0.169201196f,
                  {0.870896f, 0.870352f, 0.898672f}}};
    rig_t *rig = rig_new();
    const float parameters[5][4] = {{1, 0.5f}, {5, 0.6f}, {5, 0.6f}, {0}, {8, 0.5f, 1.5f, 0.4f}};
    const texture_kind_t kinds[5] = {TEXTURE_FBM, TEXTURE_FBM, TEXTURE_WRINKLED, TEXTURE_WINDY,
                                     TEXTURE_MARBLE};
    for (int i = 0; i < 5; i++) {
        blob_texture_t texture = plain(kinds[i], MAPPING_POINT);
        memcpy(texture.parameters, parameters[i], sizeof texture.parameters);
        add(rig, texture);
    }
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        texture_point_t at = point_at(cases[i].p.x, cases[i].p.y, cases[i].p.z);
        /* Octaves magnify the rounding of large coordinates. */
        float tolerance = 4e-6f + 1e-6f * v_length(cases[i].p);
        assert_grey(eval(rig, 0, at), cases[i].noise, tolerance);
        assert_grey(eval(rig, 1, at), cases[i].fbm, 4 * tolerance);
        assert_grey(eval(rig, 2, at), cases[i].turbulence, 4 * tolerance);
        assert_grey(eval(rig, 3, at), cases[i].windy, 4 * tolerance);
        rgb_t m = cases[i].marble;
        assert_rgb(eval(rig, 4, at), m.x, m.y, m.z, 8 * tolerance);
    }
    rig_free(rig);
}

/* A picture of the dots, made elsewhere from the same formulas. */
static void dots_are_where_a_reference_has_them(void **state)
{
    (void)state;
    static const char *const picture[] = {
        "........................................", ".......###.......###...##...............",
        ".......###.......###..####..............", ".......................##...............",
        ".......................................#", "......................................##",
        ".......................................#", ".............##.........................",
        "............####........................", ".............#..........................",
        "........................................", "......####..####..###..###..###..####..#",
        "......####..###...###..###..###...##...#", "........................................",
        ".............##..####..###..###..####...", "............####.####..###..###..####...",
    };
    rig_t *rig = rig_new();
    add(rig, plain(TEXTURE_DOTS, MAPPING_UV));
    for (size_t j = 0; j < ARRAY_LENGTH(picture); j++)
        for (size_t i = 0; picture[j][i] != '\0'; i++) {
            texture_point_t at = point_uv((float)i * 0.19f - 2.5f, ((float)j - 2) * 0.31f - 0.9f);
            assert_grey(eval(rig, 0, at), picture[j][i] == '#' ? 1 : 2, 0);
        }
    rig_free(rig);
}

/* ---- what no sane scene has ---- */

static const float absurd[] = {0,        -0.0f, 1,      -1,      1e-40f,   0x1p24f,  -0x1p24f,  0x1p31f,
                               -0x1p31f, 1e10f, -1e10f, FLT_MAX, -FLT_MAX, INFINITY, -INFINITY, NAN};

static blob_texture_t absurd_texture(texture_kind_t kind, mapping_t mapping, uint32_t variant)
{
    blob_texture_t texture = plain(kind, mapping);
    texture.image = 1;
    texture.wrap_s = texture.wrap_t = variant % 5;
    texture.flags = variant % 4;
    texture.channel = variant % 8;
    for (int k = 0; k < TEXTURE_PARAMETERS; k++)
        texture.parameters[k] = variant % 3 == 0 ? 3 : variant % 3 == 1 ? FLT_MAX : -FLT_MAX;
    if (variant % 7 == 3) texture.texture_from_world.m[0][3] = FLT_MAX;
    if (variant % 7 == 4) texture.matrix[1][1] = -FLT_MAX;
    return texture;
}

/* Every kind with every mapping: always a finite answer. Run with the sanitizers. */
static void absurd_points_get_finite_answers(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    fill_bytes(rig);
    add_image(rig, TEXELS_RGBA8, 31, 33, 0, 0);
    uint32_t count = 0;
    for (texture_kind_t kind = TEXTURE_IMAGE; kind < TEXTURE_KIND_END; kind++)
        for (uint32_t variant = 0; variant < 9; variant++)
            for (mapping_t mapping = 0; mapping <= MAPPING_CYLINDER; mapping++)
                count = 1 + add(rig, absurd_texture(kind, mapping, variant));
    for (uint32_t index = 0; index < count; index++)
        for (size_t i = 0; i < ARRAY_LENGTH(absurd); i++)
            for (size_t j = 0; j < ARRAY_LENGTH(absurd); j++) {
                texture_point_t at = {.uv = {absurd[i], absurd[j]},
                                      .uv2 = {absurd[j], absurd[i]},
                                      .p = {absurd[i], absurd[j], absurd[(i + j) % 16]},
                                      .n = {0, absurd[i], absurd[j]},
                                      .colour = {absurd[i], absurd[j], 0, 0}};
                assert_true(v_is_finite(eval(rig, index, at)));
            }
    for (wrap_t wrap = 0; wrap <= WRAP_MIRROR; wrap++)
        for (size_t i = 0; i < ARRAY_LENGTH(absurd); i++)
            for (size_t j = 0; j < ARRAY_LENGTH(absurd); j++)
                assert_true(v_is_finite(
                    textures_image(rig->textures, 0, wrap, wrap, (vec2_t){absurd[i], absurd[j]})));
    rig_free(rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_image_wraps_and_interpolates),
        cmocka_unit_test(at_their_centres_texels_are_exact),
        cmocka_unit_test(tables_of_blocks_fit_the_memory),
        cmocka_unit_test(many_texels_are_read_in_blocks),
        cmocka_unit_test(blocks_are_known_until_others_come),
        cmocka_unit_test(an_image_is_decoded_before_it_is_interpolated),
        cmocka_unit_test(every_image_format_gives_its_values),
        cmocka_unit_test(a_channel_of_an_image_can_be_chosen),
        cmocka_unit_test(nearest_lookups_do_not_interpolate),
        cmocka_unit_test(every_mapping_places_points_by_its_formula),
        cmocka_unit_test(azimuths_behind_the_axis_are_not_negative),
        cmocka_unit_test(combinations_follow_their_formulas),
        cmocka_unit_test(checks_alternate),
        cmocka_unit_test(the_longest_chain_of_textures_is_evaluated),
        cmocka_unit_test(noise_has_published_values),
        cmocka_unit_test(dots_are_where_a_reference_has_them),
        cmocka_unit_test(absurd_points_get_finite_answers),
    };
    return cmocka_run_group_tests_name("texture", tests, NULL, NULL);
}
