/* named_media: the media that pbrt knows by name, for subsurface scattering and as presets of media. */
#ifndef LIGHTMILL_PBRT_NAMED_MEDIA_H
#define LIGHTMILL_PBRT_NAMED_MEDIA_H

#include "common/vec.h"

/* The coefficients of absorption and of scattering, the latter reduced (as if it scattered evenly), per mm;
 * false when the name is unknown. */
bool named_medium_coefficients(const char *name, rgb_t *absorption, rgb_t *scattering);

#endif
