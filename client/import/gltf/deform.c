/* deform: morph targets and skins put the vertices of a mesh elsewhere (the glTF 2.0 specification, sections
 * 3.7.2.2 and 3.7.3): first the targets, each by its weight, then the mean of what the joints do.
 *
 * A joint is a node. What it does to a vertex is its place in the world after the inverse of the place that
 * it had when mesh and joint were bound; where the node of the mesh stands means nothing. So a skinned mesh
 * is in the world as soon as it is read.
 */
#include "client/import/gltf/primitive.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

static const double largest_weight = 1e6;

/* ---- where joints stand -------------------------------------------------------------------------------- */

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
    uint32_t node = 0;
    TRY(item_index_at(joints, i, document_count(document, TOP_NODES), "nodes", &node));
    *world = node_world(document, node);
    if (*world) return result_ok();
    return item_fail(joints, "element %zu, node %" PRIu32 ", hangs from itself, or too deep", i, node);
}

static result_t make_skin(document_t *document, const item_t *item, gltf_skin_t *skin)
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

/* The skin of that index, made when it is asked for first. Valid until document_close. */
static result_t skin_get(document_t *document, uint32_t index, const gltf_skin_t **skin)
{
    gltf_skin_t *known = &document->pose->skins[index];
    item_t item;
    *skin = NULL;
    if (!known->joints) {
        TRY(document_item(document, TOP_SKINS, index, &item));
        result_t result = make_skin(document, &item, known);
        if (result.code != RESULT_OK) {
            free(known->joints);
            known->joints = NULL;
            return result;
        }
    }
    *skin = known;
    return result_ok();
}

/* ---- what deforms a mesh ------------------------------------------------------------------------------- */

/* The property "weights" of a node or of a mesh; *present says whether it is there. */
static result_t read_weights(const item_t *owner, deform_t *deform, bool *present)
{
    item_t list;
    TRY(item_member(owner, "weights", JSON_ARRAY, &list));
    *present = list.json != NULL;
    if (!*present) return result_ok();
    deform->count = item_count(&list);
    deform->weights = mem_zalloc(deform->count + 1, sizeof *deform->weights);
    return item_numbers(owner, "weights", deform->count, -largest_weight, largest_weight, deform->weights,
                        NULL);
}

/* The weights that an animation gives a node now. */
static result_t animated_weights(const document_t *document, uint32_t node, deform_t *deform, bool *present)
{
    size_t count = animation_width(document, node, MOVING_WEIGHTS);
    *present = count > 0;
    if (!*present) return result_ok();
    deform->count = count;
    deform->weights = mem_zalloc(count, sizeof *deform->weights);
    return animation_value(document, node, MOVING_WEIGHTS, document->pose->time, deform->weights);
}

static result_t begin(document_t *document, uint32_t mesh, const gltf_placement_t *place, deform_t *deform)
{
    bool present = false;
    item_t item;
    if (place && place->posed) {
        TRY(document_item(document, TOP_NODES, place->node, &item));
        TRY(animated_weights(document, place->node, deform, &present));
        if (!present) TRY(read_weights(&item, deform, &present));
        if (place->skin != ITEM_NONE)
            TRY(report_excuse(document->builder->report, skin_get(document, place->skin, &deform->skin),
                              "the mesh is rendered in its rest pose"));
    }
    if (present) return result_ok();
    TRY(document_item(document, TOP_MESHES, mesh, &item));
    return read_weights(&item, deform, &present);
}

result_t deform_begin(document_t *document, uint32_t mesh, const gltf_placement_t *place, deform_t *deform)
{
    *deform = (deform_t){0};
    result_t result = begin(document, mesh, place, deform);
    if (result.code != RESULT_OK) deform_end(deform);
    return result;
}

void deform_end(deform_t *deform)
{
    free(deform->weights);
    *deform = (deform_t){0};
}

/* ---- morph targets ------------------------------------------------------------------------------------- */

