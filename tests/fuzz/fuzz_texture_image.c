/* fuzz_texture_image: whatever the bytes are, the readers of textures give an image or an error.
 *
 * The first bytes tell the format as they do in a file; what begins like none is taken for TGA.
 */
#include "common/image/texture_image.h"

#include <math.h>
#include <stdlib.h>

#include "tests/fuzz/fuzz.h"

/* Ends the run unless every texel is there and finite. */
static void check_texels(const texture_image_t *image)
{
    size_t count = (size_t)image->width * image->height * image->channels;
    unsigned sum = 0;
    if (count == 0 || image->channels > 4) abort();
    for (size_t i = 0; i < count; i++) {
        if (image->type == TEXELS_FLOAT && !isfinite(image->floats[i])) abort();
        if (image->type == TEXELS_U8) sum += image->bytes[i];
    }
    volatile unsigned sink = sum;
    (void)sink;
}

int fuzz_texture_image(const uint8_t *data, size_t size)
{
    texture_image_t image;
    result_t result = texture_image_decode("fuzz.tga", data, size, &image);
    if (result.code == RESULT_OK)
        check_texels(&image);
    else if (image.bytes != NULL || image.floats != NULL || result.message[0] == '\0')
        abort();
    texture_image_free(&image);
    return 0;
}
