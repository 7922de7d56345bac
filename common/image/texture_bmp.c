/* texture_bmp: Windows bitmaps (see texture_image.h).
 *
 * A header of 14 bytes, a second one whose first word is its size, masks or a colour map, then rows, each
 * filled up to a multiple of 4 bytes, from the bottom unless the height is negative. A pixel is a little
 * endian number of 1 to 32 bits: an index of the colour map, or bits that masks cut into colours.
 */
#include "common/image/texture_codec.h"

enum {
    FILE_HEADER = 14,
    OLD_HEADER = 12, /* of OS/2: sizes of 16 bits, and a colour map of 3 bytes an entry */
    INFO_HEADER = 40,
    MASKS_HEADER = 52,
    ALPHA_HEADER = 56,
    PLAIN = 0,
    MASKS = 3
};

typedef struct {
    const char *name;
    texture_image_t *image;
    const uint8_t *data, *map;
    size_t size, pixels; /* of the file; where its pixels begin */
    uint32_t bits;       /* of a pixel */
    uint32_t masks[4];   /* red, green, blue, alpha; 0: there is none */
    uint32_t map_length, entry_bytes;
    bool from_top;
} bmp_t;

static result_t bmp_error(const bmp_t *bmp, const char *reason)
{
    return result_fail(RESULT_INPUT, "%s: cannot be read as BMP: %s", bmp->name, reason);
}

/* A little endian number of `bytes` bytes, up to 4. */
static uint32_t read_number(const uint8_t *in, uint32_t bytes)
{
    uint32_t value = 0;
    for (uint32_t i = 0; i < bytes; i++) value |= (uint32_t)in[i] << (8 * i);
    return value;
}

/* The masks that a depth has when the file has none of its own. */
static void default_masks(bmp_t *bmp)
{
    uint32_t width = bmp->bits == 16 ? 5 : 8, ones = (1U << width) - 1;
    for (uint32_t c = 0; c < 3; c++) bmp->masks[c] = ones << (2 - c) * width;
    bmp->masks[3] = bmp->bits == 32 ? ones << 24 : 0;
}

/* Three masks stand in the second header or behind it; the one of alpha only in it. */
static result_t read_masks(bmp_t *bmp, uint32_t header)
{
    uint32_t count = header >= ALPHA_HEADER ? 4 : 3;
    if (bmp->bits != 16 && bmp->bits != 32) return bmp_error(bmp, "masks do not go with its depth");
    if (bmp->size < FILE_HEADER + INFO_HEADER + 4 * (size_t)count) return bmp_error(bmp, "it is cut short");
    for (uint32_t c = 0; c < count; c++)
        bmp->masks[c] = read_number(bmp->data + FILE_HEADER + INFO_HEADER + 4 * (size_t)c, 4);
    return result_ok();
}

static result_t read_map(bmp_t *bmp, uint32_t header, uint32_t colours)
{
    size_t offset = FILE_HEADER + (size_t)header;
    uint32_t most = 1U << bmp->bits;
    bmp->entry_bytes = header == OLD_HEADER ? 3 : 4;
    bmp->map_length = colours == 0 || colours > most ? most : colours;
    bmp->map = bmp->data + offset;
    if (bmp->size < offset + (size_t)bmp->map_length * bmp->entry_bytes)
        return bmp_error(bmp, "it is cut short");
    return result_ok();
}

static result_t read_headers(bmp_t *bmp)
{
    if (bmp->size < FILE_HEADER + INFO_HEADER) return bmp_error(bmp, "it is cut short");
    const uint8_t *info = bmp->data + FILE_HEADER;
    uint32_t header = read_number(info, 4);
    bool old = header == OLD_HEADER;
    if (!old && (header < INFO_HEADER || header > 256)) return bmp_error(bmp, "its header is not known");
    int64_t width = read_number(info + 4, old ? 2 : 4),
            height = read_number(info + (old ? 6 : 8), old ? 2 : 4);
    if (height > INT32_MAX) height -= (int64_t)1 << 32;
    bmp->from_top = height < 0;
    bmp->bits = read_number(info + (old ? 10 : 14), 2);
    bmp->pixels = read_number(bmp->data + 10, 4);
    uint32_t packing = old ? PLAIN : read_number(info + 16, 4);
    TRY(texture_set_size(bmp->name, width, height < 0 ? -height : height, bmp->image));

    if (packing != PLAIN && packing != MASKS) return bmp_error(bmp, "packed pixels are not supported");
    bool mapped = bmp->bits == 1 || bmp->bits == 4 || bmp->bits == 8;
    if (!mapped && bmp->bits != 16 && bmp->bits != 24 && bmp->bits != 32)
        return bmp_error(bmp, "pixels of a depth that is not supported");
    if (packing == MASKS) return read_masks(bmp, header);
    default_masks(bmp);
    return mapped ? read_map(bmp, header, old ? 0 : read_number(info + 32, 4)) : result_ok();
}

/* The bits under a mask as a number of 8 bits. */
static uint8_t masked(uint32_t value, uint32_t mask)
{
    if (mask == 0) return 0;
    uint32_t shift = (uint32_t)__builtin_ctz(mask), most = mask >> shift;
    return (uint8_t)(((uint64_t)((value & mask) >> shift) * 255 + most / 2) / most);
}

static void store_colour(const bmp_t *bmp, uint32_t value, uint8_t *out)
{
    for (uint32_t c = 0; c < bmp->image->channels; c++) out[c] = masked(value, bmp->masks[c]);
}

static result_t read_row(const bmp_t *bmp, const uint8_t *in, uint8_t *out)
{
    for (uint32_t x = 0; x < bmp->image->width; x++, out += bmp->image->channels) {
        size_t bit = (size_t)x * bmp->bits;
        if (bmp->map == NULL) {
            store_colour(bmp, read_number(in + bit / 8, bmp->bits / 8), out);
            continue;
        }
        uint32_t index = in[bit / 8] >> (8 - bmp->bits - bit % 8) & ((1U << bmp->bits) - 1);
        if (index >= bmp->map_length) return bmp_error(bmp, "a pixel is outside the colour map");
        for (uint32_t c = 0; c < 3; c++) out[c] = bmp->map[(size_t)index * bmp->entry_bytes + 2 - c];
    }
    return result_ok();
}

result_t texture_read_bmp(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    bmp_t bmp = {.name = name, .image = image, .data = data, .size = size};
    TRY(read_headers(&bmp));
    size_t row = ((size_t)image->width * bmp.bits + 7) / 8, stride = (row + 3) / 4 * 4;
    if (bmp.pixels > size || size - bmp.pixels < (image->height - 1) * stride + row)
        return bmp_error(&bmp, "it is cut short");
    TRY(texture_allocate(name, bmp.map == NULL && bmp.masks[3] != 0 ? 4 : 3, TEXELS_U8, image));
    image->encoded = true;
    for (size_t y = 0; y < image->height; y++) {
        size_t to = bmp.from_top ? y : image->height - 1 - y;
        TRY(read_row(&bmp, data + bmp.pixels + y * stride,
                     image->bytes + to * image->width * image->channels));
    }
    if (image->channels == 4) texture_drop_empty_alpha(image);
    return result_ok();
}
