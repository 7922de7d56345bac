/* fuzz_draco: any bytes as a mesh packed by Draco, which a confined process unpacks, and as what such a
 * process may send back once bytes have taken it over: here is a mesh that can be walked, or an error. */
#include "client/import/packed/draco.h"

#include <stdlib.h>
#include <string.h>

#include "tests/fuzz/fuzz.h"

enum { ATTRIBUTES = 2 };

static void walk(const void *data, size_t size)
{
    const uint8_t *bytes = data;
    unsigned sum = 0;
    for (size_t i = 0; i < size; ++i) sum += bytes[i];
    volatile unsigned sink = sum;
    (void)sink;
}

static void walk_mesh(const draco_mesh_t *mesh, size_t attributes)
{
    static const size_t sizes[] = {1, 1, 2, 2, 0, 4, 4};
    walk(mesh->corners, 12 * (size_t)mesh->triangles);
    for (size_t i = 0; i < attributes; ++i) {
        const draco_attribute_t *attribute = &mesh->attributes[i];
        walk(attribute->data, (size_t)mesh->points * attribute->components * sizes[attribute->type - 5120]);
    }
}

static void unpack(const uint8_t *data, size_t size)
{
    static const uint32_t ids[ATTRIBUTES] = {0, 1};
    draco_mesh_t mesh;
    result_t result = draco_unpack(data, size, ids, ATTRIBUTES, &mesh);
    fuzz_expect(result.code == RESULT_OK || result.message[0] != '\0', "an error without text");
    if (result.code != RESULT_OK) return;
    walk_mesh(&mesh, ATTRIBUTES);
    draco_free(&mesh);
}

static void take_back(const uint8_t *data, size_t size)
{
    /* a copy of its own, aligned like a page, so that the address sanitizer sees who reads beyond it */
    uint8_t *copy = mem_alloc(size + (size == 0));
    memcpy(copy, data, size);
    draco_mesh_t mesh = {.memory = {.data = copy, .size = size}};
    if (draco_lay_out(ATTRIBUTES, &mesh)) walk_mesh(&mesh, ATTRIBUTES);
    free(copy);
}

int fuzz_draco(const uint8_t *data, size_t size)
{
    if (size >= 5 && memcmp(data, "DRACO", 5) == 0)
        unpack(data, size);
    else
        take_back(data, size);
    return 0;
}
