/* primitive: the vertices and triangles of one primitive of a mesh.
 *
 * Exporters let the primitives of a mesh share one set of vertices, so only the vertices that a primitive's
 * triangles use are decoded, in the order in which they first appear; the work then follows the indices, not
 * the shared arrays. A primitive that is packed by Draco has its vertices and triangles in there instead.
 */
#include "client/import/gltf/primitive.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

typedef enum { MODE_TRIANGLES = 4, MODE_STRIP = 5, MODE_FAN = 6 } topology_t;

/* ---- attributes ---------------------------------------------------------------------------------------- */

/* Opens an attribute, packed or not; *present says whether it is there. Those of morph targets are not
 * packed.
 */
static result_t find_attribute(reader_t *r, const item_t *attributes, const char *name, uint32_t *index,
                               accessor_t *accessor, bool *present)
{
    *index = ITEM_NONE;
    TRY(item_index(attributes, name, document_count(r->document, TOP_ACCESSORS), index));
    const draco_attribute_t *packed = attributes == &r->attributes ? unpack_find(&r->packed, name) : NULL;
    *present = packed || *index != ITEM_NONE;
    if (packed) return accessor_of_draco(r->document, *index, packed, r->packed.mesh.points, accessor);
    return *present ? accessor_open(r->document, *index, accessor) : result_ok();
}

result_t reader_open(reader_t *r, const item_t *attributes, const char *name, size_t least, size_t most,
                     accessor_t *accessor, bool *present)
{
    uint32_t index;
    TRY(find_attribute(r, attributes, name, &index, accessor, present));
    if (!*present) return result_ok();
    if (accessor->components < least || accessor->components > most)
        return item_fail(attributes, "accessor %" PRIu32 " has the wrong number of components for %s", index,
                         name);
    if (accessor->count < r->position.count)
        return item_fail(attributes, "%s has %zu elements for %zu vertices", name, accessor->count,
                         r->position.count);
    return result_ok();
}

static result_t open_positions(reader_t *r)
{
    uint32_t index;
    bool present;
    TRY(find_attribute(r, &r->attributes, "POSITION", &index, &r->position, &present));
    if (!present) return item_fail(r->item, "has no POSITION; the mesh is unusable");
    if (r->position.components != 3)
        return item_fail(&r->attributes, "accessor %" PRIu32 " must be a VEC3 to be a POSITION", index);
    return result_ok();
}

static vec3_t *read_vec3(const reader_t *r, const accessor_t *accessor)
{
    uint32_t count = r->mesh->vertex_count;
    vec3_t *out = mem_alloc(count * sizeof *out);
    for (uint32_t i = 0; i < count; ++i) {
        double v[4];
        accessor_get(accessor, r->used[i], v);
        out[i] = vec3((float)v[0], (float)v[1], (float)v[2]);
    }
    return out;
}

static result_t read_uvs(reader_t *r, const char *name, vec2_t **out)
{
    accessor_t accessor;
    bool present;
    TRY(reader_open(r, &r->attributes, name, 2, 2, &accessor, &present));
    if (!present) return result_ok();
    uint32_t count = r->mesh->vertex_count;
    *out = mem_alloc(count * sizeof **out);
    for (uint32_t i = 0; i < count; ++i) {
        double v[4];
        accessor_get(&accessor, r->used[i], v);
        (*out)[i] = (vec2_t){(float)v[0], (float)(1 - v[1])};
    }
    return result_ok();
}

/* On a mesh without texture coordinates images show one texel, as if all were (0, 0). */
static void fill_uvs(mesh_t *mesh)
{
    mesh->uvs = mem_alloc(mesh->vertex_count * sizeof *mesh->uvs);
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) mesh->uvs[i] = (vec2_t){0, 1};
}

static result_t read_normals(reader_t *r)
{
    accessor_t accessor;
    bool present;
    TRY(reader_open(r, &r->attributes, "NORMAL", 3, 3, &accessor, &present));
    if (present) r->mesh->normals = read_vec3(r, &accessor);
    return result_ok();
}

