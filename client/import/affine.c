/* affine: see affine.h. The formulas are those of Pharr, Jakob, Humphreys, "Physically Based Rendering", 2.7.
 */
#include "client/import/affine.h"

affine_t affine_identity(void)
{
    return (affine_t){{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};
}

affine_t affine_multiply(const affine_t *a, const affine_t *b)
{
    affine_t c;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 4; ++j)
            c.m[i][j] = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] + a->m[i][2] * b->m[2][j];
        c.m[i][3] += a->m[i][3];
    }
    return c;
}

affine_t affine_translation(const double offset[3])
{
    return (affine_t){{{1, 0, 0, offset[0]}, {0, 1, 0, offset[1]}, {0, 0, 1, offset[2]}}};
}

affine_t affine_scaling(const double factors[3])
{
    return (affine_t){{{factors[0], 0, 0, 0}, {0, factors[1], 0, 0}, {0, 0, factors[2], 0}}};
}

static bool unit(double v[3])
{
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (!(length > 0) || !isfinite(length)) return false;
    for (int i = 0; i < 3; ++i) v[i] /= length;
    return true;
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* sine and cosine, exact at the multiples of 90 degrees that scene files are full of */
static void sine_cosine(double degrees, double *sine, double *cosine)
{
    double turn = fmod(degrees, 360);
    if (fmod(turn, 90) == 0) {
        static const double sines[4] = {0, 1, 0, -1};
        int quarter = ((int)(turn / 90) + 4) % 4;
        *sine = sines[quarter];
        *cosine = sines[(quarter + 1) % 4];
        return;
    }
    double radians = turn * (3.14159265358979323846 / 180);
    *sine = sin(radians);
    *cosine = cos(radians);
}

bool affine_rotation(double degrees, const double axis[3], affine_t *out)
{
    double a[3] = {axis[0], axis[1], axis[2]}, s, c;
    if (!unit(a)) return false;
    sine_cosine(degrees, &s, &c);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) out->m[i][j] = a[i] * a[j] * (1 - c) + (i == j ? c : 0);
        out->m[i][3] = 0;
    }
    out->m[0][1] -= a[2] * s;
    out->m[0][2] += a[1] * s;
    out->m[1][0] += a[2] * s;
    out->m[1][2] -= a[0] * s;
    out->m[2][0] -= a[1] * s;
    out->m[2][1] += a[0] * s;
    return true;
}

bool affine_look_at(const double eye[3], const double target[3], const double up[3], affine_t *out)
{
    double view[3] = {target[0] - eye[0], target[1] - eye[1], target[2] - eye[2]};
    double above[3] = {up[0], up[1], up[2]}, right[3], top[3];
    if (!unit(view) || !unit(above)) return false;
    cross(above, view, right);
    if (right[0] * right[0] + right[1] * right[1] + right[2] * right[2] < 1e-18 || !unit(right)) return false;
    cross(view, right, top);
    affine_t world_from_camera;
    for (int i = 0; i < 3; ++i) {
        world_from_camera.m[i][0] = right[i];
        world_from_camera.m[i][1] = top[i];
        world_from_camera.m[i][2] = view[i];
        world_from_camera.m[i][3] = eye[i];
    }
    return affine_invert(&world_from_camera, out);
}

bool affine_from_columns(const double columns[16], affine_t *out)
{
    double w = columns[15];
    if (columns[3] != 0 || columns[7] != 0 || columns[11] != 0 || !(w != 0)) return false;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 4; ++j) {
            out->m[i][j] = columns[4 * j + i] / w;
            if (!isfinite(out->m[i][j])) return false;
        }
    }
    return true;
}

double affine_determinant(const affine_t *t)
{
    return t->m[0][0] * (t->m[1][1] * t->m[2][2] - t->m[1][2] * t->m[2][1]) -
           t->m[0][1] * (t->m[1][0] * t->m[2][2] - t->m[1][2] * t->m[2][0]) +
           t->m[0][2] * (t->m[1][0] * t->m[2][1] - t->m[1][1] * t->m[2][0]);
}

bool affine_invert(const affine_t *t, affine_t *inverse)
{
    double reciprocal = 1 / affine_determinant(t);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            int r0 = (j + 1) % 3, r1 = (j + 2) % 3, c0 = (i + 1) % 3, c1 = (i + 2) % 3;
            double cofactor = t->m[r0][c0] * t->m[r1][c1] - t->m[r0][c1] * t->m[r1][c0];
            inverse->m[i][j] = cofactor * reciprocal;
        }
    }
    bool finite = true;
    for (int i = 0; i < 3; ++i) {
        inverse->m[i][3] =
            -(inverse->m[i][0] * t->m[0][3] + inverse->m[i][1] * t->m[1][3] + inverse->m[i][2] * t->m[2][3]);
        for (int j = 0; j < 4; ++j) finite = finite && isfinite(inverse->m[i][j]);
    }
    return finite;
}

xform_t affine_to_xform(const affine_t *t)
{
    xform_t x;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 4; ++j) x.m[i][j] = (float)t->m[i][j];
    return x;
}

vec3_t affine_point(const affine_t *t, vec3_t p)
{
    return vec3((float)(t->m[0][0] * p.x + t->m[0][1] * p.y + t->m[0][2] * p.z + t->m[0][3]),
                (float)(t->m[1][0] * p.x + t->m[1][1] * p.y + t->m[1][2] * p.z + t->m[1][3]),
                (float)(t->m[2][0] * p.x + t->m[2][1] * p.y + t->m[2][2] * p.z + t->m[2][3]));
}

vec3_t affine_normal(const affine_t *inverse, vec3_t n)
{
    double v[3];
    for (int i = 0; i < 3; ++i)
        v[i] = inverse->m[0][i] * n.x + inverse->m[1][i] * n.y + inverse->m[2][i] * n.z;
    if (!unit(v)) return vec3(0, 0, 0);
    return vec3((float)v[0], (float)v[1], (float)v[2]);
}
