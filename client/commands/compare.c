/* compare: `lightmill compare`, the command around agreement.h: options, files, report. */
#include "client/commands/commands.h"
#include "client/image/agreement.h"
#include "common/image/image.h"
#include "common/text/json.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

typedef struct {
    const char *image, *reference; /* the arguments */
    const char *image_stderr;
    option_list_t runs;
    agreement_limits_t limits;
    int worst;
    bool json;
} values_t;

static const option_t noise_rows[] = {
    OPTION(values_t, runs, "runs", "A.exr B.exr ...",
           "independent, equally long renders; IMG is their mean, and may be given as -", .many = true),
    OPTION(values_t, image_stderr, "img-stderr", "X.exr", "standard error of each pixel of IMG"),
};
static const option_group_t noise_options = OPTION_GROUP("The noise of IMG", noise_rows);

static const option_t rows[] = {
    OPTION(values_t, limits.max_rms, "max-rms", "X", "largest rms of the block z (default: 1.25)",
           OPTION_RANGE(0, 1e9)),
    OPTION(values_t, limits.max_z, "max-z", "X", "largest |z| of a block (default: 6)", OPTION_RANGE(0, 1e9)),
    OPTION(values_t, limits.max_mean_z, "max-mean-z", "X",
           "largest |z| of the image mean of a channel (default: 4)", OPTION_RANGE(0, 1e9)),
    OPTION(values_t, worst, "worst", "N", "list the N blocks with the largest |z|", OPTION_RANGE(0, INT_MAX)),
    OPTION(values_t, json, "json", NULL, "print one JSON object instead of text"),
};
static const option_group_t compare_options = OPTION_GROUP("The test and its report", rows);

static void begin(void *data)
{
    ((values_t *)data)->limits = agreement_default_limits();
}

static result_t check_values(const values_t *values)
{
    if (values->runs.count > 0 && values->image_stderr != NULL)
        return result_fail(RESULT_USAGE, "give --runs or --img-stderr, not both");
    if (values->runs.count == 1)
        return result_fail(RESULT_USAGE, "--runs takes two or more images; one says nothing of its noise");
    if (strcmp(values->image, "-") == 0 && values->runs.count == 0)
        return result_fail(RESULT_USAGE, "the image '-' is the mean of --runs, which are missing");
    return result_ok();
}

/* ---- images ---- */

static double *make_plane(const estimate_image_t *image)
{
    return mem_zalloc((size_t)image->width * (size_t)image->height * 3, sizeof(double));
}

static void copy_rgb(const image_t *image, const image_channel_t *rgb[3], double *values)
{
    size_t pixels = (size_t)image->width * (size_t)image->height;
    for (size_t p = 0; p < pixels; p++)
        for (size_t c = 0; c < 3; c++) values[3 * p + c] = (double)rgb[c]->data[p * rgb[c]->stride];
}

/* Standard errors to variances; one that is not a number >= 0 tells nothing. */
static result_t square_errors(const char *path, const estimate_image_t *image, double *values)
{
    size_t count = (size_t)image->width * (size_t)image->height * 3;
    for (size_t v = 0; v < count; v++) {
        if (!(values[v] >= 0) || !isfinite(values[v]))
            return result_fail(RESULT_INPUT, "%s: a standard error is %g, expected a number >= 0", path,
                               values[v]);
        values[v] *= values[v];
    }
    return result_ok();
}

static result_t convert_image(const char *path, const image_t *file, estimate_image_t *image)
{
    const image_channel_t *rgb[3];
    *image = (estimate_image_t){.width = file->width, .height = file->height};
    if (!image_find_rgb(file, NULL, rgb))
        return result_fail(RESULT_INPUT, "%s: has no channels R, G and B", path);
    image->mean = make_plane(image);
    copy_rgb(file, rgb, image->mean);
    if (!image_find_rgb(file, "noise", rgb)) return result_ok();
    image->variance = make_plane(image);
    copy_rgb(file, rgb, image->variance);
    return square_errors(path, image, image->variance);
}

