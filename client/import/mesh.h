/* mesh: a triangle mesh on its way from a file into the blob.
 *
 * A reader of some format fills a mesh_t in the shape's own space; mesh_add checks it, takes it to the
 * object's space and appends it. It guarantees what the blob promises: finite vertices, indices in range, no
 * triangle without area, normals of unit length.
 */
#ifndef LIGHTMILL_MESH_H
#define LIGHTMILL_MESH_H

#include "client/import/affine.h"
#include "client/import/report.h"

/* Owns its arrays (mesh_free). `normals`, `uvs`, `uvs2` and `colours` are NULL or hold vertex_count each. */
typedef struct {
    vec3_t *positions;
    vec3_t *normals;
    vec2_t *uvs;
    vec2_t *uvs2;
    blob_colour_t *colours;
    blob_triangle_t *triangles;
    uint32_t vertex_count, triangle_count;
} mesh_t;

/* Frees the arrays and empties the mesh. */
void mesh_free(mesh_t *mesh);

/* Appends the mesh, transformed by `object_from_mesh` (invertible), to the builder, and empties it; after
 * an error, or without a triangle, it may be half transformed, and is only good for mesh_free. `reverse` is
 * the file's wish to turn the surface over: vertex normals are negated by it, and *flip says whether the
 * shape needs SHAPE_FLIP. *index is the new mesh, or BLOB_NONE when no triangle had an area. Errors and
 * warnings name `at`, the shape in the scene file. */
result_t mesh_add(mesh_t *mesh, const affine_t *object_from_mesh, bool reverse, position_t at,
                  report_t *report, blob_builder_t *builder, uint32_t *index, bool *flip);

#endif
