/* obj: Wavefront OBJ files with their MTL materials, as modelling programs and archives of models have them.
 *
 * They know surfaces alone: a scene gets a camera that sees all of it, and, where nothing emits, a white sky.
 * docs/import.md says what is read, and what becomes of Phong's materials.
 */
#ifndef LIGHTMILL_OBJ_H
#define LIGHTMILL_OBJ_H

#include "client/import/scene/scene_builder.h"

/* Reads the scene at `path` into an empty builder: see import_scene. */
result_t obj_import(const char *path, scene_builder_t *builder);

#endif
