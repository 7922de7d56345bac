/* placement: meshes become shapes of the world, or, where they stand in several places, of an object with
 * instances. Shapes in objects do not emit, so what emits is put into the world at every place. */
#include "client/import/gltf/document.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

typedef enum { PICK_ALL, PICK_DARK, PICK_EMITTING } pick_t;

/* How often a mesh stands in the scene, and what became of it. */
typedef struct {
    uint32_t places;
    bool made, emits;
    uint32_t object; /* in the blob; 0: none, nothing of it is dark */
} mesh_state_t;

static void append(shapes_t *shapes, const blob_shape_t *shape)
{
    shapes->items = grow(shapes->items, &shapes->capacity, shapes->count + 1, sizeof *shapes->items);
    shapes->items[shapes->count++] = *shape;
}

/* A shape of the world gets a light of its own. */
static void add_light(document_t *document, const material_t *material, blob_shape_t *shape)
{
    blob_light_t light = {.kind = LIGHT_AREA,
                          .flags = material->two_sided ? LIGHT_TWO_SIDED : 0,
                          .radiance = material->emission,
                          .shape = (uint32_t)document->world.count,
                          .world_from_light = xform_identity()};
    shape->light = blob_builder_add(document->builder, BLOB_SECTION_LIGHTS, &light, 1);
}

/* A flattened mesh: its normals would have no direction, so it gets flat ones. */
static void flatten(mesh_t *mesh, const affine_t *transform)
{
    for (uint32_t i = 0; i < mesh->vertex_count; ++i)
        mesh->positions[i] = affine_point(transform, mesh->positions[i]);
    free(mesh->normals);
    mesh->normals = NULL;
}

/* Reads a primitive and appends it to the blob; *geometry is BLOB_NONE when there is nothing to see. */
static result_t add_geometry(document_t *document, const item_t *primitive, affine_t transform,
                             uint32_t *geometry, bool *flip)
{
    mesh_t mesh = {0};
    affine_t inverse;
    char name[PATH_ROOM];
    *geometry = BLOB_NONE;
    result_t result = primitive_read(document, primitive, &mesh);
    if (result.code == RESULT_OK && mesh.triangle_count > 0) {
        if (!affine_invert(&transform, &inverse)) {
            flatten(&mesh, &transform);
            transform = affine_identity();
        }
        item_name(primitive, name, sizeof name);
        char *at = mem_printf("%s: %s", document->path, name);
        result = mesh_add(&mesh, &transform, false, (position_t){at, 0, 0}, document->report,
                          document->builder, geometry, flip);
        free(at);
    }
    mesh_free(&mesh);
    return result;
}

static bool is_picked(pick_t pick, const material_t *material)
{
    return pick == PICK_ALL || (pick == PICK_EMITTING) == material->emits;
}

static result_t add_primitive(document_t *document, const item_t *primitive, pick_t pick,
                              const affine_t *transform, uint32_t name, bool *emits)
{
    uint32_t index = ITEM_NONE;
    item_t attributes;
    const material_t *material;
    bool flip = false;
    TRY(document_charge(document, primitive, 1));
    TRY(item_index(primitive, "material", document_count(document, TOP_MATERIALS), &index));
    TRY(item_member(primitive, "attributes", JSON_OBJECT, &attributes));
    TRY(material_get(document, index, json_object_get(attributes.json, "COLOR_0") != NULL, &material));
    *emits = *emits || material->emits;
    bool invisible = material->alpha.texture == 0 && material->alpha.factor.x <= 0;
    if (!is_picked(pick, material) || invisible) return result_ok();
    blob_shape_t shape = {.kind = SHAPE_MESH,
                          .material = material->index,
                          .light = BLOB_NONE,
                          .name = name,
                          .alpha = material->alpha,
                          .shadow_alpha = blob_constant(1)};
    TRY(add_geometry(document, primitive, *transform, &shape.geometry, &flip));
    if (shape.geometry == BLOB_NONE) return result_ok();
    shape.flags = (flip ? SHAPE_FLIP : 0) | (material->cutout ? SHAPE_CUTOUT : 0);
    if (pick != PICK_DARK && material->emits) add_light(document, material, &shape);
    append(pick == PICK_DARK ? &document->objects : &document->world, &shape);
    return result_ok();
}

