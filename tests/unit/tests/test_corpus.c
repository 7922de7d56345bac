/* Every seed of tests/fuzz/seeds once through its fuzz target: what once was a finding stays mended. The
 * targets themselves end the process when something is wrong; under `make asan` the sanitizers look as well.
 * The last line of the log names the seed. */
#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "tests/fuzz/fuzz.h"

static int is_seed(const struct dirent *entry)
{
    return entry->d_name[0] != '.';
}

/* Seeds in the order of their names; returns how many there are. */
static int run_seeds(const char *folder, int (*target)(const uint8_t *data, size_t size))
{
    struct dirent **entries;
    char *path = mem_printf("tests/fuzz/seeds/%s", folder);
    int count = scandir(path, &entries, is_seed, alphasort);
    if (count < 0) fail_msg("no folder %s: tests run from the repository's root", path);
    for (int i = 0; i < count; ++i) {
        char *seed = mem_printf("%s/%s", path, entries[i]->d_name);
        uint8_t *data;
        size_t size;
        puts(seed);
        fflush(stdout);
        result_t result = file_read(seed, 1 << 24, &data, &size);
        assert_string_equal(result.message, "");
        target(data, size);
        free(data);
        free(seed);
        free(entries[i]);
    }
    free(entries);
    free(path);
    return count;
}

static void test_blob(void **state)
{
    (void)state;
    assert_true(run_seeds("blob", fuzz_blob) > 0);
}

static void test_render(void **state)
{
    (void)state;
    assert_true(run_seeds("blob", fuzz_render) + run_seeds("render", fuzz_render) > 0);
}

static void test_pbrt(void **state)
{
    (void)state;
    assert_true(run_seeds("pbrt", fuzz_pbrt) > 0);
}

static void test_gltf(void **state)
{
    (void)state;
    assert_true(run_seeds("gltf", fuzz_gltf) > 0);
}

static void test_ply(void **state)
{
    (void)state;
    assert_true(run_seeds("ply", fuzz_ply) > 0);
}

static void test_spool(void **state)
{
    (void)state;
    assert_true(run_seeds("spool", fuzz_spool) > 0);
}

static void test_spectrum(void **state)
{
    (void)state;
    assert_true(run_seeds("spectrum", fuzz_spectrum) > 0);
}

static void test_texture_image(void **state)
{
    (void)state;
    assert_true(run_seeds("texture_image", fuzz_texture_image) > 0);
}

static void test_wire(void **state)
{
    (void)state;
    assert_true(run_seeds("wire", fuzz_wire) > 0);
}

static void test_payload(void **state)
{
    (void)state;
    assert_true(run_seeds("payload", fuzz_payload) > 0);
}

static void test_allow_list(void **state)
{
    (void)state;
    assert_true(run_seeds("allow_list", fuzz_allow_list) > 0);
}

static void test_checkpoint(void **state)
{
    (void)state;
    assert_true(run_seeds("checkpoint", fuzz_checkpoint) > 0);
}

static void test_record(void **state)
{
    (void)state;
    assert_true(run_seeds("record", fuzz_record) > 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_blob),          cmocka_unit_test(test_render),
        cmocka_unit_test(test_pbrt),          cmocka_unit_test(test_gltf),
        cmocka_unit_test(test_ply),           cmocka_unit_test(test_spectrum),
        cmocka_unit_test(test_texture_image), cmocka_unit_test(test_checkpoint),
        cmocka_unit_test(test_wire),          cmocka_unit_test(test_payload),
        cmocka_unit_test(test_allow_list),    cmocka_unit_test(test_spool),
        cmocka_unit_test(test_record),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
