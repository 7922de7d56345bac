/* texture_image: pictures that scenes use as textures, in the formats that people keep them in.
 *
 * PNG, JPEG, WebP, TGA, BMP, Radiance HDR, OpenEXR and PFM are read whole or not at all; the values are the
 * file's own, no colour space is converted. A file that is cut short, too large or damaged is an error, never
 * half an image. Nothing is allocated for pixels that the bytes present cannot hold.
 */
#ifndef LIGHTMILL_TEXTURE_IMAGE_H
#define LIGHTMILL_TEXTURE_IMAGE_H

#include "common/base.h"

enum { TEXTURE_MAX_SIDE = 65536, TEXTURE_MAX_PIXELS = 1 << 28 };

typedef enum { TEXELS_U8, TEXELS_FLOAT } texel_type_t;

/* A decoded texture image: rows from the top, channels interleaved. */
typedef struct {
    uint32_t width, height;
    uint32_t channels; /* 1 grey, 2 grey and alpha, 3 RGB, 4 RGBA */
    texel_type_t type;
    /* The colour channels are sRGB-encoded by the convention of their format (PNG of 8 and 16 bits, JPEG,
     * WebP, TGA, BMP); false: linear (EXR, HDR, PFM). Alpha is linear always, and not multiplied into the
     * colours by convention (EXR: it is). */
    bool encoded;
    bool alpha_expanded; /* PNG: alpha, if any, comes from a palette or from one colour that is transparent */
    uint8_t *bytes;      /* owned; TEXELS_U8: [height][width][channels] */
    float *floats; /* owned; TEXELS_FLOAT: the same layout; a 16-bit PNG's values are divided by 65535 */
    uint64_t bad_values;        /* infinite and NaN values of the file, which are 0 here */
    bool has_chromaticities;    /* an EXR that says what its R, G and B are: */
    float chromaticities[4][2]; /* x and y of red, green, blue and white */
} texture_image_t;

/* Reads a file in the format that its first bytes tell; one that begins like none is taken for TGA when its
 * extension is .tga, .icb, .vda or .vst. RESULT_INPUT names the path and the reason, RESULT_LIMIT a lack of
 * memory. On failure there is nothing to free.
 *
 * PNG: all kinds; palettes, depths below 8 bits and transparent colours are expanded; gamma and profiles are
 * ignored. JPEG: grey and colour, baseline and progressive; CMYK is refused, and so is a file about which
 * the decoder has a complaint. WebP: lossy and lossless, with and without alpha; animations are refused,
 * profiles ignored. TGA: types 1, 2, 3, 9, 10, 11; a fourth byte that the header does not call
 * alpha counts as alpha unless it is 0 everywhere. BMP: what is not packed; alpha that is 0 everywhere is
 * none. HDR: RGBE, flat or new run-length coding, lines along x;
 * EXPOSURE is not undone. EXR: what image_read_exr reads; R, G, B, or Y, or the only channel, and A.
 * PFM: multiplied by the absolute value of its scale. */
result_t texture_image_read(const char *path, texture_image_t *image);
/* The same of a file's bytes in memory; `name`, not empty, stands for the path in errors, and its extension
 * for a file's. */
result_t texture_image_decode(const char *name, const uint8_t *data, size_t size, texture_image_t *image);
/* Frees what the image owns; harmless on a zeroed image. */
void texture_image_free(texture_image_t *image);

#endif
