/* bench_mesh: a mesh of a million triangles: how long it takes to import, how long until its blob can be
 * traced, and how much memory that takes, Embree's tree included.
 *
 * usage: bench_mesh [TRIANGLES]     writes a binary PLY and its scene into a scratch folder
 */
#include "client/import/import.h"
#include "tests/scratch.h"
#include "worker/render/renderer.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

static void check(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "bench_mesh: %s\n", result.message);
    exit(result_exit_code(result));
}

/* A bumpy sphere of 2 side^2 triangles, with normals as an exporter writes them. */
static void write_ply(const char *path, uint32_t side)
{
    FILE *file = fopen(path, "wb");
    if (file == NULL) {
        check(result_fail(RESULT_IO, "%s cannot be written", path));
        return;
    }
    uint32_t vertices = (side + 1) * (side + 1), faces = 2 * side * side;
    fprintf(file,
            "ply\nformat binary_little_endian 1.0\nelement vertex %u\nproperty float x\nproperty float y\n"
            "property float z\nproperty float nx\nproperty float ny\nproperty float nz\nelement face %u\n"
            "property list uchar int vertex_indices\nend_header\n",
            vertices, faces);
    for (uint32_t i = 0; i <= side; i++)
        for (uint32_t j = 0; j <= side; j++) {
            float theta = PI_F * (0.001f + 0.998f * (float)i / (float)side);
            float phi = TWO_PI_F * (float)j / (float)side;
            vec3_t n = vec3(sinf(theta) * cosf(phi), sinf(theta) * sinf(phi), cosf(theta));
            vec3_t p = v_scale(n, 1 + 0.02f * sinf(40 * theta) * sinf(40 * phi));
            fwrite(&p, sizeof p, 1, file);
            fwrite(&n, sizeof n, 1, file);
        }
    for (uint32_t i = 0; i < side; i++)
        for (uint32_t j = 0; j < side; j++) {
            int32_t v = (int32_t)(i * (side + 1) + j), w = v + (int32_t)side + 1;
            const int32_t pair[2][3] = {{v, w, v + 1}, {v + 1, w, w + 1}};
            for (int k = 0; k < 2; k++) {
                fputc(3, file);
                fwrite(pair[k], sizeof pair[k], 1, file);
            }
        }
    if (fclose(file) != 0) check(result_fail(RESULT_IO, "%s cannot be written", path));
}

static const char scene_text[] =
    "LookAt 0 -4 1  0 0 0  0 0 1\nCamera \"perspective\" \"float fov\" 40\n"
    "Film \"image\" \"integer xresolution\" 64 \"integer yresolution\" 64\nWorldBegin\n"
    "LightSource \"infinite\"\nShape \"plymesh\" \"string filename\" \"mesh.ply\"\nWorldEnd\n";

/* Imports the scene and writes its blob. */
static void import(const char *scene, const char *blob_path)
{
    uint8_t *bytes;
    uint64_t size;
    double start = clock_now();
    check(import_scene_blob(scene, NULL, &bytes, &size));
    printf("import: %.2f s, blob of %.1f MB\n", clock_now() - start, (double)size * 1e-6);
    scratch_write(blob_path, bytes, size);
    free(bytes);
}

/* Traces the first tile of the blob. */
static void trace(const char *blob_path)
{
    scene_blob_t blob;
    renderer_t *renderer;
    unit_result_t result = {0};
    atomic_bool cancel = false;
    double start = clock_now();
    check(blob_open_file(blob_path, &blob));
    job_settings_t settings = blob_default_settings(&blob);
    check(renderer_new(&blob, &settings, &renderer));
    printf("from the blob to the first ray: %.2f s\n", clock_now() - start);
    renderer_unit(renderer, &(unit_t){0, 0, 1}, &result, &cancel);
    unit_result_free(&result);
    renderer_destroy(&renderer);
    blob_close(&blob);
}

/* Runs one step in a process of its own and returns the most memory it had, in bytes. */
static double peak_of(void (*step)(const char *, const char *), const char *a, const char *b)
{
    struct rusage usage;
    int status;
    fflush(stdout);
    pid_t child = fork();
    if (child == 0) {
        step(a, b);
        exit(0);
    }
    if (child < 0 || wait4(child, &status, 0, &usage) != child || status != 0)
        check(result_fail(RESULT_IO, "a step failed"));
    return (double)usage.ru_maxrss * 1024;
}

static void trace_step(const char *scene, const char *blob_path)
{
    (void)scene;
    trace(blob_path);
}

int main(int argc, char **argv)
{
    double wanted = argc > 1 ? strtod(argv[1], NULL) : 1e6;
    uint32_t side = (uint32_t)ceil(sqrt(float_clamp((float)wanted, 8, 2e8f) / 2));
    double triangles = 2.0 * side * side;
    char *folder = scratch_new(), *ply = scratch_path(folder, "mesh.ply");
    char *scene = scratch_path(folder, "scene.pbrt"), *blob = scratch_path(folder, "scene.blob");
    write_ply(ply, side);
    scratch_write(scene, scene_text, strlen(scene_text));
    printf("%.0f triangles with vertex normals\n", triangles);
    printf("  at most %.0f bytes a triangle while importing\n", peak_of(import, scene, blob) / triangles);
    printf("  at most %.0f bytes a triangle while tracing\n", peak_of(trace_step, scene, blob) / triangles);
    free(ply);
    free(scene);
    free(blob);
    scratch_destroy(&folder);
    return 0;
}
