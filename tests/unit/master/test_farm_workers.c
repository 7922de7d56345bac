/* Tests of workers.c, take.c, standing.c and suspects.c: deadlines and stragglers,
 * machines with other bits, who is put aside, and units that end whoever renders them. */
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static int set_up(void **state)
{
    *state = toy_farm(false);
    return 0;
}

static int set_up_roomy(void **state)
{
    *state = toy_roomy_farm();
    return 0;
}

static int tear_down(void **state)
{
    farm_destroy((farm_t **)state);
    return 0;
}

static uint64_t submit(farm_t *farm, uint32_t spp)
{
    job_settings_t settings = toy_settings();
    settings.spp = spp;
    return toy_submit(farm, 0, &settings, 0);
}

/* One unit of a tile and 4 samples, as long as there are some. */
static toy_work_t take_one(farm_t *farm, double now, uint64_t worker)
{
    return toy_take(farm, now, worker, 1, 1 << 20);
}

static result_t deliver(farm_t *farm, double now, uint64_t worker, const toy_work_t *work)
{
    return toy_deliver_work(farm, now, worker, work, 0);
}

/* Lets time pass, with heartbeats of these workers (0: none) and of nobody else. */
static void pass(farm_t *farm, double *now, double seconds, const uint64_t *workers, size_t count)
{
    for (double end = *now + seconds; *now < end; *now += 0.5) {
        for (size_t i = 0; i < count; i++)
            if (workers[i] != 0) toy_beat(farm, *now, workers[i]);
        farm_tick(farm, *now);
    }
}

/* A process says hello that has a number. */
static uint64_t join_process(farm_t *farm, double now, const char *name, uint64_t process)
{
    uint64_t worker;
    worker_hello_t hello = {.name = name, .threads = 1, .process = process};
    assert_int_equal(toy_say_hello(farm, now, hello, &worker).code, RESULT_OK);
    return worker;
}

static worker_report_t find_worker(farm_t *farm, double now, const char *name)
{
    size_t count;
    worker_report_t *reports = farm_worker_report(farm, now, &count), found = {.threads = 0};
    for (size_t i = 0; i < count; i++)
        if (strcmp(reports[i].name, name) == 0 && found.threads == 0) found = reports[i];
    free(reports);
    assert_true(found.threads > 0);
    return found;
}

/* ---- deadlines ----------------------------------------------------------------------------------------- */

/* Two workers that have delivered a unit of four samples each: in `quick` and in `slow` seconds. */
static uint64_t measured_pair(farm_t *farm, double quick_seconds, double slow_seconds, uint64_t *quick,
                              uint64_t *slow)
{
    uint64_t job = submit(farm, 16);
    *quick = toy_join(farm, 0, "quick", 1, 0);
    *slow = toy_join(farm, 0, "slow", 1, 0);
    toy_work_t a = take_one(farm, 0, *quick), b = take_one(farm, 0, *slow);
    assert_int_equal(deliver(farm, quick_seconds, *quick, &a).code, RESULT_OK);
    assert_int_equal(deliver(farm, slow_seconds, *slow, &b).code, RESULT_OK);
    return job;
}

static void speed_is_measured(void **state)
{
    farm_t *farm = *state;
    uint64_t quick, slow;
    measured_pair(farm, 2, 20, &quick, &slow);
    assert_float_equal(find_worker(farm, 20, "quick").speed, 16 * 16 * 4 / 2.0, 1e-6);
    assert_float_equal(find_worker(farm, 20, "slow").speed, 16 * 16 * 4 / 20.0, 1e-6);
}

/* At the end of a job who is quick gets what a slow one has only just begun; the first result counts. */
static void an_idle_worker_takes_over_from_a_straggler(void **state)
{
    farm_t *farm = *state;
    uint64_t quick, slow, job = measured_pair(farm, 2, 40, &quick, &slow);
    toy_work_t last = take_one(farm, 40, slow), work;
    uint64_t reissued = toy_report(farm, 40, job).record.units_reissued;
    while ((work = take_one(farm, 40, quick)).job != 0 &&
           toy_report(farm, 40, job).record.units_reissued == reissued)
        assert_int_equal(deliver(farm, 40, quick, &work).code, RESULT_OK);
    assert_int_equal(toy_report(farm, 40, job).record.units_reissued,
                     reissued + 1); /* it takes 40 s more, not 2 */
    assert_int_equal(work.units[0].tile, last.units[0].tile);
    assert_int_equal(work.units[0].first, last.units[0].first);
    do /* in smaller pieces */
        assert_int_equal(deliver(farm, 42, quick, &work).code, RESULT_OK);
    while ((work = take_one(farm, 42, quick)).job != 0);
    assert_int_equal(toy_state(farm, 42, job), JOB_FINISHING);
    assert_int_not_equal(deliver(farm, 43, slow, &last).code, RESULT_OK);
}

/* A batch that was let in has some moments to come; then its link is the reason, and the end of the job does
 * not wait for it. */
static void a_thin_link_holds_nobody_up(void **state)
{
    farm_t *farm = *state;
    uint64_t quick, slow, job = measured_pair(farm, 2, 20, &quick, &slow);
    toy_work_t last = take_one(farm, 20, slow), work;
    assert_int_equal(farm_batch_wanted(farm, 20, slow, job).code, RESULT_OK);
    farm_batch_granted(farm, 21, slow);
    while ((work = take_one(farm, 21, quick)).job != 0)
        assert_int_equal(deliver(farm, 21, quick, &work).code, RESULT_OK);
    assert_int_equal(toy_report(farm, 21, job).record.units_reissued, 0);
    assert_int_equal(take_one(farm, 22, quick).job, 0);
    toy_beat(farm, 24, slow);
    work = take_one(farm, 24, quick);
    assert_int_equal(work.job, job);
    assert_int_equal(work.units[0].tile, last.units[0].tile);
}

static void equals_leave_each_other_alone(void **state)
{
    farm_t *farm = *state;
    uint64_t a, b, job = measured_pair(farm, 20, 20, &a, &b);
    double now = 20;
    toy_work_t last, other;
    for (;;) { /* a has the last unit */
        last = take_one(farm, now, a);
        other = take_one(farm, now, b);
        now += 5 * (double)last.units[0].count;
        if (other.job == 0) break;
        assert_int_equal(deliver(farm, now, b, &other).code, RESULT_OK);
        schedule_account_t account = toy_report(farm, now, job).record.account;
        if (account.counted + account.out == 4 * 16 * 16 * 16) break;
        assert_int_equal(deliver(farm, now, a, &last).code, RESULT_OK);
    }
    for (double late = 0; late < 10; late++) { /* it should have been here now */
        toy_beat(farm, now + late, a);
        farm_tick(farm, now + late);
        assert_int_equal(take_one(farm, now + late, b).job, 0);
    }
    assert_int_equal(toy_report(farm, now, job).record.units_reissued, 0);
    assert_int_equal(deliver(farm, now + 10, a, &last).code, RESULT_OK);
    assert_int_equal(toy_state(farm, now, job), JOB_FINISHING);
}

