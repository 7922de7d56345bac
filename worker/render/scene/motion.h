/* motion: transforms that change from time 0 to time 1.
 *
 * A transform is split into translation, rotation and an upper triangular stretch, M = T R S; translation and
 * stretch are interpolated linearly, the rotation along the great arc of unit quaternions (Shoemake 1985).
 */
#ifndef LIGHTMILL_MOTION_H
#define LIGHTMILL_MOTION_H

#include "common/vec.h"

/* One transform, split. */
typedef struct {
    vec3_t translation;
    float rotation[4]; /* unit quaternion r, i, j, k */
    float stretch[6];  /* the upper triangle: xx, xy, xz, yy, yz, zz */
} motion_key_t;

typedef struct {
    bool moves;
    xform_t still; /* at time 0 */
    motion_key_t keys[2];
} motion_t;

/* From the (invertible) transforms at times 0 and 1. */
motion_t motion_between(const xform_t *start, const xform_t *end);
xform_t motion_at(const motion_t *motion, float time);

#endif
