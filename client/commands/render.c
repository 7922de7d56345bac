/* render: the command that renders on this machine.
 *
 * DESIGN. A client of a farm that happens to be its own: it starts one (local_farm.c), and then does what
 * `submit --wait` does: upload, submit, watch, fetch. Ctrl-C cancels the job; the workers send what they have
 * finished, and the image so far is written as if the job had been meant to end there. The second Ctrl-C ends
 * the process.
 */
#include "client/commands/commands.h"
#include "client/farm/local_farm.h"
#include "client/farm/strategies.h"
#include "client/farm/watch.h"
#include "client/image/output.h"
#include "client/scene/loaded_scene.h"
#include "client/scene/scene_options.h"
#include "client/scene/settings.h"
#include "common/film/picture.h"
#include "common/interrupt.h"

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    import_wishes_t wishes;
    overrides_t overrides;
    output_t output;
    local_farm_options_t farm;
    const char *viewer; /* HOST[:PORT]; NULL: none */
    tell_t tell;
    bool strategies, quiet;
} values_t;

/* Seconds that a viewer which does not read may keep us after the image is written, and one that reads. */
static const double VIEWER_STALL = 3, VIEWER_LIMIT = 60;

static const option_t rows[] = {
    OPTION(values_t, farm.threads, "threads", "N",
           "render threads (default: one a core); with --workers, of each worker", OPTION_RANGE(1, 4096)),
    OPTION(values_t, farm.workers, "workers", "N",
           "N worker processes and a master on loopback TCP, as on a farm",
           OPTION_RANGE(1, LOCAL_FARM_MAX_WORKERS)),
    OPTION(values_t, strategies, "strategies", NULL,
           "an image of each strategy of bdpt, weighted and unweighted, instead of the picture: layers "
           "weighted.sS_tT and unweighted.sS_tT of SCENE-strategies.exr, and a contact sheet beside it; "
           "paths of at most 12 segments (--max-depth 11). Ctrl-C: no files"),
    OPTION(values_t, output.halves, "halves", NULL,
           "with the images of the even and of the odd samples, as layers half0 and half1"),
    OPTION(values_t, viewer, "display", "HOST[:PORT]",
           "show the image as it converges in an image viewer: tev, HDRView, or another that speaks tev's "
           "protocol (default port: 14158); it may come, go and come again"),
    OPTION(values_t, quiet, "quiet", NULL, "no progress, errors only"),
    OPTION(values_t, farm.verbose, "verbose", NULL, "log what master and workers do"),
};
static const option_group_t render_options = OPTION_GROUP(NULL, rows);

