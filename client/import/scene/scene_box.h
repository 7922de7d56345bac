/* scene_box: the box about shapes, for cameras that shall see them. */
#ifndef LIGHTMILL_SCENE_BOX_H
#define LIGHTMILL_SCENE_BOX_H

#include "client/import/scene/scene_builder.h"

/* Along the axes; empty while low is above high. */
typedef struct {
    vec3_t low, high;
} box_t;

box_t box_empty(void);
/* Extends it by a shape of the blob, of which a quadric counts as its bounding box, a curve as its points. */
void box_extend(box_t *box, const scene_builder_t *scene, const blob_shape_t *shape,
                const xform_t *world_from_object);
/* About all shapes where they stand, instances included, when the shutter opens; before scene_finish. A scene
 * without shapes has a cube about the origin, whose edges are 2 long. */
box_t scene_box(const scene_builder_t *scene);

#endif
