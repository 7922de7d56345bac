/* sim: see sim.h. */
#include "tests/sim/sim.h"

#include "client/farm/remote.h"
#include "tests/clock.h"
#include "tests/sim/processes.h"

#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

enum { MAX_RELAYS = 16, MAX_ROWS = 10000 };
static const double PATIENCE = 60; /* seconds, for processes to begin and to end */

typedef struct {
    const sim_options_t *options;
    sim_report_t *report;
    processes_t processes;
    prepared_t *prepared;
    pid_t master, relays[MAX_RELAYS];
    int master_port, ports[MAX_RELAYS]; /* control ports: of the master; that the workers dial */
    remote_t *remote;
    uint64_t job;
    crowd_t *crowd;
} sim_t;

/* One line of the table. */
typedef struct {
    double memory, sent;
} row_t;

sim_options_t sim_options_default(void)
{
    return (sim_options_t){.workers = 500,
                           .width = 1920,
                           .height = 1080,
                           .seconds = 180,
                           .interval = 10,
                           .power = 1,
                           .row = 10,
                           .scene = "scenes/seed-hidden/scene.pbrt",
                           .table = stdout};
}

/* Every worker has two connections. */
static void raise_file_limit(void)
{
    struct rlimit limit;
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_NOFILE, &limit);
}

static double relays_cpu(const sim_t *sim)
{
    double sum = 0;
    for (int i = 0; i < sim->options->relays; i++) sum += process_cpu(sim->relays[i]);
    return sum;
}

static double relays_memory(const sim_t *sim)
{
    double most = 0;
    for (int i = 0; i < sim->options->relays; i++) most = fmax(most, process_memory(sim->relays[i]));
    return most;
}

/* ---- setting up ---------------------------------------------------------------------------------------- */

static void start_master(sim_t *sim)
{
    const sim_options_t *options = sim->options;
    sim->master_port = process_ports(&sim->processes);
    char *memory = options->batch_megabytes > 0
                       ? mem_printf("--batch-memory %g", 1e-3 * options->batch_megabytes)
                       : mem_strdup("");
    sim->master = process_start(&sim->processes, "lightmill-master",
                                mem_printf("--listen 127.0.0.1:%d --data %s/data --batch-interval %g %s %s",
                                           sim->master_port, sim->processes.folder, options->interval, memory,
                                           options->master != NULL ? options->master : ""));
    free(memory);
}

static void start_relays(sim_t *sim)
{
    sim->ports[0] = sim->master_port;
    for (int i = 0; i < sim->options->relays; i++) {
        sim->ports[i] = process_ports(&sim->processes);
        sim->relays[i] = process_start(
            &sim->processes, "lightmill-relay",
            mem_printf("127.0.0.1:%d --listen 127.0.0.1:%d --data %s/relay-%d --batch-interval %g",
                       sim->master_port, sim->ports[i], sim->processes.folder, i, sim->options->interval));
    }
}

static result_t submit(sim_t *sim)
{
    char *endpoint = mem_printf("tcp://127.0.0.1:%d", sim->master_port);
    result_t result = remote_open(NULL, endpoint, NULL, PATIENCE, &sim->remote);
    free(endpoint);
    TRY(result);
    TRY(remote_put_blob(sim->remote, prepared_blob(sim->prepared), NULL, NULL));
    return remote_submit(sim->remote, "simulated", prepared_settings(sim->prepared),
                         &prepared_blob(sim->prepared)->hash, &sim->job);
}

static result_t set_up(sim_t *sim)
{
    const sim_options_t *options = sim->options;
    TRY(processes_new(&sim->processes));
    raise_file_limit();
    TRY(prepared_new(options->scene, options->width, options->height,
                     fmax(0.05, options->power * options->interval), !options->no_learn, &sim->prepared));
    start_master(sim);
    start_relays(sim);
    TRY(submit(sim));
    crowd_options_t crowd = {.prepared = sim->prepared,
                             .host = "127.0.0.1",
                             .ports = sim->ports,
                             .port_count = int_max(1, options->relays),
                             .workers = options->workers,
                             .threads = 2,
                             .power = options->power,
                             .spread = options->interval};
    return crowd_start(&crowd, &sim->crowd);
}

