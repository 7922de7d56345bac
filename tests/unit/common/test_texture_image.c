/* Tests of common/texture_*.c: every kind of every format gives its exact texels the right way up; files that
 * are cut short, damaged, too large or something else give errors that name them. */
#include "common/image/image.h"
#include "common/image/texture_image.h"
#include "tests/scratch.h"

#include <math.h>
#include <png.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <turbojpeg.h>
#include <webp/encode.h>

#include <cmocka.h>

static int setup(void **state)
{
    *state = scratch_new();
    return 0;
}

static int teardown(void **state)
{
    scratch_destroy((char **)state);
    return 0;
}

/* ---- files in the making ---- */

/* The bytes of a file; what is appended must fit. */
typedef struct {
    uint8_t bytes[1 << 16];
    size_t size;
} file_t;

static void put(file_t *file, const void *data, size_t size)
{
    assert_true(size <= sizeof file->bytes - file->size);
    memcpy(file->bytes + file->size, data, size);
    file->size += size;
}

static void put_text(file_t *file, const char *text)
{
    put(file, text, strlen(text));
}

static void put_floats(file_t *file, const float *values, size_t count, bool little)
{
    for (size_t i = 0; i < count; i++) {
        uint32_t bits;
        memcpy(&bits, &values[i], sizeof bits);
        if (!little) bits = __builtin_bswap32(bits);
        put(file, &bits, sizeof bits);
    }
}

/* ---- what is expected ---- */

static void assert_fails(const char *name, const uint8_t *data, size_t size, const char *part)
{
    /* A copy of exactly that size, so that the sanitizers see a read beyond it. */
    uint8_t *copy = mem_alloc(size + (size == 0));
    memcpy(copy, data, size);
    texture_image_t image;
    result_t result = texture_image_decode(name, copy, size, &image);
    free(copy);
    if (result.code != RESULT_INPUT || strstr(result.message, part) == NULL ||
        strncmp(result.message, name, strlen(name)) != 0)
        fail_msg("%zu bytes: expected an error with '%s', got code %d: %s", size, part, result.code,
                 result.message);
    assert_null(image.bytes);
    assert_null(image.floats);
}

static texture_image_t decode(const char *name, const file_t *file)
{
    texture_image_t image;
    result_t result = texture_image_decode(name, file->bytes, file->size, &image);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    return image;
}

static void assert_shape(const texture_image_t *image, uint32_t width, uint32_t height, uint32_t channels,
                         texel_type_t type, bool encoded)
{
    assert_int_equal(image->width, width);
    assert_int_equal(image->height, height);
    assert_int_equal(image->channels, channels);
    assert_int_equal(image->type, type);
    assert_int_equal(image->encoded, encoded);
    assert_true((image->bytes != NULL) == (type == TEXELS_U8));
    assert_true((image->floats != NULL) == (type == TEXELS_FLOAT));
}

/* Decodes a file to sRGB-encoded bytes and compares them. */
static void check_bytes(const char *name, const file_t *file, uint32_t width, uint32_t height,
                        uint32_t channels, const uint8_t *expected)
{
    texture_image_t image = decode(name, file);
    assert_shape(&image, width, height, channels, TEXELS_U8, true);
    assert_memory_equal(image.bytes, expected, (size_t)width * height * channels);
    assert_int_equal(image.bad_values, 0);
    texture_image_free(&image);
}

/* The same of floats, bit by bit. */
static void check_floats(const char *name, const file_t *file, uint32_t width, uint32_t height,
                         uint32_t channels, bool encoded, const float *expected, uint64_t bad_values)
{
    texture_image_t image = decode(name, file);
    assert_shape(&image, width, height, channels, TEXELS_FLOAT, encoded);
    assert_memory_equal(image.floats, expected, (size_t)width * height * channels * sizeof *expected);
    assert_int_equal(image.bad_values, bad_values);
    texture_image_free(&image);
}

/* Every beginning of a file is an error. */
static void check_truncations(const char *name, const file_t *file)
{
    texture_image_t image = decode(name, file);
    texture_image_free(&image);
    for (size_t size = 0; size < file->size; size++) assert_fails(name, file->bytes, size, "");
}

/* Damages one byte after the other: an image or an error, and no finding of the sanitizers. */
static void check_damage(const char *name, const file_t *file)
{
    static const uint8_t values[] = {0x00, 0x01, 0x7F, 0x80, 0xFF};
    file_t bad = *file;
    for (size_t i = 0; i < file->size; i++)
        for (size_t v = 0; v < ARRAY_LENGTH(values); v++) {
            texture_image_t image;
            bad.bytes[i] = values[v];
            result_t result = texture_image_decode(name, bad.bytes, bad.size, &image);
            assert_true((result.code == RESULT_OK) == (image.bytes != NULL || image.floats != NULL));
            texture_image_free(&image);
            bad.bytes[i] = file->bytes[i];
        }
}

/* ---- PNG ---- */

/* What write_png writes. */
typedef struct {
    uint32_t width, height;
    int bits, colours, interlace;
    const uint8_t *rows; /* packed as in the file */
    size_t row_bytes;
    png_colorp palette;
    int palette_length;
    png_bytep alpha; /* of the palette */
    int alpha_length;
    png_color_16p transparent;
} png_kind_t;

static void append_png(png_structp png, png_bytep data, png_size_t size)
{
    put(png_get_io_ptr(png), data, size);
}

static file_t write_png(const png_kind_t *kind)
{
    file_t file = {.size = 0};
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);
    png_set_write_fn(png, &file, append_png, NULL);
    png_set_IHDR(png, info, kind->width, kind->height, kind->bits, kind->colours, kind->interlace,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_gAMA(png, info, 1.0); /* is not to be applied */
    if (kind->palette != NULL) png_set_PLTE(png, info, kind->palette, kind->palette_length);
    if (kind->alpha != NULL || kind->transparent != NULL)
        png_set_tRNS(png, info, kind->alpha, kind->alpha_length, kind->transparent);
    png_write_info(png, info);
    const uint8_t *rows[64];
    for (uint32_t y = 0; y < kind->height; y++) rows[y] = kind->rows + y * kind->row_bytes;
    png_write_image(png, (png_bytepp)rows);
    png_write_end(png, info);
    png_destroy_write_struct(&png, &info);
    return file;
}

