/* scene_images: see scene_images.h. */
#include "client/import/scene/scene_images.h"

#include <float.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

/* ---- encodings ---------------------------------------------------------------------------------------- */

static float gamma_of(float asked, bool encoded)
{
    return asked >= 0 ? asked : encoded ? 0.0f : 1.0f;
}

double scene_decode_srgb(double encoded)
{
    return encoded <= 0.04045 ? encoded / 12.92 : pow((encoded + 0.055) / 1.055, 2.4);
}

static double decode(double encoded, float gamma)
{
    return gamma > 0 ? pow(encoded, (double)gamma) : scene_decode_srgb(encoded);
}

/* Beyond 1 it goes on as it is; below 0 there is nothing to decode. */
static float decode_float(float encoded, float gamma)
{
    if (gamma == 1 || encoded <= 0) return encoded;
    double value = decode((double)encoded, gamma);
    return value < (double)FLT_MAX ? (float)value : FLT_MAX;
}

/* ---- storing ------------------------------------------------------------------------------------------ */

/* A texel of any type as 8 bits. */
static uint8_t byte_at(const texture_image_t *image, size_t at)
{
    if (image->type == TEXELS_U8) return image->bytes[at];
    return (uint8_t)(float_clamp(image->floats[at], 0, 1) * 255.0f + 0.5f);
}

/* One pixel: grey, or four channels, of which the last is alpha. */
static void write_bytes(const texture_image_t *source, size_t pixel, bool grey, uint8_t *to)
{
    size_t channels = source->channels, from = pixel * channels;
    for (size_t k = 0; k < (grey ? 1 : 3); ++k) to[k] = byte_at(source, from + (channels == 2 ? 0 : k));
    if (!grey) to[3] = channels % 2 == 0 ? byte_at(source, from + channels - 1) : 255;
}

static void write_floats(const texture_image_t *source, size_t pixel, bool grey, float gamma, float *to)
{
    for (size_t k = 0; k < (grey ? 1 : 3); ++k)
        to[k] = decode_float(source->floats[pixel * source->channels + k], gamma);
}

/* All pixels, from rows to the order of the blob. */
static void write_pixels(const texture_image_t *source, bool floats, bool grey, float gamma, void *to)
{
    for (uint32_t y = 0; y < source->height; ++y) {
        blob_row_t row = blob_image_row(source->width, source->height, y);
        for (uint32_t x = 0; x < source->width; ++x) {
            size_t from = (size_t)y * source->width + x, at = row.first + x * row.step;
            if (floats)
                write_floats(source, from, grey, gamma, (float *)to + at * (grey ? 1 : 3));
            else
                write_bytes(source, from, grey, (uint8_t *)to + at * (grey ? 1 : 4));
        }
    }
}

/* Room for so many bytes among the texels; NULL when they are full, which finishing the blob tells. */
static void *add_texels(scene_builder_t *scene, size_t size, uint32_t *first)
{
    uint32_t count = (uint32_t)((size + 3) / 4);
    *first = blob_builder_add(scene->blob, BLOB_SECTION_TEXELS, NULL, count);
    if (blob_builder_count(scene->blob, BLOB_SECTION_TEXELS) != *first + count) return NULL;
    return (uint32_t *)blob_builder_records(scene->blob, BLOB_SECTION_TEXELS) + *first;
}

static blob_ref_t add_record(scene_builder_t *scene, const blob_image_t *record)
{
    return 1 + blob_builder_add(scene->blob, BLOB_SECTION_IMAGES, record, 1);
}

static blob_ref_t store(scene_builder_t *scene, const texture_image_t *source, bool floats, bool grey,
                        float gamma)
{
    blob_image_t record = {.width = source->width, .height = source->height, .gamma = floats ? 1 : gamma};
    size_t pixels = (size_t)source->width * source->height;
    record.format = floats ? (grey ? TEXELS_R32F : TEXELS_RGB32F) : grey ? TEXELS_R8 : TEXELS_RGBA8;
    void *to = add_texels(scene, pixels * blob_texel_bytes(record.format), &record.first_word);
    if (to) write_pixels(source, floats, grey, gamma, to);
    return add_record(scene, &record);
}

