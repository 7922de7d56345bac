/* payload_read: the decoding half of the codec (payload.c says how and why; PROTOCOL.md gives the layout).
 *
 * DESIGN. A frame is read in pieces of some hundred pixels. The planes of a band are decompressed one after
 * the other; a piece is put together from them when it is asked for, in memory that stays in the cache, and
 * added up or stored by the caller before the next one. So decoding a frame of 100 MB takes 2 MB of memory,
 * and the sums go through it once. */
#include "proto/wire/payload_format.h"

#include <stdlib.h>
#include <string.h>
#include <zstd.h>

enum { PIECE_WORDS = PAYLOAD_PIECE / 64, SMALL_BITS = 55, VALUE_BITS = 63 };

/* What is left of a frame or a band. */
typedef struct {
    const uint8_t *bytes;
    size_t size;
} input_t;

/* Values of a band that share their planes. */
typedef struct {
    size_t next; /* in the planes */
    int plane_count;
} stream_t;

struct payload_reader {
    const sum_layout_t *layout;
    size_t size;
    bool damaged;
    size_t values; /* that must come out */
    input_t rest;  /* of the frame: bands, or raw values */
    uint8_t codec;
    const uint8_t *table; /* u32 bytes of each band */
    size_t band_count, next_band;

    /* The band at hand: its planes are decompressed. */
    band_t band;
    size_t next_pixel;                 /* in the band; == band.pixels: no band is at hand */
    stream_t streams[STREAMS];         /* their values lie one after the other in the planes */
    size_t next_index;                 /* in the index */
    uint64_t before[SUM_GROUP_VALUES]; /* where differences are coded: the pixel before */

    uint64_t mask[BAND_PIXELS / 64];
    uint64_t all_marked[PIECE_WORDS];
    int64_t piece[PAYLOAD_PIECE_VALUES];
    int64_t apart[PAYLOAD_PIECE_VALUES]; /* the same values by streams */
    uint8_t planes[PLANES][BAND_VALUES];
    colour_t colours[1 + MAX_COLOURS]; /* from 1 on; 0: none */
    uint8_t index[BAND_PIXELS];        /* the colour of each pixel that is marked */
    ZSTD_DCtx *decompressor;
};

payload_reader_t *payload_reader_new(void)
{
    payload_reader_t *reader = malloc(sizeof *reader);
    if (reader == NULL) return NULL;
    reader->decompressor = ZSTD_createDCtx();
    memset(reader->all_marked, 0xff, sizeof reader->all_marked);
    reader->colours[0] = (colour_t){0};
    if (reader->decompressor != NULL) return reader;
    free(reader);
    return NULL;
}

void payload_reader_free(payload_reader_t **reader)
{
    if (*reader == NULL) return;
    ZSTD_freeDCtx((*reader)->decompressor);
    free(*reader);
    *reader = NULL;
}

/* ---- frames -------------------------------------------------------------------------------------------- */

static uint32_t get_u32(const uint8_t *bytes)
{
    uint32_t value = 0;
    for (int i = 0; i < 4; i++) value |= (uint32_t)bytes[i] << (8 * i);
    return value;
}

static const uint8_t *input_take(input_t *in, size_t size)
{
    if (size > in->size) return NULL;
    const uint8_t *bytes = in->bytes;
    in->bytes += size;
    in->size -= size;
    return bytes;
}

/* Checks a compressed frame's sizes against the number of values that must come out. */
static bool open_bands(payload_reader_t *reader)
{
    reader->band_count = get_u32(reader->rest.bytes - 4);
    if (reader->band_count != band_count(reader->layout, reader->values)) return false;
    reader->table = input_take(&reader->rest, 4 * reader->band_count);
    if (reader->table == NULL) return false;
    uint64_t sum = 0;
    for (size_t b = 0; b < reader->band_count; b++) sum += get_u32(reader->table + 4 * b);
    return sum == reader->rest.size;
}

/* Likewise for values as they are: they make one band. */
static bool open_raw(payload_reader_t *reader)
{
    const sum_layout_t *layout = reader->layout;
    reader->band_count = 0;
    reader->band = (band_t){
        .stride = layout->values, .lanes = layout->values, .pixels = reader->values / layout->values};
    return reader->rest.size == reader->values * sizeof(int64_t);
}