/* Past the deadline that its own speed gives it, a worker loses its units to whoever is idle, however slow.
 */
static void deadlines_follow_the_speed(void **state)
{
    farm_t *farm = *state;
    uint64_t quick, slow, job = measured_pair(farm, 1, 100, &quick, &slow);
    toy_work_t work;
    double now = 100;
    while ((work = take_one(farm, 101, quick)).job != 0)
        if (toy_report(farm, 101, job).record.account.counted < 4 * 16 * 16 * 16 / 2)
            assert_int_equal(deliver(farm, 101, quick, &work).code, RESULT_OK);
    uint64_t alive[] = {quick, slow};
    while (toy_report(farm, now, job).record.units_reissued == 0 && now < 300) {
        pass(farm, &now, 1, alive, 2);
        take_one(farm, now, slow);
    }
    assert_true(now > 120 && now < 135); /* two batch intervals and a lease after its last batch */
    assert_true(find_worker(farm, now, "quick").units_reissued > 0);
}

/* All units that there are, of one job. */
static toy_work_t take_all(farm_t *farm, double now, uint64_t worker)
{
    toy_work_t all = take_one(farm, now, worker), more;
    while ((more = take_one(farm, now, worker)).job != 0) {
        assert_true(more.job == all.job && all.count + more.count <= ARRAY_LENGTH(all.units));
        memcpy(all.units + all.count, more.units, more.count * sizeof *more.units);
        all.count += more.count;
    }
    return all;
}

/* Who asks ahead is not idle: it takes over only what it would be done with sooner after its own work. (Both
 * would be in one batch, and lost if the other was first.) */
static void who_has_work_of_its_own_takes_over_later(void **state)
{
    farm_t *farm = *state;
    uint64_t quick, slow, job = measured_pair(farm, 2, 20, &quick, &slow);
    toy_work_t work, last, own;
    double now = 20;
    for (int i = 0; i < 7; i++) {
        work = take_one(farm, now, quick);
        now += 2;
        assert_int_equal(deliver(farm, now, quick, &work).code, RESULT_OK);
    }
    last = take_one(farm, now, slow); /* three samples of its tile: 15 seconds of work */
    assert_int_equal(last.units[0].count, 3);
    own = take_all(farm, now, quick); /* 12.5 seconds; with the other's 14, which is not sooner */
    assert_int_equal(toy_report(farm, now, job).record.units_reissued, 0);
    assert_int_equal(take_one(farm, now + 1, quick).job, 0);
    assert_int_equal(toy_report(farm, now + 1, job).record.units_reissued, 0);
    now += 6;
    toy_beat(farm, now, slow);
    assert_int_equal(deliver(farm, now, quick, &own).code, RESULT_OK);
    work = take_one(farm, now, quick); /* it is idle: less than 2 seconds, and the other needs 9 more */
    assert_int_equal(toy_report(farm, now, job).record.units_reissued, 1);
    assert_int_equal(work.units[0].tile, last.units[0].tile);
    assert_int_equal(work.units[0].first, last.units[0].first);
}

/* Where more comes after the pass, a slow worker is not overtaken; one that does not deliver is. */
static void nobody_is_overtaken_at_the_end_of_a_pass(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = toy_settings();
    settings.spp = 16;
    settings.learn = true;
    uint64_t job = toy_submit(farm, 0, &settings, 0), quick = toy_join(farm, 0, "quick", 1, 0),
             slow = toy_join(farm, 0, "slow", 1, 0);
    toy_work_t work = take_one(farm, 0, quick), held = take_one(farm, 0, slow);
    double now = 1;
    assert_int_equal(deliver(farm, now, quick, &work).code, RESULT_OK);
    assert_int_equal(deliver(farm, now, slow, &held).code, RESULT_OK);
    held = take_one(farm, now, slow);
    assert_true(held.count > 0);
    while ((work = take_one(farm, now, quick)).count > 0)
        assert_int_equal(deliver(farm, now += 0.1, quick, &work).code, RESULT_OK);
    uint64_t alive[] = {slow, quick};
    pass(farm, &now, 15, alive, 2);
    assert_int_equal(take_one(farm, now, quick).job, 0);
    assert_int_equal(toy_report(farm, now, job).record.units_reissued, 0);
    pass(farm, &now, 30, alive, 2);
    assert_int_equal(take_one(farm, now, quick).job, job);
    assert_true(toy_report(farm, now, job).record.units_reissued > 0);
}

/* But one that would take minutes is, though it never is late, and nobody else was measured. */
static void who_delivers_by_drops_is_overtaken_at_the_end_of_a_pass(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = toy_settings();
    settings.spp = 16;
    settings.learn = true;
    uint64_t job = toy_submit(farm, 0, &settings, 0), drops = toy_join(farm, 0, "drops", 1, 0);
    toy_work_t all = take_all(farm, 0, drops), one = all;
    uint64_t idle = toy_join(farm, 0, "idle", 1, 0), alive[] = {drops, idle};
    double now = 0;
    assert_true(all.count >= 4);
    for (size_t i = 0; i < 2; i++) {
        pass(farm, &now, i == 0 ? 4 : 20, alive, 2);
        one.units[0] = all.units[i];
        one.count = 1;
        assert_int_equal(deliver(farm, now, drops, &one).code, RESULT_OK);
    }
    assert_int_equal(take_one(farm, now + 1, idle).job, job);
}

/* A worker delivers what it had lost, and then stalls with more: that goes to others, too. */
static void who_delivered_once_and_stalls_loses_its_units(void **state)
{
    farm_t *farm = *state;
    uint64_t first = submit(farm, 4), next, stalls = toy_join(farm, 0, "stalls", 1, 0), idle;
    toy_work_t old = take_all(farm, 0, stalls), work;
    double now = 0;
    idle = toy_join(farm, 0, "idle", 1, 0);
    uint64_t alive[] = {stalls, idle};
    pass(farm, &now, 6, alive, 2);
    assert_int_equal(take_one(farm, now, idle).job, first);
    assert_int_equal(deliver(farm, now, stalls, &old).code, RESULT_OK); /* it was sooner after all */
    next = submit(farm, 1);
    assert_int_equal(take_all(farm, now, stalls).job, next);
    pass(farm, &now, 20, alive, 2);
    assert_int_equal(take_one(farm, now, idle).job, 0);
    pass(farm, &now, 10, alive, 2);
    while ((work = take_one(farm, now, idle)).job != 0)
        assert_int_equal(deliver(farm, now, idle, &work).code, RESULT_OK);
    assert_int_equal(toy_state(farm, now, next), JOB_FINISHING);
}

