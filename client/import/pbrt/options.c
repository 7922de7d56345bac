/* options: the directives before WorldBegin: camera, film, sampler, integrator, pixel filter.
 *
 * Each has a table of the kinds that pbrt knows. A sampler or an integrator of ours stands in for one that we
 * do not have, with a warning, since the converged picture is the same or nearly so; a camera, film or filter
 * that we do not have makes another picture and is an error. */
#include "client/import/pbrt/directives.h"

#include <string.h>

/* Notes where an option stands; a second one is an error, since pbrt would drop the first in silence. */
static result_t once(position_t *first, position_t at, const char *directive)
{
    if (first->line)
        return error_at(at, "a second %s; the first is in line %u of %s", directive, first->line,
                        first->path);
    *first = at;
    return result_ok();
}

/* ---- camera -------------------------------------------------------------------------------------------- */

static const param_rule_t camera_rules[] = {
    {"focaldistance", PARAM_ACCEPT, NULL}, /* of a pinhole */
    {"shutteropen", PARAM_IGNORE, "nothing moves"},
    {"shutterclose", PARAM_IGNORE, "nothing moves"},
};

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

static result_t make_perspective(pbrt_t *p, params_t *params)
{
    double lens_radius = 0;
    TRY(read_fov(p, params));
    TRY(read_window(p, params));
    TRY(params_float(params, "lensradius", &lens_radius));
    if (lens_radius != 0)
        return error_at(params_where(params, "lensradius", p->camera_at),
                        "a lens (depth of field) is not supported yet; lensradius must be 0");
    return params_apply(params, camera_rules, ARRAY_LENGTH(camera_rules), p->report);
}

typedef struct {
    entry_t entry;
    result_t (*make)(pbrt_t *p, params_t *params); /* NULL: not supported yet */
} option_entry_t;

static const option_entry_t cameras[] = {
    {{"perspective", DIALECT_BOTH}, make_perspective},
    {{"orthographic", DIALECT_BOTH}, NULL},
    {{"environment", DIALECT_V3}, NULL},
    {{"spherical", DIALECT_V4}, NULL},
    {{"realistic", DIALECT_BOTH}, NULL},
};

/* Reads the type and the parameters of an option and lets the table's function make it. */
static result_t make_option(pbrt_t *p, const option_entry_t *table, size_t count, const char *directive,
                            const char *kind, position_t at)
{
    size_t index;
    TRY(pbrt_read_string(p, 0, "a type"));
    TRY(pbrt_read_params(p));
    TRY(entry_find(table, count, sizeof *table, kind, p->arguments[0], &p->dialect, at, &index));
    if (!table[index].make) return error_at(at, "%s \"%s\" is not supported yet", kind, p->arguments[0]);
    TRY(table[index].make(p, p->params));
    return pbrt_finish_params(p, directive, p->arguments[0]);
}

result_t pbrt_camera(pbrt_t *p, position_t at)
{
    affine_t world_from_camera;
    TRY(once(&p->camera_at, at, "Camera"));
    if (!affine_invert(&p->now.ctm, &world_from_camera))
        return error_at(at, "the current transform is singular or not finite");
    p->scene.world_from_camera = affine_to_xform(&world_from_camera);
    xform_t inverse;
    if (!xform_invert(&p->scene.world_from_camera, &inverse))
        return error_at(at, "the camera's transform is singular or not finite");
    pbrt_name_coordinates(p, "camera", &world_from_camera);
    return make_option(p, cameras, ARRAY_LENGTH(cameras), "Camera", "camera", at);
}

/* ---- film ---------------------------------------------------------------------------------------------- */

static const param_rule_t film_rules[] = {
    {"filename", PARAM_ACCEPT, NULL}, /* lightmill -o names the output */
    {"savefp16", PARAM_ACCEPT, NULL},
    {"diagonal", PARAM_IGNORE, "only the realistic camera uses it"},
    {"maxsampleluminance", PARAM_IGNORE, "Lightmill never clamps samples, which would darken the picture"},
    {"maxcomponentvalue", PARAM_IGNORE, "Lightmill never clamps samples, which would darken the picture"},
    {"pixelbounds", PARAM_REFUSE, "rendering a part of the image is not supported yet"},
};

