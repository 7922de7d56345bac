/* agreement: see agreement.h. */
#include "client/image/agreement.h"

#include <math.h>
#include <stdlib.h>

/* Of the relMSE: keeps black pixels from dominating; the share of the pixels that is left out. */
static const double relmse_offset = 0.01, relmse_trim = 0.001;
/* What rounding, half floats and noise-free areas may add to the error of a block or of the image, relative
 * to the reference's mean, and a variance that keeps black from dividing by zero. */
static const double block_tolerance = 1e-3, block_variance = 1e-12;
static const double mean_tolerance = 1e-4, mean_variance = 1e-16;

static size_t value_count(const estimate_image_t *image)
{
    return (size_t)image->width * (size_t)image->height * 3;
}

void estimate_image_free(estimate_image_t *image)
{
    free(image->mean);
    free(image->variance);
    *image = (estimate_image_t){0};
}

size_t estimate_image_not_finite(const estimate_image_t *image)
{
    size_t bad = 0;
    for (size_t v = 0; v < value_count(image); v += 3)
        bad += !isfinite(image->mean[v]) || !isfinite(image->mean[v + 1]) || !isfinite(image->mean[v + 2]);
    return bad;
}

agreement_limits_t agreement_default_limits(void)
{
    return (agreement_limits_t){.max_rms = 1.25, .max_z = 6.0, .max_mean_z = 4.0};
}

static int ascending(const void *a, const void *b)
{
    double left = *(const double *)a, right = *(const double *)b;
    return (left > right) - (left < right);
}

/* The trimmed mean over pixels of the squared errors: of (img - ref)^2 when there is an image, else of the
 * reference's variance. */
static double relative_error(const estimate_image_t *image, const estimate_image_t *reference)
{
    size_t pixels = value_count(reference) / 3, kept = pixels - (size_t)(relmse_trim * (double)pixels);
    double *errors = mem_alloc(pixels * sizeof *errors);
    for (size_t p = 0; p < pixels; p++) {
        double sum = 0;
        for (size_t v = 3 * p; v < 3 * p + 3; v++) {
            double ref = reference->mean[v];
            double square = image != NULL ? pow(image->mean[v] - ref, 2) : reference->variance[v];
            sum += square / (ref * ref + relmse_offset);
        }
        errors[p] = sum / 3;
    }
    qsort(errors, pixels, sizeof *errors, ascending);
    double total = 0;
    for (size_t p = 0; p < kept; p++) total += errors[p];
    free(errors);
    return total / (double)kept;
}

/* Means over a rectangle, of one channel. */
typedef struct {
    double image, reference, variance; /* variance: of a pixel, image's and reference's added */
} region_t;

static region_t region_means(const estimate_image_t *image, const estimate_image_t *reference, int x0, int y0,
                             int width, int height, size_t channel)
{
    region_t sum = {0};
    for (int y = y0; y < y0 + height; y++)
        for (int x = x0; x < x0 + width; x++) {
            size_t v = 3 * ((size_t)y * (size_t)image->width + (size_t)x) + channel;
            sum.image += image->mean[v];
            sum.reference += reference->mean[v];
            if (image->variance != NULL) sum.variance += image->variance[v];
            if (reference->variance != NULL) sum.variance += reference->variance[v];
        }
    double pixels = (double)width * height;
    return (region_t){sum.image / pixels, sum.reference / pixels, sum.variance / pixels};
}

/* The z of a region of `pixels` pixels. */
static double region_z(region_t region, double pixels, double tolerance, double least_variance)
{
    double slack = tolerance * region.reference;
    return (region.image - region.reference) /
           sqrt(region.variance / pixels + slack * slack + least_variance);
}

static void measure_means(const estimate_image_t *image, const estimate_image_t *reference,
                          agreement_t *agreement)
{
    double pixels = (double)image->width * image->height;
    for (size_t c = 0; c < 3; c++) {
        region_t whole = region_means(image, reference, 0, 0, image->width, image->height, c);
        agreement->mean_ratio[c] = whole.image / fmax(whole.reference, 1e-12);
        agreement->mean_z[c] = region_z(whole, pixels, mean_tolerance, mean_variance);
    }
}

static void measure_blocks(const estimate_image_t *image, const estimate_image_t *reference,
                           agreement_t *agreement)
{
    const int side = AGREEMENT_BLOCK, columns = image->width / side, rows = image->height / side;
    agreement->blocks = mem_alloc((size_t)columns * (size_t)rows * sizeof *agreement->blocks);
    double squares = 0;
    for (int b = 0; b < columns * rows; b++) {
        block_z_t *block = &agreement->blocks[agreement->block_count++];
        *block = (block_z_t){.x = b % columns * side, .y = b / columns * side};
        for (size_t c = 0; c < 3; c++) {
            region_t means = region_means(image, reference, block->x, block->y, side, side, c);
            block->z[c] = region_z(means, side * side, block_tolerance, block_variance);
            squares += block->z[c] * block->z[c];
            agreement->max_z = fmax(agreement->max_z, fabs(block->z[c]));
        }
    }
    agreement->rms_z = sqrt(squares / (3.0 * columns * rows));
}

void agreement_measure(const estimate_image_t *image, const estimate_image_t *reference,
                       agreement_t *agreement)
{
    *agreement = (agreement_t){.relmse = relative_error(image, reference)};
    if (reference->variance != NULL) agreement->relmse_floor = relative_error(NULL, reference);
    measure_means(image, reference, agreement);
    if (image->variance == NULL || image->width < AGREEMENT_BLOCK || image->height < AGREEMENT_BLOCK) return;
    measure_blocks(image, reference, agreement);
    agreement->tested = true;
}

void agreement_free(agreement_t *agreement)
{
    free(agreement->blocks);
    *agreement = (agreement_t){0};
}

bool agreement_holds(const agreement_t *agreement, const agreement_limits_t *limits)
{
    bool holds = agreement->tested && agreement->rms_z < limits->max_rms && agreement->max_z <= limits->max_z;
    for (size_t c = 0; c < 3; c++) holds = holds && fabs(agreement->mean_z[c]) <= limits->max_mean_z;
    return holds;
}

static double largest_z(const block_z_t *block)
{
    return fmax(fabs(block->z[0]), fmax(fabs(block->z[1]), fabs(block->z[2])));
}

static int by_largest_z(const void *a, const void *b)
{
    double left = largest_z(a), right = largest_z(b);
    return (left < right) - (left > right);
}

void agreement_sort_blocks(agreement_t *agreement)
{
    if (agreement->block_count == 0) return;
    qsort(agreement->blocks, agreement->block_count, sizeof *agreement->blocks, by_largest_z);
}
