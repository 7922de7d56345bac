/* Tests of common/image*.c, atomic_file.c and picture.c: what is written is read back bit by bit, other
 * programs' files are read, bad files and full disks give errors that say what is wrong. */
#include "common/film/picture.h"
#include "tests/scratch.h"

#include <math.h>
#include <openexr.h>
#include <png.h>
#include <sched.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

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

static void assert_ok(result_t result)
{
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
}

static void assert_fails(result_t result, result_code_t code, const char *part)
{
    if (result.code != code || strstr(result.message, part) == NULL)
        fail_msg("expected code %d with '%s', got code %d: %s", code, part, result.code, result.message);
}

static uint32_t bits(float value)
{
    uint32_t u;
    memcpy(&u, &value, sizeof u);
    return u;
}

/* A value that differs in every pixel and channel and does not fit a half. */
static float pattern(size_t pixel, size_t channel)
{
    return (float)sin((double)pixel * 0.37 + (double)channel) * 3.0f + 0.001f * (float)channel;
}

enum { WIDTH = 37, HEIGHT = 41, PIXELS = WIDTH * HEIGHT };

/* An image with planes of the given names. */
static void make_image(image_t *image, const char *const *names, size_t count, pixel_type_t type)
{
    image_init(image, WIDTH, HEIGHT);
    for (size_t c = 0; c < count; c++) {
        float *plane = image_add_channel(image, names[c], type);
        assert_non_null(plane);
        for (size_t p = 0; p < PIXELS; p++) plane[p] = pattern(p, c);
    }
}

static const char *const layers[] = {"R", "G", "B", "light.R", "light.G", "light.B", "samples"};

static void add_rgb_views(image_t *image, const float *rgb)
{
    for (size_t c = 0; c < 3; c++) image_add_view(image, layers[c], PIXEL_FLOAT, rgb + c, 3);
}

static void assert_same_pixels(const image_t *a, const image_t *b)
{
    assert_int_equal(a->width, b->width);
    assert_int_equal(a->height, b->height);
    assert_int_equal(a->channel_count, b->channel_count);
    for (size_t i = 0; i < a->channel_count; i++) {
        const image_channel_t *left = &a->channels[i], *right = image_find(b, left->name);
        assert_non_null(right);
        for (size_t p = 0; p < (size_t)a->width * (size_t)a->height; p++)
            assert_int_equal(bits(left->data[p * left->stride]), bits(right->data[p * right->stride]));
    }
}

/* ---- what we write ---- */

static void floats_come_back_bit_by_bit(void **state)
{
    char *path = scratch_path(*state, "a.exr");
    image_t image, back;
    make_image(&image, layers, ARRAY_LENGTH(layers), PIXEL_FLOAT);
    const float special[] = {NAN, INFINITY, -INFINITY, -0.0f, 1e-42f, 3.4e38f, -1.0f};
    memcpy(image.channels[3].plane + 100, special, sizeof special);
    assert_ok(image_write_exr(path, &image));
    assert_ok(image_read_exr(path, &back));
    assert_same_pixels(&image, &back);
    assert_int_equal(back.channels[0].type, PIXEL_FLOAT);
    assert_int_equal(scratch_count(*state), 1); /* no temporary is left */
    struct stat about;
    mode_t mask = umask(0);
    umask(mask);
    assert_int_equal(stat(path, &about), 0);
    assert_int_equal(about.st_mode & 0777, 0666 & ~mask);
    image_free(&image);
    image_free(&back);
    free(path);
}

static uint8_t *read_all(const char *path, size_t *size)
{
    struct stat about;
    assert_int_equal(stat(path, &about), 0);
    *size = (size_t)about.st_size;
    uint8_t *bytes = mem_alloc(*size);
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    assert_int_equal(fread(bytes, 1, *size, file), *size);
    fclose(file);
    return bytes;
}

