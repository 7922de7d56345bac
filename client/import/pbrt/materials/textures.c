/* textures: the Texture directive and the table of textures.
 *
 * A texture becomes a record of the blob at its directive; a constant stays a number, and a scale by one is
 * multiplied into the value.
 */
#include "client/import/pbrt/materials/textures.h"
#include "client/import/pbrt/state/arguments.h"
#include "client/import/pbrt/state/images.h"
#include "client/import/pbrt/state/values.h"

#include <stdlib.h>
#include <string.h>

typedef enum { SPACE_NONE, SPACE_2D, SPACE_3D } space_t;

typedef struct {
    dialect_entry_t entry;
    texture_kind_t kind; /* 0: a constant, or not supported */
    space_t space;       /* the coordinates that it looks at */
    /* Reads the other parameters of a texture of that kind and space. One whose kind becomes 0 is no texture:
     * *value is what there is to say. NULL: not supported. */
    result_t (*read)(pbrt_t *p, params_t *params, position_t at, bool is_float, blob_texture_t *texture,
                     blob_value_t *value);
} texture_entry_t;

/* ---- records ------------------------------------------------------------------------------------------- */

static result_t read_input(pbrt_t *p, params_t *params, const char *name, bool is_float, float otherwise,
                           blob_value_t *input)
{
    *input = blob_constant(otherwise);
    return is_float ? pbrt_signed_value(p, params, name, input)
                    : pbrt_colour_value(p, params, name, COLOUR_UNBOUNDED, input);
}

/* ---- mappings ------------------------------------------------------------------------------------------ */

/* Not finite where the transform cannot be inverted: scene_check_textures refuses it. */
static affine_t from_world(const pbrt_t *p)
{
    affine_t inverse;
    (void)affine_invert(&p->now.ctm, &inverse);
    return inverse;
}

static result_t map_uv(params_t *params, blob_texture_t *texture)
{
    double scale[2] = {1, 1}, delta[2] = {0, 0};
    TRY(params_float_in(params, "uscale", -1e6, 1e6, &scale[0]));
    TRY(params_float_in(params, "vscale", -1e6, 1e6, &scale[1]));
    TRY(params_float_in(params, "udelta", -1e6, 1e6, &delta[0]));
    TRY(params_float_in(params, "vdelta", -1e6, 1e6, &delta[1]));
    texture->mapping = MAPPING_UV;
    texture->matrix[0][0] = (float)scale[0];
    texture->matrix[1][1] = (float)scale[1];
    for (int i = 0; i < 2; ++i) texture->matrix[i][2] = (float)delta[i];
    return result_ok();
}

/* (s, t) = (v1 . p + udelta, v2 . p + vdelta): p in the world (v3), or in the texture's space (v4). */
static result_t map_planar(pbrt_t *p, params_t *params, blob_texture_t *texture)
{
    affine_t plane = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 0, 0}}};
    TRY(params_point(params, "v1", PARAM_BIT(PARAM_VECTOR3), plane.m[0]));
    TRY(params_point(params, "v2", PARAM_BIT(PARAM_VECTOR3), plane.m[1]));
    TRY(params_float_in(params, "udelta", -1e6, 1e6, &plane.m[0][3]));
    TRY(params_float_in(params, "vdelta", -1e6, 1e6, &plane.m[1][3]));
    affine_t space = p->dialect.dialect == DIALECT_V4 ? from_world(p) : affine_identity();
    plane = affine_multiply(&plane, &space);
    texture->mapping = MAPPING_PLANAR;
    texture->texture_from_world = affine_to_xform(&plane);
    return result_ok();
}

/* Either pbrt takes plain uv for a mapping that it does not know. */
static result_t map_plainly(const pbrt_t *p, position_t at, const char *type, blob_texture_t *texture)
{
    texture->mapping = MAPPING_UV;
    texture->matrix[0][0] = texture->matrix[1][1] = 1;
    return report_tolerate(p->report, at, "unknown mapping \"%.40s\"; it is \"uv\", as by pbrt", type);
}