static bool is_opaque(const texture_image_t *source)
{
    bool opaque = true, bytes = source->type == TEXELS_U8;
    size_t step = source->channels, values = step * source->width * source->height;
    for (size_t i = step - 1; step % 2 == 0 && i < values; i += step)
        opaque = opaque && (bytes ? source->bytes[i] == 255 : source->floats[i] == 1);
    return opaque;
}

/* The alpha, the last of two or four channels, as a grey image, decoded like the colours; 0 when it is 1
 * everywhere. */
static blob_ref_t store_alpha(scene_builder_t *scene, const texture_image_t *source, float gamma)
{
    if (is_opaque(source)) return 0;
    size_t pixels = (size_t)source->width * source->height, step = source->channels;
    texture_image_t alpha = *source;
    alpha.channels = 1;
    alpha.bytes = source->bytes ? mem_alloc(pixels) : NULL;
    alpha.floats = source->floats ? mem_alloc(pixels * sizeof *alpha.floats) : NULL;
    for (size_t i = 0; i < pixels; ++i)
        if (source->bytes)
            alpha.bytes[i] = source->bytes[step * (i + 1) - 1];
        else
            alpha.floats[i] = source->floats[step * (i + 1) - 1];
    blob_ref_t stored = store(scene, &alpha, source->type == TEXELS_FLOAT, true, gamma);
    texture_image_free(&alpha);
    return stored;
}

/* ---- finding and adding ------------------------------------------------------------------------------- */

enum { ANY_USE = UINT32_MAX }; /* changed, but in the same way for all uses */

static const scene_image_t *remember(scene_builder_t *scene, const char *key, scene_image_t image)
{
    image.key = mem_strdup(key);
    scene->images =
        grow(scene->images, &scene->image_capacity, scene->image_count + 1, sizeof *scene->images);
    scene->images[scene->image_count] = image;
    return &scene->images[scene->image_count++];
}

/* Another record of the same texels. */
static blob_ref_t reencode(scene_builder_t *scene, blob_ref_t image, float gamma)
{
    if (image == 0) return 0;
    blob_image_t record = scene_image_record(scene, image);
    record.gamma = gamma;
    return add_record(scene, &record);
}

static const scene_image_t *find(scene_builder_t *scene, const char *key, float asked, uint32_t use)
{
    const scene_image_t *other = NULL;
    for (size_t i = 0; i < scene->image_count; ++i) {
        const scene_image_t *image = &scene->images[i];
        bool fits = image->use == use || (image->use == ANY_USE && use != 0);
        if (!fits || strcmp(image->key, key) != 0) continue;
        if (image->always_linear || image->gamma == gamma_of(asked, image->encoded)) return image;
        other = image;
    }
    if (!other || scene_image_record(scene, other->image).format > TEXELS_RGBA8) return NULL;
    scene_image_t image = *other;
    image.gamma = gamma_of(asked, image.encoded);
    image.image = reencode(scene, other->image, image.gamma);
    image.alpha = reencode(scene, other->alpha, image.gamma);
    return remember(scene, key, image);
}

const scene_image_t *scene_find_image(scene_builder_t *scene, const char *key, float gamma)
{
    return find(scene, key, gamma, 0);
}

/* The use of the pixels, once they are changed. */
static uint32_t change_pixels(const scene_change_t *change, const char *name, position_t at,
                              texture_image_t *pixels)
{
    if (!change) return 0;
    return change->change(change->context, name, at, pixels) ? change->use : ANY_USE;
}

/* Adds the pixels, if reading them is a success, and frees them. */
static result_t add(scene_builder_t *scene, const char *key, const char *name, float asked,
                    scene_alpha_t alpha, const scene_change_t *change, position_t at, result_t read,
                    texture_image_t *pixels, const scene_image_t **image)
{
    if (read.code != RESULT_OK) return error_at(at, "%s", read.message);
    if (pixels->bad_values > 0)
        report_warning(scene->report, at,
                       "%s: %" PRIu64 " values are infinite or not a number and taken for 0", name,
                       pixels->bad_values);
    uint32_t use = change_pixels(change, name, at, pixels);
    bool within = alpha == SCENE_ALPHA_WITHIN, plain = pixels->channels % 2 == 1 && !pixels->encoded;
    bool floats = pixels->type == TEXELS_FLOAT && (!within || plain);
    scene_image_t added = {.encoded = pixels->encoded, .always_linear = within && floats, .use = use};
    added.gamma = added.always_linear ? 1 : gamma_of(asked, pixels->encoded);
    added.grey = pixels->channels == 1 || (pixels->channels == 2 && !within);
    result_t result = scene_charge(scene, SCENE_PIXELS, (uint64_t)pixels->width * pixels->height, at);
    if (result.code == RESULT_OK) {
        added.image = store(scene, pixels, floats, added.grey, added.gamma);
        if (alpha == SCENE_ALPHA_APART) added.alpha = store_alpha(scene, pixels, added.gamma);
        *image = remember(scene, key, added);
    }
    texture_image_free(pixels);
    return result;
}

