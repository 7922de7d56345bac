/* bench_watch: what people who watch cost the farm. A master with its page and two workers render
 * seed-hidden, processes of their own with the usual settings, one render thread a worker. In turns nobody
 * watches, and so many watchers do (tests/sim/watchers.h): they all look at the same job, at the page's own
 * pace, and one in ten of them never reads.
 *
 * What bench_farm calls the farm's overhead is the CPU time of all that is not rendering, as a share of the
 * rendering. Here it is that of the master, with watchers and without, over what the render threads do
 * without. The watching threads' own CPU time is measured too: it is less noisy, since merges and checkpoints
 * are not in it. The watchers are a process of their own, and take their CPU time from the workers, as no
 * browser does; so with watchers less is rendered, and this is not counted.
 */
#include "client/farm/remote.h"
#include "client/import/import.h"
#include "tests/sim/processes.h"
#include "tests/sim/watchers.h"

#include <dirent.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

enum { MAX_WORKERS = 8 };
static const double PATIENCE = 60, WARM_UP = 12, SETTLE = 15; /* seconds */

static void check(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "bench_watch: %s\n", result.message);
    exit(result_exit_code(result));
}

typedef struct {
    int width, height, watchers, turns, workers, sight_width, sight_height;
    uint32_t level;
    double seconds;
} bench_options_t;

/* ---- the watchers' process: one line tells it to begin, another to end -----------------------------------
 */

typedef struct {
    pid_t process;
    int orders, answers; /* pipes */
} crowd_t;

static bool read_whole(int pipe, void *bytes, size_t size)
{
    return read(pipe, bytes, size) == (ssize_t)size;
}

static void crowd_run(int orders, int answers)
{
    watchers_options_t options;
    watchers_t *watchers;
    while (read_whole(orders, &options, sizeof options)) {
        char end;
        check(watchers_start(&options, &watchers));
        bool more = read_whole(orders, &end, 1);
        watched_t seen = watchers_stop(&watchers);
        if (!more || write(answers, &seen, sizeof seen) != sizeof seen) break;
    }
}

/* To be called while this process has one thread. */
static crowd_t crowd_new(void)
{
    int orders[2], answers[2];
    if (pipe(orders) != 0 || pipe(answers) != 0) abort();
    crowd_t crowd = {.process = fork(), .orders = orders[1], .answers = answers[0]};
    if (crowd.process == 0) {
        close(orders[1]);
        close(answers[0]);
        crowd_run(orders[0], answers[1]);
        _exit(0);
    }
    close(orders[0]);
    close(answers[1]);
    return crowd;
}

static void crowd_begin(const crowd_t *crowd, const watchers_options_t *options)
{
    if (write(crowd->orders, options, sizeof *options) != sizeof *options)
        check(result_fail(RESULT_IO, "the watchers are gone"));
}

static watched_t crowd_end(const crowd_t *crowd)
{
    watched_t seen;
    if (write(crowd->orders, "", 1) != 1 || !read_whole(crowd->answers, &seen, sizeof seen))
        check(result_fail(RESULT_IO, "the watchers are gone"));
    return seen;
}

/* ---- the farm ------------------------------------------------------------------------------------------ */

typedef struct {
    processes_t processes;
    pid_t master, workers[MAX_WORKERS];
    remote_t *remote;
    uint64_t job;
    int page;
    http_tokens_t tokens;
} farm_run_t;

static uint64_t submit(remote_t *remote, const bench_options_t *options)
{
    uint8_t *bytes;
    uint64_t size, job;
    scene_blob_t blob;
    check(import_scene_blob("scenes/seed-hidden/scene.pbrt", NULL, &bytes, &size));
    check(blob_open(bytes, size, &blob));
    job_settings_t settings = blob_default_settings(&blob);
    settings.width = options->width;
    settings.height = options->height;
    settings.spp = JOB_MAX_SPP / 2;
    settings.features = false;
    check(remote_put_blob(remote, &blob, NULL, NULL));
    check(remote_submit(remote, "bench", &settings, &blob.hash, &job));
    free(bytes);
    return job;
}

static void start_farm(farm_run_t *run, const bench_options_t *options)
{
    *run = (farm_run_t){0};
    check(processes_new(&run->processes));
    int port = process_ports(&run->processes);
    run->page = process_ports(&run->processes);
    const char *folder = run->processes.folder;
    run->master =
        process_start(&run->processes, "lightmill-master",
                      mem_printf("--listen 127.0.0.1:%d --data %s/data --http %d", port, folder, run->page));
    for (int i = 0; i < options->workers; i++)
        run->workers[i] =
            process_start(&run->processes, "lightmill-worker",
                          mem_printf("127.0.0.1:%d --threads 1 --cache %s/cache-%d", port, folder, i));
    char *endpoint = mem_printf("tcp://127.0.0.1:%d", port), *data = mem_printf("%s/data", folder);
    check(remote_open(NULL, endpoint, NULL, PATIENCE, &run->remote));
    run->job = submit(run->remote, options);
    check(http_tokens_read(data, &run->tokens));
    free(endpoint);
    free(data);
}

