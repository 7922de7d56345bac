/* fuzz_blob: any bytes as a scene blob. Its size and checksum are mended, so that what lies behind them is
 * reached; a view that is handed out must be safe to look at. */
#include "tests/fuzz/fuzz.h"

#include <stdlib.h>
#include <string.h>

/* Where a blob's header has them: see scene_blob.c. */
enum { SIZE_AT = 16, CHECKSUM_AT = 24, SECTIONS_AT = CHECKSUM_AT + HASH_BYTES };
enum { HEADER_SIZE = SECTIONS_AT + 16 * BLOB_SECTION_COUNT };

int fuzz_blob(const uint8_t *data, size_t size)
{
    uint8_t *bytes = mem_alloc(size);
    if (size > 0) memcpy(bytes, data, size);
    if (size >= HEADER_SIZE) {
        uint64_t whole = size;
        hash_t checksum = hash_bytes(bytes + HEADER_SIZE, size - HEADER_SIZE);
        memcpy(bytes + SIZE_AT, &whole, sizeof whole);
        memcpy(bytes + CHECKSUM_AT, &checksum, sizeof checksum);
    }
    scene_blob_t blob;
    result_t result = blob_open(bytes, size, &blob);
    if (result.code == RESULT_OK) fuzz_walk(&blob);
    fuzz_expect(result.code == RESULT_OK || result.message[0] != '\0', "an error without text");
    blob_close(&blob);
    free(bytes);
    return 0;
}
