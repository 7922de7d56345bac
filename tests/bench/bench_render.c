/* bench_render: error and speed of the renderer, against the figures of pbrt-v3 for the same scenes.
 *
 * Error is relMSE against the reference image (client/image/agreement.h), cost is CPU time, and their product
 * does not depend on the number of samples: a renderer with half the product needs half the time for the same
 * image. CPU times of two machines are compared through what Embree does on each: rays per CPU second with
 * its single-ray kernel in a closed box around a bumpy ball of 80,000 triangles. The figures of pbrt were
 * taken where that was 7.5 million a second.
 *
 * usage: bench_render [SEEDS [SCENE]]     from the top of the tree; one thread, about two minutes a seed
 */
#include "client/import/import.h"
#include "tests/clock.h"
#include "tests/reference.h"
#include "tests/render_here.h"
#include "worker/render/scene/scene.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* tests/references/README.md: relMSE and CPU seconds of pbrt-v3's bdpt at 64 spp, and of its path at spp. */
static const struct {
    const char *scene;
    double bdpt_relmse, bdpt_cpu;
    uint32_t path_spp;
    double path_relmse, path_cpu;
} pbrt[] = {
    {"seed-diffuse", 0.001831, 12.988, 282, 0.000694, 12.765},
    {"seed-specular", 0.002571, 12.787, 269, 0.010397, 12.150},
    {"seed-hidden", 0.002718, 13.834, 317, 0.009090, 13.009},
    {"cornell", 0.001206, 9.063, 294, 0.000810, 9.038},
    {"caustic", 0.006833, 2.823, 143, 0.063135, 2.805},
    {"lights-delta", 0.005290, 3.357, 186, 0.004786, 3.334},
    {"lights-env", 0.008491, 2.467, 102, 0.014004, 2.468},
    {"materials", 0.011228, 14.547, 193, 0.008737, 14.076},
    {"textures", 0.003036, 4.093, 146, 0.001267, 4.076},
    {"instances", 0.006910, 3.752, 161, 0.005765, 3.650},
    {"lens", 0.008890, 3.457, 122, 0.009791, 3.234},
};
static const double pbrt_mrays = 7.5;

static void check(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "bench_render: %s\n", result.message);
    exit(result_exit_code(result));
}

/* ---- how fast is Embree here? -------------------------------------------------------------------------- */

enum { BALL = 200 };

