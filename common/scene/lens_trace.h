/* lens_trace: rays through a lens of spherical elements, as in pbrt's realistic camera (Kolb, Mitchell and
 * Hanrahan 1995, "A Realistic Camera Model for Computer Graphics").
 *
 * Everything is in camera space: the film lies at z = 0, the lens on the axis before it, the scene beyond
 * (+z). Elements are surfaces between two materials, the first next to the scene. A ray that leaves an
 * element's aperture, or is reflected as a whole, does not get through.
 */
#ifndef LIGHTMILL_LENS_TRACE_H
#define LIGHTMILL_LENS_TRACE_H

#include "common/base.h"
#include "common/scene/blob_format.h"

typedef struct {
    double x, y, z;
} lens_vec_t;

/* The direction has any length but 0. */
typedef struct {
    lens_vec_t origin, direction;
} lens_ray_t;

/* A lens; the arrays are the caller's. */
typedef struct {
    const blob_lens_element_t *elements; /* from the scene to the film */
    uint32_t count;                      /* > 0 */
    const float *aperture; /* what the stop lets through (blob_scene_t), +y above, in the order of a blob's
                              image; NULL: round */
    uint32_t aperture_width, aperture_height;
} lens_t;

/* Where the last element's surface, and where the first one's, meets the axis. */
double lens_rear(const lens_t *lens);
double lens_front(const lens_t *lens);

/* Takes a ray that starts before the lens's rear, towards +z, to where it leaves the first element. Returns
 * how much gets through: 0 or 1, or what the stop's aperture says. Of 0 the ray is anywhere. */
float lens_trace_from_film(const lens_t *lens, lens_ray_t *ray);
/* The other way round: from before the lens's front, towards -z, to the last element; the stop is round. */
bool lens_trace_from_scene(const lens_t *lens, lens_ray_t *ray);

#endif
