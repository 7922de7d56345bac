/* options: the directives before WorldBegin but the camera: film, sampler, integrator, pixel filter.
 *
 * Each has a table of the kinds that pbrt knows. A sampler or an integrator of ours stands in for one that we
 * do not have, with a warning, since the converged picture is the same or nearly so; a film or filter that we
 * do not have makes another picture and is an error. */
#include "client/import/pbrt/options.h"

#include "client/import/pbrt/cameras.h"
#include "client/import/pbrt/settings.h"
#include "client/import/pbrt/state/arguments.h"
#include "client/import/pbrt/state/colour_spaces.h"

#include <ctype.h>
#include <stdlib.h>
#include <string.h>

/* ---- film ---------------------------------------------------------------------------------------------- */

static const param_rule_t film_rules[] = {
    {{"filename", "savefp16"}, PARAM_ACCEPT, NULL}, /* lightmill -o names the output */
};

static result_t read_resolution(pbrt_t *p, params_t *params)
{
    blob_scene_t *scene = &p->scene;
    TRY(params_float(params, "diagonal", &p->film_diagonal));
    TRY(params_int_in(params, "xresolution", 1, JOB_MAX_RESOLUTION, &scene->width));
    TRY(params_int_in(params, "yresolution", 1, JOB_MAX_RESOLUTION, &scene->height));
    if ((int64_t)scene->width * scene->height > JOB_MAX_PIXELS)
        return error_at(p->film_at, "%d x %d pixels are more than the limit of %d", scene->width,
                        scene->height, JOB_MAX_PIXELS);
    p->crop[0] = p->crop[2] = 0;
    p->crop[1] = scene->width;
    p->crop[3] = scene->height;
    return result_ok();
}

static void intersect_crop(pbrt_t *p, const int64_t bounds[4])
{
    for (int axis = 0; axis < 4; axis += 2) {
        p->crop[axis] = (int32_t)(bounds[axis] > p->crop[axis] ? bounds[axis] : p->crop[axis]);
        p->crop[axis + 1] =
            (int32_t)(bounds[axis + 1] < p->crop[axis + 1] ? bounds[axis + 1] : p->crop[axis + 1]);
    }
}

static result_t check_crop(const pbrt_t *p, params_t *params, const char *name)
{
    if (p->crop[0] < p->crop[1] && p->crop[2] < p->crop[3]) return result_ok();
    return error_at(params_where(params, name, p->film_at), "parameter \"%s\": no pixel is left", name);
}

/* x min, x max, y min, y max as fractions of the film; pixels are counted in float and rounded up, as in
 * pbrt. */
static result_t read_crop_window(pbrt_t *p, params_t *params)
{
    const double *crop;
    size_t count;
    TRY(params_array(params, "cropwindow", PARAM_BIT(PARAM_FLOAT), 1, &crop, &count));
    if (count == 0) return result_ok();
    if (count != 4)
        return error_at(params_where(params, "cropwindow", p->film_at),
                        "cropwindow takes x min, x max, y min, y max, found %zu numbers", count);
    int64_t bounds[4];
    for (int axis = 0; axis < 4; axis += 2) {
        float low = fminf((float)crop[axis], (float)crop[axis + 1]),
              high = fmaxf((float)crop[axis], (float)crop[axis + 1]);
        float size = (float)(axis == 0 ? p->scene.width : p->scene.height);
        bounds[axis] = (int64_t)ceilf(size * float_clamp(low, 0, 1));
        bounds[axis + 1] = (int64_t)ceilf(size * float_clamp(high, 0, 1));
    }
    intersect_crop(p, bounds);
    return check_crop(p, params, "cropwindow");
}

/* v4's film and v3's integrators: x min, x end, y min, y end in pixels. */
static result_t read_pixel_bounds(pbrt_t *p, params_t *params)
{
    const double *numbers;
    size_t count;
    TRY(params_array(params, "pixelbounds", PARAM_BIT(PARAM_INTEGER), 1, &numbers, &count));
    if (count == 0) return result_ok();
    int64_t bounds[4];
    for (size_t i = 0; i < 4; ++i) {
        if (count != 4 || !(fabs(numbers[i]) <= INT32_MAX))
            return error_at(params_where(params, "pixelbounds", p->film_at),
                            "pixelbounds takes x min, x end, y min, y end in pixels");
        bounds[i] = (int64_t)numbers[i];
    }
    intersect_crop(p, bounds);
    return check_crop(p, params, "pixelbounds");
}

