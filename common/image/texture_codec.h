/* texture_codec: what the readers of texture images share; for common/image/texture_*.c alone.
 *
 * A reader gets a zeroed image and the file's bytes. When it fails, texture_image_decode frees what it left.
 */
#ifndef LIGHTMILL_TEXTURE_CODEC_H
#define LIGHTMILL_TEXTURE_CODEC_H

#include "common/image/texture_image.h"

typedef result_t texture_reader_t(const char *name, const uint8_t *data, size_t size, texture_image_t *image);

texture_reader_t texture_read_png, texture_read_jpeg, texture_read_webp, texture_read_tga, texture_read_bmp,
    texture_read_hdr, texture_read_exr, texture_read_pfm;

/* Sets width and height; an error when they are outside the limits. */
result_t texture_set_size(const char *name, int64_t width, int64_t height, texture_image_t *image);
/* Allocates the zeroed texels of an image that has its size, for `channels` and `type`. */
result_t texture_allocate(const char *name, uint32_t channels, texel_type_t type, texture_image_t *image);

/* Takes the alpha, of 8 bits, away from an image of four channels when it is 0 everywhere: many files have a
 * fourth byte that means nothing. */
void texture_drop_empty_alpha(texture_image_t *image);

/* width * height. */
static inline uint64_t texture_pixels(const texture_image_t *image)
{
    return (uint64_t)image->width * image->height;
}

#endif
