/* crease: smooth normals of meshes that have sharp edges all the same. */
#ifndef LIGHTMILL_CREASE_H
#define LIGHTMILL_CREASE_H

#include "client/import/scene/mesh.h"

/* Gives the mesh normals as mesh_smooth does, but not across edges sharper than `angle`, in degrees, whatever
 * normals and vertices it has: vertices that are alike become one, which is parted again into as many as
 * there are groups of its triangles. A group is the first triangle that is in none yet and all others whose
 * normals are less than `angle` from its normal, or the same (so Mitsuba does it). Of more than 64 groups at
 * a vertex each triangle has its own. Indices must be in range, and triangles less than 2^32 / 3:
 * RESULT_INPUT otherwise, with `at`, the shape in the scene file. The mesh must stand still and have no uvs2.
 */
result_t mesh_crease(mesh_t *mesh, double angle, position_t at);
/* Makes one vertex of those that are alike in position, uv and colour; the mesh has no normals afterwards.
 * Indices must be in range; the mesh must stand still and have no uvs2. */
void mesh_join(mesh_t *mesh);

#endif