static result_t tear_down(sim_t *sim)
{
    crowd_report_t last;
    result_t result = result_ok();
    if (sim->crowd != NULL) crowd_stop(&sim->crowd, 0, &last);
    if (sim->remote != NULL) remote_close(&sim->remote);
    for (int i = 0; i < sim->options->relays; i++) {
        result_t ended = process_end(&sim->processes, sim->relays[i], "lightmill-relay");
        if (ended.code != RESULT_OK) result = ended;
    }
    result_t ended = process_end(&sim->processes, sim->master, "lightmill-master");
    if (ended.code != RESULT_OK) result = ended;
    prepared_destroy(&sim->prepared);
    processes_free(&sim->processes);
    return result;
}

/* ---- measuring ----------------------------------------------------------------------------------------- */

static double raw_bytes(const sim_t *sim)
{
    return (double)(sum_image_values(prepared_settings(sim->prepared), SUM_SPLAT) * sizeof(int64_t));
}

static void print_head(const sim_t *sim)
{
    FILE *table = sim->options->table;
    if (table == NULL) return;
    double seconds = sim->options->power * sim->options->interval;
    fprintf(table,
            "%d workers of %g cores (%.0f samples/s each), %d x %d, a batch every %g s: splats in %.1f %% of "
            "the pixels, %.1f MB; raw %.1f MB\n",
            sim->options->workers, sim->options->power, sim->options->power * prepared_speed(sim->prepared),
            sim->options->width, sim->options->height, sim->options->interval,
            100 * prepared_density(sim->prepared, seconds),
            1e-6 * (double)prepared_bytes(sim->prepared, seconds), 1e-6 * raw_bytes(sim));
    fprintf(
        table,
        "  time joined  batches/s  raw GB/s  wire MB/s  master MB  cores  (sim)  heartbeat ms: half   99 %%"
        "   most  offers  sent  idle  interval s  answer s  refused\n");
    fflush(table);
}

static void print_row(const sim_t *sim, double time, double seconds, const crowd_report_t *report,
                      double memory, double cpu, double own)
{
    FILE *table = sim->options->table;
    double batches = (double)report->batches;
    if (table == NULL) return;
    fprintf(table,
            "%6.0f %6d %10.1f %9.2f %10.1f %10.0f %6.2f %6.2f %19.2f %6.1f %6.0f %7d %5d %5d %11.1f %9.2f "
            "%8llu\n",
            time, report->joined, batches / seconds, 1e-9 * batches * raw_bytes(sim) / seconds,
            1e-6 * (double)report->bytes / seconds, 1e-6 * memory, cpu / seconds, own / seconds,
            1e3 * crowd_beat(report, 0.5), 1e3 * crowd_beat(report, 0.99), 1e3 * report->beat_most,
            report->waiting, report->sent, report->idle,
            report->intervals > 0 ? report->interval_sum / (double)report->intervals : 0,
            batches > 0 ? report->answer_sum / batches : 0,
            (unsigned long long)(report->refused + report->lost + report->failed));
    fflush(table);
}

/* Adds what happened; of what is now the last row tells. */
static void add(crowd_report_t *sum, const crowd_report_t *row)
{
    crowd_report_t total = *row;
    crowd_report_add(&total, sum);
    *sum = total;
}

/* Lets `seconds` pass; with pause_merging the master is stopped for a second of every four. */
static void let_pass(const sim_t *sim, double seconds)
{
    for (double end = clock_now() + seconds; clock_now() < end;) {
        usleep((unsigned)(1e6 * fmax(0, fmin(end - clock_now(), 3))));
        if (!sim->options->pause_merging) continue;
        kill(sim->master, SIGSTOP);
        usleep(1000000);
        kill(sim->master, SIGCONT);
    }
}

