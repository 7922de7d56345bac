/* Tests of `lightmill compare`: the numbers of agreement.h by hand and against figures from another program,
 * the statistics on images with known noise, and the command with its exit codes. Runs from the top of the
 * tree, for tests/references. */
#include "client/commands/commands.h"
#include "client/image/agreement.h"
#include "common/image/image.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static int setup(void **state)
{
    *state = scratch_new();
    return 0;
}

static int teardown(void **state)
{
    scratch_destroy((char **)state);
    return 0;
}

static void assert_near(double value, double expected, double relative)
{
    if (!(fabs(value - expected) <= relative * fabs(expected)))
        fail_msg("got %.12g, expected %.12g", value, expected);
}

/* ---- random numbers ---- */

static double uniform(uint64_t *state)
{
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return ((double)(*state >> 11) + 0.5) * 0x1p-53;
}

/* Box-Muller, one value of the pair. */
static double normal(uint64_t *state)
{
    double radius = sqrt(-2 * log(uniform(state)));
    return radius * cos(6.283185307179586 * uniform(state));
}

/* ---- images in memory ---- */

static estimate_image_t make_image(int width, int height, double mean, double variance)
{
    estimate_image_t image = {.width = width, .height = height};
    size_t count = (size_t)width * (size_t)height * 3;
    image.mean = mem_alloc(count * sizeof(double));
    image.variance = mem_alloc(count * sizeof(double));
    for (size_t v = 0; v < count; v++) {
        image.mean[v] = mean;
        image.variance[v] = variance;
    }
    return image;
}

static void relmse_leaves_out_the_worst_pixels(void **state)
{
    (void)state;
    estimate_image_t reference = make_image(50, 40, 0.5, 0.0004), image = make_image(50, 40, 0.6, 0);
    agreement_t agreement;
    image.mean[3 * 17] = 1000; /* floor(0.001 x 2000) = 2 pixels are left out */
    image.mean[3 * 1999 + 2] = -1000;
    agreement_measure(&image, &reference, &agreement);
    assert_near(agreement.relmse, 0.01 / 0.26, 1e-12);
    assert_near(agreement.relmse_floor, 0.0004 / 0.26, 1e-12);
    assert_near(agreement.mean_ratio[1], 1.2, 1e-12);
    agreement_free(&agreement);

    image.mean[3 * 100 + 1] = 3.5; /* the third is not */
    agreement_measure(&image, &reference, &agreement);
    assert_near(agreement.relmse, (1997 * 0.01 + (2 * 0.01 + 9) / 3) / 0.26 / 1998, 1e-12);
    agreement_free(&agreement);
    estimate_image_free(&reference);
    estimate_image_free(&image);
}

static void z_is_the_difference_over_the_errors(void **state)
{
    (void)state;
    /* Two blocks and a rim that fills none. */
    estimate_image_t reference = make_image(20, 12, 0.5, 0.0004), image = make_image(20, 12, 0.5, 0.0012);
    agreement_t agreement;
    for (size_t x = 8; x < 16; x++)
        image.mean[3 * (3 * 20 + x) + 1] += 0.08;              /* one row of the second, green */
    for (size_t x = 16; x < 20; x++) image.mean[3 * x] += 100; /* in the rim, red */
    agreement_measure(&image, &reference, &agreement);
    double error = sqrt(0.0016 / 64 + 0.0005 * 0.0005 + 1e-12);
    assert_true(agreement.tested);
    assert_int_equal(agreement.block_count, 2);
    assert_int_equal(agreement.blocks[1].x, 8);
    assert_int_equal(agreement.blocks[1].y, 0);
    assert_near(agreement.blocks[1].z[1], 0.01 / error, 1e-9);
    assert_true(agreement.blocks[1].z[0] == 0 && agreement.blocks[0].z[1] == 0);
    assert_near(agreement.max_z, 0.01 / error, 1e-9);
    assert_near(agreement.rms_z, 0.01 / error / sqrt(6), 1e-9);
    double mean_error = sqrt(0.0016 / 240 + 0.00005 * 0.00005 + 1e-16);
    assert_near(agreement.mean_z[1], 0.64 / 240 / mean_error, 1e-9);
    assert_near(agreement.mean_z[0], 400.0 / 240 / mean_error, 1e-9);
    agreement_sort_blocks(&agreement);
    assert_int_equal(agreement.blocks[0].x, 8);
    agreement_free(&agreement);

    free(image.variance);
    image.variance = NULL;
    agreement_measure(&image, &reference, &agreement);
    assert_false(agreement.tested);
    agreement_limits_t limits = agreement_default_limits();
    assert_false(agreement_holds(&agreement, &limits));
    agreement_free(&agreement);
    estimate_image_free(&reference);
    estimate_image_free(&image);
}

