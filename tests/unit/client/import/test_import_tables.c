/* Materials that are tables of BSDFs in files: what is in them, that they are read once, and what is said of
 * files that are none. */
#include "tests/unit/client/import/test_import.h"

#include "client/import/files/fourier_table.h"
#include "client/import/files/measured_table.h"
#include "tests/bsdf_files.h"

#define BALL "Shape \"sphere\"\n"
#define LAMP "LightSource \"point\"\n"
#define FOURIER(file) "Material \"fourier\" \"string bsdffile\" \"" file "\"\n"

static uint8_t *small_file(size_t *size)
{
    return fourier_file(4, 3, 8, 1.3f, fourier_glossy, size);
}

static void fourier_tables_are_read_once(void **state)
{
    (void)state;
    bench_t bench = {0};
    size_t size;
    uint8_t *file = small_file(&size);
    bench_write(&bench, "a.bsdf", file, size);
    bench_write(&bench, "b.bsdf", file, size);
    bench_run_v3(&bench, LAMP FOURIER("a.bsdf") BALL FOURIER("b.bsdf") BALL FOURIER("a.bsdf") BALL);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_FOURIERS], 2);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_SERIES], 2 * 16);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_MATERIALS], 3);
    for (uint32_t i = 0; i < 3; ++i) {
        assert_int_equal(bench.blob.materials[i].kind, MATERIAL_FOURIER);
        assert_int_equal(bench.blob.materials[i].table, i % 2);
    }
    const blob_fourier_t *table = &bench.blob.fouriers[1];
    assert_int_equal(table->nodes, 4);
    assert_int_equal(table->channels, 3);
    assert_true(table->eta == 1.3f);
    assert_true(bench.blob.numbers[table->first_node + 3] == 1);
    expect_near((double)bench.blob.numbers[table->first_node + 1], -0.5, 1e-6);
    /* Between a cosine of -0.5 and one of 0.5, reflected to the same azimuth, in red. */
    const blob_series_t *series = &bench.blob.series[table->first_series + 2 * 4 + 1];
    double sum = 0;
    for (uint32_t k = 0; k < series->count; ++k)
        sum += (double)bench.blob.numbers[series->first + series->count + k];
    expect_near(sum, fourier_glossy(-0.5, 0.5, 0, 1), 1e-3);
    free(file);
    bench_close(&bench);
}

/* As in pbrt-v3: "Tabulated BSDF file ... has an incompatible file format or version", and it goes on. */
static void what_is_no_fourier_table_is_black(void **state)
{
    (void)state;
    static const struct {
        const char *text, *warning;
    } cases[] = {
        {FOURIER("none.bsdf") BALL, "none.bsdf: cannot be opened"},
        {"Material \"fourier\"\n" BALL, "2:1: a fourier material needs a \"string bsdffile\""},
        {FOURIER("bad.bsdf") BALL, "bad.bsdf: does not begin with SCATFUN"},
    };
    bench_t bench = {0};
    bench_write(&bench, "bad.bsdf", "tensor_file", 11);
    for (size_t i = 0; i < ARRAY_LENGTH(cases); ++i) {
        bench.strict = true;
        bench_run_v3(&bench, cases[i].text);
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, cases[i].warning);
        bench.strict = false;
        bench_run_v3(&bench, cases[i].text);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, cases[i].warning);
        expect_text(bench.warnings, "the surface is black");
        assert_int_equal(bench.blob.materials[0].kind, MATERIAL_DIFFUSE);
        assert_true(v_is_zero(bench.blob.materials[0].values[VALUE_REFLECTANCE].factor));
    }
    bench_close(&bench);
}

/* Decodes a file with one word changed. */
static void expect_refusal(size_t at, uint32_t word, const char *message)
{
    size_t size;
    uint8_t *file = small_file(&size);
    fourier_table_t table;
    memcpy(file + at, &word, sizeof word);
    result_t result = fourier_table_decode("x.bsdf", file, size, &table);
    free(file);
    if (result.code != RESULT_INPUT) fail_msg("accepted: %s", message);
    expect_text(result.message, message);
}

static uint32_t bits(float x)
{
    uint32_t word;
    memcpy(&word, &x, sizeof word);
    return word;
}

