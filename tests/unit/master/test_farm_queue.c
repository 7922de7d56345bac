/* Tests of the queue: orders of clients, shares and priorities, jobs that outlive the process. Without
 * sockets, in a time of its own (tests/toy_farm.h). */
#include "master/threads/control_reports.h"
#include "tests/toy_farm.h"

#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
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

static job_settings_t settings_of(uint32_t spp)
{
    job_settings_t settings = toy_settings();
    settings.spp = spp;
    return settings;
}

static uint64_t submit(farm_t *farm, double now, uint32_t spp)
{
    job_settings_t settings = settings_of(spp);
    return toy_submit(farm, now, &settings, 0);
}

static const result_t ok = {0};

/* ---- shares and priorities ----------------------------------------------------------------------------- */

enum { MAX_WORKERS = 16, MAX_SIMULATED = 8 };

/* Workers that take a second's work at a time and deliver it a second later. */
typedef struct {
    farm_t *farm;
    double now;
    int workers;
    uint64_t worker[MAX_WORKERS];
    uint32_t threads[MAX_WORKERS];
    toy_work_t work[MAX_WORKERS];
    uint64_t loaded[MAX_WORKERS];
    int switches;
    double served[MAX_SIMULATED]; /* thread-seconds, by the job's number */
} simulation_t;

static simulation_t simulate(farm_t *farm, int workers, const uint32_t *threads)
{
    simulation_t s = {.farm = farm, .workers = workers};
    for (int w = 0; w < workers; w++) {
        s.threads[w] = threads[w];
        s.worker[w] = toy_hello(farm, 0, threads[w]);
    }
    return s;
}

static void run(simulation_t *s, double seconds)
{
    for (double end = s->now + seconds; s->now < end; s->now += 0.25) {
        farm_tick(s->farm, s->now);
        for (int w = 0; w < s->workers; w++) {
            if ((int)(4 * s->now + w) % 4 != 0) continue; /* each at its own time */
            toy_work_t *work = &s->work[w];
            if (work->job != 0) {
                s->served[work->job] += s->threads[w];
                toy_deliver(s->farm, s->now, s->worker[w], work->job, work->units, work->count);
            }
            *work = toy_take(s->farm, s->now, s->worker[w], 256 * s->threads[w], 256);
            if (work->job == 0) continue;
            s->switches += s->loaded[w] != 0 && s->loaded[w] != work->job;
            s->loaded[w] = work->job;
        }
    }
}

static void assert_even(double a, double b)
{
    if (a < 0.9 * b || b < 0.9 * a) fail_msg("%g and %g thread-seconds", a, b);
}

static void jobs_of_one_priority_share_evenly(void **state)
{
    static const struct {
        int workers;
        uint32_t threads[MAX_WORKERS];
        int switches; /* at most, in 1000 seconds */
    } farms[] = {{1, {1}, 40},       {1, {4}, 40},          {2, {2, 2}, 1},
                 {3, {1, 1, 1}, 20}, {4, {8, 1, 1, 2}, 40}, {10, {1, 1, 1, 1, 1, 1, 1, 1, 1, 1}, 5}};
    (void)state;
    for (size_t i = 0; i < ARRAY_LENGTH(farms); i++) {
        farm_t *farm = toy_farm(true);
        uint64_t a = submit(farm, 0, 1 << 20), b = submit(farm, 0, 1 << 20);
        simulation_t s = simulate(farm, farms[i].workers, farms[i].threads);
        run(&s, 1000);
        assert_even(s.served[a], s.served[b]);
        if (s.switches > farms[i].switches) fail_msg("farm %zu: %d switches of scenes", i, s.switches);
        farm_destroy(&farm);
    }
}

static void who_comes_later_is_owed_nothing(void **state)
{
    farm_t *farm = *state;
    uint64_t first = submit(farm, 0, 1 << 20);
    simulation_t s = simulate(farm, 4, (const uint32_t[]){1, 1, 1, 1});
    run(&s, 1000);
    uint64_t second = submit(farm, s.now, 1 << 20);
    double before = s.served[first];
    run(&s, 400);
    assert_even(s.served[first] - before, s.served[second]);
    assert_int_equal(toy_order(farm, s.now, first, ORDER_PAUSE).code, RESULT_OK);
    run(&s, 400);
    assert_int_equal(toy_order(farm, s.now, first, ORDER_RESUME).code, RESULT_OK);
    before = s.served[first];
    double before_second = s.served[second];
    run(&s, 400);
    assert_even(s.served[first] - before, s.served[second] - before_second);
}

static void a_higher_priority_goes_first(void **state)
{
    farm_t *farm = *state;
    uint64_t low = submit(farm, 0, 1 << 20), other = submit(farm, 0, 1 << 20);
    simulation_t s = simulate(farm, 3, (const uint32_t[]){1, 2, 4});
    run(&s, 100);
    job_settings_t settings = settings_of(1 << 20);
    uint64_t high = toy_submit(farm, s.now, &settings, 1);
    run(&s, 2); /* what they hold is finished */
    double before = s.served[low] + s.served[other], before_high = s.served[high];
    run(&s, 100);
    assert_true(s.served[low] + s.served[other] == before);
    assert_even(s.served[high] - before_high, 700);
    job_order_t order = {.job = low, .kind = ORDER_PRIORITY, .priority = 2};
    assert_int_equal(farm_order(farm, s.now, &order).code, RESULT_OK);
    run(&s, 2);
    before_high = s.served[high];
    run(&s, 50);
    assert_true(s.served[high] == before_high);
    assert_int_equal(toy_order(farm, s.now, low, ORDER_CANCEL).code, RESULT_OK);
    assert_int_equal(toy_order(farm, s.now, high, ORDER_CANCEL).code, RESULT_OK);
    before = s.served[other];
    run(&s, 50);
    assert_true(s.served[other] > before + 300);
    order.priority = JOB_MAX_PRIORITY + 1;
    order.job = other;
    assert_int_equal(farm_order(farm, s.now, &order).code, RESULT_USAGE);
}

static void few_jobs_are_begun_at_a_time(void **state)
{
    farm_t *farm = *state;
    uint64_t jobs[6];
    for (int j = 0; j < 6; j++) jobs[j] = submit(farm, 0, 1 << 20);
    simulation_t s = simulate(farm, 10, (const uint32_t[]){1, 1, 1, 1, 1, 1, 1, 1, 1, 1});
    run(&s, 100);
    for (int j = 0; j < 6; j++)
        assert_int_equal(toy_state(farm, s.now, jobs[j]), j < 4 ? JOB_RUNNING : JOB_QUEUED);
    assert_int_equal(toy_order(farm, s.now, jobs[1], ORDER_PAUSE).code, RESULT_OK);
    run(&s, 100);
    assert_int_equal(toy_state(farm, s.now, jobs[4]), JOB_RUNNING);
    assert_int_equal(toy_state(farm, s.now, jobs[5]), JOB_QUEUED);
    job_settings_t settings = settings_of(1 << 20);
    uint64_t urgent = toy_submit(farm, s.now, &settings, 5); /* is begun though four are at work */
    run(&s, 3);
    assert_int_equal(toy_state(farm, s.now, urgent), JOB_RUNNING);
}

