/* fetch: the command that gets the image of a job. */
#include "client/commands/commands.h"
#include "client/farm/master_option.h"
#include "client/farm/watch.h"
#include "client/scene/settings.h"

#include <inttypes.h>

typedef struct {
    master_option_t master; /* first: see begin */
    output_t output;
    uint32_t at; /* samples a pixel; 0: the image as it is */
    tell_t tell;
    bool wait, quiet;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, at, "at", "SPP",
           "the image at so many samples a pixel, if the job keeps it: submit --save-at",
           OPTION_RANGE(1, JOB_MAX_SPP)),
    OPTION(values_t, output.halves, "halves", NULL,
           "with the images of its even and of its odd samples, as layers half0 and half1; with --at only if "
           "the job was submitted with --halves"),
    OPTION(values_t, wait, "wait", NULL,
           "wait for the end of the job, or with --at until that image is there, and show the progress"),
    OPTION(values_t, quiet, "quiet", NULL, "no progress"),
};
static const option_group_t fetch_options = OPTION_GROUP(NULL, rows);

/* What there is now. */
static result_t fetch_now(const values_t *values, remote_t *remote, uint64_t job)
{
    progress_t progress = progress_start(true);
    watch_t watch = {.remote = remote, .job = job, .progress = &progress};
    TRY(watch_poll(&watch));
    progress.quiet = values->quiet;
    if (values->at > 0) return watch_deliver_at(&watch, values->at, &values->output, values->quiet);
    return watch_deliver(&watch, &values->output, values->quiet);
}

/* Before the wait, not after it. */
static result_t check_halves(remote_t *remote, uint64_t job)
{
    progress_t progress = progress_start(true);
    watch_t watch = {.remote = remote, .job = job, .progress = &progress};
    TRY(watch_poll(&watch));
    if (watch.halves) return result_ok();
    return result_fail(RESULT_USAGE,
                       "job %" PRIu64
                       " was submitted without --halves, so the images that it keeps on the way "
                       "are without",
                       job);
}

static result_t fetch_later(const values_t *values, remote_t *remote, uint64_t job)
{
    if (values->output.halves && values->at > 0) TRY(check_halves(remote, job));
    if (values->at > 0) return watch_to_milestone(remote, job, values->at, &values->output, values->quiet);
    return watch_to_end(remote, job, &values->output, false, &values->tell, values->quiet);
}

static result_t run(const call_t *call)
{
    const values_t *values = call->values;
    uint64_t job;
    TRY(job_number_parse(call->arguments[0], &job));
    if (values->output.path == NULL) return result_fail(RESULT_USAGE, "fetch needs -o FILE");
    TRY(tell_check(&values->tell, values->wait));
    if (values->at > 0 && values->tell.target != NULL)
        return result_fail(RESULT_USAGE, "--notify tells of the end of a job: use it without --at");
    TRY(output_check(&values->output));
    remote_t *remote;
    TRY(master_connect(&values->master, &remote));
    result_t result = values->wait ? fetch_later(values, remote, job) : fetch_now(values, remote, job);
    remote_close(&remote);
    return result;
}

const command_t fetch_command = {.name = "lightmill fetch",
                                 .arguments = "JOB",
                                 .summary = "the image of a job so far",
                                 .about = "Writes the image of a job so far to -o FILE, or, with --at, one "
                                          "that was kept on the way.",
                                 .groups = {{&fetch_options, 0},
                                            {&output_options, offsetof(values_t, output)},
                                            {&tell_options, offsetof(values_t, tell)},
                                            MASTER_GROUPS(values_t, master)},
                                 .size = sizeof(values_t),
                                 .begin = master_option_begin,
                                 .run = run};