/* Fails unless the float has the one value that Lightmill knows. */
static result_t require_float(params_t *params, const char *name, double only, position_t at)
{
    double value = only;
    TRY(params_float(params, name, &value));
    if (value == only) return result_ok();
    return error_at(params_where(params, name, at), "parameter \"%s\" is %g; only %g is supported yet", name,
                    value, only);
}

static result_t require_whole_window(params_t *params, position_t at)
{
    const double *crop;
    size_t count;
    TRY(params_array(params, "cropwindow", PARAM_BIT(PARAM_FLOAT), 4, &crop, &count));
    if (count && (crop[0] > 0 || crop[1] < 1 || crop[2] > 0 || crop[3] < 1))
        return error_at(params_where(params, "cropwindow", at),
                        "rendering a part of the image is not supported yet");
    return result_ok();
}

static result_t make_film(pbrt_t *p, params_t *params)
{
    TRY(params_int_in(params, "xresolution", 1, JOB_MAX_RESOLUTION, &p->scene.width));
    TRY(params_int_in(params, "yresolution", 1, JOB_MAX_RESOLUTION, &p->scene.height));
    if ((int64_t)p->scene.width * p->scene.height > JOB_MAX_PIXELS)
        return error_at(p->film_at, "%d x %d pixels are more than the limit of %d", p->scene.width,
                        p->scene.height, JOB_MAX_PIXELS);
    TRY(require_whole_window(params, p->film_at));
    return params_apply(params, film_rules, ARRAY_LENGTH(film_rules), p->report);
}

static result_t make_image_film(pbrt_t *p, params_t *params)
{
    TRY(require_float(params, "scale", 1, p->film_at));
    return make_film(p, params);
}

static result_t make_rgb_film(pbrt_t *p, params_t *params)
{
    const char *sensor = "cie1931";
    TRY(require_float(params, "iso", 100, p->film_at));
    TRY(require_float(params, "exposuretime", 1, p->film_at));
    TRY(require_float(params, "whitebalance", 0, p->film_at));
    TRY(params_string(params, "sensor", &sensor));
    if (strcmp(sensor, "cie1931") != 0)
        return error_at(params_where(params, "sensor", p->film_at),
                        "sensor \"%.40s\" is not supported; only \"cie1931\", the default, is", sensor);
    return make_film(p, params);
}

static const option_entry_t films[] = {
    {{"image", DIALECT_V3}, make_image_film},
    {{"rgb", DIALECT_V4}, make_rgb_film},
    {{"gbuffer", DIALECT_V4}, NULL},
    {{"spectral", DIALECT_V4}, NULL},
};

result_t pbrt_film(pbrt_t *p, position_t at)
{
    TRY(once(&p->film_at, at, "Film"));
    return make_option(p, films, ARRAY_LENGTH(films), "Film", "film", at);
}

/* ---- sampler ------------------------------------------------------------------------------------------- */

typedef struct {
    entry_t entry;
    sampler_kind_t kind; /* ours */
    bool same;           /* ours is what the scene asks for */
    int samples;         /* a pixel, when the scene says nothing */
} sampler_entry_t;

static const sampler_entry_t samplers[] = {
    {{"random", DIALECT_V3}, SAMPLER_INDEPENDENT, true, 4},
    {{"independent", DIALECT_V4}, SAMPLER_INDEPENDENT, true, 4},
    {{"sobol", DIALECT_BOTH}, SAMPLER_SOBOL, true, 16},
    {{"zsobol", DIALECT_V4}, SAMPLER_SOBOL, false, 16},
    {{"paddedsobol", DIALECT_V4}, SAMPLER_SOBOL, false, 16},
    {{"pmj02bn", DIALECT_V4}, SAMPLER_SOBOL, false, 16},
    {{"halton", DIALECT_BOTH}, SAMPLER_SOBOL, false, 16},
    {{"stratified", DIALECT_BOTH}, SAMPLER_SOBOL, false, 16},
    {{"02sequence", DIALECT_V3}, SAMPLER_SOBOL, false, 16},
    {{"lowdiscrepancy", DIALECT_V3}, SAMPLER_SOBOL, false, 16},
    {{"maxmindist", DIALECT_V3}, SAMPLER_SOBOL, false, 16},
};

