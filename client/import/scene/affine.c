/* affine: see affine.h. The formulas are those of Pharr, Jakob, Humphreys, "Physically Based Rendering", 2.7.
 */
#include "client/import/scene/affine.h"

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

double affine_scale(const affine_t *t, bool *uniform)
{
    double scale = cbrt(fabs(affine_determinant(t))), square = scale * scale;
    *uniform = true;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            double dot = t->m[0][i] * t->m[0][j] + t->m[1][i] * t->m[1][j] + t->m[2][i] * t->m[2][j];
            if (!(fabs(dot - (i == j ? square : 0)) <= 1e-3 * square)) *uniform = false;
        }
    return scale;
}

/* A linear map as a rotation after a symmetric stretch; one that mirrors has a negative stretch. */
typedef struct {
    double quaternion[4]; /* x y z w */
    double stretch[3][3];
} polar_t;

static void quaternion_of(const affine_t *r, double q[4])
{
    double trace = r->m[0][0] + r->m[1][1] + r->m[2][2];
    if (trace > 0) {
        double s = sqrt(trace + 1);
        q[3] = s / 2;
        for (int i = 0; i < 3; ++i)
            q[i] = (r->m[(i + 2) % 3][(i + 1) % 3] - r->m[(i + 1) % 3][(i + 2) % 3]) / (2 * s);
        return;
    }
    int i = r->m[1][1] > r->m[0][0] ? 1 : 0;
    if (r->m[2][2] > r->m[i][i]) i = 2;
    int j = (i + 1) % 3, k = (i + 2) % 3;
    double s = sqrt(fmax(1 + r->m[i][i] - r->m[j][j] - r->m[k][k], 1e-30));
    q[i] = s / 2;
    q[j] = (r->m[j][i] + r->m[i][j]) / (2 * s);
    q[k] = (r->m[k][i] + r->m[i][k]) / (2 * s);
    q[3] = (r->m[k][j] - r->m[j][k]) / (2 * s);
}

static void rotation_of(const double q[4], affine_t *r)
{
    double x = q[0], y = q[1], z = q[2], w = q[3];
    *r = (affine_t){{{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 0},
                     {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), 0},
                     {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), 0}}};
}

/* Newton's iteration of r and its inverse transpose converges to the nearest orthogonal matrix. */
static void decompose(const affine_t *t, polar_t *polar)
{
    affine_t r = *t, inverse;
    for (int i = 0; i < 3; ++i) r.m[i][3] = 0;
    double sign = affine_determinant(t) < 0 ? -1 : 1, change = 1;
    for (int step = 0; step < 100 && change > 1e-14; ++step) {
        if (!affine_invert(&r, &inverse)) break;
        change = 0;
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) {
                double next = (r.m[i][j] + inverse.m[j][i]) / 2;
                change = fmax(change, fabs(next - r.m[i][j]));
                r.m[i][j] = next;
            }
    }
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) r.m[i][j] *= sign;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            polar->stretch[i][j] = r.m[0][i] * t->m[0][j] + r.m[1][i] * t->m[1][j] + r.m[2][i] * t->m[2][j];
    quaternion_of(&r, polar->quaternion);
}

/* Along the shorter arc. */
static void slerp(const double a[4], const double b[4], double t, double out[4])
{
    double dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3], sign = dot < 0 ? -1 : 1;
    double angle = acos(fmin(fabs(dot), 1)), from = 1 - t, to = t, length = 0;
    if (angle > 1e-6) {
        from = sin((1 - t) * angle) / sin(angle);
        to = sin(t * angle) / sin(angle);
    }
    for (int i = 0; i < 4; ++i) {
        out[i] = from * a[i] + sign * to * b[i];
        length += out[i] * out[i];
    }
    for (int i = 0; i < 4; ++i) out[i] /= sqrt(length);
}

void affine_interpolate(const affine_t *a, const affine_t *b, double t, affine_t *out)
{
    if (t <= 0 || t >= 1) {
        *out = t <= 0 ? *a : *b;
        return;
    }
    polar_t from, to;
    double q[4];
    affine_t r, stretch;
    decompose(a, &from);
    decompose(b, &to);
    slerp(from.quaternion, to.quaternion, t, q);
    rotation_of(q, &r);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) stretch.m[i][j] = (1 - t) * from.stretch[i][j] + t * to.stretch[i][j];
        stretch.m[i][3] = 0;
    }
    *out = affine_multiply(&r, &stretch);
    for (int i = 0; i < 3; ++i) out->m[i][3] = (1 - t) * a->m[i][3] + t * b->m[i][3];
}

bool affine_frame(const affine_t *t, affine_t *frame)
{
    vec3_t axes[3];
    double z[3], length = 0;
    for (int i = 0; i < 3; ++i) length += t->m[i][2] * t->m[i][2];
    length = sqrt(length);
    if (!(length > 0) || !isfinite(length)) return false;
    for (int i = 0; i < 3; ++i) z[i] = t->m[i][2] / length;
    double along = 0, y[3], y_length = 0;
    for (int i = 0; i < 3; ++i) along += t->m[i][1] * z[i];
    for (int i = 0; i < 3; ++i) {
        y[i] = t->m[i][1] - along * z[i];
        y_length += y[i] * y[i];
    }
    y_length = sqrt(y_length);
    if (!(y_length > 1e-9 * fabs(along)) || !isfinite(y_length)) { /* any will do */
        v_frame(vec3((float)z[0], (float)z[1], (float)z[2]), &axes[0], &axes[1]);
        y[0] = (double)axes[1].x, y[1] = (double)axes[1].y, y[2] = (double)axes[1].z;
        y_length = 1;
    }
    for (int i = 0; i < 3; ++i) y[i] /= y_length;
    for (int i = 0; i < 3; ++i) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        frame->m[i][0] = y[j] * z[k] - y[k] * z[j];
        frame->m[i][1] = y[i];
        frame->m[i][2] = z[i];
        frame->m[i][3] = t->m[i][3];
        if (!(fabs(frame->m[i][3]) <= 1e18)) return false;
    }
    return true;
}

bool affine_mirrored_frame(const affine_t *t, affine_t *frame)
{
    if (!affine_frame(t, frame)) return false;
    if (affine_determinant(t) < 0)
        for (int i = 0; i < 3; ++i) frame->m[i][0] = -frame->m[i][0];
    return true;
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

vec3_t affine_direction(const affine_t *t, vec3_t v)
{
    double out[3];
    for (int i = 0; i < 3; ++i) out[i] = t->m[i][0] * v.x + t->m[i][1] * v.y + t->m[i][2] * v.z;
    if (!unit(out)) return vec3(0, 0, 0);
    return vec3((float)out[0], (float)out[1], (float)out[2]);
}

vec3_t affine_normal(const affine_t *inverse, vec3_t n)
{
    double v[3];
    for (int i = 0; i < 3; ++i)
        v[i] = inverse->m[0][i] * n.x + inverse->m[1][i] * n.y + inverse->m[2][i] * n.z;
    if (!unit(v)) return vec3(0, 0, 0);
    return vec3((float)v[0], (float)v[1], (float)v[2]);
}