/* ---- orders -------------------------------------------------------------------------------------------- */

static bool notice_is(farm_t *farm, uint64_t job, bool flush)
{
    notice_t notice;
    for (bool found = false; farm_next_notice(farm, &notice);) {
        found |= notice.job == job && notice.flush == flush;
        if (found) return true;
    }
    return false;
}

static void a_paused_job_keeps_what_its_workers_have(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 0, 8), worker = toy_hello(farm, 0, 1), late = toy_hello(farm, 0, 1);
    toy_work_t work = toy_take(farm, 1, worker, 1024, 512), more = toy_take(farm, 1, late, 1024, 512);
    assert_true(work.job == job && more.job == job);
    assert_int_equal(toy_order(farm, 11, job, ORDER_PAUSE).code, RESULT_OK);
    assert_true(notice_is(farm, job, true));
    assert_int_equal(toy_state(farm, 10, job), JOB_PAUSED);
    assert_int_equal(toy_take(farm, 10, worker, 1024, 512).job, 0);
    assert_int_equal(toy_deliver(farm, 11, worker, job, work.units, work.count).code, RESULT_OK);
    assert_true(toy_report(farm, 11, job).record.samples_done > 0);
    assert_true(toy_report(farm, 11, job).record.account.out > 0);
    farm_tick(farm, 25); /* the grace period is over: the other's units go back, */
    assert_int_equal(toy_state(farm, 25, job), JOB_PAUSED);
    assert_int_equal(toy_report(farm, 25, job).record.account.out, 0);
    worker = toy_hello(farm, 25, 1);
    assert_int_equal(toy_take(farm, 25, worker, 1024, 512).job, 0); /* to nobody for now, */
    assert_int_equal(toy_deliver(farm, 26, late, job, more.units, more.count).code,
                     RESULT_OK); /* or come yet */
    assert_true(toy_report(farm, 1000, job).record.elapsed == 10);
    assert_int_equal(toy_order(farm, 1000, job, ORDER_PAUSE).code, RESULT_INPUT);
    assert_int_equal(toy_order(farm, 1000, job, ORDER_RESUME).code, RESULT_OK);
    assert_int_equal(toy_state(farm, 1000, job), JOB_RUNNING);
    worker = toy_hello(farm, 1000, 1);
    toy_work_off(farm, 1005, worker, job);
    assert_int_equal(toy_state(farm, 1005, job), JOB_FINISHING);
    job_report_t report = toy_report(farm, 1005, job);
    assert_true(report.record.elapsed == 10 + 5);
    assert_int_equal(report.record.samples_done, 8 * 1024);
    assert_int_equal(report.record.account.issued,
                     report.record.account.counted + report.record.account.returned);
}

/* Workers that were told to drop what they have are not held to it, though the job is resumed at once. */
static void a_short_pause_leaves_nothing_behind(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 0, 4), worker = toy_hello(farm, 0, 1);
    size_t held = 0;
    for (toy_work_t work; (work = toy_take(farm, 1, worker, 1024, 512)).job != 0;) held += work.count;
    assert_true(held > 0);
    assert_int_equal(toy_order(farm, 2, job, ORDER_PAUSE).code, RESULT_OK);
    assert_int_equal(toy_order(farm, 2, job, ORDER_RESUME).code, RESULT_OK);
    toy_work_off(farm, 3, worker, job);
    assert_int_equal(toy_state(farm, 3, job), JOB_FINISHING);
}

/* A job in each state that a client may find it in. */
static uint64_t job_in_state(farm_t *farm, job_state_t state)
{
    uint64_t job = submit(farm, 0, 4), worker = toy_hello(farm, 0, 1);
    toy_film_t film;
    if (state == JOB_QUEUED) return job;
    toy_work_t work = toy_take(farm, 0, worker, 4096, 512);
    toy_deliver(farm, 0, worker, job, work.units, work.count);
    if (state == JOB_PAUSED) toy_order(farm, 1, job, ORDER_PAUSE);
    if (state == JOB_CANCELLED) toy_order(farm, 1, job, ORDER_CANCEL);
    if (state == JOB_FINISHING || state == JOB_DONE) toy_work_off(farm, 1, worker, job);
    if (state == JOB_DONE || state == JOB_CANCELLED) {
        toy_write_images(farm, 1, ok);
        assert_true(toy_checkpoint(farm, 1, ok, &film));
        toy_film_free(&film);
    }
    if (state == JOB_FAILED) {
        farm_goodbye(farm, 1, worker, 0, "");
        job = submit(farm, 1, 4);
        for (double now = 1; toy_state(farm, now, job) != JOB_FAILED; now += 150) {
            worker = toy_hello(farm, now, 1);
            while (toy_take(farm, now, worker, 4096, 512).job != job) continue;
            farm_goodbye(farm, now, worker, job, "no");
        }
        toy_write_images(farm, 1, ok);
    }
    return job;
}

static void orders_fit_the_state_or_are_refused(void **state)
{
    enum { NO = RESULT_INPUT, YES = RESULT_OK };
    static const struct {
        job_state_t state;
        int expected[10]; /* of cancel, pause, resume, retain, release, delete, priority, extend, mixed,
                             rebind */
    } rows[] = {{JOB_QUEUED, {YES, YES, NO, YES, YES, NO, YES, NO, YES, NO}},
                {JOB_RUNNING, {YES, YES, NO, YES, YES, NO, YES, NO, YES, NO}},
                {JOB_PAUSED, {YES, NO, YES, YES, YES, NO, YES, NO, YES, NO}},
                {JOB_FINISHING, {YES, NO, NO, YES, YES, NO, YES, NO, YES, NO}},
                {JOB_DONE, {NO, NO, NO, YES, YES, YES, YES, NO, YES, NO}},
                {JOB_CANCELLED, {NO, NO, NO, YES, YES, YES, YES, YES, YES, NO}},
                {JOB_FAILED, {NO, NO, NO, YES, YES, YES, YES, YES, YES, NO}}};
    (void)state;
    for (size_t i = 0; i < ARRAY_LENGTH(rows); i++)
        for (order_kind_t kind = ORDER_CANCEL; kind <= ORDER_REBIND; kind++) {
            const int *expected = rows[i].expected;
            farm_t *farm = toy_farm(true);
            uint64_t job = job_in_state(farm, rows[i].state);
            assert_int_equal(toy_state(farm, 1, job), rows[i].state);
            result_t result = toy_order(farm, 2, job, kind);
            if ((int)result.code != expected[kind - 1])
                fail_msg("order %d of a job that is %s: %d %s", (int)kind, job_state_name(rows[i].state),
                         (int)result.code, result.message);
            assert_int_equal(toy_order(farm, 2, 77, kind).code, RESULT_INPUT);
            farm_tick(farm, 3);
            toy_write_images(farm, 3, ok);
            farm_destroy(&farm);
        }
}

