/* info: `lightmill info`: what is in an OpenEXR image, a scene blob or a scene file, and the hash of it. */
#include "client/commands/commands.h"
#include "client/scene/loaded_scene.h"
#include "client/scene/scene_options.h"
#include "common/image/image.h"
#include "common/text/json.h"
#include "common/text/text.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

typedef struct {
    import_wishes_t wishes;
    bool hash, json;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, hash, "hash", NULL,
           "print only a hash: of an image's pixels alone, whatever its attributes and compression; of a "
           "scene, the name of its blob"),
    OPTION(values_t, json, "json", NULL, "print one JSON object instead of text"),
};
static const option_group_t info_options = OPTION_GROUP(NULL, rows);

static void print_hash(const char *before, const hash_t *hash, const char *after)
{
    char text[2 * HASH_BYTES + 1];
    hash_to_hex(hash, text);
    printf("%s%s%s", before, text, after);
}

/* ---- images ---- */

/* Of the finite values of a channel. */
typedef struct {
    double least, most, mean;
    size_t not_finite;
} range_t;

static range_t channel_range(const image_t *image, const image_channel_t *channel)
{
    size_t pixels = (size_t)image->width * (size_t)image->height;
    range_t range = {.least = INFINITY, .most = -INFINITY};
    double sum = 0;
    for (size_t p = 0; p < pixels; p++) {
        double value = (double)channel->data[p * channel->stride];
        if (!isfinite(value)) {
            range.not_finite++;
            continue;
        }
        range.least = fmin(range.least, value);
        range.most = fmax(range.most, value);
        sum += value;
    }
    range.mean = sum / (double)(pixels - range.not_finite);
    return range;
}

static const char *pixel_type_name(pixel_type_t type)
{
    return type == PIXEL_HALF ? "half" : type == PIXEL_UINT ? "uint" : "float";
}

/* Of a Cryptomatte manifest, which may have very many names, how many there are; false for other attributes.
 */
static bool print_manifest(const image_attribute_t *attribute)
{
    const char *end = strrchr(attribute->name, '/');
    if (strncmp(attribute->name, "cryptomatte/", 12) != 0 || strcmp(end, "/manifest") != 0) return false;
    json_t *manifest = json_loads(attribute->text, 0, NULL);
    bool good = json_is_object(manifest);
    if (good) printf("%zu names; --json shows them", json_object_size(manifest));
    json_decref(manifest);
    return good;
}

static void print_image(const char *path, const image_t *image)
{
    hash_t hash = image_hash(image);
    text_print(path);
    printf(": OpenEXR image, %d x %d pixels, %zu channels\n", image->width, image->height,
           image->channel_count);
    print_hash("pixel hash ", &hash, "\n\n");
    printf("%-16s %-6s %13s %13s %13s\n", "channel", "type", "min", "max", "mean");
    for (size_t i = 0; i < image->channel_count; i++) {
        const image_channel_t *channel = &image->channels[i];
        range_t range = channel_range(image, channel);
        text_print(channel->name);
        for (size_t column = strlen(channel->name); column < 16; column++) putchar(' ');
        printf(" %-6s %13.6g %13.6g %13.6g", pixel_type_name(channel->type), range.least, range.most,
               range.mean);
        if (range.not_finite > 0) printf("  %zu not finite", range.not_finite);
        putchar('\n');
    }
    putchar('\n');
    for (size_t i = 0; i < image->attribute_count; i++) {
        text_print(image->attributes[i].name);
        fputs(": ", stdout);
        if (!print_manifest(&image->attributes[i])) text_print(image->attributes[i].text);
        putchar('\n');
    }
}

static json_t *channel_object(const image_t *image, const image_channel_t *channel)
{
    range_t range = channel_range(image, channel);
    json_t *object = json_object();
    put_text(object, "name", channel->name);
    put_text(object, "type", pixel_type_name(channel->type));
    put_real(object, "min", range.least);
    put_real(object, "max", range.most);
    put_real(object, "mean", range.mean);
    put_count(object, "not_finite", range.not_finite);
    return object;
}

static json_t *attribute_value(const image_attribute_t *attribute)
{
    if (attribute->kind == ATTRIBUTE_INT) return json_integer(attribute->integer);
    if (attribute->kind == ATTRIBUTE_FLOAT) return json_number((double)attribute->real);
    return json_text(attribute->text);
}

