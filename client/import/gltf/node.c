/* node: walks the hierarchy of nodes, in double precision (the glTF 2.0 specification, section 3.5). */
#include "client/import/gltf/document.h"

#include <stdlib.h>

enum { MAX_DEPTH = 500 };
static const double largest = 1e18;

typedef enum { NODE_NEW, NODE_OPEN, NODE_DONE } visit_t;

/* ---- transforms ---------------------------------------------------------------------------------------- */

/* Scaling, then the rotation by a quaternion x y z w, then the translation. */
static affine_t from_trs(const double t[3], const double r[4], const double s[3])
{
    double x = r[0], y = r[1], z = r[2], w = r[3];
    double norm = x * x + y * y + z * z + w * w, k = norm > 0 ? 2 / norm : 0;
    double rotation[3][3] = {{1 - k * (y * y + z * z), k * (x * y - z * w), k * (x * z + y * w)},
                             {k * (x * y + z * w), 1 - k * (x * x + z * z), k * (y * z - x * w)},
                             {k * (x * z - y * w), k * (y * z + x * w), 1 - k * (x * x + y * y)}};
    affine_t out;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) out.m[i][j] = rotation[i][j] * s[j];
        out.m[i][3] = t[i];
    }
    return out;
}

/* Of a node, at the document's time. */
static result_t local_transform(const document_t *document, uint32_t index, const item_t *node, affine_t *out)
{
    double matrix[16], t[3] = {0, 0, 0}, r[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
    bool present;
    bool moves = animation_width(document, index, MOVING_TRANSLATION) ||
                 animation_width(document, index, MOVING_ROTATION) ||
                 animation_width(document, index, MOVING_SCALE);
    TRY(item_numbers(node, "matrix", 16, -largest, largest, matrix, &present));
    if (present && moves)
        item_warn(node, "has a matrix and is animated, which may not be; its matrix is ignored");
    if (present && !moves) {
        if (!affine_from_columns(matrix, out))
            return item_fail(node, "its matrix is projective; the last row must be 0 0 0 1");
        return result_ok();
    }
    TRY(item_numbers(node, "translation", 3, -largest, largest, t, NULL));
    TRY(item_numbers(node, "rotation", 4, -1e6, 1e6, r, NULL));
    TRY(item_numbers(node, "scale", 3, -largest, largest, s, NULL));
    TRY(animation_value(document, index, MOVING_TRANSLATION, document->pose->time, t));
    TRY(animation_value(document, index, MOVING_ROTATION, document->pose->time, r));
    TRY(animation_value(document, index, MOVING_SCALE, document->pose->time, s));
    *out = from_trs(t, r, s);
    return result_ok();
}

/* ---- what a node holds --------------------------------------------------------------------------------- */

static gltf_placement_t *place(placements_t *list, uint32_t node, uint32_t thing, const affine_t *transform)
{
    list->items = grow(list->items, &list->capacity, list->count + 1, sizeof *list->items);
    gltf_placement_t *placement = &list->items[list->count++];
    *placement = (gltf_placement_t){node, thing, *transform, ITEM_NONE, false};
    return placement;
}

/* EXT_mesh_gpu_instancing: one of its attributes. */
static result_t open_instancing(document_t *document, const item_t *attributes, const char *name,
                                size_t components, accessor_t *accessor, size_t *count)
{
    uint32_t index = ITEM_NONE;
    TRY(item_index(attributes, name, document_count(document, TOP_ACCESSORS), &index));
    if (index == ITEM_NONE) return result_ok();
    TRY(accessor_open(document, index, accessor));
    if (accessor->components != components)
        return item_fail(attributes, "%s must have %zu components", name, components);
    if (*count != 0 && accessor->count != *count)
        return item_fail(attributes, "%s has %zu elements, but others %zu", name, accessor->count, *count);
    *count = accessor->count;
    return result_ok();
}

static result_t place_instances(document_t *document, const item_t *extension, uint32_t node, uint32_t mesh,
                                const affine_t *transform)
{
    item_t attributes;
    accessor_t translation = {0}, rotation = {0}, scale = {0};
    size_t count = 0;
    TRY(item_member(extension, "attributes", JSON_OBJECT, &attributes));
    TRY(open_instancing(document, &attributes, "TRANSLATION", 3, &translation, &count));
    TRY(open_instancing(document, &attributes, "ROTATION", 4, &rotation, &count));
    TRY(open_instancing(document, &attributes, "SCALE", 3, &scale, &count));
    if (count == 0) return item_fail(extension, "has no TRANSLATION, ROTATION or SCALE");
    TRY(document_charge(document, extension, 8 * (uint64_t)count));
    for (size_t i = 0; i < count; ++i) {
        double t[4] = {0}, r[4] = {0, 0, 0, 1}, s[4] = {1, 1, 1};
        if (translation.count) accessor_get(&translation, i, t);
        if (rotation.count) accessor_get(&rotation, i, r);
        if (scale.count) accessor_get(&scale, i, s);
        affine_t local = from_trs(t, r, s), world = affine_multiply(transform, &local);
        place(&document->pose->meshes, node, mesh, &world);
    }
    return result_ok();
}

static result_t place_mesh(document_t *document, const item_t *item, uint32_t node, const affine_t *transform)
{
    uint32_t mesh = ITEM_NONE, skin = ITEM_NONE;
    item_t instancing, weights;
    TRY(item_index(item, "mesh", document_count(document, TOP_MESHES), &mesh));
    if (mesh == ITEM_NONE) return result_ok();
    TRY(item_index(item, "skin", document_count(document, TOP_SKINS), &skin));
    TRY(item_member(item, "weights", JSON_ARRAY, &weights));
    TRY(item_extension(item, "EXT_mesh_gpu_instancing", &instancing));
    if (instancing.json) {
        if (skin != ITEM_NONE || weights.json)
            item_warn(item, "its skin and weights are ignored, since it has EXT_mesh_gpu_instancing");
        return place_instances(document, &instancing, node, mesh, transform);
    }
    gltf_placement_t *placement = place(&document->pose->meshes, node, mesh, transform);
    placement->skin = skin;
    placement->posed =
        skin != ITEM_NONE || weights.json != NULL || animation_width(document, node, MOVING_WEIGHTS) > 0;
    return result_ok();
}

static result_t place_others(document_t *document, const item_t *item, uint32_t node,
                             const affine_t *transform)
{
    uint32_t camera = ITEM_NONE, light = ITEM_NONE;
    TRY(item_index(item, "camera", document_count(document, TOP_CAMERAS), &camera));
    if (camera != ITEM_NONE) place(&document->pose->cameras, node, camera, transform);
    TRY(light_find(document, item, &light));
    if (light != ITEM_NONE && !document->hidden) place(&document->pose->lights, node, light, transform);
    return result_ok();
}

/* KHR_node_visibility: meshes and lights are hidden with all below them, cameras are not. */
static result_t hide(document_t *document, const item_t *item)
{
    item_t extension;
    bool visible = true;
    TRY(item_extension(item, "KHR_node_visibility", &extension));
    TRY(item_bool(&extension, "visible", &visible));
    document->hidden = document->hidden || !visible;
    return result_ok();
}

/* ---- the walk ------------------------------------------------------------------------------------------ */

static result_t visit(document_t *document, uint32_t node, const affine_t *parent, int depth);

/* Visits all nodes of a list of indices, a property of `owner`. */
static result_t visit_all(document_t *document, const item_t *owner, const char *key, const affine_t *parent,
                          int depth)
{
    item_t list;
    size_t nodes = document_count(document, TOP_NODES);
    TRY(item_member(owner, key, JSON_ARRAY, &list));
    for (size_t i = 0; i < item_count(&list); ++i) {
        uint32_t node = 0;
        TRY(item_index_at(&list, i, nodes, "nodes", &node));
        TRY(visit(document, node, parent, depth));
    }
    return result_ok();
}

/* A node in the scene has one parent. */
static result_t check_visit(const document_t *document, const item_t *item, uint32_t node, int depth)
{
    if (document->pose->visits[node] == NODE_OPEN)
        return item_fail(item, "is a child of itself: the nodes form a cycle");
    if (document->pose->visits[node] == NODE_DONE)
        return item_fail(item, "stands in the scene twice; a node may have one parent only");
    if (depth > MAX_DEPTH) return item_fail(item, "lies more than %d nodes deep", MAX_DEPTH);
    return result_ok();
}

/* Notes where a node is, and what stands there; *item is NULL when the walk is not to go on below it. Apart
 * from `visit`, so that what this takes of the stack is not taken for every level. */
__attribute__((noinline)) static result_t enter(document_t *document, uint32_t node, const affine_t *parent,
                                                int depth, item_t *item)
{
    affine_t local;
    pose_t *pose = document->pose;
    TRY(document_item(document, TOP_NODES, node, item));
    if (document->joints_only && (pose->visits[node] != NODE_NEW || depth > MAX_DEPTH)) {
        item->json = NULL;
        return result_ok();
    }
    TRY(check_visit(document, item, node, depth));
    pose->visits[node] = NODE_OPEN;
    TRY(local_transform(document, node, item, &local));
    affine_t transform = affine_multiply(parent, &local);
    pose->worlds[node] = transform;
    if (document->joints_only) return result_ok();
    TRY(hide(document, item));
    if (!document->hidden) TRY(place_mesh(document, item, node, &transform));
    return place_others(document, item, node, &transform);
}

static result_t visit(document_t *document, uint32_t node, const affine_t *parent, int depth)
{
    item_t item;
    bool hidden = document->hidden;
    TRY(enter(document, node, parent, depth, &item));
    if (item.json == NULL) return result_ok();
    TRY(visit_all(document, &item, "children", &document->pose->worlds[node], depth + 1));
    document->pose->visits[node] = NODE_DONE;
    document->hidden = hidden;
    return result_ok();
}

/* All nodes that are no one's child: the scene of a file without scenes. */
static result_t visit_roots(document_t *document)
{
    uint32_t count = (uint32_t)document_count(document, TOP_NODES);
    affine_t identity = affine_identity();
    bool *child = mem_zalloc(count + (size_t)1, sizeof *child);
    for (uint32_t i = 0; i < count; ++i) {
        const json_t *children =
            json_object_get(json_array_get(document->tops[TOP_NODES].json, i), "children");
        for (size_t k = 0; k < json_array_size(children); ++k) {
            json_int_t index = json_integer_value(json_array_get(children, k));
            if (index >= 0 && index < count) child[index] = true;
        }
    }
    result_t result = result_ok();
    for (uint32_t i = 0; i < count && result.code == RESULT_OK; ++i)
        if (!child[i]) result = visit(document, i, &identity, 0);
    free(child);
    return result;
}

static result_t visit_scene(document_t *document)
{
    uint32_t index = 0;
    item_t scene;
    affine_t identity = affine_identity();
    size_t count = document_count(document, TOP_SCENES);
    if (count == 0) return visit_roots(document);
    TRY(item_index(&document->root, "scene", count, &index));
    TRY(document_item(document, TOP_SCENES, index, &scene));
    if (count > 1) item_warn(&scene, "is rendered; the other %zu scenes are left out", count - 1);
    return visit_all(document, &scene, "nodes", &identity, 0);
}

static result_t walk_pose(document_t *document)
{
    size_t nodes = document_count(document, TOP_NODES), skins = document_count(document, TOP_SKINS);
    pose_t *pose = document->pose;
    pose->visits = mem_zalloc(nodes + 1, sizeof *pose->visits);
    pose->worlds = mem_zalloc(nodes + 1, sizeof *pose->worlds);
    pose->skins = mem_zalloc(skins + 1, sizeof *pose->skins);
    document->joints_only = false;
    TRY(visit_scene(document));
    document->joints_only = true;
    return skins > 0 ? visit_roots(document) : result_ok();
}

result_t node_walk(document_t *document)
{
    pose_t *middle = document->pose;
    TRY(walk_pose(document));
    result_t result = result_ok();
    document->builder->report->quiet = true; /* the others say the same */
    for (size_t i = 0; i < document->pose_count && result.code == RESULT_OK; ++i) {
        document->pose = &document->poses[i];
        if (document->pose != middle) result = walk_pose(document);
    }
    document->builder->report->quiet = false;
    document->pose = middle;
    return result;
}

const affine_t *node_world(const document_t *document, uint32_t node)
{
    return document->pose->visits[node] == NODE_DONE ? &document->pose->worlds[node] : NULL;
}
