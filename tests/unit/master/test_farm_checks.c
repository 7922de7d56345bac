/* Tests of checks.c, evidence.c and spool.c: batches that are rendered twice, workers that are
 * found to send wrong sums, and what they sent taken out again, over restarts of the master too. */
#include "master/store/spool.h"
#include "tests/scratch.h"
#include "tests/toy_farm.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

typedef enum {
    HONEST,
    LIES,               /* always */
    LIES_UNSEEN,        /* but when it is asked for a comparison */
    LIES_IN_COMPARISON, /* and only there */
    LIES_SOMETIMES,     /* in one of ten batches */
    LIES_IN_A_UNIT,     /* the first of each batch */
    LIES_AT_ONCE        /* in one batch of all that it could get */
} honesty_t;

enum { MAX_ACTORS = 6 };

typedef struct {
    const char *name;
    honesty_t honesty;
    uint64_t worker; /* 0: not connected */
    bool refused;    /* its last hello was */
    bool relay;
    uint8_t fingerprint;
    toy_work_t work;
    int checks, lies; /* that it was asked for, and told */
} actor_t;

/* A master's life after the other, with the workers that come and go. */
typedef struct {
    farm_t *farm;
    char *folder;
    double now;
    uint64_t job;
    actor_t actors[MAX_ACTORS];
    int actor_count;
    toy_film_t films[2]; /* checkpoints: the latest, the one before */
    uint32_t random;
    uint64_t samples; /* that the actors ask for at a time */
} trial_t;

static uint32_t draw(trial_t *trial, uint32_t range)
{
    trial->random = trial->random * 747796405u + 2891336453u;
    return (uint32_t)(((uint64_t)(trial->random >> 4) * range) >> 28);
}

static void add_actor(trial_t *trial, const char *name, honesty_t honesty)
{
    assert_true(trial->actor_count < MAX_ACTORS);
    trial->actors[trial->actor_count++] = (actor_t){.name = name, .honesty = honesty};
}

static job_settings_t settings(void)
{
    job_settings_t settings = toy_settings();
    settings.spp = 128;
    return settings;
}

static void begin(trial_t *trial, double verify)
{
    *trial = (trial_t){.folder = scratch_new(), .now = 1, .random = 1, .samples = 1 << 11};
    trial->farm = toy_verifying_farm(trial->folder);
    job_settings_t wanted = settings();
    trial->job =
        toy_submit_on(trial->farm, trial->now, &wanted, &(job_terms_t){.name = "trial", .verify = verify});
}

static void end(trial_t *trial)
{
    farm_destroy(&trial->farm);
    toy_film_free(&trial->films[0]);
    toy_film_free(&trial->films[1]);
    scratch_destroy(&trial->folder);
}

static bool is_lie(trial_t *trial, const actor_t *actor)
{
    bool unseen = actor->work.check == 0;
    switch (actor->honesty) {
    case HONEST:
        return false;
    case LIES:
        return true;
    case LIES_UNSEEN:
        return unseen;
    case LIES_IN_COMPARISON:
        return !unseen;
    case LIES_SOMETIMES:
        return unseen && draw(trial, 10) == 0;
    case LIES_IN_A_UNIT:
        return unseen;
    case LIES_AT_ONCE:
        return unseen && actor->lies == 0;
    }
    return false;
}

static void join(trial_t *trial, actor_t *actor)
{
    worker_hello_t hello = {
        .name = actor->name, .threads = 1, .fingerprint = {{actor->fingerprint}}, .relay = actor->relay};
    result_t result = toy_say_hello(trial->farm, trial->now, hello, &actor->worker);
    actor->refused = result.code == RESULT_CANCELLED;
    if (result.code != RESULT_OK) actor->worker = 0;
    actor->work = (toy_work_t){0};
}

/* An actor delivers what it has and asks for more. */
static void act(trial_t *trial, actor_t *actor)
{
    if (actor->worker == 0) join(trial, actor);
    if (actor->worker == 0) return;
    if (actor->work.job != 0) {
        bool lie = is_lie(trial, actor);
        actor->work.one_wrong = actor->honesty == LIES_IN_A_UNIT;
        result_t sent = toy_deliver_work(trial->farm, trial->now, actor->worker, &actor->work,
                                         lie ? 1000 + actor->name[0] : 0);
        actor->lies += lie && sent.code == RESULT_OK;
    }
    actor->work = (toy_work_t){0};
    if (!toy_beat(trial->farm, trial->now, actor->worker)) {
        actor->worker = 0;
        return;
    }
    uint64_t samples = actor->honesty == LIES_AT_ONCE ? 1 << 15 : trial->samples;
    actor->work = toy_take(trial->farm, trial->now, actor->worker, samples, 1 << 9);
    actor->checks += actor->work.check != 0;
}

static void step(trial_t *trial)
{
    for (int i = 0; i < trial->actor_count; i++) act(trial, &trial->actors[i]);
    farm_tick(trial->farm, trial->now);
    farm_settle(trial->farm);
    farm_tick(trial->farm, trial->now);
    trial->now += 1;
}

static bool is_over(trial_t *trial)
{
    return toy_state(trial->farm, trial->now, trial->job) == JOB_FINISHING;
}

static job_report_t run(trial_t *trial)
{
    for (int i = 0; i < 2000 && !is_over(trial); i++) step(trial);
    return toy_report(trial->farm, trial->now, trial->job);
}

/* The sums that honest workers make. */
static hash_t honest_sums(void)
{
    static hash_t sums;
    static bool known;
    if (!known) {
        farm_t *farm = toy_farm(true);
        job_settings_t wanted = settings();
        uint64_t job = toy_submit(farm, 0, &wanted, 0);
        toy_work_off(farm, 0, toy_hello(farm, 0, 1), job);
        sums = toy_sums(farm, job);
        farm_destroy(&farm);
        known = true;
    }
    return sums;
}

