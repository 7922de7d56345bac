/* texture_jpeg: JPEG files through TurboJPEG (see texture_image.h).
 *
 * libjpeg fills what a damaged file lacks with grey and only warns; here a warning is an error, but for one:
 * some cameras leave bytes between the picture and its end that mean nothing. The accurate inverse DCT gives
 * the same bits on every machine.
 */
#include "common/image/texture_codec.h"

#include <string.h>
#include <turbojpeg.h>

/* Huffman codes have at least one bit and a block of 8 x 8 samples at least one code; a sample covers at most
 * 4 x 4 pixels, of which the most finely sampled component has at least a quarter. */
enum { MAX_PIXELS_PER_BYTE = 8 * 64 * 4 };

enum { FLAGS = TJFLAG_LIMITSCANS | TJFLAG_ACCURATEDCT };

static result_t jpeg_error(const char *name, tjhandle decoder)
{
    return result_fail(RESULT_INPUT, "%s: cannot be read as JPEG: %s", name, tjGetErrorStr2(decoder));
}

/* True when all that is wrong are bytes that nobody needs. */
static bool is_whole(tjhandle decoder)
{
    return tjGetErrorCode(decoder) == TJERR_WARNING &&
           strstr(tjGetErrorStr2(decoder), "extraneous bytes before marker 0xd9") != NULL;
}

static result_t decode(const char *name, const uint8_t *data, size_t size, tjhandle decoder,
                       texture_image_t *image)
{
    int width = -1, height = -1, sampling = -1, colours = -1;
    int code = tjDecompressHeader3(decoder, data, size, &width, &height, &sampling, &colours);
    /* It fails for a sampling that TurboJPEG has no name for, which it decodes all the same. */
    bool unnamed_sampling = sampling < 0 && colours >= 0;
    if (code != 0 && !unnamed_sampling) return jpeg_error(name, decoder);
    if (colours == TJCS_CMYK || colours == TJCS_YCCK)
        return result_fail(RESULT_INPUT, "%s: CMYK images are not supported; save it as RGB", name);
    TRY(texture_set_size(name, width, height, image));
    if (texture_pixels(image) / MAX_PIXELS_PER_BYTE > size)
        return result_fail(RESULT_INPUT, "%s: is cut short: %zu bytes for %d x %d pixels", name, size, width,
                           height);
    bool grey = colours == TJCS_GRAY;
    TRY(texture_allocate(name, grey ? 1 : 3, TEXELS_U8, image));
    image->encoded = true;
    if (tjDecompress2(decoder, data, size, image->bytes, width, 0, height, grey ? TJPF_GRAY : TJPF_RGB,
                      FLAGS) != 0 &&
        !is_whole(decoder))
        return jpeg_error(name, decoder);
    return result_ok();
}

result_t texture_read_jpeg(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    tjhandle decoder = tjInitDecompress();
    if (decoder == NULL) return result_fail(RESULT_LIMIT, "%s: no memory for a JPEG decoder", name);
    result_t result = decode(name, data, size, decoder, image);
    tjDestroy(decoder);
    return result;
}