/* Adds what a target says of an attribute to the `width` numbers that each vertex has of it; `to` NULL: the
 * mesh has none. A width of 2 are texture coordinates, whose v is turned over; of 4 colours, whose alpha a
 * target may leave out. */
static result_t add_deltas(reader_t *r, const item_t *target, const char *name, double weight, float *to,
                           size_t width)
{
    accessor_t deltas;
    bool present;
    TRY(reader_open(r, target, name, width == 4 ? 3 : width, width, &deltas, &present));
    if (!present || !to) return result_ok();
    TRY(document_charge(r->document, r->item, r->mesh->vertex_count));
    for (uint32_t i = 0; i < r->mesh->vertex_count; ++i) {
        double delta[4];
        accessor_get(&deltas, r->used[i], delta);
        if (width == 2) delta[1] = -delta[1];
        for (size_t k = 0; k < deltas.components; ++k)
            to[width * i + k] = (float)(to[width * i + k] + weight * delta[k]);
    }
    return result_ok();
}

static result_t add_target(reader_t *r, const item_t *target, double weight)
{
    mesh_t *mesh = r->mesh;
    TRY(add_deltas(r, target, "POSITION", weight, (float *)mesh->positions, 3));
    TRY(add_deltas(r, target, "NORMAL", weight, (float *)mesh->normals, 3));
    TRY(add_deltas(r, target, "TANGENT", weight, (float *)mesh->tangents, 3));
    TRY(add_deltas(r, target, "TEXCOORD_0", weight, (float *)mesh->uvs, 2));
    TRY(add_deltas(r, target, "TEXCOORD_1", weight, (float *)mesh->uvs2, 2));
    return add_deltas(r, target, "COLOR_0", weight, (float *)mesh->colours, 4);
}

result_t deform_morph(reader_t *r, const deform_t *deform)
{
    item_t targets, target;
    TRY(item_member(r->item, "targets", JSON_ARRAY, &targets));
    for (size_t i = 0; i < item_count(&targets) && i < deform->count; ++i) {
        if (deform->weights[i] == 0) continue;
        TRY(item_element(&targets, i, JSON_OBJECT, &target));
        TRY(add_target(r, &target, deform->weights[i]));
    }
    return result_ok();
}

/* ---- skins --------------------------------------------------------------------------------------------- */

/* Four joints of each vertex, and how much of each it takes. */
typedef struct {
    accessor_t joints, weights;
} influences_t;

/* A primitive while its skin is laid on. Owned: sets. */
typedef struct {
    reader_t *r;
    const gltf_skin_t *skin;
    influences_t *sets;
    size_t count, capacity;
    uint32_t loose;    /* vertices without a weight */
    uint32_t mirrored; /* vertices that are turned inside out */
} binding_t;

/* Opens JOINTS_0 and WEIGHTS_0, then JOINTS_1 and so on, as long as there are both. */
static result_t open_sets(binding_t *b)
{
    reader_t *r = b->r;
    for (bool both = true; both;) {
        char joints[32], weights[32];
        bool weighted;
        influences_t set;
        snprintf(joints, sizeof joints, "JOINTS_%zu", b->count);
        snprintf(weights, sizeof weights, "WEIGHTS_%zu", b->count);
        TRY(reader_open(r, &r->attributes, joints, 4, 4, &set.joints, &both));
        TRY(reader_open(r, &r->attributes, weights, 4, 4, &set.weights, &weighted));
        both = both && weighted;
        if (!both) continue;
        if (!accessor_is_unsigned(&set.joints) || set.joints.normalized)
            return item_fail(&r->attributes, "%s must be unsigned integers", joints);
        TRY(document_charge(r->document, r->item, 2 * (uint64_t)r->mesh->vertex_count));
        b->sets = grow(b->sets, &b->capacity, b->count + 1, sizeof *b->sets);
        b->sets[b->count++] = set;
    }
    return result_ok();
}

static void add_share(affine_t *sum, const affine_t *joint, double weight)
{
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 4; ++j) sum->m[i][j] += weight * joint->m[i][j];
}

