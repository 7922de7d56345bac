/* fourier_table: see fourier_table.h.
 *
 * DESIGN. pbrt-v3 samples by sums in the file: a cosine, by the spline through them; then an azimuth, by
 * searching where the integral of its series reaches a random number. Both assume that neither becomes
 * negative, which series and splines do somewhere, by a little. What is drawn then has another density than
 * the claimed one, and a bidirectional renderer, which weighs strategies by densities, is biased. So here
 * cells are drawn, of constant density each, whose probabilities are made of the table: exact, whatever the
 * table says, and quicker. A part of all probability goes to all cells alike, so that none is left out that
 * the splines reach. */
#include "client/import/files/fourier_table.h"

#include <stdlib.h>
#include <string.h>

enum { HEADER_SIZE = 64, IDENTIFIER_SIZE = 8 };
/* What the cells share out evenly. */
static const double even_part = 1.0 / 32;

/* ---- decoding ------------------------------------------------------------------------------------------ */

typedef struct {
    uint32_t flags, nodes, coefficients, longest, channels, bases;
    float eta;
} header_t;

static header_t read_header(const uint8_t *data)
{
    header_t h;
    memcpy(&h, data + IDENTIFIER_SIZE, 6 * sizeof(uint32_t));
    memcpy(&h.eta, data + IDENTIFIER_SIZE + 9 * sizeof(uint32_t), sizeof h.eta);
    return h;
}

static result_t check_header(const char *name, const header_t *h, size_t size)
{
    if (h->flags != 1 || h->bases != 1)
        return result_fail(
            RESULT_INPUT,
            "%s: is a table with textures or harmonic extrapolation (flags %u, %u bases), which "
            "pbrt-v3 does not read either",
            name, h->flags, h->bases);
    if (h->nodes < 2 || h->nodes > BLOB_MAX_FOURIER_NODES)
        return result_fail(RESULT_INPUT, "%s: has %u cosines, must be 2 to %d", name, h->nodes,
                           BLOB_MAX_FOURIER_NODES);
    if (h->channels != 1 && h->channels != 3)
        return result_fail(RESULT_INPUT, "%s: has %u channels, must be 1 or 3", name, h->channels);
    if (!(h->eta >= 0.01f && h->eta <= 100))
        return result_fail(RESULT_INPUT, "%s: its index of refraction is %g, must be 0.01 to 100", name,
                           (double)h->eta);
    uint64_t needed =
        HEADER_SIZE + 4 * (h->nodes + 3 * (uint64_t)h->nodes * h->nodes + (uint64_t)h->coefficients);
    if (size < needed)
        return result_fail(RESULT_INPUT,
                           "%s: has %zu bytes, but %llu are needed for %u cosines and %u "
                           "coefficients; truncated?",
                           name, size, (unsigned long long)needed, h->nodes, h->coefficients);
    return result_ok();
}

/* *data moves behind what is copied. */
static void *copy_words(const uint8_t **data, size_t count)
{
    size_t size = count * sizeof(uint32_t);
    void *copy = mem_alloc(size + 1);
    memcpy(copy, *data, size);
    *data += size;
    return copy;
}

static result_t check_nodes(const char *name, const fourier_table_t *table)
{
    const float least = 1e-12f;
    bool good = table->mu[0] >= -1 && table->mu[table->nodes - 1] <= 1;
    for (uint32_t i = 1; i < table->nodes; ++i) good = good && table->mu[i] - table->mu[i - 1] >= least;
    return good ? result_ok() : result_fail(RESULT_INPUT, "%s: its cosines do not ascend from -1 to 1", name);
}

