/* status: the command that says what a master is doing, for people and for programs. */
#include "client/commands/commands.h"
#include "client/farm/master_option.h"
#include "client/scene/settings.h"
#include "client/text/plot.h"
#include "client/text/progress.h"
#include "common/interrupt.h"
#include "common/text/json.h"
#include "common/text/text.h"
#include "proto/wire/status_json.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

#define POLL 0.1 /* seconds: how soon Ctrl-C is noticed */

typedef struct {
    master_option_t master; /* first: see begin */
    bool json, workers, connected, aside;
    const char *only; /* NULL: all */
    double watch;     /* seconds between two reports; 0: one is enough */
} values_t;

static const option_t rows[] = {
    OPTION(values_t, workers, "workers", NULL, "the workers too"),
    OPTION(values_t, connected, "connected", NULL, "of the workers only those that are connected"),
    OPTION(values_t, aside, "aside", NULL, "of the workers only those that get no work, and why"),
    OPTION(values_t, only, "only", "NAME", "of the workers only those with this name, host, address or key"),
    OPTION(values_t, json, "json", NULL, "for programs: one JSON object, {\"workers\": N, \"jobs\": [...]}"),
    OPTION(values_t, watch, "watch", "SECONDS",
           "report again and again, every 2 seconds unless said otherwise, until Ctrl-C; with --json each "
           "report is a line",
           OPTION_RANGE(0.1, 86400), .implied = "2"),
};
static const option_group_t status_options = OPTION_GROUP(NULL, rows);

/* ---- JSON ---------------------------------------------------------------------------------------------- */

static void put_history(json_t *object, const Lm__JobStatus *job)
{
    json_t *list = json_array();
    for (size_t i = 0; i < job->n_history; i++) {
        json_t *point = json_object();
        put_real(point, "elapsed", job->history[i]->elapsed);
        put_count(point, "samples", job->history[i]->samples);
        put_real(point, "error", job->history[i]->error);
        json_array_append_new(list, point);
    }
    json_object_set_new(object, "history", list);
}

/* True when a worker has this name, is on this host, or came with this key. */
static bool is_called(const Lm__WorkerStatus *worker, const char *name)
{
    return wire_worker_is(worker->name, name) || strcmp(name, worker->key) == 0 ||
           strcmp(name, worker->address) == 0;
}

/* True when the worker is one of those that were asked for. */
static bool is_wanted(const values_t *values, const Lm__WorkerStatus *worker)
{
    return (!values->connected || worker->connected) && (!values->aside || worker->aside[0] != '\0') &&
           (values->only == NULL || is_called(worker, values->only));
}

/* `workers` is NULL when they were not asked for, `history` says whether that of the only job was. */
static void print_json(const values_t *values, const Lm__JobStatusReply *jobs, const Lm__WorkerList *workers,
                       bool history)
{
    json_t *root = json_object(), *list = json_array();
    put_count(root, "workers", jobs->workers);
    for (size_t i = 0; i < jobs->n_jobs; i++) json_array_append_new(list, status_json_job(jobs->jobs[i]));
    if (history) put_history(json_array_get(list, 0), jobs->jobs[0]);
    json_object_set_new(root, "jobs", list);
    if (workers != NULL) {
        list = json_array();
        for (size_t i = 0; i < workers->n_workers; i++)
            if (is_wanted(values, workers->workers[i]))
                json_array_append_new(list, status_json_worker(workers->workers[i]));
        json_object_set_new(root, "worker_list", list);
    }
    json_print(root, values->watch > 0 ? 0 : 2, 15);
}

/* ---- for people ---------------------------------------------------------------------------------------- */

static void print_row(const Lm__JobStatus *job)
{
    char elapsed[32], remaining[32] = "-", samples[32], error[16] = "-";
    format_duration(job->elapsed, elapsed);
    format_count((double)job->samples_done, samples);
    if (job->state == JOB_RUNNING) format_duration(job->remaining, remaining);
    if (job->error > 0) snprintf(error, sizeof error, "%.2g%%", 100 * job->error);
    printf("%6" PRIu64 "  ", job->job);
    text_print_cell(job->name, 20);
    printf("  %-9s%c %4d  %3.0f%%  %9s  %6s  %10s  %9s  %7u\n", job_state_name(job->state),
           job->retained ? '*' : ' ', job->terms ? job->terms->priority : 0, floor(100 * job_fraction(job)),
           samples, error, elapsed, remaining, job->workers);
    if (job->message[0] == '\0') return;
    printf("        ");
    text_print(job->message);
    putchar('\n');
}

static void print_jobs(const Lm__JobStatusReply *reply)
{
    printf("%u worker%s connected, %zu job%s\n", reply->workers, reply->workers == 1 ? "" : "s",
           reply->n_jobs, reply->n_jobs == 1 ? "" : "s");
    if (reply->n_jobs == 0) return;
    printf("%6s  %-20s  %-9s  %4s  %4s  %9s  %6s  %10s  %9s  %7s\n", "job", "name", "state", "prio", "done",
           "samples", "error", "time", "left", "workers");
    bool retained = false;
    for (size_t i = 0; i < reply->n_jobs; i++) {
        print_row(reply->jobs[i]);
        retained |= reply->jobs[i]->retained;
    }
    if (retained) printf("* retained: kept until it is deleted\n");
}

