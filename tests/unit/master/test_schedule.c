/* Tests of master/schedule/schedule.c, among them a random farm that is compared, sample by sample, with a
 * table. Rounds, particular units and states that come from files have more tests in test_rounds.c. */
#include "master/schedule/schedule_state.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static job_settings_t small_job(uint32_t spp)
{
    job_settings_t settings = job_settings_default();
    settings.learn = false;
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
    assert_true(schedule_round_counted(schedule));
    assert_int_equal(samples, 70 * 40 * 8);
    assert_int_equal(schedule->span_count, 15); /* one counted span a tile */
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

enum {
    TILES = 15,
    SPP = 40, /* the most that a tile gets, over all rounds */
    WORKERS = 5,
    HOLD = 4000,
    ROUNDS = 4,
    FREE = 0,
    SHUT = 253, /* no round allows it yet */
    SKIPPED = 254,
    COUNTED = 255
};

typedef struct {
    uint8_t table[TILES][SPP]; /* FREE, SHUT, SKIPPED, COUNTED or the worker */
    uint32_t weight[TILES][SPP], round[TILES][SPP], end[TILES];
    uint32_t rounds;
    unit_t units[WORKERS + 1][HOLD];
    size_t held[WORKERS + 1];
    uint64_t issued, returned; /* pixel samples */
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
            uint32_t tile = units[i].tile, sample = units[i].first + s;
            assert_int_equal(model->table[tile][sample], FREE);
            assert_int_equal(model->round[tile][sample], model->round[tile][units[i].first]);
            assert_int_equal(model->weight[tile][sample], schedule_weight(schedule, &units[i]));
            model->table[tile][sample] = (uint8_t)worker;
            model->issued += job_tile_pixels(settings, tile);
        }
        assert_true(model->held[worker] < HOLD);
        model->units[worker][model->held[worker]++] = units[i];
    }
}

/* Sends some of what the worker believes it holds. */
static void model_send(model_t *model, schedule_t *schedule, const job_settings_t *settings, uint32_t worker)
{
    size_t n = model->held[worker] == 0 ? 0 : 1 + draw(model, (uint32_t)model->held[worker]);
    const unit_t *units = model->units[worker] + model->held[worker] - n;
    bool counted = false; /* or twice in the batch: lost, and issued again to the same worker */
    uint8_t batch[TILES][SPP] = {{0}};
    for (size_t i = 0; i < n; i++)
        for (uint32_t s = 0; s < units[i].count; s++) {
            counted |= model->table[units[i].tile][units[i].first + s] >= SKIPPED;
            counted |= batch[units[i].tile][units[i].first + s]++ > 0;
        }
    bool accepted = schedule_accept(schedule, units, n).code == RESULT_OK;
    assert_int_equal(accepted, !counted);
    for (size_t i = 0; i < n; i++)
        for (uint32_t s = 0; s < units[i].count; s++) {
            uint8_t *cell = &model->table[units[i].tile][units[i].first + s];
            uint64_t pixels = job_tile_pixels(settings, units[i].tile);
            if (accepted) {
                if (*cell == FREE) model->issued += pixels;
                *cell = COUNTED;
            } else if (*cell == worker) {
                *cell = FREE;
                model->returned += pixels;
            }
        }
    if (!accepted) schedule_release_units(schedule, worker, units, n);
    if (draw(model, 10) > 0) model->held[worker] -= n; /* else it will send them again */
}

/* The master gives the worker up; the worker may not know and go on. */
static void model_lose(model_t *model, schedule_t *schedule, const job_settings_t *settings, uint32_t worker)
{
    schedule_release(schedule, worker);
    for (uint32_t t = 0; t < TILES; t++)
        for (int s = 0; s < SPP; s++)
            if (model->table[t][s] == worker) {
                model->table[t][s] = FREE;
                model->returned += job_tile_pixels(settings, t);
            }
    if (draw(model, 2) == 0) model->held[worker] = 0;
}

