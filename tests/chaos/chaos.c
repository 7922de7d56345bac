/* chaos: a farm of real processes to which everything happens that happens to farms, and the proof that no
 * sample is lost, none is counted twice, and every image has the bits of an undisturbed render.
 *
 * DESIGN. This program starts a master, workers and a proxy, submits jobs one after the other as a user would
 * (job_list), and lets faults begin and end (faults), until its time is up. Then everything is healed, and
 * the jobs that are open have to complete. The master is reached in four ways: by some workers directly, by
 * some through the proxy, by some through virtual cables of their own, and by the job_list's commands
 * directly, so that what they say is what the master says.
 *
 * Where the system allows, all of it runs in a network and on a small disk of its own, which are gone when
 * the program ends, however it ends. The list of faults follows from the seed; what they hit depends on the
 * moment, so the same seed is the same storm, though not the same wreck. */
#include "tests/chaos/disk.h"
#include "tests/chaos/faults/faults.h"
#include "tests/chaos/jobs/job_list.h"
#include "tests/chaos/process.h"
#include "tests/ports.h"
#include "tests/scratch.h"

#include <errno.h>
#include <getopt.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { LINKS = 2, SITES = 2, RELAY_WORKERS = 2, DISK_MEGABYTES = 192 };
static const char *const LINK_HOSTS[LINKS + 1] = {"127.0.1.1", "127.0.1.2", "127.0.1.3"};
static const double TICK = 0.01;    /* seconds */
static const double STORM = 0.9;    /* of a run's time, until all is healed */
static const double PATIENCE = 240; /* seconds for the open jobs after all is healed */
static const double LEASE = 1.5;    /* seconds */

static const char usage[] =
    "usage: chaos [options]\n"
    "\n"
    "  --seconds N      the whole run; faults begin and jobs are submitted for most of it (600)\n"
    "  --pause SECONDS  between the beginnings of faults, on the average (1.8)\n"
    "  --seed N         of the list of faults and jobs (from the clock)\n"
    "  --folder DIR     where the run makes a folder for logs and data, which stays when something\n"
    "                   went wrong (.)\n"
    "  --keep           it stays in any case\n"
    "  --least N        fail when there were fewer faults (0)\n"
    "  --least-kills N  fail when the master was killed less often (0)\n"
    "  --smaller N      jobs have so many times fewer samples a pixel (1)\n"
    "  --keys, --open   with keys, or open to everybody (with keys when the seed is odd)\n"
    "  --only KINDS     only faults whose names have one of these, with commas between them, in them\n"
    "  --keep-going     do not end at the first violation\n";

typedef struct {
    double seconds, pause;
    uint64_t seed;
    const char *parent, *only;
    size_t least, least_kills;
    unsigned smaller;
    bool keep, keep_going, keys, open;
} options_t;

typedef struct {
    options_t options;
    report_t report;
    char *folder;
    char *data, *master; /* the master's directory and address */
    bool separate, disk;
    network_t *network;
    passes_t passes;
    proxy_t *proxy;
    processes_t processes;
    job_list_t *job_list;
    faults_t *faults;
    unsigned master_starts;
} chaos_t;

static options_t parse_options(int argc, char **argv)
{
    static const struct option list[] = {
        {"seconds", required_argument, NULL, 's'}, {"pause", required_argument, NULL, 'p'},
        {"seed", required_argument, NULL, 'r'},    {"folder", required_argument, NULL, 'f'},
        {"least", required_argument, NULL, 'l'},   {"least-kills", required_argument, NULL, 'k'},
        {"smaller", required_argument, NULL, 'm'}, {"only", required_argument, NULL, 'o'},
        {"keep", no_argument, NULL, 'e'},          {"keys", no_argument, NULL, 'y'},
        {"open", no_argument, NULL, 'n'},          {"keep-going", no_argument, NULL, 'g'},
        {"help", no_argument, NULL, 'h'},          {NULL, 0, NULL, 0}};
    options_t options = {
        .seconds = 600, .pause = 1.8, .seed = (uint64_t)time(NULL) % 1000000, .parent = ".", .smaller = 1};
    for (int found; (found = getopt_long(argc, argv, "", list, NULL)) != -1;) {
        if (found == 's') options.seconds = atof(optarg);
        if (found == 'p') options.pause = atof(optarg);
        if (found == 'r') options.seed = strtoull(optarg, NULL, 10);
        if (found == 'f') options.parent = optarg;
        if (found == 'y') options.keys = true;
        if (found == 'n') options.open = true;
        if (found == 'e') options.keep = true;
        if (found == 'l') options.least = strtoull(optarg, NULL, 10);
        if (found == 'k') options.least_kills = strtoull(optarg, NULL, 10);
        if (found == 'm') options.smaller = (unsigned)strtoul(optarg, NULL, 10);
        if (found == 'o') options.only = optarg;
        if (found == 'g') options.keep_going = true;
        if (options.smaller == 0) found = '?';
        if (found != 'h' && found != '?') continue;
        fputs(usage, found == 'h' ? stdout : stderr);
        exit(found == 'h' ? 0 : RESULT_USAGE);
    }
    return options;
}

