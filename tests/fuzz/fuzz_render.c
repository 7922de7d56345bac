/* fuzz_render: any bytes as a scene blob, mended like those of fuzz_blob, and then rendered: a few samples of
 * a few pixels, with wavelengths where it has spectra. Whatever blob_open lets through must neither crash nor
 * hang the renderer. */
#include "tests/fuzz/fuzz.h"

#include <stdlib.h>

#include "worker/render/renderer.h"

static void render(const scene_blob_t *blob)
{
    job_settings_t settings = blob_default_settings(blob);
    settings.width = settings.height = 4;
    settings.spp = 2;
    settings.tile_size = JOB_MIN_TILE;
    settings.max_depth = int_min(settings.max_depth, 5);
    bool is_for_colours = settings.integrator == INTEGRATOR_AO || settings.integrator == INTEGRATOR_VCM;
    settings.spectral = blob->counts[BLOB_SECTION_SPECTRA] > 0 && !is_for_colours;
    result_t result = job_settings_check(&settings);
    fuzz_expect(result.code == RESULT_OK, result.message);
    renderer_t *renderer;
    result = renderer_new(blob, &settings, &renderer);
    if (result.code != RESULT_OK) {
        fuzz_expect(result.message[0] != '\0', "an error without text");
        return;
    }
    unit_result_t pixels = {0};
    unit_t unit = {.tile = 0, .first = 0, .count = settings.spp};
    atomic_bool cancel = false;
    fuzz_expect(renderer_unit(renderer, &unit, &pixels, &cancel), "a unit that was not cancelled gave up");
    unit_result_free(&pixels);
    renderer_destroy(&renderer);
}

int fuzz_render(const uint8_t *data, size_t size)
{
    uint8_t *bytes = fuzz_mend_blob(data, size);
    scene_blob_t blob;
    if (blob_open(bytes, size, &blob).code == RESULT_OK) render(&blob);
    blob_close(&blob);
    free(bytes);
    return 0;
}
