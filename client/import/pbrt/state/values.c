/* values: the parameters that may come from a texture: floats and colours. */
#include "client/import/pbrt/state/values.h"
#include "client/import/pbrt/state/colour_spaces.h"

#include <stdlib.h>

#include "client/import/files/spectrum.h"

/* ---- textures ------------------------------------------------------------------------------------------ */

/* What a parameter of type texture names; *value stays when there is no such texture. */
static result_t texture_value(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                              bool is_float, blob_value_t *value)
{
    uint32_t index;
    if (item->count != 1) return error_at(item->at, "parameter \"%s\" takes the name of one texture", name);
    const char *texture = params_text(owner, item, 0);
    const names_t *names = &p->texture_names[is_float];
    /* pbrt-v3 makes a material at its directive, v4 at the end of the scene. */
    bool own = p->dialect.dialect == DIALECT_V3 && p->in_the_making && owner == p->in_the_making->params;
    if (!names_find_before(names, own ? p->in_the_making->textures[is_float] : names->count, texture, &index))
        return pbrt_slip(p, item->at, "the parameter has its default",
                         "no %s Texture \"%.60s\" has been defined before", is_float ? "float" : "spectrum",
                         texture);
    *value = p->textures[index].value;
    return result_ok();
}

/* ---- numbers ------------------------------------------------------------------------------------------- */

static const double largest = 1e30;

result_t pbrt_signed_value(pbrt_t *p, params_t *params, const char *name, blob_value_t *value)
{
    const params_t *owner;
    const param_t *item =
        params_find(params, name, PARAM_BIT(PARAM_FLOAT) | PARAM_BIT(PARAM_TEXTURE), &owner);
    if (!item) return result_ok();
    if (item->type == PARAM_TEXTURE) return texture_value(p, owner, item, name, true, value);
    double number = 0;
    TRY(params_float_in(params, name, -largest, largest, &number));
    *value = blob_constant((float)number);
    return result_ok();
}

result_t pbrt_float_value(pbrt_t *p, params_t *params, const char *name, blob_value_t *value)
{
    TRY(pbrt_signed_value(p, params, name, value));
    if (value->texture != 0 || value->factor.x >= 0) return result_ok();
    return error_at(params_where(params, name, (position_t){.path = ""}),
                    "parameter \"%s\" is %g, but must not be negative", name, (double)value->factor.x);
}

/* ---- colours ------------------------------------------------------------------------------------------- */

/* The sRGB primaries with white D65 (IEC 61966-2-1), as pbrt-v3 uses them. */
static rgb_t rgb_from_xyz(const double xyz[3])
{
    return vec3((float)(3.240479 * xyz[0] - 1.537150 * xyz[1] - 0.498535 * xyz[2]),
                (float)(-0.969256 * xyz[0] + 1.875991 * xyz[1] + 0.041556 * xyz[2]),
                (float)(0.055648 * xyz[0] - 0.204043 * xyz[1] + 1.057311 * xyz[2]));
}

/* How many of its numbers a parameter has that takes `unit` at a time: v3 leaves out those behind the last
 * unit that is whole. */
static result_t count_numbers(pbrt_t *p, const param_t *item, const char *name, size_t unit, size_t *count)
{
    size_t excess = item->count % unit;
    *count = item->count;
    if (p->dialect.dialect != DIALECT_V3 || excess == 0 || *count < unit) return result_ok();
    *count -= excess;
    return report_tolerate(p->report, item->at,
                           "parameter \"%s\" takes %zu numbers at a time, found %zu; as in pbrt-v3, the last "
                           "%zu are left out",
                           name, unit, item->count, excess);
}

static result_t three_numbers(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                              rgb_t *value)
{
    size_t count;
    TRY(count_numbers(p, item, name, 3, &count));
    if (count != 3)
        return error_at(item->at, "parameter \"%s\" takes three numbers, found %zu", name, item->count);
    const double *v = params_numbers(owner, item);
    *value = item->type == PARAM_XYZ ? rgb_from_xyz(v) : vec3((float)v[0], (float)v[1], (float)v[2]);
    return result_ok();
}

/* What a parameter of type spectrum gives: samples, v4's name of one, or a file. The caller frees it. */
static result_t read_spectrum(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                              spectrum_t *spectrum)
{
    size_t count;
    if (!item->quoted) {
        TRY(count_numbers(p, item, name, 2, &count));
        return spectrum_from_pairs(params_numbers(owner, item), count, item->at, spectrum);
    }
    if (item->count != 1)
        return error_at(item->at, "parameter \"%s\" takes one spectrum, found %zu", name, item->count);
    const char *text = params_text(owner, item, 0);
    if (p->dialect.dialect == DIALECT_V4 && spectrum_named(text, spectrum)) return result_ok();
    char *path = pbrt_resolve(p, text);
    result_t result = spectrum_read(path, spectrum);
    free(path);
    return result.code == RESULT_OK ? result : error_at(item->at, "%s", result.message);
}

