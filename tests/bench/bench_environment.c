/* bench_environment: what --environment gains over a dome.
 *
 * A product scene, two glossy things on a table, is lit by the same studio image in two ways: by
 * --environment, and by the image as the emission of a mesh of a dome about the scene, which is what an
 * artist without the option would build. Prints for each the error (relMSE against a long render of the same)
 * times the CPU seconds, and the ratio. Fails when that is below 3, or when the two pictures are not equally
 * bright.
 *
 * usage: bench_environment [SPP [RESOLUTION [REFERENCE_SPP]]]      from the top of the tree
 */
#include "client/import/import.h"
#include "tests/reference.h"
#include "tests/render_here.h"
#include "tests/scratch.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { WIDTH = 512, HEIGHT = 256, RINGS = 32, SECTORS = 64, TEXT = 1 << 20 };
static const double pi = 3.14159265358979323846;

static void check(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "bench_environment: %s\n", result.message);
    exit(result_exit_code(result));
}

/* ---- the scene ----------------------------------------------------------------------------------------- */

/* A dim room with two soft boxes and a small lamp. The camera sees the table only, since a dome looks
 * different from every place. */
static void studio(double u, double v, float rgb[3])
{
    bool key = fabs(u - 0.62) < 0.05 && fabs(v - 0.3) < 0.08,
         fill = fabs(u - 0.3) < 0.08 && fabs(v - 0.35) < 0.1;
    bool lamp = hypot(2 * (u - 0.45), v - 0.2) < 0.012;
    double light = 0.05 + (key ? 12 : 0) + (fill ? 2 : 0) + (lamp ? 60 : 0);
    rgb[0] = (float)(light * (fill ? 0.8 : 1));
    rgb[1] = (float)light;
    rgb[2] = (float)(light * (key ? 0.85 : 1));
}

static void write_studio(const char *path)
{
    static const char head[] = "PF\n512 256\n-1.0\n";
    size_t length = sizeof head - 1, size = length + (size_t)WIDTH * HEIGHT * 12;
    uint8_t *bytes = mem_alloc(size);
    memcpy(bytes, head, length);
    for (int y = 0; y < HEIGHT; y++) /* PFM begins at the bottom */
        for (int x = 0; x < WIDTH; x++) {
            float rgb[3];
            studio((x + 0.5) / WIDTH, 1 - (y + 0.5) / HEIGHT, rgb);
            memcpy(bytes + length + 12 * ((size_t)y * WIDTH + (size_t)x), rgb, sizeof rgb);
        }
    scratch_write(path, bytes, size);
    free(bytes);
}

static const char product[] =
    "Film \"rgb\"\nCamera \"perspective\" \"float fov\" [35]\nWorldBegin\n"
    "Material \"coateddiffuse\" \"rgb reflectance\" [0.6 0.1 0.05] \"float roughness\" [0.02]\n"
    "AttributeBegin\nTranslate -0.7 1 0\nShape \"sphere\"\nAttributeEnd\n"
    "Material \"conductor\" \"float roughness\" [0.05]\n"
    "AttributeBegin\nTranslate 1.2 0.6 0.5\nShape \"sphere\" \"float radius\" [0.6]\nAttributeEnd\n"
    "Material \"diffuse\" \"rgb reflectance\" [0.5 0.5 0.5]\n"
    "AttributeBegin\nRotate -90 1 0 0\nShape \"disk\" \"float radius\" [12]\nAttributeEnd\n";

/* A sphere of triangles about all, seen from inside, with the image where --environment has it: its centre in
 * +x, what is right of it towards +z. */
static void append_dome(char *text)
{
    const double radius = 200;
    char *to = text + strlen(text);
    to += sprintf(to, "Material \"diffuse\" \"rgb reflectance\" [0 0 0]\nAreaLightSource \"diffuse\" "
                      "\"string filename\" \"studio.pfm\"\n"
                      "Shape \"trianglemesh\" \"point3 P\" [");
    for (int i = 0; i <= RINGS; i++)
        for (int k = 0; k <= SECTORS; k++) {
            double theta = pi * i / RINGS, phi = 2 * pi * k / SECTORS + pi;
            to += sprintf(to, "%.6f %.6f %.6f\n", radius * sin(theta) * cos(phi), radius * cos(theta),
                          radius * sin(theta) * sin(phi));
        }
    to += sprintf(to, "] \"point2 uv\" [");
    for (int i = 0; i <= RINGS; i++)
        for (int k = 0; k <= SECTORS; k++)
            to += sprintf(to, "%.6f %.6f\n", (double)k / SECTORS, 1 - (double)i / RINGS);
    to += sprintf(to, "] \"integer indices\" [");
    for (int i = 0; i < RINGS; i++)
        for (int k = 0; k < SECTORS; k++) {
            int a = i * (SECTORS + 1) + k, b = a + 1, c = a + SECTORS + 1, d = c + 1;
            if (i > 0) to += sprintf(to, "%d %d %d\n", a, d, b);
            if (i < RINGS - 1) to += sprintf(to, "%d %d %d\n", a, c, d);
        }
    sprintf(to, "]\n");
}