result_t payload_open(payload_reader_t *reader, const zmq_msg_t *payload, sum_kind_t kind, size_t values)
{
    reader->layout = &film_sums[kind];
    reader->size = zmq_msg_size(payload);
    reader->damaged = false;
    reader->values = values;
    reader->rest = (input_t){zmq_msg_data((zmq_msg_t *)payload), reader->size};
    reader->band_count = reader->next_band = reader->next_pixel = 0;
    reader->band = (band_t){0};
    if (reader->size == 0 && (values == 0 || reader->layout->frame)) return result_ok();
    const uint8_t *header = input_take(&reader->rest, FRAME_HEADER);
    reader->codec = header != NULL ? header[0] : CODEC_NONE;
    bool raw = reader->codec == CODEC_RAW,
         bands = reader->codec == CODEC_PLANES || reader->codec == CODEC_STREAMS;
    if (values > 0 && ((raw && open_raw(reader)) || (bands && open_bands(reader)))) return result_ok();
    return result_fail(RESULT_PROTOCOL, "the %s payload of %zu bytes cannot hold %zu values",
                       reader->layout->name, reader->size, values);
}

/* ---- bands --------------------------------------------------------------------------------------------- */

/* Decodes one block, which must give exactly `size` bytes. */
static bool decode_block(payload_reader_t *reader, input_t *in, void *bytes, size_t size)
{
    const uint8_t *header = input_take(in, BLOCK_HEADER);
    if (header == NULL) return false;
    uint32_t word = get_u32(header), coded = word & ~BLOCK_STORED;
    const uint8_t *data = input_take(in, coded);
    if (data == NULL) return false;
    if (!(word & BLOCK_STORED))
        return ZSTD_decompressDCtx(reader->decompressor, bytes, size, data, coded) == size;
    if (coded != size) return false;
    memcpy(bytes, data, size);
    return true;
}

/* The set bits of the mask; SIZE_MAX when one is set beyond the last pixel. */
static size_t mask_count(const uint64_t *mask, size_t pixels)
{
    size_t count = 0;
    for (size_t i = 0; i < pixels / 64; i++) count += (size_t)__builtin_popcountll(mask[i]);
    if (pixels % 64 == 0) return count;
    uint64_t last = mask[pixels / 64];
    return last >> (pixels % 64) ? SIZE_MAX : count + (size_t)__builtin_popcountll(last);
}

/* Decodes a stream of so many values, which lie in the planes from `first` on. */
static bool decode_stream(payload_reader_t *reader, input_t *in, stream_t *stream, size_t first, size_t count)
{
    const uint8_t *planes = input_take(in, 1);
    *stream = (stream_t){.next = first};
    if (planes == NULL || *planes > PLANES) return false;
    for (; stream->plane_count < *planes; stream->plane_count++)
        if (!decode_block(reader, in, reader->planes[stream->plane_count] + first, count)) return false;
    return true;
}

/* Decodes the colours and which pixels have them; counts those without in *unknown. */
static bool decode_colours(payload_reader_t *reader, input_t *in, size_t marked, size_t *unknown)
{
    const uint8_t *number = input_take(in, 1);
    if (number == NULL || *number > MAX_COLOURS) return false;
    for (int i = 1; i <= *number; i++)
        for (int c = 0; c < 2; c++) {
            const uint8_t *share = input_take(in, 4);
            if (share == NULL) return false;
            reader->colours[i].of_red[c] = get_u32(share);
        }
    if (*number == 0)
        memset(reader->index, 0, marked);
    else if (!decode_block(reader, in, reader->index, marked))
        return false;
    uint8_t largest = 0;
    *unknown = 0;
    for (size_t i = 0; i < marked; i++) {
        if (reader->index[i] > largest) largest = reader->index[i];
        *unknown += reader->index[i] == 0;
    }
    return largest <= *number;
}

/* Decodes the streams of a band, in which so many pixels are marked. */
static bool decode_streams(payload_reader_t *reader, input_t *in, size_t marked)
{
    const band_t *band = &reader->band;
    size_t counts[STREAMS] = {marked, marked, marked}, streams = band->lanes, unknown, first = 0;
    if (reader->codec == CODEC_PLANES) {
        streams = 1;
        counts[0] = band->lanes * marked;
    } else if (band->colours) {
        if (!decode_colours(reader, in, marked, &unknown)) return false;
        counts[1] = 2 * unknown;
        counts[2] = 2 * (marked - unknown);
    }
    for (size_t s = 0; s < streams; first += counts[s++])
        if (!decode_stream(reader, in, &reader->streams[s], first, counts[s])) return false;
    return true;
}

