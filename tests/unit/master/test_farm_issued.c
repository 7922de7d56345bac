/* Tests of what the farm counts: units that were issued to who delivers them, and no others, whatever else is
 * right with a batch or a claim. The image never changes by what is refused. */
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static int set_up(void **state)
{
    *state = toy_farm(true);
    return 0;
}

static int tear_down(void **state)
{
    farm_destroy((farm_t **)state);
    return 0;
}

static uint64_t submit(farm_t *farm)
{
    job_settings_t settings = toy_settings();
    return toy_submit(farm, 0, &settings, 0);
}

static hash_t content_of(const job_settings_t *settings)
{
    return job_content_hash(settings, &(hash_t){{0}});
}

/* A unit of some samples of a tile, of the 4 that there are. */
static toy_work_t take_unit(farm_t *farm, double now, uint64_t worker)
{
    toy_work_t work = toy_take(farm, now, worker, 1, 1 << 20);
    assert_int_equal(work.count, 1);
    return work;
}

static toy_work_t work_of(uint64_t job, unit_t unit, issue_t issue)
{
    return (toy_work_t){.job = job, .count = 1, .units = {unit}, .issues = {issue}};
}

/* Pixel samples. */
static uint64_t samples_of(const toy_work_t *work)
{
    return (uint64_t)work->units[0].count * 256;
}

/* The sums of an image that nobody disturbed. */
static hash_t undisturbed(farm_t *farm, double now)
{
    job_settings_t settings = toy_settings();
    settings.spp = 8; /* so that it stays open */
    uint64_t job = toy_submit(farm, now, &settings, 1), worker = toy_join(farm, now, "undisturbed", 1, 0);
    for (uint32_t tile = 0; tile < 4; tile++)
        assert_int_equal(toy_deliver(farm, now, worker, job, &(unit_t){tile, 0, 4}, 1).code, RESULT_OK);
    return toy_sums(farm, job);
}

static void who_was_given_one_unit_delivers_one(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = toy_settings();
    settings.spp = 8;
    uint64_t job = toy_submit(farm, 0, &settings, 0), liar = toy_join(farm, 0, "liar:1", 1, 0),
             honest = toy_join(farm, 0, "honest:1", 1, 0);
    toy_work_t one = toy_take(farm, 0, liar, 1, 1024), all = one;
    assert_int_equal(one.count, 1);
    unit_t given = one.units[0];
    assert_int_equal(given.tile, 0);
    assert_int_equal(given.first, 0);
    assert_in_range(given.count, 1, 4);
    for (uint32_t tile = 1; tile < 4; tile++) all.units[tile - 1] = (unit_t){tile, 0, 4};
    all.count = 3;
    for (int i = 0; i < 3; i++) all.issues[i] = one.issues[0];
    assert_int_equal(toy_deliver_as(farm, 0, liar, &all).code, RESULT_DENIED);
    /* Nor more of the tile, as if it were a piece of something. */
    toy_work_t more = work_of(job, (unit_t){0, given.first, given.count + 1}, one.issues[0]);
    assert_int_equal(toy_deliver_as(farm, 0, liar, &more).code, RESULT_DENIED);
    job_report_t report = toy_report(farm, 0, job);
    assert_int_equal(report.record.samples_done, 0);
    assert_int_equal(report.record.batches, 0);
    assert_int_equal(report.record.batches_refused, 2);
    assert_true(hash_is_zero(&report.record.fingerprint));
    for (uint32_t tile = 0; tile < 4; tile++)
        assert_int_equal(toy_deliver(farm, 0, honest, job, &(unit_t){tile, 0, 4}, 1).code, RESULT_OK);
    hash_t right = undisturbed(farm, 0), sums = toy_sums(farm, job);
    assert_true(hash_equal(&sums, &right));
}

