/* Tests of the relay's ledger: every sample that it was given is free, out or summed, once, until it leaves.
 */
#include "relay/ledger.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { ROOM = 64, ALICE = 1, BOB = 2 };

static ledger_t ledger_of(void)
{
    job_settings_t settings = job_settings_default();
    settings.learn = false;
    ledger_t ledger;
    settings.width = settings.height = 64;
    settings.tile_size = 32;
    settings.spp = 1 << 20;
    ledger_init(&ledger, &settings);
    return ledger;
}

/* Samples a pixel that are free, with a worker (0: anybody), or summed. */
static uint32_t free_samples(const ledger_t *ledger)
{
    uint32_t samples = 0;
    for (size_t i = ledger->free.first; i < ledger->free.end; i++) samples += ledger->free.units[i].count;
    assert_true(ledger->free.samples == (uint64_t)samples * 32 * 32);
    return samples;
}

static uint32_t out_samples(const ledger_t *ledger, uint64_t worker)
{
    uint32_t samples = 0;
    for (size_t i = 0; i < ledger->out_count; i++)
        if (worker == 0 || ledger->out[i].worker == worker) samples += ledger->out[i].unit.count;
    return samples;
}

static uint32_t summed_samples(const ledger_t *ledger)
{
    uint32_t samples = 0;
    for (size_t i = 0; i < ledger->summed_count; i++) samples += ledger->summed[i].count;
    return samples;
}

static void units_are_lent_as_they_came(void **state)
{
    (void)state;
    ledger_t ledger = ledger_of();
    const unit_t units[] = {{0, 0, 4}, {1, 8, 4}, {0, 4, 2}};
    unit_t lent[ROOM];
    ledger_put(&ledger, units, 3);
    assert_int_equal(ledger_lend(&ledger, ALICE, 5 * 32 * 32, lent, ROOM), 2);
    assert_memory_equal(lent, units, 2 * sizeof *lent);
    assert_int_equal(ledger_lend(&ledger, BOB, 1, lent, ROOM), 1); /* at least one */
    assert_memory_equal(lent, units + 2, sizeof *lent);
    assert_int_equal(ledger_lend(&ledger, BOB, 1, lent, ROOM), 0);
    assert_int_equal(ledger_held(&ledger, ALICE), 2);
    assert_int_equal(ledger_held(&ledger, BOB), 1);
    assert_int_equal(ledger_units(&ledger), 3);
    assert_int_equal(ledger_list(&ledger, lent, ROOM), 3);
    ledger_free(&ledger);
}

static void what_is_here_is_not_taken_twice(void **state)
{
    (void)state;
    ledger_t ledger = ledger_of();
    unit_t lent[ROOM];
    const unit_t out = {0, 8, 8}, summed = {1, 0, 4}, waiting = {2, 0, 4};
    const unit_t again[] = {{0, 0, 32}, {1, 0, 8}, {2, 2, 4}, {3, 0, 1}, {3, 0, 1}};
    ledger_put(&ledger, &out, 1);
    ledger_put(&ledger, &summed, 1);
    assert_int_equal(ledger_lend(&ledger, ALICE, UINT64_MAX, lent, ROOM), 2);
    assert_int_equal(ledger_accept(&ledger, &summed, 1).code, RESULT_OK);
    ledger_put(&ledger, &waiting, 1);
    for (size_t i = 0; i < ARRAY_LENGTH(again); i++) ledger_put(&ledger, &again[i], 1);
    assert_int_equal(free_samples(&ledger), 4 + 24 + 4 + 2 + 1);
    assert_int_equal(out_samples(&ledger, ALICE), 8);
    ledger_free(&ledger);
}

static void a_batch_is_accepted_whole_or_not_at_all(void **state)
{
    (void)state;
    ledger_t ledger = ledger_of();
    unit_t lent[ROOM];
    const unit_t units[] = {{0, 0, 8}, {1, 0, 8}};
    ledger_put(&ledger, units, 2);
    ledger_lend(&ledger, ALICE, UINT64_MAX, lent, ROOM);
    const unit_t twice[] = {{0, 0, 4}, {0, 3, 2}}, strange[] = {{0, 0, 4}, {1, 4, 8}};
    assert_int_equal(ledger_accept(&ledger, twice, 2).code, RESULT_MISMATCH);
    assert_int_equal(ledger_accept(&ledger, strange, 2).code, RESULT_MISMATCH);
    assert_int_equal(out_samples(&ledger, ALICE), 16);
    assert_int_equal(summed_samples(&ledger), 0);
    /* A worker may cut a unit. */
    const unit_t parts[] = {{0, 2, 3}, {1, 0, 8}};
    assert_int_equal(ledger_accept(&ledger, parts, 2).code, RESULT_OK);
    assert_int_equal(out_samples(&ledger, ALICE), 5);
    assert_int_equal(summed_samples(&ledger), 11);
    assert_int_equal(ledger_accept(&ledger, parts, 1).code, RESULT_MISMATCH);
    const unit_t rest[] = {{0, 5, 3}, {0, 0, 2}};
    assert_int_equal(ledger_accept(&ledger, rest, 2).code, RESULT_OK);
    assert_int_equal(ledger_held(&ledger, ALICE), 0);
    ledger_settle(&ledger, parts, 2);
    ledger_settle(&ledger, rest, 2);
    assert_int_equal(ledger_units(&ledger), 0);
    /* What has left may be given again: the master did not count it after all. */
    ledger_put(&ledger, units, 2);
    assert_int_equal(free_samples(&ledger), 16);
    ledger_free(&ledger);
}