static void end_farm(farm_run_t *run, const bench_options_t *options)
{
    remote_close(&run->remote);
    for (int i = 0; i < options->workers; i++)
        check(process_end(&run->processes, run->workers[i], "lightmill-worker"));
    check(process_end(&run->processes, run->master, "lightmill-master"));
    processes_free(&run->processes);
}

/* ---- measuring ----------------------------------------------------------------------------------------- */

/* At one moment, or between two. */
typedef struct {
    double time, batches, samples, render, master, http, events, tiles; /* seconds, CPU seconds */
} reading_t;

/* CPU seconds of a thread whose name begins so; in nanoseconds, unlike /proc/PID/stat. */
static double thread_cpu(pid_t process, const char *name)
{
    char path[64 + NAME_MAX];
    double sum = 0;
    snprintf(path, sizeof path, "/proc/%d/task", (int)process);
    DIR *folder = opendir(path);
    for (struct dirent *entry; folder != NULL && (entry = readdir(folder)) != NULL;) {
        char text[32] = "";
        unsigned long long nanoseconds = 0;
        if (entry->d_name[0] == '.') continue;
        snprintf(path, sizeof path, "/proc/%d/task/%s/comm", (int)process, entry->d_name);
        FILE *file = fopen(path, "r");
        if (file != NULL && fgets(text, sizeof text, file) == NULL) text[0] = '\0';
        if (file != NULL) fclose(file);
        if (strncmp(text, name, strlen(name)) != 0) continue;
        snprintf(path, sizeof path, "/proc/%d/task/%s/schedstat", (int)process, entry->d_name);
        file = fopen(path, "r");
        if (file != NULL && fscanf(file, "%llu", &nanoseconds) == 1) sum += 1e-9 * (double)nanoseconds;
        if (file != NULL) fclose(file);
    }
    if (folder != NULL) closedir(folder);
    return sum;
}

static reading_t read_farm(const farm_run_t *run, const bench_options_t *options)
{
    wire_message_t message;
    check(remote_status(run->remote, run->job, &message));
    reading_t reading = {.time = clock_now(),
                         .batches = (double)message.envelope->job_status_reply->jobs[0]->batches,
                         .samples = (double)message.envelope->job_status_reply->jobs[0]->samples_done,
                         .master = thread_cpu(run->master, ""),
                         .http = thread_cpu(run->master, "MHD"),
                         .events = thread_cpu(run->master, "lm-events"),
                         .tiles = thread_cpu(run->master, "lm-tiles")};
    for (int i = 0; i < options->workers; i++) reading.render += thread_cpu(run->workers[i], "render");
    wire_free(&message);
    return reading;
}

static reading_t measure(const farm_run_t *run, const bench_options_t *options)
{
    reading_t first = read_farm(run, options);
    usleep((useconds_t)(1e6 * options->seconds));
    reading_t last = read_farm(run, options);
    return (reading_t){.time = last.time - first.time,
                       .batches = last.batches - first.batches,
                       .samples = last.samples - first.samples,
                       .render = last.render - first.render,
                       .master = last.master - first.master,
                       .http = last.http - first.http,
                       .events = last.events - first.events,
                       .tiles = last.tiles - first.tiles};
}

static void add(reading_t *sum, const reading_t *turn)
{
    sum->time += turn->time;
    sum->batches += turn->batches;
    sum->samples += turn->samples;
    sum->render += turn->render;
    sum->master += turn->master;
    sum->http += turn->http;
    sum->events += turn->events;
    sum->tiles += turn->tiles;
}

static void print_reading(const char *what, const reading_t *r)
{
    double watching = r->http + r->events + r->tiles;
    printf("%-8s %4.0f s, %3.0f batches; CPU seconds: rendering %.1f (%.0f samples in each), master %.2f, of "
           "it watching %.3f (http "
           "%.3f, events %.3f, tiles %.3f): %.2f %% of a core\n",
           what, r->time, r->batches, r->render, r->samples / fmax(r->render, 1e-3), r->master, watching,
           r->http, r->events, r->tiles, 100 * watching / r->time);
    fflush(stdout);
}