static void begin(void *data)
{
    *(values_t *)data = (values_t){.wishes = import_wishes_none(), .overrides = overrides_none()};
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

/* The viewer's image is called like the file, so that files can be compared in the viewer. */
static result_t start_display(const values_t *values, local_farm_t *farm, watch_t *watch)
{
    remote_t *remote;
    if (watch->display == NULL) return result_ok();
    TRY(local_farm_connect(farm, &remote));
    return display_start(watch->display, remote, watch->job, values->output.path);
}

/* The image is written, so a viewer that does not take it is no failure; one that is away has been told of.
 */
static void finish_display(watch_t *watch)
{
    result_t result = display_finish(watch->display, VIEWER_STALL, VIEWER_LIMIT, false);
    if (result.code != RESULT_OK) log_warning("%s; it is in the file", result.message);
}

static result_t run_job(const values_t *values, local_farm_t *farm, remote_t *remote,
                        const loaded_scene_t *scene, const job_settings_t *settings, display_t *display)
{
    progress_t progress = progress_start(values->quiet);
    watch_t watch = {.remote = remote,
                     .progress = &progress,
                     .display = display,
                     .saves = &values->output,
                     .quiet = values->quiet};
    result_t ended_by;
    TRY(remote_put_blob(remote, &scene->blob, NULL, NULL));
    job_terms_t terms = {.halves = values->output.halves};
    snprintf(terms.name, sizeof terms.name, "%s", scene->name);
    TRY(remote_submit_job(remote, &terms, settings, &scene->blob.hash, &watch.job));
    TRY(start_display(values, farm, &watch));
    result_t result = watch_job(farm, &watch, &ended_by);
    progress_end(&progress);
    TRY(result);
    result = watch_deliver(&watch, &values->output, values->quiet);
    if (result.code == RESULT_OK) finish_display(&watch);
    watch_tell(&watch, &values->tell, result.code == RESULT_OK ? values->output.path : NULL,
               result.code == RESULT_OK ? ended_by.message : result.message);
    return result.code == RESULT_OK ? ended_by : result;
}

static result_t check_farm(void *farm)
{
    return local_farm_check(farm);
}

static result_t run_strategies(const values_t *values, local_farm_t *farm, remote_t *remote,
                               const loaded_scene_t *scene, const job_settings_t *settings,
                               display_t *display)
{
    (void)display; /* there is none: see check */
    strategies_t strategies = {.remote = remote,
                               .scene = scene,
                               .settings = *settings,
                               .output = &values->output,
                               .quiet = values->quiet,
                               .check = check_farm,
                               .check_context = farm};
    return strategies_render(&strategies);
}

/* The page's address opens it, so it goes to who started this, and to no log. */
static void tell_page(const local_farm_t *farm)
{
    char *page = local_farm_page(farm);
    if (page != NULL) fprintf(stderr, "watch it at %s\n", page);
    free(page);
}

static result_t render(const values_t *values, const loaded_scene_t *scene, display_t **display)
{
    job_settings_t settings;
    result_t (*prepare)(const overrides_t *, const scene_blob_t *, job_settings_t *) =
        values->strategies ? strategies_settings : overrides_apply;
    TRY(prepare(&values->overrides, &scene->blob, &settings));
    TRY(output_check_saves(&values->output, &settings.save_at));
    local_farm_options_t options = values->farm;
    options.batch_interval = batch_interval(&settings);
    interrupt_catch();
    signal(SIGPIPE, SIG_IGN);
    local_farm_t *farm;
    TRY(local_farm_start(&options, &farm));
    tell_page(farm);
    remote_t *remote;
    result_t result = local_farm_connect(farm, &remote);
    if (result.code == RESULT_OK)
        result =
            (values->strategies ? run_strategies : run_job)(values, farm, remote, scene, &settings, *display);
    display_close(display);
    remote_close(&remote);
    local_farm_stop(&farm);
    return result;
}

static result_t check(const values_t *values)
{
    if (values->strategies && values->output.halves)
        return result_fail(RESULT_USAGE, "--halves and --strategies do not go together");
    if (values->strategies && values->tell.target)
        return result_fail(RESULT_USAGE, "--notify tells of one job, and --strategies makes many");
    if (values->strategies && values->viewer)
        return result_fail(RESULT_USAGE, "--display and --strategies do not go together: the images of the "
                                         "strategies are put together only at the end");
    return output_check(&values->output);
}

static result_t run(const call_t *call)
{
    values_t *values = call->values;
    display_t *display = NULL;
    log_init("lightmill", values->farm.verbose ? LOG_DEBUG : values->quiet ? LOG_ERROR : LOG_WARNING);
    loaded_scene_t scene;
    TRY(scene_load(call->arguments[0], &values->wishes, &scene));
    settings_tell_cut(&values->overrides, &scene.blob);
    output_name(&values->output, scene.name, values->strategies);
    result_t result = check(values);
    if (result.code == RESULT_OK) result = display_open(values->viewer, &display);
    if (result.code == RESULT_OK) result = render(values, &scene, &display);
    display_close(&display);
    output_free(&values->output);
    scene_free(&scene);
    return result;
}

const command_t render_command = {
    .name = "lightmill render",
    .arguments = "SCENE",
    .summary = "render on this machine and write the image",
    .about =
        "Renders a scene (a .pbrt, .gltf, .glb, .obj or .xml file, a folder with a scene.pbrt, or a scene "
        "blob) on this machine. Ctrl-C ends the render and writes the image so far; twice: leaves at once. A "
        "terminal that is closed (SIGHUP) counts as one Ctrl-C.",
    .groups = {{&render_options, 0},
               {&output_options, offsetof(values_t, output)},
               {&tell_options, offsetof(values_t, tell)},
               {&scene_options, offsetof(values_t, wishes)},
               {&settings_options, offsetof(values_t, overrides)},
               {&http_options, offsetof(values_t, farm.http)}},
    .size = sizeof(values_t),
    .begin = begin,
    .run = run};
