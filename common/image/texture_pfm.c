/* texture_pfm: portable float maps (see texture_image.h).
 *
 * "PF" (RGB) or "Pf" (grey), width, height and scale as text, one white space, then floats with the rows from
 * the bottom; a negative scale says little endian.
 */
#include "common/image/texture_codec.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The text of the header that is not read yet. */
typedef struct {
    const uint8_t *at, *end;
} pfm_text_t;

static bool is_space(uint8_t c)
{
    return c == ' ' || c == '\t' || c == '\n' || c == '\r';
}

/* The next word, which must have white space before and after it, as a number; false when there is none. */
static bool read_number(pfm_text_t *text, double *number)
{
    char word[32];
    size_t length = 0;
    if (text->at == text->end || !is_space(*text->at)) return false;
    while (text->at < text->end && is_space(*text->at)) text->at++;
    while (text->at < text->end && !is_space(*text->at)) {
        if (length + 1 == sizeof word) return false;
        word[length++] = (char)*text->at++;
    }
    word[length] = '\0';
    char *rest;
    *number = strtod(word, &rest);
    return length > 0 && *rest == '\0' && strlen(word) == length && text->at < text->end;
}

static result_t read_size(const char *name, pfm_text_t *text, texture_image_t *image)
{
    double width, height;
    if (!read_number(text, &width) || !read_number(text, &height))
        return result_fail(RESULT_INPUT, "%s: cannot be read as PFM: no width and height", name);
    if (!(fabs(width) < 1e9 && fabs(height) < 1e9) || width != floor(width) || height != floor(height))
        return result_fail(RESULT_INPUT, "%s: cannot be read as PFM: %g x %g pixels", name, width, height);
    return texture_set_size(name, (int64_t)width, (int64_t)height, image);
}

static float read_float(const uint8_t *in, bool little)
{
    uint32_t bits = little ? (uint32_t)in[3] << 24 | (uint32_t)in[2] << 16 | (uint32_t)in[1] << 8 | in[0]
                           : (uint32_t)in[0] << 24 | (uint32_t)in[1] << 16 | (uint32_t)in[2] << 8 | in[3];
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

result_t texture_read_pfm(const char *name, const uint8_t *data, size_t size, texture_image_t *image)
{
    pfm_text_t text = {data + 2, data + size};
    double scale;
    TRY(read_size(name, &text, image));
    if (!read_number(&text, &scale) || scale == 0.0 || !isfinite((float)scale))
        return result_fail(RESULT_INPUT, "%s: cannot be read as PFM: no finite scale other than 0", name);
    text.at++; /* exactly one white space: the next byte may look like one */

    uint32_t channels = data[1] == 'F' ? 3 : 1;
    size_t line = (size_t)image->width * channels, bytes = line * image->height * sizeof(float);
    if ((size_t)(text.end - text.at) < bytes)
        return result_fail(RESULT_INPUT, "%s: is cut short: %zu bytes of pixels, expected %zu", name,
                           (size_t)(text.end - text.at), bytes);
    TRY(texture_allocate(name, channels, TEXELS_FLOAT, image));
    float factor = fabsf((float)scale);
    for (size_t y = 0; y < image->height; y++) {
        float *row = image->floats + (image->height - 1 - y) * line;
        for (size_t i = 0; i < line; i++)
            row[i] = factor * read_float(text.at + (y * line + i) * sizeof(float), scale < 0.0);
    }
    return result_ok();
}
