/* ply: triangle meshes in the Stanford PLY format, ASCII and binary of either byte order.
 *
 * Read are the vertices' x y z, nx ny nz and u v (also s t, texture_u texture_v, texture_s texture_t) and the
 * faces' list of 3 or 4 vertex indices; a face of four becomes the triangles 0 1 2 and 0 2 3. Other elements
 * and properties are passed over. Counts are checked against the bytes that are there before memory is taken.
 */
#ifndef LIGHTMILL_IMPORT_PLY_H
#define LIGHTMILL_IMPORT_PLY_H

#include "client/import/mesh.h"

/* Reads the file into an empty mesh, which the caller frees, also after an error. An error names the file and
 * the line, or in the body of a binary file the byte offset. Faces of fewer than three vertices are left out
 * with a warning. */
result_t ply_read(const char *path, report_t *report, mesh_t *mesh);

#endif