static void a_deleted_job_is_unknown_and_its_record_goes(void **state)
{
    farm_t *farm = *state;
    uint64_t job = job_in_state(farm, JOB_DONE);
    job_record_t record;
    while (farm_next_record(farm, 2, &record)) assert_false(record.removed);
    job_t *pinned = farm_pin(farm, job);
    assert_int_equal(toy_order(farm, 2, job, ORDER_DELETE).code, RESULT_OK);
    assert_null(farm_pin(farm, job));
    assert_int_equal(toy_order(farm, 2, job, ORDER_RETAIN).code, RESULT_INPUT);
    assert_int_equal(farm_job_id(pinned), job); /* who looks at it may finish */
    farm_finished(farm, 2, pinned, ok, NULL);
    farm_unpin(farm, pinned);
    assert_true(farm_next_record(farm, 2, &record));
    assert_true(record.removed && record.job == job);
    farm_record_unsaved(farm, job);
    assert_true(farm_next_record(farm, 2, &record));
    assert_true(record.removed && record.job == job);
    assert_false(farm_next_record(farm, 2, &record));
}

static void retained_jobs_are_not_forgotten(void **state)
{
    (void)state;
    farm_options_t options = {.lease = 5,
                              .batch_interval = 10,
                              .film_limit = 1 << 20,
                              .first_job = 5,
                              .job_limit = 3,
                              .control_wake = -1,
                              .image_wake = -1,
                              .journal_writer_wake = -1,
                              .news_wake = -1,
                              .checkpoint_wake = -1,
                              .grant_wake = -1};
    farm_t *farm = farm_new(&options);
    job_settings_t settings = settings_of(4);
    hash_t blob = {{0}};
    uint64_t jobs[3], job;
    for (int j = 0; j < 3; j++) {
        jobs[j] = submit(farm, 0, 4);
        assert_int_equal(toy_order(farm, 0, jobs[j], ORDER_CANCEL).code, RESULT_OK);
    }
    assert_int_equal(jobs[0], 5);
    assert_int_equal(toy_order(farm, 0, jobs[0], ORDER_RETAIN).code, RESULT_OK);
    assert_int_equal(toy_order(farm, 0, jobs[1], ORDER_RETAIN).code, RESULT_OK);
    assert_int_equal(toy_order(farm, 0, jobs[1], ORDER_RELEASE).code, RESULT_OK);
    submit(farm, 0, 4);
    submit(farm, 0, 4);
    assert_non_null(farm_pin(farm, jobs[0]));
    assert_null(farm_pin(farm, jobs[1]));
    assert_null(farm_pin(farm, jobs[2]));
    job_terms_t terms = {.name = "one too many"};
    assert_int_equal(farm_submit(farm, 0, &terms, &settings, &blob, 1, &job).code, RESULT_LIMIT);
    job_t *pinned = farm_pin(farm, jobs[0]);
    farm_unpin(farm, pinned);
    farm_unpin(farm, pinned);
    assert_true(toy_report(farm, 0, jobs[0]).record.retained);
    farm_destroy(&farm);
}

/* ---- what clients are told ----------------------------------------------------------------------------- */

typedef struct {
    uint64_t next;
    size_t count, messages;
} pages_t;

static void take_page(void *context, Lm__Envelope__BodyCase kind, void *body)
{
    pages_t *pages = context;
    Lm__JobStatusReply *reply = body;
    Lm__Envelope answer = LM__ENVELOPE__INIT;
    assert_int_equal(kind, LM__ENVELOPE__BODY_JOB_STATUS_REPLY);
    answer.body_case = kind;
    answer.job_status_reply = reply;
    assert_true(lm__envelope__get_packed_size(&answer) < WIRE_MAX_HEADER);
    for (size_t i = 0; i < reply->n_jobs; i++) assert_int_equal(reply->jobs[i]->job, ++pages->count);
    pages->next = reply->next;
    pages->messages++;
}

static void a_long_queue_is_told_in_several_messages(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = settings_of(4);
    job_terms_t terms = {.verify = 0.5};
    hash_t blob = {{1}};
    uint64_t job;
    memset(terms.name, 'x', JOB_MAX_NAME);
    for (int i = 0; i < FARM_MAX_JOBS; i++) {
        job_record_t record = {
            .job = (uint64_t)i + 1, .state = JOB_FAILED, .settings = settings, .terms = terms};
        memset(record.message, 'y', sizeof record.message - 1);
        record.account = (schedule_account_t){UINT64_MAX, UINT64_MAX, UINT64_MAX, 0, 0};
        farm_restore(farm, 0, &record);
    }
    pages_t pages = {.next = 1};
    while (pages.next != 0) {
        Lm__JobStatusRequest request = LM__JOB_STATUS_REQUEST__INIT;
        request.from = pages.next;
        assert_int_equal(report_jobs(farm, 0, &request, 1, take_page, &pages).code, RESULT_OK);
    }
    assert_int_equal(pages.count, FARM_MAX_JOBS);
    assert_true(pages.messages > 1 && pages.messages < 10);
    Lm__JobStatusRequest request = LM__JOB_STATUS_REQUEST__INIT;
    request.job = FARM_MAX_JOBS + 1;
    assert_int_equal(report_jobs(farm, 0, &request, 1, take_page, &pages).code, RESULT_INPUT);
    assert_int_equal(farm_submit(farm, 0, &terms, &settings, &blob, 1, &job).code, RESULT_OK);
}

/* ---- the end of a job ---------------------------------------------------------------------------------- */

static void a_job_is_over_when_image_and_checkpoint_are_made(void **state)
{
    for (int image_first = 0; image_first < 2; image_first++) {
        farm_t *farm = toy_farm(true);
        uint64_t job = job_in_state(farm, JOB_FINISHING);
        toy_film_t film;
        if (image_first) assert_int_equal(toy_write_images(farm, 2, ok), 1);
        if (!image_first) assert_true(toy_checkpoint(farm, 2, ok, &film));
        assert_int_equal(toy_state(farm, 2, job), JOB_FINISHING);
        if (!image_first) assert_int_equal(toy_write_images(farm, 2, ok), 1);
        if (image_first) assert_true(toy_checkpoint(farm, 2, ok, &film));
        assert_int_equal(toy_state(farm, 2, job), JOB_DONE);
        assert_int_equal(toy_report(farm, 2, job).record.samples_done, 4 * 1024);
        assert_int_equal(toy_report(farm, 2, job).record.account.counted, 4 * 1024);
        assert_int_equal(film.state.issued, film.state.returned + 4 * 1024);
        toy_film_free(&film);
        farm_destroy(&farm);
    }
    (void)state;
}

