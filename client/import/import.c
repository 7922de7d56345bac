/* import: the table of formats, and nothing else. */
#include "client/import/import.h"

#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "client/import/gltf/gltf.h"
#include "client/import/obj/obj.h"
#include "client/import/pbrt/pbrt.h"

typedef struct {
    const char *extension;
    result_t (*import)(const char *path, scene_builder_t *scene);
} format_t;

static const format_t formats[] = {
    {".pbrt", pbrt_import},
    {".gltf", gltf_import},
    {".glb", gltf_import},
    {".obj", obj_import},
};

static const format_t *format_of(const char *path)
{
    const char *name = strrchr(path, '/');
    const char *dot = strrchr(name ? name : path, '.');
    for (size_t i = 0; dot && i < ARRAY_LENGTH(formats); ++i)
        if (strcasecmp(dot, formats[i].extension) == 0) return &formats[i];
    return NULL;
}

static result_t import_file(const char *path, blob_builder_t *builder, const import_report_t *sink)
{
    const format_t *format = format_of(path);
    if (!format)
        return result_fail(RESULT_INPUT,
                           "%s: not a scene format that Lightmill reads; it reads .pbrt, .gltf, .glb and .obj",
                           path);
    report_t report = report_begin(sink);
    scene_builder_t scene;
    scene_begin(&scene, builder, &report);
    result_t result = format->import(path, &scene);
    scene_end(&scene);
    report_end(&report);
    return result;
}

result_t import_scene(const char *path, blob_builder_t *builder, const import_report_t *report)
{
    struct stat status;
    if (stat(path, &status) != 0 || !S_ISDIR(status.st_mode)) return import_file(path, builder, report);
    size_t length = strlen(path);
    char *inside = mem_printf("%s%sscene.pbrt", path, length && path[length - 1] == '/' ? "" : "/");
    result_t result = import_file(inside, builder, report);
    free(inside);
    return result;
}

result_t import_scene_blob(const char *path, const import_report_t *report, uint8_t **bytes, uint64_t *size)
{
    blob_builder_t *builder = blob_builder_new();
    result_t result = import_scene(path, builder, report);
    if (result.code == RESULT_OK) result = blob_builder_finish(builder, bytes, size);
    blob_builder_destroy(&builder);
    return result;
}
