/* fuzz_meshopt: mode, filter, stride and count from the first bytes, the rest as what meshoptimizer packed:
 * all of what it should become is there, or an error. */
#include "client/import/packed/meshopt.h"

#include <stdlib.h>
#include <string.h>

#include "tests/fuzz/fuzz.h"

enum { HEADER = 5 };

int fuzz_meshopt(const uint8_t *data, size_t size)
{
    if (size < HEADER) return 0;
    meshopt_layout_t layout = {.mode = (meshopt_mode_t)(data[0] % 3),
                               .filter = (meshopt_filter_t)(data[1] % 4),
                               .stride = data[2],
                               .count = data[3] + 256u * data[4]};
    uint8_t *unpacked = NULL;
    /* a copy of its own, so that the address sanitizer sees who reads beyond it */
    uint8_t *copy = mem_alloc(size - HEADER + 1);
    memcpy(copy, data + HEADER, size - HEADER);
    result_t result = meshopt_unpack(&layout, copy, size - HEADER, &unpacked);
    fuzz_expect(result.code == RESULT_OK || result.message[0] != '\0', "an error without text");
    uint64_t sum = 0;
    for (size_t i = 0; result.code == RESULT_OK && i < layout.count * layout.stride; ++i) sum += unpacked[i];
    volatile uint64_t sink = sum;
    (void)sink;
    free(copy);
    free(unpacked);
    return 0;
}
