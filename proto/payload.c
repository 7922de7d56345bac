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
#include "proto/wire.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <zstd.h>

enum {
    CODEC_RAW = 0,
    CODEC_PLANES = 1,
    FRAME_HEADER = 8, /* u8 codec, 3 zero bytes, u32 bands */
    BAND_PIXELS = 1 << 16,
    GROUP_VALUES = 3, /* of a pixel in a band, at most */
    BAND_VALUES = GROUP_VALUES * BAND_PIXELS,
    MASK_BYTES = BAND_PIXELS / 8,
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

/* How an array of sums is cut: a pixel has `stride` values, in groups that are coded apart, since they are of
 * different kinds. Where neighbours are much alike, each value is coded as its difference from the pixel
 * before.
 */
typedef struct {
    size_t stride, group_count;
    uint8_t groups[6]; /* values of each, at most GROUP_VALUES */
    bool differences;
} layout_t;

static const layout_t colour_layout = {3, 1, {3}, false};
/* Albedo, normal, position, depth, counts, ids. */
static const layout_t feature_layout = {FEATURE_VALUES, 6, {3, 3, 3, 1, 2, 2}, true};

static size_t band_count(const layout_t *layout, size_t values)
{
    size_t pixels = values / layout->stride;
    return (pixels + BAND_PIXELS - 1) / BAND_PIXELS * layout->group_count;
}

/* One group of values of up to BAND_PIXELS pixels. */
typedef struct {
    size_t first; /* index of its first value */
    size_t stride, lanes, pixels;
    bool differences;
} band_t;

static band_t band_at(const layout_t *layout, size_t values, size_t index)
{
    size_t chunk = index / layout->group_count, group = index % layout->group_count;
    size_t pixels = values / layout->stride - chunk * BAND_PIXELS;
    band_t band = {.first = chunk * BAND_PIXELS * layout->stride,
                   .stride = layout->stride,
                   .lanes = layout->groups[group],
                   .pixels = pixels < BAND_PIXELS ? pixels : BAND_PIXELS,
                   .differences = layout->differences};
    for (size_t g = 0; g < group; g++) band.first += layout->groups[g];
    return band;
}

/* Memory of one direction of the codec. */
typedef struct {
    uint64_t packed[BAND_VALUES +
                    GROUP_VALUES]; /* the values that are not left out, zigzag; room for one pixel more */
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

static uint64_t zigzag(uint64_t value)
{
    return value << 1 ^ (value >> 63 ? UINT64_MAX : 0);
}

static uint64_t zigzag_back(uint64_t value)
{
    return value >> 1 ^ (value & 1 ? UINT64_MAX : 0);
}

/* Gathers the values of the pixels that are not all zero and marks these in the mask; returns how many values
 * there are, and in *bits all bits that are set in any. */
static size_t pack_pixels(scratch_t *scratch, const band_t *band, const int64_t *values, uint64_t *bits)
{
    uint64_t before[GROUP_VALUES] = {0}, *packed = scratch->packed;
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

static result_t encode_planes(const layout_t *layout, const int64_t *values, size_t count, zmq_msg_t *message)
{
    scratch_t *scratch = scratch_new(true);
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
        encode_band(scratch, &band, values + band.first, &out);
        put_u32(out.bytes + FRAME_HEADER + 4 * b, (uint32_t)(out.size - start));
    }
    scratch_free(scratch);
    return output_message(&out, message);
}

static result_t encode_raw(const layout_t *layout, const int64_t *values, size_t count, zmq_msg_t *message)
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

result_t payload_encode(const batch_t *batch, bool compress, zmq_msg_t payload[BATCH_PAYLOADS])
{
    result_t (*encode)(const layout_t *, const int64_t *, size_t, zmq_msg_t *) =
        compress ? encode_planes : encode_raw;
    size_t splats = batch->splat != NULL ? batch_splat_values(&batch->settings) : 0;
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_init(&payload[i]);
    result_t result = encode(&colour_layout, batch->eye, batch->eye_count, &payload[0]);
    if (result.code == RESULT_OK && splats > 0)
        result = encode(&colour_layout, batch->splat, splats, &payload[1]);
    if (result.code == RESULT_OK && batch->feature_count > 0)
        result = encode(&feature_layout, batch->features, batch->feature_count, &payload[2]);
    for (int i = 0; i < BATCH_PAYLOADS && result.code != RESULT_OK; i++) zmq_msg_close(&payload[i]);
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

/* The set bits of the mask; SIZE_MAX when one is set beyond the last pixel. */
static size_t mask_count(const uint8_t *mask, size_t pixels)
{
    size_t count = 0;
    for (size_t i = 0; i < pixels / 8; i++) count += (size_t)__builtin_popcount(mask[i]);
    if (pixels % 8 == 0) return count;
    uint8_t last = mask[pixels / 8];
    return last >> (pixels % 8) ? SIZE_MAX : count + (size_t)__builtin_popcount(last);
}

/* Puts the packed values where the mask says, zeroes (or no difference) elsewhere. */
static void unpack_pixels(const scratch_t *scratch, const band_t *band, int64_t *values)
{
    const uint64_t *packed = scratch->packed;
    uint64_t before[GROUP_VALUES] = {0};
    for (size_t i = 0; i < band->pixels; i++) {
        int64_t *v = values + band->stride * i;
        bool marked = scratch->mask[i / 8] >> (i % 8) & 1;
        for (size_t l = 0; l < band->lanes; l++) {
            uint64_t value = before[l] + (marked ? zigzag_back(*packed++) : 0);
            v[l] = (int64_t)value;
            if (band->differences) before[l] = value;
        }
    }
}

/* `values` are those from the band's first on. */
static bool decode_band(scratch_t *scratch, const band_t *band, input_t in, int64_t *values)
{
    size_t mask_bytes = (band->pixels + 7) / 8;
    if (in.size == 0) {
        memset(scratch->mask, 0, mask_bytes);
        unpack_pixels(scratch, band, values);
        return true;
    }
    if (!decode_block(scratch, &in, scratch->mask, mask_bytes)) return false;
    size_t marked = mask_count(scratch->mask, band->pixels);
    const uint8_t *planes = input_take(&in, 1);
    if (marked == SIZE_MAX || planes == NULL || *planes > PLANES) return false;
    size_t packed = band->lanes * marked;
    memset(scratch->packed, 0, packed * sizeof *scratch->packed);
    for (int p = 0; p < *planes; p++) {
        if (!decode_block(scratch, &in, scratch->plane, packed)) return false;
        for (size_t i = 0; i < packed; i++) scratch->packed[i] |= (uint64_t)scratch->plane[i] << (8 * p);
    }
    unpack_pixels(scratch, band, values);
    return in.size == 0;
}

/* The parts of a compressed frame. */
typedef struct {
    const uint8_t *table; /* u32 bytes of each band */
    input_t bands;
    size_t count;
} frame_t;

/* Checks a compressed frame's sizes against the number of values that must come out. */
static bool frame_open(input_t in, const layout_t *layout, size_t values, frame_t *frame)
{
    const uint8_t *header = input_take(&in, FRAME_HEADER);
    if (header == NULL || header[0] != CODEC_PLANES) return false;
    frame->count = get_u32(header + 4);
    if (frame->count != band_count(layout, values)) return false;
    frame->table = input_take(&in, 4 * frame->count);
    if (frame->table == NULL) return false;
    uint64_t sum = 0;
    for (size_t b = 0; b < frame->count; b++) sum += get_u32(frame->table + 4 * b);
    frame->bands = in;
    return sum == in.size;
}

static bool decode_planes(frame_t *frame, const layout_t *layout, int64_t *values, size_t count)
{
    scratch_t *scratch = scratch_new(false);
    bool good = scratch != NULL;
    for (size_t b = 0; good && b < frame->count; b++) {
        size_t size = get_u32(frame->table + 4 * b);
        input_t in = {input_take(&frame->bands, size), size};
        band_t band = band_at(layout, count, b);
        good = decode_band(scratch, &band, in, values + band.first);
    }
    if (scratch != NULL) scratch_free(scratch);
    return good;
}

/* Fills *values, at least `count` of them: what is there of `capacity` is used, or else memory is taken once
 * the frame's sizes are known to be right. */
static result_t decode_frame(const zmq_msg_t *message, const char *name, const layout_t *layout, size_t count,
                             int64_t **values, size_t *capacity)
{
    input_t in = {zmq_msg_data((zmq_msg_t *)message), zmq_msg_size(message)};
    bool raw = in.size == FRAME_HEADER + count * sizeof **values && in.bytes[0] == CODEC_RAW;
    frame_t frame = {0};
    if (!raw && !frame_open(in, layout, count, &frame))
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
    else if (!decode_planes(&frame, layout, *values, count))
        return result_fail(RESULT_PROTOCOL, "the %s payload of %zu bytes is damaged", name, in.size);
    return result_ok();
}

static result_t decode_splats(const zmq_msg_t *message, batch_t *batch)
{
    if (zmq_msg_size(message) == 0) {
        free(batch->splat);
        batch->splat = NULL;
        return result_ok();
    }
    size_t values = batch_splat_values(&batch->settings), capacity = batch->splat == NULL ? 0 : values;
    return decode_frame(message, "splat", &colour_layout, values, &batch->splat, &capacity);
}

static result_t decode_features(const zmq_msg_t *message, size_t values, batch_t *batch)
{
    if (values == 0 && zmq_msg_size(message) == 0) return result_ok();
    if (values == 0) return result_fail(RESULT_PROTOCOL, "a feature payload for units that have no features");
    TRY(decode_frame(message, "feature", &feature_layout, values, &batch->features,
                     &batch->feature_capacity));
    batch->feature_count = values;
    return result_ok();
}

result_t payload_decode(const zmq_msg_t payload[BATCH_PAYLOADS], batch_t *batch)
{
    size_t eye_values = 0, feature_values = 0;
    for (size_t i = 0; i < batch->unit_count; i++) {
        eye_values += batch_tile_values(&batch->settings, batch->units[i].tile);
        feature_values += batch_feature_values(&batch->settings, &batch->units[i]);
    }
    batch->eye_count = batch->feature_count = 0;
    TRY(decode_frame(&payload[0], "eye", &colour_layout, eye_values, &batch->eye, &batch->eye_capacity));
    batch->eye_count = eye_values;
    TRY(decode_splats(&payload[1], batch));
    return decode_features(&payload[2], feature_values, batch);
}
