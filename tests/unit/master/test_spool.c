/* Batches on the disk: what is written comes back, with light groups and without; files of masters that knew
 * three payloads only are still read, and written the same. */
#include "master/store/spool.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

static const spool_name_t name = {.kind = SPOOL_KEPT, .clock = 3, .serial = 4};
static const char FILE_NAME[] = "0000000000000003-0000000000000004.kept";

static job_settings_t settings_of(const char *groups)
{
    job_settings_t settings = job_settings_default();
    settings.width = settings.height = 64;
    settings.spp = 64;
    settings.learn = false; /* its payload is the last one */
    strcpy(settings.light_groups, groups);
    return settings;
}

/* A batch of one unit, with a splat. */
static batch_t batch_of(const job_settings_t *settings)
{
    batch_t batch;
    unit_result_t result = {0};
    batch_init(&batch, settings);
    unit_result_reset(&result, settings, &(unit_t){1, 2, 3});
    for (sum_kind_t k = 0; k < BATCH_SUMS; k++)
        for (size_t i = 0; i < result.sums[k].count; i++)
            result.sums[k].values[i] = (int64_t)((unsigned)k * 1000 + i);
    splat_t splat = {17 | 1 << SPLAT_GROUP_SHIFT, {1, 2, 3}};
    if (settings->light_groups[0] == '\0') splat.pixel = 17;
    result.splats = &splat;
    result.splat_count = 1;
    batch_add(&batch, &result);
    result.splats = NULL;
    unit_result_free(&result);
    return batch;
}

/* Writes it and reads it back; returns the path of its file. */
static char *check_round_trip(const char *folder, const job_settings_t *settings)
{
    batch_t batch = batch_of(settings);
    zmq_msg_t written[BATCH_PAYLOADS], read[BATCH_PAYLOADS];
    spool_head_t head = {.units = batch.units, .unit_count = 1, .counts = {{5, 6}, 1, 2, 3, 4}}, found;
    strcpy(head.name, "a worker");
    assert_int_equal(payload_encode(&batch, written).code, RESULT_OK);
    assert_int_equal(spool_write(folder, 7, &name, &head, written).code, RESULT_OK);
    assert_int_equal(spool_read(folder, 7, &name, settings, &found, read).code, RESULT_OK);
    assert_int_equal(found.unit_count, 1);
    assert_memory_equal(found.units, batch.units, sizeof *found.units);
    assert_memory_equal(&found.counts, &head.counts, sizeof head.counts);
    assert_string_equal(found.name, head.name);
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        assert_int_equal(zmq_msg_size(&read[i]), zmq_msg_size(&written[i]));
        if (zmq_msg_size(&read[i]) > 0)
            assert_memory_equal(zmq_msg_data(&read[i]), zmq_msg_data(&written[i]), zmq_msg_size(&read[i]));
        zmq_msg_close(&read[i]);
        zmq_msg_close(&written[i]);
    }
    spool_head_free(&found);
    batch_free(&batch);
    char *jobs = scratch_path(folder, "job-7"), *path = scratch_path(jobs, FILE_NAME);
    free(jobs);
    return path;
}

static void what_is_written_comes_back(void **state)
{
    (void)state;
    const char *const groups[] = {"", "a=0,b=1", "a=0,b=1,rest"};
    const char digits[] = {'1', '1' + SUM_GROUP_SPLAT - SUM_FEATURES, '1' + SUM_GROUP_SPLAT - SUM_FEATURES};
    for (size_t i = 0; i < ARRAY_LENGTH(groups); i++) {
        char *folder = scratch_new();
        job_settings_t settings = settings_of(groups[i]);
        char *path = check_round_trip(folder, &settings);
        uint8_t *bytes;
        size_t size;
        assert_int_equal(file_read(path, 1 << 24, &bytes, &size).code, RESULT_OK);
        assert_memory_equal(bytes, "LMSPOOL", 7);
        assert_int_equal(bytes[7], digits[i]);
        free(bytes);
        free(path);
        scratch_destroy(&folder);
    }
}

/* The files are of a master that knew no light groups. */
static void old_files_are_read_and_written_the_same(void **state)
{
    (void)state;
    for (int i = 1; i <= 3; i++) {
        char *folder = scratch_new(), *jobs = scratch_path(folder, "job-1"),
             *path = scratch_path(jobs, FILE_NAME);
        char *seed = mem_printf("tests/fuzz/seeds/spool/batch-%d", i);
        uint8_t *old, *again;
        size_t old_size, again_size;
        assert_int_equal(file_read(seed, 1 << 20, &old, &old_size).code, RESULT_OK);
        assert_int_equal(mkdir(jobs, 0700), 0);
        FILE *file = fopen(path, "wb");
        assert_int_equal(fwrite(old, 1, old_size, file), old_size);
        fclose(file);
        job_settings_t settings = settings_of("");
        spool_head_t head;
        zmq_msg_t payload[BATCH_PAYLOADS];
        assert_string_equal(spool_read(folder, 1, &name, &settings, &head, payload).message, "");
        assert_int_equal(unlink(path), 0);
        assert_string_equal(spool_write(folder, 1, &name, &head, payload).message, "");
        assert_int_equal(file_read(path, 1 << 20, &again, &again_size).code, RESULT_OK);
        assert_int_equal(again_size, old_size);
        assert_memory_equal(again, old, old_size);
        for (int p = 0; p < BATCH_PAYLOADS; p++) zmq_msg_close(&payload[p]);
        spool_head_free(&head);
        free(old);
        free(again);
        free(seed);
        free(path);
        free(jobs);
        scratch_destroy(&folder);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(what_is_written_comes_back),
                                       cmocka_unit_test(old_files_are_read_and_written_the_same)};
    return cmocka_run_group_tests_name("spool", tests, NULL, NULL);
}
