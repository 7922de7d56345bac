/* shape_curve: curves, taken to cubic Bezier segments with a radius at each control point.
 *
 * A quadratic segment is raised to degree 3; a segment of a uniform B-spline becomes Bezier by its polar form
 * (Ramshaw 1989, "Blossoms Are Polar Forms"). The width changes linearly along all segments. */
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

#include "client/import/pbrt/materials/materials.h"
#include "client/import/pbrt/shapes/shapes.h"

typedef struct {
    curves_kind_t kind;
    bool spline; /* a uniform B-spline; else Bezier */
    int degree;
    double widths[2]; /* at the beginning and the end */
    const double *points, *normals;
    size_t point_count, segments;
} curve_t;

/* ---- reading ------------------------------------------------------------------------------------------ */

static result_t read_kind(pbrt_t *p, shape_work_t *work, curve_t *curve)
{
    const char *type = "flat", *basis = "bezier";
    TRY(params_string(work->params, "type", &type));
    TRY(params_string(work->params, "basis", &basis));
    curve->kind = strcmp(type, "ribbon") == 0 ? CURVES_RIBBON : CURVES_ROUND;
    curve->spline = strcmp(basis, "bspline") == 0;
    if (curve->kind == CURVES_ROUND && strcmp(type, "flat") != 0 && strcmp(type, "cylinder") != 0)
        TRY(report_tolerate(p->report, params_where(work->params, "type", work->at),
                            "a curve is of type \"flat\", \"ribbon\" or \"cylinder\", not \"%.40s\"; it is "
                            "\"cylinder\", as by pbrt",
                            type));
    if (!curve->spline && strcmp(basis, "bezier") != 0)
        return error_at(params_where(work->params, "basis", work->at),
                        "the basis of a curve is \"bezier\" or \"bspline\", not \"%.40s\"", basis);
    bool flat = strcmp(type, "flat") == 0;
    if (curve->kind == CURVES_ROUND && pbrt_material_may_be_hair(p))
        curve->kind = flat ? CURVES_FLAT_FIBRE : CURVES_FIBRE;
    if (flat && curve->kind == CURVES_ROUND) pbrt_warn_of_flat_curves(p, work->at);
    return result_ok();
}

static result_t count_segments(shape_work_t *work, curve_t *curve)
{
    size_t count = curve->point_count, degree = (size_t)curve->degree;
    position_t at = params_where(work->params, "P", work->at);
    if (count < degree + 1)
        return error_at(at, "%zu control points, but a curve of degree %zu needs %zu", count, degree,
                        degree + 1);
    if (!curve->spline && (count - 1) % degree)
        return error_at(at,
                        "%zu control points, but Bezier curves of degree %zu need %zu, and %zu more for "
                        "each further segment",
                        count, degree, degree + 1, degree);
    curve->segments = curve->spline ? count - degree : (count - 1) / degree;
    if (curve->segments >= BLOB_NONE / 4) return error_at(at, "too many control points");
    return result_ok();
}

static result_t read_normals(pbrt_t *p, shape_work_t *work, curve_t *curve)
{
    size_t count;
    unsigned types = PARAM_BIT(PARAM_NORMAL3) | PARAM_BIT(PARAM_VECTOR3);
    position_t at = params_where(work->params, "N", work->at);
    TRY(params_array(work->params, "N", types, 3, &curve->normals, &count));
    if (curve->kind != CURVES_RIBBON) {
        if (count) report_warning(p->report, at, "normals are only used with ribbons");
        return result_ok();
    }
    if (count / 3 != curve->segments + 1)
        return error_at(at, "a ribbon of %zu segments needs %zu normals \"N\", found %zu", curve->segments,
                        curve->segments + 1, count / 3);
    return result_ok();
}

static result_t read_curve(pbrt_t *p, shape_work_t *work, curve_t *curve)
{
    double width = 1;
    int32_t degree = 3, depth;
    params_t *params = work->params;
    TRY(read_kind(p, work, curve));
    TRY(params_float_in(params, "width", 0, 1e18, &width));
    curve->widths[0] = curve->widths[1] = width;
    TRY(params_float_in(params, "width0", 0, 1e18, &curve->widths[0]));
    TRY(params_float_in(params, "width1", 0, 1e18, &curve->widths[1]));
    TRY(params_int_in(params, "degree", 2, 3, &degree));
    curve->degree = degree;
    if (!params_find(params, "splitdepth", PARAM_BIT(PARAM_FLOAT), NULL))       /* v3 takes a float as well */
        TRY(params_int_in(params, "splitdepth", INT32_MIN, INT32_MAX, &depth)); /* how pbrt goes about it */
    TRY(params_array(params, "P", PARAM_BIT(PARAM_POINT3), 3, &curve->points, &curve->point_count));
    curve->point_count /= 3;
    TRY(count_segments(work, curve));
    return read_normals(p, work, curve);
}

/* ---- segments ----------------------------------------------------------------------------------------- */

static void blend(const double a[3], const double b[3], double t, double out[3])
{
    for (int i = 0; i < 3; ++i) out[i] = (1 - t) * a[i] + t * b[i];
}

/* The Bezier points of a quadratic, of degree 3. */
static void raise_degree(const double quadratic[3][3], double cubic[4][3])
{
    memcpy(cubic[0], quadratic[0], sizeof cubic[0]);
    blend(quadratic[0], quadratic[1], 2.0 / 3, cubic[1]);
    blend(quadratic[1], quadratic[2], 1.0 / 3, cubic[2]);
    memcpy(cubic[3], quadratic[2], sizeof cubic[3]);
}