static void print_image_json(const image_t *image)
{
    hash_t hash = image_hash(image);
    json_t *root = json_object(), *channels = json_array(), *attributes = json_object();
    put_text(root, "kind", "image");
    put_count(root, "width", (uint64_t)image->width);
    put_count(root, "height", (uint64_t)image->height);
    put_hash(root, "hash", &hash);
    for (size_t i = 0; i < image->channel_count; i++)
        json_array_append_new(channels, channel_object(image, &image->channels[i]));
    json_object_set_new(root, "channels", channels);
    for (size_t i = 0; i < image->attribute_count; i++)
        json_object_set_new(attributes, image->attributes[i].name, attribute_value(&image->attributes[i]));
    json_object_set_new(root, "attributes", attributes);
    json_print(root, 0, 9);
}

static result_t info_image(const char *path, const values_t *values)
{
    image_t image;
    TRY(image_read_exr(path, &image));
    if (values->hash) {
        hash_t hash = image_hash(&image);
        print_hash("", &hash, "\n");
    } else if (values->json) {
        print_image_json(&image);
    } else {
        print_image(path, &image);
    }
    image_free(&image);
    return result_ok();
}

/* ---- scenes ---- */

static const struct {
    blob_section_t section;
    const char *name;
} counted[] = {{BLOB_SECTION_OBJECTS, "objects"},     {BLOB_SECTION_INSTANCES, "instances"},
               {BLOB_SECTION_SHAPES, "shapes"},       {BLOB_SECTION_MESHES, "meshes"},
               {BLOB_SECTION_TRIANGLES, "triangles"}, {BLOB_SECTION_POSITIONS, "vertices"},
               {BLOB_SECTION_QUADRICS, "quadrics"},   {BLOB_SECTION_CURVES, "curves"},
               {BLOB_SECTION_MATERIALS, "materials"}, {BLOB_SECTION_TEXTURES, "textures"},
               {BLOB_SECTION_IMAGES, "images"},       {BLOB_SECTION_LIGHTS, "lights"},
               {BLOB_SECTION_MEDIA, "media"}};

/* The name of an enumerator, from a table that is indexed by it. */
static const char *name_in(const char *const *names, size_t count, uint32_t kind)
{
    return kind < count && names[kind] != NULL ? names[kind] : "unknown";
}

#define NAME_IN(names, kind) name_in(names, ARRAY_LENGTH(names), kind)

static const char *const material_kinds[] = {[MATERIAL_DIFFUSE] = "diffuse",
                                             [MATERIAL_MIRROR] = "mirror",
                                             [MATERIAL_DIELECTRIC] = "dielectric",
                                             [MATERIAL_CONDUCTOR] = "conductor",
                                             [MATERIAL_PLASTIC] = "plastic",
                                             [MATERIAL_UBER] = "uber",
                                             [MATERIAL_SUBSTRATE] = "substrate",
                                             [MATERIAL_TRANSLUCENT] = "translucent",
                                             [MATERIAL_MIX] = "mix",
                                             [MATERIAL_DISNEY] = "disney",
                                             [MATERIAL_COATED_DIFFUSE] = "coated diffuse",
                                             [MATERIAL_COATED_CONDUCTOR] = "coated conductor",
                                             [MATERIAL_DIFFUSE_TRANSMISSION] = "diffuse transmission",
                                             [MATERIAL_GLTF] = "gltf",
                                             [MATERIAL_FOURIER] = "fourier",
                                             [MATERIAL_MEASURED] = "measured",
                                             [MATERIAL_PHONG] = "phong",
                                             [MATERIAL_WARD] = "ward",
                                             [MATERIAL_WARD_DUER] = "ward-duer",
                                             [MATERIAL_WARD_BALANCED] = "balanced ward",
                                             [MATERIAL_INTERFACE] = "interface",
                                             [MATERIAL_HAIR] = "hair"};