enum { WIDTH = 5, HEIGHT = 3, SAMPLES = WIDTH * HEIGHT };

/* Values that differ all over the image. */
static void fill(uint8_t *bytes, size_t count)
{
    for (size_t i = 0; i < count; i++) bytes[i] = (uint8_t)(i * 37 + 11);
}

static const struct {
    int colours;
    uint32_t channels;
} png_colours[] = {{PNG_COLOR_TYPE_GRAY, 1},
                   {PNG_COLOR_TYPE_GRAY_ALPHA, 2},
                   {PNG_COLOR_TYPE_RGB, 3},
                   {PNG_COLOR_TYPE_RGB_ALPHA, 4}};

static png_kind_t png_kind(size_t i, int bits, int interlace, const uint8_t *rows)
{
    return (png_kind_t){.width = WIDTH,
                        .height = HEIGHT,
                        .bits = bits,
                        .colours = png_colours[i].colours,
                        .interlace = interlace,
                        .rows = rows,
                        .row_bytes = (size_t)WIDTH * png_colours[i].channels * (size_t)bits / 8};
}

static void png_of_all_colours_is_read(void **state)
{
    (void)state;
    uint8_t rows[SAMPLES * 8];
    float wide[SAMPLES * 4];
    fill(rows, sizeof rows);
    for (size_t i = 0; i < ARRAY_LENGTH(wide); i++)
        wide[i] = (float)(256 * rows[2 * i] + rows[2 * i + 1]) / 65535.0f;
    for (size_t i = 0; i < ARRAY_LENGTH(png_colours); i++)
        for (int interlace = PNG_INTERLACE_NONE; interlace <= PNG_INTERLACE_ADAM7; interlace++) {
            png_kind_t kind = png_kind(i, 8, interlace, rows);
            file_t file = write_png(&kind);
            check_bytes("a.png", &file, WIDTH, HEIGHT, png_colours[i].channels, rows);
            kind = png_kind(i, 16, interlace, rows);
            file = write_png(&kind);
            check_floats("a.png", &file, WIDTH, HEIGHT, png_colours[i].channels, true, wide, 0);
        }
}

static void png_palettes_and_bits_are_expanded(void **state)
{
    (void)state;
    png_color palette[] = {{1, 2, 3}, {40, 50, 60}, {255, 0, 128}};
    uint8_t alpha[] = {9, 200};
    const uint8_t two_bits[] = {0x18}; /* 0 1 2 */
    png_kind_t kind = {.width = 3,
                       .height = 1,
                       .bits = 2,
                       .colours = PNG_COLOR_TYPE_PALETTE,
                       .rows = two_bits,
                       .row_bytes = 1,
                       .palette = palette,
                       .palette_length = 3};
    file_t file = write_png(&kind);
    check_bytes("a.png", &file, 3, 1, 3, (const uint8_t[]){1, 2, 3, 40, 50, 60, 255, 0, 128});
    kind.alpha = alpha;
    kind.alpha_length = 2;
    file = write_png(&kind);
    check_bytes("a.png", &file, 3, 1, 4, (const uint8_t[]){1, 2, 3, 9, 40, 50, 60, 200, 255, 0, 128, 255});

    png_color_16 two = {.gray = 2};
    png_kind_t grey = {
        .width = 3, .height = 1, .bits = 2, .colours = PNG_COLOR_TYPE_GRAY, .rows = two_bits, .row_bytes = 1};
    file = write_png(&grey);
    check_bytes("a.png", &file, 3, 1, 1, (const uint8_t[]){0, 85, 170});
    grey.transparent = &two;
    file = write_png(&grey);
    check_bytes("a.png", &file, 3, 1, 2, (const uint8_t[]){0, 255, 85, 255, 170, 0});
}

static file_t small_png(void)
{
    uint8_t rows[SAMPLES * 8];
    fill(rows, sizeof rows);
    png_kind_t kind = png_kind(2, 8, PNG_INTERLACE_ADAM7, rows);
    return write_png(&kind);
}

static void bad_png_is_an_error(void **state)
{
    (void)state;
    file_t file = small_png();
    check_truncations("a.png", &file);
    check_damage("a.png", &file);
    assert_fails("a.png", file.bytes, file.size - 20, "a.png: cannot be read as PNG: the file is cut short");
    uint8_t *pixels = memmem(file.bytes, file.size, "IDAT", 4);
    pixels[20] ^= 1; /* a texel of an incompressible block */
    assert_fails("a.png", file.bytes, file.size, "a.png: cannot be read as PNG: IDAT: ");
}