static void bezier_segment(const curve_t *curve, size_t segment, double cubic[4][3])
{
    const double(*c)[3] =
        (const double(*)[3])(curve->points + 3 * segment * (size_t)(curve->spline ? 1 : curve->degree));
    double quadratic[3][3], before[3], after[3];
    if (curve->degree == 2) {
        memcpy(quadratic, c, sizeof quadratic);
        if (curve->spline) {
            blend(c[0], c[1], 0.5, quadratic[0]);
            blend(c[1], c[2], 0.5, quadratic[2]);
        }
        raise_degree((const double(*)[3])quadratic, cubic);
    } else if (curve->spline) {
        blend(c[0], c[1], 2.0 / 3, before);
        blend(c[1], c[2], 1.0 / 3, cubic[1]);
        blend(c[1], c[2], 2.0 / 3, cubic[2]);
        blend(c[2], c[3], 1.0 / 3, after);
        blend(before, cubic[1], 0.5, cubic[0]);
        blend(cubic[2], after, 0.5, cubic[3]);
    } else {
        memcpy(cubic, c, 4 * sizeof *cubic);
    }
}

static result_t fill_points(const curve_t *curve, const shape_work_t *work, double scale,
                            blob_curve_point_t *points)
{
    for (size_t s = 0; s < curve->segments; ++s) {
        double cubic[4][3];
        bezier_segment(curve, s, cubic);
        for (size_t k = 0; k < 4; ++k) {
            double t = ((double)s + (double)k / 3) / (double)curve->segments;
            double width = (1 - t) * curve->widths[0] + t * curve->widths[1];
            vec3_t v =
                affine_point(&work->placed, vec3((float)cubic[k][0], (float)cubic[k][1], (float)cubic[k][2]));
            float radius = (float)(scale * width / 2);
            if (!v_is_finite(v) || !(fmaxf(fmaxf(fabsf(v.x), fabsf(v.y)), fabsf(v.z)) < 1e18f) ||
                !isfinite(radius))
                return error_at(work->at,
                                "segment %zu of the curve: coordinates must be finite and below 1e18", s);
            points[4 * s + k] = (blob_curve_point_t){v.x, v.y, v.z, radius};
        }
        if (!blob_segment_is_traceable(points + 4 * s))
            return error_at(work->at,
                            "segment %zu of the curve is smaller than 1e-30: scale it up or leave it out", s);
    }
    return result_ok();
}

/* Normals turn evenly along a segment. */
static void fill_normals(const curve_t *curve, const affine_t *inverse, vec3_t *normals)
{
    for (size_t s = 0; s < curve->segments; ++s) {
        vec3_t ends[2];
        for (size_t k = 0; k < 2; ++k) {
            const double *n = curve->normals + 3 * (s + k);
            ends[k] = affine_normal(inverse, vec3((float)n[0], (float)n[1], (float)n[2]));
            if (v_is_zero(ends[k])) ends[k] = vec3(0, 0, 1);
        }
        double cosine = fmin(fmax((double)v_dot(ends[0], ends[1]), -1), 1), angle = acos(cosine);
        for (int k = 0; k < 4; ++k) {
            double t = k / 3.0, from = 1 - t, to = t;
            if (angle > 1e-3 && angle < 3.14) {
                from = sin((1 - t) * angle);
                to = sin(t * angle);
            }
            vec3_t n = v_mad(v_scale(ends[0], (float)from), (float)to, ends[1]);
            normals[4 * s + (size_t)k] = v_is_zero(n) ? ends[0] : v_normalize(n);
        }
    }
}

static result_t add_curves(pbrt_t *p, shape_work_t *work, const curve_t *curve)
{
    affine_t inverse;
    bool uniform;
    double scale = affine_scale(&work->placed, &uniform);
    if (!affine_invert(&work->placed, &inverse))
        return error_at(work->at, "the current transform is singular or not finite");
    if (!uniform)
        report_warning(p->report, work->at,
                       "the transform stretches this curve: its width is scaled by the mean of the stretch");
    uint32_t count = 4 * (uint32_t)curve->segments;
    blob_curve_point_t *points = mem_zalloc(count, sizeof *points);
    result_t result = fill_points(curve, work, scale, points);
    if (result.code == RESULT_OK) {
        blob_curves_t curves = {
            .kind = curve->kind, .segment_count = (uint32_t)curve->segments, .first_normal = BLOB_NONE};
        curves.first_point = blob_builder_add(p->builder->blob, BLOB_SECTION_CURVE_POINTS, points, count);
        if (curve->kind == CURVES_RIBBON) {
            vec3_t *normals = mem_zalloc(count, sizeof *normals);
            fill_normals(curve, &inverse, normals);
            curves.first_normal = blob_builder_add(p->builder->blob, BLOB_SECTION_NORMALS, normals, count);
            free(normals);
        }
        work->shape.geometry = blob_builder_add(p->builder->blob, BLOB_SECTION_CURVES, &curves, 1);
    }
    free(points);
    return result;
}

result_t pbrt_make_curve(pbrt_t *p, shape_work_t *work)
{
    curve_t curve = {0};
    TRY(read_curve(p, work, &curve));
    work->shape.kind = SHAPE_CURVES;
    work->shape.flags = p->now.reverse ? SHAPE_FLIP : 0;
    if (curve.widths[0] == 0 && curve.widths[1] == 0) {
        report_warning(p->report, work->at, "a curve without width is left out");
        return result_ok();
    }
    return add_curves(p, work, &curve);
}
