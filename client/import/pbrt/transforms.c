/* transforms: the directives that change the current transform (CTM). pbrt multiplies on the right: the
 * transform nearest to the shape applies first.
 *
 * A CTM that is singular is tolerated, as in pbrt, until something uses it; one that makes no sense at all is
 * not a number. What uses a CTM sees that it can be inverted. */
#include "client/import/pbrt/transforms.h"
#include "client/import/pbrt/state/arguments.h"

static affine_t no_transform(void)
{
    affine_t t;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 4; ++j) t.m[i][j] = NAN;
    return t;
}

static bool is_invertible(const affine_t *t)
{
    affine_t inverse;
    return affine_invert(t, &inverse);
}

/* Makes the CTM at both times what it is to be, where ActiveTransform says so. What was singular before has
 * been told. */
static result_t set(pbrt_t *p, const affine_t *start, const affine_t *end, bool told, position_t at)
{
    bool good = is_invertible(start) && is_invertible(end);
    bool before = told || !(is_invertible(&p->now.ctm) && is_invertible(&p->now.ctm_end));
    if (p->now.active & ACTIVE_START) p->now.ctm = *start;
    if (p->now.active & ACTIVE_END) p->now.ctm_end = *end;
    if (good || before) return result_ok();
    return report_tolerate(p->report, at,
                           "the current transform becomes singular or too large here; nothing must use it");
}

static result_t concatenate(pbrt_t *p, const affine_t *t, position_t at)
{
    affine_t start = affine_multiply(&p->now.ctm, t), end = affine_multiply(&p->now.ctm_end, t);
    return set(p, &start, &end, false, at);
}

/* The same by a transform that makes no sense, of which a message tells. */
static result_t spoil(pbrt_t *p, result_t told, position_t at)
{
    affine_t t = no_transform();
    TRY(told);
    return set(p, &t, &t, true, at);
}

result_t pbrt_identity(pbrt_t *p, position_t at)
{
    affine_t identity = affine_identity();
    return set(p, &identity, &identity, true, at);
}

result_t pbrt_translate(pbrt_t *p, position_t at)
{
    double v[3];
    TRY(pbrt_read_numbers(p, 3, v, "Translate", at));
    affine_t t = affine_translation(v);
    return concatenate(p, &t, at);
}

result_t pbrt_scale(pbrt_t *p, position_t at)
{
    double v[3];
    TRY(pbrt_read_numbers(p, 3, v, "Scale", at));
    affine_t t = affine_scaling(v);
    return concatenate(p, &t, at);
}

result_t pbrt_rotate(pbrt_t *p, position_t at)
{
    double v[4];
    TRY(pbrt_read_numbers(p, 4, v, "Rotate", at));
    affine_t t;
    if (!affine_rotation(v[0], v + 1, &t))
        return spoil(
            p,
            report_tolerate(p->report, at, "the axis of this Rotate has no direction; nothing must use it"),
            at);
    return concatenate(p, &t, at);
}

/* pbrt-v3 leaves the CTM as it is when up points along the view; v4 refuses. */
static result_t look_nowhere(pbrt_t *p, const double v[9], position_t at)
{
    bool same = v[0] == v[3] && v[1] == v[4] && v[2] == v[5];
    const char *what = "this LookAt has no direction: the eye is at the target, or up points along the view";
    if (same || p->dialect.dialect == DIALECT_V4) return error_at(at, "%s", what);
    return report_tolerate(p->report, at, "%s; it is left out, as by pbrt-v3", what);
}

result_t pbrt_look_at(pbrt_t *p, position_t at)
{
    double v[9];
    TRY(pbrt_read_numbers(p, 9, v, "LookAt", at));
    affine_t t;
    if (!affine_look_at(v, v + 3, v + 6, &t)) return look_nowhere(p, v, at);
    return concatenate(p, &t, at);
}

/* *affine is false when the matrix is none that leaves w alone. */
static result_t read_matrix(pbrt_t *p, const char *directive, affine_t *t, bool *affine, position_t at)
{
    double v[16];
    TRY(pbrt_read_numbers(p, 16, v, directive, at));
    *affine = affine_from_columns(v, t);
    if (*affine) return result_ok();
    return report_tolerate(p->report, at,
                           "%s: not an affine transform (numbers 4, 8 and 12 must be 0, number 16 must not); "
                           "nothing must use it",
                           directive);
}

result_t pbrt_transform(pbrt_t *p, position_t at)
{
    affine_t t;
    bool affine;
    TRY(read_matrix(p, "Transform", &t, &affine, at));
    return affine ? set(p, &t, &t, false, at) : spoil(p, result_ok(), at);
}

result_t pbrt_concat_transform(pbrt_t *p, position_t at)
{
    affine_t t;
    bool affine;
    TRY(read_matrix(p, "ConcatTransform", &t, &affine, at));
    return affine ? concatenate(p, &t, at) : spoil(p, result_ok(), at);
}

result_t pbrt_coordinate_system(pbrt_t *p, position_t at)
{
    (void)at;
    TRY(pbrt_read_string(p, 0, "the name of a coordinate system"));
    pbrt_name_coordinates(p, p->arguments[0], &p->now.ctm, &p->now.ctm_end);
    return result_ok();
}

result_t pbrt_coord_sys_transform(pbrt_t *p, position_t at)
{
    uint32_t index;
    TRY(pbrt_read_string(p, 0, "the name of a coordinate system"));
    if (!names_find(&p->coordinates, p->arguments[0], &index))
        return report_tolerate(
            p->report, at,
            "no CoordinateSystem \"%.60s\" has been named before; this is left out, as by pbrt",
            p->arguments[0]);
    p->now.ctm = p->systems[index][0]; /* both, whatever ActiveTransform says, as in either pbrt */
    p->now.ctm_end = p->systems[index][1];
    return result_ok();
}

result_t pbrt_active_transform(pbrt_t *p, position_t at)
{
    token_t token;
    char quote[TOKEN_QUOTE_SIZE];
    TRY(lexer_next(&p->lexer, &token));
    if (token_is(&token, "All"))
        p->now.active = ACTIVE_START | ACTIVE_END;
    else if (token_is(&token, "StartTime"))
        p->now.active = ACTIVE_START;
    else if (token_is(&token, "EndTime"))
        p->now.active = ACTIVE_END;
    else
        return error_at(token.at, "expected All, StartTime or EndTime, found %s", token_quote(&token, quote));
    (void)at;
    return result_ok();
}

result_t pbrt_transform_times(pbrt_t *p, position_t at)
{
    double v[2];
    TRY(pbrt_read_numbers(p, 2, v, "TransformTimes", at));
    if (!(v[0] <= v[1])) return error_at(at, "TransformTimes: the start must not come after the end");
    p->transform_times[0] = v[0];
    p->transform_times[1] = v[1];
    return result_ok();
}