static void print_verdict(const bench_options_t *options, const reading_t *quiet, const reading_t *watched,
                          const watched_t *seen)
{
    double capacity = quiet->render / quiet->time; /* of all render threads, nobody watching */
    double before = quiet->master / quiet->time / capacity,
           after = watched->master / watched->time / capacity;
    double watching = (watched->http + watched->events + watched->tiles) / watched->time;
    double time = watched->time + options->turns * SETTLE;
    printf("%d watchers: master / rendering %.3f %% without, %.3f %% with them: %+.3f points; the watching "
           "threads alone: %.3f points, %.2f %% of a core\n",
           options->watchers, 100 * before, 100 * after, 100 * (after - before), 100 * watching / capacity,
           100 * watching);
    printf(
        "to them: %.2f MB/s, of it tiles %.2f; %.1f requests/s, %.1f pictures/s, %.1f events/s; %llu times "
        "events were lost, %llu refusals\n",
        1e-6 * seen->bytes / time, 1e-6 * seen->tile_bytes / time, (double)seen->requests / time,
        (double)seen->pictures / time, (double)seen->events / time, (unsigned long long)seen->lost,
        (unsigned long long)seen->refused);
}

static void bench(const crowd_t *crowd, const bench_options_t *options)
{
    farm_run_t run;
    reading_t quiet = {0}, watched = {0};
    watched_t seen = {0};
    start_farm(&run, options);
    usleep((useconds_t)(1e6 * WARM_UP));
    watchers_options_t watchers = {.port = run.page,
                                   .job = run.job,
                                   .level = options->level,
                                   .width = options->sight_width,
                                   .height = options->sight_height,
                                   .count = options->watchers,
                                   .deaf = options->watchers / 10};
    memcpy(watchers.token, run.tokens.view, sizeof watchers.token);
    for (int turn = 0; turn < options->turns; turn++) {
        reading_t without = measure(&run, options);
        print_reading("nobody", &without);
        crowd_begin(crowd, &watchers);
        usleep((useconds_t)(1e6 * SETTLE));
        reading_t with = measure(&run, options);
        watched_t turn_seen = crowd_end(crowd);
        print_reading("watched", &with);
        add(&quiet, &without);
        add(&watched, &with);
        seen.bytes += turn_seen.bytes;
        seen.tile_bytes += turn_seen.tile_bytes;
        seen.requests += turn_seen.requests;
        seen.pictures += turn_seen.pictures;
        seen.events += turn_seen.events;
        seen.lost += turn_seen.lost;
        seen.refused += turn_seen.refused;
    }
    print_verdict(options, &quiet, &watched, &seen);
    end_farm(&run, options);
}

/* ---- the command line ---------------------------------------------------------------------------------- */

static const char HELP[] = "bench_watch: what people who watch cost the farm\n"
                           "\n"
                           "usage: bench_watch [options]      from the top of the tree\n"
                           "\n"
                           "  --watchers N           one in ten never reads (100)\n"
                           "  --size WIDTHxHEIGHT    of the image (512x512)\n"
                           "  --level L              that they look at (0)\n"
                           "  --sight WIDTHxHEIGHT   what is in sight, in texels of the level (all)\n"
                           "  --workers N            of one thread each (2)\n"
                           "  --turns N              (2)\n"
                           "  --seconds S            without watchers, and with them, in each turn (40)\n";

static bool set_option(bench_options_t *options, const char *name, const char *value)
{
    if (strcmp(name, "watchers") == 0) options->watchers = atoi(value);
    if (strcmp(name, "level") == 0) options->level = (uint32_t)atoi(value);
    if (strcmp(name, "workers") == 0) options->workers = atoi(value);
    if (strcmp(name, "turns") == 0) options->turns = atoi(value);
    if (strcmp(name, "seconds") == 0) options->seconds = atof(value);
    if (strcmp(name, "size") == 0) return sscanf(value, "%dx%d", &options->width, &options->height) == 2;
    if (strcmp(name, "sight") == 0)
        return sscanf(value, "%dx%d", &options->sight_width, &options->sight_height) == 2;
    return options->watchers > 0 && options->workers > 0 && options->workers <= MAX_WORKERS &&
           options->turns > 0 && options->seconds > 0;
}

int main(int argc, char **argv)
{
    bench_options_t options = {.width = 512,
                               .height = 512,
                               .watchers = 100,
                               .turns = 2,
                               .workers = 2,
                               .sight_width = JOB_MAX_RESOLUTION,
                               .sight_height = JOB_MAX_RESOLUTION,
                               .seconds = 40};
    for (int i = 1; i < argc; i += 2) {
        bool good =
            strncmp(argv[i], "--", 2) == 0 && i + 1 < argc && set_option(&options, argv[i] + 2, argv[i + 1]);
        if (good) continue;
        fputs(HELP, stderr);
        return 1;
    }
    log_init("bench_watch", LOG_WARNING);
    crowd_t crowd = crowd_new();
    bench(&crowd, &options);
    close(crowd.orders);
    waitpid(crowd.process, NULL, 0);
    return 0;
}
