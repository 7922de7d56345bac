/* texture_exr: the colour channels of an OpenEXR file (see texture_image.h and image.h). */
#include "common/image/image.h"
#include "common/image/texture_codec.h"
#include "common/plain_text.h"

#include <stdio.h>
#include <string.h>

/* The channels that make the texture, in order; 0 when none do. */
static uint32_t choose_channels(const image_t *file, const image_channel_t *chosen[4])
{
    uint32_t count = 0;
    if (image_find_rgb(file, NULL, chosen))
        count = 3;
    else if (image_find(file, "Y") != NULL && image_find(file, "RY") == NULL)
        chosen[count++] = image_find(file, "Y");
    else if (file->channel_count == 1)
        chosen[count++] = &file->channels[0];
    const image_channel_t *alpha = image_find(file, "A");
    if (count > 0 && alpha != NULL && alpha != chosen[0]) chosen[count++] = alpha;
    return count;
}

/* Refuses a file without such channels, and says which it has. */
static result_t refuse(const char *name, const image_t *file)
{
    char names[200] = "";
    for (size_t i = 0, used = 0; i < file->channel_count && used + 1 < sizeof names; i++) {
        int n = snprintf(names + used, sizeof names - used, "%s%s", i > 0 ? " " : "", file->channels[i].name);
        used += n > 0 ? (size_t)n : 0;
    }
    plain_text_clean(names);
    return result_fail(RESULT_INPUT, "%s: has neither R, G and B nor Y nor one channel alone, but: %s", name,
                       names);
}

static result_t interleave(const char *name, const image_t *file, texture_image_t *image)
{
    const image_channel_t *chosen[4] = {NULL};
    uint32_t channels = choose_channels(file, chosen);
    if (channels == 0) return refuse(name, file);
    TRY(texture_set_size(name, file->width, file->height, image));
    TRY(texture_allocate(name, channels, TEXELS_FLOAT, image));
    image->has_chromaticities = file->has_chromaticities;
    memcpy(image->chromaticities, file->chromaticities, sizeof image->chromaticities);
    size_t pixels = texture_pixels(image);
    for (size_t p = 0; p < pixels; p++)
        for (uint32_t c = 0; c < channels; c++)
            image->floats[p * channels + c] = chosen[c]->data[p * chosen[c]->stride];
    return result_ok();
}

result_t texture_read_exr(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    image_t file;
    TRY(image_decode_exr(name, data, size, &file));
    result_t result = interleave(name, &file, image);
    image_free(&file);
    return result;
}
