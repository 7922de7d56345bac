/* Tests of common/film/learning.c, and of lessons in batches: which pass a sample is of, what a plan is made
 * of, what is no plan, and which lessons a batch can have. */
#include "common/film/batch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static job_settings_t settings_of(bool adaptive)
{
    job_settings_t settings = job_settings_default();
    settings.width = settings.height = 16;
    settings.tile_size = 16;
    settings.spp = 1 << 16;
    settings.adaptive = adaptive;
    return settings;
}

/* ---- passes -------------------------------------------------------------------------------------------- */

static void bdpt_learns_unless_it_is_told_not_to(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(false), other = settings;
    assert_true(job_learns(&settings));
    other.learn = false;
    assert_false(job_learns(&other));
    other = settings;
    other.integrator = INTEGRATOR_PATH;
    assert_false(job_learns(&other));
    other = settings;
    other.strategy_s = other.strategy_t = 2;
    assert_false(job_learns(&other));
}

static void passes_double(void **state)
{
    (void)state;
    for (int adaptive = 0; adaptive < 2; adaptive++) {
        job_settings_t settings = settings_of(adaptive);
        uint32_t passes = learning_passes(&settings);
        assert_int_equal(learning_pass_begin(&settings, 0), 0);
        for (uint32_t pass = 1; pass < passes; pass++) {
            uint32_t begin = learning_pass_begin(&settings, pass);
            assert_int_equal(begin, 1u << pass);
            assert_int_equal(learning_pass(&settings, begin - 1), pass - 1);
            assert_int_equal(learning_pass(&settings, begin), pass);
        }
        assert_int_equal(learning_pass(&settings, JOB_MAX_SPP - 1), passes - 1);
        assert_true(learning_pass_begin(&settings, passes) == UINT32_MAX);
        assert_int_equal(learning_taught(&settings), passes - 2);
    }
}

/* The samples of a plan are older than the pass before it. */
static void a_plan_needs_not_the_last_pass(void **state)
{
    (void)state;
    assert_int_equal(learning_teachers(0), 0);
    assert_int_equal(learning_teachers(1), 0);
    for (uint32_t pass = 2; pass < LEARNING_PASSES; pass++)
        assert_int_equal(learning_teachers(pass), pass - 1);
}

static void units_wait_for_the_plan_of_their_pass(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(false);
    assert_true(learning_ready(&settings, 3, 0));
    assert_false(learning_ready(&settings, 4, 0));
    assert_true(learning_ready(&settings, 7, 1 << 2));
    assert_false(learning_ready(&settings, 8, 1 << 2));
    settings.learn = false;
    assert_true(learning_ready(&settings, 8, 0));
}

/* ---- plans --------------------------------------------------------------------------------------------- */

static int64_t *some_lessons(uint32_t passes)
{
    int64_t *lessons = mem_alloc((size_t)passes * LEARNING_PLACES * sizeof *lessons);
    for (size_t i = 0; i < (size_t)passes * LEARNING_PLACES; i++) lessons[i] = (int64_t)(i * i);
    return lessons;
}

/* All of a plan, in fresh memory. */
static uint8_t *plan_bytes(uint32_t pass, const int64_t *lessons, const hash_t *content)
{
    uint8_t *bytes = mem_alloc(learning_plan_bytes());
    learning_plan_write(pass, lessons, content, 0, bytes, learning_plan_bytes());
    return bytes;
}

static void a_plan_is_the_sum_of_its_passes(void **state)
{
    (void)state;
    hash_t content = hash_bytes("job", 3);
    int64_t *lessons = some_lessons(LEARNING_PASSES);
    for (uint32_t pass = 2; pass < LEARNING_PASSES; pass++) {
        uint8_t *bytes = plan_bytes(pass, lessons, &content);
        learning_plan_t got;
        assert_int_equal(learning_plan_read(bytes, learning_plan_bytes(), &content, &got).code, RESULT_OK);
        assert_int_equal(got.pass, pass);
        assert_int_equal(got.teachers, pass - 1);
        for (size_t i = 0; i < LEARNING_PLACES; i++) {
            int64_t sum = 0;
            for (size_t teacher = 0; teacher < pass - 1; teacher++)
                sum += lessons[teacher * LEARNING_PLACES + i];
            assert_int_equal(got.lessons[i], sum);
        }
        free(bytes);
    }
    free(lessons);
}

