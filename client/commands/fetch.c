/* fetch: the command that gets the image of a job. */
#include "client/commands/commands.h"
#include "client/farm/master_option.h"
#include "client/farm/watch.h"
#include "client/scene/settings.h"

typedef struct {
    master_option_t master; /* first: see begin */
    output_t output;
    tell_t tell;
    bool wait, quiet;
} values_t;

static const option_t rows[] = {
    OPTION(values_t, wait, "wait", NULL, "wait for the end of the job, and show its progress"),
    OPTION(values_t, quiet, "quiet", NULL, "no progress"),
};
static const option_group_t fetch_options = OPTION_GROUP(NULL, rows);

/* The image as it is. */
static result_t fetch_now(const values_t *values, remote_t *remote, uint64_t job)
{
    progress_t progress = progress_start(true);
    watch_t watch = {.remote = remote, .job = job, .progress = &progress};
    TRY(watch_poll(&watch));
    return watch_deliver(&watch, &values->output, values->quiet);
}

static result_t run(const call_t *call)
{
    const values_t *values = call->values;
    uint64_t job;
    TRY(job_number_parse(call->arguments[0], &job));
    if (values->output.path == NULL) return result_fail(RESULT_USAGE, "fetch needs -o FILE");
    TRY(tell_check(&values->tell, values->wait));
    TRY(output_check(&values->output));
    remote_t *remote;
    TRY(master_connect(&values->master, &remote));
    result_t result = values->wait ? watch_to_end(remote, job, &values->output, &values->tell, values->quiet)
                                   : fetch_now(values, remote, job);
    remote_close(&remote);
    return result;
}

const command_t fetch_command = {.name = "lightmill fetch",
                                 .arguments = "JOB",
                                 .summary = "the image of a job so far",
                                 .about = "Writes the image of a job so far to -o FILE.",
                                 .groups = {{&fetch_options, 0},
                                            {&output_options, offsetof(values_t, output)},
                                            {&tell_options, offsetof(values_t, tell)},
                                            MASTER_GROUPS(values_t, master)},
                                 .size = sizeof(values_t),
                                 .begin = master_option_begin,
                                 .run = run};