/* Series may share coefficients, but not so often that a small file takes long. */
static result_t check_series(const char *name, const header_t *h, const fourier_table_t *table)
{
    uint64_t terms = 0, most = 4 * (uint64_t)table->coefficient_count + (1u << 24);
    for (size_t i = 0; i < (size_t)table->nodes * table->nodes; ++i) {
        blob_series_t s = table->series[i];
        uint64_t length = (uint64_t)s.count * table->channels;
        if (s.count > h->longest || s.count > BLOB_MAX_FOURIER_ORDER ||
            (s.count > 0 && s.first + length > table->coefficient_count))
            return result_fail(
                RESULT_INPUT,
                "%s: series %zu has %u terms from coefficient %u on; there are %u coefficients, "
                "and a series has at most %u terms",
                name, i, s.count, s.first, table->coefficient_count,
                h->longest < BLOB_MAX_FOURIER_ORDER ? h->longest : (uint32_t)BLOB_MAX_FOURIER_ORDER);
        terms += length;
    }
    if (terms > most)
        return result_fail(RESULT_INPUT, "%s: its series have %llu terms of %u coefficients", name,
                           (unsigned long long)terms, table->coefficient_count);
    return result_ok();
}

static result_t check_coefficients(const char *name, const fourier_table_t *table)
{
    const float largest = 1e9f;
    for (uint32_t i = 0; i < table->coefficient_count; ++i)
        if (!(fabsf(table->coefficients[i]) <= largest))
            return result_fail(RESULT_INPUT, "%s: coefficient %u is not finite, or over 1e9", name, i);
    return result_ok();
}

result_t fourier_table_decode(const char *name, const uint8_t *data, size_t size, fourier_table_t *table)
{
    *table = (fourier_table_t){0};
    if (size < HEADER_SIZE || memcmp(data, "SCATFUN\x01", IDENTIFIER_SIZE) != 0)
        return result_fail(RESULT_INPUT, "%s: does not begin with SCATFUN, version 1; no table of a BSDF",
                           name);
    header_t h = read_header(data);
    TRY(check_header(name, &h, size));
    size_t pairs = (size_t)h.nodes * h.nodes;
    *table = (fourier_table_t){
        .nodes = h.nodes, .channels = h.channels, .eta = h.eta, .coefficient_count = h.coefficients};
    data += HEADER_SIZE;
    table->mu = copy_words(&data, h.nodes);
    data += pairs * sizeof(float); /* pbrt's sums */
    table->series = copy_words(&data, 2 * pairs);
    table->coefficients = copy_words(&data, h.coefficients);
    result_t result = check_nodes(name, table);
    if (result.code == RESULT_OK) result = check_series(name, &h, table);
    if (result.code == RESULT_OK) result = check_coefficients(name, table);
    if (result.code != RESULT_OK) fourier_table_free(table);
    return result;
}

void fourier_table_free(fourier_table_t *table)
{
    free(table->mu);
    free(table->series);
    free(table->coefficients);
    *table = (fourier_table_t){0};
}

/* ---- cells --------------------------------------------------------------------------------------------- */

/* At how many azimuths a cell is looked at. */
enum { LOOKS = 4, AZIMUTHS = FOURIER_AZIMUTHS * LOOKS };

static double azimuth_edge(uint32_t k)
{
    double t = (double)k / FOURIER_AZIMUTHS;
    return M_PI * t * t;
}

/* cos(k phi) for the terms of a series: [k][AZIMUTHS]. */
static float *cosines(uint32_t terms)
{
    float *table = mem_alloc(((size_t)terms + 1) * AZIMUTHS * sizeof *table);
    for (uint32_t j = 0; j < AZIMUTHS; ++j) {
        double low = azimuth_edge(j / LOOKS), high = azimuth_edge(j / LOOKS + 1);
        double phi = low + (high - low) * (j % LOOKS + 0.5) / LOOKS;
        for (uint32_t k = 0; k < terms; ++k) table[(size_t)k * AZIMUTHS + j] = (float)cos(k * phi);
    }
    return table;
}