static void each_limit_counts(void **state)
{
    (void)state;
    const agreement_limits_t limits = agreement_default_limits();
    const agreement_t good = {.tested = true, .rms_z = 1.24, .max_z = 6.0, .mean_z = {4.0, -4.0, 0}};
    agreement_t bad = good;
    assert_true(agreement_holds(&good, &limits));
    bad.rms_z = 1.25;
    assert_false(agreement_holds(&bad, &limits));
    bad = good;
    bad.max_z = 6.01;
    assert_false(agreement_holds(&bad, &limits));
    bad = good;
    bad.mean_z[1] = -4.01;
    assert_false(agreement_holds(&bad, &limits));
    bad = good;
    bad.mean_z[2] = NAN;
    assert_false(agreement_holds(&bad, &limits));
    bad = good;
    bad.tested = false;
    assert_false(agreement_holds(&bad, &limits));
}

/* ---- statistics ---- */

/* The picture of a film whose halves have normal noise: mean and |difference| / 2 of two values a pixel. */
static void make_noisy(const estimate_image_t *truth, double sigma, uint64_t *random, estimate_image_t *image)
{
    *image = make_image(truth->width, truth->height, 0, 0);
    for (size_t v = 0; v < (size_t)truth->width * (size_t)truth->height * 3; v++) {
        double scale = sigma * (0.2 + truth->mean[v]);
        double a = truth->mean[v] + scale * normal(random), b = truth->mean[v] + scale * normal(random);
        image->mean[v] = (a + b) / 2;
        image->variance[v] = (a - b) * (a - b) / 4;
    }
}

static estimate_image_t make_truth(void)
{
    estimate_image_t truth = make_image(128, 128, 0, 1e-8);
    for (size_t v = 0; v < 128 * 128 * 3; v++) truth.mean[v] = 0.5 + 0.4 * sin((double)v * 0.001);
    return truth;
}

/* With one degree of freedom a pixel, the z of an unbiased image must still look standard normal: Student's t
 * with 64 degrees has an rms of sqrt(64 / 62) = 1.016. */
static void noise_of_one_degree_passes(void **state)
{
    (void)state;
    estimate_image_t truth = make_truth();
    agreement_limits_t limits = agreement_default_limits();
    uint64_t random = 1;
    double squares = 0;
    enum { ROUNDS = 40 };
    for (int round = 0; round < ROUNDS; round++) {
        estimate_image_t image;
        agreement_t agreement;
        make_noisy(&truth, 0.3, &random, &image);
        agreement_measure(&image, &truth, &agreement);
        assert_true(agreement_holds(&agreement, &limits));
        squares += agreement.rms_z * agreement.rms_z;
        agreement_free(&agreement);
        estimate_image_free(&image);
    }
    /* 30720 values: the standard error of the rms is 0.004. */
    assert_near(sqrt(squares / ROUNDS), sqrt(64.0 / 62.0), 0.02);
    estimate_image_free(&truth);
}