/* The writer takes as many threads as the process may use cores: one makes the same bytes as all. */
static void any_number_of_threads_writes_the_same_file(void **state)
{
    char *path = scratch_path(*state, "a.exr");
    image_t image;
    image_init(&image, 300, 1000); /* 63 chunks */
    for (size_t c = 0; c < 3; c++) {
        float *plane = image_add_channel(&image, layers[c], PIXEL_FLOAT);
        for (size_t p = 0; p < 300000; p++)
            plane[p] = pattern(p * (p % 700 < 300), c); /* some compress better */
    }
    cpu_set_t all, one;
    size_t sizes[2];
    assert_int_equal(sched_getaffinity(0, sizeof all, &all), 0);
    assert_ok(image_write_exr(path, &image));
    uint8_t *many = read_all(path, &sizes[0]);
    CPU_ZERO(&one);
    for (int cpu = 0; CPU_COUNT(&one) == 0; cpu++)
        if (CPU_ISSET(cpu, &all)) CPU_SET(cpu, &one);
    assert_int_equal(sched_setaffinity(0, sizeof one, &one), 0);
    assert_ok(image_write_exr(path, &image));
    assert_int_equal(sched_setaffinity(0, sizeof all, &all), 0);
    uint8_t *single = read_all(path, &sizes[1]);
    assert_int_equal(sizes[0], sizes[1]);
    assert_memory_equal(many, single, sizes[0]);
    free(many);
    free(single);
    image_free(&image);
    free(path);
}

static void attributes_come_back(void **state)
{
    char *path = scratch_path(*state, "a.exr");
    image_t image, back;
    make_image(&image, layers, 3, PIXEL_FLOAT);
    image_set_string(&image, "lightmill.note", "a \"quoted\" text");
    image_set_string(&image, "lightmill.empty", "");
    image_set_int(&image, "lightmill.int", -123456);
    image_set_float(&image, "lightmill.float", 0.1f);
    image_set_u64(&image, "lightmill.u64", UINT64_MAX);
    assert_ok(image_write_exr(path, &image));
    assert_ok(image_read_exr(path, &back));
    assert_string_equal(image_attribute(&back, "lightmill.note")->text, "a \"quoted\" text");
    assert_string_equal(image_attribute(&back, "lightmill.empty")->text, "");
    assert_int_equal(image_attribute(&back, "lightmill.int")->integer, -123456);
    assert_int_equal(bits(image_attribute(&back, "lightmill.float")->real), bits(0.1f));
    assert_string_equal(image_attribute(&back, "lightmill.u64")->text, "18446744073709551615");
    assert_string_equal(image_attribute(&back, "dataWindow")->text, "0 0 to 36 40");
    assert_string_equal(image_attribute(&back, "compression")->text, "zip");
    assert_null(image_attribute(&back, "nothing"));
    image_free(&image);
    image_free(&back);
    free(path);
}

static void halves_are_rounded_and_clamped(void **state)
{
    char *path = scratch_path(*state, "a.exr");
    image_t image, back;
    make_image(&image, layers, 1, PIXEL_HALF);
    const float given[] = {1.0f, 1.0f + 0x1p-11f, 1.0f + 0x3p-11f, 65504.0f, 1e6f, -1e6f, INFINITY, NAN};
    const float expected[] = {1.0f, 1.0f, 1.0f + 0x4p-11f, 65504.0f, 65504.0f, -65504.0f, INFINITY};
    memcpy(image.channels[0].plane, given, sizeof given);
    assert_ok(image_write_exr(path, &image));
    assert_ok(image_read_exr(path, &back));
    assert_int_equal(back.channels[0].type, PIXEL_HALF);
    for (size_t i = 0; i < ARRAY_LENGTH(expected); i++)
        assert_int_equal(bits(back.channels[0].data[i]), bits(expected[i]));
    assert_true(isnan(back.channels[0].data[7]));
    for (size_t p = ARRAY_LENGTH(given); p < PIXELS; p++)
        assert_true(fabsf(back.channels[0].data[p] - image.channels[0].data[p]) <= 0x1p-10f);
    image_free(&image);
    image_free(&back);
    free(path);
}

static void views_are_written_like_planes(void **state)
{
    char *path = scratch_path(*state, "a.exr");
    image_t planes, views, back;
    make_image(&planes, layers, 3, PIXEL_FLOAT);
    float *interleaved = mem_alloc(PIXELS * 3 * sizeof *interleaved);
    for (size_t p = 0; p < PIXELS; p++)
        for (size_t c = 0; c < 3; c++) interleaved[3 * p + c] = pattern(p, c);
    image_init(&views, WIDTH, HEIGHT);
    add_rgb_views(&views, interleaved);
    assert_same_pixels(&planes, &views);
    assert_ok(image_write_exr(path, &views));
    assert_ok(image_read_exr(path, &back));
    assert_same_pixels(&planes, &back);
    image_free(&planes);
    image_free(&views);
    image_free(&back);
    free(interleaved);
    free(path);
}

/* Chunks of 64 bytes, each with a different share of noise: some of them compress to exactly 64 bytes, which
 * OpenEXRCore 3.1 left to itself writes so that nobody can read them. */