/* Whether v3 names a file that is missing: a slip, which does what `does` says. */
static result_t find_spectrum(pbrt_t *p, const params_t *owner, const param_t *item, const char *does,
                              bool *missing)
{
    *missing = false;
    if (p->dialect.dialect != DIALECT_V3 || !item->quoted || item->count != 1) return result_ok();
    char *path = pbrt_resolve(p, params_text(owner, item, 0));
    *missing = pbrt_is_missing(path);
    result_t result = *missing ? pbrt_missing(p, item->at, path, does) : result_ok();
    free(path);
    return result;
}

static spectrum_rules_t rules_of(const pbrt_t *p)
{
    return p->dialect.dialect == DIALECT_V3 ? SPECTRUM_PBRT_V3 : SPECTRUM_PBRT_V4;
}

/* Keeps the spectrum, times `scale`, for spectral jobs, beside the colour that it has. */
static void keep_spectrum(pbrt_t *p, const spectrum_t *spectrum, double scale, blob_value_t *value)
{
    blob_spectrum_t kept;
    double most = (double)v_max(value->factor);
    if (most > 0 && scale > 0 && spectrum_resample(spectrum, scale / most, &kept))
        value->spectrum = scene_add_spectrum(p->builder, &kept);
}

static void keep_emission(pbrt_t *p, const spectrum_t *spectrum, blob_value_t *value)
{
    keep_spectrum(p, spectrum, spectrum_emission_scale(spectrum, rules_of(p)), value);
}

static result_t spectrum_value(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                               colour_use_t use, blob_value_t *value)
{
    static const spectrum_use_t uses[] = {[COLOUR_REFLECTANCE] = SPECTRUM_REFLECTANCE,
                                          [COLOUR_UNBOUNDED] = SPECTRUM_REFLECTANCE,
                                          [COLOUR_INDEX] = SPECTRUM_INDEX,
                                          [COLOUR_LIGHT] = SPECTRUM_EMISSION};
    spectrum_t spectrum;
    bool missing;
    TRY(find_spectrum(p, owner, item, "it is black", &missing));
    if (missing) return result_ok();
    TRY(read_spectrum(p, owner, item, name, &spectrum));
    value->factor = spectrum_colour(&spectrum, uses[use], rules_of(p));
    /* A colour beyond sRGB is one within it, but the spectrum stays what it is. */
    if (use == COLOUR_REFLECTANCE && p->dialect.dialect == DIALECT_V4)
        value->factor = v_low(value->factor, vec3(1, 1, 1));
    if (use == COLOUR_LIGHT)
        keep_emission(p, &spectrum, value);
    else
        keep_spectrum(p, &spectrum, 1, value);
    spectrum_free(&spectrum);
    return result_ok();
}

/* A temperature in kelvin; in v3 with a scale behind it. */
static result_t blackbody_value(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                                blob_value_t *value)
{
    size_t numbers = p->dialect.dialect == DIALECT_V3 ? 2 : 1, count;
    const double *v = params_numbers(owner, item);
    TRY(count_numbers(p, item, name, numbers, &count));
    if (count != numbers)
        return error_at(item->at, "parameter \"%s\": a blackbody takes %s, found %zu numbers", name,
                        numbers == 2 ? "a temperature and a scale" : "a temperature", item->count);
    if (!(v[0] > 0 && v[0] <= 1e6))
        return error_at(item->at, "parameter \"%s\": the temperature is %g K, but must be over 0", name,
                        v[0]);
    value->factor = spectrum_blackbody(v[0], rules_of(p));
    spectrum_t spectrum = spectrum_of_blackbody(v[0]);
    keep_emission(p, &spectrum, value);
    spectrum_free(&spectrum);
    if (numbers == 2) value->factor = v_scale(value->factor, (float)v[1]);
    return result_ok();
}

/* Three numbers; what a colour space without sRGB's gamut makes negative is 0. */
static result_t rgb_value(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                          colour_use_t use, rgb_t *value)
{
    TRY(three_numbers(p, owner, item, name, value));
    if (item->type == PARAM_XYZ || value->x < 0 || value->y < 0 || value->z < 0) return result_ok();
    rgb_t c = pbrt_srgb(p, *value, use == COLOUR_LIGHT);
    *value = vec3(fmaxf(c.x, 0), fmaxf(c.y, 0), fmaxf(c.z, 0));
    return result_ok();
}

