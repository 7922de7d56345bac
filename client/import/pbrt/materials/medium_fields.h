/* medium_fields: what varies in a medium of pbrt: densities, temperatures and colours in cells, in NanoVDB
 * files, and clouds. Each reads its parameters and adds fields to the blob; the coefficients of `medium` are
 * there already, times their scale. `at` is the directive. */
#ifndef LIGHTMILL_PBRT_MEDIUM_FIELDS_H
#define LIGHTMILL_PBRT_MEDIUM_FIELDS_H

#include "client/import/pbrt/state/state.h"

/* `density` in nx x ny x nz cells between p0 and p1. */
result_t medium_density_cells(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium);
/* `temperature` in the cells of the density: what a black body of it emits. */
result_t medium_temperature_cells(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium);
/* `Lescale` in the cells of the density. */
result_t medium_emission_cells(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium);

/* `sigma_a`, `sigma_s` and `Le` in cells; `Lescale`. */
result_t medium_tints(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium);
/* `density`, `wispiness` and `frequency` of a cloud between p0 and p1. */
result_t medium_cloud(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium);
/* The density and the temperature of a file, `Lescale`. */
result_t medium_nanovdb(pbrt_t *p, params_t *params, position_t at, blob_medium_t *medium);

#endif
