/* Tests of window.c and of what take.c makes of it: how much workers may hold, who takes units and delivers
 * none, and that nobody who is honest waits for it. Workers are played as ours behave: they ask for a second
 * of work ahead, and send a batch every ten seconds, or when they have run out of work. */
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { IDLERS = 10, MANY = 20, HELD = 512 };
static const double LEASE = 5, INTERVAL = 10, STEP = 0.1; /* seconds; the first two are the toy farm's */

/* A worker. Its units: the first `done` are rendered, and in the batch. */
typedef struct {
    uint64_t id;
    double speed;          /* pixel samples a second */
    double load, transfer; /* seconds, until it has loaded its first scene, and for sending a batch */
    bool idle;             /* it takes and never delivers, */
    bool claims;           /* and says again and again that it has kept what it was given first: */
    toy_work_t first;
    uint64_t job;
    unit_t units[HELD];
    size_t count, done;
    double progress; /* samples rendered of the next unit */
    double opened;   /* when the batch was begun */
    double sends;    /* until when it sends a batch of `sent` units, 0: it does not; those are the first */
    size_t sent;
    int delivered;
    double last; /* seconds, when it delivered */
    uint64_t samples;
} actor_t;

static double unit_size(const unit_t *unit)
{
    return 16.0 * 16 * unit->count;
}

static double ahead(const actor_t *actor)
{
    double samples = 0;
    for (size_t i = actor->done; i < actor->count; i++) samples += unit_size(&actor->units[i]);
    return samples - actor->progress;
}

static actor_t join(farm_t *farm, double now, const char *name, double speed)
{
    return (actor_t){.id = toy_join(farm, now, name, 1, 0), .speed = speed, .load = now};
}

/* Asks for work; true when there was none for it. */
static bool ask(farm_t *farm, double now, actor_t *actor)
{
    uint64_t samples = actor->idle ? 1 << 18 : (uint64_t)actor->speed, unit = (uint64_t)(0.4 * actor->speed);
    toy_work_t work = toy_take(farm, now, actor->id, samples, unit > 0 ? unit : 1);
    for (size_t i = 0; i < work.count && actor->count < HELD; i++)
        actor->units[actor->count++] = work.units[i];
    if (work.job != 0) actor->job = work.job;
    if (actor->claims && actor->first.job == 0) actor->first = work;
    return work.job == 0;
}

static void deliver(farm_t *farm, double now, actor_t *actor)
{
    toy_work_t work = {.job = actor->job, .count = actor->sent};
    assert_true(actor->sent <= ARRAY_LENGTH(work.units));
    memcpy(work.units, actor->units, actor->sent * sizeof *work.units);
    if (toy_deliver_work(farm, now, actor->id, &work, 0).code == RESULT_OK) {
        actor->delivered++;
        actor->last = now;
        for (size_t i = 0; i < actor->sent; i++) actor->samples += (uint64_t)unit_size(&actor->units[i]);
    }
    actor->count -= actor->sent;
    actor->done -= actor->sent;
    memmove(actor->units, actor->units + actor->sent, actor->count * sizeof *actor->units);
    actor->sends = 0;
}

static void act(farm_t *farm, double now, actor_t *actor)
{
    bool none = false;
    if (!toy_beat(farm, now, actor->id)) return; /* it is put aside */
    if (actor->idle) {
        actor->count = 0; /* it does not care */
        const toy_work_t *first = &actor->first;
        farm_reclaim(farm, now,
                     &(claim_t){actor->id, first->job, NULL, first->units, first->issues, first->count});
        ask(farm, now, actor);
        return;
    }
    if (ahead(actor) < 0.5 * actor->speed) none = ask(farm, now, actor);
    if (now < actor->load) return;
    actor->progress += STEP * actor->speed;
    while (actor->done < actor->count && actor->progress >= unit_size(&actor->units[actor->done])) {
        if (actor->done == (actor->sends > 0 ? actor->sent : 0)) actor->opened = now;
        actor->progress -= unit_size(&actor->units[actor->done++]);
    }
    if (actor->done == actor->count) actor->progress = 0;
    if (actor->sends > 0 && now >= actor->sends) deliver(farm, now, actor);
    bool full = now - actor->opened >= INTERVAL || actor->done >= 60;
    if (actor->sends > 0 || actor->done == 0 || !(full || (none && actor->done == actor->count))) return;
    actor->sent = actor->done < 64 ? actor->done : 64;
    actor->sends = now + actor->transfer;
    assert_int_equal(farm_batch_wanted(farm, now, actor->id, actor->job).code, RESULT_OK);
    farm_batch_granted(farm, now, actor->id);
    if (actor->transfer <= 0) deliver(farm, now, actor);
}

