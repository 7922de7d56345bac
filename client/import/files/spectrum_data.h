/* spectrum_data: the tables behind spectrum.h; for spectrum.c only. */
#ifndef LIGHTMILL_SPECTRUM_DATA_H
#define LIGHTMILL_SPECTRUM_DATA_H

#include "common/base.h"
#include "common/colour/cie.h"

/* Where a table's values lie: from `first` by `step`, in nm or eV, or at a list of wavelengths in nm. */
typedef enum { GRID_NANOMETRES, GRID_ELECTRONVOLTS, GRID_LISTED } grid_t;

typedef struct {
    const char *name;
    grid_t grid;
    double first, step;
    const double *lambda; /* GRID_LISTED only */
    const double *value;
    size_t count;
} spectrum_table_t;

/* All that have a name but stdillum-A, which is a formula. Wavelengths ascend. */
extern const spectrum_table_t spectrum_tables[];
extern const size_t spectrum_table_count;

/* n^2 = 1 + sum of b_i l^2 / (l^2 - c_i), with l in micrometres; and n at the d line, as the catalogue has it
 * rounded. */
typedef struct {
    const char *name;
    double d_line;
    double b[3], c[3];
} spectrum_glass_t;
extern const spectrum_glass_t spectrum_glasses[];
extern const size_t spectrum_glass_count;

#endif