static bool holds_when_scaled(const estimate_image_t *truth, double sigma, double factor, size_t from,
                              size_t to)
{
    agreement_limits_t limits = agreement_default_limits();
    uint64_t random = 7;
    estimate_image_t image;
    agreement_t agreement;
    make_noisy(truth, sigma, &random, &image);
    for (size_t v = from; v < to; v++) image.mean[v] *= factor;
    agreement_measure(&image, truth, &agreement);
    bool holds = agreement_holds(&agreement, &limits);
    agreement_free(&agreement);
    estimate_image_free(&image);
    return holds;
}

static void errors_beyond_the_noise_fail(void **state)
{
    (void)state;
    estimate_image_t truth = make_truth();
    size_t all = 128 * 128 * 3;
    assert_true(holds_when_scaled(&truth, 0.3, 1.0, 0, all));
    assert_false(holds_when_scaled(&truth, 0.3, 1.01, 0, all));              /* all too bright: the mean z */
    assert_false(holds_when_scaled(&truth, 0.3, 1.4, 3 * 640, 3 * 128 * 9)); /* a band: the block z */
    assert_true(holds_when_scaled(&truth, 3.0, 1.01, 0, all));               /* drowned in noise */
    estimate_image_free(&truth);
}

/* ---- the command ---- */

/* Runs compare with up to 12 arguments, ended by NULL, and keeps its output in fresh memory. */
static result_t run(const char *folder, char **output, const char *first, ...)
{
    char *argv[16] = {"compare"};
    int argc = 1;
    va_list list;
    va_start(list, first);
    for (const char *word = first; word != NULL && argc < 15; word = va_arg(list, const char *))
        argv[argc++] = (char *)word;
    va_end(list);
    scratch_capture_t capture = scratch_capture(folder, 1);
    result_t result = command_run(&compare_command, argc, argv);
    char *text = scratch_uncapture(&capture);
    if (output != NULL)
        *output = text;
    else
        free(text);
    return result;
}

static void assert_result(result_t result, result_code_t code, const char *part)
{
    if (result.code != code || strstr(result.message, part) == NULL)
        fail_msg("expected code %d with '%s', got code %d: %s", code, part, result.code, result.message);
}

/* The numbers behind a key in a JSON object, up to three. */
static void json_numbers(const char *json, const char *key, double *values, int count)
{
    char *quoted = mem_printf("\"%s\": ", key);
    const char *at = strstr(json, quoted);
    assert_non_null(at);
    at += strlen(quoted);
    for (int i = 0; i < count; i++) {
        char *end;
        at += strspn(at, "[ ,");
        values[i] = strtod(at, &end);
        assert_ptr_not_equal(end, at);
        at = end;
    }
    free(quoted);
}

static void assert_json(const char *json, const char *key, double a, double b, double c)
{
    double values[3] = {0}, expected[3] = {a, b, c};
    int count = isnan(b) ? 1 : 3;
    json_numbers(json, key, values, count);
    for (int i = 0; i < count; i++) assert_near(values[i], expected[i], 2e-7);
}

/* The expected numbers come from another implementation of the same definitions, in Python with numpy. */
static void numbers_agree_with_another_program(void **state)
{
    char *json;
    result_t result =
        run(*state, &json, "tests/references/seed-diffuse/ref.exr", "tests/references/seed-specular",
            "--img-stderr", "tests/references/seed-diffuse/stderr.exr", "--json", "--worst", "1", NULL);
    assert_int_equal(result.code, RESULT_MISMATCH);
    assert_json(json, "relmse", 0.1566829664, NAN, NAN);
    assert_json(json, "relmse_floor", 7.946732465e-05, NAN, NAN);
    assert_json(json, "mean_ratio", 0.9951700696, 0.9908790357, 1.0073911365);
    assert_json(json, "block_z_rms", 185.0445566, NAN, NAN);
    assert_json(json, "block_z_max", 853.6741982, NAN, NAN);
    assert_json(json, "mean_z", -14.0755422202, -25.2578197382, 18.4673690121);
    assert_json(json, "worst\": [{\"x", 80, NAN, NAN);
    assert_json(json, "z", 836.8751003368, 509.6731826356, 853.6741982344);
    assert_non_null(strstr(json, "\"pass\": false"));
    free(json);

    result = run(*state, &json, "-", "tests/references/seed-specular", "--json", "--worst", "1", "--runs",
                 "tests/references/seed-diffuse/ref.exr", "tests/references/seed-specular/ref.exr",
                 "tests/references/seed-hidden/ref.exr", NULL);
    assert_int_equal(result.code, RESULT_MISMATCH);
    assert_json(json, "relmse", 0.3639198529, NAN, NAN);
    assert_json(json, "mean_ratio", 0.9993820936, 0.9637293319, 0.9633684945);
    assert_json(json, "block_z_rms", 7.213310349, NAN, NAN);
    assert_json(json, "mean_z", -0.0488331096, -2.7195043923, -2.4590845861);
    assert_json(json, "worst\": [{\"x", 88, NAN, NAN);
    assert_json(json, "z", 14.9610702002, 10.9129989677, 14.5593428805);
    free(json);
}

