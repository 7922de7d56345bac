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
 * Values are cut into bands that are coded independently, so that later many cores can share the work. The
 * decoder knows from the units how many values must come out; every size in the bytes is checked against that
 * and against the frame's end before it is used. */
#include "proto/wire.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <zstd.h>

enum {
    CODEC_RAW = 0,
    CODEC_PLANES = 1,
    FRAME_HEADER = 8,       /* u8 codec, 3 zero bytes, u32 bands */
    BAND_TRIPLES = 1 << 16, /* pixels' values, 3 each */
    BAND_VALUES = 3 * BAND_TRIPLES,
    MASK_BYTES = BAND_TRIPLES / 8,
    PLANES = 8,
    BLOCK_HEADER = 4,
    ZSTD_LEVEL = 1
};
#define BLOCK_STORED 0x80000000u

static void put_u32(uint8_t *bytes, uint32_t value)
{
    for (int i = 0; i < 4; i++) bytes[i] = (uint8_t)(value >> (8 * i));
}

static uint32_t get_u32(const uint8_t *bytes)
{
    uint32_t value = 0;
    for (int i = 0; i < 4; i++) value |= (uint32_t)bytes[i] << (8 * i);
    return value;
}

static size_t band_count(size_t values)
{
    return (values + BAND_VALUES - 1) / BAND_VALUES;
}

/* Memory of one direction of the codec. */
typedef struct {
    uint64_t packed[BAND_VALUES]; /* the values that are not left out, zigzag */
    uint8_t plane[BAND_VALUES];
    uint8_t mask[MASK_BYTES];
    ZSTD_CCtx *compressor;   /* only when encoding */
    ZSTD_DCtx *decompressor; /* only when decoding */
} scratch_t;

static scratch_t *scratch_new(bool encode)
{
    scratch_t *scratch = mem_alloc(sizeof *scratch);
    scratch->compressor = encode ? ZSTD_createCCtx() : NULL;
    scratch->decompressor = encode ? NULL : ZSTD_createDCtx();
    if (scratch->compressor != NULL || scratch->decompressor != NULL) return scratch;
    free(scratch);
    return NULL;
}

static void scratch_free(scratch_t *scratch)
{
    ZSTD_freeCCtx(scratch->compressor);
    ZSTD_freeDCtx(scratch->decompressor);
    free(scratch);
}

/* ---- encoding ------------------------------------------------------------------------------------------ */

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

/* Gathers the triples that are not all zero and marks them in the mask; returns how many values they have. */
static size_t pack_triples(scratch_t *scratch, const int64_t *values, size_t triples, uint64_t *bits)
{
    size_t packed = 0;
    uint64_t all = 0;
    memset(scratch->mask, 0, (triples + 7) / 8);
    for (size_t i = 0; i < triples; i++) {
        const int64_t *v = values + 3 * i;
        if ((v[0] | v[1] | v[2]) == 0) continue;
        scratch->mask[i / 8] |= (uint8_t)(1 << (i % 8));
        for (int c = 0; c < 3; c++) {
            uint64_t zigzag = ((uint64_t)v[c] << 1) ^ (v[c] < 0 ? UINT64_MAX : 0);
            scratch->packed[packed++] = zigzag;
            all |= zigzag;
        }
    }
    *bits = all;
    return packed;
}