/* The job is complete, with exactly the right sums, and every sample is accounted for. */
static void check_result(trial_t *trial)
{
    job_report_t report = toy_report(trial->farm, trial->now, trial->job);
    assert_int_equal(report.record.state, JOB_FINISHING);
    assert_int_equal(report.record.account.counted, (uint64_t)32 * 32 * settings().spp);
    assert_int_equal(report.record.account.issued,
                     report.record.account.counted + report.record.account.returned);
    hash_t right = honest_sums(), sums = toy_sums(trial->farm, trial->job);
    assert_true(hash_equal(&right, &sums));
}

static size_t spooled(const trial_t *trial)
{
    size_t count;
    free(spool_list(trial->folder, trial->job, &count));
    return count;
}

/* ---- comparisons --------------------------------------------------------------------------------------- */

static void honest_workers_pass(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    job_report_t report = run(&trial);
    check_result(&trial);
    assert_int_equal(report.record.checks_failed, 0);
    assert_true(report.record.checks_passed > 5);
    assert_string_equal(report.record.message, "");
    /* When the job is over, nothing is left on the disk. */
    toy_film_t film;
    toy_write_images(trial.farm, trial.now, result_ok());
    assert_true(toy_checkpoint(trial.farm, trial.now, result_ok(), &film));
    assert_int_equal(toy_state(trial.farm, trial.now, trial.job), JOB_DONE);
    farm_settle(trial.farm);
    assert_int_equal(scratch_count(trial.folder), 0);
    toy_film_free(&film);
    end(&trial);
}

/* Every batch is rendered twice when all are to be. */
static void everything_can_be_compared(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 1);
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    job_report_t report = run(&trial);
    check_result(&trial);
    assert_int_equal(report.record.checks_passed, report.record.batches);
    end(&trial);
}

static void run_with_a_liar(double verify, honesty_t honesty)
{
    trial_t trial;
    begin(&trial, verify);
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    add_actor(&trial, "liar", honesty);
    add_actor(&trial, "c", HONEST);
    job_report_t report = run(&trial);
    check_result(&trial);
    assert_true(report.record.checks_failed > 0);
    assert_true(report.record.checks_passed > 0);
    assert_true(trial.actors[2].refused);
    for (int i = 0; i < trial.actor_count; i++) assert_true(i == 2 || !trial.actors[i].refused);
    uint64_t worker;
    result_t refused = toy_say_hello(trial.farm, trial.now, (worker_hello_t){.name = "liar"}, &worker);
    assert_int_equal(refused.code, RESULT_CANCELLED);
    assert_non_null(strstr(refused.message, "sent other sums than two others"));
    end(&trial);
}

static void a_liar_is_found(void **state)
{
    (void)state;
    run_with_a_liar(0.3, LIES);
}

static void a_liar_cannot_tell_when_it_is_watched(void **state)
{
    (void)state;
    run_with_a_liar(0.3, LIES_UNSEEN);
}

static void who_lies_about_others_is_found(void **state)
{
    (void)state;
    run_with_a_liar(0.3, LIES_IN_COMPARISON);
}

/* Whoever lies everywhere in a batch is found, and one that lies in one of all that it sends is found before
 * the job is done: in all of a hundred farms. */
static void small_shares_find_liars(honesty_t honesty, int at_least)
{
    int lied = 0;
    for (uint32_t seed = 1; seed <= 100; seed++) {
        trial_t trial;
        begin(&trial, 0.05);
        trial.random = seed * 7919;
        add_actor(&trial, "a", HONEST);
        add_actor(&trial, "liar", honesty);
        add_actor(&trial, "b", HONEST);
        job_report_t report = run(&trial);
        check_result(&trial);
        const actor_t *liar = &trial.actors[1];
        assert_int_equal(report.record.checks_failed > 0, liar->lies > 0);
        assert_int_equal(liar->refused, liar->lies > 0);
        assert_false(trial.actors[0].refused || trial.actors[2].refused);
        lied += liar->lies > 0;
        end(&trial);
    }
    assert_true(lied >= at_least);
}

static void who_lies_now_and_then_is_found(void **state)
{
    (void)state;
    small_shares_find_liars(LIES_SOMETIMES, 60);
}

static void who_lies_once_is_found(void **state)
{
    (void)state;
    small_shares_find_liars(LIES_AT_ONCE, 100);
}

/* A batch that is wrong in one of 16 units is found when that is compared: a quarter of those of a new party
 * are. */
static void one_wrong_unit_is_found_by_chance(void **state)
{
    (void)state;
    int caught = 0, lies = 0;
    for (uint32_t seed = 1; seed <= 60; seed++) {
        trial_t trial;
        begin(&trial, 0.01);
        trial.samples = 1 << 13;
        add_actor(&trial, "liar", LIES_IN_A_UNIT);
        step(&trial);
        step(&trial); /* one batch, with a lie */
        trial.actors[0].honesty = HONEST;
        add_actor(&trial, "a", HONEST);
        add_actor(&trial, "b", HONEST);
        run(&trial);
        lies += trial.actors[0].lies;
        caught += trial.actors[0].refused;
        hash_t right = honest_sums(), sums = toy_sums(trial.farm, trial.job);
        assert_int_equal(hash_equal(&right, &sums), trial.actors[0].refused);
        end(&trial);
    }
    assert_int_equal(lies, 60);
    assert_true(caught >= 5 && caught <= 30); /* 15 are expected, +-3.4 */
}

/* Units of one batch that are asked for once more. */
static size_t compared_units(trial_t *trial)
{
    size_t most = 0;
    for (int i = 0; i < trial->actor_count; i++) {
        size_t units = trial->actors[i].work.check != 0 ? trial->actors[i].work.count : 0;
        most = units > most ? units : most;
    }
    return most;
}

