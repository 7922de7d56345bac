/* metals: the indices of refraction that Mitsuba's conductors know by name. */
#ifndef LIGHTMILL_MITSUBA_METALS_H
#define LIGHTMILL_MITSUBA_METALS_H

#include <stdbool.h>

#include "common/vec.h"

/* The complex index eta + i k of a metal, or of another substance that Mitsuba lists with them, as colours
 * (docs/import.md, "equal energy"). An ending "_palik" makes no difference. False: the name is not known. */
bool metal_index(const char *name, rgb_t *eta, rgb_t *k);

#endif