/* The disk is full for a while. */
static void what_cannot_be_written_is_tried_again(void **state)
{
    farm_t *farm = *state;
    uint64_t job = job_in_state(farm, JOB_FINISHING);
    toy_film_t film;
    result_t full = result_fail(RESULT_IO, "no space left on device");
    assert_int_equal(toy_write_images(farm, 2, full), 1);
    assert_non_null(strstr(toy_report(farm, 2, job).record.message, "no space left"));
    assert_true(toy_checkpoint(farm, 2, full, &film));
    assert_int_equal(toy_state(farm, 2, job), JOB_FINISHING);
    assert_int_equal(toy_write_images(farm, 3, ok), 0); /* not at once */
    farm_tick(farm, 20);
    assert_int_equal(toy_write_images(farm, 20, ok), 1);
    assert_true(toy_checkpoint(farm, 20, full, &film));
    assert_int_equal(toy_state(farm, 20, job), JOB_FINISHING);
    assert_non_null(strstr(toy_report(farm, 20, job).record.message, "last checkpoint cannot be written"));
    assert_true(toy_checkpoint(farm, 30, ok, &film));
    assert_int_equal(toy_state(farm, 30, job), JOB_DONE);
    assert_string_equal(toy_report(farm, 30, job).record.message, "");
    toy_film_free(&film);
}

static void cancelling_gives_up_what_cannot_be_written(void **state)
{
    farm_t *farm = *state;
    uint64_t job = job_in_state(farm, JOB_FINISHING);
    toy_film_t film;
    result_t full = result_fail(RESULT_IO, "no space left on device");
    assert_int_equal(toy_write_images(farm, 2, full), 1);
    assert_true(toy_checkpoint(farm, 2, full, &film));
    assert_int_equal(toy_order(farm, 3, job, ORDER_CANCEL).code, RESULT_OK);
    assert_int_equal(toy_state(farm, 3, job), JOB_FAILED);
    assert_false(toy_checkpoint(farm, 3, ok, &film));
    assert_int_equal(toy_order(farm, 3, job, ORDER_DELETE).code, RESULT_OK);
}

/* It is given up while an attempt is under way, which fails. */
static void what_was_given_up_is_not_tried_again(void **state)
{
    farm_t *farm = *state;
    uint64_t job = job_in_state(farm, JOB_FINISHING);
    result_t full = result_fail(RESULT_IO, "no space left on device");
    schedule_state_t saved;
    shared_film_snapshot_t *snapshot;
    double age;
    bool last;
    assert_int_equal(toy_write_images(farm, 2, full), 1);
    job_t *saving = farm_next_checkpoint(farm, 2, &age, &last);
    assert_true(farm_snapshot(farm, saving, &saved, &snapshot));
    assert_int_equal(toy_order(farm, 3, job, ORDER_CANCEL).code, RESULT_OK);
    shared_film_snapshot_free(&snapshot);
    schedule_state_free(&saved);
    farm_checkpointed(farm, 4, saving, full);
    farm_unpin(farm, saving);
    assert_int_equal(toy_state(farm, 4, job), JOB_FAILED);
    assert_non_null(strstr(toy_report(farm, 4, job).record.message, "no space left"));
}

/* ---- after the process --------------------------------------------------------------------------------- */

enum { MAX_RECORDS = 16 };

/* The farm's process ends: what is left are its records. */
static size_t end_process(farm_t **farm, double now, job_record_t records[MAX_RECORDS])
{
    size_t count = 0;
    for (job_record_t record; farm_next_record(*farm, now, &record);) {
        size_t i = 0;
        while (i < count && records[i].job != record.job) i++;
        assert_true(i < MAX_RECORDS);
        records[i] = record;
        if (i == count) count++;
    }
    farm_destroy(farm);
    return count;
}

static farm_t *begin_process(double now, const job_record_t *records, size_t count)
{
    farm_t *farm = toy_farm(true);
    for (size_t i = 0; i < count; i++)
        if (!records[i].removed) farm_restore(farm, now, &records[i]);
    return farm;
}

/* The sums that a job of so many samples has at the end. */
static hash_t undisturbed(uint32_t spp)
{
    farm_t *farm = toy_farm(true);
    uint64_t job = submit(farm, 0, spp);
    toy_work_off(farm, 0, toy_hello(farm, 0, 1), job);
    hash_t hash = toy_sums(farm, job);
    farm_destroy(&farm);
    return hash;
}

static void assert_sums(farm_t *farm, uint64_t job, uint32_t spp)
{
    hash_t expected = undisturbed(spp), got = toy_sums(farm, job);
    assert_true(hash_equal(&expected, &got));
}

static void a_job_goes_on_where_its_checkpoint_was(void **state)
{
    farm_t *farm = toy_farm(true);
    uint64_t job = submit(farm, 0, 16), queued = submit(farm, 0, 4), worker = toy_hello(farm, 0, 1);
    job_record_t records[MAX_RECORDS];
    toy_film_t film;
    toy_work_t work = toy_take(farm, 5, worker, 2048, 512);
    assert_int_equal(work.job, job);
    assert_int_equal(toy_deliver(farm, 5, worker, job, work.units, 2).code, RESULT_OK);
    uint64_t done = toy_report(farm, 5, job).record.samples_done;
    assert_true(toy_checkpoint(farm, 6, ok, &film));
    assert_true(toy_report(farm, 7, job).checkpoint_age == 1);
    assert_int_equal(toy_deliver(farm, 7, worker, job, work.units + 2, work.count - 2).code, RESULT_OK);
    assert_true(toy_report(farm, 7, job).record.samples_done > done);
    size_t count = end_process(&farm, 8, records);
    assert_int_equal(count, 2);

    farm = begin_process(0, records, count);
    assert_int_equal(toy_state(farm, 0, queued), JOB_QUEUED);
    worker = toy_hello(farm, 0, 1);
    assert_true(toy_load(farm, 1, &film));
    assert_false(toy_load(farm, 1, NULL));
    job_report_t report = toy_report(farm, 1, job);
    assert_int_equal(report.record.state, JOB_RUNNING);
    assert_int_equal(report.record.samples_done, done);
    assert_int_equal(report.record.account.issued,
                     report.record.account.counted + report.record.account.returned);
    assert_true(report.record.elapsed >= 1 && report.record.elapsed < 10);
    assert_int_equal(report.record.workers_seen, 1);
    /* What the lost process had merged is wanted again. */
    assert_int_equal(toy_deliver(farm, 1, worker, job, work.units + 2, work.count - 2).code, RESULT_OK);
    assert_int_equal(toy_deliver(farm, 1, worker, job, work.units, 2).code, RESULT_MISMATCH);
    assert_int_equal(toy_order(farm, 1, queued, ORDER_CANCEL).code, RESULT_OK);
    toy_work_off(farm, 2, worker, job);
    assert_int_equal(toy_state(farm, 2, job), JOB_FINISHING);
    assert_sums(farm, job, 16);
    assert_true(submit(farm, 2, 4) > queued);
    *state = farm;
}

