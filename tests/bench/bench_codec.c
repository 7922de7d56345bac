/* bench_codec: sizes and speeds of ways to send a batch's sums, the measurements behind proto/wire/payload.c.
 *
 * The data are made like those of a render at 1920 x 1080 (or WIDTHxHEIGHT given as an argument): eye sums of
 * a few float contributions a sample, and splat frames in which a given share of the pixels was hit.
 * `streams` is our codec; the others are what it was chosen over. Speeds are of CPU time, in raw bytes, on
 * one thread.
 */
#include "proto/wire/wire.h"
#include "tests/clock.h"

#include <blosc.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zstd.h>

enum { BAND_BYTES = 1 << 20 };

static uint64_t random_state = 88172645463325252u; /* xorshift64 */

static double draw(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (double)(random_state >> 11) * 0x1p-53;
}

static double draw_gaussian(void)
{
    return sqrt(-2 * log(1 - draw())) * cos(6.283185307179586 * draw());
}

/* Adds a contribution: log-normal brightness, the colour of a light after a few bounces off three walls. */
static void contribute(int64_t rgb[3], double brightness)
{
    static const double light[3] = {1.7, 1.2, 0.4};
    static const double walls[3][3] = {{0.73, 0.73, 0.73}, {0.65, 0.05, 0.05}, {0.12, 0.45, 0.15}};
    double value = brightness * exp(draw_gaussian()), colour[3] = {light[0], light[1], light[2]};
    for (int bounces = (int)(draw() * 4); bounces >= 0; bounces--) {
        int wall = draw() < 0.6 ? 0 : draw() < 0.5 ? 1 : 2;
        for (int c = 0; c < 3; c++) colour[c] *= walls[wall][c];
    }
    for (int c = 0; c < 3; c++) rgb[c] += film_quantise((float)(value * colour[c]), FILM_DEFAULT_SCALE);
}

static void fill_eye(int64_t *values, size_t triples, int samples)
{
    memset(values, 0, triples * 3 * sizeof *values);
    for (size_t i = 0; i < triples; i++)
        for (int s = 0; s < 5 * samples; s++)
            if (draw() < 0.7) contribute(values + 3 * i, 0.08);
}

static void fill_splat(int64_t *values, size_t triples, double occupancy)
{
    memset(values, 0, triples * 3 * sizeof *values);
    size_t splats = (size_t)(-log1p(-occupancy) * (double)triples);
    for (size_t i = 0; i < splats; i++) contribute(values + 3 * (size_t)(draw() * (double)triples), 0.02);
}

/* ---- the candidates ------------------------------------------------------------------------------------ */

typedef struct {
    const char *name;
    const char *blosc; /* compressor, or NULL: zstd on our own shuffled bytes */
    int level, shuffle;
} candidate_t;

static const candidate_t candidates[] = {{"blosc lz4, byte shuffle", "lz4", 5, BLOSC_SHUFFLE},
                                         {"blosc lz4, bit shuffle", "lz4", 5, BLOSC_BITSHUFFLE},
                                         {"blosc zstd 1, byte shuffle", "zstd", 1, BLOSC_SHUFFLE},
                                         {"blosc zstd 1, bit shuffle", "zstd", 1, BLOSC_BITSHUFFLE},
                                         {"blosc zstd 3, bit shuffle", "zstd", 3, BLOSC_BITSHUFFLE},
                                         {"zstd 1, byte shuffle", NULL, 1, 0},
                                         {"zstd 3, byte shuffle", NULL, 3, 0}};

/* Coded bands one after the other. */
typedef struct {
    uint8_t *bytes;
    size_t *sizes; /* of each band */
} coded_t;

static void shuffle(const int64_t *values, size_t count, uint8_t *out)
{
    for (size_t b = 0; b < 8; b++)
        for (size_t i = 0; i < count; i++) out[b * count + i] = (uint8_t)((uint64_t)values[i] >> (8 * b));
}

static void unshuffle(const uint8_t *in, size_t count, int64_t *values)
{
    memset(values, 0, count * sizeof *values);
    for (size_t b = 0; b < 8; b++)
        for (size_t i = 0; i < count; i++) values[i] |= (int64_t)((uint64_t)in[b * count + i] << (8 * b));
}

static size_t encode(const candidate_t *c, const int64_t *values, size_t count, coded_t *out,
                     uint8_t *scratch)
{
    size_t total = 0, band = BAND_BYTES / sizeof *values;
    for (size_t i = 0, b = 0; i < count; i += band, b++) {
        size_t n = count - i < band ? count - i : band, room = ZSTD_compressBound(n * 8) + BLOSC_MAX_OVERHEAD;
        if (c->blosc != NULL) {
            out->sizes[b] = (size_t)blosc_compress_ctx(c->level, c->shuffle, 8, n * 8, values + i,
                                                       out->bytes + total, room, c->blosc, 0, 1);
        } else {
            shuffle(values + i, n, scratch);
            out->sizes[b] = ZSTD_compress(out->bytes + total, room, scratch, n * 8, c->level);
        }
        total += out->sizes[b];
    }
    return total;
}

