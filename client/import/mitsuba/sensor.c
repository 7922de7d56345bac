/* sensor: see sensor.h. */
#include "client/import/mitsuba/sensor.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "common/job.h"

static const double degrees = 180 / 3.14159265358979323846;
enum { DEEPEST = 100 };

/* ---- film ---------------------------------------------------------------------------------------------- */

static const struct {
    const char *type;
    blob_filter_t filter;
} filters[] = {
    {"box", {FILTER_BOX, 0.5f, 0.5f, {0, 0}}},
    {"tent", {FILTER_TRIANGLE, 1, 1, {0, 0}}},
    {"gaussian", {FILTER_GAUSSIAN, 2, 2, {0.5f, 0}}},
    {"mitchell", {FILTER_MITCHELL, 2, 2, {1 / 3.0f, 1 / 3.0f}}},
    {"catmullrom", {FILTER_MITCHELL, 2, 2, {0, 0.5f}}},
    {"lanczos", {FILTER_SINC, 3, 3, {3, 0}}},
};
enum { BOX = 0, GAUSSIAN = 2 }; /* what there is by default */

/* What a filter says of itself. */
static result_t read_shape(mitsuba_t *m, const element_t *element, blob_filter_t *filter)
{
    double sigma = 0.5, radius = 0.5, lobes = 3, b = (double)filter->parameters[0],
           c = (double)filter->parameters[1];
    TRY(property_number(m, element, "stddev", 0.05, 8, &sigma));
    TRY(property_number(m, element, "B", -10, 10, &b));
    TRY(property_number(m, element, "C", -10, 10, &c));
    TRY(property_number(m, element, "lobes", 1, 16, &lobes));
    TRY(property_number(m, element, "radius", 0.05, 8, &radius));
    if (filter->kind == FILTER_BOX) filter->radius_x = filter->radius_y = (float)radius;
    if (filter->kind == FILTER_MITCHELL) filter->parameters[0] = (float)b, filter->parameters[1] = (float)c;
    if (filter->kind == FILTER_GAUSSIAN) {
        filter->parameters[0] = (float)sigma;
        filter->radius_x = filter->radius_y = (float)(4 * sigma);
    }
    if (filter->kind == FILTER_SINC)
        filter->parameters[0] = filter->radius_x = filter->radius_y = (float)floor(lobes);
    return object_finish(m, element);
}

/* `otherwise`: the filter of a film that names none. */
static result_t read_filter(mitsuba_t *m, element_t *film, size_t otherwise)
{
    element_t *found;
    TRY(object_only(m, film, "rfilter", &found));
    size_t i = found ? 0 : otherwise;
    while (found && i < ARRAY_LENGTH(filters) && strcmp(object_type(found), filters[i].type) != 0) ++i;
    if (i == ARRAY_LENGTH(filters))
        return report_refuse(m->report, found->at,
                             "filter \"%.40s\" is not supported; the nearest is gaussian",
                             object_type(found));
    m->record.filter = filters[i].filter;
    return found ? read_shape(m, found, &m->record.filter) : result_ok();
}

/* What says how the image is written, or shown, not what it is. */
static void ignore_formats(element_t *film)
{
    static const char *const names[] = {
        "fileFormat", "pixelFormat",  "componentFormat", "banner", "attachLog", "highQualityEdges",
        "gamma",      "exposure",     "tonemapMethod",   "key",    "burn",      "variable",
        "digits",     "channelNames",
    };
    for (size_t i = 0; i < ARRAY_LENGTH(names); ++i) property_ignore(film, names[i]);
}

/* The window of the whole film, whose shorter side spans [-1, 1]: of a film that is shown in part. */
static void set_window(mitsuba_t *m, double aspect)
{
    const float x = (float)fmax(aspect, 1), y = (float)fmax(1 / aspect, 1), window[4] = {-x, x, -y, y};
    memcpy(m->record.screen_window, window, sizeof window);
}