static void chunks_that_do_not_shrink_survive(void **state)
{
    enum { CHUNKS = 2000, LINES = 16 };
    char *path = scratch_path(*state, "a.exr");
    unsigned seed = 1;
    image_t image, back;
    image_init(&image, 1, CHUNKS * LINES);
    float *plane = image_add_channel(&image, "Y", PIXEL_FLOAT);
    for (size_t chunk = 0; chunk < CHUNKS; chunk++) {
        uint32_t mask = (uint32_t)rand_r(&seed) & 0x7FFFFF;
        for (size_t line = 0; line < LINES; line++) {
            uint32_t value = 0x3F800000u | (((uint32_t)rand_r(&seed) << 8 ^ (uint32_t)rand_r(&seed)) & mask);
            memcpy(&plane[chunk * LINES + line], &value, sizeof value);
        }
    }
    assert_ok(image_write_exr(path, &image));
    assert_ok(image_read_exr(path, &back));
    assert_same_pixels(&image, &back);
    image_free(&image);
    image_free(&back);
    free(path);
}

/* ---- the hash ---- */

static void assert_hash_equal(const image_t *a, const image_t *b, bool equal)
{
    hash_t left = image_hash(a), right = image_hash(b);
    assert_int_equal(hash_equal(&left, &right), equal);
}

static void hash_sees_pixels_only(void **state)
{
    const char *const reversed[] = {"B", "G", "R"};
    (void)state;
    image_t a, b;
    make_image(&a, layers, 3, PIXEL_FLOAT);
    make_image(&b, reversed, 3, PIXEL_HALF);
    for (size_t c = 0; c < 3; c++)
        memcpy(b.channels[c].plane, a.channels[2 - c].plane, PIXELS * sizeof(float));
    image_set_string(&b, "lightmill.note", "differs");
    assert_hash_equal(&a, &b, true);

    float *pixel = &b.channels[1].plane[PIXELS - 1], kept = *pixel;
    *pixel = nextafterf(kept, 9.0f);
    assert_hash_equal(&a, &b, false);
    *pixel = kept;
    free(b.channels[0].name);
    b.channels[0].name = mem_strdup("b");
    assert_hash_equal(&a, &b, false);
    free(b.channels[0].name);
    b.channels[0].name = mem_strdup("B");
    assert_hash_equal(&a, &b, true);
    b.width = HEIGHT;
    b.height = WIDTH;
    assert_hash_equal(&a, &b, false);
    image_free(&a);
    image_free(&b);
}

/* The definition in image.h, computed elsewhere:
 * hashlib.blake2b(struct.pack('<II', 2, 1) + b'Y\0' + struct.pack('<ff', 1, -2.5), digest_size=32) */
static void hash_is_as_documented(void **state)
{
    (void)state;
    const float values[] = {1.0f, -2.5f};
    image_t image;
    image_init(&image, 2, 1);
    image_add_view(&image, "Y", PIXEL_FLOAT, values, 1);
    hash_t hash = image_hash(&image);
    char text[2 * HASH_BYTES + 1];
    hash_to_hex(&hash, text);
    assert_string_equal(text, "7c2987a352ce185cb098a5bd77ab2d1ebf15d16937511b7fd49e8ca06e637344");
    image_free(&image);
}

/* ---- what others write ---- */

/* What foreign_file writes. */
typedef struct {
    exr_compression_t compression;
    exr_pixel_type_t type;
    int tile; /* pixels a side, 0 for scanlines */
} foreign_t;

static const exr_attr_box2i_t foreign_window = {{{{-3, 5}}}, {{{-3 + WIDTH - 1, 5 + HEIGHT - 1}}}};

/* Exact in every pixel type and compression, and small enough for every chunk to shrink. */
static float foreign_value(size_t pixel)
{
    return (float)(pixel % WIDTH / 4 + 3 * (pixel / WIDTH));
}

/* Whole numbers as uint or float values in fresh memory. */
static void *foreign_values(exr_pixel_type_t type)
{
    float *values = mem_alloc(PIXELS * sizeof *values);
    for (size_t p = 0; p < PIXELS; p++) {
        values[p] = foreign_value(p);
        if (type == EXR_PIXEL_UINT) memcpy(&values[p], &(uint32_t){(uint32_t)values[p]}, sizeof(uint32_t));
    }
    return values;
}

