/* serialized: Mitsuba's own format of meshes: several in a file, each compressed by zlib, and a directory at
 * the end (the documentation of Mitsuba 0.6, section 8.2.4). */
#ifndef LIGHTMILL_SERIALIZED_H
#define LIGHTMILL_SERIALIZED_H

#include "client/import/scene/mesh.h"

/* Reads mesh `index` of the file into an empty mesh, which the caller frees, also after an error. *flat: the
 * file asks for flat faces. Versions 3 and 4. Counts its bytes and vertices (scene_charge); errors name `at`.
 */
result_t serialized_read(const char *path, uint64_t index, scene_builder_t *scene, position_t at,
                         mesh_t *mesh, bool *flat);

#endif
