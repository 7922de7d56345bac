/* orders: the commands that tell a master what is to be done with its jobs: cancel, pause, resume, retain,
 * release, delete, priority, change, take-out, extend. */
#include "client/commands/commands.h"
#include "client/farm/master_option.h"
#include "client/farm/watch.h"
#include "client/scene/settings.h"

#include <string.h>

/* Sends one order. */
static result_t send_order(const master_option_t *master, const job_order_t *order)
{
    remote_t *remote;
    TRY(master_connect(master, &remote));
    result_t result = remote_order(remote, order);
    remote_close(&remote);
    return result;
}

/* ---- one word, many jobs ------------------------------------------------------------------------------- */

static result_t order_jobs(remote_t *remote, order_kind_t kind, const call_t *call)
{
    result_t first = result_ok();
    for (int i = 0; i < call->count && first.code != RESULT_UNREACHABLE; i++) {
        job_order_t order = {.kind = kind};
        job_number_parse(call->arguments[i], &order.job);
        result_t result = remote_order(remote, &order);
        if (result.code == RESULT_OK) continue;
        if (first.code == RESULT_OK)
            first = result;
        else
            log_error("%s", result.message);
    }
    return first;
}

static result_t run_order(order_kind_t kind, const call_t *call)
{
    uint64_t job;
    for (int i = 0; i < call->count; i++) TRY(job_number_parse(call->arguments[i], &job));
    remote_t *remote;
    TRY(master_connect(call->values, &remote));
    result_t result = order_jobs(remote, kind, call);
    remote_close(&remote);
    return result;
}

#define ORDER_COMMAND(word, kind, summary_, about_)                                                          \
    static result_t run_##word(const call_t *call)                                                           \
    {                                                                                                        \
        return run_order(kind, call);                                                                        \
    }                                                                                                        \
    const command_t word##_command = {                                                                       \
        .name = "lightmill " #word,                                                                          \
        .arguments = "JOB...",                                                                               \
        .summary = summary_,                                                                                 \
        .about = about_,                                                                                     \
        .groups = {{&master_options, 0}, {&dial_options, offsetof(master_option_t, dial)}},                  \
        .size = sizeof(master_option_t),                                                                     \
        .begin = master_option_begin,                                                                        \
        .run = run_##word}

ORDER_COMMAND(
    cancel, ORDER_CANCEL, "end jobs; the images so far stay",
    "Ends jobs. What their workers have finished is still counted, and the image so far is written. "
    "lightmill extend goes on with a job that was cancelled.");
ORDER_COMMAND(pause, ORDER_PAUSE, "hand out no more of jobs until they are resumed",
              "Hands out no more of the jobs until they are resumed. What their workers have finished is "
              "counted; time that they are paused does not count for --time.");
ORDER_COMMAND(resume, ORDER_RESUME, "go on with jobs that were paused",
              "Goes on with jobs that were paused.");
ORDER_COMMAND(retain, ORDER_RETAIN, "keep jobs until they are deleted",
              "Keeps jobs until they are deleted: when the master needs room for new ones, it forgets the "
              "oldest of those that are over and not retained, with their films and images.");
ORDER_COMMAND(release, ORDER_RELEASE, "take back retain", "Takes back lightmill retain.");
ORDER_COMMAND(delete, ORDER_DELETE, "remove jobs that are over, with their images",
              "Removes jobs that are over (cancel them first), with their films and images on the master.");

/* ---- priority ------------------------------------------------------------------------------------------ */

static result_t run_priority(const call_t *call)
{
    static const option_t range = {.name = "priority", OPTION_RANGE(-JOB_MAX_PRIORITY, JOB_MAX_PRIORITY)};
    job_order_t order = {.kind = ORDER_PRIORITY};
    TRY(job_number_parse(call->arguments[0], &order.job));
    TRY(option_int32(&range, call->arguments[1], &order.priority));
    return send_order(call->values, &order);
}

const command_t priority_command = {
    .name = "lightmill priority",
    .arguments = "JOB N",
    .summary = "let jobs of a higher priority go first",
    .about =
        "Gives a job its priority: jobs of a higher one go first, jobs of the same one share the workers. "
        "New jobs have 0; N is from -1000 to 1000.",
    .groups = {{&master_options, 0}, {&dial_options, offsetof(master_option_t, dial)}},
    .size = sizeof(master_option_t),
    .begin = master_option_begin,
    .run = run_priority};
static_assert(JOB_MAX_PRIORITY == 1000, "the help of priority names the range");

/* ---- change -------------------------------------------------------------------------------------------- */

typedef struct {
    master_option_t master;
    bool mixed, rebind;
} change_t;

static const option_t change_rows[] = {
    OPTION(change_t, mixed, "mixed", NULL, "machines of all kinds may work on it from now on"),
    OPTION(change_t, rebind, "rebind", NULL,
           "the kind of machines that has most threads now goes on with it"),
};
static const option_group_t change_options = OPTION_GROUP(NULL, change_rows);

static result_t run_change(const call_t *call)
{
    const change_t *values = call->values;
    job_order_t order = {.kind = values->mixed ? ORDER_MIXED : ORDER_REBIND};
    TRY(job_number_parse(call->arguments[0], &order.job));
    if (values->mixed == values->rebind)
        return result_fail(RESULT_USAGE, "say what is to change: --mixed or --rebind");
    return send_order(&values->master, &order);
}