/* The luminance of a pair of nodes at all azimuths. */
static void luminances(const fourier_table_t *table, const blob_series_t *series, const float *cosine,
                       float *out)
{
    memset(out, 0, AZIMUTHS * sizeof *out);
    for (uint32_t k = 0; k < series->count; ++k) {
        float a = table->coefficients[series->first + k];
        for (uint32_t j = 0; j < AZIMUTHS; ++j) out[j] += a * cosine[(size_t)k * AZIMUTHS + j];
    }
}

/* The integrals of luminance over the cells between two nodes, from what it is at these. */
static void integrate_cells(const float *low, const float *high, double width, double *cells)
{
    for (uint32_t k = 0; k < FOURIER_AZIMUTHS; ++k) {
        double sum = 0, extent = azimuth_edge(k + 1) - azimuth_edge(k);
        for (uint32_t j = k * LOOKS; j < (k + 1) * LOOKS; ++j)
            sum += fmax(0, ((double)low[j] + (double)high[j]) / 2);
        cells[k] = sum / LOOKS * width * extent;
    }
}

/* Sums of `count` weights from 0 to 1. */
static void accumulate(const double *weights, uint32_t count, double total, float *sums)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; ++i) {
        sums[i] = (float)fmin(sum / total, 1);
        sum += weights[i];
    }
    sums[count] = 1;
}

/* The weights of all cells of an outgoing node, with their even part: the whole is 1, or that part alone for
 * a node that sends out nothing. */
static void mend_weights(const fourier_table_t *table, double *cells)
{
    uint32_t intervals = table->nodes - 1;
    double total = 0, extent = ((double)table->mu[intervals] - (double)table->mu[0]) * M_PI;
    for (size_t i = 0; i < (size_t)intervals * FOURIER_AZIMUTHS; ++i) total += cells[i];
    for (uint32_t i = 0; i < intervals; ++i) {
        double width = (double)table->mu[i + 1] - (double)table->mu[i];
        for (uint32_t k = 0; k < FOURIER_AZIMUTHS; ++k) {
            double *cell = &cells[(size_t)i * FOURIER_AZIMUTHS + k];
            double area = width * (azimuth_edge(k + 1) - azimuth_edge(k));
            *cell = even_part * area / extent + (total > 0 ? (1 - even_part) * *cell / total : 0);
        }
    }
}

/* The sums of one outgoing node. `cells`: room for all of its cells. */
static void sum_cells(const fourier_table_t *table, double *cells, float *marginal, float *conditional)
{
    uint32_t intervals = table->nodes - 1;
    double *rows = mem_alloc(intervals * sizeof *rows), total = 0;
    mend_weights(table, cells);
    for (uint32_t i = 0; i < intervals; ++i) {
        rows[i] = 0;
        for (uint32_t k = 0; k < FOURIER_AZIMUTHS; ++k) rows[i] += cells[(size_t)i * FOURIER_AZIMUTHS + k];
        accumulate(cells + (size_t)i * FOURIER_AZIMUTHS, FOURIER_AZIMUTHS, rows[i],
                   conditional + (size_t)i * (FOURIER_AZIMUTHS + 1));
        total += rows[i];
    }
    accumulate(rows, intervals, total, marginal);
    free(rows);
}

static void make_sums(const fourier_table_t *table, float *marginal, float *conditional)
{
    uint32_t n = table->nodes, longest = 0;
    for (size_t i = 0; i < (size_t)n * n; ++i)
        if (table->series[i].count > longest) longest = table->series[i].count;
    float *cosine = cosines(longest), at[2][AZIMUTHS];
    double *cells = mem_alloc((size_t)n * FOURIER_AZIMUTHS * sizeof *cells);
    for (uint32_t o = 0; o < n; ++o) {
        luminances(table, &table->series[(size_t)o * n], cosine, at[0]);
        for (uint32_t i = 0; i + 1 < n; ++i) {
            luminances(table, &table->series[(size_t)o * n + i + 1], cosine, at[(i + 1) % 2]);
            integrate_cells(at[i % 2], at[(i + 1) % 2], (double)table->mu[i + 1] - (double)table->mu[i],
                            cells + (size_t)i * FOURIER_AZIMUTHS);
        }
        sum_cells(table, cells, marginal + (size_t)o * n,
                  conditional + (size_t)o * (n - 1) * (FOURIER_AZIMUTHS + 1));
    }
    free(cells);
    free(cosine);
}

