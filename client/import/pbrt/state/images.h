/* images: image files that textures and lights name, and what lights must know about them. */
#ifndef LIGHTMILL_PBRT_IMAGES_H
#define LIGHTMILL_PBRT_IMAGES_H

#include "client/import/pbrt/state/state.h"

/* How the numbers of a file are encoded: as its format says, or a gamma of blob_image_t (0: sRGB, 1: linear).
 */
#define IMAGE_GAMMA_OF_FILE (-1.0f)
/* Reads an image file into the blob, once for each encoding. `filename` is as in the scene (see
 * pbrt_resolve). Fails at `at` when it cannot be read. */
result_t pbrt_image(pbrt_t *p, const char *filename, float gamma, position_t at, blob_ref_t *image);
/* What the texture of an image must know about it. */
const image_file_t *pbrt_image_file(const pbrt_t *p, blob_ref_t image);

/* The mean over an image of the blob of its luminance times weight(context, s, t), where (s, t) is a pixel's
 * centre in [0, 1]^2 with the first row at t = 0; `weight` NULL: 1. */
double pbrt_image_mean(const pbrt_t *p, blob_ref_t image, double (*weight)(const void *, double, double),
                       const void *context);
/* A copy of an image with the mean of its colours as grey. */
blob_ref_t pbrt_grey_image(pbrt_t *p, blob_ref_t image);
/* An image of one white pixel. */
blob_ref_t pbrt_white_image(pbrt_t *p);

#endif
