/* fuzz_record: any bytes as the record of a job, as the journal keeps it. What is accepted can be a job, and
 * comes back as it was when it is written again. */
#include "tests/fuzz/fuzz.h"

#include "master/store/record.h"

#include <stdlib.h>
#include <string.h>

int fuzz_record(const uint8_t *data, size_t size)
{
    job_record_t record, back;
    result_t result = record_unpack(data, size, &record);
    if (result.code != RESULT_OK) {
        fuzz_expect(result.message[0] != '\0', "an error without text");
        return 0;
    }
    fuzz_expect(record.job != 0, "a job without number");
    fuzz_expect(job_settings_check(&record.settings).code == RESULT_OK, "settings that were not checked");
    size_t packed_size, again_size;
    uint8_t *packed = record_pack(&record, &packed_size);
    fuzz_expect(record_unpack(packed, packed_size, &back).code == RESULT_OK,
                "a record that does not come back");
    uint8_t *again = record_pack(&back, &again_size);
    fuzz_expect(again_size == packed_size && memcmp(again, packed, packed_size) == 0, "another record");
    free(packed);
    free(again);
    return 0;
}
