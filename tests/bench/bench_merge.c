/* bench_merge: how fast a master merges, as a share of what memory allows.
 *
 * Real batches: seed-hidden at 1920 x 1080, what one thread renders in so many CPU seconds (or so many
 * threads in one second), so that the splat frames are as dense as those of smaller and larger workers. Each
 * is merged from its payloads, as they came over the wire, into a shared film with nobody else at it. The raw
 * size of a splat frame is 99.5 MB whatever is in it; the merge rate is raw bytes a CPU second of one core,
 * with the eye tiles of the batch merged as well but not counted. memcpy copies as many bytes in the same
 * run.
 *
 * usage: bench_merge [SCENE [SECONDS...]]      from the top of the tree; by default seed-hidden and CPU
 * seconds of rendering from 0.1 to 30
 */
#include "client/import/import.h"
#include "master/film/shared_film.h"
#include "worker/render/renderer.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { REPEATS = 5, FIRST_SAMPLE = 32, UNIT_SAMPLES = 128 };

static void check(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "bench_merge: %s\n", result.message);
    exit(result_exit_code(result));
}

/* CPU seconds of this thread. */
static double thread_cpu(void)
{
    struct timespec time;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* Renders units from all over the image for so many CPU seconds. */
static batch_t render_batch(const renderer_t *renderer, const job_settings_t *settings, double seconds)
{
    batch_t batch;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    uint32_t tiles = job_tile_count(settings), step = 7919; /* a prime: no tile comes twice in a round */
    double start = thread_cpu();
    batch_init(&batch, settings);
    for (uint32_t i = 0; thread_cpu() - start < seconds; i++) {
        unit_t unit = {(uint32_t)((uint64_t)i * step % tiles), FIRST_SAMPLE + i / tiles * UNIT_SAMPLES,
                       UNIT_SAMPLES};
        renderer_unit(renderer, &unit, &result, &cancel);
        batch_add(&batch, &result);
    }
    unit_result_free(&result);
    return batch;
}

static double splat_share(const batch_t *batch)
{
    const sum_array_t *splats = &batch->sums[SUM_SPLAT];
    size_t pixels = sum_image_values(&batch->settings, SUM_SPLAT) / 3, hit = 0;
    for (size_t v = 0; v < splats->count; v += 3)
        hit += (splats->values[v] | splats->values[v + 1] | splats->values[v + 2]) != 0;
    return (double)hit / (double)pixels;
}

/* GB a CPU second, the best of a few. */
static double copy_rate(size_t bytes)
{
    uint8_t *from = mem_zalloc(bytes, 1), *to = mem_zalloc(bytes, 1);
    double best = 1e30;
    memset(from, 1, bytes);
    memset(to, 2, bytes);
    for (int i = 0; i < REPEATS; i++) {
        double start = thread_cpu();
        memcpy(to, from, bytes);
        __asm__ volatile("" : : "r"(to) : "memory");
        double seconds = thread_cpu() - start;
        best = seconds < best ? seconds : best;
    }
    free(from);
    free(to);
    return 1e-9 * (double)bytes / best;
}

static void bench(shared_film_t *shared_film, const renderer_t *renderer, const job_settings_t *settings,
                  double seconds)
{
    size_t raw = sum_image_values(settings, SUM_SPLAT) * sizeof(int64_t);
    batch_t batch = render_batch(renderer, settings, seconds);
    zmq_msg_t payload[BATCH_PAYLOADS];
    double start = thread_cpu();
    check(payload_encode(&batch, payload));
    double encode = thread_cpu() - start, best = 1e30, copy = copy_rate(raw);
    sum_limits_t limits = {.once = {0}};
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++) /* as the master, but nothing is beyond */
        if (k != SUM_FEATURES && k != SUM_MATTES) limits.once[k] = UINT64_C(1) << 44;
    for (int i = 0; i < REPEATS; i++) {
        start = thread_cpu();
        shared_film_enter(shared_film);
        if (i % 2 == 0)
            check(shared_film_merge_within(shared_film, payload, &batch, NULL, &limits));
        else
            check(shared_film_merge_payload(shared_film, payload, &batch, NULL, -1));
        shared_film_leave(shared_film);
        double merge = thread_cpu() - start;
        best = merge < best && i % 2 == 0 ? merge : best;
    }
    double rate = 1e-9 * (double)raw / best;
    printf("%8.1f %9.1f %% %8zu %8.2f %8.2f %9.1f %9.2f %9.2f %9.2f %7.0f %%\n", seconds,
           100 * splat_share(&batch), batch.unit_count, 1e-6 * (double)zmq_msg_size(&payload[0]),
           1e-6 * (double)zmq_msg_size(&payload[1]), 1e3 * encode, 1e3 * best, rate, copy, 100 * rate / copy);
    fflush(stdout);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    batch_free(&batch);
}

int main(int argc, char **argv)
{
    static const double usual[] = {0.1, 1, 3, 10, 30};
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    renderer_t *renderer;
    film_t *film;
    check(import_scene_blob(argc > 1 ? argv[1] : "scenes/seed-hidden", NULL, &bytes, &size));
    check(blob_open(bytes, size, &blob));
    job_settings_t settings = blob_default_settings(&blob);
    settings.width = 1920;
    settings.height = 1080;
    settings.spp = JOB_MAX_SPP;
    check(renderer_new(&blob, &settings, &renderer));
    check(film_new(&settings, &film));
    shared_film_t *shared_film = shared_film_new(film);
    for (size_t i = 0; i < shared_film_page_count(&settings); i++) {
        size_t bytes_of_page;
        uint8_t *page = shared_film_page(film, i, &bytes_of_page);
        for (size_t at = 0; at < bytes_of_page; at += 4096) page[at] = 0; /* its memory is there */
    }
    printf(
        "rendered  splats in    units   eye MB  splat MB encode ms  merge ms      GB/s    memcpy  share\n");
    for (int i = 2; i < argc; i++) bench(shared_film, renderer, &settings, strtod(argv[i], NULL));
    for (size_t i = 0; argc <= 2 && i < ARRAY_LENGTH(usual); i++)
        bench(shared_film, renderer, &settings, usual[i]);
    shared_film_destroy(&shared_film);
    renderer_destroy(&renderer);
    free(bytes);
    return 0;
}