static void trust_is_earned(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 1e-6);
    trial.samples = 1 << 13; /* 16 units, but the first batch is smaller */
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    size_t first = 0, last = 0;
    while (!is_over(&trial)) {
        step(&trial);
        size_t units = compared_units(&trial);
        if (first == 0) first = units;
        if (units > 0) last = units;
    }
    check_result(&trial);
    assert_true(first >= 2);
    assert_int_equal(last, 1);
    end(&trial);
}

static result_t take_out(trial_t *trial, uint64_t job, const char *who)
{
    job_order_t order = {.job = job, .kind = ORDER_TAKE_OUT};
    snprintf(order.who, sizeof order.who, "%s", who);
    return farm_order(trial->farm, trial->now, &order);
}

/* An operator knows better: all that somebody delivered goes out, by its address, its name or its key. */
static void somebody_is_taken_out(void **state)
{
    (void)state;
    static const char *const whos[] = {"liar", "liar:1", "address liar"};
    for (size_t w = 0; w < ARRAY_LENGTH(whos); w++) {
        trial_t trial;
        begin(&trial, 1e-6);
        add_actor(&trial, "liar:1", LIES);
        for (int i = 0; i < 6; i++) step(&trial);
        uint64_t before = toy_report(trial.farm, trial.now, trial.job).record.account.counted;
        assert_true(before > 0);
        assert_int_equal(take_out(&trial, trial.job, "nobody").code, RESULT_INPUT);
        assert_int_equal(take_out(&trial, 77, "liar").code, RESULT_INPUT);
        assert_int_equal(take_out(&trial, w == 0 ? 0 : trial.job, whos[w]).code, RESULT_OK);
        farm_settle(trial.farm);
        assert_int_equal(toy_report(trial.farm, trial.now, trial.job).record.account.counted, 0);
        trial.actors[0].honesty = HONEST;
        trial.actors[0].work = (toy_work_t){0};
        add_actor(&trial, "a", HONEST);
        job_report_t report = run(&trial);
        check_result(&trial);
        assert_int_equal(report.record.checks_failed, 0);
        assert_int_equal(take_out(&trial, trial.job, "a").code, RESULT_INPUT); /* it has ended */
        assert_int_equal(take_out(&trial, 0, "a").code, RESULT_INPUT);
        end(&trial);
    }
}

/* Takes and delivers all that there is; returns where its last sample ends. */
static uint32_t work_off(farm_t *farm, uint64_t worker)
{
    uint32_t end = 0;
    for (toy_work_t work; (work = toy_take(farm, 1, worker, 1 << 9, 1 << 9)).job != 0;) {
        for (size_t i = 0; i < work.count; i++)
            if (work.units[i].first + work.units[i].count > end)
                end = work.units[i].first + work.units[i].count;
        assert_int_equal(toy_deliver_work(farm, 1, worker, &work, 0).code, RESULT_OK);
    }
    return end;
}

/* Nothing is learned from what is known to be wrong, not even until it is out. */
static void a_plan_waits_for_what_goes_out(void **state)
{
    (void)state;
    trial_t trial = {.folder = scratch_new(), .now = 1};
    farm_t *farm = trial.farm = toy_verifying_farm(trial.folder);
    job_settings_t wanted = settings();
    wanted.learn = true;
    trial.job = toy_submit_on(farm, 1, &wanted, &(job_terms_t){.name = "trial", .verify = 1e-6});
    uint64_t liar = toy_join(farm, 1, "liar", 1, 0), honest = toy_join(farm, 1, "honest", 1, 0);
    toy_work_t lie = toy_take(farm, 1, liar, 1 << 9, 1 << 9);
    assert_int_equal(toy_deliver_work(farm, 1, liar, &lie, 77).code, RESULT_OK);
    assert_int_equal(take_out(&trial, trial.job, "liar").code, RESULT_OK);
    assert_int_equal(work_off(farm, honest), learning_pass_begin(&wanted, 2)); /* which waits for a plan */
    farm_settle(farm);
    assert_int_equal(work_off(farm, honest), wanted.spp);
    end(&trial);
}

static void a_job_without_evidence_says_so(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0);
    add_actor(&trial, "a", HONEST);
    for (int i = 0; i < 3; i++) step(&trial);
    result_t result = take_out(&trial, trial.job, "a");
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "--verify"));
    end(&trial);
}

/* All that was merged can be taken out until the job is over. */
static void everything_is_kept(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.1);
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    job_report_t report = run(&trial);
    assert_int_equal(spooled(&trial), report.record.batches);
    end(&trial);
}

/* What does not fit into the quota stays in the image, is said, and is compared all the same. */
static void the_evidence_has_a_quota(void **state)
{
    (void)state;
    enum { QUOTA = 200000 };
    trial_t trial;
    begin(&trial, 0.1);
    farm_destroy(&trial.farm);
    trial.farm = toy_quota_farm(trial.folder, QUOTA);
    job_settings_t wanted = settings();
    trial.job = toy_submit_on(trial.farm, trial.now, &wanted, &(job_terms_t){.name = "trial", .verify = 0.1});
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    add_actor(&trial, "late liar", HONEST);
    for (int i = 0; !is_over(&trial); i++) {
        if (i == 12) trial.actors[2].honesty = LIES;
        step(&trial);
        size_t count;
        uint64_t bytes = 0;
        spool_name_t *names = spool_list(trial.folder, trial.job, &count);
        for (size_t n = 0; n < count; n++) bytes += names[n].bytes;
        free(names);
        assert_true(bytes <= QUOTA);
        assert_true(i < 12 || bytes > QUOTA / 2);
    }
    job_report_t report = toy_report(trial.farm, trial.now, trial.job);
    assert_true(trial.actors[2].refused);
    assert_non_null(strstr(report.record.message, "cannot be taken out again"));
    assert_non_null(strstr(report.record.message, "are in the image"));
    end(&trial);
}