/* However long a worker once took from one batch to the next: patience has a bound. */
static void who_was_slow_once_is_not_waited_for_twice_as_long(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 4), slow = toy_join(farm, 0, "slow", 1, 0);
    toy_work_t all = take_all(farm, 0, slow), one = all;
    double now = 0;
    one.count = 1;
    pass(farm, &now, 1000, &slow, 1);
    assert_int_equal(deliver(farm, now, slow, &one).code, RESULT_OK);
    uint64_t idle = toy_join(farm, now, "idle", 1, 0), alive[] = {slow, idle};
    pass(farm, &now, 200, alive, 2);
    assert_int_equal(take_one(farm, now, idle).job, 0);
    pass(farm, &now, 60, alive, 2);
    assert_int_equal(take_one(farm, now, idle).job, job);
}

/* Batches that wait to be let in are nobody's fault. Those that never come though they were, or that are
 * refused again and again, are; and so are those of a job that is over. */
static void who_offers_for_ever_loses_its_units(void **state)
{
    enum { WAITS, IS_GRANTED, IS_REFUSED, IS_OVER, WAYS };
    for (int way = 0; way < WAYS; way++) {
        farm_t *farm = *state;
        uint64_t over = submit(farm, 4), job = submit(farm, 4), offers = toy_join(farm, 0, "offers", 1, 0);
        assert_int_equal(toy_order(farm, 0, over, ORDER_CANCEL).code, RESULT_OK);
        double now = 0;
        toy_work_t all = take_all(farm, now, offers), counted = all;
        assert_int_equal(all.job, job);
        counted.count = 1;
        assert_int_equal(deliver(farm, now, offers, &counted).code, RESULT_OK);
        uint64_t idle = toy_join(farm, now, "idle", 1, 0), alive[] = {offers, idle};
        for (int i = 0; i < 20; i++) {
            farm_batch_wanted(farm, now, offers, way == IS_OVER ? over : job);
            if (way == IS_GRANTED || way == IS_REFUSED) farm_batch_granted(farm, now, offers);
            if (way == IS_REFUSED && i % 3 == 2) {
                assert_int_not_equal(deliver(farm, now, offers, &counted).code, RESULT_OK);
                farm_batch_wanted(farm, now, offers, job);
            }
            pass(farm, &now, 15, alive, 2);
        }
        assert_int_equal(take_one(farm, now, idle).job, way == WAITS ? 0 : job);
        farm_destroy((farm_t **)state);
        *state = toy_farm(false);
    }
}

/* Says what a worker has in hand, which was issued to it. */
static void claim(farm_t *farm, uint64_t worker, uint64_t job, const hash_t *content, const unit_t *units,
                  size_t count)
{
    issue_t issues[8];
    toy_issue(farm, worker, job, 0, units, count, issues);
    farm_reclaim(farm, 1, &(claim_t){worker, job, content, units, issues, count});
}

/* What a worker has in hand after a restart of the master is its own again. */
static void units_are_reclaimed(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = toy_settings();
    uint64_t job = submit(farm, 4), worker = toy_join(farm, 0, "back", 1, 0);
    uint64_t other = toy_join(farm, 0, "other", 1, 0);
    toy_work_t first = take_one(farm, 0, other);
    assert_int_equal(first.units[0].tile, 0);
    unit_t units[] = {{0, 0, 4}, {1, 0, 4}, {3, 0, 2}}, wrong = {9, 0, 4};
    hash_t blob = {{0}}, hash = job_content_hash(&settings, &blob);
    claim(farm, worker, job, &hash, units, 3);
    claim(farm, worker, job, &hash, &wrong, 1);
    assert_int_equal(find_worker(farm, 1, "back").units_held, 2); /* but for what the other has */
    hash.bytes[0] ^= 1;
    claim(farm, worker, job, &hash, &(unit_t){2, 0, 4}, 1);
    assert_int_equal(find_worker(farm, 1, "back").units_held, 2); /* that was another job */
}

/* ---- bits ---------------------------------------------------------------------------------------------- */

static void a_job_belongs_to_the_machines_with_the_same_bits(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 8), few = toy_join(farm, 0, "few", 2, 1);
    uint64_t many[] = {toy_join(farm, 0, "many-1", 2, 2), toy_join(farm, 0, "many-2", 1, 2)};
    assert_int_equal(take_one(farm, 0, few).job, 0);
    toy_work_t work = take_one(farm, 0, many[0]);
    assert_int_equal(work.job, job);
    assert_int_equal(take_one(farm, 0, many[1]).job, job);
    assert_int_equal(take_one(farm, 1, few).job, 0);
    assert_int_equal(toy_report(farm, 1, job).record.fingerprint.bytes[0], 0); /* nothing is counted */
    assert_int_equal(deliver(farm, 1, many[0], &work).code, RESULT_OK);
    assert_int_equal(toy_report(farm, 1, job).record.fingerprint.bytes[0], 2);
    /* What others have of it, from the life of another master, is of no use. */
    work.units[0].tile = 3;
    assert_int_equal(farm_batch_wanted(farm, 1, few, job).code, RESULT_MISMATCH);
    assert_int_equal(deliver(farm, 1, few, &work).code, RESULT_MISMATCH);
    /* Those who have it leave: it waits for others of their kind, and says so. */
    farm_goodbye(farm, 2, many[0], 0, "");
    farm_goodbye(farm, 2, many[1], 0, "");
    farm_tick(farm, 3);
    assert_int_equal(take_one(farm, 3, few).job, 0);
    assert_non_null(
        strstr(toy_report(farm, 3, job).record.message, "waits for a machine that makes the same bits"));
    assert_int_equal(toy_state(farm, 3, job), JOB_RUNNING);
    many[0] = toy_join(farm, 4, "many-3", 1, 2);
    assert_int_equal(take_one(farm, 4, many[0]).job, job);
    toy_beat(farm, 5, few);
    farm_tick(farm, 5);
    assert_null(strstr(toy_report(farm, 5, job).record.message, "waits"));
    /* The others have jobs of their own. */
    uint64_t next = submit(farm, 4);
    toy_join(farm, 5, "many-4", 2, 2);
    assert_int_equal(take_one(farm, 5, few).job, 0);
    toy_join(farm, 5, "few-2", 2, 1);
    assert_int_equal(take_one(farm, 5, few).job, next);
}

