/* ply: triangle meshes in the Stanford PLY format, ASCII and binary of either byte order, plain or gzipped.
 *
 * Read are the vertices' x y z, nx ny nz, u v (also s t, texture_u texture_v, texture_s texture_t) and red
 * green blue (also diffuse_red and so on; bytes become 0 to 1, encoded or not) and the faces' list of vertex
 * indices. Other elements and properties, face_indices among them, are passed over. Counts are checked
 * against the bytes that are there before memory is taken; a gzipped file may have up to 4 GiB inside.
 */
#ifndef LIGHTMILL_PLY_H
#define LIGHTMILL_PLY_H

#include "client/import/scene/mesh.h"

/* What a face of more than three vertices becomes. Which corner a triangle begins with tells where it has
 * which uv when the file has none. */
typedef enum {
    PLY_FANS,    /* the fan of triangles 0 1 2, 0 2 3, 0 3 4 and so on */
    PLY_PBRT_V3, /* of four: 0 1 2 and 3 0 2; both pbrts leave out those of more, a slip */
    PLY_PBRT_V4  /* of four: 0 1 2 and 2 3 0, on which u and v run along the sides that they do on pbrt-v4's
                    patch */
} ply_rules_t;

/* Reads the file into an empty mesh, which the caller frees, also after an error. An error names the file and
 * the line, or in the body of a binary file the byte offset. Faces of fewer than three vertices are left out
 * with a warning. `faces`, or NULL, gets the number of those that are not left out. */
result_t ply_read(const char *path, ply_rules_t rules, report_t *report, mesh_t *mesh, uint64_t *faces);

#endif
