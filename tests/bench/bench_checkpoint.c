/* bench_checkpoint: what a checkpoint costs, and what it costs those who merge meanwhile; the figures of
 * docs/durability.md.
 *
 * The film is filled with sums like those of a render at 1920 x 1080 (or WIDTHxHEIGHT given as an argument)
 * with a few samples a pixel. Files go to $TMPDIR or /tmp. */
#include "master/store/checkpoint.h"

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MERGERS = 2 };

static double draw(uint64_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    return (double)(*state >> 11) * 0x1p-53;
}

static void fill(int64_t *values, size_t count, double share)
{
    uint64_t state = 88172645463325252u + count;
    for (size_t i = 0; i < count; i++) {
        double value = 0;
        for (int sample = 0; sample < 4; sample++)
            if (draw(&state) < share) value += 0.1 * -log(1 - draw(&state));
        values[i] = film_quantise((float)value, FILM_DEFAULT_SCALE);
    }
}

/* A batch of one splat frame, in payloads as they come over the wire. */
static void make_batch(const job_settings_t *settings, batch_t *batch, zmq_msg_t payload[BATCH_PAYLOADS])
{
    batch_init(batch, settings);
    fill(batch_frame(batch, SUM_SPLAT), sum_image_values(settings, SUM_SPLAT), 0.2);
    if (payload_encode(batch, payload).code != RESULT_OK) abort();
}

/* Mergers that go on until they are stopped, and how many batches they managed. */
typedef struct {
    shared_film_t *shared_film;
    const batch_t *batch;
    const zmq_msg_t *payload;
    atomic_bool stop;
    atomic_ulong merged;
} mergers_t;

static void *merge(void *argument)
{
    mergers_t *mergers = argument;
    while (!atomic_load(&mergers->stop)) {
        shared_film_enter(mergers->shared_film);
        result_t result =
            shared_film_merge_payload(mergers->shared_film, mergers->payload, mergers->batch, NULL, 1);
        shared_film_leave(mergers->shared_film);
        if (result.code != RESULT_OK) abort();
        atomic_fetch_add(&mergers->merged, 1);
    }
    return NULL;
}

static result_t write_one(shared_film_t *shared_film, const schedule_t *schedule, checkpoint_info_t *info,
                          const char *path, int threads, checkpoint_cost_t *cost)
{
    schedule_state_t state;
    shared_film_lock(shared_film);
    schedule_save(schedule, &state);
    shared_film_snapshot_t *snapshot = shared_film_snapshot(shared_film);
    shared_film_unlock(shared_film);
    result_t result = checkpoint_write(path, info, &state, snapshot, threads, cost);
    shared_film_snapshot_free(&snapshot);
    schedule_state_free(&state);
    return result;
}

static void report(const char *what, const checkpoint_cost_t *cost, size_t raw)
{
    printf("%-28s %6.1f MB of %6.1f MB, %.2f s, %.2f CPU s: one every %.0f s takes 2%%\n", what,
           1e-6 * (double)cost->bytes, 1e-6 * (double)raw, cost->wall, cost->cpu, 50 * cost->wall);
}

static double merge_rate(mergers_t *mergers, double seconds)
{
    unsigned long before = atomic_load(&mergers->merged);
    double start = clock_now();
    struct timespec time = {.tv_sec = (time_t)seconds};
    nanosleep(&time, NULL);
    return (double)(atomic_load(&mergers->merged) - before) / (clock_now() - start);
}