/* Who begins a job and leaves with nothing counted takes nothing with it. */
/* Most threads decide whose bits a job is made of, but only theirs who want work. */
static void who_asks_for_nothing_keeps_no_job_from_others(void **state)
{
    farm_t *farm = *state;
    uint64_t few = toy_join(farm, 0, "few", 2, 1), loud = toy_join(farm, 0, "loud", 4000, 2);
    uint64_t alive[] = {few, loud};
    double now = 0;
    for (int i = 0; i < 15; i++) {
        toy_take(farm, now, loud, 0, 1);
        take_one(farm, now, few);
        pass(farm, &now, 10, alive, 2);
    }
    uint64_t job = submit(farm, 8);
    toy_take(farm, now, loud, 0, 1);
    assert_int_equal(take_one(farm, now, few).job, job);
}

/* One that says hello again and again does not fill the list. */
static void a_connection_has_one_number(void **state)
{
    farm_t *farm = *state;
    worker_hello_t hello = {.name = "many", .key = "", .threads = 1};
    identity_t one = {{1}, 1}, other = {{2}, 1};
    uint64_t worker, job = submit(farm, 4);
    assert_int_equal(farm_hello(farm, 0, &other, &hello, &worker).code, RESULT_OK);
    assert_int_equal(farm_worker_reached(farm, 0, worker).code, RESULT_OK);
    toy_work_t work = take_one(farm, 0, worker);
    assert_int_equal(work.job, job);
    uint64_t again;
    for (int i = 0; i < FARM_MAX_WORKERS + 10; i++)
        assert_int_equal(farm_hello(farm, 0, &one, &hello, &again).code, RESULT_OK);
    assert_int_equal(farm_hello(farm, 0, &other, &hello, &again).code, RESULT_OK);
    assert_int_equal(deliver(farm, 0, worker, &work).code, RESULT_OK); /* work was bound to its old number */
}

static void a_job_with_nothing_counted_is_free(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 8), odd = toy_join(farm, 0, "odd", FARM_WORKER_THREADS, 1);
    uint64_t even = toy_join(farm, 0, "even", 2, 2), both[] = {odd, even};
    assert_int_equal(take_one(farm, 0, odd).job, job);
    assert_int_equal(take_one(farm, 0, even).job, 0);
    farm_goodbye(farm, 1, odd, 0, "");
    assert_int_equal(take_one(farm, 1, even).job, job);
    /* Nor does one freeze it that stays and delivers nothing, whatever it says of its threads. */
    farm_destroy((farm_t **)state);
    farm = *state = toy_farm(false);
    job = submit(farm, 8);
    odd = both[0] = toy_join(farm, 0, "odd", FARM_WORKER_THREADS, 1);
    even = both[1] = toy_join(farm, 0, "even", 2, 2);
    double now = 0;
    take_all(farm, now, odd);
    toy_work_t work = {0};
    while (work.job == 0 && now < 300) {
        pass(farm, &now, 5, both, 2);
        (void)toy_take(farm, now, odd, 1, 1 << 20);
        work = take_one(farm, now, even);
    }
    assert_int_equal(work.job, job);
    assert_int_equal(deliver(farm, now, even, &work).code, RESULT_OK);
    assert_int_equal(toy_report(farm, now, job).record.fingerprint.bytes[0], 2);
    assert_int_equal(find_worker(farm, now, "odd").units_held, 0); /* what it held is not of these bits */
}

static void too_many_threads_are_refused(void **state)
{
    farm_t *farm = *state;
    worker_hello_t hello = {.name = "much:1", .threads = FARM_WORKER_THREADS + 1};
    uint64_t worker;
    result_t refused = toy_say_hello(farm, 0, hello, &worker);
    assert_int_equal(refused.code, RESULT_LIMIT);
    assert_non_null(strstr(refused.message, "4096 at most"));
    hello.threads = UINT32_MAX;
    hello.relay = true;
    assert_int_equal(toy_say_hello(farm, 0, hello, &worker).code, RESULT_LIMIT);
    hello.threads = FARM_RELAY_THREADS;
    assert_int_equal(toy_say_hello(farm, 0, hello, &worker).code, RESULT_OK);
    farm_worker_threads(farm, worker, UINT32_MAX);
    assert_int_equal(find_worker(farm, 0, "much:1").threads, FARM_RELAY_THREADS);
}

/* Workers are upgraded while a job runs: it waits for the old kind, until it is told to go on. */
static void a_job_can_be_bound_anew(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 8), old = toy_join(farm, 0, "old", 2, 1);
    assert_int_equal(toy_order(farm, 0, job, ORDER_REBIND).code, RESULT_INPUT); /* it is bound to none */
    toy_work_t work = take_one(farm, 0, old), on_its_way = take_one(farm, 0, old);
    assert_int_equal(deliver(farm, 1, old, &work).code, RESULT_OK);
    assert_int_equal(toy_order(farm, 1, job, ORDER_REBIND).code, RESULT_INPUT); /* to them already */
    uint64_t new = toy_join(farm, 1, "new", 4, 2);
    assert_int_equal(take_one(farm, 1, new).job, 0);
    assert_int_equal(toy_order(farm, 2, job, ORDER_REBIND).code, RESULT_OK);
    job_report_t report = toy_report(farm, 2, job);
    assert_int_equal(report.record.fingerprint.bytes[0], 2);
    assert_non_null(
        strstr(report.record.message, "two kinds of bits: 01000000, and 02000000 after 1 samples"));
    assert_int_equal(report.record.samples_done, 4 * 16 * 16);
    assert_int_equal(find_worker(farm, 2, "old").units_held, 0);
    notice_t notice;
    bool told = false;
    while (farm_next_notice(farm, &notice)) told = told || (notice.job == job && !notice.flush);
    assert_true(told);
    assert_int_equal(take_one(farm, 2, old).job, 0);
    assert_int_equal(deliver(farm, 2, old, &on_its_way).code, RESULT_MISMATCH);
    toy_work_off(farm, 3, new, job);
    assert_int_equal(toy_state(farm, 3, job), JOB_FINISHING);
}

