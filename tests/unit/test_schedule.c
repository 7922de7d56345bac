/* Tests of master/schedule.c, among them a random farm that is compared, sample by sample, with a table. */
#include "master/schedule.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static job_settings_t small_job(uint32_t spp)
{
    job_settings_t settings = job_settings_default();
    settings.width = 70; /* 5 x 3 tiles of 16; the rim is 6 and 8 pixels wide */
    settings.height = 40;
    settings.tile_size = 16;
    settings.spp = spp;
    return settings;
}

static schedule_wish_t wish(uint64_t worker, uint64_t samples, uint64_t unit_samples)
{
    return (schedule_wish_t){worker, samples, unit_samples, 1, 1};
}

static void hands_out_every_sample_once(void **state)
{
    (void)state;
    job_settings_t settings = small_job(8);
    schedule_t *schedule = schedule_new(&settings);
    uint8_t seen[15][8] = {{0}};
    unit_t units[64];
    uint64_t samples = 0;
    for (size_t n; (n = schedule_take(schedule, &(schedule_wish_t){1, 1 << 20, 600, 1, 1}, units, 64)) > 0;) {
        for (size_t i = 0; i < n; i++) {
            assert_true(job_unit_valid(&settings, &units[i]));
            for (uint32_t s = 0; s < units[i].count; s++)
                assert_int_equal(seen[units[i].tile][units[i].first + s]++, 0);
            samples += (uint64_t)units[i].count * job_tile_pixels(&settings, units[i].tile);
        }
        assert_int_equal(schedule_accept(schedule, units, n).code, RESULT_OK);
        assert_int_equal(schedule_done(schedule), samples);
    }
    assert_true(schedule_complete(schedule));
    assert_int_equal(samples, 70 * 40 * 8);
    assert_int_equal(schedule_spans(schedule), 15); /* one counted span a tile */
    schedule_destroy(&schedule);
    assert_null(schedule);
}

static void follows_the_wish(void **state)
{
    (void)state;
    job_settings_t settings = small_job(1024);
    schedule_t *schedule = schedule_new(&settings);
    unit_t units[1000];
    schedule_wish_t w = wish(1, 256 * 40, 256 * 8);
    uint32_t reach[15] = {0};
    for (int round = 0; round < 30; round++) {
        size_t n = schedule_take(schedule, &w, units, 1000);
        assert_true(n > 0);
        for (size_t i = 0; i < n; i++) {
            uint32_t limit = 2048 / job_tile_pixels(&settings, units[i].tile);
            assert_true(units[i].count <= limit);
            /* the first of a tile covers the image fast, later ones are as large as wished */
            if (units[i].first >= limit) assert_int_equal(units[i].count, limit);
            reach[units[i].tile] = units[i].first + units[i].count;
        }
    }
    uint32_t low = UINT32_MAX, high = 0;
    for (int t = 0; t < 15; t++) {
        if (reach[t] < low) low = reach[t];
        if (reach[t] > high) high = reach[t];
    }
    assert_true(high - low <= 2048 / 48); /* evenly: no tile is ahead by more than one unit */
    schedule_destroy(&schedule);
}

static void covers_the_image_first_when_time_ends_the_job(void **state)
{
    (void)state;
    job_settings_t settings = small_job(JOB_MAX_SPP);
    settings.time_limit = 60;
    schedule_t *schedule = schedule_new(&settings);
    unit_t units[15];
    schedule_wish_t w = wish(1, 1 << 30, 1 << 20);
    assert_int_equal(schedule_take(schedule, &w, units, 15), 15);
    for (uint32_t i = 0; i < 15; i++) {
        assert_int_equal(units[i].tile, i);
        assert_int_equal(units[i].count, 1);
    }
    schedule_destroy(&schedule);
}

static void shares_what_is_left(void **state)
{
    (void)state;
    job_settings_t settings = small_job(16);
    schedule_t *schedule = schedule_new(&settings);
    unit_t units[1000];
    /* Greedy workers with four threads each ask in turn: none gets more than half its share of what is left.
     */
    uint64_t left = 70 * 40 * 16;
    for (uint64_t worker = 1; schedule_available(schedule); worker = worker % 4 + 1) {
        schedule_wish_t w = {worker, UINT64_MAX, UINT64_MAX, 4, 16};
        size_t n = schedule_take(schedule, &w, units, 1000);
        assert_true(n > 0);
        uint64_t got = 0;
        for (size_t i = 0; i < n; i++)
            got += (uint64_t)units[i].count * job_tile_pixels(&settings, units[i].tile);
        assert_true(got <= left / 8 + left / 64 + 256); /* and one unit */
        if (left > 8192) assert_true(n >= 4);           /* something for each thread */
        left -= got;
    }
    assert_int_equal(left, 0);
    schedule_destroy(&schedule);
}

