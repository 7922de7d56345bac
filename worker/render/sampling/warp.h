/* warp: uniform numbers in the unit square to densities on discs, hemispheres, spheres and triangles. */
#ifndef LIGHTMILL_WARP_H
#define LIGHTMILL_WARP_H

#include "common/vec.h"

/* Uniform on the unit disc; concentric, so that strata stay compact (Shirley and Chiu 1997). */
static inline vec2_t warp_disc(vec2_t u)
{
    float x = 2 * u.x - 1, y = 2 * u.y - 1;
    if (x == 0 && y == 0) return (vec2_t){0, 0};
    bool wide = fabsf(x) > fabsf(y);
    float r = wide ? x : y, ratio = wide ? y / x : x / y, angle = PI_F / 4 * ratio;
    float c = cosf(angle), s = sinf(angle);
    return wide ? (vec2_t){r * c, r * s} : (vec2_t){r * s, r * c};
}

/* On the hemisphere about +z with density cos / pi per steradian (Malley's method). */
static inline vec3_t warp_cosine_hemisphere(vec2_t u)
{
    vec2_t d = warp_disc(u);
    return vec3(d.x, d.y, sqrtf(float_max(0, 1 - d.x * d.x - d.y * d.y)));
}

/* Uniform on the unit sphere: density 1 / (4 pi) per steradian. */
static inline vec3_t warp_sphere(vec2_t u)
{
    float z = 1 - 2 * u.x, r = sqrtf(float_max(0, 1 - z * z)), phi = TWO_PI_F * u.y;
    return vec3(r * cosf(phi), r * sinf(phi), z);
}

/* The numbers that warp_sphere takes to a unit direction. */
static inline vec2_t warp_sphere_numbers(vec3_t w)
{
    float turn = atan2f(w.y, w.x) * (0.5f * INV_PI_F);
    return (vec2_t){float_clamp(0.5f - 0.5f * w.z, 0, 1), turn < 0 ? turn + 1 : turn};
}

/* Uniform barycentric coordinates (b1, b2) of a triangle, low distortion (Heitz 2019, "A Low-Distortion Map
 * Between Triangle and Square"). */
static inline vec2_t warp_triangle(vec2_t u)
{
    if (u.y > u.x) {
        u.x *= 0.5f;
        u.y -= u.x;
    } else {
        u.y *= 0.5f;
        u.x -= u.y;
    }
    return u;
}

/* By how much a transform that stretches makes directions denser: a density per steradian at the unit
 * direction d, times this, is that of the direction that d becomes. 1 for rigid and evenly scaled transforms
 * (but for rounding). */
static inline float warp_density_factor(const xform_t *t, vec3_t d)
{
    float length = v_length(xform_vector(t, d));
    return length * length * length / fabsf(xform_determinant(t));
}

#endif
