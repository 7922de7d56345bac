/* vec: three-vectors, which serve for points, directions, normals and linear RGB, and affine transforms. */
#ifndef LIGHTMILL_VEC_H
#define LIGHTMILL_VEC_H

#include <math.h>
#include <stdbool.h>

typedef struct {
    float x, y, z;
} vec3_t;
typedef vec3_t rgb_t; /* linear sRGB primaries; x, y, z are red, green, blue */
typedef struct {
    float x, y;
} vec2_t;

#define PI_F 3.14159265358979323846f
#define INV_PI_F 0.31830988618379067154f
#define TWO_PI_F 6.28318530717958647693f

static inline vec3_t vec3(float x, float y, float z)
{
    return (vec3_t){x, y, z};
}
static inline vec3_t v_add(vec3_t a, vec3_t b)
{
    return vec3(a.x + b.x, a.y + b.y, a.z + b.z);
}
static inline vec3_t v_sub(vec3_t a, vec3_t b)
{
    return vec3(a.x - b.x, a.y - b.y, a.z - b.z);
}
static inline vec3_t v_mul(vec3_t a, vec3_t b)
{
    return vec3(a.x * b.x, a.y * b.y, a.z * b.z);
}
static inline vec3_t v_scale(vec3_t a, float s)
{
    return vec3(a.x * s, a.y * s, a.z * s);
}
static inline vec3_t v_neg(vec3_t a)
{
    return vec3(-a.x, -a.y, -a.z);
}
/* a + s b */
static inline vec3_t v_mad(vec3_t a, float s, vec3_t b)
{
    return vec3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
static inline float v_dot(vec3_t a, vec3_t b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
static inline vec3_t v_cross(vec3_t a, vec3_t b)
{
    return vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline float v_length2(vec3_t a)
{
    return v_dot(a, a);
}
static inline float v_length(vec3_t a)
{
    return sqrtf(v_dot(a, a));
}
static inline vec3_t v_normalize(vec3_t a)
{
    return v_scale(a, 1.0f / v_length(a));
}
/* The larger and the smaller of two numbers, in one instruction each; b where a is NaN. */
static inline float float_max(float a, float b)
{
    return a > b ? a : b;
}
static inline float float_min(float a, float b)
{
    return a < b ? a : b;
}
static inline float v_max(vec3_t a)
{
    return float_max(a.x, float_max(a.y, a.z));
}
/* The corners of the smallest box about two points. */
static inline vec3_t v_low(vec3_t a, vec3_t b)
{
    return vec3(float_min(a.x, b.x), float_min(a.y, b.y), float_min(a.z, b.z));
}
static inline vec3_t v_high(vec3_t a, vec3_t b)
{
    return vec3(float_max(a.x, b.x), float_max(a.y, b.y), float_max(a.z, b.z));
}
/* A coordinate, by its number from 0 to 2. */
static inline float v_at(vec3_t a, int axis)
{
    return axis == 0 ? a.x : axis == 1 ? a.y : a.z;
}
/* The number of the largest coordinate, the first of several. */
static inline int v_longest(vec3_t a)
{
    return a.x >= a.y && a.x >= a.z ? 0 : a.y >= a.z ? 1 : 2;
}
static inline bool v_is_zero(vec3_t a)
{
    return a.x == 0 && a.y == 0 && a.z == 0;
}
static inline bool v_is_finite(vec3_t a)
{
    return isfinite(a.x) && isfinite(a.y) && isfinite(a.z);
}
/* Luminance of linear sRGB (ITU-R BT.709). */
static inline float rgb_luminance(rgb_t c)
{
    return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z;
}
static inline float float_clamp(float x, float low, float high)
{
    return x < low ? low : x > high ? high : x;
}

/* Two unit vectors that make a right-handed orthonormal frame with the unit vector n
 * (Duff et al. 2017, "Building an Orthonormal Basis, Revisited"). */
static inline void v_frame(vec3_t n, vec3_t *s, vec3_t *t)
{
    float sign = copysignf(1.0f, n.z);
    float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    *s = vec3(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *t = vec3(b, sign + n.y * n.y * a, -n.y);
}

/* An affine transform: row-major 3 x 4, the last column is the translation. */
typedef struct {
    float m[3][4];
} xform_t;

static inline xform_t xform_identity(void)
{
    return (xform_t){{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};
}
static inline vec3_t xform_point(const xform_t *t, vec3_t p)
{
    return vec3(t->m[0][0] * p.x + t->m[0][1] * p.y + t->m[0][2] * p.z + t->m[0][3],
                t->m[1][0] * p.x + t->m[1][1] * p.y + t->m[1][2] * p.z + t->m[1][3],
                t->m[2][0] * p.x + t->m[2][1] * p.y + t->m[2][2] * p.z + t->m[2][3]);
}
/* The largest number that the transform of such a point is added up of, or of any other whose coordinates are
 * at most `reach`: what its rounding goes by. */
static inline float xform_reach(const xform_t *t, vec3_t p, float reach)
{
    float largest = 0;
    for (int i = 0; i < 3; i++) {
        const float *m = t->m[i];
        float sum = fabsf(m[3]) + fabsf(m[0]) * float_max(fabsf(p.x), reach) +
                    fabsf(m[1]) * float_max(fabsf(p.y), reach) + fabsf(m[2]) * float_max(fabsf(p.z), reach);
        largest = float_max(largest, sum);
    }
    return largest;
}
static inline vec3_t xform_vector(const xform_t *t, vec3_t v)
{
    return vec3(t->m[0][0] * v.x + t->m[0][1] * v.y + t->m[0][2] * v.z,
                t->m[1][0] * v.x + t->m[1][1] * v.y + t->m[1][2] * v.z,
                t->m[2][0] * v.x + t->m[2][1] * v.y + t->m[2][2] * v.z);
}
/* A normal under the transform whose INVERSE is given (the transpose of the inverse); not normalised. */
static inline vec3_t xform_normal(const xform_t *inverse, vec3_t n)
{
    return vec3(inverse->m[0][0] * n.x + inverse->m[1][0] * n.y + inverse->m[2][0] * n.z,
                inverse->m[0][1] * n.x + inverse->m[1][1] * n.y + inverse->m[2][1] * n.z,
                inverse->m[0][2] * n.x + inverse->m[1][2] * n.y + inverse->m[2][2] * n.z);
}
/* Determinant of the linear part; negative when the transform mirrors. */
static inline float xform_determinant(const xform_t *t)
{
    return t->m[0][0] * (t->m[1][1] * t->m[2][2] - t->m[1][2] * t->m[2][1]) -
           t->m[0][1] * (t->m[1][0] * t->m[2][2] - t->m[1][2] * t->m[2][0]) +
           t->m[0][2] * (t->m[1][0] * t->m[2][1] - t->m[1][1] * t->m[2][0]);
}
/* a after b. */
xform_t xform_multiply(const xform_t *a, const xform_t *b);
/* False when the transform is singular or not finite; computed in double precision. */
bool xform_invert(const xform_t *t, xform_t *inverse);

#endif
