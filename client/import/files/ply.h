/* ply: triangle meshes in the Stanford PLY format, ASCII and binary of either byte order, plain or gzipped.
 *
 * Read are the vertices' x y z, nx ny nz, u v (also s t, texture_u texture_v, texture_s texture_t) and red
 * green blue (also diffuse_red and so on; bytes become 0 to 1, encoded or not) and the faces' list of vertex
 * indices; a face becomes the fan of triangles 0 1 2, 0 2 3, 0 3 4 and so on. Other elements and properties,
 * face_indices among them, are passed over. Counts are checked against the bytes that are there before memory
 * is taken; a gzipped file may have up to 4 GiB inside.
 */
#ifndef LIGHTMILL_PLY_H
#define LIGHTMILL_PLY_H

#include "client/import/scene/mesh.h"

/* Reads the file into an empty mesh, which the caller frees, also after an error. An error names the file and
 * the line, or in the body of a binary file the byte offset. Faces of fewer than three vertices are left out
 * with a warning. */
result_t ply_read(const char *path, report_t *report, mesh_t *mesh);

#endif