static const char *const texture_kinds[] = {[TEXTURE_IMAGE] = "image",
                                            [TEXTURE_SCALE] = "scale",
                                            [TEXTURE_MIX] = "mix",
                                            [TEXTURE_DIRECTION_MIX] = "direction mix",
                                            [TEXTURE_BILERP] = "bilerp",
                                            [TEXTURE_UV] = "uv",
                                            [TEXTURE_CHECKERBOARD] = "checkerboard",
                                            [TEXTURE_DOTS] = "dots",
                                            [TEXTURE_FBM] = "fbm",
                                            [TEXTURE_WRINKLED] = "wrinkled",
                                            [TEXTURE_WINDY] = "windy",
                                            [TEXTURE_MARBLE] = "marble",
                                            [TEXTURE_CHANNEL] = "channel",
                                            [TEXTURE_THRESHOLD] = "threshold",
                                            [TEXTURE_COLOUR] = "mesh colour"};

static const char *const mappings[] = {"",          "uv",          "second uv", "planar",
                                       "spherical", "cylindrical", "point",     "cylindrical"};

static const char *const texel_formats[] = {[TEXELS_R8] = "grey, 8 bits",
                                            [TEXELS_RGBA8] = "RGBA, 8 bits",
                                            [TEXELS_R32F] = "grey, float",
                                            [TEXELS_RGB32F] = "RGB, float"};

static const char *const filters[] = {[FILTER_BOX] = "box",
                                      [FILTER_TRIANGLE] = "triangle",
                                      [FILTER_GAUSSIAN] = "gaussian",
                                      [FILTER_MITCHELL] = "mitchell",
                                      [FILTER_SINC] = "sinc"};

static const char *const cameras[] = {[CAMERA_PERSPECTIVE] = "perspective",
                                      [CAMERA_ORTHOGRAPHIC] = "orthographic",
                                      [CAMERA_SPHERICAL] = "spherical",
                                      [CAMERA_EQUAL_AREA] = "equal-area sphere",
                                      [CAMERA_REALISTIC] = "realistic"};

/* A material's values in the order of their slots; those with one number are not colours. */
static const struct {
    const char *name;
    bool number;
} material_values[MATERIAL_VALUES] = {
    [VALUE_REFLECTANCE] = {"reflectance", false},
    [VALUE_TRANSMITTANCE] = {"transmittance", false},
    [VALUE_SPECULAR] = {"specular", false},
    [VALUE_MIRROR] = {"mirror", false},
    [VALUE_REFLECT] = {"reflect", false},
    [VALUE_TRANSMIT] = {"transmit", false},
    [VALUE_OPACITY] = {"opacity", false},
    [VALUE_AMOUNT] = {"amount", false},
    [VALUE_SIGMA] = {"sigma", true},
    [VALUE_ROUGHNESS_U] = {"roughness u", true},
    [VALUE_ROUGHNESS_V] = {"v", true},
    [VALUE_ETA] = {"eta", false},
    [VALUE_K] = {"k", false},
    [VALUE_BASE_ROUGHNESS_U] = {"base roughness u", true},
    [VALUE_BASE_ROUGHNESS_V] = {"v", true},
    [VALUE_BASE_ETA] = {"base eta", false},
    [VALUE_THICKNESS] = {"thickness", true},
    [VALUE_ALBEDO] = {"albedo", false},
    [VALUE_G] = {"g", true},
    [VALUE_METALLIC] = {"metallic", true},
    [VALUE_SPECULAR_TINT] = {"specular tint", true},
    [VALUE_ANISOTROPIC] = {"anisotropic", true},
    [VALUE_SHEEN] = {"sheen", true},
    [VALUE_SHEEN_TINT] = {"sheen tint", true},
    [VALUE_CLEARCOAT] = {"clearcoat", true},
    [VALUE_CLEARCOAT_GLOSS] = {"clearcoat gloss", true},
    [VALUE_CLEARCOAT_ROUGHNESS] = {"clearcoat roughness", true},
    [VALUE_SPECULAR_COLOUR] = {"specular colour", false},
    [VALUE_TRANSMISSION] = {"transmission", true},
    [VALUE_FLATNESS] = {"flatness", true},
    [VALUE_DIFFUSE_TRANSMISSION] = {"diffuse transmission", true},
    [VALUE_ATTENUATION] = {"attenuation", false},
    [VALUE_SHEEN_COLOUR] = {"sheen colour", false},
    [VALUE_SHEEN_ROUGHNESS] = {"sheen roughness", true},
    [VALUE_IRIDESCENCE] = {"iridescence", true},
    [VALUE_IRIDESCENCE_ETA] = {"film eta", true},
    [VALUE_IRIDESCENCE_THICKNESS] = {"film nm", true},
    [VALUE_DISPERSION] = {"dispersion", true},
    [VALUE_ANISOTROPY_DIRECTION] = {"anisotropy direction", false},
    [VALUE_ANISOTROPY_TURN] = {"turned by", false},
    [VALUE_EXPONENT] = {"exponent", true},
    [VALUE_EUMELANIN] = {"eumelanin", true},
    [VALUE_PHEOMELANIN] = {"pheomelanin", true},
    [VALUE_TILT] = {"tilt", true},
};