static void refuses_what_was_counted(void **state)
{
    (void)state;
    job_settings_t settings = small_job(16);
    schedule_t *schedule = schedule_new(&settings);
    const unit_t a[] = {{0, 0, 4}, {1, 0, 4}}, overlap[] = {{2, 0, 4}, {1, 3, 2}},
                 twice[] = {{3, 0, 4}, {3, 2, 4}};
    assert_int_equal(schedule_accept(schedule, a, 2).code, RESULT_OK);
    uint64_t done = schedule_done(schedule);
    assert_int_equal(schedule_accept(schedule, a, 2).code, RESULT_MISMATCH);
    assert_int_equal(schedule_accept(schedule, overlap, 2).code, RESULT_MISMATCH);
    assert_int_equal(schedule_accept(schedule, twice, 2).code, RESULT_MISMATCH);
    assert_int_equal(schedule_done(schedule), done); /* all or none */
    assert_int_equal(schedule_accept(schedule, overlap, 1).code, RESULT_OK);
    schedule_destroy(&schedule);
}

static void gives_back_what_a_lost_worker_held(void **state)
{
    (void)state;
    job_settings_t settings = small_job(4);
    schedule_t *schedule = schedule_new(&settings);
    unit_t mine[8], again[8], theirs[64];
    schedule_wish_t w1 = wish(1, 1, 1 << 20), w2 = wish(2, 1, 1 << 20);
    assert_int_equal(schedule_take(schedule, &w1, mine, 8), 1);
    assert_int_equal(schedule_take(schedule, &w2, theirs, 8), 1);
    assert_int_equal(schedule_holders(schedule), 2);
    assert_int_equal(schedule_release(schedule, 1), 1);
    assert_int_equal(schedule_release(schedule, 1), 0);
    assert_int_equal(schedule_held(schedule, 1), 0);
    assert_int_equal(schedule_held(schedule, 2), 1);
    /* The returned unit goes out first. */
    assert_int_equal(schedule_take(schedule, &w2, again, 8), 1);
    assert_memory_equal(&again[0], &mine[0], sizeof(unit_t));
    /* The straggler's result comes first and counts: the other one's holding goes, its result is refused. */
    assert_int_equal(schedule_accept(schedule, mine, 1).code, RESULT_OK);
    assert_int_equal(schedule_held(schedule, 2), 1);
    unit_t batch[2] = {again[0], theirs[0]};
    assert_int_equal(schedule_accept(schedule, batch, 2).code, RESULT_MISMATCH);
    /* What is missing of the refused batch goes back. */
    assert_int_equal(schedule_release_units(schedule, 2, batch, 2), 1);
    assert_int_equal(schedule_holders(schedule), 0);
    assert_int_equal(schedule_take(schedule, &w1, again, 1), 1);
    assert_memory_equal(&again[0], &theirs[0], sizeof(unit_t));
    schedule_destroy(&schedule);
}

static void a_straggler_splits_what_was_issued_again(void **state)
{
    (void)state;
    job_settings_t settings = small_job(64);
    schedule_t *schedule = schedule_new(&settings);
    unit_t units[4];
    const unit_t late = {0, 1, 2};
    schedule_wish_t w = wish(7, 1, 1 << 20);
    assert_int_equal(schedule_take(schedule, &w, units, 1), 1);
    assert_int_equal(units[0].count, 4);
    assert_int_equal(schedule_accept(schedule, &late, 1).code, RESULT_OK);
    assert_int_equal(schedule_held(schedule, 7), 2); /* [0,1) and [3,4) */
    assert_int_equal(schedule_accept(schedule, units, 1).code, RESULT_MISMATCH);
    assert_int_equal(schedule_release_units(schedule, 7, units, 1), 2);
    assert_int_equal(schedule_take(schedule, &w, units, 1), 1);
    assert_int_equal(units[0].first, 0);
    assert_int_equal(units[0].count, 1);
    schedule_destroy(&schedule);
}

/* ---- a random farm against a table --------------------------------------------------------------------- */

enum { TILES = 15, SPP = 40, WORKERS = 5, HOLD = 4000, FREE = 0, COUNTED = 255 };

typedef struct {
    uint8_t table[TILES][SPP]; /* FREE, COUNTED or the worker */
    unit_t units[WORKERS + 1][HOLD];
    size_t held[WORKERS + 1];
    uint64_t random;
} model_t;

static uint32_t draw(model_t *model, uint32_t bound)
{
    model->random = model->random * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(model->random >> 33) % bound;
}

static void model_take(model_t *model, schedule_t *schedule, const job_settings_t *settings, uint32_t worker)
{
    unit_t units[50];
    schedule_wish_t w = {worker, draw(model, 20000), 1 + draw(model, 5000), 1, WORKERS};
    size_t n = schedule_take(schedule, &w, units, 1 + draw(model, 50));
    for (size_t i = 0; i < n; i++) {
        assert_true(job_unit_valid(settings, &units[i]));
        for (uint32_t s = 0; s < units[i].count; s++) {
            uint8_t *cell = &model->table[units[i].tile][units[i].first + s];
            assert_int_equal(*cell, FREE);
            *cell = (uint8_t)worker;
        }
        assert_true(model->held[worker] < HOLD);
        model->units[worker][model->held[worker]++] = units[i];
    }
}