static void own_noise_layer_is_used(void **state)
{
    char *path = scratch_path(*state, "a.exr"), *text;
    image_t reference, errors, image;
    assert_int_equal(image_read_exr("tests/references/caustic/ref.exr", &reference).code, RESULT_OK);
    assert_int_equal(image_read_exr("tests/references/caustic/stderr.exr", &errors).code, RESULT_OK);
    image_init(&image, reference.width, reference.height);
    const char *const names[2][3] = {{"R", "G", "B"}, {"noise.R", "noise.G", "noise.B"}};
    uint64_t random = 3;
    for (size_t c = 0; c < 3; c++) {
        float *mean = image_add_channel(&image, names[0][c], PIXEL_FLOAT);
        float *noise = image_add_channel(&image, names[1][c], PIXEL_FLOAT);
        const float *truth = image_find(&reference, names[0][c])->data,
                    *error = image_find(&errors, names[0][c])->data;
        for (size_t p = 0; p < 128 * 128; p++) {
            /* The reference's noise is that of its own renders, not of ours. */
            double a = (double)truth[p] + 6 * (double)error[p] * normal(&random);
            double b = (double)truth[p] + 6 * (double)error[p] * normal(&random);
            mean[p] = (float)((a + b) / 2);
            noise[p] = (float)(fabs(a - b) / 2);
        }
    }
    assert_int_equal(image_write_exr(path, &image).code, RESULT_OK);
    assert_result(run(*state, &text, path, "tests/references/caustic", NULL), RESULT_OK, "");
    assert_non_null(strstr(text, "PASS"));
    free(text);
    /* Against another scene, and with a limit that nothing passes. */
    assert_result(run(*state, NULL, path, "tests/references/cornell", NULL), RESULT_MISMATCH,
                  "does not agree with");
    assert_result(run(*state, NULL, path, "tests/references/caustic", "--max-rms", "0.5", NULL),
                  RESULT_MISMATCH, "");
    assert_result(run(*state, NULL, path, "tests/references/caustic", "--max-z=1", NULL), RESULT_MISMATCH,
                  "");
    assert_result(run(*state, NULL, path, "tests/references/caustic", "--max-mean-z", "0", NULL),
                  RESULT_MISMATCH, "");
    /* An image as its own reference has both noises. */
    assert_result(run(*state, &text, path, path, NULL), RESULT_OK, "");
    assert_null(strstr(text, "taken as none"));
    free(text);
    /* A NaN is a failure of the image. */
    image.channels[0].plane[77] = NAN;
    assert_int_equal(image_write_exr(path, &image).code, RESULT_OK);
    assert_result(run(*state, NULL, path, "tests/references/caustic", NULL), RESULT_MISMATCH,
                  "1 pixels are not finite");
    image.channels[0].plane[77] = 0;
    image.channels[1].plane[77] = -1;
    assert_int_equal(image_write_exr(path, &image).code, RESULT_OK);
    assert_result(run(*state, NULL, path, "tests/references/caustic", NULL), RESULT_INPUT,
                  "standard error is -1");
    image_free(&image);
    image_free(&reference);
    image_free(&errors);
    free(path);
}