static uint32_t crc32_of(const uint8_t *data, size_t size)
{
    uint32_t crc = ~0u;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

/* A small file whose header promises other sizes, with the right checksum. */
static file_t resized_png(uint32_t width, uint32_t height)
{
    file_t file = small_png();
    uint32_t big[2] = {__builtin_bswap32(width), __builtin_bswap32(height)};
    memcpy(file.bytes + 16, big, sizeof big);
    uint32_t crc = __builtin_bswap32(crc32_of(file.bytes + 12, 17));
    memcpy(file.bytes + 29, &crc, sizeof crc);
    return file;
}

static void huge_png_is_refused(void **state)
{
    (void)state;
    file_t file = resized_png(WIDTH, HEIGHT); /* still good: the checksum is right */
    texture_image_t image = decode("a.png", &file);
    texture_image_free(&image);
    file = resized_png(65536, 4097);
    assert_fails("a.png", file.bytes, file.size, "65536 x 4097 pixels are outside the limits");
    file = resized_png(65537, 1);
    assert_fails("a.png", file.bytes, file.size, "65537 x 1 pixels are outside the limits");
    file = resized_png(65536, 4096);
    assert_fails("a.png", file.bytes, file.size, "is cut short");
    file = resized_png(WIDTH, HEIGHT + 8);
    assert_fails("a.png", file.bytes, file.size, "cannot be read as PNG");
}

/* ---- JPEG ---- */

enum { SIDE = 24 };

/* Three bands of one colour each, which JPEG keeps nearly exactly where their edges are the blocks'. */
static file_t write_jpeg(int sampling, int flags, int format)
{
    static const uint8_t bands[3][3] = {{255, 0, 0}, {20, 160, 40}, {0, 0, 255}};
    size_t channels = (size_t)tjPixelSize[format];
    uint8_t pixels[SIDE * SIDE * 4] = {0};
    for (size_t p = 0; p < SIDE * SIDE; p++)
        for (size_t c = 0; c < 3 && c < channels; c++)
            pixels[p * channels + c] = bands[p / SIDE / 8][channels == 1 ? 1 : c];
    tjhandle encoder = tjInitCompress();
    uint8_t *bytes = NULL;
    unsigned long size = 0;
    assert_int_equal(tjCompress2(encoder, pixels, SIDE, 0, SIDE, format, &bytes, &size, sampling, 100, flags),
                     0);
    file_t file = {.size = 0};
    put(&file, bytes, size);
    tjFree(bytes);
    tjDestroy(encoder);
    return file;
}

static void assert_near(int value, int expected)
{
    if (abs(value - expected) > 2) fail_msg("%d, expected %d", value, expected);
}

static void jpeg_is_read(void **state)
{
    (void)state;
    static const uint8_t bands[3][3] = {{255, 0, 0}, {20, 160, 40}, {0, 0, 255}};
    for (int flags = 0; flags <= TJFLAG_PROGRESSIVE; flags += TJFLAG_PROGRESSIVE) {
        file_t file = write_jpeg(TJSAMP_444, flags, TJPF_RGB);
        texture_image_t image = decode("a.jpg", &file);
        assert_shape(&image, SIDE, SIDE, 3, TEXELS_U8, true);
        for (size_t p = 0; p < SIDE * SIDE; p++)
            for (size_t c = 0; c < 3; c++) assert_near(image.bytes[3 * p + c], bands[p / SIDE / 8][c]);
        texture_image_free(&image);

        file = write_jpeg(TJSAMP_GRAY, flags, TJPF_GRAY);
        image = decode("a.jpg", &file);
        assert_shape(&image, SIDE, SIDE, 1, TEXELS_U8, true);
        for (size_t p = 0; p < SIDE * SIDE; p++) assert_near(image.bytes[p], bands[p / SIDE / 8][1]);
        texture_image_free(&image);
    }
    file_t file = write_jpeg(TJSAMP_420, 0, TJPF_RGB);
    texture_image_t image = decode("a.jpg", &file);
    assert_shape(&image, SIDE, SIDE, 3, TEXELS_U8, true);
    texture_image_free(&image);

    /* Bytes that mean nothing before the end, as some cameras leave them. */
    file_t padded = {.size = 0};
    put(&padded, file.bytes, file.size - 2);
    put(&padded, (uint8_t[64]){0}, 64);
    put(&padded, "\xff\xd9", 2);
    image = decode("a.jpg", &padded);
    assert_shape(&image, SIDE, SIDE, 3, TEXELS_U8, true);
    texture_image_free(&image);
}

static void bad_jpeg_is_an_error(void **state)
{
    (void)state;
    file_t file = write_jpeg(TJSAMP_420, 0, TJPF_RGB), grey = write_jpeg(TJSAMP_GRAY, 0, TJPF_GRAY),
           progressive = write_jpeg(TJSAMP_444, TJFLAG_PROGRESSIVE, TJPF_RGB);
    check_truncations("a.jpg", &file);
    check_truncations("a.jpg", &grey);
    check_truncations("a.jpg", &progressive);
    check_damage("a.jpg", &grey);
    assert_fails("a.jpg", file.bytes, file.size - 30, "a.jpg: cannot be read as JPEG: ");

    file_t cmyk = write_jpeg(TJSAMP_444, 0, TJPF_CMYK);
    assert_fails("a.jpg", cmyk.bytes, cmyk.size, "a.jpg: CMYK images are not supported");

    uint8_t *frame = memmem(grey.bytes, grey.size, "\xff\xc0", 2); /* length, depth, height, width */
    assert_non_null(frame);
    memcpy(frame + 5, "\x40\x00\x20\x00", 4);
    assert_fails("a.jpg", grey.bytes, grey.size, "is cut short");
    memcpy(frame + 5, "\x7f\xff\x7f\xff", 4);
    assert_fails("a.jpg", grey.bytes, grey.size, "32767 x 32767 pixels are outside the limits");
}

/* ---- WebP ---- */

/* A ramp of colours and, where there are four channels, of alpha, never 0: the encoder drops colours there.
 */
static void make_ramp(size_t channels, uint8_t *pixels)
{
    for (size_t p = 0; p < SIDE * SIDE; p++) {
        uint8_t x = (uint8_t)(p % SIDE), y = (uint8_t)(p / SIDE);
        memcpy(pixels + p * channels, (uint8_t[4]){10 * x, 10 * y, 5 * x + 5 * y, 255 - 9 * x}, channels);
    }
}

/* `quality` of a lossy file; above 100: lossless. */
static file_t write_webp(size_t channels, float quality, uint8_t *pixels)
{
    uint8_t *bytes = NULL;
    int stride = (int)(SIDE * channels);
    make_ramp(channels, pixels);
    bool lossless = quality > 100, alpha = channels == 4;
    size_t size = lossless && alpha ? WebPEncodeLosslessRGBA(pixels, SIDE, SIDE, stride, &bytes)
                  : lossless        ? WebPEncodeLosslessRGB(pixels, SIDE, SIDE, stride, &bytes)
                  : alpha           ? WebPEncodeRGBA(pixels, SIDE, SIDE, stride, quality, &bytes)
                                    : WebPEncodeRGB(pixels, SIDE, SIDE, stride, quality, &bytes);
    file_t file = {.size = 0};
    put(&file, bytes, size);
    WebPFree(bytes);
    return file;
}

static void webp_is_read(void **state)
{
    (void)state;
    uint8_t pixels[SIDE * SIDE * 4];
    for (size_t channels = 3; channels <= 4; channels++) {
        file_t file = write_webp(channels, 101, pixels);
        check_bytes("a.webp", &file, SIDE, SIDE, (uint32_t)channels, pixels);

        file = write_webp(channels, 100, pixels);
        texture_image_t image = decode("a.webp", &file);
        assert_shape(&image, SIDE, SIDE, (uint32_t)channels, TEXELS_U8, true);
        long difference = 0;
        for (size_t i = 0; i < SIDE * SIDE * channels; i++)
            difference += labs((long)image.bytes[i] - pixels[i]);
        assert_true(difference > 0 && difference < 3 * (long)(SIDE * SIDE * channels));
        for (size_t i = 3; channels == 4 && i < SIDE * SIDE * 4; i += 4)
            assert_int_equal(image.bytes[i], pixels[i]); /* alpha is lossless at this quality */
        texture_image_free(&image);
    }
}

static void bad_webp_is_an_error(void **state)
{
    (void)state;
    uint8_t pixels[SIDE * SIDE * 4];
    for (int kind = 0; kind < 4; kind++) {
        file_t file = write_webp(3 + (size_t)kind % 2, kind < 2 ? 101 : 50, pixels);
        /* a last byte of 0 may fill up a chunk */
        for (size_t size = 1; size + 2 < file.size; size++) assert_fails("a.webp", file.bytes, size, "");
        check_damage("a.webp", &file);
        assert_fails("a.webp", file.bytes, file.size / 2, "cannot be read as WebP: it is cut short");
    }
    assert_fails("a.webp", (const uint8_t *)"RIFF\4\0\0\0WAVEfmt ", 16, "it is damaged, or no WebP");
    /* an extended header with the flag of animations; 24 x 24 pixels */
    static const char animated[] = "RIFF\x16\0\0\0WEBPVP8X\x0a\0\0\0\2\0\0\0\x17\0\0\x17\0\0";
    assert_fails("a.webp", (const uint8_t *)animated, sizeof animated - 1, "is an animation");
    /* lossless, 16384 x 16384 pixels, of which nothing follows */
    static const char large[] = "RIFF\x14\0\0\0WEBPVP8L\x08\0\0\0\x2f\xff\xff\xff\x0f\0\0";
    assert_fails("a.webp", (const uint8_t *)large, sizeof large, "bytes for 16384 x 16384 pixels");
}

/* ---- TGA ---- */

enum { FROM_TOP = 0x20, RIGHT_TO_LEFT = 0x10 };

/* A header with a text of two bytes behind it, for an image of two by two pixels, and a colour map. */
static file_t start_tga(uint8_t type, uint8_t bits, uint8_t descriptor, const char *map, uint8_t map_length,
                        uint8_t map_bits)
{
    uint8_t header[] = {2, map_length > 0, type,       7,   0,  map_length, 0, map_bits, 0, 0, 0, 0, 2, 0, 2,
                        0, bits,           descriptor, 'i', 'd'};
    file_t file = {.size = 0};
    put(&file, header, sizeof header);
    put(&file, map, (size_t)map_length * ((map_bits + 7u) / 8));
    return file;
}

static file_t write_tga(uint8_t type, uint8_t bits, uint8_t descriptor, const char *pixels, size_t size)
{
    file_t file = start_tga(type, bits, descriptor, "", 0, 0);
    put(&file, pixels, size);
    return file;
}

static void tga_is_turned_the_right_way_up(void **state)
{
    (void)state;
    const uint8_t descriptors[] = {0, FROM_TOP, RIGHT_TO_LEFT, FROM_TOP | RIGHT_TO_LEFT};
    const char *const expected[] = {"cdab", "abcd", "dcba", "badc"};
    for (size_t i = 0; i < ARRAY_LENGTH(descriptors); i++) {
        file_t file = write_tga(3, 8, descriptors[i], "abcd", 4);
        check_bytes("a.tga", &file, 2, 2, 1, (const uint8_t *)expected[i]);
        file = write_tga(11, 8, descriptors[i], "\3abcd", 5);
        check_bytes("a.tga", &file, 2, 2, 1, (const uint8_t *)expected[i]);
    }
}

static void tga_of_all_depths_is_read(void **state)
{
    (void)state;
    file_t file = write_tga(2, 24, FROM_TOP, "abcdefghijkl", 12);
    check_bytes("a.tga", &file, 2, 2, 3, (const uint8_t *)"cbafedihglkj");
    file = write_tga(2, 32, FROM_TOP | 8, "abcdefghijklmnop", 16);
    check_bytes("A.TGA", &file, 2, 2, 4, (const uint8_t *)"cbadgfehkjilonmp");
    file = write_tga(3, 16, FROM_TOP | 8, "abcdefgh", 8);
    check_bytes("a.tga", &file, 2, 2, 2, (const uint8_t *)"abcdefgh");

    /* Alpha bit, red, green, blue: 0 31 0 1; 1 0 16 0; 0 0 0 31; 1 31 31 31. */
    const char shorts[] = "\x01\x7c\x00\x82\x1f\x00\xff\xff";
    const uint8_t rgba[] = {255, 0, 8, 0, 0, 132, 0, 255, 0, 0, 255, 0, 255, 255, 255, 255};
    const uint8_t rgb[] = {255, 0, 8, 0, 132, 0, 0, 0, 255, 255, 255, 255};
    file = write_tga(2, 16, FROM_TOP | 1, shorts, 8);
    check_bytes("a.tga", &file, 2, 2, 4, rgba);
    file = write_tga(2, 16, FROM_TOP, shorts, 8);
    check_bytes("a.tga", &file, 2, 2, 3, rgb);
    file = write_tga(2, 15, FROM_TOP, shorts, 8);
    check_bytes("a.tga", &file, 2, 2, 3, rgb);
}

/* A fourth byte that the header does not call alpha. */
static void undeclared_alpha_counts_unless_empty(void **state)
{
    (void)state;
    file_t file = write_tga(2, 32, FROM_TOP, "abc\0efg\0ijk\1mno\0", 16);
    check_bytes("a.tga", &file, 2, 2, 4, (const uint8_t *)"cba\0gfe\0kji\1onm");
    file = write_tga(2, 32, FROM_TOP, "abc\0efg\0ijk\0mno\0", 16);
    check_bytes("a.tga", &file, 2, 2, 3, (const uint8_t *)"cbagfekjionm");
    file = write_tga(2, 32, FROM_TOP | 8, "abc\0efg\0ijk\0mno\0", 16);
    check_bytes("a.tga", &file, 2, 2, 4, (const uint8_t *)"cba\0gfe\0kji\0onm");
}

static void tga_packets_go_on_from_row_to_row(void **state)
{
    (void)state;
    file_t file = write_tga(10, 24, FROM_TOP, "\x82xyz\0abc", 8);
    check_bytes("a.tga", &file, 2, 2, 3, (const uint8_t *)"zyxzyxzyxcba");
    file =
        write_tga(10, 24, FROM_TOP, "\x83xyz\x80", 5); /* a packet begun behind the last pixel is no matter */
    check_bytes("a.tga", &file, 2, 2, 3, (const uint8_t *)"zyxzyxzyxzyx");
    file = write_tga(10, 24, FROM_TOP, "\x84xyz------------", 16);
    assert_fails("a.tga", file.bytes, file.size, "beyond the last pixel");
}

/* The map begins at index 7. */
static void tga_colour_maps_are_looked_up(void **state)
{
    (void)state;
    file_t file = start_tga(1, 8, FROM_TOP, "abcdef", 2, 24);
    put(&file, "\7\10\7\7", 4);
    check_bytes("a.tga", &file, 2, 2, 3, (const uint8_t *)"cbafedcbacba");
    file.bytes[file.size - 1] = 6;
    assert_fails("a.tga", file.bytes, file.size, "outside the colour map");
    file.bytes[file.size - 1] = 9;
    assert_fails("a.tga", file.bytes, file.size, "outside the colour map");

    file = start_tga(9, 16, FROM_TOP | 8, "abcdefgh", 2, 32);
    put(&file, "\x82\7\0\0\10\0", 6);
    check_bytes("a.tga", &file, 2, 2, 4, (const uint8_t *)"cbadcbadcbadgfeh");
    file = start_tga(1, 8, FROM_TOP, "\x00\x7c", 1, 15);
    put(&file, "\7\7\7\7", 4);
    check_bytes("a.tga", &file, 2, 2, 3, (const uint8_t[]){255, 0, 0, 255, 0, 0, 255, 0, 0, 255, 0, 0});

    /* A true-colour image may have a map, which is passed over. */
    file = start_tga(2, 24, FROM_TOP, "......", 2, 24);
    put(&file, "abcdefghijkl", 12);
    check_bytes("a.tga", &file, 2, 2, 3, (const uint8_t *)"cbafedihglkj");
}

static void bad_tga_is_an_error(void **state)
{
    (void)state;
    file_t flat = write_tga(2, 24, 0, "abcdefghijkl", 12), packed = write_tga(10, 24, 0, "\x82xyz\0abc", 8);
    check_truncations("a.tga", &flat);
    check_truncations("a.tga", &packed);
    check_damage("a.tga", &flat);
    check_damage("a.tga", &packed);
    assert_fails("a.tga", flat.bytes, flat.size - 1,
                 "a.tga: cannot be read as TGA: it is too short for its size");
    file_t map = start_tga(9, 8, 0, "abcdef", 2, 24);
    put(&map, "\x83\7", 2);
    check_truncations("a.tga", &map);
    check_damage("a.tga", &map);

    memset(packed.bytes + 12, 0xFF, 4);
    assert_fails("a.tga", packed.bytes, packed.size, "outside the limits");
    memcpy(packed.bytes + 12, "\xff\xff\xff\x0f", 4);
    assert_fails("a.tga", packed.bytes, packed.size, "too short for its size");
    memset(packed.bytes + 12, 0, 4);
    assert_fails("a.tga", packed.bytes, packed.size, "0 x 0 pixels");
    flat.bytes[16] = 23;
    assert_fails("a.tga", flat.bytes, flat.size, "depth");
    flat.bytes[2] = 32;
    assert_fails("a.tga", flat.bytes, flat.size, "header");
}

/* ---- BMP ---- */

enum { BMP_HEADERS = 54 };

/* Both headers of an image of two by two pixels, from the top, and what stands behind them; `behind` of these
 * bytes are masks or a colour map. */
static file_t write_bmp(uint8_t bits, uint8_t packing, uint8_t colours, uint8_t behind, const char *bytes,
                        size_t size)
{
    uint8_t headers[BMP_HEADERS] = {'B',           'M',         [10] = (uint8_t)(BMP_HEADERS + behind),
                                    [14] = 40,     [18] = 2,    [22] = 0xFE,
                                    0xFF,          0xFF,        0xFF,
                                    [26] = 1,      [28] = bits, [30] = packing,
                                    [46] = colours};
    file_t file = {.size = 0};
    put(&file, headers, sizeof headers);
    put(&file, bytes, size);
    return file;
}

static void bmp_of_all_depths_is_read(void **state)
{
    (void)state;
    file_t file = write_bmp(24, 0, 0, 0, "abcdef..ghijkl..", 16);
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t *)"cbafedihglkj");
    file.size -= 2; /* what fills up the last row may be missing */
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t *)"cbafedihglkj");
    file = write_bmp(16, 0, 0, 0, "\x00\x7c\xe0\x03\x1f\x00\x10\x42", 8);
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t[]){255, 0, 0, 0, 255, 0, 0, 0, 255, 132, 132, 132});
    file = write_bmp(8, 0, 3, 12, "abc.def.ghi.\0\1..\2\0..", 20);
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t *)"cbafedihgcba");
    file = write_bmp(4, 0, 3, 12, "abc.def.ghi.\x01...\x20...", 20);
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t *)"cbafedihgcba");
    file = write_bmp(1, 0, 0, 8, "abc.def.\x40...\x80...", 16);
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t *)"cbafedfedcba");
}

