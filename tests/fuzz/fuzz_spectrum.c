/* fuzz_spectrum: any text as a file of wavelengths and values. A spectrum that is accepted has finite colours
 * without negative components. */
#include "tests/fuzz/fuzz.h"

#include "client/import/files/spectrum.h"

static void check_colours(const spectrum_t *spectrum)
{
    for (int use = SPECTRUM_REFLECTANCE; use <= SPECTRUM_INDEX; ++use)
        for (int rules = SPECTRUM_PBRT_V3; rules <= SPECTRUM_PBRT_V4; ++rules) {
            rgb_t c = spectrum_colour(spectrum, (spectrum_use_t)use, (spectrum_rules_t)rules);
            fuzz_expect(v_is_finite(c) && c.x >= 0 && c.y >= 0 && c.z >= 0, "the colour of a spectrum");
        }
}

int fuzz_spectrum(const uint8_t *data, size_t size)
{
    spectrum_t spectrum;
    fuzz_write("fuzz.spd", data, size);
    result_t result = spectrum_read(fuzz_path("fuzz.spd"), &spectrum);
    if (result.code == RESULT_OK) {
        fuzz_expect(spectrum.count > 0, "a spectrum without samples");
        for (size_t i = 1; i < spectrum.count; ++i)
            fuzz_expect(spectrum.lambda[i - 1] < spectrum.lambda[i], "wavelengths do not ascend");
        fuzz_expect(isfinite(spectrum_at(&spectrum, SPECTRUM_D_LINE)), "a value that is not finite");
        check_colours(&spectrum);
    } else {
        fuzz_expect(result.message[0] != '\0' && !spectrum.lambda && !spectrum.value, "an error's leftovers");
    }
    spectrum_free(&spectrum);
    return 0;
}
