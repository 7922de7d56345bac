/* texture: images, samplers and texture transforms become textures of the blob. */
#include "client/import/gltf/document.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

/* ---- images -------------------------------------------------------------------------------------------- */

result_t texture_bytes(document_t *document, const item_t *image, bytes_t *bytes, char name[PATH_ROOM])
{
    uint32_t view = ITEM_NONE;
    const char *uri = NULL;
    TRY(item_string(image, "uri", &uri));
    TRY(item_index(image, "bufferView", document_count(document, TOP_BUFFER_VIEWS), &view));
    if (uri) return document_uri(document, image, uri, bytes, name);
    strcpy(name, "buffer");
    if (view == ITEM_NONE) return item_fail(image, "has neither uri nor bufferView");
    return document_view(document, view, bytes);
}

static result_t find_or_add(document_t *document, uint32_t index, encoding_t encoding, blob_ref_t *ref)
{
    item_t item;
    bytes_t bytes;
    char key[32], name[PATH_ROOM];
    float gamma = encoding == ENCODING_SRGB ? 0 : 1;
    snprintf(key, sizeof key, "images[%" PRIu32 "]", index);
    const scene_image_t *image = scene_find_image(document->builder, key, gamma);
    if (!image) {
        TRY(document_item(document, TOP_IMAGES, index, &item));
        TRY(texture_bytes(document, &item, &bytes, name));
        TRY(scene_add_image(document->builder, key, name, bytes.data, bytes.size, gamma, SCENE_ALPHA_WITHIN,
                            document_at(document, &item), &image));
    }
    *ref = image->image;
    return result_ok();
}

/* The image in the blob; 0 when it cannot be read and --lenient has the texture left out. */
static result_t image_ref(document_t *document, uint32_t index, encoding_t encoding, blob_ref_t *ref)
{
    *ref = 0;
    return report_excuse(document->builder->report, find_or_add(document, index, encoding, ref),
                         "the texture is left out");
}

/* ---- samplers and transforms --------------------------------------------------------------------------- */

static result_t read_wrap(const item_t *sampler, const char *key, uint32_t *wrap)
{
    enum { REPEAT = 10497, CLAMP_TO_EDGE = 33071, MIRRORED_REPEAT = 33648 };
    uint64_t mode = REPEAT;
    TRY(item_whole(sampler, key, 65535, &mode));
    if (mode != REPEAT && mode != CLAMP_TO_EDGE && mode != MIRRORED_REPEAT)
        return item_fail(sampler, "%s must be 10497, 33071 or 33648", key);
    *wrap = mode == REPEAT ? WRAP_REPEAT : mode == CLAMP_TO_EDGE ? WRAP_CLAMP : WRAP_MIRROR;
    return result_ok();
}

static result_t read_sampler(const document_t *document, const item_t *texture, blob_texture_t *out)
{
    enum { NEAREST = 9728 };
    uint32_t index = ITEM_NONE;
    uint64_t filter = 0;
    item_t sampler;
    out->wrap_s = out->wrap_t = WRAP_REPEAT;
    TRY(item_index(texture, "sampler", document_count(document, TOP_SAMPLERS), &index));
    if (index == ITEM_NONE) return result_ok();
    TRY(document_item(document, TOP_SAMPLERS, index, &sampler));
    TRY(read_wrap(&sampler, "wrapS", &out->wrap_s));
    TRY(read_wrap(&sampler, "wrapT", &out->wrap_t));
    TRY(item_whole(&sampler, "magFilter", 65535, &filter));
    if (filter == NEAREST) out->flags |= TEXTURE_NEAREST;
    return result_ok();
}

/* KHR_texture_transform: translation after rotation after scaling, about the upper left corner, v downwards.
 * The meshes hold 1 - v (see primitive_read), which the matrix undoes. */
static result_t read_mapping(const item_t *info, blob_texture_t *out)
{
    const double most = 1e6;
    double offset[2] = {0, 0}, scale[2] = {1, 1}, angle = 0;
    uint64_t set = 0;
    item_t transform;
    TRY(item_whole(info, "texCoord", 1000, &set));
    TRY(item_extension(info, "KHR_texture_transform", &transform));
    TRY(item_numbers(&transform, "offset", 2, -most, most, offset, NULL));
    TRY(item_numbers(&transform, "scale", 2, -most, most, scale, NULL));
    TRY(item_number(&transform, "rotation", -most, most, &angle));
    TRY(item_whole(&transform, "texCoord", 1000, &set));
    if (set > 1)
        item_warn(info, "texture coordinates beyond the second set are not supported; the second is used");
    double c = cos(angle), s = sin(angle);
    double m[2][3] = {{c * scale[0], s * scale[1], offset[0]}, {-s * scale[0], c * scale[1], offset[1]}};
    for (int i = 0; i < 2; ++i) {
        out->matrix[i][0] = (float)m[i][0];
        out->matrix[i][1] = (float)-m[i][1];
        out->matrix[i][2] = (float)(m[i][2] + m[i][1]);
    }
    out->mapping = set == 0 ? MAPPING_UV : MAPPING_UV2;
    return result_ok();
}

