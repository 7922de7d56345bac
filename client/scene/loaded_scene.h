/* loaded_scene: a scene as it is named on a command line, as one blob. */
#ifndef LIGHTMILL_LOADED_SCENE_H
#define LIGHTMILL_LOADED_SCENE_H

#include "client/import/scene/wishes.h"
#include "common/scene/scene_blob.h"

typedef struct {
    scene_blob_t blob; /* mapped from its file, or from one without a name */
    char *name;        /* owned; what to call the job and the image: "cornell" */
} loaded_scene_t;

/* Loads a scene file (.pbrt, .gltf, .glb, .obj, .xml), a directory that holds a scene.pbrt, or a scene blob.
 * Warnings go to the log. `wishes` (NULL: none) is what is asked for beyond what the file says. */
result_t scene_load(const char *path, const import_wishes_t *wishes, loaded_scene_t *scene);
/* Harmless on a zeroed scene. */
void scene_free(loaded_scene_t *scene);

#endif
