/* bsdf: Mitsuba's materials. docs/import.md says what each becomes. */
#ifndef LIGHTMILL_MITSUBA_BSDF_H
#define LIGHTMILL_MITSUBA_BSDF_H

#include "client/import/mitsuba/property.h"

/* The material of a shape: its last bsdf. Of a shape from an OBJ file, whose material is called `wanted` (""
 * where it has none), those of other names do not count. `wanted` NULL: it is from no OBJ file. *given is
 * false where it has none. `flipped`: see texture.h. */
result_t bsdf_of_shape(mitsuba_t *m, const element_t *shape, const char *wanted, bool flipped,
                       material_t *material, bool *given);
/* The material of a shape that is given none: a diffuse one that reflects half, or nothing where the shape
 * emits; what holds a medium is invisible. */
material_t bsdf_default(mitsuba_t *m, const element_t *shape);

#endif
