/* texture: images, samplers and texture transforms become textures of the blob. */
#include "client/import/gltf/document.h"

#include <stdlib.h>
#include <string.h>

#include "common/image/texture_image.h"

/* ---- images -------------------------------------------------------------------------------------------- */

static result_t image_bytes(document_t *document, const item_t *image, bytes_t *bytes, char name[PATH_ROOM])
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

/* An 8-bit texel of any of the image's types. */
static uint8_t byte_at(const texture_image_t *image, size_t at)
{
    if (image->type == TEXELS_U8) return image->bytes[at];
    float value = float_clamp(image->floats[at], 0, 1);
    return (uint8_t)(value * 255.0f + 0.5f);
}

/* The words of the image in the blob's texels: R8 for one channel, else RGBA8. */
static void write_bytes(const texture_image_t *image, uint8_t *to)
{
    size_t pixels = (size_t)image->width * image->height, channels = image->channels;
    for (size_t i = 0; i < pixels; ++i) {
        size_t from = i * channels;
        if (channels == 1) {
            to[i] = byte_at(image, from);
            continue;
        }
        for (size_t k = 0; k < 3; ++k) to[4 * i + k] = byte_at(image, from + (channels == 2 ? 0 : k));
        to[4 * i + 3] = channels % 2 == 0 ? byte_at(image, from + channels - 1) : 255;
    }
}

/* Images of more than 8 bits without alpha, such as normal maps, keep their precision when they are linear.
 */
static bool is_deep(const texture_image_t *image)
{
    return image->type == TEXELS_FLOAT && image->channels % 2 == 1 && !image->encoded;
}

static void store_pixels(document_t *document, const texture_image_t *image, blob_image_t *record)
{
    size_t pixels = (size_t)image->width * image->height, size;
    if (is_deep(image)) {
        record->format = image->channels == 1 ? TEXELS_R32F : TEXELS_RGB32F;
        size = pixels * image->channels;
    } else {
        record->format = image->channels == 1 ? TEXELS_R8 : TEXELS_RGBA8;
        size = image->channels == 1 ? (pixels + 3) / 4 : pixels;
    }
    uint32_t before = blob_builder_count(document->builder, BLOB_SECTION_TEXELS);
    record->first_word = blob_builder_add(document->builder, BLOB_SECTION_TEXELS, NULL, (uint32_t)size);
    if (blob_builder_count(document->builder, BLOB_SECTION_TEXELS) == before)
        return; /* full: finish says so */
    uint32_t *words = (uint32_t *)blob_builder_records(document->builder, BLOB_SECTION_TEXELS) + before;
    if (is_deep(image))
        memcpy(words, image->floats, size * sizeof *words);
    else
        write_bytes(image, (uint8_t *)words);
}

static result_t load(document_t *document, uint32_t index, image_t *image)
{
    item_t item;
    bytes_t bytes;
    char name[PATH_ROOM];
    TRY(document_item(document, TOP_IMAGES, index, &item));
    TRY(image_bytes(document, &item, &bytes, name));
    texture_image_t pixels;
    result_t result = texture_image_decode(name, bytes.data, bytes.size, &pixels);
    if (result.code != RESULT_OK) return item_fail(&item, "%s", result.message);
    result = document_charge_pixels(document, &item, (uint64_t)pixels.width * pixels.height);
    if (result.code == RESULT_OK) {
        image->record = (blob_image_t){.width = pixels.width, .height = pixels.height};
        store_pixels(document, &pixels, &image->record);
    }
    texture_image_free(&pixels);
    return result;
}

/* The image as a record of the blob; floats are linear whatever the use. */
static result_t image_ref(document_t *document, uint32_t index, encoding_t encoding, blob_ref_t *ref)
{
    image_t *image = &document->images[index];
    if (image->record.format == 0) TRY(load(document, index, image));
    if (image->record.format > TEXELS_RGBA8) encoding = ENCODING_LINEAR;
    if (image->refs[encoding] == 0) {
        image->record.gamma = encoding == ENCODING_SRGB ? 0 : 1;
        image->refs[encoding] =
            1 + blob_builder_add(document->builder, BLOB_SECTION_IMAGES, &image->record, 1);
    }
    *ref = image->refs[encoding];
    return result_ok();
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

static blob_ref_t add(document_t *document, const blob_texture_t *texture)
{
    return 1 + blob_builder_add(document->builder, BLOB_SECTION_TEXTURES, texture, 1);
}

result_t texture_value(document_t *document, const item_t *owner, const char *key, encoding_t encoding,
                       channel_t channel, rgb_t factor, blob_value_t *value)
{
    *value = blob_colour_value(factor);
    item_t info, item;
    TRY(item_member(owner, key, JSON_OBJECT, &info));
    if (!info.json) return result_ok();
    uint32_t index = ITEM_NONE, source = ITEM_NONE;
    TRY(item_index(&info, "index", document_count(document, TOP_TEXTURES), &index));
    if (index == ITEM_NONE) return item_fail(&info, "names no texture");
    TRY(document_item(document, TOP_TEXTURES, index, &item));
    TRY(item_index(&item, "source", document_count(document, TOP_IMAGES), &source));
    if (source == ITEM_NONE)
        return item_fail(&item, "has no image that can be read; export textures as PNG or JPEG");
    blob_texture_t texture = {.kind = TEXTURE_IMAGE, .channel = channel, .inputs = {blob_constant(1)}};
    texture.texture_from_world = xform_identity();
    TRY(read_mapping(&info, &texture));
    TRY(read_sampler(document, &item, &texture));
    TRY(image_ref(document, source, encoding, &texture.image));
    value->texture = add(document, &texture);
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
    return (blob_value_t){vec3(1, 1, 1), add(document, &texture)};
}

blob_value_t texture_vertex_colour(document_t *document, channel_t channel)
{
    blob_texture_t texture = {.kind = TEXTURE_COLOUR, .channel = channel};
    texture.texture_from_world = xform_identity();
    return (blob_value_t){vec3(1, 1, 1), add(document, &texture)};
}

blob_value_t texture_threshold(document_t *document, blob_value_t value, float cutoff)
{
    if (value.texture == 0) return blob_constant(value.factor.x >= cutoff ? 1 : 0);
    blob_texture_t texture = {
        .kind = TEXTURE_THRESHOLD, .channel = CHANNEL_RGB, .inputs = {value}, .parameters = {cutoff}};
    texture.texture_from_world = xform_identity();
    return (blob_value_t){vec3(1, 1, 1), add(document, &texture)};
}
