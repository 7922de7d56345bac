/* materials: the directives that name materials, and how shapes come to have them. */
#ifndef LIGHTMILL_PBRT_MATERIALS_H
#define LIGHTMILL_PBRT_MATERIALS_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_material(pbrt_t *p, position_t at);
result_t pbrt_make_named_material(pbrt_t *p, position_t at);
result_t pbrt_named_material(pbrt_t *p, position_t at);
/* Makes material 0, which shapes have when none is set. */
void pbrt_default_material(pbrt_t *p);
/* The index in the blob of the current material as a shape with these parameters has it: in v3 they
 * override the material's own. BLOB_NONE: an interface between media, which does nothing to light. */
result_t pbrt_shape_material(pbrt_t *p, params_t *shape_params, uint32_t *index);
/* The material of shapes that have such an interface and part two media. */
uint32_t pbrt_interface_material(pbrt_t *p);
/* Whether the material that shapes get is hair, or (v4) not known yet. */
bool pbrt_material_may_be_hair(const pbrt_t *p);
/* Says, once, that flat curves which are not of hair become round ones. */
void pbrt_warn_of_flat_curves(pbrt_t *p, position_t at);
/* v4: makes the materials of shapes whose names, or the names of their textures, came later. */
result_t pbrt_finish_materials(pbrt_t *p);
/* Checks the materials that no shape has: warnings only. */
void pbrt_check_unused_materials(pbrt_t *p);

#endif
