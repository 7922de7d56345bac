/* mesh: a triangle mesh on its way from a file into the blob.
 *
 * A reader of some format fills a mesh_t in the shape's own space; mesh_add checks it, takes it to the
 * object's space and appends it. It guarantees what the blob promises: finite vertices, indices in range, no
 * triangle without area, normals of unit length, tangents of unit length or 0.
 */
#ifndef LIGHTMILL_MESH_H
#define LIGHTMILL_MESH_H

#include "client/import/scene/scene_builder.h"

/* Owns its arrays (mesh_free). All but `positions` and `triangles` may be NULL; those of vertices hold
 * vertex_count each. Of a mesh that changes while the shutter is open `positions`, `normals`, `tangents` and
 * `bitangents` hold `steps` times as many: see blob_mesh_t. */
typedef struct {
    vec3_t *positions;
    vec3_t *normals;
    vec3_t *tangents, *bitangents; /* both, beside normals, or none */
    vec2_t *uvs;
    vec2_t *uvs2;
    blob_colour_t *colours;
    blob_triangle_t *triangles;
    uint32_t vertex_count, triangle_count;
    uint32_t steps; /* 0: it stands still */
} mesh_t;

/* Frees the arrays and empties the mesh. */
void mesh_free(mesh_t *mesh);

/* Appends the mesh, transformed by `object_from_mesh` (invertible), to the blob, and frees it, whatever the
 * result. `reverse` is the file's wish to turn the surface over: vertex normals are negated by it, and it
 * takes part in SHAPE_FLIP. The shape gets its kind, geometry and flags; its geometry is BLOB_NONE when no
 * triangle had an area. Errors and warnings name `at`, the shape in the scene file. */
result_t mesh_add(scene_builder_t *scene, mesh_t *mesh, const affine_t *object_from_mesh, bool reverse,
                  position_t at, blob_shape_t *shape);
/* Gives the mesh vertex normals: at each vertex the mean of its triangles' normals, weighted by their angles
 * there (Thuermer and Wuethrich 1998, "Computing Vertex Normals from Polygonal Facets"). Indices must be in
 * range: RESULT_INPUT otherwise. */
result_t mesh_smooth(mesh_t *mesh, position_t at);
/* The area of a mesh in the blob. */
double mesh_area(const scene_builder_t *scene, uint32_t geometry);

#endif