static result_t make_image_film(pbrt_t *p, params_t *params)
{
    double most = INFINITY;
    TRY(read_resolution(p, params));
    TRY(read_crop_window(p, params));
    TRY(params_float_in(params, "scale", 1e-30, 1e30, &p->gain));
    TRY(params_float_in(params, "maxsampleluminance", 1e-30, INFINITY, &most));
    most *= p->gain; /* which pbrt applies last */
    p->scene.max_luminance = most <= 1e38 ? (float)most : INFINITY;
    return params_apply(params, film_rules, ARRAY_LENGTH(film_rules), p->report);
}

/* pbrt's balance is a matrix; its effect on white light, which reaches the film as it leaves the lights. */
static result_t read_white_balance(pbrt_t *p, params_t *params)
{
    double white = 0;
    TRY(params_float(params, "whitebalance", &white));
    if (white == 0) return result_ok(); /* none */
    TRY(params_float_in(params, "whitebalance", 1667, 25000, &white));
    p->balance = pbrt_white_balance(white);
    report_warning(p->report, params_where(params, "whitebalance", p->film_at),
                   "the white balance is put into the lights: strong colours turn out a little different");
    return result_ok();
}

static result_t read_sensor(pbrt_t *p, params_t *params)
{
    const char *sensor = "cie1931";
    double iso = 100, exposure = 1;
    TRY(params_float_in(params, "iso", 1e-30, 1e30, &iso));
    TRY(params_float_in(params, "exposuretime", 1e-30, 1e30, &exposure));
    TRY(params_string(params, "sensor", &sensor));
    p->gain = exposure * iso / 100;
    if (strcmp(sensor, "cie1931") != 0) /* calibrated to colours like the eye's */
        report_warning(p->report, params_where(params, "sensor", p->film_at),
                       "sensor \"%.40s\": \"cie1931\" is used, whose colours differ a little", sensor);
    return read_white_balance(p, params);
}

static const param_rule_t bounds_rules[] = {
    {{"pixelbounds"}, PARAM_IGNORE, "the cropwindow goes before it"},
};

static result_t make_rgb_film(pbrt_t *p, params_t *params)
{
    double most = INFINITY;
    bool both = params_has(params, "cropwindow") && params_has(params, "pixelbounds");
    TRY(read_resolution(p, params));
    TRY(read_crop_window(p, params));
    if (both) /* as in pbrt */
        TRY(params_apply(params, bounds_rules, ARRAY_LENGTH(bounds_rules), p->report));
    else
        TRY(read_pixel_bounds(p, params));
    TRY(read_sensor(p, params));
    TRY(params_float_in(params, "maxcomponentvalue", 1e-30, INFINITY, &most));
    p->scene.max_luminance = most <= 1e38 ? (float)most : INFINITY;
    if (isfinite(p->scene.max_luminance))
        report_warning(
            p->report, params_where(params, "maxcomponentvalue", p->film_at),
            "parameter \"maxcomponentvalue\" limits the luminance of a sample, not its components");
    return params_apply(params, film_rules, ARRAY_LENGTH(film_rules), p->report);
}

static const param_rule_t gbuffer_rules[] = {
    {{"coordinatesystem"}, PARAM_IGNORE, "only the picture is written"},
};

static result_t make_gbuffer_film(pbrt_t *p, params_t *params)
{
    report_warning(p->report, p->film_at, "film \"gbuffer\": only its picture is made, as by \"rgb\"");
    TRY(params_apply(params, gbuffer_rules, ARRAY_LENGTH(gbuffer_rules), p->report));
    return make_rgb_film(p, params);
}

static const param_rule_t spectral_rules[] = {
    {{"nbuckets", "lambdamin", "lambdamax"}, PARAM_IGNORE, "there are no wavelengths"},
};

static result_t make_spectral_film(pbrt_t *p, params_t *params)
{
    TRY(report_refuse(p->report, p->film_at,
                      "film \"spectral\" is not supported; the picture is made, as by \"rgb\""));
    TRY(params_apply(params, spectral_rules, ARRAY_LENGTH(spectral_rules), p->report));
    return make_rgb_film(p, params);
}

static const setting_entry_t films[] = {
    {{"image", DIALECT_V3}, make_image_film},
    {{"rgb", DIALECT_V4}, make_rgb_film},
    {{"gbuffer", DIALECT_V4}, make_gbuffer_film},
    {{"spectral", DIALECT_V4}, make_spectral_film},
};

