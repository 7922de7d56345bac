/* fuzz_obj: any bytes as an OBJ file beside the files of tests/fuzz/assets; what stands behind a line "--" is
 * the library a.mtl. */
#include "tests/fuzz/fuzz.h"

#include <string.h>

int fuzz_obj(const uint8_t *data, size_t size)
{
    static const char mark[] = "\n--\n";
    const uint8_t *cut = memmem(data, size, mark, sizeof mark - 1);
    size_t obj = cut ? (size_t)(cut - data) : size, behind = cut ? obj + sizeof mark - 1 : size;
    fuzz_write("scene.obj", data, obj);
    fuzz_write("a.mtl", data + behind, size - behind);
    fuzz_import("scene.obj");
    return 0;
}