result_t scene_add_image(scene_builder_t *scene, const char *key, const char *name, const uint8_t *bytes,
                         size_t size, float gamma, scene_alpha_t alpha, position_t at,
                         const scene_image_t **image)
{
    texture_image_t pixels;
    result_t read = texture_image_decode(name, bytes, size, &pixels);
    return add(scene, key, name, gamma, alpha, NULL, at, read, &pixels, image);
}

result_t scene_image_of_file(scene_builder_t *scene, const char *path, float gamma, scene_alpha_t alpha,
                             position_t at, const scene_image_t **image)
{
    return scene_changed_image(scene, path, gamma, alpha, NULL, at, image);
}

result_t scene_changed_image(scene_builder_t *scene, const char *path, float gamma, scene_alpha_t alpha,
                             const scene_change_t *change, position_t at, const scene_image_t **image)
{
    *image = find(scene, path, gamma, change ? change->use : 0);
    if (*image) return result_ok();
    texture_image_t pixels;
    scene_count_file(scene, path);
    result_t read = texture_image_read(path, &pixels);
    return add(scene, path, path, gamma, alpha, change, at, read, &pixels, image);
}

/* ---- what lights ask of them -------------------------------------------------------------------------- */

blob_image_t scene_image_record(const scene_builder_t *scene, blob_ref_t image)
{
    return ((const blob_image_t *)blob_builder_records(scene->blob, BLOB_SECTION_IMAGES))[image - 1];
}

/* Linear; negative values are 0. */
static void pixel(const blob_image_t *image, const uint32_t *texels, size_t index, double rgb[3])
{
    const uint8_t *bytes = (const uint8_t *)(texels + image->first_word);
    const float *floats = (const float *)(texels + image->first_word);
    for (size_t k = 0; k < 3; ++k) {
        switch ((texels_t)image->format) {
        case TEXELS_R8:
            rgb[k] = decode(bytes[index] / 255.0, image->gamma);
            break;
        case TEXELS_RGBA8:
            rgb[k] = decode(bytes[4 * index + k] / 255.0, image->gamma);
            break;
        case TEXELS_R32F:
            rgb[k] = fmax((double)floats[index], 0);
            break;
        default:
            rgb[k] = fmax((double)floats[3 * index + k], 0);
        }
    }
}

double scene_image_mean(const scene_builder_t *scene, blob_ref_t ref,
                        double (*weight)(const void *, double, double), const void *context)
{
    blob_image_t image = scene_image_record(scene, ref);
    const uint32_t *texels = blob_builder_records(scene->blob, BLOB_SECTION_TEXELS);
    double sum = 0;
    for (uint32_t y = 0; y < image.height; ++y) {
        double sum_of_row = 0;
        blob_row_t row = blob_image_row(image.width, image.height, y);
        for (uint32_t x = 0; x < image.width; ++x) {
            double rgb[3];
            pixel(&image, texels, row.first + x * row.step, rgb);
            double luminance = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
            sum_of_row += weight
                              ? luminance * weight(context, (x + 0.5) / image.width, (y + 0.5) / image.height)
                              : luminance;
        }
        sum += sum_of_row;
    }
    return sum / ((double)image.width * image.height);
}

