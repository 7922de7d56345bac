/* cube: surroundings in six images, the faces of a cube, laid out anew as one image of latitude and
 * longitude: that is what the renderer draws directions from.
 */
#ifndef LIGHTMILL_CUBE_H
#define LIGHTMILL_CUBE_H

#include "client/import/scene/scene_images.h"
#include "common/image/texture_image.h"

enum { CUBE_FACES = 6 };

/* Linear RGB, rows from the top. Use it zeroed; owned: the faces. */
typedef struct {
    vec3_t *faces[CUBE_FACES]; /* +x -x +y -y +z -z */
    uint32_t side;
} cube_t;

void cube_free(cube_t *cube);
/* Takes over a decoded image as the next face; false when it is no square, or not as large as the face
 * before. Where the colours of its format are encoded and it has an alpha, that divides the colours (RGBD).
 */
bool cube_set_face(cube_t *cube, int face, const texture_image_t *image);
/* Adds the image of a cube whose faces are all set, for the mapping LIGHT_LATLONG_Y. */
blob_ref_t cube_add_image(scene_builder_t *scene, const cube_t *cube);

#endif