static void what_cannot_be_tested_is_no_pass(void **state)
{
    char *small = scratch_path(*state, "small.exr"), *text;
    static const char reference[] = "tests/references/cornell/ref.exr", folder[] = "tests/references/cornell";
    assert_result(run(*state, &text, reference, folder, NULL), RESULT_INPUT, "give --runs or --img-stderr");
    assert_non_null(strstr(text, "relMSE      0.000000"));
    assert_null(strstr(text, "PASS"));
    free(text);
    assert_result(run(*state, NULL, "none.exr", folder, NULL), RESULT_INPUT, "none.exr: cannot be opened");
    assert_result(run(*state, NULL, reference, "tests/unit", NULL), RESULT_INPUT, "tests/unit/ref.exr");
    assert_result(
        run(*state, NULL, reference, folder, "--runs", reference, "tests/references/caustic/ref.exr", NULL),
        RESULT_INPUT, "is not the mean of the --runs");
    image_t image;
    image_init(&image, 4, 4);
    for (int c = 0; c < 3; c++) image_add_channel(&image, (const char *[]){"R", "G", "B"}[c], PIXEL_FLOAT);
    assert_int_equal(image_write_exr(small, &image).code, RESULT_OK);
    assert_result(run(*state, NULL, small, folder, NULL), RESULT_INPUT, "4 x 4 pixels");
    assert_result(run(*state, &text, small, small, "--img-stderr", small, NULL), RESULT_INPUT,
                  "smaller than a block");
    assert_non_null(strstr(text, "taken as none"));
    free(text);
    image.channels[2].name[0] = 'X';
    assert_int_equal(image_write_exr(small, &image).code, RESULT_OK);
    assert_result(run(*state, NULL, small, folder, NULL), RESULT_INPUT, "no channels R, G and B");
    image_free(&image);
    free(small);
}

static void usage_errors_name_the_cure(void **state)
{
    char *text;
    assert_result(run(*state, NULL, NULL), RESULT_USAGE, "expects IMG.exr REF");
    assert_result(run(*state, NULL, "a", NULL), RESULT_USAGE, "expects IMG.exr REF");
    assert_result(run(*state, NULL, "a", "b", "c", NULL), RESULT_USAGE, "'c'");
    assert_result(run(*state, NULL, "a", "b", "--bogus", NULL), RESULT_USAGE, "--bogus");
    assert_result(run(*state, NULL, "a", "b", "--max-z", "much", NULL), RESULT_USAGE,
                  "--max-z takes a number");
    assert_result(run(*state, NULL, "a", "b", "--worst", "1.5", NULL), RESULT_USAGE,
                  "--worst takes a whole number");
    assert_result(run(*state, NULL, "a", "b", "--max-z", NULL), RESULT_USAGE, "--max-z needs a value");
    assert_result(run(*state, NULL, "a", "b", "--runs", "c", NULL), RESULT_USAGE, "two or more");
    assert_result(run(*state, NULL, "-", "b", NULL), RESULT_USAGE, "--runs");
    assert_result(run(*state, NULL, "a", "b", "--runs", "c", "d", "--img-stderr", "e", NULL), RESULT_USAGE,
                  "not both");
    assert_result(run(*state, &text, "--help", NULL), RESULT_OK, "");
    assert_non_null(strstr(text, "usage: lightmill compare IMG.exr REF"));
    free(text);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, setup, teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {TEST(relmse_leaves_out_the_worst_pixels),
                                       TEST(z_is_the_difference_over_the_errors),
                                       TEST(each_limit_counts),
                                       TEST(noise_of_one_degree_passes),
                                       TEST(errors_beyond_the_noise_fail),
                                       TEST(numbers_agree_with_another_program),
                                       TEST(own_noise_layer_is_used),
                                       TEST(what_cannot_be_tested_is_no_pass),
                                       TEST(usage_errors_name_the_cure)};
    return cmocka_run_group_tests_name("compare", tests, NULL, NULL);
}
