/* payload: the lossless codec of a batch's sums. PROTOCOL.md gives the byte layout, docs/codec.md the
 * figures.
 *
 * DESIGN. A sum is a 64-bit integer whose upper half is mostly zero and whose lowest 25 or so significant
 * bits are noise: no dictionary finds anything in it. What can be saved is the zero bytes, the skew of the
 * topmost used byte and of the lowest (a float has no more than 24 significant bits), and, in a splat frame,
 * the empty pixels. So the three values of a pixel are left out together where all are zero, as a bit mask
 * says; the others are laid out as byte planes, lowest first, as many as the largest value needs; and zstd at
 * level 1 codes the mask and each plane by itself, so that each has entropy tables of its own.
 *
 * Blosc (LZ4 and zstd, byte and bit shuffle) and plain zstd on shuffled bytes repeat the pattern of empty
 * pixels in every plane: at 5% occupancy their output is 1.6 to 6 times as large, and they take 3 to 10 times
 * as long. Higher zstd levels gain nothing, for there is nothing to match.
 *
 * Features go the same way, but each value as its difference from the pixel before: ids, albedos and the
 * normals of flat faces are the same over large areas, and places differ little. They are cut into groups of
 * one kind (position, depth, ids, ...), so that a plane holds bytes that are alike.
 *
 * Values are cut into bands that are coded independently, so that later many cores can share the work. The
 * decoder knows from the units how many values must come out; every size in the bytes is checked against that
 * and against the frame's end before it is used. */
#include "proto/wire/payload_format.h"

#include <stdlib.h>
#include <string.h>
#include <zstd.h>

enum { ZSTD_LEVEL = 1 };

static void put_u32(uint8_t *bytes, uint32_t value)
{
    for (int i = 0; i < 4; i++) bytes[i] = (uint8_t)(value >> (8 * i));
}

/* Memory of the encoder. */
typedef struct {
    uint64_t packed[BAND_VALUES +
                    SUM_GROUP_VALUES]; /* the values that are not left out, zigzag; room for one pixel more */
    uint8_t plane[BAND_VALUES];
    uint8_t mask[MASK_BYTES];
    ZSTD_CCtx *compressor;
} scratch_t;

static scratch_t *scratch_new(void)
{
    scratch_t *scratch = mem_alloc(sizeof *scratch);
    scratch->compressor = ZSTD_createCCtx();
    if (scratch->compressor != NULL) return scratch;
    free(scratch);
    return NULL;
}

static void scratch_free(scratch_t *scratch)
{
    ZSTD_freeCCtx(scratch->compressor);
    free(scratch);
}

/* Bytes that grow. */
typedef struct {
    uint8_t *bytes;
    size_t size, capacity;
} output_t;

static uint8_t *output_reserve(output_t *out, size_t more)
{
    if (out->size + more > out->capacity) {
        out->capacity = 2 * out->capacity + more;
        out->bytes = mem_realloc(out->bytes, out->capacity);
    }
    return out->bytes + out->size;
}

/* Appends a block: a u32 with its size and, in the top bit, whether it is stored as it is; then its bytes. */
static void encode_block(scratch_t *scratch, const uint8_t *bytes, size_t size, output_t *out)
{
    size_t bound = ZSTD_compressBound(size);
    uint8_t *block = output_reserve(out, BLOCK_HEADER + bound);
    size_t coded =
        ZSTD_compressCCtx(scratch->compressor, block + BLOCK_HEADER, bound, bytes, size, ZSTD_LEVEL);
    bool stored = ZSTD_isError(coded) || coded >= size;
    if (stored) {
        coded = size;
        memcpy(block + BLOCK_HEADER, bytes, size);
    }
    put_u32(block, (uint32_t)coded | (stored ? BLOCK_STORED : 0));
    out->size += BLOCK_HEADER + coded;
}

static uint64_t zigzag(uint64_t value)
{
    return value << 1 ^ (value >> 63 ? UINT64_MAX : 0);
}

/* Gathers the values of the pixels that are not all zero and marks these in the mask; returns how many values
 * there are, and in *bits all bits that are set in any. */