static result_t map_2d(pbrt_t *p, params_t *params, position_t at, blob_texture_t *texture)
{
    const char *type = "uv";
    TRY(params_string(params, "mapping", &type));
    bool sphere = strcmp(type, "spherical") == 0;
    if (strcmp(type, "uv") == 0) return map_uv(params, texture);
    if (strcmp(type, "planar") == 0) return map_planar(p, params, texture);
    if (!sphere && strcmp(type, "cylindrical") != 0)
        return map_plainly(p, params_where(params, "mapping", at), type, texture);
    affine_t space = from_world(p);
    texture->texture_from_world = affine_to_xform(&space);
    texture->mapping = sphere                             ? MAPPING_SPHERICAL
                       : p->dialect.dialect == DIALECT_V3 ? MAPPING_CYLINDRICAL
                                                          : MAPPING_CYLINDER;
    return result_ok();
}

/* pbrt-v3 applies the current transform itself to the point in the world, pbrt-v4 its inverse. */
static result_t read_space(pbrt_t *p, params_t *params, position_t at, space_t kind, blob_texture_t *texture)
{
    if (kind == SPACE_NONE) return result_ok();
    if (kind == SPACE_2D) return map_2d(p, params, at, texture);
    affine_t space = p->dialect.dialect == DIALECT_V4 ? from_world(p) : p->now.ctm;
    texture->mapping = MAPPING_POINT;
    texture->texture_from_world = affine_to_xform(&space);
    return result_ok();
}

static void negate_row(xform_t *t, int row)
{
    for (int i = 0; i < 4; ++i) t->m[row][i] = -t->m[row][i];
}

/* Makes t of an image 1 - t: pbrt's v = 0 is the bottom row, the blob's t = 0 the top one. On a sphere the
 * mirrored y makes it so; on v3's cylinder the mirrored z does as far as the image repeats. */
static void flip_t(blob_texture_t *texture)
{
    switch (texture->mapping) {
    case MAPPING_UV:
        for (int i = 0; i < 3; ++i) texture->matrix[1][i] = -texture->matrix[1][i];
        texture->matrix[1][2] += 1;
        return;
    case MAPPING_PLANAR:
        negate_row(&texture->texture_from_world, 1);
        texture->texture_from_world.m[1][3] += 1;
        return;
    case MAPPING_SPHERICAL:
        negate_row(&texture->texture_from_world, 1);
        return;
    case MAPPING_CYLINDER:
        negate_row(&texture->texture_from_world, 2);
        texture->texture_from_world.m[2][3] += 1;
        return;
    default:
        negate_row(&texture->texture_from_world, 2);
    }
}

/* ---- textures of textures ------------------------------------------------------------------------------ */

static result_t read_constant(pbrt_t *p, params_t *params, position_t at, bool is_float,
                              blob_texture_t *texture, blob_value_t *value)
{
    (void)at, (void)texture;
    return read_input(p, params, "value", is_float, 1, value);
}

static result_t read_product(pbrt_t *p, params_t *params, position_t at, bool is_float,
                             blob_texture_t *texture, blob_value_t *value)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    blob_value_t *a = &texture->inputs[0], *b = &texture->inputs[1];
    TRY(read_input(p, params, v3 ? "tex1" : "tex", is_float, 1, a));
    TRY(read_input(p, params, v3 ? "tex2" : "scale", v3 ? is_float : true, 1, b));
    *value = (blob_value_t){.factor = v_mul(a->factor, b->factor),
                            .texture = a->texture ? a->texture : b->texture};
    if (b->factor.x == b->factor.y && b->factor.y == b->factor.z) value->spectrum = a->spectrum;
    if (!v_is_finite(value->factor)) return error_at(at, "this scale is not finite");
    if (!a->texture || !b->texture) texture->kind = 0;
    return result_ok();
}

static result_t read_mix(pbrt_t *p, params_t *params, position_t at, bool is_float, blob_texture_t *texture,
                         blob_value_t *value)
{
    (void)at, (void)value;
    TRY(read_input(p, params, "tex1", is_float, 0, &texture->inputs[0]));
    TRY(read_input(p, params, "tex2", is_float, 1, &texture->inputs[1]));
    return read_input(p, params, "amount", true, 0.5f, &texture->inputs[2]);
}

/* pbrt-v4's tex1 has the share |n . d|. */
static result_t read_direction_mix(pbrt_t *p, params_t *params, position_t at, bool is_float,
                                   blob_texture_t *texture, blob_value_t *value)
{
    (void)value;
    double d[3] = {0, 1, 0};
    TRY(read_input(p, params, "tex1", is_float, 0, &texture->inputs[1]));
    TRY(read_input(p, params, "tex2", is_float, 1, &texture->inputs[0]));
    TRY(params_point(params, "dir", PARAM_BIT(PARAM_VECTOR3), d));
    xform_t space = affine_to_xform(&p->now.ctm);
    vec3_t direction = v_normalize(xform_vector(&space, vec3((float)d[0], (float)d[1], (float)d[2])));
    if (!v_is_finite(direction)) return error_at(params_where(params, "dir", at), "\"dir\" has no direction");
    texture->parameters[0] = direction.x;
    texture->parameters[1] = direction.y;
    texture->parameters[2] = direction.z;
    return result_ok();
}