static void print_rgb(const char *name, rgb_t value)
{
    /* Adding 0 makes -0 a 0. */
    printf("  %s %g %g %g", name, (double)value.x + 0.0, (double)value.y + 0.0, (double)value.z + 0.0);
}

static void print_value(const char *name, const blob_value_t *value, bool number)
{
    if (number)
        printf("  %s %g", name, (double)value->factor.x + 0.0);
    else
        print_rgb(name, value->factor);
    if (value->texture != 0) printf(" x texture %u", value->texture - 1);
}

static void print_name(const scene_blob_t *blob, uint32_t name)
{
    if (name != 0) {
        fputs("  ", stdout);
        text_print(blob->strings + name);
    }
    putchar('\n');
}

/* The values that are not 0, since a kind reads few of them; a dielectric's eta is one number. */
static void print_material(const scene_blob_t *blob, size_t index)
{
    const blob_material_t *m = &blob->materials[index];
    printf("material %zu: %-10s", index, NAME_IN(material_kinds, m->kind));
    if (m->kind == MATERIAL_MIX) printf("  of %u and %u", m->parts[0], m->parts[1]);
    if ((m->flags & MATERIAL_THIN) != 0) fputs("  thin", stdout);
    for (int i = 0; i < MATERIAL_VALUES; i++) {
        const blob_value_t *value = &m->values[i];
        bool number = material_values[i].number || (i == VALUE_ETA && m->kind != MATERIAL_CONDUCTOR);
        if (value->texture != 0 || !v_is_zero(value->factor))
            print_value(material_values[i].name, value, number);
    }
    if (m->bump != 0) printf("  bumps of texture %u", m->bump - 1);
    if (m->normal_map != 0) printf("  normals of texture %u", m->normal_map - 1);
    if (m->coat_normal_map != 0) printf("  normals of the coat of texture %u", m->coat_normal_map - 1);
    print_name(blob, m->name);
}

static void print_texture(const scene_blob_t *blob, size_t index)
{
    const blob_texture_t *t = &blob->textures[index];
    printf("texture %zu: %s", index, NAME_IN(texture_kinds, t->kind));
    if (t->mapping != 0) printf("  over %s", NAME_IN(mappings, t->mapping));
    if (t->image != 0) printf("  image %u", t->image - 1);
    int last = TEXTURE_INPUTS;
    while (last > 0 && t->inputs[last - 1].texture == 0 && v_is_zero(t->inputs[last - 1].factor)) last--;
    for (int i = 0; i < last; i++) print_value("input", &t->inputs[i], false);
    putchar('\n');
}

static void print_image_record(const scene_blob_t *blob, size_t index)
{
    const blob_image_t *image = &blob->images[index];
    printf("image %zu: %u x %u pixels, %s", index, image->width, image->height,
           NAME_IN(texel_formats, image->format));
    if (image->gamma == 0)
        printf(", sRGB\n");
    else if (image->gamma == 1)
        printf(", linear\n");
    else
        printf(", gamma %g\n", (double)image->gamma);
}

/* What a medium's density, or its colours, lie in. */
static void print_field(const blob_field_t *field)
{
    const uint32_t *n = field->cells;
    if (field->kind == FIELD_CLOUD)
        printf("  a cloud");
    else if (field->kind == FIELD_BRICKS)
        printf("  in %u x %u x %u cells, %u bricks", n[0], n[1], n[2], field->brick_count);
    else
        printf("  in %u x %u x %u cells", n[0], n[1], n[2]);
}