/* ---- setting up --------------------------------------------------------------------------------------- */

static void make_folder(const char *path)
{
    if (mkdir(path, 0777) == 0) return;
    perror(path);
    exit(RESULT_IO);
}

/* Says what cannot be done here, and goes on without. */
static bool available(chaos_t *chaos, const char *what, result_t result)
{
    if (result.code == RESULT_OK) return true;
    report_line(&chaos->report, "without %s: %s", what, result.message);
    return false;
}

static void make_passes(chaos_t *chaos)
{
    const options_t *options = &chaos->options;
    bool keys = !options->open && (options->keys || options->seed % 2 == 1);
    chaos->passes = passes_open();
    if (!keys) return;
    char *folder = mem_printf("%s/keys", chaos->folder);
    result_t result = passes_with_keys(folder, &chaos->passes);
    free(folder);
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "chaos: %s\n", result.message);
    exit(RESULT_IO);
}

static void prepare(chaos_t *chaos)
{
    const options_t *options = &chaos->options;
    chaos->folder =
        mem_printf("%s/chaos-%llu-%d", options->parent, (unsigned long long)options->seed, (int)getpid());
    make_folder(chaos->folder);
    chaos->report = report_open(chaos->folder);
    make_passes(chaos);
    report_line(&chaos->report, "seed %llu, %.0f s, %s, in %s", (unsigned long long)options->seed,
                options->seconds, chaos->passes.master[1] ? "with keys" : "open to everybody", chaos->folder);
    chaos->data = mem_printf("%s/data", chaos->folder);
    make_folder(chaos->data);
    chaos->separate = available(chaos, "partitions, thin cables and a full disk", network_separate());
    if (!chaos->separate) return;
    chaos->disk = available(chaos, "a full disk", disk_mount(chaos->data, DISK_MEGABYTES));
    available(chaos, "partitions and thin cables", network_new(SITES, &chaos->network));
}

/* A port that is free with the next one; in a network of our own every one is. */
static int choose_port(const chaos_t *chaos)
{
    return chaos->separate ? PROCESSES_PORT : ports_choose(PROCESSES_RELAY_PORT + 2);
}

/* One worker calls the master directly, two through the proxy, and where there are cables, two through those.
 * Two are behind a relay, which goes through the proxy itself. Two more join late. */
static void start_processes(chaos_t *chaos)
{
    processes_t *processes = &chaos->processes;
    *processes = (processes_t){.report = &chaos->report,
                               .folder = chaos->folder,
                               .data = chaos->data,
                               .listen = chaos->network ? NETWORK_HOST : "127.0.0.1",
                               .port = choose_port(chaos),
                               .lease = LEASE,
                               .passes = &chaos->passes,
                               .worlds = available(chaos, "clock jumps and slow disks", world_available())};
    result_t result = proxy_start(LINK_HOSTS, LINKS + 1, processes->listen, processes->port,
                                  chaos->options.seed, &chaos->proxy);
    if (result.code != RESULT_OK) {
        fprintf(stderr, "chaos: %s\n", result.message);
        exit(RESULT_IO);
    }
    processes_init(processes);
    processes_add_worker(processes, processes->listen, -1, false);
    for (size_t i = 0; i < LINKS; i++) processes_add_worker(processes, LINK_HOSTS[i], -1, false);
    for (size_t i = 0; i < SITES && chaos->network; i++)
        processes_add_worker(processes, NETWORK_HOST, network_site(chaos->network, i), false);
    processes_add_relay(processes, LINK_HOSTS[LINKS - 1]);
    for (size_t i = 0; i < RELAY_WORKERS; i++) processes_add_relay_worker(processes);
    processes_add_worker(processes, processes->listen, -1, true);
    processes_add_worker(processes, LINK_HOSTS[0], -1, true);
}

static void begin(chaos_t *chaos)
{
    prepare(chaos);
    start_processes(chaos);
    chaos->master = mem_printf("%s:%d", chaos->processes.listen, chaos->processes.port);
    chaos->job_list = job_list_new(&(job_list_setup_t){.report = &chaos->report,
                                                       .folder = chaos->folder,
                                                       .master = chaos->master,
                                                       .passes = &chaos->passes,
                                                       .seed = chaos->options.seed,
                                                       .smaller = chaos->options.smaller,
                                                       .at_a_time = 3});
    chaos->faults = faults_new(&(faults_setup_t){.report = &chaos->report,
                                                 .processes = &chaos->processes,
                                                 .proxy = chaos->proxy,
                                                 .links = LINKS,
                                                 .client_host = LINK_HOSTS[LINKS],
                                                 .network = chaos->network,
                                                 .sites = SITES,
                                                 .disk = chaos->disk,
                                                 .folder = chaos->folder,
                                                 .seed = chaos->options.seed,
                                                 .pause = chaos->options.pause,
                                                 .only = chaos->options.only});
}

