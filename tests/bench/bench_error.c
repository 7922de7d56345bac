/* bench_error: do jobs that are to stop at an error stop at that error?
 *
 * Renders cornell and seed-hidden with several seeds until the estimated relative error is E
 * (master/schedule/next_round.h), and measures the true one against a long render by the same formula
 * (film_noise in common/film/film.h). It must lie between E / 2 and 3 E / 2. For comparison it prints two
 * other errors: the root of the relMSE of `lightmill compare`, and the distance of the images over the length
 * of the reference as vectors.
 *
 * usage: bench_error [SEEDS [E [RESOLUTION [adaptive]]]]      from the top of the tree; one process a scene
 */
#include "client/import/import.h"
#include "tests/reference.h"
#include "tests/render_here.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

static const char *const scenes[] = {"cornell", "seed-hidden"};

typedef struct {
    uint64_t seeds;
    double error;
    int resolution;
    bool adaptive;
} order_t;

static void check(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "bench_error: %s\n", result.message);
    exit(result_exit_code(result));
}

static double distance(const estimate_image_t *image, const estimate_image_t *reference)
{
    size_t values = 3 * (size_t)image->width * (size_t)image->height;
    double distance2 = 0, length2 = 0;
    for (size_t i = 0; i < values; i++) {
        distance2 += pow(image->mean[i] - reference->mean[i], 2) - reference->variance[i];
        length2 += pow(reference->mean[i], 2);
    }
    return sqrt(fmax(0, distance2) / length2);
}

static double root_relmse(const estimate_image_t *image, const estimate_image_t *reference)
{
    agreement_t agreement;
    agreement_measure(image, reference, &agreement);
    double root = sqrt(fmax(0, agreement.relmse - agreement.relmse_floor));
    agreement_free(&agreement);
    return root;
}

/* The long render: its error is about a third of E, and what it adds is taken off. */
static estimate_image_t long_render(const scene_blob_t *blob, job_settings_t settings, double error)
{
    planned_t planned;
    settings.seed = 1 << 30;
    settings.error = error / 3;
    settings.adaptive = false;
    film_t *film = render_planned(blob, &settings, 1 << 20, 1, &planned);
    estimate_image_t reference = reference_estimate(film);
    printf("# long render: %.0f samples a pixel, estimated error %.5f\n", planned.samples, planned.error);
    fflush(stdout);
    free(planned.shown);
    film_destroy(&film);
    return reference;
}

/* Returns how many of the runs were out of bounds. */
static int run_scene(const char *scene, const order_t *order)
{
    char *path = mem_printf("scenes/%s/scene.pbrt", scene);
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    int failed = 0;
    double sum = 0, least = INFINITY, most = 0;
    check(import_scene_blob(path, NULL, &bytes, &size));
    check(blob_open(bytes, size, &blob));
    job_settings_t settings = blob_default_settings(&blob);
    settings.width = settings.height = order->resolution;
    settings.features = false;
    settings.spp = JOB_MAX_SPP;
    settings.error = order->error;
    settings.adaptive = order->adaptive;
    estimate_image_t reference = long_render(&blob, settings, order->error);
    for (uint64_t seed = 1; seed <= order->seeds; seed++) {
        planned_t planned;
        settings.seed = seed;
        film_t *film = render_planned(&blob, &settings, 1 << 20, 1, &planned);
        estimate_image_t estimate = reference_estimate(film);
        double error = reference_error(&estimate, &reference);
        failed += !(error > 0.5 * order->error && error < 1.5 * order->error);
        printf("%-12s seed %2llu: %2u rounds, %6.0f samples a pixel, estimated %.5f, true %.5f (root of "
               "relMSE %.5f, "
               "as vectors %.5f)\n",
               scene, (unsigned long long)seed, planned.rounds, planned.samples, planned.error, error,
               root_relmse(&estimate, &reference), distance(&estimate, &reference));
        fflush(stdout);
        sum += error / (double)order->seeds;
        least = fmin(least, error);
        most = fmax(most, error);
        estimate_image_free(&estimate);
        film_destroy(&film);
        free(planned.shown);
    }
    printf("%-12s error %g: true %.5f to %.5f, mean %.5f; %d of %llu out of bounds\n", scene, order->error,
           least, most, sum, failed, (unsigned long long)order->seeds);
    estimate_image_free(&reference);
    free(bytes);
    free(path);
    return failed;
}

int main(int argc, char **argv)
{
    order_t order = {.seeds = argc > 1 ? strtoull(argv[1], NULL, 10) : 10,
                     .error = argc > 2 ? strtod(argv[2], NULL) : 0.01,
                     .resolution = argc > 3 ? atoi(argv[3]) : 64,
                     .adaptive = argc > 4 && strcmp(argv[4], "adaptive") == 0};
    for (size_t i = 0; i < ARRAY_LENGTH(scenes); i++)
        if (fork() == 0) exit(run_scene(scenes[i], &order) > 0);
    int failed = 0;
    for (int status; wait(&status) > 0;) failed += !WIFEXITED(status) || WEXITSTATUS(status) != 0;
    return failed > 0;
}