static void bmp_with_a_positive_height_is_upside_down(void **state)
{
    (void)state;
    file_t file = write_bmp(24, 0, 0, 0, "abcdef..ghijkl..", 16);
    memcpy(file.bytes + 22, "\2\0\0", 4);
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t *)"ihglkjcbafed");
}

static void bmp_alpha_counts_unless_it_is_empty(void **state)
{
    (void)state;
    file_t file = write_bmp(32, 0, 0, 0, "abc\0efg\0ijk\1mno\0", 16);
    check_bytes("a.dat", &file, 2, 2, 4, (const uint8_t *)"cba\0gfe\0kji\1onm");
    file = write_bmp(32, 0, 0, 0, "abc\0efg\0ijk\0mno\0", 16);
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t *)"cbagfekjionm");
}

static void bmp_masks_say_where_the_colours_are(void **state)
{
    (void)state;
    static const char rgb[] = "\xff\0\0\0\0\xff\0\0\0\0\xff\0"
                              "abc.def.ghi.jkl.";
    file_t file = write_bmp(32, 3, 0, 12, rgb, sizeof rgb - 1);
    check_bytes("a.dat", &file, 2, 2, 3, (const uint8_t *)"abcdefghijkl");
    static const char rgba[] = "\0\xff\0\0\0\0\xff\0\0\0\0\xff\xff\0\0\0"
                               "abcdefghijklmnop";
    file = write_bmp(32, 3, 0, 16, rgba, sizeof rgba - 1);
    file.bytes[14] = 56; /* a longer header, which has a mask of alpha */
    check_bytes("a.dat", &file, 2, 2, 4, (const uint8_t *)"bcdafghejklinopm");
}

