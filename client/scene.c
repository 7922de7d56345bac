/* scene: see scene.h. */
#include "client/scene.h"

#include "client/import/import.h"

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
    int file = open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0) return false;
    ssize_t size = read(file, head, sizeof head);
    close(file);
    return size > 0 && blob_recognise(head, (uint64_t)size);
}

result_t scene_load(const char *path, bool lenient, scene_t *scene)
{
    *scene = (scene_t){0};
    if (access(path, R_OK) != 0)
        return result_fail(RESULT_INPUT, "cannot read %.300s: %s", path, strerror(errno));
    result_t result;
    if (is_blob_file(path)) {
        result = blob_open_file(path, &scene->blob);
    } else {
        uint64_t size;
        import_report_t report = {.lenient = lenient};
        result = import_scene_blob(path, &report, &scene->bytes, &size);
        if (result.code == RESULT_OK) result = blob_open(scene->bytes, size, &scene->blob);
    }
    if (result.code == RESULT_OK)
        scene->name = scene_name(path);
    else
        scene_free(scene);
    return result;
}

void scene_free(scene_t *scene)
{
    blob_close(&scene->blob);
    free(scene->bytes);
    free(scene->name);
    *scene = (scene_t){0};
}