static void bench_merging(shared_film_t *shared_film, const schedule_t *schedule, checkpoint_info_t *info,
                          const char *path, size_t raw)
{
    batch_t batch;
    zmq_msg_t payload[BATCH_PAYLOADS];
    make_batch(&info->record.settings, &batch, payload);
    mergers_t mergers = {.shared_film = shared_film, .batch = &batch, .payload = payload};
    pthread_t threads[MERGERS];
    for (int i = 0; i < MERGERS; i++) pthread_create(&threads[i], NULL, merge, &mergers);
    double alone = merge_rate(&mergers, 5);
    unsigned long before = atomic_load(&mergers.merged);
    double start = clock_now();
    checkpoint_cost_t cost;
    for (int i = 0; i < 5; i++)
        if (write_one(shared_film, schedule, info, path, 1, &cost).code != RESULT_OK) abort();
    double with = (double)(atomic_load(&mergers.merged) - before) / (clock_now() - start);
    report("while two threads merge", &cost, raw);
    printf("%-28s %.1f batches/s alone, %.1f beside a checkpoint that never ends\n",
           "merging of splat frames", alone, with);
    atomic_store(&mergers.stop, true);
    for (int i = 0; i < MERGERS; i++) pthread_join(threads[i], NULL);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    batch_free(&batch);
}

static void bench_loading(const job_settings_t *settings, const char *path, int threads)
{
    checkpoint_t *checkpoint;
    film_t *film;
    schedule_state_t state;
    double start = clock_now();
    if (checkpoint_open(path, &checkpoint).code != RESULT_OK) abort();
    if (checkpoint_load(checkpoint, settings, threads, &film, &state).code != RESULT_OK) abort();
    printf("loading with %d thread%-12s %.2f s\n", threads, threads == 1 ? "" : "s", clock_now() - start);
    checkpoint_close(&checkpoint);
    film_destroy(&film);
    schedule_state_free(&state);
}

int main(int argc, char **argv)
{
    job_settings_t settings = job_settings_default();
    settings.width = 1920;
    settings.height = 1080;
    settings.learn = false; /* all units may come at once */
    if (argc > 1 && sscanf(argv[1], "%dx%d", &settings.width, &settings.height) != 2) {
        fprintf(stderr, "usage: bench_checkpoint [WIDTHxHEIGHT]\n");
        return 1;
    }
    film_t *film;
    if (film_new(&settings, &film).code != RESULT_OK) return 1;
    size_t values = sum_image_values(&settings, SUM_SPLAT), raw = values * 16 + values / 3 * 4;
    fill(film->sums[SUM_EYE], values, 0.7);
    fill(film->sums[SUM_SPLAT], values, 0.3);
    for (size_t i = 0; i < values / 3; i++) film->samples[i] = 4;
    if (film->sums[SUM_FEATURES] != NULL) {
        raw += values / 6 * FEATURE_VALUES * sizeof(int64_t);
        for (size_t i = 0; i < values / 6 * FEATURE_VALUES; i++)
            film->sums[SUM_FEATURES][i] =
                (int64_t)(i % FEATURE_VALUES) << 30 | (int64_t)(i * 2654435761u & 0xffffff);
    }
    schedule_t *schedule = schedule_new(&settings);
    for (uint32_t t = 0; t < job_tile_count(&settings); t++) {
        unit_t unit = {t, 0, 1};
        if (schedule_accept(schedule, &unit, 1).code != RESULT_OK) return 1;
    }
    shared_film_t *shared_film = shared_film_new(film);
    checkpoint_info_t info = {.record = {.job = 1, .settings = settings, .state = JOB_RUNNING},
                              .generation = 1};
    const char *folder = getenv("TMPDIR");
    char *path = mem_printf("%s/bench-%d.film", folder != NULL ? folder : "/tmp", (int)getpid());
    checkpoint_cost_t cost;
    for (int threads = 1; threads <= 2; threads++) {
        if (write_one(shared_film, schedule, &info, path, threads, &cost).code != RESULT_OK) return 1;
        report(threads == 1 ? "a checkpoint, one thread" : "a checkpoint, two threads", &cost, raw);
    }
    for (int threads = 1; threads <= 2; threads++) bench_loading(&settings, path, threads);
    bench_merging(shared_film, schedule, &info, path, raw);
    unlink(path);
    free(path);
    shared_film_destroy(&shared_film);
    schedule_destroy(&schedule);
    return 0;
}