static void wait_for_crowd(sim_t *sim)
{
    double deadline = clock_now() + PATIENCE + 2 * sim->options->interval;
    for (crowd_report_t report = {0};
         (report.joined < sim->options->workers || report.batches == 0) && clock_now() < deadline;) {
        usleep(100000);
        crowd_report_t more = crowd_report(sim->crowd);
        add(&report, &more);
        sim->report->samples += more.samples;
    }
    let_pass(sim, sim->options->interval);
    sim->report->samples += crowd_report(sim->crowd).samples;
}

static double mean(const row_t *rows, int first, int end, bool memory)
{
    double sum = 0;
    for (int i = first; i < end; i++) sum += memory ? rows[i].memory : rows[i].sent;
    return end > first ? sum / (end - first) : 0;
}

static void measure(sim_t *sim)
{
    const sim_options_t *options = sim->options;
    sim_report_t *report = sim->report;
    row_t *rows = mem_zalloc(MAX_ROWS, sizeof *rows);
    int count = 0;
    double start = clock_now(), last = start, cpu = process_cpu(sim->master), own = clock_cpu();
    double first_cpu = cpu, first_own = own, first_relays = relays_cpu(sim);
    while (clock_now() - start < options->seconds - 1e-3 && count < MAX_ROWS) {
        let_pass(sim, options->row);
        double now = clock_now(), cpu_now = process_cpu(sim->master), own_now = clock_cpu();
        crowd_report_t row = crowd_report(sim->crowd);
        rows[count] = (row_t){process_memory(sim->master), row.sent + row.waiting};
        print_row(sim, now - start, now - last, &row, rows[count].memory, cpu_now - cpu, own_now - own);
        report->memory_most = fmax(report->memory_most, rows[count].memory);
        report->relay_memory = fmax(report->relay_memory, relays_memory(sim));
        add(&report->all, &row);
        last = now;
        cpu = cpu_now;
        own = own_now;
        count++;
    }
    double seconds = last - start;
    int third = (count + 2) / 3;
    report->samples += report->all.samples;
    report->batches = (double)report->all.batches / seconds;
    report->raw = report->batches * raw_bytes(sim);
    report->wire = (double)report->all.bytes / seconds;
    report->master_cpu = (cpu - first_cpu) / seconds;
    report->own_cpu = (own - first_own) / seconds;
    report->relay_cpu = (relays_cpu(sim) - first_relays) / seconds;
    report->memory_early = mean(rows, 0, third, true);
    report->memory_late = mean(rows, count - third, count, true);
    report->sent_early = mean(rows, 0, third, false);
    report->sent_late = mean(rows, count - third, count, false);
    report->interval =
        report->all.intervals > 0 ? report->all.interval_sum / (double)report->all.intervals : 0;
    report->beat_median = crowd_beat(&report->all, 0.5);
    report->beat_99 = crowd_beat(&report->all, 0.99);
    report->beat_most = report->all.beat_most;
    free(rows);
}

/* Both sides must have counted the same; what relays hold is on its way for a while. */
static result_t settle_accounts(sim_t *sim)
{
    sim_report_t *report = sim->report;
    crowd_report_t last;
    crowd_stop(&sim->crowd, PATIENCE, &last);
    report->samples += last.samples;
    double deadline = clock_now() + PATIENCE;
    do {
        wire_message_t message;
        TRY(remote_status(sim->remote, sim->job, &message));
        report->samples_counted = message.envelope->job_status_reply->jobs[0]->samples_done;
        wire_free(&message);
        if (report->samples_counted < report->samples) usleep(100000);
    } while (report->samples_counted < report->samples && clock_now() < deadline);
    return result_ok();
}

result_t sim_run(const sim_options_t *options, sim_report_t *report)
{
    sim_t sim = {.options = options, .report = report};
    *report = (sim_report_t){0};
    if (options->relays > MAX_RELAYS) return result_fail(RESULT_USAGE, "at most %d relays", MAX_RELAYS);
    result_t result = set_up(&sim);
    if (result.code == RESULT_OK) {
        print_head(&sim);
        wait_for_crowd(&sim);
        measure(&sim);
        result = settle_accounts(&sim);
    }
    result_t ended = tear_down(&sim);
    return result.code == RESULT_OK ? ended : result;
}
