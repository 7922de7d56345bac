/* texture: see texture.h. */
#include "client/import/mitsuba/texture.h"

#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "client/import/scene/scene_images.h"

enum { MOST_DEPTH = 16 };

/* (s, t) = scale (u, v) + offset. */
static result_t read_mapping(mitsuba_t *m, const element_t *object, bool flipped, blob_texture_t *texture)
{
    double scale[2] = {1, 1}, offset[2] = {0, 0};
    const double most = 1e6;
    TRY(property_number(m, object, "uvscale", -most, most, &scale[0]));
    scale[1] = scale[0];
    TRY(property_number(m, object, "uscale", -most, most, &scale[0]));
    TRY(property_number(m, object, "vscale", -most, most, &scale[1]));
    TRY(property_number(m, object, "uoffset", -most, most, &offset[0]));
    TRY(property_number(m, object, "voffset", -most, most, &offset[1]));
    property_ignore(object, "coordinates"); /* uv is all that there is */
    texture->mapping = MAPPING_UV;
    texture->texture_from_world = xform_identity();
    texture->matrix[0][0] = (float)scale[0];
    texture->matrix[0][2] = (float)offset[0];
    texture->matrix[1][1] = (float)(flipped ? -scale[1] : scale[1]);
    texture->matrix[1][2] = (float)(flipped ? scale[1] + offset[1] : offset[1]);
    return result_ok();
}

static result_t read_wrap(mitsuba_t *m, const element_t *object, const char *name, const char *otherwise,
                          uint32_t *wrap)
{
    static const struct {
        const char *name;
        wrap_t wrap;
    } modes[] = {{"repeat", WRAP_REPEAT},
                 {"clamp", WRAP_CLAMP},
                 {"mirror", WRAP_MIRROR},
                 {"zero", WRAP_BLACK},
                 {"black", WRAP_BLACK}};
    const char *mode = otherwise;
    TRY(property_string(m, object, name, &mode));
    for (size_t i = 0; i < ARRAY_LENGTH(modes); ++i) {
        if (strcasecmp(mode, modes[i].name) != 0) continue;
        *wrap = modes[i].wrap;
        return result_ok();
    }
    *wrap = WRAP_CLAMP;
    return report_refuse(
        m->report, object->at,
        "%s \"%.20s\" is not supported; it may be repeat, clamp, mirror or zero. The nearest "
        "is clamp",
        name, mode);
}

static result_t read_wraps(mitsuba_t *m, const element_t *object, blob_texture_t *texture)
{
    const char *both = "repeat";
    TRY(property_string(m, object, "wrapMode", &both));
    TRY(read_wrap(m, object, "wrapModeU", both, &texture->wrap_s));
    return read_wrap(m, object, "wrapModeV", both, &texture->wrap_t);
}

static result_t read_channel(mitsuba_t *m, const element_t *object, uint32_t *channel)
{
    static const struct {
        const char *name;
        channel_t channel;
    } channels[] = {{"r", CHANNEL_R}, {"g", CHANNEL_G}, {"b", CHANNEL_B}, {"a", CHANNEL_A}};
    const char *name = "";
    *channel = CHANNEL_RGB;
    TRY(property_string(m, object, "channel", &name));
    for (size_t i = 0; i < ARRAY_LENGTH(channels); ++i) {
        if (strcasecmp(name, channels[i].name) != 0) continue;
        *channel = channels[i].channel;
        return result_ok();
    }
    if (*name == '\0') return result_ok();
    return report_refuse(
        m->report, object->at,
        "channel \"%.20s\" is not supported; it may be r, g, b or a. The nearest is all of them", name);
}

/* Mitsuba's gamma: 0 as the file says, -1 sRGB. Alpha is linear always. */
static result_t read_gamma(mitsuba_t *m, const element_t *object, texture_use_t use, channel_t channel,
                           float *gamma)
{
    double given = use == TEXTURE_NORMALS ? 1 : 0;
    TRY(property_number(m, object, "gamma", -1, 100, &given));
    if (given < 0 && given != -1) return error_at(object->at, "gamma must be -1 (sRGB), 0 or above");
    if (channel == CHANNEL_A) given = 1;
    *gamma = given == 0 ? SCENE_GAMMA_OF_FILE : given == -1 ? 0 : (float)given;
    return result_ok();
}

