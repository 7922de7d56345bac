/* textures: the Texture directive, and the values that may come from a texture: floats and colours.
 *
 * Constant textures are all there is so far, so a value is a number or a colour when a material is made. */
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

/* ---- values -------------------------------------------------------------------------------------------- */

/* What a parameter of type texture names. */
static result_t texture_value(const pbrt_t *p, const params_t *owner, const param_t *item, const char *name,
                              bool is_float, rgb_t *value)
{
    uint32_t index;
    if (item->count != 1) return error_at(item->at, "parameter \"%s\" takes the name of one texture", name);
    const char *texture = params_text(owner, item, 0);
    if (!names_find(&p->texture_names[is_float], texture, &index))
        return error_at(item->at, "no %s Texture \"%.60s\" has been defined before",
                        is_float ? "float" : "spectrum", texture);
    *value = p->textures[index].colour;
    return result_ok();
}

result_t pbrt_float_value(pbrt_t *p, params_t *params, const char *name, double *value)
{
    const params_t *owner;
    const param_t *item = params_find(params, name, &owner);
    if (item && item->type == PARAM_TEXTURE) {
        rgb_t constant;
        TRY(texture_value(p, owner, item, name, true, &constant));
        *value = (double)constant.x;
    } else {
        TRY(params_float(params, name, value));
    }
    if (item && !(*value >= 0 && *value <= 1e30))
        return error_at(item->at, "parameter \"%s\" is %g, but must not be negative", name, *value);
    return result_ok();
}

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
                            rgb_t *value)
{
    switch (item->type) {
    case PARAM_RGB:
    case PARAM_XYZ:
        return three_numbers(owner, item, name, value);
    case PARAM_SPECTRUM:
        return spectrum_value(owner, item, name, value);
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

result_t pbrt_colour(pbrt_t *p, params_t *params, const char *name, colour_use_t use, rgb_t *value)
{
    const params_t *owner;
    const param_t *item = params_find(params, name, &owner);
    if (!item) return result_ok();
    TRY(read_colour(p, owner, item, name, value));
    if (!v_is_finite(*value) || value->x < 0 || value->y < 0 || value->z < 0)
        return error_at(item->at, "parameter \"%s\" must be a colour without negative components", name);
    if (use != COLOUR_REFLECTANCE || v_max(*value) <= 1) return result_ok();
    if (p->dialect.dialect == DIALECT_V4) {
        *value = vec3(fminf(value->x, 1), fminf(value->y, 1), fminf(value->z, 1));
        report_warning(p->report, item->at, "parameter \"%s\" is above 1 and taken for 1, as in pbrt-v4",
                       name);
    } else {
        report_warning(p->report, item->at, "parameter \"%s\" is above 1: the surface makes light", name);
    }
    return result_ok();
}

/* ---- the directive ------------------------------------------------------------------------------------- */

typedef struct {
    entry_t entry;
    /* Reads the texture's parameters; NULL: not supported yet. */
    result_t (*make)(pbrt_t *p, params_t *params, bool is_float, texture_t *texture);
} texture_entry_t;

static result_t make_constant(pbrt_t *p, params_t *params, bool is_float, texture_t *texture)
{
    if (!is_float) {
        texture->colour = vec3(1, 1, 1);
        return pbrt_colour(p, params, "value", COLOUR_UNBOUNDED, &texture->colour);
    }
    double value = 1;
    TRY(pbrt_float_value(p, params, "value", &value));
    texture->colour = vec3((float)value, (float)value, (float)value);
    return result_ok();
}

static const texture_entry_t textures[] = {
    {{"constant", DIALECT_BOTH}, make_constant},
    {{"imagemap", DIALECT_BOTH}, NULL},
    {{"checkerboard", DIALECT_BOTH}, NULL},
    {{"scale", DIALECT_BOTH}, NULL},
    {{"mix", DIALECT_BOTH}, NULL},
    {{"bilerp", DIALECT_BOTH}, NULL},
    {{"dots", DIALECT_BOTH}, NULL},
    {{"fbm", DIALECT_BOTH}, NULL},
    {{"wrinkled", DIALECT_BOTH}, NULL},
    {{"marble", DIALECT_BOTH}, NULL},
    {{"windy", DIALECT_BOTH}, NULL},
    {{"uv", DIALECT_V3}, NULL},
    {{"directionmix", DIALECT_V4}, NULL},
    {{"ptex", DIALECT_BOTH}, NULL},
};

static result_t read_value_type(const pbrt_t *p, position_t at, bool *is_float)
{
    const char *type = p->arguments[1];
    *is_float = strcmp(type, "float") == 0;
    if (*is_float || strcmp(type, "spectrum") == 0 || strcmp(type, "color") == 0) return result_ok();
    return error_at(at, "a Texture is of type \"float\" or \"spectrum\", not \"%.40s\"", type);
}

static void store(pbrt_t *p, bool is_float, texture_t texture, position_t at)
{
    uint32_t old;
    names_t *names = &p->texture_names[is_float];
    if (names_find(names, p->arguments[0], &old))
        report_warning(p->report, at, "the texture \"%.60s\" is replaced", p->arguments[0]);
    p->textures = grow(p->textures, &p->texture_capacity, p->texture_count + 1, sizeof *p->textures);
    names_add(names, p->arguments[0], (uint32_t)p->texture_count);
    p->textures[p->texture_count++] = texture;
}

result_t pbrt_texture(pbrt_t *p, position_t at)
{
    texture_t texture;
    bool is_float;
    size_t index;
    TRY(pbrt_read_string(p, 0, "the texture's name"));
    TRY(pbrt_read_string(p, 1, "the type \"float\" or \"spectrum\""));
    TRY(pbrt_read_string(p, 2, "the texture's class"));
    TRY(pbrt_read_params_for(p, TARGET_TEXTURE));
    TRY(read_value_type(p, at, &is_float));
    TRY(entry_find(textures, ARRAY_LENGTH(textures), sizeof *textures, "texture", p->arguments[2],
                   &p->dialect, at, &index));
    if (!textures[index].make) return error_at(at, "texture \"%s\" is not supported yet", p->arguments[2]);
    TRY(textures[index].make(p, p->params, is_float, &texture));
    TRY(pbrt_finish_params(p, "Texture", p->arguments[2]));
    store(p, is_float, texture, at);
    return result_ok();
}
