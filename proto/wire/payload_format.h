/* payload_format: how sums are cut for the codec, what its two halves (payload.c, payload_read.c) share. */
#ifndef LIGHTMILL_PAYLOAD_FORMAT_H
#define LIGHTMILL_PAYLOAD_FORMAT_H

#include "proto/wire/wire.h"

enum {
    CODEC_RAW = 0,
    CODEC_PLANES = 1,
    FRAME_HEADER = 8, /* u8 codec, 3 zero bytes, u32 bands */
    BAND_PIXELS = 1 << 16,
    GROUP_VALUES = 3, /* of a pixel in a band, at most */
    BAND_VALUES = GROUP_VALUES * BAND_PIXELS,
    MASK_BYTES = BAND_PIXELS / 8,
    PLANES = 8,
    BLOCK_HEADER = 4
};
#define BLOCK_STORED 0x80000000u

/* How an array of sums is cut: a pixel has `stride` values, in groups that are coded apart, since they are of
 * different kinds. Where neighbours are much alike, each value is coded as its difference from the pixel
 * before.
 */
typedef struct {
    size_t stride, group_count;
    uint8_t groups[6]; /* values of each, at most GROUP_VALUES */
    bool differences;
} layout_t;

/* One group of values of up to BAND_PIXELS pixels. */
typedef struct {
    size_t pixel;  /* the first */
    size_t offset; /* of the group's first value in its pixel */
    size_t stride, lanes, pixels;
    bool differences;
} band_t;

static const layout_t payload_layouts[BATCH_PAYLOADS] = {
    {3, 1, {3}, false},                           /* eye */
    {3, 1, {3}, false},                           /* splats */
    {FEATURE_VALUES, 6, {3, 3, 3, 1, 2, 2}, true} /* albedo, normal, position, depth, counts, ids */
};

static inline size_t band_count(const layout_t *layout, size_t values)
{
    size_t pixels = values / layout->stride;
    return (pixels + BAND_PIXELS - 1) / BAND_PIXELS * layout->group_count;
}

static inline band_t band_at(const layout_t *layout, size_t values, size_t index)
{
    size_t chunk = index / layout->group_count, group = index % layout->group_count;
    size_t pixels = values / layout->stride - chunk * BAND_PIXELS;
    band_t band = {.pixel = chunk * BAND_PIXELS,
                   .stride = layout->stride,
                   .lanes = layout->groups[group],
                   .pixels = pixels < BAND_PIXELS ? pixels : BAND_PIXELS,
                   .differences = layout->differences};
    for (size_t g = 0; g < group; g++) band.offset += layout->groups[g];
    return band;
}

#endif
