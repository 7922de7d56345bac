/* submit: the command that hands a scene to a master, and with --wait sees it through. */
#include "client/commands.h"
#include "client/interrupt.h"
#include "client/master_option.h"
#include "client/options.h"
#include "client/output.h"
#include "client/scene.h"
#include "client/strategies.h"
#include "client/watch.h"
#include "common/film/picture.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "usage: lightmill submit SCENE [options]\n"
    "\n"
    "Sends a scene (a .pbrt, .gltf or .glb file, a folder with a scene.pbrt, or a scene blob) to a "
    "master and prints the job's\n"
    "number.\n"
    "\n"
    "  --name NAME        what the job is called (default: after the scene)\n"
    "  --priority N       jobs of a higher priority go first, those of the same share the workers (0)\n"
    "  --verify SHARE     render so much of it twice, on two workers, and compare (1% or 0.01)\n"
    "  --mixed            let machines share it that do not make the same bits\n"
    "  --wait             show the progress, and fetch the image at the end; goes on when the master is\n"
    "                     restarted\n"
    "  --strategies       with --wait: as in lightmill render; two jobs a strategy, which "
    "Ctrl-C cancels\n"
    "  --quiet            no progress\n";

typedef struct {
    const char *scene_path, *name;
    job_terms_t terms; /* without the name */
    overrides_t overrides;
    output_t output;
    master_option_t master;
    bool wait, strategies, quiet, help;
} command_t;

static result_t parse_terms(job_terms_t *terms, const char *option, const char *value, bool *taken)
{
    long long number;
    *taken = true;
    if (strcmp(option, "priority") == 0) {
        TRY(option_integer(option, value, -JOB_MAX_PRIORITY, JOB_MAX_PRIORITY, &number));
        terms->priority = (int32_t)number;
    } else if (strcmp(option, "verify") == 0) {
        return option_share(option, value, &terms->verify);
    } else if (strcmp(option, "mixed") == 0) {
        terms->mixed = true;
    } else {
        *taken = false;
    }
    return result_ok();
}

static result_t parse_option(command_t *command, const char *option, const char *value)
{
    bool taken;
    TRY(overrides_option(&command->overrides, option, value, &taken));
    if (!taken) TRY(output_option(&command->output, option, value, &taken));
    if (!taken) TRY(master_option(&command->master, option, value, &taken));
    if (!taken) TRY(parse_terms(&command->terms, option, value, &taken));
    if (taken) return result_ok();
    if (strcmp(option, "name") == 0)
        command->name = value;
    else if (strcmp(option, "wait") == 0)
        command->wait = true;
    else if (strcmp(option, "strategies") == 0)
        command->strategies = true;
    else if (strcmp(option, "quiet") == 0)
        command->quiet = true;
    else
        command->help = true;
    return result_ok();
}

static result_t parse_arguments(int argc, char **argv, command_t *command)
{
    static const struct option options[] = {SETTINGS_OPTIONS,
                                            OUTPUT_OPTIONS,
                                            MASTER_OPTIONS,
                                            {"name", required_argument, NULL, 0},
                                            {"priority", required_argument, NULL, 0},
                                            {"verify", required_argument, NULL, 0},
                                            {"mixed", no_argument, NULL, 0},
                                            {"wait", no_argument, NULL, 0},
                                            {"strategies", no_argument, NULL, 0},
                                            {"quiet", no_argument, NULL, 0},
                                            {"help", no_argument, NULL, 0},
                                            {NULL, 0, NULL, 0}};
    *command = (command_t){.overrides = overrides_none(), .master = master_option_default()};
    int index = 0, found;
    while ((found = getopt_long(argc, argv, "o:", options, &index)) != -1) {
        if (found == '?') return result_fail(RESULT_USAGE, "see lightmill submit --help");
        TRY(parse_option(command, found == 'o' ? "output" : options[index].name, optarg));
        if (command->help) return result_ok();
    }
    if (argc - optind != 1)
        return result_fail(RESULT_USAGE, "submit takes one scene; see lightmill submit --help");
    if (command->strategies && !command->wait)
        return result_fail(RESULT_USAGE, "--strategies needs --wait: the images are put together here");
    if ((command->output.path || command->output.png) && !command->wait)
        return result_fail(RESULT_USAGE,
                           "-o and --png need --wait; without it fetch the image later: lightmill fetch");
    command->scene_path = argv[optind];
    return result_ok();
}

static void show_upload(void *context, uint64_t done, uint64_t size)
{
    progress_upload(context, done, size);
}

static result_t check_interrupt(void *context)
{
    (void)context;
    if (!interrupt_seen()) return result_ok();
    return result_fail(RESULT_CANCELLED, "interrupted before all strategies were done; nothing is written");
}

static result_t submit_strategies(const command_t *command, remote_t *remote, const scene_t *scene)
{
    strategies_t strategies = {.remote = remote,
                               .scene = scene,
                               .terms = command->terms,
                               .output = &command->output,
                               .quiet = command->quiet,
                               .patient = true,
                               .check = check_interrupt};
    TRY(strategies_settings(&command->overrides, &scene->blob, &strategies.settings));
    interrupt_catch();
    return strategies_render(&strategies);
}

static result_t submit(const command_t *command, remote_t *remote, const scene_t *scene)
{
    job_settings_t settings;
    TRY(overrides_apply(&command->overrides, &scene->blob, &settings));
    progress_t progress = progress_start(command->quiet);
    result_t result = remote_put_blob(remote, &scene->blob, show_upload, &progress);
    progress_end(&progress);
    TRY(result);
    watch_t watch = {.remote = remote, .progress = &progress, .patient = true};
    job_terms_t terms = command->terms;
    snprintf(terms.name, sizeof terms.name, "%s", command->name ? command->name : scene->name);
    TRY(remote_submit_job(remote, &terms, &settings, &scene->blob.hash, &watch.job));
    printf("%" PRIu64 "\n", watch.job);
    fflush(stdout);
    if (!command->wait) return result_ok();
    result = watch_wait(&watch);
    progress_end(&progress);
    TRY(result);
    TRY(watch_deliver(&watch, &command->output, command->quiet));
    return watch_outcome(&watch);
}

result_t cmd_submit(int argc, char **argv)
{
    command_t command;
    TRY(parse_arguments(argc, argv, &command));
    if (command.help) {
        printf("%s%s%s\n%s\n%s", usage, master_usage, dial_usage, output_usage, settings_usage);
        return result_ok();
    }
    log_init("lightmill", command.quiet ? LOG_ERROR : LOG_WARNING);
    scene_t scene;
    TRY(scene_load(command.scene_path, command.overrides.lenient, &scene));
    char *path = mem_printf(command.strategies ? "%s-strategies.exr" : "%s.exr", scene.name);
    if (command.output.path == NULL) command.output.path = path;
    char *sheet = picture_png_path(command.output.path);
    if (command.strategies && command.output.png == NULL && !output_is_png(command.output.path))
        command.output.png = sheet;
    remote_t *remote = NULL;
    result_t result = command.wait ? output_check(&command.output) : result_ok();
    if (result.code == RESULT_OK) result = master_connect(&command.master, &remote);
    if (result.code == RESULT_OK)
        result = (command.strategies ? submit_strategies : submit)(&command, remote, &scene);
    remote_close(&remote);
    free(path);
    free(sheet);
    scene_free(&scene);
    return result;
}
