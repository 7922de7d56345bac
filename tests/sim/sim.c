/* sim: see sim.h. */
#include "tests/sim/sim.h"

#include "client/remote.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MAX_RELAYS = 16, MAX_ARGUMENTS = 40, MAX_ROWS = 10000 };
static const double PATIENCE = 60; /* seconds, for processes to begin and to end */

typedef struct {
    const sim_options_t *options;
    sim_report_t *report;
    char *folder;
    char *bin;
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

/* ---- processes ----------------------------------------------------------------------------------------- */

/* Two ports in a row that nobody listens on. */
static int free_ports(void)
{
    for (int port = 20000 + (int)getpid() % 20000;; port += 2) {
        int good = 0;
        for (int i = 0; i < 2; i++) {
            struct sockaddr_in address = {.sin_family = AF_INET,
                                          .sin_port = htons((uint16_t)(port + i)),
                                          .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
            int socket_fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
            good += bind(socket_fd, (struct sockaddr *)&address, sizeof address) == 0;
            close(socket_fd);
        }
        if (good == 2) return port;
    }
}

/* The folder of our programs: this one is BUILD/tests/FOLDER/NAME. */
static char *program_folder(void)
{
    char path[4000];
    ssize_t length = readlink("/proc/self/exe", path, sizeof path - 1);
    path[length > 0 ? length : 0] = '\0';
    for (int i = 0; i < 3; i++)
        if (strrchr(path, '/') != NULL) *strrchr(path, '/') = '\0';
    return mem_strdup(path);
}

/* Starts a program; `line` has its arguments, separated by spaces. What it writes goes to a file. */
static pid_t start(const sim_t *sim, const char *program, char *line)
{
    char *path = mem_printf("%s/%s", sim->bin, program), *log = mem_printf("%s/%s.log", sim->folder, program);
    char *argv[MAX_ARGUMENTS] = {path}, *save;
    int count = 1;
    for (char *word = strtok_r(line, " ", &save); word != NULL && count + 1 < MAX_ARGUMENTS;
         word = strtok_r(NULL, " ", &save))
        argv[count++] = word;
    int file = open(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    pid_t process = fork();
    if (process == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        dup2(file, STDOUT_FILENO);
        dup2(file, STDERR_FILENO);
        execv(path, argv);
        _exit(127);
    }
    close(file);
    free(path);
    free(log);
    free(line);
    return process;
}

/* Ends a process kindly; what it had to say is copied to stderr unless it ends well. */
static result_t end_process(const sim_t *sim, pid_t process, const char *program)
{
    int status = 0;
    pid_t ended = 0;
    if (process <= 0) return result_ok();
    kill(process, SIGTERM);
    for (double deadline = clock_now() + PATIENCE; ended == 0 && clock_now() < deadline; usleep(10000))
        ended = waitpid(process, &status, WNOHANG);
    if (ended == process && WIFEXITED(status) && WEXITSTATUS(status) == 0) return result_ok();
    if (ended == 0) {
        kill(process, SIGKILL);
        waitpid(process, &status, 0);
    }
    char *path = mem_printf("%s/%s.log", sim->folder, program);
    uint8_t *text;
    size_t size;
    if (file_read(path, 1 << 24, &text, &size).code == RESULT_OK) {
        fwrite(text, 1, size, stderr);
        free(text);
    }
    free(path);
    return result_fail(RESULT_IO, "%s ended badly (status %d)", program, status);
}

/* Every worker has two connections. */
static void raise_file_limit(void)
{
    struct rlimit limit;
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_NOFILE, &limit);
}

/* Bytes of memory in use. */
static double process_memory(pid_t process)
{
    char *path = mem_printf("/proc/%d/statm", (int)process);
    FILE *file = fopen(path, "r");
    unsigned long size, resident = 0;
    if (file == NULL || fscanf(file, "%lu %lu", &size, &resident) != 2) resident = 0;
    if (file != NULL) fclose(file);
    free(path);
    return (double)resident * (double)sysconf(_SC_PAGESIZE);
}

/* CPU seconds so far. */
static double process_cpu(pid_t process)
{
    char *path = mem_printf("/proc/%d/stat", (int)process), text[1000] = "";
    FILE *file = fopen(path, "r");
    unsigned long user = 0, system = 0;
    if (file != NULL && fgets(text, sizeof text, file) != NULL && strrchr(text, ')') != NULL &&
        sscanf(strrchr(text, ')') + 1, " %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user,
               &system) != 2)
        user = system = 0;
    if (file != NULL) fclose(file);
    free(path);
    return (double)(user + system) / (double)sysconf(_SC_CLK_TCK);
}

/* ---- setting up ---------------------------------------------------------------------------------------- */

static result_t make_folder(sim_t *sim)
{
    const char *base = getenv("TMPDIR");
    sim->folder = mem_printf("%s/lightmill-sim-XXXXXX", base != NULL && base[0] != '\0' ? base : "/tmp");
    if (mkdtemp(sim->folder) != NULL) return result_ok();
    return result_fail(RESULT_IO, "cannot make the folder %s: %s", sim->folder, strerror(errno));
}

static void start_master(sim_t *sim)
{
    const sim_options_t *options = sim->options;
    sim->master_port = free_ports();
    char *memory = options->batch_megabytes > 0
                       ? mem_printf("--batch-memory %g", 1e-3 * options->batch_megabytes)
                       : mem_strdup("");
    sim->master = start(sim, "lightmill-master",
                        mem_printf("--listen 127.0.0.1:%d --data %s/data --batch-interval %g %s %s",
                                   sim->master_port, sim->folder, options->interval, memory,
                                   options->master != NULL ? options->master : ""));
    free(memory);
}

static void start_relays(sim_t *sim)
{
    sim->ports[0] = sim->master_port;
    for (int i = 0; i < sim->options->relays; i++) {
        sim->ports[i] = free_ports();
        sim->relays[i] =
            start(sim, "lightmill-relay",
                  mem_printf("--master 127.0.0.1:%d --listen 127.0.0.1:%d", sim->master_port, sim->ports[i]));
        usleep(300000); /* the next one looks for other ports */
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
    TRY(make_folder(sim));
    raise_file_limit();
    sim->bin = program_folder();
    TRY(prepared_new(options->scene, options->width, options->height,
                     fmax(0.05, options->power * options->interval), &sim->prepared));
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

static int remove_entry(const char *path, const struct stat *status, int type, struct FTW *walk)
{
    (void)status, (void)type, (void)walk;
    return remove(path);
}

static result_t tear_down(sim_t *sim)
{
    crowd_report_t last;
    result_t result = result_ok();
    if (sim->crowd != NULL) crowd_stop(&sim->crowd, 0, &last);
    if (sim->remote != NULL) remote_close(&sim->remote);
    for (int i = 0; i < sim->options->relays; i++) {
        result_t ended = end_process(sim, sim->relays[i], "lightmill-relay");
        if (ended.code != RESULT_OK) result = ended;
    }
    result_t ended = end_process(sim, sim->master, "lightmill-master");
    if (ended.code != RESULT_OK) result = ended;
    prepared_destroy(&sim->prepared);
    if (sim->folder != NULL) nftw(sim->folder, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
    free(sim->folder);
    free(sim->bin);
    return result;
}

/* ---- measuring ----------------------------------------------------------------------------------------- */

static double raw_bytes(const sim_t *sim)
{
    return (double)(batch_splat_values(prepared_settings(sim->prepared)) * sizeof(int64_t));
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

static void add(crowd_report_t *sum, const crowd_report_t *row)
{
    crowd_report_t total = *row; /* what is now */
    total.batches += sum->batches;
    total.refused += sum->refused;
    total.units += sum->units;
    total.bytes += sum->bytes;
    total.samples += sum->samples;
    for (int i = 0; i < CROWD_BEATS; i++) total.beats[i] += sum->beats[i];
    total.beat_most = fmax(total.beat_most, sum->beat_most);
    total.intervals += sum->intervals;
    total.interval_sum += sum->interval_sum;
    total.answer_sum += sum->answer_sum;
    total.lost += sum->lost;
    total.failed += sum->failed;
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
    double first_cpu = cpu, first_own = own;
    while (clock_now() - start < options->seconds - 1e-3 && count < MAX_ROWS) {
        let_pass(sim, options->row);
        double now = clock_now(), cpu_now = process_cpu(sim->master), own_now = clock_cpu();
        crowd_report_t row = crowd_report(sim->crowd);
        rows[count] = (row_t){process_memory(sim->master), row.sent + row.waiting};
        print_row(sim, now - start, now - last, &row, rows[count].memory, cpu_now - cpu, own_now - own);
        report->memory_most = fmax(report->memory_most, rows[count].memory);
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

/* Both sides must have counted the same. */
static result_t settle_accounts(sim_t *sim)
{
    crowd_report_t last;
    wire_message_t message;
    crowd_stop(&sim->crowd, PATIENCE, &last);
    sim->report->samples += last.samples;
    TRY(remote_status(sim->remote, sim->job, &message));
    sim->report->samples_counted = message.envelope->job_status_reply->jobs[0]->samples_done;
    wire_free(&message);
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