static void encode_chunk(exr_context_t context, exr_chunk_info_t *chunk, int x, int y,
                         const foreign_t *foreign, const void *values)
{
    exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
    assert_int_equal(exr_encoding_initialize(context, 0, chunk, &encoder), 0);
    encoder.channels[0].encode_from_ptr = (const uint8_t *)values + 4 * (y * WIDTH + x);
    encoder.channels[0].user_data_type = foreign->type == EXR_PIXEL_UINT ? EXR_PIXEL_UINT : EXR_PIXEL_FLOAT;
    encoder.channels[0].user_bytes_per_element = 4;
    encoder.channels[0].user_pixel_stride = 4;
    encoder.channels[0].user_line_stride = 4 * WIDTH;
    assert_int_equal(exr_encoding_choose_default_routines(context, 0, &encoder), 0);
    assert_int_equal(exr_encoding_run(context, 0, &encoder), 0);
    exr_encoding_destroy(context, &encoder);
}

static void encode_lines(exr_context_t context, const foreign_t *foreign, const void *values)
{
    int32_t lines = 0;
    exr_chunk_info_t chunk;
    assert_int_equal(exr_get_scanlines_per_chunk(context, 0, &lines), 0);
    for (int y = 0; y < HEIGHT; y += lines) {
        assert_int_equal(exr_write_scanline_chunk_info(context, 0, y + foreign_window.min.y, &chunk), 0);
        encode_chunk(context, &chunk, 0, y, foreign, values);
    }
}

static void encode_tiles(exr_context_t context, const foreign_t *foreign, const void *values)
{
    int tile = foreign->tile;
    exr_chunk_info_t chunk;
    for (int y = 0; y < HEIGHT; y += tile)
        for (int x = 0; x < WIDTH; x += tile) {
            assert_int_equal(exr_write_tile_chunk_info(context, 0, x / tile, y / tile, 0, 0, &chunk), 0);
            encode_chunk(context, &chunk, x, y, foreign, values);
        }
}

/* Starts an EXR with one channel "Y" and a data window that does not begin at 0, straight from OpenEXRCore.
 */
static exr_context_t foreign_start(const char *path, exr_storage_t storage, const foreign_t *foreign)
{
    const exr_attr_v2f_t centre = {{{0, 0}}};
    uint32_t tile = (uint32_t)foreign->tile;
    exr_context_t context;
    assert_int_equal(exr_start_write(&context, path, EXR_WRITE_FILE_DIRECTLY, NULL), 0);
    assert_int_equal(exr_add_part(context, "part", storage, NULL), 0);
    assert_int_equal(exr_initialize_required_attr(context, 0, &foreign_window, &foreign_window, 1.0f, &centre,
                                                  1.0f, EXR_LINEORDER_INCREASING_Y, foreign->compression),
                     0);
    if (tile > 0)
        assert_int_equal(
            exr_set_tile_descriptor(context, 0, tile, tile, EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN), 0);
    assert_int_equal(exr_add_channel(context, 0, "Y", foreign->type, EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1), 0);
    if (storage == EXR_STORAGE_DEEP_SCANLINE) assert_int_equal(exr_set_version(context, 0, 1), 0);
    assert_int_equal(exr_write_header(context), 0);
    return context;
}

static void foreign_file(const char *path, foreign_t foreign)
{
    exr_storage_t storage = foreign.tile > 0 ? EXR_STORAGE_TILED : EXR_STORAGE_SCANLINE;
    exr_context_t context = foreign_start(path, storage, &foreign);
    void *values = foreign_values(foreign.type);
    (foreign.tile > 0 ? encode_tiles : encode_lines)(context, &foreign, values);
    free(values);
    assert_int_equal(exr_finish(&context), 0);
}

/* A deep image without samples. */
static void deep_file(const char *path)
{
    const int32_t counts[WIDTH] = {0};
    exr_context_t context =
        foreign_start(path, EXR_STORAGE_DEEP_SCANLINE, &(foreign_t){EXR_COMPRESSION_NONE, EXR_PIXEL_HALF, 0});
    for (int y = foreign_window.min.y; y <= foreign_window.max.y; y++)
        assert_int_equal(exr_write_deep_scanline_chunk(context, 0, y, counts, 0, 0, counts, sizeof counts),
                         0);
    assert_int_equal(exr_finish(&context), 0);
}