/* Reads R, G, B and, where there is a noise layer, the variance. On failure there is nothing to free. */
static result_t load_image(const char *path, estimate_image_t *image)
{
    image_t file;
    *image = (estimate_image_t){0};
    TRY(image_read_exr(path, &file));
    result_t result = convert_image(path, &file, image);
    image_free(&file);
    if (result.code != RESULT_OK) estimate_image_free(image);
    return result;
}

static result_t same_size(const char *path, const estimate_image_t *a, const char *other,
                          const estimate_image_t *b)
{
    if (a->width == b->width && a->height == b->height) return result_ok();
    return result_fail(RESULT_INPUT, "%s is %d x %d pixels, but %s is %d x %d", path, a->width, a->height,
                       other, b->width, b->height);
}

/* Replaces what is known of an image's noise by the standard errors in a file. */
static result_t load_errors(const char *path, const char *image_path, estimate_image_t *image)
{
    estimate_image_t errors;
    TRY(load_image(path, &errors));
    result_t result = same_size(path, &errors, image_path, image);
    if (result.code == RESULT_OK) result = square_errors(path, &errors, errors.mean);
    if (result.code == RESULT_OK) {
        free(image->variance);
        image->variance = errors.mean;
        errors.mean = NULL;
    }
    estimate_image_free(&errors);
    return result;
}

static result_t load_reference(const char *path, estimate_image_t *reference)
{
    struct stat about;
    if (stat(path, &about) != 0 || !S_ISDIR(about.st_mode)) return load_image(path, reference);
    char *mean = mem_printf("%s/ref.exr", path), *errors = mem_printf("%s/stderr.exr", path);
    result_t result = load_image(mean, reference);
    if (result.code == RESULT_OK) {
        result = load_errors(errors, mean, reference);
        if (result.code != RESULT_OK) estimate_image_free(reference);
    }
    free(mean);
    free(errors);
    return result;
}

/* Adds a run to sums of values and squares of differences to the first run, which keeps them well
 * conditioned. */
static result_t add_run(const char *path, const char *first_path, const estimate_image_t *first,
                        estimate_image_t *sums)
{
    estimate_image_t run;
    TRY(load_image(path, &run));
    result_t result = same_size(path, &run, first_path, first);
    size_t count = (size_t)first->width * (size_t)first->height * 3;
    for (size_t v = 0; result.code == RESULT_OK && v < count; v++) {
        double difference = run.mean[v] - first->mean[v];
        sums->mean[v] += difference;
        sums->variance[v] += difference * difference;
    }
    estimate_image_free(&run);
    return result;
}

/* The mean of the runs and the variance of that mean, from their scatter. */
static result_t load_runs(const values_t *values, estimate_image_t *mean)
{
    estimate_image_t first;
    TRY(load_image(values->runs.texts[0], &first));
    *mean = (estimate_image_t){.width = first.width, .height = first.height};
    mean->mean = make_plane(mean);
    mean->variance = make_plane(mean);
    result_t result = result_ok();
    for (size_t i = 1; result.code == RESULT_OK && i < values->runs.count; i++)
        result = add_run(values->runs.texts[i], values->runs.texts[0], &first, mean);
    size_t count = (size_t)first.width * (size_t)first.height * 3;
    double runs = (double)values->runs.count;
    for (size_t v = 0; v < count; v++) {
        double shift = mean->mean[v] / runs;
        double scatter = fmax(mean->variance[v] - runs * shift * shift, 0.0) / (runs - 1);
        mean->mean[v] = first.mean[v] + shift;
        mean->variance[v] = scatter / runs;
    }
    estimate_image_free(&first);
    if (result.code != RESULT_OK) estimate_image_free(mean);
    return result;
}

