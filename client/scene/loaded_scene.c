/* loaded_scene: see loaded_scene.h. */
#include "client/scene/loaded_scene.h"

#include "client/import/import.h"
#include "client/text/progress.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* The last part of a path without its extension; for DIR/scene.pbrt the directory's name, since all scenes
 * that come as a folder are called so. The caller frees it. */
static char *scene_name(const char *path)
{
    char *resolved = realpath(path, NULL);
    char *copy = resolved ? resolved : mem_strdup(path);
    char *slash = strrchr(copy, '/');
    char *base = slash ? slash + 1 : copy;
    struct stat status;
    bool directory = stat(path, &status) == 0 && S_ISDIR(status.st_mode);
    char *dot = strrchr(base, '.');
    if (dot && dot != base && !directory) *dot = '\0';
    if (!directory && strcmp(base, "scene") == 0 && slash) {
        *slash = '\0';
        char *parent = strrchr(copy, '/');
        if (parent && parent[1]) base = parent + 1;
    }
    char *name = mem_strdup(base[0] ? base : "image");
    free(copy);
    return name;
}

/* True when the path is a file that begins like a blob. */
static bool is_blob_file(const char *path)
{
    uint8_t head[64];
    struct stat about;
    int file;
    if (file_open(path, &file, &about).code != RESULT_OK) return false;
    ssize_t size = read(file, head, sizeof head);
    close(file);
    return size > 0 && blob_recognise(head, (uint64_t)size);
}

/* A warning must not end up behind the bar. */
static void warn(void *context, const char *message)
{
    progress_end(context);
    log_warning("%s", message);
}

static void show_progress(void *context, double fraction)
{
    progress_import(context, fraction);
}

/* Imports a scene file, or makes a blob what the wishes ask for. */
static result_t import_file(const char *path, const scene_blob_t *blob, const import_wishes_t *wishes,
                            loaded_scene_t *scene)
{
    int file;
    progress_t progress = progress_start(false);
    import_report_t report = {.warn = warn,
                              .progress = show_progress,
                              .context = &progress,
                              .lenient = wishes && wishes->lenient,
                              .strict = wishes && wishes->strict,
                              .wishes = wishes};
    result_t result =
        blob ? import_changed_file(blob, &report, &file) : import_scene_file(path, &report, &file);
    if (result.code == RESULT_OK) {
        result = blob_open_descriptor(file, path, &scene->blob);
        close(file);
    }
    progress_erase(&progress);
    return result;
}

static result_t load_blob(const char *path, const import_wishes_t *wishes, loaded_scene_t *scene)
{
    scene_blob_t blob;
    if (!import_changes_blobs(wishes)) return blob_open_file(path, &scene->blob);
    TRY(blob_open_file(path, &blob));
    result_t result = import_file(path, &blob, wishes, scene);
    blob_close(&blob);
    return result;
}

result_t scene_load(const char *path, const import_wishes_t *wishes, loaded_scene_t *scene)
{
    *scene = (loaded_scene_t){0};
    if (access(path, R_OK) != 0)
        return result_fail(RESULT_INPUT, "cannot read %.300s: %s", path, strerror(errno));
    result_t result =
        is_blob_file(path) ? load_blob(path, wishes, scene) : import_file(path, NULL, wishes, scene);
    if (result.code == RESULT_OK)
        scene->name = scene_name(path);
    else
        scene_free(scene);
    return result;
}

void scene_free(loaded_scene_t *scene)
{
    blob_close(&scene->blob);
    free(scene->name);
    *scene = (loaded_scene_t){0};
}