static result_t read_colour(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                            colour_use_t use, blob_value_t *value)
{
    if (item->type != PARAM_TEXTURE) *value = blob_constant(0);
    switch (item->type) {
    case PARAM_RGB:
    case PARAM_XYZ:
        return rgb_value(p, owner, item, name, use, &value->factor);
    case PARAM_SPECTRUM:
        return spectrum_value(p, owner, item, name, use, value);
    case PARAM_TEXTURE:
        return texture_value(p, owner, item, name, false, value);
    case PARAM_BLACKBODY:
        return blackbody_value(p, owner, item, name, value);
    default:
        return error_at(item->at, "parameter \"%s\" must be a colour (rgb), not of type %s", name,
                        param_type_name(item->type));
    }
}

static result_t check_constant(pbrt_t *p, const char *name, position_t at, colour_use_t use, rgb_t *value)
{
    if (!v_is_finite(*value) || value->x < 0 || value->y < 0 || value->z < 0)
        return error_at(at, "parameter \"%s\" must be a colour without negative components", name);
    if (use != COLOUR_REFLECTANCE || v_max(*value) <= 1) return result_ok();
    if (p->dialect.dialect == DIALECT_V4) {
        *value = v_low(*value, vec3(1, 1, 1));
        report_warning(p->report, at, "parameter \"%s\" is above 1 and taken for 1, as in pbrt-v4", name);
    } else {
        report_warning(p->report, at, "parameter \"%s\" is above 1: the surface makes light", name);
    }
    return result_ok();
}

result_t pbrt_colour_value(pbrt_t *p, params_t *params, const char *name, colour_use_t use,
                           blob_value_t *value)
{
    const params_t *owner;
    const param_t *item = params_find(params, name, PARAM_COLOURS | PARAM_BIT(PARAM_TEXTURE), &owner);
    if (!item) return result_ok();
    TRY(read_colour(p, owner, item, name, use, value));
    return value->texture ? result_ok() : check_constant(p, name, item->at, use, &value->factor);
}

result_t pbrt_constant_colour(pbrt_t *p, params_t *params, const char *name, colour_use_t use,
                              blob_value_t *value)
{
    TRY(pbrt_colour_value(p, params, name, use, value));
    if (value->texture == 0) return result_ok();
    return error_at(params_where(params, name, (position_t){.path = ""}),
                    "parameter \"%s\" cannot vary; give a colour instead of a texture", name);
}

result_t pbrt_colour(pbrt_t *p, params_t *params, const char *name, colour_use_t use, rgb_t *value)
{
    blob_value_t read = blob_colour_value(*value);
    TRY(pbrt_constant_colour(p, params, name, use, &read));
    *value = read.factor;
    return result_ok();
}

/* pbrt-v4 makes a spectrum of it; there is no dispersion here. */
static result_t index_of_rgb(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                             blob_value_t *value)
{
    rgb_t rgb;
    TRY(rgb_value(p, owner, item, name, COLOUR_UNBOUNDED, &rgb));
    float luminance = rgb_luminance(rgb);
    if (rgb.x != rgb.y || rgb.y != rgb.z)
        report_warning(p->report, item->at,
                       "parameter \"%s\": there is no dispersion, %g is used for all colours", name,
                       (double)luminance);
    *value = blob_constant(luminance);
    return result_ok();
}

result_t pbrt_index(pbrt_t *p, params_t *params, const char *name, blob_value_t *value)
{
    const params_t *owner;
    unsigned types = PARAM_BIT(PARAM_SPECTRUM);
    if (p->dialect.dialect == DIALECT_V4) types |= PARAM_BIT(PARAM_RGB);
    const param_t *item = params_find(params, name, types, &owner);
    if (!item) return result_ok();
    if (item->type == PARAM_RGB) return index_of_rgb(p, owner, item, name, value);
    spectrum_t spectrum;
    bool missing;
    TRY(find_spectrum(p, owner, item, "the default is taken", &missing));
    if (missing) return result_ok();
    TRY(read_spectrum(p, owner, item, name, &spectrum));
    *value = blob_constant((float)spectrum_at(&spectrum, SPECTRUM_D_LINE));
    if (spectrum.count > 1) keep_spectrum(p, &spectrum, 1, value);
    spectrum_free(&spectrum);
    return result_ok();
}

blob_value_t pbrt_named_index(pbrt_t *p, const char *name)
{
    spectrum_t spectrum;
    if (!spectrum_named(name, &spectrum)) return blob_constant(0);
    blob_value_t value = blob_colour_value(spectrum_colour(&spectrum, SPECTRUM_INDEX, rules_of(p)));
    keep_spectrum(p, &spectrum, 1, &value);
    spectrum_free(&spectrum);
    return value;
}