/* The runs tell the noise of their mean only. */
static result_t check_mean(const values_t *values, const estimate_image_t *image,
                           const estimate_image_t *mean)
{
    TRY(same_size(values->image, image, values->runs.texts[0], mean));
    double largest = 1e-12, off = 0;
    size_t count = (size_t)image->width * (size_t)image->height * 3;
    for (size_t v = 0; v < count; v++) {
        largest = fmax(largest, fabs(image->mean[v]));
        off = fmax(off, fabs(image->mean[v] - mean->mean[v]));
    }
    if (off <= 1e-3 * largest) return result_ok();
    return result_fail(RESULT_INPUT,
                       "%s is not the mean of the --runs (largest difference %.3g of its maximum)",
                       values->image, off / largest);
}

static result_t load_image_with_runs(const values_t *values, estimate_image_t *image)
{
    estimate_image_t mean;
    TRY(load_runs(values, &mean));
    if (strcmp(values->image, "-") == 0) {
        *image = mean;
        return result_ok();
    }
    result_t result = load_image(values->image, image);
    if (result.code == RESULT_OK && estimate_image_not_finite(image) == 0) {
        result = check_mean(values, image, &mean);
        if (result.code != RESULT_OK) estimate_image_free(image);
    }
    if (result.code == RESULT_OK) {
        free(image->variance);
        image->variance = mean.variance;
        mean.variance = NULL;
    }
    estimate_image_free(&mean);
    return result;
}

static result_t load_tested(const values_t *values, estimate_image_t *image)
{
    if (values->runs.count > 0) return load_image_with_runs(values, image);
    TRY(load_image(values->image, image));
    if (values->image_stderr == NULL) return result_ok();
    result_t result = load_errors(values->image_stderr, values->image, image);
    if (result.code != RESULT_OK) estimate_image_free(image);
    return result;
}

/* ---- the report ---- */

static void print_text(const agreement_t *a, const values_t *values, bool exact, bool holds)
{
    printf("relMSE      %.6f   (reference floor %.6f%s)\n", a->relmse, a->relmse_floor,
           exact ? "; its noise is unknown and taken as none" : "");
    printf("mean ratio  R %.5f  G %.5f  B %.5f\n", a->mean_ratio[0], a->mean_ratio[1], a->mean_ratio[2]);
    if (!a->tested) return;
    printf("block z     rms %.3f  max %.2f   (%zu blocks x 3 channels)\n", a->rms_z, a->max_z,
           a->block_count);
    printf("mean z      R %+.2f  G %+.2f  B %+.2f\n", a->mean_z[0], a->mean_z[1], a->mean_z[2]);
    for (size_t i = 0; i < (size_t)values->worst && i < a->block_count; i++) {
        const block_z_t *b = &a->blocks[i];
        printf("  block x %d..%d  y %d..%d  z R %+.2f  G %+.2f  B %+.2f\n", b->x, b->x + AGREEMENT_BLOCK - 1,
               b->y, b->y + AGREEMENT_BLOCK - 1, b->z[0], b->z[1], b->z[2]);
    }
    puts(holds ? "PASS" : "FAIL");
}

static json_t *three(const double values[3])
{
    json_t *array = json_array();
    for (size_t c = 0; c < 3; c++) json_array_append_new(array, json_number(values[c]));
    return array;
}

static json_t *worst_blocks(const agreement_t *a, size_t count)
{
    json_t *array = json_array();
    for (size_t i = 0; i < count && i < a->block_count; i++) {
        json_t *block = json_pack("{sisi}", "x", a->blocks[i].x, "y", a->blocks[i].y);
        json_object_set_new(block, "z", three(a->blocks[i].z));
        json_array_append_new(array, block);
    }
    return array;
}