/* A crop shows its part of the whole film. */
static result_t read_crop(mitsuba_t *m, const element_t *film, double width, double height)
{
    double x = 0, y = 0, crop_width = width, crop_height = height;
    TRY(property_number(m, film, "cropOffsetX", 0, width - 1, &x));
    TRY(property_number(m, film, "cropOffsetY", 0, height - 1, &y));
    TRY(property_number(m, film, "cropWidth", 1, width - x, &crop_width));
    TRY(property_number(m, film, "cropHeight", 1, height - y, &crop_height));
    const float window[4] = {(float)(x / width), (float)((x + crop_width) / width), (float)(y / height),
                             (float)((y + crop_height) / height)};
    memcpy(m->record.film_window, window, sizeof window);
    m->record.width = (int32_t)crop_width;
    m->record.height = (int32_t)crop_height;
    if (crop_width != width || crop_height != height) set_window(m, width / height);
    return result_ok();
}

/* What Mitsuba has without a film and a sampler. */
enum { WIDTH = 768, HEIGHT = 576, SAMPLES = 4 };

static void default_film(mitsuba_t *m)
{
    m->record.width = WIDTH;
    m->record.height = HEIGHT;
    m->record.filter = filters[GAUSSIAN].filter;
    m->record.spp = SAMPLES;
}

/* *aspect is that of the whole film. A film for other programs to count with is one pixel if it does not say.
 */
static result_t read_film(mitsuba_t *m, const element_t *sensor, double *aspect)
{
    element_t *film;
    double width = WIDTH, height = HEIGHT;
    default_film(m);
    TRY(object_only(m, sensor, "film", &film));
    if (film) {
        bool numbers = strcmp(object_type(film), "mfilm") == 0;
        if (numbers) width = height = 1;
        TRY(property_number(m, film, "width", 1, 65535, &width));
        TRY(property_number(m, film, "height", 1, 65535, &height));
        TRY(read_filter(m, film, numbers ? BOX : GAUSSIAN));
        TRY(read_crop(m, film, floor(width), floor(height)));
        ignore_formats(film);
        TRY(object_finish(m, film));
    }
    *aspect = floor(width) / floor(height);
    return result_ok();
}

static result_t read_sampler(mitsuba_t *m, const element_t *sensor)
{
    element_t *sampler;
    double count = SAMPLES;
    TRY(object_only(m, sensor, "sampler", &sampler));
    if (sampler) {
        TRY(property_number(m, sampler, "sampleCount", 1, 1e9, &count));
        property_ignore(sampler, "seed"); /* which numbers it draws */
        property_ignore(sampler, "scramble");
        property_ignore(sampler, "dimension");
        TRY(object_finish(m, sampler));
    }
    m->record.spp = (uint32_t)count;
    return result_ok();
}

/* ---- lenses -------------------------------------------------------------------------------------------- */

/* Half the film's width at distance 1, from fov and its axis, or from a focal length for film of 36 x 24 mm.
 */
static result_t read_half_width(mitsuba_t *m, const element_t *sensor, double aspect, double *half)
{
    double fov = 0, length = 50;
    const char *axis = "x", *text = NULL;
    TRY(property_number(m, sensor, "fov", 1e-3, 179.99, &fov));
    TRY(property_string(m, sensor, "fovAxis", &axis));
    TRY(property_string(m, sensor, "focalLength", &text));
    if (text) length = strtod(text, NULL);
    if (!(length > 1e-3 && length < 1e6)) return error_at(sensor->at, "focalLength must be like \"50mm\"");
    double diagonal = 1 / sqrt(1 + 1 / (aspect * aspect)); /* the width is this part of it */
    double tangent = tan(fov / 2 / degrees);
    if (strcasecmp(axis, "smaller") == 0) axis = aspect > 1 ? "y" : "x";
    if (strcasecmp(axis, "larger") == 0) axis = aspect > 1 ? "x" : "y";
    if (fov == 0)
        *half = sqrt(36.0 * 36 + 24 * 24) / (2 * length) * diagonal;
    else if (strcasecmp(axis, "x") == 0)
        *half = tangent;
    else if (strcasecmp(axis, "y") == 0)
        *half = tangent * aspect;
    else if (strcasecmp(axis, "diagonal") == 0)
        *half = tangent * diagonal;
    else
        return error_at(sensor->at, "fovAxis must be x, y, diagonal, smaller or larger, found \"%.20s\"",
                        axis);
    return result_ok();
}

