/* payload_format: how sums are cut for the codec, what its two halves (payload.c, payload_read.c) share. */
#ifndef LIGHTMILL_PAYLOAD_FORMAT_H
#define LIGHTMILL_PAYLOAD_FORMAT_H

#include "proto/wire/payload.h"

enum {
    CODEC_RAW = 0,
    CODEC_PLANES = 1, /* what spools of earlier versions hold; read, not written */
    CODEC_STREAMS = 2,
    CODEC_NONE = 255,
    FRAME_HEADER = 8, /* u8 codec, 3 zero bytes, u32 bands */
    BAND_PIXELS = 1 << 16,
    BAND_VALUES = SUM_GROUP_VALUES * BAND_PIXELS,
    MASK_BYTES = BAND_PIXELS / 8,
    PLANES = 8,
    STREAMS = SUM_GROUP_VALUES, /* of a band, at most */
    BLOCK_HEADER = 4,
    MAX_COLOURS = 63 /* of a band */
};
#define BLOCK_STORED 0x80000000u
#define COLOUR_ONE 0x1p28

/* A colour: green and blue as shares of red, in units of 2^-28. */
typedef struct {
    uint32_t of_red[2];
} colour_t;

/* The share of a value, rounded down, modulo 2^64; as any 64-bit machine makes it. */
static inline uint64_t colour_share(uint64_t value, uint32_t share)
{
    uint64_t upper = (uint64_t)((int64_t)value >> 32), lower = value & UINT32_MAX;
    return (upper * share << 4) + (lower * share >> 28);
}

/* One group of values of up to BAND_PIXELS pixels. */
typedef struct {
    size_t pixel;  /* the first */
    size_t offset; /* of the group's first value in its pixel */
    size_t stride, lanes, pixels;
    bool differences;
    bool colours; /* of a frame: green and blue may follow from red */
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
                   .differences = layout->differences,
                   .colours = layout->frame && layout->places == 0};
    for (size_t g = 0; g < group; g++) band.offset += layout->groups[g];
    return band;
}

#endif
