/* wavefront: the meshes of an OBJ file (Wavefront, "Object Files", version 3.0).
 *
 * Read are v, vt, vn and f, with indices from the file's begin or, negative, from the line; o and g, which
 * name what follows; usemtl and mtllib, whose names are handed on. Faces of one name and one material make
 * one mesh, those with normals apart from those without. A face of many corners becomes triangles: a fan
 * where it is convex, otherwise by cutting off ears, as long as that takes seconds (warning). Not read, with
 * a warning each: points, lines, weights, colours at vertices. Free-form curves and surfaces are refused.
 */
#ifndef LIGHTMILL_WAVEFRONT_H
#define LIGHTMILL_WAVEFRONT_H

#include "client/import/files/intern.h"
#include "client/import/scene/mesh.h"

#define WAVEFRONT_NONE 0xFFFFFFFFu

/* Faces of one name and material, as a mesh with vertices of its own. */
typedef struct {
    uint32_t name;     /* among the names; WAVEFRONT_NONE where the file gives none */
    uint32_t material; /* among the materials; WAVEFRONT_NONE where none was chosen */
    position_t at;     /* of its first face */
    mesh_t mesh;       /* at least one triangle, of which none has been checked: see mesh_add */
} wavefront_part_t;

/* Owned: all of it (wavefront_free). */
typedef struct {
    wavefront_part_t *parts;
    size_t part_count, part_capacity;
    size_t position_count; /* of all v in the file */
    intern_t names, materials;
    intern_t libraries; /* the files that mtllib names, in the order of the file */
} wavefront_t;

/* Reads the file into *out; `path` is kept for the places of messages. Counts its bytes and vertices: see
 * scene_charge. The caller frees *out, also after an error. Errors and warnings name the line. */
result_t wavefront_read(const char *path, scene_builder_t *scene, wavefront_t *out);
void wavefront_free(wavefront_t *file);

#endif
