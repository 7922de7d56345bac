/* file: the container: .glb chunks, JSON, buffers, URIs (the glTF 2.0 specification, sections 3.6 and 4). */
#include "client/import/gltf/document.h"

#include "client/import/files/lines.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { GLB_HEADER = 12, CHUNK_HEADER = 8 };
static const uint32_t glb_magic = 0x46546C67, chunk_json = 0x4E4F534A, chunk_binary = 0x004E4942;
static const size_t largest_file = (size_t)1 << 36;
static const uint64_t largest_offset = (uint64_t)1 << 40;

static const char *const top_names[TOP_COUNT] = {
    [TOP_ACCESSORS] = "accessors", [TOP_ANIMATIONS] = "animations", [TOP_BUFFER_VIEWS] = "bufferViews",
    [TOP_BUFFERS] = "buffers",     [TOP_CAMERAS] = "cameras",       [TOP_IMAGES] = "images",
    [TOP_MATERIALS] = "materials", [TOP_MESHES] = "meshes",         [TOP_NODES] = "nodes",
    [TOP_SAMPLERS] = "samplers",   [TOP_SCENES] = "scenes",         [TOP_SKINS] = "skins",
    [TOP_TEXTURES] = "textures",
};

/* What is known of an extension. */
static const struct {
    const char *name;
    bool done;        /* by this importer */
    const char *cure; /* what to say when it is not; NULL: that it is ignored */
} extensions[] = {
    {"CESIUM_RTC", true, NULL},            /* where on the globe all of it stands: nothing looks different */
    {"KHR_animation_pointer", true, NULL}, /* with a warning at each channel */
    {"KHR_lights_punctual", true, NULL},
    {"KHR_materials_anisotropy", true, NULL},
    {"KHR_materials_clearcoat", true, NULL},
    {"KHR_materials_diffuse_transmission", true, NULL},
    {"KHR_materials_dispersion", true, NULL},
    {"KHR_materials_emissive_strength", true, NULL},
    {"KHR_materials_ior", true, NULL},
    {"KHR_materials_iridescence", true, NULL},
    {"KHR_materials_pbrSpecularGlossiness", true, NULL},
    {"KHR_materials_sheen", true, NULL},
    {"KHR_materials_specular", true, NULL},
    {"KHR_materials_transmission", true, NULL},
    {"KHR_materials_unlit", true, NULL},
    {"KHR_materials_variants", true, NULL},
    {"KHR_materials_volume", true, NULL},
    {"KHR_materials_volume_scatter", true, NULL},
    {"KHR_mesh_quantization", true, NULL},
    {"KHR_node_visibility", true, NULL},
    {"KHR_texture_transform", true, NULL},
    {"EXT_mesh_gpu_instancing", true, NULL},
    {"KHR_draco_mesh_compression", true, NULL},
    {"EXT_meshopt_compression", true, NULL},
    {"KHR_meshopt_compression", true, NULL},
    {"EXT_texture_webp", true, NULL},
    {"KHR_texture_basisu", false, "export textures as PNG, JPEG or WebP"},
    {"EXT_texture_avif", false, "export textures as PNG, JPEG or WebP"},
    {"EXT_lights_image_based", true, NULL},
    {"KHR_environment_map", false,
     "its cube maps are KTX2 files, which are not read: give the scene its surroundings with --environment"},
};

/* Of these, those without which only textures are missing. */
static const char *const texture_formats[] = {"KHR_texture_basisu", "EXT_texture_avif"};

/* ---- places -------------------------------------------------------------------------------------------- */

position_t document_at(document_t *document, const item_t *item)
{
    char name[PATH_ROOM];
    item_name(item, name, sizeof name);
    free(document->place);
    document->place = mem_printf("%s%s%s", document->path, *name ? ": " : "", name);
    return (position_t){document->place, 0, 0};
}

result_t document_charge(document_t *document, const item_t *item, uint64_t amount)
{
    return scene_charge(document->builder, SCENE_VERTICES, amount, document_at(document, item));
}

/* ---- opening ------------------------------------------------------------------------------------------- */

static uint32_t word_at(const uint8_t *data)
{
    uint32_t word;
    memcpy(&word, data, sizeof word);
    return word;
}

