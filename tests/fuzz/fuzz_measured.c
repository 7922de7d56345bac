/* fuzz_measured: any bytes as a measured BRDF. One that is accepted makes a blob that passes its
 * checks, and scatters light by finite amounts. */
#include "tests/fuzz/fuzz.h"

#include <stdlib.h>

#include "client/import/files/measured_table.h"

static void check_table(const measured_table_t *table)
{
    scene_blob_t blob;
    uint8_t *bytes;
    blob_builder_t *builder = fuzz_begin_blob();
    measured_table_add(table, builder);
    fuzz_end_blob(&builder, &bytes, &blob);
    const lobe_t lobe = {
        .kind = &lobe_measured,
        .chance = 0.5f,
        .measured = {.table = blob.measurements, .numbers = blob.numbers, .factor = {1, 1, 1}}};
    fuzz_scatter(&lobe);
    free(bytes);
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