static result_t read_perspective(mitsuba_t *m, const element_t *sensor, double aspect)
{
    double half = 0;
    m->record.camera = CAMERA_PERSPECTIVE;
    TRY(read_half_width(m, sensor, aspect, &half));
    m->record.fov = (float)(2 * atan(aspect > 1 ? half / aspect : half) * degrees);
    return result_ok();
}

/* Of thinlens and telecentric, in the world's units. */
static result_t read_aperture(mitsuba_t *m, const element_t *sensor)
{
    double radius = 0, focus = 1e4;
    TRY(property_number(m, sensor, "farClip", 1e-18, 1e30, &focus));
    TRY(property_number(m, sensor, "focusDistance", 1e-18, 1e18, &focus));
    TRY(property_number(m, sensor, "apertureRadius", 0, 1e18, &radius));
    m->record.lens_radius = (float)radius;
    m->record.focal_distance = (float)focus;
    return result_ok();
}

/* The film spans [-1, 1] along x in the sensor's space, whose scale is the size of what is seen. */
static void set_orthographic(mitsuba_t *m, const affine_t *world_from_sensor, double aspect)
{
    double size[2];
    for (int k = 0; k < 2; ++k) {
        double sum = 0;
        for (int i = 0; i < 3; ++i) sum += world_from_sensor->m[i][k] * world_from_sensor->m[i][k];
        size[k] = sqrt(sum);
    }
    const float x = (float)size[0], y = (float)(size[1] / aspect), window[4] = {-x, x, -y, y};
    memcpy(m->record.screen_window, window, sizeof window);
    m->record.camera = CAMERA_ORTHOGRAPHIC;
}

static result_t read_lens(mitsuba_t *m, element_t *sensor, const affine_t *world_from_sensor, double aspect)
{
    static const char *const ignored[] = {"nearClip", "farClip", "focusDistance"};
    const char *type = object_type(sensor);
    bool thin = strcmp(type, "thinlens") == 0, telecentric = strcmp(type, "telecentric") == 0;
    bool known = thin || strcmp(type, "perspective") == 0;
    if (thin && !property_find(sensor, "apertureRadius"))
        return error_at(sensor->at, "thinlens needs an apertureRadius");
    if (thin || telecentric) TRY(read_aperture(m, sensor));
    for (size_t i = 0; i < ARRAY_LENGTH(ignored); ++i) property_ignore(sensor, ignored[i]);
    if (telecentric || strcmp(type, "orthographic") == 0) {
        set_orthographic(m, world_from_sensor, aspect);
        return result_ok();
    }
    if (strcmp(type, "spherical") == 0) {
        m->record.camera = CAMERA_SPHERICAL;
        return result_ok();
    }
    if (strcmp(type, "radiancemeter") == 0) { /* the limit of perspective */
        m->record.camera = CAMERA_PERSPECTIVE;
        m->record.fov = 1e-3f;
        return result_ok();
    }
    if (!known)
        TRY(report_refuse(m->report, sensor->at,
                          "sensor \"%.40s\" is not supported; the nearest is perspective", type));
    return read_perspective(m, sensor, aspect);
}

/* Mitsuba's sensors have x to the left of the image; a spherical one begins at -z and goes to +x, where the
 * blob's goes from +x to +z. A transform that mirrors makes the sensor left-handed, and so a picture that is
 * mirrored. */
