/* primitive: what the reading of a primitive (primitive.c) and the deforming of its vertices (deform.c)
 * share.
 */
#ifndef LIGHTMILL_PRIMITIVE_H
#define LIGHTMILL_PRIMITIVE_H

#include "client/import/gltf/document.h"

/* A primitive while it is read. */
typedef struct {
    document_t *document;
    const item_t *item;
    item_t attributes;
    uint64_t mode; /* 4 to 6, once checked */
    unpacked_t packed;
    accessor_t position, indices;
    accessor_t tangent; /* of a mesh that has tangents */
    bool indexed;
    uint32_t *used; /* old numbers of the vertices in use, by their new ones */
    size_t used_capacity;
    mesh_t *mesh;
} reader_t;

/* Opens an attribute of the primitive, packed or not, or, of `attributes` other than the primitive's, one of
 * a morph target. It has `least` to `most` components and an element for each vertex. *present says whether
 * it is there. */
result_t reader_open(reader_t *r, const item_t *attributes, const char *name, size_t least, size_t most,
                     accessor_t *accessor, bool *present);

/* Adds to what was read what morph targets say. */
result_t deform_morph(reader_t *r, const deform_t *deform);
/* Moves the vertices, with normals, tangents and bitangents, to where the skin puts them. *skinned: they are
 * in the world now; otherwise in the mesh's own space, since there is no skin. */
result_t deform_skin(reader_t *r, const deform_t *deform, bool *skinned);

#endif
