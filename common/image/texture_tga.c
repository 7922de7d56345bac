/* texture_tga: Truevision TGA files (see texture_image.h).
 *
 * A header of 18 bytes, a text, a colour map, then pixels of 1 to 4 bytes, little endian: blue, green, red,
 * alpha, as they are or in packets, which may go on from row to row. The file has no mark at its beginning,
 * so the header is checked for all that it can be wrong in.
 */
#include "common/image/texture_codec.h"

#include <string.h>

enum {
    HEADER_BYTES = 18,
    TYPE_MAPPED = 1,
    TYPE_COLOUR = 2,
    TYPE_GREY = 3,
    TYPE_PACKED = 8,
    MAX_PACKET = 128
};

typedef struct {
    const char *name;
    texture_image_t *image;
    uint32_t type; /* TYPE_MAPPED, TYPE_COLOUR or TYPE_GREY */
    bool packed;   /* in packets */
    bool from_top, right_to_left;
    uint32_t alpha_bits, bits, pixel_bytes; /* of a pixel */
    uint32_t map_first, map_length, map_bits, entry_bytes;
    const uint8_t *map, *at, *end; /* the colour map; the pixels that are not read yet */
    uint32_t x, y;                 /* of the next pixel in the order of the file */
} tga_t;

static result_t tga_error(const tga_t *tga, const char *reason)
{
    return result_fail(RESULT_INPUT, "%s: cannot be read as TGA: %s", tga->name, reason);
}

static uint32_t read_u16(const uint8_t *in)
{
    return (uint32_t)in[0] | (uint32_t)in[1] << 8;
}

static bool is_colour_depth(uint32_t bits)
{
    return bits == 15 || bits == 16 || bits == 24 || bits == 32;
}

static result_t check_depths(const tga_t *tga, bool has_map)
{
    bool known = tga->type == TYPE_MAPPED ? tga->bits == 8 || tga->bits == 16
                 : tga->type == TYPE_GREY ? tga->bits == 8 || tga->bits == 16
                                          : is_colour_depth(tga->bits);
    if (!known) return tga_error(tga, "pixels of a depth that is not supported");
    if (tga->type == TYPE_MAPPED && !has_map) return tga_error(tga, "it has no colour map");
    if (tga->type == TYPE_MAPPED && !is_colour_depth(tga->map_bits))
        return tga_error(tga, "a colour map of a depth that is not supported");
    return result_ok();
}

static result_t read_header(tga_t *tga, const uint8_t *data, size_t size)
{
    if (size < HEADER_BYTES) return tga_error(tga, "it is cut short");
    tga->packed = (data[2] & TYPE_PACKED) != 0;
    tga->type = data[2] & ~(uint32_t)TYPE_PACKED;
    if (data[1] > 1 || tga->type < TYPE_MAPPED || tga->type > TYPE_GREY || (data[17] & 0xC0) != 0)
        return tga_error(tga, "its header is not one of a supported TGA file");
    bool has_map = data[1] == 1;
    tga->map_first = read_u16(data + 3);
    tga->map_length = has_map ? read_u16(data + 5) : 0;
    tga->map_bits = data[7];
    tga->entry_bytes = (tga->map_bits + 7) / 8;
    tga->bits = data[16];
    tga->pixel_bytes = (tga->bits + 7) / 8;
    tga->alpha_bits = data[17] & 15;
    tga->right_to_left = (data[17] & 0x10) != 0;
    tga->from_top = (data[17] & 0x20) != 0;
    TRY(check_depths(tga, has_map));

    size_t map_offset = HEADER_BYTES + (size_t)data[0],
           map_bytes = (size_t)tga->map_length * tga->entry_bytes;
    if (size < map_offset + map_bytes) return tga_error(tga, "it is cut short");
    tga->map = data + map_offset;
    tga->at = tga->map + map_bytes;
    tga->end = data + size;
    return texture_set_size(tga->name, read_u16(data + 12), read_u16(data + 14), tga->image);
}