/* Takes out what was counted, keeps a unit from the others, leaves one out. */
static void model_meddle(model_t *model, schedule_t *schedule, const job_settings_t *settings)
{
    unit_t unit = {draw(model, TILES), draw(model, SPP), 0};
    unit.count = 1 + draw(model, SPP - unit.first < 6 ? SPP - unit.first : 6);
    uint32_t what = draw(model, 4), worker = 1 + draw(model, WORKERS);
    uint64_t pixels = job_tile_pixels(settings, unit.tile);
    uint8_t *cells = &model->table[unit.tile][unit.first];
    bool all_free = true;
    for (uint32_t s = 0; s < unit.count; s++)
        all_free &= cells[s] == FREE &&
                    model->round[unit.tile][unit.first + s] == model->round[unit.tile][unit.first];
    if (what == 0)
        schedule_uncount(schedule, &unit, 1);
    else if (what == 1 && draw(model, 5) == 0)
        schedule_skip(schedule, &unit);
    else if (what > 1)
        assert_int_equal(schedule_issue(schedule, worker, &unit), all_free);
    else
        return;
    for (uint32_t s = 0; s < unit.count; s++) {
        if (what == 0 && cells[s] == COUNTED) {
            cells[s] = FREE;
            model->returned += pixels;
        } else if (what == 1 && cells[s] == FREE) {
            cells[s] = SKIPPED;
        } else if (what > 1 && all_free) {
            cells[s] = (uint8_t)worker;
            model->issued += pixels;
        }
    }
    if (what > 1 && all_free) model->units[worker][model->held[worker]++] = unit;
}

/* A round of random numbers of samples, the last one up to SPP. */
static void model_open(model_t *model, schedule_t *schedule)
{
    uint32_t ends[TILES], weights[TILES];
    for (uint32_t t = 0; t < TILES; t++) {
        uint32_t left = SPP - model->end[t];
        ends[t] = model->rounds + 1 == ROUNDS ? SPP : model->end[t] + draw(model, left / 2 + 1);
        weights[t] = 1u << draw(model, 5);
        for (uint32_t s = model->end[t]; s < ends[t]; s++) {
            model->table[t][s] = FREE;
            model->weight[t][s] = weights[t];
            model->round[t][s] = model->rounds;
        }
        model->end[t] = ends[t];
    }
    schedule_open_round(schedule, ends, weights);
    assert_int_equal(schedule_round_count(schedule), ++model->rounds);
    assert_memory_equal(schedule_round_ends(schedule), ends, sizeof ends);
    assert_memory_equal(schedule_round_weights(schedule), weights, sizeof weights);
}

/* The master dies and comes again; the workers still have their units. */
static void model_restart(model_t *model, schedule_t **schedule, job_settings_t *settings)
{
    schedule_state_t state;
    schedule_save(*schedule, &state);
    schedule_destroy(schedule);
    result_t result = schedule_restore(settings, &state, schedule);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    schedule_state_free(&state);
    for (uint32_t t = 0; t < TILES; t++)
        for (int s = 0; s < SPP; s++)
            if (model->table[t][s] != FREE && model->table[t][s] <= WORKERS) {
                model->table[t][s] = FREE;
                model->returned += job_tile_pixels(settings, t);
            }
}