/* Sends some of what the worker believes it holds. */
static void model_send(model_t *model, schedule_t *schedule, uint32_t worker)
{
    size_t n = model->held[worker] == 0 ? 0 : 1 + draw(model, (uint32_t)model->held[worker]);
    const unit_t *units = model->units[worker] + model->held[worker] - n;
    bool counted = false; /* or twice in the batch: lost, and issued again to the same worker */
    uint8_t batch[TILES][SPP] = {{0}};
    for (size_t i = 0; i < n; i++)
        for (uint32_t s = 0; s < units[i].count; s++) {
            counted |= model->table[units[i].tile][units[i].first + s] == COUNTED;
            counted |= batch[units[i].tile][units[i].first + s]++ > 0;
        }
    bool accepted = schedule_accept(schedule, units, n).code == RESULT_OK;
    assert_int_equal(accepted, !counted);
    for (size_t i = 0; i < n; i++)
        for (uint32_t s = 0; s < units[i].count; s++) {
            uint8_t *cell = &model->table[units[i].tile][units[i].first + s];
            if (accepted)
                *cell = COUNTED;
            else if (*cell == worker)
                *cell = FREE;
        }
    if (!accepted) schedule_release_units(schedule, worker, units, n);
    if (draw(model, 10) > 0) model->held[worker] -= n; /* else it will send them again */
}

/* The master gives the worker up; the worker may not know and go on. */
static void model_lose(model_t *model, schedule_t *schedule, uint32_t worker)
{
    schedule_release(schedule, worker);
    for (int t = 0; t < TILES; t++)
        for (int s = 0; s < SPP; s++)
            if (model->table[t][s] == worker) model->table[t][s] = FREE;
    if (draw(model, 2) == 0) model->held[worker] = 0;
}

static void model_compare(const model_t *model, const schedule_t *schedule, const job_settings_t *settings)
{
    uint64_t counted = 0;
    bool available = false, holds[WORKERS + 1] = {false};
    for (uint32_t t = 0; t < TILES; t++)
        for (uint32_t s = 0; s < SPP; s++) {
            uint8_t cell = model->table[t][s];
            if (cell == COUNTED) counted += job_tile_pixels(settings, t);
            available |= cell == FREE;
            if (cell != COUNTED && cell != FREE) holds[cell] = true;
        }
    assert_int_equal(schedule_done(schedule), counted);
    assert_int_equal(schedule_available(schedule), available);
    for (uint32_t w = 1; w <= WORKERS; w++) assert_int_equal(schedule_held(schedule, w) > 0, holds[w]);
}

static void a_random_farm_agrees_with_a_table(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 20; seed++) {
        job_settings_t settings = small_job(SPP);
        schedule_t *schedule = schedule_new(&settings);
        model_t *model = calloc(1, sizeof *model);
        model->random = seed;
        int steps = 0;
        for (; !schedule_complete(schedule) && steps < 100000; steps++) {
            uint32_t worker = 1 + draw(model, WORKERS), what = draw(model, 10);
            if (what < 5)
                model_take(model, schedule, &settings, worker);
            else if (what < 9)
                model_send(model, schedule, worker);
            else
                model_lose(model, schedule, worker);
            model_compare(model, schedule, &settings);
        }
        assert_true(schedule_complete(schedule));
        assert_int_equal(schedule_spans(schedule), TILES);
        free(model);
        schedule_destroy(&schedule);
    }
}

static void a_long_job_stays_small(void **state)
{
    (void)state;
    job_settings_t settings = small_job(JOB_MAX_SPP);
    settings.time_limit = 1e6;
    schedule_t *schedule = schedule_new(&settings);
    unit_t units[100];
    for (int i = 0; i < 20000; i++) {
        schedule_wish_t w = {1 + (uint64_t)(i % 3), 10000, 2000, 1, 3};
        size_t n = schedule_take(schedule, &w, units, 100);
        assert_int_equal(schedule_accept(schedule, units, n).code, RESULT_OK);
    }
    assert_true(schedule_spans(schedule) <= TILES);
    schedule_destroy(&schedule);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(hands_out_every_sample_once),
        cmocka_unit_test(follows_the_wish),
        cmocka_unit_test(covers_the_image_first_when_time_ends_the_job),
        cmocka_unit_test(shares_what_is_left),
        cmocka_unit_test(refuses_what_was_counted),
        cmocka_unit_test(gives_back_what_a_lost_worker_held),
        cmocka_unit_test(a_straggler_splits_what_was_issued_again),
        cmocka_unit_test(a_random_farm_agrees_with_a_table),
        cmocka_unit_test(a_long_job_stays_small),
    };
    return cmocka_run_group_tests_name("schedule", tests, NULL, NULL);
}