static void a_job_can_be_opened_to_all_kinds(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 8), old = toy_join(farm, 0, "old", 2, 1),
             new = toy_join(farm, 0, "new", 1, 2);
    toy_work_t work = take_one(farm, 0, old);
    assert_int_equal(deliver(farm, 1, old, &work).code, RESULT_OK);
    assert_int_equal(toy_order(farm, 1, job, ORDER_MIXED).code, RESULT_OK);
    assert_int_equal(toy_order(farm, 1, job, ORDER_MIXED).code, RESULT_INPUT);
    assert_int_equal(toy_order(farm, 1, job, ORDER_REBIND).code, RESULT_INPUT);
    assert_true(toy_report(farm, 1, job).record.terms.mixed);
    work = take_one(farm, 1, new);
    assert_int_equal(deliver(farm, 2, new, &work).code, RESULT_OK);
    assert_non_null(strstr(toy_report(farm, 2, job).record.message, "depend on which machine"));
    assert_int_equal(take_one(farm, 2, old).job, job);
}

/* A job that nobody was given anything of, since this master knows it, is made of the first bits that come.
 */
static void the_first_batch_decides_on_the_bits(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 8), one = toy_join(farm, 0, "one", 1, 1),
             two = toy_join(farm, 0, "two", 2, 2);
    toy_work_t work = {.job = job, .count = 1, .units = {{0, 0, 4}}}, other = work;
    other.units[0].tile = 1;
    assert_int_equal(farm_batch_wanted(farm, 1, one, job).code, RESULT_OK);
    assert_int_equal(deliver(farm, 1, one, &work).code, RESULT_OK);
    assert_int_equal(toy_report(farm, 1, job).record.fingerprint.bytes[0], 1);
    assert_int_equal(deliver(farm, 1, two, &other).code, RESULT_MISMATCH);
}

static void a_mixed_job_takes_everybody_and_says_so(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = toy_settings();
    uint64_t job = toy_submit_on(farm, 0, &settings, &(job_terms_t){.name = "mixed", .mixed = true});
    uint64_t a = toy_join(farm, 0, "a", 1, 1), b = toy_join(farm, 0, "b", 4, 2);
    toy_work_t work = take_one(farm, 0, a);
    assert_int_equal(deliver(farm, 0, a, &work).code, RESULT_OK);
    work = take_one(farm, 0, b);
    assert_string_equal(toy_report(farm, 0, job).record.message, "");
    assert_int_equal(deliver(farm, 0, b, &work).code, RESULT_OK);
    assert_non_null(strstr(toy_report(farm, 0, job).record.message, "depend on which machine"));
}

/* ---- put aside ----------------------------------------------------------------------------------------- */

static result_t try_hello(farm_t *farm, double now, const char *name, uint64_t *worker)
{
    return toy_say_hello(farm, now, (worker_hello_t){.name = name, .threads = 1}, worker);
}

/* A process of host:n joins, takes a unit, and is not heard of again. */
static void come_and_die(farm_t *farm, double *now, int process, const uint64_t *others, size_t count)
{
    char name[30];
    snprintf(name, sizeof name, "host:%d", process);
    uint64_t worker;
    pass(farm, now, 80, others, count); /* after units lapsed, others are given none for a while */
    take_one(farm, *now, others[0]);
    assert_int_equal(try_hello(farm, *now, name, &worker).code, RESULT_OK);
    assert_int_not_equal(take_one(farm, *now, worker).job, 0);
    pass(farm, now, 6, others, count);
    assert_false(toy_report(farm, *now, 0).workers > count);
}

static void who_dies_again_and_again_is_put_aside(void **state)
{
    farm_t *farm = *state;
    submit(farm, 1024);
    double now = 0;
    uint64_t worker, good = toy_join(farm, 0, "good:1", 1, 0);
    toy_work_t work = take_one(farm, 0, good);
    for (int i = 0; i < FARM_MAX_FAILURES; i++) come_and_die(farm, &now, i, &good, 1);
    result_t refused = try_hello(farm, now, "host:77", &worker);
    assert_int_equal(refused.code, RESULT_CANCELLED);
    assert_non_null(strstr(refused.message, "died with units in its hands"));
    worker_report_t report = find_worker(farm, now, "host:2");
    assert_false(report.connected);
    assert_non_null(strstr(report.aside, "died with units"));
    assert_string_equal(find_worker(farm, now, "good:1").aside, "");
    assert_int_equal(deliver(farm, now, good, &work).code, RESULT_OK);
    /* It may come back; the second time it is aside for longer. */
    pass(farm, &now, FARM_ASIDE_SECONDS, &good, 1);
    for (int i = 0; i < FARM_MAX_FAILURES; i++) come_and_die(farm, &now, 10 + i, &good, 1);
    pass(farm, &now, FARM_ASIDE_SECONDS, &good, 1);
    assert_int_equal(try_hello(farm, now, "host:78", &worker).code, RESULT_CANCELLED);
    pass(farm, &now, FARM_ASIDE_SECONDS, &good, 1);
    assert_int_equal(try_hello(farm, now, "host:79", &worker).code, RESULT_OK);
}

static void a_delivery_clears_a_machine(void **state)
{
    farm_t *farm = *state;
    submit(farm, 1024);
    double now = 0;
    uint64_t good = toy_join(farm, now, "good:1", 1, 0), worker;
    take_one(farm, now, good);
    for (int i = 0; i < 4 * FARM_MAX_FAILURES; i++) {
        char name[30];
        snprintf(name, sizeof name, "host:%d", i);
        pass(farm, &now, 20, &good, 1);
        assert_int_equal(try_hello(farm, now, name, &worker).code, RESULT_OK);
        toy_work_t work = take_one(farm, now, worker);
        if (i % 2 == 1) assert_int_equal(deliver(farm, now + 1, worker, &work).code, RESULT_OK);
        if (i % 2 == 1) assert_int_not_equal(take_one(farm, now + 1, worker).job, 0);
        pass(farm, &now, 8, &good, 1);
    }
}

/* A link breaks: all workers of a machine are lost at a time, twice, three times. They come back by the same
 * or by other names. */
static void a_broken_link_is_no_failure(void **state)
{
    farm_t *farm = *state;
    submit(farm, 1024);
    double now = 0;
    uint64_t workers[8];
    for (int loss = 0; loss < 6; loss++) {
        for (int i = 0; i < 8; i++) {
            char name[30];
            snprintf(name, sizeof name, "host:%d", i);
            assert_int_equal(try_hello(farm, now, name, &workers[i]).code, RESULT_OK);
            assert_int_not_equal(take_one(farm, now, workers[i]).job, 0);
        }
        pass(farm, &now, 7, NULL, 0);
        /* They do not know that they were given up. */
        for (int i = 0; i < 8; i++) assert_false(toy_beat(farm, now, workers[i]));
    }
}

