/* spectrum: sampled spectra, and what an RGB renderer makes of them: linear sRGB.
 *
 * Everything is weighted by the CIE 1931 2-degree observer, summed from 360 to 830 nm by 1 nm, and taken to
 * the sRGB primaries; a component that comes out negative (a colour outside of sRGB) is set to 0.
 * docs/import.md has the equations and says which rule is whose.
 */
#ifndef LIGHTMILL_SPECTRUM_H
#define LIGHTMILL_SPECTRUM_H

#include "client/import/scene/report.h"
#include "common/scene/blob_format.h"

/* Samples over wavelength in nm, ascending without equals, at least one; linear between them, constant beyond
 * the ends. Values lie within +-1e30. Owned: see spectrum_free. */
typedef struct {
    double *lambda, *value;
    size_t count;
} spectrum_t;

void spectrum_free(spectrum_t *spectrum);

/* A spectrum from `count` numbers: wavelength, value, wavelength, value ... in any order. The caller frees
 * *out; after an error it is empty. Errors name `at`: an odd count, no pairs, a number that is not finite or
 * too large, a wavelength below 0 or given twice. */
result_t spectrum_from_pairs(const double *numbers, size_t count, position_t at, spectrum_t *out);

/* The same from a text file (.spd): numbers between blanks, '#' starts a comment up to the line's end. Errors
 * name the path and the line. */
result_t spectrum_read(const char *path, spectrum_t *out);

/* One of pbrt-v4's spectra by its name ("metal-Cu-eta"); false when there is none of that name. The caller
 * frees *out. A glass is its index by Sellmeier's formula, by 5 nm, and at 587.56 nm. */
bool spectrum_named(const char *name, spectrum_t *out);

/* The value at a wavelength in nm: for what has no colour, such as the index of a dielectric. */
double spectrum_at(const spectrum_t *spectrum, double lambda);
/* The yellow line of helium, at which indices of glass are given, in nm. */
#define SPECTRUM_D_LINE 587.56

/* What a spectrum stands for, and whose rules make a colour of it. */
typedef enum { SPECTRUM_REFLECTANCE, SPECTRUM_EMISSION, SPECTRUM_INDEX } spectrum_use_t;
typedef enum { SPECTRUM_PBRT_V3, SPECTRUM_PBRT_V4 } spectrum_rules_t;

/* Linear sRGB by the rules of a program: v3 takes all for equal energy, times 470/471, so that the constant 1
 * becomes (1.202, 0.946, 0.907); v4 takes reflectances and the indices of metals under D65, where it becomes
 * (1, 1, 1), an emission with D65 as (1, 1, 1) and its luminance made 1 (black when it has none). */
rgb_t spectrum_colour(const spectrum_t *spectrum, spectrum_use_t use, spectrum_rules_t rules);

/* What the spectrum of light is to be multiplied by, so that the renderer's film shows the colour that
 * spectrum_colour makes of it: 0 when it has none. (To the film D65 with 100 at 560 nm is 100.) */
double spectrum_emission_scale(const spectrum_t *spectrum, spectrum_rules_t rules);
/* The spectrum, times `scale`, as blobs have it. A sample is the mean about its wavelength, as interpolation
 * weighs it, so that narrow lines keep their light. False when a sample is larger than a blob's may be;
 * negative ones are 0. */
bool spectrum_resample(const spectrum_t *spectrum, double scale, blob_spectrum_t *out);

/* What each of `count` samples of a reflectance, at wavelengths in nm that ascend, adds to its colour by the
 * rules of v4: weights[3 i + c] of sample i to channel c. Components that come out negative are the caller's.
 */
void spectrum_reflectance_weights(const double *lambda, size_t count, double *weights);

/* A black body's emission, at a temperature above 0 in kelvin, by 1 nm over the observer's range; as v3 has
 * it: the greatest value over all wavelengths is 1. The caller frees it. */
spectrum_t spectrum_of_blackbody(double kelvin);
/* Linear sRGB of a black body's emission, at a temperature in kelvin; black when that is not above 0. v3:
 * Planck's law with its greatest value over all wavelengths made 1. v4: with its luminance made 1. */
rgb_t spectrum_blackbody(double kelvin, spectrum_rules_t rules);

/* The luminance of the constant 1, which pbrt-v4 does not divide by where a medium emits by itself. */
#define SPECTRUM_LUMINANCE_OF_1 106.856895
/* The same with Planck's law's greatest value made 1, as pbrt-v4 has it in media. */
rgb_t spectrum_glow(double kelvin);

#endif
