/* unpack: what the extensions for packed files hold: EXT_meshopt_compression, KHR_meshopt_compression, whose
 * newer bit streams are not read, and KHR_draco_mesh_compression. */
#include "client/import/gltf/document.h"

#include "client/import/packed/meshopt.h"

#include <string.h>

/* ---- meshopt ------------------------------------------------------------------------------------------- */

/* The number of the name that a property has, `given` when it is absent. */
static result_t read_name(const item_t *object, const char *key, const char *const *names, size_t count,
                          int given, int *number)
{
    const char *name = NULL;
    *number = given;
    TRY(item_string(object, key, &name));
    if (!name && given >= 0) return result_ok();
    for (size_t i = 0; name && i < count; ++i) {
        *number = (int)i;
        if (strcmp(name, names[i]) == 0) return result_ok();
    }
    return item_fail(object, "its %s \"%.20s\" is not one that EXT_meshopt_compression knows", key,
                     name ? name : "");
}

static result_t read_layout(const item_t *packed, meshopt_layout_t *layout)
{
    static const char *const modes[] = {"ATTRIBUTES", "TRIANGLES", "INDICES"};
    static const char *const filters[] = {"NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"};
    int mode, filter;
    TRY(read_name(packed, "mode", modes, ARRAY_LENGTH(modes), -1, &mode));
    TRY(read_name(packed, "filter", filters, ARRAY_LENGTH(filters), MESHOPT_NONE, &filter));
    *layout = (meshopt_layout_t){.mode = (meshopt_mode_t)mode, .filter = (meshopt_filter_t)filter};
    TRY(item_whole(packed, "count", UINT32_MAX, &layout->count));
    return item_whole(packed, "byteStride", 1 << 16, &layout->stride);
}

static result_t unpack(document_t *document, const item_t *packed, bytes_t *bytes)
{
    meshopt_layout_t layout;
    bytes_t from;
    uint8_t *data;
    TRY(document_range(document, packed, &from));
    TRY(read_layout(packed, &layout));
    result_t result = meshopt_check(&layout, from.size);
    if (result.code != RESULT_OK) return item_fail(packed, "%s", result.message);
    /* many views may name the same bytes */
    TRY(document_charge(document, packed, layout.count * layout.stride / 16 + 1));
    result = meshopt_unpack(&layout, from.data, from.size, &data);
    if (result.code != RESULT_OK) return item_fail(packed, "%s", result.message);
    *bytes = (bytes_t){data, layout.count * layout.stride};
    return result_ok();
}

result_t unpack_view(document_t *document, uint32_t index, const item_t *packed, bytes_t *bytes)
{
    bytes_t *known = &document->unpacked[index];
    if (!known->data) TRY(unpack(document, packed, known));
    *bytes = *known;
    return result_ok();
}

/* ---- Draco --------------------------------------------------------------------------------------------- */

/* Which attributes there are, by name. */
static result_t read_ids(const item_t *packed, unpacked_t *unpacked)
{
    item_t attributes;
    TRY(item_member(packed, "attributes", JSON_OBJECT, &attributes));
    if (json_object_size(attributes.json) > DRACO_MOST_ATTRIBUTES)
        return item_fail(&attributes, "has more than %d attributes", DRACO_MOST_ATTRIBUTES);
    const char *name;
    json_t *value;
    json_object_foreach((json_t *)(uintptr_t)attributes.json, name, value)
    {
        uint64_t id = 0;
        TRY(item_whole(&attributes, name, UINT32_MAX, &id));
        unpacked->names[unpacked->count] = name;
        unpacked->ids[unpacked->count++] = (uint32_t)id;
    }
    return result_ok();
}

result_t unpack_primitive(document_t *document, const item_t *primitive, unpacked_t *unpacked)
{
    item_t packed;
    uint32_t view = ITEM_NONE;
    bytes_t bytes;
    *unpacked = (unpacked_t){0};
    TRY(item_extension(primitive, "KHR_draco_mesh_compression", &packed));
    if (!packed.json) return result_ok();
    TRY(item_index(&packed, "bufferView", document_count(document, TOP_BUFFER_VIEWS), &view));
    if (view == ITEM_NONE) return item_fail(&packed, "names no bufferView");
    TRY(document_view(document, view, &bytes));
    TRY(read_ids(&packed, unpacked));
    TRY(document_charge(document, &packed, bytes.size)); /* many primitives may name the same bytes */
    result_t result = draco_unpack(bytes.data, bytes.size, unpacked->ids, unpacked->count, &unpacked->mesh);
    if (result.code == RESULT_INPUT) return item_fail(&packed, "%s", result.message);
    unpacked->present = result.code == RESULT_OK;
    return result;
}

const draco_attribute_t *unpack_find(const unpacked_t *unpacked, const char *name)
{
    for (size_t i = 0; unpacked->present && i < unpacked->count; ++i)
        if (strcmp(unpacked->names[i], name) == 0) return &unpacked->mesh.attributes[i];
    return NULL;
}