static void print_time(const char *what, double seconds)
{
    char text[64];
    time_t whole = (time_t)seconds;
    struct tm parts;
    if (seconds <= 0 || localtime_r(&whole, &parts) == NULL) return;
    strftime(text, sizeof text, "%Y-%m-%d %H:%M:%S", &parts);
    printf("  %-12s %s\n", what, text);
}

static void print_goals(const job_settings_t *settings)
{
    printf("  %-12s", "until");
    const char *separator = " ";
    if (settings->spp < JOB_MAX_SPP) {
        printf("%s%u samples a pixel%s", separator, settings->spp, settings->adaptive ? " in the mean" : "");
        separator = ", or ";
    }
    if (settings->error > 0) {
        printf("%san error of %.3g%%", separator, 100 * settings->error);
        separator = ", or ";
    }
    if (settings->time_limit > 0) {
        printf("%s%.0f seconds of work", separator, settings->time_limit);
        separator = ", or ";
    }
    printf("%s\n", separator[0] == ' ' ? " it is cancelled" : "");
}

/* "images       kept at 16, 64; still to come: 256" */
static void print_images(const save_at_t *save_at, uint32_t saved)
{
    if (save_at->count == 0) return;
    uint32_t kept = 0;
    while (kept < save_at->count && save_at->spp[kept] <= saved) kept++;
    printf("  %-12s", "images");
    for (uint32_t i = 0; i < kept; i++) printf("%s%u", i > 0 ? ", " : " kept at ", save_at->spp[i]);
    for (uint32_t i = kept; i < save_at->count; i++)
        printf("%s%u",
               i > kept   ? ", "
               : kept > 0 ? "; still to come: "
                          : " still to come: ",
               save_at->spp[i]);
    printf(" samples a pixel\n");
}

static void print_account(const Lm__JobStatus *job)
{
    printf("  %-12s issued %" PRIu64 " = counted %" PRIu64 " + returned %" PRIu64 " + out %" PRIu64,
           "samples", job->samples_issued, job->samples_counted, job->samples_returned, job->samples_out);
    if (job->samples_skipped > 0) printf("; left out %" PRIu64, job->samples_skipped);
    putchar('\n');
}

static void print_checks(const Lm__JobStatus *job)
{
    if (job->terms && job->terms->verify > 0)
        printf("  %-12s %.3g%% of the samples; %" PRIu64 " passed, %" PRIu64
               " failed; kept %.2f GB of at most %.3g GB of all jobs\n",
               "verified", 100 * job->terms->verify, job->checks_passed, job->checks_failed,
               1e-9 * (double)job->evidence, 1e-9 * (double)job->evidence_limit);
    hash_t hash;
    char hex[2 * HASH_BYTES + 1];
    if (!wire_hash_get(&job->fingerprint, &hash)) return;
    hash_to_hex(&hash, hex);
    printf("  %-12s %.16s (machines that make the same bits)\n", "fingerprint", hex);
}

/* What the table has no room for. */
static void print_details(const Lm__JobStatus *job)
{
    job_settings_t settings;
    if (job->settings && wire_settings_get(job->settings, &settings).code == RESULT_OK) {
        printf("  %-12s %d x %d, %s, seed %" PRIu64 ", max depth %d\n", "picture", settings.width,
               settings.height, integrator_name(settings.integrator), settings.seed, settings.max_depth);
        print_goals(&settings);
        print_images(&settings.save_at, job->saved);
    }
    print_time("submitted", job->submitted);
    print_time("ended", job->ended);
    print_account(job);
    printf("  %-12s %" PRIu64 " (%" PRIu64 " refused) from %u worker%s, %.1f MB; %" PRIu64
           " units issued again\n",
           "batches", job->batches, job->batches_refused, job->workers_seen,
           job->workers_seen == 1 ? "" : "s", 1e-6 * (double)job->bytes_received, job->units_reissued);
    if (job->checkpoint_age >= 0) printf("  %-12s %.0f s ago\n", "checkpoint", job->checkpoint_age);
    print_checks(job);
}

static int terminal_width(void)
{
    struct winsize size = {0};
    return ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 1 ? size.ws_col - 1 : 79;
}

static void print_plot(const Lm__JobStatus *job)
{
    char *text = plot_error(job, terminal_width());
    if (text != NULL) printf("\n%s", text);
    free(text);
}

