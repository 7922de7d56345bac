/* pbrt: scenes in the text formats of pbrt-v3 and pbrt-v4.
 *
 * How the folder is cut, from the bottom up: syntax/ reads the text, and tells v3 from v4; state/ holds the
 * graphics state, and reads values with it; materials/ (with media) and shapes/, transforms, options, cameras
 * and lights are the directives, each family with a table of its own; pbrt is the table of directives and the
 * loop over them. A new material, medium, shape, light, texture, camera or filter is one table entry and one
 * function.
 */
#ifndef LIGHTMILL_PBRT_H
#define LIGHTMILL_PBRT_H

#include "client/import/scene/scene_builder.h"

/* Imports the scene at `path` into an empty builder: see import_scene. */
result_t pbrt_import(const char *path, scene_builder_t *builder);

#endif