/* A party has one voice: its processes do not outvote another. */
static void a_party_has_one_voice(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "honest:1", HONEST);
    add_actor(&trial, "liar:1", LIES);
    add_actor(&trial, "liar:2", LIES);
    add_actor(&trial, "liar:3", LIES);
    for (int i = 0; i < 300; i++) step(&trial);
    job_report_t report = toy_report(trial.farm, trial.now, trial.job);
    assert_int_equal(report.record.state, JOB_RUNNING);
    assert_non_null(strstr(report.record.message, "disagree"));
    add_actor(&trial, "third:1", HONEST);
    run(&trial);
    check_result(&trial);
    for (int i = 0; i < trial.actor_count; i++)
        assert_int_equal(trial.actors[i].refused, strncmp(trial.actors[i].name, "liar", 4) == 0);
    end(&trial);
}

/* Where a party is alone, and one of its processes errs, the others go on. */
static void a_process_of_a_party_is_put_aside_alone(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "farm:1", HONEST);
    add_actor(&trial, "farm:2", HONEST);
    add_actor(&trial, "farm:3", LIES);
    run(&trial);
    check_result(&trial);
    assert_true(trial.actors[2].refused);
    assert_false(trial.actors[0].refused || trial.actors[1].refused);
    end(&trial);
}

static void a_single_worker_holds_nothing_up(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "other bits", HONEST);
    trial.actors[0].fingerprint = 1;
    trial.actors[1].fingerprint = 2;
    for (int i = 0; i < 10; i++) step(&trial); /* so that one of its batches must be compared */
    assert_non_null(
        strstr(toy_report(trial.farm, trial.now, trial.job).record.message, "cannot be compared"));
    run(&trial);
    check_result(&trial);
    assert_non_null(
        strstr(toy_report(trial.farm, trial.now, trial.job).record.message, "batches could not be compared"));
    assert_int_equal(trial.actors[1].checks, 0);
    end(&trial);
}

/* The only other worker hangs, though its heart beats: nobody waits for it for ever. */
static void who_hangs_is_not_waited_for(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "a", HONEST);
    uint64_t hangs = toy_join(trial.farm, trial.now, "hangs", 1, 0);
    for (int i = 0; i < 2000 && !is_over(&trial); i++) {
        assert_true(toy_beat(trial.farm, trial.now, hangs));
        step(&trial);
    }
    check_result(&trial);
    assert_true(trial.now > 1000); /* it might load a scene */
    end(&trial);
}

/* The only other worker seems to be very slow, and keeps what it was to compare: it has no longer than a
 * quick one would need. */
static void who_seems_slow_keeps_no_comparison_for_long(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 1);
    uint64_t slow = toy_join(trial.farm, trial.now, "slow", 1, 0);
    toy_work_t work = toy_take(trial.farm, trial.now, slow, 1 << 9, 1 << 9);
    for (int i = 0; i < 1000; i++, trial.now += 1) {
        assert_true(toy_beat(trial.farm, trial.now, slow));
        farm_tick(trial.farm, trial.now);
    }
    assert_int_equal(toy_deliver_work(trial.farm, trial.now, slow, &work, 0).code, RESULT_OK);
    add_actor(&trial, "a", HONEST);
    for (work.check = 0; work.check == 0 && trial.now < 1100;) {
        step(&trial);
        work = toy_take(trial.farm, trial.now, slow, 1, 1 << 9);
    }
    assert_int_not_equal(work.check, 0);
    double begun = trial.now;
    for (int i = 0; i < 4000 && !is_over(&trial); i++) {
        assert_true(toy_beat(trial.farm, trial.now, slow));
        step(&trial);
    }
    check_result(&trial);
    assert_true(trial.now - begun < 2000);
    end(&trial);
}

/* A batch with wrong sums is being compared when a right one of the same worker, a later one, passes. */
static void a_later_pass_does_not_vouch_for_a_lie(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 1);
    add_actor(&trial, "errs", LIES);
    step(&trial);
    step(&trial); /* its lie is in the film */
    trial.actors[0].honesty = HONEST;
    add_actor(&trial, "b", HONEST);
    for (int i = 0; i < 40; i++) step(&trial); /* with nobody to decide who is wrong about the first */
    job_report_t report = toy_report(trial.farm, trial.now, trial.job);
    assert_true(report.record.checks_passed > 0 && report.record.checks_failed == 0);
    add_actor(&trial, "c", HONEST);
    report = run(&trial);
    assert_int_equal(report.record.checks_failed, 1);
    check_result(&trial);
    end(&trial);
}

/* A batch that claims to be a comparison is refused for it before anything of it is unfolded. */
static void what_nobody_asked_for_is_not_decoded(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 1);
    add_actor(&trial, "a", HONEST);
    step(&trial);
    batch_t batch;
    unit_t unit = {0, 0, 2};
    zmq_msg_t payload[BATCH_PAYLOADS];
    job_settings_t wanted = settings();
    batch_init(&batch, &wanted);
    batch.units = &unit;
    batch.unit_count = 1;
    for (int half = 0; half < 2 && job_has_splats(&wanted); half++)
        batch.counts.light_paths[half] = job_tile_pixels(&wanted, 0);
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        assert_int_equal(zmq_msg_init_size(&payload[i], 100), 0);
        memset(zmq_msg_data(&payload[i]), 0x55, 100); /* which cannot be decoded */
    }
    farm_batch_t open;
    issue_t issue;
    toy_issue(trial.farm, trial.actors[0].worker, trial.job, 77, &unit, 1, &issue);
    batch_head_t head = {.worker = trial.actors[0].worker,
                         .job = trial.job,
                         .check = 77,
                         .units = &unit,
                         .issues = &issue,
                         .unit_count = 1,
                         .bytes = 100};
    assert_int_equal(farm_batch_begin(trial.farm, trial.now, &head, &open).code, RESULT_OK);
    assert_int_equal(farm_batch_commit(trial.farm, trial.now, &open, &batch, payload).code, RESULT_MISMATCH);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    run(&trial);
    check_result(&trial);
    end(&trial);
}

