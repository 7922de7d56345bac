/* image: channels, attributes and the pixel hash (see image.h). */
#include "common/image/image.h"

#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static size_t pixel_count(const image_t *image)
{
    return (size_t)image->width * (size_t)image->height;
}

void image_init(image_t *image, int width, int height)
{
    *image = (image_t){.width = width, .height = height};
}

void image_free(image_t *image)
{
    for (size_t i = 0; i < image->channel_count; i++) {
        free(image->channels[i].name);
        free(image->channels[i].plane);
    }
    for (size_t i = 0; i < image->attribute_count; i++) {
        free(image->attributes[i].name);
        free(image->attributes[i].text);
    }
    free(image->channels);
    free(image->attributes);
    *image = (image_t){0};
}

static void append_channel(image_t *image, image_channel_t channel)
{
    size_t bytes = (image->channel_count + 1) * sizeof *image->channels;
    image->channels = mem_realloc(image->channels, bytes);
    image->channels[image->channel_count++] = channel;
}

float *image_add_channel(image_t *image, const char *name, pixel_type_t type)
{
    float *plane = calloc(pixel_count(image), sizeof *plane);
    if (plane != NULL) append_channel(image, (image_channel_t){mem_strdup(name), type, plane, 1, plane});
    return plane;
}

void image_add_view(image_t *image, const char *name, pixel_type_t type, const float *data, size_t stride)
{
    append_channel(image, (image_channel_t){mem_strdup(name), type, data, stride, NULL});
}

/* "layer.R", or "R" without a layer, in fresh memory. */
static char *layer_name(const char *layer, size_t component)
{
    return mem_printf("%s%s%c", layer != NULL ? layer : "", layer != NULL ? "." : "", "RGB"[component]);
}

bool image_add_rgb(image_t *image, const char *layer, pixel_type_t type, float *rgb[3])
{
    bool enough = true;
    for (size_t c = 0; c < 3; c++) {
        char *name = layer_name(layer, c);
        rgb[c] = image_add_channel(image, name, type);
        enough = enough && rgb[c] != NULL;
        free(name);
    }
    return enough;
}

const image_channel_t *image_find(const image_t *image, const char *name)
{
    for (size_t i = 0; i < image->channel_count; i++)
        if (strcmp(image->channels[i].name, name) == 0) return &image->channels[i];
    return NULL;
}

bool image_find_rgb(const image_t *image, const char *layer, const image_channel_t *rgb[3])
{
    bool found = true;
    for (size_t c = 0; c < 3; c++) {
        char *name = layer_name(layer, c);
        rgb[c] = image_find(image, name);
        found = found && rgb[c] != NULL;
        free(name);
    }
    return found;
}

/* Takes over `text`. */
static image_attribute_t *append_attribute(image_t *image, const char *name, attribute_kind_t kind,
                                           char *text)
{
    size_t bytes = (image->attribute_count + 1) * sizeof *image->attributes;
    image->attributes = mem_realloc(image->attributes, bytes);
    image_attribute_t *attribute = &image->attributes[image->attribute_count++];
    *attribute = (image_attribute_t){.name = mem_strdup(name), .kind = kind, .text = text};
    return attribute;
}

void image_set_string(image_t *image, const char *name, const char *text)
{
    append_attribute(image, name, ATTRIBUTE_STRING, mem_strdup(text));
}

void image_set_int(image_t *image, const char *name, int32_t value)
{
    append_attribute(image, name, ATTRIBUTE_INT, mem_printf("%d", value))->integer = value;
}

void image_set_float(image_t *image, const char *name, float value)
{
    append_attribute(image, name, ATTRIBUTE_FLOAT, mem_printf("%.9g", (double)value))->real = value;
}

void image_set_u64(image_t *image, const char *name, uint64_t value)
{
    append_attribute(image, name, ATTRIBUTE_STRING, mem_printf("%llu", (unsigned long long)value));
}

const image_attribute_t *image_attribute(const image_t *image, const char *name)
{
    for (size_t i = 0; i < image->attribute_count; i++)
        if (strcmp(image->attributes[i].name, name) == 0) return &image->attributes[i];
    return NULL;
}

static int by_name(const void *a, const void *b)
{
    const image_channel_t *const *left = a, *const *right = b;
    return strcmp((*left)->name, (*right)->name);
}

static void hash_channel(crypto_generichash_state *state, const image_channel_t *channel, size_t pixels)
{
    float chunk[4096];
    crypto_generichash_update(state, (const uint8_t *)channel->name, strlen(channel->name) + 1);
    for (size_t first = 0; first < pixels; first += ARRAY_LENGTH(chunk)) {
        size_t count = pixels - first < ARRAY_LENGTH(chunk) ? pixels - first : ARRAY_LENGTH(chunk);
        for (size_t i = 0; i < count; i++) chunk[i] = channel->data[(first + i) * channel->stride];
        crypto_generichash_update(state, (const uint8_t *)chunk, count * sizeof *chunk);
    }
}

hash_t image_hash(const image_t *image)
{
    const image_channel_t **sorted = mem_alloc((image->channel_count + 1) * sizeof *sorted);
    for (size_t i = 0; i < image->channel_count; i++) sorted[i] = &image->channels[i];
    qsort(sorted, image->channel_count, sizeof *sorted, by_name);

    const uint32_t size[2] = {(uint32_t)image->width, (uint32_t)image->height};
    hash_t hash;
    crypto_generichash_state state;
    crypto_generichash_init(&state, NULL, 0, HASH_BYTES);
    crypto_generichash_update(&state, (const uint8_t *)size, sizeof size);
    for (size_t i = 0; i < image->channel_count; i++) hash_channel(&state, sorted[i], pixel_count(image));
    crypto_generichash_final(&state, hash.bytes, HASH_BYTES);
    free(sorted);
    return hash;
}
