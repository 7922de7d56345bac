/* scene_images: the images of a scene, decoded once, stored once, and found again by their key.
 *
 * The blob has texels of 8 bits, encoded, or of floats, linear: what is encoded in a file of floats is
 * decoded here. An image of 8 bits that is wanted in two encodings is two records of the same texels.
 */
#ifndef LIGHTMILL_SCENE_IMAGES_H
#define LIGHTMILL_SCENE_IMAGES_H

#include "client/import/scene/scene_builder.h"
#include "common/image/texture_image.h"

/* What becomes of alpha. */
typedef enum {
    SCENE_ALPHA_DROPPED, /* only images of 8 bits may keep it */
    SCENE_ALPHA_APART,   /* the same; where it is not 1 everywhere, it also becomes a grey image, decoded as
                            colours are */
    SCENE_ALPHA_WITHIN   /* it stays with the colours, which takes images of 8 bits: of floats, only what is
                            linear and without alpha stays as it is */
} scene_alpha_t;

/* How the numbers of a file are encoded: as its format says, or a gamma of blob_image_t (0: sRGB, 1: linear).
 */
#define SCENE_GAMMA_OF_FILE (-1.0f)

/* What a reader changes of an image before it is stored. */
typedef struct {
    uint32_t use; /* what it is wanted for: 1 and more, as far as that makes a difference */
    /* Changes the pixels of a file, called `name`; returns whether they are others for other uses. */
    bool (*change)(void *context, const char *name, position_t at, texture_image_t *pixels);
    void *context;
} scene_change_t;

/* The image of that key in that encoding, as in the file; NULL when it must be read first. Valid until
 * another one is added.
 */
const scene_image_t *scene_find_image(scene_builder_t *scene, const char *key, float gamma);
/* Decodes the bytes of an image file, called `name` in messages, and adds it; *image is valid until another
 * one is added. Errors and warnings name `at`. RESULT_INPUT when the image cannot be read, or is too much:
 * see SCENE_PIXELS. */
result_t scene_add_image(scene_builder_t *scene, const char *key, const char *name, const uint8_t *bytes,
                         size_t size, float gamma, scene_alpha_t alpha, position_t at,
                         const scene_image_t **image);
/* Finds or adds the image in a file; its path is its key. */
result_t scene_image_of_file(scene_builder_t *scene, const char *path, float gamma, scene_alpha_t alpha,
                             position_t at, const scene_image_t **image);
/* The same once it is changed; `change` NULL: as in the file. */
result_t scene_changed_image(scene_builder_t *scene, const char *path, float gamma, scene_alpha_t alpha,
                             const scene_change_t *change, position_t at, const scene_image_t **image);

/* The light of a value that is encoded as sRGB (IEC 61966-2-1). */
double scene_decode_srgb(double encoded);
blob_image_t scene_image_record(const scene_builder_t *scene, blob_ref_t image);
/* The mean over an image of the blob of its luminance times weight(context, s, t), where (s, t) is a pixel's
 * centre in [0, 1]^2 with the first row at t = 0; `weight` NULL: 1. */
double scene_image_mean(const scene_builder_t *scene, blob_ref_t image,
                        double (*weight)(const void *, double, double), const void *context);
/* The mean of each channel of an image of the blob, linear. */
rgb_t scene_image_average(const scene_builder_t *scene, blob_ref_t image);
/* The largest value of each channel in an image of the blob, linear. */
rgb_t scene_image_most(const scene_builder_t *scene, blob_ref_t image);
/* Whether an image plainly holds normals in tangent space and not colours or heights: three quarters of its
 * linear colours are unit vectors n as (n + 1) / 2, and their mean looks outward. A grey image never does. */
bool scene_image_holds_normals(const scene_builder_t *scene, blob_ref_t image);
/* The mean of the colours of each pixel of an image, linear, in fresh memory that the caller frees. */
float *scene_image_greys(const scene_builder_t *scene, blob_ref_t image);
/* A copy of an image with the mean of its colours as grey; the image itself when it is grey. */
blob_ref_t scene_grey_image(scene_builder_t *scene, blob_ref_t image);
/* Adds an image of linear floats, rows from the top, of one channel or of three interleaved. */
blob_ref_t scene_float_image(scene_builder_t *scene, const float *values, uint32_t width, uint32_t height,
                             uint32_t channels);
/* An image of one white pixel. */
blob_ref_t scene_white_image(scene_builder_t *scene);

#endif
