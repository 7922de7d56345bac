/* daylight_emitter: Mitsuba's sky, sun and sunsky.
 *
 * The sun is that of Preetham, Shirley and Smits (1999), as in Mitsuba; the sky is theirs as well, where
 * Mitsuba has that of Hosek and Wilkie (2012).
 */
#ifndef LIGHTMILL_MITSUBA_DAYLIGHT_EMITTER_H
#define LIGHTMILL_MITSUBA_DAYLIGHT_EMITTER_H

#include "client/import/mitsuba/property.h"

/* Adds what an emitter sky, sun or sunsky says. `world_from_light`: its transform, a rotation that may mirror
 * as well. RESULT_INPUT: the sun is below the horizon, or a parameter is out of its range. */
result_t daylight_emitter_add(mitsuba_t *m, const element_t *emitter, const affine_t *world_from_light);
/* Adds the sky and the large sun that Mitsuba gives to a scene without any emitter. */
result_t daylight_emitter_default(mitsuba_t *m, position_t at);

/* Where the sun stands at a time (universal, hours of the day) and a place (degrees, north and east): its
 * angle from the zenith, and its azimuth from north by east, in radians. Source: Blanco-Muriel, Alarcon-
 * Padilla, Lopez-Moratalla and Lara-Coira (2001), "Computing the Solar Vector". */
void sun_position(int year, int month, int day, double hours, double latitude, double longitude,
                  double *zenith, double *azimuth);

#endif