/* Whoever fetches a plan chooses the pieces. */
static void a_plan_comes_in_any_pieces(void **state)
{
    (void)state;
    hash_t content = hash_bytes("job", 3);
    int64_t *lessons = some_lessons(3);
    size_t size = learning_plan_bytes(), lengths[] = {1, 7, 48, 4096, 8191, 100000};
    uint8_t *whole = plan_bytes(4, lessons, &content), *bytes = mem_alloc(size);
    for (size_t i = 0; i < ARRAY_LENGTH(lengths); i++) {
        memset(bytes, 0xee, size);
        size_t length = lengths[i];
        for (size_t at = 0; at < size; at += length) {
            if (length == 1 && at == 100) at = size - 100; /* not everywhere */
            size_t part = length < size - at ? length : size - at;
            learning_plan_write(4, lessons, &content, at, bytes + at, part);
            assert_memory_equal(bytes + at, whole + at, part);
            if (at + part < size) assert_int_equal(bytes[at + part], 0xee);
        }
    }
    free(lessons);
    free(whole);
    free(bytes);
}

static void expect_refused(const uint8_t *bytes, size_t size, const hash_t *content, result_code_t code,
                           const char *text)
{
    learning_plan_t got;
    result_t result = learning_plan_read(bytes, size, content, &got);
    assert_int_equal(result.code, code);
    if (strstr(result.message, text) == NULL) fail_msg("'%s' does not say '%s'", result.message, text);
}

static void what_is_no_plan_is_refused(void **state)
{
    (void)state;
    hash_t content = hash_bytes("job", 3), other = hash_bytes("another", 7);
    int64_t *lessons = some_lessons(2);
    size_t size = learning_plan_bytes();
    uint8_t *bytes = mem_zalloc(size + 8, 1);
    learning_plan_write(3, lessons, &content, 0, bytes, size);
    expect_refused(bytes, 0, &content, RESULT_INPUT, "0 bytes");
    expect_refused(bytes, size - 1, &content, RESULT_INPUT, "pass 3");
    expect_refused(bytes, size + 8, &content, RESULT_INPUT, "pass 3");
    expect_refused(bytes, size, &other, RESULT_MISMATCH, "another job");
    bytes[8] = LEARNING_PASSES; /* the pass */
    expect_refused(bytes, size, &content, RESULT_INPUT, "a plan of pass");
    bytes[8] = 2;
    expect_refused(bytes, size, &content, RESULT_INPUT, "a plan of pass");
    bytes[0] ^= 1;
    expect_refused(bytes, size, &content, RESULT_INPUT, "no plan");
    free(bytes);
    free(lessons);
}

/* ---- lessons ------------------------------------------------------------------------------------------- */

/* A unit that notes `value` at a place. */
static void add_unit(batch_t *batch, uint32_t first, uint32_t count, size_t place, uint64_t value)
{
    unit_result_t result = {0};
    unit_result_reset(&result, &batch->settings, &(unit_t){0, first, count});
    if (job_learns(&batch->settings)) unit_result_teach(&result, place, value);
    batch_add(batch, &result);
    unit_result_free(&result);
}

static void lessons_are_summed_by_pass(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(false);
    batch_t batch;
    batch_init(&batch, &settings);
    add_unit(&batch, 0, 2, 5, 7);
    add_unit(&batch, 2, 1, 5, 8);
    add_unit(&batch, 3, 1, 5, 9);
    add_unit(&batch, 1 << (LEARNING_PASSES - 2), 1, 5, 10); /* it goes into no plan */
    const int64_t *sums = batch.sums[SUM_LESSONS].values;
    assert_int_equal(sums[5], 7);
    assert_int_equal(sums[LEARNING_PLACES + 5], 17);
    for (size_t i = 0; i < batch.sums[SUM_LESSONS].count; i++)
        if (i != 5 && i != LEARNING_PLACES + 5) assert_int_equal(sums[i], 0);
    assert_int_equal(batch_check_sums(&batch).code, RESULT_OK);
    batch_free(&batch);
}