/* A worker that was right may be wrong later: a comparison vouches for what came before. */
static void a_pass_says_nothing_of_what_comes_later(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "a", HONEST);
    for (int i = 0; i < 10; i++) step(&trial);
    trial.actors[0].honesty = LIES;
    for (int i = 0; i < 3; i++) step(&trial);
    add_actor(&trial, "b", HONEST);
    add_actor(&trial, "c", HONEST);
    job_report_t report = run(&trial);
    check_result(&trial);
    assert_true(report.record.checks_passed > 0 && report.record.checks_failed > 0);
    end(&trial);
}

/* Two workers disagree, and there is no third: the job waits for one. */
static void a_third_worker_decides(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "honest", HONEST);
    add_actor(&trial, "liar", LIES);
    for (int i = 0; i < 300; i++) step(&trial);
    job_report_t report = toy_report(trial.farm, trial.now, trial.job);
    assert_int_equal(report.record.state, JOB_RUNNING);
    assert_non_null(strstr(report.record.message, "disagree"));
    assert_int_equal(report.record.checks_failed, 0);
    add_actor(&trial, "third", HONEST);
    run(&trial);
    check_result(&trial);
    assert_true(trial.actors[1].refused);
    assert_false(trial.actors[0].refused);
    end(&trial);
}

/* A worker that dies with a comparison does not keep it. */
static void a_lost_comparison_is_made_by_another(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    int lost = 0;
    for (int i = 0; i < 2000 && !is_over(&trial); i++) {
        step(&trial);
        for (int j = 0; j < trial.actor_count; j++) {
            actor_t *actor = &trial.actors[j];
            if (actor->work.check == 0 || actor->worker == 0 || draw(&trial, 2) == 0) continue;
            farm_goodbye(trial.farm, trial.now, actor->worker, 0, "killed");
            actor->worker = 0;
            lost++;
        }
    }
    check_result(&trial);
    assert_true(lost > 0);
    end(&trial);
}

/* Batches of a relay are compared as others are. */
static void a_relay_is_watched_too(void **state)
{
    (void)state;
    for (int lies = 0; lies < 2; lies++) {
        trial_t trial;
        begin(&trial, 0.2);
        add_actor(&trial, "a", HONEST);
        add_actor(&trial, "relay", lies ? LIES : HONEST);
        add_actor(&trial, "b", HONEST);
        trial.actors[1].relay = true;
        job_report_t report = run(&trial);
        check_result(&trial);
        assert_int_equal(trial.actors[1].refused, lies);
        assert_int_equal(report.record.checks_failed > 0, lies);
        end(&trial);
    }
}

/* A liar that has rendered all of a job has its other keys take the comparisons, and leave. Others are there,
 * and make them all the same. */
static void nobody_spoils_comparisons(void **state)
{
    (void)state;
    static const char *const spoilers[] = {"x", "y", "z"};
    trial_t trial;
    begin(&trial, 0.05);
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    join(&trial, &trial.actors[0]);
    join(&trial, &trial.actors[1]);
    int batches = 0, spoilt = 0;
    uint64_t liar = toy_join(trial.farm, trial.now, "liar", 1, 0);
    for (toy_work_t work; (work = toy_take(trial.farm, trial.now, liar, 1 << 17, 1 << 11)).job != 0;
         batches++)
        assert_int_equal(toy_deliver_work(trial.farm, trial.now, liar, &work, 1000).code, RESULT_OK);
    for (size_t i = 0; i < ARRAY_LENGTH(spoilers); i++) {
        uint64_t spoiler = toy_join(trial.farm, trial.now, spoilers[i], 1, 0);
        while (toy_take(trial.farm, trial.now, spoiler, 1 << 17, 1 << 11).job != 0) spoilt++;
        farm_goodbye(trial.farm, trial.now, spoiler, 0, "");
    }
    assert_int_equal(spoilt, 3 * batches);
    farm_tick(trial.farm, trial.now);
    assert_int_equal(toy_state(trial.farm, trial.now, trial.job), JOB_RUNNING);
    job_report_t report = run(&trial);
    check_result(&trial);
    assert_true(report.record.checks_failed > 0);
    end(&trial);
}

/* If no two workers make the same bits, it is not the workers. */
static void a_job_that_cannot_be_verified_says_so(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    static const char *const names[] = {"a", "b", "c", "d", "e"};
    for (int i = 0; i < 5; i++) add_actor(&trial, names[i], LIES); /* each by another amount */
    job_report_t report = run(&trial);
    assert_int_equal(report.record.state, JOB_FINISHING);
    assert_non_null(strstr(report.record.message, "could not be verified"));
    for (int i = 0; i < 5; i++) assert_false(trial.actors[i].refused);
    end(&trial);
}

/* Without a disk there is no verification; the message says so. */
static void without_a_disk_nothing_is_verified(void **state)
{
    (void)state;
    farm_t *farm = toy_farm(true);
    job_settings_t wanted = settings();
    uint64_t job = toy_submit_on(farm, 0, &wanted, &(job_terms_t){.name = "x", .verify = 0.5});
    uint64_t worker = toy_hello(farm, 0, 1);
    toy_work_t work = toy_take(farm, 0, worker, 1 << 11, 1 << 9);
    farm_tick(farm, 2);
    assert_int_equal(toy_deliver_work(farm, 3, worker, &work, 0).code, RESULT_OK);
    assert_non_null(strstr(toy_report(farm, 3, job).record.message, "not verified"));
    toy_work_off(farm, 3, worker, job);
    assert_int_equal(toy_state(farm, 3, job), JOB_FINISHING);
    farm_destroy(&farm);
}