const command_t change_command = {
    .name = "lightmill change",
    .arguments = "JOB",
    .summary = "let other kinds of machines go on with a job",
    .about =
        "A job belongs to the machines that make the same bits as its first batch did, and waits for them "
        "when they leave. After an upgrade of the workers, say, it can go on with others: with those that "
        "have most threads now (--rebind), or with all (--mixed). What was counted stays. The last bits of "
        "the image then depend on which machine rendered what, and the job's message says so.",
    .groups = {{&change_options, 0}, MASTER_GROUPS(change_t, master)},
    .size = sizeof(change_t),
    .begin = master_option_begin, /* the first member */
    .run = run_change};

/* ---- take-out ------------------------------------------------------------------------------------------ */

typedef struct {
    master_option_t master;
    const char *job; /* NULL: all */
} take_out_t;

static const option_t take_out_rows[] = {
    OPTION(take_out_t, job, "job", "N", "out of this job alone (default: of all that are not over)"),
};
static const option_group_t take_out_options = OPTION_GROUP(NULL, take_out_rows);

static result_t run_take_out(const call_t *call)
{
    const take_out_t *values = call->values;
    job_order_t order = {.kind = ORDER_TAKE_OUT};
    if (values->job != NULL) TRY(job_number_parse(values->job, &order.job));
    if (call->arguments[0][0] == '\0' || strlen(call->arguments[0]) >= sizeof order.who)
        return result_fail(RESULT_USAGE, "this is no key, address or name of a worker: %s",
                           call->arguments[0]);
    snprintf(order.who, sizeof order.who, "%s", call->arguments[0]);
    return send_order(&values->master, &order);
}

const command_t take_out_command = {
    .name = "lightmill take-out",
    .arguments = "WHO",
    .summary = "take out of jobs what somebody delivered",
    .about =
        "Takes out of jobs all that somebody delivered to them, exactly, and has it rendered again. WHO is a "
        "public key or its name on the master's list, the address of a machine, or the name of a worker, as "
        "lightmill status --workers shows them. Only jobs of submit --verify can do it, until they are over: "
        "they keep what was delivered. Who is connected goes on delivering: lightmill exclude its key first.",
    .groups = {{&take_out_options, 0}, MASTER_GROUPS(take_out_t, master)},
    .size = sizeof(take_out_t),
    .begin = master_option_begin, /* the first member */
    .run = run_take_out};

/* ---- extend -------------------------------------------------------------------------------------------- */

typedef struct {
    master_option_t master;
    output_t output;
    tell_t tell;
    job_order_t order;
    bool wait, quiet;
} extend_t;

static const option_t extend_rows[] = {
    OPTION(extend_t, order.spp, "spp", "N", "samples a pixel in all", OPTION_RANGE(1, JOB_MAX_SPP)),
    OPTION_BY(option_error, extend_t, order.error, "error", "E",
              "until the estimated relative error is at most E (0.01 or 1%)"),
    OPTION(extend_t, order.time_limit, "time", "SECONDS", "for so long from now", OPTION_RANGE(0.1, 1e9)),
    OPTION(extend_t, wait, "wait", NULL, "wait for the end of the job, and fetch its image (needs -o)"),
    OPTION(extend_t, quiet, "quiet", NULL, "no progress"),
};
static const option_group_t extend_options = OPTION_GROUP(NULL, extend_rows);

static result_t run_extend(const call_t *call)
{
    extend_t *values = call->values;
    values->order.kind = ORDER_EXTEND;
    TRY(job_number_parse(call->arguments[0], &values->order.job));
    if (values->wait != (values->output.path != NULL) || (values->output.png && !values->wait))
        return result_fail(RESULT_USAGE, "--wait and -o FILE belong together; fetch gets an image later");
    TRY(tell_check(&values->tell, values->wait));
    if (!values->wait) return send_order(&values->master, &values->order);
    TRY(output_check(&values->output));
    remote_t *remote;
    TRY(master_connect(&values->master, &remote));
    result_t result = remote_order(remote, &values->order);
    if (result.code == RESULT_OK)
        result =
            watch_to_end(remote, values->order.job, &values->output, false, &values->tell, values->quiet);
    remote_close(&remote);
    return result;
}

const command_t extend_command = {
    .name = "lightmill extend",
    .arguments = "JOB",
    .summary = "go on with a job that is over, for more samples",
    .about =
        "Goes on with a job: one that is over with the samples that it has, one that runs with other goals. "
        "When you extend a job, a goal that it has reached is dropped; set a new one. A job that was "
        "cancelled or has failed goes on to its old goals if you set none.\n\n"
        "The image is the one that a job with these goals from the start would have made, bit by bit, if it "
        "goes by --spp.",
    .groups = {{&extend_options, 0},
               {&output_options, offsetof(extend_t, output)},
               {&tell_options, offsetof(extend_t, tell)},
               MASTER_GROUPS(extend_t, master)},
    .size = sizeof(extend_t),
    .begin = master_option_begin, /* the first member */
    .run = run_extend};
