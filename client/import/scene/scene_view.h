/* scene_view: changes the camera of a scene that its reader has finished: field of view, lens, focus. */
#ifndef LIGHTMILL_SCENE_VIEW_H
#define LIGHTMILL_SCENE_VIEW_H

#include "client/import/scene/scene_builder.h"

/* Grants fov, lens_radius and focus. An object's focus is the middle of the box about its shapes, where they
 * are when the shutter opens. RESULT_USAGE when the camera has no such thing (only perspective ones have a
 * field of view, only these and orthographic ones a lens), when a lens has no focus, or when there is no such
 * object, or it lies behind the camera or stands in several places. */
result_t scene_adjust_view(scene_builder_t *scene, const import_wishes_t *wishes);

#endif
