/* fuzz_gltf: any bytes as a glTF file: the JSON of a .gltf beside the files of tests/fuzz/assets, or, when
 * they begin like one, a .glb. What may have animations is imported in the middle of them and blurred, too.
 */
#include "tests/fuzz/fuzz.h"

#include <string.h>

int fuzz_gltf(const uint8_t *data, size_t size)
{
    bool binary = size >= 4 && memcmp(data, "glTF", 4) == 0;
    const char *name = binary ? "scene.glb" : "scene.gltf";
    fuzz_write(name, data, size);
    fuzz_import(name);
    if (memmem(data, size, "\"animations\"", 12)) fuzz_import_at(name, 0.5, "0.5");
    return 0;
}
