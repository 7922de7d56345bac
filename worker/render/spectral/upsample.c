/* upsample: see upsample.h.
 *
 * DESIGN. The table is Jakob and Hanika's: one part for each component that may be the largest, z; in each,
 * nodes over z and over the two others as shares x and y of it. Two things differ. What is kept and
 * interpolated are the coefficients times q = sqrt(z (1 - z)): towards black and white they grow as 1 / q,
 * and of greys c0 q is z - 1/2, so that interpolation is exact there. And nodes lie closer where the
 * coefficients change fast: z at both ends, x and y at 0 and 1. Colours nearer than DARKEST to black are the
 * spectrum of a brighter colour, scaled; nearer than that to 1 they are taken for 1 - DARKEST.
 *
 * Coefficients are found by Newton's method, damped as Levenberg and Marquardt do it, from those of the node
 * before. It uses +, -, *, / and square roots alone, so that all machines find the same. */
#include "worker/render/spectral/upsample.h"

#include "common/base.h"
#include "common/colour/cie.h"
#include "worker/render/spectral/response.h"

#include <immintrin.h>
#include <stdlib.h>
#include <string.h>

enum { LEVELS = 48, SHARES = 24, STEP = 5, LANES = 4, PLACES = 96 /* the last weighs nothing */ };
static const double DARKEST = 2.5e-3;

struct upsampling {
    float levels[LEVELS], shares[SHARES];             /* z, and x or y, of the nodes */
    float coefficients[3][LEVELS][SHARES][SHARES][3]; /* by the largest component, z, y, x */
};

/* ---- making it ----------------------------------------------------------------------------------------- */

/* What reflects 1 in the neighbourhood of a wavelength, and nothing elsewhere, adds to a colour. */
typedef struct {
    double place[PLACES], weight[3][PLACES];
} observer_t;

static void observe(observer_t *observer)
{
    response_t response;
    response_init(&response);
    memset(observer, 0, sizeof *observer);
    for (int j = 0; j < PLACES; j++) observer->place[j] = 2.0 * j / (PLACES - 2) - 1;
    for (int i = 0; i < CIE_COUNT; i++) {
        int j = i / STEP;
        double part = (double)(i % STEP) / STEP;
        for (int c = 0; c < 3; c++) {
            observer->weight[c][j] += (1 - part) * response.white[c][i];
            if (part > 0) observer->weight[c][j + 1] += part * response.white[c][i];
        }
    }
}

/* A colour, and how it changes with the coefficients: row c is {component c, its derivatives}. */
typedef double colour_t[3][4];

static void colour_of(const observer_t *observer, const double a[3], double q, colour_t colour)
{
    const __m256d half = _mm256_set1_pd(0.5), one = _mm256_set1_pd(1), inverse = _mm256_set1_pd(1 / q);
    const __m256d a0 = _mm256_set1_pd(a[0]), a1 = _mm256_set1_pd(a[1]), a2 = _mm256_set1_pd(a[2]);
    __m256d sums[3][4] = {{{0}}};
    for (int j = 0; j < PLACES; j += LANES) {
        __m256d t = _mm256_loadu_pd(observer->place + j), x = (a0 + t * (a1 + t * a2)) * inverse;
        __m256d root = one / _mm256_sqrt_pd(one + x * x), slope = half * root * root * root * inverse;
        const __m256d values[4] = {half + half * x * root, slope, slope * t, slope * t * t};
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < 4; k++) sums[c][k] += _mm256_loadu_pd(observer->weight[c] + j) * values[k];
    }
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 4; k++)
            colour[c][k] = sums[c][k][0] + sums[c][k][1] + sums[c][k][2] + sums[c][k][3];
}

/* The squared distance from a colour that is wanted. */
static double miss_of(const double wanted[3], colour_t colour)
{
    double sum = 0;
    for (int c = 0; c < 3; c++) sum += (wanted[c] - colour[c][0]) * (wanted[c] - colour[c][0]);
    return sum;
}

/* The step of Levenberg and Marquardt: solves (J^T J + damping) step = J^T (wanted - colour). */
static void step_to(const double wanted[3], colour_t colour, double damping, double step[3])
{
    double m[3][4] = {{0}};
    for (int i = 0; i < 3; i++) {
        for (int c = 0; c < 3; c++) {
            for (int k = 0; k < 3; k++) m[i][k] += colour[c][1 + i] * colour[c][1 + k];
            m[i][3] += colour[c][1 + i] * (wanted[c] - colour[c][0]);
        }
        m[i][i] = m[i][i] * (1 + damping) + 1e-14;
    }
    for (int i = 0; i < 3; i++)
        for (int k = i + 1; k < 3; k++) {
            double factor = m[k][i] / m[i][i];
            for (int l = i; l < 4; l++) m[k][l] -= factor * m[i][l];
        }
    for (int i = 2; i >= 0; i--) {
        step[i] = m[i][3];
        for (int k = i + 1; k < 3; k++) step[i] -= m[i][k] * step[k];
        step[i] /= m[i][i];
    }
}

