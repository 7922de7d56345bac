/* named_media: the media that pbrt knows by name, for subsurface scattering and as presets of media. */
#ifndef LIGHTMILL_PBRT_NAMED_MEDIA_H
#define LIGHTMILL_PBRT_NAMED_MEDIA_H

#include "common/vec.h"

/* The coefficients of absorption and of scattering, the latter reduced (as if it scattered evenly), per mm;
 * false when the name is unknown. */
bool named_medium_coefficients(const char *name, rgb_t *absorption, rgb_t *scattering);

/* What a deep layer of the medium reflects of white light, diffusely and without a surface; false when the
 * name is unknown. By the dipole's diffuse reflectance without internal reflection (Jensen, Marschner, Levoy
 * and Hanrahan 2001, equation 15 with A = 1). */
bool named_medium_colour(const char *name, rgb_t *colour);

#endif