static void damaged_fourier_tables_are_refused(void **state)
{
    (void)state;
    enum { NODES_AT = 64, SERIES_AT = NODES_AT + 4 * (4 + 16), COEFFICIENTS_AT = SERIES_AT + 8 * 16 };
    expect_refusal(4, 0, "does not begin with SCATFUN");
    expect_refusal(offsetof(fourier_header_t, flags), 3, "flags 3");
    expect_refusal(offsetof(fourier_header_t, bases), 2, "2 bases");
    expect_refusal(offsetof(fourier_header_t, nodes), 1, "has 1 cosines");
    expect_refusal(offsetof(fourier_header_t, nodes), UINT32_MAX, "cosines, must be 2 to 1024");
    expect_refusal(offsetof(fourier_header_t, nodes), 1024, "truncated?");
    expect_refusal(offsetof(fourier_header_t, coefficients), UINT32_MAX, "truncated?");
    expect_refusal(offsetof(fourier_header_t, channels), 2, "has 2 channels");
    expect_refusal(offsetof(fourier_header_t, eta), 0, "index of refraction is 0");
    expect_refusal(offsetof(fourier_header_t, eta), bits(NAN), "index of refraction is nan");
    expect_refusal(offsetof(fourier_header_t, longest), 2, "a series has at most 2 terms");
    expect_refusal(NODES_AT, bits(-1.1f), "do not ascend");
    expect_refusal(NODES_AT + 4, bits(-1), "do not ascend");
    expect_refusal(NODES_AT + 8, bits(NAN), "do not ascend");
    expect_refusal(SERIES_AT, 0x7FFFFFFF, "terms from coefficient 2147483647 on");
    expect_refusal(SERIES_AT + 4, 0xFFFFFFFF, "has 4294967295 terms");
    expect_refusal(COEFFICIENTS_AT + 4, bits(INFINITY), "coefficient 1 is not finite");
    size_t size;
    uint8_t *file = small_file(&size);
    fourier_table_t table;
    for (size_t cut = 0; cut < size; cut += cut < 80 ? 1 : 97) {
        uint8_t *part = malloc(cut + 1); /* ends where it ends, for the address sanitizer */
        memcpy(part, file, cut);
        assert_int_equal(fourier_table_decode("x.bsdf", part, cut, &table).code, RESULT_INPUT);
        free(part);
    }
    free(file);
}

/* Series that share their coefficients, which takes no room in the file, and much time to sum. */
static void small_files_do_not_take_long(void **state)
{
    (void)state;
    enum { NODES = 512, TERMS = 4096 };
    size_t words = 16 + NODES + 3 * NODES * NODES + TERMS;
    uint32_t *file = calloc(words, sizeof *file);
    fourier_header_t header = {.identifier = "SCATFUN",
                               .version = 1,
                               .flags = 1,
                               .nodes = NODES,
                               .coefficients = TERMS,
                               .longest = TERMS,
                               .channels = 1,
                               .bases = 1,
                               .eta = 1};
    memcpy(file, &header, sizeof header);
    for (uint32_t i = 0; i < NODES; ++i) file[16 + i] = bits(fourier_node(NODES, i));
    for (size_t i = 0; i < (size_t)NODES * NODES; ++i) file[16 + NODES + NODES * NODES + 2 * i + 1] = TERMS;
    fourier_table_t table;
    result_t result = fourier_table_decode("x.bsdf", (uint8_t *)file, words * sizeof *file, &table);
    assert_int_equal(result.code, RESULT_INPUT);
    expect_text(result.message, "its series have 1073741824 terms of 4096 coefficients");
    free(file);
}

/* ---- measured ------------------------------------------------------------------------------------------ */

#define MEASURED(file) "Material \"measured\" \"string filename\" \"" file "\"\n"

static void measured_tables_are_read_once(void **state)
{
    (void)state;
    bench_t bench = {0};
    size_t size;
    uint8_t *file = measured_file(false, true, 0.6, &size);
    bench_write(&bench, "a.bsdf", file, size);
    bench_run(&bench, "WorldBegin\nAttribute \"shape\" \"float alpha\" 1\n" LAMP MEASURED("a.bsdf")
                          BALL MEASURED("a.bsdf") BALL);
    bench_expect_silence(&bench);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_MEASUREMENTS], 1);
    assert_int_equal(bench.blob.counts[BLOB_SECTION_MATERIALS], 2);
    assert_int_equal(bench.blob.materials[1].kind, MATERIAL_MEASURED);
    const blob_measured_t *table = &bench.blob.measurements[0];
    assert_int_equal(table->isotropic, 0);
    assert_int_equal(table->azimuths, 9);
    assert_int_equal(table->elevations, 6);
    expect_near((double)bench.blob.numbers[table->first_elevation + 5], 1.4, 1e-6);
    rgb_t first = {bench.blob.numbers[table->first_colour], bench.blob.numbers[table->first_colour + 1],
                   bench.blob.numbers[table->first_colour + 2]};
    assert_true(first.x < first.y && first.y < first.z); /* spectra fall towards red */
    free(file);
    file = measured_file(true, false, 0.6, &size);
    bench_write(&bench, "a.bsdf", file, size);
    bench_run(&bench, "WorldBegin\nAttribute \"shape\" \"float alpha\" 1\n" LAMP MEASURED("a.bsdf") BALL);
    bench_expect_silence(&bench);
    table = &bench.blob.measurements[0];
    assert_int_equal(table->isotropic, 1);
    for (uint32_t c = 0; c < 3; ++c) /* constant spectra are white */
        expect_near((double)bench.blob.numbers[table->first_colour + c], 0.6, 1e-4);
    free(file);
    bench_close(&bench);
}