/* Lets them work until a job is done, and returns when that was. */
static double run(farm_t *farm, double now, uint64_t job, actor_t *actors, size_t count)
{
    for (double begun = now; toy_state(farm, now, job) < JOB_FINISHING; now += STEP) {
        for (size_t i = 0; i < count; i++) act(farm, now, &actors[i]);
        farm_tick(farm, now);
        if (now - begun > 3600) fail_msg("the job does not end");
    }
    return now;
}

static uint64_t submit(farm_t *farm, double now, uint32_t spp)
{
    job_settings_t settings = toy_settings();
    settings.spp = spp;
    return toy_submit(farm, now, &settings, 0);
}

/* The time of a job with an honest worker, of `speed`, and so many idlers of one party that were first. */
static double time_beside(uint32_t spp, double speed, size_t idlers, bool claims)
{
    farm_t *farm = toy_farm(false);
    actor_t actors[1 + IDLERS] = {0};
    for (size_t i = 1; i <= idlers; i++) {
        char name[30];
        snprintf(name, sizeof name, "idler:%zu", i);
        actors[i] = join(farm, 0, name, 1e6);
        actors[i].idle = true;
        actors[i].claims = claims;
    }
    uint64_t job = submit(farm, 0, spp);
    for (size_t i = 1; i <= idlers; i++) ask(farm, 0, &actors[i]);
    actors[0] = join(farm, 0, "honest:1", speed);
    double time = run(farm, 0, job, actors, 1 + idlers);
    schedule_account_t account = toy_report(farm, time, job).record.account;
    assert_int_equal(account.issued, account.counted + account.returned);
    farm_destroy(&farm);
    return time;
}

static void ten_idlers_delay_a_job_by_a_lease_and_a_tenth(void **state)
{
    static const struct {
        uint32_t spp;
        double speed;
    } rows[] = {{16, 4000}, {64, 16000}, {64, 3000}, {256, 3000}};
    (void)state;
    for (size_t i = 0; i < ARRAY_LENGTH(rows); i++) {
        double alone = time_beside(rows[i].spp, rows[i].speed, 0, false);
        for (int claims = 0; claims < 2; claims++) {
            double beside = time_beside(rows[i].spp, rows[i].speed, IDLERS, claims == 1);
            print_message("%.1f s alone, %.1f s beside idlers%s\n", alone, beside,
                          claims ? " that claim what they lost" : "");
            assert_true(beside <= 1.1 * alone + LEASE + 2 * STEP);
        }
    }
}

/* Where batches come often, an idler is overtaken long before its lease is over; it is not served again. */
static void an_idler_that_is_overtaken_gets_no_more(void **state)
{
    const double interval = 0.2;
    const uint64_t all = 1 << 20;
    farm_t *farm = toy_brisk_farm(interval);
    uint64_t honest = toy_join(farm, 0, "honest:1", 1, 0), idler = toy_join(farm, 0, "idler:1", 1, 0);
    uint64_t job = submit(farm, 0, 16);
    toy_work_t work = toy_take(farm, 0, honest, 256, 256);
    assert_int_equal(toy_take(farm, 0, idler, 256, 256).job, job);
    while (work.job != 0) {
        assert_int_equal(toy_deliver_work(farm, interval, honest, &work, 0).code, RESULT_OK);
        work = toy_take(farm, interval, honest, 256, 256);
    }
    (void)state;
    for (double now = 2 * interval; work.job == 0 && now < LEASE; now += interval) {
        assert_true(toy_beat(farm, now, idler));
        work = toy_take(farm, now, honest, 256, 256);
    }
    assert_int_equal(work.job, job);
    assert_int_equal(toy_order(farm, LEASE, job, ORDER_PAUSE).code, RESULT_OK);
    uint64_t other = submit(farm, LEASE, 16);
    assert_int_equal(toy_take(farm, LEASE, idler, all, 256).job, 0);
    assert_int_equal(toy_take(farm, LEASE, honest, all, 256).job, other);
    farm_destroy(&farm);
}

/* Twenty workers share a key: all have work from the beginning, and the farm is as fast as they are. */
static void workers_of_one_party_work_at_full_speed(void **state)
{
    (void)state;
    farm_t *farm = toy_farm(false);
    static actor_t actors[MANY];
    for (size_t i = 0; i < MANY; i++) {
        char name[30];
        snprintf(name, sizeof name, "one:%zu", i);
        actors[i] = join(farm, 0, name, 1000);
    }
    uint64_t job = submit(farm, 0, 1024);
    double time = run(farm, 0, job, actors, MANY), ideal = 32.0 * 32 * 1024 / (1000 * MANY);
    print_message("%.1f s, %.1f s at full speed\n", time, ideal);
    assert_true(time < 1.15 * ideal + 1);
    farm_destroy(&farm);
}

