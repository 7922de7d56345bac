/* quadric: see quadric.h. */
#include "worker/render/scene/quadric.h"

void quadric_bounds(const quadric_t *quadric, float low[3], float high[3])
{
    const blob_quadric_t *q = quadric->record;
    float z_low = q->z_min, z_high = q->kind == QUADRIC_DISK ? q->z_min : q->z_max;
    for (int i = 0; i < 3; i++) {
        const float *row = q->object_from_quadric.m[i];
        /* The disc of the radius, swept from z_low to z_high; rounded outward. */
        float across = q->radius * sqrtf(row[0] * row[0] + row[1] * row[1]);
        float a = row[2] * z_low, b = row[2] * z_high;
        low[i] = row[3] + float_min(a, b) - across;
        high[i] = row[3] + float_max(a, b) + across;
        float slack = 1e-5f * (across + fabsf(a) + fabsf(b)) + 1e-6f * fabsf(row[3]);
        low[i] -= slack;
        high[i] += slack;
    }
}

/* ---- crossings ----------------------------------------------------------------------------------------- */

typedef struct {
    double x, y, z;
} point_t;

/* True when a point of the whole quadric is in the part that is there. */
static bool is_there(const blob_quadric_t *q, const point_t *p)
{
    if (q->phi_max < TWO_PI_F) {
        double phi = atan2(p->y, p->x);
        if (phi < 0) phi += 2 * M_PI;
        if (phi > (double)q->phi_max) return false;
    }
    if (q->kind == QUADRIC_DISK) {
        double r2 = p->x * p->x + p->y * p->y;
        return r2 <= (double)q->radius * (double)q->radius &&
               r2 >= (double)q->inner_radius * (double)q->inner_radius;
    }
    if (q->kind == QUADRIC_SPHERE && q->z_min <= -q->radius && q->z_max >= q->radius) return true;
    return p->z >= (double)q->z_min && p->z <= (double)q->z_max;
}

/* The two roots of a sphere or cylinder; false when the ray passes by. The discriminant is taken from the
 * ray's closest point to the centre: no cancellation (Haines et al. 2019, "Precision Improvements for
 * Ray/Sphere Intersection"). `flat` 0 leaves z out: the cylinder. */
static bool round_roots(const blob_quadric_t *q, vec3_t o, vec3_t d, double flat, double roots[2])
{
    double dx = d.x, dy = d.y, dz = flat * (double)d.z, ox = o.x, oy = o.y, oz = flat * (double)o.z;
    double a = dx * dx + dy * dy + dz * dz, b = dx * ox + dy * oy + dz * oz, r = q->radius;
    if (!(a > 0)) return false;
    double t = -b / a, cx = ox + t * dx, cy = oy + t * dy, cz = oz + t * dz;
    double left = r * r - (cx * cx + cy * cy + cz * cz);
    if (!(left >= 0)) return false;
    double half = sqrt(left / a);
    roots[0] = t - half;
    roots[1] = t + half;
    return true;
}

int quadric_crossings(const quadric_t *quadric, vec3_t origin, vec3_t direction, float distances[2])
{
    const blob_quadric_t *q = quadric->record;
    vec3_t o = xform_point(&quadric->quadric_from_object, origin);
    vec3_t d = xform_vector(&quadric->quadric_from_object, direction);
    double roots[2];
    int candidates = 2, count = 0;
    if (q->kind == QUADRIC_DISK) {
        if (d.z == 0) return 0;
        roots[0] = ((double)q->z_min - (double)o.z) / (double)d.z;
        candidates = 1;
    } else if (!round_roots(q, o, d, q->kind == QUADRIC_SPHERE ? 1 : 0, roots)) {
        return 0;
    }
    for (int i = 0; i < candidates; i++) {
        point_t p = {(double)o.x + roots[i] * (double)d.x, (double)o.y + roots[i] * (double)d.y,
                     (double)o.z + roots[i] * (double)d.z};
        if (is_there(q, &p)) distances[count++] = (float)roots[i];
    }
    return count;
}

/* ---- points -------------------------------------------------------------------------------------------- */

/* Pushes a point in the quadric's space onto it. */
static vec3_t pull(const blob_quadric_t *q, vec3_t p)
{
    if (q->kind == QUADRIC_DISK) return vec3(p.x, p.y, q->z_min);
    if (q->kind == QUADRIC_SPHERE) return v_scale(p, q->radius / v_length(p));
    float scale = q->radius / sqrtf(p.x * p.x + p.y * p.y);
    return vec3(p.x * scale, p.y * scale, p.z);
}

/* The normal at a point of the quadric, in its own space. */
static vec3_t local_normal(const blob_quadric_t *q, vec3_t p)
{
    float inverse = 1 / q->radius;
    if (q->kind == QUADRIC_DISK) return vec3(0, 0, 1);
    return vec3(p.x * inverse, p.y * inverse, q->kind == QUADRIC_SPHERE ? p.z * inverse : 0);
}

