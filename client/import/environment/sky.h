/* sky: the light of a clear day: sun and sky after Preetham, Shirley and Smits (1999), "A Practical Analytic
 * Model for Daylight".
 *
 * Directions are unit vectors with y up; the sun stands over +x. Radiance is linear sRGB, scaled so that sun
 * and sky together make a white, diffuse surface that lies flat as bright as radiance 1 (an irradiance of
 * pi). `illuminance` tells what that is in nature. Below the horizon lies a grey ground that is lit by both.
 */
#ifndef LIGHTMILL_SKY_H
#define LIGHTMILL_SKY_H

#include "common/vec.h"

/* Perez' five coefficients, and the value at the zenith over the formula's own there. */
typedef struct {
    double a, b, c, d, e, scale;
} sky_perez_t;

typedef struct {
    double turbidity;      /* haze: 2 is a very clear day, 10 a hazy one */
    double sun_angle;      /* of the sun from the zenith, radians ... */
    double sun[3];         /* ... and where it stands */
    sky_perez_t luminance; /* kcd / m^2 */
    sky_perez_t x, y;      /* chromaticities */
    rgb_t sun_irradiance;  /* of the sun alone, on a surface that faces it */
    rgb_t ground;          /* radiance below the horizon */
    float scale;           /* from kcd / m^2 to radiance */
    double illuminance;    /* klx on flat ground */
} sky_t;

/* The sun's radius as it is seen from here: degrees. */
#define SKY_SUN_RADIUS 0.2665

/* The turbidity of a clear day. */
#define SKY_TURBIDITY 3.0

/* `elevation` of the sun above the horizon, in degrees from 0 to 90; `turbidity` from 2 to 10. */
void sky_init(sky_t *sky, double elevation, double turbidity);
/* The radiance that comes from a direction, the sun's disc apart. */
rgb_t sky_radiance(const sky_t *sky, const double w[3]);

#endif