static void a_job_that_was_given_to_nobody_stays_as_it_is(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), liar = toy_join(farm, 0, "liar:1", 1, 7);
    job_settings_t settings = toy_settings();
    hash_t content = content_of(&settings);
    const unit_t unit = {0, 0, 4};
    const issue_t guess = {.mac = 12345};
    toy_work_t all = work_of(job, unit, guess);
    assert_int_equal(farm_batch_wanted(farm, 0, liar, job).code, RESULT_OK); /* the batch decides */
    assert_int_equal(toy_state(farm, 0, job), JOB_QUEUED);
    assert_int_equal(toy_deliver_as(farm, 0, liar, &all).code, RESULT_DENIED);
    farm_reclaim(farm, 0, &(claim_t){liar, job, &content, &unit, &guess, 1});
    job_report_t report = toy_report(farm, 0, job);
    assert_int_equal(report.record.state, JOB_QUEUED);
    assert_int_equal(report.record.samples_done, 0);
    assert_true(hash_is_zero(&report.record.fingerprint));
}

/* The master was restarted, and had no checkpoint: what workers have of the job begins it again. */
static void who_had_units_of_a_lost_job_begins_it_again(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = toy_settings();
    hash_t content = content_of(&settings);
    for (int claims = 0; claims < 2; claims++) {
        uint64_t job = submit(farm), worker = toy_join(farm, 0, "w:1", 1, 0);
        toy_work_t work = work_of(job, (unit_t){2, 0, 4}, (issue_t){0});
        toy_issue(farm, worker, job, 0, work.units, 1, work.issues);
        assert_int_equal(toy_state(farm, 0, job), JOB_QUEUED);
        if (claims) {
            farm_reclaim(farm, 0, &(claim_t){worker, job, &content, work.units, work.issues, 1});
            assert_int_equal(toy_state(farm, 0, job), JOB_RUNNING);
            assert_int_equal(toy_report(farm, 0, job).record.account.out, 4 * 256);
        }
        assert_int_equal(toy_deliver_as(farm, 0, worker, &work).code, RESULT_OK);
        assert_int_equal(toy_state(farm, 0, job), JOB_RUNNING);
        assert_int_equal(toy_report(farm, 0, job).record.samples_done, 4 * 256);
    }
}

/* A job that is over and goes on: its film is on the disk, and a batch that was issued waits until it is
 * here. */
static void a_batch_waits_for_the_film_of_its_job(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), other = toy_join(farm, 0, "other:1", 1, 0),
             late = toy_join(farm, 0, "late:1", 1, 0);
    toy_work_t work = take_unit(farm, 0, late);
    toy_film_t film;
    for (uint32_t tile = 1; tile < 4; tile++)
        assert_int_equal(toy_deliver(farm, 0, other, job, &(unit_t){tile, 0, 4}, 1).code, RESULT_OK);
    toy_order(farm, 0, job, ORDER_CANCEL);
    toy_beat(farm, 0, other);
    farm_tick(farm, 100);
    assert_int_equal(toy_write_images(farm, 100, result_ok()), 1);
    assert_true(toy_checkpoint(farm, 100, result_ok(), &film));
    assert_int_equal(toy_state(farm, 100, job), JOB_CANCELLED);
    late = toy_join(farm, 100, "late:1", 1, 0);
    assert_int_equal(toy_deliver_as(farm, 100, late, &work).code, RESULT_CANCELLED);
    assert_int_equal(farm_order(farm, 100, &(job_order_t){.job = job, .kind = ORDER_EXTEND, .spp = 8}).code,
                     RESULT_OK);
    toy_work_t wrong = work;
    wrong.issues[0].mac++;
    assert_int_equal(toy_deliver_as(farm, 100, late, &wrong).code, RESULT_DENIED);
    assert_null(farm_next_load(farm)); /* that loads nothing */
    assert_int_equal(farm_batch_wanted(farm, 100, late, job).code, RESULT_OK);
    assert_int_equal(toy_deliver_as(farm, 100, late, &work).code, RESULT_LIMIT);
    assert_int_equal(farm_batch_wanted(farm, 100, late, job).code, RESULT_LIMIT);
    assert_true(toy_load(farm, 100, &film));
    assert_int_equal(farm_batch_wanted(farm, 100, late, job).code, RESULT_OK);
    assert_int_equal(toy_deliver_as(farm, 100, late, &work).code, RESULT_OK);
    assert_int_equal(toy_report(farm, 100, job).record.samples_done, 3 * 1024 + samples_of(&work));
}

