/* submit: the command that hands a scene to a master, and with --wait sees it through. */
#include "client/commands/commands.h"
#include "client/farm/master_option.h"
#include "client/farm/strategies.h"
#include "client/farm/watch.h"
#include "client/image/output.h"
#include "client/scene/loaded_scene.h"
#include "client/scene/scene_options.h"
#include "client/scene/settings.h"
#include "common/film/picture.h"
#include "common/interrupt.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    const char *name;
    job_terms_t terms; /* without the name */
    import_wishes_t wishes;
    overrides_t overrides;
    output_t output;
    master_option_t master;
    tell_t tell;
    bool wait, strategies, quiet;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, name, "name", "NAME", "what the job is called (default: after the scene)"),
    OPTION(values_t, terms.priority, "priority", "N",
           "jobs of a higher priority go first, those of the same share the workers (default: 0)",
           OPTION_RANGE(-JOB_MAX_PRIORITY, JOB_MAX_PRIORITY)),
    OPTION_BY(
        option_share, values_t, terms.verify, "verify", "SHARE",
        "render so much of it twice, on two workers, and compare (1% or 0.01); wrong sums are taken out"),
    OPTION(values_t, terms.mixed, "mixed", NULL, "let machines share it that do not make the same bits"),
    OPTION(values_t, terms.halves, "halves", NULL,
           "keep the images of the even and of the odd samples too, as layers half0 and half1 of its images"),
    OPTION(values_t, wait, "wait", NULL,
           "show the progress, and fetch the image at the end; goes on when the master is restarted"),
    OPTION(values_t, strategies, "strategies", NULL,
           "with --wait: as in lightmill render; two jobs a strategy, which Ctrl-C cancels"),
    OPTION(values_t, quiet, "quiet", NULL, "no progress"),
};
static const option_group_t submit_options = OPTION_GROUP(NULL, rows);

static void begin(void *data)
{
    *(values_t *)data = (values_t){
        .wishes = import_wishes_none(), .overrides = overrides_none(), .master = master_option_default()};
}

static result_t check(const values_t *values)
{
    if (values->strategies && !values->wait)
        return result_fail(RESULT_USAGE, "--strategies needs --wait: the images are put together here");
    if ((values->output.path || values->output.png) && !values->wait)
        return result_fail(RESULT_USAGE,
                           "-o and --png need --wait; without it fetch the image later: lightmill fetch");
    if (values->strategies && values->terms.halves)
        return result_fail(RESULT_USAGE, "--halves and --strategies do not go together");
    if (values->strategies && values->tell.target)
        return result_fail(RESULT_USAGE, "--notify tells of one job, and --strategies makes many");
    return tell_check(&values->tell, values->wait);
}

static void show_upload(void *context, uint64_t done, uint64_t size)
{
    progress_upload(context, done, size);
}

static result_t submit_strategies(const values_t *values, remote_t *remote, const loaded_scene_t *scene)
{
    strategies_t strategies = {.remote = remote,
                               .scene = scene,
                               .terms = values->terms,
                               .output = &values->output,
                               .quiet = values->quiet,
                               .patient = true};
    TRY(strategies_settings(&values->overrides, &scene->blob, &strategies.settings));
    interrupt_catch();
    return strategies_render(&strategies);
}

static result_t submit(const values_t *values, remote_t *remote, const loaded_scene_t *scene)
{
    job_settings_t settings;
    TRY(overrides_apply(&values->overrides, &scene->blob, &settings));
    if (values->wait) TRY(output_check_saves(&values->output, &settings.save_at));
    progress_t progress = progress_start(values->quiet);
    result_t result = remote_put_blob(remote, &scene->blob, show_upload, &progress);
    progress_end(&progress);
    TRY(result);
    uint64_t job;
    job_terms_t terms = values->terms;
    snprintf(terms.name, sizeof terms.name, "%s", values->name ? values->name : scene->name);
    TRY(remote_submit_job(remote, &terms, &settings, &scene->blob.hash, &job));
    printf("%" PRIu64 "\n", job);
    fflush(stdout);
    return values->wait ? watch_to_end(remote, job, &values->output, true, &values->tell, values->quiet)
                        : result_ok();
}

static result_t run(const call_t *call)
{
    values_t *values = call->values;
    TRY(check(values));
    log_init("lightmill", values->quiet ? LOG_ERROR : LOG_WARNING);
    loaded_scene_t scene;
    TRY(scene_load(call->arguments[0], &values->wishes, &scene));
    settings_tell_cut(&values->overrides, &scene.blob);
    output_name(&values->output, scene.name, values->strategies);
    remote_t *remote = NULL;
    result_t result = values->wait ? output_check(&values->output) : result_ok();
    if (result.code == RESULT_OK) result = master_connect(&values->master, &remote);
    if (result.code == RESULT_OK)
        result = (values->strategies ? submit_strategies : submit)(values, remote, &scene);
    remote_close(&remote);
    output_free(&values->output);
    scene_free(&scene);
    return result;
}

const command_t submit_command = {
    .name = "lightmill submit",
    .arguments = "SCENE",
    .summary = "hand a scene to a master; with --wait also fetch the image",
    .about = "Sends a scene (a .pbrt, .gltf, .glb, .obj or .xml file, a folder with a scene.pbrt, or a scene "
             "blob) to a master and prints the job's number.",
    .groups = {{&submit_options, 0},
               {&output_options, offsetof(values_t, output)},
               {&tell_options, offsetof(values_t, tell)},
               {&scene_options, offsetof(values_t, wishes)},
               {&settings_options, offsetof(values_t, overrides)},
               MASTER_GROUPS(values_t, master)},
    .size = sizeof(values_t),
    .begin = begin,
    .run = run};