static const param_rule_t sampler_rules[] = {
    {"seed", PARAM_IGNORE, "lightmill --seed chooses it"},
    {"randomization", PARAM_IGNORE, "Lightmill scrambles as Owen does"},
    {"dimensions", PARAM_IGNORE, "all dimensions are stratified"},
    {"jitter", PARAM_IGNORE, "samples are always jittered"},
    {"samplepixelcenter", PARAM_IGNORE, "samples are spread over the pixel's filter"},
};

static result_t read_samples(pbrt_t *p, params_t *params, const char *type, int samples)
{
    if (strcmp(type, "stratified") == 0) {
        int32_t x = 4, y = 4;
        TRY(params_int_in(params, "xsamples", 1, 1 << 14, &x));
        TRY(params_int_in(params, "ysamples", 1, 1 << 14, &y));
        samples = x * y;
    } else {
        TRY(params_int_in(params, "pixelsamples", 1, JOB_MAX_SPP, &samples));
    }
    p->scene.spp = (uint32_t)samples;
    return result_ok();
}

result_t pbrt_sampler(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(once(&p->sampler_at, at, "Sampler"));
    TRY(pbrt_read_string(p, 0, "the sampler's type"));
    TRY(pbrt_read_params(p));
    TRY(entry_find(samplers, ARRAY_LENGTH(samplers), sizeof *samplers, "sampler", p->arguments[0],
                   &p->dialect, at, &index));
    const sampler_entry_t *sampler = &samplers[index];
    p->scene.sampler = sampler->kind;
    if (!sampler->same)
        report_warning(p->report, at,
                       "sampler \"%s\": the %s sampler is used instead; only the noise differs",
                       sampler->entry.name, sampler_name(sampler->kind));
    TRY(read_samples(p, p->params, sampler->entry.name, sampler->samples));
    TRY(params_apply(p->params, sampler_rules, ARRAY_LENGTH(sampler_rules), p->report));
    return pbrt_finish_params(p, "Sampler", p->arguments[0]);
}

/* ---- integrator ---------------------------------------------------------------------------------------- */

typedef struct {
    entry_t entry;
    integrator_t kind;   /* ours; 0: nothing comes near */
    const char *warning; /* how ours differs; NULL: not at all */
} integrator_entry_t;

static const integrator_entry_t integrators[] = {
    {{"bdpt", DIALECT_BOTH}, INTEGRATOR_BDPT, NULL},
    {{"path", DIALECT_BOTH}, INTEGRATOR_PATH, NULL},
    {{"volpath", DIALECT_BOTH}, INTEGRATOR_PATH, "media are not supported"},
    {{"simplepath", DIALECT_V4}, INTEGRATOR_PATH, "only the noise differs"},
    {{"simplevolpath", DIALECT_V4}, INTEGRATOR_PATH, "media are not supported"},
    {{"randomwalk", DIALECT_V4}, INTEGRATOR_PATH, "only the noise differs"},
    {{"lightpath", DIALECT_V4}, INTEGRATOR_LIGHT, "only the noise differs"},
    {{"mlt", DIALECT_BOTH}, INTEGRATOR_BDPT, "only the noise differs"},
    {{"sppm", DIALECT_BOTH}, INTEGRATOR_BDPT, "only the noise differs"},
    {{"directlighting", DIALECT_V3}, INTEGRATOR_PATH, "indirect light comes in addition"},
    {{"whitted", DIALECT_V3}, INTEGRATOR_PATH, "indirect light comes in addition"},
    {{"ambientocclusion", DIALECT_V3}, 0, NULL},
    {{"ao", DIALECT_V4}, 0, NULL},
};

static const param_rule_t integrator_rules[] = {
    {"lightsamplestrategy", PARAM_IGNORE, "lights are chosen by their power"},
    {"lightsampler", PARAM_IGNORE, "lights are chosen by their power"},
    {"rrthreshold", PARAM_IGNORE, "only the noise depends on it"},
    {"strategy", PARAM_IGNORE, "lights are chosen by their power"},
    {"pixelbounds", PARAM_REFUSE, "rendering a part of the image is not supported yet"},
    {"regularize", PARAM_IGNORE, "surfaces are never roughened"},
    {"samplebsdf", PARAM_IGNORE, "only the noise depends on it"},
    {"samplelights", PARAM_IGNORE, "only the noise depends on it"},
    {"visualizestrategies", PARAM_IGNORE, "the strategies are not written out"},
    {"visualizeweights", PARAM_IGNORE, "the strategies are not written out"},
};