static void who_delivers_first_counts(void **state)
{
    (void)state;
    ledger_t ledger = ledger_of();
    unit_t lent[ROOM];
    const unit_t units[] = {{0, 0, 8}, {1, 0, 8}, {2, 0, 8}};
    ledger_put(&ledger, units, 3);
    ledger_lend(&ledger, ALICE, UINT64_MAX, lent, ROOM);
    assert_int_equal(ledger_return(&ledger, ALICE), 3); /* she is silent */
    assert_int_equal(ledger_lend(&ledger, BOB, 9 * 32 * 32, lent, ROOM), 2);
    /* But she delivers: one unit that Bob has, and one that is free. */
    const unit_t hers[] = {{1, 0, 8}, {2, 4, 4}};
    assert_int_equal(ledger_accept(&ledger, hers, 2).code, RESULT_OK);
    assert_int_equal(out_samples(&ledger, BOB), 8);
    assert_int_equal(free_samples(&ledger), 4);
    assert_int_equal(ledger_accept(&ledger, units, 2).code, RESULT_MISMATCH);
    assert_int_equal(ledger_return_units(&ledger, BOB, units, 2), 1);
    assert_int_equal(free_samples(&ledger), 12);
    assert_int_equal(ledger_return_units(&ledger, ALICE, units, 2), 0);
    ledger_free(&ledger);
}

static void claims_take_exactly_what_is_free(void **state)
{
    (void)state;
    ledger_t ledger = ledger_of();
    const unit_t unit = {0, 0, 16}, part = {0, 4, 4}, beyond = {0, 12, 8};
    ledger_put(&ledger, &unit, 1);
    assert_false(ledger_lend_unit(&ledger, ALICE, &beyond));
    assert_true(ledger_lend_unit(&ledger, ALICE, &part));
    assert_false(ledger_lend_unit(&ledger, BOB, &part));
    assert_int_equal(free_samples(&ledger), 12);
    assert_int_equal(out_samples(&ledger, ALICE), 4);
    ledger_drop_free(&ledger);
    assert_int_equal(free_samples(&ledger), 0);
    assert_int_equal(ledger_units(&ledger), 1);
    ledger_free(&ledger);
}

/* Whatever happens, no sample is lost and none is there twice. */
static void nothing_is_lost_whatever_happens(void **state)
{
    (void)state;
    enum { TILES = 4, SAMPLES = 64, STEPS = 20000 };
    ledger_t ledger = ledger_of();
    bool here[TILES][SAMPLES] = {{false}};
    unsigned seed = 5;
    uint64_t total = 0, delivered = 0;
    for (int step = 0; step < STEPS; step++) {
        unit_t lent[ROOM];
        uint32_t tile = (uint32_t)rand_r(&seed) % TILES, first = (uint32_t)rand_r(&seed) % SAMPLES;
        unit_t unit = {tile, first, 1 + (uint32_t)rand_r(&seed) % (SAMPLES - first)};
        uint64_t worker = 1 + (uint64_t)rand_r(&seed) % 3;
        switch (rand_r(&seed) % 7) {
        case 0:
            ledger_put(&ledger, &unit, 1);
            for (uint32_t s = first; s < first + unit.count; s++) {
                total += !here[tile][s];
                here[tile][s] = true;
            }
            break;
        case 1:
            ledger_lend(&ledger, worker, 1 + (uint64_t)rand_r(&seed) % 40000, lent, ROOM);
            break;
        case 2:
            ledger_return(&ledger, worker);
            break;
        case 3:
            ledger_accept(&ledger, &unit, 1);
            break;
        case 4:
            ledger_lend_unit(&ledger, worker, &unit);
            break;
        case 5:
            ledger_return_units(&ledger, worker, &unit, 1);
            break;
        case 6:
            if (ledger.summed_count == 0) break;
            unit = ledger.summed[(size_t)rand_r(&seed) % ledger.summed_count];
            ledger_settle(&ledger, &unit, 1);
            for (uint32_t s = unit.first; s < unit.first + unit.count; s++) here[unit.tile][s] = false;
            delivered += unit.count;
            break;
        }
        uint64_t sum = free_samples(&ledger) + out_samples(&ledger, 0) + summed_samples(&ledger);
        assert_true(sum + delivered == total);
    }
    assert_true(delivered > 1000);
    ledger_free(&ledger);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(units_are_lent_as_they_came),
        cmocka_unit_test(what_is_here_is_not_taken_twice),
        cmocka_unit_test(a_batch_is_accepted_whole_or_not_at_all),
        cmocka_unit_test(who_delivers_first_counts),
        cmocka_unit_test(claims_take_exactly_what_is_free),
        cmocka_unit_test(nothing_is_lost_whatever_happens),
    };
    return cmocka_run_group_tests_name("ledger", tests, NULL, NULL);
}