/* Coordinates and derivatives at a point on the quadric, in its own space. */
static quadric_details_t local_details(const blob_quadric_t *q, vec3_t p)
{
    float phi = atan2f(p.y, p.x), r = sqrtf(p.x * p.x + p.y * p.y);
    if (phi < 0) phi += TWO_PI_F;
    quadric_details_t out = {.dpdu = vec3(-q->phi_max * p.y, q->phi_max * p.x, 0)};
    if (r == 0) out.dpdu = vec3(0, q->phi_max * q->radius * 1e-3f, 0); /* a pole: any tangent */
    out.uv.x = phi / q->phi_max;
    vec2_t out_dir = r > 0 ? (vec2_t){p.x / r, p.y / r} : (vec2_t){1, 0};
    if (q->kind == QUADRIC_DISK) {
        float width = q->radius - q->inner_radius;
        out.uv.y = 1 - (r - q->inner_radius) / width;
        out.dpdv = vec3(-out_dir.x * width, -out_dir.y * width, 0);
        return out;
    }
    float inverse = 1 / q->radius;
    out.dndu = v_scale(out.dpdu, inverse);
    if (q->kind == QUADRIC_CYLINDER) {
        float height = q->z_max - q->z_min;
        out.uv.y = (p.z - q->z_min) / height;
        out.dpdv = vec3(0, 0, height);
        return out;
    }
    float theta_min = acosf(float_clamp(q->z_min * inverse, -1, 1));
    float theta_max = acosf(float_clamp(q->z_max * inverse, -1, 1));
    float theta = acosf(float_clamp(p.z * inverse, -1, 1)), span = theta_max - theta_min;
    out.uv.y = (theta - theta_min) / span;
    out.dpdv = v_scale(vec3(p.z * out_dir.x, p.z * out_dir.y, -r), span);
    out.dndv = v_scale(out.dpdv, inverse);
    return out;
}

/* A point of the quadric's own space in the object's. */
static quadric_point_t object_point(const quadric_t *quadric, vec3_t local)
{
    vec3_t n = xform_normal(&quadric->quadric_from_object, local_normal(quadric->record, local));
    return (quadric_point_t){.p = xform_point(&quadric->record->object_from_quadric, local),
                             .n = v_scale(n, 1 / v_length(n))};
}

void quadric_at(const quadric_t *quadric, vec3_t p, quadric_point_t *point)
{
    *point = object_point(quadric, pull(quadric->record, xform_point(&quadric->quadric_from_object, p)));
}

void quadric_details(const quadric_t *quadric, vec3_t p, quadric_details_t *details)
{
    const xform_t *object = &quadric->record->object_from_quadric, *inverse = &quadric->quadric_from_object;
    vec3_t local = pull(quadric->record, xform_point(inverse, p));
    quadric_details_t own = local_details(quadric->record, local);
    float scale = 1 / v_length(xform_normal(inverse, local_normal(quadric->record, local)));
    *details = (quadric_details_t){.uv = own.uv,
                                   .dpdu = xform_vector(object, own.dpdu),
                                   .dpdv = xform_vector(object, own.dpdv),
                                   .dndu = v_scale(xform_normal(inverse, own.dndu), scale),
                                   .dndv = v_scale(xform_normal(inverse, own.dndv), scale)};
}

/* ---- sampling ------------------------------------------------------------------------------------------ */

static double local_area(const blob_quadric_t *q)
{
    double phi = q->phi_max, r = q->radius, inner = q->inner_radius;
    if (q->kind == QUADRIC_DISK) return 0.5 * phi * (r * r - inner * inner);
    return phi * r * ((double)q->z_max - (double)q->z_min); /* Archimedes' hat box, too */
}

/* By how much the transform stretches area where the normal is n (unit, quadric space): |det M| |M^-T n|. */
static float stretch(const quadric_t *quadric, vec3_t n)
{
    return fabsf(xform_determinant(&quadric->record->object_from_quadric)) *
           v_length(xform_normal(&quadric->quadric_from_object, n));
}

/* Exact for a rigid transform, of the right size for any other. */
static double object_area(const quadric_t *quadric)
{
    double mean = 0;
    if (quadric->record->kind == QUADRIC_DISK)
        mean = (double)stretch(quadric, vec3(0, 0, 1));
    else
        for (int i = 0; i < 3; i++) mean += (double)stretch(quadric, vec3(i == 0, i == 1, i == 2)) / 3;
    return local_area(quadric->record) * mean;
}

void quadric_sample(const quadric_t *quadric, vec2_t u, quadric_point_t *point)
{
    const blob_quadric_t *q = quadric->record;
    float phi = u.y * q->phi_max, z = q->z_min, r = q->radius;
    if (q->kind == QUADRIC_DISK) {
        float inner2 = q->inner_radius * q->inner_radius;
        r = sqrtf(inner2 + u.x * (q->radius * q->radius - inner2));
    } else {
        z = q->z_max - u.x * (q->z_max - q->z_min);
        if (q->kind == QUADRIC_SPHERE) r = sqrtf(float_max(0, q->radius * q->radius - z * z));
    }
    *point = object_point(quadric, vec3(r * cosf(phi), r * sinf(phi), z));
}

float quadric_pdf(const quadric_t *quadric, const quadric_point_t *point)
{
    vec3_t local = xform_normal(&quadric->record->object_from_quadric, point->n);
    return 1 / ((float)local_area(quadric->record) * stretch(quadric, v_normalize(local)));
}

void quadric_init(quadric_t *quadric, const blob_quadric_t *record)
{
    quadric->record = record;
    xform_invert(&record->object_from_quadric, &quadric->quadric_from_object);
    quadric->area = object_area(quadric);
    float radius = float_max(record->radius, float_max(fabsf(record->z_min), fabsf(record->z_max)));
    quadric->reach = xform_reach(&record->object_from_quadric, vec3(0, 0, 0), radius);
}
