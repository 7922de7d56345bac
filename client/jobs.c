/* jobs: the commands on jobs that a master already has: status, fetch, cancel. */
#include "client/commands.h"
#include "client/master_option.h"
#include "client/options.h"
#include "client/output.h"
#include "client/progress.h"
#include "client/watch.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    uint64_t job; /* 0: none given */
    master_option_t master;
    output_t output;
    bool json, help;
} command_t;

static const struct option status_options[] = {
    MASTER_OPTIONS, {"json", no_argument, NULL, 0}, {"help", no_argument, NULL, 0}, {NULL, 0, NULL, 0}};
static const struct option fetch_options[] = {
    MASTER_OPTIONS, OUTPUT_OPTIONS, {"help", no_argument, NULL, 0}, {NULL, 0, NULL, 0}};
static const struct option cancel_options[] = {
    MASTER_OPTIONS, {"help", no_argument, NULL, 0}, {NULL, 0, NULL, 0}};

static result_t parse_option(command_t *command, const char *option, const char *value)
{
    bool taken;
    TRY(master_option(&command->master, option, value, &taken));
    if (!taken) TRY(output_option(&command->output, option, value, &taken));
    if (taken) return result_ok();
    if (strcmp(option, "json") == 0)
        command->json = true;
    else
        command->help = true;
    return result_ok();
}

static result_t parse_arguments(int argc, char **argv, const struct option *options,
                                const char *short_options, bool needs_job, command_t *command)
{
    *command = (command_t){.master = master_option_default()};
    int index = 0, found;
    while ((found = getopt_long(argc, argv, short_options, options, &index)) != -1) {
        if (found == '?') return result_fail(RESULT_USAGE, "see lightmill %s --help", argv[0]);
        TRY(parse_option(command, found == 'o' ? "output" : options[index].name, optarg));
        if (command->help) return result_ok();
    }
    if (argc - optind > 1 || (needs_job && argc - optind == 0))
        return result_fail(RESULT_USAGE, "%s takes one job's number; see lightmill status", argv[0]);
    if (optind < argc) TRY(option_job(argv[optind], &command->job));
    log_init("lightmill", LOG_WARNING);
    return result_ok();
}

/* ---- status ------------------------------------------------------------------------------------------- */

static void print_json_string(const char *text)
{
    putchar('"');
    for (const unsigned char *c = (const unsigned char *)text; *c; c++) {
        if (*c == '"' || *c == '\\')
            printf("\\%c", *c);
        else if (*c < 0x20)
            printf("\\u%04x", *c);
        else
            putchar(*c);
    }
    putchar('"');
}

static void print_json_settings(const Lm__Settings *settings)
{
    printf(
        ", \"integrator\": \"%s\", \"sampler\": \"%s\", \"seed\": %" PRIu64 ", \"width\": %u, \"height\": %u",
        integrator_name((integrator_t)settings->integrator), sampler_name((sampler_kind_t)settings->sampler),
        settings->seed, settings->width, settings->height);
    printf(", \"max_depth\": %u, \"spp\": %u, \"time_limit\": %g, \"layers\": %s", settings->max_depth,
           settings->spp, settings->time_limit, settings->features ? "true" : "false");
    if (settings->strategy_t > 0)
        printf(", \"strategy_s\": %u, \"strategy_t\": %u, \"unweighted\": %s", settings->strategy_s,
               settings->strategy_t, settings->unweighted ? "true" : "false");
}

static void print_json_counts(const Lm__Counts *counts)
{
    printf(", \"light_paths\": %" PRIu64 ", \"dropped\": %" PRIu64 ", \"overflows\": %" PRIu64
           ", \"rays\": %" PRIu64 ", \"cpu_seconds\": %.6f",
           counts->light_paths_even + counts->light_paths_odd, counts->dropped, counts->overflows,
           counts->rays, 1e-6 * (double)counts->cpu_us);
}

static void print_json_job(const Lm__JobStatus *job)
{
    hash_t hash;
    char hex[2 * HASH_BYTES + 1] = "";
    if (wire_hash_get(&job->blob, &hash)) hash_to_hex(&hash, hex);
    printf("    {\"job\": %" PRIu64 ", \"name\": ", job->job);
    print_json_string(job->name);
    printf(", \"state\": \"%s\", \"scene\": \"%s\"", job_state_name(job->state), hex);
    printf(", \"samples_done\": %" PRIu64 ", \"samples_total\": %" PRIu64
           ", \"elapsed\": %.3f, \"remaining\": %.3f",
           job->samples_done, job->samples_total, job->elapsed, job->remaining);
    printf(", \"workers\": %u, \"workers_seen\": %u, \"bytes_received\": %" PRIu64 ", \"batches\": %" PRIu64
           ", \"batches_refused\": %" PRIu64 ", \"units_reissued\": %" PRIu64,
           job->workers, job->workers_seen, job->bytes_received, job->batches, job->batches_refused,
           job->units_reissued);
    if (job->settings) print_json_settings(job->settings);
    if (job->counts) print_json_counts(job->counts);
    printf(", \"message\": ");
    print_json_string(job->message);
    printf("}");
}

