/* scene_defaults: what a scene gets whose file says nothing. */
#ifndef LIGHTMILL_SCENE_DEFAULTS_H
#define LIGHTMILL_SCENE_DEFAULTS_H

#include "client/import/scene/scene_builder.h"

/* Light for a file of a format that has no environment, unless it gets one: a white sky of radiance 1 where
 * nothing emits, with a warning; a warning alone where only surfaces do (`lamps` false). Such a file may be a
 * room with its lights, or be made for programs that bring an environment, where it comes out dark. */
void scene_default_light(scene_builder_t *scene, bool lamps, position_t at);
/* Places a camera that sees all shapes: in front of them (+z), a little to the right and above, y up, so far
 * away that the sphere about their box fits into `fov`. */
result_t scene_see_everything(const scene_builder_t *scene, blob_scene_t *record, position_t at);
/* Whether there is neither a shape nor an object. */
bool scene_is_empty(const scene_builder_t *scene);
/* Tells when there is no shape to be seen: a warning, since other programs show their background then; with
 * --strict an error. */
result_t scene_expect_shapes(const scene_builder_t *scene, position_t at);

#endif