static size_t pack_pixels(scratch_t *scratch, const band_t *band, const int64_t *values, uint64_t *bits)
{
    uint64_t before[SUM_GROUP_VALUES] = {0}, *packed = scratch->packed;
    *bits = 0;
    memset(scratch->mask, 0, (band->pixels + 7) / 8);
    for (size_t i = 0; i < band->pixels; i++) {
        const int64_t *v = values + band->stride * i;
        uint64_t any = 0;
        for (size_t l = 0; l < band->lanes; l++) {
            packed[l] = zigzag((uint64_t)v[l] - before[l]);
            any |= packed[l];
            if (band->differences) before[l] = (uint64_t)v[l];
        }
        if (any == 0) continue;
        scratch->mask[i / 8] |= (uint8_t)(1 << (i % 8));
        packed += band->lanes;
        *bits |= any;
    }
    return (size_t)(packed - scratch->packed);
}

/* A band of zeroes takes no bytes at all. `values` are those from the band's first on. */
static void encode_band(scratch_t *scratch, const band_t *band, const int64_t *values, output_t *out)
{
    uint64_t bits;
    size_t packed = pack_pixels(scratch, band, values, &bits);
    if (packed == 0) return;
    int planes = (64 - __builtin_clzll(bits) + 7) / 8;
    encode_block(scratch, scratch->mask, (band->pixels + 7) / 8, out);
    *output_reserve(out, 1) = (uint8_t)planes;
    out->size++;
    for (int p = 0; p < planes; p++) {
        for (size_t i = 0; i < packed; i++) scratch->plane[i] = (uint8_t)(scratch->packed[i] >> (8 * p));
        encode_block(scratch, scratch->plane, packed, out);
    }
}

static void free_output(void *bytes, void *hint)
{
    (void)hint;
    free(bytes);
}

/* Hands the bytes over to a message. */
static result_t output_message(output_t *out, zmq_msg_t *message)
{
    out->bytes = mem_realloc(out->bytes, out->size);
    if (zmq_msg_init_data(message, out->bytes, out->size, free_output, NULL) == 0) return result_ok();
    free(out->bytes);
    return result_fail(RESULT_LIMIT, "no memory for a payload of %zu bytes", out->size);
}

static result_t encode_planes(const sum_layout_t *layout, const int64_t *values, size_t count,
                              zmq_msg_t *message)
{
    scratch_t *scratch = scratch_new();
    if (scratch == NULL) return result_fail(RESULT_LIMIT, "no memory for the compressor");
    size_t bands = band_count(layout, count);
    output_t out = {.size = FRAME_HEADER + 4 * bands};
    out.capacity = out.size + count; /* about what it comes to */
    out.bytes = mem_zalloc(1, out.capacity);
    out.bytes[0] = CODEC_PLANES;
    put_u32(out.bytes + 4, (uint32_t)bands);
    for (size_t b = 0; b < bands; b++) {
        size_t start = out.size;
        band_t band = band_at(layout, count, b);
        encode_band(scratch, &band, values + band.stride * band.pixel + band.offset, &out);
        put_u32(out.bytes + FRAME_HEADER + 4 * b, (uint32_t)(out.size - start));
    }
    scratch_free(scratch);
    return output_message(&out, message);
}

static result_t encode_raw(const sum_layout_t *layout, const int64_t *values, size_t count,
                           zmq_msg_t *message)
{
    (void)layout;
    size_t size = FRAME_HEADER + count * sizeof *values;
    if (zmq_msg_init_size(message, size) != 0)
        return result_fail(RESULT_LIMIT, "no memory for a payload of %zu bytes", size);
    uint8_t *bytes = zmq_msg_data(message);
    memset(bytes, 0, FRAME_HEADER);
    bytes[0] = CODEC_RAW;
    if (count > 0) memcpy(bytes + FRAME_HEADER, values, count * sizeof *values);
    return result_ok();
}

int payload_count(const zmq_msg_t payload[BATCH_PAYLOADS])
{
    int count = BATCH_PAYLOADS;
    while (count > BATCH_BASE_PAYLOADS && zmq_msg_size(&payload[count - 1]) == 0) count--;
    return count;
}

result_t payload_encode(const batch_t *batch, bool compress, zmq_msg_t payload[BATCH_PAYLOADS])
{
    result_t (*encode)(const sum_layout_t *, const int64_t *, size_t, zmq_msg_t *) =
        compress ? encode_planes : encode_raw;
    result_t result = result_ok();
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_init(&payload[i]);
    for (int i = 0; i < BATCH_PAYLOADS && result.code == RESULT_OK; i++)
        if (batch->sums[i].count > 0)
            result = encode(&film_sums[i], batch->sums[i].values, batch->sums[i].count, &payload[i]);
    for (int i = 0; i < BATCH_PAYLOADS && result.code != RESULT_OK; i++) zmq_msg_close(&payload[i]);
    return result;
}
