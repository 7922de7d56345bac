/* placement: meshes become shapes of the world, or, where they stand in several places, of an object with
 * instances. Shapes in objects do not emit, so what emits is put into the world at every place. */
#include "client/import/gltf/document.h"
#include "client/import/scene/scene_defaults.h"

#include <stdlib.h>
#include <string.h>

typedef enum { PICK_ALL, PICK_DARK, PICK_EMITTING } pick_t;

/* Which primitives of a mesh go where. */
typedef struct {
    pick_t pick;
    uint32_t object, name; /* object: 0 for the world */
    affine_t transform;
    deform_t deform;
    bool changes; /* read it in all poses, and put it where they say; then what follows holds, not `deform` */
    size_t place; /* index in the meshes of a pose */
} target_t;

/* How often a mesh stands in the scene, and what became of it. */
typedef struct {
    uint32_t places;
    bool made, emits;
    uint32_t object; /* in the blob; 0: none, nothing of it is dark */
} mesh_state_t;

/* A flattened mesh: its normals would have no direction, so it gets flat ones. */
static void flatten(mesh_t *mesh, const affine_t *transform)
{
    for (uint32_t i = 0; i < mesh->vertex_count; ++i)
        mesh->positions[i] = affine_point(transform, mesh->positions[i]);
    free(mesh->normals);
    free(mesh->tangents);
    free(mesh->bitangents);
    mesh->normals = mesh->tangents = mesh->bitangents = NULL;
}

/* Reads a primitive and appends it to the blob; the shape's geometry is BLOB_NONE when there is nothing to
 * see. */
static result_t add_geometry(document_t *document, const item_t *primitive, const gltf_material_t *material,
                             const target_t *target, blob_shape_t *shape)
{
    mesh_t mesh = {0};
    affine_t transform = target->transform, inverse;
    bool skinned;
    result_t result = primitive_read(document, primitive, material, &target->deform, &mesh, &skinned);
    if (result.code != RESULT_OK || mesh.triangle_count == 0) {
        mesh_free(&mesh);
        return result;
    }
    if (skinned) transform = affine_identity();
    if (!affine_invert(&transform, &inverse)) {
        flatten(&mesh, &transform);
        transform = affine_identity();
    }
    return mesh_add(document->builder, &mesh, &transform, false, document_at(document, primitive), shape);
}

/* Reads a primitive as it stands in the world in the pose that is looked at. */
static result_t read_pose(document_t *document, const item_t *primitive, const gltf_material_t *material,
                          size_t index, mesh_t *mesh, bool *mirrored)
{
    const gltf_placement_t *place = &document->pose->meshes.items[index];
    const affine_t *world = &place->world_from_node;
    affine_t inverse;
    deform_t deform;
    bool skinned;
    TRY(deform_begin(document, place->thing, place, &deform));
    result_t result = primitive_read(document, primitive, material, &deform, mesh, &skinned);
    deform_end(&deform);
    TRY(result);
    *mirrored = !skinned && affine_determinant(world) < 0;
    if (skinned) return result_ok();
    bool solid = affine_invert(world, &inverse);
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        mesh->positions[i] = affine_point(world, mesh->positions[i]);
        if (mesh->normals)
            mesh->normals[i] = solid ? affine_normal(&inverse, mesh->normals[i]) : vec3(0, 0, 0);
        if (mesh->tangents) mesh->tangents[i] = affine_direction(world, mesh->tangents[i]);
        if (mesh->tangents) mesh->bitangents[i] = affine_direction(world, mesh->bitangents[i]);
    }
    return result_ok();
}

/* The vectors of all poses one behind the other; `more` are those of one of them. */
static vec3_t *keep_step(vec3_t *all, vec3_t *more, uint32_t count, size_t step)
{
    if (!more) return all;
    all = mem_realloc(all, (size_t)count * (step + 1) * sizeof *all);
    memcpy(all + (size_t)count * step, more, (size_t)count * sizeof *all);
    return all;
}

/* What is the same at all times: `from` gets the mesh's. */
static void swap_still(mesh_t *mesh, mesh_t *from)
{
    mesh_t before = *mesh;
    mesh->uvs = from->uvs, from->uvs = before.uvs;
    mesh->uvs2 = from->uvs2, from->uvs2 = before.uvs2;
    mesh->colours = from->colours, from->colours = before.colours;
}

