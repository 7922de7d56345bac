/* convert: `lightmill import`: a scene as one blob file, so that a long import is done once. */
#include "client/commands.h"
#include "client/output.h"
#include "client/scene.h"
#include "common/atomic_file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "usage: lightmill import SCENE [options]\n"
    "\n"
    "Reads a scene (a .pbrt, .gltf or .glb file, or a folder with a scene.pbrt) with all its meshes and\n"
    "textures and writes it as one scene blob, which render, submit and info take in its place, at once.\n"
    "\n"
    "  -o, --output FILE  the blob (default: the scene's name with .blob, in this folder)\n"
    "  --lenient          take the nearest substitute for what a scene has and Lightmill has not, and warn\n"
    "  --quiet            say nothing but errors and warnings\n";

typedef struct {
    const char *scene;
    const char *output; /* NULL: the default */
    bool lenient, quiet, help;
} arguments_t;

static result_t parse(int argc, char **argv, arguments_t *arguments)
{
    enum { LENIENT = 1, QUIET, HELP };
    static const struct option options[] = {{"output", required_argument, NULL, 'o'},
                                            {"lenient", no_argument, NULL, LENIENT},
                                            {"quiet", no_argument, NULL, QUIET},
                                            {"help", no_argument, NULL, HELP},
                                            {NULL, 0, NULL, 0}};
    *arguments = (arguments_t){0};
    optind = 0;
    opterr = 0;
    for (int option; (option = getopt_long(argc, argv, ":ho:", options, NULL)) != -1;) {
        switch (option) {
        case 'o':
            arguments->output = optarg;
            break;
        case LENIENT:
            arguments->lenient = true;
            break;
        case QUIET:
            arguments->quiet = true;
            break;
        case HELP:
        case 'h':
            arguments->help = true;
            return result_ok();
        case ':':
            return result_fail(RESULT_USAGE, "%s needs a value", argv[optind - 1]);
        default:
            return result_fail(RESULT_USAGE, "unknown option %s; see lightmill import --help",
                               argv[optind - 1]);
        }
    }
    if (argc - optind != 1)
        return result_fail(RESULT_USAGE, "import takes one scene; see lightmill import --help");
    arguments->scene = argv[optind];
    return result_ok();
}

result_t cmd_import(int argc, char **argv)
{
    arguments_t arguments;
    scene_t scene;
    TRY(parse(argc, argv, &arguments));
    if (arguments.help) {
        fputs(usage, stdout);
        return result_ok();
    }
    if (arguments.output) TRY(output_writable(arguments.output));
    TRY(scene_load(arguments.scene, arguments.lenient, &scene));
    char *path = arguments.output ? mem_strdup(arguments.output) : mem_printf("%s.blob", scene.name);
    result_t result = file_write_atomic(path, scene.blob.bytes, scene.blob.size);
    if (result.code == RESULT_OK && !arguments.quiet)
        printf("wrote %s: %.1f MB\n", path, (double)scene.blob.size * 1e-6);
    free(path);
    scene_free(&scene);
    return result;
}
