/* motion: see motion.h. */
#include "worker/render/scene/motion.h"

#include <string.h>

/* The quaternion of a rotation whose columns are x, y, z (Shoemake 1985; the largest component first). */
static void quaternion_of(const vec3_t axes[3], float q[4])
{
    float m[3][3];
    for (int c = 0; c < 3; c++) m[0][c] = axes[c].x, m[1][c] = axes[c].y, m[2][c] = axes[c].z;
    float trace = m[0][0] + m[1][1] + m[2][2];
    if (trace > 0) {
        float s = sqrtf(trace + 1);
        q[0] = 0.5f * s;
        q[1] = (m[2][1] - m[1][2]) / (2 * s);
        q[2] = (m[0][2] - m[2][0]) / (2 * s);
        q[3] = (m[1][0] - m[0][1]) / (2 * s);
        return;
    }
    int i = m[1][1] > m[0][0] ? 1 : 0;
    if (m[2][2] > m[i][i]) i = 2;
    int j = (i + 1) % 3, k = (i + 2) % 3;
    float s = sqrtf(float_max(m[i][i] - m[j][j] - m[k][k] + 1, 0x1p-60f));
    q[1 + i] = 0.5f * s;
    q[0] = (m[k][j] - m[j][k]) / (2 * s);
    q[1 + j] = (m[j][i] + m[i][j]) / (2 * s);
    q[1 + k] = (m[k][i] + m[i][k]) / (2 * s);
}

/* Gram-Schmidt: columns = rotation times an upper triangle. A mirroring goes into the triangle. */
static motion_key_t split(const xform_t *t)
{
    motion_key_t key = {.translation = vec3(t->m[0][3], t->m[1][3], t->m[2][3])};
    vec3_t c[3], axes[3];
    for (int i = 0; i < 3; i++) c[i] = vec3(t->m[0][i], t->m[1][i], t->m[2][i]);
    float *s = key.stretch;
    s[0] = v_length(c[0]);
    axes[0] = v_scale(c[0], 1 / s[0]);
    s[1] = v_dot(axes[0], c[1]);
    vec3_t y = v_mad(c[1], -s[1], axes[0]);
    s[3] = v_length(y);
    axes[1] = v_scale(y, 1 / s[3]);
    s[2] = v_dot(axes[0], c[2]);
    s[4] = v_dot(axes[1], c[2]);
    axes[2] = v_cross(axes[0], axes[1]);
    s[5] = v_dot(axes[2], c[2]); /* negative when the transform mirrors */
    quaternion_of(axes, key.rotation);
    return key;
}

motion_t motion_between(const xform_t *start, const xform_t *end)
{
    motion_t motion = {.still = *start, .moves = memcmp(start, end, sizeof *start) != 0};
    motion.keys[0] = split(start);
    motion.keys[1] = split(end);
    /* The shorter of the two arcs. */
    float *a = motion.keys[0].rotation, *b = motion.keys[1].rotation;
    if (a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0)
        for (int i = 0; i < 4; i++) b[i] = -b[i];
    return motion;
}

static void slerp(const float a[4], const float b[4], float time, float out[4])
{
    float cos = float_min(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3], 1);
    float angle = acosf(cos), sin = sinf(angle), wa = 1 - time, wb = time;
    if (sin > 1e-4f) wa = sinf(wa * angle) / sin, wb = sinf(wb * angle) / sin;
    float length2 = 0;
    for (int i = 0; i < 4; i++) {
        out[i] = wa * a[i] + wb * b[i];
        length2 += out[i] * out[i];
    }
    for (int i = 0; i < 4; i++) out[i] /= sqrtf(length2);
}

xform_t motion_at(const motion_t *motion, float time)
{
    if (!motion->moves) return motion->still;
    const motion_key_t *a = &motion->keys[0], *b = &motion->keys[1];
    float q[4], s[6];
    slerp(a->rotation, b->rotation, time, q);
    for (int i = 0; i < 6; i++) s[i] = (1 - time) * a->stretch[i] + time * b->stretch[i];
    vec3_t translation = v_add(v_scale(a->translation, 1 - time), v_scale(b->translation, time));
    float r = q[0], x = q[1], y = q[2], z = q[3];
    xform_t rotation = {{{1 - 2 * (y * y + z * z), 2 * (x * y - r * z), 2 * (x * z + r * y), translation.x},
                         {2 * (x * y + r * z), 1 - 2 * (x * x + z * z), 2 * (y * z - r * x), translation.y},
                         {2 * (x * z - r * y), 2 * (y * z + r * x), 1 - 2 * (x * x + y * y), translation.z}}};
    xform_t stretch = {{{s[0], s[1], s[2], 0}, {0, s[3], s[4], 0}, {0, 0, s[5], 0}}};
    return xform_multiply(&rotation, &stretch);
}