static result_t make_bitmap(mitsuba_t *m, element_t *object, texture_use_t use, bool flipped,
                            blob_value_t *value)
{
    const char *file = NULL, *filter = "";
    float gamma = 1;
    const scene_image_t *image = NULL;
    blob_texture_t texture = {.kind = TEXTURE_IMAGE, .inputs = {blob_constant(1)}};
    TRY(property_string(m, object, "filename", &file));
    TRY(property_string(m, object, "filterType", &filter));
    if (!file) return error_at(object->at, "a bitmap needs a filename");
    TRY(read_mapping(m, object, flipped, &texture));
    TRY(read_wraps(m, object, &texture));
    TRY(read_channel(m, object, &texture.channel));
    TRY(read_gamma(m, object, use, texture.channel, &gamma));
    property_ignore(object, "maxAnisotropy"); /* how Mitsuba filters and caches */
    property_ignore(object, "cache");
    if (strcasecmp(filter, "nearest") == 0) texture.flags |= TEXTURE_NEAREST;
    char *path = element_path(object, file);
    result_t result = scene_image_of_file(m->scene, path, gamma, SCENE_ALPHA_APART, object->at, &image);
    free(path);
    TRY(report_excuse(m->report, result, "the texture is grey"));
    *value = blob_constant(0.5f);
    if (!image) return result_ok();
    bool apart = texture.channel == CHANNEL_A && image->alpha != 0;
    texture.image = apart ? image->alpha : image->image;
    if (apart) texture.channel = CHANNEL_R;
    *value = scene_add_texture(m->scene, &texture);
    return result_ok();
}

/* color0 fills the cells in which u and v are in the same half. */
static result_t make_checkerboard(mitsuba_t *m, element_t *object, bool flipped, blob_value_t *value)
{
    blob_texture_t texture = {.kind = TEXTURE_CHECKERBOARD, .channel = CHANNEL_RGB};
    rgb_t colours[2] = {{0.4f, 0.4f, 0.4f}, {0.2f, 0.2f, 0.2f}};
    TRY(property_colour(m, object, "color0", &colours[0]));
    TRY(property_colour(m, object, "color1", &colours[1]));
    TRY(read_mapping(m, object, flipped, &texture));
    for (int i = 0; i < 2; ++i) {
        texture.inputs[i] = blob_colour_value(colours[i]);
        for (int k = 0; k < 3; ++k) texture.matrix[i][k] *= 2;
    }
    *value = scene_add_texture(m->scene, &texture);
    return result_ok();
}

static result_t make_value(mitsuba_t *m, element_t *object, texture_use_t use, bool flipped, int depth,
                           blob_value_t *value);

static result_t make_scale(mitsuba_t *m, element_t *object, texture_use_t use, bool flipped, int depth,
                           blob_value_t *value)
{
    element_t *inner;
    rgb_t scale = {1, 1, 1}, colour = {1, 1, 1};
    *value = blob_constant(1);
    TRY(object_only(m, object, "texture", &inner));
    if (inner) TRY(make_value(m, inner, use, flipped, depth + 1, value));
    TRY(property_colour(m, object, "value", &colour));
    TRY(property_colour(m, object, "scale", &scale));
    value->factor = v_mul(value->factor, v_mul(scale, colour));
    return result_ok();
}

static result_t make_value(mitsuba_t *m, element_t *object, texture_use_t use, bool flipped, int depth,
                           blob_value_t *value)
{
    const char *type = object_type(object);
    if (depth > MOST_DEPTH) return error_at(object->at, "more than %d textures in one another", MOST_DEPTH);
    if (strcmp(type, "bitmap") == 0 || strcmp(type, "ldrtexture") == 0 || strcmp(type, "exrtexture") == 0) {
        TRY(make_bitmap(m, object, use, flipped, value));
    } else if (strcmp(type, "checkerboard") == 0) {
        TRY(make_checkerboard(m, object, flipped, value));
    } else if (strcmp(type, "scale") == 0) {
        TRY(make_scale(m, object, use, flipped, depth, value));
    } else if (strcmp(type, "vertexcolors") == 0) {
        blob_texture_t texture = {.kind = TEXTURE_COLOUR, .channel = CHANNEL_RGB};
        texture.texture_from_world = xform_identity();
        *value = scene_add_texture(m->scene, &texture);
    } else {
        *value = blob_constant(0.5f);
        return report_refuse(m->report, object->at, "texture \"%.40s\" is not supported; the nearest is grey",
                             type);
    }
    return object_finish(m, object);
}