/* Reads a primitive in all poses. Its texture coordinates and colours are those of the middle one. */
static result_t read_poses(document_t *document, const item_t *primitive, const gltf_material_t *material,
                           size_t index, mesh_t *mesh, bool *mirrored)
{
    pose_t *middle = document->pose;
    result_t result = result_ok();
    for (size_t i = 0; i < document->pose_count && result.code == RESULT_OK; ++i) {
        mesh_t now = {0};
        document->pose = &document->poses[i];
        document->builder->report->quiet = document->pose != middle;
        result = read_pose(document, primitive, material, index, &now, mirrored);
        if (result.code == RESULT_OK && now.vertex_count > UINT32_MAX / MOST_POSES)
            result = item_fail(primitive, "has too many vertices for motion blur; leave out --shutter");
        if (i == 0) {
            *mesh = now;
            continue;
        }
        mesh->positions = keep_step(mesh->positions, now.positions, mesh->vertex_count, i);
        mesh->normals = keep_step(mesh->normals, now.normals, mesh->vertex_count, i);
        mesh->tangents = keep_step(mesh->tangents, now.tangents, mesh->vertex_count, i);
        mesh->bitangents = keep_step(mesh->bitangents, now.bitangents, mesh->vertex_count, i);
        if (document->pose == middle) swap_still(mesh, &now);
        mesh_free(&now);
    }
    document->pose = middle;
    document->builder->report->quiet = false;
    mesh->steps = (uint32_t)document->pose_count;
    return result;
}

/* True when a mesh is not the same at all its steps. */
static bool changes(const mesh_t *mesh)
{
    size_t size = mesh->vertex_count * sizeof(vec3_t);
    for (size_t i = 1; i < mesh->steps; ++i) {
        size_t first = i * mesh->vertex_count;
        if (memcmp(mesh->positions, mesh->positions + first, size) != 0) return true;
        if (mesh->normals && memcmp(mesh->normals, mesh->normals + first, size) != 0) return true;
    }
    return false;
}

/* Leaves one of the steps of a mesh, which then stands still. */
static void hold(mesh_t *mesh, size_t step)
{
    vec3_t *all[] = {mesh->positions, mesh->normals, mesh->tangents, mesh->bitangents};
    size_t first = step * mesh->vertex_count, size = mesh->vertex_count * sizeof(vec3_t);
    for (size_t i = 0; i < ARRAY_LENGTH(all); ++i)
        if (all[i]) memmove(all[i], all[i] + first, size);
    mesh->steps = 0;
}

static const char moving_light[] =
    "emits light and moves while the shutter is open; it stands where it is in the middle of that";

/* The same of a primitive that may change while the shutter is open. */
static result_t add_changing(document_t *document, const item_t *primitive, const gltf_material_t *material,
                             const target_t *target, blob_shape_t *shape)
{
    mesh_t mesh = {0};
    bool mirrored = false;
    affine_t identity = affine_identity();
    result_t result = read_poses(document, primitive, material, target->place, &mesh, &mirrored);
    if (result.code != RESULT_OK || mesh.triangle_count == 0) {
        mesh_free(&mesh);
        return result;
    }
    bool moves = changes(&mesh), emits = material->emits;
    if (moves && emits) item_warn(primitive, "%s", moving_light);
    if (!moves || emits) hold(&mesh, mesh.steps / 2);
    TRY(mesh_add(document->builder, &mesh, &identity, false, document_at(document, primitive), shape));
    if (mirrored) shape->flags ^= SHAPE_FLIP;
    return result_ok();
}

/* What a shape of the world emits. */
static blob_light_t light_of(const gltf_material_t *material)
{
    uint32_t sides = material->two_sided ? LIGHT_TWO_SIDED : 0, picture = material->unlit ? LIGHT_PICTURE : 0;
    return (blob_light_t){.kind = LIGHT_AREA,
                          .flags = sides | picture,
                          .radiance = material->emission,
                          .world_from_light = xform_identity()};
}

static bool is_picked(pick_t pick, const gltf_material_t *material)
{
    return pick == PICK_ALL || (pick == PICK_EMITTING) == material->emits;
}

