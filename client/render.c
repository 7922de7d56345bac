/* render: the command that renders on this machine.
 *
 * DESIGN. A client of a farm that happens to be its own: it starts one (local_farm.c), and then does what
 * `submit --wait` does: upload, submit, watch, fetch. Ctrl-C cancels the job; the workers send what they have
 * finished, and the image so far is written as if the job had been meant to end there. The second Ctrl-C ends
 * the process.
 */
#include "client/commands.h"
#include "client/interrupt.h"
#include "client/local_farm.h"
#include "client/options.h"
#include "client/output.h"
#include "client/scene.h"
#include "client/strategies.h"
#include "client/watch.h"
#include "common/film/picture.h"

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char usage[] =
    "usage: lightmill render SCENE [options]\n"
    "\n"
    "Renders a scene (a .pbrt, .gltf or .glb file, a folder with a scene.pbrt, or a scene blob) on this "
    "machine.\n"
    "Ctrl-C ends the render and writes the image so far; twice: leaves at once.\n"
    "\n"
    "  --threads N        render threads (default: one a core); with --workers, of each worker\n"
    "  --workers N        N worker processes and a master on loopback TCP, as on a farm\n"
    "  --strategies       an image of each strategy of bdpt, weighted and unweighted, instead of the "
    "picture:\n"
    "                     layers weighted.sS_tT and unweighted.sS_tT of SCENE-strategies.exr, and a contact\n"
    "                     sheet beside it; paths of at most 12 segments (--max-depth 11). Ctrl-C: no files\n"
    "  --quiet            no progress, errors only\n"
    "  --verbose          log what master and workers do\n";

typedef struct {
    const char *scene_path;
    overrides_t overrides;
    output_t output;
    local_farm_options_t farm;
    bool strategies, quiet, verbose, help;
} command_t;

static result_t parse_option(command_t *command, const char *option, const char *value)
{
    bool taken;
    long long number;
    TRY(overrides_option(&command->overrides, option, value, &taken));
    if (taken) return result_ok();
    TRY(output_option(&command->output, option, value, &taken));
    if (taken) return result_ok();
    if (strcmp(option, "threads") == 0) {
        TRY(option_integer(option, value, 1, 4096, &number));
        command->farm.threads = (int)number;
    } else if (strcmp(option, "workers") == 0) {
        TRY(option_integer(option, value, 1, LOCAL_FARM_MAX_WORKERS, &number));
        command->farm.workers = (int)number;
    } else if (strcmp(option, "strategies") == 0) {
        command->strategies = true;
    } else if (strcmp(option, "quiet") == 0) {
        command->quiet = true;
    } else if (strcmp(option, "verbose") == 0) {
        command->verbose = command->farm.verbose = true;
    } else {
        command->help = true;
    }
    return result_ok();
}

static result_t parse_arguments(int argc, char **argv, command_t *command)
{
    static const struct option options[] = {SETTINGS_OPTIONS,
                                            OUTPUT_OPTIONS,
                                            {"threads", required_argument, NULL, 0},
                                            {"workers", required_argument, NULL, 0},
                                            {"strategies", no_argument, NULL, 0},
                                            {"quiet", no_argument, NULL, 0},
                                            {"verbose", no_argument, NULL, 0},
                                            {"help", no_argument, NULL, 0},
                                            {NULL, 0, NULL, 0}};
    *command = (command_t){.overrides = overrides_none()};
    int index = 0, found;
    while ((found = getopt_long(argc, argv, "o:", options, &index)) != -1) {
        if (found == '?') return result_fail(RESULT_USAGE, "see lightmill render --help");
        TRY(parse_option(command, found == 'o' ? "output" : options[index].name, optarg));
        if (command->help) return result_ok();
    }
    if (argc - optind != 1)
        return result_fail(RESULT_USAGE, "render takes one scene; see lightmill render --help");
    command->scene_path = argv[optind];
    return result_ok();
}

/* Seconds between batches: a large frame is costly to send, a small one should show its progress soon. */
static double batch_interval(const job_settings_t *settings)
{
    double seconds = 5e-6 * (double)settings->width * (double)settings->height;
    return seconds < 0.5 ? 0.5 : seconds > 10 ? 10 : seconds;
}

