/* unblosc: see unblosc.h. */
#include "client/import/packed/unblosc.h"

#include "common/file_io.h"

#include <blosc.h>
#include <stdlib.h>

typedef struct {
    const uint8_t *data;
    size_t packed, size;
} request_t;

static const uint64_t spare_memory = (uint64_t)64 << 20;
enum { LEAST_SECONDS = 10, BYTES_PER_SECOND = 32 << 20 };

static int unpack_here(const void *context, int output)
{
    const request_t *r = context;
    size_t size = 0;
    if (blosc_cbuffer_validate(r->data, r->packed, &size) != 0 || size != r->size) return 1;
    void *bytes = malloc(r->size);
    if (bytes == NULL) return 2;
    int unpacked = blosc_decompress_ctx(r->data, bytes, r->size, 1);
    bool whole = unpacked >= 0 && (size_t)unpacked == r->size && file_write_all(output, bytes, r->size);
    free(bytes);
    return whole ? 0 : 1;
}

result_t unblosc(const uint8_t *data, size_t packed, size_t size, confined_result_t *out)
{
    request_t request = {data, packed, size};
    confined_limits_t limits = {2 * (uint64_t)size + spare_memory,
                                LEAST_SECONDS + (unsigned)(size / BYTES_PER_SECOND)};
    TRY(confined_run(unpack_here, &request, &limits, out));
    if (out->failure == 0 && out->size == size) return result_ok();
    confined_free(out);
    return result_fail(RESULT_INPUT, "its Blosc data are damaged");
}