static result_t add_primitive(document_t *document, const item_t *primitive, const target_t *target,
                              bool *emits)
{
    uint32_t index = ITEM_NONE;
    item_t attributes;
    const gltf_material_t *material;
    TRY(document_charge(document, primitive, 1));
    TRY(variant_material(document, primitive, &index));
    TRY(item_member(primitive, "attributes", JSON_OBJECT, &attributes));
    TRY(material_get(document, index, json_object_get(attributes.json, "COLOR_0") != NULL, &material));
    *emits = *emits || material->emits;
    bool invisible = material->alpha.texture == 0 && material->alpha.factor.x <= 0;
    if (!is_picked(target->pick, material) || invisible) return result_ok();
    blob_shape_t shape = {.geometry = BLOB_NONE,
                          .material = material->index,
                          .name = target->name,
                          .alpha = material->alpha,
                          .shadow_alpha = blob_constant(1)};
    TRY(target->changes ? add_changing(document, primitive, material, target, &shape)
                        : add_geometry(document, primitive, material, target, &shape));
    if (shape.geometry == BLOB_NONE) return result_ok();
    if (material->cutout) shape.flags |= SHAPE_CUTOUT;
    blob_light_t light = light_of(material);
    scene_add_shape(document->builder, target->object, shape,
                    target->object == 0 && material->emits ? &light : NULL);
    return result_ok();
}

/* Adds the primitives that are picked; *emits says whether any of all of them does. */
static result_t add_primitives(document_t *document, uint32_t mesh, const target_t *target, bool *emits)
{
    item_t item, primitives;
    TRY(document_item(document, TOP_MESHES, mesh, &item));
    TRY(item_member(&item, "primitives", JSON_ARRAY, &primitives));
    *emits = false;
    for (size_t i = 0; i < item_count(&primitives); ++i) {
        item_t primitive;
        TRY(item_element(&primitives, i, JSON_OBJECT, &primitive));
        TRY(add_primitive(document, &primitive, target, emits));
    }
    return result_ok();
}

/* What shapes are called: as the file calls their node or mesh, or by its place in the file. */
static result_t name_shapes(document_t *document, top_t top, uint32_t index, uint32_t *offset)
{
    item_t item;
    char place[PATH_ROOM];
    const char *given = "";
    TRY(document_item(document, top, index, &item));
    TRY(item_string(&item, "name", &given));
    item_name(&item, place, sizeof place);
    *offset = blob_builder_string(document->builder->blob, given[0] != '\0' ? given : place);
    return result_ok();
}

/* The primitives that are picked, in the world where the node stands. */
static result_t add_to_world(document_t *document, const gltf_placement_t *place, pick_t pick)
{
    bool emits;
    target_t target = {.pick = pick, .transform = place->world_from_node};
    TRY(name_shapes(document, TOP_NODES, place->node, &target.name));
    TRY(deform_begin(document, place->thing, place, &target.deform));
    result_t result = add_primitives(document, place->thing, &target, &emits);
    deform_end(&target.deform);
    return result;
}

/* The dark parts of a mesh, in its own space, as a new object. */
static result_t make_object(document_t *document, uint32_t mesh, mesh_state_t *state)
{
    uint32_t next = (uint32_t)document->builder->object_count;
    target_t target = {.pick = PICK_DARK, .object = next, .transform = affine_identity()};
    TRY(name_shapes(document, TOP_MESHES, mesh, &target.name));
    TRY(deform_begin(document, mesh, NULL, &target.deform));
    result_t result = add_primitives(document, mesh, &target, &state->emits);
    deform_end(&target.deform);
    TRY(result);
    state->made = true;
    if (document->builder->object_count > next) state->object = next;
    return result_ok();
}

/* The same in all poses. */
static result_t add_changing_to_world(document_t *document, const gltf_placement_t *place)
{
    bool emits;
    target_t target = {.changes = true, .place = (size_t)(place - document->pose->meshes.items)};
    TRY(name_shapes(document, TOP_NODES, place->node, &target.name));
    return add_primitives(document, place->thing, &target, &emits);
}

/* An instance of a mesh, which has the name of its node. */
static result_t add_instance(document_t *document, const gltf_placement_t *place, uint32_t object,
                             const affine_t *open, const affine_t *close)
{
    item_t node;
    const char *name = "";
    TRY(scene_add_instance(document->builder, object, open, close, (position_t){document->path, 0, 0}));
    TRY(document_item(document, TOP_NODES, place->node, &node));
    TRY(item_string(&node, "name", &name));
    scene_name_instance(document->builder, name);
    return result_ok();
}

