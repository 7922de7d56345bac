/* import: `lightmill import`: a scene as one blob file, so that a long import is done once. */
#include "client/commands/commands.h"
#include "client/image/output.h"
#include "client/scene/loaded_scene.h"
#include "client/scene/scene_options.h"
#include "common/atomic_file.h"

#include <stdio.h>
#include <stdlib.h>

typedef struct {
    import_wishes_t wishes;
    const char *output; /* NULL: the default */
    bool quiet;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, output, "output", "FILE",
           "the blob (default: the scene's name with .blob, in this folder)", .letter = 'o'),
    OPTION(values_t, quiet, "quiet", NULL, "say nothing but errors and warnings"),
};
static const option_group_t import_options = OPTION_GROUP(NULL, rows);

static result_t run(const call_t *call)
{
    const values_t *values = call->values;
    loaded_scene_t scene;
    if (values->output) TRY(output_writable(values->output));
    TRY(scene_load(call->arguments[0], &values->wishes, &scene));
    char *path = values->output ? mem_strdup(values->output) : mem_printf("%s.blob", scene.name);
    result_t result = file_write_atomic(path, scene.blob.bytes, scene.blob.size);
    if (result.code == RESULT_OK && !values->quiet)
        printf("wrote %s: %.1f MB\n", path, (double)scene.blob.size * 1e-6);
    free(path);
    scene_free(&scene);
    return result;
}

const command_t import_command = {
    .name = "lightmill import",
    .arguments = "SCENE",
    .summary = "a scene with all its files as one scene blob",
    .about =
        "Reads a scene (a .pbrt, .gltf, .glb, .obj or .xml file, or a folder with a scene.pbrt) with all its "
        "meshes and textures and writes it as one scene blob, which render, submit and info take in its "
        "place, at once.",
    .groups = {{&import_options, 0}, {&scene_options, offsetof(values_t, wishes)}},
    .size = sizeof(values_t),
    .begin = scene_options_begin, /* the first member */
    .run = run};
