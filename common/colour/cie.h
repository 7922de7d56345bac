/* cie: how the eye sees light of each wavelength, and the light that is white: tables of CIE 15. */
#ifndef LIGHTMILL_CIE_H
#define LIGHTMILL_CIE_H

enum { CIE_FIRST = 360, CIE_COUNT = 471 }; /* nm; one entry a nanometre */

/* xbar, ybar, zbar of the CIE 1931 2-degree observer. */
extern const double cie_observer[3][CIE_COUNT];

enum { CIE_D65_FIRST = 300, CIE_D65_STEP = 10, CIE_D65_COUNT = 54 }; /* nm */

/* Relative power of daylight, the white of sRGB; linear in between. */
extern const double cie_d65[CIE_D65_COUNT];

#endif