/* ---- patterns over (s, t) ------------------------------------------------------------------------------ */

static result_t read_bilerp(pbrt_t *p, params_t *params, position_t at, bool is_float,
                            blob_texture_t *texture, blob_value_t *value)
{
    (void)at, (void)value;
    static const char *const names[] = {"v00", "v01", "v10", "v11"};
    for (int i = 0; i < 4; ++i)
        TRY(read_input(p, params, names[i], is_float, (float)(i & 1), &texture->inputs[i]));
    return result_ok();
}

static result_t read_uv(pbrt_t *p, params_t *params, position_t at, bool is_float, blob_texture_t *texture,
                        blob_value_t *value)
{
    (void)p, (void)params, (void)texture, (void)value;
    return is_float ? error_at(at, "texture \"uv\" is a colour, not of type \"float\"") : result_ok();
}

static const param_rule_t checkerboard_rules[] = {
    {{"aamode"}, PARAM_ACCEPT, NULL}, /* many samples a pixel filter the pattern */
};

static result_t read_checkerboard(pbrt_t *p, params_t *params, position_t at, bool is_float,
                                  blob_texture_t *texture, blob_value_t *value)
{
    (void)value;
    int32_t dimension = 2;
    TRY(params_int_in(params, "dimension", 2, 3, &dimension));
    TRY(read_space(p, params, at, dimension == 2 ? SPACE_2D : SPACE_3D, texture));
    TRY(read_input(p, params, "tex1", is_float, 1, &texture->inputs[0]));
    TRY(read_input(p, params, "tex2", is_float, 0, &texture->inputs[1]));
    return params_apply(params, checkerboard_rules, ARRAY_LENGTH(checkerboard_rules), p->report);
}

static result_t read_dots(pbrt_t *p, params_t *params, position_t at, bool is_float, blob_texture_t *texture,
                          blob_value_t *value)
{
    (void)at, (void)value;
    TRY(read_input(p, params, "inside", is_float, 1, &texture->inputs[0]));
    return read_input(p, params, "outside", is_float, 0, &texture->inputs[1]);
}

/* ---- patterns of space --------------------------------------------------------------------------------- */

static result_t read_noise(pbrt_t *p, params_t *params, position_t at, bool is_float, blob_texture_t *texture,
                           blob_value_t *value)
{
    (void)p, (void)at, (void)is_float, (void)value;
    int32_t octaves = 8;
    double roughness = 0.5;
    if (texture->kind == TEXTURE_WINDY) return result_ok();
    TRY(params_int_in(params, "octaves", 0, 64, &octaves));
    TRY(params_float_in(params, "roughness", 0, 100, &roughness));
    texture->parameters[0] = (float)octaves;
    texture->parameters[1] = (float)roughness;
    return result_ok();
}

static result_t read_marble(pbrt_t *p, params_t *params, position_t at, bool is_float,
                            blob_texture_t *texture, blob_value_t *value)
{
    if (is_float) return error_at(at, "texture \"marble\" is a colour, not of type \"float\"");
    double scale = 1, variation = 0.2;
    TRY(read_noise(p, params, at, is_float, texture, value));
    TRY(params_float_in(params, "scale", -1e6, 1e6, &scale));
    TRY(params_float_in(params, "variation", -1e6, 1e6, &variation));
    texture->parameters[2] = (float)scale;
    texture->parameters[3] = (float)variation;
    return result_ok();
}

/* ---- images -------------------------------------------------------------------------------------------- */

