/* values: the parameters that may come from a texture: floats and colours. */
#include "client/import/pbrt/directives.h"

#include <string.h>

/* ---- spectra that have a name (v4) --------------------------------------------------------------------- */

/* The measured curves, weighted by the CIE 1931 observer and taken to linear sRGB as pbrt-v3 does it. */
static const struct {
    const char *name;
    rgb_t colour;
} named_spectra[] = {
    {"metal-Ag-eta", {0.155265f, 0.116723f, 0.138381f}},
    {"metal-Ag-k", {4.828343f, 3.122246f, 2.147050f}},
    {"metal-Al-eta", {1.657460f, 0.880369f, 0.521229f}},
    {"metal-Al-k", {9.223869f, 6.269523f, 4.837001f}},
    {"metal-Au-eta", {0.143119f, 0.374957f, 1.442479f}},
    {"metal-Au-k", {3.983160f, 2.385721f, 1.603215f}},
    {"metal-Cu-eta", {0.200438f, 0.924033f, 1.102212f}},
    {"metal-Cu-k", {3.912949f, 2.452848f, 2.142188f}},
    /* glasses: the index at 587.6 nm, without dispersion; F5, F10 and F11 are SF5, SF10 and SF11 */
    {"glass-BK7", {1.5168f, 1.5168f, 1.5168f}},
    {"glass-BAF10", {1.6700f, 1.6700f, 1.6700f}},
    {"glass-FK51A", {1.4866f, 1.4866f, 1.4866f}},
    {"glass-LASF9", {1.8503f, 1.8503f, 1.8503f}},
    {"glass-F5", {1.6727f, 1.6727f, 1.6727f}},
    {"glass-F10", {1.7283f, 1.7283f, 1.7283f}},
    {"glass-F11", {1.7847f, 1.7847f, 1.7847f}},
    /* the white of sRGB */
    {"stdillum-D65", {1, 1, 1}},
};

static result_t named_spectrum(const char *name, position_t at, rgb_t *value)
{
    for (size_t i = 0; i < ARRAY_LENGTH(named_spectra); ++i) {
        if (strcmp(name, named_spectra[i].name) != 0) continue;
        *value = named_spectra[i].colour;
        return result_ok();
    }
    return error_at(at, "spectrum \"%.60s\" is not supported yet; give an rgb colour instead", name);
}

/* ---- textures ------------------------------------------------------------------------------------------ */

/* What a parameter of type texture names. */
static result_t texture_value(const pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                              bool is_float, blob_value_t *value)
{
    uint32_t index;
    if (item->count != 1) return error_at(item->at, "parameter \"%s\" takes the name of one texture", name);
    const char *texture = params_text(owner, item, 0);
    if (!names_find(&p->texture_names[is_float], texture, &index))
        return error_at(item->at, "no %s Texture \"%.60s\" has been defined before",
                        is_float ? "float" : "spectrum", texture);
    *value = p->textures[index].value;
    return result_ok();
}

/* ---- numbers ------------------------------------------------------------------------------------------- */

static const double largest = 1e30;

result_t pbrt_signed_value(pbrt_t *p, params_t *params, const char *name, blob_value_t *value)
{
    const params_t *owner;
    const param_t *item = params_find(params, name, &owner);
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

static result_t three_numbers(const params_t *owner, const param_t *item, const char *name, rgb_t *value)
{
    if (item->count != 3)
        return error_at(item->at, "parameter \"%s\" takes three numbers, found %zu", name, item->count);
    const double *v = params_numbers(owner, item);
    *value = item->type == PARAM_XYZ ? rgb_from_xyz(v) : vec3((float)v[0], (float)v[1], (float)v[2]);
    return result_ok();
}

static result_t spectrum_value(const params_t *owner, const param_t *item, const char *name, rgb_t *value)
{
    if (item->quoted && item->count == 1) return named_spectrum(params_text(owner, item, 0), item->at, value);
    return error_at(item->at, "parameter \"%s\": sampled spectra are not supported yet; give an rgb colour",
                    name);
}

static result_t read_colour(pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                            blob_value_t *value)
{
    *value = blob_constant(0);
    switch (item->type) {
    case PARAM_RGB:
    case PARAM_XYZ:
        return three_numbers(owner, item, name, &value->factor);
    case PARAM_SPECTRUM:
        return spectrum_value(owner, item, name, &value->factor);
    case PARAM_TEXTURE:
        return texture_value(p, owner, item, name, false, value);
    case PARAM_BLACKBODY:
        return error_at(item->at, "parameter \"%s\": blackbody is not supported yet; give an rgb colour",
                        name);
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
        *value = vec3(fminf(value->x, 1), fminf(value->y, 1), fminf(value->z, 1));
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
    const param_t *item = params_find(params, name, &owner);
    if (!item) return result_ok();
    TRY(read_colour(p, owner, item, name, value));
    return value->texture ? result_ok() : check_constant(p, name, item->at, use, &value->factor);
}

result_t pbrt_colour(pbrt_t *p, params_t *params, const char *name, colour_use_t use, rgb_t *value)
{
    blob_value_t read = blob_colour_value(*value);
    TRY(pbrt_colour_value(p, params, name, use, &read));
    if (read.texture != 0)
        return error_at(params_where(params, name, (position_t){.path = ""}),
                        "parameter \"%s\" cannot vary; give a colour instead of a texture", name);
    *value = read.factor;
    return result_ok();
}

result_t pbrt_index(pbrt_t *p, params_t *params, const char *name, blob_value_t *value)
{
    return pbrt_colour_value(p, params, name, COLOUR_UNBOUNDED, value);
}
