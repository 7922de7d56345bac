/* Tests of batches that are doubted (trust/plausible.c, checks.c): one party's sums, however large, never
 * fail a job or get into its image; what two parties agree on counts. */
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const int64_t POISON = (int64_t)411552 << 32; /* where the mean is about 1 */
static const int64_t ALMOST = (int64_t)1 << 61;      /* just inside of the film's range */

typedef enum {
    HONEST,
    POISONS, /* adds its lie to all it delivers */
    FLIPS,   /* once, to its second batch */
    CLAIMS   /* that its sums overflow */
} conduct_t;

typedef struct {
    const char *name;
    conduct_t conduct;
    int64_t lie;
    uint64_t worker; /* 0: not connected */
    bool refused;    /* its last hello was */
    int batches, doubted, checks;
} actor_t;

enum { MAX_ACTORS = 4 };

typedef struct {
    farm_t *farm;
    char *folder; /* of what is kept of its batches */
    double now;
    uint64_t job;
    actor_t actors[MAX_ACTORS];
    int count;
} trial_t;

static job_settings_t settings(void)
{
    job_settings_t settings = toy_settings();
    settings.spp = 64;
    return settings;
}

static void begin_verified(trial_t *trial, double verify)
{
    *trial = (trial_t){.folder = scratch_new(), .now = 1};
    trial->farm = toy_verifying_farm(trial->folder);
    job_settings_t wanted = settings();
    trial->job =
        toy_submit_on(trial->farm, trial->now, &wanted, &(job_terms_t){.name = "trial", .verify = verify});
}

static void begin(trial_t *trial)
{
    begin_verified(trial, 0);
}

static void end(trial_t *trial)
{
    farm_destroy(&trial->farm);
    scratch_destroy(&trial->folder);
}

static actor_t *add(trial_t *trial, const char *name, conduct_t conduct, int64_t lie)
{
    assert_true(trial->count < MAX_ACTORS);
    trial->actors[trial->count] = (actor_t){.name = name, .conduct = conduct, .lie = lie};
    return &trial->actors[trial->count++];
}

static void deliver(trial_t *trial, actor_t *actor, const toy_work_t *work)
{
    bool lies = actor->conduct == POISONS || (actor->conduct == FLIPS && actor->batches == 1);
    result_t result =
        actor->conduct == CLAIMS
            ? toy_deliver_overflow(trial->farm, trial->now, actor->worker, work)
            : toy_deliver_work(trial->farm, trial->now, actor->worker, work, lies ? actor->lie : 0);
    actor->batches++;
    actor->doubted += result.code == RESULT_MISMATCH && strstr(result.message, "too large to be believed");
}

static void act(trial_t *trial, actor_t *actor)
{
    if (actor->worker == 0 || !toy_beat(trial->farm, trial->now, actor->worker)) {
        worker_hello_t hello = {.name = actor->name, .threads = 1};
        actor->refused = toy_say_hello(trial->farm, trial->now, hello, &actor->worker).code != RESULT_OK;
        if (actor->refused) actor->worker = 0;
        if (actor->refused) return;
    }
    toy_work_t work = toy_take(trial->farm, trial->now, actor->worker, 1 << 11, 1 << 9);
    if (work.job == 0) return;
    actor->checks += work.check != 0;
    deliver(trial, actor, &work);
}

static job_state_t state_of(const trial_t *trial)
{
    return toy_state(trial->farm, trial->now, trial->job);
}

static job_report_t run(trial_t *trial)
{
    for (int i = 0; i < 400 && state_of(trial) <= JOB_RUNNING; i++, trial->now += 1) {
        for (int a = 0; a < trial->count; a++) act(trial, &trial->actors[a]);
        farm_tick(trial->farm, trial->now);
        farm_settle(trial->farm);
        farm_tick(trial->farm, trial->now);
    }
    return toy_report(trial->farm, trial->now, trial->job);
}

static hash_t right_sums(void)
{
    trial_t trial;
    begin(&trial);
    add(&trial, "a", HONEST, 0);
    assert_int_equal(run(&trial).record.state, JOB_FINISHING);
    hash_t sums = toy_sums(trial.farm, trial.job);
    end(&trial);
    return sums;
}

/* The job is complete, with exactly the right sums. */
static void check_image(trial_t *trial)
{
    job_report_t report = toy_report(trial->farm, trial->now, trial->job);
    assert_int_equal(report.record.state, JOB_FINISHING);
    assert_int_equal(report.record.account.counted, (uint64_t)32 * 32 * settings().spp);
    assert_int_equal(report.record.counts.overflows, 0);
    hash_t right = right_sums(), sums = toy_sums(trial->farm, trial->job);
    assert_true(hash_equal(&right, &sums));
}

static void find_liar(int parties, conduct_t conduct, int64_t lie, double verify)
{
    trial_t trial;
    begin_verified(&trial, verify);
    actor_t *liar = add(&trial, "liar", conduct, lie);
    add(&trial, "b", HONEST, 0);
    if (parties == 3) add(&trial, "c", HONEST, 0);
    job_report_t report = run(&trial);
    check_image(&trial);
    assert_true(verify > 0 || report.record.checks_passed == 0);
    assert_true(report.record.checks_failed > 0);
    assert_true(liar->refused && liar->doubted > 0);
    for (int i = 1; i < parties; i++) assert_int_equal(trial.actors[i].doubted, 0);
    end(&trial);
}