/* The box and the ball as a blob; the caller frees it. */
static uint8_t *calibration_scene(uint64_t *size)
{
    blob_builder_t *b = blob_builder_new();
    blob_scene_t scene = blob_default_scene();
    blob_builder_add(b, BLOB_SECTION_SCENE, &scene, 1);
    blob_builder_add(b, BLOB_SECTION_MATERIALS, &(blob_material_t){.kind = MATERIAL_DIFFUSE}, 1);
    for (uint32_t i = 0; i <= BALL; i++)
        for (uint32_t j = 0; j <= BALL; j++) {
            double theta = M_PI * i / BALL, phi = 2 * M_PI * j / BALL;
            double r = 0.5 + 0.02 * sin(20 * theta) * sin(20 * phi);
            vec3_t p = vec3((float)(r * sin(theta) * cos(phi)), (float)(r * sin(theta) * sin(phi)),
                            (float)(r * cos(theta)));
            blob_builder_add(b, BLOB_SECTION_POSITIONS, &p, 1);
        }
    for (uint32_t i = 0; i < BALL; i++)
        for (uint32_t j = 0; j < BALL; j++) {
            uint32_t v = i * (BALL + 1) + j, w = v + BALL + 1;
            blob_triangle_t pair[2] = {{{v, v + 1, w}}, {{v + 1, w + 1, w}}};
            blob_builder_add(b, BLOB_SECTION_TRIANGLES, pair, 2);
        }
    blob_mesh_t ball = {.vertex_count = (BALL + 1) * (BALL + 1),
                        .first_normal = BLOB_NONE,
                        .first_uv = BLOB_NONE,
                        .first_uv2 = BLOB_NONE,
                        .first_colour = BLOB_NONE,
                        .triangle_count = 2 * BALL * BALL};
    blob_mesh_t box = {.first_position = ball.vertex_count,
                       .vertex_count = 8,
                       .first_normal = BLOB_NONE,
                       .first_uv = BLOB_NONE,
                       .first_uv2 = BLOB_NONE,
                       .first_colour = BLOB_NONE,
                       .first_triangle = ball.triangle_count,
                       .triangle_count = 12};
    for (int i = 0; i < 8; i++) {
        vec3_t p = vec3(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
        blob_builder_add(b, BLOB_SECTION_POSITIONS, &p, 1);
    }
    static const blob_triangle_t faces[12] = {{{0, 1, 2}}, {{1, 3, 2}}, {{4, 6, 5}}, {{5, 6, 7}},
                                              {{0, 4, 1}}, {{1, 4, 5}}, {{2, 3, 6}}, {{3, 7, 6}},
                                              {{0, 2, 4}}, {{2, 6, 4}}, {{1, 5, 3}}, {{3, 5, 7}}};
    blob_builder_add(b, BLOB_SECTION_TRIANGLES, faces, 12);
    blob_builder_add(b, BLOB_SECTION_MESHES, &ball, 1);
    blob_builder_add(b, BLOB_SECTION_MESHES, &box, 1);
    for (uint32_t i = 0; i < 2; i++)
        blob_builder_add(b, BLOB_SECTION_SHAPES,
                         &(blob_shape_t){.kind = SHAPE_MESH,
                                         .geometry = i,
                                         .light = BLOB_NONE,
                                         .alpha = blob_constant(1),
                                         .shadow_alpha = blob_constant(1)},
                         1);
    blob_builder_add(b, BLOB_SECTION_OBJECTS, &(blob_object_t){0, 2}, 1);
    uint8_t *bytes;
    check(blob_builder_finish(b, &bytes, size));
    blob_builder_destroy(&b);
    return bytes;
}

/* Cheap numbers in [0, 1), so that the rays are what is measured (PCG, O'Neill 2014). */
static float cheap_number(uint32_t *state)
{
    *state = *state * 747796405u + 2891336453u;
    uint32_t word = ((*state >> ((*state >> 28) + 4)) ^ *state) * 277803737u;
    return (float)((word >> 22 ^ word) >> 8) * 0x1p-24f;
}

/* Millions of nearest-hit queries per CPU second with incoherent rays; the best of five runs. */
static double embree_mrays(void)
{
    uint64_t size;
    uint8_t *bytes = calibration_scene(&size);
    scene_blob_t blob;
    scene_t *scene;
    check(blob_open(bytes, size, &blob));
    check(scene_new(&blob, &scene));
    double best = 0;
    for (int repeat = 0; repeat < 5; repeat++) {
        enum { RAYS = 1000000 };
        uint32_t state = 1;
        double start = clock_cpu();
        for (uint32_t i = 0; i < RAYS; i++) {
            float z = 2 * cheap_number(&state) - 1, r = sqrtf(1 - z * z),
                  phi = TWO_PI_F * cheap_number(&state);
            vec3_t origin;
            origin.x = 1.9f * cheap_number(&state) - 0.95f;
            origin.y = 1.9f * cheap_number(&state) - 0.95f;
            origin.z = 1.9f * cheap_number(&state) - 0.95f;
            scene_probe(scene, origin, vec3(r * cosf(phi), r * sinf(phi), z));
        }
        double rate = RAYS * 1e-6 / (clock_cpu() - start);
        if (rate > best) best = rate;
    }
    scene_destroy(&scene);
    free(bytes);
    return best;
}

/* ---- scenes -------------------------------------------------------------------------------------------- */

typedef struct {
    double relmse, cpu, samples, rays;
} figure_t;

/* CPU time includes reading the scene and building the tree, as pbrt's does, but no farm. */
static figure_t render(const char *name, integrator_t integrator, uint32_t spp, uint64_t seed,
                       const estimate_image_t *reference)
{
    double start = clock_cpu();
    char *path = mem_printf("scenes/%s/scene.pbrt", name);
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    check(import_scene_blob(path, NULL, &bytes, &size));
    check(blob_open(bytes, size, &blob));
    job_settings_t settings = blob_default_settings(&blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.seed = seed;
    batch_t batch;
    render_batch_here(&blob, &settings, &batch);
    figure_t figure = {.cpu = clock_cpu() - start,
                       .rays = (double)batch.counts.rays,
                       .samples = (double)spp * settings.width * settings.height};
    film_t *film = film_of_batch(&batch);
    estimate_image_t estimate = reference_estimate(film);
    agreement_t agreement;
    agreement_measure(&estimate, reference, &agreement);
    figure.relmse = agreement.relmse;
    agreement_free(&agreement);
    estimate_image_free(&estimate);
    film_destroy(&film);
    free(bytes);
    free(path);
    return figure;
}

/* Prints a line; returns our product of error and normalised time over pbrt's. */
static double compare(const char *scene, integrator_t integrator, uint32_t spp, uint64_t seeds, double mrays,
                      double relmse, double cpu)
{
    estimate_image_t reference = reference_read(scene);
    figure_t sum = {0};
    for (uint64_t seed = 1; seed <= seeds; seed++) {
        figure_t figure = render(scene, integrator, spp, seed, &reference);
        sum.relmse += figure.relmse / (double)seeds;
        sum.cpu += figure.cpu;
        sum.samples += figure.samples;
        sum.rays += figure.rays;
    }
    estimate_image_free(&reference);
    double seconds = sum.cpu / (double)seeds * mrays / pbrt_mrays;
    double ratio = sum.relmse * seconds / (relmse * cpu);
    printf("%-14s %-5s %4u spp: relMSE %.6f (pbrt %.6f), %.2f s normalised (pbrt %.2f), error x time %.2f of "
           "pbrt's; "
           "%.0f samples and %.2f Mrays a CPU s\n",
           scene, integrator_name(integrator), spp, sum.relmse, relmse, seconds, cpu, ratio,
           sum.samples / sum.cpu, sum.rays / sum.cpu * 1e-6);
    fflush(stdout);
    return ratio;
}

int main(int argc, char **argv)
{
    uint64_t seeds = argc > 1 ? strtoull(argv[1], NULL, 10) : 2;
    const char *only = argc > 2 ? argv[2] : NULL;
    double mrays = embree_mrays(), product = 1, worst = 0;
    int scenes = 0;
    for (size_t i = 0; i < ARRAY_LENGTH(pbrt); i++) {
        if (only != NULL && strcmp(only, pbrt[i].scene) != 0) continue;
        double ratio =
            compare(pbrt[i].scene, INTEGRATOR_BDPT, 64, seeds, mrays, pbrt[i].bdpt_relmse, pbrt[i].bdpt_cpu);
        compare(pbrt[i].scene, INTEGRATOR_PATH, pbrt[i].path_spp, seeds, mrays, pbrt[i].path_relmse,
                pbrt[i].path_cpu);
        product *= ratio;
        worst = fmax(worst, ratio);
        scenes++;
    }
    printf(
        "bdpt, %d scenes: geometric mean %.2f of pbrt's error x time, worst %.2f; Embree alone: %.2f Mrays "
        "a CPU s before, %.2f after (pbrt's machine %.2f)\n",
        scenes, pow(product, 1.0 / scenes), worst, mrays, embree_mrays(), pbrt_mrays);
    return 0;
}