static result_t fail(const document_t *document, const char *text)
{
    return error_at((position_t){document->path, 0, 0}, "%s", text);
}

/* Whether a chunk of a known kind begins there. */
static bool chunk_begins(const document_t *document, size_t size, size_t at)
{
    if (size - at < CHUNK_HEADER) return false;
    uint32_t length = word_at(document->data + at), type = word_at(document->data + at + 4);
    return (type == chunk_json || type == chunk_binary) && length <= size - at - CHUNK_HEADER;
}

/* The next chunk of a .glb that ends at `size`; false when it does not fit. A chunk's length is to be a
 * multiple of 4. Where it is not, the bytes that were to fill it up may be missing or not counted. */
static bool next_chunk(const document_t *document, size_t size, size_t *at, uint32_t *type, bytes_t *chunk)
{
    if (size - *at < CHUNK_HEADER) return false;
    const uint8_t *header = document->data + *at;
    chunk->size = word_at(header);
    *type = word_at(header + 4);
    *at += CHUNK_HEADER;
    if (chunk->size > size - *at) return false;
    chunk->data = document->data + *at;
    *at += chunk->size;
    if (chunk->size % 4 != 0)
        report_warning(document->builder->report, (position_t){document->path, 0, 0},
                       "a chunk of %zu bytes is not filled up to a multiple of 4; it is taken as it is",
                       chunk->size);
    if (chunk_begins(document, size, *at)) return true;
    while (*at % 4 != 0 && *at < size) ++*at;
    return true;
}

/* Finds the JSON, and the binary chunk of a .glb. A .glb is known by its first bytes. */
static result_t split(document_t *document, bytes_t *json)
{
    *json = (bytes_t){document->data, document->size};
    if (document->size < 4 || word_at(document->data) != glb_magic) return result_ok();
    if (document->size < GLB_HEADER) return fail(document, "is cut short; copy or export it again");
    uint32_t version = word_at(document->data + 4);
    if (version != 2)
        return error_at((position_t){document->path, 0, 0},
                        "is not glTF 2.0 but %" PRIu32 ".0; export it as glTF 2.0", version);
    size_t size = word_at(document->data + 8), at = GLB_HEADER;
    if (size > document->size || size < GLB_HEADER)
        return fail(document, "is cut short: it is smaller than its header says; copy or export it again");
    uint32_t type;
    if (!next_chunk(document, size, &at, &type, json) || type != chunk_json)
        return fail(document, "its first chunk is not JSON, or is cut short");
    while (at < size) {
        bytes_t chunk;
        if (!next_chunk(document, size, &at, &type, &chunk)) return fail(document, "a chunk is cut short");
        if (type == chunk_binary && !document->binary.data) document->binary = chunk;
    }
    return result_ok();
}

static result_t parse(document_t *document, bytes_t text)
{
    json_error_t error;
    const char *begin = (const char *)text.data;
    size_t mark = byte_order_mark(begin, text.size);
    document->json = json_loadb(begin + mark, text.size - mark, 0, &error);
    if (!document->json)
        return error_at((position_t){document->path, error.line > 0 ? (uint32_t)error.line : 1,
                                     error.column > 0 ? (uint32_t)error.column : 0},
                        "not JSON: %s", error.text);
    document->root =
        (item_t){.path = document->path, .report = document->builder->report, .json = document->json};
    if (!json_is_object(document->json)) return item_fail(&document->root, "must hold a JSON object");
    return result_ok();
}

static result_t find_tops(document_t *document)
{
    for (int i = 0; i < TOP_COUNT; ++i)
        TRY(item_member(&document->root, top_names[i], JSON_ARRAY, &document->tops[i]));
    for (int i = 0; i < TOP_COUNT; ++i)
        if (item_count(&document->tops[i]) >= ITEM_NONE - 1)
            return item_fail(&document->tops[i], "has too many elements");
    return result_ok();
}

/* In glTF 1.0 things have names, not numbers, and the file need not tell its version. */
static bool looks_like_version_1(const document_t *document)
{
    for (int i = 0; i < TOP_COUNT; ++i)
        if (json_is_object(json_object_get(document->json, top_names[i]))) return true;
    return false;
}