static result_t read_wrap(pbrt_t *p, params_t *params, position_t at, blob_texture_t *texture)
{
    static const struct {
        const char *name;
        wrap_t wrap;
    } wraps[] = {{"repeat", WRAP_REPEAT}, {"clamp", WRAP_CLAMP}, {"black", WRAP_BLACK}};
    const char *name = "repeat";
    TRY(params_string(params, "wrap", &name));
    at = params_where(params, "wrap", at);
    texture->wrap_s = texture->wrap_t = 0;
    for (size_t i = 0; i < ARRAY_LENGTH(wraps); ++i)
        if (strcmp(name, wraps[i].name) == 0) texture->wrap_s = texture->wrap_t = wraps[i].wrap;
    if (texture->wrap_s == 0) {
        bool known = strcmp(name, "octahedralsphere") == 0 && p->dialect.dialect == DIALECT_V4;
        TRY(known ? report_refuse(p->report, at, "wrap \"%s\" is not supported; the nearest is clamp", name)
                  : pbrt_slip(p, at, "it is \"repeat\"",
                              "unknown wrap \"%.40s\"; repeat, clamp and black are known", name));
        texture->wrap_s = texture->wrap_t = known ? WRAP_CLAMP : WRAP_REPEAT;
    }
    if (texture->mapping == MAPPING_CYLINDRICAL && texture->wrap_s != WRAP_REPEAT) {
        TRY(report_refuse(p->report, at, "an image on a cylinder can only repeat; remove \"wrap\""));
        texture->wrap_s = texture->wrap_t = WRAP_REPEAT;
    }
    return result_ok();
}

/* Filtering takes place in the pixel filter, over many samples: a mip map would only blur. */
static const param_rule_t filter_rules[] = {
    {{"trilinear", "maxanisotropy"}, PARAM_ACCEPT, NULL},
};

static result_t read_filter(const pbrt_t *p, params_t *params, position_t at, blob_texture_t *texture)
{
    static const char *const smooth[] = {"bilinear", "trilinear", "ewa", "EWA"};
    const char *filter = "bilinear";
    TRY(params_string(params, "filter", &filter));
    if (strcmp(filter, "point") == 0) {
        texture->flags |= TEXTURE_NEAREST;
        return result_ok();
    }
    for (size_t i = 0; i < ARRAY_LENGTH(smooth); ++i)
        if (strcmp(filter, smooth[i]) == 0) return result_ok();
    return report_tolerate(p->report, params_where(params, "filter", at),
                           "unknown filter \"%.40s\"; it is that of other images, as by pbrt", filter);
}

static result_t read_encoding_v3(params_t *params, float *gamma)
{
    bool encoded = false;
    *gamma = SCENE_GAMMA_OF_FILE;
    if (!params_has(params, "gamma")) return result_ok();
    TRY(params_bool(params, "gamma", &encoded));
    *gamma = encoded ? 0 : 1;
    return result_ok();
}

/* pbrt-v4 asks the encoding of PNG files alone: other files of 8 bits are sRGB, of floats linear. */
static result_t read_encoding_v4(params_t *params, const char *filename, position_t at, float *gamma)
{
    const char *encoding = "sRGB";
    TRY(params_string(params, "encoding", &encoding));
    at = params_where(params, "encoding", at);
    *gamma = SCENE_GAMMA_OF_FILE;
    char *end;
    if (strcmp(encoding, "sRGB") == 0) {
        *gamma = 0;
    } else if (strcmp(encoding, "linear") == 0) {
        *gamma = 1;
    } else {
        float exponent = strncmp(encoding, "gamma ", 6) == 0 ? strtof(encoding + 6, &end) : 0;
        if (!(exponent > 0 && exponent <= 10) || *end != '\0')
            return error_at(at, "unknown encoding \"%.40s\"; sRGB, linear and gamma X are known", encoding);
        *gamma = exponent;
    }
    if (!pbrt_has_extension(filename, ".png")) *gamma = SCENE_GAMMA_OF_FILE;
    return result_ok();
}

/* A number from an image of colours: v3 takes the luminance, v4 the mean, but alpha where there is one. Of
 * grey with alpha both take the grey. */
static void take_number(const pbrt_t *p, blob_texture_t *texture, const scene_image_t *file)
{
    bool v3 = p->dialect.dialect == DIALECT_V3;
    texture->channel = file->grey || file->alpha ? CHANNEL_R : v3 ? CHANNEL_LUMINANCE : CHANNEL_MEAN;
    if (file->alpha && !file->grey) texture->image = file->alpha;
}

static result_t read_scale(pbrt_t *p, params_t *params, blob_texture_t *texture)
{
    double scale = 1;
    bool invert = false;
    TRY(params_float_in(params, "scale", -1e30, 1e30, &scale));
    texture->inputs[0] = blob_constant((float)scale);
    if (p->dialect.dialect == DIALECT_V3) return result_ok();
    TRY(params_bool(params, "invert", &invert));
    if (invert) texture->flags |= TEXTURE_INVERT;
    return result_ok();
}