static void model_compare(const model_t *model, const schedule_t *schedule, const job_settings_t *settings)
{
    schedule_account_t expected = {.issued = model->issued, .returned = model->returned};
    bool available = false, holds[WORKERS + 1] = {false};
    for (uint32_t t = 0; t < TILES; t++)
        for (uint32_t s = 0; s < SPP; s++) {
            uint8_t cell = model->table[t][s];
            uint64_t pixels = job_tile_pixels(settings, t);
            if (cell == COUNTED) expected.counted += pixels;
            if (cell == SKIPPED) expected.skipped += pixels;
            available |= cell == FREE;
            if (cell == FREE || cell >= SHUT) continue;
            assert_true(cell <= WORKERS);
            holds[cell] = true;
            expected.out += pixels;
        }
    schedule_account_t account = schedule_account(schedule);
    assert_memory_equal(&account, &expected, sizeof account);
    assert_int_equal(account.issued, account.counted + account.returned + account.out);
    assert_int_equal(schedule_done(schedule), expected.counted);
    assert_int_equal(schedule_available(schedule), available);
    assert_int_equal(schedule_round_counted(schedule), !available && account.out == 0);
    for (uint32_t w = 1; w <= WORKERS; w++) {
        size_t count;
        unit_t *units = schedule_units_of(schedule, w, &count);
        assert_int_equal(schedule_held(schedule, w), count);
        assert_int_equal(count > 0, holds[w]);
        for (size_t i = 0; i < count; i++)
            for (uint32_t s = 0; s < units[i].count; s++)
                assert_int_equal(model->table[units[i].tile][units[i].first + s], w);
        free(units);
    }
}

static void run_model(uint64_t seed, bool planned)
{
    job_settings_t settings = small_job(SPP);
    settings.adaptive = planned;
    schedule_t *schedule = schedule_new(&settings);
    model_t *model = calloc(1, sizeof *model);
    model->random = seed;
    for (uint32_t t = 0; t < TILES; t++)
        for (uint32_t s = 0; s < SPP; s++) {
            model->weight[t][s] = 1;
            if (planned) model->table[t][s] = SHUT;
        }
    int steps = 0;
    bool done = false;
    for (; !done && steps < 100000; steps++) {
        uint32_t worker = 1 + draw(model, WORKERS), what = draw(model, 200);
        if (what < 100)
            model_take(model, schedule, &settings, worker);
        else if (what < 179)
            model_send(model, schedule, &settings, worker);
        else if (what < 194)
            model_lose(model, schedule, &settings, worker);
        else if (what < 199)
            model_meddle(model, schedule, &settings);
        else
            model_restart(model, &schedule, &settings);
        model_compare(model, schedule, &settings);
        done = schedule_round_counted(schedule);
        if (done && planned && model->rounds < ROUNDS) {
            model_open(model, schedule);
            model_compare(model, schedule, &settings);
            done = false;
        }
    }
    assert_true(done);
    assert_int_equal(model->rounds, planned ? ROUNDS : 0);
    assert_int_equal(settings.spp, SPP);
    free(model);
    schedule_destroy(&schedule);
}

static void a_random_farm_agrees_with_a_table(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 20; seed++) run_model(seed, false);
}

static void a_random_farm_with_rounds_agrees_with_a_table(void **state)
{
    (void)state;
    for (uint64_t seed = 21; seed <= 40; seed++) run_model(seed, true);
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
    assert_true(schedule->span_count <= TILES);
    schedule_destroy(&schedule);
}

/* Samples of all tiles come in the same runs, so that few sets of photons are in use at a time. */
static void units_of_vcm_keep_to_runs(void **state)
{
    (void)state;
    job_settings_t settings = small_job(37);
    settings.integrator = INTEGRATOR_VCM;
    schedule_t *schedule = schedule_new(&settings);
    unit_t units[64];
    uint32_t run = 0;
    for (size_t n; (n = schedule_take(schedule, &(schedule_wish_t){1, 5000, 4000, 1, 1}, units, 64)) > 0;) {
        for (size_t i = 0; i < n; i++) {
            assert_true(unit_end(&units[i]) <= job_run_end(&settings, units[i].first));
            assert_true(units[i].first / JOB_PHOTON_RUN >= run);
            run = units[i].first / JOB_PHOTON_RUN;
        }
        assert_int_equal(schedule_accept(schedule, units, n).code, RESULT_OK);
    }
    assert_true(schedule_round_counted(schedule));
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
        cmocka_unit_test(a_random_farm_with_rounds_agrees_with_a_table),
        cmocka_unit_test(a_long_job_stays_small),
        cmocka_unit_test(units_of_vcm_keep_to_runs),
    };
    return cmocka_run_group_tests_name("schedule", tests, NULL, NULL);
}