static void foreign_files_are_read(void **state)
{
    char *path = scratch_path(*state, "f.exr");
    const exr_compression_t kinds[] = {EXR_COMPRESSION_NONE, EXR_COMPRESSION_RLE, EXR_COMPRESSION_ZIPS,
                                       EXR_COMPRESSION_ZIP,  EXR_COMPRESSION_PIZ, EXR_COMPRESSION_PXR24};
    for (size_t i = 0; i < ARRAY_LENGTH(kinds); i++)
        for (int type = EXR_PIXEL_UINT; type <= EXR_PIXEL_FLOAT; type++)
            for (int tile = 0; tile <= 16; tile += 16) {
                image_t image;
                foreign_file(path, (foreign_t){kinds[i], (exr_pixel_type_t)type, tile});
                assert_ok(image_read_exr(path, &image));
                assert_int_equal(image.width, WIDTH);
                assert_int_equal(image.height, HEIGHT);
                assert_int_equal(image.channel_count, 1);
                for (size_t p = 0; p < PIXELS; p++)
                    assert_true(image.channels[0].data[p] == foreign_value(p));
                image_free(&image);
            }
    free(path);
}

static void what_cannot_be_read_is_refused(void **state)
{
    char *path = scratch_path(*state, "f.exr");
    image_t image;
    foreign_file(path, (foreign_t){EXR_COMPRESSION_B44, EXR_PIXEL_HALF, 0});
    assert_ok(image_read_exr(path, &image));
    image_free(&image);
    foreign_file(path, (foreign_t){EXR_COMPRESSION_B44, EXR_PIXEL_FLOAT, 0});
    assert_fails(image_read_exr(path, &image), RESULT_INPUT, "B44");
    deep_file(path);
    assert_fails(image_read_exr(path, &image), RESULT_INPUT, "deep");
    free(path);
}

/* ---- bad files ---- */

static void missing_files_are_named(void **state)
{
    image_t image;
    assert_fails(image_read_exr("/nowhere/x.exr", &image), RESULT_INPUT,
                 "/nowhere/x.exr: cannot be opened: No such");
    assert_fails(image_read_exr(*state, &image), RESULT_INPUT, "is not a regular file");
    char *path = scratch_path(*state, "text.exr");
    scratch_write(path, "not an image at all", 19);
    assert_fails(image_read_exr(path, &image), RESULT_INPUT, "text.exr: cannot be read as OpenEXR");
    free(path);
}

/* A small file of ours in memory. */
static uint8_t *small_file(const char *folder, size_t *size)
{
    char *path = scratch_path(folder, "whole.exr");
    image_t image;
    make_image(&image, layers, 4, PIXEL_FLOAT);
    image_set_string(&image, "lightmill.note", "text");
    assert_ok(image_write_exr(path, &image));
    image_free(&image);
    uint8_t *bytes = scratch_read(path, size);
    free(path);
    return bytes;
}

static void truncated_files_are_errors(void **state)
{
    char *path = scratch_path(*state, "cut.exr");
    size_t size;
    uint8_t *bytes = small_file(*state, &size);
    scratch_capture_t capture = scratch_capture(*state, 2);
    for (size_t length = 0; length < size; length += length < 900 ? 1 : 97) {
        image_t image;
        scratch_write(path, bytes, length);
        assert_fails(image_read_exr(path, &image), RESULT_INPUT, "cut.exr: cannot be read as OpenEXR: ");
        assert_null(image.channels);
    }
    char *said = scratch_uncapture(&capture);
    assert_string_equal(said, ""); /* the library is silent */
    free(said);
    free(bytes);
    free(path);
}

/* Copies rows into an image that was read whole. */
static result_t take_rows(void *context, const image_t *rows, int y, int height)
{
    const image_t *whole = context;
    assert_int_equal(height, whole->height);
    assert_true(rows->height <= 16 && y + rows->height <= height);
    for (size_t c = 0; c < rows->channel_count; c++) {
        const image_channel_t *channel = image_find(whole, rows->channels[c].name);
        assert_non_null(channel);
        size_t row = (size_t)whole->width;
        memcpy(channel->plane + row * (size_t)y, rows->channels[c].data,
               row * (size_t)rows->height * sizeof(float));
    }
    return result_ok();
}

static result_t refuse_rows(void *context, const image_t *rows, int y, int height)
{
    (void)rows, (void)y, (void)height;
    ++*(int *)context;
    return result_fail(RESULT_LIMIT, "enough");
}