/* Whether the file is missing, where that is no error. */
static result_t find_image(pbrt_t *p, const char *filename, position_t at, bool *missing)
{
    char *path = pbrt_resolve(p, filename);
    *missing = pbrt_is_missing(path);
    result_t result = *missing ? pbrt_missing(p, at, path, "it is grey, 0.5") : result_ok();
    free(path);
    return result;
}

/* pbrt-v3 has 0.5 for each pixel of a file that is missing, which it decodes and scales like others. */
static blob_value_t missing_image(const char *filename, float gamma, const blob_texture_t *texture)
{
    bool encoded = gamma == 0 || (gamma == SCENE_GAMMA_OF_FILE && (pbrt_has_extension(filename, ".png") ||
                                                                   pbrt_has_extension(filename, ".tga")));
    const float decoded = 0.21404114f; /* of 0.5, IEC 61966-2-1 */
    return blob_constant((encoded ? decoded : 0.5f) * texture->inputs[0].factor.x);
}

static result_t read_image(pbrt_t *p, params_t *params, position_t at, bool is_float, blob_texture_t *texture,
                           blob_value_t *value)
{
    bool v3 = p->dialect.dialect == DIALECT_V3, missing;
    float gamma = SCENE_GAMMA_OF_FILE;
    const char *filename = NULL;
    const scene_image_t *file;
    TRY(params_string(params, "filename", &filename));
    if (!filename) return error_at(at, "an imagemap needs its file: \"string filename\"");
    TRY(read_space(p, params, at, SPACE_2D, texture));
    flip_t(texture);
    TRY(read_wrap(p, params, at, texture));
    TRY(read_scale(p, params, texture));
    if (!v3) TRY(read_filter(p, params, at, texture));
    TRY(v3 ? read_encoding_v3(params, &gamma) : read_encoding_v4(params, filename, at, &gamma));
    TRY(params_apply(params, filter_rules, ARRAY_LENGTH(filter_rules), p->report));
    TRY(find_image(p, filename, at, &missing));
    if (missing) {
        texture->kind = 0;
        *value = missing_image(filename, gamma, texture);
        return result_ok();
    }
    TRY(pbrt_image(p, filename, gamma, is_float ? IMAGE_NUMBERS : IMAGE_REFLECTED, at, &file));
    texture->image = file->image;
    texture->channel = CHANNEL_RGB;
    if (is_float) take_number(p, texture, file);
    if (!v3 && !is_float) texture->flags |= TEXTURE_UNIT; /* a reflectance, as nearly all are */
    return result_ok();
}

result_t pbrt_normal_map(pbrt_t *p, const char *filename, position_t at, blob_ref_t *texture)
{
    const scene_image_t *image;
    blob_texture_t map = {.kind = TEXTURE_IMAGE,
                          .mapping = MAPPING_UV,
                          .matrix = {{1, 0, 0}, {0, 1, 0}},
                          .channel = CHANNEL_RGB,
                          .wrap_s = WRAP_REPEAT,
                          .wrap_t = WRAP_REPEAT,
                          .inputs = {blob_constant(1)}};
    flip_t(&map);
    TRY(pbrt_image(p, filename, 1, IMAGE_NUMBERS, at, &image));
    map.image = image->image;
    *texture = scene_add_texture(p->builder, &map).texture;
    return result_ok();
}

/* ---- the directive ------------------------------------------------------------------------------------- */

static const texture_entry_t textures[] = {
    {{"constant", DIALECT_BOTH}, 0, SPACE_NONE, read_constant},
    {{"imagemap", DIALECT_BOTH}, TEXTURE_IMAGE, SPACE_NONE, read_image}, /* whose space it turns over */
    {{"checkerboard", DIALECT_BOTH},
     TEXTURE_CHECKERBOARD,
     SPACE_NONE,
     read_checkerboard}, /* one or the other */
    {{"scale", DIALECT_BOTH}, TEXTURE_SCALE, SPACE_NONE, read_product},
    {{"mix", DIALECT_BOTH}, TEXTURE_MIX, SPACE_NONE, read_mix},
    {{"bilerp", DIALECT_BOTH}, TEXTURE_BILERP, SPACE_2D, read_bilerp},
    {{"dots", DIALECT_BOTH}, TEXTURE_DOTS, SPACE_2D, read_dots},
    {{"fbm", DIALECT_BOTH}, TEXTURE_FBM, SPACE_3D, read_noise},
    {{"wrinkled", DIALECT_BOTH}, TEXTURE_WRINKLED, SPACE_3D, read_noise},
    {{"marble", DIALECT_BOTH}, TEXTURE_MARBLE, SPACE_3D, read_marble},
    {{"windy", DIALECT_BOTH}, TEXTURE_WINDY, SPACE_3D, read_noise},
    {{"uv", DIALECT_V3}, TEXTURE_UV, SPACE_2D, read_uv},
    {{"directionmix", DIALECT_V4}, TEXTURE_DIRECTION_MIX, SPACE_NONE, read_direction_mix},
    {{"ptex", DIALECT_BOTH}, 0, SPACE_NONE, NULL},
};