result_t pbrt_film(pbrt_t *p, position_t at)
{
    return setting_keep(p, SETTING_FILM, "Film", "a type", at);
}

static result_t make_film(pbrt_t *p, position_t at)
{
    p->film_at = at;
    return setting_make(p, films, ARRAY_LENGTH(films), "Film", "film", at);
}

/* ---- sampler ------------------------------------------------------------------------------------------- */

typedef struct {
    dialect_entry_t entry;
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
    {{"adaptive", DIALECT_V3}, SAMPLER_SOBOL, false, 32}, /* this and the next are pbrt-v2's */
    {{"bestcandidate", DIALECT_V3}, SAMPLER_SOBOL, false, 4},
};

static const param_rule_t sampler_rules[] = {
    {{"seed"}, PARAM_IGNORE, "lightmill --seed chooses it"},
    {{"randomization"}, PARAM_IGNORE, "Lightmill scrambles as Owen does"},
    {{"dimensions"}, PARAM_IGNORE, "all dimensions are stratified"},
    {{"jitter"}, PARAM_IGNORE, "samples are always jittered"},
    {{"samplepixelcenter"}, PARAM_IGNORE, "samples are spread over the pixel's filter"},
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
    return setting_keep(p, SETTING_SAMPLER, "Sampler", "the sampler's type", at);
}

static result_t make_sampler(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(SETTING_FIND(p, samplers, "sampler", "sobol", at, &index));
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
    dialect_entry_t entry;
    integrator_t kind;   /* ours */
    const char *warning; /* how ours differs; NULL: not at all */
    bool knows_media;    /* pbrt's does, or does not care, like ambientocclusion */
} integrator_entry_t;

static const integrator_entry_t integrators[] = {
    {{"bdpt", DIALECT_BOTH}, INTEGRATOR_BDPT, NULL, true},
    {{"path", DIALECT_BOTH}, INTEGRATOR_PATH, NULL, false},
    {{"volpath", DIALECT_BOTH}, INTEGRATOR_PATH, NULL, true},
    {{"simplepath", DIALECT_V4}, INTEGRATOR_PATH, "only the noise differs", false},
    {{"simplevolpath", DIALECT_V4}, INTEGRATOR_PATH, "only the noise differs", true},
    {{"randomwalk", DIALECT_V4}, INTEGRATOR_PATH, "only the noise differs", false},
    {{"lightpath", DIALECT_V4}, INTEGRATOR_LIGHT, "only the noise differs", false},
    {{"mlt", DIALECT_BOTH}, INTEGRATOR_BDPT, "only the noise differs", true},
    {{"sppm", DIALECT_BOTH}, INTEGRATOR_BDPT, "only the noise differs", false},
    {{"directlighting", DIALECT_V3}, INTEGRATOR_PATH, "indirect light comes in addition", false},
    {{"whitted", DIALECT_V3}, INTEGRATOR_PATH, "indirect light comes in addition", false},
    {{"ambientocclusion", DIALECT_BOTH}, INTEGRATOR_AO, NULL, true},
};

static const param_rule_t integrator_rules[] = {
    {{"lightsamplestrategy", "lightsampler"}, PARAM_IGNORE, "lights are chosen by their power"},
    {{"rrthreshold"}, PARAM_IGNORE, "only the noise depends on it"},
    {{"strategy"}, PARAM_IGNORE, "lights are chosen by their power"},
    {{"samplebsdf", "samplelights"}, PARAM_IGNORE, "only the noise depends on it"},
    {{"visualizestrategies", "visualizeweights"}, PARAM_IGNORE, "the strategies are not written out"},
};

/* Parameters of integrators that ours stand in for. */
static const param_rule_t substitute_rules[] = {
    {{"bootstrapsamples", "chains", "mutationsperpixel", "largestepprobability", "sigma"},
     PARAM_IGNORE,
     "only mlt uses it"},
    {{"iterations", "numiterations"}, PARAM_IGNORE, "only sppm uses it; --spp sets the samples"},
    {{"photonsperiteration", "imagewritefrequency", "radius"}, PARAM_IGNORE, "only sppm uses it"},
    {{"seed"}, PARAM_IGNORE, "lightmill --seed chooses it"},
};