static void print_json(const agreement_t *a, const values_t *values, bool exact, bool holds)
{
    json_t *root = json_object();
    put_real(root, "relmse", a->relmse);
    put_real(root, "relmse_floor", a->relmse_floor);
    put_flag(root, "reference_exact", exact);
    json_object_set_new(root, "mean_ratio", three(a->mean_ratio));
    put_flag(root, "tested", a->tested);
    if (a->tested) {
        put_real(root, "block_z_rms", a->rms_z);
        put_real(root, "block_z_max", a->max_z);
        put_count(root, "blocks", a->block_count);
        json_object_set_new(root, "mean_z", three(a->mean_z));
        json_object_set_new(root, "worst", worst_blocks(a, (size_t)values->worst));
        put_flag(root, "pass", holds);
    }
    json_print(root, 0, 9);
}

static result_t verdict(const values_t *values, const agreement_t *a, bool noise_known, bool holds)
{
    if (!noise_known)
        return result_fail(RESULT_INPUT,
                           "no agreement test: %s has no noise.* layer; give --runs or --img-stderr",
                           values->image);
    if (!a->tested)
        return result_fail(RESULT_INPUT, "no agreement test: the image is smaller than a block of %d x %d",
                           AGREEMENT_BLOCK, AGREEMENT_BLOCK);
    if (holds) return result_ok();
    return result_fail(
        RESULT_MISMATCH, "%s does not agree with %s (rms z %.3f, max %.2f, mean z %.2f %.2f %.2f)",
        values->image, values->reference, a->rms_z, a->max_z, a->mean_z[0], a->mean_z[1], a->mean_z[2]);
}

static result_t compare_images(const values_t *values, const estimate_image_t *image,
                               const estimate_image_t *reference)
{
    TRY(same_size(values->image, image, values->reference, reference));
    if (estimate_image_not_finite(reference) > 0)
        return result_fail(RESULT_INPUT, "%s: has pixels that are not finite", values->reference);
    size_t bad = estimate_image_not_finite(image);
    if (bad > 0) return result_fail(RESULT_MISMATCH, "%s: %zu pixels are not finite", values->image, bad);

    agreement_t agreement;
    agreement_measure(image, reference, &agreement);
    agreement_sort_blocks(&agreement);
    bool holds = agreement_holds(&agreement, &values->limits), exact = reference->variance == NULL;
    (values->json ? print_json : print_text)(&agreement, values, exact, holds);
    result_t result = verdict(values, &agreement, image->variance != NULL, holds);
    agreement_free(&agreement);
    return result;
}

static result_t run_compare(const values_t *values)
{
    estimate_image_t reference, image;
    TRY(load_reference(values->reference, &reference));
    result_t result = load_tested(values, &image);
    if (result.code == RESULT_OK) {
        result = compare_images(values, &image, &reference);
        estimate_image_free(&image);
    }
    estimate_image_free(&reference);
    return result;
}

static result_t run(const call_t *call)
{
    values_t *values = call->values;
    values->image = call->arguments[0];
    values->reference = call->arguments[1];
    TRY(check_values(values));
    return run_compare(values);
}

const command_t compare_command = {
    .name = "lightmill compare",
    .arguments = "IMG.exr REF",
    .summary = "compare two images",
    .about =
        "Compares an image with a reference. REF is a folder with ref.exr and stderr.exr (standard error of "
        "each pixel), or an EXR; its own noise.* layer is then its standard error, and without one it "
        "counts as exact.\n\nThe noise of IMG, needed to tell an error from noise, is its noise.* layer, or "
        "given by --runs or --img-stderr.",
    .groups = {{&noise_options, 0}, {&compare_options, 0}},
    .after =
        "Printed: relMSE (mean squared relative error without the worst 0.1 % of the pixels; floor: that of "
        "the reference's own noise), mean ratio IMG / REF, and z, differences over standard errors, of "
        "blocks of 8 x 8 pixels and of the image means. The exit code says whether noise explains every "
        "difference: 0 yes, 8 no.",
    .size = sizeof(values_t),
    .begin = begin,
    .run = run};
