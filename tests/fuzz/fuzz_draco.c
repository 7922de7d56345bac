/* fuzz_draco: any bytes as a mesh packed by Draco, which a confined process unpacks: whatever becomes of that
 * process, here is a mesh that can be walked, or an error. */
#include "client/import/packed/draco.h"

#include <string.h>

#include "tests/fuzz/fuzz.h"

static void walk(const void *data, size_t size)
{
    const uint8_t *bytes = data;
    unsigned sum = 0;
    for (size_t i = 0; i < size; ++i) sum += bytes[i];
    volatile unsigned sink = sum;
    (void)sink;
}

int fuzz_draco(const uint8_t *data, size_t size)
{
    static const uint32_t ids[] = {0, 1};
    static const size_t sizes[] = {1, 1, 2, 2, 0, 4, 4};
    draco_mesh_t mesh;
    size_t count = size % 3; /* also of no attribute */
    result_t result = draco_unpack(data, size, ids, count, &mesh);
    fuzz_expect(result.code == RESULT_OK || result.message[0] != '\0', "an error without text");
    if (result.code != RESULT_OK) return 0;
    walk(mesh.corners, 12 * (size_t)mesh.triangles);
    for (size_t i = 0; i < count; ++i)
        walk(mesh.attributes[i].data,
             mesh.points * mesh.attributes[i].components * sizes[mesh.attributes[i].type - 5120]);
    draco_free(&mesh);
    return 0;
}
