/* texture_png: PNG files through libpng (see texture_image.h).
 *
 * Not through its simplified interface, which converts to sRGB or linear: the values are taken as they are.
 * Only the chunks that carry pixels are looked at.
 */
#include "common/image/texture_codec.h"

#include <png.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* zlib's deflate never makes data smaller than this. */
enum { MAX_DEFLATE_RATIO = 1032 };

/* What our callbacks share with the caller; libpng knows only addresses in it. */
typedef struct {
    const char *name;
    const uint8_t *data;
    size_t size, offset;
    texture_image_t *image;
    uint8_t *wide;   /* 16-bit texels, big endian */
    uint8_t **rows;  /* where each row goes */
    result_t result; /* of what we found ourselves */
    char message[256];
} png_source_t;

static void read_bytes(png_structp png, png_bytep out, png_size_t size)
{
    png_source_t *source = png_get_io_ptr(png);
    if (size > source->size - source->offset) png_error(png, "the file is cut short");
    memcpy(out, source->data + source->offset, size);
    source->offset += size;
}

static void keep_error(png_structp png, png_const_charp message)
{
    png_source_t *source = png_get_error_ptr(png);
    snprintf(source->message, sizeof source->message, "%s", message);
    png_longjmp(png, 1);
}

static void ignore_warning(png_structp png, png_const_charp message)
{
    (void)png, (void)message;
}

/* Takes the size from the header, as far as the bytes in the file can hold it. */
static result_t read_size(png_source_t *source, png_structp png, png_infop info)
{
    texture_image_t *image = source->image;
    TRY(texture_set_size(source->name, png_get_image_width(png, info), png_get_image_height(png, info),
                         image));
    uint64_t bytes = (uint64_t)png_get_rowbytes(png, info) * image->height;
    if (bytes / MAX_DEFLATE_RATIO > source->size)
        return result_fail(RESULT_INPUT, "%s: is cut short: %zu bytes for %u x %u pixels", source->name,
                           source->size, image->width, image->height);
    return result_ok();
}

/* Allocates what the rows go to, once the transformations are known. */
static result_t make_rows(png_source_t *source, png_structp png, png_infop info)
{
    texture_image_t *image = source->image;
    bool wide = png_get_bit_depth(png, info) == 16;
    TRY(texture_allocate(source->name, png_get_channels(png, info), wide ? TEXELS_FLOAT : TEXELS_U8, image));
    image->encoded = true;
    size_t row_bytes = (size_t)image->width * image->channels * (wide ? 2 : 1);
    if (wide) source->wide = malloc(row_bytes * image->height);
    source->rows = malloc(image->height * sizeof *source->rows);
    if ((wide && source->wide == NULL) || source->rows == NULL)
        return result_fail(RESULT_LIMIT, "%s: no memory for %u x %u pixels", source->name, image->width,
                           image->height);
    uint8_t *texels = wide ? source->wide : image->bytes;
    for (size_t y = 0; y < image->height; y++) source->rows[y] = texels + y * row_bytes;
    return result_ok();
}

static bool good(png_source_t *source, result_t result)
{
    source->result = result;
    return result.code == RESULT_OK;
}

/* False when libpng gave up, or we did. Keeps no variable over the long jump. */
static bool decode(png_source_t *source, png_structp png, png_infop info)
{
    if (setjmp(png_jmpbuf(png)) != 0) return false;
    png_set_read_fn(png, source, read_bytes);
    png_set_user_limits(png, PNG_UINT_31_MAX, PNG_UINT_31_MAX); /* read_size has ours */
    png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, NULL, -1);
    png_read_info(png, info);
    if (!good(source, read_size(source, png, info))) return false;
    source->image->alpha_expanded = (png_get_color_type(png, info) & PNG_COLOR_MASK_ALPHA) == 0;
    png_set_expand(png);
    png_set_interlace_handling(png);
    png_read_update_info(png, info);
    if (!good(source, make_rows(source, png, info))) return false;
    png_read_image(png, source->rows);
    png_read_end(png, NULL);
    return true;
}

static void widen(const png_source_t *source)
{
    texture_image_t *image = source->image;
    size_t count = texture_pixels(image) * image->channels;
    for (size_t i = 0; i < count; i++)
        image->floats[i] = (float)(source->wide[2 * i] << 8 | source->wide[2 * i + 1]) / 65535.0f;
}

result_t texture_read_png(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    png_source_t source = {.name = name, .data = data, .size = size, .image = image};
    png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &source, keep_error, ignore_warning);
    png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
    if (info == NULL) snprintf(source.message, sizeof source.message, "no memory");
    bool whole = info != NULL && decode(&source, png, info);
    png_destroy_read_struct(&png, &info, NULL);
    if (whole && image->type == TEXELS_FLOAT) widen(&source);
    free(source.rows);
    free(source.wide);
    if (whole || source.result.code != RESULT_OK) return source.result;
    return result_fail(RESULT_INPUT, "%s: cannot be read as PNG: %s", name, source.message);
}
