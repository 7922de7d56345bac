/* cloud: the density of pbrt-v4's medium "cloud", a sum of octaves of noise that thins out with height. It is
 * worked out where it is asked for: a grid that keeps its finest octave would have a billion cells. */
#ifndef LIGHTMILL_CLOUD_H
#define LIGHTMILL_CLOUD_H

/* At a point, from 0 to 1. parameters: density, wispiness, frequency. */
float cloud_density(const float parameters[3], const float point[3]);
/* No density is larger at heights from `low` to `high`. */
float cloud_most(const float parameters[3], float low, float high);

#endif
