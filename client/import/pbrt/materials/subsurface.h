/* subsurface: the materials of both dialects that scatter light below their surface. Each is the interface of
 * a dielectric, over a medium of its own (blob_material_t.body). */
#ifndef LIGHTMILL_PBRT_SUBSURFACE_H
#define LIGHTMILL_PBRT_SUBSURFACE_H

#include "client/import/pbrt/state/values.h"

/* For the rows of material_table.c: make the medium from the parameters, p->body, whose index of refraction
 * the record has already. "subsurface" of v3 and of v4, v3's "kdsubsurface", and what v3's "disney" has by
 * its "scatterdistance". */
result_t pbrt_read_subsurface(pbrt_t *p, params_t *params, position_t at, blob_material_t *record);
result_t pbrt_read_kdsubsurface(pbrt_t *p, params_t *params, position_t at, blob_material_t *record);
result_t pbrt_read_scatter_distance(pbrt_t *p, params_t *params, position_t at, blob_material_t *record);

#endif