/* ---- restarts ------------------------------------------------------------------------------------------ */

static void checkpoint(trial_t *trial)
{
    toy_film_t film;
    if (!toy_checkpoint(trial->farm, trial->now, result_ok(), &film)) return;
    toy_film_free(&trial->films[1]);
    trial->films[1] = trial->films[0];
    trial->films[0] = film;
}

/* The master is killed, and comes back with its last checkpoint or, if that is damaged, with the one before.
 */
static void restart(trial_t *trial, bool damaged)
{
    job_record_t record = {.job = 0};
    for (job_record_t next; farm_next_record(trial->farm, trial->now, &next);)
        if (next.job == trial->job) record = next;
    if (record.job == 0) { /* it has not changed since */
        job_t *job = farm_pin(trial->farm, trial->job);
        record = farm_record(trial->farm, trial->now, job);
        farm_unpin(trial->farm, job);
    }
    farm_destroy(&trial->farm);
    trial->farm = toy_verifying_farm(trial->folder);
    farm_restore(trial->farm, trial->now, &record);
    if (damaged) {
        toy_film_free(&trial->films[0]);
        trial->films[0] = trial->films[1];
        trial->films[1] = (toy_film_t){0};
    }
    toy_film_t copy = trial->films[0]; /* the farm takes it */
    if (copy.job != 0) {
        const job_settings_t *wanted = &trial->films[0].film->settings;
        assert_int_equal(film_new(wanted, &copy.film).code, RESULT_OK);
        for (size_t i = 0; i < shared_film_page_count(wanted); i++) {
            size_t size;
            void *to = shared_film_page(copy.film, i, &size);
            memcpy(to, shared_film_page(trial->films[0].film, i, &size), size);
        }
        copy.film->counts = trial->films[0].film->counts;
        schedule_t *schedule;
        job_settings_t restored = *wanted;
        assert_int_equal(schedule_restore(&restored, &trial->films[0].state, &schedule).code, RESULT_OK);
        schedule_destroy(&schedule);
        const schedule_state_t *state = &trial->films[0].state;
        size_t values = (size_t)state->round_count * state->tile_count;
#define COPY(field, count)                                                                                   \
    copy.state.field = mem_alloc(((count) + 1) * sizeof *copy.state.field);                                  \
    memcpy(copy.state.field, state->field, (count) * sizeof *copy.state.field)
        COPY(ends, values);
        COPY(weights, values);
        COPY(counted, state->counted_count);
        COPY(skipped, state->skipped_count);
    }
    toy_load(trial->farm, trial->now, copy.job != 0 ? &copy : NULL);
    for (int i = 0; i < trial->actor_count; i++) trial->actors[i].worker = 0;
}

/* The lies of the first life are found out in the second. */
static void evidence_outlives_the_master(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.3);
    add_actor(&trial, "liar", LIES);
    for (int i = 0; i < 9; i++) step(&trial); /* so that one of its batches must be compared */
    assert_int_equal(farm_sync(trial.farm).code, RESULT_OK);
    checkpoint(&trial);
    size_t kept = spooled(&trial);
    assert_true(kept > 3);
    step(&trial);
    step(&trial);
    assert_true(spooled(&trial) > kept);
    restart(&trial, false);
    assert_int_equal(spooled(&trial), kept); /* what came after the checkpoint is not in the film */
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    run(&trial);
    assert_true(trial.actors[0].refused);
    check_result(&trial);
    end(&trial);
}

/* A batch that the film does not have, whatever its name says, must not be taken out of it some day. */
static void what_the_film_lacks_is_no_evidence(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.01);
    add_actor(&trial, "a", HONEST);
    for (int i = 0; i < 5; i++) step(&trial);
    checkpoint(&trial);
    size_t count, kept = spooled(&trial);
    step(&trial);
    spool_name_t *names = spool_list(trial.folder, trial.job, &count), early = names[count - 1];
    assert_int_equal(count, kept + 1);
    early.clock = names[0].clock;
    assert_int_equal(spool_rename(trial.folder, trial.job, &names[count - 1], &early).code, RESULT_OK);
    free(names);
    restart(&trial, false);
    assert_int_equal(spooled(&trial), kept);
    run(&trial);
    check_result(&trial);
    end(&trial);
}

/* A master that has nothing but lies in its film, knows it, and is killed before it has taken them out. */
static void begin_with_lies(trial_t *trial)
{
    begin(trial, 0.01);
    add_actor(trial, "liar", LIES);
    for (int i = 0; i < 5; i++) step(trial);
    checkpoint(trial);
    size_t count;
    spool_name_t *names = spool_list(trial->folder, trial->job, &count);
    assert_true(count > 3);
    for (size_t i = 0; i < count; i++) {
        spool_name_t wrong = names[i];
        wrong.kind = SPOOL_WRONG;
        assert_int_equal(spool_rename(trial->folder, trial->job, &names[i], &wrong).code, RESULT_OK);
    }
    free(names);
    restart(trial, false);
}

static void what_is_wrong_stays_wrong(void **state)
{
    (void)state;
    trial_t trial;
    begin_with_lies(&trial);
    trial.actors[0] = (actor_t){.name = "a", .honesty = HONEST};
    run(&trial);
    check_result(&trial);
    end(&trial);
}

/* A job that is cut short has no image before what is known to be wrong is out of its film. */
static void no_lie_is_shown_at_the_end(void **state)
{
    (void)state;
    trial_t trial;
    begin_with_lies(&trial);
    assert_int_equal(toy_order(trial.farm, trial.now, trial.job, ORDER_CANCEL).code, RESULT_OK);
    assert_true(is_over(&trial));
    assert_true(toy_report(trial.farm, trial.now, trial.job).record.account.counted > 0);
    assert_int_equal(toy_write_images(trial.farm, trial.now, result_ok()), 0);
    farm_settle(trial.farm);
    assert_int_equal(toy_report(trial.farm, trial.now, trial.job).record.account.counted, 0);
    assert_int_equal(toy_write_images(trial.farm, trial.now, result_ok()), 1);
    end(&trial);
}

