/* payload_colours: which colours the splats of a band have, so that green and blue follow from red.
 *
 * A splat is a brightness times a colour: what the light and the few surfaces on its path left of each
 * channel. A pixel with one splat so has one of the few dozen colours that a scene makes, but for rounding. A
 * pixel with several splats of different colours has none of them. PROTOCOL.md says how colours are sent.
 */
#ifndef LIGHTMILL_PAYLOAD_COLOURS_H
#define LIGHTMILL_PAYLOAD_COLOURS_H

#include "proto/wire/payload_format.h"

typedef struct colour_finder colour_finder_t;

colour_finder_t *colour_finder_new(void);
void colour_finder_free(colour_finder_t *finder);

/* Finds the colours that pay in the pixels of a band, given as their red, green and blue values, each in an
 * array of its own. Writes them to `colours` and their number to *count; writes to `index` for each pixel the
 * number of its colour from 1 on, or 0 where it has none of them. */
void colour_finder_run(colour_finder_t *finder, const uint64_t *const rgb[3], size_t pixels,
                       colour_t colours[MAX_COLOURS], int *count, uint8_t *index);

#endif
