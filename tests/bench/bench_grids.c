/* bench_grids: a medium in a NanoVDB file of SIDE voxels along each axis, mostly empty and full, and in all
 * codings: how long it takes to import, how long until its blob can be traced, a tile of it, and how much
 * memory that takes. Memory counts what the kernel keeps of mapped files, which it drops where others need
 * it.
 *
 * usage: bench_grids [SIDE]      writes files and their blobs into a scratch folder
 */
#include "client/import/import.h"
#include "common/base.h"
#include "tests/nanovdb_pack.h"
#include "tests/scratch.h"
#include "worker/render/renderer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

static void check(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "bench_grids: %s\n", result.message);
    exit(result_exit_code(result));
}

/* What stands in the scratch folder. */
typedef struct {
    int side;
    bool full;
    nanovdb_codec_t codec;
    const char *scene, *grid, *blob;
} bench_t;

/* A shell of smoke about the middle, or smoke all over. */
static float smoke(const void *context, int x, int y, int z)
{
    const bench_t *bench = context;
    float half = 0.5f * (float)bench->side, px = (float)x - half, py = (float)y - half, pz = (float)z - half;
    float wave = 0.6f + 0.2f * sinf(0.11f * px) + 0.2f * sinf(0.07f * py + 0.05f * pz);
    float r = sqrtf(px * px + py * py + pz * pz) / half;
    return bench->full || fabsf(r - 0.7f - 0.1f * wave) < 0.04f ? wave : 0;
}

static void write_grid(const bench_t *bench)
{
    int last = bench->side - 1;
    double voxel = 2.0 / bench->side;
    const nanovdb_pack_t grid = {.name = "density",
                                 .high = {last, last, last},
                                 .at = smoke,
                                 .context = bench,
                                 .voxel = {voxel, voxel, voxel},
                                 .origin = {-1, -1, -1}};
    if (!nanovdb_pack(bench->grid, &grid, 1, bench->codec))
        check(result_fail(RESULT_IO, "%s cannot be written", bench->grid));
}

static const char scene_text[] =
    "LookAt 0 -4 1  0 0 0  0 0 1\nCamera \"perspective\" \"float fov\" 40\n"
    "Film \"rgb\" \"integer xresolution\" 64 \"integer yresolution\" 64\nWorldBegin\n"
    "LightSource \"infinite\"\nMakeNamedMedium \"smoke\" \"string type\" \"nanovdb\" \"string filename\" "
    "\"grid.nvdb\" \"rgb sigma_a\" [0.5 1 2] \"rgb sigma_s\" [4 4 4]\n"
    "MediumInterface \"smoke\" \"\" Material \"interface\" Shape \"sphere\" \"float radius\" 2\n";

/* Time from one look at the clocks to the next: of the clock on the wall, and of this process. */
typedef struct {
    double wall, cpu;
} watch_t;

static watch_t watch_now(void)
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    return (watch_t){clock_now(), (double)(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
                                      1e-6 * (double)(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec)};
}

static void print_since(const char *what, const watch_t *start)
{
    watch_t now = watch_now();
    printf(" %s %.2f s (CPU %.2f s);", what, now.wall - start->wall, now.cpu - start->cpu);
}

static void import(const bench_t *bench)
{
    int file;
    watch_t start = watch_now();
    check(import_scene_file(bench->scene, NULL, &file));
    print_since("import", &start);
    off_t size = lseek(file, 0, SEEK_END);
    printf(" blob of %.0f MB;", (double)size * 1e-6);
    char *buffer = mem_alloc(1 << 20);
    FILE *out = fopen(bench->blob, "wb");
    if (out == NULL) check(result_fail(RESULT_IO, "%s cannot be written", bench->blob));
    for (off_t at = 0; out != NULL && at < size;) {
        ssize_t read = pread(file, buffer, 1 << 20, at);
        if (read <= 0 || fwrite(buffer, 1, (size_t)read, out) != (size_t)read)
            check(result_fail(RESULT_IO, "%s cannot be written", bench->blob));
        at += read;
    }
    if (out != NULL) fclose(out);
    free(buffer);
    close(file);
}

/* Traces the first tile of the blob. */
static void trace(const bench_t *bench)
{
    scene_blob_t blob;
    renderer_t *renderer;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    watch_t start = watch_now();
    check(blob_open_file(bench->blob, &blob));
    print_since("blob checked", &start);
    start = watch_now();
    job_settings_t settings = blob_default_settings(&blob);
    check(renderer_new(&blob, &settings, &renderer));
    print_since("then to the first ray", &start);
    start = watch_now();
    renderer_unit(renderer, &(unit_t){0, 0, 8}, &result, &cancel);
    print_since("8 samples of the first tile", &start);
    unit_result_free(&result);
    renderer_destroy(&renderer);
    blob_close(&blob);
}

/* Runs one step in a process of its own and prints the most memory it had. */
static void run(void (*step)(const bench_t *), const bench_t *bench)
{
    struct rusage usage;
    int status;
    fflush(stdout);
    pid_t child = fork();
    if (child == 0) {
        step(bench);
        exit(0);
    }
    if (child < 0 || wait4(child, &status, 0, &usage) != child || status != 0)
        check(result_fail(RESULT_IO, "a step failed"));
    printf(" at most %.0f MB\n", (double)usage.ru_maxrss * 1.024e-3);
}

int main(int argc, char **argv)
{
    static const char *const codecs[] = {"not packed", "ZIP", "Blosc"};
    char *folder = scratch_new();
    char *scene = scratch_path(folder, "scene.pbrt"), *grid = scratch_path(folder, "grid.nvdb"),
         *blob = scratch_path(folder, "scene.blob");
    bench_t bench = {
        .side = argc > 1 ? int_max(atoi(argv[1]), 16) : 500, .scene = scene, .grid = grid, .blob = blob};
    scratch_write(scene, scene_text, strlen(scene_text));
    for (int full = 0; full < 2; full++)
        for (int codec = NANOVDB_PACK_NONE; codec <= NANOVDB_PACK_BLOSC; codec++) {
            struct stat about;
            bench.full = full;
            bench.codec = (nanovdb_codec_t)codec;
            write_grid(&bench);
            if (stat(grid, &about) != 0) check(result_fail(RESULT_IO, "%s is gone", grid));
            printf("%d^3, %s, %s, %.0f MB:", bench.side, full ? "full" : "a shell", codecs[codec],
                   (double)about.st_size * 1e-6);
            run(import, &bench);
            if (codec > NANOVDB_PACK_NONE) continue;
            printf("  ");
            run(trace, &bench);
        }
    free(scene);
    free(grid);
    free(blob);
    scratch_destroy(&folder);
    return 0;
}
