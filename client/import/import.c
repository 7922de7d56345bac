/* import: the table of formats, and what is done to scenes of all of them. */
#include "client/import/import.h"

#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "client/import/environment/environment.h"
#include "client/import/gltf/gltf.h"
#include "client/import/mitsuba/mitsuba.h"
#include "client/import/obj/obj.h"
#include "client/import/pbrt/pbrt.h"
#include "client/import/scene/scene_view.h"

typedef struct {
    const char *extension;
    result_t (*import)(const char *path, scene_builder_t *scene);
    /* What its reader takes: which of several cameras, which variant and moment, and definitions. */
    bool cameras, looks, parameters;
} format_t;

static const format_t formats[] = {
    {.extension = ".pbrt", .import = pbrt_import},
    {.extension = ".gltf", .import = gltf_import, .cameras = true, .looks = true},
    {.extension = ".glb", .import = gltf_import, .cameras = true, .looks = true},
    {.extension = ".obj", .import = obj_import},
    {.extension = ".xml", .import = mitsuba_import, .cameras = true, .parameters = true},
};
static const format_t blobs = {.extension = ".blob"};

static const format_t *format_of(const char *path)
{
    const char *name = strrchr(path, '/');
    const char *dot = strrchr(name ? name : path, '.');
    for (size_t i = 0; dot && i < ARRAY_LENGTH(formats); ++i)
        if (strcasecmp(dot, formats[i].extension) == 0) return &formats[i];
    return NULL;
}

/* Refuses wishes that no reader would ever see. */
static result_t check_wishes(const import_wishes_t *wishes, const format_t *format)
{
    if (wishes->camera && !format->cameras)
        return result_fail(RESULT_USAGE,
                           "--camera is for files with several cameras (glTF, Mitsuba); this scene has one");
    if (wishes->variant && !format->looks)
        return result_fail(RESULT_USAGE,
                           "--variant is for files with several variants (glTF); this scene has none");
    if (wishes_have_moment(wishes) && !format->looks)
        return result_fail(
            RESULT_USAGE,
            "--time-point and --frame are for files with animations (glTF); this scene has none");
    if (wishes->definitions.count > 0 && !format->parameters)
        return result_fail(RESULT_USAGE,
                           "--define is for scenes of Mitsuba (.xml); this scene has no parameters");
    return result_ok();
}

static result_t read_format(const char *path, const import_wishes_t *wishes, scene_builder_t *scene)
{
    const format_t *format = format_of(path);
    if (!format)
        return result_fail(
            RESULT_INPUT,
            "%s: not a scene format that Lightmill reads; it reads .pbrt, .gltf, .glb, .obj and .xml", path);
    TRY(check_wishes(wishes, format));
    return format->import(path, scene);
}

/* The options that only say more about another. */
static bool adjusts_environment(const import_wishes_t *wishes)
{
    return wishes->environment_turn != 0 || wishes->environment_factor != 1 || wishes->environment_up;
}

static bool sets_frame_rate(const import_wishes_t *wishes)
{
    return wishes->frames_per_second != import_wishes_none().frames_per_second;
}

/* What cannot be asked for together, or means nothing alone. */
static result_t check_company(const import_wishes_t *wishes)
{
    if (adjusts_environment(wishes) && !wishes->environment)
        return result_fail(
            RESULT_USAGE,
            "--environment-rotation, --environment-strength and --environment-up need --environment");
    if (sets_frame_rate(wishes) && isnan(wishes->frame))
        return result_fail(RESULT_USAGE, "--frames-per-second needs --frame");
    if (!isnan(wishes->time_point) && !isnan(wishes->frame))
        return result_fail(RESULT_USAGE, "--time-point and --frame say the same; give one of them");
    if (wishes->animation && !wishes_have_moment(wishes))
        return result_fail(RESULT_USAGE, "--animation needs --time-point or --frame");
    if (wishes->shutter && !wishes_have_moment(wishes))
        return result_fail(RESULT_USAGE, "--shutter needs --time-point or --frame");
    return result_ok();
}

/* Fills the builder with a scene file (`path`) or with a blob, and grants the wishes that need no reader. */
static result_t fill(const char *path, const scene_blob_t *blob, blob_builder_t *builder,
                     const import_report_t *sink)
{
    import_wishes_t wishes = sink && sink->wishes ? *sink->wishes : import_wishes_none();
    environment_t environment;
    TRY(environment_parse(wishes.environment, &environment));
    TRY(check_company(&wishes));
    report_t report = report_begin(sink);
    scene_builder_t scene;
    scene_begin(&scene, builder, &report);
    result_t result = blob ? check_wishes(&wishes, &blobs) : read_format(path, &wishes, &scene);
    if (blob) blob_builder_take(builder, blob);
    if (result.code == RESULT_OK) result = scene_adjust_view(&scene, &wishes);
    if (result.code == RESULT_OK) result = environment_add(&scene, &environment, &wishes);
    scene_end(&scene);
    report_end(&report);
    return result;
}

result_t import_scene(const char *path, blob_builder_t *builder, const import_report_t *report)
{
    struct stat status;
    if (stat(path, &status) != 0 || !S_ISDIR(status.st_mode)) return fill(path, NULL, builder, report);
    size_t length = strlen(path);
    char *inside = mem_printf("%s%sscene.pbrt", path, length && path[length - 1] == '/' ? "" : "/");
    result_t result = fill(inside, NULL, builder, report);
    free(inside);
    return result;
}

static result_t finish(result_t result, blob_builder_t *builder, int *file)
{
    *file = -1;
    if (result.code == RESULT_OK) result = blob_builder_write(builder, file);
    blob_builder_destroy(&builder);
    return result;
}

result_t import_scene_file(const char *path, const import_report_t *report, int *file)
{
    blob_builder_t *builder = blob_builder_new();
    return finish(import_scene(path, builder, report), builder, file);
}

result_t import_scene_blob(const char *path, const import_report_t *report, uint8_t **bytes, uint64_t *size)
{
    blob_builder_t *builder = blob_builder_new();
    result_t result = import_scene(path, builder, report);
    if (result.code == RESULT_OK) result = blob_builder_finish(builder, bytes, size);
    blob_builder_destroy(&builder);
    return result;
}

bool import_changes_blobs(const import_wishes_t *wishes)
{
    return wishes && (wishes->environment || wishes->camera || wishes->variant || wishes->fov > 0 ||
                      wishes->lens_radius >= 0 || wishes->focus || wishes->definitions.count > 0 ||
                      wishes_have_moment(wishes) || wishes->animation || wishes->shutter ||
                      adjusts_environment(wishes) || sets_frame_rate(wishes));
}

result_t import_changed_file(const scene_blob_t *blob, const import_report_t *report, int *file)
{
    blob_builder_t *builder = blob_builder_new();
    return finish(fill(NULL, blob, builder, report), builder, file);
}