static void print_medium(const scene_blob_t *blob, size_t index)
{
    const blob_medium_t *m = &blob->media[index];
    printf("medium %zu:", index);
    print_rgb("absorption", m->absorption);
    print_rgb("scattering", m->scattering);
    if (!v_is_zero(m->emission)) print_rgb("emission", m->emission);
    printf("  g %g", (double)m->g + 0.0);
    blob_ref_t box = m->density ? m->density : m->absorption_tint ? m->absorption_tint : m->scattering_tint;
    if (box != 0) print_field(&blob->fields[box - 1]);
    if (m->temperature != 0) printf("  glows by its temperature");
    print_name(blob, m->name);
}

static void print_light(const scene_blob_t *blob, size_t index)
{
    static const char *const units[] = {
        [LIGHT_AREA] = "radiance",         [LIGHT_POINT] = "intensity",      [LIGHT_SPOT] = "intensity",
        [LIGHT_GONIOMETRIC] = "intensity", [LIGHT_PROJECTION] = "intensity", [LIGHT_DISTANT] = "irradiance",
        [LIGHT_INFINITE] = "radiance"};
    const blob_light_t *light = &blob->lights[index];
    printf("light %zu: %s", index, NAME_IN(light_kind_names, light->kind));
    print_value(NAME_IN(units, light->kind), &light->radiance, false);
    if (light->image != 0) printf("  image %u", light->image - 1);
    if ((light->flags & LIGHT_TWO_SIDED) != 0) fputs("  two-sided", stdout);
    if ((light->flags & LIGHT_UNSEEN) != 0) fputs("  unseen", stdout);
    if ((light->flags & LIGHT_PICTURE) != 0) fputs("  a picture: only the camera sees it", stdout);
    if ((light->flags & LIGHT_PORTAL) != 0)
        printf("  through a portal of %g x %g", (double)v_length(light->portal[1]),
               (double)v_length(light->portal[2]));
    if (light->medium != 0) printf("  in medium %u", light->medium - 1);
    print_name(blob, light->kind == LIGHT_AREA ? blob->shapes[light->shape].name : 0);
}

static void print_camera(const blob_scene_t *scene)
{
    const float(*m)[4] = scene->world_from_camera.m;
    printf("camera: %s", NAME_IN(cameras, scene->camera));
    if (scene->camera == CAMERA_PERSPECTIVE) printf(", fov %g degrees", (double)scene->fov);
    if (scene->lens_radius > 0)
        printf(", lens of radius %g in focus at %g", (double)scene->lens_radius,
               (double)scene->focal_distance);
    if (scene->camera == CAMERA_REALISTIC)
        printf(", a lens of elements before a film of %g x %g",
               (double)(scene->screen_window[1] - scene->screen_window[0]),
               (double)(scene->screen_window[3] - scene->screen_window[2]));
    print_rgb("at", vec3(m[0][3], m[1][3], m[2][3]));
    print_rgb("looks along", v_normalize(vec3(m[0][2], m[1][2], m[2][2])));
    if (scene->medium != 0) printf("  in medium %u", scene->medium - 1);
    printf("\nfilter: %s, radius %g x %g pixels\n", NAME_IN(filters, scene->filter.kind),
           (double)scene->filter.radius_x, (double)scene->filter.radius_y);
}

/* Names over this many of a kind are left out of the text. */
enum { LISTED = 50 };

static const struct {
    blob_section_t section;
    void (*print)(const scene_blob_t *blob, size_t index);
} listed[] = {{BLOB_SECTION_MATERIALS, print_material},
              {BLOB_SECTION_TEXTURES, print_texture},
              {BLOB_SECTION_IMAGES, print_image_record},
              {BLOB_SECTION_LIGHTS, print_light},
              {BLOB_SECTION_MEDIA, print_medium}};