static uint8_t *import(const char *folder, bool dome, scene_blob_t *blob)
{
    char *text = mem_alloc(TEXT), *path = scratch_path(folder, dome ? "dome.pbrt" : "product.pbrt");
    char *image = scratch_path(folder, "studio.pfm");
    sprintf(text, "LookAt 0 5 6  0 0.5 0  0 1 0\n%s", product);
    if (dome) append_dome(text);
    scratch_write(path, text, strlen(text));
    import_wishes_t wishes = import_wishes_none();
    if (!dome) wishes.environment = image;
    import_report_t report = {.wishes = &wishes};
    uint8_t *bytes;
    uint64_t size;
    check(import_scene_blob(path, &report, &bytes, &size));
    check(blob_open(bytes, size, blob));
    free(text);
    free(path);
    free(image);
    return bytes;
}

/* ---- the measurement ----------------------------------------------------------------------------------- */

typedef struct {
    uint32_t spp, reference_spp;
    int resolution;
} order_t;

static estimate_image_t render(const scene_blob_t *blob, const order_t *order, uint32_t spp, uint64_t seed,
                               double *seconds)
{
    job_settings_t settings = blob_default_settings(blob);
    settings.width = settings.height = order->resolution;
    settings.features = false;
    settings.spp = spp;
    settings.seed = seed;
    struct timespec before, after;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &before);
    film_t *film = render_here(blob, &settings);
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &after);
    *seconds = (double)(after.tv_sec - before.tv_sec) + 1e-9 * (double)(after.tv_nsec - before.tv_nsec);
    estimate_image_t estimate = reference_estimate(film);
    film_destroy(&film);
    return estimate;
}

static double mean_of(const estimate_image_t *image)
{
    size_t values = 3 * (size_t)image->width * (size_t)image->height;
    double sum = 0;
    for (size_t i = 0; i < values; i++) sum += (double)image->mean[i];
    return sum / (double)values;
}

/* relMSE times CPU seconds; *mean is that of the reference. */
static double measure(const char *folder, bool dome, const order_t *order, double *mean)
{
    scene_blob_t blob;
    double seconds, unused;
    uint8_t *bytes = import(folder, dome, &blob);
    estimate_image_t reference = render(&blob, order, order->reference_spp, 99, &unused);
    estimate_image_t image = render(&blob, order, order->spp, 1, &seconds);
    agreement_t agreement;
    agreement_measure(&image, &reference, &agreement);
    double error = fmax(0, agreement.relmse - agreement.relmse_floor);
    *mean = mean_of(&reference);
    printf("%-14s relMSE %.3e at %u spp, %.2f CPU s: %.3e; mean %.4f\n", dome ? "dome mesh" : "--environment",
           error, order->spp, seconds, error * seconds, *mean);
    fflush(stdout);
    agreement_free(&agreement);
    estimate_image_free(&reference);
    estimate_image_free(&image);
    free(bytes);
    return error * seconds;
}

int main(int argc, char **argv)
{
    order_t order = {.spp = argc > 1 ? (uint32_t)atoi(argv[1]) : 64,
                     .resolution = argc > 2 ? atoi(argv[2]) : 48,
                     .reference_spp = argc > 3 ? (uint32_t)atoi(argv[3]) : 2048};
    char *folder = scratch_new(), *image = scratch_path(folder, "studio.pfm");
    double mean[2];
    write_studio(image);
    double environment = measure(folder, false, &order, &mean[0]);
    double dome = measure(folder, true, &order, &mean[1]);
    bool alike = fabs(mean[0] / mean[1] - 1) < 0.05;
    printf("--environment is %.1f times better%s\n", dome / environment,
           alike ? "" : "; but the pictures are not equally bright");
    scratch_destroy(&folder);
    free(image);
    return !(alike && dome >= 3 * environment);
}