static void old_bmp_of_os2_is_read(void **state)
{
    (void)state;
    static const char bytes[] = "BM........\x20\0\0\0\x0c\0\0\0\2\0\1\0\1\0\1\0"
                                "abcdef\x40...............................";
    file_t file = {.size = 0};
    put(&file, bytes, sizeof bytes - 1);
    check_bytes("a.dat", &file, 2, 1, 3, (const uint8_t *)"cbafed");
}

static void bad_bmp_is_an_error(void **state)
{
    (void)state;
    file_t flat = write_bmp(24, 0, 0, 0, "abcdef..ghijkl", 14);
    file_t mapped = write_bmp(8, 0, 2, 8, "abc.def.\0\1..\1\0", 14);
    check_truncations("a.bmp", &flat);
    check_truncations("a.bmp", &mapped);
    check_damage("a.bmp", &flat);
    check_damage("a.bmp", &mapped);
    assert_fails("a.bmp", flat.bytes, flat.size - 1, "a.bmp: cannot be read as BMP: it is cut short");
    mapped.bytes[mapped.size - 1] = 2;
    assert_fails("a.bmp", mapped.bytes, mapped.size, "outside the colour map");
    mapped.bytes[30] = 1;
    assert_fails("a.bmp", mapped.bytes, mapped.size, "packed pixels");
    mapped.bytes[30] = 3;
    assert_fails("a.bmp", mapped.bytes, mapped.size, "masks");
    flat.bytes[28] = 23;
    assert_fails("a.bmp", flat.bytes, flat.size, "depth");
    memset(flat.bytes + 18, 0xFF, 3);
    assert_fails("a.bmp", flat.bytes, flat.size, "outside the limits");
    flat.bytes[14] = 39;
    assert_fails("a.bmp", flat.bytes, flat.size, "header");
}

