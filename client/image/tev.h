/* tev: the packets with which a renderer shows its image in a viewer.
 *
 * The protocol is that of tev (https://github.com/Tom94/tev, README.md "Over the Network"), which pbrt-v4 and
 * HDRView speak too. A packet is its own length in bytes as a 32-bit integer, a byte that tells its kind, and
 * what that kind needs. All integers and floats are little-endian; a text ends with a zero byte. The viewer
 * answers nothing.
 */
#ifndef LIGHTMILL_TEV_H
#define LIGHTMILL_TEV_H

#include "common/base.h"

enum { TEV_DEFAULT_PORT = 14158 };

/* Packets one after the other, as they go to the viewer. Begins as zero; the owner frees `bytes`. */
typedef struct {
    uint8_t *bytes;
    size_t size, capacity;
} tev_packets_t;

/* Appends CreateImage: a black image of this name, which replaces one of the same name and comes to the
 * front. Channels "layer.R", "layer.G", "layer.B" become a group. No name begins with a digit: tev reads such
 * names wrong. */
void tev_create_image(tev_packets_t *packets, const char *name, int width, int height,
                      const char *const *channels, size_t channel_count);

typedef struct {
    int x, y, width, height; /* pixels, from the top left of the image */
} tev_rectangle_t;

/* Appends UpdateImage (its third version) for some channels of a rectangle. `values` has the shape
 * [channel_count][height][width]. All of it must stay below 2^31 bytes. */
void tev_update_image(tev_packets_t *packets, const char *name, const tev_rectangle_t *rectangle,
                      const char *const *channels, size_t channel_count, const float *values);

#endif
