/* Tests of id_table.c. */
#include "common/id_table.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

enum { NUMBERS = 500, STEPS = 20000 };

/* A number that lies anywhere among all 64-bit numbers, and is 0 or the greatest at times. */
static uint64_t number_of(size_t i)
{
    return i == 0 ? 0 : i == 1 ? UINT64_MAX : i * UINT64_C(0x9E3779B97F4A7C15);
}

static void an_empty_table_finds_nothing(void **state)
{
    (void)state;
    id_table_t table = {.entries = NULL};
    assert_true(id_table_find(&table, 0) == SIZE_MAX);
    id_table_remove(&table, 7);
    assert_int_equal(table.count, 0);
    id_table_free(&table);
}

static void it_finds_what_was_put_last_and_not_removed(void **state)
{
    (void)state;
    id_table_t table = {.entries = NULL};
    size_t expected[NUMBERS], there = 0;
    uint32_t random = 1;
    for (size_t i = 0; i < NUMBERS; i++) expected[i] = SIZE_MAX;
    for (size_t step = 0; step < STEPS; step++) {
        random = random * 1664525 + 1013904223;
        size_t i = (random >> 8) % NUMBERS;
        there -= expected[i] != SIZE_MAX;
        expected[i] = random >> 31 ? step : SIZE_MAX;
        there += expected[i] != SIZE_MAX;
        if (expected[i] != SIZE_MAX)
            id_table_put(&table, number_of(i), expected[i]);
        else
            id_table_remove(&table, number_of(i));
        assert_int_equal(table.count, there);
    }
    for (size_t i = 0; i < NUMBERS; i++) assert_true(id_table_find(&table, number_of(i)) == expected[i]);
    assert_true(id_table_find(&table, 12345) == SIZE_MAX);
    id_table_free(&table);
    assert_true(id_table_find(&table, number_of(2)) == SIZE_MAX);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_empty_table_finds_nothing),
        cmocka_unit_test(it_finds_what_was_put_last_and_not_removed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
