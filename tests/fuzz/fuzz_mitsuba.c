/* fuzz_mitsuba: any bytes as a Mitsuba scene beside the files of tests/fuzz/assets; or, when they begin like
 * one, as a file of serialized meshes that a scene names. */
#include "tests/fuzz/fuzz.h"

#include <string.h>

int fuzz_mitsuba(const uint8_t *data, size_t size)
{
    static const char holder[] = "<scene version=\"0.6.0\"><shape type=\"serialized\"><string "
                                 "name=\"filename\" value=\"a.serialized\"/>"
                                 "<integer name=\"shapeIndex\" value=\"0\"/></shape></scene>";
    bool mesh = size >= 2 && data[0] == 0x1C && data[1] == 0x04;
    if (mesh) fuzz_write("a.serialized", data, size);
    fuzz_write("scene.xml", mesh ? (const void *)holder : data, mesh ? sizeof holder - 1 : size);
    fuzz_import("scene.xml");
    return 0;
}
