/* meshopt: see meshopt.h. */
#include "client/import/packed/meshopt.h"

#include <inttypes.h>
#include <meshoptimizer.h>
#include <stdlib.h>

/* Attributes: 64 elements need two bits for 16 of them in every byte of the stride. Triangles and indices
 * need a byte for 12 bytes at most. */
enum { MOST_BYTES_PER_BYTE = 64 };
enum { MOST_STRIDE = 256 };

/* ---- the rules of the extension ------------------------------------------------------------------------ */

static bool stride_fits_mode(const meshopt_layout_t *layout)
{
    if (layout->mode == MESHOPT_ATTRIBUTES)
        return layout->stride > 0 && layout->stride <= MOST_STRIDE && layout->stride % 4 == 0;
    return layout->stride == 2 || layout->stride == 4;
}

static bool stride_fits_filter(const meshopt_layout_t *layout)
{
    switch (layout->filter) {
    case MESHOPT_OCTAHEDRAL:
        return layout->stride == 4 || layout->stride == 8;
    case MESHOPT_QUATERNION:
        return layout->stride == 8;
    case MESHOPT_NONE:
    case MESHOPT_EXPONENTIAL:
        break;
    }
    return true;
}

result_t meshopt_check(const meshopt_layout_t *layout, size_t size)
{
    if (!stride_fits_mode(layout) || !stride_fits_filter(layout))
        return result_fail(RESULT_INPUT, "its mode and filter take no byteStride of %" PRIu64,
                           layout->stride);
    if (layout->filter != MESHOPT_NONE && layout->mode != MESHOPT_ATTRIBUTES)
        return result_fail(RESULT_INPUT, "only mode ATTRIBUTES has filters");
    if (layout->count == 0 || (layout->mode == MESHOPT_TRIANGLES && layout->count % 3 != 0))
        return result_fail(RESULT_INPUT, "a count of %" PRIu64 " does not fit its mode", layout->count);
    if (layout->count > size * MOST_BYTES_PER_BYTE / layout->stride)
        return result_fail(RESULT_INPUT, "%zu bytes cannot hold %" PRIu64 " elements; is the file cut short?",
                           size, layout->count);
    return result_ok();
}

/* ---- unpacking ----------------------------------------------------------------------------------------- */

static int decode(const meshopt_layout_t *layout, const uint8_t *data, size_t size, uint8_t *out)
{
    switch (layout->mode) {
    case MESHOPT_ATTRIBUTES:
        return meshopt_decodeVertexBuffer(out, layout->count, layout->stride, data, size);
    case MESHOPT_TRIANGLES:
        return meshopt_decodeIndexBuffer(out, layout->count, layout->stride, data, size);
    case MESHOPT_INDICES:
        return meshopt_decodeIndexSequence(out, layout->count, layout->stride, data, size);
    }
    return -1;
}

static void undo_filter(const meshopt_layout_t *layout, uint8_t *out)
{
    switch (layout->filter) {
    case MESHOPT_NONE:
        break;
    case MESHOPT_OCTAHEDRAL:
        meshopt_decodeFilterOct(out, layout->count, layout->stride);
        break;
    case MESHOPT_QUATERNION:
        meshopt_decodeFilterQuat(out, layout->count, layout->stride);
        break;
    case MESHOPT_EXPONENTIAL:
        meshopt_decodeFilterExp(out, layout->count, layout->stride);
        break;
    }
}

result_t meshopt_unpack(const meshopt_layout_t *layout, const uint8_t *data, size_t size, uint8_t **unpacked)
{
    TRY(meshopt_check(layout, size));
    uint8_t *out = calloc(layout->count, layout->stride);
    if (!out) return result_fail(RESULT_LIMIT, "no memory for %" PRIu64 " elements", layout->count);
    if (decode(layout, data, size, out) != 0) {
        free(out);
        return result_fail(RESULT_INPUT,
                           "its meshopt data are damaged, or of a version that only KHR_meshopt_compression "
                           "has; copy the file again, or export it with EXT_meshopt_compression");
    }
    undo_filter(layout, out);
    *unpacked = out;
    return result_ok();
}
