/* texture_codec: see texture_codec.h. */
#include "common/image/texture_codec.h"

#include <stdlib.h>
#include <string.h>

result_t texture_set_size(const char *name, int64_t width, int64_t height, texture_image_t *image)
{
    if (width < 1 || height < 1 || width > TEXTURE_MAX_SIDE || height > TEXTURE_MAX_SIDE ||
        width * height > TEXTURE_MAX_PIXELS)
        return result_fail(RESULT_INPUT,
                           "%s: %lld x %lld pixels are outside the limits (%d a side, %d in all)", name,
                           (long long)width, (long long)height, TEXTURE_MAX_SIDE, TEXTURE_MAX_PIXELS);
    image->width = (uint32_t)width;
    image->height = (uint32_t)height;
    return result_ok();
}

result_t texture_allocate(const char *name, uint32_t channels, texel_type_t type, texture_image_t *image)
{
    size_t count = texture_pixels(image) * channels;
    image->channels = channels;
    image->type = type;
    if (type == TEXELS_U8)
        image->bytes = calloc(count, sizeof *image->bytes);
    else
        image->floats = calloc(count, sizeof *image->floats);
    if (image->bytes == NULL && image->floats == NULL)
        return result_fail(RESULT_LIMIT, "%s: no memory for %u x %u pixels of %u channels", name,
                           image->width, image->height, channels);
    return result_ok();
}

void texture_drop_empty_alpha(texture_image_t *image)
{
    size_t pixels = texture_pixels(image);
    for (size_t p = 0; p < pixels; p++)
        if (image->bytes[4 * p + 3] != 0) return;
    for (size_t p = 0; p < pixels; p++) memmove(image->bytes + 3 * p, image->bytes + 4 * p, 3);
    image->channels = 3;
}
