/* lens_file: prescriptions of lenses as pbrt has them (.dat): a surface a row, from the scene to the film, of
 * four numbers: radius of curvature (0: the stop), distance to the next surface along the axis, index of
 * refraction of what lies between, and diameter of the aperture; lengths in mm. '#' starts a comment.
 */
#ifndef LIGHTMILL_LENS_FILE_H
#define LIGHTMILL_LENS_FILE_H

#include "client/import/scene/report.h"
#include "common/scene/blob_format.h"

/* Fills *count of the LENS_MAX_ELEMENTS surfaces, in metres, with radii of apertures; an index of 0
 * becomes 1. The last one's thickness, which focusing sets, may be anything. RESULT_INPUT, which names the
 * file and the line: text that is no number, a number beyond 1e6, an incomplete row, too many or no rows, an
 * aperture or an index that is not above 0, a negative distance. */
result_t lens_file_read(const char *path, blob_lens_element_t elements[LENS_MAX_ELEMENTS], uint32_t *count);

#endif