static void print_scene(const char *path, const scene_blob_t *blob)
{
    job_settings_t settings = blob_default_settings(blob);
    text_print(path);
    printf(": scene, %llu bytes as a blob\n", (unsigned long long)blob->size);
    print_hash("scene hash ", &blob->hash, "\n\n");
    for (size_t i = 0; i < ARRAY_LENGTH(counted); i++)
        printf("%-10s %llu\n", counted[i].name, (unsigned long long)blob->counts[counted[i].section]);
    printf("\nasks for: %d x %d pixels, %u samples a pixel, %s, %s sampler, maxdepth %d\n", settings.width,
           settings.height, settings.spp, integrator_name(settings.integrator),
           sampler_name(settings.sampler), settings.max_depth);
    print_camera(blob->scene);
    for (size_t i = 0; i < ARRAY_LENGTH(listed); i++)
        for (size_t k = 0; k < blob->counts[listed[i].section] && k < LISTED; k++) listed[i].print(blob, k);
}

static void print_scene_json(const scene_blob_t *blob)
{
    job_settings_t settings = blob_default_settings(blob);
    json_t *root = json_object(), *kinds = json_array();
    put_text(root, "kind", "scene");
    put_hash(root, "hash", &blob->hash);
    put_count(root, "bytes", blob->size);
    for (size_t i = 0; i < ARRAY_LENGTH(counted); i++)
        put_count(root, counted[i].name, blob->counts[counted[i].section]);
    put_count(root, "width", (uint64_t)settings.width);
    put_count(root, "height", (uint64_t)settings.height);
    put_count(root, "spp", settings.spp);
    put_count(root, "max_depth", (uint64_t)settings.max_depth);
    put_text(root, "integrator", integrator_name(settings.integrator));
    put_text(root, "sampler", sampler_name(settings.sampler));
    put_real(root, "fov", (double)blob->scene->fov);
    for (size_t i = 0; i < blob->counts[BLOB_SECTION_MATERIALS]; i++)
        json_array_append_new(kinds, json_text(NAME_IN(material_kinds, blob->materials[i].kind)));
    json_object_set_new(root, "material_kinds", kinds);
    json_print(root, 0, 9);
}

static result_t info_scene(const char *path, const values_t *values)
{
    loaded_scene_t scene;
    TRY(scene_load(path, &values->wishes, &scene));
    if (values->hash)
        print_hash("", &scene.blob.hash, "\n");
    else if (values->json)
        print_scene_json(&scene.blob);
    else
        print_scene(path, &scene.blob);
    scene_free(&scene);
    return result_ok();
}

/* ---- the command ---- */

/* Whether a file begins like OpenEXR; false also for a folder. */
static result_t recognise_exr(const char *path, bool *is_exr)
{
    static const uint8_t magic[4] = {0x76, 0x2f, 0x31, 0x01};
    uint8_t head[sizeof magic] = {0};
    struct stat about;
    *is_exr = false;
    if (stat(path, &about) != 0)
        return result_fail(RESULT_INPUT, "%s: cannot be opened: %s", path, strerror(errno));
    if (S_ISDIR(about.st_mode)) return result_ok();
    if (!S_ISREG(about.st_mode)) return result_fail(RESULT_INPUT, "%s: is not a regular file", path);
    FILE *file = fopen(path, "rb");
    if (file == NULL) return result_fail(RESULT_INPUT, "%s: cannot be opened: %s", path, strerror(errno));
    *is_exr = fread(head, sizeof head, 1, file) == 1 && memcmp(head, magic, sizeof magic) == 0;
    fclose(file);
    return result_ok();
}

static result_t run(const call_t *call)
{
    const values_t *values = call->values;
    bool is_exr = false;
    if (values->hash && values->json) return result_fail(RESULT_USAGE, "give --hash or --json, not both");
    TRY(recognise_exr(call->arguments[0], &is_exr));
    return (is_exr ? info_image : info_scene)(call->arguments[0], values);
}

const command_t info_command = {
    .name = "lightmill info",
    .arguments = "FILE",
    .summary = "describe a scene, a scene blob or an EXR",
    .about = "Describes FILE, which may be\n"
             "- an OpenEXR image: size, channels with their range, attributes\n"
             "- a scene (.pbrt, .gltf, .glb, .obj, .xml, or a folder with a scene.pbrt) or a scene blob: "
             "counts, camera, materials, textures, images, lights, media",
    .groups = {{&info_options, 0}, {&scene_options, offsetof(values_t, wishes)}},
    .size = sizeof(values_t),
    .begin = scene_options_begin, /* the first member */
    .run = run};