/* Who declines is left alone with that job for a while, each time for longer, and no worse. */
static void who_declines_what_others_render_does_other_jobs(void **state)
{
    farm_t *farm = *state;
    farm_destroy((farm_t **)state);
    farm = *state = toy_farm(true); /* what only serves one command has no patience */
    uint64_t job = submit(farm, 1024), other = submit(farm, 1024), worker;
    int declines = 0;
    for (double now = 0; now < 400; now += 5) {
        assert_int_equal(try_hello(farm, now, "small:1", &worker).code, RESULT_OK);
        if (take_one(farm, now, worker).job == job) {
            farm_goodbye(farm, now, worker, job, "no memory for the scene");
            declines++;
        } else {
            assert_int_equal(toy_report(farm, now, other).workers, 1);
            farm_goodbye(farm, now, worker, 0, "");
        }
    }
    assert_in_range(declines, 4, 8);
    assert_int_equal(toy_state(farm, 400, job), JOB_RUNNING);
}

/* ---- units that end workers ---------------------------------------------------------------------------- */

enum { HANDLER = 4, RANDOM_FARMS = 12 };

/* A farm on which whoever holds a sample of one tile dies. */
typedef struct {
    farm_t *farm;
    double now;
    uint64_t job;
    int machines, generation, deaths;
    uint32_t killer; /* tile */
    uint64_t workers[HANDLER];
    toy_work_t work[HANDLER];
} plague_t;

static void join_again(plague_t *plague, int i)
{
    char name[30];
    snprintf(name, sizeof name, "machine-%c:%d", 'a' + i % plague->machines, ++plague->generation);
    plague->workers[i] = toy_join(plague->farm, plague->now, name, 1, 0);
    plague->work[i] = (toy_work_t){0};
}

static bool is_deadly(const plague_t *plague, const toy_work_t *work)
{
    for (size_t i = 0; i < work->count; i++)
        if (work->units[i].tile == plague->killer) return true;
    return false;
}

/* A second: who has work delivers it, or dies of it; who has none asks. */
static void plague_step(plague_t *plague)
{
    bool died[HANDLER] = {false};
    for (int i = 0; i < HANDLER; i++) {
        toy_work_t *work = &plague->work[i];
        if (work->job != 0 && !is_deadly(plague, work))
            assert_int_equal(deliver(plague->farm, plague->now, plague->workers[i], work).code, RESULT_OK);
        if (is_deadly(plague, work)) {
            died[i] = true;
            plague->deaths++;
            plague->workers[i] = 0;
        } else {
            *work = toy_take(plague->farm, plague->now, plague->workers[i], 1 << 11, 1 << 10);
        }
    }
    pass(plague->farm, &plague->now, 1, plague->workers, HANDLER);
    bool any = false;
    for (int i = 0; i < HANDLER; i++) any = any || died[i];
    if (any) pass(plague->farm, &plague->now, 6, plague->workers, HANDLER);
    for (int i = 0; i < HANDLER; i++)
        if (died[i]) join_again(plague, i);
}

static void run_plague(plague_t *plague, farm_t *farm, int machines)
{
    *plague = (plague_t){.farm = farm, .killer = 2, .machines = machines};
    plague->job = submit(farm, 8);
    for (int i = 0; i < HANDLER; i++) join_again(plague, i);
    for (int step = 0; step < 300 && toy_state(farm, plague->now, plague->job) != JOB_FINISHING; step++)
        plague_step(plague);
}

static void check_plague(plague_t *plague)
{
    job_report_t report = toy_report(plague->farm, plague->now, plague->job);
    assert_int_equal(report.record.state, JOB_FINISHING);
    assert_non_null(strstr(report.record.message, "tile 2, samples"));
    assert_non_null(strstr(report.record.message, "left out"));
    assert_int_equal(report.record.account.skipped, 16 * 16 * 8); /* that tile, and no sample more */
    assert_int_equal(report.record.account.counted, 3 * 16 * 16 * 8);
    assert_int_equal(report.record.account.issued,
                     report.record.account.counted + report.record.account.returned);
    assert_true(plague->deaths >= 2 + FARM_UNIT_DEATHS);
}

static void a_unit_that_kills_is_left_out(void **state)
{
    plague_t plague;
    run_plague(&plague, *state, 2);
    check_plague(&plague);
}

static void a_unit_that_kills_the_only_machine_is_left_out(void **state)
{
    plague_t plague;
    run_plague(&plague, *state, 1);
    check_plague(&plague);
}

/* One machine of two is broken, and dies of everything: no unit is left out for that. */
static void a_machine_that_dies_of_everything_leaves_nothing_out(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 16), good = toy_join(farm, 0, "good:1", 1, 0), bad = 0;
    double now = 0;
    int deaths = 0;
    for (int step = 0; step < 400 && toy_state(farm, now, job) != JOB_FINISHING; step++) {
        toy_work_t work = toy_take(farm, now, good, 1 << 9, 1 << 9);
        char name[30];
        snprintf(name, sizeof name, "bad:%d", step);
        if (try_hello(farm, now, name, &bad).code == RESULT_OK &&
            toy_take(farm, now, bad, 1 << 10, 1 << 9).job != 0)
            deaths++;
        pass(farm, &now, 6, &good, 1);
        if (work.job != 0) assert_int_equal(deliver(farm, now, good, &work).code, RESULT_OK);
    }
    job_report_t report = toy_report(farm, now, job);
    assert_int_equal(report.record.state, JOB_FINISHING);
    assert_int_equal(report.record.account.skipped, 0);
    assert_true(deaths >= FARM_MAX_FAILURES);
}

/* A container that is started again has the name, and the process number, of the one that died. */
static void a_process_that_begins_anew_has_died(void **state)
{
    for (uint64_t anew = 0; anew < 2; anew++) {
        farm_t *farm = *state;
        uint64_t job = submit(farm, 4), box = join_process(farm, 0, "box:1", 1);
        double now = 0;
        for (uint64_t i = 1; i < 3; i++) {
            take_one(farm, now, box);
            pass(farm, &now, 1, NULL, 0);
            box = join_process(farm, now, "box:1", 1 + i * anew);
            pass(farm, &now, 8, &box, 1);
        }
        const char *remark =
            strstr(toy_report(farm, now, job).record.message, "1 units that workers died with");
        assert_true((remark != NULL) == (anew == 1));
        farm_destroy((farm_t **)state);
        *state = toy_farm(false);
    }
}