/* ---- Radiance HDR ---- */

static file_t start_hdr(const char *size)
{
    file_t file = {.size = 0};
    put_text(&file, "#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n");
    put_text(&file, size);
    return file;
}

static void flat_hdr_is_read_in_all_directions(void **state)
{
    (void)state;
    /* 1 0.5 0.25; black, for all its mantissas; 3 0 2^-7; the largest. */
    const uint8_t pixels[] = {128, 64, 32, 129, 9, 9, 9, 0, 192, 0, 1, 130, 255, 0, 0, 255};
    const float p[4][3] = {{1, 0.5f, 0.25f}, {0, 0, 0}, {3, 0, 0x1p-6f}, {255 * 0x1p119f, 0, 0}};
    const char *const sizes[] = {"-Y 2 +X 2\n", "+Y 2 +X 2\n", "-Y 2 -X 2\n", "+Y 2 -X 2\n"};
    const int orders[][4] = {{0, 1, 2, 3}, {2, 3, 0, 1}, {1, 0, 3, 2}, {3, 2, 1, 0}};
    for (size_t i = 0; i < ARRAY_LENGTH(sizes); i++) {
        file_t file = start_hdr(sizes[i]);
        put(&file, pixels, sizeof pixels);
        float expected[4][3];
        for (size_t k = 0; k < 4; k++) memcpy(expected[k], p[orders[i][k]], sizeof p[0]);
        check_floats("a.hdr", &file, 2, 2, 3, false, &expected[0][0], 0);
    }
}

/* Two scanlines of eight pixels: one coded with runs and literals, one flat. */
static file_t coded_hdr(void)
{
    file_t file = start_hdr("-Y 2 +X 8\n");
    const uint8_t coded[] = {2,   2,   0,  8,           /* the mark and the width */
                             136, 128,                  /* red: a run of all 8 */
                             3,   10,  20, 30, 133, 40, /* green: three, then a run of five */
                             8,   1,   2,  3,  4,   5,  6, 7, 8, 136, 136}; /* blue: eight; the exponent */
    put(&file, coded, sizeof coded);
    for (int x = 0; x < 8; x++) put(&file, (const uint8_t[]){200, 100, 50, (uint8_t)(136 + x % 2)}, 4);
    return file;
}

