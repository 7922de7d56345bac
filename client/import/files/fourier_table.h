/* fourier_table: pbrt-v3's tables of BSDFs (.bsdf files that begin with "SCATFUN"): Fourier series between
 * nodes of cosines, as blob_fourier_t has them (Jakob, d'Eon, Jakob and Marschner 2014, "A Comprehensive
 * Framework for Rendering Layered Materials").
 *
 * All numbers are little-endian and of 4 bytes. Behind "SCATFUN" and the version 1 follow: flags (1: a BSDF);
 * the numbers of nodes, of coefficients, of terms of the longest series, of channels (1 or 3), and of bases
 * (1); three numbers for what is not read; the index of refraction; four more that are not read. Then the
 * nodes' cosines; sums for sampling, which are not read; the offset and the number of terms of each series;
 * the coefficients. */
#ifndef LIGHTMILL_FOURIER_TABLE_H
#define LIGHTMILL_FOURIER_TABLE_H

#include "common/scene/blob_builder.h"

/* Owned: the arrays. */
typedef struct {
    uint32_t nodes, channels; /* 1: luminance; 3: luminance, red, blue */
    float eta;
    float *mu;             /* [nodes], ascending */
    blob_series_t *series; /* [outgoing node][incident node]; `first` is an index in the coefficients */
    float *coefficients;
    uint32_t coefficient_count;
} fourier_table_t;

/* Decodes `size` bytes of a file that messages call `name`. RESULT_INPUT when they are no such table, or one
 * with textures or with harmonic extrapolation, which pbrt-v3 does not read either. *table is to be freed
 * after a success alone. */
result_t fourier_table_decode(const char *name, const uint8_t *data, size_t size, fourier_table_t *table);
void fourier_table_free(fourier_table_t *table);
/* Adds it, with what sampling needs, to the blob's fouriers, and returns its index there. Finishing the blob
 * tells when it had no room. */
uint32_t fourier_table_add(const fourier_table_t *table, blob_builder_t *blob);

#endif