/* The exporter's version is that of Blender, from 3.2 on; before, it is lower than any of these. */
static void recognise_blender(document_t *document, const char *generator)
{
    static const char mark[] = "Khronos glTF Blender I/O";
    const char *found = strstr(generator, mark);
    unsigned major = 0, minor = 0;
    document->blender = found != NULL;
    if (!found) return;
    bool said = sscanf(found + sizeof mark - 1, " v%3u.%2u", &major, &minor) == 2;
    document->blender_version = said ? 100 * major + minor : UINT32_MAX;
}

static result_t check_version(document_t *document)
{
    item_t asset;
    TRY(item_member(&document->root, "asset", JSON_OBJECT, &asset));
    const char *version = NULL, *least = NULL, *generator = "";
    TRY(item_string(&asset, "version", &version));
    TRY(item_string(&asset, "minVersion", &least));
    TRY(item_string(&asset, "generator", &generator));
    if (!version && looks_like_version_1(document)) version = "1.0";
    if (!version) return item_fail(&document->root, "has no asset.version: not a glTF file");
    if (strncmp(version, "2.", 2) != 0 || (least && strcmp(least, "2.0") != 0))
        return item_fail(&document->root, "is not glTF 2.0 but %.20s; export it as glTF 2.0",
                         least ? least : version);
    recognise_blender(document, generator);
    return result_ok();
}

/* One that is not done: an error when the file requires it. */
static result_t tell_extension(const item_t *item, const char *name, const char *cure, bool required)
{
    const char *substitute = "it is ignored";
    for (size_t i = 0; i < ARRAY_LENGTH(texture_formats); ++i)
        if (strcmp(name, texture_formats[i]) == 0) substitute = "its textures are left out";
    if (!required) {
        item_warn(item, "%.80s is ignored%s%s", name, cure ? "; " : "", cure ? cure : "");
        return result_ok();
    }
    result_t failure = item_fail(item, "the file cannot be read without %.80s, which is not supported; %s",
                                 name, cure ? cure : "export without it");
    return report_excuse(item->report, failure, substitute);
}

static result_t check_extensions(document_t *document, const char *list, bool required)
{
    item_t names, item;
    TRY(item_member(&document->root, list, JSON_ARRAY, &names));
    for (size_t i = 0; i < item_count(&names); ++i) {
        TRY(item_element(&names, i, JSON_STRING, &item));
        const char *name = json_string_value(item.json);
        size_t k = 0;
        while (k < ARRAY_LENGTH(extensions) && strcmp(name, extensions[k].name) != 0) ++k;
        bool known = k < ARRAY_LENGTH(extensions);
        if (required && strcmp(name, "KHR_meshopt_compression") == 0) document->needs_meshopt = true;
        if (known && extensions[k].done) continue;
        TRY(tell_extension(&item, name, known ? extensions[k].cure : NULL, required));
    }
    return result_ok();
}

result_t document_open(document_t *document, const char *path, scene_builder_t *builder)
{
    *document = (document_t){.path = path, .builder = builder};
    const char *slash = strrchr(path, '/');
    document->folder = mem_printf("%.*s", slash ? (int)(slash + 1 - path) : 0, path);
    TRY(file_read(path, largest_file, &document->data, &document->size));
    builder->source_bytes += document->size;
    bytes_t text;
    TRY(split(document, &text));
    TRY(parse(document, text));
    TRY(check_version(document));
    TRY(find_tops(document));
    TRY(check_extensions(document, "extensionsRequired", true));
    TRY(check_extensions(document, "extensionsUsed", false));
    document->buffers = mem_zalloc(document_count(document, TOP_BUFFERS) + 1, sizeof *document->buffers);
    document->unpacked =
        mem_zalloc(document_count(document, TOP_BUFFER_VIEWS) + 1, sizeof *document->unpacked);
    for (int i = 0; i < 2; ++i)
        document->materials[i] =
            mem_zalloc(document_count(document, TOP_MATERIALS) + 1, sizeof *document->materials[i]);
    document->pose_count = 1;
    document->pose = document->poses;
    return result_ok();
}

static void close_pose(pose_t *pose, size_t skins)
{
    free(pose->meshes.items);
    free(pose->cameras.items);
    free(pose->lights.items);
    free(pose->visits);
    free(pose->worlds);
    for (size_t i = 0; pose->skins && i < skins; ++i) free(pose->skins[i].joints);
    free(pose->skins);
}

