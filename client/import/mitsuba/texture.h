/* texture: Mitsuba's textures, and colours and numbers that may be one.
 *
 * Mitsuba's v = 0 is an image's top row. Its OBJ reader turns v over; here a mesh keeps the file's v, and
 * `flipped` asks for textures that turn it over themselves, so that normal maps see the true direction of v.
 */
#ifndef LIGHTMILL_MITSUBA_TEXTURE_H
#define LIGHTMILL_MITSUBA_TEXTURE_H

#include "client/import/mitsuba/property.h"

/* What a texture is for: colours; one number, the mean or the luminance of its colour; or normals. */
typedef enum { TEXTURE_COLOURS, TEXTURE_MEAN, TEXTURE_LUMINANCE, TEXTURE_NORMALS } texture_use_t;

/* The property of that name: a colour, a number or a texture; `otherwise` in all components where there is
 * none. RESULT_INPUT: a texture that is not supported, unless the import is lenient. */
result_t texture_property(mitsuba_t *m, const element_t *object, const char *name, double otherwise,
                          texture_use_t use, bool flipped, blob_value_t *value);
/* The most that a value is anywhere, of each channel, by what Mitsuba knows of textures: colours of vertices
 * count as white. */
rgb_t texture_most(mitsuba_t *m, const blob_value_t *value);
/* The value of a texture element. */
result_t texture_element(mitsuba_t *m, element_t *texture, texture_use_t use, bool flipped,
                         blob_value_t *value);

#endif
