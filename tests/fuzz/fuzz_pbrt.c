/* fuzz_pbrt: any text as a pbrt scene, beside files that it may name: those of tests/fuzz/assets. */
#include "tests/fuzz/fuzz.h"

int fuzz_pbrt(const uint8_t *data, size_t size)
{
    fuzz_write("scene.pbrt", data, size);
    fuzz_import("scene.pbrt");
    return 0;
}