/* Watches the job to its end. An interrupt, or the death of all workers, cancels it; *ended_by says why. */
static result_t watch_job(local_farm_t *farm, watch_t *watch, result_t *ended_by)
{
    *ended_by = result_ok();
    for (;;) {
        TRY(watch_poll(watch));
        if (watch->final) return result_ok();
        if (ended_by->code == RESULT_OK) {
            if (interrupt_seen())
                *ended_by = result_fail(RESULT_CANCELLED, "interrupted");
            else
                *ended_by = local_farm_check(farm);
            /* Refused when the job has just ended by itself: the next status says so. */
            if (ended_by->code != RESULT_OK) remote_cancel(watch->remote, watch->job);
        }
    }
}

static result_t run_job(const command_t *command, local_farm_t *farm, remote_t *remote, const scene_t *scene,
                        const job_settings_t *settings)
{
    progress_t progress = progress_start(command->quiet);
    watch_t watch = {.remote = remote, .progress = &progress};
    result_t ended_by;
    TRY(remote_put_blob(remote, &scene->blob, NULL, NULL));
    TRY(remote_submit(remote, scene->name, settings, &scene->blob.hash, &watch.job));
    result_t result = watch_job(farm, &watch, &ended_by);
    progress_end(&progress);
    if (result.code == RESULT_OK) result = watch_deliver(&watch, &command->output, command->quiet);
    return result.code == RESULT_OK ? ended_by : result;
}

static result_t check_strategies(void *context)
{
    if (interrupt_seen())
        return result_fail(RESULT_CANCELLED,
                           "interrupted before all strategies were done; nothing is written");
    return local_farm_check(context);
}

static result_t run_strategies(const command_t *command, local_farm_t *farm, remote_t *remote,
                               const scene_t *scene, const job_settings_t *settings)
{
    strategies_t strategies = {.remote = remote,
                               .scene = scene,
                               .settings = *settings,
                               .output = &command->output,
                               .quiet = command->quiet,
                               .check = check_strategies,
                               .check_context = farm};
    return strategies_render(&strategies);
}

static result_t render(const command_t *command, const scene_t *scene)
{
    job_settings_t settings;
    result_t (*prepare)(const overrides_t *, const scene_blob_t *, job_settings_t *) =
        command->strategies ? strategies_settings : overrides_apply;
    TRY(prepare(&command->overrides, &scene->blob, &settings));
    local_farm_options_t options = command->farm;
    options.batch_interval = batch_interval(&settings);
    interrupt_catch();
    signal(SIGPIPE, SIG_IGN);
    local_farm_t *farm;
    TRY(local_farm_start(&options, &farm));
    remote_t *remote;
    result_t result = local_farm_connect(farm, &remote);
    if (result.code == RESULT_OK)
        result = (command->strategies ? run_strategies : run_job)(command, farm, remote, scene, &settings);
    remote_close(&remote);
    local_farm_stop(&farm);
    return result;
}

result_t cmd_render(int argc, char **argv)
{
    command_t command;
    TRY(parse_arguments(argc, argv, &command));
    if (command.help) {
        printf("%s\n%s\n%s", usage, output_usage, settings_usage);
        return result_ok();
    }
    log_init("lightmill", command.verbose ? LOG_DEBUG : command.quiet ? LOG_ERROR : LOG_WARNING);
    scene_t scene;
    TRY(scene_load(command.scene_path, command.overrides.lenient, &scene));
    char *path = mem_printf(command.strategies ? "%s-strategies.exr" : "%s.exr", scene.name);
    if (command.output.path == NULL) command.output.path = path;
    char *sheet = picture_png_path(command.output.path);
    if (command.strategies && command.output.png == NULL && !output_is_png(command.output.path))
        command.output.png = sheet;
    result_t result = output_check(&command.output);
    if (result.code == RESULT_OK) result = render(&command, &scene);
    free(path);
    free(sheet);
    scene_free(&scene);
    return result;
}