static result_t place(mitsuba_t *m, const element_t *sensor, const affine_t world_from_sensor[2])
{
    static const affine_t flip = {{{-1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};
    static const affine_t turn = {{{0, 0, 1, 0}, {0, 1, 0, 0}, {-1, 0, 0, 0}}};
    affine_t frames[2];
    for (int i = 0; i < 2; ++i) {
        if (!affine_mirrored_frame(&world_from_sensor[i], &frames[i]))
            return error_at(sensor->at, "the sensor's transform has no direction, or lies beyond 1e18");
        frames[i] = affine_multiply(&frames[i], m->record.camera == CAMERA_SPHERICAL ? &turn : &flip);
    }
    if ((affine_determinant(&frames[0]) < 0) != (affine_determinant(&frames[1]) < 0))
        return error_at(sensor->at, "a sensor may not move from a transform to its mirror image");
    return scene_place_camera(&m->record, &frames[0], &frames[1], sensor->at);
}

result_t sensor_shutter(mitsuba_t *m, const element_t *sensor)
{
    const double most = 1e30;
    TRY(property_number(m, sensor, "shutterOpen", -most, most, &m->shutter[0]));
    TRY(property_number(m, sensor, "shutterClose", -most, most, &m->shutter[1]));
    if (m->shutter[0] <= m->shutter[1]) return result_ok();
    return error_at(sensor->at, "shutterClose (%g) must not come before shutterOpen (%g)", m->shutter[1],
                    m->shutter[0]);
}

result_t sensor_read(mitsuba_t *m, element_t *sensor)
{
    affine_t motion[2];
    double aspect;
    TRY(property_motion(m, sensor, "toWorld", motion));
    TRY(read_film(m, sensor, &aspect));
    TRY(read_sampler(m, sensor));
    TRY(read_lens(m, sensor, &motion[0], aspect));
    TRY(place(m, sensor, motion));
    return object_finish(m, sensor);
}

result_t sensor_default(mitsuba_t *m, const box_t *box)
{
    const double fov = 45, half = tan(fov / 2 / degrees);
    const double width =
        fmax((double)box->high.x - (double)box->low.x, (double)box->high.y - (double)box->low.y);
    const double from[3] = {((double)box->low.x + (double)box->high.x) / 2,
                            ((double)box->low.y + (double)box->high.y) / 2,
                            (double)box->low.z - width / (2 * half)};
    const affine_t there = affine_translation(from), world_from_sensor[2] = {there, there};
    default_film(m);
    m->record.camera = CAMERA_PERSPECTIVE;
    m->record.fov = (float)(2 * atan(half * HEIGHT / WIDTH) * degrees);
    return place(m, m->xml.root, world_from_sensor);
}

/* ---- integrators --------------------------------------------------------------------------------------- */

static result_t read_integrator(mitsuba_t *m, element_t *integrator, int depth);

/* Mitsuba's depth counts what is seen itself: 1 is light alone, 2 one bounce, -1 no bound. */
static result_t read_depth(mitsuba_t *m, const element_t *integrator, double otherwise)
{
    double depth = otherwise;
    TRY(property_number(m, integrator, "maxDepth", -1, 1e9, &depth));
    m->record.max_depth = depth < 0 ? DEEPEST : (int32_t)fmin(fmax(depth - 1, 1), DEEPEST);
    if (depth == 0 || depth == 1)
        report_warning(m->report, integrator->at, "maxDepth %g shows light alone; one bounce is rendered",
                       depth);
    return result_ok();
}

static result_t hidden_emitters(mitsuba_t *m, const element_t *integrator)
{
    bool hide = false;
    TRY(property_bool(m, integrator, "hideEmitters", &hide));
    if (hide)
        report_warning(
            m->report, integrator->at,
            "hideEmitters: they stay where the camera sees them; Mitsuba would not show their light");
    return result_ok();
}

/* An integrator's other parameters say how it works, not what it shows. */
static result_t read_parameters(mitsuba_t *m, const element_t *integrator, double depth)
{
    TRY(hidden_emitters(m, integrator));
    return read_depth(m, integrator, depth);
}

/* Mitsuba's rays are half as long as the radius of the sphere about the scene's box, unless it is told. */
static result_t read_occlusion(mitsuba_t *m, const element_t *integrator)
{
    const box_t box = scene_box(m->scene);
    double length = -1, radius = (double)v_length(v_sub(v_scale(box.high, 0.5f), v_scale(box.low, 0.5f)));
    TRY(property_number(m, integrator, "rayLength", -1e30, 1e30, &length));
    if (length < 0) length = radius / 2;
    m->record.integrator = INTEGRATOR_AO;
    m->record.occlusion_distance = fmaxf((float)length, FLT_MIN);
    report_warning(m->report, integrator->at,
                   "ambient occlusion is black here where there is no surface, and white in Mitsuba");
    return result_ok();
}

/* One that works on the picture of another: what shows the light. */
static result_t read_inner(mitsuba_t *m, element_t *integrator, int depth)
{
    enum { MOST_NESTED = 8 };
    element_t *at = NULL, *inner;
    const char *name;
    if (depth == MOST_NESTED)
        return error_at(integrator->at, "more than %d integrators in one another", depth);
    do TRY(object_child(m, integrator, "integrator", &at, &inner, &name));
    while (inner && strcmp(object_type(inner), "field") == 0);
    if (!inner)
        return report_refuse(m->report, integrator->at,
                             "integrator \"%.40s\" holds none that shows light; the nearest is path",
                             object_type(integrator));
    report_warning(m->report, integrator->at, "of integrator \"%s\" only \"%.40s\" within is rendered",
                   object_type(integrator), object_type(inner));
    return read_integrator(m, inner, depth + 1);
}

static result_t read_integrator(mitsuba_t *m, element_t *integrator, int depth)
{
    static const char *const outer[] = {"adaptive", "irrcache", "multichannel"};
    static const struct {
        const char *type;
        integrator_t integrator;
        double depth;
        bool substitute;
    } rows[] = {
        {"path", INTEGRATOR_PATH, -1, false},        {"bdpt", INTEGRATOR_BDPT, -1, false},
        {"volpath", INTEGRATOR_PATH, -1, false},     {"volpath_simple", INTEGRATOR_PATH, -1, false},
        {"direct", INTEGRATOR_PATH, 2, false},       {"ptracer", INTEGRATOR_LIGHT, -1, false},
        {"photonmapper", INTEGRATOR_BDPT, -1, true}, {"ppm", INTEGRATOR_BDPT, -1, true},
        {"sppm", INTEGRATOR_BDPT, -1, true},         {"pssmlt", INTEGRATOR_BDPT, -1, true},
        {"mlt", INTEGRATOR_BDPT, -1, true},          {"erpt", INTEGRATOR_BDPT, -1, true},
        {"vpl", INTEGRATOR_BDPT, -1, true},
    };
    const char *type = object_type(integrator);
    m->record.integrator = INTEGRATOR_PATH;
    if (strcmp(type, "ao") == 0) return read_occlusion(m, integrator);
    for (size_t i = 0; i < ARRAY_LENGTH(outer); ++i)
        if (strcmp(type, outer[i]) == 0) return read_inner(m, integrator, depth);
    for (size_t i = 0; i < ARRAY_LENGTH(rows); ++i) {
        if (strcmp(type, rows[i].type) != 0) continue;
        m->record.integrator = rows[i].integrator;
        if (rows[i].substitute)
            report_warning(m->report, integrator->at, "integrator \"%s\" becomes bdpt, which shows the same",
                           type);
        return read_parameters(m, integrator, rows[i].depth);
    }
    TRY(report_refuse(m->report, integrator->at, "integrator \"%.40s\" is not supported; the nearest is path",
                      type));
    return read_parameters(m, integrator, -1);
}

result_t sensor_integrator(mitsuba_t *m, element_t *integrator)
{
    if (integrator) return read_integrator(m, integrator, 0);
    m->record.integrator = INTEGRATOR_PATH;
    m->record.max_depth = 1;
    return result_ok();
}
