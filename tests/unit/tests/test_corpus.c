/* Every seed of tests/fuzz/seeds once through its fuzz target: what once was a finding stays mended. The
 * targets themselves end the process when something is wrong; under `make asan` the sanitizers look as well.
 * The last line of the log names the seed.
 *
 * Seeds that somebody named are files, seeds/TARGET/NAME; those that only a fuzzer found, and whose names are
 * hashes, are members of seeds/TARGET.tar. */
#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "tests/fuzz/fuzz.h"

typedef int target_t(const uint8_t *data, size_t size);

enum { TAR_BLOCK = 512, TAR_SIZE_AT = 124, TAR_SIZE_LENGTH = 12, MAX_SEED = 1 << 24, MAX_ARCHIVE = 1 << 28 };

/* A copy that ends where the seed ends, so that the address sanitizer sees who reads on. */
static void run_seed(const char *name, const uint8_t *data, size_t size, target_t *target)
{
    puts(name);
    fflush(stdout);
    uint8_t *copy = mem_alloc(size > 0 ? size : 1);
    memcpy(copy, data, size);
    target(copy, size);
    free(copy);
}

static int is_seed(const struct dirent *entry)
{
    return entry->d_name[0] != '.';
}

/* In the order of their names; returns how many there are. */
static int run_files(const char *folder, target_t *target)
{
    struct dirent **entries;
    int count = scandir(folder, &entries, is_seed, alphasort);
    if (count < 0) fail_msg("no folder %s: tests run from the repository's root", folder);
    for (int i = 0; i < count; ++i) {
        char *seed = mem_printf("%s/%s", folder, entries[i]->d_name);
        uint8_t *data;
        size_t size;
        assert_string_equal(file_read(seed, MAX_SEED, &data, &size).message, "");
        run_seed(seed, data, size, target);
        free(data);
        free(seed);
        free(entries[i]);
    }
    free(entries);
    return count;
}

/* The members of an archive in the format ustar (POSIX.1-1988): a block with name and octal size, then the
 * contents, filled up to whole blocks; a block without a name ends it. Returns how many there are; 0 without
 * an archive. */
static int run_archive(const char *path, target_t *target)
{
    uint8_t *archive;
    size_t size, at = 0;
    int count = 0;
    if (file_read(path, MAX_ARCHIVE, &archive, &size).code != RESULT_OK) return 0;
    for (; at + TAR_BLOCK <= size && archive[at] != '\0'; ++count) {
        char name[101] = {0}, octal[TAR_SIZE_LENGTH + 1] = {0};
        memcpy(name, archive + at, 100);
        memcpy(octal, archive + at + TAR_SIZE_AT, TAR_SIZE_LENGTH);
        size_t length = strtoul(octal, NULL, 8);
        at += TAR_BLOCK;
        assert_in_range(length, 0, size - at);
        run_seed(name, archive + at, length, target);
        at += (length + TAR_BLOCK - 1) / TAR_BLOCK * TAR_BLOCK;
    }
    free(archive);
    return count;
}

static void run_seeds(const char *name, target_t *target)
{
    char *folder = mem_printf("tests/fuzz/seeds/%s", name), *archive = mem_printf("%s.tar", folder);
    int files = run_files(folder, target), members = run_archive(archive, target);
    printf("%s: %d files, %d members\n", name, files, members);
    assert_true(files > 0);
    assert_true(members > 0 || access(archive, F_OK) != 0);
    free(archive);
    free(folder);
}

#define SEEDS_END_WELL(name)                                                                                 \
    static void seeds_of_##name##_end_well(void **state)                                                     \
    {                                                                                                        \
        (void)state;                                                                                         \
        run_seeds(#name, fuzz_##name);                                                                       \
    }
SEEDS_END_WELL(allow_list)
SEEDS_END_WELL(blob)
SEEDS_END_WELL(body)
SEEDS_END_WELL(checkpoint)
SEEDS_END_WELL(draco)
SEEDS_END_WELL(fourier)
SEEDS_END_WELL(gltf)
SEEDS_END_WELL(http)
SEEDS_END_WELL(lens)
SEEDS_END_WELL(measured)
SEEDS_END_WELL(meshopt)
SEEDS_END_WELL(mitsuba)
SEEDS_END_WELL(nanovdb)
SEEDS_END_WELL(obj)
SEEDS_END_WELL(payload)
SEEDS_END_WELL(pbrt)
SEEDS_END_WELL(ply)
SEEDS_END_WELL(record)
SEEDS_END_WELL(render)
SEEDS_END_WELL(spectrum)
SEEDS_END_WELL(spool)
SEEDS_END_WELL(texture_image)
SEEDS_END_WELL(wire)

static void seeds_of_blob_render_or_are_refused(void **state)
{
    (void)state;
    run_seeds("blob", fuzz_render);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(seeds_of_allow_list_end_well),
        cmocka_unit_test(seeds_of_blob_end_well),
        cmocka_unit_test(seeds_of_blob_render_or_are_refused),
        cmocka_unit_test(seeds_of_body_end_well),
        cmocka_unit_test(seeds_of_checkpoint_end_well),
        cmocka_unit_test(seeds_of_draco_end_well),
        cmocka_unit_test(seeds_of_fourier_end_well),
        cmocka_unit_test(seeds_of_gltf_end_well),
        cmocka_unit_test(seeds_of_http_end_well),
        cmocka_unit_test(seeds_of_lens_end_well),
        cmocka_unit_test(seeds_of_measured_end_well),
        cmocka_unit_test(seeds_of_meshopt_end_well),
        cmocka_unit_test(seeds_of_mitsuba_end_well),
        cmocka_unit_test(seeds_of_nanovdb_end_well),
        cmocka_unit_test(seeds_of_obj_end_well),
        cmocka_unit_test(seeds_of_payload_end_well),
        cmocka_unit_test(seeds_of_pbrt_end_well),
        cmocka_unit_test(seeds_of_ply_end_well),
        cmocka_unit_test(seeds_of_record_end_well),
        cmocka_unit_test(seeds_of_render_end_well),
        cmocka_unit_test(seeds_of_spectrum_end_well),
        cmocka_unit_test(seeds_of_spool_end_well),
        cmocka_unit_test(seeds_of_texture_image_end_well),
        cmocka_unit_test(seeds_of_wire_end_well),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