/* Whether the bytes that are left can hold all pixels: a packet is a byte and at least one pixel. */
static bool plausible(const tga_t *tga)
{
    uint64_t pixels = texture_pixels(tga->image), left = (uint64_t)(tga->end - tga->at);
    if (!tga->packed) return left >= pixels * tga->pixel_bytes;
    return left / (1 + tga->pixel_bytes) >= (pixels + MAX_PACKET - 1) / MAX_PACKET;
}

static uint32_t count_channels(const tga_t *tga)
{
    if (tga->type == TYPE_GREY) return tga->bits == 16 ? 2 : 1;
    if (tga->type == TYPE_MAPPED) return tga->map_bits == 32 ? 4 : 3;
    return tga->bits == 32 || (tga->bits == 16 && tga->alpha_bits > 0) ? 4 : 3;
}

/* Five bits as eight. */
static uint8_t five_bits(uint32_t value)
{
    return (uint8_t)(((value & 31) * 255 + 15) / 31);
}

static void store_colour(const uint8_t *in, uint32_t bits, uint32_t channels, uint8_t *out)
{
    if (bits <= 16) {
        uint32_t value = read_u16(in);
        for (uint32_t c = 0; c < 3; c++) out[c] = five_bits(value >> (10 - 5 * c));
        if (channels == 4) out[3] = value >> 15 ? 255 : 0;
        return;
    }
    for (uint32_t c = 0; c < 3; c++) out[c] = in[2 - c];
    if (channels == 4) out[3] = in[3];
}

/* Stores the next pixel; false when it is outside the colour map. */
static bool store_pixel(tga_t *tga, const uint8_t *in)
{
    texture_image_t *image = tga->image;
    size_t x = tga->right_to_left ? image->width - 1 - tga->x : tga->x;
    size_t y = tga->from_top ? tga->y : image->height - 1 - tga->y;
    uint8_t *out = image->bytes + (y * image->width + x) * image->channels;
    if (++tga->x == image->width) tga->x = 0, tga->y++;
    if (tga->type == TYPE_GREY) {
        memcpy(out, in, image->channels);
    } else if (tga->type == TYPE_COLOUR) {
        store_colour(in, tga->bits, image->channels, out);
    } else {
        uint32_t index = tga->pixel_bytes == 1 ? in[0] : read_u16(in);
        if (index < tga->map_first || index - tga->map_first >= tga->map_length) return false;
        const uint8_t *entry = tga->map + (size_t)(index - tga->map_first) * tga->entry_bytes;
        store_colour(entry, tga->map_bits, image->channels, out);
    }
    return true;
}

/* The next `count` pixels, each with its own bytes or all with the same. */
static result_t read_pixels(tga_t *tga, uint64_t count, bool same)
{
    uint64_t bytes = same ? tga->pixel_bytes : count * tga->pixel_bytes;
    if ((uint64_t)(tga->end - tga->at) < bytes) return tga_error(tga, "it is cut short");
    for (uint64_t i = 0; i < count; i++)
        if (!store_pixel(tga, tga->at + (same ? 0 : i * tga->pixel_bytes)))
            return tga_error(tga, "a pixel is outside the colour map");
    tga->at += bytes;
    return result_ok();
}

static result_t read_packets(tga_t *tga)
{
    for (uint64_t left = texture_pixels(tga->image); left > 0;) {
        if (tga->at == tga->end) return tga_error(tga, "it is cut short");
        uint32_t packet = *tga->at++, count = 1 + (packet & 127);
        if (count > left) return tga_error(tga, "a packet goes beyond the last pixel");
        TRY(read_pixels(tga, count, packet > 127));
        left -= count;
    }
    return result_ok();
}

result_t texture_read_tga(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    tga_t tga = {.name = name, .image = image};
    TRY(read_header(&tga, data, size));
    if (!plausible(&tga)) return tga_error(&tga, "it is too short for its size");
    TRY(texture_allocate(name, count_channels(&tga), TEXELS_U8, image));
    image->encoded = true;
    TRY(tga.packed ? read_packets(&tga) : read_pixels(&tga, texture_pixels(image), false));
    if (image->channels == 4 && tga.alpha_bits == 0) texture_drop_empty_alpha(image);
    return result_ok();
}