/* A minute for the scene, while others have nothing to do: its units go to them, but nothing is held against
 * it, and it works as the others do when it is ready. */
static void a_slow_start_is_no_failure(void **state)
{
    (void)state;
    farm_t *farm = toy_farm(false);
    actor_t actors[] = {join(farm, 0, "slow:1", 4000), join(farm, 0, "quick:1", 4000)};
    actors[0].load = 60;
    uint64_t small = submit(farm, 0, 16), large;
    double now = run(farm, 0, small, actors, 2);
    assert_true(now < 4.2 + LEASE);
    assert_int_equal(actors[0].delivered, 0);
    actors[0].count = actors[0].done = 0; /* it is told that the job is over */
    large = submit(farm, now, 1024);
    now = run(farm, now, large, actors, 2);
    size_t count;
    worker_report_t *reports = farm_worker_report(farm, now, &count);
    for (size_t i = 0; i < count; i++) assert_string_equal(reports[i].aside, "");
    free(reports);
    assert_true(actors[0].samples > actors[1].samples / 2);
    farm_destroy(&farm);
}

/* A link that takes a minute for a batch: what is in hand stays within three batches, and they count. */
static void a_slow_link_holds_little(void **state)
{
    (void)state;
    farm_t *farm = toy_farm(false);
    actor_t actors[] = {join(farm, 0, "slow:1", 2000), join(farm, 0, "quick:1", 2000)};
    actors[0].transfer = 60;
    uint64_t job = submit(farm, 0, 1024);
    double now = run(farm, 0, job, actors, 2), alone = time_beside(1024, 2000, 0, false);
    print_message("%.0f s, %.0f s without it; %d batches of it count\n", now, alone, actors[0].delivered);
    assert_true(actors[0].delivered >= 3);
    assert_true(now < 1.02 * alone);
    farm_destroy(&farm);
}

/* A link that takes three seconds for a batch: its batches count, and nobody waits for the last of them. */
static void a_thin_link_gets_none_of_the_last_units(void **state)
{
    (void)state;
    farm_t *farm = toy_farm(false);
    actor_t actors[] = {join(farm, 0, "thin:1", 2000), join(farm, 0, "quick:1", 2000)};
    actors[0].transfer = 3;
    uint64_t job = submit(farm, 0, 128);
    double now = run(farm, 0, job, actors, 2);
    print_message("%.1f s, %.1f s after the last batch of the thin link; %d of it count\n", now,
                  now - actors[0].last, actors[0].delivered);
    assert_int_equal(toy_report(farm, now, job).record.units_reissued, 0);
    assert_true(actors[0].delivered >= 3);
    assert_true(actors[1].last > actors[0].last);
    farm_destroy(&farm);
}

/* Takes units of job after job, for others to render: in the end it gets none. */
static void who_takes_and_never_delivers_is_put_aside(void **state)
{
    (void)state;
    farm_t *farm = toy_farm(false);
    actor_t actors[] = {join(farm, 0, "honest:1", 20000), join(farm, 0, "idler:1", 1e6)};
    actors[1].idle = true;
    double now = 0, refused = 0;
    while (refused == 0 && now < 1000) {
        uint64_t job = submit(farm, now, 16), again;
        worker_hello_t hello = {.name = "idler:1", .threads = 1};
        result_t result = toy_say_hello(farm, now, hello, &again);
        if (result.code == RESULT_OK) {
            farm_goodbye(farm, now, actors[1].id, 0, "");
            actors[1].id = again;
            ask(farm, now, &actors[1]);
            double done = run(farm, now, job, actors, 2);
            assert_true(done - now < 1.5 + LEASE);
            now = done + 1;
            toy_write_images(farm, now, result_ok());
        } else {
            assert_non_null(strstr(result.message, "delivers none"));
            refused = now;
        }
    }
    print_message("put aside after %.0f s\n", refused);
    assert_true(refused > 300 && refused < 600);
    farm_destroy(&farm);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ten_idlers_delay_a_job_by_a_lease_and_a_tenth),
        cmocka_unit_test(an_idler_that_is_overtaken_gets_no_more),
        cmocka_unit_test(workers_of_one_party_work_at_full_speed),
        cmocka_unit_test(a_slow_start_is_no_failure),
        cmocka_unit_test(a_slow_link_holds_little),
        cmocka_unit_test(a_thin_link_gets_none_of_the_last_units),
        cmocka_unit_test(who_takes_and_never_delivers_is_put_aside),
    };
    return cmocka_run_group_tests_name("farm window", tests, NULL, NULL);
}
