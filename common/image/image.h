/* image: float images with named channels, as OpenEXR knows them, and their files.
 *
 * Pixels are in rows from the top left. A channel's value at (x, y) is data[(y * width + x) * stride]; an
 * owned channel is a plane (stride 1), a view borrows any strided array, so that a film is written without a
 * copy. Attributes are the named values of an EXR header.
 */
#ifndef LIGHTMILL_IMAGE_H
#define LIGHTMILL_IMAGE_H

#include "common/base.h"

#include <stdatomic.h>

enum {
    IMAGE_MAX_SIDE = 32768,
    IMAGE_MAX_PIXELS = 1 << 27,
    IMAGE_MAX_CHANNELS = 1024,
    IMAGE_MAX_ATTRIBUTES = 4096
};
#define IMAGE_MAX_BYTES ((uint64_t)1 << 33) /* of all channels as floats */

/* How a channel is stored in a file; in memory all are floats. */
typedef enum { PIXEL_FLOAT, PIXEL_HALF, PIXEL_UINT } pixel_type_t;

typedef struct {
    char *name; /* owned */
    pixel_type_t type;
    const float *data;
    size_t stride; /* floats from pixel to pixel */
    float *plane;  /* the owned pixels, or NULL for a view */
} image_channel_t;

typedef enum { ATTRIBUTE_STRING, ATTRIBUTE_INT, ATTRIBUTE_FLOAT, ATTRIBUTE_OTHER } attribute_kind_t;

typedef struct {
    char *name; /* owned */
    attribute_kind_t kind;
    char *text; /* owned; the value as text, whatever its kind */
    int32_t integer;
    float real;
} image_attribute_t;

/* What the writer of a large EXR tells another thread while it writes, and is told. */
typedef struct {
    atomic_size_t done, total; /* pieces; total 0: it has not begun */
    atomic_bool cancel;        /* nobody wants the file any more: RESULT_CANCELLED */
    uint64_t limit;            /* bytes that it may have, RESULT_LIMIT beyond; 0: any number */
    bool too_large;            /* said by the writer: that was why it failed */
    bool fleeting;             /* it needs not survive a power cut: it is not flushed */
} image_writing_t;

typedef struct {
    int width, height;
    image_writing_t *writing; /* the caller's, for image_write_exr; NULL: nobody asks */
    image_channel_t *channels;
    size_t channel_count;
    image_attribute_t *attributes;
    size_t attribute_count;
    bool has_chromaticities;    /* the file says what R, G and B are: */
    float chromaticities[4][2]; /* x and y of red, green, blue and white; read, never written */
} image_t;

/* An image without channels. */
void image_init(image_t *image, int width, int height);
/* Frees what the image owns; harmless on a zeroed image. */
void image_free(image_t *image);

/* Adds a zeroed plane of width * height floats, owned by the image; NULL when memory lacks. `name` is copied.
 */
float *image_add_channel(image_t *image, const char *name, pixel_type_t type);
/* Adds a channel whose pixels the caller keeps as long as the image lives. */
void image_add_view(image_t *image, const char *name, pixel_type_t type, const float *data, size_t stride);
/* Adds three planes: "R", "G", "B", or with a layer "layer.R" and so on; false when memory lacks. */
bool image_add_rgb(image_t *image, const char *layer, pixel_type_t type, float *rgb[3]);
/* The channel of that name, or NULL. */
const image_channel_t *image_find(const image_t *image, const char *name);
/* The channels R, G, B, or layer.R and so on; false when one is missing. */
bool image_find_rgb(const image_t *image, const char *layer, const image_channel_t *rgb[3]);

/* Header values; names of at most 31 characters, used once each. Strings are copied. */
void image_set_string(image_t *image, const char *name, const char *text);
void image_set_int(image_t *image, const char *name, int32_t value);
void image_set_float(image_t *image, const char *name, float value);
/* EXR has no 64-bit integers: written as a decimal string. */
void image_set_u64(image_t *image, const char *name, uint64_t value);
/* The attribute of that name, or NULL. */
const image_attribute_t *image_attribute(const image_t *image, const char *name);

/* BLAKE2b-256 of the pixels alone, in this order, little-endian: width and height as 32-bit integers, then by
 * ascending name (bytewise) each channel's name, a zero byte, and its floats' bits row by row. Attributes,
 * the compression and the order of channels in the file do not matter. */
hash_t image_hash(const image_t *image);

/* Reads an OpenEXR file: the first part of a scanline or tiled file (of a tiled one the full resolution), its
 * data window, any channels and compression that OpenEXRCore decodes. RESULT_INPUT names the file and what is
 * wrong with it; deep data and subsampled channels are refused. On failure there is nothing to free. */
result_t image_read_exr(const char *path, image_t *image);
/* The same of a file's bytes in memory, not NULL; `name`, not empty, stands for the path in errors. */
result_t image_decode_exr(const char *name, const uint8_t *data, size_t size, image_t *image);
/* Is given some rows of a file of `height` rows in all: an image of its own whose first row is the file's row
 * `y`, which is kept during the call only. A failure ends the reading. */
typedef result_t (*image_rows_fn)(void *context, const image_t *rows, int y, int height);
/* Reads a scanline file from the top to the bottom, in the memory of some rows: 16 of those we write. */
result_t image_read_exr_rows(const char *path, image_rows_fn take, void *context);
/* Writes a scanline OpenEXR file with ZIP compression, whole or not at all, on as many threads as there are
 * cores; the bytes do not depend on their number. Channels of type PIXEL_HALF are rounded to halves, finite
 * values clamped to the largest of them; all others are written as floats. image->writing may end it early.
 */
result_t image_write_exr(const char *path, const image_t *image);
/* Writes R, G, B as an 8-bit sRGB PNG, scaled by 2^exposure and clipped, whole or not at all. */
result_t image_write_png(const char *path, const image_t *image, float exposure);

#endif
