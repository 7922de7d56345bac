/* accessor: arrays of small vectors in buffers (the glTF 2.0 specification, section 3.6.2).
 *
 * Everything is checked when an accessor is opened, so that accessor_get cannot leave the bytes.
 */
#include "client/import/gltf/document.h"

#include <inttypes.h>
#include <string.h>

static const uint64_t most_elements = (uint64_t)1 << 32;
static const uint64_t largest_offset = (uint64_t)1 << 40;

static size_t component_size(component_t type)
{
    switch (type) {
    case COMPONENT_INT8:
    case COMPONENT_UINT8:
        return 1;
    case COMPONENT_INT16:
    case COMPONENT_UINT16:
        return 2;
    case COMPONENT_UINT32:
    case COMPONENT_FLOAT:
        return 4;
    }
    return 0;
}

static result_t read_component(const item_t *item, component_t *type)
{
    uint64_t number = 0;
    TRY(item_whole(item, "componentType", 65535, &number));
    *type = (component_t)number;
    if (component_size(*type) == 0)
        return item_fail(item, "componentType %" PRIu64 " is not one that glTF knows (5120 to 5126)", number);
    return result_ok();
}

static result_t read_type(const item_t *item, size_t *components)
{
    static const struct {
        const char *name;
        size_t components;
    } types[] = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}, {"MAT4", 16}};
    const char *name = "";
    TRY(item_string(item, "type", &name));
    for (size_t i = 0; i < ARRAY_LENGTH(types); ++i) {
        if (strcmp(name, types[i].name) != 0) continue;
        *components = types[i].components;
        return result_ok();
    }
    return item_fail(item, "its type must be SCALAR, VEC2, VEC3, VEC4 or MAT4 here, found \"%.20s\"", name);
}

/* The bytes from the item's byteOffset in the buffer view it names, with room for `count` elements; NULL when
 * it names none. *stride may be NULL: then elements are packed. */
static result_t locate(document_t *document, const item_t *item, size_t count, size_t size, size_t *stride,
                       const uint8_t **data)
{
    uint32_t index = ITEM_NONE;
    uint64_t offset = 0, step = 0;
    TRY(item_index(item, "bufferView", document_count(document, TOP_BUFFER_VIEWS), &index));
    TRY(item_whole(item, "byteOffset", largest_offset, &offset));
    *data = NULL;
    if (index == ITEM_NONE) return result_ok();
    item_t view;
    bytes_t bytes;
    TRY(document_item(document, TOP_BUFFER_VIEWS, index, &view));
    TRY(document_view(document, index, &bytes));
    if (stride) TRY(item_whole(&view, "byteStride", 1 << 16, &step));
    if (step == 0) step = size;
    if (step < size)
        return item_fail(&view, "byteStride %" PRIu64 " is less than the %zu bytes of an element", step,
                         size);
    /* count < 2^32, step <= 2^16 and offset <= 2^40: no overflow */
    if (offset + step * (count - 1) + size > bytes.size)
        return item_fail(item, "%zu elements do not fit into the %zu bytes of buffer view %" PRIu32, count,
                         bytes.size, index);
    *data = bytes.data + offset;
    if (stride) *stride = step;
    return result_ok();
}

static uint32_t whole_at(const uint8_t *data, component_t type)
{
    uint16_t half;
    uint32_t word;
    switch (type) {
    case COMPONENT_UINT8:
        return *data;
    case COMPONENT_UINT16:
        memcpy(&half, data, sizeof half);
        return half;
    default:
        memcpy(&word, data, sizeof word);
        return word;
    }
}

static bool is_unsigned(component_t type)
{
    return type == COMPONENT_UINT8 || type == COMPONENT_UINT16 || type == COMPONENT_UINT32;
}

static result_t check_sparse_indices(const item_t *sparse, const accessor_t *accessor)
{
    size_t size = component_size(accessor->sparse_type);
    for (size_t i = 0; i < accessor->sparse_count; ++i) {
        uint32_t index = whole_at(accessor->sparse_indices + i * size, accessor->sparse_type);
        if (index >= accessor->count)
            return item_fail(sparse, "replaces element %" PRIu32 " of %zu", index, accessor->count);
        if (i > 0 && index <= whole_at(accessor->sparse_indices + (i - 1) * size, accessor->sparse_type))
            return item_fail(sparse, "its indices must ascend");
    }
    return result_ok();
}

