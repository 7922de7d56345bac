/* reference: see reference.h. */
#include "tests/reference.h"

#include "common/image/image.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static void require(result_t result)
{
    if (result.code == RESULT_OK) return;
    fprintf(stderr, "%s\n", result.message);
    exit(result_exit_code(result));
}

/* R, G, B of a file of the scene's folder, interleaved, in fresh memory. */
static double *read_rgb(const char *scene, const char *file, int *width, int *height)
{
    char *path = mem_printf("tests/references/%s/%s", scene, file);
    image_t image;
    const image_channel_t *rgb[3];
    require(image_read_exr(path, &image));
    if (!image_find_rgb(&image, NULL, rgb)) require(result_fail(RESULT_INPUT, "%s: has no R, G, B", path));
    *width = image.width;
    *height = image.height;
    size_t pixels = (size_t)image.width * (size_t)image.height;
    double *values = mem_zalloc(3 * pixels, sizeof *values);
    for (size_t p = 0; p < pixels; p++)
        for (size_t c = 0; c < 3; c++) values[3 * p + c] = (double)rgb[c]->data[p * rgb[c]->stride];
    image_free(&image);
    free(path);
    return values;
}

estimate_image_t reference_read(const char *scene)
{
    estimate_image_t reference;
    reference.mean = read_rgb(scene, "ref.exr", &reference.width, &reference.height);
    reference.variance = read_rgb(scene, "stderr.exr", &reference.width, &reference.height);
    size_t values = 3 * (size_t)reference.width * (size_t)reference.height;
    for (size_t i = 0; i < values; i++) reference.variance[i] *= reference.variance[i];
    return reference;
}

estimate_image_t reference_estimate(const film_t *film)
{
    film_image_t image;
    film_resolve(film, &image);
    size_t values = 3 * (size_t)image.width * (size_t)image.height;
    estimate_image_t estimate = {image.width, image.height, mem_zalloc(values, sizeof(double)),
                                 mem_zalloc(values, sizeof(double))};
    for (size_t i = 0; i < values; i++) {
        estimate.mean[i] = (double)image.sum[i];
        estimate.variance[i] = (double)image.noise[i] * (double)image.noise[i];
    }
    film_image_free(&image);
    return estimate;
}

double reference_error(const estimate_image_t *image, const estimate_image_t *reference)
{
    size_t values = 3 * (size_t)image->width * (size_t)image->height;
    double mean = 0, sum = 0;
    for (size_t i = 0; i < values; i++) mean += reference->mean[i] / (double)values;
    double floor = FILM_ERROR_FLOOR * mean;
    for (size_t i = 0; i < values; i++) {
        double difference = image->mean[i] - reference->mean[i];
        sum += (difference * difference - reference->variance[i]) /
               (reference->mean[i] * reference->mean[i] + floor * floor);
    }
    return sqrt(fmax(0, sum / (double)values));
}