/* Parameters of integrators that ours stand in for. */
static const param_rule_t substitute_rules[] = {
    {"bootstrapsamples", PARAM_IGNORE, "only mlt uses it"},
    {"chains", PARAM_IGNORE, "only mlt uses it"},
    {"mutationsperpixel", PARAM_IGNORE, "only mlt uses it"},
    {"largestepprobability", PARAM_IGNORE, "only mlt uses it"},
    {"sigma", PARAM_IGNORE, "only mlt uses it"},
    {"iterations", PARAM_IGNORE, "only sppm uses it; --spp sets the samples"},
    {"numiterations", PARAM_IGNORE, "only sppm uses it; --spp sets the samples"},
    {"photonsperiteration", PARAM_IGNORE, "only sppm uses it"},
    {"imagewritefrequency", PARAM_IGNORE, "only sppm uses it"},
    {"radius", PARAM_IGNORE, "only sppm uses it"},
};

static result_t apply_integrator_rules(pbrt_t *p, const integrator_entry_t *integrator)
{
    const char *strategy = NULL;
    const params_t *owner;
    const char *name = p->dialect.dialect == DIALECT_V3 ? "lightsamplestrategy" : "lightsampler";
    if (params_has(p->params, name)) {
        const param_t *item = params_find(p->params, name, &owner);
        TRY(params_string(p->params, name, &strategy));
        if (strcmp(strategy, "power") != 0) /* ours is "power", the others only make other noise */
            report_warning(p->report, item->at,
                           "parameter \"%s\" is ignored: lights are chosen by their power", name);
    }
    TRY(params_apply(p->params, integrator_rules, ARRAY_LENGTH(integrator_rules), p->report));
    if (integrator->warning)
        return params_apply(p->params, substitute_rules, ARRAY_LENGTH(substitute_rules), p->report);
    return result_ok();
}

static result_t read_depth(pbrt_t *p, position_t at)
{
    int32_t depth = 5;
    TRY(params_int_in(p->params, "maxdepth", 0, INT32_MAX, &depth));
    if (depth > JOB_MAX_DEPTH) {
        report_warning(p->report, params_where(p->params, "maxdepth", at),
                       "maxdepth %d: %d, the limit, is used", depth, JOB_MAX_DEPTH);
        depth = JOB_MAX_DEPTH;
    }
    p->scene.max_depth = depth;
    return result_ok();
}

result_t pbrt_integrator(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(once(&p->integrator_at, at, "Integrator"));
    TRY(pbrt_read_string(p, 0, "the integrator's type"));
    TRY(pbrt_read_params(p));
    TRY(entry_find(integrators, ARRAY_LENGTH(integrators), sizeof *integrators, "integrator", p->arguments[0],
                   &p->dialect, at, &index));
    const integrator_entry_t *integrator = &integrators[index];
    if (!integrator->kind)
        return error_at(at, "integrator \"%s\" is not supported yet", integrator->entry.name);
    p->scene.integrator = integrator->kind;
    if (integrator->warning)
        report_warning(p->report, at, "integrator \"%s\": %s is used instead; %s", integrator->entry.name,
                       integrator_name(integrator->kind), integrator->warning);
    TRY(read_depth(p, at));
    TRY(apply_integrator_rules(p, integrator));
    return pbrt_finish_params(p, "Integrator", p->arguments[0]);
}

/* ---- pixel filter -------------------------------------------------------------------------------------- */

/* The extent from the centre: xwidth, ywidth in v3, xradius, yradius in v4. */
static result_t read_radii(pbrt_t *p, params_t *params, filter_kind_t kind, double radius)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    double x = radius, y = radius;
    TRY(params_float_in(params, v3 ? "xwidth" : "xradius", 1e-3, 32, &x));
    TRY(params_float_in(params, v3 ? "ywidth" : "yradius", 1e-3, 32, &y));
    p->scene.filter = (blob_filter_t){.kind = kind, .radius_x = (float)x, .radius_y = (float)y};
    return result_ok();
}

static result_t make_box(pbrt_t *p, params_t *params)
{
    return read_radii(p, params, FILTER_BOX, 0.5);
}

