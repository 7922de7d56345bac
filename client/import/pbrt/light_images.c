/* light_images: what lights must know about the images that are in the blob, and images made for them. */
#include <stdlib.h>

#include "client/import/pbrt/state/images.h"

static double decode(const blob_image_t *image, uint8_t byte)
{
    double encoded = byte / 255.0;
    if (image->gamma > 0) return pow(encoded, (double)image->gamma);
    return encoded <= 0.04045 ? encoded / 12.92 : pow((encoded + 0.055) / 1.055, 2.4);
}

/* Linear; negative values are 0. */
static void pixel(const blob_image_t *image, const uint32_t *texels, size_t index, double rgb[3])
{
    const uint8_t *bytes = (const uint8_t *)(texels + image->first_word);
    const float *floats = (const float *)(texels + image->first_word);
    for (size_t k = 0; k < 3; ++k) {
        switch ((texels_t)image->format) {
        case TEXELS_R8:
            rgb[k] = decode(image, bytes[index]);
            break;
        case TEXELS_RGBA8:
            rgb[k] = decode(image, bytes[4 * index + k]);
            break;
        case TEXELS_R32F:
            rgb[k] = fmax((double)floats[index], 0);
            break;
        default:
            rgb[k] = fmax((double)floats[3 * index + k], 0);
        }
    }
}

static blob_image_t image_of(const pbrt_t *p, blob_ref_t ref)
{
    return ((const blob_image_t *)blob_builder_records(p->builder, BLOB_SECTION_IMAGES))[ref - 1];
}

double pbrt_image_mean(const pbrt_t *p, blob_ref_t ref, double (*weight)(const void *, double, double),
                       const void *context)
{
    blob_image_t image = image_of(p, ref);
    const uint32_t *texels = blob_builder_records(p->builder, BLOB_SECTION_TEXELS);
    double sum = 0;
    for (uint32_t y = 0; y < image.height; ++y) {
        double row = 0;
        for (uint32_t x = 0; x < image.width; ++x) {
            double rgb[3];
            pixel(&image, texels, (size_t)y * image.width + x, rgb);
            double luminance = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
            row += weight ? luminance * weight(context, (x + 0.5) / image.width, (y + 0.5) / image.height)
                          : luminance;
        }
        sum += row;
    }
    return sum / ((double)image.width * image.height);
}

static blob_ref_t add_floats(pbrt_t *p, uint32_t width, uint32_t height, const float *floats)
{
    blob_image_t image = {.format = TEXELS_R32F, .width = width, .height = height, .gamma = 1};
    image.first_word = blob_builder_add(p->builder, BLOB_SECTION_TEXELS, floats, width * height);
    return 1 + blob_builder_add(p->builder, BLOB_SECTION_IMAGES, &image, 1);
}

blob_ref_t pbrt_grey_image(pbrt_t *p, blob_ref_t ref)
{
    blob_image_t image = image_of(p, ref);
    if (image.format == TEXELS_R8 || image.format == TEXELS_R32F) return ref;
    size_t count = (size_t)image.width * image.height;
    const uint32_t *texels = blob_builder_records(p->builder, BLOB_SECTION_TEXELS);
    float *grey = mem_alloc(count * sizeof *grey);
    for (size_t i = 0; i < count; ++i) {
        double rgb[3];
        pixel(&image, texels, i, rgb);
        grey[i] = (float)((rgb[0] + rgb[1] + rgb[2]) / 3);
    }
    blob_ref_t made = add_floats(p, image.width, image.height, grey);
    free(grey);
    return made;
}

blob_ref_t pbrt_white_image(pbrt_t *p)
{
    static const float white = 1;
    return add_floats(p, 1, 1, &white);
}