static void units_are_of_a_party(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), first = toy_join(farm, 0, "a:1", 1, 0),
             second = toy_join(farm, 0, "a:2", 1, 0), other = toy_join(farm, 0, "b:1", 1, 0), keyed;
    worker_hello_t hello = {.name = "a:3", .key = "0123456789012345678901234567890123456789", .threads = 1};
    assert_int_equal(toy_say_hello(farm, 0, hello, &keyed).code, RESULT_OK);
    toy_work_t work = take_unit(farm, 0, first), of_key = take_unit(farm, 0, keyed);
    assert_int_equal(toy_deliver_as(farm, 0, other, &work).code, RESULT_DENIED);
    assert_int_equal(toy_deliver_as(farm, 0, keyed, &work).code, RESULT_DENIED);
    assert_int_equal(toy_deliver_as(farm, 0, first, &of_key).code, RESULT_DENIED);
    /* Another worker of the party may be the same one with a new number. */
    farm_goodbye(farm, 0, first, 0, "");
    assert_int_equal(toy_deliver_as(farm, 0, second, &work).code, RESULT_OK);
    assert_int_equal(toy_deliver_as(farm, 0, keyed, &of_key).code, RESULT_OK);
    assert_int_equal(toy_report(farm, 0, job).record.samples_done, samples_of(&work) + samples_of(&of_key));
}

static void units_are_of_a_job_and_of_a_check(void **state)
{
    farm_t *farm = *state;
    uint64_t first = submit(farm), second = submit(farm), worker = toy_join(farm, 0, "a:1", 1, 0);
    toy_work_t work = take_unit(farm, 0, worker), other = work;
    assert_int_equal(work.job, first);
    other.job = second; /* of the same content */
    assert_int_equal(toy_deliver_as(farm, 0, worker, &other).code, RESULT_DENIED);
    other = work;
    other.check = 77;
    assert_int_equal(toy_deliver_as(farm, 0, worker, &other).code, RESULT_DENIED);
    other.check = 0;
    toy_issue(farm, worker, first, 77, work.units, 1, other.issues);
    toy_deliver_as(farm, 0, worker, &work); /* clears it of what is held against it */
    assert_int_equal(toy_deliver_as(farm, 0, worker, &other).code, RESULT_DENIED);
    assert_int_equal(toy_report(farm, 0, first).record.samples_done, 1024);
    assert_int_equal(toy_state(farm, 0, second), JOB_QUEUED);
}

static void units_come_in_pieces(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), worker = toy_join(farm, 0, "a:1", 1, 0);
    toy_work_t work = take_unit(farm, 0, worker);
    unit_t unit = work.units[0];
    assert_int_equal(unit.count, 4);
    uint64_t mac = work.issues[0].mac;
    toy_work_t piece = work_of(job, (unit_t){unit.tile, 1, 2}, (issue_t){mac, 1, 1});
    assert_int_equal(toy_deliver_as(farm, 0, worker, &piece).code, RESULT_OK);
    assert_int_equal(toy_deliver_as(farm, 0, worker, &work).code, RESULT_MISMATCH); /* a part is counted */
    toy_work_t ends = {.job = job,
                       .count = 2,
                       .units = {{unit.tile, 3, 1}, {unit.tile, 0, 1}},
                       .issues = {{mac, 3, 0}, {mac, 0, 3}}};
    assert_int_equal(toy_deliver_as(farm, 0, worker, &ends).code, RESULT_OK);
    assert_int_equal(toy_report(farm, 0, job).record.samples_done, 1024);
    /* Pieces that overlap count once. */
    work = take_unit(farm, 0, worker);
    mac = work.issues[0].mac;
    unit = work.units[0];
    toy_work_t overlap = {.job = job,
                          .count = 2,
                          .units = {unit, {unit.tile, unit.first + unit.count - 1, 1}},
                          .issues = {{mac, 0, 0}, {mac, unit.count - 1, 0}}};
    assert_int_equal(toy_deliver_as(farm, 0, worker, &overlap).code, RESULT_MISMATCH);
    assert_int_equal(toy_report(farm, 0, job).record.samples_done, 1024);
}

