/* contact_sheet: the strategies of bdpt on one page, as Veach (1997, figure 10.2) shows them.
 *
 * Two pyramids, unweighted and weighted: a row for each number of segments, in it the strategies by their
 * number of light vertices s. A cell is the strategy's image, scaled down by a whole factor (means of squares
 * of pixels) so that the sheet stays within CONTACT_SHEET_SIDE, with "s=2 t=3" under it.
 */
#ifndef LIGHTMILL_CONTACT_SHEET_H
#define LIGHTMILL_CONTACT_SHEET_H

#include "common/image/image.h"

enum { CONTACT_SHEET_SIDE = 4096 /* pixels at most, of either side */ };

/* Makes a sheet (channels R, G, B; linear) of an image whose layers strategy_layer (strategy.h) names, for
 * paths of up to `segments` segments, at most STRATEGIES_MAX_SEGMENTS. All cells are scaled by 2^exposure.
 * Strategies without layers leave their place empty. RESULT_LIMIT when memory lacks; otherwise the caller
 * frees the sheet. */
result_t contact_sheet_make(const image_t *image, int segments, double exposure, image_t *sheet);

#endif
