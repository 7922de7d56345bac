/* transforms: the directives that change the current transform (CTM). pbrt multiplies on the right: the
 * transform nearest to the shape applies first. The CTM is invertible at all times. */
#include "client/import/pbrt/transforms.h"
#include "client/import/pbrt/state/arguments.h"

static result_t check(const affine_t *ctm, position_t at)
{
    affine_t inverse;
    if (!affine_invert(ctm, &inverse))
        return error_at(at, "the current transform becomes singular or too large here");
    return result_ok();
}

static result_t set(pbrt_t *p, affine_t ctm, position_t at)
{
    TRY(check(&ctm, at));
    if (p->now.active & ACTIVE_START) p->now.ctm = ctm;
    if (p->now.active & ACTIVE_END) p->now.ctm_end = ctm;
    return result_ok();
}

static result_t concatenate(pbrt_t *p, const affine_t *t, position_t at)
{
    affine_t start = affine_multiply(&p->now.ctm, t), end = affine_multiply(&p->now.ctm_end, t);
    TRY(check(&start, at));
    TRY(check(&end, at));
    if (p->now.active & ACTIVE_START) p->now.ctm = start;
    if (p->now.active & ACTIVE_END) p->now.ctm_end = end;
    return result_ok();
}

result_t pbrt_identity(pbrt_t *p, position_t at)
{
    return set(p, affine_identity(), at);
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
    if (v[0] == 0 || v[1] == 0 || v[2] == 0)
        return error_at(at, "Scale by 0 flattens everything; use a small number instead");
    affine_t t = affine_scaling(v);
    return concatenate(p, &t, at);
}

result_t pbrt_rotate(pbrt_t *p, position_t at)
{
    double v[4];
    TRY(pbrt_read_numbers(p, 4, v, "Rotate", at));
    affine_t t;
    if (!affine_rotation(v[0], v + 1, &t)) return error_at(at, "the axis of this Rotate has no direction");
    return concatenate(p, &t, at);
}

result_t pbrt_look_at(pbrt_t *p, position_t at)
{
    double v[9];
    TRY(pbrt_read_numbers(p, 9, v, "LookAt", at));
    affine_t t;
    if (!affine_look_at(v, v + 3, v + 6, &t))
        return error_at(
            at, "this LookAt has no direction: the eye is at the target, or up points along the view");
    return concatenate(p, &t, at);
}

static result_t read_matrix(pbrt_t *p, const char *directive, affine_t *t, position_t at)
{
    double v[16];
    TRY(pbrt_read_numbers(p, 16, v, directive, at));
    if (!affine_from_columns(v, t))
        return error_at(at, "%s: not an affine transform (numbers 4, 8 and 12 must be 0, number 16 must not)",
                        directive);
    return result_ok();
}

result_t pbrt_transform(pbrt_t *p, position_t at)
{
    affine_t t;
    TRY(read_matrix(p, "Transform", &t, at));
    return set(p, t, at);
}

result_t pbrt_concat_transform(pbrt_t *p, position_t at)
{
    affine_t t;
    TRY(read_matrix(p, "ConcatTransform", &t, at));
    return concatenate(p, &t, at);
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
        return error_at(at, "no CoordinateSystem \"%.60s\" has been named before", p->arguments[0]);
    p->now.ctm = p->systems[index][0]; /* both, whatever ActiveTransform says, as in either pbrt */
    p->now.ctm_end = p->systems[index][1];
    return result_ok();
}

result_t pbrt_active_transform(pbrt_t *p, position_t at)
{
    token_t token;
    char quote[TOKEN_QUOTE_SIZE];
    TRY(lexer_next(p->lexer, &token));
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