static result_t check_joint(const binding_t *b, uint32_t vertex, double joint)
{
    if (joint < (double)b->skin->count) return result_ok();
    return item_fail(&b->r->attributes,
                     "vertex %" PRIu32 " follows joint %.0f, but its skin has %zu, counted from 0", vertex,
                     joint, b->skin->count);
}

/* Adds what the joints of a set do to a vertex, and their weights; those that are not above 0, or not finite,
 * count as 0. */
static result_t add_set(const binding_t *b, size_t set, uint32_t vertex, affine_t *sum, double *total)
{
    double joints[4], weights[4];
    accessor_get(&b->sets[set].joints, vertex, joints);
    accessor_get(&b->sets[set].weights, vertex, weights);
    for (int k = 0; k < 4; ++k) {
        if (!(weights[k] > 0) || !isfinite(weights[k])) continue;
        TRY(check_joint(b, vertex, joints[k]));
        add_share(sum, &b->skin->joints[(size_t)joints[k]], weights[k]);
        *total += weights[k];
    }
    return result_ok();
}

/* What the skin does to a vertex. One that has no weights follows the first joint that it names. */
static result_t blend(binding_t *b, uint32_t vertex, affine_t *out)
{
    double total = 0, joints[4];
    *out = (affine_t){0};
    for (size_t set = 0; set < b->count; ++set) TRY(add_set(b, set, vertex, out, &total));
    for (int i = 0; i < 3 && total > 0; ++i)
        for (int j = 0; j < 4; ++j) out->m[i][j] /= total;
    if (total > 0) return result_ok();
    ++b->loose;
    accessor_get(&b->sets[0].joints, vertex, joints);
    TRY(check_joint(b, vertex, joints[0]));
    *out = b->skin->joints[(size_t)joints[0]];
    return result_ok();
}

/* A normal without direction is left for mesh_add to mend. */
static vec3_t turned(const affine_t *transform, vec3_t normal)
{
    affine_t inverse;
    return affine_invert(transform, &inverse) ? affine_normal(&inverse, normal) : vec3(0, 0, 0);
}

static result_t move_vertices(binding_t *b)
{
    mesh_t *mesh = b->r->mesh;
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        affine_t transform;
        TRY(blend(b, b->r->used[i], &transform));
        mesh->positions[i] = affine_point(&transform, mesh->positions[i]);
        if (mesh->normals) mesh->normals[i] = turned(&transform, mesh->normals[i]);
        if (mesh->tangents) mesh->tangents[i] = affine_direction(&transform, mesh->tangents[i]);
        if (mesh->tangents) mesh->bitangents[i] = affine_direction(&transform, mesh->bitangents[i]);
        b->mirrored += affine_determinant(&transform) < 0;
    }
    return result_ok();
}

/* What stands for a transform that mirrors, which mesh_add would see: the triangles wind the other way. */
static void turn_over(mesh_t *mesh)
{
    for (uint32_t i = 0; i < mesh->triangle_count; ++i) {
        uint32_t *v = mesh->triangles[i].v, second = v[1];
        v[1] = v[2];
        v[2] = second;
    }
}

static result_t lay_skin(binding_t *b, bool *skinned)
{
    TRY(open_sets(b));
    *skinned = b->count > 0;
    if (!*skinned) {
        item_warn(b->r->item, "has no JOINTS_0 and WEIGHTS_0: the skin does not move it");
        return result_ok();
    }
    TRY(move_vertices(b));
    if (b->mirrored > b->r->mesh->vertex_count / 2) turn_over(b->r->mesh);
    if (b->loose > 0)
        item_warn(b->r->item,
                  "%" PRIu32 " of %" PRIu32 " vertices have no weight above 0; they follow the first "
                  "joint that they name",
                  b->loose, b->r->mesh->vertex_count);
    return result_ok();
}

result_t deform_skin(reader_t *r, const deform_t *deform, bool *skinned)
{
    if (!deform->skin) return result_ok();
    binding_t binding = {.r = r, .skin = deform->skin};
    result_t result = lay_skin(&binding, skinned);
    free(binding.sets);
    return result;
}