/* ---- textures ------------------------------------------------------------------------------------------ */

/* The image of a texture; that of EXT_texture_webp goes before the one for programs that do not read it. */
static result_t source_of(const document_t *document, const item_t *texture, uint32_t *source)
{
    item_t webp;
    size_t images = document_count(document, TOP_IMAGES);
    TRY(item_extension(texture, "EXT_texture_webp", &webp));
    TRY(item_index(texture, "source", images, source));
    return item_index(&webp, "source", images, source);
}

/* The texture that the property `key` of an object refers to. *present is false when there is none, or when
 * --lenient has it left out. */
static result_t open_texture(document_t *document, const item_t *owner, const char *key, encoding_t encoding,
                             channel_t channel, blob_texture_t *texture, bool *present)
{
    *present = false;
    item_t info, item;
    TRY(item_member(owner, key, JSON_OBJECT, &info));
    if (!info.json) return result_ok();
    uint32_t index = ITEM_NONE, source = ITEM_NONE;
    TRY(item_index(&info, "index", document_count(document, TOP_TEXTURES), &index));
    if (index == ITEM_NONE) return item_fail(&info, "names no texture");
    TRY(document_item(document, TOP_TEXTURES, index, &item));
    TRY(source_of(document, &item, &source));
    if (source == ITEM_NONE)
        return report_excuse(
            item.report,
            item_fail(&item, "has no image that can be read; export textures as PNG, JPEG or WebP"),
            "the texture is left out");
    *texture = (blob_texture_t){.kind = TEXTURE_IMAGE, .channel = channel, .inputs = {blob_constant(1)}};
    texture->texture_from_world = xform_identity();
    TRY(read_mapping(&info, texture));
    TRY(read_sampler(document, &item, texture));
    TRY(image_ref(document, source, encoding, &texture->image));
    *present = texture->image != 0;
    return result_ok();
}

result_t texture_value(document_t *document, const item_t *owner, const char *key, encoding_t encoding,
                       channel_t channel, rgb_t factor, blob_value_t *value)
{
    blob_texture_t texture;
    bool present;
    *value = blob_colour_value(factor);
    TRY(open_texture(document, owner, key, encoding, channel, &texture, &present));
    if (present) value->texture = scene_add_texture(document->builder, &texture).texture;
    return result_ok();
}

result_t texture_complement(document_t *document, const item_t *owner, const char *key, encoding_t encoding,
                            channel_t channel, float factor, blob_value_t *value)
{
    blob_texture_t texture;
    bool present;
    *value = blob_constant(1 - factor);
    TRY(open_texture(document, owner, key, encoding, channel, &texture, &present));
    if (!present) return result_ok();
    texture.inputs[0] = blob_constant(factor);
    texture.flags |= TEXTURE_INVERT;
    *value = scene_add_texture(document->builder, &texture);
    return result_ok();
}

blob_value_t texture_product(document_t *document, blob_value_t a, blob_value_t b)
{
    if (b.texture == 0) {
        a.factor = v_mul(a.factor, b.factor);
        return a;
    }
    if (a.texture == 0) {
        b.factor = v_mul(a.factor, b.factor);
        return b;
    }
    blob_texture_t texture = {.kind = TEXTURE_SCALE, .channel = CHANNEL_RGB, .inputs = {a, b}};
    texture.texture_from_world = xform_identity();
    return scene_add_texture(document->builder, &texture);
}

blob_value_t texture_mix(document_t *document, blob_value_t a, blob_value_t b, blob_value_t amount)
{
    blob_texture_t texture = {.kind = TEXTURE_MIX, .channel = CHANNEL_RGB, .inputs = {a, b, amount}};
    texture.texture_from_world = xform_identity();
    return scene_add_texture(document->builder, &texture);
}

blob_value_t texture_vertex_colour(document_t *document, channel_t channel)
{
    blob_texture_t texture = {.kind = TEXTURE_COLOUR, .channel = channel};
    texture.texture_from_world = xform_identity();
    return scene_add_texture(document->builder, &texture);
}

blob_value_t texture_threshold(document_t *document, blob_value_t value, float cutoff)
{
    if (value.texture == 0) return blob_constant(value.factor.x >= cutoff ? 1 : 0);
    blob_texture_t texture = {
        .kind = TEXTURE_THRESHOLD, .channel = CHANNEL_RGB, .inputs = {value}, .parameters = {cutoff}};
    texture.texture_from_world = xform_identity();
    return scene_add_texture(document->builder, &texture);
}
