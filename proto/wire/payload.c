/* payload: the lossless codec of a batch's sums. PROTOCOL.md gives the byte layout, docs/codec.md the
 * figures.
 *
 * DESIGN. A sum is a 64-bit integer whose upper half is mostly zero and whose lowest 25 or so significant
 * bits are noise: no dictionary finds anything in it. What can be saved is the zero bytes, the skew of the
 * topmost used byte and of the lowest (a float has no more than 24 significant bits), and, in a splat frame,
 * the empty pixels. So the values of a pixel are left out together where all are zero, as a bit mask says;
 * the others are laid out as streams, one for each of the three, and these as byte planes, lowest first, as
 * many as the largest value needs; and zstd at level 1 codes the mask and each plane by itself, so that each
 * has entropy tables of its own.
 *
 * Of a splat frame the colours can be saved, too: where a pixel has one of the few that the splats of a scene
 * have, green and blue follow from red but for the rounding of floats (payload_colours.c).
 *
 * Blosc (LZ4 and zstd, byte and bit shuffle) and plain zstd on shuffled bytes repeat the pattern of empty
 * pixels in every plane: at 5% occupancy their output is 1.6 to 6 times as large, and they take 3 to 10 times
 * as long. Higher zstd levels gain nothing, for there is nothing to match.
 *
 * Features go the same way, but each value as its difference from the pixel before: ids, albedos and the
 * normals of flat faces are the same over large areas, and places differ little. They are cut into groups of
 * one kind (position, depth, ids, ...), which share a mask.
 *
 * Values are cut into bands that are coded independently, so that later many cores can share the work. The
 * decoder knows from the units how many values must come out; every size in the bytes is checked against that
 * and against the frame's end before it is used. */
#include "proto/wire/payload_colours.h"

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
    uint64_t lanes[SUM_GROUP_VALUES]
                  [BAND_PIXELS + 1];       /* the values that are not left out; room for one more */
    uint64_t unknown[2 * BAND_PIXELS + 2]; /* green and blue of pixels without a colour, */
    uint64_t known[2 * BAND_PIXELS + 2];   /* and what is left of them with one; room for one pixel more */
    uint8_t plane[2 * BAND_PIXELS];
    uint8_t mask[MASK_BYTES];
    uint8_t index[BAND_PIXELS];
    colour_finder_t *finder;
    ZSTD_CCtx *compressor;
} scratch_t;

static void scratch_free(scratch_t *scratch)
{
    ZSTD_freeCCtx(scratch->compressor);
    colour_finder_free(scratch->finder);
    free(scratch);
}