static void files_are_read_row_by_row(void **state)
{
    char *path = scratch_path(*state, "a.exr");
    image_t image, back;
    int calls = 0;
    make_image(&image, layers, ARRAY_LENGTH(layers), PIXEL_FLOAT);
    assert_ok(image_write_exr(path, &image));
    assert_ok(image_read_exr(path, &back));
    for (size_t c = 0; c < back.channel_count; c++) memset(back.channels[c].plane, 0, PIXELS * sizeof(float));
    assert_ok(image_read_exr_rows(path, take_rows, &back));
    assert_same_pixels(&image, &back);
    assert_fails(image_read_exr_rows(path, refuse_rows, &calls), RESULT_LIMIT, "enough");
    assert_int_equal(calls, 1);
    image_free(&image);
    image_free(&back);
    foreign_file(path, (foreign_t){EXR_COMPRESSION_ZIP, EXR_PIXEL_FLOAT, 16});
    assert_fails(image_read_exr_rows(path, refuse_rows, &calls), RESULT_INPUT, "is in tiles");
    free(path);
}

/* Whatever the bytes are: an image or an error, and no finding of the sanitizers. */
static void damaged_files_are_survived(void **state)
{
    char *path = scratch_path(*state, "bad.exr");
    size_t size, errors = 0;
    uint8_t *bytes = small_file(*state, &size);
    unsigned seed = 1;
    for (int round = 0; round < 1500; round++) {
        size_t range = round % 2 == 0 ? 700 : size; /* the header is where the traps are */
        size_t at = (size_t)rand_r(&seed) % range;
        uint8_t kept = bytes[at];
        bytes[at] = (uint8_t)(round % 3 == 0 ? 0xFF : rand_r(&seed));
        scratch_write(path, bytes, size);
        image_t image;
        result_t result = image_read_exr(path, &image);
        errors += result.code != RESULT_OK;
        assert_true(result.code == RESULT_OK || strstr(result.message, "bad.exr") != NULL);
        image_free(&image);
        bytes[at] = kept;
    }
    assert_true(errors > 100);
    free(bytes);
    free(path);
}

/* Overwrites the corners of the window that is called `name`. */
static void patch_window(uint8_t *bytes, size_t size, const char *name, const int32_t corners[4])
{
    uint8_t *at = memmem(bytes, size, name, strlen(name) + 1);
    assert_non_null(at);
    memcpy(at + strlen(name) + 1 + sizeof "box2i" + 4, corners, 16);
}

static void subsampled_channels_are_refused(void **state)
{
    char *path = scratch_path(*state, "sub.exr");
    size_t size;
    uint8_t *bytes = small_file(*state, &size);
    uint8_t *channel = memmem(bytes, size, "light.R", sizeof "light.R");
    assert_non_null(channel);
    /* Behind the name: pixel type, perceptual flag and padding, x sampling. */
    memcpy(channel + sizeof "light.R" + 8, &(int32_t){WIDTH}, sizeof(int32_t));
    scratch_write(path, bytes, size);
    image_t image;
    assert_fails(image_read_exr(path, &image), RESULT_INPUT, "light.R is subsampled");
    free(bytes);
    free(path);
}

static void huge_sizes_are_refused(void **state)
{
    char *path = scratch_path(*state, "huge.exr");
    size_t size;
    uint8_t *bytes = small_file(*state, &size);
    const int32_t windows[][4] = {{0, 0, 32767, 32767},
                                  {0, 0, 2000000000, 10},
                                  {-2147483647, -2147483647, 2147483647, 2147483647},
                                  {5, 5, 4, 4}};
    for (size_t i = 0; i < ARRAY_LENGTH(windows); i++) {
        image_t image;
        patch_window(bytes, size, "dataWindow", windows[i]);
        patch_window(bytes, size, "displayWindow", windows[i]);
        scratch_write(path, bytes, size);
        assert_int_equal(image_read_exr(path, &image).code, RESULT_INPUT);
    }
    /* At the limit but without the pixels: an error, and soon. */
    image_t image;
    patch_window(bytes, size, "dataWindow", (const int32_t[4]){0, 0, 32767, 4095});
    scratch_write(path, bytes, size);
    assert_int_equal(image_read_exr(path, &image).code, RESULT_INPUT);
    free(bytes);
    free(path);
}

/* ---- whole or not at all ---- */

typedef result_t write_function_t(const char *path, const image_t *image);

static result_t write_png(const char *path, const image_t *image)
{
    return image_write_png(path, image, 0.0f);
}

/* Limits the size of files, which stands for a full disk. */
static void limit_files(rlim_t bytes)
{
    signal(SIGXFSZ, SIG_IGN);
    struct rlimit limit;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &limit), 0);
    limit.rlim_cur = bytes;
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
}

