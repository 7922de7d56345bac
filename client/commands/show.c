/* show: the command that shows a job of a master in an image viewer, until the job ends. */
#include "client/commands/commands.h"
#include "client/farm/master_option.h"
#include "client/farm/watch.h"
#include "client/scene/settings.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>

typedef struct {
    master_option_t master; /* first: see begin */
    const char *viewer;     /* HOST[:PORT] */
    bool quiet;
} values_t;

/* Seconds without any progress, after the job has ended, before the viewer is given up. */
static const double VIEWER_STALL = 6;

static const option_t rows[] = {
    OPTION(values_t, viewer, "display", "HOST[:PORT]", "the viewer (default: 127.0.0.1:14158)"),
    OPTION(values_t, quiet, "quiet", NULL, "no progress, errors only"),
};
static const option_group_t show_options = OPTION_GROUP(NULL, rows);

static void begin(void *data)
{
    master_option_begin(data);
    ((values_t *)data)->viewer = "127.0.0.1";
}

/* "cornell, job 7": jobs may have the same name, and the viewer's images may not. */
static result_t name_job(remote_t *remote, uint64_t job, char **name)
{
    wire_message_t message;
    TRY(remote_status(remote, job, &message));
    *name = mem_printf("%s, job %" PRIu64, message.envelope->job_status_reply->jobs[0]->name, job);
    wire_free(&message);
    return result_ok();
}

/* The display's thread has a connection of its own. */
static result_t start(const values_t *values, watch_t *watch)
{
    remote_t *remote;
    char *name;
    TRY(name_job(watch->remote, watch->job, &name));
    result_t result = master_connect(&values->master, &remote);
    if (result.code == RESULT_OK) result = display_start(watch->display, remote, watch->job, name);
    free(name);
    return result;
}

static result_t show(const values_t *values, watch_t *watch)
{
    TRY(start(values, watch));
    result_t result = watch_wait(watch);
    progress_end(watch->progress);
    TRY(result);
    if (watch->state == JOB_FAILED) return result_fail(RESULT_LIMIT, "the job failed: %s", watch->message);
    if (watch->samples_done == 0)
        return result_fail(RESULT_CANCELLED, "the job ended before any sample was made; there is no image");
    return display_finish(watch->display, VIEWER_STALL, INFINITY, true);
}

static result_t run(const call_t *call)
{
    const values_t *values = call->values;
    progress_t progress = progress_start(values->quiet);
    watch_t watch = {.progress = &progress, .patient = true};
    log_init("lightmill", values->quiet ? LOG_ERROR : LOG_WARNING);
    TRY(job_number_parse(call->arguments[0], &watch.job));
    TRY(display_open(values->viewer, &watch.display));
    result_t result = master_connect(&values->master, &watch.remote);
    if (result.code == RESULT_OK) result = show(values, &watch);
    display_close(&watch.display);
    remote_close(&watch.remote);
    return result;
}

const command_t show_command = {
    .name = "lightmill show",
    .arguments = "JOB",
    .summary = "show a job in an image viewer as it converges",
    .about =
        "Shows the image of a job, with all its layers, in an image viewer until the job ends: tev, HDRView, "
        "or another that speaks tev's protocol. Only what changed is sent. The viewer may come, go and "
        "come again; a new one gets the whole image. Ctrl-C ends the showing, not the job.",
    .groups = {{&show_options, 0}, MASTER_GROUPS(values_t, master)},
    .size = sizeof(values_t),
    .begin = begin,
    .run = run};