static bool decode_band(payload_reader_t *reader, input_t in)
{
    band_t *band = &reader->band;
    size_t mask_bytes = (band->pixels + 7) / 8;
    memset(reader->streams, 0, sizeof reader->streams);
    reader->mask[(band->pixels - 1) / 64] = 0; /* not every byte of the last word is filled below */
    if (in.size == 0) {
        memset(reader->mask, 0, mask_bytes);
        return true;
    }
    if (!decode_block(reader, &in, reader->mask, mask_bytes)) return false;
    size_t marked = mask_count(reader->mask, band->pixels);
    return marked != SIZE_MAX && decode_streams(reader, &in, marked) && in.size == 0;
}

static bool next_band(payload_reader_t *reader)
{
    size_t size = get_u32(reader->table + 4 * reader->next_band);
    input_t in = {input_take(&reader->rest, size), size};
    reader->band = band_at(reader->layout, reader->values, reader->next_band++);
    reader->next_pixel = reader->next_index = 0;
    memset(reader->before, 0, sizeof reader->before);
    return decode_band(reader, in);
}

/* ---- pieces -------------------------------------------------------------------------------------------- */

/* Puts values together from `planes` bytes each; inlined for each number of planes, for vector code. */
static inline void join_planes(const payload_reader_t *reader, size_t next, int64_t *restrict values,
                               size_t count, int planes)
{
    const uint8_t *plane[PLANES];
    for (int p = 0; p < planes; p++) plane[p] = reader->planes[p] + next;
    for (size_t i = 0; i < count; i++) {
        uint64_t z = 0;
        for (int p = 0; p < planes; p++) z |= (uint64_t)plane[p][i] << (8 * p);
        values[i] = (int64_t)(z >> 1 ^ (0 - (z & 1)));
    }
}

#define JOIN_CASE(planes)                                                                                    \
    case planes:                                                                                             \
        join_planes(reader, stream->next, values, count, planes);                                            \
        break;

/* The next values of a stream. */
static void join(const payload_reader_t *reader, stream_t *stream, int64_t *values, size_t count)
{
    switch (stream->plane_count) {
        JOIN_CASE(0)
        JOIN_CASE(1)
        JOIN_CASE(2)
        JOIN_CASE(3)
        JOIN_CASE(4)
        JOIN_CASE(5)
        JOIN_CASE(6)
        JOIN_CASE(7)
        JOIN_CASE(PLANES)
    }
    stream->next += count;
}

/* Sets what is known of the size of a piece's values. */
static void set_bits(payload_piece_t *piece, int bits)
{
    piece->bits = bits;
    piece->large = bits > SMALL_BITS;
}

/* Brings the values of a piece's pixels together: those of lane l are `step` apart from lanes[l] on. */
static void interleave(payload_reader_t *reader, const int64_t *const lanes[], size_t step, size_t marked,
                       payload_piece_t *piece)
{
    int planes = 0;
    for (size_t i = 0; i < marked; i++)
        for (size_t l = 0; l < piece->lanes; l++) reader->piece[piece->lanes * i + l] = lanes[l][step * i];
    for (size_t s = 0; s < STREAMS; s++) planes = int_max(planes, reader->streams[s].plane_count);
    set_bits(piece, planes > 0 ? 8 * planes - 1 : 0);
}

/* The same of differences, which become values, of all pixels. */
static void unfold(payload_reader_t *reader, const int64_t *const lanes[], size_t step,
                   payload_piece_t *piece)
{
    size_t next = 0;
    for (size_t i = 0; i < piece->pixels; i++) {
        bool marked = piece->mask[i / 64] >> (i % 64) & 1;
        for (size_t l = 0; l < piece->lanes; l++) {
            if (marked) reader->before[l] += (uint64_t)lanes[l][next];
            reader->piece[piece->lanes * i + l] = (int64_t)reader->before[l];
        }
        if (marked) next += step;
    }
    piece->mask = reader->all_marked;
    set_bits(piece, VALUE_BITS);
}