rgb_t scene_image_average(const scene_builder_t *scene, blob_ref_t ref)
{
    blob_image_t image = scene_image_record(scene, ref);
    const uint32_t *texels = blob_builder_records(scene->blob, BLOB_SECTION_TEXELS);
    size_t count = (size_t)image.width * image.height;
    double sum[3] = {0, 0, 0}, rgb[3];
    for (size_t i = 0; i < count; ++i) {
        pixel(&image, texels, i, rgb);
        for (int k = 0; k < 3; ++k) sum[k] += rgb[k];
    }
    double part = 1 / (double)count;
    return vec3((float)(sum[0] * part), (float)(sum[1] * part), (float)(sum[2] * part));
}

/* Decoding keeps the order of what is encoded. */
rgb_t scene_image_most(const scene_builder_t *scene, blob_ref_t ref)
{
    blob_image_t image = scene_image_record(scene, ref);
    const uint32_t *texels =
        (const uint32_t *)blob_builder_records(scene->blob, BLOB_SECTION_TEXELS) + image.first_word;
    bool floats = image.format == TEXELS_R32F || image.format == TEXELS_RGB32F;
    size_t stride = image.format == TEXELS_RGBA8 ? 4 : image.format == TEXELS_RGB32F ? 3 : 1;
    size_t count = (size_t)image.width * image.height * stride;
    double most[3] = {0, 0, 0};
    for (size_t i = 0; i < 3; ++i)
        for (size_t k = stride > 1 ? i : 0; k < count; k += stride)
            most[i] = fmax(most[i], floats ? (double)((const float *)texels)[k]
                                           : ((const uint8_t *)texels)[k] / 255.0);
    for (size_t i = 0; i < 3 && !floats; ++i) most[i] = decode(most[i], image.gamma);
    return vec3((float)most[0], (float)most[1], (float)most[2]);
}

bool scene_image_holds_normals(const scene_builder_t *scene, blob_ref_t ref)
{
    blob_image_t image = scene_image_record(scene, ref);
    const uint32_t *texels = blob_builder_records(scene->blob, BLOB_SECTION_TEXELS);
    const vec3_t mean = scene_image_average(scene, ref);
    if (fabsf(mean.x - 0.5f) > 0.1f || fabsf(mean.y - 0.5f) > 0.1f || mean.z < 0.75f) return false;
    size_t count = (size_t)image.width * image.height, units = 0;
    for (size_t i = 0; i < count; ++i) {
        double rgb[3], length2 = 0;
        pixel(&image, texels, i, rgb);
        for (int k = 0; k < 3; ++k) length2 += (2 * rgb[k] - 1) * (2 * rgb[k] - 1);
        units += fabs(sqrt(length2) - 1) < 0.1;
    }
    return units >= count - count / 4;
}

float *scene_image_greys(const scene_builder_t *scene, blob_ref_t ref)
{
    blob_image_t image = scene_image_record(scene, ref);
    const uint32_t *texels = blob_builder_records(scene->blob, BLOB_SECTION_TEXELS);
    float *greys = mem_alloc((size_t)image.width * image.height * sizeof *greys), *to = greys;
    for (uint32_t y = 0; y < image.height; ++y) {
        blob_row_t row = blob_image_row(image.width, image.height, y);
        for (uint32_t x = 0; x < image.width; ++x) {
            double rgb[3];
            pixel(&image, texels, row.first + x * row.step, rgb);
            *to++ = (float)((rgb[0] + rgb[1] + rgb[2]) / 3);
        }
    }
    return greys;
}

blob_ref_t scene_grey_image(scene_builder_t *scene, blob_ref_t ref)
{
    blob_image_t image = scene_image_record(scene, ref);
    if (image.format == TEXELS_R8 || image.format == TEXELS_R32F) return ref;
    float *greys = scene_image_greys(scene, ref);
    blob_ref_t grey = scene_float_image(scene, greys, image.width, image.height, 1);
    free(greys);
    return grey;
}

blob_ref_t scene_float_image(scene_builder_t *scene, const float *values, uint32_t width, uint32_t height,
                             uint32_t channels)
{
    const texture_image_t source = {.width = width,
                                    .height = height,
                                    .channels = channels,
                                    .type = TEXELS_FLOAT,
                                    .floats = (float *)values}; /* nothing is written there */
    return store(scene, &source, true, channels == 1, 1);
}

blob_ref_t scene_white_image(scene_builder_t *scene)
{
    const float white = 1;
    return scene_float_image(scene, &white, 1, 1, 1);
}