/* One unit that was not issued spoils a batch, whose others go to who asks for them. */
static void a_batch_is_refused_whole(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), worker = toy_join(farm, 0, "a:1", 1, 0),
             other = toy_join(farm, 0, "b:1", 1, 0);
    toy_work_t work = take_unit(farm, 0, worker), spoilt = work;
    spoilt.units[1] = (unit_t){3, 0, 4};
    spoilt.issues[1] = work.issues[0];
    spoilt.count = 2;
    assert_int_equal(toy_deliver_as(farm, 0, worker, &spoilt).code, RESULT_DENIED);
    assert_int_equal(toy_report(farm, 0, job).record.account.out, 0);
    toy_work_t again = take_unit(farm, 0, other);
    assert_int_equal(again.units[0].tile, work.units[0].tile);
    assert_int_equal(toy_deliver_as(farm, 0, worker, &work).code, RESULT_OK); /* who comes first */
    assert_int_equal(toy_deliver_as(farm, 0, other, &again).code, RESULT_MISMATCH);
}

/* What comes twice is nobody's fault: the first answer may have been lost. What was never issued is. */
static void who_delivers_what_is_not_its_own_is_put_aside(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), worker = toy_join(farm, 0, "a:1", 1, 0), again;
    toy_work_t work = take_unit(farm, 0, worker);
    assert_int_equal(toy_deliver_as(farm, 0, worker, &work).code, RESULT_OK);
    for (int i = 0; i < 2 * FARM_MAX_FAILURES; i++)
        assert_int_equal(toy_deliver_as(farm, 0, worker, &work).code, RESULT_MISMATCH);
    assert_true(toy_beat(farm, 0, worker));
    toy_work_t other = work_of(job, (unit_t){3, 0, 4}, work.issues[0]);
    for (int i = 0; i < FARM_MAX_FAILURES; i++) {
        assert_true(toy_beat(farm, 0, worker));
        assert_int_equal(toy_deliver_as(farm, 0, worker, &other).code, RESULT_DENIED);
    }
    assert_false(toy_beat(farm, 0, worker));
    result_t result = toy_say_hello(farm, 0, (worker_hello_t){.name = "a:2", .threads = 1}, &again);
    assert_int_equal(result.code, RESULT_CANCELLED);
    assert_non_null(strstr(result.message, "not given"));
    assert_int_equal(toy_report(farm, 0, job).record.samples_done, 1024);
}

static void a_lease_may_end_before_a_batch_comes(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm), worker = toy_join(farm, 0, "a:1", 1, 0);
    toy_work_t work = take_unit(farm, 0, worker);
    farm_tick(farm, 100);
    assert_false(toy_beat(farm, 100, worker));
    assert_int_equal(toy_report(farm, 100, job).record.account.out, 0);
    worker = toy_join(farm, 100, "a:1", 1, 0);
    job_settings_t settings = toy_settings();
    hash_t content = content_of(&settings);
    issue_t wrong = {.mac = work.issues[0].mac + 1};
    farm_reclaim(farm, 100, &(claim_t){worker, job, &content, work.units, &wrong, 1});
    assert_int_equal(toy_report(farm, 100, job).record.account.out, 0);
    farm_reclaim(farm, 100, &(claim_t){worker, job, &content, work.units, work.issues, 1});
    assert_int_equal(toy_report(farm, 100, job).record.account.out, 1024);
    assert_int_equal(toy_deliver_as(farm, 100, worker, &work).code, RESULT_OK);
}

#define WITH_FARM(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)

int main(void)
{
    const struct CMUnitTest tests[] = {
        WITH_FARM(who_was_given_one_unit_delivers_one),
        WITH_FARM(a_job_that_was_given_to_nobody_stays_as_it_is),
        WITH_FARM(who_had_units_of_a_lost_job_begins_it_again),
        WITH_FARM(a_batch_waits_for_the_film_of_its_job),
        WITH_FARM(units_are_of_a_party),
        WITH_FARM(units_are_of_a_job_and_of_a_check),
        WITH_FARM(units_come_in_pieces),
        WITH_FARM(a_batch_is_refused_whole),
        WITH_FARM(who_delivers_what_is_not_its_own_is_put_aside),
        WITH_FARM(a_lease_may_end_before_a_batch_comes),
    };
    return cmocka_run_group_tests_name("farm issued", tests, NULL, NULL);
}