/* An instance that moves from the opening of the shutter to its close. */
static result_t add_moving(document_t *document, const gltf_placement_t *place, const affine_t ends[2],
                           mesh_state_t *state)
{
    item_t mesh;
    if (!state->made) TRY(make_object(document, place->thing, state));
    if (state->object != 0) TRY(add_instance(document, place, state->object, &ends[0], &ends[1]));
    if (!state->emits) return result_ok();
    TRY(document_item(document, TOP_MESHES, place->thing, &mesh));
    item_warn(&mesh, "%s", moving_light);
    return add_to_world(document, place, PICK_EMITTING);
}

/* What stands where a shutter is open. *done: it is in the blob; else it stands still. */
static result_t add_blurred(document_t *document, const gltf_placement_t *place, mesh_state_t *state,
                            bool *done)
{
    size_t index = (size_t)(place - document->pose->meshes.items);
    affine_t ends[2] = {document->poses[0].meshes.items[index].world_from_node,
                        document->poses[document->pose_count - 1].meshes.items[index].world_from_node};
    xform_t open = affine_to_xform(&ends[0]), close = affine_to_xform(&ends[1]);
    *done = place->posed || memcmp(&open, &close, sizeof open) != 0;
    if (!*done) return result_ok();
    bool inverts = (affine_determinant(&ends[0]) < 0) != (affine_determinant(&ends[1]) < 0);
    if (place->posed || inverts || !blob_instance_is_traceable(&open, &close))
        return add_changing_to_world(document, place);
    return add_moving(document, place, ends, state);
}

/* True when a transform leaves nothing of any area: all that it makes of the axes lies on one line. */
static bool is_collapsed(const affine_t *t)
{
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, d = (j + 2) % 3;
            if (t->m[a][c] * t->m[b][d] != t->m[a][d] * t->m[b][c]) return false;
        }
    return true;
}

/* A scale of 0 hides what a node holds, which animations do (the glTF 2.0 specification, section 3.5); but
 * not what a skin puts elsewhere. */
static bool is_hidden(const document_t *document, const gltf_placement_t *place)
{
    size_t index = (size_t)(place - document->pose->meshes.items);
    bool hidden = place->skin == ITEM_NONE;
    for (size_t i = 0; i < document->pose_count && hidden; ++i)
        hidden = is_collapsed(&document->poses[i].meshes.items[index].world_from_node);
    return hidden;
}

static result_t tell_of_hidden(const document_t *document, const gltf_placement_t *place)
{
    item_t node;
    TRY(document_item(document, TOP_NODES, place->node, &node));
    item_warn(&node, "is scaled to nothing, so its mesh is left out");
    return result_ok();
}

static result_t add_place(document_t *document, const gltf_placement_t *place, mesh_state_t *state)
{
    bool done = false;
    if (is_hidden(document, place)) return tell_of_hidden(document, place);
    if (document->pose_count > 1) TRY(add_blurred(document, place, state, &done));
    if (done) return result_ok();
    const affine_t *transform = &place->world_from_node;
    xform_t world_from_node = affine_to_xform(transform);
    if (place->posed || state->places == 1 || !blob_instance_is_traceable(&world_from_node, &world_from_node))
        return add_to_world(document, place, PICK_ALL);
    if (!state->made) TRY(make_object(document, place->thing, state));
    if (state->object != 0) TRY(add_instance(document, place, state->object, transform, transform));
    return state->emits ? add_to_world(document, place, PICK_EMITTING) : result_ok();
}

result_t placement_meshes(document_t *document)
{
    mesh_state_t *states = mem_zalloc(document_count(document, TOP_MESHES) + 1, sizeof *states);
    const placements_t *places = &document->pose->meshes;
    for (size_t i = 0; i < places->count; ++i)
        if (!places->items[i].posed) ++states[places->items[i].thing].places;
    result_t result = result_ok();
    for (size_t i = 0; i < places->count && result.code == RESULT_OK; ++i)
        result = add_place(document, &places->items[i], &states[places->items[i].thing]);
    free(states);
    TRY(result);
    return scene_expect_shapes(document->builder, (position_t){document->path, 0, 0});
}