void document_close(document_t *document)
{
    free(document->folder);
    free(document->data);
    for (size_t i = 0; document->unpacked && i < document_count(document, TOP_BUFFER_VIEWS); ++i)
        free((void *)(uintptr_t)document->unpacked[i].data);
    free(document->unpacked);
    free(document->buffers);
    for (size_t i = 0; i < document->source_count; ++i) {
        free(document->sources[i].path);
        free(document->sources[i].data);
    }
    free(document->sources);
    for (int i = 0; i < 2; ++i) free(document->materials[i]);
    animation_close(document);
    for (size_t i = 0; i < document->pose_count; ++i)
        close_pose(&document->poses[i], document_count(document, TOP_SKINS));
    free(document->place);
    free(document->marks);
    json_decref(document->json);
    *document = (document_t){0};
}

result_t document_item(const document_t *document, top_t which, uint32_t index, item_t *out)
{
    return item_element(&document->tops[which], index, JSON_OBJECT, out);
}

size_t document_count(const document_t *document, top_t which)
{
    return item_count(&document->tops[which]);
}

bool document_is_named(const document_t *document, top_t which, uint32_t index, const char *name)
{
    const json_t *element = json_array_get(document->tops[which].json, index);
    const char *own = json_string_value(json_object_get(element, "name"));
    return own && strcmp(own, name) == 0;
}

/* ---- URIs ---------------------------------------------------------------------------------------------- */