static result_t open_sparse(document_t *document, const item_t *item, accessor_t *accessor)
{
    item_t sparse, indices, values;
    TRY(item_member(item, "sparse", JSON_OBJECT, &sparse));
    if (!sparse.json) return result_ok();
    TRY(item_member(&sparse, "indices", JSON_OBJECT, &indices));
    TRY(item_member(&sparse, "values", JSON_OBJECT, &values));
    if (!indices.json || !values.json) return item_fail(&sparse, "needs indices and values");
    uint64_t count = 0;
    TRY(item_whole(&sparse, "count", accessor->count, &count));
    if (count == 0) return item_fail(&sparse, "needs a count above 0");
    TRY(read_component(&indices, &accessor->sparse_type));
    if (!is_unsigned(accessor->sparse_type)) return item_fail(&indices, "must be unsigned integers");
    TRY(locate(document, &indices, count, component_size(accessor->sparse_type), NULL,
               &accessor->sparse_indices));
    TRY(locate(document, &values, count, accessor->components * component_size(accessor->type), NULL,
               &accessor->sparse_values));
    if (!accessor->sparse_indices || !accessor->sparse_values)
        return item_fail(&sparse, "its indices and values need a bufferView each");
    TRY(document_charge(document, &sparse, count));
    accessor->sparse_count = count;
    return check_sparse_indices(&sparse, accessor);
}

result_t accessor_open(document_t *document, uint32_t index, accessor_t *accessor)
{
    item_t item;
    uint64_t count = 0;
    *accessor = (accessor_t){0};
    TRY(document_item(document, TOP_ACCESSORS, index, &item));
    TRY(read_component(&item, &accessor->type));
    TRY(read_type(&item, &accessor->components));
    TRY(item_bool(&item, "normalized", &accessor->normalized));
    TRY(item_whole(&item, "count", most_elements - 2, &count));
    if (count == 0) return item_fail(&item, "needs a count above 0");
    accessor->count = count;
    size_t size = accessor->components * component_size(accessor->type);
    TRY(locate(document, &item, count, size, &accessor->stride, &accessor->data));
    if (!accessor->data) TRY(document_charge(document, &item, count));
    return open_sparse(document, &item, accessor);
}

result_t accessor_of_draco(document_t *document, uint32_t index, const draco_attribute_t *attribute,
                           uint32_t count, accessor_t *accessor)
{
    component_t type = (component_t)attribute->type;
    *accessor = (accessor_t){.count = count,
                             .components = attribute->components,
                             .type = type,
                             .normalized = attribute->normalized,
                             .data = attribute->data,
                             .stride = attribute->components * component_size(type)};
    if (index == ITEM_NONE) return result_ok();
    item_t item;
    component_t said;
    TRY(document_item(document, TOP_ACCESSORS, index, &item));
    TRY(read_component(&item, &said));
    return said == type ? item_bool(&item, "normalized", &accessor->normalized) : result_ok();
}

/* The bytes of an element; NULL: zeroes. */
static const uint8_t *element_at(const accessor_t *accessor, size_t index)
{
    size_t low = 0, high = accessor->sparse_count, size = component_size(accessor->sparse_type);
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        uint32_t at = whole_at(accessor->sparse_indices + middle * size, accessor->sparse_type);
        if (at == index)
            return accessor->sparse_values + middle * accessor->components * component_size(accessor->type);
        if (at < index)
            low = middle + 1;
        else
            high = middle;
    }
    return accessor->data ? accessor->data + index * accessor->stride : NULL;
}

static double component_at(const uint8_t *data, component_t type, bool normalized)
{
    int16_t half;
    float number;
    double value;
    switch (type) {
    case COMPONENT_INT8:
        value = (int8_t)*data;
        return normalized ? fmax(value / 127, -1) : value;
    case COMPONENT_INT16:
        memcpy(&half, data, sizeof half);
        return normalized ? fmax(half / 32767.0, -1) : half;
    case COMPONENT_UINT8:
        return normalized ? *data / 255.0 : *data;
    case COMPONENT_UINT16:
        return whole_at(data, type) / (normalized ? 65535.0 : 1.0);
    case COMPONENT_UINT32:
        return whole_at(data, type);
    case COMPONENT_FLOAT:
        memcpy(&number, data, sizeof number);
        return (double)number;
    }
    return 0;
}

void accessor_get(const accessor_t *accessor, size_t index, double *values)
{
    const uint8_t *element = element_at(accessor, index);
    size_t size = component_size(accessor->type);
    for (size_t i = 0; i < accessor->components; ++i)
        values[i] = element ? component_at(element + i * size, accessor->type, accessor->normalized) : 0;
}

uint32_t accessor_whole(const accessor_t *accessor, size_t index)
{
    const uint8_t *element = element_at(accessor, index);
    return element ? whole_at(element, accessor->type) : 0;
}

bool accessor_is_unsigned(const accessor_t *accessor)
{
    return is_unsigned(accessor->type);
}
