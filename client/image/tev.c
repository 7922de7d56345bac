/* tev: see tev.h. */
#include "client/image/tev.h"

#include <endian.h>
#include <string.h>

enum { CREATE_IMAGE = 4, UPDATE_IMAGE_V3 = 6 };

static void put(tev_packets_t *packets, const void *bytes, size_t size)
{
    if (packets->size + size > packets->capacity) {
        packets->capacity = 2 * (packets->size + size);
        packets->bytes = mem_realloc(packets->bytes, packets->capacity);
    }
    memcpy(packets->bytes + packets->size, bytes, size);
    packets->size += size;
}

static void put_byte(tev_packets_t *packets, uint8_t value)
{
    put(packets, &value, 1);
}

static void put_int32(tev_packets_t *packets, int32_t value)
{
    uint32_t little = htole32((uint32_t)value);
    put(packets, &little, sizeof little);
}

static void put_int64(tev_packets_t *packets, int64_t value)
{
    uint64_t little = htole64((uint64_t)value);
    put(packets, &little, sizeof little);
}

static void put_text(tev_packets_t *packets, const char *text)
{
    put(packets, text, strlen(text) + 1);
}

static void put_texts(tev_packets_t *packets, const char *const *texts, size_t count)
{
    put_int32(packets, (int32_t)count);
    for (size_t i = 0; i < count; i++) put_text(packets, texts[i]);
}

/* Returns where the packet begins. `focus`: the viewer is to bring the image to the front. */
static size_t begin_packet(tev_packets_t *packets, uint8_t kind, bool focus, const char *name)
{
    size_t start = packets->size;
    put_int32(packets, 0); /* the length, in end_packet */
    put_byte(packets, kind);
    put_byte(packets, focus);
    put_text(packets, name);
    return start;
}

static void end_packet(tev_packets_t *packets, size_t start)
{
    uint32_t length = htole32((uint32_t)(packets->size - start));
    memcpy(packets->bytes + start, &length, sizeof length);
}

void tev_create_image(tev_packets_t *packets, const char *name, int width, int height,
                      const char *const *channels, size_t channel_count)
{
    size_t start = begin_packet(packets, CREATE_IMAGE, true, name);
    put_int32(packets, width);
    put_int32(packets, height);
    put_texts(packets, channels, channel_count);
    end_packet(packets, start);
}

void tev_update_image(tev_packets_t *packets, const char *name, const tev_rectangle_t *rectangle,
                      const char *const *channels, size_t channel_count, const float *values)
{
    size_t plane = (size_t)rectangle->width * (size_t)rectangle->height;
    size_t start = begin_packet(packets, UPDATE_IMAGE_V3, false, name);
    put_texts(packets, channels, channel_count);
    put_int32(packets, rectangle->x);
    put_int32(packets, rectangle->y);
    put_int32(packets, rectangle->width);
    put_int32(packets, rectangle->height);
    /* Where each channel begins in the values, and how far its pixels are apart; both count floats. */
    for (size_t c = 0; c < channel_count; c++) put_int64(packets, (int64_t)(c * plane));
    for (size_t c = 0; c < channel_count; c++) put_int64(packets, 1);
    put(packets, values, channel_count * plane * sizeof *values);
    end_packet(packets, start);
}
