/* texture_image: which format a file is in (see texture_image.h). */
#include "common/image/texture_codec.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* The pixels of the largest image as they are, and as much again for headers as anyone can want. */
#define MAX_FILE_BYTES ((size_t)TEXTURE_MAX_PIXELS * 4 * sizeof(float) + ((size_t)1 << 24))

static bool begins(const uint8_t *data, size_t size, const char *magic, size_t length)
{
    return size >= length && memcmp(data, magic, length) == 0;
}

static bool has_tga_extension(const char *name)
{
    static const char *const extensions[] = {".tga", ".icb", ".vda", ".vst"};
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot != NULL && i < ARRAY_LENGTH(extensions); i++)
        if (strcasecmp(dot, extensions[i]) == 0) return true;
    return false;
}

/* The reader of the format, or NULL. */
static texture_reader_t *find_reader(const char *name, const uint8_t *data, size_t size)
{
    static const struct {
        const char *magic;
        size_t length;
        texture_reader_t *read;
    } formats[] = {{"\x89PNG\r\n\x1a\n", 8, texture_read_png},
                   {"\xff\xd8\xff", 3, texture_read_jpeg},
                   {"RIFF", 4, texture_read_webp},
                   {"\x76\x2f\x31\x01", 4, texture_read_exr},
                   {"BM", 2, texture_read_bmp},
                   {"#?", 2, texture_read_hdr},
                   {"PF", 2, texture_read_pfm},
                   {"Pf", 2, texture_read_pfm}};
    for (size_t i = 0; i < ARRAY_LENGTH(formats); i++)
        if (begins(data, size, formats[i].magic, formats[i].length)) return formats[i].read;
    return has_tga_extension(name) ? texture_read_tga : NULL;
}

static void replace_bad_values(texture_image_t *image)
{
    size_t count = texture_pixels(image) * image->channels;
    for (size_t i = 0; i < count; i++) {
        if (isfinite(image->floats[i])) continue;
        image->floats[i] = 0.0f;
        image->bad_values++;
    }
}

result_t texture_image_decode(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    *image = (texture_image_t){0};
    if (size == 0) return result_fail(RESULT_INPUT, "%s: is empty, expected an image", name);
    texture_reader_t *read = find_reader(name, data, size);
    if (read == NULL)
        return result_fail(
            RESULT_INPUT, "%s: is not an image that can be read (PNG, JPEG, WebP, TGA, BMP, HDR, EXR or PFM)",
            name);
    result_t result = read(name, data, size, image);
    if (result.code != RESULT_OK)
        texture_image_free(image);
    else if (image->type == TEXELS_FLOAT)
        replace_bad_values(image);
    return result;
}

result_t texture_image_read(const char *path, texture_image_t *image)
{
    uint8_t *data = NULL;
    size_t size = 0;
    *image = (texture_image_t){0};
    TRY(file_read(path, MAX_FILE_BYTES, &data, &size));
    result_t result = texture_image_decode(path, data, size, image);
    free(data);
    return result;
}

void texture_image_free(texture_image_t *image)
{
    free(image->bytes);
    free(image->floats);
    *image = (texture_image_t){0};
}
