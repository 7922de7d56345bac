/* named_media: the colours of the materials that pbrt's subsurface scattering knows by name. */
#ifndef LIGHTMILL_PBRT_NAMED_MEDIA_H
#define LIGHTMILL_PBRT_NAMED_MEDIA_H

#include "common/vec.h"

/* What a deep layer of the medium reflects of white light, diffusely and without a surface; false when the
 * name is unknown. By the dipole's diffuse reflectance without internal reflection (Jensen, Marschner, Levoy
 * and Hanrahan 2001, equation 15 with A = 1). */
bool named_medium_colour(const char *name, rgb_t *colour);

#endif