static void print_worker(const Lm__WorkerStatus *worker)
{
    char speed[32] = "-", job[24] = "-";
    if (worker->speed > 0) format_count(worker->speed, speed);
    if (worker->job != 0) snprintf(job, sizeof job, "%" PRIu64, worker->job);
    text_print_cell(worker->name, 28);
    printf("  %7u  %6s  %5u  %9s  %7" PRIu64 "  %7" PRIu64 "  %6.1f s  %s%s\n", worker->threads, job,
           worker->units_held, speed, worker->batches, worker->batches_refused, worker->last_seen,
           worker->connected ? "" : "gone", worker->relay ? " relay" : "");
    if (worker->key[0] != '\0' || worker->address[0] != '\0') {
        printf("        %s", worker->key[0] != '\0' ? "key " : "");
        text_print(worker->key);
        printf("%sat ", worker->key[0] != '\0' ? " " : "");
        text_print(worker->address[0] != '\0' ? worker->address : "(in the master)");
        putchar('\n');
    }
    if (worker->aside[0] == '\0') return;
    printf("        gets no work: ");
    text_print(worker->aside);
    putchar('\n');
}

static void print_workers(const values_t *values, const Lm__WorkerList *list)
{
    size_t count = 0;
    for (size_t i = 0; i < list->n_workers; i++) count += is_wanted(values, list->workers[i]);
    if (count == 0) return;
    printf("\n%-28s  %7s  %6s  %5s  %9s  %7s  %7s  %8s\n", "worker", "threads", "job", "units", "samples/s",
           "batches", "refused", "heard of");
    for (size_t i = 0; i < list->n_workers; i++)
        if (is_wanted(values, list->workers[i])) print_worker(list->workers[i]);
}

/* ---- the command --------------------------------------------------------------------------------------- */

/* Where the next report goes: over the last one on a terminal, else below it. */
static void begin_page(void)
{
    static const char home_and_erase[] = "\033[H\033[J";
    if (isatty(STDOUT_FILENO) == 1)
        fputs(home_and_erase, stdout);
    else
        putchar('\n');
}

static void print_report(const values_t *values, uint64_t job, const Lm__JobStatusReply *jobs,
                         const Lm__WorkerList *workers)
{
    if (values->json) {
        print_json(values, jobs, workers, job != 0);
        return;
    }
    if (values->watch > 0) begin_page();
    print_jobs(jobs);
    if (job != 0) print_details(jobs->jobs[0]);
    if (job != 0) print_plot(jobs->jobs[0]);
    if (workers != NULL) print_workers(values, workers);
}

/* Of one job, or of all when `job` is 0. */
static result_t report(const values_t *values, uint64_t job, remote_t *remote)
{
    wire_message_t jobs, workers;
    TRY(job != 0 ? remote_history(remote, job, &jobs) : remote_status(remote, job, &jobs));
    result_t result = values->workers ? remote_workers(remote, &workers) : result_ok();
    if (result.code == RESULT_OK) {
        print_report(values, job, jobs.envelope->job_status_reply,
                     values->workers ? workers.envelope->worker_list : NULL);
        if (values->workers) wire_free(&workers);
    }
    wire_free(&jobs);
    if (fflush(stdout) != 0 && result.code == RESULT_OK)
        return result_fail(RESULT_IO, "cannot write to the standard output: %s", strerror(errno));
    return result;
}

/* Waits, at most until Ctrl-C. */
static void wait_for(double seconds)
{
    for (double end = clock_now() + seconds; clock_now() < end && !interrupt_seen();) {
        double left = fmax(0, fmin(POLL, end - clock_now()));
        nanosleep(&(struct timespec){.tv_nsec = (long)(1e9 * left)}, NULL);
    }
}

/* Reports until Ctrl-C. A master that answered once is waited for when it does not any more. */
static result_t watch(const values_t *values, uint64_t job, remote_t *remote)
{
    bool silent = false;
    interrupt_catch();
    TRY(report(values, job, remote));
    for (;;) {
        wait_for(values->watch);
        if (interrupt_seen()) return result_ok();
        result_t result = report(values, job, remote);
        if (result.code != RESULT_UNREACHABLE) TRY(result);
        if (result.code == RESULT_UNREACHABLE && !silent) log_warning("%s; asking on", result.message);
        if (result.code == RESULT_OK && silent) log_warning("the master is back");
        silent = result.code == RESULT_UNREACHABLE;
    }
}

static result_t run(const call_t *call)
{
    values_t *values = call->values;
    uint64_t job = 0;
    values->workers |= values->connected || values->aside || values->only != NULL;
    if (call->count > 0) TRY(job_number_parse(call->arguments[0], &job));
    remote_t *remote;
    TRY(master_connect(&values->master, &remote));
    result_t result = values->watch > 0 ? watch(values, job, remote) : report(values, job, remote);
    remote_close(&remote);
    return result;
}

const command_t status_command = {.name = "lightmill status",
                                  .arguments = "[JOB]",
                                  .summary = "what a master is doing",
                                  .about =
                                      "What a master is doing: its jobs, or all that is known of one, with a "
                                      "plot of how its error falls.",
                                  .groups = {{&status_options, 0}, MASTER_GROUPS(values_t, master)},
                                  .size = sizeof(values_t),
                                  .begin = master_option_begin,
                                  .run = run};
