/* bsdf_files: materials that are a table in a file of their own. */
#ifndef LIGHTMILL_PBRT_BSDF_FILES_H
#define LIGHTMILL_PBRT_BSDF_FILES_H

#include "client/import/pbrt/state/state.h"

/* pbrt-v3's fourier material. Without its file, or with one that is no table, it is black, as in pbrt. */
result_t pbrt_read_fourier(pbrt_t *p, params_t *params, position_t at, blob_material_t *record);
/* pbrt-v4's measured material. Without its file, or with one that is no table, it is an error, or of a
 * lenient import a diffuse surface. */
result_t pbrt_read_measured(pbrt_t *p, params_t *params, position_t at, blob_material_t *record);

#endif