/* Makes the values of a piece whose green and blue may follow from red. */
static void colour(payload_reader_t *reader, size_t marked, payload_piece_t *piece)
{
    const uint8_t *index = reader->index + reader->next_index;
    int64_t *red = reader->apart, *pairs[2] = {red + marked}, *value = reader->piece;
    uint64_t set = 0;
    size_t unknown = 0;
    for (size_t i = 0; i < marked; i++) unknown += index[i] == 0;
    pairs[1] = pairs[0] + 2 * unknown;
    join(reader, &reader->streams[0], red, marked);
    join(reader, &reader->streams[1], pairs[0], 2 * unknown);
    join(reader, &reader->streams[2], pairs[1], 2 * (marked - unknown));
    for (size_t i = 0; i < marked; i++, value += 3) {
        const colour_t *known = &reader->colours[index[i]];
        const int64_t *pair = pairs[index[i] > 0];
        value[0] = red[i];
        for (int c = 0; c < 2; c++)
            value[1 + c] = (int64_t)((uint64_t)pair[c] + colour_share((uint64_t)red[i], known->of_red[c]));
        for (int c = 0; c < 3; c++) set |= (uint64_t)(value[c] < 0 ? ~value[c] : value[c]);
        pairs[index[i] > 0] += 2;
    }
    reader->next_index += marked;
    set_bits(piece, set == 0 ? 0 : 64 - __builtin_clzll(set));
}

static void make_piece(payload_reader_t *reader, payload_piece_t *piece)
{
    const band_t *band = &reader->band;
    const uint64_t *mask = reader->mask + reader->next_pixel / 64;
    size_t left = band->pixels - reader->next_pixel, pixels = left < PAYLOAD_PIECE ? left : PAYLOAD_PIECE;
    size_t marked = 0;
    for (size_t w = 0; 64 * w < pixels; w++) marked += (size_t)__builtin_popcountll(mask[w]);
    *piece = (payload_piece_t){.first = band->pixel + reader->next_pixel,
                               .pixels = pixels,
                               .offset = band->offset,
                               .lanes = band->lanes,
                               .mask = mask,
                               .values = reader->piece};
    reader->next_pixel += pixels;
    bool streams = reader->codec == CODEC_STREAMS;
    if (streams && band->colours) {
        colour(reader, marked, piece);
        return;
    }
    const int64_t *lanes[SUM_GROUP_VALUES];
    for (size_t l = 0; l < band->lanes; l++) {
        lanes[l] = reader->apart + (streams ? l * marked : l);
        if (streams) join(reader, &reader->streams[l], reader->apart + l * marked, marked);
    }
    if (!streams) join(reader, &reader->streams[0], reader->apart, band->lanes * marked);
    if (band->differences)
        unfold(reader, lanes, streams ? 1 : band->lanes, piece);
    else
        interleave(reader, lanes, streams ? 1 : band->lanes, marked, piece);
}

/* Values as they are: a pixel of features is larger than the others, so that a piece has fewer. */
static void make_raw_piece(payload_reader_t *reader, payload_piece_t *piece)
{
    const band_t *band = &reader->band;
    size_t left = band->pixels - reader->next_pixel, room = ARRAY_LENGTH(reader->piece) / band->lanes;
    size_t most = room < PAYLOAD_PIECE ? room : PAYLOAD_PIECE;
    size_t pixels = left < most ? left : most;
    size_t bytes = pixels * band->lanes * sizeof(int64_t);
    memcpy(reader->piece, input_take(&reader->rest, bytes), bytes);
    *piece = (payload_piece_t){.first = reader->next_pixel,
                               .pixels = pixels,
                               .lanes = band->lanes,
                               .mask = reader->all_marked,
                               .values = reader->piece,
                               .bits = VALUE_BITS,
                               .large = true};
    reader->next_pixel += pixels;
}

bool payload_read(payload_reader_t *reader, payload_piece_t *piece)
{
    while (reader->next_pixel == reader->band.pixels && !reader->damaged) {
        if (reader->next_band == reader->band_count) return false;
        reader->damaged = !next_band(reader);
    }
    if (reader->damaged) return false;
    if (reader->codec == CODEC_RAW)
        make_raw_piece(reader, piece);
    else
        make_piece(reader, piece);
    return true;
}