/* A sender that is found out when a job has all its samples takes none from it: nobody would render them. */
static void a_complete_job_stays_complete(void **state)
{
    (void)state;
    trial_t trial;
    begin(&trial, 0.01);
    add_actor(&trial, "liar", LIES);
    run(&trial);
    uint64_t first = trial.job;
    job_settings_t wanted = settings();
    trial.job = toy_submit_on(trial.farm, trial.now, &wanted, &(job_terms_t){.name = "second", .verify = 1});
    add_actor(&trial, "a", HONEST);
    add_actor(&trial, "b", HONEST);
    run(&trial);
    check_result(&trial);
    assert_true(trial.actors[0].refused);
    job_report_t report = toy_report(trial.farm, trial.now, first);
    assert_int_equal(report.record.state, JOB_FINISHING);
    assert_int_equal(report.record.account.counted, (uint64_t)32 * 32 * settings().spp);
    assert_non_null(strstr(report.record.message, "wrong sums"));
    end(&trial);
}

/* A liar is found and its sums are taken out; then the master falls back to a checkpoint that has them. */
static void what_was_taken_out_stays_out(void **state)
{
    (void)state;
    for (int damaged = 0; damaged < 2; damaged++) {
        trial_t trial;
        begin(&trial, 0.3);
        add_actor(&trial, "liar", LIES_UNSEEN);
        for (int i = 0; i < 4; i++) step(&trial);
        checkpoint(&trial); /* lies and nothing else */
        add_actor(&trial, "a", HONEST);
        add_actor(&trial, "b", HONEST);
        while (!trial.actors[0].refused) step(&trial);
        step(&trial);
        if (damaged) checkpoint(&trial);
        for (int i = 0; i < 4; i++) step(&trial);
        restart(&trial, damaged);
        trial.actors[0] = trial.actors[--trial.actor_count]; /* it does not come back */
        farm_settle(trial.farm);
        run(&trial);
        check_result(&trial);
        end(&trial);
    }
}

/* Anything may happen at any time; in the end the sums are right, if the liar was found. */
static void random_lives(void **state)
{
    (void)state;
    int restarts = 0, fallbacks = 0, found = 0, missed = 0;
    for (uint32_t seed = 1; seed <= 60; seed++) {
        trial_t trial;
        begin(&trial, 0.25);
        trial.random = seed * 7919;
        add_actor(&trial, "a", HONEST);
        add_actor(&trial, "liar", seed % 2 ? LIES : LIES_UNSEEN);
        add_actor(&trial, "b", HONEST);
        bool caught = false;
        for (int i = 0; i < 3000 && !is_over(&trial); i++) {
            step(&trial);
            caught = caught || trial.actors[1].refused;
            uint32_t event = draw(&trial, 24);
            actor_t *actor = &trial.actors[draw(&trial, 3)];
            if (event < 4) checkpoint(&trial);
            if (event == 4 && actor->worker != 0) {
                farm_goodbye(trial.farm, trial.now, actor->worker, 0, "killed");
                actor->worker = 0;
            }
            if (event == 5) actor->worker = 0; /* it hangs, and is given up */
            if (event != 6 && event != 7) continue;
            restarts++;
            fallbacks += event == 7 && trial.films[1].job != 0;
            restart(&trial, event == 7 && trial.films[1].job != 0);
        }
        job_report_t report = toy_report(trial.farm, trial.now, trial.job);
        assert_int_equal(report.record.state, JOB_FINISHING);
        assert_int_equal(report.record.account.issued,
                         report.record.account.counted + report.record.account.returned);
        hash_t right = honest_sums(), sums = toy_sums(trial.farm, trial.job);
        found += hash_equal(&right, &sums);
        missed += !hash_equal(&right, &sums);
        if (!hash_equal(&right, &sums)) assert_false(trial.actors[1].refused);
        end(&trial);
    }
    print_message("%d restarts, %d of them to an older checkpoint; liars found %d times, missed %d times\n",
                  restarts, fallbacks, found, missed);
    assert_true(restarts > 60 && fallbacks > 10);
    assert_int_equal(missed, 0);
}

/* ---- the spool ----------------------------------------------------------------------------------------- */

static void make_entry(spool_head_t *head, zmq_msg_t payload[BATCH_PAYLOADS])
{
    static unit_t units[2] = {{0, 0, 4}, {3, 4, 2}};
    *head = (spool_head_t){.name = "host:1",
                           .party = "key KEY",
                           .fingerprint = {{7}},
                           .counts = {.light_paths = {1, 2}, .rays = 5},
                           .units = units,
                           .unit_count = 2};
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        zmq_msg_init_size(&payload[i], (size_t)(10 * i));
        memset(zmq_msg_data(&payload[i]), 'a' + i, (size_t)(10 * i));
    }
}

