/* affine: affine transforms in double precision, for the importers alone.
 *
 * A scene file multiplies long chains of transforms; they are carried in double and rounded to float once,
 * when a vertex or an instance is written. The directions and signs are pbrt's.
 */
#ifndef LIGHTMILL_AFFINE_H
#define LIGHTMILL_AFFINE_H

#include "common/vec.h"

/* Row-major 3 x 4; the last column is the translation. */
typedef struct {
    double m[3][4];
} affine_t;

affine_t affine_identity(void);
/* a after b. */
affine_t affine_multiply(const affine_t *a, const affine_t *b);
affine_t affine_translation(const double offset[3]);
affine_t affine_scaling(const double factors[3]);
/* By `degrees` about an axis of any length but 0 (false). */
bool affine_rotation(double degrees, const double axis[3], affine_t *out);
/* The transform that takes the world to a camera at `eye` looking down +z to `target`, y towards `up`, x = y
 * x z. False when the eye is at the target or `up` points along the view. */
bool affine_look_at(const double eye[3], const double target[3], const double up[3], affine_t *out);
/* From pbrt's 16 numbers, column by column. False when it is projective, or not finite. */
bool affine_from_columns(const double columns[16], affine_t *out);
/* False when it is singular or not finite. */
bool affine_invert(const affine_t *t, affine_t *inverse);
double affine_determinant(const affine_t *t);
/* Between a (t = 0, and before) and b (t = 1, and after): translation, rotation and stretch each, after a
 * polar decomposition (Shoemake and Duff 1992, "Matrix Animation and Polar Decomposition"). */
void affine_interpolate(const affine_t *a, const affine_t *b, double t, affine_t *out);
/* The factor by which it scales lengths, as the cube root of its factor on volumes; *uniform: in all
 * directions and without shear, to a part in 1000. */
double affine_scale(const affine_t *t, bool *uniform);
/* The transform without scale and shear, its z axis along the old one; false when that axis has no direction
 * or the origin lies beyond 1e18. */
bool affine_frame(const affine_t *t, affine_t *frame);
/* The same, but it mirrors where the transform does: its x axis points the other way then. */
bool affine_mirrored_frame(const affine_t *t, affine_t *frame);
xform_t affine_to_xform(const affine_t *t);

vec3_t affine_point(const affine_t *t, vec3_t p);
/* A direction under the transform, of unit length; (0, 0, 0) when none is left of it. */
vec3_t affine_direction(const affine_t *t, vec3_t v);
/* A normal under the transform whose inverse is given, of unit length; (0, 0, 0) when it has no direction. */
vec3_t affine_normal(const affine_t *inverse, vec3_t n);

#endif