bool payload_lessons_possible(const payload_piece_t *piece, const lesson_limits_t *limits)
{
    const int64_t *value = piece->values;
    bool good = true;
    for (size_t i = 0; i < piece->pixels; i += 64)
        for (uint64_t mask = payload_marked(piece, i); mask != 0; mask &= mask - 1)
            good &= lesson_possible(limits, piece->first + i + (size_t)__builtin_ctzll(mask), *value++);
    return good;
}

result_t payload_end(const payload_reader_t *reader)
{
    if (!reader->damaged) return result_ok();
    return result_fail(RESULT_PROTOCOL, "the %s payload of %zu bytes is damaged", reader->layout->name,
                       reader->size);
}

/* ---- whole frames -------------------------------------------------------------------------------------- */

static void store_piece(const payload_piece_t *piece, size_t stride, int64_t *values)
{
    const int64_t *value = piece->values;
    int64_t *first = values + stride * piece->first + piece->offset;
    if (piece->lanes == stride) memset(first, 0, piece->pixels * stride * sizeof *values);
    for (size_t i = 0; i < piece->pixels; i += 64)
        for (uint64_t mask = payload_marked(piece, i); mask != 0; mask &= mask - 1, value += piece->lanes) {
            int64_t *pixel = first + stride * (i + (size_t)__builtin_ctzll(mask));
            for (size_t l = 0; l < piece->lanes; l++) pixel[l] = value[l];
        }
}

/* Memory that is there is used; more is taken once the payload's sizes are known to be right. */
static result_t decode(payload_reader_t *reader, const zmq_msg_t *payload, sum_kind_t kind, batch_t *batch)
{
    sum_array_t *sums = &batch->sums[kind];
    size_t count = batch_expected_values(batch, kind);
    sums->count = 0;
    TRY(payload_open(reader, payload, kind, count));
    if (reader->size == 0) return result_ok();
    if (sums->capacity < count && !sum_array_try(sums, count))
        return result_fail(RESULT_LIMIT, "no memory for %zu %s values", count, reader->layout->name);
    for (payload_piece_t piece; payload_read(reader, &piece);)
        store_piece(&piece, reader->layout->values, sums->values);
    TRY(payload_end(reader));
    sums->count = count;
    return result_ok();
}

static result_t decode_all(const zmq_msg_t payload[BATCH_PAYLOADS], batch_t *batch, bool frames)
{
    payload_reader_t *reader = payload_reader_new();
    result_t result = reader != NULL ? result_ok() : result_fail(RESULT_LIMIT, "no memory for a decoder");
    for (sum_kind_t k = 0; k < BATCH_SUMS && result.code == RESULT_OK; k++)
        if (frames || !film_sums[k].frame) result = decode(reader, &payload[k], k, batch);
    payload_reader_free(&reader);
    return result;
}

result_t payload_decode(const zmq_msg_t payload[BATCH_PAYLOADS], batch_t *batch)
{
    return decode_all(payload, batch, true);
}

result_t payload_decode_tiles(const zmq_msg_t payload[BATCH_PAYLOADS], batch_t *batch)
{
    return decode_all(payload, batch, false);
}

result_t payload_digest(const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch, hash_t *digest)
{
    batch_t decoded = *batch;
    memset(decoded.sums, 0, sizeof decoded.sums);
    result_t result = payload_decode(payload, &decoded);
    if (result.code == RESULT_OK) batch_digest(&decoded, digest);
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) sum_array_free(&decoded.sums[k]);
    return result;
}

/* ---- some units of a frame ----------------------------------------------------------------------------- */

/* Where the tile of a chosen unit begins, in pixels. */
typedef struct {
    size_t from, pixels; /* in the payload */
    size_t to;           /* among those chosen */
} place_t;

static size_t unit_pixels(const batch_t *batch, sum_kind_t kind, const unit_t *unit)
{
    return sum_unit_values(&batch->settings, kind, unit) / film_sums[kind].values;
}

/* Finds the places of the units of `part`, which are in the order of the batch. */
static void find_places(const batch_t *batch, const batch_t *part, sum_kind_t kind, place_t *places)
{
    size_t from = 0, to = 0, next = 0;
    for (size_t i = 0; i < batch->unit_count && next < part->unit_count; i++) {
        size_t pixels = unit_pixels(batch, kind, &batch->units[i]);
        if (memcmp(&batch->units[i], &part->units[next], sizeof(unit_t)) == 0) {
            places[next++] = (place_t){from, pixels, to};
            to += pixels;
        }
        from += pixels;
    }
}