/* A worker that was held for dead, and is not: its units are above suspicion again. */
static void who_is_heard_of_again_did_not_die(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 4);
    double now = 0;
    uint64_t first = toy_join(farm, now, "a:1", 1, 0);
    take_one(farm, now, first);
    pass(farm, &now, 6, NULL, 0);
    uint64_t second = toy_join(farm, now, "b:1", 1, 0);
    take_one(farm, now, second);
    pass(farm, &now, 8, NULL, 0);
    assert_non_null(strstr(toy_report(farm, now, job).record.message, "1 units that workers died with"));
    assert_false(toy_beat(farm, now, second));
    pass(farm, &now, 1.5, NULL, 0);
    assert_null(strstr(toy_report(farm, now, job).record.message, "died"));
    uint64_t third = toy_join(farm, now, "c:1", 1, 0);
    toy_work_t work = toy_take(farm, now, third, 1 << 12, 1 << 10);
    assert_true(work.count > 1); /* not one unit alone */
    assert_int_equal(work.units[0].tile, 0);
}

/* A suspect is handed out alone, to one who holds nothing else. */
static void suspects_are_handed_out_apart(void **state)
{
    farm_t *farm = *state;
    submit(farm, 64);
    double now = 0;
    uint64_t busy = toy_join(farm, now, "busy:1", 1, 0);
    toy_work_t work = take_one(farm, now, busy);
    for (int i = 0; i < 2; i++) {
        uint64_t dies = toy_join(farm, now, i == 0 ? "a:1" : "b:1", 1, 0);
        assert_int_equal(take_one(farm, now, dies).units[0].tile, 1);
        pass(farm, &now, 6, &busy, 1);
    }
    uint64_t fresh = toy_join(farm, now, "fresh:1", 1, 0), both[] = {busy, fresh};
    toy_work_t alone = toy_take(farm, now, fresh, 1 << 14, 1 << 10);
    assert_int_equal(alone.count, 1);
    assert_int_equal(alone.units[0].tile, 1);
    assert_int_equal(toy_take(farm, now, fresh, 1 << 14, 1 << 10).job, 0); /* it holds nothing else */
    toy_work_t more = take_one(farm, now, busy);                           /* the others go on */
    assert_int_not_equal(more.job, 0);
    assert_int_equal(deliver(farm, now, fresh, &alone).code, RESULT_OK);
    notice_t notice;
    bool called = false;
    while (farm_next_notice(farm, &notice)) called = true; /* and it is called when it may have more */
    assert_true(called);
    assert_true(toy_take(farm, now, fresh, 1 << 14, 1 << 10).count > 1);
    pass(farm, &now, 2, both, 2);
    assert_int_equal(deliver(farm, now, busy, &work).code, RESULT_OK);
}

/* A machine that hangs, though its heart beats, does not keep a suspect from others for ever. */
static void who_hangs_is_not_waited_for(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 4), hangs = toy_join(farm, 0, "hangs:1", 1, 0);
    double now = 0;
    toy_work_t work;
    for (int i = 0; i < 2; i++) {
        uint64_t dies = toy_join(farm, now, i == 0 ? "a:1" : "a:2", 1, 0);
        assert_int_equal(take_one(farm, now, dies).units[0].tile, 0);
        pass(farm, &now, 6, &hangs, 1);
    }
    uint64_t other = toy_join(farm, now, "a:3", 1, 0), both[] = {hangs, other};
    while ((work = take_one(farm, now, other)).job != 0)
        assert_int_equal(deliver(farm, now, other, &work).code, RESULT_OK);
    assert_int_equal(toy_state(farm, now, job),
                     JOB_RUNNING); /* the first tile is kept for the other machine */
    pass(farm, &now, 120, both, 2);
    while ((work = take_one(farm, now, other)).job != 0)
        assert_int_equal(deliver(farm, now, other, &work).code, RESULT_OK);
    assert_int_equal(toy_state(farm, now, job), JOB_FINISHING);
}

/* One farm whose workers live for so many half seconds on average; returns how many were killed. */
static int random_kills(uint32_t seed, uint32_t life)
{
    farm_t *farm = toy_farm(false);
    job_settings_t settings = toy_settings();
    settings.spp = 1024;
    uint64_t job = toy_submit(farm, 0, &settings, 0), workers[HANDLER] = {0};
    double now = 0, begun[HANDLER] = {0};
    toy_work_t work[HANDLER];
    int kills = 0, generation = 0;
    uint32_t random = seed;
    while (toy_state(farm, now, job) != JOB_FINISHING && kills < 3000) {
        for (int i = 0; i < HANDLER; i++) {
            random = random * 747796405u + 2891336453u;
            if (workers[i] == 0) {
                char name[30];
                snprintf(name, sizeof name, "host-%d:%d", i % 2, ++generation);
                workers[i] = toy_join(farm, now, name, 1, 0);
                work[i] = (toy_work_t){0};
            } else if (work[i].job == 0) {
                work[i] = toy_take(farm, now, workers[i], 1 << 12, 1 << 10);
                begun[i] = now;
            } else if ((random >> 8) % life == 0) {
                workers[i] = 0;
                kills++;
            } else if (now - begun[i] >= 2) {
                (void)deliver(farm, now, workers[i], &work[i]); /* it may come too late */
                work[i] = (toy_work_t){0};
            }
        }
        pass(farm, &now, 0.5, workers, HANDLER);
    }
    pass(farm, &now, 2, NULL, 0);
    job_report_t report = toy_report(farm, now, job);
    assert_int_equal(report.record.state, JOB_FINISHING);
    assert_int_equal(report.record.account.skipped, 0);
    assert_int_equal(report.record.account.issued,
                     report.record.account.counted + report.record.account.returned);
    assert_string_equal(report.record.message, "");
    farm_destroy(&farm);
    return kills;
}

/* Workers are killed at random, all the time: everything is delivered in the end, nothing is left out, nobody
 * is put aside. They need two seconds for a batch, and live for three to eight. */
static void random_kills_leave_nothing_out(void **state)
{
    (void)state;
    int kills = 0;
    for (uint32_t seed = 1; seed <= RANDOM_FARMS; seed++)
        kills += random_kills(seed * 7919, 6 + 2 * (seed % 6));
    print_message("%d kills\n", kills);
    assert_true(kills > 100 * RANDOM_FARMS);
}

/* ---- operators ----------------------------------------------------------------------------------------- */

