/* noise: gradient noise and its sums. */
#ifndef LIGHTMILL_NOISE_H
#define LIGHTMILL_NOISE_H

#include "common/vec.h"

/* Perlin's gradient noise (Perlin 2002, "Improving Noise"), 0 at whole numbers, about -1 to 1, repeating
 * after 256. */
float noise(vec3_t p);
/* Sum of octaves of noise, each at 1.99 times the frequency of the one before and `roughness` times its
 * amplitude. */
float noise_fbm(vec3_t p, int octaves, float roughness);
/* The same sum of absolute values, plus a fifth of the amplitude that the next octave would have (which is
 * how pbrt-v3 ends its sum). */
float noise_turbulence(vec3_t p, int octaves, float roughness);

#endif