static void a_job_without_a_checkpoint_begins_anew(void **state)
{
    farm_t *farm = toy_farm(true);
    uint64_t job = submit(farm, 0, 8), worker = toy_hello(farm, 0, 1);
    job_record_t records[MAX_RECORDS];
    toy_work_t work = toy_take(farm, 5, worker, 2048, 512);
    assert_int_equal(toy_deliver(farm, 5, worker, job, work.units, work.count).code, RESULT_OK);
    size_t count = end_process(&farm, 8, records);
    farm = begin_process(0, records, count);
    worker = toy_hello(farm, 0, 1);
    assert_int_equal(toy_take(farm, 0, worker, 2048, 512).job, 0); /* its film might be there */
    assert_true(toy_load(farm, 1, NULL));
    assert_int_equal(toy_report(farm, 1, job).record.samples_done, 0);
    toy_work_off(farm, 2, worker, job);
    assert_sums(farm, job, 8);
    *state = farm;
}

/* The time that was spent on samples that are lost does not end a job. */
static void what_begins_anew_has_all_its_time(void **state)
{
    farm_t *farm = toy_farm(true);
    job_settings_t settings = settings_of(8);
    settings.time_limit = 10;
    uint64_t job = toy_submit(farm, 0, &settings, 0);
    job_record_t records[MAX_RECORDS];
    assert_int_equal(toy_take(farm, 1, toy_hello(farm, 1, 1), 2048, 512).job, job);
    size_t count = end_process(&farm, 10, records);
    farm = begin_process(0, records, count);
    assert_true(toy_load(farm, 1, NULL));
    assert_int_equal(toy_take(farm, 1, toy_hello(farm, 1, 1), 2048, 512).job, job);
    farm_tick(farm, 5);
    assert_int_equal(toy_state(farm, 5, job), JOB_RUNNING);
    farm_tick(farm, 12);
    assert_int_equal(toy_state(farm, 12, job), JOB_FINISHING);
    *state = farm;
}

/* There is room for six films. Seven jobs, of which six were begun: the seventh does not take the room of one
 * that is still to be loaded. */
static void room_is_kept_for_films_that_come_back(void **state)
{
    enum { BEGUN = 6 };
    farm_t *farm = toy_farm(true);
    uint64_t jobs[BEGUN + 1], worker = toy_hello(farm, 0, 1);
    job_record_t records[MAX_RECORDS];
    for (int i = 0; i < BEGUN; i++) {
        jobs[i] = submit(farm, i, 4);
        while (toy_take(farm, i, worker, 1024, 1 << 16).job != 0) continue;
    }
    jobs[BEGUN] = submit(farm, BEGUN, 4);
    size_t count = end_process(&farm, BEGUN, records);
    farm = begin_process(0, records, count);
    worker = toy_hello(farm, 0, 1);
    assert_true(toy_load(farm, 0, NULL));
    for (toy_work_t work; (work = toy_take(farm, 0, worker, 4096, 1024)).job != 0;)
        assert_int_not_equal(work.job, jobs[BEGUN]);
    for (int i = 1; i < BEGUN; i++) assert_true(toy_load(farm, 0, NULL));
    *state = farm;
}

static void a_job_that_was_finishing_gets_its_image(void **state)
{
    static const job_state_t ends[] = {JOB_DONE, JOB_CANCELLED};
    for (size_t i = 0; i < ARRAY_LENGTH(ends); i++) {
        farm_t *farm = toy_farm(true);
        uint64_t job = submit(farm, 0, 8), worker = toy_hello(farm, 0, 1);
        job_record_t records[MAX_RECORDS];
        toy_film_t film, last;
        toy_work_t work = toy_take(farm, 5, worker, 2048, 512);
        assert_int_equal(toy_deliver(farm, 5, worker, job, work.units, work.count).code, RESULT_OK);
        assert_true(toy_checkpoint(farm, 6, ok, &film));
        if (ends[i] == JOB_DONE)
            toy_work_off(farm, 7, worker, job);
        else
            assert_int_equal(toy_order(farm, 7, job, ORDER_CANCEL).code, RESULT_OK);
        assert_int_equal(toy_state(farm, 7, job), JOB_FINISHING);
        size_t count = end_process(&farm, 8, records);
        assert_int_equal(records[0].state, JOB_FINISHING);
        farm = begin_process(0, records, count);
        worker = toy_hello(farm, 0, 1);
        assert_true(toy_load(farm, 0, &film));
        if (ends[i] == JOB_DONE) {
            assert_int_equal(toy_state(farm, 0, job), JOB_RUNNING); /* the checkpoint is older */
            toy_work_off(farm, 0, worker, job);
            assert_sums(farm, job, 8);
        }
        assert_int_equal(toy_state(farm, 0, job), JOB_FINISHING);
        assert_int_equal(toy_write_images(farm, 0, ok), 1);
        if (toy_checkpoint(farm, 0, ok, &last)) toy_film_free(&last);
        assert_int_equal(toy_state(farm, 0, job), ends[i]);
        farm_destroy(&farm);
    }
    *state = toy_farm(true);
}

