/* lens: what is found out about a lens of elements when a scene is imported: where it must stand for what is
 * at some distance to be sharp, and through which part of it light gets to a place on the film.
 */
#ifndef LIGHTMILL_LENS_H
#define LIGHTMILL_LENS_H

#include "common/base.h"
#include "common/scene/lens_trace.h"

/* The distance from the last element to the film at which the plane so far from the film is sharp, by the
 * lens's cardinal points, which two rays parallel to the axis and `height` from it find, as in pbrt (Pharr,
 * Jakob and Humphreys, PBR 3rd edition, 6.4.3). The last element's thickness may be anything. RESULT_INPUT
 * when such a ray does not get through, or when the lens cannot focus so near: the message is a part of a
 * sentence that begins with the lens. */
result_t lens_focus(const lens_t *lens, double height, double distance, double *thickness);

/* Fills LENS_PUPILS boxes (blob_pupil_t) for a focused lens and a film whose corners are `radius` from the
 * axis. They hold everything that light may pass: a little more than the pupil. One through which nothing
 * passes is empty. False when all are. */
bool lens_find_pupils(const lens_t *lens, double radius, blob_pupil_t pupils[LENS_PUPILS]);

#endif
