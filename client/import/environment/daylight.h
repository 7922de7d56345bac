/* daylight: a sky and its sun (sky.h) as lights of a scene. */
#ifndef LIGHTMILL_DAYLIGHT_H
#define LIGHTMILL_DAYLIGHT_H

#include "client/import/environment/sky.h"
#include "client/import/scene/scene_builder.h"

/* What is seen below the horizon: the sky's ground, nothing, or the horizon's light, which fades to black at
 * the nadir. */
typedef enum { DAYLIGHT_GROUND, DAYLIGHT_BLACK, DAYLIGHT_FADING } daylight_below_t;

typedef struct {
    const sky_t *sky;
    affine_t world_from_sky; /* the sky has y up, its sun over +x */
    double factor;           /* on the sky's radiance, and on the sun's irradiance */
    double stretch;          /* what lies at an angle from the zenith is shown at so many times it: 1 to 2 */
    daylight_below_t below;
    double sun_radius; /* degrees, at most 45; its irradiance does not depend on it */
    position_t at;     /* for messages */
} daylight_t;

/* Adds the light of the sky without its sun: an image of 512 x 256 pixels. RESULT_INPUT as
 * scene_add_light. */
result_t daylight_add_sky(scene_builder_t *scene, const daylight_t *light);
/* Adds the sun: a disc, or, without a radius, a light that comes from one direction. RESULT_INPUT as
 * scene_add_light. */
result_t daylight_add_sun(scene_builder_t *scene, const daylight_t *light);

#endif