static result_t make_texture(pbrt_t *p, const texture_entry_t *entry, position_t at, bool is_float,
                             blob_value_t *value)
{
    blob_texture_t texture = {.kind = entry->kind};
    TRY(read_space(p, p->params, at, entry->space, &texture));
    TRY(entry->read(p, p->params, at, is_float, &texture, value));
    if (texture.kind) *value = scene_add_texture(p->builder, &texture);
    return result_ok();
}

/* What v3 leaves out: a texture of another type, or of a class that nobody knows. */
static result_t leave_out(pbrt_t *p, position_t at, bool typed)
{
    if (typed) return pbrt_slip(p, at, "it is left out", "unknown texture \"%.40s\"", p->arguments[2]);
    return pbrt_slip(p, at, "it is left out", "a Texture is of type \"float\" or \"spectrum\", not \"%.40s\"",
                     p->arguments[1]);
}

static void store(pbrt_t *p, bool is_float, blob_value_t value, position_t at)
{
    uint32_t old;
    names_t *names = &p->texture_names[is_float];
    if (names_find(names, p->arguments[0], &old))
        report_warning(p->report, at, "the texture \"%.60s\" is replaced", p->arguments[0]);
    p->textures = grow(p->textures, &p->texture_capacity, p->texture_count + 1, sizeof *p->textures);
    names_add(names, p->arguments[0], (uint32_t)p->texture_count);
    p->textures[p->texture_count++] = (texture_t){.value = value};
}

static const param_rule_t substitute_rules[] = {
    {{"filename", "encoding", "gamma", "scale"}, PARAM_ACCEPT, NULL},
};

/* A lenient import takes grey for what is not supported. */
static result_t make_substitute(pbrt_t *p, position_t at, bool known, blob_value_t *value)
{
    *value = blob_constant(0.5f);
    TRY(report_refuse(p->report, at, "%stexture \"%.40s\"%s; the nearest is a constant 0.5",
                      known ? "" : "unknown ", p->arguments[2], known ? " is not supported" : ""));
    return params_apply(p->params, substitute_rules, ARRAY_LENGTH(substitute_rules), p->report);
}

/* Makes a texture of a class that the scene's dialect has. */
static result_t make_known(pbrt_t *p, position_t at, bool is_float, blob_value_t *value)
{
    size_t index;
    TRY(entry_find(textures, ARRAY_LENGTH(textures), sizeof *textures, "texture", p->arguments[2],
                   &p->dialect, at, &index));
    return textures[index].read ? make_texture(p, &textures[index], at, is_float, value)
                                : make_substitute(p, at, true, value);
}

result_t pbrt_texture(pbrt_t *p, position_t at)
{
    blob_value_t value = blob_constant(1);
    TRY(pbrt_read_string(p, 0, "the texture's name"));
    TRY(pbrt_read_string(p, 1, "the type \"float\" or \"spectrum\""));
    TRY(pbrt_read_string(p, 2, "the texture's class"));
    TRY(pbrt_read_params_for(p, TARGET_TEXTURE));
    const char *type = p->arguments[1];
    bool is_float = strcmp(type, "float") == 0;
    bool typed = is_float || strcmp(type, "spectrum") == 0 || strcmp(type, "color") == 0;
    bool known = entry_knows(textures, ARRAY_LENGTH(textures), sizeof *textures, p->arguments[2]);
    if (!typed || (!known && p->dialect.dialect == DIALECT_V3)) return leave_out(p, at, typed);
    TRY(known ? make_known(p, at, is_float, &value) : make_substitute(p, at, false, &value));
    TRY(pbrt_finish_params(p, "Texture", p->arguments[2]));
    TRY(scene_check_textures(p->builder, at));
    store(p, is_float, value, at);
    return result_ok();
}
