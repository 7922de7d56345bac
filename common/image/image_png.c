/* image_png: 8-bit sRGB previews through libpng (see image.h). */
#include "common/atomic_file.h"
#include "common/image/image.h"

#include <math.h>
#include <png.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>

/* What our callbacks share with the caller; libpng knows only addresses in it. */
typedef struct {
    const image_t *image;
    const image_channel_t *rgb[3];
    float scale;
    uint8_t *row; /* width RGB triples */
    atomic_file_t file;
    uint64_t offset;
    char message[256];
} png_writer_t;

/* The sRGB transfer function, IEC 61966-2-1, of a value clipped to [0, 1]; NaN gives 0. */
static uint8_t srgb_byte(float linear)
{
    float clipped = linear > 0.0f ? fminf(linear, 1.0f) : 0.0f;
    float encoded = clipped <= 0.0031308f ? 12.92f * clipped : 1.055f * powf(clipped, 1.0f / 2.4f) - 0.055f;
    return (uint8_t)(255.0f * encoded + 0.5f);
}

static void write_bytes(png_structp png, png_bytep data, png_size_t size)
{
    png_writer_t *writer = png_get_io_ptr(png);
    if (!atomic_file_write_at(&writer->file, data, size, writer->offset)) png_error(png, "a write failed");
    writer->offset += size;
}

static void flush_bytes(png_structp png)
{
    (void)png;
}

static void keep_error(png_structp png, png_const_charp message)
{
    png_writer_t *writer = png_get_error_ptr(png);
    snprintf(writer->message, sizeof writer->message, "%s", message);
    png_longjmp(png, 1);
}

static void ignore_warning(png_structp png, png_const_charp message)
{
    (void)png, (void)message;
}

static void fill_row(png_writer_t *writer, int y)
{
    size_t width = (size_t)writer->image->width;
    for (size_t x = 0; x < width; x++)
        for (size_t c = 0; c < 3; c++) {
            const image_channel_t *channel = writer->rgb[c];
            float value = channel->data[((size_t)y * width + x) * channel->stride];
            writer->row[3 * x + c] = srgb_byte(writer->scale * value);
        }
}

/* False when libpng gave up. Keeps no variable over the long jump. */
static bool encode(png_writer_t *writer, png_structp png, png_infop info)
{
    if (setjmp(png_jmpbuf(png)) != 0) return false;
    png_set_write_fn(png, writer, write_bytes, flush_bytes);
    png_set_IHDR(png, info, (png_uint_32)writer->image->width, (png_uint_32)writer->image->height, 8,
                 PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
                 PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    png_write_info(png, info);
    for (int y = 0; y < writer->image->height; y++) {
        fill_row(writer, y);
        png_write_row(png, writer->row);
    }
    png_write_end(png, info);
    return true;
}

static result_t encode_file(png_writer_t *writer, const char *path)
{
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, writer, keep_error, ignore_warning);
    png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
    bool good = info != NULL && encode(writer, png, info);
    png_destroy_write_struct(&png, &info);
    return good ? result_ok()
                : result_fail(RESULT_IO, "%s: cannot be written as PNG: %s", path, writer->message);
}

result_t image_write_png(const char *path, const image_t *image, float exposure)
{
    png_writer_t writer = {.image = image, .scale = exp2f(exposure)};
    if (!image_find_rgb(image, NULL, writer.rgb))
        return result_fail(RESULT_INPUT, "%s: a PNG needs the channels R, G and B", path);
    TRY(atomic_file_open(&writer.file, path));
    writer.row = mem_alloc((size_t)image->width * 3);
    result_t result = encode_file(&writer, path);
    free(writer.row);
    /* A write that failed is known to the file with its cause. */
    if (result.code == RESULT_OK || writer.file.error != 0) return atomic_file_commit(&writer.file);
    atomic_file_abort(&writer.file);
    return result;
}