/* Of an image, looked at once. */
static rgb_t image_most(mitsuba_t *m, blob_ref_t image)
{
    size_t known = m->image_most_capacity;
    m->image_most = grow(m->image_most, &m->image_most_capacity, image, sizeof *m->image_most);
    for (; known < m->image_most_capacity; ++known) m->image_most[known] = vec3(-1, -1, -1);
    if (m->image_most[image - 1].x < 0) m->image_most[image - 1] = scene_image_most(m->scene, image);
    return m->image_most[image - 1];
}

static rgb_t channel_of(rgb_t most, uint32_t channel)
{
    if (channel == CHANNEL_R) return vec3(most.x, most.x, most.x);
    if (channel == CHANNEL_G) return vec3(most.y, most.y, most.y);
    if (channel == CHANNEL_B) return vec3(most.z, most.z, most.z);
    return channel == CHANNEL_A ? vec3(1, 1, 1) : most;
}

rgb_t texture_most(mitsuba_t *m, const blob_value_t *value)
{
    const blob_texture_t *texture = blob_builder_records(m->scene->blob, BLOB_SECTION_TEXTURES);
    if (value->texture == 0) return value->factor;
    texture += value->texture - 1;
    rgb_t a = texture->inputs[0].factor, b = texture->inputs[1].factor;
    if (texture->kind == TEXTURE_IMAGE)
        return v_mul(value->factor, channel_of(image_most(m, texture->image), texture->channel));
    if (texture->kind == TEXTURE_CHECKERBOARD)
        return v_mul(value->factor, vec3(float_max(a.x, b.x), float_max(a.y, b.y), float_max(a.z, b.z)));
    return value->factor;
}

/* ---- numbers ------------------------------------------------------------------------------------------- */

static bool is_grey(rgb_t c)
{
    return c.x == c.y && c.y == c.z;
}

static rgb_t grey_of(rgb_t c, channel_t channel)
{
    if (is_grey(c)) return c;
    float number = channel == CHANNEL_MEAN ? (c.x + c.y + c.z) / 3 : rgb_luminance(c);
    return vec3(number, number, number);
}

/* Lets a texture that has just been made have one number in all its components. */
static void make_grey(mitsuba_t *m, channel_t channel, blob_value_t *value)
{
    blob_texture_t *texture = blob_builder_records(m->scene->blob, BLOB_SECTION_TEXTURES);
    if (value->texture == 0) {
        value->factor = grey_of(value->factor, channel);
        return;
    }
    texture += value->texture - 1;
    if (texture->kind == TEXTURE_IMAGE && is_grey(value->factor)) {
        if (texture->channel == CHANNEL_RGB) texture->channel = channel;
    } else if (texture->kind == TEXTURE_CHECKERBOARD && is_grey(value->factor)) {
        for (int i = 0; i < 2; ++i) texture->inputs[i].factor = grey_of(texture->inputs[i].factor, channel);
    } else {
        blob_texture_t number = {.kind = TEXTURE_CHANNEL, .channel = channel, .inputs = {*value}};
        number.texture_from_world = xform_identity();
        *value = scene_add_texture(m->scene, &number);
    }
}

static void make_number(mitsuba_t *m, texture_use_t use, blob_value_t *value)
{
    if (use == TEXTURE_MEAN) make_grey(m, CHANNEL_MEAN, value);
    if (use == TEXTURE_LUMINANCE) make_grey(m, CHANNEL_LUMINANCE, value);
}

/* ---- the whole ----------------------------------------------------------------------------------------- */

result_t texture_element(mitsuba_t *m, element_t *texture, texture_use_t use, bool flipped,
                         blob_value_t *value)
{
    TRY(make_value(m, texture, use, flipped, 0, value));
    make_number(m, use, value);
    return result_ok();
}

result_t texture_property(mitsuba_t *m, const element_t *object, const char *name, double otherwise,
                          texture_use_t use, bool flipped, blob_value_t *value)
{
    element_t *found;
    *value = blob_constant((float)otherwise);
    TRY(object_named(m, object, "texture", name, &found));
    if (found) return texture_element(m, found, use, flipped, value);
    TRY(property_colour(m, object, name, &value->factor));
    make_number(m, use, value);
    return result_ok();
}