/* TANGENT means nothing without NORMAL. */
static result_t read_tangents(reader_t *r)
{
    bool present;
    if (!r->mesh->normals) return result_ok();
    TRY(reader_open(r, &r->attributes, "TANGENT", 4, 4, &r->tangent, &present));
    if (!present) return result_ok();
    TRY(document_charge(r->document, r->item, r->mesh->vertex_count));
    r->mesh->tangents = read_vec3(r, &r->tangent);
    return result_ok();
}

/* The bitangents, of normals and tangents that morph targets have moved: the cross product of the two, turned
 * over where TANGENT's fourth number is negative. */
static void add_bitangents(reader_t *r)
{
    mesh_t *mesh = r->mesh;
    if (!mesh->tangents) return;
    mesh->bitangents = mem_alloc(mesh->vertex_count * sizeof *mesh->bitangents);
    for (uint32_t i = 0; i < mesh->vertex_count; ++i) {
        double v[4];
        accessor_get(&r->tangent, r->used[i], v);
        vec3_t across = v_cross(mesh->normals[i], mesh->tangents[i]);
        mesh->bitangents[i] = v[3] < 0 ? v_neg(across) : across;
    }
}

/* Where a mesh has but one set, that one stands for both. */
static void swap_sets(mesh_t *mesh)
{
    vec2_t *first = mesh->uvs;
    if (!mesh->uvs2) return;
    mesh->uvs = mesh->uvs2;
    mesh->uvs2 = first;
}

static result_t read_colours(reader_t *r)
{
    accessor_t accessor;
    bool present;
    TRY(reader_open(r, &r->attributes, "COLOR_0", 3, 4, &accessor, &present));
    if (!present) return result_ok();
    uint32_t count = r->mesh->vertex_count;
    r->mesh->colours = mem_alloc(count * sizeof *r->mesh->colours);
    for (uint32_t i = 0; i < count; ++i) {
        double c[4] = {1, 1, 1, 1};
        accessor_get(&accessor, r->used[i], c);
        r->mesh->colours[i] = (blob_colour_t){(float)c[0], (float)c[1], (float)c[2], (float)c[3]};
    }
    return result_ok();
}

/* Colours are factors between 0 and 1, also where morph targets have changed them. A NaN stays, for mesh_add
 * to find. */
static void limit_colours(mesh_t *mesh)
{
    float *c = (float *)mesh->colours;
    for (size_t i = 0; c && i < 4 * (size_t)mesh->vertex_count; ++i)
        c[i] = c[i] < 0 ? 0 : c[i] > 1 ? 1 : c[i];
}

/* ---- triangles ----------------------------------------------------------------------------------------- */

static result_t open_indices(reader_t *r, size_t *corners)
{
    uint32_t index = ITEM_NONE;
    if (r->packed.present) {
        *corners = 3 * (size_t)r->packed.mesh.triangles;
        return result_ok();
    }
    TRY(item_index(r->item, "indices", document_count(r->document, TOP_ACCESSORS), &index));
    r->indexed = index != ITEM_NONE;
    *corners = r->position.count;
    if (!r->indexed) return result_ok();
    TRY(accessor_open(r->document, index, &r->indices));
    if (r->indices.components != 1 || !accessor_is_unsigned(&r->indices))
        return item_fail(r->item, "its indices (accessor %" PRIu32 ") must be unsigned integers", index);
    *corners = r->indices.count;
    return result_ok();
}

/* The vertex at one corner of the run, under its new number. */
static result_t corner(reader_t *r, size_t at, uint32_t *number)
{
    uint32_t vertex = r->packed.present ? r->packed.mesh.corners[at]
                      : r->indexed      ? accessor_whole(&r->indices, at)
                                        : (uint32_t)at;
    if (vertex >= r->position.count)
        return item_fail(r->item, "index %zu is vertex %" PRIu32 ", but there are %zu, counted from 0", at,
                         vertex, r->position.count);
    mark_t *mark = &r->document->marks[vertex];
    if (mark->stamp != r->document->stamp) {
        *mark = (mark_t){r->document->stamp, r->mesh->vertex_count++};
        r->used = grow(r->used, &r->used_capacity, r->mesh->vertex_count, sizeof *r->used);
        r->used[mark->number] = vertex;
    }
    *number = mark->number;
    return result_ok();
}