static result_t apply_integrator_rules(pbrt_t *p, const integrator_entry_t *integrator)
{
    const char *name = p->dialect.dialect == DIALECT_V3 ? "lightsamplestrategy" : "lightsampler";
    const char *strategy = "power"; /* ours; the others only make other noise */
    TRY(params_string(p->params, name, &strategy));
    if (strcmp(strategy, "power") != 0)
        report_warning(p->report, params_where(p->params, name, p->integrator_at),
                       "parameter \"%s\" is ignored: lights are chosen by their power", name);
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

/* v3's pixels of the film that are rendered: the others stay black there. */
static result_t read_integrator_bounds(pbrt_t *p, position_t at)
{
    const double *numbers;
    size_t count;
    if (p->dialect.dialect != DIALECT_V3) return result_ok();
    TRY(params_array(p->params, "pixelbounds", PARAM_BIT(PARAM_INTEGER), 1, &numbers, &count));
    if (count == 0) return result_ok();
    return report_refuse(p->report, params_where(p->params, "pixelbounds", at),
                         "an integrator's pixelbounds are not supported, use the film's \"cropwindow\"; the "
                         "whole image is rendered");
}

static result_t read_regularize(pbrt_t *p)
{
    bool regularize = false;
    if (p->dialect.dialect == DIALECT_V4) TRY(params_bool(p->params, "regularize", &regularize));
    p->scene.regularize = regularize;
    return result_ok();
}

/* v3 traces `nsamples` rays in each sample of a pixel, and shows pi where all is open. */
static result_t read_v3_occlusion(pbrt_t *p, position_t at)
{
    int32_t rays = 64, spp = (int32_t)p->scene.spp;
    TRY(params_int_in(p->params, "nsamples", 1, 1 << 20, &rays));
    p->scene.occlusion_radiance = vec3(PI_F, PI_F, PI_F);
    p->scene.spp = (uint32_t)(spp <= JOB_MAX_SPP / rays ? spp * rays : JOB_MAX_SPP);
    if (rays > 1)
        report_warning(
            p->report, params_where(p->params, "nsamples", at),
            "ambient occlusion with %d rays in each of %d samples a pixel: it becomes %u samples with a "
            "ray each",
            rays, spp, p->scene.spp);
    return result_ok();
}

static result_t read_occlusion(pbrt_t *p, position_t at)
{
    bool cosine = true;
    double distance = INFINITY;
    TRY(params_bool(p->params, "cossample", &cosine));
    if (!cosine)
        report_warning(p->report, params_where(p->params, "cossample", at),
                       "directions are drawn by their cosine all the same; only the noise differs");
    if (p->dialect.dialect == DIALECT_V3) return read_v3_occlusion(p, at);
    TRY(params_float_in(p->params, "maxdistance", 1e-30, INFINITY, &distance));
    p->scene.occlusion_distance = distance <= 1e30 ? (float)distance : INFINITY;
    return result_ok();
}

result_t pbrt_integrator(pbrt_t *p, position_t at)
{
    return setting_keep(p, SETTING_INTEGRATOR, "Integrator", "the integrator's type", at);
}

static result_t make_integrator(pbrt_t *p, position_t at)
{
    size_t index;
    p->integrator_at = at;
    TRY(SETTING_FIND(p, integrators, "integrator", "path", at, &index));
    const integrator_entry_t *integrator = &integrators[index];
    p->scene.integrator = integrator->kind;
    p->knows_media = integrator->knows_media;
    if (integrator->warning)
        report_warning(p->report, at, "integrator \"%s\": %s is used instead; %s", integrator->entry.name,
                       integrator_name(integrator->kind), integrator->warning);
    TRY(read_depth(p, at));
    TRY(read_integrator_bounds(p, at));
    TRY(read_regularize(p));
    if (integrator->kind == INTEGRATOR_AO) TRY(read_occlusion(p, at));
    TRY(apply_integrator_rules(p, integrator));
    return pbrt_finish_params(p, "Integrator", p->arguments[0]);
}

/* ---- pixel filter -------------------------------------------------------------------------------------- */

/* A filter's own parameter: what the blob keeps of it may be another number. */
typedef struct {
    const char *name; /* NULL: there is none */
    double low, high, value;
} filter_parameter_t;

typedef struct {
    dialect_entry_t entry;
    filter_kind_t kind;
    double radius; /* when the scene says nothing */
    filter_parameter_t parameters[2];
} filter_entry_t;

/* mitchell: Mitchell and Netravali 1988, "Reconstruction Filters in Computer Graphics". */
static const filter_entry_t filters[] = {
    {{"box", DIALECT_BOTH}, FILTER_BOX, 0.5, {{0}}},
    {{"triangle", DIALECT_BOTH}, FILTER_TRIANGLE, 2, {{0}}},
    {{"gaussian", DIALECT_V3}, FILTER_GAUSSIAN, 2, {{"alpha", 1e-6, 1e6, 2}}},
    {{"gaussian", DIALECT_V4}, FILTER_GAUSSIAN, 1.5, {{"sigma", 1e-6, 1e6, 0.5}}},
    {{"mitchell", DIALECT_BOTH}, FILTER_MITCHELL, 2, {{"B", -100, 100, 1.0 / 3}, {"C", -100, 100, 1.0 / 3}}},
    {{"sinc", DIALECT_BOTH}, FILTER_SINC, 4, {{"tau", 1e-3, 1e3, 3}}},
};

/* The extent from the centre is called xwidth, ywidth in v3, xradius, yradius in v4. */
static result_t read_filter(pbrt_t *p, const filter_entry_t *filter)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    double x = filter->radius, y = filter->radius;
    TRY(params_float_in(p->params, v3 ? "xwidth" : "xradius", 1e-3, 32, &x));
    TRY(params_float_in(p->params, v3 ? "ywidth" : "yradius", 1e-3, 32, &y));
    p->scene.filter = (blob_filter_t){.kind = filter->kind, .radius_x = (float)x, .radius_y = (float)y};
    for (int i = 0; i < 2 && filter->parameters[i].name; ++i) {
        const filter_parameter_t *parameter = &filter->parameters[i];
        double value = parameter->value;
        TRY(params_float_in(p->params, parameter->name, parameter->low, parameter->high, &value));
        /* v3 writes exp(-alpha x^2), v4 the same with alpha = 1 / (2 sigma^2). */
        if (v3 && filter->kind == FILTER_GAUSSIAN) value = sqrt(1 / (2 * value));
        p->scene.filter.parameters[i] = (float)value;
    }
    return result_ok();
}

