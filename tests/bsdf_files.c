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

/* ---- measured ------------------------------------------------------------------------------------------ */

enum { THETAS = 6, PHIS = 9, WAVES = 5, WIDE = 20, HIGH = 24, FINE = 8 };

/* Trowbridge and Reitz's normals, and the area that they show in a direction. */
static double facets(double theta, double phi, bool isotropic)
{
    const double a2 = 0.16;
    double c = cos(theta), d = c * c * (a2 - 1) + 1;
    return a2 / (M_PI * d * d) * (isotropic ? 1 : 1 + 0.4 * cos(2 * phi));
}

static double shown_area(double theta)
{
    return 0.5 * (cos(theta) + sqrt(cos(theta) * cos(theta) + 0.16 * sin(theta) * sin(theta)));
}

static double theta_at(double x)
{
    return x * x * M_PI / 2;
}

static double phi_at(double y)
{
    return (2 * y - 1) * M_PI;
}

/* The density of visible normals on the unit square. */
static double visible(double theta_o, double phi_o, double x, double y, bool isotropic)
{
    double theta = theta_at(x), phi = phi_at(y), between = isotropic ? phi : phi - phi_o;
    double cosine = cos(theta) * cos(theta_o) + sin(theta) * sin(theta_o) * cos(between);
    return fmax(cosine, 0) * facets(theta, phi, isotropic) / shown_area(theta_o) * 2 * M_PI * M_PI * x *
               sin(theta) +
           1e-4;
}

static double brightness(double x, double y)
{
    return 1 + 0.4 * x - 0.3 * y;
}

/* A file under construction. */
typedef struct {
    uint8_t *bytes;
    size_t fields, data; /* where the next go */
} tensor_t;

static void put(uint8_t *bytes, size_t *at, const void *what, size_t size)
{
    memcpy(bytes + *at, what, size);
    *at += size;
}

/* Adds a field, and returns where its floats go. They need not be aligned, which these are. */
static float *add_field(tensor_t *t, const char *name, uint16_t dimensions, const uint64_t *shape)
{
    uint16_t length = (uint16_t)strlen(name);
    const uint8_t type = 10;
    uint64_t offset = t->data, count = 1;
    put(t->bytes, &t->fields, &length, 2);
    put(t->bytes, &t->fields, name, length);
    put(t->bytes, &t->fields, &dimensions, 2);
    put(t->bytes, &t->fields, &type, 1);
    put(t->bytes, &t->fields, &offset, 8);
    put(t->bytes, &t->fields, shape, 8 * (size_t)dimensions);
    for (uint16_t i = 0; i < dimensions; i++) count *= shape[i];
    t->data += count * sizeof(float);
    return (float *)(void *)(t->bytes + offset);
}

static void add_axis(tensor_t *t, const char *name, uint64_t count, double first, double last)
{
    float *values = add_field(t, name, 1, &count);
    for (uint64_t i = 0; i < count; i++)
        values[i] = count == 1 ? 0 : (float)(first + (last - first) * (double)i / (double)(count - 1));
}

static double along(uint64_t i, uint64_t count)
{
    return (double)i / (double)(count - 1);
}

static void add_normals(tensor_t *t, bool isotropic)
{
    const uint64_t shape[2] = {HIGH, WIDE};
    float *ndf = add_field(t, "ndf", 2, shape), *sigma = add_field(t, "sigma", 2, shape);
    for (uint64_t y = 0; y < HIGH; y++)
        for (uint64_t x = 0; x < WIDE; x++) {
            double theta = theta_at(along(x, WIDE));
            ndf[y * WIDE + x] = (float)facets(theta, phi_at(along(y, HIGH)), isotropic);
            sigma[y * WIDE + x] = (float)shown_area(theta);
        }
}

static void add_slices(tensor_t *t, bool isotropic, bool red, double level)
{
    uint64_t phis = isotropic ? 1 : PHIS;
    const uint64_t normals[4] = {phis, THETAS, HIGH, WIDE}, lights[4] = {phis, THETAS, FINE, FINE},
                   spectra[5] = {phis, THETAS, WAVES, FINE, FINE};
    float *vndf = add_field(t, "vndf", 4, normals), *luminance = add_field(t, "luminance", 4, lights),
          *colours = add_field(t, "spectra", 5, spectra);
    for (uint64_t s = 0; s < phis * THETAS; s++) {
        double theta = along(s % THETAS, THETAS) * 1.4, phi = isotropic ? 0 : phi_at(along(s / THETAS, PHIS));
        for (uint64_t i = 0; i < HIGH * WIDE; i++)
            *vndf++ = (float)visible(theta, phi, along(i % WIDE, WIDE), along(i / WIDE, HIGH), isotropic);
        for (uint64_t i = 0; i < FINE * FINE; i++)
            *luminance++ = (float)brightness(along(i % FINE, FINE), along(i / FINE, FINE));
        for (uint64_t i = 0; i < WAVES * FINE * FINE; i++)
            *colours++ = (float)(brightness(along(i % FINE, FINE), along(i / FINE % FINE, FINE)) * level *
                                 (red ? 1 - 0.2 * (double)(i / (FINE * FINE)) : 1));
    }
}

uint8_t *measured_file(bool isotropic, bool red, double level, size_t *size)
{
    static const char head[] = "tensor_file\0\1\0\10\0\0"; /* and the NUL: 8 fields */
    uint64_t phis = isotropic ? 1 : PHIS;
    tensor_t t = {.fields = sizeof head, .data = 512};
    t.bytes = mem_zalloc(
        1, 512 + 4 * (2 * HIGH * WIDE + 64 + phis * THETAS * (HIGH * WIDE + FINE * FINE * (1 + WAVES))));
    memcpy(t.bytes, head, sizeof head);
    add_axis(&t, "theta_i", THETAS, 0, 1.4);
    add_axis(&t, "phi_i", phis, -M_PI, M_PI);
    add_axis(&t, "wavelengths", WAVES, 400, 700);
    add_normals(&t, isotropic);
    add_slices(&t, isotropic, red, level);
    *size = t.data;
    return t.bytes;
}