static void what_is_no_measurement_is_refused(void **state)
{
    (void)state;
    bench_t bench = {0};
    static const char *const files[] = {"none.bsdf", "bad.bsdf"};
    static const char *const messages[] = {"none.bsdf: cannot be opened",
                                           "bad.bsdf: does not begin with tensor_file"};
    bench_write(&bench, "bad.bsdf", "SCATFUN\1", 8);
    for (size_t i = 0; i < ARRAY_LENGTH(files); ++i) {
        char *text = mem_printf(
            "WorldBegin\nAttribute \"shape\" \"float alpha\" 1\n" LAMP MEASURED("%s") BALL, files[i]);
        bench.lenient = false;
        bench_run(&bench, text);
        assert_int_equal(bench.result.code, RESULT_INPUT);
        expect_text(bench.result.message, messages[i]);
        bench.lenient = true;
        bench_run(&bench, text);
        bench_expect_ok(&bench);
        expect_text(bench.warnings, messages[i]);
        assert_int_equal(bench.blob.materials[0].kind, MATERIAL_DIFFUSE);
        assert_true(bench.blob.materials[0].values[VALUE_REFLECTANCE].factor.x == 0.5f);
        free(text);
    }
    bench_close(&bench);
}

/* Decodes a file that has `size` bytes changed. */
static void expect_measured_refusal(size_t at, const void *bytes, size_t count, const char *message)
{
    size_t size;
    uint8_t *file = measured_file(true, false, 1, &size);
    measured_table_t table;
    memcpy(file + at, bytes, count);
    result_t result = measured_table_decode("x.bsdf", file, size, &table);
    free(file);
    if (result.code != RESULT_INPUT) fail_msg("accepted: %s", message);
    expect_text(result.message, message);
}

/* Where the field of that name begins in the file: at the length of its name. */
static size_t field_at(const char *name)
{
    size_t size, at = 0, length = strlen(name);
    uint8_t *file = measured_file(true, false, 1, &size);
    while (memcmp(file + at, name, length) != 0) ++at;
    free(file);
    return at - 2;
}

static void damaged_measurements_are_refused(void **state)
{
    (void)state;
    const uint64_t huge = UINT64_MAX, large = 1 << 20, one = 1;
    const float nan = NAN, minus = -1, infinite = INFINITY, far = 2e9f;
    uint8_t type = 11;
    expect_measured_refusal(12, "\2", 1, "does not begin with tensor_file");
    expect_measured_refusal(14, "\7", 1, "has no field spectra");
    expect_measured_refusal(14, &huge, 4, "is truncated among its fields");
    expect_measured_refusal(field_at("ndf"), &huge, 2, "is truncated among its fields");
    expect_measured_refusal(field_at("ndf") + 2, "x", 1, "has no field ndf");
    size_t vndf = field_at("vndf") + 6; /* its dimensions, type, offset, shape */
    expect_measured_refusal(vndf, "\3", 1, "field vndf has 3 dimensions");
    expect_measured_refusal(vndf, &huge, 2, "is truncated among its fields");
    expect_measured_refusal(vndf + 2, &type, 1, "of type 11");
    expect_measured_refusal(vndf + 3, &huge, 8, "is truncated among its fields");
    expect_measured_refusal(vndf + 3, &large, 8, "truncated");
    expect_measured_refusal(vndf + 11, &huge, 8, "field vndf lies outside the file");
    expect_measured_refusal(vndf + 19, &one, 8, "do not fit together");
    expect_measured_refusal(vndf + 35, &one, 8, "do not fit together");
    size_t numbers = 512; /* theta_i: 6, phi_i: 1, wavelengths: 5, ndf and sigma: 480 each, vndf: 2880 */
    expect_measured_refusal(numbers, &nan, 4, "theta_i does not ascend");
    expect_measured_refusal(numbers + 8, &minus, 4, "theta_i does not ascend");
    expect_measured_refusal(numbers + 4 * 6, &infinite, 4, "phi_i does not ascend");
    expect_measured_refusal(numbers + 4 * 5, &far, 4, "theta_i does not ascend, or is too large");
    expect_measured_refusal(numbers + 4 * 8, &minus, 4, "wavelengths does not ascend");
    expect_measured_refusal(numbers + 4 * 20, &nan, 4, "a number in field ndf is not finite");
    size_t size;
    uint8_t *file = measured_file(true, false, 1, &size);
    measured_table_t table;
    memset(file + numbers + 4 * (12 + 960), 0, 4 * 480);
    expect_text(measured_table_decode("x.bsdf", file, size, &table).message,
                "field vndf is black for outgoing direction 0");
    for (size_t cut = 0; cut < size; cut += cut < 512 ? 1 : 997) {
        uint8_t *part = malloc(cut + 1); /* ends where it ends, for the address sanitizer */
        memcpy(part, file, cut);
        assert_int_equal(measured_table_decode("x.bsdf", part, cut, &table).code, RESULT_INPUT);
        free(part);
    }
    free(file);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(fourier_tables_are_read_once),
        cmocka_unit_test(what_is_no_fourier_table_is_black),
        cmocka_unit_test(damaged_fourier_tables_are_refused),
        cmocka_unit_test(small_files_do_not_take_long),
        cmocka_unit_test(measured_tables_are_read_once),
        cmocka_unit_test(what_is_no_measurement_is_refused),
        cmocka_unit_test(damaged_measurements_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