static void check_failed_write(const char *folder, const char *name, write_function_t *write_image)
{
    char *path = scratch_path(folder, name);
    image_t image;
    make_image(&image, layers, 7, PIXEL_FLOAT);
    scratch_write(path, "old", 3);
    size_t files = scratch_count(folder);
    for (rlim_t limit = 1; limit < 1000; limit += 333) {
        limit_files(limit);
        result_t result = write_image(path, &image);
        limit_files(RLIM_INFINITY);
        assert_fails(result, RESULT_IO, "cannot be written: File too large");
        assert_non_null(strstr(result.message, name));
        size_t size;
        uint8_t *old = scratch_read(path, &size);
        assert_int_equal(size, 3);
        assert_memory_equal(old, "old", 3);
        free(old);
        assert_int_equal(scratch_count(folder), files);
    }
    assert_ok(write_image(path, &image));
    assert_int_equal(scratch_count(folder), files);
    image_free(&image);
    free(path);
}

static void full_disks_leave_the_old_file(void **state)
{
    check_failed_write(*state, "a.exr", image_write_exr);
    check_failed_write(*state, "a.png", write_png);
}

static void unwritable_folders_are_named(void **state)
{
    (void)state;
    image_t image;
    make_image(&image, layers, 3, PIXEL_FLOAT);
    assert_fails(image_write_exr("/nowhere/a.exr", &image), RESULT_IO,
                 "/nowhere/a.exr: cannot be written: No such");
    assert_fails(write_png("/proc/a.png", &image), RESULT_IO, "/proc/a.png: cannot be written: ");
    image_free(&image);
}

/* ---- PNG ---- */

static uint8_t *read_png(const char *path, int width, int height)
{
    png_image png = {.version = PNG_IMAGE_VERSION};
    assert_true(png_image_begin_read_from_file(&png, path));
    png.format = PNG_FORMAT_RGB;
    assert_int_equal(png.width, width);
    assert_int_equal(png.height, height);
    uint8_t *pixels = mem_alloc(PNG_IMAGE_SIZE(png));
    assert_true(png_image_finish_read(&png, NULL, pixels, 0, NULL));
    return pixels;
}

static void png_is_srgb(void **state)
{
    /* Linear values and their sRGB bytes, worked out from the standard's formula. */
    const float linear[4][3] = {
        {0.0f, 1.0f, 0.21404114f}, {-1.0f, 7.0f, 0.5f}, {NAN, INFINITY, 0.002f}, {0.01f, 0.003f, 0.0f}};
    const uint8_t encoded[4][3] = {{0, 255, 128}, {0, 255, 188}, {0, 255, 7}, {25, 10, 0}};
    char *path = scratch_path(*state, "a.png");
    image_t image;
    image_init(&image, 4, 1);
    add_rgb_views(&image, &linear[0][0]);
    assert_ok(image_write_png(path, &image, 0.0f));
    uint8_t *pixels = read_png(path, 4, 1);
    assert_memory_equal(pixels, encoded, sizeof encoded);
    free(pixels);
    assert_ok(image_write_png(path, &image, 1.0f)); /* one stop brighter: twice the light */
    pixels = read_png(path, 4, 1);
    assert_int_equal(pixels[2], 175); /* 0.428 */
    assert_int_equal(pixels[5], 255); /* 1.0 */
    free(pixels);
    image_free(&image);
    free(path);
}

static void png_needs_rgb(void **state)
{
    char *path = scratch_path(*state, "a.png");
    image_t image;
    make_image(&image, layers, 2, PIXEL_FLOAT);
    assert_fails(image_write_png(path, &image, 0.0f), RESULT_INPUT, "R, G and B");
    image_free(&image);
    free(path);
}

/* ---- pictures ---- */