/* Where in the run the corners of the i-th triangle are (the glTF 2.0 specification, section 3.7.2.1). */
static void corners_of(uint64_t mode, size_t i, size_t at[3])
{
    switch ((topology_t)mode) {
    case MODE_TRIANGLES:
        for (size_t k = 0; k < 3; ++k) at[k] = 3 * i + k;
        break;
    case MODE_STRIP:
        at[0] = i;
        at[1] = i + 1 + i % 2;
        at[2] = i + 2 - i % 2;
        break;
    case MODE_FAN:
        at[0] = i + 1;
        at[1] = i + 2;
        at[2] = 0;
        break;
    }
}

static bool repeats(const blob_triangle_t *t)
{
    return t->v[0] == t->v[1] || t->v[1] == t->v[2] || t->v[2] == t->v[0];
}

/* Makes room for marks of all vertices, none of them set. */
static void begin_marks(document_t *d, size_t vertices)
{
    if (vertices > d->mark_capacity) {
        size_t before = d->mark_capacity;
        d->marks = grow(d->marks, &d->mark_capacity, vertices, sizeof *d->marks);
        memset(d->marks + before, 0, (d->mark_capacity - before) * sizeof *d->marks);
    }
    ++d->stamp;
}

static result_t read_triangles(reader_t *r)
{
    size_t corners;
    TRY(open_indices(r, &corners));
    TRY(document_charge(r->document, r->item, corners));
    bool list = r->mode == MODE_TRIANGLES;
    size_t count = list ? corners / 3 : corners < 3 ? 0 : corners - 2;
    if (count == 0 || (list && corners % 3 != 0))
        item_warn(r->item, "%zu corners do not make whole triangles; the rest is left out", corners);
    if (count == 0) return result_ok();
    begin_marks(r->document, r->position.count);
    r->mesh->triangles = mem_alloc(count * sizeof *r->mesh->triangles);
    for (size_t i = 0; i < count; ++i) {
        size_t at[3] = {0};
        blob_triangle_t triangle;
        corners_of(r->mode, i, at);
        for (int k = 0; k < 3; ++k) TRY(corner(r, at[k], &triangle.v[k]));
        if (list || !repeats(&triangle)) r->mesh->triangles[r->mesh->triangle_count++] = triangle;
    }
    return result_ok();
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

static result_t read_all(reader_t *r, const gltf_material_t *material, const deform_t *deform, bool *skinned)
{
    TRY(unpack_primitive(r->document, r->item, &r->packed));
    if (r->packed.present) r->mode = MODE_TRIANGLES; /* whatever it was before it was packed */
    TRY(open_positions(r));
    TRY(read_triangles(r));
    if (r->mesh->triangle_count == 0) return result_ok();
    TRY(document_charge(r->document, r->item, r->mesh->vertex_count));
    r->mesh->positions = read_vec3(r, &r->position);
    TRY(read_normals(r));
    if (material->needs_tangents) TRY(read_tangents(r));
    TRY(read_uvs(r, "TEXCOORD_0", &r->mesh->uvs));
    TRY(read_uvs(r, "TEXCOORD_1", &r->mesh->uvs2));
    TRY(read_colours(r));
    TRY(deform_morph(r, deform));
    if (material->has_images && !r->mesh->uvs) fill_uvs(r->mesh);
    if (material->swaps_sets) swap_sets(r->mesh);
    limit_colours(r->mesh);
    add_bitangents(r);
    return deform_skin(r, deform, skinned);
}

result_t primitive_read(document_t *document, const item_t *primitive, const gltf_material_t *material,
                        const deform_t *deform, mesh_t *mesh, bool *skinned)
{
    reader_t r = {.document = document, .item = primitive, .mode = MODE_TRIANGLES, .mesh = mesh};
    *skinned = false;
    TRY(item_whole(primitive, "mode", MODE_FAN, &r.mode));
    TRY(item_member(primitive, "attributes", JSON_OBJECT, &r.attributes));
    if (!r.attributes.json) return item_fail(primitive, "has no attributes");
    if (r.mode < MODE_TRIANGLES) {
        item_warn(primitive, "points and lines have no surface and are left out");
        return result_ok();
    }
    result_t result = read_all(&r, material, deform, skinned);
    draco_free(&r.packed.mesh);
    free(r.used);
    return result;
}
