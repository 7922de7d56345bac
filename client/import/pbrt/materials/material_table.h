/* material_table: how a Material's parameters become the blob's record: a row for each material of both
 * dialects. */
#ifndef LIGHTMILL_MATERIAL_TABLE_H
#define LIGHTMILL_MATERIAL_TABLE_H

#include "client/import/pbrt/state/values.h"

/* The row of that name. RESULT_INPUT when the scene's dialect has none, unless pbrt or a lenient import takes
 * another. */
result_t material_find(pbrt_t *p, const char *name, position_t at, size_t *entry);
/* What the material of a row becomes; 0: an interface between media. */
material_kind_t material_kind(size_t entry);
/* Fills the record (zero but for the name) from the parameters; the parts of a mix are left out. */
result_t material_fill(pbrt_t *p, params_t *params, const material_t *material, blob_material_t *record);

#endif
