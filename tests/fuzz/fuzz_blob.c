/* fuzz_blob: any bytes as a scene blob. Its size and checksum are mended, so that what lies behind them is
 * reached; a view that is handed out must be safe to look at. */
#include "tests/fuzz/fuzz.h"

#include <stdlib.h>

int fuzz_blob(const uint8_t *data, size_t size)
{
    uint8_t *bytes = fuzz_mend_blob(data, size);
    scene_blob_t blob;
    result_t result = blob_open(bytes, size, &blob);
    if (result.code == RESULT_OK) fuzz_walk(&blob);
    fuzz_expect(result.code == RESULT_OK || result.message[0] != '\0', "an error without text");
    blob_close(&blob);
    free(bytes);
    return 0;
}