static void coded_hdr_is_read(void **state)
{
    (void)state;
    static const float green[] = {10, 20, 30, 40, 40, 40, 40, 40};
    file_t file = coded_hdr();
    float expected[2][8][3];
    for (size_t x = 0; x < 8; x++) {
        float factor = x % 2 == 0 ? 1.0f : 2.0f;
        memcpy(expected[0][x], (const float[]){128, green[x], (float)(x + 1)}, sizeof expected[0][x]);
        memcpy(expected[1][x], (const float[]){200 * factor, 100 * factor, 50 * factor},
               sizeof expected[1][x]);
    }
    check_floats("a.pic", &file, 8, 2, 3, false, &expected[0][0][0], 0);
}

static void bad_hdr_is_an_error(void **state)
{
    (void)state;
    file_t file = coded_hdr();
    check_truncations("a.hdr", &file);
    check_damage("a.hdr", &file);
    assert_fails("a.hdr", file.bytes, file.size - 1,
                 "a.hdr: cannot be read as Radiance HDR: it is cut short");
    uint8_t *mark = memmem(file.bytes, file.size, "\2\2\0\10", 4);
    mark[4] = 137; /* a run of 9 */
    assert_fails("a.hdr", file.bytes, file.size, "damaged");
    mark[3] = 9;
    assert_fails("a.hdr", file.bytes, file.size, "another width");
    file = start_hdr("-Y 1 +X 8\n");
    put(&file, (const uint8_t[]){2, 2, 0, 8, 0, 136, 1, 136, 1, 136, 1, 136, 1}, 13);
    assert_fails("a.hdr", file.bytes, file.size, "damaged"); /* no pixels, then a run of all */

    const struct {
        const char *text, *reason;
    } cases[] = {{"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n....", "FORMAT"},
                 {"#?RADIANCE\n\n+X 1 -Y 1\n....", "of the form"},
                 {"#?RADIANCE\n\n-Y 1 +X 1 x\n....", "of the form"},
                 {"#?RADIANCE\n\n-Y 65537 +X 1\n....", "outside the limits"},
                 {"#?RADIANCE\n\n-Y -1 +X 1\n....", "outside the limits"},
                 {"#?RADIANCE\n\n-Y 4096 +X 65536\n....", "too short for its size"},
                 {"#?RADIANCE\n\n-Y 8192 +X 32767\n\2\2\177\377....", "too short for its size"},
                 {"#?RADIANCE\n\n-Y 1 +X 2\nabcd\1\1\1\1", "old run-length coding"},
                 {"#?RADIANCE\n", "does not end"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++)
        assert_fails("a.hdr", (const uint8_t *)cases[i].text, strlen(cases[i].text), cases[i].reason);
}

/* ---- PFM ---- */

static void pfm_is_read_from_the_bottom(void **state)
{
    (void)state;
    const float values[] = {1, 2, 3, 4, 5, 6, -7, 8, 1e-42f, 10, 11, 3e38f};
    const float rgb[] = {-7, 8, 1e-42f, 10, 11, 3e38f, 1, 2, 3, 4, 5, 6}, grey[] = {3, 4, 1, 2};
    const float twice[] = {6, 8, 2, 4};
    file_t file = {.size = 0};
    put_text(&file, "PF\n2 2\n-1.0\n");
    put_floats(&file, values, 12, true);
    check_floats("a.pfm", &file, 2, 2, 3, false, rgb, 0);
    file.size = 0;
    put_text(&file, "PF\n2 2\n1.0\n");
    put_floats(&file, values, 12, false);
    check_floats("a.pfm", &file, 2, 2, 3, false, rgb, 0);
    file.size = 0;
    put_text(&file, "Pf 2\t2\r\n-1e0\n");
    put_floats(&file, values, 4, true);
    check_floats("a.pfm", &file, 2, 2, 1, false, grey, 0);
    file.size = 0;
    put_text(&file, "Pf\n2 2\n2\n");
    put_floats(&file, values, 4, false);
    check_floats("a.pfm", &file, 2, 2, 1, false, twice, 0);
}

static void bad_values_are_counted(void **state)
{
    (void)state;
    const float values[] = {NAN, 2, INFINITY, -INFINITY}, expected[] = {0, 0, 0, 2};
    file_t file = {.size = 0};
    put_text(&file, "Pf\n2 2\n-1.0\n");
    put_floats(&file, values, 4, true);
    check_floats("a.pfm", &file, 2, 2, 1, false, expected, 3);
}

static void bad_pfm_is_an_error(void **state)
{
    (void)state;
    const float values[] = {1, 2, 3, 4};
    file_t file = {.size = 0};
    put_text(&file, "Pf\n2 2\n-1.0\n");
    put_floats(&file, values, 4, true);
    check_truncations("a.pfm", &file);
    check_damage("a.pfm", &file);
    assert_fails("a.pfm", file.bytes, file.size - 1, "a.pfm: is cut short: 15 bytes of pixels, expected 16");
    const struct {
        const char *text, *reason;
    } cases[] = {{"PF4\n1 1\n1\n....", "no width"},
                 {"PF\nx 1\n1\n....", "no width"},
                 {"PF\n1.5 1\n1\n....", "1.5 x 1"},
                 {"PF\nnan 1\n1\n....", "nan x 1"},
                 {"PF\n1 1e300\n1\n....", "1 x 1e+300"},
                 {"PF\n0 1\n1\n....", "outside the limits"},
                 {"PF\n-1 1\n1\n....", "outside"},
                 {"PF\n65536 4097\n1\n....", "outside the limits"},
                 {"Pf\n1 1\n0\n....", "no finite scale"},
                 {"Pf\n1 1\n1e99\n....", "no finite scale"},
                 {"Pf\n1 1\ninf\n....", "no finite"},
                 {"Pf\n65536 4096\n1\n....", "is cut short"},
                 {"Pf\n1 1\n1000000000000000000000000000000000000\n", "no finite scale"}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++)
        assert_fails("a.pfm", (const uint8_t *)cases[i].text, strlen(cases[i].text), cases[i].reason);
}

/* ---- OpenEXR ---- */

/* Writes planes of two by one pixels with these names of one letter; plane c has c + 1 and c + 1.5. */
static file_t write_exr(const char *folder, const char *names)
{
    char *path = scratch_path(folder, "x.exr");
    image_t image;
    image_init(&image, 2, 1);
    for (size_t c = 0; names[c] != '\0'; c++) {
        float *plane = image_add_channel(&image, (const char[]){names[c], '\0'}, PIXEL_FLOAT);
        plane[0] = (float)c + 1.0f;
        plane[1] = (float)c + 1.5f;
    }
    assert_int_equal(image_write_exr(path, &image).code, RESULT_OK);
    image_free(&image);
    size_t size;
    uint8_t *bytes = scratch_read(path, &size);
    file_t file = {.size = 0};
    put(&file, bytes, size);
    free(bytes);
    free(path);
    return file;
}

static void exr_channels_are_chosen(void **state)
{
    const struct {
        const char *names;
        uint32_t channels;
        const float expected[8];
    } cases[] = {{"RGB", 3, {1, 2, 3, 1.5, 2.5, 3.5}},
                 {"BAZGR", 4, {5, 4, 1, 2, 5.5, 4.5, 1.5, 2.5}},
                 {"Y", 1, {1, 1.5}},
                 {"ZAY", 2, {3, 2, 3.5, 2.5}},
                 {"Q", 1, {1, 1.5}},
                 {"A", 1, {1, 1.5}}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        file_t file = write_exr(*state, cases[i].names);
        check_floats("a.exr", &file, 2, 1, cases[i].channels, false, cases[i].expected, 0);
    }
    file_t file = write_exr(*state, "RGZ");
    assert_fails("a.exr", file.bytes, file.size, "a.exr: has neither R, G and B nor Y");
}

static void bad_exr_is_an_error(void **state)
{
    file_t file = write_exr(*state, "RGB");
    check_truncations("a.exr", &file);
    check_damage("a.exr", &file);
}

/* ---- files ---- */

static void files_are_told_by_their_bytes(void **state)
{
    char *path = scratch_path(*state, "picture.jpg");
    texture_image_t image;
    file_t file = small_png();
    scratch_write(path, file.bytes, file.size);
    assert_int_equal(texture_image_read(path, &image).code, RESULT_OK);
    assert_shape(&image, WIDTH, HEIGHT, 3, TEXELS_U8, true);
    texture_image_free(&image);

    scratch_write(path, file.bytes, file.size - 1);
    result_t result = texture_image_read(path, &image);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "picture.jpg: cannot be read as PNG"));
    assert_null(image.bytes);
    assert_int_equal(texture_image_read("/nowhere/a.png", &image).code, RESULT_INPUT);
    texture_image_free(&image);
    free(path);
}

