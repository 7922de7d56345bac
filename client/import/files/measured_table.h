/* measured_table: measured BRDFs of the RGL database (.bsdf files that begin with "tensor_file"), as pbrt-v4
 * reads them (Dupuy and Jakob 2018, "An Adaptive Parameterization for Efficient Material Acquisition and
 * Rendering").
 *
 * All is little-endian. Behind "tensor_file", a NUL, the version (1, 0) and the number of fields follow the
 * fields: the length of the name (2 bytes), the name, the number of dimensions (2 bytes), the type (1 byte;
 * 1: bytes, 10: floats), the offset of the contents in the file (8 bytes), the dimensions (8 bytes each), of
 * which the last varies fastest. What is needed: theta_i, phi_i, wavelengths, ndf, sigma, vndf, luminance,
 * spectra. */
#ifndef LIGHTMILL_MEASURED_TABLE_H
#define LIGHTMILL_MEASURED_TABLE_H

#include "common/scene/blob_builder.h"

/* A table of `width` x `height` numbers for each of its slices. Owned: values. */
typedef struct {
    uint32_t width, height;
    float *values;
} measured_grid_t;

/* blob_measured_t says what its parts mean. Owned: the arrays. */
typedef struct {
    uint32_t azimuths, elevations; /* of outgoing directions; each pair of them is a slice */
    float *azimuth, *elevation;    /* radians, ascending */
    bool isotropic;
    measured_grid_t ndf, sigma;         /* of one slice */
    measured_grid_t visible, luminance; /* of all slices */
    measured_grid_t colours;            /* the same; three numbers each: linear sRGB */
} measured_table_t;

/* Decodes `size` bytes of a file that messages call `name`. Spectra become colours by pbrt-v4's rule for
 * reflectances (spectrum.h). RESULT_INPUT when they are no such table, or one of a part of the azimuths,
 * which pbrt-v4 does not read either. *table is to be freed after a success alone. */
result_t measured_table_decode(const char *name, const uint8_t *data, size_t size, measured_table_t *table);
void measured_table_free(measured_table_t *table);
/* Adds it, with the sums that sampling needs, to the blob's measurements, and returns its index there.
 * Finishing the blob tells when it had no room. */
uint32_t measured_table_add(const measured_table_t *table, blob_builder_t *blob);

#endif