static void a_job_that_does_not_learn_has_no_lessons(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(false);
    settings.learn = false;
    batch_t batch;
    batch_init(&batch, &settings);
    add_unit(&batch, 0, 2, 5, 7);
    assert_int_equal(batch.sums[SUM_LESSONS].count, 0);
    assert_int_equal(sum_image_values(&settings, SUM_LESSONS), 0);
    batch_free(&batch);
}

/* The units have 256 * 2 samples of pass 0 and 256 of pass 2, and none of others. */
static void lessons_that_no_sample_can_add_are_refused(void **state)
{
    (void)state;
    const int64_t most = (INT64_C(512) << LEARNING_BITS) - 1, half = (INT64_C(256) << LEARNING_BITS) - 1;
    const struct {
        size_t pass;
        int64_t value;
        bool good;
    } cases[] = {{0, most, true},       {0, most + 1, false}, {0, -1, false}, {1, 1, false},
                 {2, half, true},       {2, half + 1, false}, {3, 1, false},  {LEARNING_PASSES - 3, 1, false},
                 {0, INT64_MAX, false}, {2, INT64_MIN, false}};
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        job_settings_t settings = settings_of(false);
        batch_t batch;
        batch_init(&batch, &settings);
        add_unit(&batch, 0, 2, 0, 0);
        add_unit(&batch, 4, 1, 0, 0);
        batch_frame(&batch, SUM_LESSONS)[cases[i].pass * LEARNING_PLACES + i] = cases[i].value;
        result_t result = batch_check_sums(&batch);
        assert_int_equal(result.code, cases[i].good ? RESULT_OK : RESULT_PROTOCOL);
        if (!cases[i].good) assert_non_null(strstr(result.message, "lesson sums"));
        batch_free(&batch);
    }
}

/* All samples that a pass may have, in the largest image, at the most that each may add. */
static void lessons_cannot_overflow(void **state)
{
    (void)state;
    job_settings_t settings = settings_of(false);
    settings.width = 32768;
    settings.height = JOB_MAX_PIXELS / settings.width;
    settings.tile_size = JOB_MAX_TILE;
    settings.spp = JOB_MAX_SPP;
    uint32_t pass = learning_taught(&settings) - 1, tiles = job_tile_count(&settings);
    batch_t batch = {.settings = settings, .units = mem_alloc(tiles * sizeof(unit_t)), .unit_count = tiles};
    uint32_t begin = learning_pass_begin(&settings, pass);
    for (uint32_t t = 0; t < tiles; t++)
        batch.units[t] = (unit_t){t, begin, learning_pass_begin(&settings, pass + 1) - begin};
    lesson_limits_t limits = batch_lesson_limits(&batch);
    uint32_t bits =
        LEARNING_BITS + pass + 27; /* the pass has 2^pass samples a pixel, the image 2^27 pixels */
    assert_int_equal(limits.limit[pass], UINT64_C(1) << bits);
    for (uint32_t t = 0; t < tiles; t++) batch.units[t].count = JOB_MAX_SPP - begin; /* nobody issues such */
    limits = batch_lesson_limits(&batch);
    assert_true(limits.limit[pass] == UINT64_C(1) << 62);
    free(batch.units);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(bdpt_learns_unless_it_is_told_not_to),
                                       cmocka_unit_test(passes_double),
                                       cmocka_unit_test(a_plan_needs_not_the_last_pass),
                                       cmocka_unit_test(units_wait_for_the_plan_of_their_pass),
                                       cmocka_unit_test(a_plan_is_the_sum_of_its_passes),
                                       cmocka_unit_test(a_plan_comes_in_any_pieces),
                                       cmocka_unit_test(what_is_no_plan_is_refused),
                                       cmocka_unit_test(lessons_are_summed_by_pass),
                                       cmocka_unit_test(a_job_that_does_not_learn_has_no_lessons),
                                       cmocka_unit_test(lessons_that_no_sample_can_add_are_refused),
                                       cmocka_unit_test(lessons_cannot_overflow)};
    return cmocka_run_group_tests_name("learning", tests, NULL, NULL);
}
