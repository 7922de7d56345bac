/* payload_format: how sums are cut for the codec, what its two halves (payload.c, payload_read.c) share. */
#ifndef LIGHTMILL_PAYLOAD_FORMAT_H
#define LIGHTMILL_PAYLOAD_FORMAT_H

#include "proto/wire/payload.h"

enum {
    CODEC_RAW = 0,
    CODEC_PLANES = 1,
    FRAME_HEADER = 8, /* u8 codec, 3 zero bytes, u32 bands */
    BAND_PIXELS = 1 << 16,
    BAND_VALUES = SUM_GROUP_VALUES * BAND_PIXELS,
    MASK_BYTES = BAND_PIXELS / 8,
    PLANES = 8,
    BLOCK_HEADER = 4
};
#define BLOCK_STORED 0x80000000u

/* One group of values of up to BAND_PIXELS pixels. */
typedef struct {
    size_t pixel;  /* the first */
    size_t offset; /* of the group's first value in its pixel */
    size_t stride, lanes, pixels;
    bool differences;
} band_t;

static inline size_t band_count(const sum_layout_t *layout, size_t values)
{
    size_t pixels = values / layout->values;
    return (pixels + BAND_PIXELS - 1) / BAND_PIXELS * layout->group_count;
}

static inline band_t band_at(const sum_layout_t *layout, size_t values, size_t index)
{
    size_t chunk = index / layout->group_count, group = index % layout->group_count;
    size_t pixels = values / layout->values - chunk * BAND_PIXELS;
    band_t band = {.pixel = chunk * BAND_PIXELS,
                   .stride = layout->values,
                   .lanes = layout->groups[group],
                   .pixels = pixels < BAND_PIXELS ? pixels : BAND_PIXELS,
                   .differences = layout->differences};
    for (size_t g = 0; g < group; g++) band.offset += layout->groups[g];
    return band;
}

#endif