static int hex_digit(char c)
{
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* Undoes %XX (RFC 3986, 2.1) in place. False when a digit is missing or a byte is 0. */
static bool decode_percent(char *text)
{
    char *to = text;
    for (const char *from = text; *from; ++from) {
        *to = *from;
        if (*from == '%') {
            int high = hex_digit(from[1]), low = high < 0 ? -1 : hex_digit(from[2]);
            if (low < 0 || high + low == 0) return false;
            *to = (char)(16 * high + low);
            from += 2;
        }
        ++to;
    }
    *to = '\0';
    return true;
}

static int base64_digit(char c)
{
    if (c >= 'A' && c <= 'Z') return c - 'A';
    if (c >= 'a' && c <= 'z') return c - 'a' + 26;
    if (c >= '0' && c <= '9') return c - '0' + 52;
    return c == '+' ? 62 : c == '/' ? 63 : -1;
}

/* Base64 (RFC 4648, 4), the padding of the last group may be missing. False when it is malformed. */
static bool decode_base64(const char *text, uint8_t *out, size_t *size)
{
    size_t length = strlen(text), used = 0;
    while (length > 0 && text[length - 1] == '=' && length % 4 != 1) --length;
    if (length % 4 == 1) return false;
    uint32_t bits = 0;
    for (size_t i = 0; i < length; ++i) {
        int digit = base64_digit(text[i]);
        if (digit < 0) return false;
        bits = (bits << 6) | (uint32_t)digit;
        if (i % 4 != 0) out[used++] = (uint8_t)(bits >> (6 - 2 * (i % 4)));
    }
    *size = used;
    return true;
}

static void keep(document_t *document, gltf_source_t source, bytes_t *bytes)
{
    document->sources = grow(document->sources, &document->source_capacity, document->source_count + 1,
                             sizeof *document->sources);
    document->sources[document->source_count++] = source;
    *bytes = (bytes_t){source.data, source.size};
}

static result_t read_data_uri(document_t *document, const item_t *owner, const char *uri, bytes_t *bytes)
{
    static const char mark[] = ";base64,";
    const char *comma = strchr(uri, ',');
    size_t before = comma ? (size_t)(comma + 1 - uri) : 0;
    if (before < sizeof mark - 1 || strncmp(comma + 2 - sizeof mark, mark, sizeof mark - 1) != 0)
        return item_fail(owner, "its data URI must be base64: \"data:...;base64,...\"");
    gltf_source_t source = {.data = mem_alloc(strlen(comma) + 4)};
    if (!decode_base64(comma + 1, source.data, &source.size)) {
        free(source.data);
        return item_fail(owner, "the base64 of its data URI is malformed");
    }
    keep(document, source, bytes);
    return result_ok();
}

/* True when the URI begins with a scheme (RFC 3986, 3.1). */
static bool has_scheme(const char *uri)
{
    size_t length = strcspn(uri, ":/?#");
    return uri[length] == ':';
}

static result_t read_file_uri(document_t *document, const item_t *owner, char *path, bytes_t *bytes)
{
    for (size_t i = 0; i < document->source_count; ++i) {
        const gltf_source_t *known = &document->sources[i];
        if (!known->path || strcmp(known->path, path) != 0) continue;
        *bytes = (bytes_t){known->data, known->size};
        free(path);
        return result_ok();
    }
    gltf_source_t source = {.path = path};
    result_t result = file_read(path, largest_file, &source.data, &source.size);
    if (result.code != RESULT_OK) {
        free(path);
        return item_fail(owner, "%s", result.message);
    }
    document->builder->source_bytes += source.size;
    keep(document, source, bytes);
    return result_ok();
}

result_t document_uri(document_t *document, const item_t *owner, const char *uri, bytes_t *bytes,
                      char path[PATH_ROOM])
{
    snprintf(path, PATH_ROOM, "%s", strncmp(uri, "data:", 5) == 0 ? "data URI" : uri);
    if (strncmp(uri, "data:", 5) == 0) return read_data_uri(document, owner, uri, bytes);
    if (has_scheme(uri))
        return item_fail(owner, "its URI \"%.60s\" has a scheme; only data: and relative paths are read",
                         uri);
    char *relative = mem_strdup(uri);
    if (!decode_percent(relative) || !*relative) {
        free(relative);
        return item_fail(owner, "its URI \"%.60s\" is empty or malformed", uri);
    }
    char *full = relative[0] == '/' ? mem_strdup(relative) : mem_printf("%s%s", document->folder, relative);
    free(relative);
    return read_file_uri(document, owner, full, bytes);
}

/* ---- buffers ------------------------------------------------------------------------------------------- */

static result_t read_buffer(document_t *document, uint32_t index, bytes_t *bytes)
{
    item_t buffer;
    TRY(document_item(document, TOP_BUFFERS, index, &buffer));
    const char *uri = NULL;
    uint64_t length = 0;
    char path[PATH_ROOM];
    TRY(item_string(&buffer, "uri", &uri));
    TRY(item_whole(&buffer, "byteLength", largest_offset, &length));
    if (length == 0) return item_fail(&buffer, "needs a byteLength above 0");
    if (uri)
        TRY(document_uri(document, &buffer, uri, bytes, path));
    else if (index == 0 && document->binary.data)
        *bytes = document->binary;
    else
        return item_fail(&buffer, "has no uri, and is not the binary chunk of a .glb file");
    if (bytes->size < length)
        return item_fail(&buffer, "has %zu bytes, but byteLength says %" PRIu64 "; is the file cut short?",
                         bytes->size, length);
    bytes->size = length;
    return result_ok();
}

result_t document_range(document_t *document, const item_t *owner, bytes_t *bytes)
{
    uint32_t buffer = ITEM_NONE;
    uint64_t offset = 0, length = 0;
    TRY(item_index(owner, "buffer", document_count(document, TOP_BUFFERS), &buffer));
    TRY(item_whole(owner, "byteOffset", largest_offset, &offset));
    TRY(item_whole(owner, "byteLength", largest_offset, &length));
    if (buffer == ITEM_NONE) return item_fail(owner, "names no buffer");
    if (length == 0) return item_fail(owner, "needs a byteLength above 0");
    bytes_t *whole = &document->buffers[buffer];
    if (!whole->data) TRY(read_buffer(document, buffer, whole));
    if (offset > whole->size || length > whole->size - offset)
        return item_fail(owner, "reaches beyond its buffer of %zu bytes", whole->size);
    *bytes = (bytes_t){whole->data + offset, length};
    return result_ok();
}

result_t document_view(document_t *document, uint32_t index, bytes_t *bytes)
{
    item_t view, packed;
    TRY(document_item(document, TOP_BUFFER_VIEWS, index, &view));
    TRY(item_extension(&view, "EXT_meshopt_compression", &packed));
    if (!packed.json && document->needs_meshopt)
        TRY(item_extension(&view, "KHR_meshopt_compression", &packed));
    return packed.json ? unpack_view(document, index, &packed, bytes)
                       : document_range(document, &view, bytes);
}