static void picture_has_layers_and_history(void **state)
{
    char *path = scratch_path(*state, "p.exr"), *png = picture_png_path(path);
    float planes[4][12], samples[4] = {3, 4, 5, 70000};
    for (size_t i = 0; i < 48; i++) planes[i / 12][i % 12] = (float)i + 0.1f;
    float position[12], depth[4] = {0}, object[4] = {1, 2, 3, 100001}, coverage[4] = {1, 1, 1, 0.5f};
    for (size_t i = 0; i < 12; i++) position[i] = (float)i + 1000.1f;
    film_image_t film = {.width = 2,
                         .height = 2,
                         .sum = planes[0],
                         .eye = planes[1],
                         .light = planes[2],
                         .noise = planes[3],
                         .samples = samples};
    picture_meta_t meta = {
        .scene = hash_bytes("x", 1),
        .scene_name = "cornell",
        .settings = job_settings_default(),
        .counts = {.light_paths = {6, 5}, .cpu_us = 2500000, .rays = 1ull << 40, .dropped = 2},
        .workers = 3};
    meta.settings.seed = 1ull << 63;
    assert_ok(picture_write_exr(path, &film, &meta, false));
    image_t image;
    assert_ok(image_read_exr(path, &image));
    assert_ok(image_write_png(png, &image, 0.0f));
    assert_int_equal(image.channel_count, 13);
    assert_true(image_find(&image, "G")->data[3] == planes[0][10]);
    assert_true(image_find(&image, "eye.R")->data[2] == planes[1][6]);
    assert_true(image_find(&image, "light.B")->data[0] == planes[2][2]);
    assert_true(image_find(&image, "noise.B")->data[3] == planes[3][11]);
    assert_true(image_find(&image, "samples")->data[3] == 70000.0f);
    assert_string_equal(image_attribute(&image, "lightmill.seed")->text, "9223372036854775808");
    assert_string_equal(image_attribute(&image, "lightmill.integrator")->text, "bdpt");
    assert_string_equal(image_attribute(&image, "lightmill.samples")->text, "70012");
    assert_string_equal(image_attribute(&image, "lightmill.lightPaths")->text, "11");
    assert_string_equal(image_attribute(&image, "lightmill.rays")->text, "1099511627776");
    assert_true(image_attribute(&image, "lightmill.cpuSeconds")->real == 2.5f);
    assert_int_equal(image_attribute(&image, "lightmill.workers")->integer, 3);
    assert_int_equal(strlen(image_attribute(&image, "lightmill.sceneHash")->text), 64);
    image_free(&image);

    film.albedo = planes[1];
    film.normal = planes[2];
    film.position = position;
    film.depth = depth;
    film.object = object;
    film.material = samples;
    film.coverage = coverage;
    assert_ok(picture_write_exr(path, &film, &meta, true));
    assert_ok(image_read_exr(path, &image));
    assert_int_equal(image.channel_count, 26);
    assert_int_equal(image_find(&image, "albedo.G")->type, PIXEL_HALF);
    assert_int_equal(image_find(&image, "normal.X")->type, PIXEL_HALF);
    assert_true(image_find(&image, "normal.Z")->data[0] == image_find(&image, "light.B")->data[0]);
    assert_true(image_find(&image, "position.Y")->data[3] == position[10]);
    assert_true(image_find(&image, "object.id")->data[3] == 100001.0f);
    assert_true(image_find(&image, "material.id")->data[3] == 70000.0f);
    assert_int_equal(image_find(&image, "depth.Z")->type, PIXEL_FLOAT);
    assert_true(image_find(&image, "coverage")->data[3] == 0.5f);
    assert_int_equal(image_find(&image, "noise.R")->type, PIXEL_HALF);
    assert_true(image_find(&image, "samples")->data[3] == 70000.0f);
    image_free(&image);
    free(path);
    free(png);
}

static void png_paths_replace_the_extension(void **state)
{
    const char *const cases[][2] = {{"a.exr", "a.png"},
                                    {"dir.d/a", "dir.d/a.png"},
                                    {"dir.d/a.b.exr", "dir.d/a.b.png"},
                                    {".hidden", ".hidden.png"},
                                    {"x/.exr", "x/.exr.png"}};
    (void)state;
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        char *path = picture_png_path(cases[i][0]);
        assert_string_equal(path, cases[i][1]);
        free(path);
    }
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, setup, teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {TEST(floats_come_back_bit_by_bit),
                                       TEST(any_number_of_threads_writes_the_same_file),
                                       TEST(attributes_come_back),
                                       TEST(halves_are_rounded_and_clamped),
                                       TEST(views_are_written_like_planes),
                                       TEST(chunks_that_do_not_shrink_survive),
                                       TEST(hash_sees_pixels_only),
                                       TEST(hash_is_as_documented),
                                       TEST(foreign_files_are_read),
                                       TEST(what_cannot_be_read_is_refused),
                                       TEST(missing_files_are_named),
                                       TEST(truncated_files_are_errors),
                                       TEST(files_are_read_row_by_row),
                                       TEST(damaged_files_are_survived),
                                       TEST(subsampled_channels_are_refused),
                                       TEST(huge_sizes_are_refused),
                                       TEST(full_disks_leave_the_old_file),
                                       TEST(unwritable_folders_are_named),
                                       TEST(png_is_srgb),
                                       TEST(png_needs_rgb),
                                       TEST(picture_has_layers_and_history),
                                       TEST(png_paths_replace_the_extension)};
    return cmocka_run_group_tests_name("image", tests, NULL, NULL);
}