static void a_drained_worker_gets_nothing_more_and_is_asked_to_leave(void **state)
{
    farm_t *farm = *state;
    notice_t notice;
    uint64_t job = submit(farm, 16), one = toy_join(farm, 0, "node-1:7", 1, 0);
    uint64_t two = toy_join(farm, 0, "node-10:7", 1, 0), other = toy_join(farm, 0, "node-1:8", 1, 0);
    toy_work_t work = take_one(farm, 0, one);
    assert_int_equal(work.job, job);
    while (farm_next_notice(farm, &notice)) {
    }
    assert_int_equal(farm_drain(farm, "node"), 0); /* no part of a host's name */
    assert_int_equal(farm_drain(farm, "node-1:7"), 1);
    assert_true(farm_next_notice(farm, &notice) && notice.leave);
    assert_false(farm_next_notice(farm, &notice));
    assert_int_equal(take_one(farm, 0, one).job, 0);
    assert_int_equal(take_one(farm, 0, two).job, job);
    assert_int_equal(deliver(farm, 1, one, &work).code, RESULT_OK); /* what it has counts */
    assert_non_null(strstr(find_worker(farm, 1, "node-1:7").aside, "drained"));
    /* It has lost its connection meanwhile: it is still to leave. */
    farm_goodbye(farm, 1, one, 0, "");
    uint64_t again = toy_join(farm, 1, "node-1:7", 1, 0);
    assert_true(farm_next_notice(farm, &notice) && notice.leave);
    assert_int_equal(take_one(farm, 1, again).job, 0);
    assert_int_equal(take_one(farm, 1, other).job, job);
    assert_int_equal(farm_drain(farm, "node-1"), 2); /* all of the host */
    assert_int_equal(take_one(farm, 1, other).job, 0);
    assert_int_equal(take_one(farm, 1, toy_join(farm, 1, "node-1:9", 1, 0)).job, job); /* a new process */
    /* Also under an old name, as that of a container is. */
    assert_int_equal(take_one(farm, 1, join_process(farm, 1, "node-1:7", 2)).job, job);
}

static size_t workers_listed(farm_t *farm, double now)
{
    size_t count;
    free(farm_worker_report(farm, now, &count));
    return count;
}

static void workers_that_are_gone_are_forgotten(void **state)
{
    farm_t *farm = *state;
    submit(farm, 64);
    uint64_t delivers = toy_join(farm, 0, "a:1", 1, 0), stays = toy_join(farm, 0, "b:1", 1, 0);
    uint64_t idle = toy_join(farm, 0, "c:1", 1, 0);
    toy_work_t work = take_one(farm, 0, delivers);
    assert_int_equal(deliver(farm, 1, delivers, &work).code, RESULT_OK);
    farm_goodbye(farm, 1, delivers, 0, "");
    farm_goodbye(farm, 1, idle, 0, "");
    double now = 2;
    pass(farm, &now, 280, &stays, 1);
    assert_int_equal(workers_listed(farm, now), 3);
    pass(farm, &now, 40, &stays, 1);
    assert_int_equal(workers_listed(farm, now), 2); /* who delivered nothing goes first */
    assert_true(toy_beat(farm, now, stays));
    pass(farm, &now, 3400, &stays, 1);
    assert_int_equal(workers_listed(farm, now), 1);
    farm_goodbye(farm, now, stays, 0, "");
    assert_int_equal(farm_purge(farm, now), 1); /* at once */
    assert_int_equal(workers_listed(farm, now), 0);
}

static void who_comes_and_goes_does_not_fill_the_log(void **state)
{
    farm_t *farm = *state;
    enum { TIMES = 2000 };
    char *folder = scratch_new();
    log_init("test", LOG_INFO);
    scratch_capture_t capture = scratch_capture(folder, 2);
    for (int i = 0; i < TIMES; i++) {
        char name[40];
        snprintf(name, sizeof name, "flooder:%d", i);
        farm_goodbye(farm, 0.01 * i, toy_join(farm, 0.01 * i, name, 1, 0), 0, "");
    }
    toy_join(farm, 0.01 * TIMES, "other:1", 1, 0); /* others are told of as ever */
    for (double now = 0.01 * TIMES; now < 90; now += 0.5) farm_tick(farm, now);
    char *text = scratch_uncapture(&capture);
    size_t lines = 0;
    for (const char *c = text; *c != '\0'; c++) lines += *c == '\n';
    assert_in_range(lines, 100, 400);
    assert_non_null(strstr(text, "worker other:1 joins"));
    assert_non_null(strstr(text, "come and go all the time"));
    assert_non_null(strstr(text, "times more than was written"));
    free(text);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define WITH_FARM(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
        WITH_FARM(a_drained_worker_gets_nothing_more_and_is_asked_to_leave),
        WITH_FARM(workers_that_are_gone_are_forgotten),
        WITH_FARM(who_comes_and_goes_does_not_fill_the_log),
        WITH_FARM(speed_is_measured),
        WITH_FARM(an_idle_worker_takes_over_from_a_straggler),
        WITH_FARM(a_thin_link_holds_nobody_up),
        WITH_FARM(equals_leave_each_other_alone),
        WITH_FARM(deadlines_follow_the_speed),
        WITH_FARM(who_has_work_of_its_own_takes_over_later),
        cmocka_unit_test_setup_teardown(nobody_is_overtaken_at_the_end_of_a_pass, set_up_roomy, tear_down),
        cmocka_unit_test_setup_teardown(who_delivers_by_drops_is_overtaken_at_the_end_of_a_pass, set_up_roomy,
                                        tear_down),
        WITH_FARM(who_asks_for_nothing_keeps_no_job_from_others),
        WITH_FARM(a_connection_has_one_number),
        WITH_FARM(a_process_that_begins_anew_has_died),
        WITH_FARM(who_delivered_once_and_stalls_loses_its_units),
        WITH_FARM(who_was_slow_once_is_not_waited_for_twice_as_long),
        WITH_FARM(who_offers_for_ever_loses_its_units),
        WITH_FARM(units_are_reclaimed),
        WITH_FARM(a_job_belongs_to_the_machines_with_the_same_bits),
        WITH_FARM(a_job_with_nothing_counted_is_free),
        WITH_FARM(too_many_threads_are_refused),
        WITH_FARM(a_job_can_be_bound_anew),
        WITH_FARM(a_job_can_be_opened_to_all_kinds),
        WITH_FARM(the_first_batch_decides_on_the_bits),
        WITH_FARM(a_mixed_job_takes_everybody_and_says_so),
        WITH_FARM(who_dies_again_and_again_is_put_aside),
        WITH_FARM(a_delivery_clears_a_machine),
        WITH_FARM(a_broken_link_is_no_failure),
        WITH_FARM(who_declines_what_others_render_does_other_jobs),
        WITH_FARM(a_unit_that_kills_is_left_out),
        WITH_FARM(a_unit_that_kills_the_only_machine_is_left_out),
        WITH_FARM(a_machine_that_dies_of_everything_leaves_nothing_out),
        WITH_FARM(who_is_heard_of_again_did_not_die),
        WITH_FARM(suspects_are_handed_out_apart),
        WITH_FARM(who_hangs_is_not_waited_for),
        WITH_FARM(random_kills_leave_nothing_out),
    };
    return cmocka_run_group_tests_name("farm workers", tests, NULL, NULL);
}