/* ---- the run ------------------------------------------------------------------------------------------ */

static bool may_go_on(const chaos_t *chaos)
{
    return chaos->report.violations == 0 || chaos->options.keep_going;
}

static void tick(chaos_t *chaos, bool more)
{
    faults_tick(chaos->faults, more, TICK);
    double now = clock_now();
    processes_tick(&chaos->processes, now);
    if (chaos->processes.master.starts != chaos->master_starts) job_list_new_master(chaos->job_list);
    chaos->master_starts = chaos->processes.master.starts;
    job_list_tick(chaos->job_list, now, more);
}

static void run(chaos_t *chaos)
{
    double end = clock_now() + STORM * chaos->options.seconds;
    while (clock_now() < end && may_go_on(chaos)) tick(chaos, true);
    faults_heal(chaos->faults);
    processes_heal(&chaos->processes);
    report_line(&chaos->report, "all is healed; waiting for the open jobs");
    end = clock_now() + PATIENCE;
    while (!job_list_settled(chaos->job_list) && may_go_on(chaos)) {
        tick(chaos, false);
        if (clock_now() < end) continue;
        report_violation(&chaos->report, "jobs have not completed %.0f s after all was healed", PATIENCE);
        break;
    }
}

static void print_sums(chaos_t *chaos)
{
    report_t *report = &chaos->report;
    job_list_sum_t sum = job_list_sum(chaos->job_list);
    faults_print(chaos->faults);
    report_text(report,
                "%6zu  jobs, %zu of them proved: same pixels, the account holds; the slowest took %.0f s",
                sum.submitted, sum.proved, sum.longest);
    report_text(report, "%6u  starts of the master (%u without room), %llu answers of status checked",
                chaos->processes.master.starts, chaos->processes.master_failures,
                (unsigned long long)sum.questions);
    report_text(
        report,
        "%6.2f  million samples issued, %.2f counted: %.1f%% rendered again; %llu batches, %llu refused, "
        "%llu units re-issued",
        1e-6 * (double)sum.issued, 1e-6 * (double)sum.counted,
        sum.counted ? 100 * ((double)sum.issued / (double)sum.counted - 1) : 0,
        (unsigned long long)sum.batches, (unsigned long long)sum.batches_refused,
        (unsigned long long)sum.units_reissued);
}

static void check_numbers(chaos_t *chaos)
{
    size_t faults = faults_count(chaos->faults), kills = faults_master_kills(chaos->faults);
    if (!proxy_alive(chaos->proxy)) report_violation(&chaos->report, "the proxy has died");
    processes_check_logs(&chaos->processes);
    if (chaos->report.violations > 0) return;
    if (faults < chaos->options.least)
        report_violation(&chaos->report, "%zu faults, fewer than %zu", faults, chaos->options.least);
    if (kills < chaos->options.least_kills)
        report_violation(&chaos->report, "the master was killed %zu times, less than %zu", kills,
                         chaos->options.least_kills);
}

/* The data lies on a disk that ends with this process. */
static void keep_evidence(chaos_t *chaos)
{
    char *kept = mem_printf("%s/data-kept", chaos->folder);
    result_t result = chaos->disk ? disk_save(chaos->data, kept) : result_ok();
    if (result.code != RESULT_OK) report_line(&chaos->report, "the data is lost: %s", result.message);
    report_text(&chaos->report,
                "FAILED. Logs and data are in %s. The same faults again: make chaos SEED=%llu", chaos->folder,
                (unsigned long long)chaos->options.seed);
    free(kept);
}

static void end(chaos_t *chaos, bool kept)
{
    job_list_free(&chaos->job_list);
    faults_free(&chaos->faults);
    processes_free(&chaos->processes);
    proxy_stop(&chaos->proxy);
    network_destroy(&chaos->network);
    free(chaos->master);
    passes_free(&chaos->passes);
    report_close(&chaos->report);
    if (chaos->disk) disk_unmount(chaos->data);
    if (!kept) scratch_destroy(&chaos->folder);
    free(chaos->folder);
    free(chaos->data);
}

int main(int argc, char **argv)
{
    chaos_t chaos = {.options = parse_options(argc, argv)};
    signal(SIGPIPE, SIG_IGN);
    begin(&chaos);
    run(&chaos);
    check_numbers(&chaos);
    if (chaos.report.violations > 0) job_list_describe(chaos.job_list);
    print_sums(&chaos);
    size_t violations = chaos.report.violations;
    if (violations > 0)
        keep_evidence(&chaos);
    else
        report_text(&chaos.report, "Nothing was lost, nothing counted twice.");
    end(&chaos, violations > 0 || chaos.options.keep);
    return violations > 0 ? RESULT_MISMATCH : 0;
}
