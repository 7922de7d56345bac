/* octahedral: the equal-area map between the unit square and the sphere (Clarberg 2008, "Fast Equal-Area
 * Mapping of the (Hemi)Sphere using SIMD", Journal of Graphics Tools 13(3)), laid out as in pbrt-v4.
 *
 * The sphere's northern half (z > 0) fills the diamond |u| + |v| < 1 of the square [-1, 1]^2, the southern
 * half the four corners, folded outwards. With r = |u| + |v| on the diamond, a ring r = const is the circle
 * z = 1 - r^2, and positions along its sides are angles: areas on the square are areas on the sphere by a
 * factor of 4 pi (for the unit square).
 */
#ifndef LIGHTMILL_OCTAHEDRAL_H
#define LIGHTMILL_OCTAHEDRAL_H

#include "common/vec.h"

/* The unit direction at a point of [0, 1]^2. */
static inline vec3_t octahedral_to_sphere(vec2_t p)
{
    float u = 2 * p.x - 1, v = 2 * p.y - 1, au = fabsf(u), av = fabsf(v);
    float inside = 1 - (au + av); /* < 0: a corner */
    float r = 1 - fabsf(inside);
    float phi = r > 0 ? 0.25f * PI_F * ((av - au) / r + 1) : 0;
    float across = r * sqrtf(float_max(2 - r * r, 0)); /* the sine of the angle from the pole */
    return vec3(across * copysignf(cosf(phi), u), across * copysignf(sinf(phi), v),
                copysignf(1 - r * r, inside));
}

/* The point of [0, 1]^2 of a unit direction. */
static inline vec2_t octahedral_to_square(vec3_t d)
{
    float ax = fabsf(d.x), ay = fabsf(d.y), az = fabsf(d.z);
    /* sqrt(1 - |z|) without its cancellation near the poles. */
    float r = float_min(sqrtf((ax * ax + ay * ay) / (1 + az)), 1);
    float v = r * atan2f(ay, ax) * (2 * INV_PI_F), u = float_max(r - v, 0);
    if (d.z < 0) {
        float folded = 1 - v;
        v = 1 - u;
        u = folded;
    }
    return (vec2_t){float_clamp(0.5f * (copysignf(u, d.x) + 1), 0, 1),
                    float_clamp(0.5f * (copysignf(v, d.y) + 1), 0, 1)};
}

#endif
