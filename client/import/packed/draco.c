/* draco: see draco.h. */
#include "client/import/packed/draco.h"

#include "client/import/packed/draco_shim.h"

#include <string.h>

/* What a decoder may have: the least for any file, and so much more for a byte. Draco packs a triangle into 1
 * to 4 bytes of some hundred, and unpacks a megabyte a second or more. */
static const uint64_t least_memory = (uint64_t)256 << 20, memory_per_byte = 4096,
                      most_memory = (uint64_t)1 << 40;
enum { LEAST_SECONDS = 10, BYTES_PER_SECOND = 1 << 16, MOST_SECONDS = 3600 };

static confined_limits_t limits_for(size_t size)
{
    uint64_t memory = size < most_memory / memory_per_byte ? size * memory_per_byte : most_memory;
    uint64_t seconds = LEAST_SECONDS + size / BYTES_PER_SECOND;
    return (confined_limits_t){least_memory + memory,
                               seconds < MOST_SECONDS ? (unsigned)seconds : MOST_SECONDS};
}

static int unpack_here(const void *context, int output)
{
    return (int)draco_shim_unpack(context, output);
}

static result_t failure_of(int failure)
{
    switch (failure) {
    case DRACO_SHIM_NO_ATTRIBUTE:
        return result_fail(RESULT_INPUT, "its Draco data have no such attribute");
    case DRACO_SHIM_NO_MEMORY:
    case DRACO_SHIM_NOT_WRITTEN:
        return result_fail(RESULT_INPUT,
                           "its Draco data ask for more memory than their size justifies; copy or "
                           "export the file again, or export without Draco compression");
    default:
        return result_fail(RESULT_INPUT,
                           "its Draco data are damaged or no mesh; copy or export the file again, "
                           "or export without Draco compression");
    }
}

/* ---- what came back ------------------------------------------------------------------------------------ */

/* Takes `size` bytes from the front of what is left; NULL when there are not so many. */
static const uint8_t *take(confined_result_t *left, uint64_t size)
{
    if (size > left->size) return NULL;
    const uint8_t *taken = left->data;
    left->data += size;
    left->size -= size;
    return taken;
}

static size_t size_of_type(uint32_t type)
{
    static const uint8_t sizes[] = {1, 1, 2, 2, 0, 4, 4};
    return type >= 5120 && type <= 5126 ? sizes[type - 5120] : 0;
}

/* False when the attribute cannot be: the process that told of it may have been taken over by the bytes. */
static bool take_description(confined_result_t *left, draco_attribute_t *attribute)
{
    draco_shim_attribute_t about;
    const uint8_t *bytes = take(left, sizeof about);
    if (!bytes) return false;
    memcpy(&about, bytes, sizeof about);
    *attribute = (draco_attribute_t){about.components, about.type, about.normalized != 0, NULL};
    return about.components >= 1 && about.components <= 4 && size_of_type(about.type) > 0;
}

bool draco_lay_out(size_t attributes, draco_mesh_t *mesh)
{
    confined_result_t left = mesh->memory;
    uint32_t counts[2];
    const uint8_t *bytes = take(&left, sizeof counts);
    if (!bytes) return false;
    memcpy(counts, bytes, sizeof counts);
    mesh->points = counts[0];
    mesh->triangles = counts[1];
    for (size_t i = 0; i < attributes; ++i)
        if (!take_description(&left, &mesh->attributes[i])) return false;
    /* aligned: all before it are uint32_t, and the memory begins at a page */
    mesh->corners = (const uint32_t *)take(&left, 12 * (uint64_t)mesh->triangles);
    if (!mesh->corners) return false;
    for (size_t i = 0; i < attributes; ++i) {
        draco_attribute_t *attribute = &mesh->attributes[i];
        size_t element = attribute->components * size_of_type(attribute->type);
        attribute->data = take(&left, element * (uint64_t)mesh->points);
        if (!attribute->data) return false;
    }
    return true;
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

result_t draco_unpack(const uint8_t *data, size_t size, const uint32_t *ids, size_t id_count,
                      draco_mesh_t *mesh)
{
    *mesh = (draco_mesh_t){0};
    if (id_count > DRACO_MOST_ATTRIBUTES)
        return result_fail(RESULT_INPUT, "has more than %d attributes", DRACO_MOST_ATTRIBUTES);
    draco_shim_request_t request = {data, size, ids, id_count};
    confined_limits_t limits = limits_for(size);
    result_t result = confined_run(unpack_here, &request, &limits, &mesh->memory);
    if (result.code == RESULT_OK && (mesh->memory.failure != 0 || !draco_lay_out(id_count, mesh)))
        result = failure_of(mesh->memory.failure);
    if (result.code != RESULT_OK) draco_free(mesh);
    return result;
}

void draco_free(draco_mesh_t *mesh)
{
    confined_free(&mesh->memory);
    *mesh = (draco_mesh_t){0};
}
