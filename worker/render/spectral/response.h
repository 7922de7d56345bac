/* response: what light of each wavelength adds to linear sRGB: the observer and the primaries of the film. */
#ifndef LIGHTMILL_RESPONSE_H
#define LIGHTMILL_RESPONSE_H

#include "common/colour/cie.h"

/* By channel, and nanometre from CIE_FIRST on. */
typedef struct {
    double light[3][CIE_COUNT]; /* of light whose power is 1, in units in which that of D65 is below; */
    double white[3][CIE_COUNT]; /* of D65; each channel adds up to 1 */
    double d65[CIE_COUNT];      /* its power */
} response_t;

void response_init(response_t *response);

#endif