static void print_json(const Lm__JobStatusReply *reply)
{
    printf("{\n  \"workers\": %u,\n  \"jobs\": [", reply->workers);
    for (size_t i = 0; i < reply->n_jobs; i++) {
        printf(i ? ",\n" : "\n");
        print_json_job(reply->jobs[i]);
    }
    printf("%s]\n}\n", reply->n_jobs ? "\n  " : "");
}

static void print_row(const Lm__JobStatus *job)
{
    char elapsed[32], remaining[32] = "-", samples[32];
    format_duration(job->elapsed, elapsed);
    format_count((double)job->samples_done, samples);
    if (job->state == JOB_RUNNING) format_duration(job->remaining, remaining);
    printf("%6" PRIu64 "  %-20.20s  %-9s  %3.0f%%  %9s  %10s  %9s  %7u  %8.1f MB\n", job->job, job->name,
           job_state_name(job->state), 100 * job_fraction(job), samples, elapsed, remaining, job->workers,
           1e-6 * (double)job->bytes_received);
    if (job->message[0]) printf("        %s\n", job->message);
}

static void print_table(const Lm__JobStatusReply *reply)
{
    printf("%u worker%s connected, %zu job%s\n", reply->workers, reply->workers == 1 ? "" : "s",
           reply->n_jobs, reply->n_jobs == 1 ? "" : "s");
    if (reply->n_jobs == 0) return;
    printf("%6s  %-20s  %-9s  %4s  %9s  %10s  %9s  %7s  %11s\n", "job", "name", "state", "done", "samples",
           "time", "left", "workers", "received");
    for (size_t i = 0; i < reply->n_jobs; i++) print_row(reply->jobs[i]);
}

result_t cmd_status(int argc, char **argv)
{
    command_t command;
    TRY(parse_arguments(argc, argv, status_options, "", false, &command));
    if (command.help) {
        printf("usage: lightmill status [JOB] [options]\n\nWhat a master is doing: its workers and jobs.\n\n"
               "  --json             for programs\n%s",
               master_usage);
        return result_ok();
    }
    remote_t *remote;
    TRY(master_connect(&command.master, &remote));
    wire_message_t message;
    result_t result = remote_status(remote, command.job, &message);
    if (result.code == RESULT_OK) {
        const Lm__JobStatusReply *reply = message.envelope->job_status_reply;
        if (command.json)
            print_json(reply);
        else
            print_table(reply);
        wire_free(&message);
    }
    remote_close(&remote);
    return result;
}

/* ---- fetch -------------------------------------------------------------------------------------------- */

static result_t fetch(const command_t *command, remote_t *remote)
{
    progress_t progress = progress_start(true);
    watch_t watch = {.remote = remote, .job = command->job, .progress = &progress};
    TRY(watch_poll(&watch));
    return watch_deliver(&watch, &command->output, false);
}

result_t cmd_fetch(int argc, char **argv)
{
    command_t command;
    TRY(parse_arguments(argc, argv, fetch_options, "o:", true, &command));
    if (command.help) {
        printf("usage: lightmill fetch JOB -o FILE [options]\n\nThe image of a job so far.\n\n%s%s",
               output_usage, master_usage);
        return result_ok();
    }
    if (command.output.path == NULL) return result_fail(RESULT_USAGE, "fetch needs -o FILE");
    TRY(output_check(&command.output));
    remote_t *remote;
    TRY(master_connect(&command.master, &remote));
    result_t result = fetch(&command, remote);
    remote_close(&remote);
    return result;
}

/* ---- cancel ------------------------------------------------------------------------------------------- */

result_t cmd_cancel(int argc, char **argv)
{
    command_t command;
    TRY(parse_arguments(argc, argv, cancel_options, "", true, &command));
    if (command.help) {
        printf("usage: lightmill cancel JOB [options]\n\nEnds a job; the image so far can still be "
               "fetched.\n\n%s",
               master_usage);
        return result_ok();
    }
    remote_t *remote;
    TRY(master_connect(&command.master, &remote));
    result_t result = remote_cancel(remote, command.job);
    remote_close(&remote);
    return result;
}
