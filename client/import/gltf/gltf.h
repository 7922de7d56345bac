/* gltf: glTF 2.0 scenes (.gltf and .glb), as Blender and many others export them.
 *
 * docs/import.md lists what is read; docs/blender.md says how to export for Lightmill.
 */
#ifndef LIGHTMILL_GLTF_H
#define LIGHTMILL_GLTF_H

#include "client/import/scene/scene_builder.h"

/* Reads the scene at `path` into an empty builder: see import_scene. */
result_t gltf_import(const char *path, scene_builder_t *builder);

#endif
