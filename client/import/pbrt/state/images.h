/* images: the image files that a scene names. */
#ifndef LIGHTMILL_PBRT_IMAGES_H
#define LIGHTMILL_PBRT_IMAGES_H

#include "client/import/pbrt/state/state.h"

/* What an image is for. */
typedef enum {
    IMAGE_NUMBERS = 1, /* its values are taken as they are */
    IMAGE_REFLECTED,   /* it has colours: of surfaces, */
    IMAGE_EMITTED      /* or of lights */
} image_use_t;

/* Finds or reads an image file that the scene names, as pbrt does: v4 makes two images of a PNG or EXR file
 * that is transparent, and linear sRGB of an EXR's colours that say which others they are. */
result_t pbrt_image(pbrt_t *p, const char *filename, float gamma, image_use_t use, position_t at,
                    const scene_image_t **image);
/* Whether the file's name ends so, in small letters or capitals. */
bool pbrt_has_extension(const char *filename, const char *extension);

#endif
