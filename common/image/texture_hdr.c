/* texture_hdr: Radiance pictures, .hdr and .pic (see texture_image.h).
 *
 * Lines of text up to an empty one, a line with the size and the order of the pixels, then scanlines of
 * pixels of four bytes: three mantissas and an exponent (G. Ward, "Real Pixels", Graphics Gems II, 1991). A
 * scanline is flat, or each of its four components is run-length coded by itself. The old run-length coding,
 * which repeats whole pixels, is refused: its mark, mantissas 1 1 1, is no pixel that a writer makes.
 */
#include "common/image/texture_codec.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MIN_CODED_WIDTH = 8, MAX_CODED_WIDTH = 32767, MAX_RUN = 127, MAX_LINE = 4096 };

typedef struct {
    const char *name;
    const uint8_t *at, *end; /* what is not read yet */
    texture_image_t *image;
    bool bottom_up, right_to_left;
    uint8_t *scanline; /* [width][4] */
} hdr_t;

static result_t hdr_error(const hdr_t *hdr, const char *reason)
{
    return result_fail(RESULT_INPUT, "%s: cannot be read as Radiance HDR: %s", hdr->name, reason);
}

/* The next line without its end, as a string; false when none ends within reach. */
static bool read_line(hdr_t *hdr, char line[MAX_LINE])
{
    size_t left = (size_t)(hdr->end - hdr->at), reach = left < MAX_LINE ? left : MAX_LINE;
    const uint8_t *stop = memchr(hdr->at, '\n', reach);
    if (stop == NULL) return false;
    size_t length = (size_t)(stop - hdr->at);
    memcpy(line, hdr->at, length);
    if (length > 0 && line[length - 1] == '\r') length--;
    line[length] = '\0';
    hdr->at = stop + 1;
    return true;
}

static result_t read_header(hdr_t *hdr)
{
    char line[MAX_LINE];
    do {
        if (!read_line(hdr, line)) return hdr_error(hdr, "its header does not end");
        if (strncmp(line, "FORMAT=", 7) == 0 && strcmp(line + 7, "32-bit_rle_rgbe") != 0)
            return hdr_error(hdr, "its FORMAT is not 32-bit_rle_rgbe");
    } while (line[0] != '\0');
    return result_ok();
}

/* "-Y height +X width": rows from the top, pixels from the left; the other signs turn it round. */
static result_t read_size(hdr_t *hdr)
{
    char line[MAX_LINE], vertical, horizontal;
    int height, width, used = 0;
    if (!read_line(hdr, line)) return hdr_error(hdr, "there is no line with its size");
    int found = sscanf(line, "%cY %9d %cX %9d%n", &vertical, &height, &horizontal, &width, &used);
    if (found != 4 || line[used] != '\0' || strchr("+-", vertical) == NULL ||
        strchr("+-", horizontal) == NULL)
        return hdr_error(hdr, "its size is not of the form -Y height +X width");
    hdr->bottom_up = vertical == '+';
    hdr->right_to_left = horizontal == '-';
    return texture_set_size(hdr->name, width, height, hdr->image);
}

static bool can_be_coded(const texture_image_t *image)
{
    return image->width >= MIN_CODED_WIDTH && image->width <= MAX_CODED_WIDTH;
}

/* The fewest bytes that a scanline takes: for each component runs of two bytes. */
static size_t least_scanline(const texture_image_t *image)
{
    size_t flat = 4 * (size_t)image->width, coded = 4 + 4 * 2 * ((image->width + MAX_RUN - 1) / MAX_RUN);
    return can_be_coded(image) && coded < flat ? coded : flat;
}

/* One component of a coded scanline. */
static bool read_component(hdr_t *hdr, uint32_t component)
{
    uint32_t width = hdr->image->width;
    for (uint32_t x = 0; x < width;) {
        if (hdr->at == hdr->end) return false;
        uint32_t count = *hdr->at++;
        bool run = count > 128;
        if (run) count -= 128;
        size_t bytes = run ? 1 : count;
        if (count == 0 || count > width - x || bytes > (size_t)(hdr->end - hdr->at)) return false;
        for (uint32_t i = 0; i < count; i++, x++) hdr->scanline[4 * x + component] = hdr->at[run ? 0 : i];
        hdr->at += bytes;
    }
    return true;
}

static bool read_flat(hdr_t *hdr)
{
    size_t bytes = 4 * (size_t)hdr->image->width;
    if ((size_t)(hdr->end - hdr->at) < bytes) return false;
    memcpy(hdr->scanline, hdr->at, bytes);
    hdr->at += bytes;
    return true;
}

static result_t read_scanline(hdr_t *hdr)
{
    const uint8_t *in = hdr->at;
    bool coded = can_be_coded(hdr->image) && hdr->end - in >= 4 && in[0] == 2 && in[1] == 2 && in[2] < 128;
    if (!coded) {
        if (!read_flat(hdr)) return hdr_error(hdr, "it is cut short");
        for (size_t x = 0; x < hdr->image->width; x++)
            if (memcmp(hdr->scanline + 4 * x, "\1\1\1", 3) == 0)
                return hdr_error(hdr, "its old run-length coding is not supported; save it again");
        return result_ok();
    }
    if ((uint32_t)(in[2] << 8 | in[3]) != hdr->image->width)
        return hdr_error(hdr, "a scanline has another width");
    hdr->at += 4;
    for (uint32_t c = 0; c < 4; c++)
        if (!read_component(hdr, c)) return hdr_error(hdr, "a scanline is cut short or damaged");
    return result_ok();
}

/* A mantissa m with the exponent e stands for m / 256 * 2^(e - 128); the exponent 0 for black. */
static void store_scanline(const hdr_t *hdr, size_t y)
{
    const texture_image_t *image = hdr->image;
    size_t width = image->width;
    float *row = image->floats + (hdr->bottom_up ? image->height - 1 - y : y) * width * 3;
    for (size_t x = 0; x < width; x++) {
        const uint8_t *in = hdr->scanline + 4 * x;
        float *out = row + 3 * (hdr->right_to_left ? width - 1 - x : x);
        float scale = in[3] > 0 ? ldexpf(1.0f, in[3] - 136) : 0.0f;
        for (size_t c = 0; c < 3; c++) out[c] = scale * (float)in[c];
    }
}

result_t texture_read_hdr(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    hdr_t hdr = {.name = name, .at = data, .end = data + size, .image = image};
    TRY(read_header(&hdr));
    TRY(read_size(&hdr));
    if ((size_t)(hdr.end - hdr.at) / image->height < least_scanline(image))
        return hdr_error(&hdr, "it is too short for its size");
    TRY(texture_allocate(name, 3, TEXELS_FLOAT, image));
    hdr.scanline = mem_alloc(4 * (size_t)image->width);
    result_t result = result_ok();
    for (size_t y = 0; y < image->height && result.code == RESULT_OK; y++) {
        result = read_scanline(&hdr);
        store_scanline(&hdr, y);
    }
    free(hdr.scanline);
    return result;
}
