/* skin: where the joints of a skin stand (the glTF 2.0 specification, section 3.7.3).
 *
 * A joint is a node. What it does to a vertex is its place in the world after the inverse of the place that
 * it had when mesh and joint were bound; where the node of the mesh stands means nothing. So a skinned mesh
 * is in the world as soon as it is read.
 */
#include "client/import/gltf/document.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

/* Mesh to joint when they were bound. Its last row is 0 0 0 1; exporters round it. */
static affine_t inverse_bind(const accessor_t *accessor, size_t joint)
{
    double columns[16];
    affine_t out;
    accessor_get(accessor, joint, columns);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 4; ++j) out.m[i][j] = columns[4 * j + i];
    return out;
}

static result_t open_inverses(document_t *document, const item_t *item, size_t joints, accessor_t *accessor)
{
    uint32_t index = ITEM_NONE;
    *accessor = (accessor_t){0};
    TRY(item_index(item, "inverseBindMatrices", document_count(document, TOP_ACCESSORS), &index));
    if (index == ITEM_NONE) return result_ok();
    TRY(accessor_open(document, index, accessor));
    if (accessor->components != 16 || accessor->type != COMPONENT_FLOAT)
        return item_fail(item, "its inverseBindMatrices (accessor %" PRIu32 ") must be a MAT4 of floats",
                         index);
    if (accessor->count < joints)
        return item_fail(item, "has %zu inverseBindMatrices for %zu joints", accessor->count, joints);
    return result_ok();
}

static result_t find_joint(const document_t *document, const item_t *joints, size_t i, const affine_t **world)
{
    const json_t *element = json_array_get(joints->json, i);
    json_int_t node = json_is_integer(element) ? json_integer_value(element) : -1;
    size_t nodes = document_count(document, TOP_NODES);
    if (node < 0 || (uint64_t)node >= nodes)
        return item_fail(joints, "element %zu must be the index of one of the %zu nodes", i, nodes);
    *world = node_world(document, (uint32_t)node);
    return *world
               ? result_ok()
               : item_fail(joints, "element %zu, node %" PRIu32 ", is not in the scene", i, (uint32_t)node);
}

static result_t make(document_t *document, const item_t *item, gltf_skin_t *skin)
{
    item_t joints;
    accessor_t inverses;
    TRY(item_member(item, "joints", JSON_ARRAY, &joints));
    skin->count = item_count(&joints);
    if (skin->count == 0) return item_fail(item, "needs joints");
    TRY(open_inverses(document, item, skin->count, &inverses));
    skin->joints = mem_alloc(skin->count * sizeof *skin->joints);
    for (size_t i = 0; i < skin->count; ++i) {
        const affine_t *world = NULL;
        TRY(find_joint(document, &joints, i, &world));
        skin->joints[i] = *world;
        if (inverses.count == 0) continue;
        affine_t inverse = inverse_bind(&inverses, i);
        skin->joints[i] = affine_multiply(world, &inverse);
    }
    return result_ok();
}

result_t skin_get(document_t *document, uint32_t index, const gltf_skin_t **skin)
{
    gltf_skin_t *known = &document->skins[index];
    item_t item;
    *skin = NULL;
    if (!known->joints) {
        TRY(document_item(document, TOP_SKINS, index, &item));
        result_t result = make(document, &item, known);
        if (result.code != RESULT_OK) {
            free(known->joints);
            known->joints = NULL;
            return result;
        }
    }
    *skin = known;
    return result_ok();
}