static result_t make_triangle(pbrt_t *p, params_t *params)
{
    return read_radii(p, params, FILTER_TRIANGLE, 2);
}

/* v3 writes exp(-alpha x^2), v4 the same with alpha = 1 / (2 sigma^2). */
static result_t make_gaussian(pbrt_t *p, params_t *params)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    double alpha = 2, sigma = 0.5;
    TRY(read_radii(p, params, FILTER_GAUSSIAN, v3 ? 2 : 1.5));
    if (v3) {
        TRY(params_float_in(params, "alpha", 1e-6, 1e6, &alpha));
        sigma = sqrt(1 / (2 * alpha));
    } else {
        TRY(params_float_in(params, "sigma", 1e-6, 1e6, &sigma));
    }
    p->scene.filter.gaussian_sigma = (float)sigma;
    return result_ok();
}

static const option_entry_t filters[] = {
    {{"box", DIALECT_BOTH}, make_box},
    {{"triangle", DIALECT_BOTH}, make_triangle},
    {{"gaussian", DIALECT_BOTH}, make_gaussian},
    {{"mitchell", DIALECT_BOTH}, NULL},
    {{"sinc", DIALECT_BOTH}, NULL},
};

result_t pbrt_pixel_filter(pbrt_t *p, position_t at)
{
    TRY(once(&p->filter_at, at, "PixelFilter"));
    return make_option(p, filters, ARRAY_LENGTH(filters), "PixelFilter", "pixel filter", at);
}

/* ---- the rest ------------------------------------------------------------------------------------------ */

result_t pbrt_accelerator(pbrt_t *p, position_t at)
{
    TRY(pbrt_read_string(p, 0, "the accelerator's type"));
    TRY(pbrt_read_params(p));
    report_warning(p->report, at, "Accelerator is ignored: Embree builds its own");
    return result_ok();
}

result_t pbrt_color_space(pbrt_t *p, position_t at)
{
    TRY(pbrt_read_string(p, 0, "the colour space"));
    if (strcmp(p->arguments[0], "srgb") == 0) return result_ok();
    return error_at(at, "colour space \"%.40s\" is not supported yet; only \"srgb\" is", p->arguments[0]);
}

static const param_rule_t option_rules[] = {
    {"forcediffuse", PARAM_REFUSE, "not supported"},
    {"disablepixeljitter", PARAM_IGNORE, "samples are always jittered"},
    {"disablewavelengthjitter", PARAM_IGNORE, "there are no wavelengths"},
    {"disabletexturefiltering", PARAM_IGNORE, "textures are not supported yet"},
    {"displacementedgescale", PARAM_IGNORE, "displacement is not supported yet"},
    {"msereferenceimage", PARAM_IGNORE, "see lightmill compare"},
    {"msereferenceout", PARAM_IGNORE, "see lightmill compare"},
    {"rendercoordsys", PARAM_IGNORE, "rendering is in world space"},
    {"seed", PARAM_IGNORE, "lightmill --seed chooses it"},
    {"wavefront", PARAM_IGNORE, "it chooses how pbrt works, not what it renders"},
};

result_t pbrt_option(pbrt_t *p, position_t at)
{
    (void)at;
    TRY(pbrt_read_params(p));
    TRY(params_apply(p->params, option_rules, ARRAY_LENGTH(option_rules), p->report));
    return params_finish(p->params, "Option", true, p->report);
}

/* The screen window of an aspect ratio that is not the film's: the shorter side spans [-1, 1]. */
static void set_window_by_aspect(blob_scene_t *scene, double aspect)
{
    float x = aspect > 1 ? (float)aspect : 1, y = aspect > 1 ? 1 : (float)(1 / aspect);
    const float window[4] = {-x, x, -y, y};
    memcpy(scene->screen_window, window, sizeof window);
}

void pbrt_options_finish(pbrt_t *p)
{
    static const float automatic[4] = {0};
    blob_scene_t *scene = &p->scene;
    double aspect = (double)scene->width / scene->height;
    bool given = memcmp(scene->screen_window, automatic, sizeof automatic) != 0;
    if (!given && p->frame_aspect > 0 && fabs(p->frame_aspect - aspect) > 1e-5 * aspect)
        set_window_by_aspect(scene, p->frame_aspect);
}