static void a_paused_job_stays_paused(void **state)
{
    farm_t *farm = toy_farm(true);
    uint64_t job = job_in_state(farm, JOB_PAUSED), other = submit(farm, 1, 4);
    assert_int_equal(toy_order(farm, 1, other, ORDER_PAUSE).code, RESULT_OK);
    job_record_t records[MAX_RECORDS];
    toy_film_t film;
    assert_true(toy_checkpoint(farm, 2, ok, &film));
    size_t count = end_process(&farm, 2, records);
    snprintf(records[0].message, sizeof records[0].message, "%s", FARM_NO_SCENE);
    farm = begin_process(0, records, count);
    assert_int_equal(toy_state(farm, 0, job), JOB_PAUSED);
    assert_true(toy_load(farm, 0, &film));
    if (toy_load(farm, 0, NULL)) assert_int_equal(toy_state(farm, 0, other), JOB_PAUSED);
    assert_int_equal(toy_state(farm, 0, job), JOB_PAUSED);
    uint64_t worker = toy_hello(farm, 0, 1);
    assert_int_equal(toy_take(farm, 0, worker, 1024, 512).job, 0);
    assert_string_equal(toy_report(farm, 0, job).record.message, FARM_NO_SCENE);
    assert_int_equal(toy_order(farm, 1, job, ORDER_RESUME).code, RESULT_OK);
    assert_string_equal(toy_report(farm, 1, job).record.message, "");
    toy_work_off(farm, 1, worker, job);
    assert_sums(farm, job, 4);
    assert_int_equal(toy_order(farm, 1, other, ORDER_RESUME).code, RESULT_OK);
    toy_work_off(farm, 1, worker, other);
    *state = farm;
}

static void a_film_that_cannot_be_had_fails_the_job(void **state)
{
    farm_t *farm = toy_farm(true);
    uint64_t job = job_in_state(farm, JOB_PAUSED), worker;
    job_record_t records[MAX_RECORDS];
    size_t count = end_process(&farm, 2, records);
    farm = begin_process(0, records, count);
    job_t *wanted = farm_next_load(farm);
    assert_non_null(wanted);
    farm_load_failed(farm, 1, wanted, "job-1.2.film: cannot be read");
    farm_unpin(farm, wanted);
    toy_write_images(farm, 1, ok);
    assert_int_equal(toy_state(farm, 1, job), JOB_FAILED);
    assert_non_null(strstr(toy_report(farm, 1, job).record.message, "cannot be read"));
    /* Once more, when the disk is back. */
    assert_int_equal(toy_order(farm, 2, job, ORDER_EXTEND).code, RESULT_OK);
    worker = toy_hello(farm, 2, 1);
    assert_int_equal(toy_take(farm, 2, worker, 1024, 512).job, 0);
    assert_true(toy_load(farm, 2, NULL));
    toy_work_off(farm, 2, worker, job);
    assert_sums(farm, job, 4);
    *state = farm;
}

/* The process ends in order: what no checkpoint holds is saved. */
static void shutting_down_saves_all_and_cancels_nothing(void **state)
{
    farm_t *farm = toy_farm(true);
    uint64_t job = submit(farm, 0, 8), worker = toy_hello(farm, 0, 1);
    job_record_t records[MAX_RECORDS];
    toy_film_t film;
    double age;
    bool last;
    toy_work_t work = toy_take(farm, 5, worker, 2048, 512);
    assert_int_equal(toy_deliver(farm, 5, worker, job, work.units, work.count).code, RESULT_OK);
    job_t *next = farm_next_checkpoint(farm, 6, &age, &last);
    assert_non_null(next);
    assert_true(!last && age == 1);
    farm_unpin(farm, next);
    farm_shut_down(farm);
    assert_int_equal(toy_take(farm, 6, worker, 2048, 512).job, 0);
    next = farm_next_checkpoint(farm, 6, &age, &last);
    assert_non_null(next);
    assert_true(last);
    farm_unpin(farm, next);
    assert_true(toy_checkpoint(farm, 6, ok, &film));
    assert_false(toy_checkpoint(farm, 6, ok, &film));
    assert_int_equal(toy_state(farm, 6, job), JOB_RUNNING);
    size_t count = end_process(&farm, 7, records);
    farm = begin_process(0, records, count);
    assert_true(toy_load(farm, 0, &film));
    toy_work_off(farm, 1, toy_hello(farm, 1, 1), job);
    assert_sums(farm, job, 8);
    *state = farm;
}

/* ---- extending ----------------------------------------------------------------------------------------- */

/* A job that is over, and its film on the disk. */
static uint64_t finished_job(farm_t *farm, uint32_t spp, toy_film_t *film)
{
    uint64_t job = submit(farm, 0, spp), worker = toy_hello(farm, 0, 1);
    toy_work_off(farm, 1, worker, job);
    farm_goodbye(farm, 1, worker, 0, "");
    assert_int_equal(toy_write_images(farm, 1, ok), 1);
    assert_true(toy_checkpoint(farm, 1, ok, film));
    assert_int_equal(toy_state(farm, 1, job), JOB_DONE);
    return job;
}

static void an_extended_job_is_as_one_that_was_longer(void **state)
{
    for (int restart = 0; restart < 2; restart++) {
        farm_t *farm = toy_farm(true);
        toy_film_t film;
        job_record_t records[MAX_RECORDS];
        uint64_t job = finished_job(farm, 4, &film);
        if (restart) {
            size_t count = end_process(&farm, 2, records);
            farm = begin_process(0, records, count);
            assert_int_equal(toy_state(farm, 0, job), JOB_DONE);
            assert_int_equal(toy_report(farm, 0, job).record.samples_done, 4 * 1024);
            assert_false(toy_load(farm, 0, NULL));
        }
        job_order_t order = {.job = job, .kind = ORDER_EXTEND, .spp = 12};
        assert_int_equal(farm_order(farm, 2, &order).code, RESULT_OK);
        assert_int_equal(toy_state(farm, 2, job), JOB_QUEUED);
        uint64_t worker = toy_hello(farm, 2, 1);
        assert_false(toy_load(farm, 2, NULL)); /* not before its turn */
        assert_int_equal(toy_take(farm, 2, worker, 1024, 512).job, 0);
        assert_true(toy_load(farm, 2, &film));
        assert_int_equal(toy_state(farm, 2, job), JOB_RUNNING);
        order.spp = 16; /* while it runs */
        assert_int_equal(farm_order(farm, 2, &order).code, RESULT_OK);
        order.spp = 8;
        assert_int_equal(farm_order(farm, 2, &order).code, RESULT_INPUT);
        toy_work_off(farm, 2, worker, job);
        assert_sums(farm, job, 16);
        assert_int_equal(toy_write_images(farm, 3, ok), 1);
        assert_true(toy_checkpoint(farm, 3, ok, &film));
        toy_film_free(&film);
        assert_int_equal(toy_state(farm, 3, job), JOB_DONE);
        job_report_t report = toy_report(farm, 3, job);
        assert_int_equal(report.record.samples_done, 16 * 1024);
        assert_int_equal(report.record.account.issued,
                         report.record.account.counted + report.record.account.returned);
        farm_destroy(&farm);
    }
    *state = toy_farm(true);
}

