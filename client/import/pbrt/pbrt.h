/* pbrt: scenes in the text formats of pbrt-v3 and pbrt-v4.
 *
 * How the folder is cut: lexer (tokens) and params (parameter lists) read the text; dialect tells v3 from v4;
 * state holds the graphics state and gathers the scene; pbrt is the table of directives and the loop over
 * them; transforms, options, materials, textures, lights and shapes are the directives, each family with a
 * table of its own. A new material, shape, light, texture or filter is one table entry and one function.
 */
#ifndef LIGHTMILL_PBRT_H
#define LIGHTMILL_PBRT_H

#include "client/import/report.h"

/* Imports the scene at `path` into an empty builder: see import_scene. */
result_t pbrt_import(const char *path, blob_builder_t *builder, report_t *report);

#endif