/* ---- adding -------------------------------------------------------------------------------------------- */

/* 2 pi times the integral of a series' mean over mu_i, by the trapezoidal rule: what leaves in a direction of
 * all light that arrives. */
static double scattered(const fourier_table_t *table, uint32_t o, uint32_t channel)
{
    double sum = 0, before = 0;
    for (uint32_t i = 0; i < table->nodes; ++i) {
        blob_series_t s = table->series[(size_t)o * table->nodes + i];
        double a0 = s.count == 0 ? 0 : (double)table->coefficients[s.first + channel * s.count];
        if (i > 0) sum += (a0 + before) / 2 * ((double)table->mu[i] - (double)table->mu[i - 1]);
        before = a0;
    }
    return 2 * M_PI * sum;
}

/* Over the outgoing directions of the outside, by their cosines; over all, where the outside has none. */
static double mean_scattered(const fourier_table_t *table, uint32_t channel)
{
    double sum = 0, weights = 0;
    for (uint32_t o = 0; o + 1 < table->nodes; ++o) {
        double low = fmax((double)table->mu[o], 0), high = (double)table->mu[o + 1];
        if (!(high > low)) continue;
        double weight = high * high - low * low;
        sum += weight * (scattered(table, o, channel) + scattered(table, o + 1, channel)) / 2;
        weights += weight;
    }
    return weights > 0 ? sum / weights : 0.5;
}

static float share(double x)
{
    return x > 1e-3 ? (float)fmin(x, 1) : 1e-3f;
}

static rgb_t albedo(const fourier_table_t *table)
{
    double y = mean_scattered(table, 0);
    if (table->channels == 1) return vec3(share(y), share(y), share(y));
    double r = mean_scattered(table, 1), b = mean_scattered(table, 2);
    return vec3(share(r), share(1.39829 * y - 0.100913 * b - 0.297375 * r), share(b));
}

static uint32_t add_series(const fourier_table_t *table, blob_builder_t *blob)
{
    uint32_t first =
        blob_builder_add(blob, BLOB_SECTION_NUMBERS, table->coefficients, table->coefficient_count);
    size_t count = (size_t)table->nodes * table->nodes;
    blob_series_t *series = mem_alloc(count * sizeof *series);
    for (size_t i = 0; i < count; ++i) {
        uint32_t terms = table->series[i].count; /* without terms there is no first one */
        series[i].count = terms;
        series[i].first = terms > 0 ? first + table->series[i].first : 0;
    }
    uint32_t at = blob_builder_add(blob, BLOB_SECTION_SERIES, series, count);
    free(series);
    return at;
}

uint32_t fourier_table_add(const fourier_table_t *table, blob_builder_t *blob)
{
    uint64_t nodes = table->nodes, sums = nodes * nodes, cells = nodes * (nodes - 1) * (FOURIER_AZIMUTHS + 1);
    float *marginal = mem_alloc(sums * sizeof *marginal),
          *conditional = mem_alloc(cells * sizeof *conditional);
    make_sums(table, marginal, conditional);
    blob_fourier_t record = {
        .nodes = table->nodes, .channels = table->channels, .eta = table->eta, .albedo = albedo(table)};
    record.first_series = add_series(table, blob);
    record.first_node = blob_builder_add(blob, BLOB_SECTION_NUMBERS, table->mu, nodes);
    record.first_marginal = blob_builder_add(blob, BLOB_SECTION_NUMBERS, marginal, sums);
    record.first_conditional = blob_builder_add(blob, BLOB_SECTION_NUMBERS, conditional, cells);
    free(marginal);
    free(conditional);
    return blob_builder_add(blob, BLOB_SECTION_FOURIERS, &record, 1);
}
