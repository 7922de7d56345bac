/* reference: the images that another renderer made (tests/references/README.md). Calls end the test or the
 * bench on failure. */
#ifndef LIGHTMILL_REFERENCE_H
#define LIGHTMILL_REFERENCE_H

#include "client/image/agreement.h"
#include "common/film/film.h"

/* The reference of a scene: its mean, and as variance the square of its standard error. */
estimate_image_t reference_read(const char *scene);
/* A film as an estimate; the variance is what its two halves tell. */
estimate_image_t reference_estimate(const film_t *film);
/* The relative error of an image as film_noise means it, with the brightness and the mean of the reference;
 * what the noise of the reference itself adds is taken off. */
double reference_error(const estimate_image_t *image, const estimate_image_t *reference);

#endif