/* The first place that does not end before a pixel of the payload. */
static size_t place_at(const place_t *places, size_t count, size_t pixel)
{
    size_t low = 0, high = count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if (places[middle].from + places[middle].pixels > pixel)
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

static void store_places(const payload_piece_t *piece, size_t stride, const place_t *places, size_t count,
                         int64_t *values)
{
    const int64_t *value = piece->values;
    size_t at = place_at(places, count, piece->first);
    for (size_t i = 0; i < piece->pixels && at < count; i += 64)
        for (uint64_t mask = payload_marked(piece, i); mask != 0; mask &= mask - 1, value += piece->lanes) {
            size_t pixel = piece->first + i + (size_t)__builtin_ctzll(mask);
            while (at < count && pixel >= places[at].from + places[at].pixels) at++;
            if (at == count || pixel < places[at].from) continue;
            memcpy(values + stride * (places[at].to + pixel - places[at].from) + piece->offset, value,
                   piece->lanes * sizeof *value);
        }
}

/* Passes over bands that none of the places lies in. */
static void skip_bands(payload_reader_t *reader, const place_t *places, size_t count)
{
    while (reader->codec != CODEC_RAW && reader->next_pixel == reader->band.pixels &&
           reader->next_band < reader->band_count) {
        band_t next = band_at(reader->layout, reader->values, reader->next_band);
        size_t at = place_at(places, count, next.pixel);
        if (at < count && places[at].from < next.pixel + next.pixels) return;
        (void)input_take(&reader->rest, get_u32(reader->table + 4 * reader->next_band++));
    }
}

static result_t decode_places(payload_reader_t *reader, const zmq_msg_t *payload, sum_kind_t kind,
                              const batch_t *batch, batch_t *part, place_t *places)
{
    sum_array_t *sums = &part->sums[kind];
    TRY(payload_open(reader, payload, kind, batch_expected_values(batch, kind)));
    if (reader->size == 0) return result_ok();
    find_places(batch, part, kind, places);
    size_t count = batch_expected_values(part, kind);
    if (!sum_array_try(sums, count))
        return result_fail(RESULT_LIMIT, "no memory for %zu %s values", count, reader->layout->name);
    memset(sums->values, 0, count * sizeof *sums->values);
    sums->count = count;
    skip_bands(reader, places, part->unit_count);
    for (payload_piece_t piece; payload_read(reader, &piece);) {
        store_places(&piece, reader->layout->values, places, part->unit_count, sums->values);
        skip_bands(reader, places, part->unit_count);
    }
    return payload_end(reader);
}

/* Those of the batch's units that are among others (sorted), in the order of the batch. */
static size_t pick_units(const batch_t *batch, const unit_t *sorted, size_t count, unit_t *picked)
{
    size_t found = 0;
    for (size_t i = 0; i < batch->unit_count && found < count; i++)
        if (bsearch(&batch->units[i], sorted, count, sizeof *sorted, unit_order) != NULL)
            picked[found++] = batch->units[i];
    return found;
}

result_t payload_digest_units(const zmq_msg_t payload[BATCH_PAYLOADS], const batch_t *batch,
                              const unit_t *units, size_t count, hash_t *digest)
{
    unit_t *sorted = units_sorted(units, count);
    batch_t part = {.settings = batch->settings, .units = mem_alloc((count + 1) * sizeof *units)};
    place_t *places = mem_alloc((count + 1) * sizeof *places);
    payload_reader_t *reader = payload_reader_new();
    result_t result = reader != NULL ? result_ok() : result_fail(RESULT_LIMIT, "no memory for a decoder");
    part.unit_count = pick_units(batch, sorted, count, part.units);
    for (sum_kind_t k = 0; k < BATCH_SUMS && result.code == RESULT_OK; k++)
        if (!film_sums[k].frame) result = decode_places(reader, &payload[k], k, batch, &part, places);
    if (result.code == RESULT_OK) batch_digest(&part, digest);
    payload_reader_free(&reader);
    batch_free(&part);
    free(places);
    free(sorted);
    return result;
}
