/* bench_farm: what a farm costs beside the rendering: seed-hidden at 512 x 512 on a master and one worker,
 * then on a master and two, all of them processes of their own with the usual settings, one render thread a
 * worker.
 *
 * The CPU time of the render threads is the work; all other CPU time of the workers and all of the master's
 * is the farm: protocol, coding, merging, checkpoints, heartbeats. How much faster two workers are than one
 * is measured in samples that the master has counted. A machine does not keep its speed for minutes, so the
 * two farms take turns, and their sums are compared. The factor is given in two: the CPU time of the render
 * threads, which the farm could take from them, and what a CPU second yields, which is the machine's part.
 *
 * usage: bench_farm [SECONDS [TURNS]]      from the top of the tree; of each farm in each turn, 60 and 5 by
 *                                          default
 */
#include "client/farm/remote.h"
#include "client/import/import.h"
#include "tests/sim/processes.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

enum { MAX_WORKERS = 2 };
static const double PATIENCE = 60, WARM_UP = 15; /* seconds; the latter until all are at full speed */

static void check(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "bench_farm: %s\n", result.message);
    exit(result_exit_code(result));
}

typedef struct {
    processes_t processes;
    pid_t master, workers[MAX_WORKERS];
    int worker_count;
    remote_t *remote;
    uint64_t job;
} farm_run_t;

/* Everything that is read from outside, at one moment; or what came between two moments. */
typedef struct {
    double time, samples, bytes, batches;
    double render_cpu, worker_cpu, master_cpu; /* seconds */
} reading_t;

static void start_farm(farm_run_t *run, int workers)
{
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    *run = (farm_run_t){.worker_count = workers};
    check(processes_new(&run->processes));
    int port = process_ports(&run->processes);
    const char *folder = run->processes.folder;
    run->master = process_start(&run->processes, "lightmill-master",
                                mem_printf("--listen 127.0.0.1:%d --data %s/data", port, folder));
    for (int i = 0; i < workers; i++)
        run->workers[i] =
            process_start(&run->processes, "lightmill-worker",
                          mem_printf("127.0.0.1:%d --threads 1 --cache %s/cache-%d", port, folder, i));
    check(import_scene_blob("scenes/seed-hidden/scene.pbrt", NULL, &bytes, &size));
    check(blob_open(bytes, size, &blob));
    job_settings_t settings = blob_default_settings(&blob);
    settings.width = settings.height = 512;
    settings.spp = JOB_MAX_SPP / 2;
    char *endpoint = mem_printf("tcp://127.0.0.1:%d", port);
    check(remote_open(NULL, endpoint, NULL, PATIENCE, &run->remote));
    check(remote_put_blob(run->remote, &blob, NULL, NULL));
    check(remote_submit(run->remote, "bench", &settings, &blob.hash, &run->job));
    free(endpoint);
    free(bytes);
}

static reading_t read_farm(const farm_run_t *run)
{
    wire_message_t message;
    reading_t reading = {0};
    check(remote_status(run->remote, run->job, &message));
    const Lm__JobStatus *status = message.envelope->job_status_reply->jobs[0];
    reading.time = clock_now();
    reading.samples = (double)status->samples_done;
    reading.bytes = (double)status->bytes_received;
    reading.batches = (double)status->batches;
    reading.master_cpu = process_cpu(run->master);
    for (int i = 0; i < run->worker_count; i++) {
        reading.worker_cpu += process_cpu(run->workers[i]);
        reading.render_cpu += process_thread_cpu(run->workers[i], "render");
    }
    wire_free(&message);
    return reading;
}

/* A reading just after a batch was counted, so that what is between two of them is whole batches. */
static reading_t read_after_batch(const farm_run_t *run)
{
    reading_t first = read_farm(run), now = first;
    while (now.batches < first.batches + run->worker_count && now.time < first.time + PATIENCE) {
        usleep(20000);
        now = read_farm(run);
    }
    return now;
}

static void end_farm(farm_run_t *run)
{
    remote_close(&run->remote);
    for (int i = 0; i < run->worker_count; i++)
        check(process_end(&run->processes, run->workers[i], "lightmill-worker"));
    check(process_end(&run->processes, run->master, "lightmill-master"));
    processes_free(&run->processes);
}

static reading_t measure(int workers, double seconds)
{
    farm_run_t run;
    start_farm(&run, workers);
    usleep((useconds_t)(1e6 * WARM_UP));
    reading_t first = read_after_batch(&run);
    usleep((useconds_t)(1e6 * seconds));
    reading_t last = read_after_batch(&run);
    end_farm(&run);
    return (reading_t){.time = last.time - first.time,
                       .samples = last.samples - first.samples,
                       .bytes = last.bytes - first.bytes,
                       .batches = last.batches - first.batches,
                       .render_cpu = last.render_cpu - first.render_cpu,
                       .worker_cpu = last.worker_cpu - first.worker_cpu,
                       .master_cpu = last.master_cpu - first.master_cpu};
}

static void add(reading_t *sum, const reading_t *turn)
{
    sum->time += turn->time;
    sum->samples += turn->samples;
    sum->bytes += turn->bytes;
    sum->batches += turn->batches;
    sum->render_cpu += turn->render_cpu;
    sum->worker_cpu += turn->worker_cpu;
    sum->master_cpu += turn->master_cpu;
}

static void print_costs(int workers, const reading_t *sum)
{
    double rest = sum->worker_cpu - sum->render_cpu;
    printf("%d worker%s, %.0f s: %.0f samples/s; CPU seconds: rendering %.1f, the workers' rest %.2f, master "
           "%.2f; farm / rendering %.2f %%; %.0f batches of %.2f MB\n",
           workers, workers > 1 ? "s" : "", sum->time, sum->samples / sum->time, sum->render_cpu, rest,
           sum->master_cpu, 100 * (rest + sum->master_cpu) / sum->render_cpu, sum->batches,
           1e-6 * sum->bytes / fmax(1, sum->batches));
}

static void print_ratios(const reading_t *one, const reading_t *two)
{
    double samples = two->samples / two->time / (one->samples / one->time);
    double cpu = two->render_cpu / two->time / (one->render_cpu / one->time);
    printf("two workers count %.3f times the samples of one in the same time: their render threads have %.3f "
           "times the CPU time, and a CPU second yields %.3f of what it does with one worker\n",
           samples, cpu, samples / cpu);
    fflush(stdout);
}

int main(int argc, char **argv)
{
    double seconds = argc > 1 ? strtod(argv[1], NULL) : 60;
    int turns = argc > 2 ? atoi(argv[2]) : 5;
    reading_t one = {0}, two = {0};
    log_init("bench_farm", LOG_WARNING);
    for (int turn = 0; turn < turns; turn++) {
        reading_t alone = measure(1, seconds), both = measure(2, seconds);
        print_ratios(&alone, &both);
        add(&one, &alone);
        add(&two, &both);
    }
    printf("all %d turns:\n", turns);
    print_costs(1, &one);
    print_costs(2, &two);
    print_ratios(&one, &two);
    return 0;
}
