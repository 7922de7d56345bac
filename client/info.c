/* info: `lightmill info`: what is in an OpenEXR image, a scene blob or a scene file, and the hash of it. */
#include "client/commands.h"
#include "client/scene.h"
#include "client/text.h"
#include "common/image.h"

#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

static const char help[] =
    "Usage: lightmill info FILE [--hash | --json]\n"
    "\n"
    "Describes FILE, which may be\n"
    "  an OpenEXR image: size, channels with their range, attributes\n"
    "  a scene (.pbrt, or a folder with a scene.pbrt) or a scene blob: counts, camera, materials, lights\n"
    "\n"
    "Options:\n"
    "  --hash  print only a hash: of an image's pixels alone, whatever its attributes and compression; of a\n"
    "          scene, the name of its blob\n"
    "  --json  print one JSON object instead of text\n"
    "  --help  print this\n";

typedef struct {
    const char *path;
    bool hash, json, help;
} options_t;

static result_t parse_options(int argc, char **argv, options_t *options)
{
    static const struct option long_options[] = {{"hash", no_argument, NULL, 'H'},
                                                 {"json", no_argument, NULL, 'j'},
                                                 {"help", no_argument, NULL, 'h'},
                                                 {NULL, 0, NULL, 0}};
    optind = 0; /* getopt starts anew */
    opterr = 0;
    int option;
    while ((option = getopt_long(argc, argv, "h", long_options, NULL)) != -1) {
        if (option == 'H')
            options->hash = true;
        else if (option == 'j')
            options->json = true;
        else if (option == 'h')
            options->help = true;
        else
            return result_fail(RESULT_USAGE, "unknown option %.100s; see lightmill info --help",
                               argv[optind - 1]);
    }
    if (options->help) return result_ok();
    if (options->hash && options->json) return result_fail(RESULT_USAGE, "give --hash or --json, not both");
    if (argc - optind != 1) return result_fail(RESULT_USAGE, "expected one FILE; see lightmill info --help");
    options->path = argv[optind];
    return result_ok();
}

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
        text_print(image->attributes[i].text);
        putchar('\n');
    }
}

static void print_channel_json(const image_t *image, const image_channel_t *channel)
{
    range_t range = channel_range(image, channel);
    fputs("{\"name\": ", stdout);
    text_print_json(channel->name);
    printf(", \"type\": \"%s\", \"min\": ", pixel_type_name(channel->type));
    text_print_json_number(range.least);
    fputs(", \"max\": ", stdout);
    text_print_json_number(range.most);
    fputs(", \"mean\": ", stdout);
    text_print_json_number(range.mean);
    printf(", \"not_finite\": %zu}", range.not_finite);
}

static void print_attribute_json(const image_attribute_t *attribute)
{
    text_print_json(attribute->name);
    fputs(": ", stdout);
    if (attribute->kind == ATTRIBUTE_INT)
        printf("%d", attribute->integer);
    else if (attribute->kind == ATTRIBUTE_FLOAT)
        text_print_json_number((double)attribute->real);
    else
        text_print_json(attribute->text);
}

static void print_image_json(const image_t *image)
{
    hash_t hash = image_hash(image);
    printf("{\"kind\": \"image\", \"width\": %d, \"height\": %d, ", image->width, image->height);
    print_hash("\"hash\": \"", &hash, "\", \"channels\": [");
    for (size_t i = 0; i < image->channel_count; i++) {
        if (i > 0) fputs(", ", stdout);
        print_channel_json(image, &image->channels[i]);
    }
    fputs("], \"attributes\": {", stdout);
    for (size_t i = 0; i < image->attribute_count; i++) {
        if (i > 0) fputs(", ", stdout);
        print_attribute_json(&image->attributes[i]);
    }
    puts("}}");
}

