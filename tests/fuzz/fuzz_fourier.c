/* fuzz_fourier: any bytes as a table of Fourier series. One that is accepted makes a blob that passes its
 * checks, and scatters light by finite amounts. */
#include "tests/fuzz/fuzz.h"

#include <stdlib.h>

#include "client/import/files/fourier_table.h"

static void check_table(const fourier_table_t *table)
{
    scene_blob_t blob;
    uint8_t *bytes;
    blob_builder_t *builder = fuzz_begin_blob();
    fourier_table_add(table, builder);
    fuzz_end_blob(&builder, &bytes, &blob);
    const blob_fourier_t *record = &blob.fouriers[0];
    const lobe_t lobe = {.kind = &lobe_fourier,
                         .chance = 0.5f,
                         .fourier = {.table = record,
                                     .series = blob.series + record->first_series,
                                     .numbers = blob.numbers,
                                     .factor = {1, 1, 1}}};
    fuzz_scatter(&lobe);
    free(bytes);
}

int fuzz_fourier(const uint8_t *data, size_t size)
{
    fourier_table_t table;
    result_t result = fourier_table_decode("fuzz.bsdf", data, size, &table);
    if (result.code == RESULT_OK) {
        check_table(&table);
        fourier_table_free(&table);
    } else {
        fuzz_expect(result.message[0] != '\0', "an error without text");
    }
    return 0;
}