static void who_sends_impossible_sums_is_put_aside(void **state)
{
    (void)state;
    for (int i = 0; i < 4; i++) {
        int parties = 2 + i % 2;
        double verify = i < 2 ? 0 : 0.05;
        find_liar(parties, POISONS, POISON, verify);
        find_liar(parties, POISONS, -POISON, verify);
        find_liar(parties, POISONS, ALMOST, verify);
        find_liar(parties, POISONS, INT64_C(3) << 61, verify);
        find_liar(parties, CLAIMS, 0, verify);
    }
}

static void a_flipped_bit_is_rendered_again(void **state)
{
    (void)state;
    for (int parties = 1; parties <= 3; parties++) {
        trial_t trial;
        begin(&trial);
        actor_t *flips = add(&trial, "a", FLIPS, (int64_t)1 << 55);
        for (int i = 1; i < parties; i++) add(&trial, i == 1 ? "b" : "c", HONEST, 0);
        (void)run(&trial);
        check_image(&trial);
        assert_int_equal(flips->doubted, 1);
        if (parties == 1) assert_true(flips->checks == 1 && !flips->refused);
        end(&trial);
    }
}

/* An honest scene whose lights are not known to be so bright. */
static void what_two_agree_on_is_believed(void **state)
{
    (void)state;
    for (int parties = 1; parties <= 3; parties++) {
        trial_t trial;
        int doubted = 0;
        begin(&trial);
        for (int i = 0; i < parties; i++) add(&trial, (const char *[]){"a", "b", "c"}[i], POISONS, POISON);
        job_report_t report = run(&trial);
        assert_int_equal(report.record.state, JOB_FINISHING);
        assert_int_equal(report.record.account.counted, (uint64_t)32 * 32 * settings().spp);
        assert_int_equal(report.record.checks_failed, 0);
        for (int i = 0; i < parties; i++) doubted += trial.actors[i].doubted;
        assert_true(doubted > 0 && doubted <= parties); /* each may have had one under way */
        end(&trial);
    }
}

/* A job whose sums do overflow fails, when two say so or there is only one. */
static void an_honest_overflow_fails_the_job(void **state)
{
    (void)state;
    for (int parties = 1; parties <= 3; parties++)
        for (int claims = 0; claims < 2; claims++) {
            trial_t trial;
            begin(&trial);
            for (int i = 0; i < parties; i++)
                add(&trial, (const char *[]){"a", "b", "c"}[i], claims ? CLAIMS : POISONS, INT64_C(3) << 61);
            act(&trial, &trial.actors[0]);
            assert_int_equal(trial.actors[0].doubted, 1);
            assert_int_equal(state_of(&trial), JOB_RUNNING);
            job_report_t report = run(&trial);
            assert_int_equal(report.record.state, JOB_FAILED);
            assert_non_null(strstr(report.record.message, "--film-scale 24"));
            end(&trial);
        }
}

/* Another one is needed for the doubt to go, but not for the job to be ended. */
static void a_doubt_does_not_outlive_the_job(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial);
    actor_t *actor = add(&trial, "a", POISONS, POISON);
    act(&trial, actor);
    assert_int_equal(actor->doubted, 1);
    assert_int_equal(toy_order(trial.farm, trial.now, trial.job, ORDER_CANCEL).code, RESULT_OK);
    for (int i = 0; i < 30; i++, trial.now += 1) farm_tick(trial.farm, trial.now);
    assert_true(state_of(&trial) > JOB_RUNNING);
    job_report_t report = toy_report(trial.farm, trial.now, trial.job);
    assert_int_equal(report.record.account.counted, 0);
    assert_int_equal(report.record.account.out, 0);
    end(&trial);
}

/* Who is in the master's process has nothing to prove: its overflow fails the job at once. */
static void a_worker_in_the_process_is_believed(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial);
    worker_hello_t hello = {.name = "here", .key = "", .address = "", .threads = 1};
    uint64_t worker;
    const identity_t nobody = {{0}, 0};
    assert_int_equal(farm_hello(trial.farm, trial.now, &nobody, &hello, &worker).code, RESULT_OK);
    assert_int_equal(farm_worker_reached(trial.farm, trial.now, worker).code, RESULT_OK);
    toy_work_t work = toy_take(trial.farm, trial.now, worker, 1 << 11, 1 << 9);
    assert_int_equal(toy_deliver_work(trial.farm, trial.now, worker, &work, INT64_C(3) << 61).code,
                     RESULT_OK);
    assert_int_equal(state_of(&trial), JOB_FAILED);
    end(&trial);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(who_sends_impossible_sums_is_put_aside),
        cmocka_unit_test(a_flipped_bit_is_rendered_again),
        cmocka_unit_test(what_two_agree_on_is_believed),
        cmocka_unit_test(an_honest_overflow_fails_the_job),
        cmocka_unit_test(a_doubt_does_not_outlive_the_job),
        cmocka_unit_test(a_worker_in_the_process_is_believed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
