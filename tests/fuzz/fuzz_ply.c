/* fuzz_ply: any bytes as the PLY file, plain or gzipped, that a scene names. */
#include "tests/fuzz/fuzz.h"

#include <string.h>

int fuzz_ply(const uint8_t *data, size_t size)
{
    static const char scene[] = "WorldBegin\n"
                                "Scale 1 -2 3\n"
                                "AreaLightSource \"diffuse\"\n"
                                "Shape \"plymesh\" \"string filename\" \"mesh.ply\"\n"
                                "WorldEnd\n";
    fuzz_write("mesh.ply", data, size);
    fuzz_write("scene.pbrt", scene, strlen(scene));
    fuzz_import("scene.pbrt");
    return 0;
}