/* What was reached and is not asked for anew ends the job no longer. */
static void an_extension_replaces_what_was_reached(void **state)
{
    farm_t *farm = *state;
    toy_film_t film;
    uint64_t job = finished_job(farm, 4, &film);
    job_order_t order = {.job = job, .kind = ORDER_EXTEND};
    result_t result = farm_order(farm, 2, &order);
    assert_int_equal(result.code, RESULT_INPUT);
    assert_non_null(strstr(result.message, "how far"));
    order.spp = 4;
    assert_int_equal(farm_order(farm, 2, &order).code, RESULT_INPUT);
    order = (job_order_t){.job = job, .kind = ORDER_EXTEND, .time_limit = 100};
    assert_int_equal(farm_order(farm, 2, &order).code, RESULT_OK);
    job_report_t report = toy_report(farm, 2, job);
    assert_int_equal(report.record.settings.spp, JOB_MAX_SPP);
    assert_true(report.record.settings.time_limit == report.record.elapsed + 100);
    assert_int_equal(toy_order(farm, 2, job, ORDER_CANCEL).code,
                     RESULT_OK); /* has a film: its image is made */
    assert_int_equal(toy_state(farm, 2, job), JOB_FINISHING);
    assert_true(toy_load(farm, 2, &film));
    assert_int_equal(toy_write_images(farm, 2, ok), 1);
    assert_int_equal(toy_state(farm, 2, job), JOB_CANCELLED);
}

static void a_master_that_keeps_no_films_says_so(void **state)
{
    farm_destroy((farm_t **)state);
    farm_t *farm = *state = toy_farm(false);
    uint64_t job = submit(farm, 0, 4);
    toy_work_off(farm, 1, toy_hello(farm, 0, 1), job);
    assert_int_equal(toy_write_images(farm, 1, ok), 1);
    assert_int_equal(toy_state(farm, 1, job), JOB_DONE);
    job_order_t order = {.job = job, .kind = ORDER_EXTEND, .spp = 12};
    assert_int_equal(farm_order(farm, 2, &order).code, RESULT_INPUT);
}

/* ---- rounds -------------------------------------------------------------------------------------------- */

static job_settings_t planned(double error, bool adaptive, uint32_t spp)
{
    job_settings_t settings = settings_of(spp);
    settings.error = error;
    settings.adaptive = adaptive;
    return settings;
}

/* What came out of a planned job. */
typedef struct {
    uint64_t samples;
    double error;
    hash_t sums;
} outcome_t;

/* Renders on a farm where units come back in another order, some are lost, and the process ends in between,
 * `disturbance` times. */
static outcome_t render_planned(const job_settings_t *settings, int disturbances)
{
    farm_t *farm = toy_farm(true);
    uint64_t job = toy_submit(farm, 0, settings, 0), worker[3];
    double now = 1;
    for (int w = 0; w < 3; w++) worker[w] = toy_hello(farm, now, 1);
    toy_take(farm, now, worker[0], 512, 512); /* it is begun; these are lost */
    farm_goodbye(farm, now, worker[0], 0, "");
    worker[0] = toy_hello(farm, now, 1);
    for (int turn = 0; toy_state(farm, now, job) == JOB_RUNNING; turn++) {
        toy_work_t work[3];
        assert_true(turn < 100000);
        now += 0.01;
        for (int w = 0; w < 3; w++) work[w] = toy_take(farm, now, worker[w], 512 + 256 * (unsigned)w, 256);
        for (int w = 2; w >= 0; w--)
            if (work[w].job != 0 && (disturbances == 0 || (turn + w) % 4 != 0))
                toy_deliver(farm, now, worker[w], job, work[w].units, work[w].count);
        if (disturbances == 0) continue;
        for (int w = 0; w < 3; w++) { /* whoever did not deliver is lost */
            farm_goodbye(farm, now, worker[w], 0, "");
            worker[w] = toy_hello(farm, now, 1);
        }
        if (turn % 7 != 6 || disturbances-- < 2) continue;
        toy_film_t film;
        job_record_t records[MAX_RECORDS];
        if (!toy_checkpoint(farm, now, ok, &film)) continue;
        size_t count = end_process(&farm, now, records);
        farm = begin_process(now, records, count);
        assert_true(toy_load(farm, now, &film));
        for (int w = 0; w < 3; w++) worker[w] = toy_hello(farm, now, 1);
    }
    assert_int_equal(toy_state(farm, now, job), JOB_FINISHING);
    job_report_t report = toy_report(farm, now, job);
    assert_int_equal(report.record.account.issued,
                     report.record.account.counted + report.record.account.returned);
    assert_int_equal(report.record.account.counted, report.record.samples_done);
    outcome_t outcome = {report.record.samples_done, report.record.error, toy_sums(farm, job)};
    farm_destroy(&farm);
    return outcome;
}

static void rounds_are_the_same_on_any_farm(void **state)
{
    const job_settings_t jobs[] = {planned(0.02, false, JOB_MAX_SPP), planned(0.02, true, JOB_MAX_SPP),
                                   planned(0, true, 100), planned(0.001, false, 200)};
    (void)state;
    for (size_t i = 0; i < ARRAY_LENGTH(jobs); i++) {
        outcome_t calm = render_planned(&jobs[i], 0), disturbed = render_planned(&jobs[i], 10);
        assert_int_equal(calm.samples, disturbed.samples);
        assert_true(calm.error == disturbed.error && calm.error > 0);
        assert_true(hash_equal(&calm.sums, &disturbed.sums));
        if (jobs[i].spp == JOB_MAX_SPP)
            assert_true(calm.error <= 0.02);
        else
            assert_true(calm.samples <= (uint64_t)1024 * jobs[i].spp);
    }
}

static void a_planned_job_can_be_extended(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = planned(0.05, false, JOB_MAX_SPP);
    toy_film_t film;
    uint64_t job = toy_submit(farm, 0, &settings, 0), worker = toy_hello(farm, 0, 1);
    toy_work_off(farm, 1, worker, job);
    assert_int_equal(toy_write_images(farm, 1, ok), 1);
    assert_true(toy_checkpoint(farm, 1, ok, &film));
    assert_int_equal(toy_state(farm, 1, job), JOB_DONE);
    job_report_t report = toy_report(farm, 1, job);
    assert_true(report.record.error > 0.02 && report.record.error <= 0.05);
    job_order_t order = {.job = job, .kind = ORDER_EXTEND, .error = 0.06};
    assert_int_equal(farm_order(farm, 1, &order).code, RESULT_INPUT);
    order.error = 0.02;
    assert_int_equal(farm_order(farm, 1, &order).code, RESULT_OK);
    assert_int_equal(toy_take(farm, 2, worker, 512, 512).job, 0);
    assert_true(toy_load(farm, 2, &film));
    uint64_t before = toy_report(farm, 2, job).record.samples_done;
    assert_int_equal(before, report.record.samples_done);
    toy_work_off(farm, 2, worker, job);
    assert_int_equal(toy_state(farm, 2, job), JOB_FINISHING);
    report = toy_report(farm, 2, job);
    assert_true(report.record.error <= 0.02 && report.record.samples_done > before);
}

