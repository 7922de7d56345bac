/* bsdf_files: see bsdf_files.h. */
#include "tests/bsdf_files.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/base.h"

static_assert(sizeof(fourier_header_t) == 64, "as in the file");

/* ---- formulas ------------------------------------------------------------------------------------------ */

double fourier_white(double mu_i, double mu_o, double phi, int channel)
{
    (void)phi, (void)channel;
    return mu_i * mu_o < 0 ? fabs(mu_i) / M_PI : 0;
}

double fourier_glossy(double mu_i, double mu_o, double phi, int channel)
{
    static const double diffuse[] = {0.2, 0.35, 0.1}, sheen[] = {0.6, 0.8, 0.3}, through[] = {0.2, 0.1, 0.3};
    double across = sqrt((1 - mu_i * mu_i) * (1 - mu_o * mu_o)) * cos(phi);
    if (mu_i * mu_o > 0) return fabs(mu_i) * through[channel] * exp(4 * (across + mu_i * mu_o - 1));
    return fabs(mu_i) * (diffuse[channel] / M_PI + sheen[channel] * exp(6 * (across - mu_i * mu_o - 1)));
}

double fourier_skewed(double mu_i, double mu_o, double phi, int channel)
{
    return fourier_glossy(mu_i, mu_o, phi, channel) * (1 - 0.6 * fabs(mu_o));
}

/* ---- files --------------------------------------------------------------------------------------------- */

float fourier_node(uint32_t nodes, uint32_t node)
{
    return node == 0 ? -1 : node == nodes - 1 ? 1 : (float)-cos(M_PI * node / (nodes - 1));
}

/* The coefficients of an even function of the azimuth, from its values. */
static void transform(fourier_formula_t *formula, double mu_i, double mu_o, int channel, uint32_t terms,
                      float *out)
{
    uint32_t samples = 4 * terms;
    double *values = mem_alloc(samples * sizeof *values);
    for (uint32_t j = 0; j < samples; j++)
        values[j] = formula(mu_i, mu_o, M_PI * (j + 0.5) / samples, channel);
    for (uint32_t k = 0; k < terms; k++) {
        double sum = 0;
        for (uint32_t j = 0; j < samples; j++) sum += values[j] * cos(k * M_PI * (j + 0.5) / samples);
        out[k] = (float)(sum * (k == 0 ? 1 : 2) / samples);
    }
    free(values);
}

/* How many terms the longest of the channels has. */
static uint32_t length_of(const float *coefficients, uint32_t channels, uint32_t terms)
{
    uint32_t length = 0;
    for (uint32_t c = 0; c < channels; c++)
        for (uint32_t k = 0; k < terms; k++)
            if (fabsf(coefficients[c * terms + k]) > 1e-6f && k + 1 > length) length = k + 1;
    return length;
}

uint8_t *fourier_file(uint32_t nodes, uint32_t channels, uint32_t terms, float eta,
                      fourier_formula_t *formula, size_t *size)
{
    size_t pairs = (size_t)nodes * nodes, words = 16 + nodes + 3 * pairs, used = 0;
    uint32_t *file = mem_zalloc(words + pairs * channels * terms, sizeof *file);
    uint32_t *series = file + 16 + nodes + pairs;
    float *cosines = (float *)(file + 16), *coefficients = (float *)(file + words);
    float *all = mem_alloc((size_t)channels * terms * sizeof *all);
    for (uint32_t i = 0; i < nodes; i++) cosines[i] = fourier_node(nodes, i);
    for (size_t pair = 0; pair < pairs; pair++) {
        for (uint32_t c = 0; c < channels; c++)
            transform(formula, (double)cosines[pair % nodes], (double)cosines[pair / nodes], (int)c, terms,
                      all + (size_t)c * terms);
        uint32_t length = length_of(all, channels, terms);
        series[2 * pair] = (uint32_t)used;
        series[2 * pair + 1] = length;
        for (uint32_t c = 0; c < channels; c++, used += length)
            memcpy(coefficients + used, all + (size_t)c * terms, length * sizeof *all);
    }
    free(all);
    fourier_header_t header = {.version = 1,
                               .flags = 1,
                               .nodes = nodes,
                               .coefficients = (uint32_t)used,
                               .longest = terms,
                               .channels = channels,
                               .bases = 1,
                               .eta = eta};
    memcpy(header.identifier, "SCATFUN", sizeof header.identifier);
    memcpy(file, &header, sizeof header);
    *size = (words + used) * sizeof *file;
    return (uint8_t *)file;
}