static void batches_come_back_from_the_spool(void **state)
{
    (void)state;
    char *folder = scratch_new();
    job_settings_t wanted = settings();
    spool_head_t head, back;
    zmq_msg_t payload[BATCH_PAYLOADS], read[BATCH_PAYLOADS];
    spool_name_t name = {.clock = 77, .serial = 3, .kind = SPOOL_CHECK};
    spool_name_t out = {.clock = 77, .serial = 3, .out_clock = 99, .kind = SPOOL_OUT};
    make_entry(&head, payload);
    assert_int_equal(spool_write(folder, 5, &name, &head, payload).code, RESULT_OK);
    assert_int_equal(spool_write(folder, 5, &name, &head, payload).code, RESULT_IO); /* it is there */
    assert_int_equal(spool_rename(folder, 5, &name, &out).code, RESULT_OK);
    size_t count;
    spool_name_t *names = spool_list(folder, 5, &count);
    assert_int_equal(count, 1);
    assert_int_equal(names[0].clock, out.clock);
    assert_int_equal(names[0].serial, out.serial);
    assert_int_equal(names[0].out_clock, out.out_clock);
    assert_int_equal(names[0].kind, out.kind);
    free(names);
    assert_int_equal(spool_read(folder, 5, &out, &wanted, &back, read).code, RESULT_OK);
    assert_string_equal(back.name, "host:1");
    assert_string_equal(back.party, "key KEY");
    assert_int_equal(back.counts.rays, 5);
    assert_int_equal(back.unit_count, 2);
    assert_memory_equal(back.units, head.units, 2 * sizeof(unit_t));
    for (int i = 0; i < BATCH_PAYLOADS; i++) {
        assert_int_equal(zmq_msg_size(&read[i]), zmq_msg_size(&payload[i]));
        assert_memory_equal(zmq_msg_data(&read[i]), zmq_msg_data(&payload[i]), zmq_msg_size(&read[i]));
        zmq_msg_close(&read[i]);
        zmq_msg_close(&payload[i]);
    }
    spool_head_free(&back);
    uint64_t *jobs = spool_jobs(folder, &count);
    assert_int_equal(count, 1);
    assert_int_equal(jobs[0], 5);
    free(jobs);
    assert_int_equal(spool_sync(folder).code, RESULT_OK);
    spool_delete_job(folder, 5);
    free(spool_jobs(folder, &count));
    assert_int_equal(count, 0);
    scratch_destroy(&folder);
}

/* Whatever byte is changed, wherever a file is cut: it is noticed. */
static void damage_is_noticed(void **state)
{
    (void)state;
    char *folder = scratch_new();
    job_settings_t wanted = settings();
    spool_head_t head, back;
    zmq_msg_t payload[BATCH_PAYLOADS], read[BATCH_PAYLOADS];
    spool_name_t name = {.clock = 1, .serial = 1};
    make_entry(&head, payload);
    assert_int_equal(spool_write(folder, 5, &name, &head, payload).code, RESULT_OK);
    for (int i = 0; i < BATCH_PAYLOADS; i++) zmq_msg_close(&payload[i]);
    char *inner = scratch_path(folder, "job-5/0000000000000001-0000000000000001.kept");
    size_t size;
    uint8_t *bytes = scratch_read(inner, &size);
    for (size_t i = 0; i < size; i++) {
        bytes[i] ^= 0x10;
        scratch_write(inner, bytes, size);
        assert_int_equal(spool_read(folder, 5, &name, &wanted, &back, read).code, RESULT_INPUT);
        bytes[i] ^= 0x10;
        scratch_write(inner, bytes, i);
        assert_int_equal(spool_read(folder, 5, &name, &wanted, &back, read).code, RESULT_INPUT);
    }
    scratch_write(inner, bytes, size);
    assert_int_equal(spool_read_head(folder, 5, &name, &wanted, &back).code, RESULT_OK);
    spool_head_free(&back);
    wanted.width = wanted.height = 16; /* another job's units */
    assert_int_equal(spool_read_head(folder, 5, &name, &wanted, &back).code, RESULT_INPUT);
    free(bytes);
    free(inner);
    scratch_destroy(&folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(honest_workers_pass),
        cmocka_unit_test(everything_can_be_compared),
        cmocka_unit_test(a_liar_is_found),
        cmocka_unit_test(a_liar_cannot_tell_when_it_is_watched),
        cmocka_unit_test(who_lies_about_others_is_found),
        cmocka_unit_test(who_lies_now_and_then_is_found),
        cmocka_unit_test(who_lies_once_is_found),
        cmocka_unit_test(one_wrong_unit_is_found_by_chance),
        cmocka_unit_test(trust_is_earned),
        cmocka_unit_test(somebody_is_taken_out),
        cmocka_unit_test(a_plan_waits_for_what_goes_out),
        cmocka_unit_test(a_job_without_evidence_says_so),
        cmocka_unit_test(everything_is_kept),
        cmocka_unit_test(the_evidence_has_a_quota),
        cmocka_unit_test(a_party_has_one_voice),
        cmocka_unit_test(a_process_of_a_party_is_put_aside_alone),
        cmocka_unit_test(a_single_worker_holds_nothing_up),
        cmocka_unit_test(who_hangs_is_not_waited_for),
        cmocka_unit_test(who_seems_slow_keeps_no_comparison_for_long),
        cmocka_unit_test(a_later_pass_does_not_vouch_for_a_lie),
        cmocka_unit_test(what_nobody_asked_for_is_not_decoded),
        cmocka_unit_test(a_pass_says_nothing_of_what_comes_later),
        cmocka_unit_test(a_third_worker_decides),
        cmocka_unit_test(a_lost_comparison_is_made_by_another),
        cmocka_unit_test(nobody_spoils_comparisons),
        cmocka_unit_test(a_relay_is_watched_too),
        cmocka_unit_test(a_job_that_cannot_be_verified_says_so),
        cmocka_unit_test(without_a_disk_nothing_is_verified),
        cmocka_unit_test(evidence_outlives_the_master),
        cmocka_unit_test(what_the_film_lacks_is_no_evidence),
        cmocka_unit_test(what_is_wrong_stays_wrong),
        cmocka_unit_test(no_lie_is_shown_at_the_end),
        cmocka_unit_test(a_complete_job_stays_complete),
        cmocka_unit_test(what_was_taken_out_stays_out),
        cmocka_unit_test(random_lives),
        cmocka_unit_test(batches_come_back_from_the_spool),
        cmocka_unit_test(damage_is_noticed),
    };
    return cmocka_run_group_tests_name("farm checks", tests, NULL, NULL);
}