static void what_is_no_image_is_refused(void **state)
{
    (void)state;
    file_t tga = write_tga(3, 8, 0, "abcd", 4);
    assert_fails("a.dat", tga.bytes, tga.size, "a.dat: is not an image that can be read");
    assert_fails("tga", tga.bytes, tga.size, "is not an image");
    assert_fails("a.png", (const uint8_t *)"GIF89a", 6, "is not an image");
    assert_fails("a.png", (const uint8_t *)"", 0, "is empty");
    assert_fails("a.tga", (const uint8_t *)"", 0, "is empty");
}

static void noise_is_survived(void **state)
{
    (void)state;
    static const char *const starts[] = {
        "\x89PNG\r\n\x1a\n", "\xff\xd8\xff", "\x76\x2f\x31\x01", "#?", "PF", ""};
    unsigned seed = 1;
    uint8_t bytes[300];
    for (int round = 0; round < 3000; round++) {
        const char *start = starts[(size_t)round % ARRAY_LENGTH(starts)];
        for (size_t i = 0; i < sizeof bytes; i++) bytes[i] = (uint8_t)rand_r(&seed);
        memcpy(bytes, start, strlen(start));
        texture_image_t image;
        result_t result = texture_image_decode("a.tga", bytes, sizeof bytes, &image);
        assert_true(result.code == RESULT_OK || strncmp(result.message, "a.tga: ", 7) == 0);
        texture_image_free(&image);
    }
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, setup, teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {TEST(png_of_all_colours_is_read),
                                       TEST(png_palettes_and_bits_are_expanded),
                                       TEST(bad_png_is_an_error),
                                       TEST(huge_png_is_refused),
                                       TEST(jpeg_is_read),
                                       TEST(bad_jpeg_is_an_error),
                                       TEST(webp_is_read),
                                       TEST(bad_webp_is_an_error),
                                       TEST(tga_is_turned_the_right_way_up),
                                       TEST(tga_of_all_depths_is_read),
                                       TEST(undeclared_alpha_counts_unless_empty),
                                       TEST(tga_packets_go_on_from_row_to_row),
                                       TEST(tga_colour_maps_are_looked_up),
                                       TEST(bad_tga_is_an_error),
                                       TEST(bmp_of_all_depths_is_read),
                                       TEST(bmp_with_a_positive_height_is_upside_down),
                                       TEST(bmp_alpha_counts_unless_it_is_empty),
                                       TEST(bmp_masks_say_where_the_colours_are),
                                       TEST(old_bmp_of_os2_is_read),
                                       TEST(bad_bmp_is_an_error),
                                       TEST(flat_hdr_is_read_in_all_directions),
                                       TEST(coded_hdr_is_read),
                                       TEST(bad_hdr_is_an_error),
                                       TEST(pfm_is_read_from_the_bottom),
                                       TEST(bad_values_are_counted),
                                       TEST(bad_pfm_is_an_error),
                                       TEST(exr_channels_are_chosen),
                                       TEST(bad_exr_is_an_error),
                                       TEST(files_are_told_by_their_bytes),
                                       TEST(what_is_no_image_is_refused),
                                       TEST(noise_is_survived)};
    return cmocka_run_group_tests_name("texture_image", tests, NULL, NULL);
}
