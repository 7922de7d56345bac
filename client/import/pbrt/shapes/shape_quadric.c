/* shape_quadric: spheres, disks and cylinders, or parts of them, which the renderer intersects as they are.
 *
 * A quadric's normals point away from its axis or centre, a disk's along +z. ReverseOrientation turns them,
 * and so does a mirroring transform, which makes glass inside out: pbrt does that where a ray hits. Where it
 * samples a light it does not; nor do shapes that emit here. */
#include "client/import/pbrt/shapes/shapes.h"

static const double pi = 3.14159265358979323846;

/* ---- area --------------------------------------------------------------------------------------------- */

/* dp/du x dp/dv at (u, v) of [0, 1]^2, where u goes with phi and v with z or the radius, each linearly. */
static void tangents(const blob_quadric_t *q, double u, double v, double du[3], double dv[3])
{
    double phi = u * (double)q->phi_max, c = cos(phi), s = sin(phi), r = (double)q->radius;
    double height = (double)q->z_max - (double)q->z_min;
    double outward = 0, up = height;
    if (q->kind == QUADRIC_SPHERE) {
        double z = (double)q->z_min + v * height, radius = r;
        r = sqrt(fmax(radius * radius - z * z, 0));
        outward = r > 0 ? -z / r * height : 0;
    } else if (q->kind == QUADRIC_DISK) {
        outward = (double)q->inner_radius - r;
        r = r + v * outward;
        up = 0;
    }
    du[0] = -s * r * (double)q->phi_max;
    du[1] = c * r * (double)q->phi_max;
    du[2] = 0;
    dv[0] = c * outward;
    dv[1] = s * outward;
    dv[2] = up;
}

static void apply_linear(const affine_t *t, double v[3])
{
    double x = v[0], y = v[1], z = v[2];
    for (int i = 0; i < 3; ++i) v[i] = t->m[i][0] * x + t->m[i][1] * y + t->m[i][2] * z;
}

/* In the object's space: in closed form when the transform keeps angles, else by the midpoint rule. */
static double quadric_area(const blob_quadric_t *q, const affine_t *placed)
{
    enum { STEPS = 256 };
    bool uniform;
    double scale = affine_scale(placed, &uniform), phi = (double)q->phi_max, r = (double)q->radius;
    double inner = (double)q->inner_radius, height = (double)q->z_max - (double)q->z_min, area = 0;
    if (uniform)
        return scale * scale * phi * (q->kind == QUADRIC_DISK ? (r * r - inner * inner) / 2 : r * height);
    for (int i = 0; i < STEPS; ++i)
        for (int j = 0; j < STEPS; ++j) {
            double a[3], b[3];
            tangents(q, (i + 0.5) / STEPS, (j + 0.5) / STEPS, a, b);
            apply_linear(placed, a);
            apply_linear(placed, b);
            double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2],
                   z = a[0] * b[1] - a[1] * b[0];
            area += sqrt(x * x + y * y + z * z);
        }
    return area / ((double)STEPS * STEPS);
}

/* ---- the shapes --------------------------------------------------------------------------------------- */

static result_t read_radius(shape_work_t *work, double *radius)
{
    TRY(params_float(work->params, "radius", radius));
    if ((float)*radius > 0 && isfinite((float)*radius)) return result_ok();
    return error_at(params_where(work->params, "radius", work->at), "the radius is %g, but must be positive",
                    *radius);
}

/* zmin and zmax in either order. */
static result_t read_heights(shape_work_t *work, double *low, double *high)
{
    TRY(params_float(work->params, "zmin", low));
    TRY(params_float(work->params, "zmax", high));
    if (*low <= *high) return result_ok();
    double swapped = *low;
    *low = *high;
    *high = swapped;
    return result_ok();
}

static result_t read_phi(shape_work_t *work, float *phi_max)
{
    double degrees = 360;
    TRY(params_float(work->params, "phimax", &degrees));
    *phi_max = fminf((float)(fmin(degrees, 360) * (pi / 180)), TWO_PI_F);
    if (*phi_max > 0) return result_ok();
    return error_at(params_where(work->params, "phimax", work->at), "phimax is %g, but must be positive",
                    degrees);
}

static result_t add_quadric(pbrt_t *p, shape_work_t *work, blob_quadric_t *quadric)
{
    xform_t inverse;
    quadric->object_from_quadric = affine_to_xform(&work->placed);
    if (!xform_invert(&quadric->object_from_quadric, &inverse))
        return error_at(work->at, "the current transform is singular or not finite");
    if (!isfinite(quadric->z_min) || !isfinite(quadric->z_max))
        return error_at(work->at, "the shape's height is not finite");
    work->shape.kind = SHAPE_QUADRIC;
    work->shape.geometry = blob_builder_add(p->builder->blob, BLOB_SECTION_QUADRICS, quadric, 1);
    bool emits = p->now.emits && p->object == 0, mirrored = affine_determinant(&work->placed) < 0;
    work->shape.flags = p->now.reverse != (mirrored && !emits) ? SHAPE_FLIP : 0;
    work->inside_out = mirrored && emits;
    work->emitters = 1;
    if (p->now.emits) work->area = quadric_area(quadric, &work->placed);
    return result_ok();
}

result_t pbrt_make_sphere(pbrt_t *p, shape_work_t *work)
{
    double radius = 1;
    TRY(read_radius(work, &radius));
    double low = -radius, high = radius;
    TRY(read_heights(work, &low, &high));
    blob_quadric_t quadric = {.kind = QUADRIC_SPHERE, .radius = (float)radius};
    quadric.z_min = (float)fmin(fmax(low, -radius), radius);
    quadric.z_max = (float)fmin(fmax(high, -radius), radius);
    TRY(read_phi(work, &quadric.phi_max));
    if (!(quadric.z_min < quadric.z_max))
        return error_at(params_where(work->params, "zmin", work->at),
                        "nothing of the sphere lies between zmin %g and zmax %g", low, high);
    return add_quadric(p, work, &quadric);
}

result_t pbrt_make_disk(pbrt_t *p, shape_work_t *work)
{
    double radius = 1, inner = 0, height = 0;
    TRY(read_radius(work, &radius));
    TRY(params_float(work->params, "innerradius", &inner));
    TRY(params_float(work->params, "height", &height));
    blob_quadric_t quadric = {.kind = QUADRIC_DISK, .radius = (float)radius, .inner_radius = (float)inner};
    quadric.z_min = quadric.z_max = (float)height;
    TRY(read_phi(work, &quadric.phi_max));
    if (!(quadric.inner_radius >= 0 && quadric.inner_radius < quadric.radius))
        return error_at(params_where(work->params, "innerradius", work->at),
                        "innerradius is %g, but must be from 0 to below the radius, %g", inner, radius);
    return add_quadric(p, work, &quadric);
}

result_t pbrt_make_cylinder(pbrt_t *p, shape_work_t *work)
{
    double radius = 1, low = -1, high = 1;
    TRY(read_radius(work, &radius));
    TRY(read_heights(work, &low, &high));
    blob_quadric_t quadric = {
        .kind = QUADRIC_CYLINDER, .radius = (float)radius, .z_min = (float)low, .z_max = (float)high};
    TRY(read_phi(work, &quadric.phi_max));
    if (!(quadric.z_min < quadric.z_max))
        return error_at(params_where(work->params, "zmin", work->at), "the cylinder has no height");
    return add_quadric(p, work, &quadric);
}
