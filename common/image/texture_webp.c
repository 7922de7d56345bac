/* texture_webp: WebP files through libwebp, lossy and lossless, one picture a file (see texture_image.h).
 *
 * libwebp's decoders give the same bits with and without SIMD, as the format demands.
 */
#include "common/image/texture_codec.h"

#include <webp/decode.h>

/* A lossless picture of one colour has no bytes for its pixels at all, so the size of the file bounds them
 * only beyond a picture of 8192 x 8192. */
enum { FREE_PIXELS = 1 << 26, MAX_PIXELS_PER_BYTE = 1 << 12 };

static const char *reason_of(VP8StatusCode code)
{
    switch (code) {
    case VP8_STATUS_SUSPENDED:
    case VP8_STATUS_NOT_ENOUGH_DATA:
        return "it is cut short";
    case VP8_STATUS_UNSUPPORTED_FEATURE:
        return "it uses what the decoder does not know";
    default:
        return "it is damaged, or no WebP";
    }
}

static result_t webp_error(const char *name, VP8StatusCode code)
{
    if (code == VP8_STATUS_OUT_OF_MEMORY)
        return result_fail(RESULT_LIMIT, "%s: no memory for its pixels", name);
    return result_fail(RESULT_INPUT, "%s: cannot be read as WebP: %s", name, reason_of(code));
}

result_t texture_read_webp(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    WebPDecoderConfig config;
    if (!WebPInitDecoderConfig(&config))
        return result_fail(RESULT_LIMIT, "%s: libwebp is of another version than at build time", name);
    VP8StatusCode code = WebPGetFeatures(data, size, &config.input);
    if (code != VP8_STATUS_OK) return webp_error(name, code);
    if (config.input.has_animation)
        return result_fail(RESULT_INPUT, "%s: is an animation; save one picture of it", name);
    TRY(texture_set_size(name, config.input.width, config.input.height, image));
    uint64_t pixels = texture_pixels(image);
    if (pixels > FREE_PIXELS && (pixels - FREE_PIXELS) / MAX_PIXELS_PER_BYTE > size)
        return result_fail(RESULT_INPUT, "%s: is cut short: %zu bytes for %d x %d pixels", name, size,
                           config.input.width, config.input.height);
    uint32_t channels = config.input.has_alpha ? 4 : 3;
    TRY(texture_allocate(name, channels, TEXELS_U8, image));
    image->encoded = true;
    config.output.colorspace = channels == 4 ? MODE_RGBA : MODE_RGB;
    config.output.is_external_memory = 1;
    config.output.u.RGBA = (WebPRGBABuffer){
        .rgba = image->bytes, .stride = (int)(channels * image->width), .size = channels * pixels};
    code = WebPDecode(data, size, &config);
    return code == VP8_STATUS_OK ? result_ok() : webp_error(name, code);
}
