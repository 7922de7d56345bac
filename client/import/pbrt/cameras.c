/* cameras: see cameras.h. A camera that we do not have makes another picture and is an error. */
#include "client/import/pbrt/cameras.h"

#include "client/import/pbrt/realistic.h"
#include "client/import/pbrt/settings.h"
#include "client/import/pbrt/state/arguments.h"

#include <string.h>

static result_t read_fov(pbrt_t *p, params_t *params)
{
    const double most = 179.9;
    double fov = (double)p->scene.fov, half;
    TRY(params_float_in(params, "fov", 1e-3, most, &fov));
    if (p->dialect.dialect == DIALECT_V3 && params_has(params, "halffov")) {
        half = fov / 2;
        TRY(params_float_in(params, "halffov", 5e-4, most / 2, &half));
        fov = 2 * half;
    }
    p->scene.fov = (float)fov;
    return result_ok();
}

static result_t read_window(pbrt_t *p, params_t *params)
{
    const double *window;
    size_t count;
    TRY(params_float_in(params, "frameaspectratio", 1e-3, 1e3, &p->frame_aspect));
    TRY(params_array(params, "screenwindow", PARAM_BIT(PARAM_FLOAT), 4, &window, &count));
    if (count == 0) return result_ok();
    if (count != 4 || !(window[0] < window[1]) || !(window[2] < window[3]))
        return error_at(params_where(params, "screenwindow", p->camera_at),
                        "screenwindow takes x min, x max, y min, y max, each minimum below its maximum");
    for (int i = 0; i < 4; ++i) p->scene.screen_window[i] = (float)window[i];
    return result_ok();
}

/* A shutter that closes before it opens is turned round in v3, as in pbrt; in v4 it lets no light in. */
static result_t read_shutter(pbrt_t *p, params_t *params)
{
    double open = 0, close = 1;
    TRY(params_float_in(params, "shutteropen", -1e30, 1e30, &open));
    TRY(params_float_in(params, "shutterclose", -1e30, 1e30, &close));
    if (p->dialect.dialect == DIALECT_V4 && !(close > open))
        return error_at(params_where(params, "shutterclose", p->camera_at),
                        "the shutter closes at %g, but opens at %g: no light comes in", close, open);
    p->shutter[0] = fmin(open, close);
    p->shutter[1] = fmax(open, close);
    return result_ok();
}

static result_t read_lens(pbrt_t *p, params_t *params)
{
    double radius = 0, distance = 1e6;
    TRY(params_float_in(params, "lensradius", 0, 1e18, &radius));
    TRY(params_float_in(params, "focaldistance", -1e30, 1e30, &distance));
    if (radius > 0 && !((float)distance > 0))
        return error_at(params_where(params, "focaldistance", p->camera_at),
                        "focaldistance is %g, but must be positive", distance);
    p->scene.lens_radius = (float)radius;
    p->scene.focal_distance = (float)distance > 0 ? (float)distance : 1e6f;
    return result_ok();
}

static result_t make_perspective(pbrt_t *p, params_t *params)
{
    TRY(read_fov(p, params));
    TRY(read_window(p, params));
    TRY(read_lens(p, params));
    return read_shutter(p, params);
}

/* A lens makes pbrt's orthographic camera another one. Rays start on the lens about the axis, wherever on the
 * film they belong, and meet in the plane of focus what the film shows without the lens: so does a
 * perspective camera whose screen window is that plane. */
static result_t look_through_lens(pbrt_t *p, position_t at)
{
    const double degrees = 180 / M_PI, distance = (double)p->scene.focal_distance;
    if (!(distance >= 1e-3 && distance <= 1e8))
        return error_at(at, "an orthographic camera with a lens needs a focaldistance from 1e-3 to 1e8");
    p->scene.camera = CAMERA_PERSPECTIVE;
    p->scene.fov = (float)(2 * atan(1 / distance) * degrees);
    report_warning(
        p->report, at,
        "an orthographic camera with a lens: as in pbrt, all rays start on the lens, and the screen "
        "window lies in the plane of focus, so the picture has perspective");
    return result_ok();
}

static result_t make_orthographic(pbrt_t *p, params_t *params)
{
    p->scene.camera = CAMERA_ORTHOGRAPHIC;
    TRY(read_window(p, params));
    TRY(read_lens(p, params));
    TRY(read_shutter(p, params));
    if (p->scene.lens_radius == 0) return result_ok();
    return look_through_lens(p, params_where(params, "lensradius", p->camera_at));
}

/* The lens and the window mean nothing to a camera that looks everywhere; pbrt reads them, too. */
static const param_rule_t sphere_rules[] = {
    {{"lensradius", "focaldistance", "frameaspectratio", "screenwindow"}, PARAM_ACCEPT, NULL},
};

static result_t make_environment(pbrt_t *p, params_t *params)
{
    p->scene.camera = CAMERA_SPHERICAL;
    TRY(read_shutter(p, params));
    return params_apply(params, sphere_rules, ARRAY_LENGTH(sphere_rules), p->report);
}

static result_t make_spherical(pbrt_t *p, params_t *params)
{
    const char *mapping = "equalarea";
    TRY(params_string(params, "mapping", &mapping));
    TRY(make_environment(p, params));
    if (strcmp(mapping, "equirectangular") == 0) return result_ok();
    if (strcmp(mapping, "equalarea") != 0)
        return error_at(params_where(params, "mapping", p->camera_at),
                        "a spherical camera's mapping is \"equalarea\" or \"equirectangular\", not \"%.40s\"",
                        mapping);
    p->scene.camera = CAMERA_EQUAL_AREA;
    return result_ok();
}

/* A lens that cannot be had becomes a pinhole when lenient. */
static result_t make_realistic(pbrt_t *p, params_t *params)
{
    TRY(read_shutter(p, params));
    result_t result = pbrt_make_realistic(p, params);
    if (result.code == RESULT_OK) return result;
    static const float automatic[4] = {0};
    memcpy(p->scene.screen_window, automatic, sizeof automatic);
    p->scene.aperture = 0;
    return report_excuse(p->report, result, "a perspective camera of 90 degrees is used");
}

static const setting_entry_t cameras[] = {
    {{"perspective", DIALECT_BOTH}, make_perspective}, {{"orthographic", DIALECT_BOTH}, make_orthographic},
    {{"environment", DIALECT_V3}, make_environment},   {{"spherical", DIALECT_V4}, make_spherical},
    {{"realistic", DIALECT_BOTH}, make_realistic},
};

/* A scale of the camera's space scales what is in it, as in pbrt. */
result_t pbrt_camera(pbrt_t *p, position_t at)
{
    TRY(setting_keep(p, SETTING_CAMERA, "Camera", "a type", at));
    if (!affine_invert(&p->now.ctm, &p->camera[0]) || !affine_invert(&p->now.ctm_end, &p->camera[1]))
        return error_at(at, "the current transform is singular or not finite");
    p->camera_medium = p->now.media[1];
    pbrt_name_coordinates(p, "camera", &p->camera[0], &p->camera[1]);
    return result_ok();
}

result_t pbrt_make_camera(pbrt_t *p, position_t at)
{
    p->camera_at = at;
    return setting_make(p, cameras, ARRAY_LENGTH(cameras), "Camera", "camera", at);
}
