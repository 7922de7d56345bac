/* images: image files that textures and lights name, read once for each encoding and stored in the blob. */
#include "client/import/pbrt/state/images.h"

#include <float.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/texture_image.h"

/* The sRGB transfer function (IEC 61966-2-1), or a power; beyond 1 it goes on as it is. */
static float decode(float encoded, float gamma)
{
    if (encoded <= 0) return encoded;
    double value = (double)encoded;
    if (gamma > 0)
        value = pow(value, (double)gamma);
    else
        value = value <= 0.04045 ? value / 12.92 : pow((value + 0.055) / 1.055, 2.4);
    return value < (double)FLT_MAX ? (float)value : FLT_MAX;
}

static uint32_t add_words(pbrt_t *p, const void *bytes, size_t size)
{
    uint32_t count = (uint32_t)((size + 3) / 4);
    uint32_t first = blob_builder_add(p->builder, BLOB_SECTION_TEXELS, NULL, count);
    if (blob_builder_count(p->builder, BLOB_SECTION_TEXELS) == first + count)
        memcpy((uint32_t *)blob_builder_records(p->builder, BLOB_SECTION_TEXELS) + first, bytes, size);
    return first; /* too many texels: finishing the blob says so */
}

static void add_bytes(pbrt_t *p, const texture_image_t *source, const image_file_t *file, blob_image_t *image)
{
    size_t pixels = (size_t)source->width * source->height, channels = source->channels;
    size_t to = file->grey ? 1 : 4;
    uint8_t *bytes = mem_alloc(pixels * to);
    for (size_t i = 0; i < pixels; ++i) {
        const uint8_t *from = source->bytes + i * channels;
        memcpy(bytes + i * to, from, file->grey ? 1 : 3);
        if (file->grey) continue;
        bytes[4 * i + 3] = channels == 4 ? from[3] : 255;
    }
    image->format = file->grey ? TEXELS_R8 : TEXELS_RGBA8;
    image->gamma = file->gamma;
    image->first_word = add_words(p, bytes, pixels * to);
    free(bytes);
}

static void add_floats(pbrt_t *p, const texture_image_t *source, const image_file_t *file,
                       blob_image_t *image)
{
    size_t pixels = (size_t)source->width * source->height, to = file->grey ? 1 : 3;
    float *floats = mem_alloc(pixels * to * sizeof *floats);
    for (size_t i = 0; i < pixels; ++i)
        for (size_t k = 0; k < to; ++k) {
            float value = source->floats[i * source->channels + k];
            floats[i * to + k] = file->gamma == 1 ? value : decode(value, file->gamma);
        }
    image->format = file->grey ? TEXELS_R32F : TEXELS_RGB32F;
    image->gamma = 1;
    image->first_word = add_words(p, floats, pixels * to * sizeof *floats);
    free(floats);
}

/* The alpha of an image whose alpha is not 1 everywhere, as a grey image; 0 of others. pbrt-v4 decodes it
 * like the colours. */
static blob_ref_t add_alpha(pbrt_t *p, const texture_image_t *source, float gamma)
{
    size_t pixels = (size_t)source->width * source->height;
    if (source->channels != 4) return 0;
    bool opaque = true, bytes = source->type == TEXELS_U8;
    for (size_t i = 3; i < 4 * pixels; i += 4)
        opaque = opaque && (bytes ? source->bytes[i] == 255 : source->floats[i] == 1);
    if (opaque) return 0;
    texture_image_t alpha = {
        .width = source->width, .height = source->height, .channels = 1, .type = source->type};
    if (bytes)
        alpha.bytes = mem_alloc(pixels);
    else
        alpha.floats = mem_alloc(pixels * sizeof *alpha.floats);
    for (size_t i = 0; i < pixels; ++i)
        if (bytes)
            alpha.bytes[i] = source->bytes[4 * i + 3];
        else
            alpha.floats[i] = source->floats[4 * i + 3];
    image_file_t file = {.gamma = gamma, .grey = true};
    blob_image_t image = {.width = source->width, .height = source->height};
    if (bytes)
        add_bytes(p, &alpha, &file, &image);
    else
        add_floats(p, &alpha, &file, &image);
    texture_image_free(&alpha);
    return 1 + blob_builder_add(p->builder, BLOB_SECTION_IMAGES, &image, 1);
}

static const image_file_t *find(const pbrt_t *p, const char *path, float asked, float gamma)
{
    for (size_t i = 0; i < p->image_count; ++i) {
        const image_file_t *file = &p->images[i];
        if ((file->asked == asked || file->gamma == gamma) && strcmp(file->path, path) == 0) return file;
    }
    return NULL;
}

static void store(pbrt_t *p, image_file_t file)
{
    p->images = grow(p->images, &p->image_capacity, p->image_count + 1, sizeof *p->images);
    p->images[p->image_count++] = file;
}

/* An image that is not in the blob as asked for yet; `path` becomes the list's. */
static result_t load(pbrt_t *p, char *path, float asked, position_t at, blob_ref_t *ref)
{
    texture_image_t source;
    result_t result = texture_image_read(path, &source);
    if (result.code != RESULT_OK) {
        free(path);
        return error_at(at, "%s", result.message);
    }
    if (source.bad_values > 0)
        report_warning(p->report, at, "%s: %llu values are infinite or not a number and taken for 0", path,
                       (unsigned long long)source.bad_values);
    float gamma = asked >= 0 ? asked : source.encoded ? 0.0f : 1.0f;
    image_file_t file = {.path = path, .asked = asked, .gamma = gamma, .grey = source.channels <= 2};
    const image_file_t *same = find(p, path, asked, gamma);
    if (same) {
        file.grey = same->grey;
        file.alpha = same->alpha;
        file.image = same->image;
    } else {
        blob_image_t image = {.width = source.width, .height = source.height};
        if (source.type == TEXELS_U8)
            add_bytes(p, &source, &file, &image);
        else
            add_floats(p, &source, &file, &image);
        file.image = 1 + blob_builder_add(p->builder, BLOB_SECTION_IMAGES, &image, 1);
        if (p->dialect.dialect == DIALECT_V4) file.alpha = add_alpha(p, &source, gamma);
    }
    texture_image_free(&source);
    store(p, file);
    *ref = file.image;
    return result_ok();
}

result_t pbrt_image(pbrt_t *p, const char *filename, float gamma, position_t at, blob_ref_t *image)
{
    char *path = pbrt_resolve(p, filename);
    const image_file_t *known = find(p, path, gamma, gamma < 0 ? INFINITY : gamma);
    if (!known) return load(p, path, gamma, at, image);
    free(path);
    *image = known->image;
    return result_ok();
}

const image_file_t *pbrt_image_file(const pbrt_t *p, blob_ref_t image)
{
    size_t i = 0;
    while (i + 1 < p->image_count && p->images[i].image != image) ++i;
    return &p->images[i];
}