/* A job without an error to reach is given one while it runs. */
static void an_endless_job_can_be_given_an_error(void **state)
{
    farm_t *farm = *state;
    uint64_t job = submit(farm, 0, JOB_MAX_SPP), worker = toy_hello(farm, 0, 1);
    for (int i = 0; i < 100; i++) {
        toy_work_t work = toy_take(farm, 1, worker, 1024, 256);
        assert_int_equal(toy_deliver(farm, 1, worker, job, work.units, work.count).code, RESULT_OK);
    }
    job_order_t order = {.job = job, .kind = ORDER_EXTEND, .error = 0.02};
    assert_int_equal(farm_order(farm, 1, &order).code, RESULT_OK);
    toy_work_off(farm, 2, worker, job);
    assert_int_equal(toy_state(farm, 2, job), JOB_FINISHING);
    assert_true(toy_report(farm, 2, job).record.error <= 0.02);
}

/* The time that is left is estimated from the error. */
static void the_time_to_an_error_is_estimated(void **state)
{
    farm_t *farm = *state;
    job_settings_t settings = planned(0.01, false, JOB_MAX_SPP);
    uint64_t job = toy_submit(farm, 0, &settings, 0);
    simulation_t s = simulate(farm, 2, (const uint32_t[]){8, 8});
    run(&s, 30);
    job_report_t report = toy_report(farm, s.now, job);
    assert_int_equal(report.record.state, JOB_RUNNING);
    assert_true(report.record.error > 0.01);
    double end = s.now + report.remaining;
    while (toy_state(farm, s.now, job) == JOB_RUNNING) run(&s, 1);
    if (s.now < 0.5 * end || s.now > 2 * end) fail_msg("ended at %g s instead of %g s", s.now, end);
}

/* ---- many threads -------------------------------------------------------------------------------------- */

typedef struct {
    farm_t *farm;
    uint64_t job, worker;
} labourer_t;

static void *labour(void *argument)
{
    const labourer_t *me = argument;
    while (toy_state(me->farm, 1, me->job) == JOB_RUNNING) {
        toy_work_t work = toy_take(me->farm, 1, me->worker, 512, 128);
        if (work.job != 0) toy_deliver(me->farm, 1, me->worker, work.job, work.units, work.count);
    }
    return NULL;
}

static void *keep(void *argument)
{
    const labourer_t *me = argument;
    while (toy_state(me->farm, 1, me->job) == JOB_RUNNING) {
        toy_film_t film;
        if (toy_checkpoint(me->farm, 1, ok, &film)) toy_film_free(&film);
        job_t *job = farm_next_estimate(me->farm, clock_now());
        if (job != NULL) {
            farm_estimate(me->farm, clock_now(), job);
            farm_unpin(me->farm, job);
        }
        hash_t sums = toy_sums(me->farm, me->job);
        (void)sums;
    }
    return NULL;
}

static void threads_merge_plan_and_save_at_once(void **state)
{
    enum { LABOURERS = 4 };
    job_settings_t settings = planned(0.005, true, JOB_MAX_SPP);
    outcome_t calm = render_planned(&settings, 0);
    farm_t *farm = *state;
    pthread_t threads[LABOURERS + 1];
    labourer_t labourers[LABOURERS + 1];
    uint64_t job = toy_submit(farm, 1, &settings, 0);
    for (int i = 0; i <= LABOURERS; i++) labourers[i] = (labourer_t){farm, job, toy_hello(farm, 1, 1)};
    toy_work_t work = toy_take(farm, 1, labourers[0].worker, 512, 512);
    assert_int_equal(toy_deliver(farm, 1, labourers[0].worker, job, work.units, work.count).code, RESULT_OK);
    for (int i = 0; i <= LABOURERS; i++)
        assert_int_equal(pthread_create(&threads[i], NULL, i < LABOURERS ? labour : keep, &labourers[i]), 0);
    for (int i = 0; i <= LABOURERS; i++) pthread_join(threads[i], NULL);
    assert_int_equal(toy_state(farm, 1, job), JOB_FINISHING);
    hash_t sums = toy_sums(farm, job);
    assert_true(hash_equal(&sums, &calm.sums));
    assert_int_equal(toy_report(farm, 1, job).record.samples_done, calm.samples);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define WITH_FARM(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
#define LEAVES_FARM(test) cmocka_unit_test_teardown(test, tear_down)
        WITH_FARM(jobs_of_one_priority_share_evenly),
        WITH_FARM(who_comes_later_is_owed_nothing),
        WITH_FARM(a_higher_priority_goes_first),
        WITH_FARM(few_jobs_are_begun_at_a_time),
        WITH_FARM(a_paused_job_keeps_what_its_workers_have),
        WITH_FARM(a_short_pause_leaves_nothing_behind),
        WITH_FARM(orders_fit_the_state_or_are_refused),
        WITH_FARM(a_deleted_job_is_unknown_and_its_record_goes),
        WITH_FARM(retained_jobs_are_not_forgotten),
        WITH_FARM(a_long_queue_is_told_in_several_messages),
        WITH_FARM(a_job_is_over_when_image_and_checkpoint_are_made),
        WITH_FARM(what_cannot_be_written_is_tried_again),
        WITH_FARM(cancelling_gives_up_what_cannot_be_written),
        WITH_FARM(what_was_given_up_is_not_tried_again),
        LEAVES_FARM(a_job_goes_on_where_its_checkpoint_was),
        LEAVES_FARM(a_job_without_a_checkpoint_begins_anew),
        LEAVES_FARM(what_begins_anew_has_all_its_time),
        LEAVES_FARM(room_is_kept_for_films_that_come_back),
        LEAVES_FARM(a_job_that_was_finishing_gets_its_image),
        LEAVES_FARM(a_paused_job_stays_paused),
        LEAVES_FARM(a_film_that_cannot_be_had_fails_the_job),
        LEAVES_FARM(shutting_down_saves_all_and_cancels_nothing),
        LEAVES_FARM(an_extended_job_is_as_one_that_was_longer),
        WITH_FARM(an_extension_replaces_what_was_reached),
        WITH_FARM(a_master_that_keeps_no_films_says_so),
        WITH_FARM(rounds_are_the_same_on_any_farm),
        WITH_FARM(a_planned_job_can_be_extended),
        WITH_FARM(an_endless_job_can_be_given_an_error),
        WITH_FARM(the_time_to_an_error_is_estimated),
        WITH_FARM(threads_merge_plan_and_save_at_once),
    };
    return cmocka_run_group_tests_name("farm_queue", tests, NULL, NULL);
}
