/* upsample: spectra for colours that are given as linear sRGB (Jakob and Hanika 2019, "A Low-Dimensional
 * Function Space for Efficient Spectral Upsampling").
 *
 * A reflectance is S(c0 + c1 t + c2 t^2), where S(x) = 1/2 + x / (2 sqrt(1 + x^2)) and t runs from -1 to 1
 * over the wavelengths of the observer (common/colour/cie.h). It is smooth and lies between 0 and 1. The
 * coefficients are those for which it has its colour under D65, which is the white of sRGB. A table of them
 * over all colours is made when a job needs it, in some tenths of a second, with the same bits everywhere.
 */
#ifndef LIGHTMILL_UPSAMPLE_H
#define LIGHTMILL_UPSAMPLE_H

#include "common/vec.h"

typedef struct upsampling upsampling_t;

upsampling_t *upsampling_new(void);
/* Frees the table and sets *table to NULL. */
void upsampling_destroy(upsampling_t **table);

/* A spectrum: scale S(c[0] + c[1] t + c[2] t^2). */
typedef struct {
    float scale;
    float c[3];
} upsampled_t;

/* The spectrum of a colour without negative components. A reflectance, whose components are at most 1, stays
 * below 1 at each wavelength; what is brighter is the spectrum of the same colour with 1 as its largest
 * component, times that. */
upsampled_t upsample_reflectance(const upsampling_t *table, rgb_t colour);
/* The same of what has no bound, such as light: the spectrum of twice the colour is twice the spectrum. */
upsampled_t upsample_unbounded(const upsampling_t *table, rgb_t colour);
/* What it is at a place t from -1 to 1. */
static inline float upsampled_at(const upsampled_t *s, float t)
{
    float x = s->c[0] + t * (s->c[1] + t * s->c[2]);
    return s->scale * (0.5f + 0.5f * x / sqrtf(1 + x * x));
}

#endif
