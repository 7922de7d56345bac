/* colour_spaces: what the numbers of an rgb value mean. */
#ifndef LIGHTMILL_PBRT_COLOUR_SPACES_H
#define LIGHTMILL_PBRT_COLOUR_SPACES_H

#include "client/import/pbrt/state/state.h"

result_t pbrt_color_space(pbrt_t *p, position_t at);
/* Linear sRGB of an rgb value in the current colour space. `emitted`: a light, whose white stays what it is;
 * otherwise white stays white. Components may come out negative. */
rgb_t pbrt_srgb(const pbrt_t *p, rgb_t rgb, bool emitted);
/* The colour space, 0 for sRGB, with these x and y of red, green, blue and white; false when pbrt-v4 has
 * none. */
bool pbrt_find_colour_space(const float xy[4][2], size_t *space);
/* What takes the rgb of a colour space to linear sRGB; `emitted` as above. */
affine_t pbrt_srgb_from(size_t space, bool emitted);
/* What white, (1, 1, 1), becomes when a film is balanced to daylight of a temperature: by von Kries's rule in
 * Bradford's cone responses. */
rgb_t pbrt_white_balance(double kelvin);

#endif