result_t pbrt_pixel_filter(pbrt_t *p, position_t at)
{
    return setting_keep(p, SETTING_FILTER, "PixelFilter", "a type", at);
}

static result_t make_filter(pbrt_t *p, position_t at)
{
    size_t index;
    TRY(SETTING_FIND(p, filters, "pixel filter", "gaussian", at, &index));
    TRY(read_filter(p, &filters[index]));
    return pbrt_finish_params(p, "PixelFilter", p->arguments[0]);
}

/* ---- the rest ------------------------------------------------------------------------------------------ */

result_t pbrt_accelerator(pbrt_t *p, position_t at)
{
    return setting_keep(p, SETTING_ACCELERATOR, "Accelerator", "the accelerator's type", at);
}

static result_t make_accelerator(pbrt_t *p, position_t at)
{
    report_warning(p->report, at, "Accelerator is ignored: Embree builds its own");
    return result_ok();
}

static const param_rule_t option_rules[] = {
    {{"forcediffuse"}, PARAM_REFUSE, "not supported"},
    {{"disablepixeljitter"}, PARAM_IGNORE, "samples are always jittered"},
    {{"disablewavelengthjitter"}, PARAM_IGNORE, "there are no wavelengths"},
    {{"disabletexturefiltering"}, PARAM_IGNORE, "textures are filtered by the pixel's samples alone"},
    {{"displacementedgescale"}, PARAM_IGNORE, "displacement is not supported"},
    {{"msereferenceimage"}, PARAM_IGNORE, "see lightmill compare"},
    {{"msereferenceout"}, PARAM_IGNORE, "see lightmill compare"},
    {{"pixelstats"}, PARAM_IGNORE, "the statistics of pixels are not written out"},
    {{"rendercoordsys"}, PARAM_IGNORE, "rendering is in world space"},
    {{"seed"}, PARAM_IGNORE, "lightmill --seed chooses it"},
    {{"wavefront"}, PARAM_IGNORE, "it chooses how pbrt works, not what it renders"},
};

/* pbrt takes the names of options with and without '-' and '_', in any case. */
static void normalize_option(char *name)
{
    char *to = name;
    for (const char *s = name; *s; ++s)
        if (*s != '-' && *s != '_') *to++ = (char)tolower((unsigned char)*s);
    *to = '\0';
}

