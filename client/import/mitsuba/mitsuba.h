/* mitsuba: scenes of Mitsuba 0.4 to 0.6 (.xml).
 *
 * From the bottom up: xml reads the files into a tree; property reads numbers, colours and transforms in it;
 * texture, bsdf (with metals), shape (with serialized), emitter (with daylight_emitter) and sensor each make
 * a family of objects; mitsuba is the order of things.
 */
#ifndef LIGHTMILL_MITSUBA_H
#define LIGHTMILL_MITSUBA_H

#include "client/import/scene/scene_builder.h"

/* Reads the scene at `path` into an empty builder: see import_scene. */
result_t mitsuba_import(const char *path, scene_builder_t *builder);

#endif