static void decode(const candidate_t *c, const coded_t *in, size_t count, int64_t *values, uint8_t *scratch)
{
    size_t at = 0, band = BAND_BYTES / sizeof *values;
    for (size_t i = 0, b = 0; i < count; i += band, b++) {
        size_t n = count - i < band ? count - i : band;
        if (c->blosc != NULL) {
            blosc_decompress_ctx(in->bytes + at, values + i, n * 8, 1);
        } else {
            ZSTD_decompress(scratch, n * 8, in->bytes + at, in->sizes[b]);
            unshuffle(scratch, n, values + i);
        }
        at += in->sizes[b];
    }
}

/* ---- measuring ----------------------------------------------------------------------------------------- */

typedef struct {
    size_t bytes;
    double encode, decode; /* CPU seconds */
    bool same;
} measure_t;

static measure_t measure_candidate(const candidate_t *c, const int64_t *values, size_t count, int64_t *back)
{
    size_t bands = count * 8 / BAND_BYTES + 1;
    coded_t coded = {mem_alloc(2 * count * 8), mem_alloc(bands * sizeof(size_t))};
    uint8_t *scratch = mem_alloc(BAND_BYTES);
    measure_t m = {0};
    double start = clock_cpu();
    m.bytes = encode(c, values, count, &coded, scratch);
    m.encode = clock_cpu() - start;
    start = clock_cpu();
    decode(c, &coded, count, back, scratch);
    m.decode = clock_cpu() - start;
    m.same = memcmp(values, back, count * 8) == 0;
    free(coded.bytes);
    free(coded.sizes);
    free(scratch);
    return m;
}

/* One sample of every tile; or no unit, for a batch with a splat frame alone. */
static void fill_units(batch_t *batch, sum_kind_t kind)
{
    batch->unit_count = kind == SUM_EYE ? job_tile_count(&batch->settings) : 0;
    batch->units = mem_zalloc(batch->unit_count + 1, sizeof *batch->units);
    for (uint32_t t = 0; t < batch->unit_count; t++) batch->units[t] = (unit_t){.tile = t, .count = 1};
}

/* The values as the eye tiles or the splat frame of a batch. */
static measure_t measure_payload(const job_settings_t *settings, sum_kind_t kind, int64_t *values,
                                 bool compress)
{
    batch_t sent, got;
    size_t count = sum_image_values(settings, kind);
    zmq_msg_t payload[BATCH_PAYLOADS];
    measure_t m = {0};
    batch_init(&sent, settings);
    batch_init(&got, settings);
    fill_units(&sent, kind);
    fill_units(&got, kind);
    sum_array_zeroes(&sent.sums[kind], count);
    memcpy(sent.sums[kind].values, values, count * sizeof *values);
    memset(batch_frame(&got, kind), 1, count * sizeof(int64_t)); /* kept and paged in, as in the master */
    double start = clock_cpu();
    result_t result = compress ? payload_encode(&sent, payload) : payload_wrap(&sent, payload);
    m.encode = clock_cpu() - start;
    if (result.code != RESULT_OK) return m;
    m.bytes = zmq_msg_size(&payload[kind]);
    start = clock_cpu();
    result = payload_decode(payload, &got);
    m.decode = clock_cpu() - start;
    m.same = result.code == RESULT_OK && memcmp(values, got.sums[kind].values, count * sizeof *values) == 0;
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    batch_free(&got);
    batch_free(&sent);
    return m;
}

static void report(const char *name, measure_t m, size_t count)
{
    double megabytes = 8e-6 * (double)count;
    printf("  %-28s %8.2f MB  %5.1f %%  encode %6.0f MB/s  decode %6.0f MB/s%s\n", name,
           1e-6 * (double)m.bytes, 100e-6 * (double)m.bytes / megabytes, megabytes / m.encode,
           megabytes / m.decode, m.same ? "" : "  WRONG");
}

static void bench(const char *name, const job_settings_t *settings, sum_kind_t kind, int64_t *values,
                  int64_t *back)
{
    size_t count = sum_image_values(settings, kind);
    printf("%s: %.1f MB raw\n", name, 8e-6 * (double)count);
    report("streams", measure_payload(settings, kind, values, true), count);
    report("raw", measure_payload(settings, kind, values, false), count);
    for (size_t c = 0; c < ARRAY_LENGTH(candidates); c++)
        report(candidates[c].name, measure_candidate(&candidates[c], values, count, back), count);
}

int main(int argc, char **argv)
{
    job_settings_t settings = job_settings_default();
    settings.width = 1920;
    settings.height = 1080;
    settings.features = false;
    if (argc > 1 && sscanf(argv[1], "%dx%d", &settings.width, &settings.height) != 2) {
        fprintf(stderr, "usage: bench_codec [WIDTHxHEIGHT]\n");
        return 1;
    }
    size_t count = sum_image_values(&settings, SUM_SPLAT), triples = count / 3;
    int64_t *values = mem_zalloc(count, sizeof *values), *back = mem_alloc(count * sizeof *back);
    memset(back, 1, count * sizeof *back);
    fill_eye(values, triples, 2);
    bench("eye sums, 4 samples a pixel", &settings, SUM_EYE, values, back);
    const double occupancies[] = {0.01, 0.05, 0.3, 0.8};
    for (size_t i = 0; i < ARRAY_LENGTH(occupancies); i++) {
        char name[80];
        snprintf(name, sizeof name, "splat frame, %.0f %% of the pixels hit", 100 * occupancies[i]);
        fill_splat(values, triples, occupancies[i]);
        bench(name, &settings, SUM_SPLAT, values, back);
    }
    free(values);
    free(back);
    return 0;
}