/* Option "name" value: the value is one token, without brackets. */
static result_t read_option(pbrt_t *p, position_t at)
{
    token_t value;
    TRY(pbrt_read_string(p, 0, "the option's name"));
    TRY(lexer_next(&p->lexer, &value));
    if (value.kind != TOKEN_WORD && value.kind != TOKEN_STRING)
        return error_at(value.at, "Option \"%.40s\" needs a value", p->arguments[0]);
    normalize_option(p->arguments[0]);
    for (size_t i = 0; i < ARRAY_LENGTH(option_rules); ++i) {
        const param_rule_t *rule = &option_rules[i];
        const char *name = rule->names[0]; /* a row is one option */
        if (strcmp(p->arguments[0], name) != 0) continue;
        if (token_is(&value, "false")) return result_ok(); /* as without it */
        if (rule->fate == PARAM_REFUSE)
            return report_refuse(p->report, at, "Option \"%s\": %s", name, rule->why);
        report_warning(p->report, at, "Option \"%s\" is ignored: %s", name, rule->why);
        return result_ok();
    }
    return report_refuse(p->report, at, "unknown Option \"%.40s\"; the nearest is to do without it",
                         p->arguments[0]);
}

/* The name alone, as pbrt has it, or "type name" like a parameter. */
result_t pbrt_option(pbrt_t *p, position_t at)
{
    token_t name;
    TRY(lexer_peek(&p->lexer, &name));
    if (!memchr(name.text, ' ', name.length)) return read_option(p, at);
    TRY(pbrt_read_params(p));
    TRY(params_apply(p->params, option_rules, ARRAY_LENGTH(option_rules), p->report));
    return params_finish(p->params, "Option", true, p->report);
}

/* The screen window of an aspect ratio: the shorter side spans [-1, 1]. */
static void set_window_by_aspect(blob_scene_t *scene, double aspect)
{
    float x = aspect > 1 ? (float)aspect : 1, y = aspect > 1 ? 1 : (float)(1 / aspect);
    const float window[4] = {-x, x, -y, y};
    memcpy(scene->screen_window, window, sizeof window);
}

/* A part of the film becomes an image of its own, through a window of the whole. */
static void apply_crop(pbrt_t *p)
{
    blob_scene_t *scene = &p->scene;
    int32_t sizes[2] = {scene->width, scene->height};
    for (int i = 0; i < 4; ++i) scene->film_window[i] = (float)((double)p->crop[i] / sizes[i / 2]);
    scene->width = p->crop[1] - p->crop[0];
    scene->height = p->crop[3] - p->crop[2];
}

static bool is_cropped(const pbrt_t *p)
{
    return p->crop[0] > 0 || p->crop[2] > 0 || p->crop[1] < p->scene.width || p->crop[3] < p->scene.height;
}

/* The camera where it is when the shutter opens and closes. */
static result_t place_camera(pbrt_t *p)
{
    affine_t open, close;
    p->now.ctm = p->camera[0];
    p->now.ctm_end = p->camera[1];
    pbrt_motion(p, p->camera_at, &open, &close);
    return scene_place_camera(&p->scene, &open, &close, p->camera_at);
}

static result_t make_settings(pbrt_t *p)
{
    static result_t (*const makers[SETTING_COUNT])(pbrt_t * p, position_t at) = {
        [SETTING_CAMERA] = pbrt_make_camera, [SETTING_FILM] = make_film,
        [SETTING_SAMPLER] = make_sampler,    [SETTING_INTEGRATOR] = make_integrator,
        [SETTING_FILTER] = make_filter,      [SETTING_ACCELERATOR] = make_accelerator,
    };
    for (setting_kind_t kind = 0; kind < SETTING_COUNT; ++kind)
        if (setting_recall(p, kind)) TRY(makers[kind](p, p->settings[kind].at));
    return result_ok();
}

result_t pbrt_options_finish(pbrt_t *p)
{
    TRY(make_settings(p));
    static const float automatic[4] = {0};
    blob_scene_t *scene = &p->scene;
    double film = (double)scene->width / scene->height, aspect = p->frame_aspect > 0 ? p->frame_aspect : film;
    bool projects = scene->camera == CAMERA_PERSPECTIVE || scene->camera == CAMERA_ORTHOGRAPHIC;
    bool given = memcmp(scene->screen_window, automatic, sizeof automatic) != 0;
    if (projects && !given && (fabs(aspect - film) > 1e-5 * film || is_cropped(p)))
        set_window_by_aspect(scene, aspect);
    if (is_cropped(p)) apply_crop(p);
    if (p->dialect.dialect == DIALECT_V4) p->gain *= p->shutter[1] - p->shutter[0]; /* the exposure */
    return place_camera(p);
}