static scratch_t *scratch_new(void)
{
    scratch_t *scratch = mem_alloc(sizeof *scratch);
    scratch->compressor = ZSTD_createCCtx();
    scratch->finder = colour_finder_new();
    if (scratch->compressor != NULL) return scratch;
    scratch_free(scratch);
    return NULL;
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

static void put_u8(output_t *out, uint8_t value)
{
    *output_reserve(out, 1) = value;
    out->size++;
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

/* Gathers the values of the pixels that are not all zero, or whose differences are not, by lane, and marks
 * these pixels in the mask; returns how many there are. Without branches, and inlined for each kind of band,
 * since this looks at everything. */
static inline size_t pack_lanes(scratch_t *scratch, const band_t *band, const int64_t *values, size_t lanes,
                                bool differences)
{
    uint64_t before[SUM_GROUP_VALUES] = {0};
    size_t packed = 0;
    unsigned marks = 0;
    for (size_t i = 0; i < band->pixels; i++, values += band->stride) {
        uint64_t any = 0;
        for (size_t l = 0; l < lanes; l++) {
            uint64_t value = (uint64_t)values[l] - before[l];
            scratch->lanes[l][packed] = value;
            any |= value;
            if (differences) before[l] = (uint64_t)values[l];
        }
        packed += any != 0;
        marks |= (unsigned)(any != 0) << (i % 8);
        scratch->mask[i / 8] = (uint8_t)marks;
        if (i % 8 == 7) marks = 0;
    }
    return packed;
}

static size_t pack_pixels(scratch_t *scratch, const band_t *band, const int64_t *values)
{
    if (!band->differences)
        return band->lanes == 1 ? pack_lanes(scratch, band, values, 1, false)
                                : pack_lanes(scratch, band, values, SUM_GROUP_VALUES, false);
    if (band->lanes == 3) return pack_lanes(scratch, band, values, 3, true);
    if (band->lanes == 2) return pack_lanes(scratch, band, values, 2, true);
    return pack_lanes(scratch, band, values, 1, true);
}

/* Appends values as byte planes; they become their zigzag. */
static void encode_stream(scratch_t *scratch, uint64_t *values, size_t count, output_t *out)
{
    uint64_t bits = 0;
    for (size_t i = 0; i < count; i++) bits |= values[i] = zigzag(values[i]);
    int planes = bits == 0 ? 0 : (64 - __builtin_clzll(bits) + 7) / 8;
    put_u8(out, (uint8_t)planes);
    for (int p = 0; p < planes; p++) {
        for (size_t i = 0; i < count; i++) scratch->plane[i] = (uint8_t)(values[i] >> (8 * p));
        encode_block(scratch, scratch->plane, count, out);
    }
}

/* Appends the colours of a frame's pixels. Of green and blue only what red does not tell is left, in pairs.
 */
static void encode_colours(scratch_t *scratch, size_t pixels, output_t *out)
{
    colour_t colours[1 + MAX_COLOURS] = {0};
    int number;
    const uint64_t *const rgb[] = {scratch->lanes[0], scratch->lanes[1], scratch->lanes[2]};
    colour_finder_run(scratch->finder, rgb, pixels, colours + 1, &number, scratch->index);
    put_u8(out, (uint8_t)number);
    for (int i = 1; i <= number; i++)
        for (int c = 0; c < 2; c++, out->size += 4) put_u32(output_reserve(out, 4), colours[i].of_red[c]);
    if (number > 0) encode_block(scratch, scratch->index, pixels, out);
    size_t unknown = 0;
    for (size_t i = 0; i < pixels; i++) {
        const colour_t *colour = &colours[scratch->index[i]];
        uint64_t *pairs[] = {scratch->unknown + 2 * unknown, scratch->known + 2 * (i - unknown)};
        for (int c = 0; c < 2; c++) /* to both, since guessing which costs more */
            pairs[0][c] = pairs[1][c] = rgb[1 + c][i] - colour_share(rgb[0][i], colour->of_red[c]);
        unknown += scratch->index[i] == 0;
    }
    encode_stream(scratch, scratch->lanes[0], pixels, out);
    encode_stream(scratch, scratch->unknown, 2 * unknown, out);
    encode_stream(scratch, scratch->known, 2 * (pixels - unknown), out);
}

/* A band of zeroes takes no bytes at all. `values` are those from the band's first on. */
static void encode_band(scratch_t *scratch, const band_t *band, const int64_t *values, output_t *out)
{
    size_t pixels = pack_pixels(scratch, band, values);
    if (pixels == 0) return;
    encode_block(scratch, scratch->mask, (band->pixels + 7) / 8, out);
    if (band->colours)
        encode_colours(scratch, pixels, out);
    else
        for (size_t l = 0; l < band->lanes; l++) encode_stream(scratch, scratch->lanes[l], pixels, out);
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

static result_t encode_streams(scratch_t *scratch, const sum_layout_t *layout, const sum_array_t *sums,
                               zmq_msg_t *message)
{
    size_t bands = band_count(layout, sums->count);
    output_t out = {.size = FRAME_HEADER + 4 * bands};
    out.capacity = out.size + sums->count; /* about what it comes to */
    out.bytes = mem_alloc(out.capacity);
    memset(out.bytes, 0, out.size);
    out.bytes[0] = CODEC_STREAMS;
    put_u32(out.bytes + 4, (uint32_t)bands);
    for (size_t b = 0; b < bands; b++) {
        size_t start = out.size;
        band_t band = band_at(layout, sums->count, b);
        encode_band(scratch, &band, sums->values + band.stride * band.pixel + band.offset, &out);
        put_u32(out.bytes + FRAME_HEADER + 4 * b, (uint32_t)(out.size - start));
    }
    return output_message(&out, message);
}

static void free_values(void *bytes, void *hint)
{
    (void)hint;
    sum_values_free((int64_t *)((uint8_t *)bytes + FRAME_HEADER));
}

/* Takes the values as they are; the header lies before them. */
static result_t wrap(sum_array_t *sums, zmq_msg_t *message)
{
    uint8_t *bytes = (uint8_t *)sums->values - FRAME_HEADER;
    memset(bytes, 0, FRAME_HEADER);
    bytes[0] = CODEC_RAW;
    size_t size = FRAME_HEADER + sums->count * sizeof *sums->values;
    if (zmq_msg_init_data(message, bytes, size, free_values, NULL) != 0)
        return result_fail(RESULT_LIMIT, "no memory for a payload of %zu bytes", size);
    *sums = (sum_array_t){0};
    return result_ok();
}
_Static_assert((int)FRAME_HEADER <= (int)SUM_HEADROOM, "no room for the header");

int payload_count(const zmq_msg_t payload[BATCH_PAYLOADS])
{
    int count = BATCH_PAYLOADS;
    while (count > BATCH_BASE_PAYLOADS && zmq_msg_size(&payload[count - 1]) == 0) count--;
    return count;
}

static void open_all(zmq_msg_t payload[BATCH_PAYLOADS])
{
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_init(&payload[i]);
}

/* None is left open where something failed. */
static result_t close_failed(result_t result, zmq_msg_t payload[BATCH_PAYLOADS])
{
    for (int i = 0; i < BATCH_PAYLOADS && result.code != RESULT_OK; i++) zmq_msg_close(&payload[i]);
    return result;
}

result_t payload_encode(const batch_t *batch, zmq_msg_t payload[BATCH_PAYLOADS])
{
    scratch_t *scratch = scratch_new();
    if (scratch == NULL) return result_fail(RESULT_LIMIT, "no memory for the compressor");
    result_t result = result_ok();
    open_all(payload);
    for (int i = 0; i < BATCH_PAYLOADS && result.code == RESULT_OK; i++)
        if (batch->sums[i].count > 0)
            result = encode_streams(scratch, &film_sums[i], &batch->sums[i], &payload[i]);
    scratch_free(scratch);
    return close_failed(result, payload);
}

result_t payload_wrap(batch_t *batch, zmq_msg_t payload[BATCH_PAYLOADS])
{
    result_t result = result_ok();
    open_all(payload);
    for (int i = 0; i < BATCH_PAYLOADS && result.code == RESULT_OK; i++)
        if (batch->sums[i].count > 0) result = wrap(&batch->sums[i], &payload[i]);
    return close_failed(result, payload);
}
