/* nurbs: rational B-spline surfaces by de Boor's algorithm (Piegl and Tiller 1997, "The NURBS Book", 4.3).
 *
 * A surface is evaluated in homogeneous coordinates: along v for each column of control points that matters
 * at u, then along u through the results, and the other way round for the other derivative. A derivative is
 * the difference of the last two de Boor points, and the quotient rule brings it to space.
 */
#include "client/import/tessellate/grid.h"
#include "client/import/tessellate/tessellate.h"

/* A homogeneous point (w x, w y, w z, w). */
typedef struct {
    double c[4];
} point4_t;

/* An axis whose numbers were checked. */
typedef struct {
    uint32_t order, count;
    const double *knots;
    double begin, end; /* the parameters of the first and the last sample */
} axis_t;

static result_t take_axis(const nurbs_axis_t *in, char name, position_t at, axis_t *out)
{
    if (!(in->order >= 2 && in->order <= NURBS_MAX_ORDER) || in->order != floor(in->order))
        return error_at(at, "%corder is %g, but must be an integer from 2 to %d", name, in->order,
                        NURBS_MAX_ORDER);
    if (!(in->count >= in->order && in->count <= 1e6) || in->count != floor(in->count))
        return error_at(at, "n%c is %g, but must be an integer from %corder, %g, to 1000000", name, in->count,
                        name, in->order);
    if (in->count + in->order != (double)in->knot_count)
        return error_at(at, "%zu numbers in %cknots for %g control points of order %g, which need %g",
                        in->knot_count, name, in->count, in->order, in->count + in->order);
    *out = (axis_t){(uint32_t)in->order, (uint32_t)in->count, in->knots, 0, 0};
    for (size_t i = 0; i < in->knot_count; ++i)
        if (!isfinite(in->knots[i]) || (i > 0 && in->knots[i] < in->knots[i - 1]))
            return error_at(at, "number %zu of %cknots is %g: knots must be finite and must not decrease", i,
                            name, in->knots[i]);
    double low = in->knots[out->order - 1], high = in->knots[out->count];
    if (!(low < high))
        return error_at(at, "%cknots leave no range: knot %u and knot %u are both %g", name, out->order - 1,
                        out->count, low);
    out->begin = in->has_range ? in->range[0] : low;
    out->end = in->has_range ? in->range[1] : high;
    if (!(fmin(out->begin, out->end) >= low && fmax(out->begin, out->end) <= high) || out->begin == out->end)
        return error_at(at, "%c0 %g and %c1 %g must differ and lie within the knots' range from %g to %g",
                        name, out->begin, name, out->end, low, high);
    return result_ok();
}

static double sample_at(const axis_t *axis, double position)
{
    double t = (1 - position) * axis->begin + position * axis->end;
    return fmin(fmax(t, fmin(axis->begin, axis->end)), fmax(axis->begin, axis->end));
}

/* The k with knots[k] < knots[k + 1] whose span holds t: at a knot the span before it, as in pbrt. */
static uint32_t find_span(const axis_t *axis, double t)
{
    uint32_t span = axis->order - 1;
    while (span + 1 < axis->count &&
           (t > axis->knots[span + 1] || axis->knots[span] == axis->knots[span + 1]))
        ++span;
    while (axis->knots[span] == axis->knots[span + 1]) --span; /* trailing empty ones, when t is the end */
    return span;
}

/* The curve through work[0 .. order - 1], the control points of `span`, which are spent, and its derivative.
 */
static point4_t de_boor(const axis_t *axis, uint32_t span, double t, point4_t *work, point4_t *derivative)
{
    uint32_t degree = axis->order - 1;
    for (uint32_t round = 1; round <= degree; ++round) {
        for (uint32_t j = degree; j >= round; --j) {
            double left = axis->knots[span - degree + j], right = axis->knots[span + 1 + j - round];
            double alpha = (t - left) / (right - left);
            for (int c = 0; c < 4; ++c) {
                double before = work[j - 1].c[c], here = work[j].c[c];
                if (round == degree) derivative->c[c] = degree * (here - before) / (right - left);
                work[j].c[c] = (1 - alpha) * before + alpha * here;
            }
        }
    }
    return work[degree];
}

typedef struct {
    axis_t u, v;
    const double *points;
    bool rational;
} nurbs_surface_t;

static point4_t control_point(const nurbs_surface_t *surface, uint32_t u, uint32_t v)
{
    size_t index = (size_t)v * surface->u.count + u;
    const double *p = surface->points + index * (surface->rational ? 4 : 3);
    return (point4_t){{p[0], p[1], p[2], surface->rational ? p[3] : 1}};
}