static result_t info_image(const options_t *options)
{
    image_t image;
    TRY(image_read_exr(options->path, &image));
    if (options->hash) {
        hash_t hash = image_hash(&image);
        print_hash("", &hash, "\n");
    } else if (options->json) {
        print_image_json(&image);
    } else {
        print_image(options->path, &image);
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
               {BLOB_SECTION_SPHERES, "spheres"},     {BLOB_SECTION_MATERIALS, "materials"},
               {BLOB_SECTION_LIGHTS, "lights"}};

static const char *material_kind_name(uint32_t kind)
{
    static const char *const names[] = {[MATERIAL_DIFFUSE] = "diffuse",
                                        [MATERIAL_MIRROR] = "mirror",
                                        [MATERIAL_DIELECTRIC] = "dielectric",
                                        [MATERIAL_CONDUCTOR] = "conductor"};
    return kind < ARRAY_LENGTH(names) && names[kind] != NULL ? names[kind] : "unknown";
}

static const char *filter_name(uint32_t kind)
{
    return kind == FILTER_BOX ? "box" : kind == FILTER_TRIANGLE ? "triangle" : "gaussian";
}

static void print_rgb(const char *name, rgb_t value)
{
    /* Adding 0 makes -0 a 0. */
    printf("  %s %g %g %g", name, (double)value.x + 0.0, (double)value.y + 0.0, (double)value.z + 0.0);
}

static void print_material(const scene_blob_t *blob, size_t index)
{
    const blob_material_t *m = &blob->materials[index];
    printf("material %zu: %-10s", index, material_kind_name(m->kind));
    if (m->kind != MATERIAL_CONDUCTOR) print_rgb("reflectance", m->reflectance);
    if (m->kind == MATERIAL_DIELECTRIC) print_rgb("transmittance", m->transmittance);
    if (m->kind == MATERIAL_DIELECTRIC) printf("  eta %g", (double)m->eta.x);
    if (m->kind == MATERIAL_CONDUCTOR) {
        print_rgb("eta", m->eta);
        print_rgb("k", m->k);
        printf("  alpha %g %g", (double)m->alpha_u, (double)m->alpha_v);
    }
    if (m->name != 0) {
        fputs("  ", stdout);
        text_print(blob->strings + m->name);
    }
    putchar('\n');
}

static void print_light(const scene_blob_t *blob, size_t index)
{
    const blob_light_t *light = &blob->lights[index];
    printf("light %zu: diffuse area", index);
    print_rgb("radiance", light->radiance);
    printf("%s  ", (light->flags & LIGHT_TWO_SIDED) != 0 ? "  two-sided" : "");
    text_print(blob->strings + blob->shapes[light->shape].name);
    putchar('\n');
}

static void print_camera(const blob_scene_t *scene)
{
    const float(*m)[4] = scene->world_from_camera.m;
    printf("camera: perspective, fov %g degrees", (double)scene->fov);
    print_rgb("at", vec3(m[0][3], m[1][3], m[2][3]));
    print_rgb("looks along", v_normalize(vec3(m[0][2], m[1][2], m[2][2])));
    printf("\nfilter: %s, radius %g x %g pixels\n", filter_name(scene->filter.kind),
           (double)scene->filter.radius_x, (double)scene->filter.radius_y);
}

/* Names over this many of a kind are left out of the text. */
enum { LISTED = 50 };

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
    for (size_t i = 0; i < blob->counts[BLOB_SECTION_MATERIALS] && i < LISTED; i++) print_material(blob, i);
    for (size_t i = 0; i < blob->counts[BLOB_SECTION_LIGHTS] && i < LISTED; i++) print_light(blob, i);
}

static void print_scene_json(const scene_blob_t *blob)
{
    job_settings_t settings = blob_default_settings(blob);
    print_hash("{\"kind\": \"scene\", \"hash\": \"", &blob->hash, "\"");
    printf(", \"bytes\": %llu", (unsigned long long)blob->size);
    for (size_t i = 0; i < ARRAY_LENGTH(counted); i++)
        printf(", \"%s\": %llu", counted[i].name, (unsigned long long)blob->counts[counted[i].section]);
    printf(", \"width\": %d, \"height\": %d, \"spp\": %u, \"max_depth\": %d", settings.width, settings.height,
           settings.spp, settings.max_depth);
    printf(", \"integrator\": \"%s\", \"sampler\": \"%s\", \"fov\": %.9g, \"material_kinds\": [",
           integrator_name(settings.integrator), sampler_name(settings.sampler), (double)blob->scene->fov);
    for (size_t i = 0; i < blob->counts[BLOB_SECTION_MATERIALS]; i++)
        printf("%s\"%s\"", i > 0 ? ", " : "", material_kind_name(blob->materials[i].kind));
    puts("]}");
}

static result_t info_scene(const options_t *options)
{
    scene_t scene;
    TRY(scene_load(options->path, &scene));
    if (options->hash)
        print_hash("", &scene.blob.hash, "\n");
    else if (options->json)
        print_scene_json(&scene.blob);
    else
        print_scene(options->path, &scene.blob);
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

result_t cmd_info(int argc, char **argv)
{
    options_t options = {0};
    bool is_exr = false;
    TRY(parse_options(argc, argv, &options));
    if (options.help) {
        fputs(help, stdout);
        return result_ok();
    }
    TRY(recognise_exr(options.path, &is_exr));
    return is_exr ? info_image(&options) : info_scene(&options);
}
