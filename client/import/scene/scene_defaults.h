/* scene_defaults: what a scene gets whose file says nothing. */
#ifndef LIGHTMILL_SCENE_DEFAULTS_H
#define LIGHTMILL_SCENE_DEFAULTS_H

#include "client/import/scene/scene_builder.h"

/* A white sky of radiance 1. */
void scene_add_sky(scene_builder_t *scene);
/* Places a camera that sees all meshes: in front of them (+z), a little to the right and above, y up, so far
 * away that the sphere about their box fits into `fov`. There must be one mesh at least. */
result_t scene_see_everything(const scene_builder_t *scene, blob_scene_t *record, position_t at);

#endif
