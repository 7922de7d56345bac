/* bsdf: Mitsuba's materials. docs/import.md says what each becomes. */
#ifndef LIGHTMILL_MITSUBA_BSDF_H
#define LIGHTMILL_MITSUBA_BSDF_H

#include "client/import/mitsuba/property.h"

/* The material of a shape: its bsdf of that name, else its first; a diffuse one that reflects half where it
 * has none. `wanted` NULL: the first. `flipped`: see texture.h. */
result_t bsdf_of_shape(mitsuba_t *m, const element_t *shape, const char *wanted, bool flipped,
                       material_t *material);

#endif