/* A band of zeroes takes no bytes at all. */
static void encode_band(scratch_t *scratch, const int64_t *values, size_t count, output_t *out)
{
    uint64_t bits;
    size_t triples = count / 3, packed = pack_triples(scratch, values, triples, &bits);
    if (packed == 0) return;
    int planes = (64 - __builtin_clzll(bits) + 7) / 8;
    encode_block(scratch, scratch->mask, (triples + 7) / 8, out);
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

static result_t encode_planes(const int64_t *values, size_t count, zmq_msg_t *message)
{
    scratch_t *scratch = scratch_new(true);
    if (scratch == NULL) return result_fail(RESULT_LIMIT, "no memory for the compressor");
    size_t bands = band_count(count);
    output_t out = {.size = FRAME_HEADER + 4 * bands};
    out.capacity = out.size + count; /* about what it comes to */
    out.bytes = mem_zalloc(1, out.capacity);
    out.bytes[0] = CODEC_PLANES;
    put_u32(out.bytes + 4, (uint32_t)bands);
    for (size_t b = 0; b < bands; b++) {
        size_t first = b * BAND_VALUES, start = out.size;
        size_t size = count - first < BAND_VALUES ? count - first : BAND_VALUES;
        encode_band(scratch, values + first, size, &out);
        put_u32(out.bytes + FRAME_HEADER + 4 * b, (uint32_t)(out.size - start));
    }
    scratch_free(scratch);
    return output_message(&out, message);
}

static result_t encode_raw(const int64_t *values, size_t count, zmq_msg_t *message)
{
    size_t size = FRAME_HEADER + count * sizeof *values;
    if (zmq_msg_init_size(message, size) != 0)
        return result_fail(RESULT_LIMIT, "no memory for a payload of %zu bytes", size);
    uint8_t *bytes = zmq_msg_data(message);
    memset(bytes, 0, FRAME_HEADER);
    bytes[0] = CODEC_RAW;
    if (count > 0) memcpy(bytes + FRAME_HEADER, values, count * sizeof *values);
    return result_ok();
}

result_t payload_encode(const batch_t *batch, bool compress, zmq_msg_t payload[2])
{
    result_t (*encode)(const int64_t *, size_t, zmq_msg_t *) = compress ? encode_planes : encode_raw;
    TRY(encode(batch->eye, batch->eye_count, &payload[0]));
    if (batch->splat == NULL) {
        zmq_msg_init(&payload[1]);
        return result_ok();
    }
    result_t result = encode(batch->splat, batch_splat_values(&batch->settings), &payload[1]);
    if (result.code != RESULT_OK) zmq_msg_close(&payload[0]);
    return result;
}

/* ---- decoding ------------------------------------------------------------------------------------------ */

/* What is left of a frame or a band. */
typedef struct {
    const uint8_t *bytes;
    size_t size;
} input_t;

static const uint8_t *input_take(input_t *in, size_t size)
{
    if (size > in->size) return NULL;
    const uint8_t *bytes = in->bytes;
    in->bytes += size;
    in->size -= size;
    return bytes;
}

/* Decodes one block, which must give exactly `size` bytes. */
static bool decode_block(scratch_t *scratch, input_t *in, uint8_t *bytes, size_t size)
{
    const uint8_t *header = input_take(in, BLOCK_HEADER);
    if (header == NULL) return false;
    uint32_t word = get_u32(header), coded = word & ~BLOCK_STORED;
    const uint8_t *data = input_take(in, coded);
    if (data == NULL) return false;
    if (!(word & BLOCK_STORED))
        return ZSTD_decompressDCtx(scratch->decompressor, bytes, size, data, coded) == size;
    if (coded != size) return false;
    memcpy(bytes, data, size);
    return true;
}

/* The set bits of the mask; SIZE_MAX when one is set beyond the last triple. */
static size_t mask_count(const uint8_t *mask, size_t triples)
{
    size_t count = 0;
    for (size_t i = 0; i < triples / 8; i++) count += (size_t)__builtin_popcount(mask[i]);
    if (triples % 8 == 0) return count;
    uint8_t last = mask[triples / 8];
    return last >> (triples % 8) ? SIZE_MAX : count + (size_t)__builtin_popcount(last);
}

/* Puts the packed values where the mask says, zeroes elsewhere. */
static void unpack_triples(const scratch_t *scratch, int64_t *values, size_t triples)
{
    const uint64_t *packed = scratch->packed;
    for (size_t i = 0; i < triples; i++) {
        int64_t *v = values + 3 * i;
        if (!(scratch->mask[i / 8] >> (i % 8) & 1)) {
            v[0] = v[1] = v[2] = 0;
            continue;
        }
        for (int c = 0; c < 3; c++, packed++) v[c] = (int64_t)(*packed >> 1 ^ -(*packed & 1));
    }
}

static bool decode_band(scratch_t *scratch, input_t in, int64_t *values, size_t count)
{
    size_t triples = count / 3;
    if (in.size == 0) {
        memset(values, 0, count * sizeof *values);
        return true;
    }
    if (!decode_block(scratch, &in, scratch->mask, (triples + 7) / 8)) return false;
    size_t marked = mask_count(scratch->mask, triples);
    const uint8_t *planes = input_take(&in, 1);
    if (marked == SIZE_MAX || planes == NULL || *planes > PLANES) return false;
    size_t packed = 3 * marked;
    memset(scratch->packed, 0, packed * sizeof *scratch->packed);
    for (int p = 0; p < *planes; p++) {
        if (!decode_block(scratch, &in, scratch->plane, packed)) return false;
        for (size_t i = 0; i < packed; i++) scratch->packed[i] |= (uint64_t)scratch->plane[i] << (8 * p);
    }
    unpack_triples(scratch, values, triples);
    return in.size == 0;
}

/* The parts of a compressed frame. */
typedef struct {
    const uint8_t *table; /* u32 bytes of each band */
    input_t bands;
    size_t count;
} frame_t;

/* Checks a compressed frame's sizes against the number of values that must come out. */
static bool frame_open(input_t in, size_t values, frame_t *frame)
{
    const uint8_t *header = input_take(&in, FRAME_HEADER);
    if (header == NULL || header[0] != CODEC_PLANES) return false;
    frame->count = get_u32(header + 4);
    if (frame->count != band_count(values)) return false;
    frame->table = input_take(&in, 4 * frame->count);
    if (frame->table == NULL) return false;
    uint64_t sum = 0;
    for (size_t b = 0; b < frame->count; b++) sum += get_u32(frame->table + 4 * b);
    frame->bands = in;
    return sum == in.size;
}

static bool decode_planes(frame_t *frame, int64_t *values, size_t count)
{
    scratch_t *scratch = scratch_new(false);
    bool good = scratch != NULL;
    for (size_t b = 0; good && b < frame->count; b++) {
        size_t size = get_u32(frame->table + 4 * b), first = b * BAND_VALUES;
        input_t band = {input_take(&frame->bands, size), size};
        good = decode_band(scratch, band, values + first,
                           count - first < BAND_VALUES ? count - first : BAND_VALUES);
    }
    if (scratch != NULL) scratch_free(scratch);
    return good;
}

/* Fills *values, at least `count` of them: what is there of `capacity` is used, or else memory is taken once
 * the frame's sizes are known to be right. */
static result_t decode_frame(const zmq_msg_t *message, const char *name, size_t count, int64_t **values,
                             size_t *capacity)
{
    input_t in = {zmq_msg_data((zmq_msg_t *)message), zmq_msg_size(message)};
    bool raw = in.size == FRAME_HEADER + count * sizeof **values && in.bytes[0] == CODEC_RAW;
    frame_t frame = {0};
    if (!raw && !frame_open(in, count, &frame))
        return result_fail(RESULT_PROTOCOL, "the %s payload of %zu bytes cannot hold %zu values", name,
                           in.size, count);
    if (*capacity < count) {
        free(*values);
        *values = malloc(count * sizeof **values);
        *capacity = *values == NULL ? 0 : count;
        if (*values == NULL) return result_fail(RESULT_LIMIT, "no memory for %zu %s values", count, name);
    }
    if (raw)
        memcpy(*values, in.bytes + FRAME_HEADER, count * sizeof **values);
    else if (!decode_planes(&frame, *values, count))
        return result_fail(RESULT_PROTOCOL, "the %s payload of %zu bytes is damaged", name, in.size);
    return result_ok();
}

result_t payload_decode(const zmq_msg_t *eye, const zmq_msg_t *splat, batch_t *batch)
{
    size_t eye_values = 0, splat_values = batch_splat_values(&batch->settings);
    for (size_t i = 0; i < batch->unit_count; i++)
        eye_values += batch_tile_values(&batch->settings, batch->units[i].tile);
    batch->eye_count = 0;
    TRY(decode_frame(eye, "eye", eye_values, &batch->eye, &batch->eye_capacity));
    batch->eye_count = eye_values;
    if (zmq_msg_size(splat) == 0) {
        free(batch->splat);
        batch->splat = NULL;
        return result_ok();
    }
    size_t capacity = batch->splat == NULL ? 0 : splat_values;
    return decode_frame(splat, "splat", splat_values, &batch->splat, &capacity);
}
