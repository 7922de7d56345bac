/* fuzz_measured: any bytes as a measured BRDF. One that is accepted makes a blob that passes its
 * checks, and scatters light by finite amounts. */
#include "tests/fuzz/fuzz.h"

#include <stdlib.h>

#include "client/import/files/measured_table.h"
#include "worker/render/bsdf/bsdf.h"

static void check_sample(const lobe_t *lobe, vec3_t wo, vec2_t u)
{
    bsdf_sample_t sample;
    for (int mode = TRANSPORT_RADIANCE; mode <= TRANSPORT_IMPORTANCE; ++mode) {
        if (!lobe->kind->sample(lobe, wo, u, u.x, (transport_t)mode, &sample)) continue;
        fuzz_expect(v_is_finite(sample.wi) && v_is_finite(sample.weight), "a sample that is not finite");
        fuzz_expect(sample.pdf > 0 && isfinite(sample.pdf) && sample.pdf_rev >= 0,
                    "a sample without density");
    }
}

static void scatter(const scene_blob_t *blob)
{
    const blob_measured_t *table = &blob->measurements[0];
    const lobe_t lobe = {
        .kind = &lobe_measured, .chance = 0.5f, .measured = {table, blob->numbers, {1, 1, 1}}};
    static const float places[] = {0, 0.3f, 0.5f, 0.8f, 0x1.fffffep-1f};
    for (size_t i = 0; i < ARRAY_LENGTH(places); ++i)
        for (size_t k = 0; k < ARRAY_LENGTH(places); ++k) {
            float z = 2 * places[i] - 1, r = sqrtf(1 - z * z);
            check_sample(&lobe, vec3(r, 0, z), (vec2_t){places[k], places[(i + k) % ARRAY_LENGTH(places)]});
        }
}

static void check_table(const measured_table_t *table)
{
    blob_builder_t *builder = blob_builder_new();
    blob_scene_t scene = blob_default_scene();
    blob_object_t world = {0, 0};
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    blob_builder_add(builder, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(builder, BLOB_SECTION_OBJECTS, &world, 1);
    measured_table_add(table, builder);
    result_t result = blob_builder_finish(builder, &bytes, &size);
    fuzz_expect(result.code == RESULT_OK, result.message);
    result = blob_open(bytes, size, &blob);
    fuzz_expect(result.code == RESULT_OK, result.message);
    scatter(&blob);
    free(bytes);
    blob_builder_destroy(&builder);
}

int fuzz_measured(const uint8_t *data, size_t size)
{
    measured_table_t table;
    result_t result = measured_table_decode("fuzz.bsdf", data, size, &table);
    if (result.code == RESULT_OK) {
        check_table(&table);
        measured_table_free(&table);
    } else {
        fuzz_expect(result.message[0] != '\0', "an error without text");
    }
    return 0;
}