/* Adds the primitives that are picked; *emits says whether any of all of them does. */
static result_t add_primitives(document_t *document, uint32_t mesh, pick_t pick, const affine_t *transform,
                               uint32_t name, bool *emits)
{
    item_t item, primitives;
    TRY(document_item(document, TOP_MESHES, mesh, &item));
    TRY(item_member(&item, "primitives", JSON_ARRAY, &primitives));
    *emits = false;
    for (size_t i = 0; i < item_count(&primitives); ++i) {
        item_t primitive;
        TRY(item_element(&primitives, i, JSON_OBJECT, &primitive));
        TRY(add_primitive(document, &primitive, pick, transform, name, emits));
    }
    return result_ok();
}

static uint32_t place_name(document_t *document, uint32_t node)
{
    char name[PATH_ROOM];
    node_name(document, node, name, sizeof name);
    return blob_builder_string(document->builder, name);
}

/* The dark parts of a mesh, in its own space, as a new object. */
static result_t make_object(document_t *document, uint32_t mesh, mesh_state_t *state)
{
    char name[PATH_ROOM];
    item_t item;
    affine_t identity = affine_identity();
    size_t first = document->objects.count;
    TRY(document_item(document, TOP_MESHES, mesh, &item));
    item_name(&item, name, sizeof name);
    uint32_t label = blob_builder_string(document->builder, name);
    TRY(add_primitives(document, mesh, PICK_DARK, &identity, label, &state->emits));
    state->made = true;
    if (document->objects.count == first) return result_ok();
    document->object_records = grow(document->object_records, &document->object_capacity,
                                    document->object_count + 1, sizeof *document->object_records);
    document->object_records[document->object_count++] =
        (blob_object_t){(uint32_t)first, (uint32_t)(document->objects.count - first)};
    state->object = (uint32_t)document->object_count;
    return result_ok();
}

static result_t add_place(document_t *document, const placement_t *place, mesh_state_t *state)
{
    bool emits;
    xform_t world_from_node = affine_to_xform(&place->world_from_node);
    if (state->places == 1 || !blob_instance_is_traceable(&world_from_node, &world_from_node))
        return add_primitives(document, place->thing, PICK_ALL, &place->world_from_node,
                              place_name(document, place->node), &emits);
    if (!state->made) TRY(make_object(document, place->thing, state));
    if (state->object != 0) {
        blob_instance_t instance = {state->object, world_from_node, world_from_node};
        blob_builder_add(document->builder, BLOB_SECTION_INSTANCES, &instance, 1);
    }
    if (!state->emits) return result_ok();
    return add_primitives(document, place->thing, PICK_EMITTING, &place->world_from_node,
                          place_name(document, place->node), &emits);
}

/* The world's shapes come first, then those of the objects. */
static void lay_out(document_t *document)
{
    blob_object_t world = {0, (uint32_t)document->world.count};
    blob_builder_add(document->builder, BLOB_SECTION_OBJECTS, &world, 1);
    for (size_t i = 0; i < document->object_count; ++i)
        document->object_records[i].first_shape += world.shape_count;
    if (document->object_count > 0)
        blob_builder_add(document->builder, BLOB_SECTION_OBJECTS, document->object_records,
                         (uint32_t)document->object_count);
    const shapes_t *runs[] = {&document->world, &document->objects};
    for (size_t i = 0; i < ARRAY_LENGTH(runs); ++i)
        if (runs[i]->count > 0)
            blob_builder_add(document->builder, BLOB_SECTION_SHAPES, runs[i]->items,
                             (uint32_t)runs[i]->count);
}

result_t placement_meshes(document_t *document)
{
    mesh_state_t *states = mem_zalloc(document_count(document, TOP_MESHES) + 1, sizeof *states);
    const placements_t *places = &document->meshes;
    for (size_t i = 0; i < places->count; ++i) ++states[places->items[i].thing].places;
    result_t result = result_ok();
    for (size_t i = 0; i < places->count && result.code == RESULT_OK; ++i)
        result = add_place(document, &places->items[i], &states[places->items[i].thing]);
    free(states);
    if (result.code == RESULT_OK && document->world.count + document->objects.count == 0)
        result = item_fail(&document->root, "the scene has no triangle that could be rendered");
    if (result.code == RESULT_OK) lay_out(document);
    return result;
}