/* One order of evaluation: curves along `inner`, then one along `outer`; the derivative is along `outer`. */
static point4_t evaluate(const nurbs_surface_t *surface, bool outer_is_u, double u, double v,
                         point4_t *derivative)
{
    const axis_t *outer = outer_is_u ? &surface->u : &surface->v;
    const axis_t *inner = outer_is_u ? &surface->v : &surface->u;
    double outer_t = outer_is_u ? u : v, inner_t = outer_is_u ? v : u;
    uint32_t outer_span = find_span(outer, outer_t), inner_span = find_span(inner, inner_t);
    point4_t across[NURBS_MAX_ORDER], work[NURBS_MAX_ORDER];
    for (uint32_t i = 0; i < outer->order; ++i) {
        uint32_t a = outer_span - outer->order + 1 + i;
        for (uint32_t j = 0; j < inner->order; ++j) {
            uint32_t b = inner_span - inner->order + 1 + j;
            work[j] = outer_is_u ? control_point(surface, a, b) : control_point(surface, b, a);
        }
        across[i] = de_boor(inner, inner_span, inner_t, work, derivative);
    }
    return de_boor(outer, outer_span, outer_t, across, derivative);
}

static dvec3_t in_space(point4_t p)
{
    return (dvec3_t){p.c[0] / p.c[3], p.c[1] / p.c[3], p.c[2] / p.c[3]};
}

/* The derivative of in_space(p): (p' - w' p / w) / w. */
static dvec3_t derivative_in_space(point4_t p, point4_t derivative)
{
    return d_scale(d_mad(d_vec3(derivative.c), -derivative.c[3], in_space(p)), 1 / p.c[3]);
}

/* Position and normal at (u, v), each in [0, 1] of the range; false where the weight vanishes. */
static bool sample(const nurbs_surface_t *surface, double u, double v, dvec3_t *position, vec3_t *normal)
{
    point4_t du, dv;
    u = sample_at(&surface->u, u);
    v = sample_at(&surface->v, v);
    point4_t p = evaluate(surface, true, u, v, &du);
    evaluate(surface, false, u, v, &dv);
    if (!(fabs(p.c[3]) > 0)) return false;
    *position = in_space(p);
    *normal = d_direction(d_cross(derivative_in_space(p, du), derivative_in_space(p, dv)));
    return true;
}

static result_t add_sample(const nurbs_surface_t *surface, uint32_t i, uint32_t j, position_t at,
                           mesh_t *mesh)
{
    double u = (double)i / (NURBS_DICE - 1), v = (double)j / (NURBS_DICE - 1);
    uint32_t vertex = mesh->vertex_count++;
    dvec3_t position, beside;
    if (!sample(surface, u, v, &position, &mesh->normals[vertex]))
        return error_at(at, "the weight vanishes at u = %g, v = %g: \"Pw\" needs positive weights",
                        sample_at(&surface->u, u), sample_at(&surface->v, v));
    mesh->positions[vertex] = d_to_float(position);
    mesh->uvs[vertex] = (vec2_t){(float)sample_at(&surface->u, u), (float)sample_at(&surface->v, v)};
    /* at a pole the limit from within */
    if (v_is_zero(mesh->normals[vertex]))
        sample(surface, u + 1e-4 * (0.5 - u), v + 1e-4 * (0.5 - v), &beside, &mesh->normals[vertex]);
    return result_ok();
}

result_t tessellate_nurbs(const nurbs_t *nurbs, position_t at, mesh_t *mesh)
{
    nurbs_surface_t surface = {.points = nurbs->points, .rational = nurbs->rational};
    TRY(take_axis(&nurbs->u, 'u', at, &surface.u));
    TRY(take_axis(&nurbs->v, 'v', at, &surface.v));
    size_t size = nurbs->rational ? 4 : 3, points = (size_t)surface.u.count * surface.v.count;
    if (nurbs->number_count != points * size)
        return error_at(at, "%zu numbers in \"%s\" for %u by %u control points, which need %zu",
                        nurbs->number_count, nurbs->rational ? "Pw" : "P", surface.u.count, surface.v.count,
                        points * size);
    mesh_reserve(mesh, NURBS_DICE * NURBS_DICE, 2 * NURBS_DICE * NURBS_DICE, true, true);
    for (uint32_t j = 0; j < NURBS_DICE; ++j)
        for (uint32_t i = 0; i < NURBS_DICE; ++i) TRY(add_sample(&surface, i, j, at, mesh));
    mesh_grid(mesh, 0, NURBS_DICE, NURBS_DICE);
    return result_ok();
}