/* Improves coefficients times q, from which it starts. */
static void find_coefficients(const observer_t *observer, const double wanted[3], double q, double a[3])
{
    enum { MOST_STEPS = 60 };
    const double near_enough = 1e-14, hopeless = 1e8;
    colour_t colour;
    double damping = 1e-6;
    colour_of(observer, a, q, colour);
    double miss = miss_of(wanted, colour);
    for (int i = 0; i < MOST_STEPS && miss > near_enough && damping < hopeless; i++) {
        double step[3], next[3];
        colour_t there;
        step_to(wanted, colour, damping, step);
        for (int k = 0; k < 3; k++) next[k] = a[k] + step[k];
        colour_of(observer, next, q, there);
        double left = miss_of(wanted, there);
        damping *= left < miss ? 0.1 : 10;
        if (!(left < miss)) continue;
        miss = left;
        memcpy(a, next, sizeof next);
        memcpy(colour, there, sizeof there);
    }
}

static double smooth_step(double x)
{
    return x * x * (3 - 2 * x);
}

/* The nodes of one level, of the colours whose largest component is `most`: from grey on. */
static void fill_level(upsampling_t *table, const observer_t *observer, int most, int level)
{
    double z = (double)table->levels[level], q = sqrt(z * (1 - z)), a[3] = {z - 0.5, 0, 0}, row[3];
    memcpy(row, a, sizeof row);
    for (int j = SHARES - 1; j >= 0; j--) {
        memcpy(a, row, sizeof a);
        for (int i = SHARES - 1; i >= 0; i--) {
            double wanted[3];
            wanted[most] = z;
            wanted[(most + 1) % 3] = z * (double)table->shares[i];
            wanted[(most + 2) % 3] = z * (double)table->shares[j];
            find_coefficients(observer, wanted, q, a);
            if (i == SHARES - 1) memcpy(row, a, sizeof row);
            for (int k = 0; k < 3; k++) table->coefficients[most][level][j][i][k] = (float)a[k];
        }
    }
}

upsampling_t *upsampling_new(void)
{
    upsampling_t *table = mem_alloc(sizeof *table);
    observer_t observer;
    observe(&observer);
    for (int i = 0; i < SHARES; i++) table->shares[i] = (float)smooth_step((double)i / (SHARES - 1));
    for (int i = 0; i < LEVELS; i++) {
        double z = smooth_step(smooth_step((double)i / (LEVELS - 1)));
        table->levels[i] = (float)(DARKEST + (1 - 2 * DARKEST) * z);
    }
    for (int most = 0; most < 3; most++)
        for (int i = 0; i < LEVELS; i++) fill_level(table, &observer, most, i);
    return table;
}

void upsampling_destroy(upsampling_t **table)
{
    free(*table);
    *table = NULL;
}

/* ---- looking up ---------------------------------------------------------------------------------------- */

/* The node before `at`, of which there is one behind it; *part is how far `at` lies towards that. */
static int find_node(const float *nodes, int count, float at, float *part)
{
    int low = 0, high = count - 1;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (nodes[middle] <= at)
            low = middle;
        else
            high = middle;
    }
    *part = float_clamp((at - nodes[low]) / (nodes[low + 1] - nodes[low]), 0, 1);
    return low;
}

/* Of a colour between DARKEST and 1. */
static void interpolate(const upsampling_t *table, rgb_t colour, float c[3])
{
    const float rgb[3] = {colour.x, colour.y, colour.z};
    int most = v_longest(colour);
    float z = float_min(rgb[most], table->levels[LEVELS - 1]), up, along, across;
    int level = find_node(table->levels, LEVELS, z, &up);
    int i = find_node(table->shares, SHARES, rgb[(most + 1) % 3] / rgb[most], &along);
    int j = find_node(table->shares, SHARES, rgb[(most + 2) % 3] / rgb[most], &across);
    float inverse = 1 / sqrtf(z * (1 - z));
    c[0] = c[1] = c[2] = 0;
    for (int corner = 0; corner < 8; corner++) {
        int x = corner & 1, y = corner >> 1 & 1, l = corner >> 2;
        const float *node = table->coefficients[most][level + l][j + y][i + x];
        float weight = (x ? along : 1 - along) * (y ? across : 1 - across) * (l ? up : 1 - up) * inverse;
        for (int k = 0; k < 3; k++) c[k] += weight * node[k];
    }
}

/* The spectrum of a colour over `scale`, times that. Greys are constant, and exact. */
static upsampled_t scaled(const upsampling_t *table, rgb_t colour, float scale)
{
    upsampled_t s = {.scale = 2 * colour.x};
    if (colour.x == colour.y && colour.y == colour.z) return s;
    s.scale = scale;
    interpolate(table, v_scale(colour, 1 / scale), s.c);
    return s;
}

upsampled_t upsample_reflectance(const upsampling_t *table, rgb_t colour)
{
    float most = v_max(colour), least = table->levels[0];
    return scaled(table, colour, most > 1 ? most : most < least ? most / least : 1);
}

upsampled_t upsample_unbounded(const upsampling_t *table, rgb_t colour)
{
    return scaled(table, colour, 2 * v_max(colour));
}
